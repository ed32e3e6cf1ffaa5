//! Whose material lies behind a surface that another leaf cut.
//!
//! # Theory
//! Where a leaf was subtracted, what is seen is the inside of another: the first that the result there could not do without. The
//! rule is that of every pipeline (`Left::body` in [`super::crossed`] has it for crossings).

use crate::classify::Model;
use crate::csg::LeafId;
use crate::csg::residual::{Crossing, Membership};

/// The leaf whose material lies behind a surface of leaf `own`: its own, or, where it was subtracted, the [`body`]; `holds`
/// decides for leaves that are near.
pub(super) fn body_behind(
    model: &Model,
    own: LeafId,
    crossing: Crossing,
    surfel: usize,
    holds: impl FnMut(LeafId) -> bool,
) -> u32 {
    match crossing {
        Crossing::Rises => own.0,
        Crossing::Falls => body(model, own, |leaf| model.status(own, surfel, leaf), holds).unwrap_or(own).0,
    }
}

/// As [`body_behind`] of a surface of a leaf that was subtracted, where `holds` decides for all leaves.
pub(super) fn body_at(model: &Model, own: LeafId, holds: impl FnMut(LeafId) -> bool) -> Option<LeafId> {
    body(model, own, |_| Membership::Near, holds)
}

/// The first leaf that the result just outside of leaf `own`, where it holds, could not do without; where it could do without
/// any one of them, the first that is left when they are taken away from the last on for as long as it holds. Of a leaf that is
/// taken away the complemented occurrences stay: within `b` the body of `(a - b) | b` is `b`. `status` tells the place of the
/// point in the other leaves, and `holds`, at most once each, in those that are near.
fn body(
    model: &Model,
    own: LeafId,
    status: impl Fn(LeafId) -> Membership,
    mut holds: impl FnMut(LeafId) -> bool,
) -> Option<LeafId> {
    let mut asked: Vec<(LeafId, bool)> = Vec::new();
    let mut inside = |leaf: LeafId| match status(leaf) {
        _ if leaf == own => false,
        Membership::In => true,
        Membership::Out => false,
        Membership::Near => match asked.iter().find(|(other, _)| *other == leaf) {
            Some((_, known)) => *known,
            None => {
                let known = holds(leaf);
                asked.push((leaf, known));
                known
            }
        },
    };
    // A leaf that the point is outside of is one that the result can do without, so it need not be asked itself.
    let may_hold = |leaf: &LeafId| *leaf != own && status(*leaf) != Membership::Out;
    let candidates = || model.positive_leaves().iter().copied().filter(may_hold);
    let mut holds_without = |gone: &[LeafId], leaf| {
        model.list.eval_occurrences(|literal| {
            let is_gone = literal.leaf == leaf || gone.contains(&literal.leaf);
            (literal.negated || !is_gone) && inside(literal.leaf)
        })
    };
    if let Some(needed) = candidates().find(|&leaf| !holds_without(&[], leaf)) {
        return Some(needed);
    }
    let mut gone = Vec::new();
    let within: Vec<LeafId> = candidates().collect();
    for &leaf in within.iter().rev() {
        if holds_without(&gone, leaf) {
            gone.push(leaf);
        }
    }
    within.into_iter().find(|leaf| !gone.contains(leaf))
}
