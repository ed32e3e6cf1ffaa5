//! The styles' pictures against the measures of `examples/styles.rs`, small.

use std::path::Path;

use surfcut::measure::styles::{
    fewer_layers, layers_against_truth, lines_of_scan, noisy_scan, sketch_coherence, surfels_against_meshes,
};
use surfcut::scene::style::StyleKind;
use surfcut::scene::{Scene, toml_file};

fn scene(name: &str, size: (u32, u32)) -> Scene {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("data/{name}.toml"));
    Scene { size, ..toml_file::read(&path).unwrap() }
}

#[test]
fn layers_of_every_pipeline_are_the_references() {
    for name in ["widget", "overlap", "five_spheres_minus"] {
        for (pipeline, found) in layers_against_truth(&scene(name, (160, 160))).unwrap() {
            assert!(found.boundaries > 5_000, "{name}: {} boundaries off edges", found.boundaries);
            let share = found.wrong as f64 / found.boundaries as f64;
            assert!(share <= 0.001, "{name}, {pipeline}: {} of {} are wrong", found.wrong, found.boundaries);
        }
    }
}

#[test]
fn surfels_and_triangles_make_one_picture() {
    let found = surfels_against_meshes(&scene("widget", (192, 192))).unwrap();
    assert!(found.shaded >= 0.98 && found.transparent >= 0.98 && found.lines >= 0.99, "{found:?}");
}

#[test]
fn lines_of_a_noisy_scan_are_true() {
    let found = lines_of_scan(&noisy_scan(0.1, 12_000, (256, 256)).unwrap(), Some(1)).unwrap();
    assert!(found.precision >= 0.9 && found.recall >= 0.85, "{} and {}", found.precision, found.recall);
    // The measure can fail: noise of many spacings leaves no lines that are true.
    let found = lines_of_scan(&noisy_scan(2.0, 12_000, (256, 256)).unwrap(), Some(1)).unwrap();
    assert!(found.precision < 0.9, "{}", found.precision);
}

#[test]
fn the_spanner_needs_three_layers() {
    let scene = scene("spanner", (480, 250));
    let enough = fewer_layers(&scene, StyleKind::Blueprint, 3, 4).unwrap();
    let few = fewer_layers(&scene, StyleKind::Blueprint, 2, 4).unwrap();
    assert!(enough >= 0.97 && few < enough, "{enough} with three layers, {few} with two");
}

#[test]
fn a_sketch_moves_with_the_scene() {
    let found = sketch_coherence(&scene("widget", (256, 256))).unwrap();
    assert!(found.within_a_pixel > 0.97, "{found:?}");
}
