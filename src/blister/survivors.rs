//! The boundaries of a block, gathered by pixel.
//!
//! *Practice.* Peels come pixel by pixel in any order; rows of pixels are handed over in order. Between the two a boundary is a
//! [`Survivor`] of twenty bytes: what is looked up and computed for it is left to [`write`](super::write), row by row.

use super::fragments::{BLOCK_WIDTH, LANES};
use super::model::Look;
use super::peel::{Peel, Sink};
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

/// The survivors of a block and of the rows that its pixels lie in.
#[derive(Debug, Default)]
pub(super) struct Survivors {
    /// Each pixel's first.
    first: [Survivor; LANES],
    /// Which pixels have one.
    has: u8,
    /// The others, front to back for each pixel.
    more: Vec<(usize, Survivor)>,
    pub rows: [Row; LANES / BLOCK_WIDTH as usize],
}

/// A row of pixels.
#[derive(Debug, Default)]
pub(super) struct Row {
    /// In the order of pixels, front to back for each.
    pub survivors: Vec<Survivor>,
    /// By pixel: how many are its.
    pub counts: Vec<u32>,
}

impl Survivors {
    /// Ends a block: appends the `wanted` pixels to their rows.
    #[inline(always)]
    pub fn end_block(&mut self, wanted: u8) {
        for (row, lanes) in self.rows.iter_mut().zip([0..BLOCK_WIDTH as usize, BLOCK_WIDTH as usize..LANES]) {
            for lane in lanes.filter(|lane| wanted >> lane & 1 == 1) {
                let before = row.survivors.len();
                if self.has >> lane & 1 == 1 {
                    row.survivors.push(self.first[lane]);
                    if !self.more.is_empty() {
                        row.survivors.extend(self.more.iter().filter(|(of, _)| *of == lane).map(|(_, more)| *more));
                    }
                }
                row.counts.push((row.survivors.len() - before) as u32);
            }
        }
        self.has = 0;
        self.more.clear();
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
        if self.has >> lane & 1 == 0 {
            self.has |= 1 << lane;
            self.first[lane] = survivor;
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
            let body = if goes_with_result { owner } else { self.judge.body(shrunk, inside).unwrap_or(owner) };
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
