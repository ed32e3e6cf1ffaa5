//! What a boundary of the result is, along one ray.
//!
//! Leaves toggle at their crossings, front to back. Crossings that coincide toggle together. Where the expression before
//! such a set differs from the expression after it, there is a boundary: so A − A is empty, and coplanar faces of a union
//! show no seam.
//!
//! *Who owns it*: of the set's leaves those that matter: whose toggling alone would change the expression before the set, or
//! whose not toggling would change it after. Of these first one that goes the result's way (positive before complemented),
//! then the least index, so the order of leaves changes nothing.
//!
//! *Whose body*: the owner's if it goes the result's way. Else the owner cuts, and the body is the first leaf which the
//! result just inside could not do without: the result fails where the leaf's uncomplemented occurrences are out. Complemented
//! occurrences stay as they are, so that within `b` the body of `(a - b) | b` is `b`, whose material is there.
//!
//! A *sheet* is never in or out. Its surface shows where the result would have it if the sheet were a solid there and would
//! not have it otherwise; seen from either side it is a front, since what is seen is where the ray meets it.

use glam::DVec3;

use super::Occurrences;
use crate::layers::{Facing, LayerLimit};

/// One crossing of the ray and a leaf's surface.
#[derive(Debug, Clone, Copy)]
pub(super) struct Crossing {
    /// Planar depth; may be negative.
    pub t: f64,
    /// Index into the reference's own list of leaves.
    pub slot: usize,
    /// Unit normal of the leaf, world space.
    pub normal: DVec3,
    /// Linear RGB.
    pub colour: [f32; 3],
    /// Whether the surface shows there (a half-space shows only within its square).
    pub drawn: bool,
}

/// A boundary of the result.
#[derive(Debug, Clone, Copy)]
pub(super) struct Settled {
    pub crossing: Crossing,
    /// Slot of the leaf whose material lies behind.
    pub body: usize,
    pub facing: Facing,
}

/// The boundaries beyond depth 0. `slots` gives, in the order of leaf indices, each leaf's index and whether it is a sheet;
/// `states` whether the ray's beginning, infinitely far behind the eye, is inside each.
pub(super) fn settle(
    slots: &[(u32, bool)],
    mut states: Vec<bool>,
    mut crossings: Vec<Crossing>,
    coincidence: f64,
    inside: &Occurrences,
    limit: LayerLimit,
) -> Vec<Settled> {
    for (state, (_, sheet)) in states.iter_mut().zip(slots) {
        *state &= !sheet;
    }
    let slot_of = |leaf: u32| slots.binary_search_by_key(&leaf, |slot| slot.0);
    let result = |states: &[bool]| inside(&|leaf, _| slot_of(leaf).is_ok_and(|slot| states[slot]));
    let result_without = |states: &[bool], gone: &[bool]| {
        inside(&|leaf, complemented| slot_of(leaf).is_ok_and(|slot| states[slot] && (complemented || !gone[slot])))
    };
    crossings.sort_by(|a, b| a.t.total_cmp(&b.t).then(a.slot.cmp(&b.slot)));
    let mut settled = Vec::new();
    let mut begin = 0;
    while begin < crossings.len() {
        let together = crossings[begin..].iter().take_while(|c| c.t - crossings[begin].t <= coincidence).count();
        let set = &crossings[begin..begin + together];
        begin += together;

        let before = states.clone();
        for crossing in set.iter().filter(|c| !slots[c.slot].1) {
            states[crossing.slot] ^= true;
        }
        // What lies behind the eye only sets the states.
        if !(set[0].t > 0.0) {
            continue;
        }
        let found = solid_boundary(set, &before, &states, &result, &result_without)
            .or_else(|| sheet_boundary(set, slots, &before, &states, &result));
        settled.extend(found.filter(|found| found.crossing.drawn));
        if limit == LayerLimit::Nearest && !settled.is_empty() {
            break;
        }
    }
    settled
}

fn flipped(states: &[bool], slot: usize) -> Vec<bool> {
    let mut states = states.to_vec();
    states[slot] ^= true;
    states
}

fn solid_boundary(
    set: &[Crossing],
    before: &[bool],
    after: &[bool],
    result: &impl Fn(&[bool]) -> bool,
    result_without: &impl Fn(&[bool], &[bool]) -> bool,
) -> Option<Settled> {
    let (was, is) = (result(before), result(after));
    if was == is {
        return None;
    }
    let toggled: Vec<usize> = (0..before.len()).filter(|&slot| before[slot] != after[slot]).collect();
    let matters = |slot: &usize| result(&flipped(before, *slot)) != was || result(&flipped(after, *slot)) != is;
    let mut active: Vec<usize> = toggled.iter().copied().filter(matters).collect();
    if active.is_empty() {
        active = toggled;
    }
    // `min_by_key` takes the first of equals, and slots are in the order of leaf indices.
    let owner = *active.iter().min_by_key(|&&slot| after[slot] != is)?;
    let body = if after[owner] == is {
        owner
    } else {
        body_of(if is { after } else { before }, result_without).unwrap_or(owner)
    };
    let crossing = *set.iter().find(|c| c.slot == owner)?;
    Some(Settled { crossing, body, facing: if is { Facing::Front } else { Facing::Back } })
}

/// The first leaf that the result, which holds in `states`, could not do without. If it could do without any one (a union of
/// overlapping leaves), the first of those left when leaves are taken away from the last on as long as the result holds.
fn body_of(states: &[bool], result_without: &impl Fn(&[bool], &[bool]) -> bool) -> Option<usize> {
    let inside = || (0..states.len()).filter(|&slot| states[slot]);
    let only = |slot: usize| (0..states.len()).map(|other| other == slot).collect::<Vec<bool>>();
    if let Some(needed) = inside().find(|&slot| !result_without(states, &only(slot))) {
        return Some(needed);
    }
    let mut gone = vec![false; states.len()];
    for slot in inside().rev() {
        gone[slot] = true;
        gone[slot] = result_without(states, &gone);
    }
    inside().find(|&slot| !gone[slot])
}

fn sheet_boundary(
    set: &[Crossing],
    slots: &[(u32, bool)],
    before: &[bool],
    after: &[bool],
    result: &impl Fn(&[bool]) -> bool,
) -> Option<Settled> {
    let shows =
        |slot: usize| [before, after].into_iter().any(|states| !result(states) && result(&flipped(states, slot)));
    let crossing = set.iter().filter(|c| slots[c.slot].1 && shows(c.slot)).min_by_key(|c| c.slot)?;
    Some(Settled { crossing: *crossing, body: crossing.slot, facing: Facing::Front })
}
