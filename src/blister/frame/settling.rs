//! Blocks that are peeled before all of their tile is drawn.
//!
//! *Theory.* Meshlets are drawn nearest first. Once the nearest fragment of those to come is known, nothing nearer can appear:
//! all fragments before it can be peeled and forgotten. A pixel that has its boundary then takes no more fragments; a
//! meshlet behind blocks whose pixels all have theirs is not drawn. This needs every ray to begin outside of every leaf, since
//! else the parity of a leaf takes all of its fragments.
//!
//! *Practice.* A block keeps its pixels' memberships from look to look, so that every fragment is peeled once. Still a look
//! passes by the layers that are too far to be peeled yet, so one is taken when as many layers have come as the look before
//! left over: then what such looks pass by is no more than what was drawn. Fragments that share a layer take their time to be
//! drawn too: where many do, a look is taken when there are as many as are worth it. Where a look settled no block, the next waits
//! for twice as much: in some scenes nothing settles before all is drawn.

use fearless_simd::Simd;

use super::super::bins::Entry;
use super::super::few::{FEW, FewLayers};
use super::super::fragments::{BLOCK_HEIGHT, BLOCK_WIDTH, BLOCKS_ACROSS, BLOCKS_DOWN, Fragments};
use super::super::peel::{Block, LaneScratch};
use super::super::raster::Grid;
use super::super::survivors::Chooser;
use super::{Scratch, wanted_lanes};
use crate::layers::TILE_SIDE;
use crate::space::PixelRect;

/// How far the blocks of a tile are settled, at one sample of every pixel.
pub(super) struct Settling {
    wanted: PixelRect,
    wants_bodies: bool,
    /// Whether [`FewLayers`] may do.
    pub may_be_few: bool,
    grid: Grid,
    is_on: bool,
    /// Blocks that are not settled.
    pub open: u32,
    /// Layers begun at the last look, and how many more make the next.
    last: usize,
    step: usize,
    /// How often fragments had shared a layer at the last look.
    last_shared: usize,
    /// How many times as much as else the next look waits for.
    patience: usize,
    /// All fragments with greater keys have been peeled.
    floor: f32,
}

impl Settling {
    /// No look is taken until so many layers have come for each open block, or so many fragments that shared one. To draw one
    /// takes about as long as to look at a block, but of those to come only some are spared by it.
    const LAYERS_A_LOOK: u32 = 2;

    /// A look passes by so many layers in the time that drawing a fragment that shares one takes; found by trying, on scenes
    /// of many small triangles, whose fragments nearly all do.
    const LAYERS_A_SHARER: usize = 8;

    pub fn new(wanted: PixelRect, grid: Grid, is_on: bool, may_be_few: bool, wants_bodies: bool) -> Self {
        let blocks = |first: u32, end: u32, size: u32| end.div_ceil(size) - first / size;
        let across = blocks(wanted.x0 - grid.x0, wanted.x1 - grid.x0, BLOCK_WIDTH);
        let open = across * blocks(wanted.y0 - grid.y0, wanted.y1 - grid.y0, BLOCK_HEIGHT);
        let mut settling = Self {
            wanted,
            wants_bodies,
            may_be_few,
            grid,
            is_on,
            open,
            last: 0,
            step: 0,
            last_shared: 0,
            patience: 1,
            floor: f32::INFINITY,
        };
        settling.step = settling.for_blocks();
        settling
    }

    /// What a look waits for at least.
    fn for_blocks(&self) -> usize {
        (self.open * Self::LAYERS_A_LOOK) as usize
    }

    /// Whether to look, where `nearest` is the greatest key that fragments to come can have.
    pub fn is_due(&self, nearest: f32, fragments: &Fragments) -> bool {
        let shared = fragments.shared - self.last_shared;
        let enough = || self.for_blocks() + fragments.in_use() / Self::LAYERS_A_SHARER;
        let has_paid = || shared >= self.patience.saturating_mul(enough());
        // Nothing can be told while what is to come may be as near as what has been peeled.
        self.is_on && nearest < self.floor && (fragments.begun - self.last >= self.step || has_paid())
    }

    /// No fragment that is still to be peeled has this key or a greater one.
    pub fn ceiling(&self) -> f32 {
        self.floor.next_up()
    }

    /// Whether all that an entry could draw is behind settled blocks.
    pub fn hides(&self, entry: &Entry, fragments: &Fragments) -> bool {
        let within = |px: u16, corner: u32| u32::from(px).saturating_sub(corner).min(TILE_SIDE - 1);
        let (x0, y0) = (within(entry.px[0], self.grid.x0), within(entry.px[1], self.grid.y0));
        let (x1, y1) = (within(entry.px[2], self.grid.x0), within(entry.px[3], self.grid.y0));
        let block = |x: u32, y: u32| (x / BLOCK_WIDTH, y / BLOCK_HEIGHT);
        fragments.all_settled(block(x0, y0), block(x1, y1))
    }

    /// Peels every open block down to `floor`, the greatest key that fragments to come can have.
    #[inline(always)]
    pub fn settle<S: Simd>(&mut self, simd: S, floor: f32, scratch: &mut Scratch, lanes: &mut LaneScratch<S>) {
        let (words, open) = (scratch.shrunk.words(), self.open);
        for number in 0..BLOCKS_ACROSS * BLOCKS_DOWN {
            let (block_x, block_y) = (number % BLOCKS_ACROSS, number / BLOCKS_ACROSS);
            let corner = (self.grid.x0 + block_x * BLOCK_WIDTH, self.grid.y0 + block_y * BLOCK_HEIGHT);
            let wanted = wanted_lanes(corner, self.wanted);
            let done = scratch.fragments.done(number);
            if wanted & !done == 0 {
                continue;
            }
            scratch.fragments.take_above(number, floor, &mut scratch.layers);
            if scratch.layers.is_empty() {
                continue;
            }
            let found = &mut scratch.found[number as usize];
            let state = &mut scratch.states[number as usize * words..][..words];
            let few = self.may_be_few && scratch.layers.len() <= FEW;
            let few = few.then_some(FewLayers {
                shrunk: &scratch.shrunk,
                fragments: &scratch.fragments,
                layers: &scratch.layers,
                wanted: wanted & !done,
                floor,
                ceiling: self.ceiling(),
            });
            if let Some(few) = few
                && let Some(new) = few.peel(simd, &mut lanes.nodes, &mut state[0], found)
            {
                self.end(simd, number, done | new, wanted, floor, &scratch.layers, &mut scratch.fragments);
                continue;
            }
            let mut chooser = Chooser {
                looks: &scratch.looks,
                hits: &scratch.hits,
                judge: &mut scratch.judge,
                out: &mut scratch.survivors,
                wants_bodies: self.wants_bodies,
            };
            let block = Block {
                shrunk: &scratch.shrunk,
                fragments: &scratch.fragments,
                kinds: &scratch.kinds,
                layers: &scratch.layers,
                begins_inside: &[],
                wanted: wanted & !done,
                has_sheets: false,
                is_plain: true,
                ends: true,
                is_partial: true,
                floor,
                ceiling: self.ceiling(),
            };
            chooser.out.put_block(found, done);
            block.peel_on(simd, state, lanes, &mut scratch.peel, &mut chooser);
            let done;
            (*found, done) = chooser.out.take_block();
            self.end(simd, number, done, wanted, floor, &scratch.layers, &mut scratch.fragments);
        }
        self.floor = floor;
        self.last = scratch.fragments.begun;
        self.last_shared = scratch.fragments.shared;
        self.patience = if self.open < open { 1 } else { self.patience.saturating_mul(2) };
        self.step = self.patience.saturating_mul(scratch.fragments.in_use().max(self.for_blocks()));
    }

    /// Ends the look at a block: of the pixels `wanted` those of `done` need nothing more, the others what is left of `layers`.
    #[inline(always)]
    #[allow(clippy::too_many_arguments)]
    fn end<S: Simd>(
        &mut self,
        simd: S,
        number: u32,
        done: u8,
        wanted: u8,
        floor: f32,
        layers: &[u32],
        fragments: &mut Fragments,
    ) {
        let is_settled = done & wanted == wanted;
        fragments.finish(number, done, is_settled);
        self.open -= u32::from(is_settled);
        fragments.put_back(simd, number, layers, floor);
    }
}
