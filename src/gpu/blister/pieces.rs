//! Which triangles every tile of the picture has, with their edges from the tile's corner.
//!
//! *Practice.* Edge functions of [`raster`](crate::blister) need 64 bits in general, and 32 at the pixels of a tile that the edge
//! crosses; an edge that all of a tile lies within is left out, and a triangle that no pixel of a tile lies within has no piece there.
//! So a shader covers the samples that the CPU covers. Keys are counted from the tile's corner: surfaces of one plane have one
//! function in a tile, whatever else they are.

use rayon::prelude::*;

use super::arrangement::{PlacedCorner, Surface, flags};
use crate::blister::frame::arrangement::owns_zero;
use crate::gpu::shader::WORKGROUP;
use crate::gpu_struct;
use crate::space::PixelRect;

/// Pixels of a tile's side: as many pixels as a workgroup has threads.
pub(super) const TILE: u32 = 8;

/// Positions of the grid within a pixel.
const SUBPIXELS: i64 = crate::blister::frame::arrangement::SUBPIXELS as i64;

const _: () = assert!(TILE * TILE == WORKGROUP);

gpu_struct! {
    /// A surface in a tile.
    pub struct Piece {
        /// ⌊e/256⌋ of an edge at the tile's first pixel, and what a pixel to the right and one down add.
        a: [i32; 3],
        /// The leaf, and `PIECE_HIDDEN` where boundaries on it do not show.
        slot: u32,
        /// The next edge.
        b: [i32; 3],
        /// What it is of.
        surface: u32,
        /// The last edge.
        c: [i32; 3],
        /// Least key.
        low: f32,
        /// The key's change to the right and down, and its value at the tile's first pixel.
        key: [f32; 3],
        /// Greatest key.
        high: f32,
    }
}

gpu_struct! {
    /// A boundary that a tile's kernel found.
    pub struct TileBoundary {
        /// Which pixel of the band.
        pixel: u32,
        /// Its number among the pixel's.
        number: u32,
        /// Larger is nearer.
        key: f32,
        /// What it is of.
        surface: u32,
        /// Whose material is behind.
        body: u32,
        /// Whether the result is entered.
        is_front: u32,
    }
}

/// The pieces of all tiles.
#[derive(Debug, Default)]
pub(super) struct Pieces {
    pub tiles_across: u32,
    /// By tile, row by row: its first piece, and how many.
    pub tiles: Vec<[u32; 2]>,
    pub pieces: Vec<Piece>,
    /// By pixel of the rectangle that is drawn, row by row, where its single fragments begin; empty without any.
    pub single_offsets: Vec<u32>,
    /// Of single fragments: their pieces.
    pub singles: Vec<u32>,
}

/// An edge over whole pixels: `c + right·x + down·y`, in 256ths of its function.
#[derive(Clone, Copy)]
struct Edge {
    c: i64,
    right: i64,
    down: i64,
}

impl Edge {
    /// From `p` to `q`, on the grid; samples lie at pixels' centres.
    fn new(p: [i64; 2], q: [i64; 2]) -> Self {
        let (dx, dy) = (q[0] - p[0], q[1] - p[1]);
        let centre = SUBPIXELS / 2;
        let e = dy * (p[0] - centre) - dx * (p[1] - centre);
        // Differences on the grid have 24 bits.
        Self {
            c: (e - i64::from(!owns_zero(dx as i32, dy as i32))) >> SUBPIXELS.trailing_zeros(),
            right: -dy,
            down: dx,
        }
    }

    /// At the first pixel of a tile; `None` where no pixel of the tile lies within, zeros where all do.
    fn in_tile(&self, x: u32, y: u32) -> Option<[i32; 3]> {
        let c = self.c + self.right * i64::from(x) + self.down * i64::from(y);
        let last = i64::from(TILE) - 1;
        let (most, least) = (self.right.max(0) + self.down.max(0), self.right.min(0) + self.down.min(0));
        if c + last * most < 0 {
            return None;
        }
        if c + last * least >= 0 {
            return Some([0; 3]);
        }
        // Zero is within the range over the tile, so all values are below the range's width.
        Some([c as i32, self.right as i32, self.down as i32])
    }
}

/// A piece without edges, or one that is nowhere covered.
fn piece(surface: &Surface, number: u32, [x, y]: [u32; 2], edges: [[i32; 3]; 3]) -> Piece {
    let [right, down, at_anchor] = surface.key;
    let from_anchor = [x as f32 - surface.anchor[0], y as f32 - surface.anchor[1]].map(f64::from);
    let at_tile = f64::from(right) * from_anchor[0] + f64::from(down) * from_anchor[1] + f64::from(at_anchor);
    let [a, b, c] = edges;
    let hidden = if surface.flags & flags::SURFACE_HIDDEN != 0 { flags::PIECE_HIDDEN } else { 0 };
    let (slot, [low, high]) = (surface.slot & flags::SLOT_NUMBER | hidden, surface.range);
    Piece { a, slot, b, surface: number, c, low, key: [right, down, at_tile as f32], high }
}

impl Pieces {
    /// Of a picture of `size`: `corners` are three for each triangle, and surface i is that of triangle i; `singles` are the fragments
    /// beside them in the rectangle that is drawn.
    pub fn new(
        size: [u32; 2],
        corners: &[PlacedCorner],
        (rect, singles): (PixelRect, &[PlacedCorner]),
        surfaces: &[Surface],
    ) -> Self {
        let [across, down] = size.map(|side| side.div_ceil(TILE));
        // Step 1: tasks of triangles in parallel, joined in their order.
        const A_TASK: usize = 3 * 1024;
        let placed: Vec<Vec<(u32, Piece)>> = corners
            .par_chunks(A_TASK)
            .map(|corners| {
                let mut out = Vec::new();
                corners.chunks_exact(3).for_each(|corners| cut(size, across, corners, surfaces, &mut out));
                out
            })
            .collect();
        // Step 2: sorted by tile.
        let mut tiles = vec![[0; 2]; (across * down) as usize];
        placed.iter().flatten().for_each(|(tile, _)| tiles[*tile as usize][1] += 1);
        let mut end = 0;
        let mut next = Vec::with_capacity(tiles.len());
        for [first, count] in &mut tiles {
            *first = end;
            next.push(end);
            end += *count;
        }
        let mut pieces = vec![Piece::default(); end as usize];
        for (tile, piece) in placed.into_iter().flatten() {
            let place = &mut next[tile as usize];
            pieces[*place as usize] = piece;
            *place += 1;
        }
        let mut all = Self { tiles_across: across, tiles, pieces, ..Self::default() };
        if !singles.is_empty() {
            all.place_singles(rect, singles, surfaces);
        }
        all
    }

    fn place_singles(&mut self, rect: PixelRect, singles: &[PlacedCorner], surfaces: &[Surface]) {
        let pixel =
            |corner: &PlacedCorner| ((corner.y as u32 - rect.y0) * rect.width() + corner.x as u32 - rect.x0) as usize;
        self.single_offsets = vec![0; rect.area() + 1];
        singles.iter().for_each(|corner| self.single_offsets[pixel(corner) + 1] += 1);
        for i in 1..self.single_offsets.len() {
            self.single_offsets[i] += self.single_offsets[i - 1];
        }
        let mut next = self.single_offsets.clone();
        self.singles = vec![0; singles.len()];
        // Neighbours mostly have surfaces of their own, or that of the one before.
        let mut last = (u32::MAX, [u32::MAX; 2]);
        for corner in singles {
            let corner_of_tile = [corner.x as u32 / TILE * TILE, corner.y as u32 / TILE * TILE];
            if last != (corner.surface, corner_of_tile) {
                last = (corner.surface, corner_of_tile);
                let surface = &surfaces[corner.surface as usize];
                self.pieces.push(piece(surface, corner.surface, corner_of_tile, [[0; 3]; 3]));
            }
            let place = &mut next[pixel(corner)];
            self.singles[*place as usize] = self.pieces.len() as u32 - 1;
            *place += 1;
        }
    }
}

/// Appends the pieces of one triangle.
fn cut(size: [u32; 2], across: u32, corners: &[PlacedCorner], surfaces: &[Surface], out: &mut Vec<(u32, Piece)>) {
    // Corners are whole on the grid, and their floats hold that exactly.
    let on_grid = |corner: &PlacedCorner| [corner.x, corner.y].map(|px| (px * SUBPIXELS as f32) as i64);
    let [a, b, c] = [on_grid(&corners[0]), on_grid(&corners[1]), on_grid(&corners[2])];
    let area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1]);
    if area == 0 {
        return;
    }
    let (b, c) = if area < 0 { (c, b) } else { (b, c) };
    // Pixels with their centres inside the box.
    let centre = SUBPIXELS / 2;
    let first = |axis: usize| (a[axis].min(b[axis]).min(c[axis]) - centre + SUBPIXELS - 1).div_euclid(SUBPIXELS).max(0);
    let last =
        |axis: usize| (a[axis].max(b[axis]).max(c[axis]) - centre).div_euclid(SUBPIXELS).min(i64::from(size[axis]) - 1);
    let (x0, y0, x1, y1) = (first(0), first(1), last(0), last(1));
    if x0 > x1 || y0 > y1 {
        return;
    }
    let edges = [Edge::new(a, b), Edge::new(b, c), Edge::new(c, a)];
    let number = corners[0].surface;
    let surface = &surfaces[number as usize];
    for row in y0 as u32 / TILE..=y1 as u32 / TILE {
        for column in x0 as u32 / TILE..=x1 as u32 / TILE {
            let (x, y) = (column * TILE, row * TILE);
            let [Some(a), Some(b), Some(c)] = edges.map(|edge| edge.in_tile(x, y)) else { continue };
            out.push((row * across + column, piece(surface, number, [x, y], [a, b, c])));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::layout::assert_same_layout;

    #[test]
    fn the_structs_are_the_shaders() {
        assert_same_layout::<Piece>();
        assert_same_layout::<TileBoundary>();
    }

    /// Two triangles that share an edge cover every pixel of their square once, wherever its corners are on the grid.
    #[test]
    fn triangles_that_share_an_edge_cover_no_pixel_twice_and_leave_none_out() {
        let surface = Surface { range: [-1.0, 1.0], ..Surface::default() };
        for shift in 0..40 {
            let at = |x: f32, y: f32, surface| PlacedCorner {
                x: x + (shift * 37 % 256) as f32 / 256.0,
                y: y + (shift * 91 % 256) as f32 / 256.0,
                surface,
            };
            let square = [(2.5, 1.5), (37.5, 3.5), (33.5, 29.5), (4.5, 25.5)];
            let corner = |i: usize, surface| at(square[i].0, square[i].1, surface);
            let corners = [corner(0, 0), corner(1, 0), corner(2, 0), corner(0, 1), corner(3, 1), corner(2, 1)];
            let pieces =
                Pieces::new([48, 48], &corners, (PixelRect { x0: 0, y0: 0, x1: 48, y1: 48 }, &[]), &[surface, surface]);
            let mut counts = [[0; 48]; 48];
            for (tile, range) in pieces.tiles.iter().enumerate() {
                let (x0, y0) = (tile as u32 % pieces.tiles_across * TILE, tile as u32 / pieces.tiles_across * TILE);
                for piece in &pieces.pieces[range[0] as usize..(range[0] + range[1]) as usize] {
                    for (x, y) in (0..TILE).flat_map(|y| (0..TILE).map(move |x| (x, y))) {
                        let at = |[c, right, down]: [i32; 3]| c + right * x as i32 + down * y as i32;
                        if at(piece.a) | at(piece.b) | at(piece.c) >= 0 {
                            counts[(y0 + y) as usize][(x0 + x) as usize] += 1;
                        }
                    }
                }
            }
            assert!(counts.iter().flatten().all(|count| *count <= 1), "shift {shift}");
            let covered = counts.iter().flatten().sum::<i32>();
            // The shoelace formula, to within half the outline.
            let turned = (0..4).map(|i| (square[i], square[(i + 1) % 4]));
            let area: f32 = turned.map(|(p, q)| p.0 * q.1 - q.0 * p.1).sum::<f32>() * 0.5;
            assert!((covered as f32 - area).abs() < 20.0, "shift {shift}: {covered} of {area}");
            // A row is covered without a gap.
            for row in &counts {
                let changes = row.windows(2).filter(|pair| pair[0] != pair[1]).count();
                assert!(changes <= 2, "shift {shift}: {row:?}");
            }
        }
    }
}
