//! The compositor on the GPU: the twin of [`composite`](crate::composite), band by band.
//!
//! ```text
//! layers of a band ─► recolour ─► shaded ──────────────────────────────────► pixels
//!                        │                                                     ▲
//!                        ├─► facets ─► edges ─► strokes ─┐ ink by layer         │
//!                        └─► lit surfaces, occlusion ────┴─► layered, sketchy ─┘
//! ```
//!
//! *Practice.* A band is a part of the picture and what lies around it as far as the style looks; the source draws it on the GPU,
//! and nothing of it comes back but the part's pixels, their depths, and a few counts that tell how large the next buffer must
//! be. A band whose records fit no buffer is halved. Every thread is about one pixel and writes what no other does, so that
//! pictures are the same bits every time. What the algorithms are and why is told beside the CPU's; here is told what differs.

mod edges;
mod facets;
mod layered;
mod occlusion;
mod recolour;
mod section;
mod shaded;
pub mod shadow;
mod sketchy;
mod strokes;
mod styled;
mod view;

pub use styled::{styled, styled_with};

/// Every module of the compositor.
pub(super) fn shaders() -> Vec<super::shader::Shader> {
    vec![
        recolour::shader(),
        shaded::shader(),
        facets::shader(),
        edges::shader(),
        strokes::shader(),
        layered::shader(),
        occlusion::shader(),
        sketchy::shader(),
        shadow::shader(),
    ]
}
