//! Lit surfaces: the twin of [`composite::shaded`](crate::composite::shaded()).

use super::view::{self, Band};
use crate::composite::Look;
use crate::composite::layered::Inks;
use crate::composite::lighting::{self, GROUND_SHARE, HIGHLIGHT, HIGHLIGHT_EXPONENT, RIM, RIM_EXPONENT};
use crate::gpu::buffers::Commands;
use crate::gpu::layers::LayerRecord;
use crate::gpu::shader::Shader;
use crate::gpu::{Gpu, GpuError};
use crate::gpu_struct;
use crate::scene::style::Style;
use crate::space::Camera;

gpu_struct! {
    /// Light, paper and ink.
    pub struct Paints {
        /// Unit vector, world space.
        towards_light: [f32; 3],
        /// Share of the light that comes from all around.
        ambient: f32,
        /// Linear RGB and straight alpha.
        background: [f32; 4],
        /// Linear RGB of lines.
        ink: [f32; 3],
        /// Strength of a layer's ink as a share of that of the layer before it.
        kept: f32,
        /// Layers drawn at most.
        most: u32,
        /// 1 where surfaces have the ink's colour, else 0.
        tints: u32,
        /// Fills the row.
        unused: [u32; 2],
    }
}

impl Paints {
    /// Of `style` under the light of `look`.
    pub fn new(camera: &Camera, look: &Look, style: &Style) -> Self {
        let shader = lighting::Shader::new(&look.light, camera);
        let inks = Inks::new(style, look.background);
        Self {
            towards_light: shader.towards_light.to_array(),
            ambient: shader.ambient,
            background: look.background,
            ink: inks.colour,
            kept: inks.kept,
            most: style.max_layers.unwrap_or(u32::MAX),
            tints: u32::from(inks.tints),
            unused: [0; 2],
        }
    }
}

/// The kernels' module.
pub(super) fn shader() -> Shader {
    with_light(view::shader("shaded"))
}

/// With what lights and blends.
pub(super) fn with_light(shader: Shader) -> Shader {
    shader
        .with_constant("GROUND_SHARE", GROUND_SHARE)
        .with_constant("HIGHLIGHT", HIGHLIGHT)
        .with_constant("HIGHLIGHT_EXPONENT", HIGHLIGHT_EXPONENT as u32)
        .with_constant("RIM", RIM)
        .with_constant("RIM_EXPONENT", RIM_EXPONENT as u32)
        .with_constant("LEAST_SQUARED", f32::MIN_POSITIVE)
        .with_struct::<LayerRecord>()
        .with_struct::<Paints>()
        .with_text(include_str!("../../../shaders/composite/shaded.wgsl"))
}

/// By row of the band's part, how many of its pixels show a surface.
pub(super) struct Covered(wgpu::Buffer);

impl Covered {
    /// Not counted yet.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`].
    pub fn new(gpu: &Gpu, band: &Band) -> Result<Self, GpuError> {
        Ok(Self(gpu.storage::<u32>("covered", band.part.height() as usize)?))
    }

    /// Counts, where [`blend`] does not.
    pub fn count(&self, commands: &mut Commands, band: &Band) {
        band.for_part(commands, &shader(), "count_covered", &[(1, &band.layers.offsets), (5, &self.0)]);
    }

    /// Over all rows, once all commands are done.
    ///
    /// # Errors
    /// [`GpuError::Lost`].
    pub fn sum(&self, gpu: &Gpu, band: &Band) -> Result<u32, GpuError> {
        Ok(gpu.download::<u32>(&self.0, band.part.height() as usize)?.iter().sum())
    }
}

/// Blends the layers of the band's part into `pixels`, front to back, of `samples` a pixel, and counts what is `covered`.
pub(super) fn blend(
    commands: &mut Commands,
    band: &Band,
    samples: u32,
    paints: &wgpu::Buffer,
    pixels: &wgpu::Buffer,
    covered: &Covered,
) {
    let layers = &band.layers;
    let buffers = [(1, &layers.offsets), (2, &layers.records), (3, paints), (4, pixels), (5, &covered.0)];
    band.for_part(commands, &shader(), if samples > 1 { "blend" } else { "blend_single" }, &buffers);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_struct_is_the_shaders() {
        crate::gpu::layout::assert_same_layout::<Paints>();
    }
}
