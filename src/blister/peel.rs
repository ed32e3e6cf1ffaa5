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
use fearless_simd::{Simd, f32x8, mask32x8, u32x8};

use super::fragments::{ABSENT, Fragments, LANES};
use super::survivors::Survivor;
use super::ties::{State, is_inside, turn};
use crate::csg::flat::SLOTS_A_WORD;
use crate::csg::{Counters, Shrunk};

/// Blocks with more layers are sorted. Two passes over n layers for each of up to n peels, at a few cycles for eight pixels,
/// meet n log n scalar steps for each of them at about here.
const MOST_LAYERS: usize = 96;

/// Blocks with more layers are put in order of their nearest fragments, so that a peel looks only at the layers that reach
/// it. Below, the order costs more than it saves.
const UNORDERED_LAYERS: usize = 12;

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

    /// As [`take_one`](Self::take_one) for several pixels of a [`Block::is_plain`] block, which then need nothing more if
    /// its [`ends`](Block::ends) says so.
    fn take_lanes<S: Simd>(&mut self, simd: S, lanes: mask32x8<S>, found: &FoundLanes<S>);

    /// Whether bodies are asked for.
    fn wants_bodies(&self) -> bool;

    /// The body of a boundary whose owner goes against the result, given the state just inside it.
    fn body(&mut self, shrunk: &Shrunk, inside: &State) -> Option<u32>;

    /// Any other peel that may be a boundary. Returns whether the pixel needs nothing behind this.
    fn take(&mut self, shrunk: &Shrunk, peel: &Peel<'_>) -> bool;
}

/// Boundaries of eight pixels at which one fragment alone toggles.
pub(super) struct FoundLanes<S: Simd> {
    pub keys: f32x8<S>,
    pub what: u32x8<S>,
    /// Slots.
    pub owners: u32x8<S>,
    pub bodies: u32x8<S>,
    /// All bits where the result is entered, else none.
    pub is_front: u32x8<S>,
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
    /// Which pixels are to be peeled.
    pub wanted: u8,
    /// Whether any slot is a sheet.
    pub has_sheets: bool,
    /// Whether all boundaries are alike, wherever they are and whosesoever: they show, and all or none are all that their pixels
    /// need.
    pub is_plain: bool,
    /// Whether any boundary is all that its pixel needs, if [plain](Self::is_plain).
    pub ends: bool,
    /// Whether every ray begins outside of every slot, so that no parity is needed, and fragments may be missing.
    pub is_partial: bool,
    /// Only fragments with greater keys are peeled.
    pub floor: f32,
    /// Only fragments with lesser keys are: the others have been.
    pub ceiling: f32,
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
    /// For putting the layers in order.
    order: Vec<u64>,
    unordered: Vec<GatheredLayer>,
    /// Of one pixel: key, slot, what.
    sorted: Vec<(f32, u32, u32)>,
    members: Vec<Member>,
    before: Vec<u32>,
    after: Vec<u32>,
    outside: Vec<[u32; LANES]>,
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
        let mut state = std::mem::take(&mut scratch.outside);
        state.clear();
        state.resize(self.shrunk.words(), [0; LANES]);
        self.peel_on(simd, &mut state, lanes, scratch, sink);
        scratch.outside = state;
    }

    /// As [`peel`](Self::peel), from `state` on, the pixels' memberships at the ceiling word by word. Of pixels that are
    /// still wanted it becomes that at the floor.
    #[inline(always)]
    pub fn peel_on<S: Simd>(
        &self,
        simd: S,
        state: &mut [[u32; LANES]],
        lanes: &mut LaneScratch<S>,
        scratch: &mut PeelScratch,
        sink: &mut impl Sink,
    ) {
        if self.layers.len() > MOST_LAYERS || self.shrunk.words() > MOST_WORDS || self.has_sheets {
            return self.peel_sorted(state, scratch, sink);
        }
        match self.shrunk.words() {
            1 => self.peel_lanes::<S, 1>(simd, state, lanes, scratch, sink),
            2 => self.peel_lanes::<S, 2>(simd, state, lanes, scratch, sink),
            3..=4 => self.peel_lanes::<S, 4>(simd, state, lanes, scratch, sink),
            _ => self.peel_lanes::<S, MOST_WORDS>(simd, state, lanes, scratch, sink),
        }
    }

    #[inline(always)]
    fn peel_lanes<S: Simd, const WORDS: usize>(
        &self,
        simd: S,
        kept: &mut [[u32; LANES]],
        lanes: &mut LaneScratch<S>,
        scratch: &mut PeelScratch,
        sink: &mut impl Sink,
    ) {
        let (none, absent) = (u32x8::splat(simd, 0), f32x8::splat(simd, ABSENT));
        let mut state = [none; WORDS];
        for (word, kept) in state.iter_mut().zip(&*kept) {
            *word = u32x8::from_slice(simd, kept);
        }
        self.gather(simd, lanes, scratch);
        for (&keys, layer) in lanes.keys.iter().zip(&scratch.layers) {
            if layer.is_closed && !self.is_partial {
                let bit = u32x8::splat(simd, layer.bit);
                state[layer.word % WORDS] ^= keys.simd_gt(absent).select(bit, none);
            }
        }
        for &(slot, pixels) in self.begins_inside {
            let (word, bit) = (slot as usize / SLOTS_A_WORD % WORDS, 1_u32 << (slot as usize % SLOTS_A_WORD));
            let mut inside = [0; LANES];
            for (lane, inside) in inside.iter_mut().enumerate() {
                *inside = if pixels >> lane & 1 == 1 { bit } else { 0 };
            }
            state[word] |= u32x8::from_slice(simd, &inside);
        }
        let mut was = self.shrunk.eval_lanes(simd, &state, &mut lanes.nodes);
        let mut last = f32x8::splat(simd, self.ceiling);
        let mut alive = u32::from(self.wanted);
        // The layers before `first` have been peeled off.
        let mut first = 0;
        let is_ordered = lanes.keys.len() > UNORDERED_LAYERS;
        loop {
            while first < lanes.keys.len() {
                let keys = lanes.keys[first];
                let ahead = keys.simd_lt(last) & keys.simd_gt(absent);
                if ahead.to_bitmask() as u32 & alive != 0 {
                    break;
                }
                first += 1;
            }
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
                next = next.max(ahead.select(keys, absent));
            }
            // Pixels without more toggle no more: what the state becomes is theirs at the floor.
            next = next.simd_gt(self.floor).select(next, absent);
            alive &= next.simd_gt(absent).to_bitmask() as u32;
            if alive == 0 {
                break;
            }
            let before = state;
            // The layer that each pixel's fragment is in, by its number plus one, and whether there is another.
            let (mut of_layer, mut several) = (none, none);
            let is_any = next.simd_gt(absent);
            for i in first..end {
                let here = lanes.keys[i].simd_eq(next) & is_any;
                let bit = u32x8::splat(simd, scratch.layers[i].bit);
                let word = scratch.layers[i].word % WORDS;
                state[word] ^= here.select(bit, none);
                several |= here.select(of_layer, none);
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
                if self.is_plain && changed & !several != 0 {
                    let lanes_of = changed & !several;
                    let found = self.found(simd, lanes_of, next, &before, &state, is, first..end, lanes, scratch, sink);
                    sink.take_lanes(simd, mask32x8::from_bitmask(simd, u64::from(lanes_of)), &found);
                    if self.ends {
                        alive &= !lanes_of;
                    }
                    rest &= !lanes_of;
                }
                while rest != 0 {
                    let lane = rest.trailing_zeros() as usize;
                    rest &= rest - 1;
                    let is_front = is_inside >> lane & 1 == 1;
                    let is_done = if several >> lane & 1 == 0 {
                        let layer = &scratch.layers[of_layer[lane] as usize - 1];
                        let owner_after: [u32; LANES] = state[layer.word % WORDS].into();
                        let goes_with_result = (owner_after[lane] & layer.bit != 0) == is_front;
                        let body = if goes_with_result || !sink.wants_bodies() {
                            layer.slot
                        } else {
                            let inside = self.of_lane(lane, if is_front { &state } else { &before });
                            sink.body(self.shrunk, &inside[..self.shrunk.words()]).unwrap_or(layer.slot)
                        };
                        let what = self.fragments.what(self.fragments.layer(layer.layer), lane);
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
                    break;
                }
            }
            (was, last) = (is, next);
        }
        for (word, kept) in state.into_iter().zip(kept) {
            *kept = word.into();
        }
    }

    /// The boundaries at which the fragments of `layers` with the keys `next` toggle alone, at the pixels `wanted`.
    #[inline(always)]
    #[allow(clippy::too_many_arguments)]
    fn found<S: Simd, const WORDS: usize>(
        &self,
        simd: S,
        wanted: u32,
        next: f32x8<S>,
        before: &[u32x8<S>; WORDS],
        after: &[u32x8<S>; WORDS],
        is_front: u32x8<S>,
        layers: std::ops::Range<usize>,
        lanes: &LaneScratch<S>,
        scratch: &PeelScratch,
        sink: &mut impl Sink,
    ) -> FoundLanes<S> {
        let none = u32x8::splat(simd, 0);
        let (mut what, mut owners, mut inside) = (none, none, none);
        for i in layers {
            let here = lanes.keys[i].simd_eq(next);
            let layer = &scratch.layers[i];
            what = here.select(self.fragments.what_lanes(simd, self.fragments.layer(layer.layer)), what);
            owners = here.select(u32x8::splat(simd, layer.slot), owners);
            inside = here.select(after[layer.word % WORDS] & layer.bit, inside);
        }
        let goes_with_result = !(inside.simd_eq(0) ^ is_front.simd_eq(0));
        let mut against = if sink.wants_bodies() { !(goes_with_result.to_bitmask() as u32) & wanted } else { 0 };
        let mut bodies = owners;
        if against != 0 {
            let entered = is_front.simd_ne(0);
            let mut states = [none; WORDS];
            for (word, state) in states.iter_mut().enumerate() {
                *state = entered.select(after[word], before[word]);
            }
            while against != 0 {
                // Pixels in the same state have the same body; mostly all of them are.
                let state = self.of_lane(against.trailing_zeros() as usize, &states);
                let mut alike = mask32x8::from_bitmask(simd, u64::from(against));
                for (word, states) in state.iter().zip(&states) {
                    alike &= states.simd_eq(*word);
                }
                if let Some(body) = sink.body(self.shrunk, &state[..self.shrunk.words()]) {
                    bodies = alike.select(u32x8::splat(simd, body), bodies);
                }
                against &= !(alike.to_bitmask() as u32);
            }
        }
        FoundLanes { keys: next, what, owners, bodies, is_front }
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
            let slot = self.fragments.layer(layer).slot as usize;
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
                let keys = f32x8::from_slice(simd, &self.fragments.layer(gathered.layer).keys);
                gathered.nearest = keys.reduce_max();
            }
            scratch.order.clear();
            for (i, gathered) in scratch.layers.iter().enumerate() {
                // As integers in the same order; the greatest key first.
                let bits = gathered.nearest.to_bits();
                let ordered = bits ^ (((bits as i32 >> 31) as u32 >> 1) | 1 << 31);
                scratch.order.push(u64::from(!ordered) << 32 | i as u64);
            }
            scratch.order.sort_unstable();
            scratch.unordered.clone_from(&scratch.layers);
            for (place, number) in scratch.layers.iter_mut().zip(&scratch.order) {
                *place = scratch.unordered[*number as u32 as usize];
            }
        }
        lanes.keys.clear();
        for gathered in &scratch.layers {
            lanes.keys.push(f32x8::from_slice(simd, &self.fragments.layer(gathered.layer).keys));
        }
    }

    /// The fragments of pixel `lane` with just this key.
    fn members(&self, lane: usize, key: f32, members: &mut Vec<Member>) {
        for &layer in self.layers {
            let layer = self.fragments.layer(layer);
            if layer.keys[lane] == key {
                members.push((layer.slot, self.fragments.what(layer, lane)));
            }
        }
    }

    fn peel_sorted(&self, state: &mut [[u32; LANES]], scratch: &mut PeelScratch, sink: &mut impl Sink) {
        for lane in (0..LANES).filter(|lane| self.wanted >> lane & 1 == 1) {
            scratch.before.clear();
            scratch.before.extend(state.iter().map(|word| word[lane]));
            self.peel_pixel(lane, scratch, sink);
            for (word, before) in state.iter_mut().zip(&scratch.before) {
                word[lane] = *before;
            }
        }
    }

    /// From the memberships that `scratch` has as those before to those at the floor.
    fn peel_pixel(&self, lane: usize, scratch: &mut PeelScratch, sink: &mut impl Sink) {
        let PeelScratch { counters, sorted, members, before, after, .. } = scratch;
        sorted.clear();
        for &layer in self.layers {
            let layer = self.fragments.layer(layer);
            let key = layer.keys[lane];
            if key > ABSENT && key < self.ceiling {
                sorted.push((key, layer.slot, self.fragments.what(layer, lane)));
            }
        }
        sorted.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then((a.1, a.2).cmp(&(b.1, b.2))));
        counters.reset(self.shrunk);
        let slots = self.shrunk.slots().len() as u32;
        for slot in (0..slots).filter(|slot| is_inside(before, *slot)) {
            counters.toggle(self.shrunk, slot as usize);
        }
        let by_parity = |slot: u32| !self.is_partial && self.kinds[slot as usize] == SlotKind::Closed;
        let beginning = sorted.iter().filter(|(_, slot, _)| by_parity(*slot));
        let endless = self.begins_inside.iter().filter(|(_, pixels)| pixels >> lane & 1 == 1);
        for slot in beginning.map(|(_, slot, _)| *slot).chain(endless.map(|(slot, _)| *slot)) {
            counters.toggle(self.shrunk, slot as usize);
            turn(before, slot);
        }
        after.clone_from(before);
        let mut was = counters.value(self.shrunk);
        for peel in sorted.chunk_by(|a, b| a.0 == b.0).take_while(|peel| peel[0].0 > self.floor) {
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
