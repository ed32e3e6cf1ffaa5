//! Surfaces that coincide: what Boolean algebra says of a set and itself holds for two samplings of one surface.

use glam::{DMat3, DVec3};

use super::Frame;
use super::settings::SplatSettings;
use super::test_scenes::{COVER, Shape, camera, looks, tree};
use crate::classify::{LeafField, Model};
use crate::layers::{Boundary, Facing, LayerLimit, LayerStack};
use crate::scene::LeafKind;

const BALL: Shape = Shape::Sphere(DVec3::ZERO, 1.0);

/// Samplings a, b of one ball, which have no point in common, and another ball c that cuts it.
fn stack(text: &str, limit: LayerLimit, samples: u32) -> LayerStack {
    let turn = DMat3::from_axis_angle(DVec3::new(0.3, -0.5, 0.8).normalize(), 0.7);
    let other = Shape::Sphere(DVec3::new(0.5, -0.7, 0.6), 0.6);
    let clouds = [BALL.surfels(3000, 0.0, COVER), BALL.turned_surfels(2200, turn), other.surfels(1500, 0.0, COVER)];
    let fields = clouds.into_iter().map(|cloud| LeafField::new(cloud, None, LeafKind::Solid)).collect();
    let model = Model::new(&tree(text), fields, looks(3));
    let camera = camera(DVec3::new(2.6, -2.4, 1.8), DVec3::ZERO, 36.0, 64);
    LayerStack::collect(&Frame::new(&model, camera, limit, samples, SplatSettings::default(), None))
}

fn all(stack: &LayerStack) -> impl Iterator<Item = (u32, u32, &[Boundary])> {
    let (width, height) = (stack.camera.width, stack.camera.height);
    (0..height).flat_map(move |y| (0..width).map(move |x| (x, y, stack.at(x, y))))
}

#[test]
fn nothing_is_left_of_a_scan_less_another_scan_of_the_same() {
    let settings = [(LayerLimit::All, 1), (LayerLimit::Nearest, 1), (LayerLimit::All, 4)];
    let texts = ["b - a", "(a - b) | (b - a)", "(a | b) - (a & b)"].map(|text| (text, settings[0]));
    for (text, (limit, samples)) in texts.into_iter().chain(settings.map(|settings| ("a - b", settings))) {
        let left = all(&stack(text, limit, samples)).filter(|(.., boundaries)| !boundaries.is_empty()).count();
        assert_eq!(left, 0, "{text}, {limit:?}, {samples} samples");
    }
}

#[test]
fn a_scan_with_another_scan_of_the_same_is_one_scan() {
    let alone = stack("a", LayerLimit::All, 1);
    for text in ["a | b", "a & b", "b | a"] {
        let both = stack(text, LayerLimit::All, 1);
        let mut covered = 0;
        for ((x, y, one), (.., two)) in all(&alone).zip(all(&both)) {
            covered += usize::from(!one.is_empty());
            // On the silhouette the two samplings need not agree whether a ray meets the ball.
            if one.len() != two.len() && (one.is_empty() || (one[0].depth - one[one.len() - 1].depth).abs() < 0.1) {
                continue;
            }
            let same = one.len() == two.len()
                && one.iter().zip(two).all(|(a, b)| {
                    (a.leaf, a.body, a.facing) == (b.leaf, b.body, b.facing) && (a.depth - b.depth).abs() < 1e-3
                });
            assert!(same, "{text} at {x}, {y}: {one:?} and {two:?}");
        }
        assert!(covered > 900);
    }
}

#[test]
fn a_third_leaf_cuts_both_alike() {
    for (text, alone) in [("(a | b) - c", "a - c"), ("(a & b) | c", "a | c"), ("c - (a | b)", "c - a")] {
        let (both, alone) = (stack(text, LayerLimit::All, 1), stack(alone, LayerLimit::All, 1));
        let (mut differing, mut covered) = (0, 0);
        for ((.., one), (.., two)) in all(&alone).zip(all(&both)) {
            covered += usize::from(!one.is_empty());
            let what = |b: &Boundary| (b.leaf, b.body, b.facing);
            differing += usize::from(!one.iter().map(what).eq(two.iter().map(what)));
        }
        // At the edge, whose place is that of one sampling or the other, and on the silhouette.
        assert!(covered > 200 && differing * 100 <= covered, "{text}: {differing} of {covered}");
    }
}

#[test]
fn sides_that_face_each_other_make_one_block() {
    // Two squares of surfels back to back: what is below one and what is above the other share their border.
    let (up, down) = (Shape::HalfSpace(DVec3::ZERO, DVec3::Z), Shape::HalfSpace(DVec3::ZERO, -DVec3::Z));
    let clouds = [up.surfels(900, 4.0, COVER), down.surfels(625, 4.1, COVER)];
    let fields = clouds.into_iter().map(|cloud| LeafField::new(cloud, None, LeafKind::Solid)).collect::<Vec<_>>();
    let camera = camera(DVec3::new(0.4, -0.3, 3.0), DVec3::ZERO, 20.0, 64);
    let drawn = |text: &str, fields: Vec<LeafField>| {
        let model = Model::new(&tree(text), fields, looks(2));
        let frame = Frame::new(&model, camera.clone(), LayerLimit::All, 1, SplatSettings::default(), None);
        LayerStack::collect(&frame)
    };
    let again = || {
        let clouds = [up.surfels(900, 4.0, COVER), down.surfels(625, 4.1, COVER)];
        clouds.into_iter().map(|cloud| LeafField::new(cloud, None, LeafKind::Solid)).collect::<Vec<_>>()
    };
    // Together they are everything, and apart from the border they share nothing.
    for text in ["a | b", "a & b"] {
        assert_eq!(all(&drawn(text, again())).filter(|(.., b)| !b.is_empty()).count(), 0, "{text}");
    }
    // What is below and not above is below.
    let below = drawn("a - b", fields);
    let right = |boundaries: &[Boundary]| matches!(boundaries, [b] if b.leaf == 0 && b.facing == Facing::Front);
    assert_eq!(all(&below).filter(|(.., b)| !right(b)).count(), 0);
}
