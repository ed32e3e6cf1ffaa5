//! Hybrid pictures against the judge, which knows what the scans were taken of.

use std::sync::Arc;

use glam::DVec3;

use super::HybridModel;
use crate::csg::{LeafId, expression};
use crate::formats::{NoProgress, ReadOptions};
use crate::geometry::{PointCloud, Solid, TriMesh};
use crate::layers::{LayerLimit, LayerSource, LayerStack};
use crate::measure::compare::{Comparison, compare};
use crate::measure::open::open_reference;
use crate::measure::scenes::{cylinder, half_space, sphere};
use crate::measure::simulate::{ScanOptions, scan};
use crate::pipeline::{Density, ExactLeaves, convert};
use crate::scene::{CameraSpec, Leaf, LeafSource, Representation, Scene, Truth, load};
use crate::space::{Camera, Lens, PixelRect};

fn scanned(name: &str, solid: Solid, points: usize) -> Leaf {
    let cloud: PointCloud = scan(&solid, &ScanOptions::regular(points, 7)).unwrap();
    Leaf { truth: Some(Truth::Solid(solid)), ..Leaf::new(name, LeafSource::Cloud(Arc::new(cloud))) }
}

fn mesh_of(solid: &Solid) -> Arc<TriMesh> {
    Arc::new(solid.tessellate(1e-3).unwrap())
}

fn meshed(name: &str, solid: &Solid) -> Leaf {
    Leaf::new(name, LeafSource::Mesh(mesh_of(solid)))
}

/// A scene in a view from above and aside.
fn scene(csg: &str, leaves: Vec<Leaf>) -> Scene {
    let find = |name: &str| leaves.iter().position(|leaf| leaf.name == name).map(|i| LeafId(i as u32));
    let tree = expression::parse(csg, &mut { find }).unwrap();
    let mut scene = Scene::new(leaves, tree);
    let eye = DVec3::new(2.4, -2.8, 1.9);
    scene.camera = Some(CameraSpec { eye, target: DVec3::ZERO, up: DVec3::Z, lens: Lens::FovY(36.0) });
    scene.size = (256, 256);
    scene
}

fn model(scene: &Scene) -> (HybridModel, Camera) {
    let mut loaded = load(scene.clone(), &ReadOptions::default(), &NoProgress).unwrap();
    let camera = loaded.camera().unwrap();
    let converted = convert(&mut loaded, &camera, Density::default(), ExactLeaves::Crossed, &|_| ()).unwrap();
    (converted.classify().into_hybrid(), camera)
}

fn judged(scene: &Scene, limit: LayerLimit) -> Comparison {
    let (model, camera) = model(scene);
    let truth = open_reference(scene, limit).unwrap()(&camera).unwrap();
    compare(&LayerStack::collect(&model.frame(&camera, limit, 1)), &truth).unwrap()
}

/// A scan, a mesh, and an exact solid, each in each role.
fn scenes() -> Vec<(&'static str, Scene)> {
    let ball = || scanned("scan", sphere([0.0; 3], 1.0), 20_000);
    let drill = cylinder([0.2, -0.3, 0.1], [0.5, -0.6, 0.7], 1.6, 0.35);
    let cut = || Leaf::new("cut", LeafSource::Solid(half_space([0.4, -0.4, 0.3], [-0.6, 0.2, -0.4], 3.0)));
    let block = Solid::Box { min: DVec3::new(-1.2, -1.2, -0.6), max: DVec3::new(0.9, 0.7, 0.5) };
    vec![
        ("a scan minus a mesh", scene("scan - drill", vec![ball(), meshed("drill", &drill)])),
        ("minus an exact half-space too", scene("scan - drill - cut", vec![ball(), meshed("drill", &drill), cut()])),
        ("a mesh minus a scan", scene("block - scan", vec![ball(), meshed("block", &block)])),
        ("a union", scene("scan | block | drill", vec![ball(), meshed("block", &block), meshed("drill", &drill)])),
        ("what is in one alone", scene("(scan - block) | (block - scan)", vec![ball(), meshed("block", &block)])),
        (
            "a scan within two exact leaves",
            scene(
                "scan & block - drill",
                vec![
                    ball(),
                    Leaf::new("block", LeafSource::Solid(block.clone())),
                    Leaf::new("drill", LeafSource::Solid(drill)),
                ],
            ),
        ),
    ]
}

#[test]
fn every_leaf_in_its_own_form_is_where_the_judge_has_it() {
    for (name, scene) in scenes() {
        for limit in [LayerLimit::Nearest, LayerLimit::All] {
            let judged = judged(&scene, limit);
            assert!(judged.wrong_pixels == 0.0, "{name}, {limit:?}: {judged:?}");
            assert!(judged.near_edge_wrong < 2e-3 && judged.holes + judged.spill == 0, "{name}, {limit:?}: {judged:?}");
            assert!(
                judged.depth_px.unwrap() < 0.05 && judged.normal_deg.unwrap() < 0.5,
                "{name}, {limit:?}: {judged:?}"
            );
            if limit == LayerLimit::All {
                assert!(judged.layers_wrong < 5e-3, "{name}: {judged:?}");
            }
        }
    }
}

/// The layers of a scene whose exact leaves are found as `exact` says.
fn drawn(scene: &Scene, exact: ExactLeaves) -> LayerStack {
    let mut loaded = load(scene.clone(), &ReadOptions::default(), &NoProgress).unwrap();
    let camera = loaded.camera().unwrap();
    let converted = convert(&mut loaded, &camera, Density::default(), exact, &|_| ()).unwrap();
    let model = converted.classify().into_hybrid();
    LayerStack::collect(&model.frame(&camera, LayerLimit::All, 1))
}

fn pixels(stack: &LayerStack) -> impl Iterator<Item = &[crate::layers::Boundary]> {
    let (width, height) = (stack.camera.width, stack.camera.height);
    (0..width * height).map(move |i| stack.at(i % width, i / width))
}

#[test]
fn a_scan_and_the_solid_that_it_is_of_are_one() {
    let ball = || scanned("scan", sphere([0.0; 3], 1.0), 6_000);
    let solid = || Leaf::new("solid", LeafSource::Solid(sphere([0.0; 3], 1.0)));
    let small = |csg: &str| Scene { size: (96, 96), ..scene(csg, vec![ball(), solid()]) };
    let alone = drawn(&small("scan"), ExactLeaves::Crossed);
    for exact in [ExactLeaves::Crossed, ExactLeaves::Sampled] {
        for csg in ["scan - solid", "solid - scan"] {
            let left = pixels(&drawn(&small(csg), exact)).filter(|boundaries| !boundaries.is_empty()).count();
            assert_eq!(left, 0, "{csg}, {exact:?}");
        }
        for csg in ["scan | solid", "solid & scan"] {
            let both = drawn(&small(csg), exact);
            let what = |b: &crate::layers::Boundary| (b.leaf, b.body, b.facing);
            let differing =
                pixels(&alone).zip(pixels(&both)).filter(|(a, b)| !a.iter().map(what).eq(b.iter().map(what)));
            // Only on the silhouette, where a ray may meet one and not the other.
            assert!(differing.count() <= 12, "{csg}, {exact:?}");
        }
    }
}

#[test]
fn what_coincides_with_a_boundary_and_does_not_matter_shows_nothing() {
    let ball = || scanned("scan", sphere([0.0; 3], 1.0), 6_000);
    let solid = || Leaf::new("solid", LeafSource::Solid(sphere([0.0; 3], 1.0)));
    let other = || scanned("other", sphere([0.5, -0.7, 0.6], 0.8), 4_000);
    let small = |csg: &str| Scene { size: (96, 96), ..scene(csg, vec![ball(), solid(), other()]) };
    let alone = drawn(&small("scan"), ExactLeaves::Crossed);
    // Within the other the boundary is that of the one that is not with it, and the whole is the ball.
    for (csg, leaf) in [("(solid | other) & scan", 0), ("(scan | other) & solid", 1)] {
        let both = drawn(&small(csg), ExactLeaves::Crossed);
        let what = |b: &crate::layers::Boundary| b.facing;
        let differing = pixels(&alone).zip(pixels(&both)).filter(|(a, b)| !a.iter().map(what).eq(b.iter().map(what)));
        assert!(differing.count() <= 12, "{csg}");
        assert!(pixels(&both).flatten().filter(|b| b.leaf == leaf).count() > 1000, "{csg}");
    }
}

#[test]
fn a_pocket_that_is_flush_with_a_scanned_face_has_no_lid() {
    let block = Solid::Box { min: DVec3::new(-1.0, -1.0, -0.8), max: DVec3::new(1.0, 1.0, 0.4) };
    let pocket = Solid::Box { min: DVec3::new(-0.5, -0.6, 0.0), max: DVec3::new(0.5, 0.6, 0.4) };
    let leaves = |pocket| vec![scanned("scan", block.clone(), 30_000), pocket];
    for (how, pocket) in
        [("solid", Leaf::new("pocket", LeafSource::Solid(pocket.clone()))), ("mesh", meshed("pocket", &pocket))]
    {
        for exact in [ExactLeaves::Crossed, ExactLeaves::Sampled] {
            let scene = Scene { size: (128, 128), ..scene("scan - pocket", leaves(pocket.clone())) };
            let stack = drawn(&scene, exact);
            let (mut within, mut lids) = (0, 0);
            for (x, y) in (0..128).flat_map(|y| (0..128).map(move |x| (x, y))) {
                let ray = stack.camera.ray(glam::DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5));
                // Where the ray meets the face, a surfel's width within the pocket's outline.
                let p = ray.at((0.4 - ray.origin.z) / ray.dir.z);
                if p.x.abs() < 0.46 && p.y.abs() < 0.56 {
                    within += 1;
                    // The pocket's walls come up to the face too.
                    let is_lid = |b: &crate::layers::Boundary| {
                        b.normal.z.abs() > 0.9 && (ray.at(f64::from(b.depth)).z - 0.4).abs() < 0.02
                    };
                    lids += usize::from(stack.at(x, y).iter().any(is_lid));
                }
            }
            assert!(within > 500 && lids == 0, "{how}, {exact:?}: {lids} of {within}");
        }
    }
}

#[test]
fn exact_leaves_need_no_surfels_and_a_leaf_that_is_to_be_surfels_is_nothing_else() {
    let (_, mut scene) = scenes().swap_remove(0);
    let surfels = |scene: &Scene| {
        let (model, _) = model(scene);
        let counts: Vec<usize> = model.surfels().fields.iter().map(|field| field.cloud.len()).collect();
        (counts, model.surfels().fields[1].exact.is_some(), model.exact().map(|exact| exact.triangle_count()))
    };
    let (counts, is_exact, triangles) = surfels(&scene);
    assert!(counts[0] == 20_000 && counts[1] == 0 && is_exact && triangles.is_some());
    scene.represent("drill", Representation::Surfels).unwrap();
    let (counts, is_exact, triangles) = surfels(&scene);
    assert!(counts[0] == 20_000 && counts[1] > 100 && !is_exact && triangles.is_none());
}

#[test]
fn a_solid_as_a_mesh_is_within_the_error_of_the_solid() {
    let (_, mut scene) = scenes().swap_remove(5);
    scene.represent("drill", Representation::Mesh).unwrap();
    let (model, _) = model(&scene);
    assert!(model.exact().unwrap().triangle_count() > 40);
    let judged = judged(&scene, LayerLimit::Nearest);
    // Half a pixel of error puts no edge further off than that.
    assert!(judged.wrong_pixels == 0.0 && judged.depth_px.unwrap() < 0.5, "{judged:?}");
}

#[test]
fn samples_and_tiles_change_no_pixel() {
    let (_, scene) = scenes().swap_remove(1);
    let (model, camera) = model(&scene);
    let frame = model.frame(&camera, LayerLimit::Nearest, 4);
    let stack = LayerStack::collect(&frame);
    // A pixel's samples see what a picture of that sample alone sees: coverage as the mean over a picture 4 times as fine.
    let covered: u32 =
        (0..256 * 256).map(|i| stack.at(i % 256, i / 256).iter().map(|b| b.samples.count_ones()).sum::<u32>()).sum();
    let one = LayerStack::collect(&model.frame(&camera, LayerLimit::Nearest, 1));
    let covered_once = (0..256 * 256).filter(|&i| !one.at(i % 256, i / 256).is_empty()).count();
    assert!((f64::from(covered) / 4.0 / covered_once as f64 - 1.0).abs() < 2e-3);
    // The same bits for another cut of the picture.
    let rect = PixelRect { x0: 50, y0: 70, x1: 150, y1: 141 };
    let part = frame.draw(rect);
    for (x, y) in (rect.y0..rect.y1).flat_map(|y| (rect.x0..rect.x1).map(move |x| (x, y))) {
        let [a, b] = [part.at(x, y), stack.at(x, y)];
        let same = a.len() == b.len()
            && a.iter().zip(b).all(|(a, b)| (a.leaf, a.facing, a.samples) == (b.leaf, b.facing, b.samples));
        assert!(same, "({x}, {y}): {a:?} {b:?}");
    }
}

/// A box without its lid, as a solid: its picture is that of the box but for the rays through the hole.
#[test]
fn an_open_mesh_is_drawn_and_its_undecided_pixels_are_counted() {
    let block = Solid::Box { min: DVec3::new(-0.7, -0.7, -0.7), max: DVec3::new(0.7, 0.7, 0.7) };
    let closed = mesh_of(&block);
    let mut open = (*closed).clone();
    let is_lid = |t: &[u32; 3]| t.iter().all(|&v| closed.positions[v as usize].z > 0.0);
    open.triangles.retain(|t| !is_lid(t));
    assert_eq!(open.triangles.len(), 10);
    let ball = || scanned("scan", sphere([0.0, -0.7, 0.0], 0.5), 8_000);
    let with = |mesh: Arc<TriMesh>| scene("block - scan", vec![ball(), Leaf::new("block", LeafSource::Mesh(mesh))]);
    let (model, camera) = model(&with(Arc::new(open)));
    let drawn = LayerStack::collect(&model.frame(&camera, LayerLimit::All, 1));
    let truth = open_reference(&with(closed), LayerLimit::All).unwrap()(&camera).unwrap();
    let [(leaf, undecided)] = model.undecided()[..] else { panic!("one leaf is open") };
    // Nor do others count.
    let aside = LayerStack::collect(&model.frame_aside(&camera, LayerLimit::All, 1));
    assert_eq!(model.undecided(), [(leaf, undecided)]);
    assert!((0..256).all(|y| (0..256).all(|x| aside.at(x, y) == drawn.at(x, y))));
    // Rays that pass the lid, from above, are those that do not alternate.
    let passes_lid = |x: u32, y: u32| {
        truth.at(x, y).iter().any(|b| {
            b.leaf == 1 && b.normal.z.abs() > 0.99 && {
                let ray = camera.ray(glam::DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5));
                ray.at(f64::from(b.depth)).z > 0.6
            }
        })
    };
    let (mut through, mut differ) = (0, 0);
    for (x, y) in (0..256).flat_map(|y| (0..256).map(move |x| (x, y))) {
        if passes_lid(x, y) {
            through += 1;
        } else if drawn.at(x, y).first().map(|b| b.leaf) != truth.at(x, y).first().map(|b| b.leaf) {
            differ += 1;
        }
    }
    assert_eq!(leaf, LeafId(1));
    assert!(through > 1000 && undecided.abs_diff(through) < 300, "{undecided} of {through}");
    assert!(differ < 60, "{differ}");
}
