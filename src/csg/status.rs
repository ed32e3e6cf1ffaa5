//! A Blist whose entries share a few IDs: one status a point, and many points in one forward walk.
//!
//! *Theory.* Blister (Hable and Rossignac 2005) §3.2 and §3.3. A point's *status* is the ID of the entry that it waits for.
//! The walk passes every entry once; points that wait for it are asked about its leaf and go on to one of its two ways.
//! An ID is only needed from the first entry that leads there until its own entry has been passed: after that another may
//! have it. Entries are numbered with the lowest ID that is free.
//!
//! *Changes from the paper.* `in` and `out` are ends here, not leaves of `(Y ∪ out) ∩ in`, but they take their IDs by the
//! same rule when an entry first leads to them, and keep them.
//!
//! The paper says that 64 IDs serve every expression of 3909 leaves in left-heavy order, and derives 3 + (2 + 4 + … + x) =
//! x(x + 1) + 3 leaves for x IDs from its Fig. 11; the two sides differ, and so does what the figure needs. Count again. Of
//! the path from the root to a leaf only the steps to the right leave somebody waiting; and each of them only adds to those if a
//! step to the left comes after it and makes a new place to go on at. So of the steps to the right, the i-th from below
//! has i − 1 others and i steps to the left below it: its node is at least 2i high, its left operand at least 2i − 1 high, which
//! takes 2i leaves. With b of them there wait b + 2 (the two ways of the lowest leaf included), and there are b leaves on the
//! right and the lowest: 1 + b + (2 + 4 + … + 2b) = (b + 1)². Hence:
//! * x IDs, `in` and `out` among them as the walk needs them: (x − 1)² leaves at least. 64 IDs serve all expressions of fewer
//!   than 64² = 4096 leaves, and the paper's 3909 hold.
//! * two of the IDs set aside for `in` and `out` and y others, which is how the paper counts ("62·63 + 3"): two steps to the
//!   left must come first, 1 + y + (2 + 4 + … + 2(y − 2)) = y² − 2y + 3 leaves. 62 others serve fewer than 63² − 123 = 3846
//!   leaves: there is a tree of 3846 leaves, and so of 3909, that needs one more.
//!
//! Both worst trees are built in the tests. With the busier operand first instead of the deeper (see
//! [`left_heavy`](super::left_heavy)) each step to the right leads to a lower Strahler number, so a number of s needs at most s + 1
//! IDs, and 64 serve all expressions of fewer than 2^63 leaves.
//!
//! *Practice.* [`StatusList::walk`] holds for every ID a word: a bit for each of 64 points that wait for it. Points whose membership
//! is undecided go both ways, and which of the two ends they reach is Kleene's logic.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use super::blist::{Blist, Jump};
use super::{LeafId, Tri};

/// One entry: an ID that points wait for, and the IDs that they wait for next.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Module {
    /// The leaf to ask about.
    pub leaf: LeafId,
    /// Who waits for this entry.
    pub id: u32,
    /// What a point inside the *leaf* waits for next.
    pub if_in: u32,
    /// What a point outside the *leaf* waits for next.
    pub if_out: u32,
}

/// An expression as a list of [`Module`]s.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct StatusList {
    modules: Vec<Module>,
    ids: u32,
    /// The most entries that are waited for at once.
    most_waited_for: u32,
    inside: u32,
    outside: u32,
}

/// IDs in use, and the lowest that is not.
#[derive(Default)]
struct Ids {
    free: BinaryHeap<Reverse<u32>>,
    used: u32,
}

impl Ids {
    fn lock_lowest(&mut self) -> u32 {
        self.free.pop().map_or_else(
            || {
                self.used += 1;
                self.used - 1
            },
            |Reverse(id)| id,
        )
    }

    fn unlock(&mut self, id: u32) {
        self.free.push(Reverse(id));
    }
}

impl From<&Blist> for StatusList {
    fn from(blist: &Blist) -> Self {
        let entries = blist.entries();
        let mut ids = Ids::default();
        // By entry, and behind the entries those of the two ends.
        let mut id_of: Vec<Option<u32>> = vec![None; entries.len() + 2];
        let place = |jump: Jump| match jump {
            Jump::Entry(entry) => entry as usize,
            Jump::Out => entries.len(),
            Jump::In => entries.len() + 1,
        };
        id_of[0] = Some(ids.lock_lowest());
        let (mut waited_for, mut most_waited_for) = (1, 1);
        let mut modules = Vec::with_capacity(entries.len());
        for (position, entry) in entries.iter().enumerate() {
            let id = id_of[position].expect("some entry leads to the next, and all begin at the first");
            ids.unlock(id);
            waited_for -= 1;
            // The next entry first, then the match, as the paper does.
            let (next, other) = if place(entry.if_in) <= place(entry.if_out) {
                (entry.if_in, entry.if_out)
            } else {
                (entry.if_out, entry.if_in)
            };
            for way in [next, other] {
                let id = &mut id_of[place(way)];
                if id.is_none() {
                    *id = Some(ids.lock_lowest());
                    waited_for += u32::from(place(way) < entries.len());
                }
            }
            most_waited_for = most_waited_for.max(waited_for);
            let at = |jump: Jump| id_of[place(jump)].expect("both ways have just been given theirs");
            modules.push(Module { leaf: entry.leaf(), id, if_in: at(entry.if_in), if_out: at(entry.if_out) });
        }
        let end = |jump: Jump| id_of[place(jump)].expect("the last entry leads to both ends");
        Self { inside: end(Jump::In), outside: end(Jump::Out), ids: ids.used, most_waited_for, modules }
    }
}

/// Of 64 points, which may be inside a leaf or a result and which may be outside: a decided point has one of its two bits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Points {
    /// Bit i is set where point i may be inside.
    pub may_be_in: u64,
    /// Bit i is set where point i may be outside.
    pub may_be_out: u64,
}

impl Points {
    /// Points that are decided.
    pub fn decided(inside: u64) -> Self {
        Self { may_be_in: inside, may_be_out: !inside }
    }

    /// One point's value. `False` too for a point that was not asked about.
    pub fn get(self, point: u32) -> Tri {
        match (self.may_be_in >> point & 1, self.may_be_out >> point & 1) {
            (1, 1) => Tri::Unknown,
            (1, _) => Tri::True,
            _ => Tri::False,
        }
    }
}

impl StatusList {
    /// The entries in the expression's order.
    pub fn modules(&self) -> &[Module] {
        &self.modules
    }

    /// How many IDs are used, those of `in` and `out` included: IDs are `0..id_count()`.
    pub fn id_count(&self) -> u32 {
        self.ids
    }

    /// How many IDs would be used if `in` and `out` had two to themselves from the start.
    pub fn id_count_with_ends_apart(&self) -> u32 {
        self.most_waited_for + 2
    }

    /// Up to 64 points in one forward walk, in Kleene's logic: `asked` has the bits of those that are wanted. Asks about leaves that
    /// still matter to one of them, in order, each occurrence at most once, and tells for which points.
    pub fn walk(&self, asked: u64, scratch: &mut Vec<u64>, mut inside: impl FnMut(LeafId, u64) -> Points) -> Points {
        scratch.clear();
        scratch.resize(self.ids as usize, 0);
        scratch[self.modules[0].id as usize] = asked;
        for module in &self.modules {
            let here = std::mem::take(&mut scratch[module.id as usize]);
            if here != 0 {
                let found = inside(module.leaf, here);
                scratch[module.if_in as usize] |= here & found.may_be_in;
                scratch[module.if_out as usize] |= here & found.may_be_out;
            }
        }
        Points { may_be_in: scratch[self.inside as usize], may_be_out: scratch[self.outside as usize] }
    }
}

#[cfg(test)]
mod tests {
    use super::super::exhaustive::leaf_of_letter;
    use super::*;
    use crate::csg::expression::parse;
    use crate::csg::left_heavy::First;
    use crate::csg::{Positive, TreeBuilder};

    fn positive(text: &str) -> Positive {
        parse(text, &mut leaf_of_letter).unwrap().positive()
    }

    fn list(positive: &Positive) -> StatusList {
        StatusList::from(&positive.blist())
    }

    /// The path of zigzags as the derivation has it, and nothing beside it that the left-heavy order would move: from below,
    /// `rights` steps to the right that each leave a list of just as many leaves as keeps its place on the left, a step to the
    /// left before each; above them as many more steps to the left.
    fn worst(rights: u32, more_lefts: u32) -> Positive {
        let mut builder = TreeBuilder::default();
        let mut next_leaf = 0;
        let mut leaf = |builder: &mut TreeBuilder| {
            builder.leaf(LeafId(next_leaf));
            next_leaf += 1;
        };
        // In post-order: all that is left of the path from the top, the lowest leaf, then what is right of it from below.
        for right in (1..=rights).rev() {
            leaf(&mut builder);
            for _ in 1..2 * right {
                leaf(&mut builder);
                builder.and();
            }
        }
        leaf(&mut builder);
        for _ in 0..rights {
            // To the left at a union, which makes a new place for what is outside; to the right at an intersection.
            leaf(&mut builder);
            builder.or().and();
        }
        for level in 0..more_lefts {
            leaf(&mut builder);
            if level % 2 == 0 {
                builder.or()
            } else {
                builder.and()
            };
        }
        builder.finish().unwrap().positive()
    }

    #[test]
    fn figure_11_of_the_paper() {
        // Eight leaves along a zigzag.
        let zigzag = positive("(a & ((b & ((c & ((d & h) | g)) | f)) | e))");
        assert_eq!(zigzag.literals().count(), 8);
        assert_eq!(list(&zigzag).id_count(), 5);
        for first in [First::Deeper, First::Busier] {
            assert_eq!(list(&zigzag.left_heavy(first)).id_count(), 2);
        }
        // A list needs two, whatever its length and its operators.
        assert_eq!(list(&positive("((((((a & b) | c) & d) | e) - f) | g) & h")).id_count(), 2);
    }

    #[test]
    fn ids_of_the_papers_example() {
        // The paper's algorithm by hand on (ABC∪D)(E'F'∪G'): A 0, B 0, C 0, D 1, E 0, F 0, G 2; out 1, in 0.
        let list = list(&positive("(a & b & c | d) - (e | f) & g"));
        let ids: Vec<u32> = list.modules().iter().map(|module| module.id).collect();
        assert_eq!((ids, list.outside, list.inside), (vec![0, 0, 0, 1, 0, 0, 2], 1, 0));
        assert_eq!(list.id_count(), 3);
    }

    #[test]
    fn the_worst_left_heavy_trees_have_as_many_leaves_as_derived() {
        for x in 3..40_u32 {
            let tree = worst(x - 2, 0);
            assert_eq!(tree.literals().count() as u32, (x - 1) * (x - 1));
            assert_eq!(tree.left_heavy(First::Deeper), tree, "it is left-heavy already");
            assert_eq!(list(&tree).id_count(), x);
            let y = x;
            let tree = worst(y - 2, 2);
            assert_eq!(tree.literals().count() as u32, y * y - 2 * y + 3);
            assert_eq!(tree.left_heavy(First::Deeper), tree);
            assert_eq!(list(&tree).id_count_with_ends_apart(), y + 2);
        }
    }

    #[test]
    fn sixty_four_ids_serve_4095_leaves_or_3845_with_the_ends_apart() {
        let least = worst(63, 0);
        assert_eq!((least.literals().count(), list(&least).id_count()), (4096, 65));
        let least = worst(61, 2);
        assert_eq!((least.literals().count(), list(&least).id_count_with_ends_apart()), (3846, 65));
        // The paper's bound, 3909 leaves, lies between the two.
        // The busier operand first: a handful.
        for worst in [worst(63, 0), worst(61, 2)] {
            let levels = worst.literals().count().ilog2();
            assert!(list(&worst.left_heavy(First::Busier)).id_count() <= levels + 2);
        }
    }
}
