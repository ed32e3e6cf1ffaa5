//! Edge points into strokes and strokes into ink: the twin of [`composite::strokes`](crate::composite).
//!
//! *Changes from the CPU.* There each layer of a tile has a map of its ink, into which strokes are drawn one after the other. Here a
//! pixel has a list of its layers' ink, down to the last that has any, and asks the strokes around it.

use super::edges::{EdgePoints, LineRules, modes, points, with_points};
use super::facets::facets;
use super::view::{self, Band};
use crate::composite::strokes::{
    DASH_DIRECTIONS, FADED_PX, FEWEST_NEIGHBOURS, HEAVY, NEAR_PX, SAME_LINE_PX, SAME_WAY, WEIGHT_ENDS_PX, WHOLE_PX,
};
use crate::gpu::shader::Shader;
use crate::gpu::{Gpu, GpuError, scan};
use crate::gpu_struct;
use crate::scene::style::{Style, WIDEST_LINE_PX};
use glam::Vec2;

gpu_struct! {
    /// A piece of a line.
    pub struct Stroke {
        /// Its middle, in pixels.
        at: [f32; 2],
        /// Unit vector along it.
        along: [f32; 2],
        /// World units.
        depth: f32,
        /// 0 to 1; 0 where there is none.
        strength: f32,
        /// Pixels.
        width: f32,
        /// Its surface's layer.
        layer: u32,
    }
}

/// The ink of a band.
pub(super) struct Inks {
    /// By pixel, as those of layers.
    pub offsets: wgpu::Buffer,
    /// By layer: the share of the pixel that is inked, and the depth of the nearest line.
    pub inks: wgpu::Buffer,
}

/// How lines are found and drawn.
pub(super) struct Lines {
    rules: wgpu::Buffer,
    modes: [wgpu::Buffer; 2],
    /// How far from a pixel the layers are that its ink depends on, in columns and rows.
    pub reach_px: u32,
}

impl Lines {
    /// Those of `style`; `None` where it draws none. `any_heavy` says whether the outline of a leaf is drawn stronger.
    pub fn new(gpu: &Gpu, style: &Style, any_heavy: bool) -> Option<Self> {
        if !style.kind.has_lines() && !any_heavy {
            return None;
        }
        let width_px = style.lines.width_px.clamp(0.0, WIDEST_LINE_PX);
        let widest = width_px * if any_heavy { HEAVY } else { 1.0 };
        // A point lies between its pixel and the next, and its stroke is moved onto the line of those around it.
        let window = ((0.5 * widest + 0.5).max(FADED_PX) + SAME_LINE_PX + 1.0).ceil() as u32;
        /// A point depends on facets so many pixels before its own and beyond the next.
        const FACETS_PX: u32 = 2;
        Some(Self {
            rules: gpu.uniform("line rules", &LineRules::new(style, width_px, window)),
            modes: modes(gpu),
            reach_px: window + NEAR_PX + FACETS_PX,
        })
    }

    /// The ink of `band`, of which `samples` a pixel were taken; `leaves` is the leaves' table.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`], [`GpuError::Lost`].
    pub fn inks(&self, gpu: &Gpu, band: &Band, samples: u32, leaves: &wgpu::Buffer) -> Result<Inks, GpuError> {
        let facets = facets(gpu, band, samples, leaves)?;
        let points = points(gpu, band, &facets, &self.rules, &self.modes)?;
        drop(facets);
        if points.count == 0 {
            return no_inks(gpu, band);
        }
        self.drawn(gpu, band, &points)
    }

    fn drawn(&self, gpu: &Gpu, band: &Band, points: &EdgePoints) -> Result<Inks, GpuError> {
        let (shader, area) = (shader(), band.layers.rect.area());
        let strokes = gpu.storage::<Stroke>("strokes", points.count)?;
        let mut commands = gpu.commands();
        let buffers = [(1, &self.rules), (2, &points.offsets), (3, &points.points), (4, &strokes)];
        band.for_all(&mut commands, &shader, "make_strokes", &buffers);
        let offsets = gpu.storage::<u32>("ink offsets", area + 1)?;
        let none = gpu.storage::<[f32; 2]>("no inks", 1)?;
        let [counts, writes] = &self.modes;
        let with =
            |inks, mode| [(1, &self.rules), (2, &points.offsets), (4, &strokes), (5, &offsets), (6, inks), (7, mode)];
        band.for_all(&mut commands, &shader, "find_inks", &with(&none, counts));
        scan::exclusive(gpu, &mut commands, &offsets, area + 1)?;
        commands.submit();
        let count = gpu.download_from::<u32>(&offsets, 4 * area as u64, 1)?[0] as usize;
        let inks = gpu.storage::<[f32; 2]>("inks", count)?;
        let mut commands = gpu.commands();
        band.for_all(&mut commands, &shader, "find_inks", &with(&inks, writes));
        commands.submit();
        Ok(Inks { offsets, inks })
    }
}

/// No ink at any pixel of `band`.
///
/// # Errors
/// [`GpuError::TooLarge`].
pub(super) fn no_inks(gpu: &Gpu, band: &Band) -> Result<Inks, GpuError> {
    Ok(Inks {
        offsets: gpu.storage::<u32>("ink offsets", band.layers.rect.area() + 1)?,
        inks: gpu.storage::<[f32; 2]>("no inks", 1)?,
    })
}

/// The kernels' module.
pub(super) fn shader() -> Shader {
    with_points(view::shader("strokes"))
        .with_constant("NEAR_PX", NEAR_PX)
        .with_constant("WEIGHT_ENDS_PX", WEIGHT_ENDS_PX)
        .with_constant("SAME_WAY", SAME_WAY)
        .with_constant("SAME_LINE_PX", SAME_LINE_PX)
        .with_constant("FEWEST_NEIGHBOURS", FEWEST_NEIGHBOURS as u32)
        .with_constant("WHOLE_PX", WHOLE_PX)
        .with_constant("FADED_PX", FADED_PX)
        .with_constant("HEAVY", HEAVY)
        .with_text(&dash_ways())
        .with_struct::<Stroke>()
        .with_text(include_str!("../../../shaders/composite/strokes.wgsl"))
}

/// The directions that dashes tell apart, in the half of the circle that stands for both.
fn dash_ways() -> String {
    let way = |i: u32| {
        let Vec2 { x, y } = Vec2::from_angle(i as f32 * std::f32::consts::PI / DASH_DIRECTIONS);
        format!("vec2<f32>({x:e}f, {y:e}f)")
    };
    let ways: Vec<String> = (0..DASH_DIRECTIONS as u32).map(way).collect();
    format!(
        "const DASH_DIRECTIONS: u32 = {count}u;\nconst DASH_WAYS = array<vec2<f32>, {count}>({ways});\n",
        count = ways.len(),
        ways = ways.join(", ")
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_struct_is_the_shaders() {
        crate::gpu::layout::assert_same_layout::<Stroke>();
    }
}
