//! The layer stack: the only contract between a pipeline and what draws its result.
//!
//! A *layer* is the i-th boundary of the result solid along each pixel's ray, fronts and backs. A pipeline is a
//! [`LayerSource`]: it hands over one [`LayerTile`] for any rectangle of pixels asked for, with per-pixel lists in depth
//! order. Dense layers do not fit in memory (4096² is about 470 MB each), so a whole [`LayerStack`] exists only where
//! something needs all of it: EXR output and measurements.
//!
//! A style derives all else from these records; no style adds a channel.

pub mod limit;
pub mod merged;
pub mod opaque;
#[cfg(test)]
mod test_layers;

use std::sync::LazyLock;

use glam::{DVec2, Vec3};
use rayon::prelude::*;

pub use opaque::OpaqueTile;

use crate::space::{Camera, PixelRect};

/// Tiles are this many pixels a side.
pub const TILE_SIDE: u32 = 64;

/// The most samples a pixel can have: one bit each in [`Boundary::samples`].
pub const MAX_SAMPLES: u32 = 16;

/// `Boundary::leaf` where there is none.
pub const NO_LEAF: u32 = u32::MAX;

/// Where in its pixel each of `samples` samples lies, pixel units, (0, 0) the pixel's top left corner: the one set of
/// positions that every pipeline and the judge use. One sample is at the centre; several stand one to a column and one to a
/// row (a rotated grid: no edge direction meets two at once that need not), as far apart as a lattice lets them.
///
/// `samples` is held to 1 to [`MAX_SAMPLES`].
pub fn sample_offsets(samples: u32) -> &'static [DVec2] {
    static PATTERNS: LazyLock<Vec<Vec<DVec2>>> = LazyLock::new(|| (1..=MAX_SAMPLES).map(sample_pattern).collect());
    &PATTERNS[samples.clamp(1, MAX_SAMPLES) as usize - 1]
}

/// Of all lattices that put one of `n` samples in each row and column the one whose nearest two are furthest apart.
fn sample_pattern(n: u32) -> Vec<DVec2> {
    let mut best = (0, Vec::new());
    // Row i·step mod n, or the same a step in from the border of a lattice one larger.
    for border in [0, 1] {
        for step in 1..=n {
            let row = |i: u32| ((i + border) * step % (n + border)).wrapping_sub(border);
            let cells: Vec<(u32, u32)> = (0..n).map(|i| (i, row(i))).collect();
            let one_a_row = (0..n).all(|r| cells.iter().any(|cell| cell.1 == r));
            if !one_a_row {
                continue;
            }
            let apart = |a: &(u32, u32), b: &(u32, u32)| a.0.abs_diff(b.0).pow(2) + a.1.abs_diff(b.1).pow(2);
            let pairs = cells.iter().enumerate().flat_map(|(i, a)| cells[..i].iter().map(move |b| apart(a, b)));
            let nearest = pairs.min().unwrap_or(u32::MAX);
            if nearest > best.0 {
                best = (nearest, cells);
            }
        }
    }
    let centre = |cell: u32| (f64::from(cell) + 0.5) / f64::from(n);
    best.1.into_iter().map(|(x, y)| DVec2::new(centre(x), centre(y))).collect()
}

/// Which way the *result's* surface faces at a boundary.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(i8)]
pub enum Facing {
    /// The ray enters the result here.
    Front = 1,
    /// The ray leaves the result here.
    Back = -1,
}

/// One boundary of the result at one pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Boundary {
    /// Planar view depth, world units; the mean over its samples.
    pub depth: f32,
    /// Unit normal of the *result* (outward), world space.
    pub normal: Vec3,
    /// Linear RGB of the surface, unlit.
    pub colour: [f32; 3],
    /// The leaf's opacity times the surfel's, 0 to 1.
    pub opacity: f32,
    /// The leaf whose surface this is, an index into the scene's leaves.
    pub leaf: u32,
    /// The leaf whose material lies behind the surface; where a cutter's surface bounds the result, that is the leaf
    /// that was cut.
    pub body: u32,
    /// The result's facing.
    pub facing: Facing,
    /// Bit i is set where sample i of the pixel sees this boundary. Never zero.
    pub samples: u16,
}

/// The boundaries of one rectangle of pixels, per-pixel lists in compressed rows.
#[derive(Debug, Clone)]
pub struct LayerTile {
    /// Which pixels.
    pub rect: PixelRect,
    /// `area() + 1` offsets into `boundaries`, pixels row by row.
    pub offsets: Vec<u32>,
    /// Front to back within a pixel.
    pub boundaries: Vec<Boundary>,
}

impl LayerTile {
    /// A tile without a boundary.
    pub fn empty(rect: PixelRect) -> Self {
        Self { rect, offsets: vec![0; rect.area() + 1], boundaries: Vec::new() }
    }

    /// From boundaries with the pixels they belong to, counted row by row from the rectangle's corner. Pixels may come in
    /// any order; a pixel's own boundaries come front to back.
    pub fn from_placed(rect: PixelRect, placed: &[(u32, Boundary)]) -> Self {
        let mut offsets = vec![0_u32; rect.area() + 1];
        for (pixel, _) in placed {
            offsets[*pixel as usize + 1] += 1;
        }
        for i in 1..offsets.len() {
            offsets[i] += offsets[i - 1];
        }
        let Some(&(_, any)) = placed.first() else { return Self::empty(rect) };
        let mut boundaries = vec![any; placed.len()];
        let mut next = offsets.clone();
        for (pixel, boundary) in placed {
            let place = &mut next[*pixel as usize];
            boundaries[*place as usize] = *boundary;
            *place += 1;
        }
        Self { rect, offsets, boundaries }
    }

    /// The passes over one rectangle, a sample each, as one tile with sample masks.
    pub fn of_samples(rect: PixelRect, passes: &[Self]) -> Self {
        let mut merged = Self { rect, offsets: Vec::with_capacity(rect.area() + 1), boundaries: Vec::new() };
        merged.offsets.push(0);
        for y in rect.y0..rect.y1 {
            for x in rect.x0..rect.x1 {
                if passes.iter().any(|pass| !pass.at(x, y).is_empty()) {
                    let mut merger = SampleMerger::default();
                    passes.iter().for_each(|pass| merger.add(pass.at(x, y).iter().copied()));
                    merged.boundaries.extend(merger.finish());
                }
                merged.offsets.push(merged.boundaries.len() as u32);
            }
        }
        merged
    }

    /// The boundaries of the pixel at column `x`, row `y` of the *picture*, front to back.
    pub fn at(&self, x: u32, y: u32) -> &[Boundary] {
        let index = ((y - self.rect.y0) * self.rect.width() + (x - self.rect.x0)) as usize;
        &self.boundaries[self.offsets[index] as usize..self.offsets[index + 1] as usize]
    }
}

/// Joins the boundaries that a pixel's samples see into records with sample masks: the same leaf, facing and body, in the
/// same order, are one boundary.
#[derive(Debug, Clone, Default)]
pub struct SampleMerger {
    records: Vec<Boundary>,
}

impl SampleMerger {
    /// Adds what one sample sees, front to back; each boundary's mask has that sample's bit alone.
    pub fn add(&mut self, of_sample: impl Iterator<Item = Boundary>) {
        let mut from = 0;
        for boundary in of_sample {
            let same = |r: &Boundary| {
                (r.leaf, r.facing, r.body) == (boundary.leaf, boundary.facing, boundary.body)
                    && r.samples & boundary.samples == 0
            };
            match self.records[from..].iter().position(same) {
                Some(ahead) => {
                    let record = &mut self.records[from + ahead];
                    // A running mean, so that a record is always what its samples so far see.
                    let share = 1.0 / (record.samples.count_ones() + 1) as f32;
                    record.depth += (boundary.depth - record.depth) * share;
                    record.normal += (boundary.normal - record.normal) * share;
                    record.opacity += (boundary.opacity - record.opacity) * share;
                    for (mean, c) in record.colour.iter_mut().zip(boundary.colour) {
                        *mean += (c - *mean) * share;
                    }
                    record.samples |= boundary.samples;
                    from += ahead + 1;
                }
                None => {
                    self.records.insert(from, boundary);
                    from += 1;
                }
            }
        }
    }

    /// The pixel's boundaries, front to back.
    pub fn finish(mut self) -> Vec<Boundary> {
        for record in &mut self.records {
            record.normal = record.normal.normalize_or_zero();
        }
        self.records.sort_by(|a, b| a.depth.total_cmp(&b.depth));
        self.records
    }
}

/// How many boundaries a pipeline hands over.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum LayerLimit {
    /// Only what an opaque picture needs of every sample: its boundaries down to the first opaque one.
    #[default]
    Nearest,
    /// All of them.
    All,
}

/// A pipeline, ready to draw one frame.
pub trait LayerSource: Sync {
    /// The camera, with the picture's size.
    fn camera(&self) -> &Camera;
    /// Samples a pixel, 1 to [`MAX_SAMPLES`]. A pixel whose samples all see the same is handed over with every bit set.
    fn samples(&self) -> u32;
    /// The boundaries of `rect`, which lies within the picture. The same bits whatever thread asks, and whatever tiles
    /// were asked for before.
    fn draw(&self, rect: PixelRect) -> LayerTile;
    /// Fills `tile` with what [`draw`](Self::draw) would show of `rect`, which lies within one tile of the picture, and with nothing
    /// around it. `false` where the source has no such short cut, or the layers are more than it holds; `tile` then holds
    /// nothing of use.
    fn draw_opaque(&self, _rect: PixelRect, _tile: &mut OpaqueTile) -> bool {
        false
    }
}

impl<S: LayerSource + ?Sized> LayerSource for Box<S> {
    fn camera(&self) -> &Camera {
        (**self).camera()
    }
    fn samples(&self) -> u32 {
        (**self).samples()
    }
    fn draw(&self, rect: PixelRect) -> LayerTile {
        (**self).draw(rect)
    }

    fn draw_opaque(&self, rect: PixelRect, tile: &mut OpaqueTile) -> bool {
        (**self).draw_opaque(rect, tile)
    }
}

impl<S: LayerSource + ?Sized> LayerSource for &S {
    fn camera(&self) -> &Camera {
        (**self).camera()
    }
    fn samples(&self) -> u32 {
        (**self).samples()
    }
    fn draw(&self, rect: PixelRect) -> LayerTile {
        (**self).draw(rect)
    }

    fn draw_opaque(&self, rect: PixelRect, tile: &mut OpaqueTile) -> bool {
        (**self).draw_opaque(rect, tile)
    }
}

/// A whole frame's tiles.
#[derive(Debug, Clone)]
pub struct LayerStack {
    /// The camera, with the picture's size.
    pub camera: Camera,
    /// Samples a pixel.
    pub samples: u32,
    tiles: Vec<LayerTile>,
}

impl LayerStack {
    /// Draws every tile of `source`, in parallel.
    pub fn collect(source: &dyn LayerSource) -> Self {
        let camera = source.camera().clone();
        let tiles = PixelRect::tiles(camera.width, camera.height, TILE_SIDE)
            .into_par_iter()
            .map(|rect| source.draw(rect))
            .collect();
        Self { camera, samples: source.samples(), tiles }
    }

    /// A stack whose every pixel `(column, row)` holds what `boundaries_at` returns, front to back: for pictures that do
    /// not come from a pipeline, such as those with a known answer.
    pub fn from_fn(camera: Camera, samples: u32, boundaries_at: impl Fn(u32, u32) -> Vec<Boundary> + Sync) -> Self {
        struct ByPixel<F>(Camera, u32, F);
        impl<F: Fn(u32, u32) -> Vec<Boundary> + Sync> LayerSource for ByPixel<F> {
            fn camera(&self) -> &Camera {
                &self.0
            }
            fn samples(&self) -> u32 {
                self.1
            }
            fn draw(&self, rect: PixelRect) -> LayerTile {
                let mut tile = LayerTile { rect, offsets: vec![0], boundaries: Vec::new() };
                for y in rect.y0..rect.y1 {
                    for x in rect.x0..rect.x1 {
                        tile.boundaries.extend((self.2)(x, y));
                        tile.offsets.push(tile.boundaries.len() as u32);
                    }
                }
                tile
            }
        }
        Self::collect(&ByPixel(camera, samples, boundaries_at))
    }

    /// The boundaries of the pixel at column `x`, row `y`, front to back.
    pub fn at(&self, x: u32, y: u32) -> &[Boundary] {
        let across = self.camera.width.div_ceil(TILE_SIDE);
        self.tiles[((y / TILE_SIDE) * across + x / TILE_SIDE) as usize].at(x, y)
    }

    /// The most boundaries any pixel has.
    pub fn depth_complexity(&self) -> usize {
        let longest = |tile: &LayerTile| tile.offsets.windows(2).map(|w| (w[1] - w[0]) as usize).max().unwrap_or(0);
        self.tiles.iter().map(longest).max().unwrap_or(0)
    }

    /// The tiles, row by row.
    pub fn tiles(&self) -> &[LayerTile] {
        &self.tiles
    }
}

impl LayerSource for LayerStack {
    fn camera(&self) -> &Camera {
        &self.camera
    }

    fn samples(&self) -> u32 {
        self.samples
    }

    fn draw(&self, rect: PixelRect) -> LayerTile {
        let across = self.camera.width.div_ceil(TILE_SIDE);
        let tile = &self.tiles[(rect.y0 / TILE_SIDE * across + rect.x0 / TILE_SIDE) as usize];
        if tile.rect == rect {
            return tile.clone();
        }
        let mut part = LayerTile { rect, offsets: Vec::with_capacity(rect.area() + 1), boundaries: Vec::new() };
        part.offsets.push(0);
        for y in rect.y0..rect.y1 {
            for x in rect.x0..rect.x1 {
                part.boundaries.extend_from_slice(self.at(x, y));
                part.offsets.push(part.boundaries.len() as u32);
            }
        }
        part
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_stand_one_to_a_row_and_column_around_the_centre() {
        assert_eq!(sample_offsets(1), [DVec2::splat(0.5)]);
        for n in 1..=MAX_SAMPLES {
            let offsets = sample_offsets(n);
            assert_eq!(offsets.len(), n as usize);
            for axis in 0..2 {
                let mut cells: Vec<u32> = offsets.iter().map(|p| (p[axis] * f64::from(n)) as u32).collect();
                cells.sort_unstable();
                assert_eq!(cells, (0..n).collect::<Vec<_>>());
            }
            let mean = offsets.iter().sum::<DVec2>() / f64::from(n);
            assert!((mean - 0.5).length() < 1e-12);
        }
        // The rotated grid of four.
        let nearest = |n: u32| {
            let offsets = sample_offsets(n);
            let pairs = offsets.iter().enumerate().flat_map(|(i, a)| offsets[..i].iter().map(|b| a.distance(*b)));
            pairs.fold(f64::INFINITY, f64::min)
        };
        assert!((nearest(4) - 5f64.sqrt() / 4.0).abs() < 1e-12);
    }
}
