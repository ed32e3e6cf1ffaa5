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
#[derive(Debug, Default)]
pub(super) struct Survivors {
    /// Each pixel's first.
    first: Eight,
    /// Which pixels have one.
    has: u8,
    /// The others, front to back for each pixel.
    more: Vec<(usize, Survivor)>,
    pub rows: [Row; LANES / BLOCK_WIDTH as usize],
}

/// A row of pixels: in their order, front to back for each.
#[derive(Debug, Default)]
pub(super) struct Row {
    keys: Vec<f32>,
    what: Vec<u32>,
    owners: Vec<u32>,
    bodies: Vec<u32>,
    /// Of the pixel, from the row's first.
    columns: Vec<u32>,
    /// By pixel: how many are its.
    pub counts: Vec<u32>,
}

impl Row {
    /// Its survivors.
    pub fn len(&self) -> usize {
        self.keys.len()
    }

    /// A survivor and the column of its pixel.
    #[inline(always)]
    pub fn survivor(&self, number: usize) -> (u32, Survivor) {
        let body = self.bodies[number];
        let survivor = Survivor {
            key: self.keys[number],
            what: self.what[number],
            owner: self.owners[number],
            body: body & (u32::MAX >> 1),
            is_front: body >> 31 == 1,
        };
        (self.columns[number], survivor)
    }

    /// Appends one survivor of the pixel that is counted next.
    fn push(&mut self, survivor: &Survivor) {
        self.columns.push(self.counts.len() as u32);
        self.keys.push(survivor.key);
        self.what.push(survivor.what);
        self.owners.push(survivor.owner);
        self.bodies.push(packed(survivor.body, survivor.is_front));
    }

    /// Appends a row of a block, of which every pixel has one survivor.
    #[inline(always)]
    fn extend(&mut self, from: &Eight, row: usize) {
        // Arrays, whose length the compiler knows: four words are one store.
        fn half<T: Copy>(of: &[T; LANES], row: usize) -> [T; HALF] {
            std::array::from_fn(|i| of[row * HALF + i])
        }
        let first = self.counts.len() as u32;
        self.columns.extend_from_slice(&[first, first + 1, first + 2, first + 3]);
        self.keys.extend_from_slice(&half(&from.keys, row));
        self.what.extend_from_slice(&half(&from.what, row));
        self.owners.extend_from_slice(&half(&from.owners, row));
        self.bodies.extend_from_slice(&half(&from.bodies, row));
        self.counts.extend_from_slice(&[1; HALF]);
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
}

impl Survivors {
    /// Ends a block: appends the `wanted` pixels to their rows.
    #[inline(always)]
    pub fn end_block(&mut self, wanted: u8) {
        for (number, row) in self.rows.iter_mut().enumerate() {
            let here = ((1_u8 << HALF) - 1) << (number * HALF);
            if self.has & wanted & here == here && self.more.is_empty() {
                row.extend(&self.first, number);
                continue;
            }
            for lane in (number * HALF..(number + 1) * HALF).filter(|lane| wanted >> lane & 1 == 1) {
                let before = row.keys.len();
                if self.has >> lane & 1 == 1 {
                    row.push(&self.first.get(lane));
                    self.more.iter().filter(|(of, _)| *of == lane).for_each(|(_, more)| row.push(more));
                }
                row.counts.push((row.keys.len() - before) as u32);
            }
        }
        self.forget_block();
    }

    /// Drops what was found of a block; returns each pixel's first survivor, and which pixels have one.
    pub fn take_block(&mut self) -> (Eight, u8) {
        let has = self.has;
        self.forget_block();
        (self.first, has)
    }

    /// Puts back what [`take_block`](Self::take_block) returned.
    pub fn put_block(&mut self, first: &Eight, has: u8) {
        self.first = *first;
        self.has = has;
    }

    fn forget_block(&mut self) {
        self.has = 0;
        self.more.clear();
    }

    /// Ends a row of blocks.
    pub fn clear_rows(&mut self) {
        for row in &mut self.rows {
            row.keys.clear();
            row.what.clear();
            row.owners.clear();
            row.bodies.clear();
            row.columns.clear();
            row.counts.clear();
        }
    }

    #[inline(always)]
    fn put(&mut self, lane: usize, survivor: Survivor) {
        if self.has >> lane & 1 == 0 {
            self.has |= 1 << lane;
            self.first.keys[lane] = survivor.key;
            self.first.what[lane] = survivor.what;
            self.first.owners[lane] = survivor.owner;
            self.first.bodies[lane] = packed(survivor.body, survivor.is_front);
        } else {
            self.more.push((lane, survivor));
        }
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
        let first = &mut self.out.first;
        self.out.has |= lanes.to_bitmask() as u8;
        first.keys = lanes.select(found.keys, f32x8::from_slice(simd, &first.keys)).into();
        first.what = lanes.select(found.what, u32x8::from_slice(simd, &first.what)).into();
        first.owners = lanes.select(found.owners, u32x8::from_slice(simd, &first.owners)).into();
        let bodies = found.bodies | (found.is_front & (1 << 31));
        first.bodies = lanes.select(bodies, u32x8::from_slice(simd, &first.bodies)).into();
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
