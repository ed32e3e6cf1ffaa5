//! Leaves that are not made of surfels, on the rays of a tile: where each ray crosses them, and which crossings are on the
//! result.
//!
//! # Theory
//! A crossing of an exact leaf is a boundary where the expression before it differs from the expression after it. The sides
//! of the other exact leaves are known from the ray's own crossings; a scan is asked by its field at the crossing (DESIGN's
//! hybrid rule: a surfel fragment asks a mesh leaf exactly, a mesh fragment asks a surfel leaf by its field). Coincident crossings
//! toggle together; who owns such a boundary, and whose material lies behind it, is Blister's active leaf (Hable and Rossignac
//! 2005 §4.3) with the order that every pipeline keeps: a leaf that matters, then one that goes the result's way, then
//! the least index.
//!
//! # Practice
//! Leaves that no ray of the tile crosses, or begins inside of, are constants. A crossing whose sides are the same whatever the
//! scans say is passed over without asking them, so where exact leaves lie beside one another they cost no question.

use glam::{DVec2, DVec3, Vec3};

use super::hits::Hit;
use super::project::View;
use super::tied::{self, Tied};
use crate::classify::Model;
use crate::crossings::{Crossing, CrossingSource, CrossingTile};
use crate::csg::positive::Folded;
use crate::csg::{LeafId, Positive, Tri};
use crate::layers::Facing;
use crate::scene::LeafKind;
use crate::space::PixelRect;

/// Memberships of a point: a bit for each leaf of the tile's expression, 64 to a word.
type State = Vec<u64>;

/// The crossings of one tile's rays at one place within their pixels, and the expression that is left there.
pub struct Crossed<'a> {
    model: &'a Model,
    view: &'a View,
    source: &'a dyn CrossingSource,
    tile: CrossingTile,
    rect: PixelRect,
    offset: DVec2,
    anchor: f64,
    /// The leaves that the source finds.
    of_source: Vec<LeafId>,
    /// The expression over the leaves that are not constant in the tile; `None` where it is constant itself.
    left: Option<Left>,
}

/// The expression that is left in a tile.
struct Left {
    expression: Positive,
    /// Its leaves, ascending: the order of the bits of a [`State`].
    leaves: Vec<LeafId>,
    /// By leaf index: its bit, or [`NO_BIT`].
    bits: Vec<u32>,
    /// Its values, where it has at most [`MOST_IN_TABLE`] leaves.
    table: Option<u64>,
    /// The bits of the leaves that must be asked.
    asked: State,
    /// Whether any of the other leaves is undecided at some pixel.
    any_undecided: bool,
}

/// [`Left::bits`] of a leaf that is constant in the tile.
const NO_BIT: u32 = u32::MAX;

/// Leaves whose truth table is one word.
const MOST_IN_TABLE: usize = 6;

fn get(state: &[u64], bit: u32) -> bool {
    state[bit as usize / 64] >> (bit % 64) & 1 == 1
}

fn put(state: &mut [u64], bit: u32, value: bool) {
    let (word, mask) = (&mut state[bit as usize / 64], 1 << (bit % 64));
    if value { *word |= mask } else { *word &= !mask }
}

impl Left {
    fn eval(&self, state: &[u64]) -> bool {
        match self.table {
            Some(table) => table >> state[0] & 1 == 1,
            None => self.expression.eval(|leaf| get(state, self.bits[leaf.0 as usize])),
        }
    }

    /// As [`eval`](Self::eval) where one bit is turned over.
    fn eval_turned(&self, state: &mut [u64], bit: u32) -> bool {
        state[bit as usize / 64] ^= 1 << (bit % 64);
        let value = self.eval(state);
        state[bit as usize / 64] ^= 1 << (bit % 64);
        value
    }

    /// Whether the result may differ between two states in which the bits of `open` are not known, and are the same in both.
    fn may_differ(&self, before: &[u64], after: &[u64], open: &[u64]) -> bool {
        if let Some(table) = self.table {
            // All subsets of the open bits.
            let open = open[0];
            let (before, after) = (before[0] & !open, after[0] & !open);
            let mut subset = 0_u64;
            loop {
                if (table >> (before | subset) ^ table >> (after | subset)) & 1 == 1 {
                    return true;
                }
                subset = subset.wrapping_sub(open) & open;
                if subset == 0 {
                    return false;
                }
            }
        }
        let of = |state: &[u64], leaf: LeafId| {
            let bit = self.bits[leaf.0 as usize];
            if get(open, bit) { Tri::Unknown } else { Tri::from(get(state, bit)) }
        };
        let was = self.expression.eval_tri(|leaf| of(before, leaf));
        was == Tri::Unknown || was != self.expression.eval_tri(|leaf| of(after, leaf))
    }

    /// The first leaf that the result in `state`, where it holds, could not do without; where it could do without any one of
    /// them, the first that is left when they are taken away from the last on for as long as it holds. Of a leaf that is taken
    /// away the complemented occurrences stay: within `b` the body of `(a - b) | b` is `b`.
    fn body(&self, state: &[u64]) -> Option<LeafId> {
        let within: Vec<u32> = (0..self.leaves.len() as u32).filter(|&bit| get(state, bit)).collect();
        let holds_without = |gone: &[u64]| {
            self.expression.eval_occurrences(|literal| {
                let bit = self.bits[literal.leaf.0 as usize];
                get(state, bit) && (literal.negated || !get(gone, bit))
            })
        };
        let mut gone = vec![0; state.len()];
        for &bit in &within {
            put(&mut gone, bit, true);
            if !holds_without(&gone) {
                return Some(self.leaves[bit as usize]);
            }
            put(&mut gone, bit, false);
        }
        for &bit in within.iter().rev() {
            put(&mut gone, bit, true);
            let holds = holds_without(&gone);
            put(&mut gone, bit, holds);
        }
        within.into_iter().find(|&bit| !get(&gone, bit)).map(|bit| self.leaves[bit as usize])
    }
}

/// The crossings of one ray, peel by peel.
#[derive(Debug, Clone, Default)]
pub struct Walk {
    pixel: usize,
    /// The next crossing of the pixel.
    next: usize,
    /// Memberships of the leaves that crossings tell of, before and after the current peel.
    before: State,
    after: State,
    /// The bits of the leaves that must be asked at this ray, and at this peel.
    asked: State,
    open: State,
}

/// A peel that may be a boundary.
#[derive(Debug, Clone, Copy)]
pub struct Peel<'t> {
    /// Depth less the tile's anchor.
    pub t: f32,
    /// The crossings that coincide there.
    members: &'t [Crossing],
}

impl Peel<'_> {
    /// The unit normal of one of its surfaces, either way; they need not be parallel.
    pub fn normal_in_world(&self) -> Vec3 {
        self.members[0].normal
    }
}

impl<'a> Crossed<'a> {
    /// Of `tile`, the crossings that `source` found for `rect` at `offset` within its pixels. Depths are relative to `anchor`.
    pub fn new(
        model: &'a Model,
        view: &'a View,
        source: &'a dyn CrossingSource,
        tile: CrossingTile,
        (rect, anchor): (PixelRect, f64),
        offset: DVec2,
    ) -> Self {
        let of_source = source.leaves();
        let mut present: Vec<LeafId> = Vec::new();
        for crossing in &tile.crossings {
            if present.last() != Some(&crossing.leaf) {
                present.push(crossing.leaf);
            }
        }
        present.extend(tile.begins.iter().map(|(leaf, _)| *leaf));
        present.sort_unstable();
        present.dedup();
        let is_sheet = |leaf: LeafId| model.fields[leaf.0 as usize].kind == LeafKind::Sheet;
        let constant = |leaf: LeafId| match of_source.binary_search(&leaf) {
            Ok(_) if present.binary_search(&leaf).is_ok() => Tri::Unknown,
            Ok(_) => Tri::False,
            // A sheet of surfels holds no point.
            Err(_) if is_sheet(leaf) => Tri::False,
            Err(_) => Tri::Unknown,
        };
        let left = match model.tree.fold(constant) {
            Folded::Open(expression) => Some(expression),
            Folded::Constant(_) => None,
        };
        let left = left.map(|expression| {
            let leaves = expression.leaves();
            let mut bits = vec![NO_BIT; model.fields.len()];
            leaves.iter().enumerate().for_each(|(bit, leaf)| bits[leaf.0 as usize] = bit as u32);
            let mut asked = vec![0; leaves.len().div_ceil(64)];
            for (bit, leaf) in leaves.iter().enumerate() {
                put(&mut asked, bit as u32, of_source.binary_search(leaf).is_err());
            }
            let value = |row: u64| u64::from(expression.eval(|leaf| row >> bits[leaf.0 as usize] & 1 == 1)) << row;
            let has_table = leaves.len() <= MOST_IN_TABLE;
            let table = has_table.then(|| (0..1 << leaves.len()).fold(0, |table, row| table | value(row)));
            Left { leaves, bits, table, asked, any_undecided: !tile.undecided.is_empty(), expression }
        });
        Self { model, view, source, tile, rect, offset, anchor, of_source, left }
    }

    /// Whether the ray of the pixel at column and row `place` of the tile is inside of `leaf` at depth `t` (less the anchor);
    /// `None` where the leaf itself must be asked.
    pub fn inside(&self, place: (u32, u32), leaf: LeafId, t: f32) -> Option<bool> {
        self.of_source.binary_search(&leaf).ok()?;
        self.tile.inside(self.pixel(place), leaf, (self.anchor + f64::from(t)) as f32)
    }

    /// Whether the ray at `place` may cross `leaf` nearer than `within` to depth `t` (less the anchor).
    pub(super) fn may_cross_within(&self, place: (u32, u32), leaf: LeafId, t: f32, within: f32) -> bool {
        let is_told = self.of_source.binary_search(&leaf).is_ok() && !self.tile.is_undecided(self.pixel(place), leaf);
        let near = |c: &Crossing| (f64::from(c.depth) - self.anchor - f64::from(t)).abs() <= f64::from(within);
        !is_told || self.tile.of(self.pixel(place)).iter().any(|c| c.leaf == leaf && near(c))
    }

    fn pixel(&self, (x, y): (u32, u32)) -> usize {
        (y * self.tile.width + x) as usize
    }

    /// Whether the rays of two tiles cross other leaves, or in another order, at the pixel at column and row `place`, nearer than
    /// `depth` (less the anchor).
    pub fn differs_at(&self, other: &Self, place: (u32, u32), depth: f32) -> bool {
        let depth = (self.anchor + f64::from(depth)) as f32;
        let [a, b] = [self, other].map(|crossed| {
            let nearer =
                crossed.tile.of(crossed.pixel(place)).iter().take_while(move |crossing| crossing.depth < depth);
            nearer.map(|crossing| crossing.leaf)
        });
        !a.eq(b)
    }

    /// Whether the ray at `place` crosses anything.
    pub fn is_crossed(&self, place: (u32, u32)) -> bool {
        self.left.is_some() && !self.tile.of(self.pixel(place)).is_empty()
    }

    /// Begins the walk along the ray at `place`.
    pub fn begin(&self, place: (u32, u32), walk: &mut Walk) {
        walk.pixel = self.pixel(place);
        walk.next = 0;
        let Some(left) = &self.left else { return };
        walk.after.clear();
        walk.after.resize(left.asked.len(), 0);
        walk.asked.clone_from(&left.asked);
        for (leaf, begins) in &self.tile.begins {
            let bit = left.bits[leaf.0 as usize];
            if bit != NO_BIT && begins.get(walk.pixel) && self.is_solid(*leaf) {
                put(&mut walk.after, bit, true);
            }
        }
        if left.any_undecided {
            for (leaf, undecided) in &self.tile.undecided {
                let bit = left.bits[leaf.0 as usize];
                if bit != NO_BIT && undecided.get(walk.pixel) {
                    put(&mut walk.asked, bit, true);
                }
            }
        }
    }

    fn is_solid(&self, leaf: LeafId) -> bool {
        self.model.fields[leaf.0 as usize].kind == LeafKind::Solid
    }

    /// Goes on to the next peel that may be a boundary, given what the leaves that must be asked may say.
    pub fn next(&self, walk: &mut Walk) -> Option<Peel<'_>> {
        let left = self.left.as_ref()?;
        let of_pixel = self.tile.of(walk.pixel);
        while let Some(first) = of_pixel.get(walk.next) {
            let count = of_pixel[walk.next..].iter().take_while(|crossing| crossing.depth == first.depth).count();
            let members = &of_pixel[walk.next..walk.next + count];
            walk.next += count;
            walk.before.clone_from(&walk.after);
            walk.open.clone_from(&walk.asked);
            let mut has_sheet = false;
            for crossing in members {
                let bit = left.bits[crossing.leaf.0 as usize];
                if bit == NO_BIT {
                    continue;
                }
                if !self.is_solid(crossing.leaf) {
                    has_sheet = true;
                    continue;
                }
                if get(&walk.asked, bit) {
                    // Undecided along the ray, but not at its own crossing.
                    put(&mut walk.open, bit, false);
                    put(&mut walk.before, bit, !crossing.enters);
                }
                put(&mut walk.after, bit, crossing.enters);
            }
            if has_sheet || left.may_differ(&walk.before, &walk.after, &walk.open) {
                return Some(Peel { t: (f64::from(first.depth) - self.anchor) as f32, members });
            }
        }
        None
    }

    /// What a peel of `walk` shows, where it is a boundary; `holds` tells on which side the peel's point is of a leaf that
    /// crossings do not tell of.
    pub fn boundary(&self, walk: &mut Walk, peel: &Peel<'_>, mut holds: impl FnMut(LeafId) -> bool) -> Option<Hit> {
        let left = self.left.as_ref()?;
        let Walk { pixel, before, after, open, .. } = walk;
        for bit in (0..left.leaves.len() as u32).filter(|&bit| get(open, bit)) {
            let inside = holds(left.leaves[bit as usize]);
            put(before, bit, inside);
            put(after, bit, inside);
        }
        let (was, is) = (left.eval(before), left.eval(after));
        let members = peel.members.iter().filter(|c| left.bits[c.leaf.0 as usize] != NO_BIT);
        let (owner, enters_result) = if was != is {
            let mut best = None;
            for crossing in members {
                let bit = left.bits[crossing.leaf.0 as usize];
                if get(before, bit) == get(after, bit) {
                    continue;
                }
                let is_alone = peel.members.len() == 1;
                let matters = is_alone || left.eval_turned(before, bit) == is || left.eval_turned(after, bit) != is;
                let rank = (!matters, get(after, bit) != is, crossing.leaf, crossing.what);
                if best.as_ref().is_none_or(|(least, _)| rank < *least) {
                    best = Some((rank, crossing));
                }
            }
            (best?.1, is)
        } else {
            // A sheet shows where the result would have it if it were a solid, and does not otherwise.
            let shows = |c: &&Crossing| {
                let bit = left.bits[c.leaf.0 as usize];
                (!was && left.eval_turned(before, bit)) || (!is && left.eval_turned(after, bit))
            };
            (members.filter(|c| !self.is_solid(c.leaf)).find(shows)?, true)
        };
        if !owner.is_drawn {
            return None;
        }
        let goes_with_result = was == is || get(after, left.bits[owner.leaf.0 as usize]) == is;
        let body = if goes_with_result { None } else { left.body(if is { after } else { before }) };
        let px = self.px(*pixel);
        let dir = self.view.camera.ray(px).dir.as_vec3();
        // Outward from the result: against the ray where it is entered, along it where it is left.
        let is_along = owner.normal.dot(dir) > 0.0;
        let normal = owner.normal * if is_along == enters_result { -1.0 } else { 1.0 };
        let (colour, opacity) = self.source.paint(owner, px);
        Some(Hit {
            t: peel.t,
            normal: self.view.camera.rotate_to_view(normal.as_dvec3()).as_vec3(),
            colour,
            opacity,
            leaf: owner.leaf.0,
            body: body.unwrap_or(owner.leaf).0,
            facing: if enters_result { Facing::Front } else { Facing::Back },
        })
    }

    /// Adds the crossings of a peel with whose surfaces those of a scan coincide; its surfels have at most this `radius`, world units.
    pub(super) fn tie(&self, walk: &Walk, peel: &Peel<'_>, radius: f32, out: &mut Vec<Tied>) {
        let Some(left) = &self.left else { return };
        let px = self.px(walk.pixel);
        let dir = self.view.camera.ray(px).dir;
        let dir_in_view = self.view.camera.rotate_to_view(dir).as_vec3();
        for crossing in peel.members.iter().filter(|c| left.bits[c.leaf.0 as usize] != NO_BIT) {
            let (colour, opacity) = self.source.paint(crossing, px);
            // Rays enter against the outward normal.
            let is_outward = (crossing.normal.as_dvec3().dot(dir) < 0.0) == crossing.enters;
            let normal_in_world = crossing.normal * if is_outward { 1.0 } else { -1.0 };
            let normal = self.view.camera.rotate_to_view(normal_in_world.as_dvec3()).as_vec3();
            out.push(Tied {
                t: peel.t,
                reach: tied::reach(radius, normal, dir_in_view),
                radius,
                leaf: crossing.leaf,
                enters: crossing.enters,
                normal,
                colour,
                opacity,
                is_drawn: crossing.is_drawn,
            });
        }
    }

    /// Where on the picture the ray of a pixel goes.
    fn px(&self, pixel: usize) -> DVec2 {
        let (x, y) = (pixel as u32 % self.tile.width, pixel as u32 / self.tile.width);
        DVec2::new(f64::from(self.rect.x0 + x), f64::from(self.rect.y0 + y)) + self.offset
    }

    /// The point of a peel, world space.
    pub fn point(&self, walk: &Walk, peel: &Peel<'_>) -> DVec3 {
        self.view.camera.ray(self.px(walk.pixel)).at(self.anchor + f64::from(peel.t))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::splat::test_scenes::tree;

    fn left(text: &str, asked: u64, has_table: bool) -> Left {
        let expression = tree(text).positive();
        let leaves = expression.leaves();
        let bits: Vec<u32> = (0..leaves.len() as u32).collect();
        let value = |row: u64| u64::from(expression.eval(|leaf| row >> leaf.0 & 1 == 1)) << row;
        let table = has_table.then(|| (0..1 << leaves.len()).fold(0, |table, row| table | value(row)));
        Left { expression, leaves, bits, table, asked: vec![asked], any_undecided: false }
    }

    /// The first leaf that a product of the positive form which holds there needs.
    #[test]
    fn material_is_that_of_a_leaf_that_the_result_needs() {
        for (text, state, body) in [
            ("a & b", 0b11, Some(0)),
            ("a | b", 0b11, Some(0)),
            ("a - b", 0b01, Some(0)),
            ("(a - b) | c", 0b101, Some(0)),
            ("(a - b) | c", 0b111, Some(2)),
            // Two parts without a gap.
            ("(a - b) | b", 0b01, Some(0)),
            ("(a - b) | b", 0b11, Some(1)),
            ("a | (b - a)", 0b11, Some(0)),
            // What is left of nothing.
            ("!a | b", 0b00, None),
            ("!a | b", 0b10, None),
        ] {
            assert_eq!(left(text, 0, true).body(&[state]), body.map(LeafId), "{text} {state:b}");
        }
    }

    /// Both ways to evaluate agree with the expression itself, for every state, and with trying all that is not known.
    #[test]
    fn tables_and_expressions_say_the_same() {
        for text in ["a - b", "(a - b) | (b - a)", "a & (b | c) - d", "(a | b) & (c | !d)"] {
            let asked = 0b101;
            let (table, plain) = (left(text, asked, true), left(text, asked, false));
            let states = 1_u64 << table.leaves.len();
            for (before, after) in (0..states).flat_map(|b| (0..states).map(move |a| (b, a))) {
                let expected = table.expression.eval(|leaf| before >> leaf.0 & 1 == 1);
                assert_eq!([table.eval(&[before]), plain.eval(&[before])], [expected; 2]);
                let open = asked & (states - 1);
                let after = after & !open | before & open;
                let differs = (0..states)
                    .filter(|s| s & !open == 0)
                    .any(|s| plain.eval(&[before & !open | s]) != plain.eval(&[after & !open | s]));
                assert_eq!(table.may_differ(&[before], &[after], &[open]), differs, "{text} {before:b} {after:b}");
                // Kleene's logic may not see that a leaf that occurs twice is the same one.
                assert!(plain.may_differ(&[before], &[after], &[open]) || !differs);
                if expected {
                    assert_eq!(table.body(&[before]), plain.body(&[before]));
                }
            }
        }
    }
}
