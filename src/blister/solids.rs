//! Analytic leaves, intersected exactly at every pixel.
//!
//! *Practice.* A solid is asked in its own space, in `f64`, at the pixels of the tile's blocks that its box may cover. Its
//! flat faces that coincide with other leaves' take the shared plane's key ([`planes`](super::planes)), so that they toggle
//! together. A half-space has no other end: whether a ray begins inside cannot be told from the crossings in front of the
//! eye, so it is asked at the ray's origin.

use glam::{DVec2, DVec3, Vec3};

use super::fragments::{BLOCK_HEIGHT, BLOCK_WIDTH, BLOCKS_ACROSS, BLOCKS_DOWN, Fragments, LANES};
use super::model::SolidLeaf;
use super::planes::NO_PLANE;
use super::project::{SUBPIXELS, View, corners};
use super::raster::{Grid, Key};
use crate::geometry::Solid;
use crate::geometry::solid::Hit;
use crate::layers::TILE_SIDE;
use crate::space::{PixelRect, Ray};

/// What a fragment of a solid is.
#[derive(Debug, Clone, Copy)]
pub(super) struct SolidHit {
    /// Unit outward normal, world space.
    pub normal: Vec3,
    /// Whether the surface shows there: a half-space shows only within its square.
    pub is_drawn: bool,
    /// The plane that it shares with another leaf, or [`NO_PLANE`].
    #[cfg_attr(not(feature = "gpu"), expect(dead_code))]
    pub plane: u32,
}

/// A hit's normal is a flat face's if their cosine is larger.
const SAME_FACE: f64 = 1.0 - 1e-9;

impl SolidLeaf {
    /// The pixels that the solid may cover; all of the picture for a half-space, and for what is not all in front of the
    /// eye.
    pub fn covers(&self, view: &View) -> PixelRect {
        let (width, height) = (view.camera.width, view.camera.height);
        let all = PixelRect { x0: 0, y0: 0, x1: width, y1: height };
        let Some((low, high)) = self.solid.bounds() else { return all };
        let (mut least, mut most) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        for corner in corners(low, high) {
            let p_in_view = view.camera.view_from_world(self.world_from_leaf.transform_point3(corner));
            if !(p_in_view.z > 0.0) {
                return all;
            }
            let px = view.camera.px_from_view(p_in_view);
            (least, most) = (least.min(px), most.max(px));
        }
        // Casts saturate.
        let first = |px: f64, side: u32| ((px - 1.0).floor().max(0.0) as u32).min(side);
        let end = |px: f64, side: u32| ((px + 1.0).ceil().max(0.0) as u32).min(side);
        PixelRect {
            x0: first(least.x, width),
            y0: first(least.y, height),
            x1: end(most.x, width),
            y1: end(most.y, height),
        }
    }

    /// Whether a ray may begin inside without leaving.
    pub fn is_endless(&self) -> bool {
        matches!(self.solid, Solid::HalfSpace { .. })
    }

    /// Whether the ray's origin is inside.
    pub fn begins_inside(&self, ray: &Ray) -> bool {
        self.solid.contains(self.leaf_from_world.transform_point3(ray.origin))
    }

    fn is_drawn(&self, p_in_leaf: DVec3) -> bool {
        let Solid::HalfSpace { point, normal, extent } = &self.solid else { return true };
        let (u, v) = normal.normalize_or(DVec3::Z).any_orthonormal_pair();
        let offset = p_in_leaf - *point;
        offset.dot(u).abs() <= *extent && offset.dot(v).abs() <= *extent
    }
}

/// The ray of a tile's pixel, counted from the tile's corner.
pub(super) fn ray(view: &View, grid: &Grid, column: u32, row: u32) -> Ray {
    let sample = DVec2::new(f64::from(grid.sample[0]), f64::from(grid.sample[1])) / f64::from(SUBPIXELS);
    view.camera.ray(sample + DVec2::new(f64::from(column), f64::from(row)))
}

/// Puts all fragments of `leaf` in the tile into `fragments`; `covers` are its pixels, `hits` gathers what they are.
#[allow(clippy::too_many_arguments)]
pub(super) fn draw(
    view: &View,
    planes: &[Key],
    grid: &Grid,
    leaf: &SolidLeaf,
    covers: PixelRect,
    slot: u32,
    hits: &mut Vec<SolidHit>,
    fragments: &mut Fragments,
) {
    let within = |first: u32, end: u32, corner: u32, block: u32, blocks: u32| {
        let first = first.saturating_sub(corner) / block;
        let end = end.saturating_sub(corner).min(TILE_SIDE).div_ceil(block);
        first.min(blocks)..end.min(blocks)
    };
    let mut found: Vec<Hit> = Vec::new();
    for block_y in within(covers.y0, covers.y1, grid.y0, BLOCK_HEIGHT, BLOCKS_DOWN) {
        for block_x in within(covers.x0, covers.x1, grid.x0, BLOCK_WIDTH, BLOCKS_ACROSS) {
            let block = block_y * BLOCKS_ACROSS + block_x;
            // The i-th hits of all pixels go into one layer.
            let mut layers: Vec<([f32; LANES], [u32; LANES], u64)> = Vec::new();
            for lane in 0..LANES {
                let column = block_x * BLOCK_WIDTH + lane as u32 % BLOCK_WIDTH;
                let row = block_y * BLOCK_HEIGHT + lane as u32 / BLOCK_WIDTH;
                let ray = ray(view, grid, column, row);
                let origin = leaf.leaf_from_world.transform_point3(ray.origin);
                let dir = leaf.leaf_from_world.transform_vector3(ray.dir);
                leaf.solid.intersect(origin, dir, &mut found);
                for (number, hit) in found.iter().filter(|hit| hit.t > 0.0).enumerate() {
                    if layers.len() == number {
                        layers.push(([0.0; LANES], [0; LANES], 0));
                    }
                    let (keys, what, bits) = &mut layers[number];
                    let face = leaf.shared.iter().find(|(normal, _)| normal.dot(hit.normal) > SAME_FACE);
                    keys[lane] = match face {
                        Some((_, plane)) => planes[*plane as usize].in_block(grid, block_x, block_y, lane),
                        None => view.key(hit.t) as f32,
                    };
                    what[lane] = hits.len() as u32;
                    *bits |= 1 << lane;
                    let normal = leaf.world_from_normal * hit.normal;
                    hits.push(SolidHit {
                        normal: normal.try_normalize().unwrap_or_else(|| -ray.dir.normalize()).as_vec3(),
                        is_drawn: leaf.is_drawn(origin + dir * hit.t),
                        plane: face.map_or(NO_PLANE, |(_, plane)| *plane),
                    });
                }
            }
            let open = !u64::from(fragments.done(block));
            for (keys, what, bits) in layers {
                for lane in (0..LANES).filter(|lane| (bits & open) >> lane & 1 == 1) {
                    fragments.add_one(block, slot, lane, keys[lane], what[lane]);
                }
            }
        }
    }
}
