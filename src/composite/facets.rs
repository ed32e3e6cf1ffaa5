//! The layers of a strip of the picture as an edge detector sees them: every boundary with the slope of its tangent plane.

use glam::Vec3;
use rayon::prelude::*;

use crate::layers::{Boundary, Facing, LayerTile, TILE_SIDE, sample_offsets};
use crate::space::{Camera, PixelRect, Projection};

/// A surface seen at a grazing angle steps by at most so many footprints a pixel: its true slope has no limit, and what it
/// predicts beyond this is worth nothing.
pub(crate) const STEEPEST: f32 = 50.0;

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

/// The facets of one tile, as its boundaries are listed, one sample's alone; an array for each of their values, so that many
/// are compared at once.
#[derive(Debug)]
pub(super) struct Facets {
    rect: PixelRect,
    /// `area + 1` offsets into the arrays, pixels row by row.
    pub offsets: Vec<u32>,
    depth: Vec<f32>,
    px_per_unit: Vec<f32>,
    step: [Vec<f32>; 2],
    normal: [Vec<f32>; 3],
    /// ±1, as [`Facing`].
    facing: Vec<f32>,
    leaf: Vec<u32>,
}

impl Facets {
    /// Facet number `i`.
    pub fn get(&self, i: usize) -> Facet {
        Facet {
            depth: self.depth[i],
            px_per_unit: self.px_per_unit[i],
            step: [self.step[0][i], self.step[1][i]],
            normal: Vec3::new(self.normal[0][i], self.normal[1][i], self.normal[2][i]),
            facing: if self.facing[i] > 0.0 { Facing::Front } else { Facing::Back },
            leaf: self.leaf[i],
        }
    }

    /// Whether each of the facets `a` of `self` goes on in the facet of `others` that has its place in `b`, which is as long:
    /// faces the same way, is at most `jump_px` and a share of the step off the tangent planes, and has a normal with at least
    /// `least_cos` to its own. `alike` gets the answers, 1 or 0.
    pub fn alike(
        &self,
        a: std::ops::Range<usize>,
        others: &Self,
        b: std::ops::Range<usize>,
        axis: usize,
        limits: &Limits,
        alike: &mut Vec<u8>,
    ) -> bool {
        let count = a.len();
        alike.clear();
        alike.resize(count, 0);
        // Slices of one known length: the loop is a vector loop.
        let (za, zb) = (&self.depth[a.clone()], &others.depth[b.clone()]);
        let (sa, sb) = (&self.step[axis][a.clone()], &others.step[axis][b.clone()]);
        let (fa, fb) = (&self.facing[a.clone()], &others.facing[b.clone()]);
        let [xa, ya, na] = [0, 1, 2].map(|k| &self.normal[k][a.clone()]);
        let [xb, yb, nb] = [0, 1, 2].map(|k| &others.normal[k][b.clone()]);
        let scale = &self.px_per_unit[a];
        let out = &mut alike[..count];
        let mut all = 1u8;
        for i in 0..count {
            let goes_on = limits.goes_on((zb[i] - za[i]) * scale[i], sa[i], sb[i]);
            let cos = xa[i] * xb[i] + ya[i] * yb[i] + na[i] * nb[i];
            let same = u8::from(goes_on) & u8::from(cos >= limits.least_cos) & u8::from(fa[i] == fb[i]);
            out[i] = same;
            all &= same;
        }
        all == 1
    }
}

/// When a surface goes on.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limits {
    /// Footprints that it may be off the tangent planes.
    pub jump_px: f32,
    /// Of the steps that the two tangent planes foresee, so much may be amiss too: what a curved surface does between two
    /// pixels.
    pub curved_share: f32,
    /// Least cosine between two normals.
    pub least_cos: f32,
}

impl Limits {
    /// Whether a surface goes on in a pixel where one is `deeper` by so many footprints, of the steps that each foresees.
    #[inline(always)]
    pub fn goes_on(&self, deeper: f32, step_a: f32, step_b: f32) -> bool {
        let amiss = (deeper - step_a).abs().min((deeper - step_b).abs());
        amiss <= self.jump_px + self.curved_share * step_a.abs().min(step_b.abs())
    }
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
            y0: tiles[0].rect.y0,
            y1: tiles[tiles.len() - 1].rect.y1,
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

    /// The facets of tile `index`.
    pub fn tile(&self, index: usize) -> &Facets {
        &self.tiles[index]
    }

    /// The facets of a pixel, front to back: those of a tile, and which; `None` outside of the strip.
    #[inline]
    pub fn at(&self, x: u32, y: u32) -> Option<(&Facets, std::ops::Range<usize>)> {
        if x >= self.width || y < self.y0 || y >= self.y1 {
            return None;
        }
        let index = ((y - self.y0) / TILE_SIDE) as usize * self.across + (x / TILE_SIDE) as usize;
        let (tile, rect) = (&self.tiles[index], self.rect(index));
        let pixel = ((y - rect.y0) * rect.width() + (x - rect.x0)) as usize;
        Some((tile, tile.offsets[pixel] as usize..tile.offsets[pixel + 1] as usize))
    }
}

/// The sample nearest to a pixel's middle: lines are found in what it sees.
pub(crate) fn central_sample(samples: u32) -> u32 {
    let from_middle = |i: &u32| (sample_offsets(samples)[*i as usize] - 0.5).length_squared();
    (0..samples.max(1)).min_by(|a, b| from_middle(a).total_cmp(&from_middle(b))).unwrap_or(0)
}

/// What a camera makes of normals.
pub(super) struct Slopes {
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
    /// As `camera` sees them.
    pub fn new(camera: &Camera) -> Self {
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

    /// How many footprints deeper the tangent plane with `normal` is one pixel to the right of pixel (`x`, `y`), and one down.
    pub fn step(&self, normal: Vec3, x: u32, y: u32) -> [f32; 2] {
        let u = (x as f32 - self.middle[0]) * self.tangent;
        let v = (y as f32 - self.middle[1]) * self.tangent;
        self.step_along(normal, self.forward + self.right * u + self.down * v)
    }

    /// The same where the ray goes `towards`, one unit forward.
    #[inline(always)]
    fn step_along(&self, normal: Vec3, towards: Vec3) -> [f32; 2] {
        // The plane through z·d with normal n holds z'·d' where z' (n·d') = z (n·d), and d' = d + right/f.
        let along = normal.dot(towards);
        // (x / (x² + e²) is at most 1 / 2e.)
        let per_along = -along / (along * along + 0.25 / (STEEPEST * STEEPEST));
        [normal.dot(self.right) * per_along, normal.dot(self.down) * per_along]
    }

    /// Pixels to a world unit at `depth`.
    #[inline(always)]
    pub fn px_per_unit(&self, depth: f32) -> f32 {
        if self.perspective { self.focal / depth } else { self.focal }
    }

    fn facets(&self, tile: &LayerTile, samples: u32, sample: u32) -> Facets {
        let rect = tile.rect;
        let is_seen = |boundary: &Boundary| samples <= 1 || boundary.samples >> sample & 1 == 1;
        let offsets = if samples <= 1 {
            tile.offsets.clone()
        } else {
            let mut seen = 0;
            let of_pixel = |pixel: &[u32]| {
                let boundaries = &tile.boundaries[pixel[0] as usize..pixel[1] as usize];
                seen += boundaries.iter().filter(|boundary| is_seen(boundary)).count() as u32;
                seen
            };
            std::iter::once(0).chain(tile.offsets.windows(2).map(of_pixel)).collect()
        };
        let count = offsets.last().map_or(0, |count| *count as usize);
        let array = || vec![0.0_f32; count];
        let (mut depth, mut px_per_unit, mut facing, mut leaf) = (array(), array(), array(), vec![0; count]);
        let (mut right, mut down, mut x_of, mut y_of, mut z_of) = (array(), array(), array(), array(), array());
        // Slices of one known length: no write asks where its array ends.
        {
            let (depth, px_per_unit, facing) = (&mut depth[..count], &mut px_per_unit[..count], &mut facing[..count]);
            let (leaf, right, down) = (&mut leaf[..count], &mut right[..count], &mut down[..count]);
            let (x_of, y_of, z_of) = (&mut x_of[..count], &mut y_of[..count], &mut z_of[..count]);
            let (mut pixel, mut i) = (0, 0);
            for y in rect.y0..rect.y1 {
                let v = (y as f32 - self.middle[1]) * self.tangent;
                for x in rect.x0..rect.x1 {
                    let of_pixel = tile.offsets[pixel] as usize..tile.offsets[pixel + 1] as usize;
                    pixel += 1;
                    if of_pixel.is_empty() {
                        continue;
                    }
                    let u = (x as f32 - self.middle[0]) * self.tangent;
                    let towards = self.forward + self.right * u + self.down * v;
                    for boundary in tile.boundaries[of_pixel].iter().filter(|boundary| is_seen(boundary)) {
                        if i >= count {
                            break;
                        }
                        [right[i], down[i]] = self.step_along(boundary.normal, towards);
                        depth[i] = boundary.depth;
                        px_per_unit[i] = self.px_per_unit(boundary.depth);
                        [x_of[i], y_of[i], z_of[i]] = boundary.normal.to_array();
                        facing[i] = f32::from(boundary.facing as i8);
                        leaf[i] = boundary.leaf;
                        i += 1;
                    }
                }
            }
        }
        Facets { rect, offsets, depth, px_per_unit, step: [right, down], normal: [x_of, y_of, z_of], facing, leaf }
    }
}
