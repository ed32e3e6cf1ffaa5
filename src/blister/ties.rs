//! Who owns a boundary, and whose material lies behind it.
//!
//! *Theory.* Blister §4.3 gives a boundary where several faces coincide to an *active* leaf, one whose membership matters
//! there. Here that is a rule that no order of leaves changes: of the leaves that toggle, those whose toggle alone
//! changes the expression before, or whose staying would change it after; of them first one that goes the result's way
//! (positive before complemented), then the least index. The reference renderer obeys the same rule in code of its own.
//!
//! The *body* is the owner if it goes the result's way. Else the owner cuts, and the body is the first leaf that the result
//! just inside could not do without: that fails where the leaf's uncomplemented occurrences are out. Its complemented ones
//! stay as they are, so that within `b` the body of `(a - b) | b` is `b`.

use crate::csg::Shrunk;
use crate::csg::flat::SLOTS_A_WORD;

/// The memberships of a point in all slots of a [`Shrunk`], a bit each.
pub(super) type State = [u32];

pub(super) fn is_inside(state: &State, slot: u32) -> bool {
    state[slot as usize / SLOTS_A_WORD] >> (slot as usize % SLOTS_A_WORD) & 1 == 1
}

pub(super) fn turn(state: &mut State, slot: u32) {
    state[slot as usize / SLOTS_A_WORD] ^= 1 << (slot as usize % SLOTS_A_WORD);
}

/// What decides ties in one tile. It remembers the last body found: neighbours mostly have the same.
#[derive(Debug, Default)]
pub(super) struct Judge {
    scratch: Vec<bool>,
    state: Vec<u32>,
    /// The state just inside, and its body.
    last_body: Option<(Vec<u32>, u32)>,
}

impl Judge {
    /// Forgets what it knows of another expression.
    pub fn reset(&mut self) {
        self.last_body = None;
    }

    /// Whether the result holds in `state`.
    pub fn eval(&mut self, shrunk: &Shrunk, state: &State) -> bool {
        shrunk.eval(state, &mut self.scratch)
    }

    /// Whether the result holds where `slot` is turned over in `state`.
    pub fn eval_turned(&mut self, shrunk: &Shrunk, state: &State, slot: u32) -> bool {
        self.state.clear();
        self.state.extend_from_slice(state);
        turn(&mut self.state, slot);
        shrunk.eval(&self.state, &mut self.scratch)
    }

    /// The slot that owns the boundary between `before` and `after`, where the result is not the same.
    pub fn owner(&mut self, shrunk: &Shrunk, before: &State, after: &State, is_inside_after: bool) -> u32 {
        let slots = shrunk.slots().len() as u32;
        let toggled = (0..slots).filter(|&slot| is_inside(before, slot) != is_inside(after, slot));
        let mut best = None;
        for slot in toggled {
            let matters = self.eval_turned(shrunk, before, slot) == is_inside_after
                || self.eval_turned(shrunk, after, slot) != is_inside_after;
            let rank = (!matters, is_inside(after, slot) != is_inside_after, slot);
            best = Some(best.map_or(rank, |best: (bool, bool, u32)| best.min(rank)));
        }
        best.expect("the result differs, so some slot does").2
    }

    /// The body of a boundary that `owner` bounds against its own way, given the state just inside the result.
    pub fn body(&mut self, shrunk: &Shrunk, inside: &State) -> Option<u32> {
        if let Some((state, body)) = &self.last_body
            // Mostly one word, for which a call to compare bytes would take longer.
            && state.iter().eq(inside)
        {
            return Some(*body);
        }
        let body = self.find_body(shrunk, inside)?;
        self.last_body = Some((inside.to_vec(), body));
        Some(body)
    }

    fn find_body(&mut self, shrunk: &Shrunk, inside: &State) -> Option<u32> {
        let slots = shrunk.slots().len() as u32;
        let within: Vec<u32> = (0..slots).filter(|&slot| is_inside(inside, slot)).collect();
        let mut gone = vec![0; inside.len()];
        for &slot in &within {
            turn(&mut gone, slot);
            if !shrunk.eval_without(inside, &gone, &mut self.scratch) {
                return Some(slot);
            }
            turn(&mut gone, slot);
        }
        // The result could do without any one of them (a union of overlapping leaves): take them away from the last on, as
        // long as the result holds; the first of those left.
        for &slot in within.iter().rev() {
            turn(&mut gone, slot);
            if !shrunk.eval_without(inside, &gone, &mut self.scratch) {
                turn(&mut gone, slot);
            }
        }
        within.into_iter().find(|&slot| !is_inside(&gone, slot))
    }
}
