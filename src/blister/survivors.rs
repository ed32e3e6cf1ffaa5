//! The boundaries of a block, gathered by pixel.
//!
//! *Practice.* Peels come pixel by pixel in any order; rows of pixels are handed over in order. Between the two a boundary is a
//! [`Survivor`] of twenty bytes: what is looked up and computed for it is left to [`write`](super::write), row by row.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x8, mask32x8, u32x8};

use super::fragments::{BLOCK_WIDTH, LANES};
use super::model::Look;
use super::peel::{FoundLanes, Peel, Sink};
use super::solids::SolidHit;
use super::ties::{Judge, State, is_inside};
use crate::csg::{LeafId, Shrunk};

/// A boundary of the result at one pixel.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Survivor {
    pub key: f32,
    /// The triangle, or the solid's hit.
    pub what: u32,
    /// Whose surface it is, a slot.
    pub owner: u32,
    /// Whose material lies behind, a slot.
    pub body: u32,
    /// Whether the result is entered.
    pub is_front: bool,
}

/// How a slot looks.
#[derive(Debug, Clone, Copy)]
pub(super) struct SlotLook {
    pub leaf: LeafId,
    pub look: Look,
    pub is_solid: bool,
    /// Whether nothing behind its boundaries is wanted.
    pub stops: bool,
}

/// Pixels of a block's row.
const HALF: usize = BLOCK_WIDTH as usize;

/// Eight survivors, one a pixel.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Eight {
    keys: [f32; LANES],
    what: [u32; LANES],
    owners: [u32; LANES],
    /// Body and facing, as [`packed`].
    bodies: [u32; LANES],
}

/// A body's slot and the highest bit set where the result is entered.
fn packed(body: u32, is_front: bool) -> u32 {
    body | (u32::from(is_front) << 31)
}

/// The survivors of a block, and of the rows that its pixels lie in.
#[derive(Debug)]
pub(super) struct Survivors {
    /// Each pixel's first, then each pixel's second, and so on; at least one.
    levels: Vec<Eight>,
    /// How many each pixel has.
    counts: [u32; LANES],
    pub rows: [Row; LANES / BLOCK_WIDTH as usize],
}

impl Default for Survivors {
    fn default() -> Self {
        Self { levels: vec![Eight::default()], counts: [0; LANES], rows: Default::default() }
    }
}

/// A row of pixels: in their order, front to back for each.
#[derive(Debug, Default)]
pub(super) struct Row {
    /// Each with the column of its pixel, from the row's first.
    pub survivors: Vec<(u32, Survivor)>,
    /// By pixel: how many are its.
    pub counts: Vec<u32>,
}

impl Row {
    /// Appends the pixels `lanes` of a block, which have as many survivors as `counts` says.
    #[inline(always)]
    fn extend(&mut self, levels: &[Eight], counts: &[u32; LANES], lanes: impl Iterator<Item = usize>) {
        for lane in lanes {
            let (column, count) = (self.counts.len() as u32, counts[lane]);
            self.survivors.extend(levels[..count as usize].iter().map(|level| (column, level.get(lane))));
            self.counts.push(count);
        }
    }
}

impl Eight {
    /// What each pixel shows.
    pub fn what(&self) -> &[u32; LANES] {
        &self.what
    }

    /// Whose each pixel is, a slot.
    pub fn owners(&self) -> &[u32; LANES] {
        &self.owners
    }

    /// Puts in what the pixels `lanes` show, whoever asks for no more than that.
    #[inline(always)]
    pub fn put_lanes<S: Simd>(&mut self, simd: S, lanes: mask32x8<S>, what: u32x8<S>, owners: u32x8<S>) {
        self.what = lanes.select(what, u32x8::from_slice(simd, &self.what)).into();
        self.owners = lanes.select(owners, u32x8::from_slice(simd, &self.owners)).into();
    }

    fn get(&self, lane: usize) -> Survivor {
        let body = self.bodies[lane];
        Survivor {
            key: self.keys[lane],
            what: self.what[lane],
            owner: self.owners[lane],
            body: body & (u32::MAX >> 1),
            is_front: body >> 31 == 1,
        }
    }

    #[inline(always)]
    fn set(&mut self, lane: usize, survivor: &Survivor) {
        self.keys[lane] = survivor.key;
        self.what[lane] = survivor.what;
        self.owners[lane] = survivor.owner;
        self.bodies[lane] = packed(survivor.body, survivor.is_front);
    }

    #[inline(always)]
    fn set_lanes<S: Simd>(&mut self, simd: S, lanes: mask32x8<S>, found: &FoundLanes<S>) {
        self.keys = lanes.select(found.keys, f32x8::from_slice(simd, &self.keys)).into();
        self.what = lanes.select(found.what, u32x8::from_slice(simd, &self.what)).into();
        self.owners = lanes.select(found.owners, u32x8::from_slice(simd, &self.owners)).into();
        let bodies = found.bodies | (found.is_front & (1 << 31));
        self.bodies = lanes.select(bodies, u32x8::from_slice(simd, &self.bodies)).into();
    }
}

impl Survivors {
    /// Ends a block: appends the `wanted` pixels to their rows.
    #[inline(always)]
    pub fn end_block(&mut self, wanted: u8) {
        for (number, row) in self.rows.iter_mut().enumerate() {
            let lanes = number * HALF..(number + 1) * HALF;
            if wanted == u8::MAX {
                row.extend(&self.levels, &self.counts, lanes);
            } else {
                row.extend(&self.levels, &self.counts, lanes.filter(|lane| wanted >> lane & 1 == 1));
            }
        }
        self.counts = [0; LANES];
    }

    /// Drops what was found of a block; returns each pixel's first survivor, and which pixels have one.
    pub fn take_block(&mut self) -> (Eight, u8) {
        let has = |has, lane: usize| has | u8::from(self.counts[lane] > 0) << lane;
        let has = (0..LANES).fold(0, has);
        self.counts = [0; LANES];
        (self.levels[0], has)
    }

    /// Puts back what [`take_block`](Self::take_block) returned.
    pub fn put_block(&mut self, first: &Eight, has: u8) {
        self.levels[0] = *first;
        self.counts = std::array::from_fn(|lane| u32::from(has >> lane & 1));
    }

    /// Ends a row of blocks.
    pub fn clear_rows(&mut self) {
        for row in &mut self.rows {
            row.survivors.clear();
            row.counts.clear();
        }
    }

    #[inline(always)]
    fn put(&mut self, lane: usize, survivor: Survivor) {
        self.level(self.counts[lane]).set(lane, &survivor);
        self.counts[lane] += 1;
    }

    #[inline(always)]
    fn put_lanes<S: Simd>(&mut self, simd: S, lanes: mask32x8<S>, found: &FoundLanes<S>) {
        let counts = u32x8::from_slice(simd, &self.counts);
        let mut rest = lanes.to_bitmask() as u32;
        // Mostly all of them have as many.
        while rest != 0 {
            let count = self.counts[rest.trailing_zeros() as usize];
            let alike = lanes & counts.simd_eq(count);
            self.level(count).set_lanes(simd, alike, found);
            rest &= !(alike.to_bitmask() as u32);
        }
        self.counts = (counts + lanes.select(u32x8::splat(simd, 1), u32x8::splat(simd, 0))).into();
    }

    /// Where survivors go that have `count` before them.
    #[inline(always)]
    fn level(&mut self, count: u32) -> &mut Eight {
        if self.levels.len() <= count as usize {
            self.levels.resize(count as usize + 1, Eight::default());
        }
        &mut self.levels[count as usize]
    }
}

/// Decides what survives, with the rules of [`ties`](super::ties).
pub(super) struct Chooser<'a> {
    pub looks: &'a [SlotLook],
    pub hits: &'a [SolidHit],
    pub judge: &'a mut Judge,
    pub out: &'a mut Survivors,
    /// Whether anybody asks for bodies: the owner stands for them where nobody does.
    pub wants_bodies: bool,
}

impl Sink for Chooser<'_> {
    #[inline(always)]
    fn take_one(&mut self, lane: usize, survivor: Survivor) -> bool {
        let look = &self.looks[survivor.owner as usize];
        // A half-space shows only within its square.
        if look.is_solid && !self.hits[survivor.what as usize].is_drawn {
            return false;
        }
        self.out.put(lane, survivor);
        look.stops
    }

    #[inline(always)]
    fn take_lanes<S: Simd>(&mut self, simd: S, lanes: mask32x8<S>, found: &FoundLanes<S>) {
        self.out.put_lanes(simd, lanes, found);
    }

    fn wants_bodies(&self) -> bool {
        self.wants_bodies
    }

    fn body(&mut self, shrunk: &Shrunk, inside: &State) -> Option<u32> {
        self.judge.body(shrunk, inside)
    }

    #[inline(never)]
    fn take(&mut self, shrunk: &Shrunk, peel: &Peel<'_>) -> bool {
        let (owner, body, is_front) = if peel.was != peel.is {
            let owner = match peel.members {
                [(slot, _)] => *slot,
                _ => self.judge.owner(shrunk, peel.before, peel.after, peel.is),
            };
            let inside = if peel.is { peel.after } else { peel.before };
            let goes_with_result = is_inside(peel.after, owner) == peel.is;
            let is_own = goes_with_result || !self.wants_bodies;
            let body = if is_own { owner } else { self.judge.body(shrunk, inside).unwrap_or(owner) };
            (owner, body, peel.is)
        } else {
            let Some(owner) = self.sheet(shrunk, peel) else { return false };
            (owner, owner, true)
        };
        // Of several fragments of the owner, whose normals alone differ, the first by number.
        let of_owner = peel.members.iter().filter(|(slot, _)| *slot == owner).map(|(_, what)| *what);
        let Some(what) = of_owner.min() else { return false };
        self.take_one(peel.lane, Survivor { key: peel.key, what, owner, body, is_front })
    }
}

impl Chooser<'_> {
    /// The first of the peel's sheets that shows: the result would have it there if it were a solid, and does not otherwise.
    fn sheet(&mut self, shrunk: &Shrunk, peel: &Peel<'_>) -> Option<u32> {
        let is_sheet = |slot: &u32| self.looks[*slot as usize].look.is_sheet;
        let mut sheets: Vec<u32> = peel.members.iter().map(|(slot, _)| *slot).filter(is_sheet).collect();
        sheets.sort_unstable();
        sheets.into_iter().find(|&slot| {
            [peel.before, peel.after]
                .into_iter()
                .any(|state| !self.judge.eval(shrunk, state) && self.judge.eval_turned(shrunk, state, slot))
        })
    }
}
