//! Shade in hollows: the twin of [`composite::occlusion`](crate::composite).

use super::view::{self, Band};
use crate::composite::occlusion::{ANOTHER_BODY, DIRECTIONS, LEAST_HEIGHT, MAYBE_ANOTHER_BODY, RINGS, neighbours};
use crate::gpu::buffers::Commands;
use crate::gpu::layers::LayerRecord;
use crate::gpu::shader::Shader;
use crate::gpu::{Gpu, GpuError};
use crate::gpu_struct;
use crate::space::Camera;

gpu_struct! {
    /// How dark hollows are.
    pub struct Shade {
        /// 0 to 1.
        strength: f32,
    }
}

/// Darkens surfaces where their neighbours hide the sky.
pub(super) struct Occlusion {
    shade: wgpu::Buffer,
    neighbours: wgpu::Buffer,
    /// How far from a pixel its neighbours are, in columns and rows.
    pub reach_px: u32,
}

impl Occlusion {
    /// For pictures of `camera`; at a `strength` of 1 a surface loses the share of its light that its sky loses.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`].
    pub fn new(gpu: &Gpu, camera: &Camera, strength: f32) -> Result<Self, GpuError> {
        let asked = neighbours(camera);
        let reach = asked.iter().flatten().map(|neighbour| neighbour.at.abs().max_element()).fold(0.0, f32::max);
        let rows: Vec<[f32; 4]> = asked.iter().flatten().map(|n| [n.at.x, n.at.y, n.per_distance, 0.0]).collect();
        Ok(Self {
            shade: gpu.uniform("shade", &Shade { strength }),
            neighbours: gpu.upload("neighbours", &rows)?,
            reach_px: reach as u32,
        })
    }

    /// Darkens the lit `surfaces` of the band's part.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`].
    pub fn darken(
        &self,
        gpu: &Gpu,
        commands: &mut Commands,
        band: &Band,
        surfaces: &wgpu::Buffer,
    ) -> Result<(), GpuError> {
        let (shader, layers) = (shader(), &band.layers);
        let nearest = gpu.storage::<f32>("nearest", layers.rect.area())?;
        let both = [(1, &layers.offsets), (2, &layers.records), (4, &nearest)];
        band.for_all(commands, &shader, "find_nearest", &both);
        let others = [(3, surfaces), (5, &self.neighbours), (6, &self.shade)];
        band.for_part(commands, &shader, "darken", &[both, others].concat());
        Ok(())
    }
}

/// The kernels' module.
pub(super) fn shader() -> Shader {
    view::shader("occlusion")
        .with_constant("DIRECTIONS", DIRECTIONS as u32)
        .with_constant("RINGS", RINGS.len() as u32)
        .with_constant("ANOTHER_BODY", ANOTHER_BODY)
        .with_constant("MAYBE_ANOTHER_BODY", MAYBE_ANOTHER_BODY)
        .with_constant("LEAST_HEIGHT", LEAST_HEIGHT)
        .with_struct::<LayerRecord>()
        .with_struct::<Shade>()
        .with_text(include_str!("../../../shaders/composite/occlusion.wgsl"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_struct_is_the_shaders() {
        crate::gpu::layout::assert_same_layout::<Shade>();
    }
}
