//! Trees a million levels deep, and of a million leaves: nothing recurses, nothing is quadratic.

use super::exhaustive::{leaf_of_letter, letter};
use super::expression::parse;
use super::*;

/// Runs on a stack that a recursion of a few thousand levels would overflow.
fn on_a_small_stack(task: impl FnOnce() + Send + 'static) {
    const STACK_BYTES: usize = 256 << 10;
    std::thread::Builder::new().stack_size(STACK_BYTES).spawn(task).unwrap().join().unwrap();
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
    // The leaf before the last is added and then not taken away: 999 999 is a multiple of three.
    assert!(positive.blist().eval(|leaf| leaf.0 == LEAVES - 2));
    assert!(!positive.blist().eval(|leaf| leaf.0 == LEAVES - 1));
    let Residual::Edge(edge) = Residual::of(&positive, LeafId(0), |_| Membership::Near) else { panic!("an edge") };
    assert_eq!(edge.near.len() as u32, LEAVES - 1);
    assert_eq!(edge.crossing(|_| false), Some(Crossing::Rises));
    assert_eq!(edge.crossing(|i| i == 0), None);
}
