//! The mesh pipeline on the GPU: [`blister`](crate::blister) with its fragments found by the GPU's rasteriser.
//!
//! ```text
//! MeshFrame (CPU, f64): snapped corners, planes, hits of solids ─► arrangement ─► raster ─► fragments ─► resolve ─► write ─► GpuLayers
//! ```
//!
//! *Theory.* Blister §3-4; what a boundary is, who owns it and what lies behind are as in [`blister`](crate::blister).
//!
//! *Changes from the paper.* WGSL has no `f64`, so vertices are projected and snapped on the CPU, as for its own pipeline: then both
//! cover the same samples. Three ways to classify what is drawn: `list` puts every fragment into its pixel's list in one pass and
//! resolves the lists in compute; the others peel.
//!
//! *Practice.* [`arrangement`] is what is uploaded; [`list`] draws it. A band that needs more than one buffer's worth of fragments
//! is refused with [`GpuError::TooLarge`](super::GpuError::TooLarge), and drawn in parts by whoever asked.

pub mod arrangement;
pub mod list;

pub use list::GpuMeshFrame;

use super::layers::LayerRecord;
use super::shader::Shader;
use crate::csg::steps::{INSIDE, OUTSIDE};
use arrangement::{Fragment, Frame, PlacedCorner, Slot, Step, Surface, Survivor, flags};

/// No slot.
const NO_SLOT: u32 = u32::MAX;

/// Pixels with more fragments are sorted by heap: insertion is quadratic.
const INSERTION_SORTED: u32 = 32;

/// The module, for states of so many words.
pub(super) fn shader(words: u32) -> Shader {
    Shader::new("blister")
        .with_constant("WORDS", words)
        .with_constant("NO_SLOT", NO_SLOT)
        .with_constant("STEP_INSIDE", INSIDE)
        .with_constant("STEP_OUTSIDE", OUTSIDE)
        .with_constant("INSERTION_SORTED", INSERTION_SORTED)
        .with_constant("SLOT_SHEET", flags::SLOT_SHEET)
        .with_constant("SLOT_ENDLESS", flags::SLOT_ENDLESS)
        .with_constant("SURFACE_HIDDEN", flags::SURFACE_HIDDEN)
        .with_constant("SURFACE_OWN_COLOUR", flags::SURFACE_OWN_COLOUR)
        .with_constant("SURFACE_CORNER_COLOURS", flags::SURFACE_CORNER_COLOURS)
        .with_struct::<Frame>()
        .with_struct::<Step>()
        .with_struct::<Slot>()
        .with_struct::<Surface>()
        .with_struct::<Fragment>()
        .with_struct::<Survivor>()
        .with_struct::<PlacedCorner>()
        .with_struct::<LayerRecord>()
        .with_text(include_str!("../../../shaders/blister/frame.wgsl"))
        .with_text(include_str!("../../../shaders/blister/expression.wgsl"))
        .with_text(include_str!("../../../shaders/blister/raster.wgsl"))
        .with_text(include_str!("../../../shaders/blister/list.wgsl"))
        .with_text(include_str!("../../../shaders/blister/resolve.wgsl"))
        .with_text(include_str!("../../../shaders/blister/write.wgsl"))
}
