//! Every layer under its ink: the twin of [`composite::layered`](crate::composite).

use super::shaded::with_light;
use super::shadow::with_light_steps;
use super::strokes::Inks;
use super::view::{self, Band};
use crate::composite::layered::INK_HAS_DEPTH;
use crate::gpu::buffers::Commands;
use crate::gpu::shader::Shader;
use crate::gpu::{Gpu, GpuError};

/// The kernels' module.
pub(super) fn shader() -> Shader {
    with_gathering(view::shader("layered"))
}

/// With what gathers layers.
pub(super) fn with_gathering(shader: Shader) -> Shader {
    with_light_steps(with_light(shader))
        .with_constant("INK_HAS_DEPTH", INK_HAS_DEPTH)
        .with_text(include_str!("../../../shaders/composite/layered.wgsl"))
}

/// The lit colours, with their opacities, of the boundaries of all of the band, or of its part alone. Of the light `kept_off` does not
/// arrive.
///
/// # Errors
/// [`GpuError::TooLarge`].
pub(super) fn surfaces(
    gpu: &Gpu,
    commands: &mut Commands,
    band: &Band,
    paints: &wgpu::Buffer,
    of_all: bool,
    kept_off: Option<&wgpu::Buffer>,
) -> Result<wgpu::Buffer, GpuError> {
    let layers = &band.layers;
    let surfaces = gpu.storage::<[f32; 4]>("surfaces", layers.count)?;
    let mut buffers = vec![(1, &layers.offsets), (2, &layers.records), (3, paints), (6, &surfaces)];
    buffers.extend(kept_off.map(|kept_off| (16, kept_off)));
    let entry = if kept_off.is_some() { "light_shadowed_surfaces" } else { "light_surfaces" };
    if of_all {
        band.for_all(commands, &shader(), entry, &buffers);
    } else {
        band.for_part(commands, &shader(), entry, &buffers);
    }
    Ok(surfaces)
}

/// Where a picture's pixels go.
pub(super) struct Canvas {
    /// Linear red, green, blue, and alpha.
    pub pixels: wgpu::Buffer,
    /// World units.
    pub depths: wgpu::Buffer,
}

/// Blends the `surfaces` of the band's part under their `inks` into `canvas`.
pub(super) fn compose(
    commands: &mut Commands,
    band: &Band,
    paints: &wgpu::Buffer,
    surfaces: &wgpu::Buffer,
    inks: &Inks,
    canvas: &Canvas,
) {
    let layers = &band.layers;
    let buffers = [
        (1, &layers.offsets),
        (2, &layers.records),
        (3, paints),
        (4, &canvas.pixels),
        (6, surfaces),
        (7, &canvas.depths),
        (8, &inks.offsets),
        (9, &inks.inks),
    ];
    band.for_part(commands, &shader(), "compose", &buffers);
}
