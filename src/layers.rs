//! The layer stack: the only contract between a pipeline and what draws its result.
//!
//! A *layer* is the i-th boundary of the result solid along each pixel's ray, fronts and backs. A pipeline is a
//! [`LayerSource`]: it hands over one [`LayerTile`] for any rectangle of pixels asked for, with per-pixel lists in depth
//! order. Dense layers do not fit in memory (4096² is about 470 MB each), so a whole [`LayerStack`] exists only where
//! something needs all of it: EXR output and measurements.
//!
//! A style derives all else from these records; no style adds a channel.

use glam::Vec3;
use rayon::prelude::*;

use crate::space::{Camera, PixelRect};

/// Tiles are this many pixels a side.
pub const TILE_SIDE: u32 = 64;

/// The most samples a pixel can have: one bit each in [`Boundary::samples`].
pub const MAX_SAMPLES: u32 = 16;

/// `Boundary::leaf` where there is none.
pub const NO_LEAF: u32 = u32::MAX;

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

    /// The boundaries of the pixel at column `x`, row `y` of the *picture*, front to back.
    pub fn at(&self, x: u32, y: u32) -> &[Boundary] {
        let index = ((y - self.rect.y0) * self.rect.width() + (x - self.rect.x0)) as usize;
        &self.boundaries[self.offsets[index] as usize..self.offsets[index + 1] as usize]
    }
}

/// How many boundaries a pipeline hands over.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum LayerLimit {
    /// Only the nearest boundary of every sample: enough for an opaque picture.
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
