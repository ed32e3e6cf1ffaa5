//! Wicke's own rules, kept to be compared with residuals: clipping bottom up, with *unknown* that drops out.
//!
//! *Theory.* Wicke 2004 §3.3 (functions `clipped` and `insideTree`, eqs. 6 to 9), §3.3.1 and Appendix A (`clipped2`). A
//! fragment of a patch climbs from its leaf to the root; at an intersection it stays where it is inside the sibling, at a
//! union where it is outside. A patch that has no clipping partner at the fragment's surfel is *unknown*, and drops out of
//! the expression: `A ∧ unknown = A`, `A ∨ unknown = A`. An unknown sibling never discards a fragment. (That is not
//! Kleene's logic: it guesses that what is not near does not matter.)
//!
//! *Changes from the paper.* The paper's patches are the leaves of its tree, each there once. A leaf that the user names
//! several times is one patch per **occurrence** here; a complemented occurrence is its own patch with all normals
//! reversed, so both its membership and its facing are inverted (§4.1). Where the paper evaluates both operands, an
//! operand that is decided by the first is not asked for: false still wins an intersection and true a union.
//!
//! *Practice.* [`PaperTree::clipped`] is what to use; [`PaperTree::clipped2`] is the appendix's form, and tests hold the two
//! equal. The surfels of a leaf's other occurrences lie exactly on the fragment's own: what their `inside` says is the
//! caller's to choose, and the paper is silent about it.

use super::bits::TriStack;
use super::positive::PositiveNode;
use super::tree::index;
use super::{Crossing, LeafId, Literal, Positive, Tri};

/// An expression whose patches are the occurrences of leaves, numbered from left to right.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PaperTree {
    /// In post-order, as in [`Positive`]; a right operand directly precedes its operator.
    nodes: Vec<PositiveNode>,
    /// Each node's operator; the root is its own.
    parents: Vec<u32>,
    /// Where each node's subtree begins: its leftmost literal.
    starts: Vec<u32>,
    /// The node of each occurrence.
    occurrences: Vec<u32>,
    /// The occurrence of each literal node; of an operator, that of the last literal before it.
    occurrence_at: Vec<u32>,
    /// All occurrences, sorted by leaf and then by number.
    by_leaf: Vec<(LeafId, usize)>,
}

impl From<&Positive> for PaperTree {
    fn from(positive: &Positive) -> Self {
        let nodes = positive.nodes().to_vec();
        let root = index(nodes.len() - 1);
        let mut parents = vec![root; nodes.len()];
        let mut starts: Vec<u32> = Vec::with_capacity(nodes.len());
        let mut occurrence_at = Vec::with_capacity(nodes.len());
        let (mut occurrences, mut by_leaf) = (Vec::new(), Vec::new());
        for (i, node) in nodes.iter().enumerate() {
            match *node {
                PositiveNode::Literal(literal) => {
                    starts.push(index(i));
                    by_leaf.push((literal.leaf, occurrences.len()));
                    occurrences.push(index(i));
                }
                PositiveNode::And(a, b) | PositiveNode::Or(a, b) => {
                    starts.push(starts[a as usize]);
                    parents[a as usize] = index(i);
                    parents[b as usize] = index(i);
                }
            }
            occurrence_at.push(index(occurrences.len() - 1));
        }
        by_leaf.sort_unstable();
        Self { nodes, parents, starts, occurrences, occurrence_at, by_leaf }
    }
}

impl PaperTree {
    /// The number of occurrences: those are `0..occurrence_count()`.
    pub fn occurrence_count(&self) -> usize {
        self.occurrences.len()
    }

    /// The occurrences of a leaf, in order; none where the expression has not got it.
    pub fn occurrences_of(&self, leaf: LeafId) -> impl Iterator<Item = usize> + '_ {
        let first = self.by_leaf.partition_point(|&(other, _)| other < leaf);
        self.by_leaf[first..].iter().take_while(move |&&(other, _)| other == leaf).map(|&(_, occurrence)| occurrence)
    }

    /// An occurrence's leaf, and whether it is complemented.
    ///
    /// # Panics
    /// Past the last occurrence, as do the functions below.
    pub fn literal(&self, occurrence: usize) -> Literal {
        match self.nodes[self.occurrences[occurrence] as usize] {
            PositiveNode::Literal(literal) => literal,
            PositiveNode::And(..) | PositiveNode::Or(..) => unreachable!("occurrences are literals"),
        }
    }

    /// Which way the result faces along an occurrence's surface. In a positive form a patch bounds the result with its own
    /// outward normal, and a complemented patch's is the reverse of its leaf's.
    pub fn crossing(&self, occurrence: usize) -> Crossing {
        if self.literal(occurrence).negated { Crossing::Falls } else { Crossing::Rises }
    }

    /// Whether a fragment of `occurrence` is clipped away: the paper's function of that name. `inside` tells whether the
    /// fragment is inside another occurrence's *leaf* (complements are handled here), unknown where that patch has no
    /// clipping partner. It is asked at most once per occurrence, and never for the fragment's own.
    pub fn clipped(&self, occurrence: usize, mut inside: impl FnMut(usize) -> Tri) -> bool {
        let mut node = self.occurrences[occurrence] as usize;
        while !self.is_root(node) {
            let inside_sibling = self.inside_tree(self.sibling(node), &mut inside).known();
            node = self.parents[node] as usize;
            let on = inside_sibling.is_none_or(|inside| inside == self.is_and(node));
            if !on {
                return true;
            }
        }
        false
    }

    /// [`Self::clipped`] as Appendix A writes it for its proof: always up to the root, `on` taken along.
    pub fn clipped2(&self, occurrence: usize, mut inside: impl FnMut(usize) -> Tri) -> bool {
        let mut node = self.occurrences[occurrence] as usize;
        let mut on = true;
        while !self.is_root(node) {
            let sibling = self.sibling(node);
            let inside_sibling = self.inside_tree(sibling, &mut inside);
            node = self.parents[node] as usize;
            match inside_sibling.known() {
                None => {}
                Some(inside) if self.is_and(node) => on = on && inside,
                Some(inside) => on = on && !inside,
            }
        }
        !on
    }

    /// The nodes in post-order, each with its operator (the root's is its own) and where its subtree begins.
    #[cfg(feature = "gpu")]
    pub(crate) fn nodes(&self) -> impl Iterator<Item = (PositiveNode, u32, u32)> + '_ {
        (0..self.nodes.len()).map(|i| (self.nodes[i], self.parents[i], self.starts[i]))
    }

    /// The node of an occurrence.
    #[cfg(feature = "gpu")]
    pub(crate) fn node_of(&self, occurrence: usize) -> u32 {
        self.occurrences[occurrence]
    }

    fn is_root(&self, node: usize) -> bool {
        node + 1 == self.nodes.len()
    }

    fn is_and(&self, node: usize) -> bool {
        matches!(self.nodes[node], PositiveNode::And(..))
    }

    /// The other operand of a node's operator.
    fn sibling(&self, node: usize) -> usize {
        match self.nodes[self.parents[node] as usize] {
            PositiveNode::And(a, b) | PositiveNode::Or(a, b) => (if a as usize == node { b } else { a }) as usize,
            PositiveNode::Literal(_) => unreachable!("a parent is an operator"),
        }
    }

    /// The paper's `insideTree` for the subtree at `root`, with its rule for unknown; linear in the subtree.
    fn inside_tree(&self, root: usize, inside: &mut impl FnMut(usize) -> Tri) -> Tri {
        // The values of left operands whose right operands are being evaluated.
        let mut left = TriStack::default();
        let mut node = self.starts[root] as usize;
        loop {
            let occurrence = self.occurrence_at[node] as usize;
            let mut value = inside(occurrence).negated_if(self.literal(occurrence).negated);
            // Climb with the value, until an operator needs its right operand first.
            loop {
                if node == root {
                    return value;
                }
                let parent = self.parents[node] as usize;
                // The value that decides the operator by itself: false an intersection, true a union.
                let deciding = Tri::from(!self.is_and(parent));
                if node + 1 == parent {
                    // A right operand. The left one has not decided, so it is unknown, or the operator's neutral value.
                    let left = left.pop();
                    value = if value == Tri::Unknown { left } else { value };
                } else if value != deciding {
                    left.push(value);
                    // The right operand's leftmost literal follows the left operand.
                    node += 1;
                    break;
                }
                node = parent;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::csg::expression::parse;

    fn tree(text: &str) -> PaperTree {
        let tree = parse(text, &mut |name| Some(LeafId(u32::from(name.as_bytes()[0] - b'a')))).unwrap();
        PaperTree::from(&tree.positive())
    }

    #[test]
    fn figure_5_of_the_paper() {
        // (A ∩ B) ∩ C; a surfel of C that A cuts and that is far from B depends on A alone.
        let tree = tree("a & b & c");
        let clipped = |a, b| tree.clipped(2, |occurrence| [a, b][occurrence]);
        assert!(!clipped(Tri::True, Tri::Unknown));
        assert!(clipped(Tri::False, Tri::Unknown));
        assert!(!clipped(Tri::Unknown, Tri::Unknown));
        assert!(clipped(Tri::True, Tri::False));
    }

    #[test]
    fn a_repeated_leaf_is_a_patch_per_occurrence() {
        let tree = tree("(a - b) | (b - a)");
        assert_eq!(tree.occurrence_count(), 4);
        assert_eq!(tree.occurrences_of(LeafId(0)).collect::<Vec<_>>(), [0, 3]);
        assert_eq!(tree.occurrences_of(LeafId(1)).collect::<Vec<_>>(), [1, 2]);
        assert_eq!(tree.occurrences_of(LeafId(2)).count(), 0);
        assert_eq!([0, 1, 2, 3].map(|i| tree.literal(i).negated), [false, true, false, true]);
        assert_eq!(tree.crossing(0), Crossing::Rises);
        assert_eq!(tree.crossing(3), Crossing::Falls);
        // Where b is: the first occurrence of a bounds the result outside b, the second inside b. The other occurrence of
        // a is taken as unknown.
        let clipped = |occurrence, b| {
            tree.clipped(occurrence, |other| if [1, 2].contains(&other) { Tri::from(b) } else { Tri::Unknown })
        };
        assert!(clipped(0, true));
        assert!(clipped(3, false));
        assert!(!clipped(3, true));
    }

    #[test]
    fn a_dropped_leaf_keeps_what_the_tree_would_clip() {
        // C ∩ (A ∪ B), the design's example of where unknown fails: a surfel of A inside C that is buried in B, but has no
        // partner of B, is kept.
        let tree = tree("c & (a | b)");
        assert!(!tree.clipped(1, |occurrence| if occurrence == 0 { Tri::True } else { Tri::Unknown }));
        assert!(tree.clipped(1, |_| Tri::True));
    }
}
