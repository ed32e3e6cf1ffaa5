//! From classified surfels to the boundaries of the result at every pixel.
//!
//! A [`Frame`] is a [`LayerSource`](crate::layers::LayerSource): [`frame`] bins surfels into tiles, [`project`] turns a
//! tile's surfels into view space, [`rows`] holds the kernels that find, solve and clip surfaces for eight rays at once,
//! and [`surface`] puts them together for one block of pixels. The paper's own way is [`fragment`], with the weights of
//! [`ewa`]; [`clip`] asks clipping partners, which [`clip_buffer`] finds in the picture. Leaves that are not made of surfels
//! come from whoever finds them ([`crossed`]).

pub mod bins;
mod body;
pub mod clip;
pub mod clip_buffer;
pub mod crossed;
pub mod ewa;
#[cfg(test)]
mod figure_tests;
pub mod fragment;
pub mod frame;
#[cfg(test)]
mod grazing_tests;
pub mod hits;
#[cfg(test)]
mod moved_tests;
#[cfg(test)]
mod paper_tests;
pub mod project;
pub mod rows;
pub mod settings;
pub mod settle;
pub mod sides;
pub mod surface;
#[cfg(test)]
pub(crate) mod test_scenes;
pub(crate) mod tied;
#[cfg(test)]
mod tied_tests;
pub(crate) mod turns;

pub use frame::Frame;
pub use settings::{Clip, Inside, Partners, SplatSettings, Unknown};
