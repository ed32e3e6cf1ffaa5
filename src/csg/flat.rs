//! The expression with as few nodes as its operators allow, and what of it is left where most leaves are absent.
//!
//! *Theory.* Union and intersection are associative, so a run of equal operators in the positive form is one node with
//! many operands: `a - b - c - d` is a single intersection of `a`, `b'`, `c'`, `d'`. A node is *decided* as soon as one
//! operand has its deciding value (false for an intersection, true for a union); otherwise it has the other value. So it
//! is enough to count, for every node, the operands that decide it. Where a leaf is absent its literals are constants;
//! a node that a constant decides is a constant, and constants that do not decide vanish.
//!
//! *Changes from the paper.* Blister 2005 §3 walks a list, which visits literals one after the other. Here a node's
//! literals lie in bit masks: 32 of them are compared at once, and eight points at a time ([`Shrunk::eval_lanes`]); or
//! only the nodes are visited that the toggle of one leaf changes ([`Counters`]). Over few leaves the values of all states are
//! found once and looked up (`csg::table`).
//!
//! *Practice.* [`Flat`] is made once for a scene. [`Shrunk::keep`] is called for every tile with the leaves that occur
//! there: it visits those leaves and the nodes above them, never the whole tree. Leaves that cannot matter any more get no
//! slot.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, u32x8};

use super::positive::PositiveNode;
use super::table::{self, Table};
use super::{LeafId, Positive};

/// Leaves a word of state holds.
pub const SLOTS_A_WORD: usize = 32;

/// No parent: the root.
pub(super) const ROOT: u32 = u32::MAX;

/// One occurrence of a leaf in a [`Flat`] node, or of a slot in a [`Shrunk`] one.
#[derive(Debug, Clone, Copy)]
struct Place {
    node: u32,
    negated: bool,
}

/// A positive form whose nodes have any number of operands. Parents come before their children.
#[derive(Debug, Clone)]
pub struct Flat {
    is_and: Vec<bool>,
    parents: Vec<u32>,
    /// By node: how many of its operands decide it where every leaf is out.
    deciding: Vec<u32>,
    /// The leaves that occur, sorted.
    leaves: Vec<LeafId>,
    /// By position in `leaves`: where its places begin; one more than there are leaves.
    starts: Vec<u32>,
    places: Vec<Place>,
}

impl From<&Positive> for Flat {
    fn from(positive: &Positive) -> Self {
        let nodes = positive.nodes();
        let (mut is_and, mut parents) = (Vec::new(), Vec::new());
        // The flat node that each operand belongs to, from the root down.
        let mut belongs = vec![ROOT; nodes.len()];
        let mut literals = Vec::new();
        for (i, node) in nodes.iter().enumerate().rev() {
            let above = belongs[i];
            let (a, b, and) = match *node {
                PositiveNode::Literal(literal) => {
                    // An expression of one literal is an intersection of one.
                    if above == ROOT {
                        is_and.push(true);
                        parents.push(ROOT);
                    }
                    let node = if above == ROOT { 0 } else { above };
                    literals.push((literal.leaf, Place { node, negated: literal.negated }));
                    continue;
                }
                PositiveNode::And(a, b) => (a, b, true),
                PositiveNode::Or(a, b) => (a, b, false),
            };
            let own = if above != ROOT && is_and[above as usize] == and {
                above
            } else {
                is_and.push(and);
                parents.push(above);
                super::tree::index(is_and.len() - 1)
            };
            belongs[a as usize] = own;
            belongs[b as usize] = own;
        }
        literals.sort_by_key(|(leaf, place)| (*leaf, place.node, place.negated));
        let leaves = positive.leaves();
        let mut starts = Vec::with_capacity(leaves.len() + 1);
        for (i, (leaf, _)) in literals.iter().enumerate() {
            if i == 0 || literals[i - 1].0 != *leaf {
                starts.push(super::tree::index(i));
            }
        }
        starts.push(super::tree::index(literals.len()));
        let places: Vec<Place> = literals.into_iter().map(|(_, place)| place).collect();

        let mut deciding = vec![0_u32; is_and.len()];
        for place in &places {
            // Out, a literal is what its complement says; it decides an intersection when false, a union when true.
            deciding[place.node as usize] += u32::from(place.negated != is_and[place.node as usize]);
        }
        for node in (1..is_and.len()).rev() {
            let value = is_and[node] == (deciding[node] == 0);
            let above = parents[node] as usize;
            deciding[above] += u32::from(value != is_and[above]);
        }
        Self { is_and, parents, deciding, leaves, starts, places }
    }
}

impl Flat {
    /// The leaves that occur, sorted.
    pub fn leaves(&self) -> &[LeafId] {
        &self.leaves
    }

    fn places_of(&self, leaf: LeafId) -> &[Place] {
        match self.leaves.binary_search(&leaf) {
            Ok(at) => &self.places[self.starts[at] as usize..self.starts[at + 1] as usize],
            Err(_) => &[],
        }
    }
}

/// Up to 32 literals of one node.
#[derive(Debug, Clone, Copy)]
pub(super) struct Literals {
    /// Which word of the state.
    pub word: u32,
    /// Which bits of it.
    pub mask: u32,
    /// Those of them that are complemented.
    pub negated: u32,
}

#[derive(Debug, Clone, Copy)]
pub(super) struct ShrunkNode {
    pub is_and: bool,
    /// [`ROOT`] for the last one.
    pub parent: u32,
    /// Range in `Shrunk::literals`.
    pub first: u32,
    pub end: u32,
    /// How many operands decide it where every leaf is out.
    deciding: u32,
}

/// What [`Shrunk::keep`] leaves of an expression.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kept {
    /// It is in or out whatever the leaves that were kept are.
    Constant(bool),
    /// It depends on [`Shrunk::slots`].
    Open,
}

/// An expression over the few leaves that are present somewhere. A leaf is a *slot* here: a bit of the state. Buffers are
/// kept from call to call.
#[derive(Debug, Clone, Default)]
pub struct Shrunk {
    slots: Vec<LeafId>,
    /// Children before parents, the root last.
    pub(super) nodes: Vec<ShrunkNode>,
    pub(super) literals: Vec<Literals>,
    /// By slot: where its places begin; one more than there are slots.
    starts: Vec<u32>,
    places: Vec<Place>,
    /// By node of the flat expression: its place in `touched`, plus one; 0 elsewhere.
    touched_at: Vec<u32>,
    touched: Vec<Touched>,
    order: Vec<u32>,
    /// Where the expression has more than one node, and few slots.
    table: Option<Table>,
}

/// A node above a present leaf, while shrinking.
#[derive(Debug, Clone, Copy)]
struct Touched {
    node: u32,
    /// Operands that decide it whatever the present leaves are.
    deciding: u32,
    /// Operands that are open.
    open: u32,
    /// Its number among the kept nodes, where it is kept.
    kept: u32,
}

/// [`Touched::kept`] of a node that is not kept.
const NOT_KEPT: u32 = u32::MAX;

impl Shrunk {
    /// Makes this what `flat` is where only the leaves `present` (sorted, each once) may be in. Leaves that the expression
    /// does not name, or that cannot matter, get no slot.
    pub fn keep(&mut self, flat: &Flat, present: &[LeafId]) -> Kept {
        self.clear();
        self.touched_at.resize(flat.is_and.len(), 0);
        // Step 1: the nodes above present leaves. Their present operands no longer count as deciding.
        for &leaf in present {
            for place in flat.places_of(leaf) {
                let at = self.touch(flat, place.node);
                let decided = place.negated != flat.is_and[place.node as usize];
                self.touched[at].deciding -= u32::from(decided);
                self.touched[at].open += 1;
            }
        }
        // Step 2: children before parents; a child that stayed open is an open operand, one that became a constant may
        // decide.
        self.order.extend(self.touched.iter().map(|t| t.node));
        self.order.sort_unstable_by(|a, b| b.cmp(a));
        for i in 0..self.order.len() {
            let node = self.order[i];
            let own = self.touched[self.touched_at[node as usize] as usize - 1];
            let above = flat.parents[node as usize];
            if above == ROOT {
                continue;
            }
            let is_and = flat.is_and[node as usize];
            let above_is_and = flat.is_and[above as usize];
            let up = &mut self.touched[self.touched_at[above as usize] as usize - 1];
            if own.deciding == 0 && own.open > 0 {
                up.open += 1;
            } else {
                let value = is_and == (own.deciding == 0);
                up.deciding += u32::from(value != above_is_and);
            }
        }
        let root = match self.touched_at.first() {
            Some(&at) if at > 0 => self.touched[at as usize - 1],
            _ => {
                self.reset_touched();
                return Kept::Constant(flat.is_and[0] == (flat.deciding[0] == 0));
            }
        };
        if root.deciding > 0 || root.open == 0 {
            self.reset_touched();
            return Kept::Constant(flat.is_and[0] == (root.deciding == 0));
        }
        self.write(flat, present);
        self.reset_touched();
        Kept::Open
    }

    fn clear(&mut self) {
        self.slots.clear();
        self.nodes.clear();
        self.literals.clear();
        self.starts.clear();
        self.places.clear();
        self.order.clear();
        self.touched.clear();
        self.table = None;
    }

    fn reset_touched(&mut self) {
        for touched in &self.touched {
            self.touched_at[touched.node as usize] = 0;
        }
    }

    /// The place of `node` in `touched`, where it and all nodes above it are put.
    fn touch(&mut self, flat: &Flat, node: u32) -> usize {
        let found = self.touched_at[node as usize];
        if found > 0 {
            return found as usize - 1;
        }
        let mut next = node;
        let first = self.touched.len();
        while next != ROOT && self.touched_at[next as usize] == 0 {
            let deciding = flat.deciding[next as usize];
            self.touched.push(Touched { node: next, deciding, open: 0, kept: NOT_KEPT });
            self.touched_at[next as usize] = self.touched.len() as u32;
            next = flat.parents[next as usize];
        }
        // A touched child's all-out value is no constant operand any more.
        for at in first..self.touched.len() {
            let child = self.touched[at].node as usize;
            let above = flat.parents[child];
            if above != ROOT {
                let value = flat.is_and[child] == (flat.deciding[child] == 0);
                let up = self.touched_at[above as usize] as usize - 1;
                self.touched[up].deciding -= u32::from(value != flat.is_and[above as usize]);
            }
        }
        first
    }

    /// Step 3: the open nodes below the root, children first, and the slots that they name.
    fn write(&mut self, flat: &Flat, present: &[LeafId]) {
        // From the root down: a node is kept if it is open and its parent is kept.
        let mut count = 0;
        for i in (0..self.order.len()).rev() {
            let node = self.order[i] as usize;
            let above = flat.parents[node];
            let is_kept = above == ROOT || self.touched[self.touched_at[above as usize] as usize - 1].kept != NOT_KEPT;
            let own = &mut self.touched[self.touched_at[node] as usize - 1];
            if is_kept && own.deciding == 0 && own.open > 0 {
                own.kept = count;
                count += 1;
            }
        }
        // Numbered from the root; turned over, so that the root is last.
        let number = |touched: &Touched| count - 1 - touched.kept;
        let none = ShrunkNode { is_and: true, parent: ROOT, first: 0, end: 0, deciding: 0 };
        self.nodes.resize(count as usize, none);
        for touched in self.touched.iter().filter(|t| t.kept != NOT_KEPT) {
            let node = &mut self.nodes[number(touched) as usize];
            node.is_and = flat.is_and[touched.node as usize];
            let above = flat.parents[touched.node as usize];
            if above != ROOT {
                node.parent = number(&self.touched[self.touched_at[above as usize] as usize - 1]);
            }
        }
        for &leaf in present {
            let first = self.places.len();
            for place in flat.places_of(leaf) {
                let touched = &self.touched[self.touched_at[place.node as usize] as usize - 1];
                if touched.kept != NOT_KEPT {
                    self.places.push(Place { node: number(touched), negated: place.negated });
                }
            }
            if self.places.len() > first {
                self.slots.push(leaf);
                self.starts.push(first as u32);
            }
        }
        self.starts.push(self.places.len() as u32);
        // By node and word.
        let mut sorted: Vec<(u32, u32, bool)> = Vec::with_capacity(self.places.len());
        for (slot, range) in self.starts.windows(2).enumerate() {
            let places = &self.places[range[0] as usize..range[1] as usize];
            sorted.extend(places.iter().map(|place| (place.node, slot as u32, place.negated)));
        }
        sorted.sort_unstable();
        let mut next = 0;
        for (number, node) in self.nodes.iter_mut().enumerate() {
            node.first = self.literals.len() as u32;
            while let Some(&(of, slot, negated)) = sorted.get(next) {
                if of as usize != number {
                    break;
                }
                next += 1;
                let (word, bit) = (slot / SLOTS_A_WORD as u32, 1 << (slot % SLOTS_A_WORD as u32));
                let own = self.literals.len() > node.first as usize;
                match self.literals.last_mut() {
                    // A slot that stands here both ways needs its bit twice.
                    Some(last) if own && last.word == word && last.mask & bit == 0 => {
                        last.mask |= bit;
                        last.negated |= if negated { bit } else { 0 };
                    }
                    _ => self.literals.push(Literals { word, mask: bit, negated: if negated { bit } else { 0 } }),
                }
            }
            node.end = self.literals.len() as u32;
        }
        // What decides where all is out, children first.
        for &(node, _, negated) in &sorted {
            let node = &mut self.nodes[node as usize];
            node.deciding += u32::from(negated != node.is_and);
        }
        for i in 0..self.nodes.len() - 1 {
            let (is_and, deciding, parent) = (self.nodes[i].is_and, self.nodes[i].deciding, self.nodes[i].parent);
            let above = &mut self.nodes[parent as usize];
            above.deciding += u32::from((is_and == (deciding == 0)) != above.is_and);
        }
        // One node is as soon evaluated as looked up.
        if self.nodes.len() > 1 && self.slots.len() <= table::MOST_SLOTS {
            self.table = Some(self.tabulated());
        }
    }

    fn tabulated(&self) -> Table {
        let mut values: Vec<Table> = self.nodes.iter().map(|node| Table::constant(node.is_and)).collect();
        for (i, node) in self.nodes.iter().enumerate() {
            let own = self.literals[node.first as usize..node.end as usize].iter().flat_map(|literals| {
                let slots = (0..self.slots.len()).filter(|slot| literals.mask >> slot & 1 == 1);
                slots.map(|slot| Table::of_slot(slot, literals.negated >> slot & 1 == 1))
            });
            let value = own.fold(values[i], |value, literal| value.and_or(literal, node.is_and));
            values[i] = value;
            if let Some(above) = values.get_mut(node.parent as usize) {
                *above = above.and_or(value, self.nodes[node.parent as usize].is_and);
            }
        }
        // The root is the last.
        values[values.len() - 1]
    }

    /// The leaves that matter, sorted: slot `i` is bit `i % 32` of word `i / 32` of a state.
    pub fn slots(&self) -> &[LeafId] {
        &self.slots
    }

    /// The words of a state.
    pub fn words(&self) -> usize {
        self.slots.len().div_ceil(SLOTS_A_WORD)
    }

    /// The nodes: what [`Self::eval`] costs.
    pub fn node_count(&self) -> usize {
        self.nodes.len()
    }

    /// Whether a point is inside the result, given the state of the slots.
    ///
    /// # Panics
    /// Unless [`keep`](Self::keep) returned [`Kept::Open`] and `state` has all words.
    pub fn eval(&self, state: &[u32], scratch: &mut Vec<bool>) -> bool {
        self.eval_with(scratch, |literals| state[literals.word as usize])
    }

    /// As [`eval`](Self::eval), where the uncomplemented occurrences of the slots in `gone` are out. Complemented ones are
    /// what `state` says.
    ///
    /// # Panics
    /// As [`eval`](Self::eval); and unless `gone` has all words.
    pub fn eval_without(&self, state: &[u32], gone: &[u32], scratch: &mut Vec<bool>) -> bool {
        let left = |literals: &Literals| {
            let word = literals.word as usize;
            state[word] & !(gone[word] & !literals.negated)
        };
        self.eval_with(scratch, left)
    }

    /// The result, where `inside` tells for the literals of a word which of their leaves the point is inside of.
    #[inline(always)]
    fn eval_with(&self, scratch: &mut Vec<bool>, inside: impl Fn(&Literals) -> u32) -> bool {
        scratch.clear();
        scratch.extend(self.nodes.iter().map(|node| node.is_and));
        for (i, node) in self.nodes.iter().enumerate() {
            let mut value = scratch[i];
            for literals in &self.literals[node.first as usize..node.end as usize] {
                let holds = (inside(literals) ^ literals.negated) & literals.mask;
                value = if node.is_and { value & (holds == literals.mask) } else { value | (holds != 0) };
            }
            match scratch.get_mut(node.parent as usize) {
                Some(above) if self.nodes[node.parent as usize].is_and => *above &= value,
                Some(above) => *above |= value,
                None => return value,
            }
        }
        unreachable!("the last node is the root")
    }

    /// Whether it is one product: an intersection of literals.
    pub fn is_product(&self) -> bool {
        matches!(&self.nodes[..], [root] if root.is_and)
    }

    /// [`Self::eval`] for eight points at once: the lanes of `state` are theirs. A lane of the result has all bits set
    /// where its point is inside, else none. `scratch` has [`node_count`](Self::node_count) entries, of any value.
    #[inline(always)]
    pub fn eval_lanes<S: Simd>(&self, simd: S, state: &[u32x8<S>], scratch: &mut [u32x8<S>]) -> u32x8<S> {
        if let (Some(table), [state, ..]) = (&self.table, state) {
            return table.look_up(simd, *state);
        }
        let (none, all) = (u32x8::splat(simd, 0), u32x8::splat(simd, u32::MAX));
        if let [root] = &self.nodes[..] {
            return self.own_lanes(simd, root, state, if root.is_and { all } else { none });
        }
        for (value, node) in scratch.iter_mut().zip(&self.nodes) {
            *value = if node.is_and { all } else { none };
        }
        for (i, node) in self.nodes.iter().enumerate() {
            let value = self.own_lanes(simd, node, state, scratch[i]);
            let Some(above) = self.nodes.get(node.parent as usize) else { return value };
            let up = &mut scratch[node.parent as usize];
            *up = if above.is_and { *up & value } else { *up | value };
        }
        none
    }

    /// A node's value with its own literals, given that of its other operands. Not a closure: those are not always inlined,
    /// and then every operation becomes a call.
    #[inline(always)]
    fn own_lanes<S: Simd>(&self, simd: S, node: &ShrunkNode, state: &[u32x8<S>], mut value: u32x8<S>) -> u32x8<S> {
        for literals in &self.literals[node.first as usize..node.end as usize] {
            let mask = u32x8::splat(simd, literals.mask);
            let holds = (state[literals.word as usize] ^ literals.negated) & mask;
            value = if node.is_and {
                holds.simd_eq(mask).select(value, u32x8::splat(simd, 0))
            } else {
                holds.simd_eq(0).select(value, u32x8::splat(simd, u32::MAX))
            };
        }
        value
    }
}

/// An expression's value while leaves are toggled one by one: only the nodes whose value changes are visited.
#[derive(Debug, Clone, Default)]
pub struct Counters {
    /// By slot.
    inside: Vec<bool>,
    /// By node: how many operands decide it.
    deciding: Vec<u32>,
}

impl Counters {
    /// Sets every slot of `shrunk` out.
    pub fn reset(&mut self, shrunk: &Shrunk) {
        self.inside.clear();
        self.inside.resize(shrunk.slots.len(), false);
        self.deciding.clear();
        self.deciding.extend(shrunk.nodes.iter().map(|node| node.deciding));
    }

    /// Whether the point is inside `slot`.
    pub fn is_inside(&self, slot: usize) -> bool {
        self.inside[slot]
    }

    /// Turns `slot` over; returns the result's value after it.
    pub fn toggle(&mut self, shrunk: &Shrunk, slot: usize) -> bool {
        self.inside[slot] ^= true;
        let inside = self.inside[slot];
        for place in &shrunk.places[shrunk.starts[slot] as usize..shrunk.starts[slot + 1] as usize] {
            let mut at = place.node as usize;
            let mut value = inside != place.negated;
            // An operand's value changed to `value`: climb for as long as that changes the node's.
            loop {
                let node = &shrunk.nodes[at];
                let count = &mut self.deciding[at];
                let was_decided = *count > 0;
                *count = if value == node.is_and { *count - 1 } else { *count + 1 };
                if was_decided == (*count > 0) || node.parent == ROOT {
                    break;
                }
                value = node.is_and == (*count == 0);
                at = node.parent as usize;
            }
        }
        self.value(shrunk)
    }

    /// The result's value.
    pub fn value(&self, shrunk: &Shrunk) -> bool {
        let root = shrunk.nodes.len() - 1;
        shrunk.nodes[root].is_and == (self.deciding[root] == 0)
    }
}
