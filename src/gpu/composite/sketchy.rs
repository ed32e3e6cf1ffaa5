//! The sketchy style: the twin of [`composite::sketchy`](crate::composite).
//!
//! *Practice.* The noise is the CPU's, computed there where its grid has points, one in 64 pixels: shaders' sines are too coarse to
//! make the same.

use glam::Vec2;

use super::layered::{Canvas, with_gathering};
use super::strokes::Inks;
use super::view::{self, Band};
use crate::composite::sketchy::{Hand, NOISE_GRID_PX};
use crate::gpu::shader::Shader;
use crate::gpu::{Gpu, GpuError, scan};
use crate::gpu_struct;
use crate::scene::style::SketchSettings;
use crate::space::PixelRect;

gpu_struct! {
    /// How loose the hand is.
    pub struct Sketch {
        /// Rows of the matrix of edges' offsets, pixels for a noise of 1.
        edge: [f32; 4],
        /// That of surfaces.
        shade: [f32; 4],
        /// First column and row of the noise's grid, and how many columns it has.
        grid: [u32; 4],
    }
}

/// A loose hand.
pub(super) struct Sketcher {
    hand: Hand,
    settings: SketchSettings,
    /// How far from a pixel it looks, in columns and rows.
    pub reach_px: u32,
}

impl Sketcher {
    /// As `settings` say.
    pub fn new(settings: &SketchSettings) -> Self {
        let hand = Hand::new(settings);
        // One more for the second of two pixels that a lookup lies between.
        Self { hand, settings: *settings, reach_px: hand.reach_px() + 1 }
    }

    /// Draws the `surfaces` and the `inks` of `band` into `canvas`, its part.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`].
    pub fn draw(
        &self,
        gpu: &Gpu,
        band: &Band,
        paints: &wgpu::Buffer,
        surfaces: &wgpu::Buffer,
        inks: &Inks,
        canvas: &Canvas,
    ) -> Result<(), GpuError> {
        let (shader, layers) = (shader(), &band.layers);
        let (count, area) = (layers.count, layers.rect.area());
        let offsets = gpu.storage::<u32>("layer offsets", area + 1)?;
        let colours = gpu.storage::<[f32; 4]>("layer colours", count)?;
        let depths = gpu.storage::<f32>("layer depths", count)?;
        let (noise, grid) = self.noise(gpu, band.part)?;
        let mut commands = gpu.commands();
        let records = [(1, &layers.offsets), (2, &layers.records)];
        band.for_all(&mut commands, &shader, "count_layers", &[&records[..], &[(3, paints), (10, &offsets)]].concat());
        scan::exclusive(gpu, &mut commands, &offsets, area + 1)?;
        let of_layers = [(11, &offsets), (12, &colours), (13, &depths)];
        band.for_all(&mut commands, &shader, "make_layers", &[&records[..], &[(6, surfaces)], &of_layers].concat());
        let others = [
            (3, paints),
            (4, &canvas.pixels),
            (7, &canvas.depths),
            (8, &inks.offsets),
            (9, &inks.inks),
            (14, &noise),
            (15, &grid),
        ];
        band.for_part(&mut commands, &shader, "draw", &[&of_layers[..], &others].concat());
        commands.submit();
        Ok(())
    }

    /// The noise at the grid's points in and around `rect`, row by row, and where they are.
    fn noise(&self, gpu: &Gpu, rect: PixelRect) -> Result<(wgpu::Buffer, wgpu::Buffer), GpuError> {
        let first = |at: u32| at / NOISE_GRID_PX;
        let last = |end: u32| (end - 1) / NOISE_GRID_PX + 1;
        let (x0, y0, x1, y1) = (first(rect.x0), first(rect.y0), last(rect.x1), last(rect.y1));
        let at = |x: u32, y: u32| self.hand.noise_at(Vec2::new((x * NOISE_GRID_PX) as f32, (y * NOISE_GRID_PX) as f32));
        let values: Vec<[f32; 2]> = (y0..=y1).flat_map(|y| (x0..=x1).map(move |x| at(x, y).to_array())).collect();
        let rows = |[a, b]: [[f32; 2]; 2]| [a[0], a[1], b[0], b[1]];
        let sketch = Sketch {
            edge: rows(self.settings.edge_px),
            shade: rows(self.settings.shade_px),
            grid: [x0, y0, x1 - x0 + 1, 0],
        };
        Ok((gpu.upload("noise", &values)?, gpu.uniform("sketch", &sketch)))
    }
}

/// The kernels' module.
pub(super) fn shader() -> Shader {
    with_gathering(view::shader("sketchy"))
        .with_constant("NOISE_GRID_PX", NOISE_GRID_PX)
        .with_constant("MOST_OFFSET_PX", SketchSettings::MOST_OFFSET_PX)
        .with_struct::<Sketch>()
        .with_text(include_str!("../../../shaders/composite/sketchy.wgsl"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_struct_is_the_shaders() {
        crate::gpu::layout::assert_same_layout::<Sketch>();
    }
}
