//! The layers of a strip of the picture as an edge detector sees them: every boundary with the slope of its tangent plane.
//!
//! *Practice.* A detector goes through a tile row by row and looks at two rows at a time, so there are never more than two
//! [`FacetRow`]s of a tile: they stay in the cache. What it asks of other pixels now and then is made of their boundaries anew.

use std::ops::Range;

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x8};
use glam::Vec3;

use crate::layers::{Boundary, Facing, LayerTile, TILE_SIDE, sample_offsets};
use crate::space::{Camera, Projection};

/// A surface seen at a grazing angle steps by at most so many footprints a pixel: its true slope has no limit, and what it
/// predicts beyond this is worth nothing.
pub(crate) const STEEPEST: f32 = 50.0;

/// Facets that are compared at once.
const LANES: usize = 8;
// What becomes of them is a bit for each in a byte.
const _: () = assert!(LANES == u8::BITS as usize);

/// A boundary at one pixel.
#[derive(Debug, Clone, Copy)]
pub(super) struct Facet {
    /// Planar view depth, world units.
    pub depth: f32,
    /// Pixels to a world unit at that depth.
    pub px_per_unit: f32,
    /// How many footprints deeper the tangent plane is one pixel to the right, and one pixel down.
    pub step: [f32; 2],
    /// Outward unit normal of the result, world space.
    pub normal: Vec3,
    /// The result's.
    pub facing: Facing,
    /// Whose surface.
    pub leaf: u32,
}

impl Facet {
    /// How many footprints deeper `other` is.
    #[inline]
    pub fn deeper(&self, other: &Self) -> f32 {
        (other.depth - self.depth) * self.px_per_unit
    }
}

/// The facets of a row of a tile's pixels and of the next tile's first, pixel by pixel and front to back, one sample's alone; an
/// array for each of their values, so that many are compared at once. Its buffers are kept from row to row and only grow: what is
/// behind the row's facets means nothing.
#[derive(Debug, Default)]
pub(super) struct FacetRow {
    /// By pixel and one more: where its facets begin.
    pub offsets: Vec<u32>,
    /// How many there are.
    count: usize,
    /// By facet: the column of its pixel, from the tile's first.
    pub columns: Vec<i32>,
    depth: Vec<f32>,
    px_per_unit: Vec<f32>,
    step: [Vec<f32>; 2],
    normal: [Vec<f32>; 3],
    /// ±1, as [`Facing`].
    facing: Vec<f32>,
    leaf: Vec<u32>,
    /// What the one sample sees, where a pixel has several.
    seen: Vec<Boundary>,
}

impl FacetRow {
    /// Facet number `i`.
    pub fn get(&self, i: usize) -> Facet {
        Facet {
            depth: self.depth[i],
            px_per_unit: self.px_per_unit[i],
            step: [self.step[0][i], self.step[1][i]],
            normal: Vec3::new(self.normal[0][i], self.normal[1][i], self.normal[2][i]),
            facing: if self.facing[i] > 0.0 { Facing::Front } else { Facing::Back },
            leaf: self.leaf[i],
        }
    }

    /// Becomes row number `row` of tile `index` of `strip`, with the first pixel of the tile beside it, if there is one.
    #[inline(always)]
    pub fn fill(&mut self, strip: &FacetStrip, index: usize, row: u32) {
        let tile = strip.tile(index);
        let beside = (tile.rect.x1 < strip.width).then(|| strip.tile(index + 1));
        let across = tile.rect.width() as usize;
        let first = row as usize * across;
        let offsets = &tile.offsets[first..=first + across];
        let beside = beside.map(|tile| tile.at(tile.rect.x0, tile.rect.y0 + row));
        let own = &tile.boundaries[offsets[0] as usize..offsets[across] as usize];
        self.offsets.clear();
        if strip.samples <= 1 {
            self.offsets.extend(offsets.iter().map(|offset| offset - offsets[0]));
            self.offsets.extend(beside.map(|beside| (own.len() + beside.len()) as u32));
            self.gather(own, beside.unwrap_or_default());
        } else {
            let mut seen = std::mem::take(&mut self.seen);
            seen.clear();
            self.offsets.push(0);
            let pixels = offsets.windows(2).map(|w| &tile.boundaries[w[0] as usize..w[1] as usize]);
            for of_pixel in pixels.chain(beside) {
                seen.extend(of_pixel.iter().filter(|boundary| strip.is_seen(boundary)));
                self.offsets.push(seen.len() as u32);
            }
            self.gather(&seen, &[]);
            self.seen = seen;
        }
        self.slope(&strip.slopes, tile.rect.x0, tile.rect.y0 + row);
    }

    /// Takes over what the boundaries `own` and `beside` say.
    #[inline(always)]
    fn gather(&mut self, own: &[Boundary], beside: &[Boundary]) {
        self.count = own.len() + beside.len();
        if self.columns.len() < self.count + LANES {
            self.grow();
        }
        self.take(0, own);
        self.take(own.len(), beside);
        let columns = &mut self.columns[..self.count + LANES];
        for (of_pixel, column) in self.offsets.windows(2).zip(0..) {
            let (from, to) = (of_pixel[0] as usize, of_pixel[1] as usize);
            // Nearly all pixels have fewer than this; what is too much is the next pixel's.
            if let Some(lanes) = columns[from..].first_chunk_mut::<LANES>() {
                *lanes = [column; LANES];
            }
            if to > from + LANES {
                columns[from + LANES..to].fill(column);
            }
        }
    }

    /// Makes room for as many facets as there are, and some more.
    #[cold]
    fn grow(&mut self) {
        let room = (self.count + LANES).next_power_of_two();
        self.columns.resize(room, 0);
        self.leaf.resize(room, 0);
        let arrays = [&mut self.depth, &mut self.px_per_unit, &mut self.facing];
        arrays.into_iter().chain(&mut self.step).chain(&mut self.normal).for_each(|array| array.resize(room, 0.0));
    }

    /// Takes over what `boundaries` say, from number `first` on.
    #[inline(always)]
    fn take(&mut self, first: usize, boundaries: &[Boundary]) {
        // Slices of one known length: no write asks where its array ends.
        let (count, all) = (boundaries.len(), first..first + boundaries.len());
        let (depth, facing) = (&mut self.depth[all.clone()][..count], &mut self.facing[all.clone()][..count]);
        let [x, y, z] = &mut self.normal;
        let (x, y, z) = (&mut x[all.clone()][..count], &mut y[all.clone()][..count], &mut z[all.clone()][..count]);
        let leaf = &mut self.leaf[all][..count];
        for (i, boundary) in boundaries.iter().enumerate() {
            depth[i] = boundary.depth;
            [x[i], y[i], z[i]] = boundary.normal.to_array();
            facing[i] = f32::from(boundary.facing as i8);
            leaf[i] = boundary.leaf;
        }
    }

    /// Finds the slopes at pixels of row `y` of the picture, the first of them at column `x0`.
    #[inline(always)]
    fn slope(&mut self, slopes: &Slopes, x0: u32, y: u32) {
        let count = self.count;
        let v = slopes.down_of(y as f32);
        let (depth, columns, px_per_unit) =
            (&self.depth[..count], &self.columns[..count], &mut self.px_per_unit[..count]);
        let [right, down] = &mut self.step;
        let (right, down) = (&mut right[..count], &mut down[..count]);
        let [n_x, n_y, n_z] = [0, 1, 2].map(|k| &self.normal[k][..count]);
        for i in 0..count {
            let u = slopes.right_of((x0 as i32 + columns[i]) as f32);
            let towards = slopes.forward + slopes.right * u + slopes.down * v;
            [right[i], down[i]] = slopes.step_along(Vec3::new(n_x[i], n_y[i], n_z[i]), towards);
            px_per_unit[i] = slopes.px_per_unit(depth[i]);
        }
    }

    /// Learns into `fates` what becomes of each of the facets `a` of `self` in the facet of `others` that has its place in those
    /// from `b` on. Whether all go on.
    #[inline(always)]
    pub fn compare<S: Simd>(
        &self,
        simd: S,
        a: Range<usize>,
        (others, b): (&Self, usize),
        axis: usize,
        limits: &Limits,
        fates: &mut Fates,
    ) -> bool {
        let count = a.len();
        let groups = count.div_ceil(LANES);
        fates.groups.resize(groups, [0; 2]);
        let mut all_go_on = true;
        for (group, fates) in fates.groups.iter_mut().enumerate() {
            let (i, j) = (a.start + group * LANES, b + group * LANES);
            let mine = |of: &[f32]| f32x8::from_slice(simd, &of[i..i + LANES]);
            let theirs = |of: &[f32]| f32x8::from_slice(simd, &of[j..j + LANES]);
            let deeper = (theirs(&others.depth) - mine(&self.depth)) * mine(&self.px_per_unit);
            let (step_a, step_b) = (mine(&self.step[axis]), theirs(&others.step[axis]));
            let amiss = (deeper - step_a).abs().min((deeper - step_b).abs());
            let allowed = step_a.abs().min(step_b.abs()) * limits.curved_share + limits.jump_px;
            let goes_on = amiss.simd_le(allowed) & mine(&self.facing).simd_eq(theirs(&others.facing));
            let x = mine(&self.normal[0]) * theirs(&others.normal[0]);
            let y = mine(&self.normal[1]) * theirs(&others.normal[1]);
            let z = mine(&self.normal[2]) * theirs(&others.normal[2]);
            let is_turned_little = (x + y + z).simd_ge(limits.least_cos);
            // What lies behind the last facet has no fate.
            let asked = u8::MAX >> (LANES - (count - group * LANES).min(LANES));
            let goes_on = goes_on.to_bitmask() as u8;
            *fates = [!goes_on & asked, goes_on & !(is_turned_little.to_bitmask() as u8) & asked];
            all_go_on &= *fates == [0; 2];
        }
        all_go_on
    }
}

/// What becomes of surfaces between two pixels, as [`Limits`] say, one by one. A surface goes on where it faces the same way and is
/// near the tangent planes.
#[derive(Debug, Default)]
pub(super) struct Fates {
    /// A bit for each of eight: whether the other pixel has something else in its place; whether it goes on, but its normal is far
    /// from what it was.
    groups: Vec<[u8; 2]>,
}

impl Fates {
    /// The first from number `from` on that does not simply go on.
    pub fn first_from(&self, from: usize) -> Option<usize> {
        let mut known = u8::MAX << (from % LANES);
        for (group, [ends, turns]) in self.groups.iter().enumerate().skip(from / LANES) {
            let found = (ends | turns) & known;
            if found != 0 {
                return Some(group * LANES + found.trailing_zeros() as usize);
            }
            known = u8::MAX;
        }
        None
    }

    /// Whether the other pixel has something else in the place of number `i`.
    pub fn ends(&self, i: usize) -> bool {
        self.groups[i / LANES][0] >> (i % LANES) & 1 == 1
    }

    /// Whether number `i` goes on, but its normal is far from what it was.
    pub fn turns(&self, i: usize) -> bool {
        self.groups[i / LANES][1] >> (i % LANES) & 1 == 1
    }
}

/// When a surface goes on.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limits {
    /// Footprints that it may be off the tangent planes.
    pub jump_px: f32,
    /// Of the steps that the two tangent planes foresee, so much may be amiss too: what a curved surface does between two
    /// pixels.
    pub curved_share: f32,
    /// Least cosine between two normals.
    pub least_cos: f32,
}

impl Limits {
    /// Whether a surface goes on in a pixel where one is `deeper` by so many footprints, of the steps that each foresees.
    #[inline(always)]
    pub fn goes_on(&self, deeper: f32, step_a: f32, step_b: f32) -> bool {
        let amiss = (deeper - step_a).abs().min((deeper - step_b).abs());
        amiss <= self.jump_px + self.curved_share * step_a.abs().min(step_b.abs())
    }
}

/// Some rows of tiles, and what their boundaries are as facets.
#[derive(Debug)]
pub(super) struct FacetStrip<'a> {
    /// Tiles side by side.
    pub across: usize,
    /// First row of pixels.
    pub y0: u32,
    /// One past the last row.
    pub y1: u32,
    /// Pixels side by side.
    pub width: u32,
    tiles: &'a [LayerTile],
    slopes: Slopes,
    samples: u32,
    /// The one that counts.
    sample: u32,
}

impl<'a> FacetStrip<'a> {
    /// From `tiles`, row by row; at least one.
    pub fn new(tiles: &'a [LayerTile], camera: &Camera, samples: u32) -> Self {
        Self {
            across: camera.width.div_ceil(TILE_SIDE) as usize,
            y0: tiles[0].rect.y0,
            y1: tiles[tiles.len() - 1].rect.y1,
            width: camera.width,
            tiles,
            slopes: Slopes::new(camera),
            samples,
            sample: central_sample(samples),
        }
    }

    /// Tile `index`.
    pub fn tile(&self, index: usize) -> &'a LayerTile {
        &self.tiles[index]
    }

    /// The facets of a pixel that face as `facing`, front to back; `None` outside of the strip.
    pub fn at(&self, x: u32, y: u32, facing: Facing) -> Option<impl Iterator<Item = Facet>> {
        if x >= self.width || y < self.y0 || y >= self.y1 {
            return None;
        }
        let index = ((y - self.y0) / TILE_SIDE) as usize * self.across + (x / TILE_SIDE) as usize;
        let is_asked = move |b: &&Boundary| self.is_seen(b) && facing == b.facing;
        let asked = self.tiles[index].at(x, y).iter().filter(is_asked);
        Some(asked.map(move |boundary| self.slopes.facet(boundary, x, y)))
    }

    #[inline(always)]
    fn is_seen(&self, boundary: &Boundary) -> bool {
        self.samples <= 1 || boundary.samples >> self.sample & 1 == 1
    }
}

/// The sample nearest to a pixel's middle: lines are found in what it sees.
pub(crate) fn central_sample(samples: u32) -> u32 {
    let from_middle = |i: &u32| (sample_offsets(samples)[*i as usize] - 0.5).length_squared();
    (0..samples.max(1)).min_by(|a, b| from_middle(a).total_cmp(&from_middle(b))).unwrap_or(0)
}

/// What a camera makes of normals.
#[derive(Debug)]
pub(super) struct Slopes {
    right: Vec3,
    down: Vec3,
    forward: Vec3,
    middle: [f32; 2],
    /// Perspective: tangent of a pixel. Orthographic: 0.
    tangent: f32,
    /// Perspective: pixels to a unit at depth 1. Orthographic: at any depth.
    focal: f32,
    perspective: bool,
}

impl Slopes {
    /// As `camera` sees them.
    pub fn new(camera: &Camera) -> Self {
        let (tangent, focal, perspective) = match camera.projection {
            Projection::Perspective { focal_px } => ((1.0 / focal_px) as f32, focal_px as f32, true),
            Projection::Orthographic { px_per_unit } => (0.0, px_per_unit as f32, false),
        };
        Self {
            right: camera.right.as_vec3(),
            down: camera.down.as_vec3(),
            forward: camera.forward.as_vec3(),
            middle: [0.5 * camera.width as f32 - 0.5, 0.5 * camera.height as f32 - 0.5],
            tangent,
            focal,
            perspective,
        }
    }

    /// How many footprints deeper the tangent plane with `normal` is one pixel to the right of pixel (`x`, `y`), and one down.
    pub fn step(&self, normal: Vec3, x: u32, y: u32) -> [f32; 2] {
        let (u, v) = (self.right_of(x as f32), self.down_of(y as f32));
        self.step_along(normal, self.forward + self.right * u + self.down * v)
    }

    /// How far to the right of the middle the ray through column `x` is, one unit forward.
    #[inline(always)]
    fn right_of(&self, x: f32) -> f32 {
        (x - self.middle[0]) * self.tangent
    }

    /// The same downwards, for row `y`.
    #[inline(always)]
    fn down_of(&self, y: f32) -> f32 {
        (y - self.middle[1]) * self.tangent
    }

    /// The same where the ray goes `towards`, one unit forward.
    #[inline(always)]
    fn step_along(&self, normal: Vec3, towards: Vec3) -> [f32; 2] {
        // The plane through z·d with normal n holds z'·d' where z' (n·d') = z (n·d), and d' = d + right/f.
        let along = normal.dot(towards);
        // (x / (x² + e²) is at most 1 / 2e.)
        let per_along = -along / (along * along + 0.25 / (STEEPEST * STEEPEST));
        [normal.dot(self.right) * per_along, normal.dot(self.down) * per_along]
    }

    /// Pixels to a world unit at `depth`.
    #[inline(always)]
    pub fn px_per_unit(&self, depth: f32) -> f32 {
        if self.perspective { self.focal / depth } else { self.focal }
    }

    fn facet(&self, boundary: &Boundary, x: u32, y: u32) -> Facet {
        Facet {
            depth: boundary.depth,
            px_per_unit: self.px_per_unit(boundary.depth),
            step: self.step(boundary.normal, x, y),
            normal: boundary.normal,
            facing: boundary.facing,
            leaf: boundary.leaf,
        }
    }
}
