//! From fragments to boundaries: peel by peel, front to back, eight pixels at once.
//!
//! *Theory.* Blister's inner loop (§4): the next layer's depth, the leaves' membership there, the expression's value. The next
//! peel of a pixel is the greatest key below the last one; all fragments that have exactly that key toggle their leaves;
//! where the expression then differs from what it was, there is a boundary. The first state is what lies at the eye: the
//! parity of all fragments in front of it, since beyond the last crossing every leaf is out.
//!
//! *Changes from the paper.* The expression is not walked literal by literal but compared 32 literals at a time
//! ([`Shrunk::eval_lanes`]). Peeling needs no sort: each peel is two passes over the block's layers. That is quadratic in
//! the layers, so deep blocks ([`MOST_LAYERS`]), and expressions over more leaves than [`MOST_WORDS`] words hold, are sorted
//! pixel by pixel and toggled with [`Counters`], which is linear.
//!
//! *Practice.* Lanes are pixels. A boundary found is handed over by scalar code ([`Sink`]): there is mostly one a pixel.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x8, u32x8};

use super::fragments::{ABSENT, Fragments, LANES};
use super::survivors::Survivor;
use super::ties::{State, turn};
use crate::csg::flat::SLOTS_A_WORD;
use crate::csg::{Counters, Shrunk};

/// Blocks with more layers are sorted. Two passes over n layers for each of up to n peels, at a few cycles for eight pixels,
/// meet n log n scalar steps for each of them at about here.
const MOST_LAYERS: usize = 96;

/// Blocks with more layers are put in order of their nearest fragments, so that a peel looks only at the layers that reach
/// it. Below, the order costs more than it saves.
const UNORDERED_LAYERS: usize = 6;

/// Wider states are toggled slot by slot.
pub(super) const MOST_WORDS: usize = 8;

/// A fragment of a peel: slot and what it is of.
pub(super) type Member = (u32, u32);

/// A peel that changes something, at one pixel.
#[derive(Debug)]
pub(super) struct Peel<'a> {
    /// Pixel of the block.
    pub lane: usize,
    /// Depth, as a key.
    pub key: f32,
    /// The fragments that coincide there.
    pub members: &'a [Member],
    /// Memberships before and after.
    pub before: &'a State,
    pub after: &'a State,
    /// The result before and after.
    pub was: bool,
    pub is: bool,
}

/// Takes the peels at which the result may have a boundary, front to back for each pixel.
pub(super) trait Sink {
    /// A boundary where one fragment alone toggles. Returns whether the pixel needs nothing behind this.
    fn take_one(&mut self, lane: usize, survivor: Survivor) -> bool;

    /// The body of a boundary whose owner goes against the result, given the state just inside it.
    fn body(&mut self, shrunk: &Shrunk, inside: &State) -> Option<u32>;

    /// Any other peel that may be a boundary. Returns whether the pixel needs nothing behind this.
    fn take(&mut self, shrunk: &Shrunk, peel: &Peel<'_>) -> bool;
}

/// What of a slot's crossings a block needs to know.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum SlotKind {
    /// Closed: the parity of its fragments tells where a ray begins.
    Closed,
    /// A half-space: where a ray begins is told by [`Block::begins_inside`].
    Endless,
    /// A sheet: never in or out.
    Sheet,
}

/// A block to be peeled.
pub(super) struct Block<'a> {
    pub shrunk: &'a Shrunk,
    pub fragments: &'a Fragments,
    /// By slot.
    pub kinds: &'a [SlotKind],
    /// Its layers.
    pub layers: &'a [u32],
    /// For endless slots: the pixels whose rays begin inside.
    pub begins_inside: &'a [(u32, u8)],
    /// Which pixels are wanted.
    pub wanted: u8,
    /// Whether any slot is a sheet.
    pub has_sheets: bool,
}

/// One layer of a block.
#[derive(Debug, Clone, Copy)]
struct GatheredLayer {
    layer: u32,
    slot: u32,
    /// The slot's word and bit of the state.
    word: usize,
    bit: u32,
    is_closed: bool,
    /// The greatest key, where the layers are in its order.
    nearest: f32,
}

/// Buffers that are kept from block to block.
#[derive(Debug, Default)]
pub(super) struct PeelScratch {
    counters: Counters,
    layers: Vec<GatheredLayer>,
    /// Of one pixel: key, slot, what.
    sorted: Vec<(f32, u32, u32)>,
    members: Vec<Member>,
    before: Vec<u32>,
    after: Vec<u32>,
}

/// Buffers of lanes.
pub(super) struct LaneScratch<S: Simd> {
    /// As many as the expression has nodes.
    pub nodes: Vec<u32x8<S>>,
    keys: Vec<f32x8<S>>,
}

impl<S: Simd> Default for LaneScratch<S> {
    fn default() -> Self {
        Self { nodes: Vec::new(), keys: Vec::new() }
    }
}

impl Block<'_> {
    /// Hands every peel that matters to `sink`.
    #[inline(always)]
    pub fn peel<S: Simd>(&self, simd: S, lanes: &mut LaneScratch<S>, scratch: &mut PeelScratch, sink: &mut impl Sink) {
        if self.layers.len() > MOST_LAYERS || self.shrunk.words() > MOST_WORDS || self.has_sheets {
            return self.peel_sorted(scratch, sink);
        }
        match self.shrunk.words() {
            1 => self.peel_lanes::<S, 1>(simd, lanes, scratch, sink),
            2 => self.peel_lanes::<S, 2>(simd, lanes, scratch, sink),
            3..=4 => self.peel_lanes::<S, 4>(simd, lanes, scratch, sink),
            _ => self.peel_lanes::<S, MOST_WORDS>(simd, lanes, scratch, sink),
        }
    }

    #[inline(always)]
    fn peel_lanes<S: Simd, const WORDS: usize>(
        &self,
        simd: S,
        lanes: &mut LaneScratch<S>,
        scratch: &mut PeelScratch,
        sink: &mut impl Sink,
    ) {
        let (none, absent) = (u32x8::splat(simd, 0), f32x8::splat(simd, ABSENT));
        let mut state = [none; WORDS];
        self.gather(simd, lanes, scratch);
        for (&keys, layer) in lanes.keys.iter().zip(&scratch.layers) {
            if layer.is_closed {
                let bit = u32x8::splat(simd, layer.bit);
                state[layer.word % WORDS] = state[layer.word % WORDS] ^ keys.simd_gt(absent).select(bit, none);
            }
        }
        for &(slot, pixels) in self.begins_inside {
            let (word, bit) = (slot as usize / SLOTS_A_WORD % WORDS, 1_u32 << (slot as usize % SLOTS_A_WORD));
            let mut inside = [0; LANES];
            for (lane, inside) in inside.iter_mut().enumerate() {
                *inside = if pixels >> lane & 1 == 1 { bit } else { 0 };
            }
            state[word] = state[word] | u32x8::from_slice(simd, &inside);
        }
        let mut was = self.shrunk.eval_lanes(simd, &state, &mut lanes.nodes);
        let mut last = f32x8::splat(simd, f32::INFINITY);
        let mut alive = u32::from(self.wanted);
        // The layers before `first` have been peeled off.
        let mut first = 0;
        let is_ordered = lanes.keys.len() > UNORDERED_LAYERS;
        loop {
            let mut next = absent;
            let mut end = lanes.keys.len();
            for i in first..lanes.keys.len() {
                // No fragment of this layer, nor of those after it, is as near as what every pixel has found.
                if is_ordered && next.simd_gt(scratch.layers[i].nearest).to_bitmask() as u32 & alive == alive {
                    end = i;
                    break;
                }
                let keys = lanes.keys[i];
                let ahead = keys.simd_lt(last);
                if i == first && ahead.to_bitmask() as u32 & alive == 0 {
                    first += 1;
                }
                next = next.max(ahead.select(keys, absent));
            }
            alive &= next.simd_gt(absent).to_bitmask() as u32;
            if alive == 0 {
                return;
            }
            let before = state;
            // The number of the layer that each pixel's fragment is in, and whether there is another.
            let (mut of_layer, mut several) = (none, none);
            for i in first..end {
                let here = lanes.keys[i].simd_eq(next);
                let bit = u32x8::splat(simd, scratch.layers[i].bit);
                let word = scratch.layers[i].word % WORDS;
                state[word] = state[word] ^ here.select(bit, none);
                several = several | here.select(of_layer, none);
                of_layer = here.select(u32x8::splat(simd, i as u32 + 1), of_layer);
            }
            let is = self.shrunk.eval_lanes(simd, &state, &mut lanes.nodes);
            let changed = is.simd_ne(was).to_bitmask() as u32 & alive;
            if changed != 0 {
                let is_inside = is.simd_ne(none).to_bitmask() as u32;
                let keys: [f32; LANES] = next.into();
                let of_layer: [u32; LANES] = of_layer.into();
                let several = several.simd_ne(none).to_bitmask() as u32;
                let mut rest = changed;
                while rest != 0 {
                    let lane = rest.trailing_zeros() as usize;
                    rest &= rest - 1;
                    let is_front = is_inside >> lane & 1 == 1;
                    let is_done = if several >> lane & 1 == 0 {
                        let layer = &scratch.layers[of_layer[lane] as usize - 1];
                        let owner_after: [u32; LANES] = state[layer.word % WORDS].into();
                        let goes_with_result = (owner_after[lane] & layer.bit != 0) == is_front;
                        let body = if goes_with_result {
                            layer.slot
                        } else {
                            let inside = self.of_lane(lane, if is_front { &state } else { &before });
                            sink.body(self.shrunk, &inside[..self.shrunk.words()]).unwrap_or(layer.slot)
                        };
                        let what = self.fragments.what[layer.layer as usize][lane];
                        sink.take_one(lane, Survivor { key: keys[lane], what, owner: layer.slot, body, is_front })
                    } else {
                        scratch.members.clear();
                        self.members(lane, keys[lane], &mut scratch.members);
                        let words = self.shrunk.words();
                        let peel = Peel {
                            lane,
                            key: keys[lane],
                            members: &scratch.members,
                            before: &self.of_lane(lane, &before)[..words],
                            after: &self.of_lane(lane, &state)[..words],
                            was: !is_front,
                            is: is_front,
                        };
                        sink.take(self.shrunk, &peel)
                    };
                    if is_done {
                        alive &= !(1 << lane);
                    }
                }
                if alive == 0 {
                    return;
                }
            }
            (was, last) = (is, next);
        }
    }

    /// One pixel's state.
    #[inline(always)]
    fn of_lane<S: Simd, const WORDS: usize>(&self, lane: usize, state: &[u32x8<S>; WORDS]) -> [u32; WORDS] {
        let mut words = [0; WORDS];
        for (word, lanes) in words.iter_mut().zip(state) {
            let lanes: [u32; LANES] = (*lanes).into();
            *word = lanes[lane];
        }
        words
    }

    /// Fills the lists of layers; in order of their nearest fragments where there are many.
    #[inline(always)]
    fn gather<S: Simd>(&self, simd: S, lanes: &mut LaneScratch<S>, scratch: &mut PeelScratch) {
        scratch.layers.clear();
        for &layer in self.layers {
            let slot = self.fragments.heads[layer as usize].slot as usize;
            scratch.layers.push(GatheredLayer {
                layer,
                slot: slot as u32,
                word: slot / SLOTS_A_WORD,
                bit: 1 << (slot % SLOTS_A_WORD),
                is_closed: self.kinds[slot] == SlotKind::Closed,
                nearest: 0.0,
            });
        }
        if scratch.layers.len() > UNORDERED_LAYERS {
            for gathered in &mut scratch.layers {
                let keys = f32x8::from_slice(simd, &self.fragments.keys[gathered.layer as usize]);
                gathered.nearest = keys.reduce_max();
            }
            scratch.layers.sort_unstable_by(|a, b| b.nearest.total_cmp(&a.nearest).then(a.layer.cmp(&b.layer)));
        }
        lanes.keys.clear();
        for gathered in &scratch.layers {
            lanes.keys.push(f32x8::from_slice(simd, &self.fragments.keys[gathered.layer as usize]));
        }
    }

    /// The fragments of pixel `lane` with just this key.
    fn members(&self, lane: usize, key: f32, members: &mut Vec<Member>) {
        for &layer in self.layers {
            if self.fragments.keys[layer as usize][lane] == key {
                members.push((self.fragments.heads[layer as usize].slot, self.fragments.what[layer as usize][lane]));
            }
        }
    }

    fn peel_sorted(&self, scratch: &mut PeelScratch, sink: &mut impl Sink) {
        for lane in (0..LANES).filter(|lane| self.wanted >> lane & 1 == 1) {
            self.peel_pixel(lane, scratch, sink);
        }
    }

    fn peel_pixel(&self, lane: usize, scratch: &mut PeelScratch, sink: &mut impl Sink) {
        let PeelScratch { counters, sorted, members, before, after, .. } = scratch;
        sorted.clear();
        for &layer in self.layers {
            let key = self.fragments.keys[layer as usize][lane];
            if key > ABSENT {
                sorted.push((
                    key,
                    self.fragments.heads[layer as usize].slot,
                    self.fragments.what[layer as usize][lane],
                ));
            }
        }
        sorted.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then((a.1, a.2).cmp(&(b.1, b.2))));
        counters.reset(self.shrunk);
        before.clear();
        before.resize(self.shrunk.words(), 0);
        let beginning = sorted.iter().filter(|(_, slot, _)| self.kinds[*slot as usize] == SlotKind::Closed);
        let endless = self.begins_inside.iter().filter(|(_, pixels)| pixels >> lane & 1 == 1);
        for slot in beginning.map(|(_, slot, _)| *slot).chain(endless.map(|(slot, _)| *slot)) {
            counters.toggle(self.shrunk, slot as usize);
            turn(before, slot);
        }
        after.clone_from(before);
        let mut was = counters.value(self.shrunk);
        for peel in sorted.chunk_by(|a, b| a.0 == b.0) {
            let mut has_sheet = false;
            for &(_, slot, _) in peel {
                if self.kinds[slot as usize] == SlotKind::Sheet {
                    has_sheet = true;
                } else {
                    counters.toggle(self.shrunk, slot as usize);
                    turn(after, slot);
                }
            }
            let is = counters.value(self.shrunk);
            if was != is || has_sheet {
                members.clear();
                members.extend(peel.iter().map(|&(_, slot, what)| (slot, what)));
                let peel = Peel { lane, key: peel[0].0, members, before, after, was, is };
                if sink.take(self.shrunk, &peel) {
                    return;
                }
            }
            for &(_, slot, _) in peel.iter().filter(|(_, slot, _)| self.kinds[*slot as usize] != SlotKind::Sheet) {
                turn(before, slot);
            }
            was = is;
        }
    }
}
