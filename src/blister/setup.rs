//! Triangles made ready to be drawn, eight at a time, and those of a few pixels drawn.
//!
//! *Theory.* As in [`raster`](super::raster), with lanes that are triangles instead of pixels. A triangle whose box holds at
//! most two samples each way has at most four to be asked for. The others are handed on with their edges and their key over
//! the picture.
//!
//! *Practice.* Scans at picture size are made of small triangles, and half of those hold no sample. They cost a share of a
//! few dozen vector instructions here; keys are computed where any triangle of the eight needs one. Vertices are kept whole
//! and turned into lanes as vectors: lanes that are stored one by one must all have arrived before they can be loaded. Edge
//! functions of a triangle no wider than [`SMALL`] fit 32 bits over the tile, wherever it touches that; larger ones are handed
//! back.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x8, i32x8};
use glam::DVec2;

use super::fragments::{BLOCK_HEIGHT, BLOCK_WIDTH, BLOCKS_ACROSS, Fragments, LANES};
use super::model::Surface;
use super::planes::NO_PLANE;
use super::project::{Affine, Affines, Snapped, View};
use super::raster::{Edge, Grid, Key, SMALL};
use crate::layers::TILE_SIDE;

/// Up to eight triangles.
#[derive(Debug, Default)]
pub(super) struct Batch {
    pub len: usize,
    /// The triangles' numbers.
    pub numbers: [u32; LANES],
    /// By corner: each triangle's.
    corners: [[Snapped; LANES]; 3],
}

/// What is known of a batch's triangles.
pub(super) struct Ready {
    /// Bit i is set where triangle i is larger than [`SMALL`]: nothing more is known of it.
    pub large: u32,
    /// The others that may have samples beyond the four that were asked for.
    pub medium: u32,
    /// For each of four samples (left and right of the first row, then of the second): the small triangles that cover it.
    covered: [u32; 4],
    /// The samples in each one's box, relative to the tile: first and last column and row.
    columns: [[i32; LANES]; 2],
    rows: [[i32; LANES]; 2],
    /// By edge: `c`, `dx` and `dy` of each one's [`Edge`].
    edges: [[[i32; LANES]; 3]; 3],
    /// The range of the corners' keys.
    low: [f32; LANES],
    high: [f32; LANES],
}

/// The keys over a batch's triangles.
pub(super) struct Keys {
    own: Affines,
    /// Shared planes.
    planes: [u32; LANES],
}

impl Batch {
    #[inline(always)]
    pub fn push(&mut self, number: u32, [a, b, c]: [&Snapped; 3]) {
        let lane = self.len;
        self.len += 1;
        self.numbers[lane] = number;
        for (corners, v) in self.corners.iter_mut().zip([a, b, c]) {
            corners[lane] = *v;
        }
    }

    /// The numbers of one corner of each triangle, those of a [`Snapped`].
    #[inline(always)]
    fn corner<S: Simd>(&self, simd: S, corner: usize) -> [i32x8<S>; 4] {
        let (left, right) = self.corners[corner].split_at(LANES / 2);
        let of_half = |half: &[Snapped]| {
            let numbers = half.as_flattened().try_into().expect("half of the lanes, four numbers each");
            simd.load_four_interleaved_i32x4(numbers)
        };
        let (left, right) = (of_half(left), of_half(right));
        [left[0].combine(right[0]), left[1].combine(right[1]), left[2].combine(right[2]), left[3].combine(right[3])]
    }

    /// Finds what the triangles cover.
    #[inline(always)]
    pub fn ready<S: Simd>(&self, simd: S, grid: &Grid) -> Ready {
        let ([ax, ay, a_key, _], [bx, by, b_key, _], [cx, cy, c_key, _]) =
            (self.corner(simd, 0), self.corner(simd, 1), self.corner(simd, 2));
        let (ax, bx, cx) = (ax - grid.sample[0], bx - grid.sample[0], cx - grid.sample[0]);
        let (ay, by, cy) = (ay - grid.sample[1], by - grid.sample[1], cy - grid.sample[1]);
        let [a_key, b_key, c_key] = [a_key, b_key, c_key].map(|bits| bits.bitcast::<f32x8<S>>());
        let last = TILE_SIDE as i32 - 1;
        let (low_x, high_x) = (ax.min(bx).min(cx), ax.max(bx).max(cx));
        let (low_y, high_y) = (ay.min(by).min(cy), ay.max(by).max(cy));
        // The samples inside the box and the tile.
        let (x0, y0) = (((low_x + 255) >> 8).max(0), ((low_y + 255) >> 8).max(0));
        let (x1, y1) = ((high_x >> 8).min(last), (high_y >> 8).min(last));
        let lanes = (1_u32 << self.len) - 1;
        let holds = (x1.simd_ge(x0) & y1.simd_ge(y0)).to_bitmask() as u32 & lanes;
        let large = (high_x - low_x).max(high_y - low_y).simd_gt(SMALL).to_bitmask() as u32 & holds;

        let area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay);
        let is_turned = area.simd_lt(0);
        let rest = holds & !large & area.simd_ne(0).to_bitmask() as u32;
        let zero = i32x8::splat(simd, 0);
        let one = i32x8::splat(simd, 1);
        // Of a triangle that is turned the second and third corner change places.
        let (bx, cx) = (is_turned.select(cx, bx), is_turned.select(bx, cx));
        let (by, cy) = (is_turned.select(cy, by), is_turned.select(by, cy));
        let mut edges = [[[0; LANES]; 3]; 3];
        let (mut e00, mut e10, mut e01, mut e11) = (zero, zero, zero, zero);
        for (edge, (x, y, to_x, to_y)) in edges.iter_mut().zip([(ax, ay, bx, by), (bx, by, cx, cy), (cx, cy, ax, ay)]) {
            let (dx, dy) = (to_x - x, to_y - y);
            let owns_zero = dy.simd_lt(0) | (dy.simd_eq(0) & dx.simd_gt(0));
            let c = (dy * x - dx * y - owns_zero.select(zero, one)) >> 8;
            let e = c + dx * y0 - dy * x0;
            // A sample is covered where no edge function is negative: where none has its highest bit.
            e00 |= e;
            e10 |= e - dy;
            e01 |= e + dx;
            e11 |= e - dy + dx;
            *edge = [c.into(), dx.into(), dy.into()];
        }
        let medium = (x1 - x0).max(y1 - y0).simd_gt(1).to_bitmask() as u32 & rest;
        let small = rest & !medium;
        let has_right = x1.simd_gt(x0).to_bitmask() as u32 & small;
        let has_down = y1.simd_gt(y0).to_bitmask() as u32 & small;
        Ready {
            large,
            medium,
            covered: [
                e00.simd_ge(0).to_bitmask() as u32 & small,
                e10.simd_ge(0).to_bitmask() as u32 & has_right,
                e01.simd_ge(0).to_bitmask() as u32 & has_down,
                e11.simd_ge(0).to_bitmask() as u32 & has_right & has_down,
            ],
            columns: [x0.into(), x1.into()],
            rows: [y0.into(), y1.into()],
            edges,
            low: a_key.min(b_key).min(c_key).into(),
            high: a_key.max(b_key).max(c_key).into(),
        }
    }

    /// The keys over the triangles of `lanes`, at samples that lie at `offset` in their pixels. `surfaces` are all triangles'.
    #[inline(always)]
    pub fn keys(&self, lanes: u32, surfaces: &[Surface], view: &View, offset: DVec2) -> Keys {
        let mut normals = [[0.0; LANES]; 3];
        let mut offsets = [0.0; LANES];
        let mut planes = [NO_PLANE; LANES];
        let mut rest = lanes;
        while rest != 0 {
            let lane = rest.trailing_zeros() as usize;
            rest &= rest - 1;
            let surface = &surfaces[self.numbers[lane] as usize];
            for (axis, normals) in normals.iter_mut().enumerate() {
                normals[lane] = f64::from(surface.normal[axis]);
            }
            offsets[lane] = surface.offset;
            planes[lane] = surface.plane;
        }
        Keys { own: view.keys_over(&normals, &offsets).counted_from(offset), planes }
    }
}

impl Keys {
    /// The key over triangle `lane`, its own or that of a shared plane.
    #[inline(always)]
    pub fn of(&self, lane: usize, ready: &Ready, planes: &[Key]) -> Key {
        if self.planes[lane] == NO_PLANE {
            held(self.own.get(lane), ready.low[lane], ready.high[lane])
        } else {
            planes[self.planes[lane] as usize]
        }
    }
}

/// A triangle's own key, held to its corners' range. One that is seen edge on has no plane that says anything: it has its
/// nearest corner's key.
#[inline(always)]
pub(super) fn held(over: Affine, low: f32, high: f32) -> Key {
    let is_sound = over.x.is_finite() && over.y.is_finite() && over.c.is_finite();
    if is_sound { Key { over, low, high } } else { Key { over: Affine::default(), low: high, high } }
}

impl Ready {
    /// The small triangles that cover a sample.
    #[inline(always)]
    pub fn visible(&self) -> u32 {
        self.covered[0] | self.covered[1] | self.covered[2] | self.covered[3]
    }

    /// The box and the edges of triangle `lane`, as [`blocks`](super::raster::blocks) takes them.
    #[inline(always)]
    pub fn outline(&self, lane: usize) -> ([(i32, i32); 2], [Edge; 3]) {
        let edge = |[c, dx, dy]: &[[i32; LANES]; 3]| Edge { c: i64::from(c[lane]), dx: dx[lane], dy: dy[lane] };
        let [columns, rows] = [&self.columns, &self.rows].map(|[first, last]| (first[lane], last[lane]));
        ([columns, rows], self.edges.each_ref().map(edge))
    }

    /// Adds the fragments of the small triangle `lane`.
    #[inline(always)]
    pub fn draw(&self, lane: usize, key: &Key, grid: &Grid, slot: u32, what: u32, fragments: &mut Fragments) {
        for (sample, covered) in self.covered.iter().enumerate().filter(|(_, covered)| *covered >> lane & 1 == 1) {
            debug_assert!(*covered != 0);
            let column = self.columns[0][lane] as u32 + (sample as u32 & 1);
            let row = self.rows[0][lane] as u32 + (sample as u32 >> 1);
            let (block_x, block_y) = (column / BLOCK_WIDTH, row / BLOCK_HEIGHT);
            let block = block_y * BLOCKS_ACROSS + block_x;
            let of_block = (row % BLOCK_HEIGHT * BLOCK_WIDTH + column % BLOCK_WIDTH) as usize;
            if fragments.done(block) >> of_block & 1 == 1 {
                continue;
            }
            let at = key.in_block(grid, block_x, block_y, of_block);
            fragments.add_one(block, slot, of_block, at, what);
        }
    }
}
