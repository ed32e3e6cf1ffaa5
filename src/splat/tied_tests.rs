//! Surfaces that coincide: what Boolean algebra says of a set and itself holds for two samplings of one surface.

use glam::{DAffine3, DMat3, DVec3};

use super::Frame;
use super::settings::SplatSettings;
use super::test_scenes::{COVER, Shape, camera, looks, tree};
use crate::classify::{LeafField, Model};
use crate::geometry::Solid;
use crate::layers::{Boundary, Facing, LayerLimit, LayerStack};
use crate::measure::simulate::{ScanOptions, scan};
use crate::scene::LeafKind;
use crate::surfel::{CloudOptions, from_cloud};

const BALL: Shape = Shape::Sphere(DVec3::ZERO, 1.0);

fn stack(text: &str, limit: LayerLimit, samples: u32) -> LayerStack {
    stack_with(text, limit, samples, LeafKind::Solid)
}

/// Samplings a, b of one ball, which have no point in common, and another ball c that cuts it. b is of `kind`.
fn stack_with(text: &str, limit: LayerLimit, samples: u32, kind: LeafKind) -> LayerStack {
    let turn = DMat3::from_axis_angle(DVec3::new(0.3, -0.5, 0.8).normalize(), 0.7);
    let other = Shape::Sphere(DVec3::new(0.5, -0.7, 0.6), 0.6);
    let clouds = [BALL.surfels(3000, 0.0, COVER), BALL.turned_surfels(2200, turn), other.surfels(1500, 0.0, COVER)];
    let kinds = [LeafKind::Solid, kind, LeafKind::Solid];
    let fields = clouds.into_iter().zip(kinds).map(|(cloud, kind)| LeafField::new(cloud, None, kind)).collect();
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
fn a_sheet_on_a_solids_surface_is_all_there_or_not_at_all() {
    // Within the union the solid has the surface; of the sheet less the solid nothing is inside of the solid.
    for (text, alone) in [("a | b", "a"), ("b - a", "b")] {
        let both = stack_with(text, LayerLimit::All, 1, LeafKind::Sheet);
        let alone = stack_with(alone, LayerLimit::All, 1, LeafKind::Sheet);
        let what = |b: &Boundary| (b.leaf, b.facing);
        let pairs = || all(&alone).zip(all(&both)).filter(|((.., one), _)| !one.is_empty());
        let differing = pairs().filter(|((.., one), (.., two))| !one.iter().map(what).eq(two.iter().map(what)));
        // On the silhouette the two samplings need not agree whether a ray meets the ball.
        let (differing, covered) = (differing.count(), pairs().count());
        assert!(covered > 900 && differing * 50 <= covered, "{text}: {differing} of {covered}");
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

#[test]
fn two_scans_of_a_surface_that_no_surfel_has_the_shape_of_coincide() {
    let torus = Solid::Torus { centre: DVec3::ZERO, axis: DVec3::Z, radius: 1.0, tube: 0.4 };
    let scanned = |seed| {
        let cloud = scan(&torus, &ScanOptions::regular(20_000, seed)).unwrap();
        from_cloud(cloud, DAffine3::IDENTITY, &CloudOptions::default(), &|_| ()).unwrap().0
    };
    let fields = [1, 2].map(|seed| LeafField::new(scanned(seed), None, LeafKind::Solid)).into();
    let model = Model::new(&tree("a - b"), fields, looks(2));
    let camera = camera(DVec3::new(2.6, -2.4, 1.8), DVec3::ZERO, 36.0, 64);
    let covered = |text: &str| {
        let model = model.with_tree(&tree(text));
        let frame = Frame::new(&model, camera.clone(), LayerLimit::Nearest, 1, SplatSettings::default(), None);
        all(&LayerStack::collect(&frame)).filter(|(.., boundaries)| !boundaries.is_empty()).count()
    };
    assert!(covered("a") > 2000);
    assert_eq!(covered("a - b"), 0);
}
