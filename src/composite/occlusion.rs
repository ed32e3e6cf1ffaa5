//! Shade in hollows: what a surface's neighbours on the screen keep from it of the light from all around.
//!
//! *Theory.* Screen-space ambient occlusion, with the reading of eye-dome lighting (Boucheny 2009) that only depth is asked:
//! a neighbour at distance r on the screen that stands nearer than the pixel's tangent plane by h covers a part of its sky that
//! grows with h / r. A scan has no ambient light of its own to show its small relief by, and its normals are smoothed; depth
//! still has it.
//!
//! *Changes.* The neighbour is compared with the tangent plane and not with the pixel's depth, so that a slanted plane is not
//! grey. What stands far in front is another body, which hides little of the sky: it does not count, and bodies throw no halo
//! on what is behind them.
//!
//! *Practice.* Everything is in footprints, so the shade is the same at any size and zoom of a picture. Pixels at the border
//! of what is covered ask those that are; pixels that are covered in part are left as they are.

use glam::Vec2;

use super::Look;
use super::facets::Slopes;
use super::layered::{Composed, from_strips};
use super::picture::Picture;
use super::shaded::{Shader, blend_tile};
use super::strip::Strip;
use crate::layers::{LayerSource, MAX_SAMPLES};
use crate::scene::style::Style;
use crate::space::Camera;

/// Directions in which neighbours are asked.
const DIRECTIONS: usize = 8;
/// How far, as shares of the reach.
const RINGS: [f32; 3] = [0.2, 0.5, 1.0];
/// The reach as a share of the picture's shorter side…
const REACH_SHARE: f32 = 0.02;
/// …in pixels at least and at most.
const REACH_PX: [f32; 2] = [4.0, 24.0];
/// What stands higher than this over the tangent plane, in units of its distance, is another body.
const ANOTHER_BODY: f32 = 2.5;
/// A neighbour lower than this over the plane is noise or the surface's own bend.
const LEAST_HEIGHT: f32 = 0.06;
/// Full occlusion at full strength leaves this share of the light.
const DARKEST: f32 = 0.2;
/// Neighbours rarely cover more than this share of the sky, so that it stands for all of it.
const MOST_COVERED: f32 = 0.45;

/// Draws `source` shaded, with shade in hollows of the style's strength.
pub(super) fn occluded(
    source: &dyn LayerSource,
    look: &Look,
    style: &Style,
    strength: f32,
    on_tile: &(dyn Fn() + Sync),
) -> Picture {
    let (shader, samples) = (Shader::new(&look.light, source.camera()), source.samples());
    let shade = Shade::new(source, strength);
    from_strips(
        source,
        look,
        style,
        &[],
        on_tile,
        |_| (),
        |strip, (), index| {
            let tile = &strip.tiles[index];
            let blended = blend_tile(tile, samples, &shader, look.background);
            let (mut pixels, covered) = (blended.pixels, blended.covered);
            shade.of_tile(strip, index, |pixel, light| pixels[pixel][..3].iter_mut().for_each(|c| *c *= light));
            Composed { pixels, depth: Vec::new(), covered }
        },
    )
}

/// How much of the light from all around reaches each pixel's nearest surface.
pub(super) struct Shade {
    slopes: Slopes,
    around: Vec<Neighbour>,
    /// Bits of all samples.
    all: u16,
    /// From 0 to 1.
    strength: f32,
}

impl Shade {
    /// For pictures of `source`, of a strength from 0 to 1.
    pub fn new(source: &dyn LayerSource, strength: f32) -> Self {
        let camera = source.camera();
        let all = u16::MAX >> (MAX_SAMPLES - source.samples());
        Self { slopes: Slopes::new(camera), around: neighbours(camera), all, strength }
    }

    /// Calls `each` with every pixel of tile `index` that a surface covers, counted row by row, and the share of its light,
    /// from 0 to 1, that reaches it.
    pub fn of_tile(&self, strip: &Strip, index: usize, mut each: impl FnMut(usize, f32)) {
        let tile = &strip.tiles[index];
        if tile.boundaries.is_empty() {
            return;
        }
        let depths = Depths::new(strip, index);
        for (pixel, of_pixel) in tile.offsets.windows(2).enumerate() {
            if of_pixel[0] == of_pixel[1] {
                continue;
            }
            let first = &tile.boundaries[of_pixel[0] as usize];
            if first.samples & self.all != self.all {
                continue;
            }
            let (column, row) = (pixel as u32 % tile.rect.width(), pixel as u32 / tile.rect.width());
            let (x, y) = (tile.rect.x0 + column, tile.rect.y0 + row);
            let step = Vec2::from(self.slopes.step(first.normal, x, y));
            let per_footprint = self.slopes.px_per_unit(first.depth);
            let at = depths.index(column, row);
            let mut covered = 0.0;
            for neighbour in &self.around {
                let deeper = (depths.nearest[at.wrapping_add_signed(neighbour.offset)] - first.depth) * per_footprint;
                let height = (step.dot(neighbour.at) - deeper) * neighbour.per_distance;
                if height > LEAST_HEIGHT && height < ANOTHER_BODY {
                    // The share of a quarter circle above the horizon that a wall of this height hides.
                    let hidden = height / (1.0 + height);
                    covered += hidden * (1.0 - height / ANOTHER_BODY);
                }
            }
            let covered = (covered / (self.around.len() as f32 * MOST_COVERED)).min(1.0);
            each(pixel, 1.0 - self.strength * (1.0 - DARKEST) * covered);
        }
    }
}

/// A pixel that is asked.
struct Neighbour {
    /// In pixels from the one that asks.
    at: Vec2,
    per_distance: f32,
    /// In [`Depths`].
    offset: isize,
}

fn neighbours(camera: &Camera) -> Vec<Neighbour> {
    let reach = (REACH_SHARE * camera.width.min(camera.height) as f32).clamp(REACH_PX[0], REACH_PX[1]);
    let mut neighbours = Vec::new();
    for (ring, share) in RINGS.iter().enumerate() {
        for direction in 0..DIRECTIONS {
            // Every other ring is turned by half a step, so that no direction is asked twice.
            let turn = (direction as f32 + 0.5 * (ring % 2) as f32) / DIRECTIONS as f32;
            let at = (Vec2::from_angle(turn * std::f32::consts::TAU) * (reach * share).max(1.0)).round();
            let offset = at.y as isize * Depths::ACROSS as isize + at.x as isize;
            neighbours.push(Neighbour { at, per_distance: 1.0 / at.length(), offset });
        }
    }
    neighbours
}

/// The nearest depths of a tile and around it; +∞ where nothing is.
struct Depths {
    nearest: Vec<f32>,
}

impl Depths {
    const REACH: usize = REACH_PX[1] as usize + 1;
    const ACROSS: usize = crate::layers::TILE_SIDE as usize + 2 * Self::REACH;

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
                    let (from, to) = (tile.offsets[pixel], tile.offsets[pixel + 1]);
                    if from < to {
                        let place = (y - y0) as usize * Self::ACROSS + (x - x0) as usize;
                        nearest[place] = tile.boundaries[from as usize].depth;
                    }
                }
            }
        }
        Self { nearest }
    }
}
