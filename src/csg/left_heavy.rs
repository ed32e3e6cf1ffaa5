//! The positive form with the operands of every operator put in the order that keeps a list's statuses few.
//!
//! *Theory.* Blister (Hable and Rossignac 2005) §3.3, Fig. 11. While a leaf is asked about, every leaf that lies behind it and
//! that some earlier leaf leads to needs an ID of its own. On the path from the root to the leaf that takes a step to the
//! left, which makes a new place to go on at, and a step to the right, which leaves that place to the operand before. So
//! what counts is how often a path *zigzags*; and as unions and intersections commute, the operand with the longer
//! zigzags can come first, where nothing waits behind it yet.
//!
//! *Changes from the paper.* The paper puts the *deeper* operand first ([`First::Deeper`]). A path to the right then has an
//! operand at least as deep on its left at each step, so a form needs many IDs only if it has many leaves, but the number
//! still grows with their square root: the least form that needs x IDs has (x − 1)² leaves (derived, and built, in
//! the tests of [`status`](super::status)). What zigzags cost is what evaluating a formula with few registers costs, and the
//! best order for that is known: first the operand with the higher Strahler number (Ershov 1958). It is 1 for a
//! literal, and one more than the operands' where those are equal, else the greater; so a number of s takes 2^(s − 1) leaves,
//! and IDs grow with the logarithm ([`First::Busier`]).
//!
//! *Practice.* A stable order: operands of equal weight stay as they were written. One pass up weighs every subtree, one pass
//! down places it; nothing recurses.

use super::Positive;
use super::positive::PositiveNode;
use super::tree::index;

/// Which operand comes first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum First {
    /// The one with the longer path to a leaf: the paper's left-heavy order.
    Deeper,
    /// The one with the higher Strahler number.
    Busier,
}

impl Positive {
    /// The same expression with every operator's operands in this order.
    pub fn left_heavy(&self, first: First) -> Self {
        let nodes = self.nodes();
        // Weight and number of nodes of each subtree.
        let mut weights: Vec<(u32, u32)> = Vec::with_capacity(nodes.len());
        for node in nodes {
            weights.push(match *node {
                PositiveNode::Literal(_) => (1, 1),
                PositiveNode::And(a, b) | PositiveNode::Or(a, b) => {
                    let ((a, a_nodes), (b, b_nodes)) = (weights[a as usize], weights[b as usize]);
                    let more = match first {
                        First::Deeper => 1,
                        First::Busier => u32::from(a == b),
                    };
                    (a.max(b) + more, a_nodes + b_nodes + 1)
                }
            });
        }
        // From the root down: a subtree's root is the last of its nodes, directly behind its right operand.
        let mut moved_to = vec![0_u32; nodes.len()];
        moved_to[nodes.len() - 1] = index(nodes.len() - 1);
        let mut ordered = nodes.to_vec();
        for (i, node) in nodes.iter().enumerate().rev() {
            let to = moved_to[i];
            ordered[to as usize] = match *node {
                PositiveNode::Literal(_) => *node,
                PositiveNode::And(a, b) | PositiveNode::Or(a, b) => {
                    let is_swapped = weights[b as usize].0 > weights[a as usize].0;
                    let (a, b) = if is_swapped { (b, a) } else { (a, b) };
                    let (to_a, to_b) = (to - 1 - weights[b as usize].1, to - 1);
                    (moved_to[a as usize], moved_to[b as usize]) = (to_a, to_b);
                    if matches!(node, PositiveNode::And(..)) {
                        PositiveNode::And(to_a, to_b)
                    } else {
                        PositiveNode::Or(to_a, to_b)
                    }
                }
            };
        }
        Self::from_post_order(ordered)
    }
}

#[cfg(test)]
mod tests {
    use super::super::exhaustive::{leaf_of_letter, letter};
    use super::*;
    use crate::csg::expression::parse;

    fn ordered(text: &str, first: First) -> String {
        let positive = parse(text, &mut leaf_of_letter).unwrap().positive().left_heavy(first);
        let mut texts: Vec<String> = Vec::new();
        for node in positive.nodes() {
            let text = match *node {
                PositiveNode::Literal(literal) => {
                    format!("{}{}", if literal.negated { "!" } else { "" }, letter(literal.leaf))
                }
                PositiveNode::And(a, b) => format!("({} & {})", texts[a as usize], texts[b as usize]),
                PositiveNode::Or(a, b) => format!("({} | {})", texts[a as usize], texts[b as usize]),
            };
            texts.push(text);
        }
        texts.pop().unwrap()
    }

    #[test]
    fn the_deeper_operand_comes_first() {
        assert_eq!(ordered("a & (b | (c & d))", First::Deeper), "(((c & d) | b) & a)");
        assert_eq!(ordered("a - (b | c)", First::Deeper), "((!b & !c) & a)");
        assert_eq!(ordered("a & b | c", First::Deeper), "((a & b) | c)");
    }

    #[test]
    fn a_long_list_is_not_busier_than_two_pairs() {
        assert_eq!(
            ordered("(a | b | c | d) & ((e | f) & (g | h))", First::Busier),
            "(((e | f) & (g | h)) & (((a | b) | c) | d))"
        );
        let already = "(((((a | b) | c) | d) | e) & ((f | g) & (h | i)))";
        assert_eq!(ordered(already, First::Deeper), already);
    }

    #[test]
    fn equals_stay_as_they_were_written() {
        for first in [First::Deeper, First::Busier] {
            assert_eq!(ordered("(a & b) | (c & d)", first), "((a & b) | (c & d))");
        }
    }
}
