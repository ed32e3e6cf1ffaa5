//! Chunks of surfels as a camera sees them, from which kernels project the surfels.
//!
//! *Theory.* With C the origin of a chunk and d a surfel's offset, both in view space, the surfel's projection is
//! U + f (d_x − (C_x/C_z) d_z)/(C_z + d_z), U = f C_x/C_z that of the origin: only U, known in `f64`, is large.

use glam::DVec3;
use rayon::prelude::*;

use super::model::Part;
use crate::classify::Model;
use crate::csg::LeafId;
use crate::gpu_struct;
use crate::space::{Camera, PixelRect, Projection};
use crate::splat::project::View;
use crate::surfel::CHUNK;

/// From this many of its radii in front of the eye a chunk's projection stands for its surfels'; nearer ones are as small as the
/// numbers they are computed from.
const FAR_IN_RADII: f64 = 4.0;

gpu_struct! {
    /// A camera, and what of its picture is drawn.
    pub(super) struct SplatView {
        /// World from view: right, down and forward in world axes.
        axes: [[f32; 4]; 3],
        /// The eye less the origin of what is far, world space.
        eye: [f32; 3],
        /// Pixels of a unit of tangent, or of a world unit without perspective.
        focal_px: f32,
        /// Half of the picture's size, pixels.
        half_size: [f32; 2],
        /// Where in its pixel a ray lies.
        place: [f32; 2],
        /// First column and row, and those past the last.
        rect: [u32; 4],
        /// First column and row of blocks, and how many across and down.
        grid: [u32; 4],
        /// 0 for an orthographic camera.
        is_perspective: u32,
        /// 1 where what an opaque surface hides is not wanted.
        nearest_only: u32,
        /// The bits of the samples that a ray stands for.
        samples: u32,
        /// How many views of surfels there are.
        views: u32,
        /// How many groups and how many hits there is room for.
        room: [u32; 2],
        /// How many leaves the scene has.
        leaves: u32,
        /// 1 where the part that is projected has ellipses.
        has_supports: u32,
        /// Where in the buffer of the blocks' lists the offsets of crossings are; 0 where there are none.
        crossings: u32,
        /// And what rays begin inside of.
        begins: u32,
        /// Words of that for a pixel.
        begins_words: u32,
        /// And the crossings.
        first_crossing: u32,
        /// How far outside of its ball a surfel is drawn, pixels.
        margin_px: f32,
        /// How partners are asked: a number of [`super::clip`].
        inside: u32,
        /// The first row of the disks that may be partners.
        disks: u32,
        /// The words that clipping by partners begins with.
        clip: u32,
    }
}

gpu_struct! {
    /// A chunk as the camera sees it.
    pub(super) struct ChunkView {
        /// The origin in view space.
        origin: [f32; 3],
        /// What the rounding of its depth left over.
        depth_rest: f32,
        /// Its projection, picture pixels: x, what rounding left of it, y, and what rounding left.
        middle: [f32; 4],
        /// Its x and y over its depth.
        slope: [f32; 2],
        /// Its first surfel in the part.
        first: u32,
        /// How many it has.
        count: u32,
        /// Whose.
        leaf: u32,
        /// Its first surfel in the leaf.
        index: u32,
        /// Where its views begin.
        view: u32,
        /// 1 where it is too near for its projection to stand for its surfels'.
        is_near: u32,
    }
}

gpu_struct! {
    /// A surfel as the camera sees it: the twin of [`crate::splat::project::ViewSurfel`], but in picture pixels and with its
    /// projection and depth as sums of two, so that it serves every block.
    pub(super) struct SurfelView {
        /// Pixels that its ball may touch: left, right, top, bottom.
        bounds: [f32; 4],
        /// Projection of the centre: x, the rest of x, y, the rest of y.
        middle: [f32; 4],
        /// Reference depth and its rest.
        depth: [f32; 2],
        /// Footprint at the reference depth.
        scale: f32,
        /// Reference depth less the centre's.
        lift: f32,
        /// Unit normal, view axes.
        normal: [f32; 3],
        /// Of the support ball.
        radius: f32,
        /// Curvature, view axes: xx, xy, xz, yy.
        curvature_a: [f32; 4],
        /// And yz, zz.
        curvature_b: [f32; 2],
        /// How far apart in depth fragments of one surface may lie.
        reach: f32,
        /// 0 to 1.
        opacity: f32,
        /// Support, eᵀSe = 1 on its border, view axes: xx, xy, xz, yy.
        support_a: [f32; 4],
        /// And yz, zz.
        support_b: [f32; 2],
        /// What it is drawn as.
        kind: u32,
        /// Index in its leaf.
        index: u32,
        /// Linear RGB.
        colour: [f32; 3],
        /// The leaf, and in the lowest bits how rays may cross it: see the constants.
        owner: u32,
    }
}

/// Bit of [`SurfelView::owner`]: a ray can enter the leaf here.
pub(super) const MAY_ENTER: u32 = 1;
/// Bit of [`SurfelView::owner`]: a ray can leave the leaf here.
pub(super) const MAY_LEAVE: u32 = 2;
/// How many bits are below the leaf's number.
pub(super) const OWNER_SHIFT: u32 = 2;

/// The picture's chunks, ready to be culled.
#[derive(Debug)]
pub(super) struct Chunks {
    /// By part and chunk; `None` where it cannot be seen.
    parts: Vec<Vec<Option<Seen>>>,
}

/// A chunk's view, and the pixels that it may touch: left, right, top, bottom.
type Seen = (ChunkView, [f64; 4]);

/// `value` as a sum of two.
fn split(value: f64) -> [f32; 2] {
    let high = value as f32;
    [high, (value - f64::from(high)) as f32]
}

impl Chunks {
    /// All chunks of `parts` as `view` sees them.
    pub fn new(model: &Model, parts: &[Part], view: &View) -> Self {
        let of_part = |part: &Part| {
            let mut first = 0;
            let firsts: Vec<u32> = part
                .chunks
                .iter()
                .map(|(leaf, chunk)| {
                    let here = first;
                    first += count(model, *leaf, *chunk);
                    here
                })
                .collect();
            part.chunks
                .par_iter()
                .zip(firsts)
                .map(|(&(leaf, chunk), first)| chunk_view(model, view, (leaf, chunk), first))
                .collect()
        };
        Self { parts: parts.iter().map(of_part).collect() }
    }

    /// By part: the chunks that may come within `margin_px` of `rect`, their views one after the other; and how many views there
    /// are.
    pub fn within(&self, rect: PixelRect, margin_px: f32) -> (Vec<Vec<ChunkView>>, u32) {
        let margin = f64::from(margin_px);
        let (x0, x1) = (f64::from(rect.x0) - margin, f64::from(rect.x1) + margin);
        let (y0, y1) = (f64::from(rect.y0) - margin, f64::from(rect.y1) + margin);
        let touches = |b: &[f64; 4]| b[0] <= x1 && b[1] >= x0 && b[2] <= y1 && b[3] >= y0;
        let mut views = 0;
        let mut of_part = |part: &Vec<Option<Seen>>| {
            let visible = part.iter().flatten().filter(|(_, bounds)| touches(bounds));
            visible
                .map(|(chunk, _)| {
                    let placed = ChunkView { view: views, ..*chunk };
                    views += chunk.count;
                    placed
                })
                .collect()
        };
        let parts = self.parts.iter().map(&mut of_part).collect();
        (parts, views)
    }
}

/// Surfels of one chunk.
fn count(model: &Model, leaf: LeafId, chunk: u32) -> u32 {
    let surfels = model.fields[leaf.0 as usize].cloud.len();
    CHUNK.min(surfels - chunk as usize * CHUNK) as u32
}

fn chunk_view(model: &Model, view: &View, (leaf, number): (LeafId, u32), first: u32) -> Option<Seen> {
    let cloud = &model.fields[leaf.0 as usize].cloud;
    let chunk = &cloud.chunks[number as usize];
    let origin = view.chunk_origin(cloud, number as usize);
    let centre = view.point(chunk.origin + chunk.centre.as_dvec3());
    let ball = f64::from(chunk.extent) + f64::from(chunk.largest_radius);
    let bounds = view.bounds(centre, ball)?;
    // From the origin of the offsets, which need not be the ball's centre.
    let reach = f64::from(chunk.centre.length()) + ball;
    let is_near =
        matches!(view.camera.projection, Projection::Perspective { .. }) && !(origin.z > FAR_IN_RADII * reach);
    let middle = if is_near { glam::DVec2::ZERO } else { view.camera.px_from_view(origin) };
    let [depth, depth_rest] = split(origin.z);
    let [[x, x_rest], [y, y_rest]] = [split(middle.x), split(middle.y)];
    let slope = if is_near { DVec3::ZERO } else { origin / origin.z };
    let chunk_view = ChunkView {
        origin: [origin.x as f32, origin.y as f32, depth],
        depth_rest,
        middle: [x, x_rest, y, y_rest],
        slope: [slope.x as f32, slope.y as f32],
        first,
        count: count(model, leaf, number),
        leaf: leaf.0,
        index: number * CHUNK as u32,
        view: 0,
        is_near: u32::from(is_near),
    };
    Some((chunk_view, [bounds.left, bounds.right, bounds.top, bounds.bottom]))
}

impl SplatView {
    /// Of `camera`, for the pixels `rect`; `origin` is that of what is far.
    pub fn new(camera: &Camera, rect: PixelRect, grid: [u32; 4], origin: DVec3) -> Self {
        let axis = |v: DVec3| [v.x as f32, v.y as f32, v.z as f32, 0.0];
        let (focal_px, is_perspective) = match camera.projection {
            Projection::Perspective { focal_px } => (focal_px, 1),
            Projection::Orthographic { px_per_unit } => (px_per_unit, 0),
        };
        Self {
            axes: [axis(camera.right), axis(camera.down), axis(camera.forward)],
            eye: (camera.eye - origin).as_vec3().to_array(),
            focal_px: focal_px as f32,
            half_size: [0.5 * camera.width as f32, 0.5 * camera.height as f32],
            place: [0.5; 2],
            rect: [rect.x0, rect.y0, rect.x1, rect.y1],
            grid,
            is_perspective,
            ..Self::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_structs_are_the_shaders() {
        crate::gpu::layout::assert_same_layout::<SplatView>();
        crate::gpu::layout::assert_same_layout::<ChunkView>();
        crate::gpu::layout::assert_same_layout::<SurfelView>();
    }

    #[test]
    fn a_number_is_the_sum_of_its_parts() {
        for value in [0.0, 1.0 / 3.0, 1e9 + 0.1, -7.000_000_1] {
            let [high, rest] = split(value);
            assert!((f64::from(high) + f64::from(rest) - value).abs() <= 1e-14 * value.abs());
        }
    }
}
