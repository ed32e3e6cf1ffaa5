//! Where fragments wait to be peeled: a tile's layers, block by block.
//!
//! *Theory.* A fragment is a crossing of one pixel's ray and one leaf's surface. Eight pixels, a *block* of
//! [`BLOCK_WIDTH`] by [`BLOCK_HEIGHT`], are peeled at once, so their fragments are kept side by side: a *layer* holds for
//! every pixel of the block at most one fragment of one leaf.
//!
//! *Changes from the paper.* The usual way on a CPU is to append single fragments to a linear buffer and to sort them by pixel.
//! Here nothing is sorted by pixel: a triangle that covers the block writes its eight fragments with two stores, and small
//! neighbouring triangles of a leaf fill the free places of one layer. A layer is not a surface: which of a leaf's
//! fragments share one does not matter, since each has its own key.
//!
//! *Practice.* The layers of a block are a linked list, newest first, so nothing is bounded. A free place has the key
//! [`ABSENT`], which no peel reaches.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x8, mask32x8, u32x8};

use crate::layers::TILE_SIDE;

/// Pixels that are peeled at once, as many as lanes.
pub(super) const LANES: usize = 8;
/// A block's pixels across. Blocks are near to square, so that small triangles touch few.
pub(super) const BLOCK_WIDTH: u32 = 4;
/// A block's pixels down.
pub(super) const BLOCK_HEIGHT: u32 = 2;
/// Blocks across a tile.
pub(super) const BLOCKS_ACROSS: u32 = TILE_SIDE / BLOCK_WIDTH;
/// Blocks down a tile.
pub(super) const BLOCKS_DOWN: u32 = TILE_SIDE / BLOCK_HEIGHT;

/// The key of a place without a fragment.
pub(super) const ABSENT: f32 = f32::NEG_INFINITY;

/// No layer.
pub(super) const END: u32 = u32::MAX;

/// How many of a block's newest layers are looked at for a free place. A surface of small triangles is drawn neighbour by
/// neighbour, so the layer that a fragment fits in is one of the last; further back a look costs more than it saves.
const LOOK_BACK: u32 = 4;

/// [`LayerHead::taken`] of a layer without a free place.
const ALL_TAKEN: u32 = (1 << LANES) - 1;

/// What all fragments of a layer share.
#[derive(Debug, Clone, Copy)]
pub(super) struct LayerHead {
    /// Of the leaf.
    pub slot: u32,
    /// The layer before, or [`END`].
    pub next: u32,
    /// Bit i is set where pixel i has a fragment.
    pub taken: u32,
}

/// The fragments of a tile. Buffers are kept from tile to tile.
#[derive(Debug, Default)]
pub(super) struct Fragments {
    /// By block: the newest layer, or [`END`].
    newest: Vec<u32>,
    pub heads: Vec<LayerHead>,
    pub keys: Vec<[f32; LANES]>,
    /// What each fragment is of: a triangle, or a solid's hit.
    pub what: Vec<[u32; LANES]>,
    /// By row of blocks: bit i is set where block i needs no more fragments.
    settled: [u16; BLOCKS_DOWN as usize],
}

impl Fragments {
    /// Forgets everything.
    pub fn clear(&mut self) {
        self.newest.clear();
        self.newest.resize((BLOCKS_ACROSS * BLOCKS_DOWN) as usize, END);
        self.heads.clear();
        self.keys.clear();
        self.what.clear();
        self.settled = [0; BLOCKS_DOWN as usize];
    }

    /// Whether a block needs no more fragments.
    #[inline(always)]
    pub fn is_settled(&self, block_x: u32, block_y: u32) -> bool {
        self.settled[block_y as usize] >> block_x & 1 == 1
    }

    /// Takes no more fragments for a block.
    pub fn settle(&mut self, block_x: u32, block_y: u32) {
        self.settled[block_y as usize] |= 1 << block_x;
    }

    /// Whether all blocks from `first` to `last`, (column, row) each, are settled.
    pub fn all_settled(&self, first: (u32, u32), last: (u32, u32)) -> bool {
        let columns = (u32::from(u16::MAX) >> (BLOCKS_ACROSS - 1 - (last.0 - first.0)) << first.0) as u16;
        self.settled[first.1 as usize..=last.1 as usize].iter().all(|row| row & columns == columns)
    }

    /// Adds fragments of the leaf `slot` at the pixels of `mask`, which is not empty.
    #[inline(always)]
    pub fn add<S: Simd>(&mut self, simd: S, block: u32, slot: u32, mask: mask32x8<S>, keys: f32x8<S>, what: u32x8<S>) {
        let bits = mask.to_bitmask() as u32;
        let newest = self.newest[block as usize];
        let mut at = newest;
        // All eight fit in no layer that has one.
        let look_back = if bits == ALL_TAKEN { 0 } else { LOOK_BACK };
        for _ in 0..look_back {
            let Some(head) = self.heads.get_mut(at as usize) else { break };
            if head.slot == slot && head.taken & bits == 0 {
                head.taken |= bits;
                let (old_keys, old_what) = (&mut self.keys[at as usize], &mut self.what[at as usize]);
                *old_keys = mask.select(keys, f32x8::from_slice(simd, &*old_keys)).into();
                *old_what = mask.select(what, u32x8::from_slice(simd, &*old_what)).into();
                return;
            }
            at = head.next;
        }
        self.newest[block as usize] = self.heads.len() as u32;
        self.heads.push(LayerHead { slot, next: newest, taken: bits });
        self.keys.push(mask.select(keys, f32x8::splat(simd, ABSENT)).into());
        self.what.push(what.into());
    }

    /// Adds one fragment of the leaf `slot`, at pixel `lane` of a block.
    #[inline(always)]
    pub fn add_one(&mut self, block: u32, slot: u32, lane: usize, key: f32, what: u32) {
        let newest = self.newest[block as usize];
        let mut at = newest;
        for _ in 0..LOOK_BACK {
            let Some(head) = self.heads.get_mut(at as usize) else { break };
            if head.slot == slot && head.taken >> lane & 1 == 0 {
                head.taken |= 1 << lane;
                self.keys[at as usize][lane] = key;
                self.what[at as usize][lane] = what;
                return;
            }
            at = head.next;
        }
        self.newest[block as usize] = self.heads.len() as u32;
        self.heads.push(LayerHead { slot, next: newest, taken: 1 << lane });
        let mut keys = [ABSENT; LANES];
        keys[lane] = key;
        self.keys.push(keys);
        self.what.push([what; LANES]);
    }

    /// Fills `list` with the layers of `block`, newest first.
    pub fn layers_of(&self, block: u32, list: &mut Vec<u32>) {
        list.clear();
        let mut at = self.newest[block as usize];
        while at != END {
            list.push(at);
            at = self.heads[at as usize].next;
        }
    }
}
