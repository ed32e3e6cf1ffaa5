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

use glam::Vec2;

use super::facets::Slopes;
use super::strip::Strip;
use crate::layers::TILE_SIDE;
use crate::space::Camera;

/// Directions in which neighbours are asked.
const DIRECTIONS: usize = 8;
/// How far, as shares of the reach.
const RINGS: [f32; 4] = [0.06, 0.2, 0.5, 1.0];
/// The reach as a share of the picture's shorter side…
const REACH_SHARE: f32 = 0.1;
/// …in pixels at least and at most: tiles beside a tile are all that it can look into.
const REACH_PX: [f32; 2] = [6.0, 56.0];
/// What stands higher than this over the tangent plane, in units of its distance, is another body…
const ANOTHER_BODY: f32 = 3.0;
/// …and what stands higher than this begins to be.
const MAYBE_ANOTHER_BODY: f32 = 2.2;
/// A neighbour lower than this over the plane is noise or the surface's own bend.
const LEAST_HEIGHT: f32 = 0.03;

const _: () = assert!(REACH_PX[1] < TILE_SIDE as f32);

/// Darkens surfaces where their neighbours hide the sky.
pub(super) struct Shade {
    slopes: Slopes,
    strength: f32,
    /// By direction, the nearest ring first.
    around: Vec<[Neighbour; RINGS.len()]>,
}

impl Shade {
    /// For pictures of `camera`; at a `strength` of 1 a surface loses the share of its light that its sky loses.
    pub fn new(camera: &Camera, strength: f32) -> Self {
        Self { slopes: Slopes::new(camera), strength, around: neighbours(camera) }
    }

    /// Darkens the lit colours of tile `index`, in the order of its boundaries.
    pub fn darken(&self, strip: &Strip, index: usize, lit: &mut [[f32; 4]]) {
        let tile = &strip.tiles[index];
        if tile.boundaries.is_empty() {
            return;
        }
        let depths = Depths::new(strip, index);
        for (pixel, of_pixel) in tile.offsets.windows(2).enumerate() {
            let (column, row) = (pixel as u32 % tile.rect.width(), pixel as u32 / tile.rect.width());
            let at = depths.index(column, row);
            let of_pixel = of_pixel[0] as usize..of_pixel[1] as usize;
            for (boundary, lit) in tile.boundaries[of_pixel.clone()].iter().zip(&mut lit[of_pixel]) {
                let step = Vec2::from(self.slopes.step(boundary.normal, tile.rect.x0 + column, tile.rect.y0 + row));
                let per_footprint = self.slopes.px_per_unit(boundary.depth);
                let mut hidden = 0.0;
                for direction in &self.around {
                    let mut highest = 0.0f32;
                    for neighbour in direction {
                        let there = depths.nearest[at.wrapping_add_signed(neighbour.offset)];
                        let deeper = (there - boundary.depth) * per_footprint;
                        let height = (step.dot(neighbour.at) - deeper) * neighbour.per_distance;
                        // Of what may be another body a part counts, so that no border shows where it begins to be.
                        let same = ((ANOTHER_BODY - height) / (ANOTHER_BODY - MAYBE_ANOTHER_BODY)).clamp(0.0, 1.0);
                        highest = highest.max(same * height);
                    }
                    if highest > LEAST_HEIGHT {
                        hidden += highest / (1.0 + highest * highest).sqrt();
                    }
                }
                let light = 1.0 - self.strength * hidden / self.around.len() as f32;
                lit[..3].iter_mut().for_each(|c| *c *= light);
            }
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

fn neighbours(camera: &Camera) -> Vec<[Neighbour; RINGS.len()]> {
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
