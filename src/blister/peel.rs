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
//! *Practice.* Lanes are pixels. A boundary found is written by scalar code ([`Sink`]): there is mostly one a pixel.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x8, u32x8};

use super::fragments::{ABSENT, Fragments, LANES};
use super::ties::{State, turn};
use crate::csg::flat::SLOTS_A_WORD;
use crate::csg::{Counters, Shrunk};

/// Blocks with more layers are sorted. Two passes over n layers for each of up to n peels, at a few cycles for eight pixels,
/// meet n log n scalar steps for each of them at about here.
const MOST_LAYERS: usize = 96;

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
    /// Returns whether the pixel needs nothing behind this.
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
}

/// Buffers that are kept from block to block.
#[derive(Debug, Default)]
pub(super) struct PeelScratch {
    counters: Counters,
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
    /// By layer: word of the state, and bit.
    bits: Vec<(usize, u32)>,
}

impl<S: Simd> Default for LaneScratch<S> {
    fn default() -> Self {
        Self { nodes: Vec::new(), keys: Vec::new(), bits: Vec::new() }
    }
}

impl Block<'_> {
    /// Hands every peel that matters to `sink`.
    #[inline(always)]
    pub fn peel<S: Simd>(&self, simd: S, lanes: &mut LaneScratch<S>, scratch: &mut PeelScratch, sink: &mut impl Sink) {
        let has_sheet = || {
            let slot = |layer: &u32| self.fragments.heads[*layer as usize].slot;
            self.layers.iter().any(|layer| self.kinds[slot(layer) as usize] == SlotKind::Sheet)
        };
        if self.layers.len() > MOST_LAYERS || self.shrunk.words() > MOST_WORDS || has_sheet() {
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
        lanes.keys.clear();
        lanes.bits.clear();
        for &layer in self.layers {
            let slot = self.fragments.heads[layer as usize].slot as usize;
            let (word, bit) = (slot / SLOTS_A_WORD % WORDS, 1_u32 << (slot % SLOTS_A_WORD));
            let keys = f32x8::from_slice(simd, &self.fragments.keys[layer as usize]);
            lanes.keys.push(keys);
            lanes.bits.push((word, bit));
            if self.kinds[slot] == SlotKind::Closed {
                state[word] = state[word] ^ keys.simd_gt(absent).select(u32x8::splat(simd, bit), none);
            }
        }
        for &(slot, pixels) in self.begins_inside {
            let (word, bit) = (slot as usize / SLOTS_A_WORD % WORDS, 1_u32 << (slot as usize % SLOTS_A_WORD));
            let inside: [u32; LANES] = std::array::from_fn(|lane| if pixels >> lane & 1 == 1 { bit } else { 0 });
            state[word] = state[word] | u32x8::from_slice(simd, &inside);
        }
        let mut was = self.shrunk.eval_lanes(simd, &state, &mut lanes.nodes);
        let mut last = f32x8::splat(simd, f32::INFINITY);
        let mut alive = u32::from(self.wanted);
        loop {
            let mut next = absent;
            for &keys in &lanes.keys {
                next = next.max(keys.simd_lt(last).select(keys, absent));
            }
            alive &= next.simd_gt(absent).to_bitmask() as u32;
            if alive == 0 {
                return;
            }
            let before = state;
            for (&keys, &(word, bit)) in lanes.keys.iter().zip(&lanes.bits) {
                let toggled = keys.simd_eq(next).select(u32x8::splat(simd, bit), none);
                state[word] = state[word] ^ toggled;
            }
            let is = self.shrunk.eval_lanes(simd, &state, &mut lanes.nodes);
            let changed = is.simd_ne(was).to_bitmask() as u32 & alive;
            if changed != 0 {
                let words = self.shrunk.words();
                let spread = |state: &[u32x8<S>; WORDS]| -> [[u32; LANES]; WORDS] {
                    std::array::from_fn(|word| state[word].into())
                };
                let (before, after) = (spread(&before), spread(&state));
                let keys: [f32; LANES] = next.into();
                let is: [u32; LANES] = is.into();
                let mut rest = changed;
                while rest != 0 {
                    let lane = rest.trailing_zeros() as usize;
                    rest &= rest - 1;
                    self.members(lane, keys[lane], &mut scratch.members);
                    let of_lane = |state: &[[u32; LANES]; WORDS]| -> [u32; WORDS] {
                        std::array::from_fn(|word| state[word][lane])
                    };
                    let peel = Peel {
                        lane,
                        key: keys[lane],
                        members: &scratch.members,
                        before: &of_lane(&before)[..words],
                        after: &of_lane(&after)[..words],
                        was: is[lane] == 0,
                        is: is[lane] != 0,
                    };
                    if sink.take(self.shrunk, &peel) {
                        alive &= !(1 << lane);
                    }
                }
            }
            (was, last) = (is, next);
        }
    }

    /// The fragments of pixel `lane` with just this key.
    #[inline(always)]
    fn members(&self, lane: usize, key: f32, members: &mut Vec<Member>) {
        members.clear();
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
        let PeelScratch { counters, sorted, members, before, after } = scratch;
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
