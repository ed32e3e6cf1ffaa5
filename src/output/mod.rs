//! What leaves the program: pictures (PNG, EXR) and the summary of a run. Never half-written, never overwritten unasked.

pub mod destination;
pub mod exr;
pub mod film;
pub mod frames;
mod gif;
pub mod png;
pub mod report;
pub mod resources;

pub use destination::{Destination, OutputError};

/// What a picture's file says of itself beside its pixels.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PictureInfo {
    /// The scene's name, such as its file's.
    pub scene: Option<String>,
    /// The unit of the scene's lengths, such as `mm`.
    pub units: Option<String>,
    /// Pixels per scene unit, for an orthographic picture: with a known unit of length, the file then holds its scale.
    pub px_per_unit: Option<f64>,
}

/// What wrote the file, for its metadata.
pub const SOFTWARE: &str = concat!("surfcut ", env!("CARGO_PKG_VERSION"));
