//! A leaf that moves: the model that was moved is the model made anew, and draws the same bytes.

use glam::DVec3;

use super::Frame;
use super::settings::{Partners, SplatSettings};
use super::test_scenes::{COVER, Shape, camera, looks, tree};
use crate::classify::partners::PartnerLists;
use crate::classify::{LeafField, Model};
use crate::csg::LeafId;
use crate::layers::{LayerLimit, LayerStack};
use crate::scene::LeafKind;
use crate::space::Motion;

const TEXT: &str = "a - b | c";

fn sphere(centre: DVec3, radius: f64, surfels: usize) -> LeafField {
    LeafField::new(Shape::Sphere(centre, radius).surfels(surfels, 0.0, COVER), None, LeafKind::Solid)
}

fn cutter(x: f64) -> LeafField {
    sphere(DVec3::new(x, -0.6, 0.5), 0.7, 1500)
}

fn model(cutter_x: f64) -> Model {
    // The last leaf is far from the cutter, wherever that goes.
    let fields = vec![sphere(DVec3::ZERO, 1.0, 3000), cutter(cutter_x), sphere(DVec3::new(0.0, 9.0, 0.0), 0.5, 500)];
    Model::new(&tree(TEXT), fields, looks(3))
}

#[test]
fn partners_of_before_a_move_are_not_used_after_it() {
    let mut moved = model(0.9);
    let settings = SplatSettings { partners: Partners::ObjectSpace, ..SplatSettings::PAPER };
    let kept = PartnerLists::in_space(&moved, settings.partners_among().unwrap());
    let camera = camera(DVec3::new(2.6, -2.4, 1.8), DVec3::ZERO, 40.0, 32);
    // Fewer surfels than before: the old lists name some that are gone.
    moved.move_leaf(LeafId(1), sphere(DVec3::new(0.3, -0.6, 0.5), 0.7, 200));
    let frame = Frame::new(&moved, camera, LayerLimit::Nearest, 1, settings, Some(&kept));
    assert!(frame.partners().is_some_and(|used| *used == PartnerLists::in_space(&moved, kept.among())));
    assert!(!LayerStack::collect(&frame).tiles().is_empty());
}

#[test]
fn moving_a_leaf_equals_starting_anew() {
    let camera = camera(DVec3::new(2.6, -2.4, 1.8), DVec3::ZERO, 40.0, 96);
    let pixels = |model: &Model| {
        let frame = Frame::new(model, camera.clone(), LayerLimit::All, 1, SplatSettings::default(), None);
        let stack = LayerStack::collect(&frame);
        let of_tile = |tile: &crate::layers::LayerTile| (tile.offsets.clone(), tile.boundaries.clone());
        stack.tiles().iter().map(of_tile).collect::<Vec<_>>()
    };
    let mut moved = model(0.9);
    let before = pixels(&moved);
    for x in [0.85, 0.3, 3.0] {
        // The ball that is cut and the cutter; the far ball keeps its classes.
        let again = moved.move_leaf(LeafId(1), cutter(x));
        assert_eq!(again, 2, "at {x}");
        let anew = model(x);
        assert_eq!(moved.classes, anew.classes, "at {x}");
        assert_eq!(pixels(&moved), pixels(&anew), "at {x}");
        assert_ne!(pixels(&moved), before, "the cut must show at {x}");
    }
}

#[test]
fn a_pose_equals_starting_anew_whatever_was_posed_before() {
    let motion = |x: f64| Motion {
        scale: 1.1,
        rotation: glam::DQuat::from_rotation_y(x),
        translation: DVec3::new(x, 0.1 * x, -0.3 * x),
    };
    let shapes = || {
        vec![
            sphere(DVec3::ZERO, 1.0, 3000),
            cutter(0.9),
            sphere(DVec3::new(0.9, -0.9, 0.1), 0.4, 900),
            sphere(DVec3::new(0.0, 9.0, 0.0), 0.5, 500),
        ]
    };
    let made = |fields: Vec<LeafField>| Model::new(&tree("a - (b - c) | d"), fields, looks(4));
    let (a, b, c) = (LeafId(0), LeafId(1), LeafId(2));
    let mut posed = made(shapes());
    let own = posed.classes.clone();
    let among = crate::classify::partners::Among::NearLeaves;
    let mut partners = PartnerLists::in_space(&posed, among);
    let poses: [&[(LeafId, Motion)]; 5] = [
        &[(b, motion(-0.2)), (c, motion(-0.2))],
        &[(b, motion(-0.2)), (c, motion(-0.3))],
        &[(a, motion(0.1)), (b, motion(0.1)), (c, motion(0.1))],
        &[(c, motion(0.2))],
        &[],
    ];
    for pose in poses {
        let again = posed.pose(pose);
        partners = partners.after_pose(&posed, &again);
        let mut fields = shapes();
        for (leaf, motion) in pose {
            let moved = fields[leaf.0 as usize].moved(motion);
            fields[leaf.0 as usize] = moved;
        }
        let anew = made(fields);
        assert!(partners.serve(&posed, among));
        if pose.windows(2).any(|pair| pair[0].1 == pair[1].1) {
            // What moves together lies as before it moved; made anew, roundings decide a few surfels otherwise.
            let both = posed.classes.iter().zip(&anew.classes).flat_map(|(a, b)| a.classes.iter().zip(&b.classes));
            let differing = both.filter(|(a, b)| a.wicke() != b.wicke()).count();
            assert!(differing < 10, "{differing} in {pose:?}");
        } else {
            assert!(posed.classes == anew.classes, "{pose:?}");
            assert!(partners == PartnerLists::in_space(&anew, among), "{pose:?}");
        }
    }
    assert!(posed.classes == own);
    // What moves with its neighbours is not classified again, nor is what nothing comes near.
    assert_eq!(posed.pose(&[(a, motion(0.1)), (b, motion(0.1)), (c, motion(0.1))]), []);
    assert_eq!(posed.pose(&[]), []);
    assert_eq!(posed.pose(&[(LeafId(3), motion(0.1))]), []);
}
