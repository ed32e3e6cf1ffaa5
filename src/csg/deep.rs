//! Trees a million levels deep, and of a million leaves: nothing recurses, and what were quadratic would not end.

use super::exhaustive::{leaf_of_letter, letter};
use super::expression::parse;
use super::*;

/// Runs on a stack that a recursion of a few thousand levels would overflow.
fn on_a_small_stack(task: impl FnOnce() + Send + 'static) {
    const STACK_BYTES: usize = 256 << 10;
    std::thread::Builder::new().stack_size(STACK_BYTES).spawn(task).unwrap().join().unwrap();
}

/// Lists with few IDs and walks that toggle, in every order of operands, of a form that is true all in, and `all_out` all out.
fn check_lists(positive: &Positive, all_out: bool) {
    let leaves = positive.leaves();
    let ordered = [First::Deeper, First::Busier].map(|first| positive.left_heavy(first));
    for (form, positive) in [positive, &ordered[0], &ordered[1]].into_iter().enumerate() {
        let list = StatusList::from(&positive.blist());
        // Point 0 is inside all leaves, point 1 outside; of point 2 nothing is known.
        let points = list.walk(0b111, &mut Vec::new(), |_, _| Points { may_be_in: 0b101, may_be_out: 0b110 });
        assert_eq!((points.get(0), points.get(1)), (Tri::True, Tri::from(all_out)));
        let unknown = positive.eval_tri(|_| Tri::Unknown);
        assert_eq!(points.get(2), unknown);
        // In Strahler's order, the logarithm of the number of leaves, and one more.
        assert!(form < 2 || list.id_count() <= positive.literals().count().ilog2() + 2);
        let mut walk = Walk::from(positive);
        assert_eq!(walk.value(), all_out);
        let last = leaves.iter().map(|leaf| walk.toggle(*leaf)).last();
        assert_eq!(last, Some(true));
    }
}

#[test]
fn a_million_levels() {
    const LEVELS: usize = 1_000_000;
    // All are true of a point inside both leaves. Outside both, the last is a complement of nothing.
    let texts = [
        format!("{}a", "b & ".repeat(LEVELS)),
        format!("{}a{}", "b & (".repeat(LEVELS), ")".repeat(LEVELS)),
        format!("{}a", "!".repeat(LEVELS)),
        format!("{}a{}", "(".repeat(LEVELS), ")".repeat(LEVELS)),
        format!("{}a{}", "(a | b & ".repeat(LEVELS), ")".repeat(LEVELS)),
        format!("{}a{}", "!(b & ".repeat(LEVELS), ")".repeat(LEVELS)),
    ];
    for (i, text) in texts.into_iter().enumerate() {
        let all_out = i == 5;
        on_a_small_stack(move || {
            let tree = parse(&text, &mut leaf_of_letter).unwrap();
            let printed = tree.display(letter).to_string();
            assert_eq!(parse(&printed, &mut leaf_of_letter), Ok(tree.clone()));
            assert!(tree.eval(|_| true));
            assert_eq!(tree.eval(|_| false), all_out);
            let positive = tree.positive();
            assert_eq!(positive.eval_tri(|_| Tri::True), Tri::True);
            assert!(positive.eval(|_| true));
            let blist = positive.blist();
            assert_eq!((blist.eval(|_| true), blist.eval(|_| false)), (true, all_out));
            assert_eq!(blist.entries().len(), positive.literals().count());
            check_lists(&positive, all_out);
            let paper = PaperTree::from(&positive);
            assert_eq!(paper.clipped(0, |_| Tri::Unknown), paper.clipped2(0, |_| Tri::Unknown));
            assert_ne!(Residual::of(&positive, LeafId(0), |_| Membership::In), Residual::Off);
            let _ = Residual::of(&positive, LeafId(0), |_| Membership::Near);
            drop((tree, positive, blist, paper));
        });
    }
}

#[test]
fn a_million_leaves() {
    const LEAVES: u32 = 1_000_000;
    let mut builder = TreeBuilder::default();
    builder.leaf(LeafId(0));
    for id in 1..LEAVES {
        builder.leaf(LeafId(id));
        if id % 3 == 0 {
            builder.minus()
        } else {
            builder.or()
        };
    }
    let positive = builder.finish().unwrap().positive();
    assert_eq!(positive.depth(), LEAVES - 1);
    assert!(positive.left_heavy(First::Deeper) == positive);
    let mut walk = Walk::from(&positive);
    // The leaf before the last is added and then not taken away: 999 999 is a multiple of three.
    assert!(positive.blist().eval(|leaf| leaf.0 == LEAVES - 2));
    assert!(!positive.blist().eval(|leaf| leaf.0 == LEAVES - 1));
    assert!(walk.toggle(LeafId(LEAVES - 2)) && !walk.toggle(LeafId(LEAVES - 1)));
    let Residual::Edge(edge) = Residual::of(&positive, LeafId(0), |_| Membership::Near) else { panic!("an edge") };
    assert_eq!(edge.near.len() as u32, LEAVES - 1);
    assert_eq!(edge.crossing(|_| false), Some(Crossing::Rises));
    assert_eq!(edge.crossing(|i| i == 0), None);
}

#[test]
fn a_balanced_tree_of_a_million_leaves() {
    const LEVELS: u32 = 20;
    let mut builder = TreeBuilder::default();
    // Pairs of pairs, as a counter carries; unions and intersections by turns.
    for id in 0..1_u32 << LEVELS {
        builder.leaf(LeafId(id));
        for level in 0..(id + 1).trailing_zeros() {
            if level % 2 == 0 {
                builder.and()
            } else {
                builder.or()
            };
        }
    }
    let positive = builder.finish().unwrap().positive();
    assert_eq!(positive.depth(), LEVELS);
    check_lists(&positive, false);
    // A step to the right at every level, every second one an intersection that leaves something to go on with.
    assert!(StatusList::from(&positive.blist()).id_count() <= LEVELS + 2);
}
