//! Draws scans by the paper, its partners found in space and in the picture, and by default, on the GPU and on the CPU: times, work, and pixels that
//! differ. Prints the table of `docs/measurements.md`, *The GPU: ways to clip*.
//!
//! ```text
//! cargo run --release --example gpu_splats -- --size 256 data/five_spheres_minus.toml
//! ```
//!
//! A pixel differs where its layers do: leaf, facing, or the depth by more than a twentieth of a pixel's size.

use std::path::Path;

use anyhow::{Context, bail};
use surfcut::classify::Model;
use surfcut::classify::partners::PartnerLists;
use surfcut::formats::NoProgress;
use surfcut::gpu::Gpu;
use surfcut::gpu::layers::collect;
use surfcut::gpu::splat::{GpuClipping, GpuSplatFrame, GpuSplatModel};
use surfcut::layers::{LayerLimit, LayerStack};
use surfcut::output::resources::cpu_ms;
use surfcut::pipeline::{Density, ExactLeaves, convert};
use surfcut::scene::{Scene, load, toml_file};
use surfcut::space::Camera;
use surfcut::splat::{Clip, Frame, Partners, SplatSettings};

/// Frames of which the fastest counts.
const REPEATS: usize = 3;

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
        bail!("name scenes: .toml");
    }
    let gpu = Gpu::open(None)?;
    println!("{}, {side} x {side}, milliseconds of processor time\n", gpu.adapter().name);
    println!(
        "| scene | way | partners | CPU: lists once | CPU: a frame | GPU: lists once | GPU: a frame | kernels | MB up | MB down | \
         pixels that differ |"
    );
    println!("| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |");
    for name in &scenes {
        let scene = toml_file::read(Path::new(name))?;
        let mut loaded = load(Scene { size: (side, side), ..scene }, &Default::default(), &NoProgress)?;
        let camera = loaded.camera()?;
        let model = convert(&mut loaded, &camera, Density::default(), ExactLeaves::Sampled, &|_| ())?.classify().model;
        let short = Path::new(name).file_stem().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        for clip in Clip::ALL {
            for partners in Partners::ALL {
                row(&gpu, &short, &model, &camera, SplatSettings { clip, partners, ..SplatSettings::PAPER })?;
            }
        }
        row(&gpu, &short, &model, &camera, SplatSettings::default())?;
    }
    Ok(())
}

fn row(gpu: &Gpu, name: &str, model: &Model, camera: &Camera, settings: SplatSettings) -> anyhow::Result<()> {
    let limit = LayerLimit::Nearest;
    // Step 1: the CPU.
    let start = cpu_ms();
    let lists = match (settings.partners, settings.partners_among()) {
        (Partners::ObjectSpace, Some(among)) => Some(PartnerLists::in_space(model, among)),
        _ => None,
    };
    let cpu_once = cpu_ms() - start;
    let (mut cpu_frame, mut gpu_frame) = (f64::INFINITY, f64::INFINITY);
    let mut expected = None;
    let mut pairs = 0;
    for _ in 0..REPEATS {
        let start = cpu_ms();
        let frame = Frame::new(model, camera.clone(), limit, 1, settings, lists.as_ref());
        expected = Some(LayerStack::collect(&frame));
        cpu_frame = cpu_frame.min(cpu_ms() - start);
        pairs = frame.partners().map_or(0, PartnerLists::len);
    }
    // Step 2: the GPU, whose pipelines are made in the first frame.
    let uploaded = GpuSplatModel::new(gpu, model)?;
    let start = cpu_ms();
    let clipping = GpuClipping::new(gpu, model, &uploaded, settings, lists.as_ref())?;
    let gpu_once = cpu_ms() - start;
    let mut drawn = None;
    let mut work = gpu.take_work();
    for _ in 0..=REPEATS {
        gpu.take_work();
        let start = cpu_ms();
        let frame = GpuSplatFrame::new(model, &uploaded, camera.clone(), limit, 1, clipping.as_ref())?;
        drawn = Some(gpu.checked(|| collect(gpu, &frame))?);
        gpu_frame = gpu_frame.min(cpu_ms() - start);
        work = gpu.take_work();
    }
    // Step 3: what differs.
    let (expected, drawn) = (expected.context("it was drawn")?, drawn.context("it was drawn")?);
    let (mut covered, mut differing) = (0, 0);
    for (x, y) in (0..camera.height).flat_map(|y| (0..camera.width).map(move |x| (x, y))) {
        let (a, b) = (expected.at(x, y), drawn.at(x, y));
        covered += u32::from(!a.is_empty());
        let same = a.len() == b.len()
            && a.iter().zip(b).all(|(a, b)| {
                let apart = f64::from((a.depth - b.depth).abs());
                (a.leaf, a.body, a.facing) == (b.leaf, b.body, b.facing)
                    && apart <= 0.05 * camera.footprint(f64::from(a.depth))
            });
        differing += u32::from(!same);
    }
    let way = if settings == SplatSettings::default() {
        "the default".to_owned()
    } else {
        format!("--clip {} --partners {}", settings.clip.name(), settings.partners.name())
    };
    let mb = |bytes: u64| bytes as f64 / 1e6;
    println!(
        "| {name} | {way} | {pairs} | {cpu_once:.0} | {cpu_frame:.0} | {gpu_once:.0} | {gpu_frame:.0} | {} | {:.2} | {:.2} | \
         {differing} of {covered} |",
        work.dispatches,
        mb(work.uploaded),
        mb(work.downloaded)
    );
    Ok(())
}
