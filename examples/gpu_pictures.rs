//! Draws scenes in every style on the GPU and on the CPU, and counts the pixels that differ. Prints the table of
//! `docs/measurements.md`, *The GPU: the same pictures*.
//!
//! ```text
//! cargo run --release --example gpu_pictures -- data/widget.toml scenes/gear48.tree.json   # these scenes
//! cargo run --release --example gpu_pictures -- --size 256 data/*.toml
//! ```
//!
//! A pixel differs where a channel of its sRGB bytes does by more than 2. It is on an edge where, within a pixel of it, the nearest
//! layers are of different leaves or facings, or folded by more than 10°.

use std::path::Path;

use anyhow::{Context, bail};
use surfcut::blister::MeshFrame;
use surfcut::composite::section::Hatching;
use surfcut::composite::{Leaves, Look, Picture, styled};
use surfcut::csg::LeafId;
use surfcut::formats::NoProgress;
use surfcut::gpu::blister::{Classifier, GpuMeshFrame};
use surfcut::gpu::splat::{GpuSplatFrame, GpuSplatModel};
use surfcut::gpu::{Gpu, GpuError, GpuLayerSource, composite};
use surfcut::layers::{LayerLimit, LayerStack};
use surfcut::pipeline::{Density, ExactLeaves, convert, has_surfels, mesh_model};
use surfcut::scene::colour::srgb_byte_from_linear;
use surfcut::scene::style::{Style, StyleKind};
use surfcut::scene::{LoadedScene, Scene, load, toml_file, tree_json};
use surfcut::splat::{Frame, SplatSettings};

/// A channel differs by more than this.
const MOST_APART: i32 = 2;

/// Normals of one surface are closer than this: the cosine of 10°.
const FOLD: f32 = 0.984_807_8;

fn main() -> anyhow::Result<()> {
    let mut side = 256;
    let mut scenes = Vec::new();
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        match word.as_str() {
            "--size" => side = words.next().and_then(|text| text.parse().ok()).context("a number is missing")?,
            _ => scenes.push(word),
        }
    }
    if scenes.is_empty() {
        bail!("name scenes: .toml or .tree.json");
    }
    let gpu = Gpu::open(None)?;
    println!(
        "{}, {side} x {side}: pixels that differ by more than 2/255 (of them off edges), of those covered\n",
        gpu.adapter().name
    );
    let kinds: Vec<&str> = StyleKind::ALL.iter().map(|kind| kind.name()).collect();
    println!("| scene | {} |", kinds.join(" | "));
    println!("| --- |{}", " --- |".repeat(kinds.len()));
    for name in &scenes {
        let path = Path::new(name);
        let short = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        match row(&gpu, path, side) {
            Ok(cells) => println!("| {short} | {} |", cells.join(" | ")),
            Err(error) => println!("| {short} | {error:#} |"),
        }
    }
    Ok(())
}

/// The cells of one scene, a style each.
fn row(gpu: &Gpu, path: &Path, side: u32) -> anyhow::Result<Vec<String>> {
    let scene = if tree_json::is_tree_file(path) { tree_json::read(path)? } else { toml_file::read(path)? };
    let mut loaded = load(Scene { size: (side, side), ..scene }, &Default::default(), &NoProgress)?;
    let camera = loaded.camera()?;
    if !has_surfels(&loaded)? {
        let model = mesh_model(&loaded, &camera, Density::default())?;
        let frame = |limit| MeshFrame::new(&model, camera.clone(), limit, 1);
        let on_gpu = |limit| Ok(GpuMeshFrame::new(frame(limit), Classifier::default()));
        return cells(gpu, &loaded, &|limit| LayerStack::collect(&frame(limit)), &on_gpu);
    }
    let settings = SplatSettings::default();
    let converted = convert(&mut loaded, &camera, Density::default(), ExactLeaves::Sampled, &|_| ())?;
    let model = converted.classify().model;
    let uploaded = GpuSplatModel::new(gpu, &model)?;
    let frame = |limit| Frame::new(&model, camera.clone(), limit, 1, settings, None);
    let on_gpu = |limit| Ok(GpuSplatFrame::new(&model, &uploaded, camera.clone(), limit, 1, None));
    cells(gpu, &loaded, &|limit| LayerStack::collect(&frame(limit)), &on_gpu)
}

fn cells<S: GpuLayerSource>(
    gpu: &Gpu,
    loaded: &LoadedScene,
    on_cpu: &dyn Fn(LayerLimit) -> LayerStack,
    on_gpu: &dyn Fn(LayerLimit) -> anyhow::Result<S>,
) -> anyhow::Result<Vec<String>> {
    let colours: Vec<[f32; 3]> =
        (0..loaded.scene.leaves.len()).map(|leaf| loaded.colour(LeafId(leaf as u32))).collect();
    let mut cells = Vec::new();
    let stack = on_cpu(LayerLimit::All);
    let edges = edges(&stack);
    let source = on_gpu(LayerLimit::All)?;
    for kind in StyleKind::ALL {
        let style = Style { kind, ..loaded.scene.style };
        let look = Look { light: loaded.scene.light, background: loaded.scene.background_for(&style) };
        let hatching = Hatching::of_scene(loaded, &style);
        let heavy = hatching.heavy();
        let leaves = Leaves { colours: &colours, heavy: &heavy, hatching: Some(&hatching), names: &[] };
        let expected = styled(&stack, &look, &style, leaves, &|| ());
        let drawn: Result<Picture, GpuError> = gpu.checked(|| composite::styled(gpu, &source, &look, &style, leaves));
        let drawn = drawn?;
        let (mut differing, mut off_edges) = (0, 0);
        for ((a, b), is_edge) in expected.pixels.iter().zip(&drawn.pixels).zip(&edges) {
            let bytes = |pixel: &[f32; 4]| {
                [pixel[0], pixel[1], pixel[2]].map(|channel| i32::from(srgb_byte_from_linear(channel)))
            };
            let apart = bytes(a).into_iter().zip(bytes(b)).map(|(a, b)| (a - b).abs()).max().unwrap_or(0);
            let alpha = (a[3] - b[3]).abs() * 255.0;
            if apart > MOST_APART || alpha > MOST_APART as f32 {
                differing += 1;
                off_edges += u32::from(!is_edge);
            }
        }
        cells.push(format!("{differing} ({off_edges}) of {}", expected.covered));
    }
    Ok(cells)
}

/// By pixel: whether there is an edge or a silhouette of any layer within a pixel.
fn edges(stack: &LayerStack) -> Vec<bool> {
    let (width, height) = (stack.camera.width, stack.camera.height);
    let differ = |x: u32, y: u32, u: u32, v: u32| {
        let (a, b) = (stack.at(x, y), stack.at(u, v));
        a.len() != b.len()
            || a.iter()
                .zip(b)
                .any(|(a, b)| (a.leaf, a.facing, a.body) != (b.leaf, b.facing, b.body) || a.normal.dot(b.normal) < FOLD)
    };
    let near = |v: u32, end: u32| v.saturating_sub(1)..(v + 2).min(end);
    (0..height)
        .flat_map(|y| (0..width).map(move |x| (x, y)))
        .map(|(x, y)| near(y, height).any(|v| near(x, width).any(|u| differ(x, y, u, v))))
        .collect()
}
