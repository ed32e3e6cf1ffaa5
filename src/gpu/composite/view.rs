//! Which pixels a kernel is about, and the camera.

use crate::composite::facets::{STEEPEST, central_sample};
use crate::gpu::buffers::Commands;
use crate::gpu::layers::{GpuLayerSource, GpuLayers};
use crate::gpu::shader::Shader;
use crate::gpu::{Gpu, GpuError};
use crate::gpu_struct;
use crate::layers::MAX_SAMPLES;
use crate::space::{Camera, PixelRect, Projection};

gpu_struct! {
    /// A camera, and a part of a band of its picture.
    pub struct View {
        /// World space.
        right: [f32; 3],
        /// Perspective: tangent of a pixel. Orthographic: 0.
        tangent: f32,
        /// World space.
        down: [f32; 3],
        /// Perspective: at depth 1. Orthographic: at any depth.
        px_per_unit: f32,
        /// World space.
        forward: [f32; 3],
        /// 1 or 0.
        is_perspective: u32,
        /// Where the view's axis meets the picture, pixels, whole numbers the pixels' middles.
        middle: [f32; 2],
        /// Samples a pixel.
        samples: u32,
        /// The one nearest to a pixel's middle.
        central_sample: u32,
        /// The pixels whose layers there are: first column and row, how many of each.
        band: [u32; 4],
        /// Those that the kernel's threads are about, within the band.
        part: [u32; 4],
    }
}

/// Depth where there is nothing: WGSL has no infinity.
pub(super) const FAR: f32 = f32::MAX;

impl View {
    /// Of the pixels `part` of `band`.
    pub fn new(camera: &Camera, samples: u32, band: PixelRect, part: PixelRect) -> Self {
        let (tangent, px_per_unit, is_perspective) = match camera.projection {
            Projection::Perspective { focal_px } => ((1.0 / focal_px) as f32, focal_px as f32, 1),
            Projection::Orthographic { px_per_unit } => (0.0, px_per_unit as f32, 0),
        };
        let corner_and_size = |rect: PixelRect| [rect.x0, rect.y0, rect.width(), rect.height()];
        Self {
            right: camera.right.as_vec3().to_array(),
            tangent,
            down: camera.down.as_vec3().to_array(),
            px_per_unit,
            forward: camera.forward.as_vec3().to_array(),
            is_perspective,
            middle: [0.5 * camera.width as f32 - 0.5, 0.5 * camera.height as f32 - 0.5],
            samples,
            central_sample: central_sample(samples),
            band: corner_and_size(band),
            part: corner_and_size(part),
        }
    }
}

/// A module about the pixels of a view.
pub(super) fn shader(name: &'static str) -> Shader {
    Shader::new(name)
        .with_constant("MAX_SAMPLES", MAX_SAMPLES)
        .with_constant("FAR", FAR)
        .with_constant("STEEPEST", STEEPEST)
        .with_struct::<View>()
        .with_text(include_str!("../../../shaders/composite/view.wgsl"))
}

/// A part of the picture, with the layers of all that its pixels look at.
pub(super) struct Band {
    /// Layers of the part and of what is around it.
    pub layers: GpuLayers,
    /// The pixels that are wanted.
    pub part: PixelRect,
    /// [`View`] of the part.
    pub of_part: wgpu::Buffer,
    /// [`View`] whose part is all of the band.
    pub of_all: wgpu::Buffer,
}

impl Band {
    /// The band around `part` as far as `reach_px`.
    ///
    /// # Errors
    /// Those of the source.
    pub fn draw(gpu: &Gpu, source: &dyn GpuLayerSource, part: PixelRect, reach_px: u32) -> Result<Self, GpuError> {
        let camera = source.camera();
        let rect = PixelRect {
            x0: part.x0.saturating_sub(reach_px),
            y0: part.y0.saturating_sub(reach_px),
            x1: (part.x1 + reach_px).min(camera.width),
            y1: (part.y1 + reach_px).min(camera.height),
        };
        let layers = source.draw(gpu, rect)?;
        let view = |part| gpu.uniform("view", &View::new(camera, source.samples().clamp(1, MAX_SAMPLES), rect, part));
        Ok(Self { layers, part, of_part: view(part), of_all: view(rect) })
    }

    /// Runs the entry point `entry` of `shader` once for each pixel of the part, `buffers` by their binding.
    pub fn for_part(&self, commands: &mut Commands, shader: &Shader, entry: &'static str, buffers: &[Bound]) {
        run(commands, shader, entry, &self.of_part, buffers, self.part.area());
    }

    /// The same for each pixel of the band.
    pub fn for_all(&self, commands: &mut Commands, shader: &Shader, entry: &'static str, buffers: &[Bound]) {
        run(commands, shader, entry, &self.of_all, buffers, self.layers.rect.area());
    }
}

/// A buffer and its binding.
pub(super) type Bound<'a> = (u32, &'a wgpu::Buffer);

fn run(
    commands: &mut Commands,
    shader: &Shader,
    entry: &'static str,
    view: &wgpu::Buffer,
    buffers: &[Bound],
    threads: usize,
) {
    let gpu = commands.gpu();
    let kernel = gpu.kernel(shader, entry);
    let bound: Vec<Bound> = [(0, view)].into_iter().chain(buffers.iter().copied()).collect();
    commands.dispatch(&kernel, &gpu.bind(&kernel, &bound), threads);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_struct_is_the_shaders() {
        crate::gpu::layout::assert_same_layout::<View>();
    }
}
