//! Figures 4, 5 and 6 of Wicke 2004, and corners: what single surfels and pixels show, against rays cast at the shapes
//! themselves. (Figure 3 is in `classify/inside.rs`; 2 and 7 to 9 are in `tests/wicke_figures.rs`.)

use glam::{DVec3, Vec3};

use super::frame::Frame;
use super::settings::{Clip, Inside, Partners, SplatSettings, Unknown};
use super::test_scenes::*;
use crate::classify::partners::{Among, PartnerLists, SurfelId};
use crate::classify::{Class, LeafField, Model, Wicke};
use crate::csg::LeafId;
use crate::layers::{LayerLimit, LayerStack};
use crate::scene::LeafKind;
use crate::space::Camera;
use crate::surfel::Sym3;

fn draw(model: &Model, camera: &Camera, settings: SplatSettings) -> LayerStack {
    LayerStack::collect(&Frame::new(model, camera.clone(), LayerLimit::Nearest, 1, settings, None))
}

fn shapes(leaves: &[(Shape, usize)]) -> Vec<Shape> {
    leaves.iter().map(|l| l.0).collect()
}

const PAPER: SplatSettings = SplatSettings::PAPER;

/// The paper's way with our rule for *unknown*.
const PAPER_RESOLVED: SplatSettings =
    SplatSettings { unknown: Unknown::Resolved, partners: Partners::ObjectSpace, ..SplatSettings::PAPER };

/// Figure 4: without outside-edge surfels the edge of a cube has holes.
#[test]
fn figure_4_the_edge_needs_its_outside_surfels() {
    let half = 0.5;
    let normals = [DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::NEG_Y, DVec3::Z, DVec3::NEG_Z];
    let leaves: Vec<(Shape, usize)> = normals.iter().map(|n| (Shape::HalfSpace(*n * half, *n), 144)).collect();
    let text = "a & b & c & d & e & f";
    // Twelve rows, 0.15 apart: the last one inside ends 0.125 before the edge, the next lies 0.025 beyond it. Disks just
    // cover: a square grid's sixth neighbour is across the diagonal, half of which a radius must be.
    let (side, just_covering) = (1.8, 0.55);
    let fields: Vec<LeafField> =
        leaves.iter().map(|(s, n)| LeafField::new(s.surfels(*n, side, just_covering), None, LeafKind::Solid)).collect();
    let mut model = Model::new(&tree(text), fields, looks(leaves.len()));
    let counts = model.counts();
    assert!(counts.outside_edge > 0 && counts.inside_edge > 0, "{counts:?}");
    let camera = camera(DVec3::new(2.2, -2.9, 2.0), DVec3::ZERO, 25.0, 256);
    let truth = cast_all(&tree(text), &shapes(&leaves), &camera);
    let settings = PAPER_RESOLVED;
    let lists = PartnerLists::in_space(&model, Among::NearLeaves);
    let picture = |model: &Model| {
        let frame = Frame::new(model, camera.clone(), LayerLimit::Nearest, 1, settings, Some(&lists));
        compare(&truth, &LayerStack::collect(&frame), 1)
    };
    let with = picture(&model);
    for of_leaf in &mut model.classes {
        for class in &mut of_leaf.classes {
            if class.wicke() == Wicke::OutsideEdge {
                *class = Class::default();
            }
        }
    }
    let without = picture(&model);
    assert_eq!(with.all(), 0, "{with:?}");
    assert!(without.holes > 100, "{without:?}");
}

/// Figure 5: (A ∩ B) ∩ C, the patch of C parallel to the picture; a surfel of C that reaches A and not B has partners of A
/// alone, and is clipped by A alone.
#[test]
fn figure_5_an_unknown_leaf_drops_out() {
    let leaves = [
        (Shape::HalfSpace(DVec3::new(0.5, 0.0, 0.0), DVec3::X), 900),
        (Shape::HalfSpace(DVec3::new(0.0, 0.5, 0.0), DVec3::Y), 900),
        (Shape::HalfSpace(DVec3::ZERO, DVec3::Z), 900),
    ];
    let model = model("a & b & c", &leaves);
    let lists = PartnerLists::in_space(&model, Among::EdgeSurfels);
    let partners_by_leaf = |at: DVec3| {
        let c = &model.fields[2];
        let (index, _) = c.nearest(at).unwrap();
        let of = lists.of(SurfelId { leaf: LeafId(2), index });
        [0, 1].map(|leaf| of.iter().filter(|t| t.leaf == LeafId(leaf)).count() > 0)
    };
    assert_eq!(partners_by_leaf(DVec3::new(0.5, 0.5, 0.0)), [true, true]);
    assert_eq!(partners_by_leaf(DVec3::new(0.5, -0.6, 0.0)), [true, false]);
    assert_eq!(partners_by_leaf(DVec3::new(-0.6, -0.6, 0.0)), [false, false]);
    let camera = camera(DVec3::new(0.0, 0.0, 5.0), DVec3::ZERO, 25.0, 200);
    let truth = cast_all(&tree("a & b & c"), &shapes(&leaves), &camera);
    let wrong = compare(&truth, &draw(&model, &camera, PAPER), 1);
    assert!(wrong.all() == 0 && wrong.covered > 5000, "{wrong:?}");
}

/// Figure 6: an irregularly sampled patch. The surfel of A crosses the large disk of B, but the two *closest* surfels of B
/// are small ones beyond a bend, whose planes run below: two-nearest takes the point for outside of B, and A bleeds into B.
/// Tests that ask only disks that reach the point are right.
#[test]
fn figure_6_a_far_centre_loses_to_two_near_ones() {
    // B's top is z = 0 for x < 0, sampled by one row of large disks, and rises as z = x for x > 0, by rows of small ones.
    // Material is below; the bend is concave as seen from above. A is the half-space x < −0.1.
    let rows = [-1.0, -0.5, 0.0, 0.5, 1.0];
    let flat = rows.map(|y| (DVec3::new(-0.9, y, 0.0), Vec3::Z, Sym3::default(), 1.0));
    let tilted = Vec3::new(-1.0, 0.0, 1.0).normalize();
    let small = (0..48).flat_map(|i| {
        let y = -1.175 + 0.05 * f64::from(i);
        [0.03, 0.08, 0.13].map(|x| (DVec3::new(x, y, x), tilted, Sym3::default(), 0.07))
    });
    let points: Vec<_> = flat.into_iter().chain(small).collect();
    let mut b = cloud(&points.iter().map(|p| (p.0, p.1, p.2)).collect::<Vec<_>>(), COVER);
    for i in 0..b.len() {
        let centre = b.centre(i);
        let radius = points.iter().find(|p| p.0.distance(centre) < 1e-6).unwrap().3;
        b.surfels[i].radius = radius;
        let chunk = &mut b.chunks[i / crate::surfel::CHUNK];
        chunk.largest_radius = chunk.largest_radius.max(radius);
    }
    let wall = Shape::HalfSpace(DVec3::new(-0.1, 0.0, 0.0), DVec3::X);
    let fields = vec![
        LeafField::new(wall.surfels(60 * 60, 2.4, COVER), None, LeafKind::Solid),
        LeafField::new(b, None, LeafKind::Solid),
    ];
    let model = Model::new(&tree("a | b"), fields, looks(2));
    // From below the bend, where nothing of B hides the wall: what is drawn of it under z = 0 is the bleeding.
    let camera = camera(DVec3::new(3.0, 0.0, 0.2), DVec3::new(-0.1, 0.0, -0.05), 6.0, 128);
    let bled = |inside: Inside| {
        let settings = SplatSettings { inside, ..PAPER_RESOLVED };
        let stack = LayerStack::collect(&Frame::new(&model, camera.clone(), LayerLimit::All, 1, settings, None));
        let of_wall = |i: u32| {
            let ray = camera.ray(glam::DVec2::new(f64::from(i % 128) + 0.5, f64::from(i / 128) + 0.5));
            stack.at(i % 128, i / 128).iter().any(|b| b.leaf == 0 && ray.at(f64::from(b.depth)).z < -0.003)
        };
        (0..128 * 128).filter(|&i| of_wall(i)).count()
    };
    let counts = Inside::ALL.map(|inside| (inside.name(), bled(inside)));
    println!("{counts:?}");
    for (name, count) in counts {
        let should_bleed = matches!(name, "nearest" | "two-nearest");
        assert!(if should_bleed { count > 200 } else { count == 0 }, "{counts:?}");
    }
}

/// Corners of three, four and five surfaces: convex, concave and saddles, of planes and of spheres, each also magnified onto
/// the corner. (Wicke 2004 §5: clipping by *any* plane would take all corners for convex.)
#[test]
fn corners_of_three_and_more_surfaces() {
    // Planes that lean so little that their sampled squares, of side 4, cover the view.
    let plane = |x: f64, y: f64, z: f64| (Shape::HalfSpace(DVec3::ZERO, DVec3::new(x, y, z).normalize()), 3600);
    let planes = [
        plane(1.0, 0.0, 0.9),
        plane(-0.5, 0.9, 0.9),
        plane(-0.5, -0.9, 0.9),
        plane(0.2, 0.1, 1.0),
        plane(0.1, -1.0, 1.1),
    ];
    // Unit spheres and smaller through one point, the origin, from several sides.
    let ball =
        |x: f64, y: f64, z: f64, radius: f64| (Shape::Sphere(-DVec3::new(x, y, z).normalize() * radius, radius), 5000);
    let balls = [
        ball(1.0, 0.0, 0.5, 1.0),
        ball(-0.5, 0.9, 0.5, 0.9),
        ball(-0.5, -0.9, 0.5, 1.1),
        ball(0.2, 0.1, 1.0, 0.8),
        ball(0.1, -1.0, 0.6, 1.2),
    ];
    let eye = DVec3::new(0.9, -0.7, 4.0);
    for (kind, leaves) in [("planes", planes), ("balls", balls)] {
        // Whether the paper's rule for unknown leaves holds. It takes each occurrence of a leaf for a patch of its own; and it
        // takes a & b for a where b is decided *out* and so lends no partner, though sampling is the same everywhere.
        for (text, paper_holds) in [
            ("a & b & c", true),
            ("a | b | c", true),
            ("(a | b) & c", true),
            ("(a & b) | c", true),
            ("a - b - c", true),
            ("(a - b) | (b - c) | (c - a)", false),
            ("a & b & c & d", true),
            ("(a | b) & (c | d)", true),
            ("(a & b) | (c & d)", true),
            ("((a & b) | (c & d)) - e", false),
        ] {
            let leaves =
                &leaves[..1 + text.bytes().filter(u8::is_ascii_lowercase).max().unwrap() as usize - 'a' as usize];
            let model = model(text, leaves);
            for (fov, apart) in [(16.0, 2), (0.16, 3)] {
                let camera = camera(eye, DVec3::ZERO, fov, 96);
                let truth = cast_all(&tree(text), &shapes(leaves), &camera);
                let ours = compare(&truth, &draw(&model, &camera, SplatSettings::default()), apart);
                assert_eq!(ours.all(), 0, "{kind} {text} {fov}: {ours:?}");
                // Flat disks are as good where surfaces are flat.
                if kind == "planes" {
                    let paper = compare(&truth, &draw(&model, &camera, PAPER), apart);
                    // Magnified, what it gets wrong may be out of view.
                    assert!(paper.all() == 0 || !paper_holds, "{text} {fov}: {paper:?}");
                    assert!(paper.all() > 50 || paper_holds || fov < 1.0, "{text} {fov}: {paper:?}");
                    for settings in [PAPER_RESOLVED, SplatSettings { clip: Clip::Surface, ..PAPER_RESOLVED }] {
                        let wrong = compare(&truth, &draw(&model, &camera, settings), apart);
                        assert_eq!(wrong.all(), 0, "{kind} {text} {fov} {settings:?}: {wrong:?}");
                    }
                }
            }
        }
    }
}
