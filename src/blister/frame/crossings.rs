//! What the mesh pipeline tells others: every crossing of its leaves and the rays of a tile.
//!
//! *Practice.* The same fragments as for a picture, of all leaves and without an expression: none is left out, since what
//! they mean is for whoever asks. A closed leaf's last crossing leaves it, and from there back each enters and leaves in turn; of
//! an open one a crossing enters where the triangle faces the ray.

use fearless_simd::Simd;
use glam::DVec2;

use super::super::fragments::{ABSENT, BLOCK_HEIGHT, BLOCK_WIDTH, BLOCKS_ACROSS, BLOCKS_DOWN, LANES};
use super::super::model::SolidLeaf;
use super::super::project;
use super::super::raster::{Grid, Offsets};
use super::super::solids;
use super::super::survivors::{SlotLook, Survivor};
use super::super::write::Writer;
use super::{MeshFrame, Pass, SUBPIXELS, Scratch, pixel_of};
use crate::crossings::{Crossing, CrossingSource, CrossingTile, PixelBits};
use crate::csg::LeafId;
use crate::geometry::exact::least_stretch;
use crate::layers::TILE_SIDE;
use crate::space::PixelRect;

/// Solids are looked for in squares of this many pixels a side, a multiple of a block's sides.
const PART: u32 = 16;

fn overlap(a: PixelRect, b: PixelRect) -> PixelRect {
    PixelRect { x0: a.x0.max(b.x0), y0: a.y0.max(b.y0), x1: a.x1.min(b.x1), y1: a.y1.min(b.y1) }
}

impl MeshFrame<'_> {
    /// Whether any ray through `rect` may meet a solid: `false` is certain.
    ///
    /// The rays are within a cone around the middle one. Along that it goes as far as the solid's distance less the cone's
    /// radius allows, until it is behind the solid or too close to tell.
    fn may_meet(&self, solid: &SolidLeaf, rect: PixelRect) -> bool {
        /// A cone that is not clear of the solid after so many steps passes it closely.
        const MOST_STEPS: u32 = 24;
        /// A step below this share of the depth is too short to get anywhere.
        const LEAST_STEP: f64 = 1e-3;
        let Some((low, high)) = solid.solid.bounds() else { return true };
        let corner = |x: u32, y: u32| self.view.camera.ray(DVec2::new(f64::from(x), f64::from(y)));
        let middle = self
            .view
            .camera
            .ray(0.5 * DVec2::new(f64::from(rect.x0) + f64::from(rect.x1), f64::from(rect.y0) + f64::from(rect.y1)));
        let corners =
            [(rect.x0, rect.y0), (rect.x1, rect.y0), (rect.x0, rect.y1), (rect.x1, rect.y1)].map(|(x, y)| corner(x, y));
        // The radius grows evenly with depth, from what it is at the origin.
        let radius_at = |t: f64| corners.iter().map(|ray| ray.at(t).distance(middle.at(t))).fold(0.0, f64::max);
        let (at_origin, growth) = (radius_at(0.0), radius_at(1.0) - radius_at(0.0));
        let speed = middle.dir.length();
        let stretch = least_stretch(solid.leaf_from_world.matrix3);
        let last = project::corners(low, high)
            .map(|p| self.view.camera.view_from_world(solid.world_from_leaf.transform_point3(p)).z)
            .into_iter()
            .fold(f64::NEG_INFINITY, f64::max);
        let mut t = 0.0;
        for _ in 0..MOST_STEPS {
            if t > last {
                return false;
            }
            let p = solid.leaf_from_world.transform_point3(middle.at(t));
            // Written so that NaN may meet.
            let clear = solid.solid.signed_distance_bound(p).abs() * stretch - (at_origin + growth * t);
            let step = clear / (speed + growth);
            if !(step > LEAST_STEP * last) {
                return true;
            }
            t += step;
        }
        true
    }

    /// Appends the crossings of the pixels `wanted` of one tile, at `offset` within the pixels.
    #[inline(always)]
    fn cross_tile<S: Simd>(
        &self,
        simd: S,
        (column, row): (u32, u32),
        rect: PixelRect,
        offset: DVec2,
        scratch: &mut Scratch,
        placed: &mut Vec<(u32, Crossing)>,
    ) {
        let (x0, y0) = (column * TILE_SIDE, row * TILE_SIDE);
        let shift = (offset * f64::from(SUBPIXELS)).round();
        let grid =
            Grid { x0, y0, sample: [x0 as i32 * SUBPIXELS + shift.x as i32, y0 as i32 * SUBPIXELS + shift.y as i32] };
        let pass = Pass { frame: self, grid, offset: shift / f64::from(SUBPIXELS) };
        scratch.planes.clear();
        scratch.planes.extend(self.planes.iter().map(|key| pass.at_samples(*key)));
        scratch.fragments.clear();
        scratch.hits.clear();
        let offsets = Offsets::new(simd);
        for entry in self.bins.of(column, row) {
            let leaf = self.model.meshlets[entry.meshlet as usize].leaf;
            pass.meshlet(simd, &offsets, entry, leaf.0, &scratch.planes, &mut scratch.fragments);
        }
        for (solid, covers) in self.model.solids.iter().zip(&self.covers) {
            let tile = PixelRect { x0, y0, x1: x0 + TILE_SIDE, y1: y0 + TILE_SIDE };
            let within = overlap(tile, overlap(*covers, rect));
            if within.x0 >= within.x1 || within.y0 >= within.y1 || !self.may_meet(solid, within) {
                continue;
            }
            for (y, x) in (0..TILE_SIDE)
                .step_by(PART as usize)
                .flat_map(|y| (0..TILE_SIDE).step_by(PART as usize).map(move |x| (y, x)))
            {
                let part = overlap(PixelRect { x0: x0 + x, y0: y0 + y, x1: x0 + x + PART, y1: y0 + y + PART }, within);
                if part.x0 < part.x1 && part.y0 < part.y1 && self.may_meet(solid, part) {
                    let (hits, fragments) = (&mut scratch.hits, &mut scratch.fragments);
                    solids::draw(&self.view, &scratch.planes, &grid, solid, part, solid.leaf.0, hits, fragments);
                }
            }
        }
        for block in 0..BLOCKS_ACROSS * BLOCKS_DOWN {
            scratch.fragments.layers_of(block, &mut scratch.layers);
            let corner = (x0 + block % BLOCKS_ACROSS * BLOCK_WIDTH, y0 + block / BLOCKS_ACROSS * BLOCK_HEIGHT);
            for &layer in &scratch.layers {
                let layer = scratch.fragments.layer(layer);
                let leaf = LeafId(layer.slot);
                let is_solid = self.model.solid_of(leaf).is_some();
                for lane in 0..LANES {
                    let (key, what) = (layer.keys[lane], scratch.fragments.what(layer, lane));
                    let (x, y) = pixel_of(lane);
                    let (x, y) = (corner.0 + x, corner.1 + y);
                    let is_wanted = (rect.x0..rect.x1).contains(&x) && (rect.y0..rect.y1).contains(&y);
                    if key == ABSENT || !is_wanted {
                        continue;
                    }
                    let (normal, is_drawn) = if is_solid {
                        let hit = &scratch.hits[what as usize];
                        (hit.normal, hit.is_drawn)
                    } else {
                        (self.model.surfaces[what as usize].normal, true)
                    };
                    let pixel = (y - rect.y0) * rect.width() + (x - rect.x0);
                    // Which way a crossing goes is told once all of its ray's are known.
                    let depth = self.view.depth(key);
                    placed.push((pixel, Crossing { depth, leaf, enters: false, normal, is_drawn, what }));
                }
            }
        }
    }

    #[inline(always)]
    fn cross_with<S: Simd>(&self, simd: S, rect: PixelRect, offset: DVec2, scratch: &mut Scratch) -> CrossingTile {
        let mut placed = Vec::new();
        for row in rect.y0 / TILE_SIDE..=(rect.y1 - 1) / TILE_SIDE {
            for column in rect.x0 / TILE_SIDE..=(rect.x1 - 1) / TILE_SIDE {
                self.cross_tile(simd, (column, row), rect, offset, scratch, &mut placed);
            }
        }
        let mut tile = CrossingTile::from_placed(rect.width(), rect.area(), &placed);
        self.tell_directions(rect, offset, &mut tile);
        tile
    }

    /// Tells of every crossing whether it enters its leaf, and of every ray which leaves it begins inside of.
    fn tell_directions(&self, rect: PixelRect, offset: DVec2, tile: &mut CrossingTile) {
        let area = rect.area();
        let ray_of = |pixel: usize| {
            let (x, y) = (pixel as u32 % rect.width(), pixel as u32 / rect.width());
            self.view.camera.ray(DVec2::new(f64::from(rect.x0 + x), f64::from(rect.y0 + y)) + offset)
        };
        let mut begins: Vec<Option<PixelBits>> = vec![None; self.model.looks.len()];
        let mut begin = |leaf: LeafId, pixel: usize| {
            begins[leaf.0 as usize].get_or_insert_with(|| PixelBits::new(area)).set(pixel);
        };
        let mut inside = vec![false; self.model.looks.len()];
        for pixel in 0..area {
            let range = tile.offsets[pixel] as usize..tile.offsets[pixel + 1] as usize;
            let crossings = &mut tile.crossings[range];
            // From the last one back: behind all crossings a ray is outside of every leaf that ends.
            for crossing in crossings.iter_mut().rev() {
                let leaf = crossing.leaf;
                let (look, solid) = (self.model.look(leaf), self.model.solid_of(leaf));
                if look.closed_within.is_some() || solid.is_some_and(|solid| !solid.is_endless()) {
                    let inside = &mut inside[leaf.0 as usize];
                    crossing.enters = *inside;
                    *inside = !*inside;
                } else {
                    let is_against = crossing.normal.dot(ray_of(pixel).dir.as_vec3()) < 0.0;
                    // Normals of solids are outward however they are placed.
                    crossing.enters = is_against != (look.is_mirrored && solid.is_none());
                }
            }
            for crossing in crossings {
                if std::mem::take(&mut inside[crossing.leaf.0 as usize]) {
                    begin(crossing.leaf, pixel);
                }
            }
        }
        for solid in self.model.solids.iter().filter(|solid| solid.is_endless()) {
            // All rays of a perspective view begin at the eye.
            let at_eye = self.view.is_perspective.then(|| solid.begins_inside(&ray_of(0)));
            let inside = |pixel: usize| at_eye.unwrap_or_else(|| solid.begins_inside(&ray_of(pixel)));
            for pixel in (0..area).filter(|&pixel| inside(pixel)) {
                begin(solid.leaf, pixel);
            }
        }
        let by_leaf = begins.into_iter().enumerate();
        tile.begins = by_leaf.filter_map(|(leaf, bits)| Some((LeafId(leaf as u32), bits?))).collect();
    }
}

impl CrossingSource for MeshFrame<'_> {
    fn leaves(&self) -> Vec<LeafId> {
        self.model.flat.leaves().to_vec()
    }

    fn crossings(&self, rect: PixelRect, offset: DVec2) -> CrossingTile {
        let spare = || self.spare.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        let mut scratch = spare().pop().unwrap_or_default();
        let tile = self.cross_into(rect, offset, &mut scratch);
        spare().push(scratch);
        tile
    }

    fn paint(&self, crossing: &Crossing, px: DVec2) -> ([f32; 3], f32) {
        let look = *self.model.look(crossing.leaf);
        let is_solid = self.model.solid_of(crossing.leaf).is_some();
        if is_solid || !look.vertex_colours {
            return (look.colour, look.opacity);
        }
        let corner = px.floor();
        let looks = [SlotLook { leaf: crossing.leaf, look, is_solid, stops: false }];
        let writer =
            Writer { model: self.model, view: &self.view, looks: &looks, hits: &[], offset: px - corner, samples: 1 };
        let key = self.view.key(f64::from(crossing.depth)) as f32;
        let survivor = Survivor { key, what: crossing.what, owner: 0, body: 0, is_front: true };
        let dir = self.view.camera.ray(px).dir.as_vec3();
        (writer.boundary(&survivor, dir, corner.x as u32, corner.y as u32).colour, look.opacity)
    }
}

impl MeshFrame<'_> {
    fn cross_into(&self, rect: PixelRect, offset: DVec2, scratch: &mut Scratch) -> CrossingTile {
        #[cfg(target_arch = "x86_64")]
        {
            // Two sets of instructions, as for pictures.
            if let Some(avx2) = self.level.as_avx2() {
                return avx2.vectorize(
                    #[inline(always)]
                    || self.cross_with(avx2, rect, offset, scratch),
                );
            }
            let sse2 = self.level.as_sse2().expect("every x86-64 processor has SSE2");
            sse2.vectorize(
                #[inline(always)]
                || self.cross_with(sse2, rect, offset, scratch),
            )
        }
        #[cfg(not(target_arch = "x86_64"))]
        fearless_simd::dispatch!(self.level, simd => self.cross_with(simd, rect, offset, scratch))
    }
}
