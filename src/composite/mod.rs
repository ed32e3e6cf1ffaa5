//! Draws a [`LayerSource`](crate::layers::LayerSource) into a picture. Styles see layers and nothing of what made them.
//!
//! *Practice.* [`recolour`] changes opacity and colours on the way in. `shaded` needs nothing but a pixel's own layers, lit as
//! [`lighting`] says. The styles with lines go strip by strip: `facets` gives boundaries slopes, `edges` finds where lines pass
//! between pixels, `strokes` smooths and draws them, and `layered` or `sketchy` (with `noise`, over a `window`) blends layers and
//! lines into a `canvas`; [`maps`] shows what they are made of. [`shadow`] asks what the light sees (`light_map`, in tiles of
//! `light_grid`). `occlusion` darkens the hollows of a shaded scan. Over the finished picture, [`legend`] names the leaves that
//! `shown` saw, each by its `swatch`, in letters of `lettering`.

mod canvas;
pub(crate) mod edges;
pub(crate) mod facets;
pub(crate) mod layered;
pub mod legend;
mod lettering;
pub(crate) mod light_frames;
pub mod light_grid;
pub mod light_map;
pub mod lighting;
pub mod maps;
pub mod merge;
mod noise;
pub(crate) mod occlusion;
pub mod picture;
pub mod recolour;
pub mod section;
pub mod shaded;
pub mod shadow;
mod shown;
pub(crate) mod sketchy;
pub(crate) mod strip;
pub(crate) mod strokes;
pub(crate) mod styled;
mod swatch;
#[cfg(test)]
mod tests;
mod window;

pub use lighting::Look;
pub use picture::Picture;
pub use shaded::shaded;
pub use styled::{Leaves, styled, styled_with};
