//! A Blist's value as leaves are toggled one by one: only the piece of the walk that a toggle leads elsewhere is walked again.
//!
//! *Theory.* Blister (Hable and Rossignac 2005) §3.1: an entry is *active* for a point if the walk comes by it; what the others
//! hold is of no account. So the toggle of a leaf changes nothing where its entry is not active. Where it is, the
//! walk goes the entry's other way.
//!
//! *Changes from the paper.* The paper classifies every layer anew. Here the old way and the new are followed side by side, the
//! one that lies further back first: jumps lead forward only, so where the two meet, they stay together, and all behind is as
//! it was. A toggle costs the entries between, all of the list at worst; [`Counters`](super::Counters), which count up
//! the tree, cost its depth at worst. On a long chain of one operator a toggle near the front costs a walk of the rest
//! here, and on a deep chain of alternating ones a climb there.
//!
//! *Practice.* A leaf that occurs several times is toggled at one place after the other, from the left.

use super::blist::{Blist, Entry, Jump};
use super::{LeafId, Positive};

/// A point's walk along a [`Blist`].
#[derive(Debug, Clone)]
pub struct Walk {
    blist: Blist,
    /// All occurrences, sorted by leaf and then by position.
    by_leaf: Vec<(LeafId, u32)>,
    /// By entry: whether the point is inside its leaf.
    inside: Vec<bool>,
    /// By entry: whether the walk comes by.
    is_active: Vec<bool>,
    value: bool,
}

impl From<&Positive> for Walk {
    /// The walk of a point that is outside all leaves.
    fn from(positive: &Positive) -> Self {
        let blist = positive.blist();
        let entries = blist.entries();
        let by_position = |(position, entry): (usize, &Entry)| (entry.leaf(), super::tree::index(position));
        let mut by_leaf: Vec<(LeafId, u32)> = entries.iter().enumerate().map(by_position).collect();
        by_leaf.sort_unstable();
        let mut is_active = vec![false; entries.len()];
        let mut at = Jump::Entry(0);
        while let Jump::Entry(position) = at {
            is_active[position as usize] = true;
            at = entries[position as usize].if_out;
        }
        Self { by_leaf, inside: vec![false; entries.len()], is_active, value: at == Jump::In, blist }
    }
}

impl Walk {
    /// Whether the point is inside the result.
    pub fn value(&self) -> bool {
        self.value
    }

    /// Turns over whether the point is inside `leaf`; returns whether it is inside the result then.
    pub fn toggle(&mut self, leaf: LeafId) -> bool {
        let first = self.by_leaf.partition_point(|&(other, _)| other < leaf);
        for i in first..self.by_leaf.len() {
            let (of, position) = self.by_leaf[i];
            if of != leaf {
                break;
            }
            self.turn(position as usize);
        }
        self.value
    }

    /// Turns one entry over, and leads the walk its new way.
    fn turn(&mut self, position: usize) {
        let was = self.inside[position];
        self.inside[position] = !was;
        if !self.is_active[position] {
            return;
        }
        let entry = &self.blist.entries()[position];
        let (mut old, mut new) = (entry.jump(was), entry.jump(!was));
        while old != new {
            match (old, new) {
                (Jump::Entry(at), Jump::Entry(other)) if at < other => old = self.step(at, false),
                (Jump::Entry(at), Jump::In | Jump::Out) => old = self.step(at, false),
                (_, Jump::Entry(at)) => new = self.step(at, true),
                // Two different ends.
                (Jump::In | Jump::Out, end) => {
                    self.value = end == Jump::In;
                    return;
                }
            }
        }
    }

    /// Makes an entry active or not; returns where a walk goes on from it.
    fn step(&mut self, at: u32, is_active: bool) -> Jump {
        self.is_active[at as usize] = is_active;
        self.blist.entries()[at as usize].jump(self.inside[at as usize])
    }
}
