//! The GPU, through wgpu: the same stages as on the CPU, in shaders of the same names.
//!
//! ```text
//! device ─► buffers, scan ─► blister, splat, hybrid (twins of the pipelines) ─► layers ─► composite (twin of the compositor) ─► picture
//!           layout, shader: structs, constants and modules, made from Rust
//! ```
//!
//! *Practice.* The CPU's path owns what is right: every twin is compared with it. A module that a shader is made of is in
//! [`shader::all`], which a test checks without a GPU.

pub mod blister;
pub mod buffers;
pub mod composite;
pub mod crossings;
pub mod device;
pub mod hybrid;
pub mod layers;
pub mod layout;
pub mod merged;
pub mod scan;
pub mod shader;
pub mod splat;

pub use buffers::Commands;
pub use device::{Gpu, GpuError};
pub use layers::{GpuLayerSource, GpuLayers};
