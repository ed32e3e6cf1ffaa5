//! The stages of a picture, one by one, on the scan of `data/` and on a million points: load, convert, classify, partners,
//! frame. `cargo bench` runs all; `cargo bench -- femoral` those whose name matches.

use std::hint::black_box;
use std::path::Path;
use std::sync::Arc;

use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use glam::DVec3;
use surfcut::classify::partners::{Among, PartnerLists};
use surfcut::composite::{Look, shaded};
use surfcut::csg::{LeafId, Tree};
use surfcut::formats::{NoProgress, ReadOptions};
use surfcut::geometry::Solid;
use surfcut::layers::LayerLimit;
use surfcut::measure::simulate::{ScanOptions, scan};
use surfcut::pipeline::{Density, ExactLeaves, convert};
use surfcut::scene::{Leaf, LeafSource, LoadedScene, Scene, load, toml_file};
use surfcut::splat::{Frame, SplatSettings};

/// A sphere of a million points minus an exact drill.
fn million() -> Scene {
    let solid = Solid::Sphere { centre: DVec3::ZERO, radius: 20.0 };
    let cloud = Arc::new(scan(&solid, &ScanOptions::regular(1_000_000, 1)).expect("a sphere can be scanned"));
    let drill = Solid::Cylinder { from: DVec3::new(8.0, -40.0, 4.0), to: DVec3::new(6.0, 40.0, 6.0), radius: 5.0 };
    let leaves = vec![Leaf::new("head", LeafSource::Cloud(cloud)), Leaf::new("drill", LeafSource::Solid(drill))];
    let tree = Tree::minus(Tree::leaf(LeafId(0)), Tree::leaf(LeafId(1)));
    Scene { size: (1024, 1024), ..Scene::new(leaves, tree) }
}

fn loaded(scene: Scene) -> LoadedScene {
    load(scene, &ReadOptions::default(), &NoProgress).expect("the scene loads")
}

fn stages(c: &mut Criterion, name: &str, scene: &Scene) {
    let mut group = c.benchmark_group(name);
    group.sample_size(10);
    group.bench_function("load", |b| b.iter_batched(|| scene.clone(), loaded, BatchSize::PerIteration));
    let ready = loaded(scene.clone());
    let camera = ready.camera().expect("the scene has a camera");
    let converted = |mut scene: LoadedScene| {
        convert(&mut scene, &camera, Density::default(), ExactLeaves::Sampled, &|_| ()).expect("the scene converts")
    };
    group.bench_function("convert", |b| b.iter_batched(|| ready.clone(), converted, BatchSize::PerIteration));
    group.bench_function("classify", |b| {
        b.iter_batched(|| converted(ready.clone()), |c| c.classify(), BatchSize::PerIteration);
    });
    let model = converted(ready.clone()).classify().model;
    group.bench_function("partners", |b| b.iter(|| PartnerLists::in_space(black_box(&model), Among::NearLeaves)));
    let look = Look { light: ready.scene.light, background: ready.scene.background_for(&ready.scene.style) };
    for (limit, what) in [(LayerLimit::Nearest, "frame, nearest"), (LayerLimit::All, "frame, all boundaries")] {
        group.bench_function(what, |b| {
            b.iter(|| {
                let frame = Frame::new(&model, camera.clone(), limit, 1, SplatSettings::default(), None);
                shaded(&frame, &look, &|| ())
            });
        });
    }
    group.finish();
}

fn pipeline(c: &mut Criterion) {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("data");
    for name in ["femoral_head", "five_spheres_minus", "mesh_minus_mesh"] {
        let scene = toml_file::read(&data.join(format!("{name}.toml"))).expect("a scene of data/ parses");
        stages(c, name, &scene);
    }
    stages(c, "million", &million());
}

criterion_group!(benches, pipeline);
criterion_main!(benches);
