//! The layers of a strip of the picture as an edge detector sees them: every boundary with the slope of its tangent plane.

use glam::Vec3;
use rayon::prelude::*;

use crate::layers::{Facing, LayerTile, TILE_SIDE, sample_offsets};
use crate::space::{Camera, PixelRect, Projection};

/// A surface seen at a grazing angle steps by at most so many footprints a pixel: its true slope has no limit, and what it
/// predicts beyond this is worth nothing.
const STEEPEST: f32 = 50.0;

/// A boundary at one pixel.
#[derive(Debug, Clone, Copy)]
pub(super) struct Facet {
    /// Planar view depth, world units.
    pub depth: f32,
    /// Pixels to a world unit at that depth.
    pub px_per_unit: f32,
    /// How many footprints deeper the tangent plane is one pixel to the right, and one pixel down.
    pub step: [f32; 2],
    /// Outward unit normal of the result, world space.
    pub normal: Vec3,
    /// The result's.
    pub facing: Facing,
    /// Whose surface.
    pub leaf: u32,
}

impl Facet {
    /// How many footprints deeper `other` is.
    #[inline]
    pub fn deeper(&self, other: &Self) -> f32 {
        (other.depth - self.depth) * self.px_per_unit
    }
}

/// The facets of one tile, as its boundaries are listed, one sample's alone.
#[derive(Debug)]
struct Facets {
    rect: PixelRect,
    offsets: Vec<u32>,
    list: Vec<Facet>,
}

/// The facets of some rows of tiles.
#[derive(Debug)]
pub(super) struct FacetStrip {
    /// Tiles side by side.
    pub across: usize,
    /// First row of pixels.
    pub y0: u32,
    /// One past the last row.
    pub y1: u32,
    /// Pixels side by side.
    pub width: u32,
    tiles: Vec<Facets>,
}

impl FacetStrip {
    /// From `tiles`, row by row; at least one.
    pub fn new(tiles: &[&LayerTile], camera: &Camera, samples: u32) -> Self {
        let slopes = Slopes::new(camera);
        let sample = central_sample(samples);
        let facets: Vec<Facets> = tiles.par_iter().map(|tile| slopes.facets(tile, samples, sample)).collect();
        Self {
            across: camera.width.div_ceil(TILE_SIDE) as usize,
            y0: facets[0].rect.y0,
            y1: facets[facets.len() - 1].rect.y1,
            width: camera.width,
            tiles: facets,
        }
    }

    /// Tiles.
    pub fn len(&self) -> usize {
        self.tiles.len()
    }

    /// The pixels of tile `index`.
    pub fn rect(&self, index: usize) -> PixelRect {
        self.tiles[index].rect
    }

    /// The facets of a pixel, front to back; `None` outside of the strip.
    #[inline]
    pub fn at(&self, x: u32, y: u32) -> Option<&[Facet]> {
        if x >= self.width || y < self.y0 || y >= self.y1 {
            return None;
        }
        let tile = &self.tiles[((y - self.y0) / TILE_SIDE) as usize * self.across + (x / TILE_SIDE) as usize];
        let index = ((y - tile.rect.y0) * tile.rect.width() + (x - tile.rect.x0)) as usize;
        Some(&tile.list[tile.offsets[index] as usize..tile.offsets[index + 1] as usize])
    }
}

/// The sample nearest to a pixel's middle: lines are found in what it sees.
pub(super) fn central_sample(samples: u32) -> u32 {
    let from_middle = |i: &u32| (sample_offsets(samples)[*i as usize] - 0.5).length_squared();
    (0..samples.max(1)).min_by(|a, b| from_middle(a).total_cmp(&from_middle(b))).unwrap_or(0)
}

/// What a camera makes of normals.
struct Slopes {
    right: Vec3,
    down: Vec3,
    forward: Vec3,
    middle: [f32; 2],
    /// Perspective: tangent of a pixel. Orthographic: 0.
    tangent: f32,
    /// Perspective: pixels to a unit at depth 1. Orthographic: at any depth.
    focal: f32,
    perspective: bool,
}

impl Slopes {
    fn new(camera: &Camera) -> Self {
        let (tangent, focal, perspective) = match camera.projection {
            Projection::Perspective { focal_px } => ((1.0 / focal_px) as f32, focal_px as f32, true),
            Projection::Orthographic { px_per_unit } => (0.0, px_per_unit as f32, false),
        };
        Self {
            right: camera.right.as_vec3(),
            down: camera.down.as_vec3(),
            forward: camera.forward.as_vec3(),
            middle: [0.5 * camera.width as f32 - 0.5, 0.5 * camera.height as f32 - 0.5],
            tangent,
            focal,
            perspective,
        }
    }

    fn facets(&self, tile: &LayerTile, samples: u32, sample: u32) -> Facets {
        let rect = tile.rect;
        if tile.boundaries.is_empty() {
            return Facets { rect, offsets: vec![0; rect.area() + 1], list: Vec::new() };
        }
        let mut list = Vec::with_capacity(tile.boundaries.len());
        let mut offsets = Vec::with_capacity(rect.area() + 1);
        offsets.push(0);
        let mut pixel = 0;
        for y in rect.y0..rect.y1 {
            let v = (y as f32 - self.middle[1]) * self.tangent;
            for x in rect.x0..rect.x1 {
                let u = (x as f32 - self.middle[0]) * self.tangent;
                let towards = self.forward + self.right * u + self.down * v;
                let of_pixel = tile.offsets[pixel] as usize..tile.offsets[pixel + 1] as usize;
                pixel += 1;
                for boundary in &tile.boundaries[of_pixel] {
                    if samples > 1 && boundary.samples >> sample & 1 == 0 {
                        continue;
                    }
                    let normal = boundary.normal;
                    // The plane through z·d with normal n holds z'·d' where z' (n·d') = z (n·d), and d' = d + right/f.
                    let along = normal.dot(towards);
                    // (x / (x² + e²) is at most 1 / 2e.)
                    let per_along = -along / (along * along + 0.25 / (STEEPEST * STEEPEST));
                    let px_per_unit = if self.perspective { self.focal / boundary.depth } else { self.focal };
                    list.push(Facet {
                        depth: boundary.depth,
                        px_per_unit,
                        step: [normal.dot(self.right) * per_along, normal.dot(self.down) * per_along],
                        normal,
                        facing: boundary.facing,
                        leaf: boundary.leaf,
                    });
                }
                offsets.push(list.len() as u32);
            }
        }
        Facets { rect, offsets, list }
    }
}
