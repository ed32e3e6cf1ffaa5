//! Boundaries with the slopes of their tangent planes: the twin of [`composite::facets`](crate::composite).

use super::recolour::with_leaves;
use super::view::{self, Band};
use crate::gpu::layers::LayerRecord;
use crate::gpu::shader::Shader;
use crate::gpu::{Gpu, GpuError, scan};
use crate::gpu_struct;

gpu_struct! {
    /// A boundary as an edge detector sees it.
    pub struct Facet {
        /// Outward unit normal of the result, world space.
        normal: [f32; 3],
        /// Planar view depth, world units.
        depth: f32,
        /// How many footprints deeper the tangent plane is one pixel to the right, and one pixel down.
        step: [f32; 2],
        /// Pixels to a world unit at that depth.
        px_per_unit: f32,
        /// Bits: `IS_FRONT`, `IS_HEAVY`.
        marks: u32,
    }
}

/// The ray enters the result here; no bit of a leaf's.
pub(super) const IS_FRONT: u32 = 4;

/// The facets of a band.
pub(super) struct Facets {
    /// As those of layers.
    pub offsets: wgpu::Buffer,
    /// [`Facet`].
    pub facets: wgpu::Buffer,
}

/// The kernels' module.
pub(super) fn shader() -> Shader {
    with_facets(with_leaves(view::shader("facets")))
        .with_struct::<LayerRecord>()
        .with_text(include_str!("../../../shaders/composite/facets.wgsl"))
}

/// With what reads facets.
pub(super) fn with_facets(shader: Shader) -> Shader {
    shader.with_constant("IS_FRONT", IS_FRONT).with_struct::<Facet>()
}

/// Of the boundaries that the central sample sees, where `samples` a pixel were taken; `leaves` is their table.
///
/// # Errors
/// [`GpuError::TooLarge`].
pub(super) fn facets(gpu: &Gpu, band: &Band, samples: u32, leaves: &wgpu::Buffer) -> Result<Facets, GpuError> {
    let (shader, layers) = (shader(), &band.layers);
    let count = layers.rect.area() + 1;
    let mut commands = gpu.commands();
    // With one sample every boundary has its facet.
    let offsets = if samples > 1 {
        let offsets = gpu.storage::<u32>("facet offsets", count)?;
        let buffers = [(1, &layers.offsets), (2, &layers.records), (4, &offsets)];
        band.for_all(&mut commands, &shader, "count_facets", &buffers);
        scan::exclusive(gpu, &mut commands, &offsets, count)?;
        offsets
    } else {
        layers.offsets.clone()
    };
    let facets = gpu.storage::<Facet>("facets", layers.count)?;
    let buffers = [(1, &layers.offsets), (2, &layers.records), (3, leaves), (5, &offsets), (6, &facets)];
    band.for_all(&mut commands, &shader, "make_facets", &buffers);
    commands.submit();
    Ok(Facets { offsets, facets })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_struct_is_the_shaders() {
        crate::gpu::layout::assert_same_layout::<Facet>();
    }
}
