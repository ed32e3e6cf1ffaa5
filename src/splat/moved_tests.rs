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
