//! Measures what the compositor costs on the GPU beside the CPU's, of the same layers, and prints a table.
//!
//! ```text
//! cargo run --release --example gpu_styles
//! ```
//!
//! Layers are on the GPU before a frame begins, and in memory before the CPU's. Times are milliseconds of processor time over all
//! threads, medians of repeats: where the adapter is a processor they are its too. Pipelines are compiled before.

use std::path::Path;

use surfcut::composite::{self, Leaves, Look, Picture};
use surfcut::formats::{NoProgress, ReadOptions};
use surfcut::gpu::layers::{GpuLayerSource, GpuLayers, Uploaded};
use surfcut::gpu::{Gpu, GpuError, composite as twin};
use surfcut::layers::{LayerLimit, LayerStack};
use surfcut::output::resources::cpu_ms;
use surfcut::pipeline::{Density, ExactLeaves, convert};
use surfcut::scene::style::{SCAN_OCCLUSION, Style, StyleKind};
use surfcut::scene::{Scene, load, toml_file};
use surfcut::space::{Camera, PixelRect};

/// Frames a figure is the median of.
const REPEATS: usize = 5;

/// Pixels on a side: one band.
const SIDE: u32 = 512;

/// Layers that stay on the GPU.
struct Resident<'a> {
    stack: &'a LayerStack,
    layers: GpuLayers,
}

impl GpuLayerSource for Resident<'_> {
    fn camera(&self) -> &Camera {
        &self.stack.camera
    }

    fn samples(&self) -> u32 {
        self.stack.samples
    }

    fn draw(&self, gpu: &Gpu, rect: PixelRect) -> Result<GpuLayers, GpuError> {
        if rect == self.layers.rect { Ok(self.layers.clone()) } else { Uploaded(self.stack).draw(gpu, rect) }
    }
}

fn main() -> anyhow::Result<()> {
    let gpu = Gpu::open(None)?;
    println!("{} ({}), {SIDE} x {SIDE} pixels, one sample", gpu.adapter().name, gpu.adapter().driver);
    println!();
    println!("| scene | style | CPU ms | GPU ms | ratio | dispatches | up kB | down kB | differ beyond 2/255 |");
    println!("| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |");
    for name in ["widget", "overlap", "drilled_bone"] {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("data/{name}.toml"));
        let scene = Scene { size: (SIDE, SIDE), ..toml_file::read(&path)? };
        let mut loaded = load(scene, &ReadOptions::default(), &NoProgress)?;
        let camera = loaded.camera()?;
        let converted = convert(&mut loaded, &camera, Density::default(), ExactLeaves::Crossed, &|_| ())?;
        let model = converted.classify().into_hybrid();
        let stack = LayerStack::collect(&model.frame(&camera, LayerLimit::All, 1));
        let all = PixelRect { x0: 0, y0: 0, x1: SIDE, y1: SIDE };
        let source = Resident { stack: &stack, layers: Uploaded(&stack).draw(&gpu, all)? };
        let styles = StyleKind::ALL.map(|kind| (kind.name(), Style::of(kind)));
        let hollows = Style { occlusion: Some(SCAN_OCCLUSION), ..Style::default() };
        for (style_name, style) in styles.into_iter().chain([("shaded, hollows", hollows)]) {
            let look = Look { light: loaded.scene.light, background: loaded.scene.background_for(&style) };
            let on_cpu = || composite::styled(&stack, &look, &style, Leaves::default(), &|| ());
            let on_gpu = || gpu.checked(|| twin::styled(&gpu, &source, &look, &style, Leaves::default()));
            let cpu = median(|| timed(on_cpu).0);
            let ms = median(|| timed(on_gpu).0);
            gpu.take_work();
            let picture = on_gpu()?;
            let work = gpu.take_work();
            println!(
                "| {name} | {style_name} | {cpu:.1} | {ms:.1} | {:.1} | {} | {:.1} | {:.0} | {} |",
                ms / cpu,
                work.dispatches,
                work.uploaded as f64 / 1e3,
                work.downloaded as f64 / 1e3,
                different(&picture, &on_cpu())
            );
        }
    }
    println!();
    println!("All pipelines were compiled in {:.0} ms.", gpu.compile_time().as_secs_f64() * 1e3);
    Ok(())
}

/// Pixels that differ by more than two steps of an 8-bit picture.
fn different(a: &Picture, b: &Picture) -> usize {
    let differ = |(a, b): &(&[f32; 4], &[f32; 4])| a.iter().zip(*b).any(|(a, b)| !((a - b).abs() <= 2.0 / 255.0));
    a.pixels.iter().zip(&b.pixels).filter(differ).count()
}

/// The median of what `measure` says over [`REPEATS`] calls, after one to warm up.
fn median(mut measure: impl FnMut() -> f64) -> f64 {
    measure();
    let mut times: Vec<f64> = (0..REPEATS).map(|_| measure()).collect();
    times.sort_by(f64::total_cmp);
    times[REPEATS / 2]
}

fn timed<T>(work: impl FnOnce() -> T) -> (f64, T) {
    let before = cpu_ms();
    let result = work();
    (cpu_ms() - before, result)
}
