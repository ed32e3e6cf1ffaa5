//! Fragments on the GPU: the twin of [`crate::splat::fragment`], with the footprints of [`crate::splat::ewa`].
//!
//! *Practice.* A pixel counts its fragments, takes as many places as it needs from a pool that all pixels share, and lists them; a
//! pool that is too small says how many were missing, and the rectangle is drawn anew. It then takes them from a heap, front to back,
//! so that what an opaque surface hides is never sorted. Between the two every
//! fragment is clipped by a thread of its own: partners' lists differ in length by more than pixels' do. Surfaces grow in the slots that fragments were taken from.

use super::project::SplatView;
use super::shaders;
use super::trace::{Drawing, Scene};
use crate::gpu::{Gpu, GpuError};
use crate::gpu_struct;
use crate::splat::bins::BLOCK;

gpu_struct! {
    /// A surfel's footprint: the twin of [`crate::splat::ewa::Splat`].
    pub(super) struct Footprint {
        /// V⁻¹ of the low-passed Gaussian, pixels: xx, xy, yy.
        low_passed: [f32; 3],
        /// Weight at the centre, at most 1.
        peak: f32,
        /// The drawn ellipse is where this is at most 1: xx, xy, yy.
        outline: [f32; 3],
        /// Half of the depth range of the disk.
        depth_reach: f32,
        /// 1 / depth of the centre; 0 for parallel rays.
        inverse_depth: f32,
        /// How far apart in depth neighbouring fragments of one surface may lie.
        reach: f32,
        /// 1 where the disk is too near the eye's plane to have a projection.
        is_close: u32,
        /// Fills the gap.
        unused: u32,
    }
}

gpu_struct! {
    /// A surfel at a pixel.
    pub(super) struct Fragment {
        /// Depth less the block's anchor.
        t: f32,
        /// Depth less the surfel's reference depth.
        tau: f32,
        /// EWA weight.
        weight: f32,
        /// That of the footprint.
        reach: f32,
        /// The view of the surfel.
        id: u32,
        /// The number of its pixel; once it is clipped, how the result changes there.
        pixel: u32,
    }
}

/// Pixels of a block that one workgroup makes hits of.
pub(super) const RESOLVED_TOGETHER: u32 = 16;

/// Workgroups of a block.
const PARTS: usize = (BLOCK * BLOCK / RESOLVED_TOGETHER) as usize;

/// Words of a pixel's range of fragments: the first, and how many.
pub(super) const RANGE_WORDS: usize = 2;

/// The footprints of all surfels that `view` and `scene` tell of.
///
/// # Errors
/// [`GpuError::TooLarge`].
pub(super) fn footprints(
    gpu: &Gpu,
    view: &SplatView,
    views: &wgpu::Buffer,
    words: (u32, u32),
) -> Result<wgpu::Buffer, GpuError> {
    let footprints = gpu.storage::<Footprint>("footprints", view.views as usize)?;
    let kernel = gpu.kernel(&shaders::fragment(words.0, words.1), "find_footprints");
    let uniform = gpu.uniform("splat view", view);
    let mut commands = gpu.commands();
    let buffers = [(0, &uniform), (1, views), (9, &footprints)];
    commands.dispatch(&kernel, &gpu.bind(&kernel, &buffers), view.views as usize);
    commands.submit();
    Ok(footprints)
}

/// Lists the fragments of one sample, clips them, and makes hits of them.
pub(super) fn dispatch(drawing: &mut Drawing<'_, '_>, scene: &Scene<'_>, footprints: &wgpu::Buffer, stack_words: u32) {
    let gpu = drawing.commands.gpu();
    let shader = shaders::fragment(scene.leaf_words, stack_words);
    let kernel = |entry| gpu.kernel(&shader, entry);
    let all = [
        (0, drawing.uniform),
        (1, scene.views),
        (2, &scene.bins.members),
        (3, &scene.bins.starts),
        (5, drawing.pixels),
        (6, scene.far),
        (7, scene.tables),
        (8, drawing.hits),
        (9, footprints),
        (10, drawing.pool),
    ];
    let group = |kernel: &wgpu::ComputePipeline, bindings: &[u32]| {
        let buffers: Vec<_> = all.iter().copied().filter(|(binding, _)| bindings.contains(binding)).collect();
        gpu.bind(kernel, &buffers)
    };
    for kernel in ["count_fragments", "rasterise"].map(kernel) {
        drawing.commands.dispatch_groups(&kernel, &group(&kernel, &[0, 1, 2, 3, 5, 9, 10]), drawing.blocks);
    }
    // The device alone knows how many fragments there are; threads without one end at once.
    let most = drawing.pool.size() as usize / size_of::<Fragment>();
    let clip = kernel("clip_fragments");
    drawing.commands.dispatch(&clip, &group(&clip, &[0, 1, 2, 5, 6, 7, 10]), most);
    let resolve = kernel("resolve_fragments");
    drawing.commands.dispatch_groups(&resolve, &group(&resolve, &[0, 1, 2, 3, 5, 6, 7, 8, 10]), drawing.blocks * PARTS);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_structs_are_the_shaders() {
        crate::gpu::layout::assert_same_layout::<Footprint>();
        crate::gpu::layout::assert_same_layout::<Fragment>();
    }
}
