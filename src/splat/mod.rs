//! Placeholder docs, filled by the module's change.

pub mod settings;

pub use settings::{Clip, Inside, Partners, SplatSettings, Unknown};
