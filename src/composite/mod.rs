//! Draws a [`LayerSource`](crate::layers::LayerSource) into a picture. Styles see layers and nothing of what made them.

pub mod picture;
pub mod shaded;

pub use picture::Picture;
pub use shaded::{Look, shaded, shaded_stack};
