//! The mesh pipeline on the GPU against that on the CPU, layer by layer.

use std::path::Path;

use surfcut::blister::{MeshFrame, MeshModel};
use surfcut::formats::NoProgress;
use surfcut::gpu::blister::{Classifier, GpuMeshFrame};
use surfcut::gpu::layers::{GpuLayerSource, in_parts};
use surfcut::gpu::{Gpu, GpuError};
use surfcut::layers::{LayerLimit, LayerStack, LayerTile};
use surfcut::pipeline::{Density, mesh_model};
use surfcut::scene::represent::Representation;
use surfcut::scene::{LeafGeometry, LoadedScene, Scene, load, toml_file};
use surfcut::space::{Camera, PixelRect};

use crate::Test;

pub const TESTS: &[Test] = &[
    ("meshes_have_the_layers_of_the_cpu", meshes_have_the_layers_of_the_cpu),
    ("solids_have_the_layers_of_the_cpu", solids_have_the_layers_of_the_cpu),
    ("several_samples_have_the_layers_of_the_cpu", several_samples_have_the_layers_of_the_cpu),
    ("a_list_that_is_too_short_grows", a_list_that_is_too_short_grows),
];

fn loaded(name: &str, size: (u32, u32)) -> LoadedScene {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("data/{name}.toml"));
    let scene = Scene { size, ..toml_file::read(&path).unwrap() };
    load(scene, &Default::default(), &NoProgress).unwrap()
}

/// The scene with every bounded solid as a mesh.
fn as_meshes(mut loaded: LoadedScene) -> LoadedScene {
    let names: Vec<String> = loaded.scene.leaves.iter().map(|leaf| leaf.name.clone()).collect();
    for (name, geometry) in names.iter().zip(loaded.geometry.clone()) {
        if matches!(&geometry, LeafGeometry::Solid(solid) if solid.bounds().is_some()) {
            loaded.represent(name, Representation::Mesh).unwrap();
        }
    }
    loaded
}

fn model(loaded: &LoadedScene) -> (MeshModel, Camera) {
    let camera = loaded.camera().unwrap();
    (mesh_model(loaded, &camera, Density::default()).unwrap(), camera)
}

fn whole(camera: &Camera) -> PixelRect {
    PixelRect { x0: 0, y0: 0, x1: camera.width, y1: camera.height }
}

fn drawn(gpu: &Gpu, frame: &GpuMeshFrame) -> Vec<LayerTile> {
    let mut tiles = Vec::new();
    let mut draw = |rect| {
        tiles.push(frame.draw(gpu, rect)?.download(gpu)?);
        Ok::<_, GpuError>(())
    };
    gpu.checked(|| in_parts(whole(frame.camera()), &mut draw)).unwrap();
    tiles
}

/// Pixels whose lists differ, of how many.
fn differing(cpu: &LayerStack, gpu: &[LayerTile]) -> (usize, usize) {
    let (mut wrong, mut all) = (0, 0);
    for tile in gpu {
        for y in tile.rect.y0..tile.rect.y1 {
            for x in tile.rect.x0..tile.rect.x1 {
                let (a, b) = (cpu.at(x, y), tile.at(x, y));
                let same = a.len() == b.len()
                    && a.iter().zip(b).all(|(a, b)| {
                        (a.leaf, a.body, a.facing, a.samples) == (b.leaf, b.body, b.facing, b.samples)
                            && (a.depth - b.depth).abs() <= 1e-5 * a.depth
                            && a.normal.distance(b.normal) < 1e-3
                            && a.colour.iter().zip(b.colour).all(|(a, b)| (a - b).abs() < 1e-3)
                    });
                wrong += usize::from(!same);
                all += usize::from(!a.is_empty() || !b.is_empty());
            }
        }
    }
    (wrong, all)
}

/// Holds the GPU's layers against the CPU's.
fn check(gpu: &Gpu, name: &str, loaded: &LoadedScene, samples: u32) {
    let (model, camera) = model(loaded);
    for limit in [LayerLimit::Nearest, LayerLimit::All] {
        let frame = || MeshFrame::new(&model, camera.clone(), limit, samples);
        let cpu = LayerStack::collect(&frame());
        for classifier in Classifier::ALL {
            let of_gpu = GpuMeshFrame::new(gpu, frame(), classifier).unwrap();
            let (wrong, all) = differing(&cpu, &drawn(gpu, &of_gpu));
            let what = format!("{name}, {limit:?}, {}", classifier.name());
            assert!(all > 1000, "{what}: only {all} pixels show anything");
            assert!(wrong as f64 <= 0.001 * all as f64, "{what}: {wrong} of {all} pixels differ");
        }
    }
}

fn meshes_have_the_layers_of_the_cpu(gpu: &'static Gpu) {
    for name in ["widget", "spanner", "overlap", "bearing", "mesh_minus_mesh"] {
        check(gpu, name, &as_meshes(loaded(name, (200, 150))), 1);
    }
}

fn solids_have_the_layers_of_the_cpu(gpu: &'static Gpu) {
    for name in ["widget", "spanner", "overlap", "bearing"] {
        check(gpu, name, &loaded(name, (120, 90)), 1);
    }
}

fn several_samples_have_the_layers_of_the_cpu(gpu: &'static Gpu) {
    check(gpu, "widget", &as_meshes(loaded("widget", (120, 90))), 4);
}

fn a_list_that_is_too_short_grows(gpu: &'static Gpu) {
    let (model, camera) = model(&as_meshes(loaded("widget", (100, 100))));
    let frame = || MeshFrame::new(&model, camera.clone(), LayerLimit::All, 1);
    let cpu = LayerStack::collect(&frame());
    for classifier in Classifier::ALL {
        let short = GpuMeshFrame::new(gpu, frame(), classifier).unwrap().with_first_length(1);
        let (wrong, all) = differing(&cpu, &drawn(gpu, &short));
        assert!(wrong * 1000 <= all, "{}: {wrong} of {all}", classifier.name());
    }
}
