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

use fearless_simd::Level;
use fearless_simd::prelude::*;
use glam::Vec2;

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

    /// Darkens the lit colours of tile `index`, in the order of its boundaries.
    pub fn darken(&self, strip: &Strip, index: usize, lit: &mut [[f32; 4]]) {
        let tile = &strip.tiles[index];
        if tile.boundaries.is_empty() {
            return;
        }
        let depths = Depths::new(strip, index);
        let across = tile.rect.width() as usize;
        let mut layer = 0;
        // The nearest boundaries of a row, then those behind them, and so on.
        loop {
            let mut deeper = false;
            for (row, offsets) in tile.offsets[..tile.offsets.len() - 1].chunks_exact(across).enumerate() {
                let y = tile.rect.y0 + row as u32;
                let mut asking = Row::default();
                let mut numbers = [usize::MAX; SIDE];
                let mut any = false;
                for (column, number) in numbers[..across].iter_mut().enumerate() {
                    let pixel = row * across + column;
                    let i = offsets[column] as usize + layer;
                    if i >= tile.offsets[pixel + 1] as usize {
                        continue;
                    }
                    (any, *number) = (true, i);
                    deeper |= i + 1 < tile.offsets[pixel + 1] as usize;
                    let boundary = &tile.boundaries[i];
                    let [right, down] = self.slopes.step(boundary.normal, tile.rect.x0 + column as u32, y);
                    (asking.right[column], asking.down[column]) = (right, down);
                    asking.depth[column] = boundary.depth;
                    asking.px_per_unit[column] = self.slopes.px_per_unit(boundary.depth);
                }
                if any {
                    let lights = self.lights(&asking, &depths, row as u32);
                    for (number, light) in numbers.iter().zip(lights).filter(|(number, _)| **number != usize::MAX) {
                        lit[*number][..3].iter_mut().for_each(|c| *c *= light);
                    }
                }
            }
            if !deeper {
                break;
            }
            layer += 1;
        }
    }

    /// The share of its light that each surface of row `row` of a tile keeps.
    fn lights(&self, asking: &Row, depths: &Depths, row: u32) -> [f32; SIDE] {
        fearless_simd::dispatch!(self.level, simd => simd.vectorize(#[inline(always)] || self.lights_of(asking, depths, row)))
    }

    #[inline(always)]
    fn lights_of(&self, asking: &Row, depths: &Depths, row: u32) -> [f32; SIDE] {
        let first = depths.index(0, row);
        let mut hidden = [0.0f32; SIDE];
        for direction in &self.around {
            let mut highest = [0.0f32; SIDE];
            for neighbour in direction {
                let there = first.wrapping_add_signed(neighbour.offset);
                let there = &depths.nearest[there..there + SIDE];
                let (ahead, below) = (neighbour.at.x, neighbour.at.y);
                for column in 0..SIDE {
                    let deeper = (there[column] - asking.depth[column]) * asking.px_per_unit[column];
                    let plane = asking.right[column] * ahead + asking.down[column] * below;
                    let height = (plane - deeper) * neighbour.per_distance;
                    // Of what may be another body a part counts, so that no border shows where it begins to be.
                    let same = (ANOTHER_BODY - height) * (1.0 / (ANOTHER_BODY - MAYBE_ANOTHER_BODY));
                    let counted = same.clamp(0.0, 1.0) * height;
                    highest[column] = if counted > highest[column] { counted } else { highest[column] };
                }
            }
            for column in 0..SIDE {
                let height = highest[column];
                let sine = height / (1.0 + height * height).sqrt();
                hidden[column] += if height > LEAST_HEIGHT { sine } else { 0.0 };
            }
        }
        hidden.map(|hidden| 1.0 - self.strength * hidden / DIRECTIONS as f32)
    }
}

/// Pixels of a tile's row.
const SIDE: usize = TILE_SIDE as usize;

/// The surfaces of a row that ask for their sky.
struct Row {
    depth: [f32; SIDE],
    px_per_unit: [f32; SIDE],
    /// The tangent plane's steps.
    right: [f32; SIDE],
    down: [f32; SIDE],
}

impl Default for Row {
    fn default() -> Self {
        Self { depth: [0.0; SIDE], px_per_unit: [0.0; SIDE], right: [0.0; SIDE], down: [0.0; SIDE] }
    }
}

/// A pixel that is asked.
pub(crate) struct Neighbour {
    /// In pixels from the one that asks.
    pub(crate) at: Vec2,
    pub(crate) per_distance: f32,
    /// In [`Depths`].
    offset: isize,
}

pub(crate) fn neighbours(camera: &Camera) -> Vec<[Neighbour; RINGS.len()]> {
    let reach = (REACH_SHARE * camera.width.min(camera.height) as f32).clamp(REACH_PX[0], REACH_PX[1]);
    let of_direction = |direction: usize| {
        // Half a step off the axes, along which pixels of a border lie in a row.
        let turn = (direction as f32 + 0.5) / DIRECTIONS as f32;
        RINGS.map(|share| {
            let at = (Vec2::from_angle(turn * std::f32::consts::TAU) * (reach * share).max(1.5)).round();
            let offset = at.y as isize * Depths::ACROSS as isize + at.x as isize;
            Neighbour { at, per_distance: 1.0 / at.length(), offset }
        })
    };
    (0..DIRECTIONS).map(of_direction).collect()
}

/// The nearest depths of a tile and around it; +∞ where nothing is.
struct Depths {
    nearest: Vec<f32>,
}

impl Depths {
    const REACH: usize = REACH_PX[1] as usize + 1;
    const ACROSS: usize = TILE_SIDE as usize + 2 * Self::REACH;

    fn index(&self, column: u32, row: u32) -> usize {
        (row as usize + Self::REACH) * Self::ACROSS + column as usize + Self::REACH
    }

    fn new(strip: &Strip, index: usize) -> Self {
        let own = strip.tiles[index].rect;
        let mut nearest = vec![f32::INFINITY; Self::ACROSS * Self::ACROSS];
        let (x0, y0) = (own.x0 as i32 - Self::REACH as i32, own.y0 as i32 - Self::REACH as i32);
        let (x1, y1) = (x0 + Self::ACROSS as i32, y0 + Self::ACROSS as i32);
        for tile in strip.around(index).map(|near| &strip.tiles[near]) {
            let rect = tile.rect;
            for y in (rect.y0 as i32).max(y0)..(rect.y1 as i32).min(y1) {
                for x in (rect.x0 as i32).max(x0)..(rect.x1 as i32).min(x1) {
                    let pixel = ((y as u32 - rect.y0) * rect.width() + (x as u32 - rect.x0)) as usize;
                    let of_pixel = tile.offsets[pixel] as usize..tile.offsets[pixel + 1] as usize;
                    if let Some(first) = tile.boundaries[of_pixel].iter().find(|boundary| boundary.opacity > 0.0) {
                        nearest[(y - y0) as usize * Self::ACROSS + (x - x0) as usize] = first.depth;
                    }
                }
            }
        }
        Self { nearest }
    }
}
