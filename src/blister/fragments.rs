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

use crate::layers::opaque::BLOCK_AREA;
pub(super) use crate::layers::opaque::{BLOCK_HEIGHT, BLOCK_WIDTH, BLOCKS_ACROSS, BLOCKS_DOWN};

/// Pixels that are peeled at once, as many as lanes.
pub(super) const LANES: usize = BLOCK_AREA;

/// The key of a place without a fragment.
pub(super) const ABSENT: f32 = f32::NEG_INFINITY;

/// No layer.
pub(super) const END: u32 = u32::MAX;

/// How many of a block's newest layers are looked at for a free place. A surface of small triangles is drawn neighbour by
/// neighbour, so the layer that a fragment fits in is one of the last; further back a look costs more than it saves.
const LOOK_BACK: u32 = 4;

/// [`Layer::taken`] of a layer without a free place.
const ALL_TAKEN: u32 = (1 << LANES) - 1;

/// [`Layer::mixed`] of a layer whose fragments are all of one thing.
const NOT_MIXED: u32 = u32::MAX;

/// For every pixel of a block at most one fragment of one leaf. All of it that is mostly asked for is one cache line.
#[derive(Debug, Clone, Copy)]
#[repr(align(64))]
pub(super) struct Layer {
    /// [`ABSENT`] where there is no fragment.
    pub keys: [f32; LANES],
    /// Of the leaf.
    pub slot: u32,
    /// Bit i is set where pixel i has a fragment.
    pub taken: u32,
    /// What all the fragments are of, where the next says so: a triangle, or a solid's hit.
    what: u32,
    /// Place in `Fragments::mixed`, or [`NOT_MIXED`].
    mixed: u32,
}

/// What is asked of layers that may be passed by. Apart from them, so that long lists lie close together.
#[derive(Debug, Clone, Copy)]
struct Link {
    /// The layer before, or [`END`].
    next: u32,
    /// No key of the layer is greater.
    nearest: f32,
}

/// The fragments of a tile. Buffers are kept from tile to tile.
#[derive(Debug, Default)]
pub(super) struct Fragments {
    /// By block: the newest layer, or [`END`].
    newest: Vec<u32>,
    layers: Vec<Layer>,
    /// By layer.
    links: Vec<Link>,
    /// What the fragments of layers are of, pixel by pixel.
    mixed: Vec<[u32; LANES]>,
    /// Layers that no block has any more.
    free: Vec<u32>,
    /// Places in `mixed` that no layer has any more.
    free_mixed: Vec<u32>,
    /// How many layers were begun.
    pub begun: usize,
    /// How many times a fragment, or those of a triangle in one block, found a place in a layer that was there.
    pub shared: usize,
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
        self.layers.clear();
        self.links.clear();
        self.mixed.clear();
        self.free.clear();
        self.free_mixed.clear();
        self.begun = 0;
        self.shared = 0;
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

    /// How many layers the blocks have.
    pub fn in_use(&self) -> usize {
        self.layers.len() - self.free.len()
    }

    /// A layer by its number.
    #[inline(always)]
    pub fn layer(&self, number: u32) -> &Layer {
        &self.layers[number as usize]
    }

    /// What the fragment of `layer` at pixel `lane` is of.
    #[inline(always)]
    pub fn what(&self, layer: &Layer, lane: usize) -> u32 {
        if layer.mixed == NOT_MIXED { layer.what } else { self.mixed[layer.mixed as usize][lane] }
    }

    /// [`what`](Self::what) of all pixels; where there is no fragment it means nothing.
    #[inline(always)]
    pub fn what_lanes<S: Simd>(&self, simd: S, layer: &Layer) -> u32x8<S> {
        if layer.mixed == NOT_MIXED {
            u32x8::splat(simd, layer.what)
        } else {
            u32x8::from_slice(simd, &self.mixed[layer.mixed as usize])
        }
    }

    /// Adds fragments of the leaf `slot` at the pixels of `mask` that need any, all of `what`; no key is greater than `nearest`.
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
        what: u32,
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
            let Some(layer) = self.layers.get_mut(at as usize) else { break };
            if layer.slot == slot && layer.taken & bits == 0 {
                self.shared += 1;
                layer.taken |= bits;
                let link = &mut self.links[at as usize];
                link.nearest = link.nearest.max(nearest);
                layer.keys = mask.select(keys, f32x8::from_slice(simd, &layer.keys)).into();
                let of_pixels = self.mixed_of(at);
                *of_pixels = mask.select(u32x8::splat(simd, what), u32x8::from_slice(simd, &*of_pixels)).into();
                return;
            }
            at = self.links[at as usize].next;
        }
        let keys = mask.select(keys, f32x8::splat(simd, ABSENT)).into();
        self.begin(block, nearest, Layer { keys, slot, taken: bits, what, mixed: NOT_MIXED });
    }

    /// Adds one fragment of the leaf `slot`, at pixel `lane` of a block, which needs it.
    #[inline(always)]
    pub fn add_one(&mut self, block: u32, slot: u32, lane: usize, key: f32, what: u32) {
        let newest = self.newest[block as usize];
        let mut at = newest;
        for _ in 0..LOOK_BACK {
            let Some(layer) = self.layers.get_mut(at as usize) else { break };
            if layer.slot == slot && layer.taken >> lane & 1 == 0 {
                self.shared += 1;
                layer.taken |= 1 << lane;
                let link = &mut self.links[at as usize];
                link.nearest = link.nearest.max(key);
                layer.keys[lane] = key;
                if layer.what != what || layer.mixed != NOT_MIXED {
                    self.mixed_of(at)[lane] = what;
                }
                return;
            }
            at = self.links[at as usize].next;
        }
        let mut keys = [ABSENT; LANES];
        keys[lane] = key;
        self.begin(block, key, Layer { keys, slot, taken: 1 << lane, what, mixed: NOT_MIXED });
    }

    /// What the fragments of a layer are of, pixel by pixel.
    #[inline(always)]
    fn mixed_of(&mut self, layer: u32) -> &mut [u32; LANES] {
        let layer = &mut self.layers[layer as usize];
        if layer.mixed == NOT_MIXED {
            let all = [layer.what; LANES];
            if let Some(place) = self.free_mixed.pop() {
                layer.mixed = place;
                self.mixed[place as usize] = all;
            } else {
                layer.mixed = self.mixed.len() as u32;
                self.mixed.push(all);
            }
        }
        &mut self.mixed[layer.mixed as usize]
    }

    /// Puts a layer before the block's others.
    #[inline(always)]
    fn begin(&mut self, block: u32, nearest: f32, layer: Layer) {
        self.begun += 1;
        let newest = &mut self.newest[block as usize];
        let link = Link { next: *newest, nearest };
        if let Some(at) = self.free.pop() {
            *newest = at;
            (self.layers[at as usize], self.links[at as usize]) = (layer, link);
            return;
        }
        *newest = self.layers.len() as u32;
        self.layers.push(layer);
        self.links.push(link);
    }

    /// Takes the layers out of a block that may have keys above `floor`, and fills `list` with them.
    pub fn take_above(&mut self, block: u32, floor: f32, list: &mut Vec<u32>) {
        list.clear();
        let (mut at, mut last_kept) = (self.newest[block as usize], END);
        while at != END {
            let Link { next, nearest } = self.links[at as usize];
            if nearest > floor {
                list.push(at);
                match self.links.get_mut(last_kept as usize) {
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
        for &number in layers {
            let layer = &mut self.layers[number as usize];
            let keys = f32x8::from_slice(simd, &layer.keys);
            let stays = keys.simd_le(floor) & keys.simd_gt(ABSENT);
            let taken = stays.to_bitmask() as u32 & open;
            if taken == 0 {
                self.free.push(number);
                if layer.mixed != NOT_MIXED {
                    self.free_mixed.push(layer.mixed);
                }
            } else {
                layer.taken = taken;
                self.links[number as usize] = Link { next: self.newest[block as usize], nearest: floor };
                self.newest[block as usize] = number;
            }
        }
    }

    /// Fills `list` with the layers of `block`, newest first.
    pub fn layers_of(&self, block: u32, list: &mut Vec<u32>) {
        list.clear();
        let mut at = self.newest[block as usize];
        while at != END {
            list.push(at);
            at = self.links[at as usize].next;
        }
    }
}
