//! The sketchy style: lines and surfaces drawn by a loose hand.
//!
//! *Theory.* Sketchy CSG §4 to §6: a pixel looks up its layer's edge map and its shade map not at itself but at two places
//! beside it, `p + E·n(p)` and `p + S·n(p)`, where `n` is smooth noise of two values and E and S are 2×2 matrices: edges
//! and surfaces move apart. Its depth is the nearer of the depths at the two places, so that the drawing still stands in
//! front of and behind other content as the body does. All layers use one noise, so what coincides in two layers still
//! coincides in the drawing.
//!
//! *Practice.* The noise belongs to the picture: it stands still while the scene moves, and a line that moves by a pixel is
//! moved on by at most the noise's slope, [`SketchSettings`]'s offset over its wavelength. It changes over tens of pixels,
//! so it is computed on a coarse grid and interpolated. Lookups are bilinear in premultiplied colour, or the border of a
//! surface would be jagged. Surfaces at the two places are lit where they are, not where they are drawn.

use fearless_simd::Level;
use fearless_simd::prelude::*;
use glam::{Vec2, Vec4};

use super::Look;
use super::canvas::TileRows;
use super::layered::{Gathered, Inks, from_strips};
use super::lighting::Shader;
use super::noise::Perlin;
use super::picture::Picture;
use super::shaded::over;
use super::shadow::Shadows;
use super::strip::Strip;
use super::window::{Bounds, Tap, Window};
use crate::layers::LayerSource;
use crate::scene::style::{SketchSettings, Style};
use crate::space::PixelRect;

/// Pixels between the places where the noise is computed.
pub(crate) const NOISE_GRID_PX: u32 = 8;
/// The second value of the noise is the same noise this far away, in wavelengths.
const SECOND_VALUE: Vec2 = Vec2::new(57.3, 131.7);
/// A position of the largest picture is off by less than this, rounded to 32 bits.
const ROUNDING_PX: f32 = 0.125;

/// Draws the layers of `source` sketchily. `heavy` says by leaf whether its outline is drawn stronger; `shadows` fall
/// on its surfaces.
pub(super) fn sketchy(
    source: &dyn LayerSource,
    look: &Look,
    style: &Style,
    heavy: &[bool],
    shadows: Option<&Shadows>,
    on_tile: &(dyn Fn() + Sync),
) -> Picture {
    let shader = Shader::new(&look.light, source.camera());
    let inks = Inks::new(style, look.background);
    let samples = source.samples();
    let hand = Hand::new(&style.sketch);
    let surfaces = |strip: &Strip| {
        let suns = inks.suns(strip, 0..strip.tiles.len(), shadows, source);
        inks.of_strip(strip, &shader, samples, &suns)
    };
    let level = Level::new();
    from_strips(source, look, style, heavy, on_tile, surfaces, |strip, surfaces, index, rows| {
        let rect = strip.tiles[index].rect;
        let covered = strip.tiles[index].offsets.windows(2).filter(|w| w[0] < w[1]).count() as u64;
        if strip.around(index).all(|tile| strip.is_empty(tile)) {
            rows.clear(look.background);
            return covered;
        }
        let offsets = hand.offsets(level, rect);
        let window = Window::new(strip, index, offsets.bounds, surfaces, false);
        fearless_simd::dispatch!(level, simd => simd.vectorize(
            #[inline(always)]
            || draw(&window, &offsets, rect, &inks, look.background, rows),
        ));
        covered
    })
}

/// Draws the pixels of `rect` and their depths, looked up in `window`, into `rows`.
#[inline(always)]
fn draw(window: &Window, offsets: &Offsets, rect: PixelRect, inks: &Inks, background: [f32; 4], rows: &mut TileRows) {
    let (nothing, _) = Gathered::new().finish(background);
    let mut number = 0;
    for ((pixels, depths), y) in rows.pixels.iter_mut().zip(&mut rows.depth).zip(rect.y0..) {
        for ((pixel, depth), x) in pixels.iter_mut().zip(depths.iter_mut()).zip(rect.x0..) {
            let [edge, shade] = offsets.at(number);
            number += 1;
            let at = Vec2::new(x as f32, y as f32);
            let (at_edge, at_shade) = (window.tap(at + edge), window.tap(at + shade));
            let (deepest, lined) = (window.deepest(&at_shade), window.lined(&at_edge));
            (*pixel, *depth) = if deepest == 0 && lined == 0 {
                (nothing, f32::INFINITY)
            } else if lined == 0 {
                bare(window, &at_edge, &at_shade, deepest, background)
            } else {
                inked(window, &at_edge, &at_shade, deepest.max(lined), inks, background)
            };
        }
    }
}

/// A pixel of `layers` layers, and its depth.
#[inline(never)]
fn inked(
    window: &Window,
    at_edge: &Tap,
    at_shade: &Tap,
    layers: usize,
    inks: &Inks,
    background: [f32; 4],
) -> ([f32; 4], f32) {
    let surfaces = window.surfaces(at_shade);
    let mut gathered = Gathered::new();
    for layer in 0..layers {
        let (ink, surface) = (window.ink(at_edge, layer), window.colour(&surfaces, layer));
        if ink > 0.0 || surface.w > 0.0 {
            let nearer = window.depth(at_edge, layer).min(window.depth(at_shade, layer));
            gathered.add(inks, ink, nearer, surface.to_array(), nearer);
            if gathered.is_opaque() {
                break;
            }
        } else {
            gathered.add(inks, 0.0, f32::INFINITY, [0.0; 4], f32::INFINITY);
        }
    }
    gathered.finish(background)
}

/// A pixel of which no line is looked up: what [`Gathered`] makes of it, which adds zeros for ink.
#[inline(always)]
fn bare(window: &Window, at_edge: &Tap, at_shade: &Tap, layers: usize, background: [f32; 4]) -> ([f32; 4], f32) {
    let surfaces = window.surfaces(at_shade);
    let (mut light, mut through, mut depth) = (Vec4::ZERO, 1.0, f32::INFINITY);
    for layer in 0..layers {
        let surface = window.colour(&surfaces, layer);
        let alpha = surface.w;
        if depth == f32::INFINITY && alpha > 0.0 {
            depth = window.depth(at_edge, layer).min(window.depth(at_shade, layer));
        }
        light += through * surface;
        through *= 1.0 - alpha;
        if through <= 0.0 {
            break;
        }
    }
    (over(light.truncate().to_array(), through, background), depth)
}

/// How far each pixel's lookups are off.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Hand {
    noise: Perlin,
    settings: SketchSettings,
}

impl Hand {
    pub fn new(settings: &SketchSettings) -> Self {
        Self { noise: Perlin::new(settings.seed), settings: *settings }
    }

    /// The noise at a position in the picture: two values of −1 to 1.
    pub fn noise_at(&self, at: Vec2) -> Vec2 {
        let p = at / self.settings.wavelength_px;
        Vec2::new(self.noise.at(p), self.noise.at(p + SECOND_VALUE))
    }

    /// The offsets in pixels of the edge and the shade lookup, for a noise value.
    #[cfg(feature = "gpu")]
    fn turned(&self, noise: Vec2) -> [Vec2; 2] {
        self.matrices().map(|matrix| held(times(matrix, noise)))
    }

    /// Of the edge and of the shade lookup.
    fn matrices(&self) -> [[[f32; 2]; 2]; 2] {
        [self.settings.edge_px, self.settings.shade_px]
    }

    /// The longest offset, in pixels.
    #[cfg(feature = "gpu")]
    pub fn reach_px(&self) -> u32 {
        let corners = [Vec2::ONE, Vec2::new(1.0, -1.0)];
        let longest = corners.into_iter().flat_map(|noise| self.turned(noise)).map(Vec2::length).fold(0.0, f32::max);
        longest.ceil() as u32
    }

    /// How far the lookups of the pixels of `rect` are off.
    pub(super) fn offsets(&self, level: Level, rect: PixelRect) -> Offsets {
        // Grid points lie at the same pixels whatever the tile.
        let first = |at: u32| at / NOISE_GRID_PX;
        let last = |end: u32| (end - 1) / NOISE_GRID_PX + 1;
        let (gx0, gy0, gx1, gy1) = (first(rect.x0), first(rect.y0), last(rect.x1), last(rect.y1));
        let mut grid = Grid { x0: gx0, y0: gy0, across: (gx1 - gx0 + 1) as usize, noise: Vec::new() };
        for gy in gy0..=gy1 {
            for gx in gx0..=gx1 {
                grid.noise.push(self.noise_at(Vec2::new((gx * NOISE_GRID_PX) as f32, (gy * NOISE_GRID_PX) as f32)));
            }
        }
        let mut offsets =
            Offsets { x: [Vec::new(), Vec::new()], y: [Vec::new(), Vec::new()], bounds: self.bounds(&grid, rect) };
        offsets.x.iter_mut().chain(&mut offsets.y).for_each(|along| along.reserve(rect.area()));
        fearless_simd::dispatch!(level, simd => simd.vectorize(
            #[inline(always)]
            || self.interpolate(&grid, rect, &mut offsets),
        ));
        offsets
    }

    /// The pixels that lookups from `rect` can meet.
    fn bounds(&self, grid: &Grid, rect: PixelRect) -> Bounds {
        // Between grid points offsets lie between theirs, and a long one that is held is on its way to none at all.
        let (mut low, mut high) = (Vec2::ZERO, Vec2::ZERO);
        for noise in &grid.noise {
            for matrix in self.matrices() {
                let offset = times(matrix, *noise);
                (low, high) = (low.min(offset), high.max(offset));
            }
        }
        let most = Vec2::splat(SketchSettings::MOST_OFFSET_PX);
        (low, high) = (low.max(-most), high.min(most));
        let along = |first: u32, end: u32, low: f32, high: f32| {
            // Two pixels are met, of which the second comes after the position's whole part.
            let (low, high) = (first as f32 + low - ROUNDING_PX, (end - 1) as f32 + high + ROUNDING_PX);
            (low.floor() as i32, high.floor() as i32 + 2)
        };
        Bounds { x: along(rect.x0, rect.x1, low.x, high.x), y: along(rect.y0, rect.y1, low.y, high.y) }
    }

    /// Appends the offsets of the pixels of `rect`, eight at a time: those between the same grid points.
    #[inline(always)]
    fn interpolate(&self, grid: &Grid, rect: PixelRect, offsets: &mut Offsets) {
        const CELL: usize = NOISE_GRID_PX as usize;
        const STEPS: [f32; CELL] = {
            let mut steps = [0.0; CELL];
            let mut i = 0;
            while i < CELL {
                steps[i] = i as f32 / CELL as f32;
                i += 1;
            }
            steps
        };
        for y in rect.y0..rect.y1 {
            let v = STEPS[(y % NOISE_GRID_PX) as usize];
            for (cell, [top, bottom]) in grid.cells(y).enumerate() {
                let x0 = (grid.x0 + cell as u32) * NOISE_GRID_PX;
                let (from, to) = (rect.x0.max(x0) - x0, rect.x1.min(x0 + NOISE_GRID_PX) - x0);
                let (mut n_x, mut n_y) = ([0.0; CELL], [0.0; CELL]);
                for i in 0..CELL {
                    let u = STEPS[i];
                    let noise = top[0].lerp(top[1], u).lerp(bottom[0].lerp(bottom[1], u), v);
                    (n_x[i], n_y[i]) = (noise.x, noise.y);
                }
                for (matrix, k) in self.matrices().into_iter().zip(0..) {
                    let (mut o_x, mut o_y, mut longest) = ([0.0; CELL], [0.0; CELL], 0.0_f32);
                    for i in 0..CELL {
                        let offset = times(matrix, Vec2::new(n_x[i], n_y[i]));
                        (o_x[i], o_y[i]) = (offset.x, offset.y);
                        longest = longest.max(offset.length_squared());
                    }
                    if longest > SketchSettings::MOST_OFFSET_PX * SketchSettings::MOST_OFFSET_PX {
                        for i in 0..CELL {
                            let held = held(Vec2::new(o_x[i], o_y[i]));
                            (o_x[i], o_y[i]) = (held.x, held.y);
                        }
                    }
                    offsets.x[k].extend_from_slice(&o_x[from as usize..to as usize]);
                    offsets.y[k].extend_from_slice(&o_y[from as usize..to as usize]);
                }
            }
        }
    }
}

/// The noise at grid points.
struct Grid {
    /// Of the first of them.
    x0: u32,
    y0: u32,
    across: usize,
    noise: Vec<Vec2>,
}

impl Grid {
    /// The noise at the corners of the cells that row `y` of the picture crosses: above it and below.
    #[inline(always)]
    fn cells(&self, y: u32) -> impl Iterator<Item = [[Vec2; 2]; 2]> {
        let row = (y / NOISE_GRID_PX - self.y0) as usize * self.across;
        let (above, below) = (&self.noise[row..row + self.across], &self.noise[row + self.across..][..self.across]);
        above.windows(2).zip(below.windows(2)).map(|(top, bottom)| [[top[0], top[1]], [bottom[0], bottom[1]]])
    }
}

/// How far the lookups of a rectangle's pixels are off, row by row.
pub(super) struct Offsets {
    /// Of the edge and of the shade lookup, in pixels.
    x: [Vec<f32>; 2],
    y: [Vec<f32>; 2],
    /// The pixels that they meet.
    pub bounds: Bounds,
}

impl Offsets {
    /// The offsets of the edge and the shade lookup of pixel number `pixel`.
    #[inline(always)]
    pub fn at(&self, pixel: usize) -> [Vec2; 2] {
        [0, 1].map(|k| Vec2::new(self.x[k][pixel], self.y[k][pixel]))
    }
}

/// `noise` turned by a matrix, given by its rows.
#[inline(always)]
fn times(rows: [[f32; 2]; 2], noise: Vec2) -> Vec2 {
    Vec2::new(Vec2::from(rows[0]).dot(noise), Vec2::from(rows[1]).dot(noise))
}

/// An offset no longer than the strips of tiles allow.
fn held(offset: Vec2) -> Vec2 {
    offset.clamp_length_max(SketchSettings::MOST_OFFSET_PX)
}
