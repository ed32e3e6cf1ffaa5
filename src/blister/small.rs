//! Triangles of a few pixels, eight at a time.
//!
//! *Theory.* As in [`raster`](super::raster), with lanes that are triangles instead of pixels. A triangle whose box holds at
//! most two samples each way has at most four to be asked for; its edge functions at these fit 32 bits as they are.
//!
//! *Practice.* Scans at picture size are made of such triangles, and half of them hold no sample. Those cost a share of a
//! few dozen vector instructions here; the depth of the others is computed when one of their samples is covered. Larger ones
//! are handed back.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, i32x8};

use super::fragments::{BLOCK_HEIGHT, BLOCK_WIDTH, BLOCKS_ACROSS, Fragments, LANES};
use super::project::Snapped;
use super::raster::{Grid, Key};
use crate::layers::TILE_SIDE;

/// Up to eight triangles.
#[derive(Debug, Default)]
pub(super) struct Batch {
    pub len: usize,
    /// The triangles' numbers.
    pub numbers: [u32; LANES],
    /// Corners on the grid: x and y of each.
    corners: [[i32; LANES]; 6],
}

/// What is known of a batch's triangles.
pub(super) struct Found {
    /// Bit i is set where triangle i is not small: it may have samples beyond those that were asked for.
    pub large: u32,
    /// The first column and row of each one's samples, relative to the tile.
    column: [i32; LANES],
    row: [i32; LANES],
    /// For each of four samples (left and right of the first row, then of the second): the triangles that cover it.
    covered: [u32; 4],
}

impl Batch {
    #[inline(always)]
    pub fn push(&mut self, number: u32, [a, b, c]: [&Snapped; 3]) {
        let lane = self.len;
        self.len += 1;
        self.numbers[lane] = number;
        for (corner, v) in [a, b, c].into_iter().enumerate() {
            self.corners[2 * corner][lane] = v[0];
            self.corners[2 * corner + 1][lane] = v[1];
        }
    }

    /// Finds what the triangles cover.
    #[inline(always)]
    pub fn find<S: Simd>(&self, simd: S, grid: &Grid) -> Found {
        let load = |i: usize| i32x8::from_slice(simd, &self.corners[i]) - grid.sample[i % 2];
        let (ax, ay, bx, by, cx, cy) = (load(0), load(1), load(2), load(3), load(4), load(5));
        let last = TILE_SIDE as i32 - 1;
        // The samples inside the box and the tile.
        let x0 = ((ax.min(bx).min(cx) + 255) >> 8).max(0);
        let y0 = ((ay.min(by).min(cy) + 255) >> 8).max(0);
        let x1 = (ax.max(bx).max(cx) >> 8).min(last);
        let y1 = (ay.max(by).max(cy) >> 8).min(last);
        let lanes = (1_u32 << self.len) - 1;
        let holds = (x1.simd_ge(x0) & y1.simd_ge(y0)).to_bitmask() as u32 & lanes;
        // Far corners would overflow the products below.
        const FAR: i32 = 8 << 8;
        let reach = |low: i32x8<S>, a: i32x8<S>, b: i32x8<S>, c: i32x8<S>| a.max(b).max(c) - low;
        let (low_x, low_y) = (ax.min(bx).min(cx), ay.min(by).min(cy));
        let is_far = reach(low_x, ax, bx, cx).max(reach(low_y, ay, by, cy)).simd_gt(FAR);
        let is_large = (x1 - x0).max(y1 - y0).simd_gt(1) | is_far;
        let large = is_large.to_bitmask() as u32 & holds;

        // From the first sample.
        let (px, py) = (x0 << 8, y0 << 8);
        let area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay);
        let is_turned = area.simd_lt(0);
        let zero = i32x8::splat(simd, 0);
        let mut e00 = i32x8::splat(simd, 0);
        let (mut e10, mut e01, mut e11) = (e00, e00, e00);
        for (x, y, to_x, to_y) in [(ax, ay, bx, by), (bx, by, cx, cy), (cx, cy, ax, ay)] {
            let (dx, dy) = (to_x - x, to_y - y);
            let (dx, dy) = (is_turned.select(zero - dx, dx), is_turned.select(zero - dy, dy));
            let owns_zero = dy.simd_lt(0) | (dy.simd_eq(0) & dx.simd_gt(0));
            let bias = owns_zero.select(zero, i32x8::splat(simd, 1));
            let e = dx * (py - y) - dy * (px - x) - bias;
            let (right, down) = (zero - (dy << 8), dx << 8);
            // A sample is covered where no edge function is negative: where none has its highest bit.
            e00 |= e;
            e10 |= e + right;
            e01 |= e + down;
            e11 |= e + right + down;
        }
        let small = holds & !large & area.simd_ne(0).to_bitmask() as u32;
        let has_right = x1.simd_gt(x0).to_bitmask() as u32 & small;
        let has_down = y1.simd_gt(y0).to_bitmask() as u32 & small;
        Found {
            large,
            column: x0.into(),
            row: y0.into(),
            covered: [
                e00.simd_ge(0).to_bitmask() as u32 & small,
                e10.simd_ge(0).to_bitmask() as u32 & has_right,
                e01.simd_ge(0).to_bitmask() as u32 & has_down,
                e11.simd_ge(0).to_bitmask() as u32 & has_right & has_down,
            ],
        }
    }
}

impl Found {
    /// The triangles that cover a sample.
    #[inline(always)]
    pub fn visible(&self) -> u32 {
        self.covered[0] | self.covered[1] | self.covered[2] | self.covered[3]
    }

    /// Adds the fragments of triangle `lane` of the batch.
    #[inline(always)]
    pub fn draw(&self, lane: usize, key: &Key, grid: &Grid, slot: u32, what: u32, fragments: &mut Fragments) {
        for (sample, covered) in self.covered.iter().enumerate().filter(|(_, covered)| *covered >> lane & 1 == 1) {
            debug_assert!(*covered != 0);
            let column = self.column[lane] as u32 + (sample as u32 & 1);
            let row = self.row[lane] as u32 + (sample as u32 >> 1);
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
