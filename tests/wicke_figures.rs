//! The figures of Wicke et al. 2004, drawn and judged by the reference renderer: named for their numbers.
//!
//! Figures 3 to 6 are about single surfels and pixels, and are tested where those are (`src/classify/inside.rs`,
//! `src/splat/figure_tests.rs`).

use surfcut::layers::LayerLimit;
use surfcut::measure::open::{open_reference, open_surfels};
use surfcut::measure::outline::zoomed_onto_cut;
use surfcut::measure::scenes::{Case, accuracy_cases, figure_2};
use surfcut::measure::{Comparison, compare};
use surfcut::splat::{Inside, SplatSettings};

const SIDE: u32 = 192;

/// The case at one magnification onto its cut, under each of the settings.
fn judged<const N: usize>(case: &Case, zoom: f64, settings: [SplatSettings; N]) -> [Comparison; N] {
    let mut scene = case.scene().unwrap();
    scene.size = (SIDE, SIDE);
    let camera = case.camera.camera(scene.size).unwrap();
    let truth = open_reference(&scene, LayerLimit::Nearest).unwrap();
    let camera = zoomed_onto_cut(&camera, zoom, &mut |camera| truth(camera)).unwrap().unwrap();
    let truth = truth(&camera).unwrap();
    settings.map(|settings| {
        let picture = open_surfels(&scene, LayerLimit::Nearest, settings).unwrap()(&camera).unwrap();
        compare(&picture, &truth).unwrap()
    })
}

fn case(name: &str) -> Case {
    accuracy_cases().into_iter().find(|case| case.name == name).unwrap()
}

/// (b), (c): the edge between two differently sampled surfaces is jagged where only the closest surfel is asked, less so
/// with the two closest; on curved surfels it is the true one. Clipped on surfaces, so that nothing but the inside test
/// differs.
#[test]
fn figure_2_two_closest_surfels_make_straighter_edges_than_one() {
    let settings = [Inside::Nearest, Inside::TwoNearest, Inside::Curved]
        .map(|inside| SplatSettings { inside, ..SplatSettings::default() });
    let [one, two, curved] = judged(&figure_2(), 1.0, settings).map(|c| c.edge_px.unwrap());
    println!("edge_px: nearest {one:.3}, two nearest {two:.3}, curved {curved:.3}");
    assert!(one > 0.1 && two < 0.85 * one && curved < 0.2 * two, "{one} {two} {curved}");
}

/// (a) and (b): the spheres just touch, and what is left between them is as thin as can be.
#[test]
fn figure_7_five_spheres_united_and_subtracted() {
    for name in ["five_spheres_union", "five_spheres_minus"] {
        for zoom in [1.0, 10.0, 100.0] {
            let [ours, paper] = judged(&case(name), zoom, [SplatSettings::default(), SplatSettings::PAPER]);
            println!("{name} {zoom}x: ours {:?}, paper {:?}", ours.edge_px, paper.edge_px);
            assert!(
                ours.edge_px.unwrap() <= 0.01 && ours.wrong_pixels == 0.0 && ours.holes == 0,
                "{name} {zoom}: {ours:?}"
            );
            assert!(paper.edge_px.unwrap() > 1.0, "{name} {zoom}: {paper:?}");
        }
    }
}

/// (a): 20 half-spaces of one surfel each. Flat faces are flat disks, so the paper's way is right too.
#[test]
fn figure_8a_an_icosahedron_of_twenty_surfels() {
    for zoom in [1.0, 10.0, 100.0] {
        for c in judged(&case("icosahedron"), zoom, [SplatSettings::default(), SplatSettings::PAPER]) {
            assert!(c.edge_px.unwrap() <= 0.02 && c.holes == 0, "{zoom}: {c:?}");
        }
    }
}

/// (c): faces of one, 25 and 900 surfels.
#[test]
fn figure_8c_a_cube_of_differently_sampled_faces() {
    for zoom in [1.0, 10.0, 100.0] {
        for c in judged(&case("cube_1_25_900"), zoom, [SplatSettings::default(), SplatSettings::PAPER]) {
            assert!(c.edge_px.unwrap() <= 0.02 && c.holes == 0, "{zoom}: {c:?}");
        }
    }
}

/// (a), and (b) the corner where three surfaces meet, magnified: the edges stay sharp, and are where they are.
#[test]
fn figure_9_a_femoral_head_minus_two_spheres_and_its_corner() {
    let case = case("femoral_head_22k");
    let mut scene = case.scene().unwrap();
    scene.size = (SIDE, SIDE);
    let camera = case.camera.camera(scene.size).unwrap();
    let truth = open_reference(&scene, LayerLimit::Nearest).unwrap();
    let ours = open_surfels(&scene, LayerLimit::Nearest, SplatSettings::default()).unwrap();
    // The corner: the pixel about which all three leaves are seen within two pixels; found again after each tenfold zoom.
    let mut view = camera.clone();
    for zoom in [10.0, 100.0, 1000.0] {
        let stack = truth(&view).unwrap();
        let seen = |x: u32, y: u32| stack.at(x, y).first().map(|b| (b.leaf, b.depth));
        let corner = (2..SIDE - 2).flat_map(|y| (2..SIDE - 2).map(move |x| (x, y))).find(|&(x, y)| {
            let mut leaves: Vec<u32> =
                (y - 2..=y + 2).flat_map(|v| (x - 2..=x + 2).filter_map(move |u| seen(u, v))).map(|b| b.0).collect();
            leaves.sort_unstable();
            leaves.dedup();
            leaves.len() == 3
        });
        let (x, y) = corner.expect("three surfaces meet in view");
        let px = glam::DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
        let target = view.ray(px).at(f64::from(seen(x, y).unwrap().1));
        view = camera.zoomed(target, zoom).unwrap();
        let c = compare(&ours(&view).unwrap(), &truth(&view).unwrap()).unwrap();
        println!("corner at {zoom}x: {c:?}");
        assert!(c.edge_px.unwrap() <= 0.05 && c.wrong_pixels == 0.0 && c.holes == 0, "{zoom}: {c:?}");
        assert!(c.edge_px_max.unwrap() < 3.0, "{zoom}: {c:?}");
    }
    let [whole] = judged(&case, 1.0, [SplatSettings::default()]);
    assert!(whole.edge_px.unwrap() <= 0.02 && whole.holes == 0, "{whole:?}");
}
