//! Leaves that hold all of the result, as few and as small as can be told without looking inside.
//!
//! *Theory.* Blister 2005 §4: with R a set of leaves whose union holds the result, no boundary is in front of R or behind it, and
//! layers there need not be peeled. An intersection lies within any one of its operands, so within the smallest; a union
//! within all of its operands together; a complemented leaf within nothing less than everything.

use super::flat::{ROOT, Shrunk};

impl Shrunk {
    /// The slots of R, sorted, where `size` tells how large each slot is; `None` where only everything holds the result.
    ///
    /// # Panics
    /// Unless [`keep`](Self::keep) returned [`Kept::Open`](super::Kept::Open).
    pub fn superset(&self, size: impl Fn(u32) -> f64) -> Option<Vec<u32>> {
        /// What is known of a node so far.
        #[derive(Clone, Default)]
        struct Bound {
            /// Of all of its operands where it is a union, of the smallest where it is an intersection.
            slots: Vec<u32>,
            size: f64,
            /// Whether it is bounded: for a union until an operand is not, for an intersection once one is.
            is_bounded: bool,
        }
        impl Bound {
            fn take(&mut self, is_and: bool, slots: &[u32], size: Option<f64>) {
                match (is_and, size) {
                    (true, Some(size)) if !self.is_bounded || size < self.size => {
                        *self = Self { slots: slots.to_vec(), size, is_bounded: true };
                    }
                    (true, _) => (),
                    (false, Some(size)) => {
                        self.slots.extend_from_slice(slots);
                        self.size += size;
                    }
                    (false, None) => self.is_bounded = false,
                }
            }
        }
        let begun = |is_and: bool| Bound { is_bounded: !is_and, ..Bound::default() };
        let mut bounds: Vec<Bound> = self.nodes.iter().map(|node| begun(node.is_and)).collect();
        for (number, node) in self.nodes.iter().enumerate() {
            let mut own = std::mem::take(&mut bounds[number]);
            for literals in &self.literals[node.first as usize..node.end as usize] {
                for bit in (0..32).filter(|bit| literals.mask >> bit & 1 == 1) {
                    let slot = literals.word * 32 + bit;
                    let is_complement = literals.negated >> bit & 1 == 1;
                    own.take(node.is_and, &[slot], (!is_complement).then(|| size(slot)));
                }
            }
            if node.parent == ROOT {
                own.slots.sort_unstable();
                own.slots.dedup();
                return own.is_bounded.then_some(own.slots);
            }
            let above = node.parent as usize;
            bounds[above].take(self.nodes[above].is_and, &own.slots, own.is_bounded.then_some(own.size));
        }
        unreachable!("the last node is the root")
    }
}

#[cfg(test)]
mod tests {
    use crate::csg::{Flat, Kept, LeafId, Shrunk, TreeBuilder};

    /// Slot i is of size i + 1; slots number the leaves that occur.
    fn superset(tree: impl FnOnce(&mut TreeBuilder)) -> Option<Vec<u32>> {
        let mut builder = TreeBuilder::default();
        tree(&mut builder);
        let flat: Flat = builder.finish().unwrap().positive().flat();
        let mut shrunk = Shrunk::default();
        assert_eq!(shrunk.keep(&flat, flat.leaves()), Kept::Open);
        shrunk.superset(|slot| f64::from(slot) + 1.0)
    }

    #[test]
    fn an_intersection_is_within_its_smallest_and_a_union_within_all() {
        let leaf = |b: &mut TreeBuilder, i| {
            b.leaf(LeafId(i));
        };
        // (a | b) - c
        let minus = |b: &mut TreeBuilder| {
            leaf(b, 0);
            leaf(b, 1);
            b.or();
            leaf(b, 2);
            b.minus();
        };
        assert_eq!(superset(minus), Some(vec![0, 1]));
        // (b | d) & c: two is less than four.
        let and = |b: &mut TreeBuilder| {
            leaf(b, 1);
            leaf(b, 3);
            b.or();
            leaf(b, 2);
            b.and();
        };
        assert_eq!(superset(and), Some(vec![1]));
        let not = |b: &mut TreeBuilder| {
            leaf(b, 0);
            b.not();
            leaf(b, 1);
            b.or();
        };
        assert_eq!(superset(not), None);
    }
}
