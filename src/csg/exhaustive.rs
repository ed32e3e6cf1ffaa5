//! Every form of an expression against every other, on all trees of up to five leaves.
//!
//! The truth is an expression type of the tests' own, evaluated by plain recursion for all assignments at once.

use std::rc::Rc;

use fearless_simd::prelude::*;
use fearless_simd::{Simd, u32x8};

use super::blist::Match;
use super::expression::parse;
use super::positive::{Folded, PositiveNode};
use super::residual::{Rule, TABLE_LEAVES};
use super::*;

/// Leaves of the largest trees that are enumerated.
const MOST_LEAVES: u32 = 5;

/// Truth tables: bit `j` is for the assignment in which leaf `i` is in just where bit `i` of `j` is set.
const LEAF_TABLES: [u32; MOST_LEAVES as usize] = [0xAAAA_AAAA, 0xCCCC_CCCC, 0xF0F0_F0F0, 0xFF00_FF00, 0xFFFF_0000];

#[derive(Debug)]
enum Ast {
    Leaf(u32),
    Not(Rc<Ast>),
    And(Rc<Ast>, Rc<Ast>),
    Or(Rc<Ast>, Rc<Ast>),
    Minus(Rc<Ast>, Rc<Ast>),
}

impl Ast {
    /// The truth table, where leaf `i` has the table `leaves[i]`.
    fn truth(&self, leaves: &[u32]) -> u32 {
        match self {
            Self::Leaf(i) => leaves[*i as usize],
            Self::Not(a) => !a.truth(leaves),
            Self::And(a, b) => a.truth(leaves) & b.truth(leaves),
            Self::Or(a, b) => a.truth(leaves) | b.truth(leaves),
            Self::Minus(a, b) => a.truth(leaves) & !b.truth(leaves),
        }
    }

    /// The truth table without the leaves that `dropped` names; `None` if nothing is left.
    fn truth_without(&self, dropped: &dyn Fn(u32) -> bool) -> Option<u32> {
        let both = |a: &Rc<Self>, b: &Rc<Self>, operator: fn(u32, u32) -> u32| match (
            a.truth_without(dropped),
            b.truth_without(dropped),
        ) {
            (Some(a), Some(b)) => Some(operator(a, b)),
            (one, other) => one.or(other),
        };
        match self {
            Self::Leaf(i) => (!dropped(*i)).then(|| LEAF_TABLES[*i as usize]),
            Self::Not(a) => a.truth_without(dropped).map(|a| !a),
            Self::And(a, b) => both(a, b, |a, b| a & b),
            Self::Or(a, b) => both(a, b, |a, b| a | b),
            Self::Minus(..) => unreachable!("only asked of positive trees"),
        }
    }

    fn build(&self, builder: &mut TreeBuilder) {
        match self {
            Self::Leaf(i) => builder.leaf(LeafId(*i)),
            Self::Not(a) => {
                a.build(builder);
                builder.not()
            }
            Self::And(a, b) | Self::Or(a, b) | Self::Minus(a, b) => {
                a.build(builder);
                b.build(builder);
                match self {
                    Self::And(..) => builder.and(),
                    Self::Or(..) => builder.or(),
                    _ => builder.minus(),
                }
            }
        };
    }

    fn tree(&self) -> Tree {
        let mut builder = TreeBuilder::default();
        self.build(&mut builder);
        builder.finish().unwrap()
    }
}

/// Which trees to enumerate.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// All three operators, each node as it is or complemented.
    All,
    /// Unions and intersections, leaves as they are or complemented: all positive forms.
    Positive,
}

/// All trees with the leaves `first..first + count` from left to right.
fn trees(kind: Kind, first: u32, count: u32) -> Vec<Rc<Ast>> {
    let mut plain = Vec::new();
    if count == 1 {
        plain.push(Rc::new(Ast::Leaf(first)));
    }
    for split in 1..count {
        let rights = trees(kind, first + split, count - split);
        for a in trees(kind, first, split) {
            for b in &rights {
                plain.push(Rc::new(Ast::And(a.clone(), b.clone())));
                plain.push(Rc::new(Ast::Or(a.clone(), b.clone())));
                if kind == Kind::All {
                    plain.push(Rc::new(Ast::Minus(a.clone(), b.clone())));
                }
            }
        }
    }
    if kind == Kind::All || count == 1 {
        let complements: Vec<_> = plain.iter().map(|ast| Rc::new(Ast::Not(ast.clone()))).collect();
        plain.extend(complements);
    }
    plain
}

fn is_in(assignment: u32, leaf: LeafId) -> bool {
    assignment >> leaf.0 & 1 == 1
}

/// The truth table of an evaluation.
fn table(leaf_count: u32, eval: impl Fn(u32) -> bool) -> u32 {
    (0..1 << leaf_count).fold(0, |table, assignment| table | u32::from(eval(assignment)) << assignment)
}

/// The lowest bits of a truth table: those of the assignments of so many leaves.
fn assignments(leaf_count: u32) -> u32 {
    ((1u64 << (1 << leaf_count)) - 1) as u32
}

/// A statement of every leaf in three values: the digits of `code` to base three.
fn digit(code: u32, leaf: u32) -> u32 {
    code / 3u32.pow(leaf) % 3
}

pub(super) fn letter(id: LeafId) -> String {
    char::from(b'a' + id.0 as u8).to_string()
}

pub(super) fn leaf_of_letter(name: &str) -> Option<LeafId> {
    Some(LeafId(u32::from(name.as_bytes()[0] - b'a')))
}

/// A generator of reproducible numbers (Numerical Recipes' constants); the high bits are the good ones.
struct Random(u64);

impl Random {
    fn below(&mut self, bound: u32) -> u32 {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        ((self.0 >> 33) % u64::from(bound)) as u32
    }
}

/// Holds all that walks forward, for one point or many, in two values or three, against the truth table; in every order of
/// operands.
fn check_walks(positive: &Positive, truth: u32, leaf_count: u32) {
    let ordered = [First::Deeper, First::Busier].map(|first| positive.left_heavy(first));
    let mut scratch = Vec::new();
    for positive in [positive, &ordered[0], &ordered[1]] {
        let list = StatusList::from(&positive.blist());
        assert_eq!(list.modules().len(), positive.literals().count());
        let all = u64::from(assignments(leaf_count));
        let points = list.walk(all, &mut scratch, |leaf, asked| {
            assert_eq!(asked & !all, 0);
            Points::decided(u64::from(LEAF_TABLES[leaf.0 as usize]))
        });
        assert_eq!((points.may_be_in, points.may_be_out), (u64::from(truth), all & !u64::from(truth)));
        // In three values, up to 64 of all statements at a time.
        let codes: Vec<u32> = (0..3_u32.pow(leaf_count)).collect();
        for codes in codes.chunks(64) {
            let status = |code: u32, leaf: LeafId| [Tri::False, Tri::True, Tri::Unknown][digit(code, leaf.0) as usize];
            let asked = u64::MAX >> (64 - codes.len());
            let points = list.walk(asked, &mut scratch, |leaf, _| {
                let bits =
                    |value: Tri| (0..codes.len()).map(|i| u64::from(status(codes[i], leaf) != value) << i).sum::<u64>();
                Points { may_be_in: bits(Tri::False), may_be_out: bits(Tri::True) }
            });
            for (i, &code) in codes.iter().enumerate() {
                assert_eq!(points.get(i as u32), positive.eval_tri(|leaf| status(code, leaf)));
            }
        }
        // One leaf toggled at a time, through all assignments.
        let mut walk = Walk::from(positive);
        let gray = |i: u32| i ^ (i >> 1);
        assert_eq!(walk.value(), truth & 1 == 1);
        for i in 1..1 << leaf_count {
            let toggled = (gray(i) ^ gray(i - 1)).trailing_zeros();
            assert_eq!(walk.toggle(LeafId(toggled)), truth >> gray(i) & 1 == 1);
        }
    }
}

#[test]
fn the_least_left_heavy_trees_that_need_so_many_ids() {
    // All orders of unions and intersections whose left operand is at least as deep as the right one, with their depths.
    const MOST: u32 = 9;
    let mut by_count: Vec<Vec<(Rc<Ast>, u32)>> = vec![Vec::new(), vec![(Rc::new(Ast::Leaf(0)), 0)]];
    let (mut least, mut least_apart) = (vec![u32::MAX; 8], vec![u32::MAX; 8]);
    for count in 1..=MOST {
        if count > 1 {
            let mut trees = Vec::new();
            for split in 1..count {
                for (a, a_depth) in &by_count[split as usize] {
                    for (b, b_depth) in by_count[(count - split) as usize].iter().filter(|(_, depth)| depth <= a_depth)
                    {
                        let depth = a_depth.max(b_depth) + 1;
                        trees.push((Rc::new(Ast::And(a.clone(), b.clone())), depth));
                        trees.push((Rc::new(Ast::Or(a.clone(), b.clone())), depth));
                    }
                }
            }
            by_count.push(trees);
        }
        for (ast, depth) in &by_count[count as usize] {
            let positive = ast.tree().positive();
            assert_eq!(positive.depth(), *depth);
            let list = StatusList::from(&positive.blist());
            for (ids, least) in [(list.id_count(), &mut least), (list.id_count_with_ends_apart(), &mut least_apart)] {
                least[ids as usize] = least[ids as usize].min(count);
            }
        }
    }
    // (x − 1)², and for y beside the ends' two y² − 2y + 3; the formulas begin where a path has a step to the right.
    assert_eq!(least[2..=4], [1, 4, 9]);
    assert_eq!(least_apart[3..=5], [1, 3, 6]);
    assert!(least[5..].iter().chain(&least_apart[6..]).all(|&count| count == u32::MAX));
}

#[test]
fn all_forms_agree_on_all_trees() {
    for leaf_count in 1..=MOST_LEAVES {
        for ast in trees(Kind::All, 0, leaf_count) {
            let truth = ast.truth(&LEAF_TABLES) & assignments(leaf_count);
            let tree = ast.tree();
            let positive = tree.positive();
            let blist = positive.blist();
            assert_eq!(table(leaf_count, |j| tree.eval(|leaf| is_in(j, leaf))), truth, "tree {ast:?}");
            assert_eq!(table(leaf_count, |j| positive.eval(|leaf| is_in(j, leaf))), truth, "positive {ast:?}");
            assert_eq!(table(leaf_count, |j| blist.eval(|leaf| is_in(j, leaf))), truth, "blist {ast:?}");
            assert!(positive.literals().map(|literal| literal.leaf.0).eq(0..leaf_count), "leaves keep their order");
            if leaf_count < MOST_LEAVES {
                check_walks(&positive, truth, leaf_count);
            }
        }
    }
}

#[test]
fn all_forms_agree_where_leaves_repeat() {
    const NAMES: u32 = 3;
    const SHARES: u32 = 61;
    for (i, ast) in trees(Kind::Positive, 0, MOST_LEAVES).iter().enumerate() {
        // Each tree with its share of all the ways to give five leaves three names.
        for code in (i as u32 % SHARES..NAMES.pow(MOST_LEAVES)).step_by(SHARES as usize) {
            let renamed: Vec<_> = (0..MOST_LEAVES).map(|leaf| LEAF_TABLES[digit(code, leaf) as usize]).collect();
            let truth = ast.truth(&renamed) & assignments(NAMES);
            let tree = ast.tree().map_leaves(|leaf| LeafId(digit(code, leaf.0)));
            let positive = tree.positive();
            assert_eq!(table(NAMES, |j| tree.eval(|leaf| is_in(j, leaf))), truth);
            assert_eq!(table(NAMES, |j| positive.eval(|leaf| is_in(j, leaf))), truth);
            assert_eq!(table(NAMES, |j| positive.blist().eval(|leaf| is_in(j, leaf))), truth);
            check_walks(&positive, truth, NAMES);
            for own in 0..NAMES {
                for statuses in (0..3u32.pow(NAMES)).filter(|&code| digit(code, own) == 0) {
                    check_residual(&positive, truth, NAMES, own, statuses);
                }
            }
        }
    }
}

#[test]
fn printing_and_reading_back_gives_the_same_tree() {
    for leaf_count in 1..MOST_LEAVES {
        for ast in trees(Kind::All, 0, leaf_count) {
            let tree = ast.tree();
            let text = tree.display(letter).to_string();
            assert_eq!(parse(&text, &mut leaf_of_letter).as_ref(), Ok(&tree), "{text}");
            // As few parentheses as possible: without any pair of them the text means something else.
            for (opening, _) in text.match_indices('(') {
                let mut depth = 0;
                let closing = text[opening..].find(|c| {
                    depth += i32::from(c == '(') - i32::from(c == ')');
                    depth == 0
                });
                let closing = opening + closing.unwrap();
                let shorter = [&text[..opening], &text[opening + 1..closing], &text[closing + 1..]].concat();
                assert_ne!(parse(&shorter, &mut leaf_of_letter).as_ref(), Ok(&tree), "{text} as {shorter}");
            }
        }
    }
}

/// A state's words as eight equal lanes through [`Shrunk::eval_lanes`], which must agree in all.
fn in_lanes(shrunk: &Shrunk, state: &[u32]) -> bool {
    fn lanes<S: Simd>(simd: S, shrunk: &Shrunk, state: &[u32]) -> [u32; 8] {
        let state: Vec<_> = state.iter().map(|&word| u32x8::splat(simd, word)).collect();
        let mut scratch = vec![u32x8::splat(simd, 7); shrunk.node_count()];
        shrunk.eval_lanes(simd, &state, &mut scratch).into()
    }
    let lanes = fearless_simd::dispatch!(fearless_simd::Level::new(), simd => lanes(simd, shrunk, state));
    assert!(lanes == [0; 8] || lanes == [u32::MAX; 8]);
    lanes[0] != 0
}

/// Holds everything that can be made of `flat` where only the leaves of `present` may be in against the truth, in a walk
/// that toggles one leaf at a time through all assignments.
fn check_shrunk(flat: &Flat, shrunk: &mut Shrunk, present: &[LeafId], tree: &Tree) {
    let truth = |inside: &dyn Fn(LeafId) -> bool| tree.eval(inside);
    let kept = shrunk.keep(flat, present);
    let all = 1_u32 << present.len();
    let gray = |i: u32| i ^ (i >> 1);
    let is_present_and_in =
        |code: u32, leaf| present.iter().position(|&p| p == leaf).is_some_and(|i| code >> i & 1 == 1);
    let Kept::Open = kept else {
        let constant = Kept::Constant(truth(&|_| false));
        assert!((0..all).all(|code| Kept::Constant(truth(&|leaf| is_present_and_in(code, leaf))) == constant));
        assert_eq!(kept, constant);
        return;
    };
    assert!(shrunk.slots().is_sorted_by(|a, b| a < b));
    let (mut counters, mut scratch) = (Counters::default(), Vec::new());
    counters.reset(shrunk);
    let steps = shrunk.steps();
    for i in 0..all {
        if i > 0 {
            let toggled = present[(gray(i) ^ gray(i - 1)).trailing_zeros() as usize];
            if let Ok(slot) = shrunk.slots().binary_search(&toggled) {
                counters.toggle(shrunk, slot);
                assert_eq!(counters.is_inside(slot), is_present_and_in(gray(i), toggled));
            }
        }
        let expected = truth(&|leaf| is_present_and_in(gray(i), leaf));
        let mut state = vec![0; shrunk.words()];
        for (slot, leaf) in shrunk.slots().iter().enumerate() {
            state[slot / 32] |= u32::from(is_present_and_in(gray(i), *leaf)) << (slot % 32);
        }
        assert_eq!(shrunk.eval(&state, &mut scratch), expected);
        assert_eq!(in_lanes(shrunk, &state), expected);
        assert_eq!(super::steps::walk(&steps, &state), expected);
        assert_eq!(counters.value(shrunk), expected);
    }
}

#[test]
fn flat_forms_are_the_tree_for_any_leaves_present_and_any_order_of_toggles() {
    let mut shrunk = Shrunk::default();
    for leaf_count in 1..=MOST_LEAVES {
        for ast in trees(Kind::Positive, 0, leaf_count) {
            let tree = ast.tree();
            let flat = tree.positive().flat();
            for chosen in 0..1_u32 << leaf_count {
                let present: Vec<_> = (0..leaf_count).filter(|i| chosen >> i & 1 == 1).map(LeafId).collect();
                check_shrunk(&flat, &mut shrunk, &present, &tree);
            }
        }
    }
}

#[test]
fn flat_forms_of_repeated_leaves_and_of_many_words_are_the_tree() {
    let mut random = Random(1999);
    let mut shrunk = Shrunk::default();
    for round in 0..300 {
        // Eight leaves named up to four times each; every third tree spreads them over several words.
        let (names, apart) = (8, if round % 3 == 0 { 9 } else { 1 });
        let mut builder = TreeBuilder::default();
        let places = 2 + random.below(30);
        for _ in 0..places {
            builder.leaf(LeafId(random.below(names) * apart));
            if random.below(3) == 0 {
                builder.not();
            }
        }
        for _ in 1..places {
            match random.below(3) {
                0 => builder.and(),
                1 => builder.or(),
                _ => builder.minus(),
            };
        }
        let tree = builder.finish().unwrap();
        let flat = tree.positive().flat();
        let mut present = tree.leaves();
        assert_eq!(flat.leaves(), present);
        check_shrunk(&flat, &mut shrunk, &present, &tree);
        present.retain(|_| random.below(2) == 0);
        check_shrunk(&flat, &mut shrunk, &present, &tree);
    }
    // More than a word of slots, of which two matter at a time.
    let mut builder = TreeBuilder::default();
    builder.leaf(LeafId(0));
    for id in 1..100 {
        builder.leaf(LeafId(id)).minus();
    }
    let tree = builder.finish().unwrap();
    let flat = tree.positive().flat();
    let all = tree.leaves();
    assert_eq!(shrunk.keep(&flat, &all), Kept::Open);
    assert_eq!((shrunk.words(), shrunk.node_count()), (4, 1));
    for cut in 1..100_usize {
        let mut state = vec![1, 0, 0, 0];
        assert!(shrunk.eval(&state, &mut Vec::new()) && in_lanes(&shrunk, &state));
        state[cut / 32] |= 1 << (cut % 32);
        assert!(!shrunk.eval(&state, &mut Vec::new()) && !in_lanes(&shrunk, &state));
    }
}

#[test]
fn kleene_and_folding_leave_what_the_unknown_leaves_decide() {
    for leaf_count in 1..=MOST_LEAVES {
        for ast in trees(Kind::Positive, 0, leaf_count) {
            let truth = ast.truth(&LEAF_TABLES);
            let positive = ast.tree().positive();
            check_walks(&positive, truth & assignments(leaf_count), leaf_count);
            for code in 0..3u32.pow(leaf_count) {
                let status = |leaf: LeafId| [Tri::False, Tri::True, Tri::Unknown][digit(code, leaf.0) as usize];
                // The assignments that the statuses allow.
                let allowed = (0..leaf_count).fold(assignments(leaf_count), |allowed, leaf| match digit(code, leaf) {
                    0 => allowed & !LEAF_TABLES[leaf as usize],
                    1 => allowed & LEAF_TABLES[leaf as usize],
                    _ => allowed,
                });
                // No leaf occurs twice, so Kleene's logic misses nothing.
                let expected = match (truth & allowed == allowed, truth & allowed == 0) {
                    (true, _) => Tri::True,
                    (_, true) => Tri::False,
                    _ => Tri::Unknown,
                };
                assert_eq!(positive.eval_tri(status), expected);
                match positive.fold(status) {
                    Folded::Constant(value) => assert_eq!(Tri::from(value), expected),
                    Folded::Open(open) => {
                        assert_eq!(expected, Tri::Unknown);
                        assert!(open.leaves().iter().all(|&leaf| status(leaf) == Tri::Unknown));
                        let folded = table(leaf_count, |j| open.eval(|leaf| is_in(j, leaf)));
                        assert_eq!((folded ^ truth) & allowed, 0);
                    }
                }
            }
        }
    }
}

/// Holds a residual against the truth table of its tree, in all assignments that the statuses allow. Returns it, and what
/// the statuses alone tell.
fn check_residual(
    positive: &Positive,
    truth: u32,
    leaf_count: u32,
    own: u32,
    statuses: u32,
) -> (Residual, Option<Residual>) {
    let status = |leaf: LeafId| {
        assert_ne!(leaf.0, own, "a surfel has no status in its own leaf");
        [Membership::Out, Membership::In, Membership::Near][digit(statuses, leaf.0) as usize]
    };
    let allowed =
        (0..leaf_count).filter(|&leaf| leaf != own).fold(assignments(leaf_count), |allowed, leaf| {
            match digit(statuses, leaf) {
                0 => allowed & !LEAF_TABLES[leaf as usize],
                1 => allowed & LEAF_TABLES[leaf as usize],
                _ => allowed,
            }
        });
    // Brought to the assignments outside the own leaf, which differ from those inside it by its bit.
    let outside = allowed & !LEAF_TABLES[own as usize];
    let entered = truth >> (1 << own);
    let (rises, falls) = (entered & !truth & outside, truth & !entered & outside);

    let residual = Residual::of(positive, LeafId(own), status);
    match &residual {
        Residual::Off => assert_eq!(rises | falls, 0),
        Residual::On(Crossing::Rises) => assert_eq!(rises, outside),
        Residual::On(Crossing::Falls) => assert_eq!(falls, outside),
        Residual::Edge(edge) => {
            assert!(rises | falls != 0 && rises != outside && falls != outside);
            assert!(edge.near.is_sorted_by(|a, b| a < b));
            for leaf in (0..leaf_count).filter(|&leaf| leaf != own) {
                // Exactly the near leaves on which one of the two functions depends.
                let pairs = outside & !LEAF_TABLES[leaf as usize];
                let changes = |function: u32| (function ^ function >> (1 << leaf)) & pairs != 0;
                let depends = digit(statuses, leaf) == 2 && (changes(rises) || changes(falls));
                assert_eq!(edge.near.contains(&LeafId(leaf)), depends);
            }
            let used = 1u64 << (1 << edge.near.len());
            assert!(matches!(edge.rule, Rule::Table { rises, falls } if rises & falls == 0 && (rises | falls) < used));
        }
    }
    for assignment in (0..1 << leaf_count).filter(|&assignment| outside >> assignment & 1 == 1) {
        let expected = Crossing::between(truth >> assignment & 1 == 1, entered >> assignment & 1 == 1);
        match &residual {
            Residual::Off => assert_eq!(None, expected),
            Residual::On(crossing) => assert_eq!(Some(*crossing), expected),
            Residual::Edge(edge) => assert_eq!(edge.crossing(|i| is_in(assignment, edge.near[i])), expected),
        }
    }
    let decided = Residual::decided(positive, LeafId(own), status);
    if let Some(decided) = &decided {
        assert_eq!(*decided, residual);
    }
    (residual, decided)
}

#[test]
fn residuals_are_the_tree() {
    for leaf_count in 1..=MOST_LEAVES {
        for ast in trees(Kind::Positive, 0, leaf_count) {
            let truth = ast.truth(&LEAF_TABLES);
            let positive = ast.tree().positive();
            for own in 0..leaf_count {
                // The own leaf's digit means nothing: leave it zero.
                for statuses in (0..3u32.pow(leaf_count)).filter(|&code| digit(code, own) == 0) {
                    let (residual, decided) = check_residual(&positive, truth, leaf_count, own, statuses);
                    let edge = matches!(residual, Residual::Edge(_));
                    assert_eq!(decided.is_some(), !edge, "without repeated leaves, statuses alone tell");
                }
            }
        }
    }
}

#[test]
fn residuals_of_many_leaves_are_the_tree() {
    let mut random = Random(2004);
    let (mut tables, mut walks) = (0, 0);
    for round in 0..400u32 {
        // Up to eleven leaves in up to sixteen places: all are near but one in six.
        let names = 7 + round % 5;
        let mut builder = TreeBuilder::default();
        for place in 0..names + round % 6 {
            builder.leaf(LeafId(if place < names { place } else { random.below(names) }));
            if random.below(4) == 0 {
                builder.not();
            }
        }
        for _ in 1..names + round % 6 {
            match random.below(3) {
                0 => builder.and(),
                1 => builder.or(),
                _ => builder.minus(),
            };
        }
        let tree = builder.finish().unwrap();
        let positive = tree.positive();
        let own = LeafId(random.below(names));
        let decided_leaf = LeafId(if round % 6 == 0 { (own.0 + 1) % names } else { names });
        let status = |leaf| if leaf == decided_leaf { Membership::In } else { Membership::Near };
        let residual = Residual::of(&positive, own, status);
        for assignment in 0..1u32 << names {
            if is_in(assignment, own) || decided_leaf.0 < names && !is_in(assignment, decided_leaf) {
                continue;
            }
            let without = tree.eval(|leaf| is_in(assignment, leaf));
            let with = tree.eval(|leaf| leaf == own || is_in(assignment, leaf));
            let expected = Crossing::between(without, with);
            match &residual {
                Residual::Off => assert_eq!(None, expected),
                Residual::On(crossing) => assert_eq!(Some(*crossing), expected),
                Residual::Edge(edge) => assert_eq!(edge.crossing(|i| is_in(assignment, edge.near[i])), expected),
            }
        }
        if let Residual::Edge(edge) = &residual {
            match edge.rule {
                Rule::Table { .. } => tables += 1,
                Rule::Walk { .. } => {
                    walks += 1;
                    assert!(edge.near.len() > TABLE_LEAVES);
                }
            }
        }
    }
    assert!(walks > 100 && walks + tables > 150, "the trees must exercise walks: {walks} walks, {tables} tables");
}

#[test]
fn crossings_ask_for_no_leaf_twice_and_for_none_that_does_not_matter() {
    let positive = parse("a & (b | c & (d | e & (f | g & (h | i))))", &mut leaf_of_letter).unwrap().positive();
    for far in [LeafId(9), LeafId(8), LeafId(7)] {
        let status = |leaf| if leaf >= far { Membership::Out } else { Membership::Near };
        let Residual::Edge(edge) = Residual::of(&positive, LeafId(0), status) else { panic!("an edge") };
        let mut asked = Vec::new();
        assert_eq!(
            edge.crossing(|i| {
                asked.push(edge.near[i]);
                edge.near[i] == LeafId(1)
            }),
            Some(Crossing::Rises)
        );
        assert!(asked.len() <= edge.near.len());
        if matches!(edge.rule, Rule::Walk { .. }) {
            assert_eq!(asked, [LeafId(1)], "inside b, nothing else matters");
        }
    }
}

#[test]
fn the_papers_two_functions_agree_and_unknown_drops_a_leaf() {
    const STATES: [Tri; 3] = [Tri::False, Tri::True, Tri::Unknown];
    for leaf_count in 1..=MOST_LEAVES {
        for ast in trees(Kind::Positive, 0, leaf_count) {
            let paper = PaperTree::from(&ast.tree().positive());
            for own in 0..leaf_count {
                for code in (0..3u32.pow(leaf_count)).filter(|&code| digit(code, own) == 0) {
                    let inside = |occurrence: usize| {
                        assert_ne!(occurrence as u32, own);
                        STATES[digit(code, occurrence as u32) as usize]
                    };
                    let clipped = paper.clipped(own as usize, inside);
                    assert_eq!(clipped, paper.clipped2(own as usize, inside));
                    // The truth: drop the unknown leaves, and see whether the rest changes where the own leaf does.
                    let rest = ast.truth_without(&|leaf| leaf != own && digit(code, leaf) == 2).unwrap();
                    let outside =
                        (0..leaf_count).filter(|&leaf| digit(code, leaf) == 1).map(|leaf| 1 << leaf).sum::<u32>();
                    let crossing = Crossing::between(rest >> outside & 1 == 1, rest >> (outside | 1 << own) & 1 == 1);
                    assert_eq!(crossing, (!clipped).then(|| paper.crossing(own as usize)));
                }
            }
        }
    }
}

/// Blister's own conversion (§3.2), climbing from each leaf, on `(Y ∪ out) ∩ in`.
fn matches_by_climbing(positive: &Positive) -> Vec<Match> {
    let mut nodes = positive.nodes().to_vec();
    let literal_count = positive.literals().count();
    let nowhere = Literal { leaf: LeafId(u32::MAX), negated: false };
    let y = nodes.len() as u32 - 1;
    nodes.push(PositiveNode::Literal(nowhere)); // out
    nodes.push(PositiveNode::Or(y, y + 1));
    nodes.push(PositiveNode::Literal(nowhere)); // in
    nodes.push(PositiveNode::And(y + 2, y + 3));

    let operands = |node: usize| match nodes[node] {
        PositiveNode::And(a, b) | PositiveNode::Or(a, b) => Some((a as usize, b as usize)),
        PositiveNode::Literal(_) => None,
    };
    let parent =
        |node: usize| (0..nodes.len()).find(|&up| operands(up).is_some_and(|(a, b)| a == node || b == node)).unwrap();
    let is_left = |node: usize| operands(parent(node)).unwrap().0 == node;
    let is_and = |node: usize| matches!(nodes[node], PositiveNode::And(..));
    let leaves: Vec<_> = (0..nodes.len()).filter(|&node| operands(node).is_none()).collect();
    let climb = |leaf: usize| {
        let mut q = leaf;
        while !is_left(q) {
            q = parent(q);
        }
        let operator = is_and(parent(q));
        q = parent(q);
        while !is_left(q) || is_and(parent(q)) == operator {
            q = parent(q);
        }
        q = operands(parent(q)).unwrap().1;
        while let Some((a, _)) = operands(q) {
            q = a;
        }
        let name = leaves.iter().position(|&other| other == q).unwrap();
        let to = match name.checked_sub(literal_count) {
            None => Jump::Entry(name as u32),
            Some(0) => Jump::Out,
            Some(_) => Jump::In,
        };
        Match { to, flip: !operator }
    };
    leaves[..literal_count].iter().map(|&leaf| climb(leaf)).collect()
}

#[test]
fn matches_are_those_that_the_paper_climbs_to() {
    for leaf_count in 1..=MOST_LEAVES {
        for ast in trees(Kind::Positive, 0, leaf_count).iter().step_by(if leaf_count == MOST_LEAVES { 5 } else { 1 }) {
            let positive = ast.tree().positive();
            let blist = positive.blist();
            let ours: Vec<_> = (0..leaf_count as usize).map(|position| blist.match_of(position).unwrap()).collect();
            assert_eq!(ours, matches_by_climbing(&positive), "{ast:?}");
        }
    }
}

#[test]
fn laws() {
    let read = |text: &str| parse(text, &mut leaf_of_letter).unwrap();
    let equal = [
        ("!(a | b)", "!a & !b"),
        ("!(a & b)", "!a | !b"),
        ("a - b", "a & !b"),
        ("!(a - b)", "!a | b"),
        ("!!a", "a"),
        ("a & a", "a"),
        ("a | a", "a"),
        ("a - a", "b - b"),
        ("a | b & c", "(a | b) & (a | c)"),
        ("a - b - c", "a - (b | c)"),
        ("a | b - c", "(a | b) - c"),
    ];
    for (one, other) in equal {
        let of = |text| table(3, |j| read(text).eval(|leaf| is_in(j, leaf)));
        assert_eq!(of(one), of(other), "{one} = {other}");
    }
    assert_eq!(table(1, |j| read("a - a").eval(|leaf| is_in(j, leaf))), 0, "empty");

    // A - A bounds nothing, A ∩ A what A bounds; in the symmetric difference A faces both ways.
    let residual = |text, status: Membership| Residual::of(&read(text).positive(), LeafId(0), |_| status);
    for status in [Membership::In, Membership::Out, Membership::Near] {
        assert_eq!(residual("a - a", status), Residual::Off);
        assert_eq!(residual("a & a", status), Residual::On(Crossing::Rises));
        assert_eq!(residual("a & b | (a - b)", status), Residual::On(Crossing::Rises));
        assert_eq!(residual("b", status), Residual::Off);
    }
    let difference = "(a - b) | (b - a)";
    assert_eq!(residual(difference, Membership::Out), Residual::On(Crossing::Rises));
    assert_eq!(residual(difference, Membership::In), Residual::On(Crossing::Falls));
    let both = EdgeResidual { near: vec![LeafId(1)], rule: Rule::Table { rises: 0b01, falls: 0b10 } };
    assert_eq!(residual(difference, Membership::Near), Residual::Edge(both));
}

#[test]
fn the_union_of_the_products_is_the_tree_and_none_is_needless() {
    for count in 1..=4 {
        for kind in [Kind::All, Kind::Positive] {
            for ast in trees(kind, 0, count) {
                // With every leaf its own, and with some leaves the same.
                for repeat in [MOST_LEAVES, 2, 1] {
                    let tables: Vec<u32> = (0..count).map(|leaf| LEAF_TABLES[(leaf % repeat) as usize]).collect();
                    let tree = ast.tree().map_leaves(|leaf| LeafId(leaf.0 % repeat));
                    let positive = tree.positive();
                    let products = positive.products().unwrap();
                    let truths: Vec<u32> = products
                        .iter()
                        .map(|product| {
                            product.literals().iter().fold(!0, |truth, literal| {
                                let table = LEAF_TABLES[literal.leaf.0 as usize];
                                truth & if literal.negated { !table } else { table }
                            })
                        })
                        .collect();
                    assert_eq!(truths.iter().fold(0, |union, truth| union | truth), ast.truth(&tables), "{ast:?}");
                    assert!(positive.product_count() >= products.len() as u64);
                    for (i, truth) in truths.iter().enumerate() {
                        assert_ne!(*truth, 0);
                        assert!(truths.iter().enumerate().all(|(j, other)| j == i || truth & !other != 0), "{ast:?}");
                    }
                }
            }
        }
    }
}
