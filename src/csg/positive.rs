//! The positive form: only unions and intersections, complements at the leaves alone.
//!
//! *Theory.* Blister (Hable and Rossignac 2005) §2, Fig. 3; Wicke 2004 §4.1. `a - b` is `a ∩ b'`; De Morgan pushes a
//! complement down, `(a ∪ b)' = a' ∩ b'`, `(a ∩ b)' = a' ∪ b'`, `a'' = a`.
//!
//! *Practice.* A node's complement parity is its parent's, turned over by a complement or by being a right operand of a
//! difference. One pass from the root down finds it for every node, one pass up writes the arena. Leaves keep their order
//! from left to right; the form has one literal per occurrence of a leaf, so it is never larger than the tree.

use super::bits::{BitStack, TriStack};
use super::tree::{index, sorted_unique};
use super::{Blist, Flat, LeafId, Node, Tree, Tri};

/// One occurrence of a leaf.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Literal {
    /// Which leaf.
    pub leaf: LeafId,
    /// Whether it stands for the leaf's complement.
    pub negated: bool,
}

impl Literal {
    /// The literal's value for a point inside its leaf or not.
    pub fn value(self, inside_leaf: bool) -> bool {
        inside_leaf != self.negated
    }
}

/// One node of a [`Positive`]; operands are indices of earlier nodes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum PositiveNode {
    /// A leaf or its complement.
    Literal(Literal),
    /// Intersection.
    And(u32, u32),
    /// Union.
    Or(u32, u32),
}

/// An expression in positive form, never empty: an arena in post-order like [`Tree`]'s, the root last.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Positive {
    nodes: Vec<PositiveNode>,
}

impl From<&Tree> for Positive {
    fn from(tree: &Tree) -> Self {
        let nodes = tree.nodes();
        let mut complemented = vec![false; nodes.len()];
        for (i, node) in nodes.iter().enumerate().rev() {
            let here = complemented[i];
            match *node {
                Node::Leaf(_) => {}
                Node::Not(a) => complemented[a as usize] = !here,
                Node::And(a, b) | Node::Or(a, b) => {
                    complemented[a as usize] = here;
                    complemented[b as usize] = here;
                }
                Node::Minus(a, b) => {
                    complemented[a as usize] = here;
                    complemented[b as usize] = !here;
                }
            }
        }

        let mut positive = Vec::with_capacity(nodes.len());
        // Where each node of the tree went; a complement is where its operand is.
        let mut moved_to: Vec<u32> = Vec::with_capacity(nodes.len());
        for (node, negated) in nodes.iter().zip(complemented) {
            let (a, b, is_and) = match *node {
                Node::Leaf(leaf) => {
                    moved_to.push(index(positive.len()));
                    positive.push(PositiveNode::Literal(Literal { leaf, negated }));
                    continue;
                }
                Node::Not(a) => {
                    moved_to.push(moved_to[a as usize]);
                    continue;
                }
                Node::Or(a, b) => (a, b, negated),
                Node::And(a, b) | Node::Minus(a, b) => (a, b, !negated),
            };
            let (a, b) = (moved_to[a as usize], moved_to[b as usize]);
            moved_to.push(index(positive.len()));
            positive.push(if is_and { PositiveNode::And(a, b) } else { PositiveNode::Or(a, b) });
        }
        Self { nodes: positive }
    }
}

/// What [`Positive::fold`] leaves of an expression.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Folded {
    /// The known leaves decide it.
    Constant(bool),
    /// An expression over unknown leaves alone.
    Open(Positive),
}

impl Positive {
    /// From nodes in post-order, the root last.
    pub(super) fn from_post_order(nodes: Vec<PositiveNode>) -> Self {
        Self { nodes }
    }

    /// The nodes in post-order, the root last.
    pub fn nodes(&self) -> &[PositiveNode] {
        &self.nodes
    }

    /// The literals from left to right, one per occurrence of a leaf.
    pub fn literals(&self) -> impl Iterator<Item = Literal> + '_ {
        self.nodes
            .iter()
            .filter_map(|node| if let PositiveNode::Literal(literal) = node { Some(*literal) } else { None })
    }

    /// The leaves that occur, sorted, each once.
    pub fn leaves(&self) -> Vec<LeafId> {
        sorted_unique(self.literals().map(|literal| literal.leaf).collect())
    }

    /// How many operators lie above the deepest literal: 0 for a literal.
    pub fn depth(&self) -> u32 {
        let mut depths: Vec<u32> = Vec::with_capacity(self.nodes.len());
        for node in &self.nodes {
            depths.push(match *node {
                PositiveNode::Literal(_) => 0,
                PositiveNode::And(a, b) | PositiveNode::Or(a, b) => depths[a as usize].max(depths[b as usize]) + 1,
            });
        }
        depths[depths.len() - 1]
    }

    /// The same expression over other leaves.
    pub fn map_leaves(&self, mut to: impl FnMut(LeafId) -> LeafId) -> Self {
        let map = |node: &PositiveNode| match *node {
            PositiveNode::Literal(Literal { leaf, negated }) => {
                PositiveNode::Literal(Literal { leaf: to(leaf), negated })
            }
            operator => operator,
        };
        Self { nodes: self.nodes.iter().map(map).collect() }
    }

    /// The same expression with as few nodes as its operators allow.
    pub fn flat(&self) -> Flat {
        Flat::from(self)
    }

    /// The same expression as a list to be walked forward.
    pub fn blist(&self) -> Blist {
        Blist::from(self)
    }

    /// Whether a point is inside the result, given which leaves it is inside of. Asks for every literal, left to right.
    pub fn eval(&self, mut inside: impl FnMut(LeafId) -> bool) -> bool {
        self.eval_occurrences(|literal| inside(literal.leaf))
    }

    /// As [`eval`](Self::eval), told for each occurrence of a leaf whether the point is inside the *leaf*.
    pub fn eval_occurrences(&self, mut inside: impl FnMut(Literal) -> bool) -> bool {
        let mut stack = BitStack::default();
        for node in &self.nodes {
            let value = match *node {
                PositiveNode::Literal(literal) => literal.value(inside(literal)),
                PositiveNode::And(..) => stack.pop() & stack.pop(),
                PositiveNode::Or(..) => stack.pop() | stack.pop(),
            };
            stack.push(value);
        }
        stack.pop()
    }

    /// As [`Self::eval`] where some leaves are undecided, in Kleene's logic: a decided result is certain, but where a leaf
    /// occurs twice an undecided one may be constant all the same.
    pub fn eval_tri(&self, mut inside: impl FnMut(LeafId) -> Tri) -> Tri {
        let mut stack = TriStack::default();
        for node in &self.nodes {
            let value = match *node {
                PositiveNode::Literal(literal) => inside(literal.leaf).negated_if(literal.negated),
                PositiveNode::And(..) => stack.pop().and(stack.pop()),
                PositiveNode::Or(..) => stack.pop().or(stack.pop()),
            };
            stack.push(value);
        }
        stack.pop()
    }

    /// Replaces every leaf whose value is known by its constant, and folds the constants away. The literals that remain
    /// keep their order. (No more than that: `u ∩ u'` stays.)
    pub fn fold(&self, mut inside: impl FnMut(LeafId) -> Tri) -> Folded {
        /// A finished subtree.
        #[derive(Clone, Copy)]
        enum Part {
            Constant(bool),
            /// The nodes from `start` to `root`.
            Open {
                start: u32,
                root: u32,
            },
        }
        let mut nodes = Vec::new();
        let mut parts = Vec::new();
        for node in &self.nodes {
            let part = match *node {
                PositiveNode::Literal(literal) => match inside(literal.leaf).known() {
                    Some(value) => Part::Constant(literal.value(value)),
                    None => {
                        let root = index(nodes.len());
                        nodes.push(*node);
                        Part::Open { start: root, root }
                    }
                },
                PositiveNode::And(..) | PositiveNode::Or(..) => {
                    let is_and = matches!(node, PositiveNode::And(..));
                    let (b, a) = (parts.pop(), parts.pop());
                    match (a.expect("post-order: a left operand"), b.expect("post-order: a right operand")) {
                        (Part::Constant(a), Part::Constant(b)) => Part::Constant(if is_and { a && b } else { a || b }),
                        (Part::Constant(value), open @ Part::Open { start, .. })
                        | (open @ Part::Open { start, .. }, Part::Constant(value)) => {
                            if value == is_and {
                                // True ∩ open, false ∪ open.
                                open
                            } else {
                                // The constant decides; the other operand's nodes are the newest, so they can be cut off.
                                nodes.truncate(start as usize);
                                Part::Constant(value)
                            }
                        }
                        (Part::Open { start, root: a }, Part::Open { root: b, .. }) => {
                            let root = index(nodes.len());
                            nodes.push(if is_and { PositiveNode::And(a, b) } else { PositiveNode::Or(a, b) });
                            Part::Open { start, root }
                        }
                    }
                }
            };
            parts.push(part);
        }
        match parts.pop().expect("a positive form has at least one node") {
            Part::Constant(value) => Folded::Constant(value),
            Part::Open { .. } => Folded::Open(Self { nodes }),
        }
    }
}
