//! Residuals: what of the expression still matters at one surfel.
//!
//! *Theory.* A surfel of leaf `own` lies on that leaf's surface, so crossing it turns `own` from outside to inside and
//! nothing else. The surfel bounds the result where the expression differs between the two: it **rises** where the result
//! is entered together with the leaf, and **falls** where the result is left (the result's outward normal is then the
//! leaf's, reversed). Every other leaf is `In` or `Out` for the whole surfel, or `Near`: undecided until a point of the
//! surfel is given. Rises and falls are then two Boolean functions of the `Near` leaves.
//!
//! *Changes from the paper.* Wicke 2004 §3.3.1 drops leaves that are not represented near the surfel (*unknown*), which
//! fails where sampling densities differ, and has one facing per patch. The residual keeps the constants that decided
//! leaves have, so it is the tree itself restricted to what is open; and it knows that in `(a - b) | (b - a)` the surface
//! of `a` faces both ways.
//!
//! *Practice.* Surfels with one signature (leaf, statuses) share a residual: build it once for each. Up to
//! [`TABLE_LEAVES`] open leaves it is a pair of truth tables in a word each, and then it is exact: leaves that the functions
//! do not depend on are dropped, and constant functions are recognised. Above that it is the folded expression's Blist,
//! walked for both memberships of `own` at once; whether that is constant is a satisfiability problem, so it is only
//! recognised as far as [`Residual::decided`] goes, and the answer at a point is right all the same.

use super::bits::PackedStack;
use super::positive::{Folded, PositiveNode};
use super::tree::index;
use super::{Blist, Jump, LeafId, Positive, Tri};

/// Open leaves up to which a residual is a truth table: 2^6 assignments are the bits of a word.
pub const TABLE_LEAVES: usize = u64::BITS.ilog2() as usize;

/// Where a surfel lies with respect to another leaf.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Membership {
    /// Inside, all of it.
    In,
    /// Outside, all of it.
    Out,
    /// The leaf's surface may pass through it.
    Near,
}

impl From<Membership> for Tri {
    fn from(membership: Membership) -> Self {
        match membership {
            Membership::In => Self::True,
            Membership::Out => Self::False,
            Membership::Near => Self::Unknown,
        }
    }
}

/// How the result changes where a leaf is entered.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Crossing {
    /// Entering the leaf enters the result: their outward normals agree.
    Rises,
    /// Entering the leaf leaves the result: their outward normals are opposite.
    Falls,
}

impl Crossing {
    /// The change from outside the leaf to inside it, given whether each side is in the result; `None` without a change.
    pub fn between(outside_leaf: bool, inside_leaf: bool) -> Option<Self> {
        match (outside_leaf, inside_leaf) {
            (false, true) => Some(Self::Rises),
            (true, false) => Some(Self::Falls),
            _ => None,
        }
    }
}

/// What is left of the expression at a surfel.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum Residual {
    /// Nowhere on the result's boundary.
    Off,
    /// On the result's boundary everywhere, the same way.
    On(Crossing),
    /// It depends on the point.
    Edge(EdgeResidual),
}

/// The open part of the expression at an edge surfel.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct EdgeResidual {
    /// The leaves that a point must be tested against, sorted; never the surfel's own.
    pub near: Vec<LeafId>,
    /// What their memberships mean.
    pub rule: Rule,
}

/// When an edge surfel bounds the result.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum Rule {
    /// For at most [`TABLE_LEAVES`] near leaves. Bit `j` is for the point that is inside `near[i]` just where bit `i` of `j`
    /// is set; bits from `2^near.len()` on are zero. No bit is set in both.
    Table {
        /// Where [`Crossing::Rises`].
        rises: u64,
        /// Where [`Crossing::Falls`].
        falls: u64,
    },
    /// For more. The list's leaves are *positions*: `i` stands for `near[i]`, and `near.len()` for the surfel's own leaf.
    Walk {
        /// The folded expression.
        list: Blist,
        /// The last entry of the own leaf: from there on both walks are one.
        last_own: u32,
    },
}

impl Residual {
    /// The residual of `tree` at a surfel of leaf `own`, where `status` tells the surfel's place in every other leaf.
    /// Where the tree has not got the leaf `own`, that is `Off`.
    pub fn of(tree: &Positive, own: LeafId, status: impl Fn(LeafId) -> Membership) -> Self {
        if let Some(decided) = Self::decided(tree, own, &status) {
            return decided;
        }
        let open = match tree.fold(|leaf| if leaf == own { Tri::Unknown } else { status(leaf).into() }) {
            Folded::Constant(_) => return Self::Off,
            Folded::Open(open) => open,
        };
        let mut near = open.leaves();
        let all = near.len();
        near.retain(|&leaf| leaf != own);
        if near.len() == all {
            return Self::Off;
        }
        if near.len() <= TABLE_LEAVES {
            return tabulate(&open, near);
        }
        let (list, last_own) = walk(&open, &near);
        Self::Edge(EdgeResidual { near, rule: Rule::Walk { list, last_own } })
    }

    /// `Off` or `On` where the statuses alone decide it, without allocating; `None` where they may not. Never wrong, and
    /// complete for expressions in which no leaf occurs twice.
    pub fn decided(tree: &Positive, own: LeafId, status: impl Fn(LeafId) -> Membership) -> Option<Self> {
        let mut stack = PackedStack::<{ pairs::BITS }>::default();
        for node in tree.nodes() {
            let value = match *node {
                PositiveNode::Literal(literal) => {
                    let set = if literal.leaf == own {
                        pairs::RISES
                    } else {
                        match status(literal.leaf) {
                            Membership::In => pairs::IN,
                            Membership::Out => pairs::OUT,
                            Membership::Near => pairs::IN | pairs::OUT,
                        }
                    };
                    if literal.negated { pairs::complement(set) } else { set }
                }
                PositiveNode::And(..) => pairs::AND[stack.pop() as usize][stack.pop() as usize],
                PositiveNode::Or(..) => pairs::OR[stack.pop() as usize][stack.pop() as usize],
            };
            stack.push(u64::from(value));
        }
        let possible = stack.pop() as u8;
        if possible & (pairs::RISES | pairs::FALLS) == 0 {
            Some(Self::Off)
        } else if possible == pairs::RISES {
            Some(Self::On(Crossing::Rises))
        } else if possible == pairs::FALLS {
            Some(Self::On(Crossing::Falls))
        } else {
            None
        }
    }
}

impl EdgeResidual {
    /// Whether and how the result changes at a point, where `inside(i)` tells whether the point is inside `near[i]`. Asks
    /// only while the answer depends on it: each leaf at most once by a table, once per occurrence by a walk.
    pub fn crossing(&self, mut inside: impl FnMut(usize) -> bool) -> Option<Crossing> {
        match &self.rule {
            &Rule::Table { mut rises, mut falls } => {
                // Halve the tables leaf by leaf; where both halves agree, the leaf does not matter here.
                for i in (0..self.near.len()).rev() {
                    let half = 1 << i;
                    let low = bits_below(half);
                    let inner = (rises >> half, falls >> half);
                    let outer = (rises & low, falls & low);
                    (rises, falls) = if inner == outer || !inside(i) { outer } else { inner };
                }
                if rises != 0 {
                    Some(Crossing::Rises)
                } else if falls != 0 {
                    Some(Crossing::Falls)
                } else {
                    None
                }
            }
            Rule::Walk { list, last_own } => {
                let own = LeafId(index(self.near.len()));
                // Two walks, outside and inside the own leaf; the one that is behind moves, or both where they meet.
                let mut walks = [Jump::Entry(0); 2];
                loop {
                    let at = match walks {
                        // From here on both go the same way.
                        [Jump::Entry(a), Jump::Entry(b)] if a == b && a > *last_own => return None,
                        [Jump::Entry(a), Jump::Entry(b)] => a.min(b),
                        [Jump::Entry(a), _] | [_, Jump::Entry(a)] => a,
                        [outside, inside] => return Crossing::between(outside == Jump::In, inside == Jump::In),
                    };
                    let entry = list.entries()[at as usize];
                    let values = if entry.leaf() == own { [false, true] } else { [inside(entry.leaf().0 as usize); 2] };
                    for (walk, value) in walks.iter_mut().zip(values) {
                        if *walk == Jump::Entry(at) {
                            *walk = entry.jump(value);
                        }
                    }
                }
            }
        }
    }
}

/// Sets of pairs (result outside the own leaf, result inside it): Kleene's logic for two results at once.
///
/// A pair is a number of two bits, inside in the low one; a set has a bit per pair. Where no leaf occurs twice, operands
/// are independent and the sets are exact.
mod pairs {
    /// One bit for each of the four pairs.
    pub(super) const BITS: u32 = 4;
    const SETS: usize = 1 << BITS;

    /// Outside on both sides.
    pub(super) const OUT: u8 = 1 << 0b00;
    /// Outside the leaf out, inside the leaf in.
    pub(super) const RISES: u8 = 1 << 0b01;
    /// Outside the leaf in, inside the leaf out.
    pub(super) const FALLS: u8 = 1 << 0b10;
    /// Inside on both sides.
    pub(super) const IN: u8 = 1 << 0b11;

    /// All intersections of a pair of one set with a pair of another.
    pub(super) const AND: [[u8; SETS]; SETS] = combine(true);
    /// All unions.
    pub(super) const OR: [[u8; SETS]; SETS] = combine(false);

    /// The set of the complements: pair `p` becomes pair `3 - p`, which reverses the set's bits.
    pub(super) const fn complement(set: u8) -> u8 {
        set.reverse_bits() >> (u8::BITS - BITS)
    }

    const fn combine(is_and: bool) -> [[u8; SETS]; SETS] {
        let mut table = [[0; SETS]; SETS];
        // Loops over a, b: the sets; p, q: the pairs. (Iterators are not const.)
        let mut a = 0;
        while a < SETS {
            let mut b = 0;
            while b < SETS {
                let mut p = 0;
                while p < BITS as usize {
                    let mut q = 0;
                    while q < BITS as usize {
                        if a >> p & 1 == 1 && b >> q & 1 == 1 {
                            table[a][b] |= 1 << if is_and { p & q } else { p | q };
                        }
                        q += 1;
                    }
                    p += 1;
                }
                b += 1;
            }
            a += 1;
        }
        table
    }
}

/// A word with the lowest `count` bits set; `count` is at most a word's.
const fn bits_below(count: u32) -> u64 {
    if count >= u64::BITS { u64::MAX } else { (1 << count) - 1 }
}

/// For each of a table's variables, the assignments in which it is true.
const VARIABLES: [u64; TABLE_LEAVES] = {
    let mut tables = [0; TABLE_LEAVES];
    let mut variable = 0;
    while variable < TABLE_LEAVES {
        let mut assignment = 0;
        while assignment < u64::BITS {
            tables[variable] |= ((assignment >> variable & 1) as u64) << assignment;
            assignment += 1;
        }
        variable += 1;
    }
    tables
};

/// The residual over at most [`TABLE_LEAVES`] open leaves: all assignments at once, one bit each. The leaf that is not in
/// `near` is the surfel's own.
fn tabulate(open: &Positive, mut near: Vec<LeafId>) -> Residual {
    // Each value is a pair of tables: outside the own leaf, inside it.
    let mut stack: Vec<[u64; 2]> = Vec::new();
    for node in open.nodes() {
        let mut operand = || stack.pop().expect("a post-order arena has two operands before each operator");
        let value = match *node {
            PositiveNode::Literal(literal) => {
                let table = match near.binary_search(&literal.leaf) {
                    Ok(i) => [VARIABLES[i]; 2],
                    Err(_) => [0, u64::MAX],
                };
                if literal.negated { table.map(|table| !table) } else { table }
            }
            PositiveNode::And(..) => {
                let (b, a) = (operand(), operand());
                [a[0] & b[0], a[1] & b[1]]
            }
            PositiveNode::Or(..) => {
                let (b, a) = (operand(), operand());
                [a[0] | b[0], a[1] | b[1]]
            }
        };
        stack.push(value);
    }
    let [outside, inside] = stack.pop().expect("a positive form has at least one node");
    let all = bits_below(1 << near.len());
    let (mut rises, mut falls) = (inside & !outside & all, outside & !inside & all);
    if rises | falls == 0 {
        return Residual::Off;
    }
    if rises == all {
        return Residual::On(Crossing::Rises);
    }
    if falls == all {
        return Residual::On(Crossing::Falls);
    }
    for i in (0..near.len()).rev() {
        let same = |table: u64| table & !VARIABLES[i] == (table >> (1 << i)) & !VARIABLES[i];
        if same(rises) && same(falls) {
            near.remove(i);
            rises = without_variable(rises, i, near.len());
            falls = without_variable(falls, i, near.len());
        }
    }
    Residual::Edge(EdgeResidual { near, rule: Rule::Table { rises, falls } })
}

/// A table that does not depend on variable `variable`, over the `left` others.
fn without_variable(table: u64, variable: usize, left: usize) -> u64 {
    let below = (1usize << variable) - 1;
    // The assignment with a zero put in at the variable's place.
    let widened = |assignment: usize| (assignment & !below) << 1 | assignment & below;
    (0..1usize << left).fold(0, |narrow, assignment| narrow | (table >> widened(assignment) & 1) << assignment)
}

/// The folded expression over positions in `near`, and the last entry of the own leaf: the only one that is not in `near`.
fn walk(open: &Positive, near: &[LeafId]) -> (Blist, u32) {
    let own_position = LeafId(index(near.len()));
    let position = |leaf: LeafId| near.binary_search(&leaf).map_or(own_position, |i| LeafId(index(i)));
    let list = open.map_leaves(position).blist();
    let last_own = list.entries().iter().rposition(|entry| entry.leaf() == own_position).unwrap_or(0);
    (list, index(last_own))
}
