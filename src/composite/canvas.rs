//! The picture that tiles are drawn into: each tile writes its own rows of it, so nothing is copied when it is done.

use super::picture::Picture;
use crate::layers::TILE_SIDE;

/// A picture with depths that is being drawn.
pub(super) struct Canvas {
    width: u32,
    height: u32,
    pixels: Vec<[f32; 4]>,
    depth: Vec<f32>,
}

/// The rows of one tile in the picture.
pub(super) struct TileRows<'a> {
    /// Linear RGB, straight alpha.
    pub pixels: Vec<&'a mut [[f32; 4]]>,
    /// Planar view depth; +∞ where nothing shows.
    pub depth: Vec<&'a mut [f32]>,
}

impl TileRows<'_> {
    /// Makes all of it `background`, where nothing shows.
    pub fn clear(&mut self, background: [f32; 4]) {
        self.pixels.iter_mut().for_each(|row| row.fill(background));
        self.depth.iter_mut().for_each(|row| row.fill(f32::INFINITY));
    }
}

impl Canvas {
    /// An empty one.
    pub fn new(width: u32, height: u32) -> Self {
        let area = width as usize * height as usize;
        Self { width, height, pixels: vec![[0.0; 4]; area], depth: vec![0.0; area] }
    }

    /// The tiles of the rows of pixels from `y0` to before `y1`, which are whole rows of tiles, in their order.
    pub fn tiles(&mut self, y0: u32, y1: u32) -> Vec<TileRows<'_>> {
        let across = self.width as usize;
        let places = y0 as usize * across..y1 as usize * across;
        let pixels = rows_of_tiles(&mut self.pixels[places.clone()], across);
        let depth = rows_of_tiles(&mut self.depth[places], across);
        pixels.into_iter().zip(depth).map(|(pixels, depth)| TileRows { pixels, depth }).collect()
    }

    /// The picture, of which `covered` pixels show a surface.
    pub fn finish(self, covered: u64, has_alpha: bool) -> Picture {
        let Self { width, height, pixels, depth } = self;
        Picture { width, height, pixels, depth: Some(depth), covered, has_alpha }
    }
}

/// The rows of each tile of `band`, some rows of tiles of a picture `across` pixels wide.
pub(super) fn rows_of_tiles<T>(band: &mut [T], across: usize) -> Vec<Vec<&mut [T]>> {
    let side = TILE_SIDE as usize;
    let mut tiles = Vec::new();
    for of_row in band.chunks_mut((across * side).max(1)) {
        let first = tiles.len();
        tiles.extend((0..across.div_ceil(side)).map(|_| Vec::with_capacity(side)));
        for line in of_row.chunks_mut(across) {
            tiles[first..].iter_mut().zip(line.chunks_mut(side)).for_each(|(rows, row)| rows.push(row));
        }
    }
    tiles
}
