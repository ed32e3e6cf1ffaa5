//! Blist: the positive form as a list, evaluated by one forward walk without a stack.
//!
//! *Theory.* Blister (Hable and Rossignac 2005) §3.1 and §3.2; Rossignac 1999. Once the leftmost literal of a positive
//! form is known it is a constant, and simplification leads either to the next literal or to one further right, its
//! *match*, or to the result. Which of the literal's two values leads to the match is its *flip*:
//! `if value == flip { match } else { next }`.
//!
//! *Changes from the paper.* Each entry stores both ways, `if_in` and `if_out`, for the leaf's raw membership: flip and
//! complement are folded in, and evaluation is one lookup. The paper's match and flip can be read back by [`Blist::match_of`].
//! The paper finds each match by climbing from the leaf (quadratic on deep trees); here one pass from the root down hands
//! every node its two continuations, where to go on when it is true and when false, so that conversion is linear. For
//! `a ∪ b`, `a` goes on to the parent's *true*, or else to the first literal of `b`; `b` inherits both.
//! A jump here is a plain index; where many points wait at once and IDs must be few, see
//! [`status`](super::status) and [`left_heavy`](super::left_heavy).
//!
//! *Practice.* Jumps lead forward only, so each entry is visited at most once, and leaves that cannot matter any more are
//! not asked for: put costly questions behind [`Blist::eval`], not behind `Tree::eval`.

use super::tree::index;
use super::{LeafId, Literal, Positive};
use crate::csg::positive::PositiveNode;

/// Where evaluation goes on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Jump {
    /// At this entry, further right.
    Entry(u32),
    /// The point is inside the result.
    In,
    /// The point is outside the result.
    Out,
}

/// One entry of a [`Blist`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Entry {
    /// The leaf to ask about, and whether it is complemented here (already part of the jumps).
    pub literal: Literal,
    /// Where to go on when the point is inside the *leaf*.
    pub if_in: Jump,
    /// Where to go on when the point is outside the *leaf*.
    pub if_out: Jump,
}

impl Entry {
    /// The leaf to ask about.
    pub fn leaf(&self) -> LeafId {
        self.literal.leaf
    }

    /// Where to go on.
    pub fn jump(&self, inside_leaf: bool) -> Jump {
        if inside_leaf { self.if_in } else { self.if_out }
    }
}

/// An entry's match and flip, as the paper's Table 2 prints them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Match {
    /// Where to go on when the literal's value equals `flip`; otherwise at the next entry (or, for the last entry, `Out`).
    pub to: Jump,
    /// For the *literal's* value. Reverse it for a complemented literal to compare with the leaf's raw parity.
    pub flip: bool,
}

/// An expression as a list of leaves and jumps, never empty.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Blist {
    entries: Vec<Entry>,
}

impl From<&Positive> for Blist {
    fn from(positive: &Positive) -> Self {
        let nodes = positive.nodes();
        // The number of literals up to each node: for a left operand, the entry with which its sibling begins.
        let mut literals_so_far = Vec::with_capacity(nodes.len());
        let mut literal_count = 0;
        for node in nodes {
            literal_count += usize::from(matches!(node, PositiveNode::Literal(_)));
            literals_so_far.push(index(literal_count));
        }

        // Where each node goes on when it is true and when it is false, from the root down. Literals come by from right to
        // left, so the list is built backwards.
        let mut ways = vec![(Jump::In, Jump::Out); nodes.len()];
        let mut entries = Vec::with_capacity(literal_count);
        for (i, node) in nodes.iter().enumerate().rev() {
            let (if_true, if_false) = ways[i];
            match *node {
                PositiveNode::Literal(literal) => {
                    let (if_in, if_out) = if literal.negated { (if_false, if_true) } else { (if_true, if_false) };
                    entries.push(Entry { literal, if_in, if_out });
                }
                PositiveNode::And(a, b) => {
                    ways[a as usize] = (Jump::Entry(literals_so_far[a as usize]), if_false);
                    ways[b as usize] = (if_true, if_false);
                }
                PositiveNode::Or(a, b) => {
                    ways[a as usize] = (if_true, Jump::Entry(literals_so_far[a as usize]));
                    ways[b as usize] = (if_true, if_false);
                }
            }
        }
        entries.reverse();
        Self { entries }
    }
}

impl Blist {
    /// The entries, in the expression's order; evaluation begins at the first.
    pub fn entries(&self) -> &[Entry] {
        &self.entries
    }

    /// Whether a point is inside the result. Asks only for leaves that still matter, each occurrence at most once.
    pub fn eval(&self, mut inside: impl FnMut(LeafId) -> bool) -> bool {
        self.eval_occurrences(|literal| inside(literal.leaf))
    }

    /// As [`eval`](Self::eval), told for each occurrence of a leaf whether the point is inside the *leaf*.
    pub fn eval_occurrences(&self, mut inside: impl FnMut(Literal) -> bool) -> bool {
        let mut entry = &self.entries[0];
        loop {
            match entry.jump(inside(entry.literal)) {
                Jump::Entry(next) => entry = &self.entries[next as usize],
                Jump::In => return true,
                Jump::Out => return false,
            }
        }
    }

    /// The paper's match and flip of an entry; `None` past the end.
    pub fn match_of(&self, position: usize) -> Option<Match> {
        let entry = self.entries.get(position)?;
        let (if_true, if_false) = (entry.jump(!entry.literal.negated), entry.jump(entry.literal.negated));
        // A literal that is the left operand of an intersection goes on at the next entry when true, and of a union when
        // false. The last entry goes to `In` and `Out`; the paper imbeds Y in (Y ∪ out) ∩ in, which makes it a left
        // operand of a union.
        let next = Jump::Entry(index(position + 1));
        Some(if if_true == next { Match { to: if_false, flip: false } } else { Match { to: if_true, flip: true } })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::csg::expression::parse;

    /// Blister's example, as the CSG tree of its Fig. 3.
    fn example() -> Blist {
        let tree =
            parse("(a & b & c | d) - (e | f) & g", &mut |name| Some(LeafId(u32::from(name.as_bytes()[0] - b'a'))));
        tree.unwrap().positive().blist()
    }

    const A: usize = 0;
    const B: usize = 1;
    const C: usize = 2;
    const D: usize = 3;
    const E: usize = 4;
    const F: usize = 5;
    const G: usize = 6;

    fn to(entry: usize) -> Jump {
        Jump::Entry(entry as u32)
    }

    #[test]
    fn table_1_of_the_paper() {
        // The leftmost literal of the simplified expression, if P is true and if P is false.
        let table = [
            (A, to(B), to(D)),
            (B, to(C), to(D)),
            (C, to(E), to(D)),
            (D, to(E), Jump::Out),
            (E, to(F), to(G)),
            (F, Jump::In, to(G)),
            (G, Jump::In, Jump::Out),
        ];
        let blist = example();
        assert_eq!(blist.entries().len(), table.len());
        for (position, if_true, if_false) in table {
            let entry = blist.entries()[position];
            assert_eq!(entry.literal, Literal { leaf: LeafId(position as u32), negated: position >= E });
            // The table is for the literal; the entry for the leaf.
            let (if_in, if_out) = if entry.literal.negated { (if_false, if_true) } else { (if_true, if_false) };
            assert_eq!((entry.if_in, entry.if_out), (if_in, if_out), "entry {position}");
        }
    }

    #[test]
    fn table_2_of_the_paper() {
        let table = [
            (A, to(D), false),
            (B, to(D), false),
            (C, to(E), true),
            (D, Jump::Out, false),
            (E, to(G), false),
            (F, Jump::In, true),
            (G, Jump::In, true),
        ];
        let blist = example();
        for (position, to, flip) in table {
            assert_eq!(blist.match_of(position), Some(Match { to, flip }), "entry {position}");
        }
        assert_eq!(blist.match_of(table.len()), None);
    }

    #[test]
    fn asks_only_for_what_matters() {
        // Inside A, B, C and F, outside E: D is skipped, and E' makes F decide that G is asked.
        let mut asked = Vec::new();
        let inside = example().eval(|leaf| {
            asked.push(leaf.0 as usize);
            [A, B, C, F].contains(&(leaf.0 as usize))
        });
        assert!(inside);
        assert_eq!(asked, [A, B, C, E, F, G]);
    }
}
