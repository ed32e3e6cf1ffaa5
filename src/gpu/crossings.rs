//! Crossings of rays and leaves on the GPU: the twin of [`crate::crossings`], in buffers.
//!
//! *Practice.* Whoever finds leaves by their exact form is a [`GpuCrossingSource`]; whoever finds the others by their surfels asks it
//! for a band at a time, and knows nothing of how they were found. Kernels cannot ask the source for a colour later, so a crossing
//! brings its own.

use super::device::{Gpu, GpuError};
use crate::csg::LeafId;
use crate::gpu_struct;
use crate::space::PixelRect;

gpu_struct! {
    /// A [`Crossing`](crate::crossings::Crossing), as buffers hold it.
    pub struct CrossingRecord {
        /// Unit normal, world space, either way.
        normal: [f32; 3],
        /// Planar view depth, world units. Crossings that coincide have exactly the same.
        depth: f32,
        /// Linear RGB.
        colour: [f32; 3],
        /// 0 to 1.
        opacity: f32,
        /// Index into the scene's leaves.
        leaf: u32,
        /// [`CROSSING_ENTERS`], [`CROSSING_SHOWS`].
        flags: u32,
        /// Nothing.
        gap: [u32; 2],
    }
}

/// Bit of [`CrossingRecord::flags`]: the ray is inside of the leaf behind it. Means nothing for sheets.
pub const CROSSING_ENTERS: u32 = 1;
/// Bit of [`CrossingRecord::flags`]: the surface shows there; a half-space shows only within its square.
pub const CROSSING_SHOWS: u32 = 2;

/// Leaves that one word of [`GpuCrossings::begins`] has bits for.
pub const LEAVES_A_WORD: u32 = u32::BITS;

/// The crossings of all rays of a band, at one place within its pixels.
#[derive(Debug)]
pub struct GpuCrossings {
    /// Which pixels.
    pub rect: PixelRect,
    /// `area() + 1` numbers: where each pixel's crossings begin, pixels row by row.
    pub offsets: wgpu::Buffer,
    /// By pixel and word, [`begins_words`](Self::begins_words) for a pixel: a bit for each leaf of the scene, set where the ray begins
    /// inside of it.
    pub begins: wgpu::Buffer,
    /// Words of `begins` that a pixel has; leaves beyond them are none that a ray begins inside of.
    pub begins_words: u32,
    /// [`CrossingRecord`], front to back within a pixel.
    pub crossings: wgpu::Buffer,
    /// How many crossings there are.
    pub count: usize,
}

/// Words that have bits for the leaves up to `last`.
pub fn words_for(last: LeafId) -> u32 {
    last.0 / LEAVES_A_WORD + 1
}

/// Whoever finds leaves by their exact form on the GPU: the twin of [`CrossingSource`](crate::crossings::CrossingSource).
pub trait GpuCrossingSource: std::fmt::Debug {
    /// The leaves that it finds, ascending.
    fn leaves(&self) -> Vec<LeafId>;
    /// All crossings of its leaves and the rays of `rect`, which lies within the picture, at the place of sample number `sample` of the
    /// frame within its pixels.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`] where they fit no buffer: ask for the rectangle's parts. Else what befell the device.
    fn crossings(&self, gpu: &Gpu, rect: PixelRect, sample: usize) -> Result<GpuCrossings, GpuError>;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_struct_is_the_shaders() {
        crate::gpu::layout::assert_same_layout::<CrossingRecord>();
    }

    #[test]
    fn every_leaf_has_a_word() {
        assert_eq!([0, 31, 32, 100].map(|leaf| words_for(LeafId(leaf))), [1, 1, 2, 4]);
    }
}
