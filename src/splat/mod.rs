//! From classified surfels to the boundaries of the result at every pixel.
//!
//! A [`Frame`] is a [`LayerSource`](crate::layers::LayerSource): [`frame`] bins surfels into tiles, [`project`] turns a
//! tile's surfels into view space, [`rows`] holds the kernels that find, solve and clip surfaces for eight rays at once,
//! and [`surface`] puts them together for one block of pixels.

pub mod frame;
pub mod project;
pub mod rows;
pub mod settings;
pub mod surface;

pub use frame::Frame;
pub use settings::{Clip, Inside, Partners, SplatSettings, Unknown};
