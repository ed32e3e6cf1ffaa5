//! Surfaces that coincide on the GPU against the CPU, whose own tests hold it to Boolean algebra (`src/splat/tied_tests.rs`,
//! `src/hybrid/tests.rs`).

use glam::{DAffine3, DVec3};
use surfcut::classify::{LeafField, Model};
use surfcut::geometry::Solid;
use surfcut::gpu::Gpu;
use surfcut::layers::{LayerLimit, LayerSource, LayerTile};
use surfcut::measure::simulate::{ScanOptions, scan};
use surfcut::scene::LeafKind;
use surfcut::space::Camera;
use surfcut::surfel::{CloudOptions, from_cloud, from_solid};

use crate::Test;
use crate::hybrid::{self, Mesh, Own, Scan, leaf};
use crate::splat::{ALLOWED, Compared, camera, compare, draw_both, looks, sphere, torus_and_cylinder, tree, whole};

pub const TESTS: &[Test] = &[
    ("tied_a_ball_and_another_scan_of_it", a_ball_and_another_scan_of_it),
    ("tied_a_third_leaf_cuts_both_alike", a_third_leaf_cuts_both_alike),
    ("tied_a_leaf_that_is_near_to_neither", a_leaf_that_is_near_to_neither),
    ("tied_several_samples_a_pixel", several_samples_a_pixel),
    ("tied_a_sheet_on_a_solids_surface", a_sheet_on_a_solids_surface),
    ("tied_sides_that_face_each_other", sides_that_face_each_other),
    ("tied_two_scans_of_a_torus", two_scans_of_a_torus),
    ("tied_a_scan_and_the_solid_that_it_is_of", a_scan_and_the_solid_that_it_is_of),
    ("tied_a_pocket_flush_with_a_scanned_face", a_pocket_flush_with_a_scanned_face),
    ("tied_a_box_flush_with_a_scanned_box", a_box_flush_with_a_scanned_box),
    ("tied_a_scan_whose_side_does_not_matter", a_scan_whose_side_does_not_matter),
    ("tied_the_comparison_can_fail", the_comparison_can_fail),
];

fn aside() -> Camera {
    camera([1.0, -5.0, 2.0], [0.0; 3], 30.0)
}

/// A sampling of `solid` that is turned, so that it has no surfel in common with one that is not; `solid` has to be the same turned.
fn turned(solid: &Solid, about: DVec3, spacing: f64) -> LeafField {
    let turn = DAffine3::from_axis_angle(about.normalize(), 0.7);
    LeafField::new(from_solid(solid, turn, spacing).unwrap(), None, LeafKind::Solid)
}

/// Two samplings a, b of one ball, of which the second is of `kind` and has `radius`, and another ball c.
fn balls(text: &str, kind: LeafKind, radius: f64) -> Model {
    balls_and(text, (kind, radius), (&sphere([0.5, -0.7, 0.6], 0.6), 0.06))
}

/// The same with c, sampled so many apart.
fn balls_and(text: &str, (kind, radius): (LeafKind, f64), (other, spacing): (&Solid, f64)) -> Model {
    let mut again = turned(&sphere([0.0; 3], radius), DVec3::new(0.3, -0.5, 0.8), 0.07);
    again.kind = kind;
    let scan = |solid: &Solid, spacing| crate::splat::scan(solid, spacing, DVec3::ZERO);
    let fields = vec![scan(&sphere([0.0; 3], 1.0), 0.06), again, scan(other, spacing)];
    Model::new(&tree(text), fields, looks(3))
}

/// Pixels that show anything.
fn covered(tile: &LayerTile) -> usize {
    tile.offsets.windows(2).filter(|ends| ends[0] < ends[1]).count()
}

/// The bar, where an empty picture is right too: of as many pixels as the scene covers without the cut.
fn hold(what: &str, compared: &Compared, of: usize) {
    assert!(of > 1000, "{what}: {of}");
    assert!(compared.differing as f64 <= ALLOWED * of as f64, "{what}: {compared:?}");
    assert_eq!(compared.off_edges, 0, "{what}: {compared:?}");
}

/// Surfels alone, with both limits; returns how many pixels show anything on the GPU.
fn hold_surfels(gpu: &Gpu, what: &str, model: &Model, camera: &Camera, samples: u32) -> usize {
    let mut shown = 0;
    for limit in [LayerLimit::Nearest, LayerLimit::All] {
        let (on_cpu, on_gpu) = draw_both(gpu, model, camera, limit, samples);
        hold(&format!("{what}, {limit:?}"), &compare(camera, &on_cpu, &on_gpu), 2000);
        shown = covered(&on_gpu);
    }
    shown
}

/// The same where leaves keep their own form.
fn hold_hybrid(gpu: &Gpu, text: &str, leaves: &[hybrid::TestLeaf], camera: &Camera) -> LayerTile {
    let model = hybrid::model(text, leaves);
    let [_, all] = [LayerLimit::Nearest, LayerLimit::All].map(|limit| {
        let on_cpu = model.frame(camera, limit, 1).draw(whole(camera));
        let on_gpu = hybrid::on_gpu(gpu, &model, camera, limit, 1);
        hold(&format!("{text}, {limit:?}"), &compare(camera, &on_cpu, &on_gpu), 2000);
        on_gpu
    });
    all
}

fn a_ball_and_another_scan_of_it(gpu: &'static Gpu) {
    for text in ["a - b", "b - a", "(a - b) | (b - a)"] {
        assert_eq!(hold_surfels(gpu, text, &balls(text, LeafKind::Solid, 1.0), &aside(), 1), 0, "{text}");
    }
    for text in ["a | b", "b & a"] {
        let model = balls(text, LeafKind::Solid, 1.0);
        assert!(hold_surfels(gpu, text, &model, &aside(), 1) > 2000);
        let (_, drawn) = draw_both(gpu, &model, &aside(), LayerLimit::All, 1);
        // A front and a back.
        assert!(drawn.offsets.windows(2).all(|ends| ends[1] - ends[0] <= 2), "{text}");
    }
}

fn a_third_leaf_cuts_both_alike(gpu: &'static Gpu) {
    for text in ["(a | b) - c", "(a & b) | c", "c - (a | b)"] {
        hold_surfels(gpu, text, &balls(text, LeafKind::Solid, 1.0), &aside(), 1);
    }
}

fn a_leaf_that_is_near_to_neither(gpu: &'static Gpu) {
    // It holds both, no surfel of theirs comes near to it, and yet it has to be asked where they coincide.
    let text = "c & (a | b)";
    let model = balls_and(text, (LeafKind::Solid, 1.0), (&sphere([0.0; 3], 1.6), 0.15));
    assert!(hold_surfels(gpu, text, &model, &aside(), 1) > 2000);
}

fn several_samples_a_pixel(gpu: &'static Gpu) {
    assert_eq!(hold_surfels(gpu, "a - b", &balls("a - b", LeafKind::Solid, 1.0), &aside(), 4), 0);
    hold_surfels(gpu, "(a | b) - c", &balls("(a | b) - c", LeafKind::Solid, 1.0), &aside(), 4);
}

fn a_sheet_on_a_solids_surface(gpu: &'static Gpu) {
    for text in ["a | b", "b - a", "a - b"] {
        hold_surfels(gpu, text, &balls(text, LeafKind::Sheet, 1.0), &aside(), 1);
    }
}

fn sides_that_face_each_other(gpu: &'static Gpu) {
    // Two squares of surfels back to back: what is below one and what is above the other share their border.
    let square = |normal: DVec3, spacing| {
        let half = Solid::HalfSpace { point: DVec3::ZERO, normal, extent: 2.0 };
        crate::splat::scan(&half, spacing, DVec3::ZERO)
    };
    let camera = camera([0.4, -0.3, 3.0], [0.0; 3], 20.0);
    for (text, is_shown) in [("a | b", false), ("a & b", false), ("a - b", true)] {
        let model = Model::new(&tree(text), vec![square(DVec3::Z, 0.08), square(-DVec3::Z, 0.1)], looks(2));
        let shown = hold_surfels(gpu, text, &model, &camera, 1);
        assert_eq!(shown, if is_shown { covered_by_all(&camera) } else { 0 }, "{text}");
    }
}

fn covered_by_all(camera: &Camera) -> usize {
    whole(camera).area()
}

fn two_scans_of_a_torus(gpu: &'static Gpu) {
    // No surfel has its shape.
    let [torus, _] = torus_and_cylinder();
    let scanned = |seed| {
        let cloud = scan(&torus, &ScanOptions::regular(20_000, seed)).unwrap();
        let surfels = from_cloud(cloud, DAffine3::IDENTITY, &CloudOptions::default(), &|_| ()).unwrap().0;
        LeafField::new(surfels, None, LeafKind::Solid)
    };
    for (text, is_shown) in [("a - b", false), ("a | b", true)] {
        let model = Model::new(&tree(text), vec![scanned(1), scanned(2)], looks(2));
        let shown = hold_surfels(gpu, text, &model, &camera([2.6, -2.4, 1.8], [0.0; 3], 36.0), 1);
        assert_eq!(shown > 0, is_shown, "{text}: {shown}");
    }
}

fn a_scan_and_the_solid_that_it_is_of(gpu: &'static Gpu) {
    let ball = sphere([0.0; 3], 1.0);
    let leaves = [leaf(Scan, ball.clone()), leaf(Own, ball)];
    for (text, is_shown) in [("a - b", false), ("b - a", false), ("a | b", true), ("b & a", true)] {
        let shown = covered(&hold_hybrid(gpu, text, &leaves, &aside()));
        assert_eq!(shown > 0, is_shown, "{text}: {shown}");
    }
}

fn face() -> Camera {
    camera([0.7, -1.2, 5.0], [0.0, 0.0, 0.2], 32.0)
}

fn block() -> Solid {
    Solid::Box { min: DVec3::new(-1.0, -1.0, -0.8), max: DVec3::new(1.0, 1.0, 0.4) }
}

fn a_pocket_flush_with_a_scanned_face(gpu: &'static Gpu) {
    let pocket = Solid::Box { min: DVec3::new(-0.5, -0.6, 0.0), max: DVec3::new(0.5, 0.6, 0.4) };
    for form in [Own, Mesh] {
        let leaves = [leaf(Scan, block()), leaf(form, pocket.clone())];
        for text in ["a - b", "a | b", "a & b"] {
            hold_hybrid(gpu, text, &leaves, &face());
        }
    }
}

fn a_box_flush_with_a_scanned_box(gpu: &'static Gpu) {
    // The same face from the other side.
    let on_top = Solid::Box { min: DVec3::new(-0.7, -0.8, 0.4), max: DVec3::new(0.5, 0.6, 0.9) };
    let leaves = [leaf(Scan, block()), leaf(Own, on_top)];
    for text in ["a - b", "a | b", "b - a"] {
        hold_hybrid(gpu, text, &leaves, &face());
    }
}

fn a_scan_whose_side_does_not_matter(gpu: &'static Gpu) {
    // Within d the side of a does not matter to whether the surface of b, which is the same, is one of the result; within c that of b
    // does not to that of a.
    let (ball, around) = (sphere([0.0; 3], 1.0), sphere([0.0, -0.8, 0.3], 0.9));
    let leaves =
        [leaf(Scan, ball.clone()), leaf(Own, ball), leaf(Own, sphere([0.9, 0.0, 0.4], 0.6)), leaf(Scan, around)];
    for text in ["(b | c) & (d | a)", "(b | c) & (a | d)", "(a | d) & (b | c)"] {
        assert!(covered(&hold_hybrid(gpu, text, &leaves, &aside())) > 2000);
    }
}

fn the_comparison_can_fail(gpu: &'static Gpu) {
    // A ball that is larger by a share of its surfels' radii that does not coincide is one that a leaves nothing of, and b a skin.
    let (camera, text) = (aside(), "b - a");
    let (on_cpu, _) = draw_both(gpu, &balls(text, LeafKind::Solid, 1.0), &camera, LayerLimit::All, 1);
    let (_, larger) = draw_both(gpu, &balls(text, LeafKind::Solid, 1.0005), &camera, LayerLimit::All, 1);
    let compared = compare(&camera, &on_cpu, &larger);
    assert!(covered(&on_cpu) == 0 && compared.differing > 1000, "{compared:?}");
}
