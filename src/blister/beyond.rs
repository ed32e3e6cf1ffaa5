//! Triangles that pass the eye, or reach too far aside for the grid: no clipping, the ray against each edge.
//!
//! *Theory.* A ray of direction d from the eye meets the triangle p, q, r (relative to the eye) in front of the eye or, as a
//! line, behind it, where d·(p × q), d·(q × r) and d·(r × p) have one sign (Olano and Greer 1997). Nothing has to be
//! clipped; the depth along the ray then tells front from behind. For two corners in front of the eye the sign is that of
//! their edge function on the picture. On an orthographic picture all are edge functions there.
//!
//! *Changes from the paper.* Blister leaves clipping to the GPU, and the camera must be outside of every leaf. Clipping at a
//! near plane makes new vertices, whose rounding opens the mesh. Here an edge whose corners are both on the grid has the
//! grid's integer edge function, as in the neighbour that [`raster`](super::raster) draws; any other edge belongs to two
//! triangles that both come here, and is evaluated from its lower to its higher vertex for both. So closed meshes stay
//! closed, and a leaf that holds the eye is crossed an odd number of times in front of it.
//!
//! *Practice.* Edge functions are linear over the picture, so one that is on the wrong side at all four corners of the tile
//! drops the triangle. The rest is plain `f64`, pixel by pixel: few triangles are near the eye.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x8, mask32x8};
use glam::{DVec2, DVec3};

use super::fragments::{ABSENT, BLOCK_HEIGHT, BLOCK_WIDTH, BLOCKS_ACROSS, BLOCKS_DOWN, Fragments, LANES};
use super::project::{Affine, SUBPIXELS, Snapped, View, place};
use super::raster::{Grid, owns_zero};
use crate::layers::TILE_SIDE;

/// An edge's function over the tile's pixels, and what its zero counts as.
#[derive(Debug, Clone, Copy)]
enum Side {
    /// Both corners are on the grid: from p by (dx, dy), relative to the tile's first sample.
    OnGrid { p: [i32; 2], dx: i32, dy: i32 },
    /// Linear over pixels, from the lower vertex to the higher; the triangle may run the other way.
    Free { function: Affine, reversed: bool },
}

impl Side {
    /// Whether the pixel (relative to the tile) is on the positive side.
    fn is_positive(&self, column: u32, row: u32) -> bool {
        match *self {
            Self::OnGrid { p, dx, dy } => {
                let x = i64::from(column as i32 * SUBPIXELS - p[0]);
                let y = i64::from(row as i32 * SUBPIXELS - p[1]);
                let e = i64::from(dx) * y - i64::from(dy) * x;
                e > 0 || (e == 0 && owns_zero(dx, dy))
            }
            Self::Free { function, reversed } => (function.at(f64::from(column), f64::from(row)) >= 0.0) != reversed,
        }
    }
}

/// One corner: its number, where it is on the grid, and where in view space.
#[derive(Debug, Clone, Copy)]
pub(super) struct Corner<'a> {
    pub vertex: u32,
    pub snapped: &'a Snapped,
    pub p_in_view: DVec3,
}

/// Puts the fragments of one triangle into `fragments`. `key` is over whole pixels' samples of the picture.
#[allow(clippy::too_many_arguments)]
pub(super) fn triangle<S: Simd>(
    simd: S,
    view: &View,
    grid: &Grid,
    corners: [Corner<'_>; 3],
    key: Affine,
    slot: u32,
    what: u32,
    fragments: &mut Fragments,
) {
    let [a, b, c] = corners;
    let sides = [side(view, grid, a, b), side(view, grid, b, c), side(view, grid, c, a)];
    // All on one side of one edge and all on the other side of another, at every corner of the tile: outside.
    let last = TILE_SIDE - 1;
    let at_corners = |side: &Side| [(0, 0), (last, 0), (0, last), (last, last)].map(|(x, y)| side.is_positive(x, y));
    let found = sides.map(|side| at_corners(&side));
    if found.contains(&[true; 4]) && found.contains(&[false; 4]) {
        return;
    }
    for block_y in 0..BLOCKS_DOWN {
        for block_x in 0..BLOCKS_ACROSS {
            let mut keys = [ABSENT; LANES];
            let mut bits = 0_u64;
            for (lane, place) in keys.iter_mut().enumerate() {
                let column = block_x * BLOCK_WIDTH + lane as u32 % BLOCK_WIDTH;
                let row = block_y * BLOCK_HEIGHT + lane as u32 / BLOCK_WIDTH;
                let positive = sides.map(|side| side.is_positive(column, row));
                let at = key.at(f64::from(column + grid.x0), f64::from(row + grid.y0)) as f32;
                if (positive == [true; 3] || positive == [false; 3]) && view.is_in_front(at) && at.is_finite() {
                    *place = at;
                    bits |= 1 << lane;
                }
            }
            if bits != 0 {
                let mask = mask32x8::from_bitmask(simd, bits);
                let block = block_y * BLOCKS_ACROSS + block_x;
                let keys = f32x8::from_slice(simd, &keys);
                fragments.add(simd, block, slot, mask, keys, f32::INFINITY, what);
            }
        }
    }
}

fn side(view: &View, grid: &Grid, from: Corner<'_>, to: Corner<'_>) -> Side {
    if from.snapped[3] | to.snapped[3] == place::FINE {
        let p = [from.snapped[0] - grid.sample[0], from.snapped[1] - grid.sample[1]];
        return Side::OnGrid { p, dx: to.snapped[0] - from.snapped[0], dy: to.snapped[1] - from.snapped[1] };
    }
    let reversed = from.vertex > to.vertex;
    let (p, q) = if reversed { (to.p_in_view, from.p_in_view) } else { (from.p_in_view, to.p_in_view) };
    // Over X and Y of the ray: of its direction, or of its origin.
    let over = if view.is_perspective { p.cross(q) } else { DVec3::new(p.y - q.y, q.x - p.x, p.x * q.y - p.y * q.x) };
    let sample = DVec2::new(f64::from(grid.sample[0]), f64::from(grid.sample[1])) / f64::from(SUBPIXELS);
    let (first, step) = (view.across(sample), view.across(sample + 1.0) - view.across(sample));
    let function = Affine { x: over.x * step.x, y: over.y * step.y, c: over.x * first.x + over.y * first.y + over.z };
    Side::Free { function, reversed }
}
