//! The expression as a walk over words of memberships, for processors that neither recurse nor keep lists.
//!
//! *Theory.* Blister 2005 §3: a point walks along the literals, and each sends it on, to a match or to the end. A node of
//! [`Shrunk`] has its literals in masks, so a step here asks up to 32 of them at once.
//!
//! *Practice.* A step tests the literals of one word of one node. Where they decide the node the walk goes to `decided`, else to
//! `open`. Both lie ahead, or are an end, so a walk has at most as many moves as there are steps.

use super::flat::{ROOT, Shrunk};

/// The walk ends: the point is inside.
pub const INSIDE: u32 = u32::MAX;

/// The walk ends: the point is outside.
pub const OUTSIDE: u32 = u32::MAX - 1;

/// A test, and where it leads.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Step {
    /// Which word of the state.
    pub word: u32,
    /// Which bits of it.
    pub mask: u32,
    /// Those of them that are complemented.
    pub negated: u32,
    /// Whether one literal that fails decides, not one that holds.
    pub is_and: bool,
    /// The next step where these literals decide their node.
    pub decided: u32,
    /// The next step where they do not.
    pub open: u32,
}

impl Shrunk {
    /// The expression's walk, which begins at the first step.
    ///
    /// # Panics
    /// Unless [`keep`](Self::keep) returned [`Kept::Open`](super::Kept::Open).
    pub fn steps(&self) -> Vec<Step> {
        let count = self.nodes.len();
        let mut children: Vec<Vec<usize>> = vec![Vec::new(); count];
        for (number, node) in self.nodes.iter().enumerate().filter(|(_, node)| node.parent != ROOT) {
            children[node.parent as usize].push(number);
        }
        // Step 1: how many steps each node has with all below it, children before parents.
        let mut lengths = vec![0_u32; count];
        for (number, node) in self.nodes.iter().enumerate() {
            lengths[number] += node.end - node.first;
            if let Some(above) = lengths.get(node.parent as usize).copied() {
                lengths[node.parent as usize] = above + lengths[number];
            }
        }
        // Step 2: parents before children, where each begins and where its value leads. Own literals come before children.
        let mut starts = vec![0_u32; count];
        let mut ends = vec![(INSIDE, OUTSIDE); count];
        let none = Step { word: 0, mask: 0, negated: 0, is_and: true, decided: INSIDE, open: INSIDE };
        let mut steps = vec![none; lengths[count - 1] as usize];
        for number in (0..count).rev() {
            let node = &self.nodes[number];
            let (inside, outside) = ends[number];
            let (decided, exhausted) = if node.is_and { (outside, inside) } else { (inside, outside) };
            let own = node.end - node.first;
            let end = starts[number] + lengths[number];
            let next = |at: u32| if at < end { at } else { exhausted };
            let mut at = starts[number];
            for literals in &self.literals[node.first as usize..(node.first + own) as usize] {
                let (word, mask, negated) = (literals.word, literals.mask, literals.negated);
                steps[at as usize] = Step { word, mask, negated, is_and: node.is_and, decided, open: next(at + 1) };
                at += 1;
            }
            for &child in &children[number] {
                starts[child] = at;
                at += lengths[child];
                ends[child] = if node.is_and { (next(at), outside) } else { (inside, next(at)) };
            }
        }
        steps
    }
}

/// Whether a point with these memberships is inside: the walk itself, as shaders take it.
#[cfg(test)]
pub(super) fn walk(steps: &[Step], state: &[u32]) -> bool {
    let mut at = 0;
    while at < OUTSIDE {
        let step = &steps[at as usize];
        let holds = (state[step.word as usize] ^ step.negated) & step.mask;
        let decides = if step.is_and { holds != step.mask } else { holds != 0 };
        let next = if decides { step.decided } else { step.open };
        assert!(next > at, "walks go ahead");
        at = next;
    }
    at == INSIDE
}
