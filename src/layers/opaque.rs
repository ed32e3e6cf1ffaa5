//! What a plain picture needs of a tile where nothing shows through anything.
//!
//! *Practice.* At most one surface a pixel, which is opaque and seen by all of the pixel's samples: less than a
//! [`LayerTile`](super::LayerTile) holds, and ready to be lit several pixels at a time. Most blocks show one flat surface and nothing
//! else, so it is written down once and not for every pixel: a tile then stays in the nearest cache between who finds its surfaces and
//! who lights them.

use super::TILE_SIDE;
use crate::space::PixelRect;

/// A block's pixels across.
pub const BLOCK_WIDTH: u32 = 4;
/// A block's pixels down. Blocks are near to square, so that small surfaces touch few.
pub const BLOCK_HEIGHT: u32 = 2;
/// Pixels of a block: as many as are worked on at once.
pub const BLOCK_AREA: usize = (BLOCK_WIDTH * BLOCK_HEIGHT) as usize;
/// Blocks across a tile.
pub const BLOCKS_ACROSS: u32 = TILE_SIDE / BLOCK_WIDTH;
/// Blocks down a tile.
pub const BLOCKS_DOWN: u32 = TILE_SIDE / BLOCK_HEIGHT;

/// [`Block::mixed`] of a block that shows one surface.
const NOT_MIXED: u32 = u32::MAX;

/// A flat surface.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct OpaqueSurface {
    /// Unit normal in world space, either way round.
    pub normal: [f32; 3],
    /// Linear RGB, unlit.
    pub colour: [f32; 3],
}

/// The surfaces of a block's pixels, row by row: numbers side by side. What they are where nothing shows means nothing.
#[derive(Debug, Clone, Copy)]
pub struct OpaquePixels {
    /// Unit normals in world space, either way round; x, y and z apart.
    pub normals: [[f32; BLOCK_AREA]; 3],
    /// Linear RGB, unlit; the channels apart.
    pub colours: [[f32; BLOCK_AREA]; 3],
}

/// What a block shows.
#[derive(Debug, Clone, Copy)]
pub enum OpaqueShown<'a> {
    /// The same surface wherever it shows any.
    One(&'a OpaqueSurface),
    /// Several.
    Mixed(&'a OpaquePixels),
}

#[derive(Debug, Clone, Copy)]
struct Block {
    /// Bit i is set where pixel i shows a surface.
    covered: u8,
    /// Place in `OpaqueTile::mixed`, or [`NOT_MIXED`].
    mixed: u32,
    surface: OpaqueSurface,
}

/// A tile of opaque surfaces. Block b is [`BLOCK_WIDTH`] by [`BLOCK_HEIGHT`] pixels of the *picture's tile*, its column
/// b % [`BLOCKS_ACROSS`] and its row b / [`BLOCKS_ACROSS`]; bit i of a block, like number i of its [`OpaquePixels`], is the pixel at
/// column i % [`BLOCK_WIDTH`] and row i / [`BLOCK_WIDTH`] of it.
#[derive(Debug, Clone)]
pub struct OpaqueTile {
    blocks: Vec<Block>,
    mixed: Vec<OpaquePixels>,
}

impl Default for OpaqueTile {
    fn default() -> Self {
        let block = Block { covered: 0, mixed: NOT_MIXED, surface: OpaqueSurface::default() };
        Self { blocks: vec![block; (BLOCKS_ACROSS * BLOCKS_DOWN) as usize], mixed: Vec::new() }
    }
}

impl OpaqueTile {
    /// Shows nothing any more.
    pub fn clear(&mut self) {
        self.blocks.iter_mut().for_each(|block| (block.covered, block.mixed) = (0, NOT_MIXED));
        self.mixed.clear();
    }

    /// Shows one surface at the pixels `covered` of a block, which showed nothing.
    #[inline(always)]
    pub fn put_one(&mut self, block: u32, covered: u8, surface: OpaqueSurface) {
        self.blocks[block as usize] = Block { covered, mixed: NOT_MIXED, surface };
    }

    /// Shows several surfaces at the pixels `covered` of a block, which showed nothing.
    #[inline(always)]
    pub fn put_mixed(&mut self, block: u32, covered: u8, pixels: OpaquePixels) {
        let mixed = self.mixed.len() as u32;
        self.blocks[block as usize] = Block { covered, mixed, surface: OpaqueSurface::default() };
        self.mixed.push(pixels);
    }

    /// At which pixels a block shows surfaces, and which.
    #[inline(always)]
    pub fn block(&self, block: u32) -> (u8, OpaqueShown<'_>) {
        let block = &self.blocks[block as usize];
        let shown = match self.mixed.get(block.mixed as usize) {
            Some(pixels) => OpaqueShown::Mixed(pixels),
            None => OpaqueShown::One(&block.surface),
        };
        (block.covered, shown)
    }

    /// The surface of the pixel at a column and a row of the picture.
    pub fn at(&self, x: u32, y: u32) -> Option<OpaqueSurface> {
        let (x, y) = (x % TILE_SIDE, y % TILE_SIDE);
        let (covered, shown) = self.block(y / BLOCK_HEIGHT * BLOCKS_ACROSS + x / BLOCK_WIDTH);
        let pixel = (y % BLOCK_HEIGHT * BLOCK_WIDTH + x % BLOCK_WIDTH) as usize;
        (covered >> pixel & 1 == 1).then(|| match shown {
            OpaqueShown::One(surface) => *surface,
            OpaqueShown::Mixed(pixels) => OpaqueSurface {
                normal: pixels.normals.map(|axis| axis[pixel]),
                colour: pixels.colours.map(|channel| channel[pixel]),
            },
        })
    }
}

/// The blocks of the tile around `rect`, which holds a pixel at least, that hold any of its pixels: first and last column, first and
/// last row.
pub fn blocks_of(rect: PixelRect) -> [(u32, u32); 2] {
    let of = |first: u32, end: u32, side: u32| (first % TILE_SIDE / side, (end - 1) % TILE_SIDE / side);
    [of(rect.x0, rect.x1, BLOCK_WIDTH), of(rect.y0, rect.y1, BLOCK_HEIGHT)]
}
