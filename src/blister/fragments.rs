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
//! [`ABSENT`], which no peel reaches. Where blocks are peeled while fragments still come, what has been peeled is forgotten
//! and its layers are used again, so that the layers in use stay few, and in the cache.

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
    /// No key is greater.
    pub nearest: f32,
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
    /// Layers that no block has any more.
    free: Vec<u32>,
    /// How many layers were begun.
    pub begun: usize,
    /// By block: bit i is set where pixel i needs no more fragments.
    done: Vec<u8>,
    /// By row of blocks: bit i is set where no pixel of block i does.
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
        self.free.clear();
        self.begun = 0;
        self.done.clear();
        self.done.resize((BLOCKS_ACROSS * BLOCKS_DOWN) as usize, 0);
        self.settled = [0; BLOCKS_DOWN as usize];
    }

    /// The pixels of a block that need no more fragments.
    #[inline(always)]
    pub fn done(&self, block: u32) -> u8 {
        self.done[block as usize]
    }

    /// Takes no more fragments for the pixels `done` of a block, or for any if `is_settled`.
    pub fn finish(&mut self, block: u32, done: u8, is_settled: bool) {
        self.done[block as usize] = if is_settled { u8::MAX } else { done };
        self.settled[(block / BLOCKS_ACROSS) as usize] |= u16::from(is_settled) << (block % BLOCKS_ACROSS);
    }

    /// Whether all blocks from `first` to `last`, (column, row) each, are settled.
    pub fn all_settled(&self, first: (u32, u32), last: (u32, u32)) -> bool {
        let columns = (u32::from(u16::MAX) >> (BLOCKS_ACROSS - 1 - (last.0 - first.0)) << first.0) as u16;
        self.settled[first.1 as usize..=last.1 as usize].iter().all(|row| row & columns == columns)
    }

    /// Adds fragments of the leaf `slot` at the pixels of `mask` that need any; no key is greater than `nearest`.
    #[inline(always)]
    #[allow(clippy::too_many_arguments)]
    pub fn add<S: Simd>(
        &mut self,
        simd: S,
        block: u32,
        slot: u32,
        mask: mask32x8<S>,
        keys: f32x8<S>,
        nearest: f32,
        what: u32x8<S>,
    ) {
        let bits = mask.to_bitmask() as u32 & !u32::from(self.done[block as usize]);
        if bits == 0 {
            return;
        }
        let newest = self.newest[block as usize];
        let mut at = newest;
        // All eight fit in no layer that has one.
        let look_back = if bits == ALL_TAKEN { 0 } else { LOOK_BACK };
        for _ in 0..look_back {
            let Some(head) = self.heads.get_mut(at as usize) else { break };
            if head.slot == slot && head.taken & bits == 0 {
                head.taken |= bits;
                head.nearest = head.nearest.max(nearest);
                let (old_keys, old_what) = (&mut self.keys[at as usize], &mut self.what[at as usize]);
                *old_keys = mask.select(keys, f32x8::from_slice(simd, &*old_keys)).into();
                *old_what = mask.select(what, u32x8::from_slice(simd, &*old_what)).into();
                return;
            }
            at = head.next;
        }
        let head = LayerHead { slot, next: newest, taken: bits, nearest };
        self.begin(block, head, mask.select(keys, f32x8::splat(simd, ABSENT)).into(), what.into());
    }

    /// Adds one fragment of the leaf `slot`, at pixel `lane` of a block, which needs it.
    #[inline(always)]
    pub fn add_one(&mut self, block: u32, slot: u32, lane: usize, key: f32, what: u32) {
        let newest = self.newest[block as usize];
        let mut at = newest;
        for _ in 0..LOOK_BACK {
            let Some(head) = self.heads.get_mut(at as usize) else { break };
            if head.slot == slot && head.taken >> lane & 1 == 0 {
                head.taken |= 1 << lane;
                head.nearest = head.nearest.max(key);
                self.keys[at as usize][lane] = key;
                self.what[at as usize][lane] = what;
                return;
            }
            at = head.next;
        }
        let mut keys = [ABSENT; LANES];
        keys[lane] = key;
        self.begin(block, LayerHead { slot, next: newest, taken: 1 << lane, nearest: key }, keys, [what; LANES]);
    }

    /// Puts a layer before the block's others.
    #[inline(always)]
    fn begin(&mut self, block: u32, head: LayerHead, keys: [f32; LANES], what: [u32; LANES]) {
        self.begun += 1;
        if let Some(at) = self.free.pop() {
            self.newest[block as usize] = at;
            (self.heads[at as usize], self.keys[at as usize], self.what[at as usize]) = (head, keys, what);
            return;
        }
        self.newest[block as usize] = self.heads.len() as u32;
        self.heads.push(head);
        self.keys.push(keys);
        self.what.push(what);
    }

    /// Takes the layers out of a block that may have keys above `floor`, and fills `list` with them.
    pub fn take_above(&mut self, block: u32, floor: f32, list: &mut Vec<u32>) {
        list.clear();
        let (mut at, mut last_kept) = (self.newest[block as usize], END);
        while at != END {
            let LayerHead { next, nearest, .. } = self.heads[at as usize];
            if nearest > floor {
                list.push(at);
                match self.heads.get_mut(last_kept as usize) {
                    Some(kept) => kept.next = next,
                    None => self.newest[block as usize] = next,
                }
            } else {
                last_kept = at;
            }
            at = next;
        }
    }

    /// Gives a block back what is left of layers taken out: the fragments at pixels that are not done, with keys up to `floor`.
    /// Their other places may be taken again.
    #[inline(always)]
    pub fn put_back<S: Simd>(&mut self, simd: S, block: u32, layers: &[u32], floor: f32) {
        let open = !u32::from(self.done[block as usize]);
        for &layer in layers {
            let keys = f32x8::from_slice(simd, &self.keys[layer as usize]);
            let stays = keys.simd_le(floor) & keys.simd_gt(ABSENT);
            let taken = stays.to_bitmask() as u32 & open;
            if taken == 0 {
                self.free.push(layer);
            } else {
                let head = &mut self.heads[layer as usize];
                (head.taken, head.next, head.nearest) = (taken, self.newest[block as usize], floor);
                self.newest[block as usize] = layer;
            }
        }
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
