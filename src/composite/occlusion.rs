//! Shade in hollows: what a surface's neighbours on the screen keep from it of the light from all around.
//!
//! *Theory.* Horizon-based ambient occlusion on the screen (Bavoil, Sainz and Dimitrov 2008), with the reading of eye-dome
//! lighting (Boucheny 2009) that depth alone is asked: in each direction the neighbour that stands highest over the pixel's
//! tangent plane, as an angle, hides the sky below it. A scan has no ambient light of its own to show its small relief by, and
//! its normals are smoothed; depth still has it.
//!
//! *Changes.* A direction hides the sine of its horizon's angle and not the sine's square, which is what a diffuse surface would
//! lose: relief of a few degrees is what this is for. Heights are over the tangent plane and not over the pixel's depth, so that a
//! slanted plane is not grey. What stands far in front is another body, which hides little of the sky: it does not count, and
//! bodies throw no halo on what is behind them.
//!
//! *Practice.* Heights and distances are in footprints: the shade does not change with the zoom, and with the picture's size
//! only where the reach meets its limit. Each boundary is shaded by itself, before layers and samples are blended; what is
//! asked is the nearest surface that is not clear.

use fearless_simd::prelude::*;
use fearless_simd::{Level, Simd, f32x8};
use glam::Vec2;
use rayon::prelude::*;

use super::facets::Slopes;
use super::strip::Strip;
use crate::layers::TILE_SIDE;
use crate::space::Camera;

/// Directions in which neighbours are asked.
pub(crate) const DIRECTIONS: usize = 8;
/// How far, as shares of the reach.
pub(crate) const RINGS: [f32; 4] = [0.06, 0.2, 0.5, 1.0];
/// The reach as a share of the picture's shorter side…
const REACH_SHARE: f32 = 0.1;
/// …in pixels at least and at most: tiles beside a tile are all that it can look into.
const REACH_PX: [f32; 2] = [6.0, 56.0];
/// What stands higher than this over the tangent plane, in units of its distance, is another body…
pub(crate) const ANOTHER_BODY: f32 = 3.0;
/// …and what stands higher than this begins to be.
pub(crate) const MAYBE_ANOTHER_BODY: f32 = 2.2;
/// A neighbour lower than this over the plane is noise or the surface's own bend.
pub(crate) const LEAST_HEIGHT: f32 = 0.03;

const _: () = assert!(REACH_PX[1] < TILE_SIDE as f32);

/// Darkens surfaces where their neighbours hide the sky.
pub(super) struct Shade {
    level: Level,
    slopes: Slopes,
    strength: f32,
    /// By direction, the nearest ring first.
    around: Vec<[Neighbour; RINGS.len()]>,
}

impl Shade {
    /// For pictures of `camera`; at a `strength` of 1 a surface loses the share of its light that its sky loses.
    pub fn new(camera: &Camera, strength: f32) -> Self {
        Self { level: Level::new(), slopes: Slopes::new(camera), strength, around: neighbours(camera) }
    }

    /// Darkens the lit colours of tile `index` of `strip`, in the order of its boundaries; `depths` are the strip's.
    pub fn darken(&self, strip: &Strip, index: usize, depths: &Depths, lit: &mut [[f32; 4]]) {
        let tile = &strip.tiles[index];
        if tile.boundaries.is_empty() {
            return;
        }
        let around = depths.around(&self.around);
        let across = tile.rect.width() as usize;
        let mut layer = 0;
        // The nearest boundaries of a row, then those behind them, and so on.
        loop {
            let mut deeper = false;
            for (row, offsets) in tile.offsets.windows(across + 1).step_by(across).enumerate() {
                let y = tile.rect.y0 + row as u32;
                for first in (0..across).step_by(LANES) {
                    let mut asking = Asking::default();
                    let mut numbers = [usize::MAX; LANES];
                    let mut any = false;
                    let of_pixels = offsets[first..across.min(first + LANES) + 1].windows(2);
                    for (lane, of_pixel) in of_pixels.enumerate() {
                        let i = of_pixel[0] as usize + layer;
                        if i >= of_pixel[1] as usize {
                            continue;
                        }
                        any = true;
                        numbers[lane] = i;
                        deeper |= i + 1 < of_pixel[1] as usize;
                        let boundary = &tile.boundaries[i];
                        let x = tile.rect.x0 + (first + lane) as u32;
                        let [right, down] = self.slopes.step(boundary.normal, x, y);
                        (asking.right[lane], asking.down[lane]) = (right, down);
                        asking.depth[lane] = boundary.depth;
                        asking.px_per_unit[lane] = self.slopes.px_per_unit(boundary.depth);
                    }
                    if any {
                        let lights = self.lights(&asking, &around, depths.from(tile.rect.x0 + first as u32, y));
                        for (number, light) in numbers.iter().zip(lights).filter(|(number, _)| **number != usize::MAX) {
                            lit[*number][..3].iter_mut().for_each(|c| *c *= light);
                        }
                    }
                }
            }
            if !deeper {
                break;
            }
            layer += 1;
        }
    }

    /// The share of its light that each surface of `asking` keeps; `nearest` are the depths from the first neighbour of the first of
    /// them on.
    fn lights(&self, asking: &Asking, around: &[[Place; RINGS.len()]], nearest: &[f32]) -> [f32; LANES] {
        fearless_simd::dispatch!(self.level, simd => simd.vectorize(
            #[inline(always)]
            || self.lights_of(simd, asking, around, nearest),
        ))
    }

    #[inline(always)]
    fn lights_of<S: Simd>(
        &self,
        simd: S,
        asking: &Asking,
        around: &[[Place; RINGS.len()]],
        nearest: &[f32],
    ) -> [f32; LANES] {
        let load = |of: &[f32; LANES]| f32x8::from_slice(simd, of);
        let (depth, px_per_unit) = (load(&asking.depth), load(&asking.px_per_unit));
        let (right, down) = (load(&asking.right), load(&asking.down));
        let zero = f32x8::splat(simd, 0.0);
        let mut hidden = zero;
        for direction in around {
            let mut highest = zero;
            for place in direction {
                let there = f32x8::from_slice(simd, &nearest[place.offset..place.offset + LANES]);
                let deeper = (there - depth) * px_per_unit;
                let plane = right * place.at.x + down * place.at.y;
                let height = (plane - deeper) * place.per_distance;
                // Of what may be another body a part counts, so that no border shows where it begins to be.
                let same = (-height + ANOTHER_BODY) * (1.0 / (ANOTHER_BODY - MAYBE_ANOTHER_BODY));
                let counted = same.max(0.0).min(1.0) * height;
                highest = counted.simd_gt(highest).select(counted, highest);
            }
            let sine = highest / (highest * highest + 1.0).sqrt();
            hidden += highest.simd_gt(LEAST_HEIGHT).select(sine, zero);
        }
        let lost: [f32; LANES] = (hidden * self.strength / DIRECTIONS as f32).into();
        lost.map(|lost| 1.0 - lost)
    }
}

/// Surfaces that ask for their sky at once.
const LANES: usize = 8;

/// The surfaces of some pixels side by side.
#[derive(Default)]
struct Asking {
    depth: [f32; LANES],
    px_per_unit: [f32; LANES],
    /// The tangent plane's steps.
    right: [f32; LANES],
    down: [f32; LANES],
}

/// A pixel that is asked.
pub(crate) struct Neighbour {
    /// In pixels from the one that asks.
    pub(crate) at: Vec2,
    pub(crate) per_distance: f32,
}

/// The pixels that are asked, by direction and the nearest first.
pub(crate) fn neighbours(camera: &Camera) -> Vec<[Neighbour; RINGS.len()]> {
    let reach = (REACH_SHARE * camera.width.min(camera.height) as f32).clamp(REACH_PX[0], REACH_PX[1]);
    let of_direction = |direction: usize| {
        // Half a step off the axes, along which pixels of a border lie in a row.
        let turn = (direction as f32 + 0.5) / DIRECTIONS as f32;
        RINGS.map(|share| {
            let at = (Vec2::from_angle(turn * std::f32::consts::TAU) * (reach * share).max(1.5)).round();
            Neighbour { at, per_distance: 1.0 / at.length() }
        })
    };
    (0..DIRECTIONS).map(of_direction).collect()
}

/// A [`Neighbour`] in [`Depths`].
struct Place {
    at: Vec2,
    per_distance: f32,
    /// From the pixel that is [`Depths::REACH`] pixels before the one that asks, in rows and columns.
    offset: usize,
}

/// The nearest depths of a strip, and nothing around it; +∞ where nothing is.
pub(super) struct Depths {
    nearest: Vec<f32>,
    across: usize,
    /// The first row of pixels.
    y0: u32,
}

impl Depths {
    /// How far beyond the strip lookups reach.
    const REACH: usize = REACH_PX[1] as usize + 1;

    /// Of `strip`.
    pub fn new(strip: &Strip) -> Self {
        let (first, last) = (strip.tiles[0].rect, strip.tiles[strip.tiles.len() - 1].rect);
        // The last pixels that ask are as many as ever, whether the picture has them or not.
        let across = (last.x1 as usize).next_multiple_of(LANES) + 2 * Self::REACH;
        let rows = (last.y1 - first.y0) as usize;
        let mut nearest = vec![f32::INFINITY; across * (rows + 2 * Self::REACH)];
        let of_strip = &mut nearest[Self::REACH * across..(Self::REACH + rows) * across];
        let side = TILE_SIDE as usize;
        of_strip.par_chunks_mut(across * side).zip(strip.tiles.par_chunks(strip.across)).for_each(|(of_row, tiles)| {
            for (row, nearest) in of_row.chunks_mut(across).enumerate() {
                for tile in tiles.iter().filter(|tile| !tile.boundaries.is_empty()) {
                    let width = tile.rect.width() as usize;
                    let offsets = &tile.offsets[row * width..=(row + 1) * width];
                    let first = Self::REACH + tile.rect.x0 as usize;
                    for (nearest, of_pixel) in nearest[first..first + width].iter_mut().zip(offsets.windows(2)) {
                        let of_pixel = &tile.boundaries[of_pixel[0] as usize..of_pixel[1] as usize];
                        if let Some(first) = of_pixel.iter().find(|boundary| boundary.opacity > 0.0) {
                            *nearest = first.depth;
                        }
                    }
                }
            }
        });
        Self { nearest, across, y0: first.y0 }
    }

    /// Where `neighbours` are from the pixel that is [`REACH`](Self::REACH) pixels before the one that asks, in rows and columns.
    fn around(&self, neighbours: &[[Neighbour; RINGS.len()]]) -> Vec<[Place; RINGS.len()]> {
        let place = |neighbour: &Neighbour| {
            let along = |at: f32| (Self::REACH as isize + at as isize) as usize;
            let offset = along(neighbour.at.y) * self.across + along(neighbour.at.x);
            Place { at: neighbour.at, per_distance: neighbour.per_distance, offset }
        };
        neighbours.iter().map(|direction| direction.each_ref().map(place)).collect()
    }

    /// From the pixel that is [`REACH`](Self::REACH) pixels before (`x`, `y`), in rows and columns, on.
    fn from(&self, x: u32, y: u32) -> &[f32] {
        &self.nearest[(y - self.y0) as usize * self.across + x as usize..]
    }
}
