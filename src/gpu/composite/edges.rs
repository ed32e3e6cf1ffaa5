//! Where lines pass between pixels: the twin of [`composite::edges`](crate::composite).
//!
//! *Practice.* How many points there are is not known before they are found. They are found twice: first counted, then put where
//! the counts' sums say. Both passes are one kernel told apart by a uniform, since two kernels might round in two ways, and count
//! one point more than they find.

use super::facets::{Facets, with_facets};
use super::recolour::with_marks;
use super::view::{self, Band};
use crate::composite::edges::{CURVED_SHARE, FULL_CREASE, PEAK, SHARP_COS, SLACK, SMOOTH_COS, crease_limits};
use crate::gpu::shader::Shader;
use crate::gpu::{Gpu, GpuError, scan};
use crate::gpu_struct;
use crate::scene::style::Style;

gpu_struct! {
    /// A place between two neighbouring pixels that a line passes.
    pub struct EdgePoint {
        /// In pixels, (0, 0) the picture's top left corner.
        at: [f32; 2],
        /// Unit vector across the line; zero where unknown.
        across: [f32; 2],
        /// Of the nearer surface, world units.
        depth: f32,
        /// 0 to 1.
        strength: f32,
        /// The layer whose surface has the edge, from 0.
        layer: u32,
        /// One past the last layer whose picture changes here.
        until: u32,
        /// Bits: `IS_SILHOUETTE`, `IS_HEAVY`.
        marks: u32,
        /// Fills the row.
        unused: u32,
    }
}

gpu_struct! {
    /// When a line is drawn, and how.
    pub struct LineRules {
        /// Footprints that a surface may be off its tangent planes.
        jump_px: f32,
        /// Two normals with a lesser cosine may be a crease.
        least_cos: f32,
        /// Two normals that are so far apart are a crease: a chord of the unit circle.
        crease: f32,
        /// Pixels.
        width_px: f32,
        /// Pixels of a dash, and of a gap.
        dash: [f32; 2],
        /// 1 where hidden lines are dashed, else 0.
        is_dashed: u32,
        /// 1 where all lines are drawn, 0 where heavy ones alone.
        draws_all: u32,
        /// Layers drawn at most.
        most: u32,
        /// How many columns and rows away the stroke of a pixel's point may be that inks a pixel.
        window: u32,
        /// Fills the row.
        unused: [u32; 2],
    }
}

gpu_struct! {
    /// Which of two passes a kernel makes.
    pub struct Mode {
        /// 0: it counts; 1: it writes.
        writes: u32,
    }
}

/// The point is a silhouette's, else a crease's; no bit of a leaf's.
const IS_SILHOUETTE: u32 = 8;

impl LineRules {
    /// Of `style`, whose lines are `width_px` wide and ink pixels up to `window` away.
    pub fn new(style: &Style, width_px: f32, window: u32) -> Self {
        let (crease, least_cos) = crease_limits(style.lines.crease_degrees);
        Self {
            jump_px: style.lines.jump_px,
            least_cos,
            crease,
            width_px,
            dash: style.lines.hidden_dash_px.unwrap_or_default(),
            is_dashed: u32::from(style.lines.hidden_dash_px.is_some()),
            draws_all: u32::from(style.kind.has_lines()),
            most: style.max_layers.unwrap_or(u32::MAX),
            window,
            unused: [0; 2],
        }
    }
}

/// The edge points of a band.
pub(super) struct EdgePoints {
    /// By pixel, as those of layers: the points between it and those to its right and below it.
    pub offsets: wgpu::Buffer,
    /// [`EdgePoint`].
    pub points: wgpu::Buffer,
    /// How many there are.
    pub count: usize,
}

/// The kernel's module.
pub(super) fn shader() -> Shader {
    with_points(with_facets(view::shader("edges")))
        .with_constant("CURVED_SHARE", CURVED_SHARE)
        .with_constant("FULL_CREASE", FULL_CREASE)
        .with_constant("PEAK", PEAK)
        .with_constant("SHARP_COS", SHARP_COS)
        .with_constant("SMOOTH_COS", SMOOTH_COS)
        .with_constant("SLACK", SLACK)
        .with_text(include_str!("../../../shaders/composite/edges.wgsl"))
}

/// With what reads points.
pub(super) fn with_points(shader: Shader) -> Shader {
    with_marks(shader)
        .with_constant("IS_SILHOUETTE", IS_SILHOUETTE)
        .with_constant("LEAST_SQUARED", f32::MIN_POSITIVE)
        .with_struct::<EdgePoint>()
        .with_struct::<LineRules>()
        .with_struct::<Mode>()
}

/// The uniforms of the pass that counts and of the one that writes.
pub(super) fn modes(gpu: &Gpu) -> [wgpu::Buffer; 2] {
    [0, 1].map(|writes| gpu.uniform("mode", &Mode { writes }))
}

/// Finds the edge points of `band` by `rules`.
///
/// # Errors
/// [`GpuError::TooLarge`], [`GpuError::Lost`].
pub(super) fn points(
    gpu: &Gpu,
    band: &Band,
    facets: &Facets,
    rules: &wgpu::Buffer,
    [counts, writes]: &[wgpu::Buffer; 2],
) -> Result<EdgePoints, GpuError> {
    let (shader, area) = (shader(), band.layers.rect.area());
    let offsets = gpu.storage::<u32>("point offsets", area + 1)?;
    let none = gpu.storage::<EdgePoint>("no points", 1)?;
    let mut commands = gpu.commands();
    let with =
        |points, mode| [(1, &facets.offsets), (2, &facets.facets), (3, rules), (4, &offsets), (5, points), (6, mode)];
    band.for_all(&mut commands, &shader, "find_edges", &with(&none, counts));
    scan::exclusive(gpu, &mut commands, &offsets, area + 1)?;
    commands.submit();
    let count = gpu.download_from::<u32>(&offsets, 4 * area as u64, 1)?[0] as usize;
    let points = gpu.storage::<EdgePoint>("points", count.max(1))?;
    if count > 0 {
        let mut commands = gpu.commands();
        band.for_all(&mut commands, &shader, "find_edges", &with(&points, writes));
        commands.submit();
    }
    Ok(EdgePoints { offsets, points, count })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::layout::assert_same_layout;

    #[test]
    fn the_structs_are_the_shaders() {
        assert_same_layout::<EdgePoint>();
        assert_same_layout::<LineRules>();
        assert_same_layout::<Mode>();
    }
}
