//! The sum of products: an expression as a union of intersections of leaves and complements.
//!
//! *Theory.* Blueprint 2006 §4 and Fig. 7a draw the overlap of a union's operands: each *product* is a solid by itself, and
//! its own layers are seen. Goldfeather 1986 brings a tree to that form: intersections are multiplied out over unions,
//! `a ∩ (b ∪ c) = a∩b ∪ a∩c`.
//!
//! *Practice.* Every product that holds a leaf and its complement is empty and dropped; one that lies within another adds
//! nothing and is dropped too (`a ∪ a∩b = a`). The form may be exponentially large, so its size is counted first, which
//! takes one pass over the tree.

use super::positive::{Literal, PositiveNode};
use super::{LeafId, Positive, Tree};

/// The most products that are multiplied out: each is drawn as a scene of its own.
pub const MOST_PRODUCTS: u64 = 256;

/// An expression is not brought into products.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "as a union of products the expression has {}{count}, more than {MOST_PRODUCTS}: draw it as one solid with \
     --union volume, or draw a smaller expression",
    if *count == u64::MAX { "more than " } else { "" }
)]
pub struct TooManyProducts {
    /// How many products there are before any is dropped; `u64::MAX` where that is more than it holds.
    pub count: u64,
}

/// An intersection of leaves and complements, never empty; every leaf occurs once, in the order of leaves.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Product {
    literals: Vec<Literal>,
}

impl Product {
    /// The literals, in the order of leaves.
    pub fn literals(&self) -> &[Literal] {
        &self.literals
    }

    /// The product as an expression.
    pub fn tree(&self) -> Tree {
        let of = |literal: &Literal| {
            let leaf = Tree::leaf(literal.leaf);
            if literal.negated { Tree::not(leaf) } else { leaf }
        };
        let (first, rest) = self.literals.split_first().expect("a product has a literal");
        rest.iter().fold(of(first), |tree, literal| Tree::and(tree, of(literal)))
    }

    /// Both; `None` where that is empty.
    fn and(&self, other: &Self) -> Option<Self> {
        let mut literals = self.literals.clone();
        literals.extend_from_slice(&other.literals);
        literals.sort_unstable_by_key(|literal| (literal.leaf, literal.negated));
        literals.dedup();
        let is_empty = literals.windows(2).any(|pair| pair[0].leaf == pair[1].leaf);
        (!is_empty).then_some(Self { literals })
    }

    /// Whether all of it lies in `other`, whatever the leaves: then it has all of its literals.
    fn is_within(&self, other: &Self) -> bool {
        other.literals.iter().all(|literal| {
            let key = |literal: &Literal| (literal.leaf, literal.negated);
            self.literals.binary_search_by_key(&key(literal), key).is_ok()
        })
    }
}

impl Positive {
    /// How many products the expression has before any is dropped; `u64::MAX` where that is more than it holds.
    pub fn product_count(&self) -> u64 {
        let mut stack: Vec<u64> = Vec::new();
        for node in self.nodes() {
            let count = match node {
                PositiveNode::Literal(_) => 1,
                PositiveNode::And(..) | PositiveNode::Or(..) => {
                    let (b, a) = (stack.pop().unwrap_or(0), stack.pop().unwrap_or(0));
                    if matches!(node, PositiveNode::And(..)) { a.saturating_mul(b) } else { a.saturating_add(b) }
                }
            };
            stack.push(count);
        }
        stack.pop().unwrap_or(0)
    }

    /// The products whose union the expression is, in an order that depends on their leaves alone: none where it is empty,
    /// and none that lies within another.
    ///
    /// # Errors
    /// [`TooManyProducts`] where there are more than [`MOST_PRODUCTS`].
    pub fn products(&self) -> Result<Vec<Product>, TooManyProducts> {
        let count = self.product_count();
        if count > MOST_PRODUCTS {
            return Err(TooManyProducts { count });
        }
        let mut stack: Vec<Vec<Product>> = Vec::new();
        for node in self.nodes() {
            let products = match *node {
                PositiveNode::Literal(literal) => vec![Product { literals: vec![literal] }],
                PositiveNode::And(..) | PositiveNode::Or(..) => {
                    let (b, a) = (stack.pop(), stack.pop());
                    let mut a = a.expect("post-order: a left operand");
                    let b = b.expect("post-order: a right operand");
                    if matches!(node, PositiveNode::And(..)) {
                        a.iter().flat_map(|a| b.iter().filter_map(|b| a.and(b))).collect()
                    } else {
                        a.extend(b);
                        a
                    }
                }
            };
            stack.push(largest(products));
        }
        Ok(stack.pop().expect("a positive form has at least one node"))
    }
}

/// Those of `products` that lie in no other, sorted.
fn largest(mut products: Vec<Product>) -> Vec<Product> {
    let key = |product: &Product| -> Vec<(LeafId, bool)> {
        product.literals.iter().map(|literal| (literal.leaf, literal.negated)).collect()
    };
    products.sort_by_cached_key(key);
    products.dedup();
    let is_largest: Vec<bool> = (0..products.len())
        .map(|i| !products.iter().enumerate().any(|(j, other)| j != i && products[i].is_within(other)))
        .collect();
    let mut kept = is_largest.into_iter();
    products.retain(|_| kept.next().unwrap_or(true));
    products
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::csg::expression::parse;

    fn positive(text: &str) -> Positive {
        parse(text, &mut |name| Some(LeafId(u32::from(name.as_bytes()[0] - b'a')))).unwrap().positive()
    }

    fn products(text: &str) -> Vec<String> {
        let name = |leaf: LeafId| char::from(b'a' + leaf.0 as u8).to_string();
        positive(text).products().unwrap().iter().map(|product| product.tree().display(name).to_string()).collect()
    }

    #[test]
    fn unions_are_multiplied_out() {
        assert_eq!(products("a - b - c"), ["a & !b & !c"]);
        assert_eq!(products("(a | b) - c"), ["a & !c", "b & !c"]);
        assert_eq!(products("(a - b) | (b - a)"), ["a & !b", "!a & b"]);
        assert_eq!(products("!(a & b)"), ["!a", "!b"]);
    }

    #[test]
    fn what_is_empty_or_within_another_is_dropped() {
        assert!(products("a - a").is_empty());
        assert_eq!(products("a | a & b | a"), ["a"]);
        assert_eq!(products("(a | b) & (a | !b) "), ["a"]);
        assert_eq!(products("(a - b) & (b | c)"), ["a & !b & c"]);
    }

    #[test]
    fn a_form_that_explodes_is_counted_and_refused() {
        let pairs = |count: usize| vec!["(a | b)"; count].join(" & ");
        assert_eq!(positive(&pairs(20)).product_count(), 1 << 20);
        let refused = positive(&pairs(20)).products().unwrap_err();
        assert_eq!(refused.count, 1 << 20);
        assert!(refused.to_string().contains("1048576") && refused.to_string().contains("--union volume"));
        let refused = positive(&pairs(70)).products().unwrap_err();
        assert!(refused.to_string().contains("more than 18446744073709551615"), "{refused}");
        assert_eq!(products(&pairs(8)), ["a", "b"]);
    }
}
