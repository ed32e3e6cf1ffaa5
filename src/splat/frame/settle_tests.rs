//! Settled pixels show what rays show: the shortcut is compared with tracing, pixel by pixel, and with the truth.

use glam::{DAffine3, DQuat, DVec3};

use super::*;
use crate::classify::LeafField;
use crate::geometry::Solid;
use crate::geometry::exact::Exact;
use crate::layers::LayerStack;
use crate::space::Lens;
use crate::splat::test_scenes::{COVER, Shape, camera, cast_all, looks, tree};
use crate::surfel::from_solid;

const SIZE: u32 = 200;

fn ball(centre: DVec3, radius: f64, surfels: usize) -> LeafField {
    LeafField::new(Shape::Sphere(centre, radius).surfels(surfels, 0.0, COVER), None, LeafKind::Solid)
}

fn frame<'a>(model: &'a Model, camera: &Camera, limit: LayerLimit, samples: u32) -> Frame<'a> {
    Frame::new(model, camera.clone(), limit, samples, SplatSettings::default(), None)
}

/// Which pixels of `frame` are settled at their middles, row by row.
fn settled(frame: &Frame<'_>) -> Vec<bool> {
    let mut settled = vec![false; (SIZE * SIZE) as usize];
    for rect in PixelRect::tiles(SIZE, SIZE, TILE_SIDE) {
        let members = frame.bins.of(rect);
        if members.is_empty() {
            continue;
        }
        let anchor = bins::anchor_of(&members, frame.model, &frame.view);
        let mut tracer = TileTracer::new(TilePass { frame, rect, anchor, members: &members }, Vec::new());
        tracer.trace(&BlockSet::new(rect, true), DVec2::splat(0.5), |_, _| {});
        for y in 0..rect.height() {
            for x in 0..rect.width() {
                let bit = tracer.kept.settled.lanes(x / BLOCK * BLOCK, y) >> (x % BLOCK) & 1;
                settled[((rect.y0 + y) * SIZE + rect.x0 + x) as usize] = bit == 1;
            }
        }
    }
    settled
}

/// Compares each settled pixel with the first boundary that tracing finds; returns how many there are.
fn settled_like_traced(name: &str, model: &Model, camera: &Camera) -> usize {
    let quick_frame = frame(model, camera, LayerLimit::Nearest, 1);
    let quick = LayerStack::collect(&quick_frame);
    let traced = LayerStack::collect(&frame(model, camera, LayerLimit::All, 1));
    let settled = settled(&quick_frame);
    for y in 0..SIZE {
        for x in 0..SIZE {
            if !settled[(y * SIZE + x) as usize] {
                continue;
            }
            let (a, b) = (quick.at(x, y)[0], traced.at(x, y)[0]);
            let place = format!("{name} ({x}, {y}): {a:?} {b:?}");
            assert_eq!((a.leaf, a.body, a.facing, a.opacity), (b.leaf, b.body, b.facing, b.opacity), "{place}");
            // The expansion leaves out what is of third order in a surfel of a few pixels.
            let footprint = camera.footprint(f64::from(b.depth)) as f32;
            assert!((a.depth - b.depth).abs() < 0.1 * footprint, "{place}");
            assert!(a.normal.angle_between(b.normal).to_degrees() < 0.5, "{place}");
            assert!(a.colour.iter().zip(b.colour).all(|(a, b)| (a - b).abs() < 1e-3), "{place}");
        }
    }
    settled.iter().filter(|s| **s).count()
}

fn eye() -> DVec3 {
    DVec3::new(2.4, -2.6, 1.6)
}

fn perspective() -> Camera {
    camera(eye(), DVec3::ZERO, 45.0, SIZE)
}

#[test]
fn whole_surfaces_settle_and_show_what_rays_show() {
    // A ball, another hidden behind it, and one in front that was cut by a third.
    let fields = vec![
        ball(DVec3::ZERO, 1.0, 20_000),
        ball(DVec3::new(-1.4, 1.5, -0.9), 0.6, 6_000),
        ball(DVec3::new(1.1, -0.9, 0.3), 0.5, 8_000),
        ball(DVec3::new(1.6, -1.1, 0.6), 0.45, 8_000),
    ];
    let model = Model::new(&tree("a | b | (c - d)"), fields, looks(4));
    let covered = |camera: &Camera| {
        let stack = LayerStack::collect(&frame(&model, camera, LayerLimit::Nearest, 1));
        (0..SIZE * SIZE).filter(|i| !stack.at(i % SIZE, i / SIZE).is_empty()).count()
    };
    let level = Camera::look_at(eye(), DVec3::ZERO, DVec3::Z, Lens::Height(3.2), SIZE, SIZE).unwrap();
    for (name, camera) in [("perspective", perspective()), ("orthographic", level)] {
        let count = settled_like_traced(name, &model, &camera);
        let covered = covered(&camera);
        assert!(count > covered / 2, "{name}: {count} of {covered} settled");
    }
}

#[test]
fn a_cut_face_of_a_scan_and_of_an_exact_solid_settle() {
    let at = DVec3::new(0.9, -0.8, 0.6);
    let model = Model::new(&tree("a - b"), vec![ball(DVec3::ZERO, 1.0, 20_000), ball(at, 0.8, 30_000)], looks(2));
    let seen = LayerStack::collect(&frame(&model, &perspective(), LayerLimit::Nearest, 1));
    let is_settled = settled(&frame(&model, &perspective(), LayerLimit::Nearest, 1));
    let on_cut = |i: &u32| is_settled[*i as usize] && seen.at(i % SIZE, i / SIZE)[0].leaf == 1;
    assert!((0..SIZE * SIZE).filter(on_cut).count() > 1000);
    assert!((0..SIZE * SIZE).filter(on_cut).all(|i| seen.at(i % SIZE, i / SIZE)[0].body == 0));
    assert!(settled_like_traced("scan", &model, &perspective()) > 3000);

    // The same cutter, stretched and mirrored into its place, asked exactly.
    let solid = Solid::Sphere { centre: DVec3::ZERO, radius: 1.0 };
    let place = DAffine3::from_scale_rotation_translation(DVec3::new(0.8, -0.6, 0.7), DQuat::from_rotation_z(0.4), at);
    let exact = Exact::solid(solid.clone(), place);
    let cutter = LeafField::new(from_solid(&solid, place, 0.02).unwrap(), Some(exact), LeafKind::Solid);
    let model = Model::new(&tree("a - b"), vec![ball(DVec3::ZERO, 1.0, 20_000), cutter], looks(2));
    assert!(settled_like_traced("exact", &model, &perspective()) > 3000);
}

#[test]
fn the_truth_is_what_settles() {
    let shapes = [Shape::Sphere(DVec3::ZERO, 1.0), Shape::Sphere(DVec3::new(0.9, -0.8, 0.6), 0.7)];
    let fields = shapes.iter().map(|s| LeafField::new(s.surfels(20_000, 0.0, COVER), None, LeafKind::Solid)).collect();
    let model = Model::new(&tree("a - b"), fields, looks(2));
    let camera = perspective();
    let truth = cast_all(&tree("a - b"), &shapes, &camera);
    let frame = frame(&model, &camera, LayerLimit::Nearest, 1);
    let stack = LayerStack::collect(&frame);
    for (i, _) in settled(&frame).iter().enumerate().filter(|(_, settled)| **settled) {
        let seen = stack.at(i as u32 % SIZE, i as u32 / SIZE)[0];
        let (leaf, facing, depth) = truth[i][0];
        assert_eq!((seen.leaf, seen.facing), (leaf, facing));
        assert!((f64::from(seen.depth) - depth).abs() < 0.1 * camera.footprint(depth));
    }
}

#[test]
fn what_lets_light_through_or_is_all_edge_does_not_settle() {
    let fields = || vec![ball(DVec3::ZERO, 1.0, 20_000)];
    let mut glass = looks(1);
    glass[0].opacity = 0.5;
    let model = Model::new(&tree("a"), fields(), glass);
    assert!(!settled(&frame(&model, &perspective(), LayerLimit::Nearest, 1)).contains(&true));
    // Every surfel of either copy is near the other.
    let twice = vec![ball(DVec3::ZERO, 1.0, 20_000), ball(DVec3::splat(1e-4), 1.0, 20_000)];
    let model = Model::new(&tree("a | b"), twice, looks(2));
    assert!(!settled(&frame(&model, &perspective(), LayerLimit::Nearest, 1)).contains(&true));
    // With all boundaries asked for, the far side counts.
    let model = Model::new(&tree("a"), fields(), looks(1));
    assert!(!frame(&model, &perspective(), LayerLimit::All, 1).settles());
}

#[test]
fn samples_of_settled_and_traced_pixels_agree() {
    let fields = vec![ball(DVec3::ZERO, 1.0, 20_000), ball(DVec3::new(0.9, -0.8, 0.6), 0.7, 20_000)];
    let model = Model::new(&tree("a - b"), fields, looks(2));
    let quick = LayerStack::collect(&frame(&model, &perspective(), LayerLimit::Nearest, 4));
    let traced = LayerStack::collect(&frame(&model, &perspective(), LayerLimit::All, 4));
    let mut partial = 0;
    for i in 0..SIZE * SIZE {
        let (a, b) = (quick.at(i % SIZE, i / SIZE), traced.at(i % SIZE, i / SIZE));
        assert_eq!(a.is_empty(), b.is_empty());
        // Coverage by each leaf's front, from the nearest boundaries of each sample.
        let first = |list: &[Boundary]| {
            let mut open = 0b1111_u16;
            list.iter()
                .map(|b| {
                    let seen = b.samples & open;
                    open &= !seen;
                    (b.leaf, seen)
                })
                .filter(|(_, seen)| *seen != 0)
                .collect::<Vec<_>>()
        };
        assert_eq!(first(a), first(b));
        partial += usize::from(a.iter().any(|b| b.samples != 0b1111));
    }
    assert!(partial > 100);
}
