//! The surfel pipeline on the GPU: the twin of [`crate::splat`].
//!
//! ```text
//! model (once a scene) ─► project ─► bins ─► trace: rows, surface, sides, residuals, ties ──────┐
//!    │                        │                                                                 ├─► hits ─► records of the layer stack
//!    │                        └─► footprints ─► fragments: count, rasterise, clip, resolve ─────┘
//!    └─► clipping (once a scene): disks, lists of partners ◄─ or, once a frame, the clip buffer
//! ```
//!
//! *Practice.* A thread is a pixel, a workgroup a block of 8×8 pixels: the block's list of surfels is the clip buffer of surfaces, as
//! on the CPU. Lists are filled with atomics and then sorted, so that sums have one order. What a pixel finds goes to lists that grow
//! in shared pools; a pool that is too small tells how much was missing, and the block is traced anew: nothing is lost.
//! There is no `f64` here. The CPU prepares in `f64`, once for a chunk of surfels, its origin in the view and its projection,
//! each as a pair of `f32` whose sum it is; all that kernels compute is relative to a chunk or to a block's nearest surfel.

mod bins;
mod clip;
mod clip_buffer;
mod crossed;
mod far;
mod fragment;
mod frame;
mod model;
mod project;
mod shaders;
mod tables;
mod trace;

pub use clip::GpuClipping;
pub use frame::GpuSplatFrame;
pub use model::{GpuSplatError, GpuSplatModel};
pub(super) use shaders::all;
