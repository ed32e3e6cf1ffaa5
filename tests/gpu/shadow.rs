//! Shadows on the GPU against those of the CPU, and against light that has nothing in its way.

use std::path::Path;

use glam::DVec3;
use surfcut::blister::MeshFrame;
use surfcut::composite::light_grid::LightGrid;
use surfcut::composite::light_map::LightMap;
use surfcut::composite::lighting::towards;
use surfcut::composite::merge::Contents;
use surfcut::composite::{self, Leaves, Look, Picture, shadow};
use surfcut::formats::{NoProgress, ReadOptions};
use surfcut::gpu::blister::{Classifier, GpuMeshFrame};
use surfcut::gpu::layers::{GpuLayerSource, Uploaded};
use surfcut::gpu::{Gpu, GpuError, composite as twin};
use surfcut::hybrid::HybridModel;
use surfcut::layers::{LayerLimit, LayerSource};
use surfcut::pipeline::{self, Density, ExactLeaves, convert};
use surfcut::scene::style::{Style, StyleKind};
use surfcut::scene::{Light, LoadedScene, Scene, load, toml_file};
use surfcut::space::{Camera, Lens, Motion};

use crate::Test;

pub const TESTS: &[Test] = &[
    ("shadows_are_the_cpus", shadows_are_the_cpus),
    ("shadows_of_leaves_that_the_gpu_draws_are_the_cpus", shadows_of_leaves_that_the_gpu_draws_are_the_cpus),
    ("shadows_seen_from_far_away_are_the_cpus", shadows_seen_from_far_away_are_the_cpus),
    ("the_comparison_of_shadows_can_fail", the_comparison_of_shadows_can_fail),
];

/// Pixels on a side.
const SIDE: u32 = 128;

fn loaded(name: &str) -> LoadedScene {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("data/{name}.toml"));
    let light = Light { towards: DVec3::new(0.6, -0.7, 1.0), in_world: true, ambient: 0.2 };
    let scene = Scene { size: (SIDE, SIDE), light, ..toml_file::read(&path).unwrap() };
    load(scene, &ReadOptions::default(), &NoProgress).unwrap()
}

fn hybrid(loaded: &mut LoadedScene) -> HybridModel {
    let camera = loaded.camera().unwrap();
    convert(loaded, &camera, Density::default(), ExactLeaves::Crossed, &|_| ()).unwrap().classify().into_hybrid()
}

fn grid(loaded: &LoadedScene, light: &Light) -> LightGrid {
    let camera = loaded.camera().unwrap();
    LightGrid::new(towards(light, &camera), &loaded.drawn_within(|_| Motion::REST))
}

fn look(loaded: &LoadedScene) -> Look {
    Look { light: loaded.scene.light, background: [1.0; 4] }
}

fn on_cpu(loaded: &LoadedScene, model: &HybridModel, style: &Style, samples: u32) -> Picture {
    let camera = loaded.camera().unwrap();
    let source = model.frame(&camera, LayerLimit::All, samples);
    let mut map = LightMap::new(grid(loaded, &loaded.scene.light), style.opacity_factor());
    let draw = |light: &Camera| -> Option<Box<dyn LayerSource + '_>> {
        Some(Box::new(model.frame(light, LayerLimit::All, 1)))
    };
    let shadows = shadow::Shadows::new(&mut map, style.shadows, &draw, &|work| work());
    let (leaves, contents) = (Leaves::default(), Contents::default());
    composite::styled_with(&source, &look(loaded), style, leaves, &contents, Some(&shadows), &|| ())
}

/// The picture of `source` on the GPU, with the shadows that `light` throws of what `draw` draws.
fn on_gpu<'a>(
    gpu: &Gpu,
    loaded: &LoadedScene,
    source: &dyn GpuLayerSource,
    style: &Style,
    light: &Light,
    draw: &dyn Fn(&Camera) -> Box<dyn GpuLayerSource + 'a>,
) -> Picture {
    let draw = |camera: &Camera| -> Result<Option<Box<dyn GpuLayerSource + '_>>, GpuError> { Ok(Some(draw(camera))) };
    let shadows = twin::shadow::Shadows::new(grid(loaded, light), style.opacity_factor(), style.shadows, &draw);
    gpu.checked(|| twin::styled_with(gpu, source, &look(loaded), style, Leaves::default(), Some(&shadows))).unwrap()
}

/// Pixels that differ by more than two steps of an 8-bit picture: all, and those off every edge of the second picture.
fn different(a: &Picture, b: &Picture) -> (usize, usize) {
    const MOST: f32 = 2.0 / 255.0;
    let off = |a: &[f32; 4], b: &[f32; 4]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    let (width, height) = (b.width as i32, b.height as i32);
    let at = |x: i32, y: i32| &b.pixels[(y * width + x) as usize];
    let (mut all, mut flat) = (0, 0);
    for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
        if off(&a.pixels[(y * width + x) as usize], at(x, y)) <= MOST {
            continue;
        }
        all += 1;
        let around = (y - 1..=y + 1).flat_map(|y| (x - 1..=x + 1).map(move |x| (x, y)));
        let mut within = around.filter(|&(x, y)| x >= 0 && y >= 0 && x < width && y < height);
        flat += usize::from(!within.any(|(nx, ny)| off(at(nx, ny), at(x, y)) > MOST));
    }
    (all, flat)
}

/// The share of pixels that may differ.
const MOST_DIFFERENT: f64 = 0.001;

fn assert_same(got: &Picture, wanted: &Picture, what: &str) {
    let (all, flat) = different(got, wanted);
    println!("{what}: {all} differ, {flat} off an edge");
    let most = (MOST_DIFFERENT * wanted.pixels.len() as f64) as usize;
    assert!(all <= most && flat == 0, "{what}: {all} pixels differ, {flat} of them off an edge");
}

fn shadows_are_the_cpus(gpu: &'static Gpu) {
    for (name, samples) in [("widget", 1), ("widget", 4), ("drilled_bone", 1), ("bearing", 1)] {
        let mut loaded = loaded(name);
        let model = hybrid(&mut loaded);
        let camera = loaded.camera().unwrap();
        for kind in [StyleKind::Shaded, StyleKind::Transparent, StyleKind::EdgeTransparent, StyleKind::Sketchy] {
            let style = Style { shadows: 0.9, ..Style::of(kind) };
            let wanted = on_cpu(&loaded, &model, &style, samples);
            let source = Uploaded(model.frame(&camera, LayerLimit::All, samples));
            let draw = |light: &Camera| -> Box<dyn GpuLayerSource + '_> {
                Box::new(Uploaded(model.frame(light, LayerLimit::All, 1)))
            };
            let got = on_gpu(gpu, &loaded, &source, &style, &loaded.scene.light, &draw);
            assert_same(&got, &wanted, &format!("{name}, {}, {samples} samples", kind.name()));
        }
    }
}

fn shadows_of_leaves_that_the_gpu_draws_are_the_cpus(gpu: &'static Gpu) {
    let mut loaded = loaded("widget");
    let camera = loaded.camera().unwrap();
    let meshes = pipeline::mesh_model(&loaded, &camera, Density::default()).unwrap();
    let model = hybrid(&mut loaded);
    let style = Style { shadows: 1.0, ..Style::default() };
    let wanted = on_cpu(&loaded, &model, &style, 1);
    let frame = |camera: &Camera| {
        let frame = MeshFrame::new(&meshes, camera.clone(), LayerLimit::Nearest, 1);
        GpuMeshFrame::new(frame, Classifier::default())
    };
    let draw = |light: &Camera| -> Box<dyn GpuLayerSource + '_> { Box::new(frame(light)) };
    let got = on_gpu(gpu, &loaded, &frame(&camera), &style, &loaded.scene.light, &draw);
    assert_same(&got, &wanted, "drawn by the GPU");
}

fn shadows_seen_from_far_away_are_the_cpus(gpu: &'static Gpu) {
    let mut loaded = loaded("widget");
    let spec = loaded.scene.camera.as_mut().unwrap();
    (spec.eye, spec.target, spec.lens) = (DVec3::new(60_000.0, -50_000.0, 62_000.0), DVec3::ZERO, Lens::Height(3.0));
    let model = hybrid(&mut loaded);
    let camera = loaded.camera().unwrap();
    let style = Style { shadows: 1.0, ..Style::default() };
    let wanted = on_cpu(&loaded, &model, &style, 1);
    let unshadowed = on_cpu(&loaded, &model, &Style { shadows: 0.0, ..style }, 1);
    assert!(different(&unshadowed, &wanted).0 > 500);
    let source = Uploaded(model.frame(&camera, LayerLimit::All, 1));
    let draw =
        |light: &Camera| -> Box<dyn GpuLayerSource + '_> { Box::new(Uploaded(model.frame(light, LayerLimit::All, 1))) };
    let got = on_gpu(gpu, &loaded, &source, &style, &loaded.scene.light, &draw);
    assert_same(&got, &wanted, "from far away");
}

fn the_comparison_of_shadows_can_fail(gpu: &'static Gpu) {
    let mut loaded = loaded("widget");
    let model = hybrid(&mut loaded);
    let camera = loaded.camera().unwrap();
    let style = Style { shadows: 1.0, ..Style::default() };
    let wanted = on_cpu(&loaded, &model, &style, 1);
    let source = Uploaded(model.frame(&camera, LayerLimit::All, 1));
    let draw =
        |light: &Camera| -> Box<dyn GpuLayerSource + '_> { Box::new(Uploaded(model.frame(light, LayerLimit::All, 1))) };
    // Two degrees beside.
    let beside = Light { towards: loaded.scene.light.towards + DVec3::new(0.0, 0.0, 0.08), ..loaded.scene.light };
    let got = on_gpu(gpu, &loaded, &source, &style, &beside, &draw);
    let (all, flat) = different(&got, &wanted);
    assert!(all as f64 > MOST_DIFFERENT * wanted.pixels.len() as f64 && flat > 0, "{all} {flat}");
}
