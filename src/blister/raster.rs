//! Triangles on the grid into fragments: exact edges, depth from the plane.
//!
//! *Theory.* With corners p, q on a grid of 1/256 pixel, the edge function e(P) = (q − p) × (P − p) is an integer. A sample is
//! covered where all three edge functions of a triangle are positive (corners ordered so that its area is), or zero on an
//! edge that is the triangle's own by the top-left rule: of two triangles that share an edge just one has it. So a closed
//! mesh crosses every sample's ray an even number of times, without a tolerance.
//!
//! *Practice.* Samples of one pass are whole pixels apart, so e changes by multiples of 256 between them, and ⌊e/256⌋ at the
//! tile's corner tells the same signs in 32 bits (the bounds are in [`project`](super::project)). An edge that every
//! sample of the triangle's box lies within is left out, so only edges that cross the tile count for those bounds. Keys are
//! evaluated in `f64` at the corner of every block and only then rounded: two triangles of one shared plane get the same
//! bits at a pixel, however they lie.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x8, i32x8};

use super::fragments::{BLOCK_HEIGHT, BLOCK_WIDTH, BLOCKS_ACROSS, Fragments};
use super::project::{Affine, Snapped};
use crate::layers::TILE_SIDE;

/// The tile that is being drawn, at one sample of every pixel.
#[derive(Debug, Clone, Copy)]
pub(super) struct Grid {
    /// The tile's first pixel.
    pub x0: u32,
    pub y0: u32,
    /// The sample of that pixel on the grid of subpixels.
    pub sample: [i32; 2],
}

impl Grid {
    /// A position relative to the first pixel's sample.
    #[inline(always)]
    pub fn place(&self, v: &Snapped) -> [i32; 2] {
        [v[0] - self.sample[0], v[1] - self.sample[1]]
    }
}

/// A key over a triangle or a plane, and the range that it is held to.
#[derive(Debug, Clone, Copy)]
pub(super) struct Key {
    /// At whole pixels' samples: `at(column, row)`.
    pub over: Affine,
    pub low: f32,
    pub high: f32,
}

impl Key {
    /// The key at the corner of a block of the tile.
    #[inline(always)]
    fn at_block(&self, grid: &Grid, block_x: u32, block_y: u32) -> f32 {
        let (column, row) = (grid.x0 + block_x * BLOCK_WIDTH, grid.y0 + block_y * BLOCK_HEIGHT);
        self.over.at(f64::from(column), f64::from(row)) as f32
    }

    /// The key at one pixel of a block: the very bits that [`triangle`] finds there.
    pub fn in_block(&self, grid: &Grid, block_x: u32, block_y: u32, lane: usize) -> f32 {
        let (x, y) = (lane as u32 % BLOCK_WIDTH, lane as u32 / BLOCK_WIDTH);
        let aside = x as f32 * self.over.x as f32 + y as f32 * self.over.y as f32;
        (aside + self.at_block(grid, block_x, block_y)).max(self.low).min(self.high)
    }
}

/// The columns and rows of a block's pixels.
pub(super) struct Offsets<S: Simd> {
    pub x: i32x8<S>,
    pub y: i32x8<S>,
    pub x_f: f32x8<S>,
    pub y_f: f32x8<S>,
}

impl<S: Simd> Offsets<S> {
    #[inline(always)]
    pub fn new(simd: S) -> Self {
        let x = i32x8::from_slice(simd, &[0, 1, 2, 3, 0, 1, 2, 3]);
        let y = i32x8::from_slice(simd, &[0, 0, 0, 0, 1, 1, 1, 1]);
        let x_f = f32x8::from_slice(simd, &[0.0, 1.0, 2.0, 3.0, 0.0, 1.0, 2.0, 3.0]);
        let y_f = f32x8::from_slice(simd, &[0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0]);
        Self { x, y, x_f, y_f }
    }
}

/// A triangle no wider than this on the grid has edge functions below 2^31 over the tile, wherever it touches it.
pub(super) const SMALL: i32 = 1 << 14;

/// ⌊e/256⌋ at a tile's pixel: `c + dx·row − dy·column`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Edge {
    pub c: i64,
    pub dx: i32,
    pub dy: i32,
}

impl Edge {
    /// Every sample lies within.
    const NONE: Self = Self { c: 0, dx: 0, dy: 0 };

    #[inline(always)]
    fn new(p: [i32; 2], q: [i32; 2]) -> Self {
        let (dx, dy) = (q[0] - p[0], q[1] - p[1]);
        let e = i64::from(dy) * i64::from(p[0]) - i64::from(dx) * i64::from(p[1]);
        Self { c: (e - i64::from(!owns_zero(dx, dy))) >> 8, dx, dy }
    }

    /// The value at a pixel of a tile that the edge crosses, which 32 bits hold.
    #[inline(always)]
    fn at(&self, column: i32, row: i32) -> i32 {
        self.c as i32 + self.dx * row - self.dy * column
    }

    /// Least and greatest value over the pixels of a box.
    fn range(&self, x: (i32, i32), y: (i32, i32)) -> (i64, i64) {
        let (dx, dy) = (i64::from(self.dx), -i64::from(self.dy));
        let (x0, x1) = (dy * i64::from(x.0), dy * i64::from(x.1));
        let (y0, y1) = (dx * i64::from(y.0), dx * i64::from(y.1));
        (self.c + x0.min(x1) + y0.min(y1), self.c + x0.max(x1) + y0.max(y1))
    }
}

/// A triangle over more blocks than this across has its rows of blocks cut to where its edges leave them: long slivers touch
/// few blocks of their box.
const WIDE_BLOCKS: i32 = 2;

/// The furthest column within an edge of any pixel of a row of blocks: `offset + slope·row`, of its first row.
#[derive(Debug, Clone, Copy)]
struct Bound {
    offset: f64,
    slope: f64,
}

/// What a triangle's edges leave of a row of blocks.
struct Bounds {
    /// Greatest and least column: of the edges that bound to the right, and to the left.
    right: [Bound; 3],
    left: [Bound; 3],
}

impl Bounds {
    fn new(edges: &[Edge; 3]) -> Self {
        let none = |offset: f64| [Bound { offset, slope: 0.0 }; 3];
        let (mut right, mut left) = (none(f64::INFINITY), none(f64::NEG_INFINITY));
        for (i, edge) in edges.iter().enumerate() {
            // c + dx·row − dy·column ≥ 0. Rounding is far below a pixel's hundredth.
            const SLACK: f64 = 0.01;
            let per = 1.0 / f64::from(edge.dy);
            let (offset, slope) = (edge.c as f64 * per, f64::from(edge.dx) * per);
            // To the block's last row.
            let down = slope * f64::from(BLOCK_HEIGHT - 1);
            if edge.dy > 0 {
                right[i] = Bound { offset: offset + down.max(0.0) + SLACK, slope };
            } else if edge.dy < 0 {
                left[i] = Bound { offset: offset + down.min(0.0) - SLACK, slope };
            }
        }
        Self { right, left }
    }

    /// The first and last column of the tile that any pixel of the row of blocks from `row` on can have, or columns next to them.
    #[inline(always)]
    fn columns(&self, row: i32) -> (i32, i32) {
        let row = f64::from(row);
        let at = |b: &Bound| b.offset + b.slope * row;
        let right = at(&self.right[0]).min(at(&self.right[1])).min(at(&self.right[2]));
        let left = at(&self.left[0]).max(at(&self.left[1])).max(at(&self.left[2]));
        // Casts saturate. Towards zero they round a column too far at most, which the edges then leave out.
        (left as i32, right as i32)
    }
}

/// The top-left rule: whether samples exactly on the edge belong to the triangle. True for just one direction of an edge.
#[inline(always)]
pub(crate) fn owns_zero(dx: i32, dy: i32) -> bool {
    dy < 0 || (dy == 0 && dx > 0)
}

/// Puts the fragments of one triangle, given by its corners on the grid, into `fragments`.
#[inline(always)]
#[allow(clippy::too_many_arguments)]
pub(super) fn triangle<S: Simd>(
    simd: S,
    offsets: &Offsets<S>,
    grid: &Grid,
    corners: [&Snapped; 3],
    key: &Key,
    slot: u32,
    what: u32,
    fragments: &mut Fragments,
) {
    let [a, b, c] = [grid.place(corners[0]), grid.place(corners[1]), grid.place(corners[2])];
    // Pixels with samples inside the box, within the tile.
    let last = TILE_SIDE as i32 - 1;
    let (low_x, high_x) = (a[0].min(b[0]).min(c[0]), a[0].max(b[0]).max(c[0]));
    let (low_y, high_y) = (a[1].min(b[1]).min(c[1]), a[1].max(b[1]).max(c[1]));
    let x = (((low_x + 255) >> 8).max(0), (high_x >> 8).min(last));
    let y = (((low_y + 255) >> 8).max(0), (high_y >> 8).min(last));
    if x.0 > x.1 || y.0 > y.1 {
        return;
    }
    let area = i64::from(b[0] - a[0]) * i64::from(c[1] - a[1]) - i64::from(c[0] - a[0]) * i64::from(b[1] - a[1]);
    if area == 0 {
        return;
    }
    let (b, c) = if area < 0 { (c, b) } else { (b, c) };
    let mut edges = [Edge::new(a, b), Edge::new(b, c), Edge::new(c, a)];
    if high_x - low_x > SMALL || high_y - low_y > SMALL {
        let (width, height) = (BLOCK_WIDTH as i32, BLOCK_HEIGHT as i32);
        let blocks_x = (x.0 / width, x.1 / width);
        let blocks_y = (y.0 / height, y.1 / height);
        // All pixels of the blocks: an edge that is left out must hold for those outside of the box too.
        let columns = (blocks_x.0 * width, blocks_x.1 * width + width - 1);
        let rows = (blocks_y.0 * height, blocks_y.1 * height + height - 1);
        for edge in &mut edges {
            let (least, most) = edge.range(columns, rows);
            if most < 0 {
                return;
            }
            if least >= 0 {
                *edge = Edge::NONE;
            }
        }
    }
    blocks(simd, offsets, grid, [x, y], &edges, key, slot, what, fragments);
}

/// Puts the fragments of one triangle into `fragments`, given its `edges` and the first and last column and row of the samples
/// in its box.
#[inline(always)]
#[allow(clippy::too_many_arguments)]
pub(super) fn blocks<S: Simd>(
    simd: S,
    offsets: &Offsets<S>,
    grid: &Grid,
    [x, y]: [(i32, i32); 2],
    edges: &[Edge; 3],
    key: &Key,
    slot: u32,
    what: u32,
    fragments: &mut Fragments,
) {
    let last = TILE_SIDE as i32 - 1;
    let (width, height) = (BLOCK_WIDTH as i32, BLOCK_HEIGHT as i32);
    let blocks_x = (x.0 / width, x.1 / width);
    let blocks_y = (y.0 / height, y.1 / height);
    let lanes = [
        offsets.y * edges[0].dx - offsets.x * edges[0].dy,
        offsets.y * edges[1].dx - offsets.x * edges[1].dy,
        offsets.y * edges[2].dx - offsets.x * edges[2].dy,
    ];
    let (key_x, key_y) = (key.over.x as f32, key.over.y as f32);
    let key_lanes = offsets.x_f * key_x + offsets.y_f * key_y;
    let bounds = (blocks_x.1 - blocks_x.0 > WIDE_BLOCKS).then(|| Bounds::new(edges));
    for block_y in blocks_y.0..=blocks_y.1 {
        let row = block_y * height;
        let mut across = blocks_x;
        if let Some(bounds) = &bounds {
            let (left, right) = bounds.columns(row);
            across = (across.0.max(left.max(0) / width), across.1.min(right.min(last) >> BLOCK_WIDTH.trailing_zeros()));
        }
        for block_x in across.0..=across.1 {
            let block = block_y as u32 * BLOCKS_ACROSS + block_x as u32;
            if fragments.done(block) == u8::MAX {
                continue;
            }
            let column = block_x * width;
            let e0 = lanes[0] + edges[0].at(column, row);
            let e1 = lanes[1] + edges[1].at(column, row);
            let e2 = lanes[2] + edges[2].at(column, row);
            let inside = (e0 | e1 | e2).simd_ge(0);
            if inside.all_false() {
                continue;
            }
            let corner = key.at_block(grid, block_x as u32, block_y as u32);
            let keys = (key_lanes + corner).max(key.low).min(key.high);
            fragments.add(simd, block, slot, inside, keys, key.high, what);
        }
    }
}
