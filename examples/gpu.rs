//! Measures the ways in which the GPU classifies meshes, against each other and against the CPU: what a frame takes, how many passes
//! and bytes it is, and at how many pixels it differs from the CPU's. Prints the tables of `docs/measurements.md`, *The GPU*.
//!
//! ```text
//! cargo run --release --example gpu -- data/widget.toml scenes/grid10.tree.json   # these scenes
//! cargo run --release --example gpu -- --size 1024 --views 8 SCENE…               # larger, over eight views around it
//! cargo run --release --example gpu -- --all SCENE…                               # all boundaries, not only the nearest
//! ```
//!
//! Times are milliseconds of processor time over all threads, medians of repeats; on a software adapter that is all there is to a
//! frame, on hardware it is what is left to the processor.

use std::cell::Cell;
use std::path::Path;
use std::rc::Rc;

use anyhow::{Context, bail};
use glam::DQuat;
use surfcut::blister::{MeshFrame, MeshModel};
use surfcut::formats::NoProgress;
use surfcut::gpu::blister::{Classifier, GpuMeshFrame, Peeling};
use surfcut::gpu::layers::collect;
use surfcut::gpu::{Gpu, GpuLayerSource};
use surfcut::layers::{LayerLimit, LayerStack};
use surfcut::measure::suite::short;
use surfcut::output::resources::cpu_ms;
use surfcut::pipeline::{Density, mesh_model};
use surfcut::scene::represent::Representation;
use surfcut::scene::{LeafGeometry, LoadedScene, Scene, load, toml_file, tree_json};
use surfcut::space::{Camera, PixelRect};

/// Frames a figure is the median of.
const REPEATS: usize = 5;

fn main() -> anyhow::Result<()> {
    let mut side = 512;
    let mut views = 1;
    let mut limit = LayerLimit::Nearest;
    let mut scenes = Vec::new();
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        let mut number = || words.next().and_then(|text| text.parse::<u32>().ok()).context("a number is missing");
        match word.as_str() {
            "--size" => side = number()?,
            "--views" => views = number()?,
            "--all" => limit = LayerLimit::All,
            _ => scenes.push(word),
        }
    }
    if scenes.is_empty() {
        bail!("name scenes: .toml or .tree.json");
    }
    let gpu = Gpu::open(None)?;
    println!("{}, {side} x {side}, {views} views\n", gpu.adapter().name);
    println!(
        "| scene | triangles | way | prepare ms | draw ms | passes | draws | triangles drawn | kernels | MB up | MB down | settled pixels passed by | layers without a test | pixels that differ |"
    );
    println!("| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |");
    for name in &scenes {
        let loaded = loaded(Path::new(name), side)?;
        let camera = loaded.camera()?;
        let model = mesh_model(&loaded, &camera, Density::default())?;
        let cameras: Vec<Camera> = (0..views).map(|view| turned(&loaded, &camera, view, views)).collect();
        let name = Path::new(name)
            .file_name()
            .map(|name| name.to_string_lossy().replace(".tree.json", "").replace(".toml", ""));
        let name = name.unwrap_or_default();
        let chart = Chart { gpu: &gpu, name: &name, model: &model, cameras: &cameras, limit };
        chart.cpu_row();
        for classifier in Classifier::ALL {
            chart.row(classifier, "", |frame| frame)?;
        }
        chart.row(Classifier::Running, ", no bounds", |frame| frame.bounded(false))?;
        chart.row(Classifier::Parity, ", every layer tested", |frame| frame.short(false))?;
    }
    Ok(())
}

/// The scene with its bounded solids as meshes.
fn loaded(path: &Path, side: u32) -> anyhow::Result<LoadedScene> {
    let scene = if tree_json::is_tree_file(path) { tree_json::read(path)? } else { toml_file::read(path)? };
    let mut loaded = load(Scene { size: (side, side), ..scene }, &Default::default(), &NoProgress)?;
    for leaf in 0..loaded.scene.leaves.len() {
        if matches!(&loaded.geometry[leaf], LeafGeometry::Solid(solid) if solid.bounds().is_some()) {
            let name = loaded.scene.leaves[leaf].name.clone();
            loaded.represent(&name, Representation::Mesh)?;
        }
    }
    Ok(loaded)
}

/// The camera turned about the scene's target, to the `view`th of `views`.
fn turned(loaded: &LoadedScene, camera: &Camera, view: u32, views: u32) -> Camera {
    let turn = DQuat::from_axis_angle(-camera.down, std::f64::consts::TAU * f64::from(view) / f64::from(views));
    let centre = loaded.camera_spec().target;
    Camera {
        eye: centre + turn * (camera.eye - centre),
        right: turn * camera.right,
        down: turn * camera.down,
        forward: turn * camera.forward,
        ..camera.clone()
    }
}

fn median(mut figures: Vec<f64>) -> f64 {
    figures.sort_by(f64::total_cmp);
    figures[figures.len() / 2]
}

/// What the rows of one scene have in common.
struct Chart<'c> {
    gpu: &'c Gpu,
    name: &'c str,
    model: &'c MeshModel,
    cameras: &'c [Camera],
    limit: LayerLimit,
}

impl Chart<'_> {
    fn frame(&self, camera: &Camera) -> MeshFrame<'_> {
        MeshFrame::new(self.model, camera.clone(), self.limit, 1)
    }

    fn cpu_row(&self) {
        let mut times = Vec::new();
        for _ in 0..REPEATS {
            for camera in self.cameras {
                let start = cpu_ms();
                std::hint::black_box(LayerStack::collect(&self.frame(camera)));
                times.push(cpu_ms() - start);
            }
        }
        let (name, triangles) = (self.name, self.model.triangle_count());
        println!("| {name} | {triangles} | CPU | | {} | | | | | | | | | |", short(median(times)));
    }

    /// One way of classifying, set as `set` does; `note` says how.
    fn row(
        &self,
        classifier: Classifier,
        note: &str,
        set: impl Fn(GpuMeshFrame<'_>) -> GpuMeshFrame<'_>,
    ) -> anyhow::Result<()> {
        let Self { gpu, name, cameras, .. } = *self;
        let (mut prepare, mut draw) = (Vec::new(), Vec::new());
        let mut peeling = Peeling::default();
        let mut is_bounded = true;
        let (mut differing, mut covered) = (0, 0);
        let mut work = surfcut::gpu::device::Work::default();
        // Lists are as long as the frame before needed.
        let length = Rc::new(Cell::new(0));
        for repeat in 0..=REPEATS {
            for camera in cameras {
                let frame = self.frame(camera);
                gpu.take_work();
                let start = cpu_ms();
                let frame = set(GpuMeshFrame::new(frame, classifier)).with_length(Rc::clone(&length));
                let whole = PixelRect { x0: 0, y0: 0, x1: camera.width, y1: camera.height };
                frame.upload(gpu, whole, 0)?;
                gpu.wait()?;
                let prepared = cpu_ms();
                let layers = gpu.checked(|| frame.draw(gpu, whole))?;
                gpu.wait()?;
                if repeat > 0 {
                    prepare.push(prepared - start);
                    draw.push(cpu_ms() - prepared);
                    continue;
                }
                // The first round warms up, and tells what it draws.
                let own = gpu.take_work();
                work = surfcut::gpu::device::Work {
                    passes: work.passes + own.passes,
                    draws: work.draws + own.draws,
                    triangles: work.triangles + own.triangles,
                    dispatches: work.dispatches + own.dispatches,
                    uploaded: work.uploaded + own.uploaded,
                    downloaded: work.downloaded + own.downloaded,
                };
                peeling.passes += frame.peeling().passes;
                peeling.rejected += frame.peeling().rejected;
                peeling.untested += frame.peeling().untested;
                is_bounded = frame.is_bounded();
                drop(layers);
                let cpu = LayerStack::collect(&self.frame(camera));
                let of_gpu = gpu.checked(|| collect(gpu, &frame))?;
                for (x, y) in (0..camera.height).flat_map(|y| (0..camera.width).map(move |x| (x, y))) {
                    let (a, b) = (cpu.at(x, y), of_gpu.at(x, y));
                    let same = a.len() == b.len()
                        && a.iter().zip(b).all(|(a, b)| {
                            (a.leaf, a.facing) == (b.leaf, b.facing) && a.normal.distance(b.normal) < 1e-3
                        });
                    differing += u64::from(!same);
                    covered += u64::from(!a.is_empty());
                }
            }
        }
        let views = cameras.len() as f64;
        let each = |count: u64| short(count as f64 / views);
        let megabytes = |bytes: u64| short(bytes as f64 / views / 1e6);
        // Passes of the geometry, with that for the superset's bounds.
        let is_peeling = matches!(classifier, Classifier::Running | Classifier::Parity);
        let passes =
            if is_peeling { peeling.passes + if is_bounded { cameras.len() as u64 } else { 0 } } else { work.passes };
        println!(
            "| {name} | | {}{} | {} | {} | {} | {} | {} | {} | {} | {} | {} | {} | {} of {} |",
            classifier.name(),
            note,
            short(median(prepare)),
            short(median(draw)),
            each(passes),
            each(work.draws),
            each(work.triangles),
            each(work.dispatches),
            megabytes(work.uploaded),
            megabytes(work.downloaded),
            each(peeling.rejected),
            each(peeling.untested),
            differing,
            covered
        );
        Ok(())
    }
}
