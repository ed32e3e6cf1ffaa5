//! Several sources as one on the GPU: against the CPU's merging of the same layers, and products drawn by either.

use std::path::Path;
use std::process::Command;

use surfcut::gpu::layers::{GpuLayerSource, Uploaded};
use surfcut::gpu::merged::GpuMergedLayers;
use surfcut::gpu::{Gpu, GpuError};
use surfcut::layers::merged::MergedLayers;
use surfcut::layers::{Boundary, Facing, LayerSource, LayerStack};
use surfcut::space::{Camera, PixelRect};

use crate::Test;
use crate::splat::{ALLOWED, camera, whole};

pub const TESTS: &[Test] = &[
    ("merged_layers_are_the_cpus_bits", merged_layers_are_the_cpus_bits),
    ("merged_layers_of_one_source_and_of_none", merged_layers_of_one_source_and_of_none),
    ("merged_products_of_each_pipeline_are_the_cpus", merged_products_of_each_pipeline_are_the_cpus),
    ("merged_products_that_move_are_the_cpus", merged_products_that_move_are_the_cpus),
];

/// A number for a pixel and a turn that looks like chance.
fn chance(x: u32, y: u32, turn: u32) -> u32 {
    let mut hash = x.wrapping_mul(0x9e37_79b1) ^ y.wrapping_mul(0x85eb_ca77) ^ turn.wrapping_mul(0xc2b2_ae3d);
    for _ in 0..3 {
        hash = (hash ^ (hash >> 15)).wrapping_mul(0x2c1b_3c6d);
    }
    hash ^ (hash >> 12)
}

/// Boundaries of few depths, so that many are equal, and not sorted among those.
fn stack(camera: &Camera, number: u32, most: u32) -> LayerStack {
    let boundaries = move |x: u32, y: u32| {
        let mut list: Vec<Boundary> = (0..chance(x, y, 1000 * number) % (most + 1))
            .map(|turn| {
                let of = chance(x, y, 1000 * number + turn + 1);
                Boundary {
                    depth: 1.0 + (of % 5) as f32,
                    normal: glam::Vec3::Z,
                    colour: [number as f32 / 100.0, turn as f32 / 100.0, 0.5],
                    opacity: 0.5,
                    leaf: of / 5 % 3,
                    body: of / 15 % 2,
                    facing: if (of / 30).is_multiple_of(2) { Facing::Front } else { Facing::Back },
                    samples: 1 + (of / 60 % 15) as u16,
                }
            })
            .collect();
        list.sort_by(|a, b| a.depth.total_cmp(&b.depth));
        list
    };
    LayerStack::from_fn(camera.clone(), 4, boundaries)
}

/// The CPU's and the GPU's, of `stacks`, which hold bit by bit the same.
fn hold(gpu: &Gpu, camera: &Camera, stacks: &[LayerStack], rect: PixelRect) -> usize {
    let on_cpu = MergedLayers::new(camera.clone(), 4, stacks.iter().collect()).draw(rect);
    let boxed = |stack| -> Box<dyn GpuLayerSource + '_> { Box::new(Uploaded(stack)) };
    let merged = GpuMergedLayers::new(camera.clone(), 4, stacks.iter().map(boxed).collect());
    let on_gpu = gpu.checked(|| merged.draw(gpu, rect)?.download(gpu)).unwrap();
    assert_eq!(on_gpu.offsets, on_cpu.offsets);
    assert_eq!(on_gpu.boundaries, on_cpu.boundaries);
    on_cpu.boundaries.len()
}

fn merged_layers_are_the_cpus_bits(gpu: &'static Gpu) {
    let camera = camera([0.0, -5.0, 0.0], [0.0; 3], 30.0);
    for (sources, most) in [(2, 3), (5, 4), (17, 2)] {
        let stacks: Vec<LayerStack> = (0..sources).map(|number| stack(&camera, number, most)).collect();
        assert!(hold(gpu, &camera, &stacks, whole(&camera)) > 10_000);
        hold(gpu, &camera, &stacks, PixelRect { x0: 3, y0: 40, x1: 70, y1: 41 });
        // The comparison can fail: with the sources the other way round, equals change places.
        let reversed: Vec<&LayerStack> = stacks.iter().rev().collect();
        let reversed = MergedLayers::new(camera.clone(), 4, reversed).draw(whole(&camera));
        let merged = MergedLayers::new(camera.clone(), 4, stacks.iter().collect()).draw(whole(&camera));
        assert_ne!(reversed.boundaries, merged.boundaries);
    }
}

fn merged_layers_of_one_source_and_of_none(gpu: &'static Gpu) {
    let camera = camera([0.0, -5.0, 0.0], [0.0; 3], 30.0);
    let empty = || stack(&camera, 0, 0);
    hold(gpu, &camera, &[], whole(&camera));
    hold(gpu, &camera, &[empty(), empty()], whole(&camera));
    hold(gpu, &camera, &[empty(), stack(&camera, 1, 3), empty()], whole(&camera));
    let one = GpuMergedLayers::new(camera.clone(), 1, vec![Box::new(TooMuch(camera.clone()))]);
    assert!(matches!(one.draw(gpu, whole(&camera)), Err(GpuError::TooLarge { .. })));
}

/// What fits no buffer.
struct TooMuch(Camera);

impl GpuLayerSource for TooMuch {
    fn camera(&self) -> &Camera {
        &self.0
    }

    fn samples(&self) -> u32 {
        1
    }

    fn draw(&self, _: &Gpu, _: PixelRect) -> Result<surfcut::gpu::GpuLayers, GpuError> {
        Err(GpuError::TooLarge { what: String::new(), needed: 1, limit: 0 })
    }
}

/// A scene of two products that overlap. Smooth: what surfels of a sharp edge come to in `f32` is not what is asked here.
const SCENE: &str = r#"
csg = "left - left_hole | right - right_hole"
size = [96, 96]
[camera]
eye = [1.2, -5.0, 2.2]
target = [0.0, 0.0, 0.0]
fov_y = 32.0
[leaf.left]
sphere = { centre = [-0.45, 0.0, 0.0], radius = 0.8 }
[leaf.left_hole]
cylinder = { from = [-0.45, -1.5, 0.0], to = [-0.45, 1.5, 0.0], radius = 0.3 }
[leaf.right]
sphere = { centre = [0.45, 0.1, 0.0], radius = 0.75 }
[leaf.right_hole]
cylinder = { from = [0.55, 0.0, -1.5], to = [0.55, 0.0, 1.5], radius = 0.28 }
"#;

/// Runs the program in `here`; what it says where that is a failure.
fn run(here: &Path, line: &str) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_surfcut"));
    let output = command.current_dir(here).args(line.split_whitespace()).output().unwrap();
    assert!(output.status.success(), "{line}: {}", String::from_utf8_lossy(&output.stderr));
}

/// How many pixels of two pictures differ by more than 2 of 255, and how many the first one covers.
fn differing(here: &Path, one: &str, other: &str) -> (usize, usize) {
    let [one, other] = [one, other].map(|name| image::open(here.join(name)).unwrap().into_rgb8());
    assert_eq!(one.dimensions(), other.dimensions());
    let differ = |a: &image::Rgb<u8>, b: &image::Rgb<u8>| (0..3).any(|k| a[k].abs_diff(b[k]) > 2);
    let paper = one[(0, 0)];
    let covered = one.pixels().filter(|pixel| differ(pixel, &paper)).count();
    (one.pixels().zip(other.pixels()).filter(|(a, b)| differ(a, b)).count(), covered)
}

/// Holds two pictures of a directory to the bar.
fn hold_pictures(what: &str, here: &Path, one: &str, other: &str) {
    let (differing, covered) = differing(here, one, other);
    assert!(covered > 2000, "{what}: {covered} pixels show anything");
    assert!(differing as f64 <= ALLOWED * covered as f64, "{what}: {differing} of {covered} pixels differ");
}

fn merged_products_of_each_pipeline_are_the_cpus(_: &'static Gpu) {
    let here = tempfile::tempdir().unwrap();
    let here = here.path();
    std::fs::write(here.join("scene.toml"), SCENE).unwrap();
    let solids = "--pipeline hybrid --represent left=surfels --represent right=surfels";
    let left = "--pipeline hybrid --represent left=surfels";
    for (what, samples, flags) in [
        ("meshes", 4, "--pipeline mesh".to_owned()),
        ("each a scan minus a solid", 4, solids.to_owned()),
        ("one without surfels", 1, left.to_owned()),
        ("one without exact leaves", 1, format!("{left} --represent left_hole=surfels")),
        ("scans", 1, format!("{solids} --represent left_hole=surfels --represent right_hole=surfels")),
    ] {
        let line = format!("render scene.toml --overwrite --style transparent --samples {samples} {flags}");
        run(here, &format!("{line} --backend cpu --union volume -o volume.png"));
        run(here, &format!("{line} --backend cpu --union products -o cpu.png"));
        run(here, &format!("{line} --backend gpu --union products -o gpu.png"));
        hold_pictures(what, here, "cpu.png", "gpu.png");
        let (shown, _) = differing(here, "volume.png", "gpu.png");
        assert!(shown > 300, "{what}: {shown} pixels show that products overlap");
    }
}

fn merged_products_that_move_are_the_cpus(_: &'static Gpu) {
    let here = tempfile::tempdir().unwrap();
    let here = here.path();
    let moving = "[[keyframe]]\ntime = 0\nleaf.left_hole = { translate = [0, 0, 0] }\n\
        [[keyframe]]\ntime = 1\nleaf.left_hole = { translate = [0.3, 0, 0.2] }\n";
    std::fs::write(here.join("scene.toml"), format!("{SCENE}{moving}")).unwrap();
    let line = "render scene.toml --style transparent --union products --animate --fps 1";
    for (what, flags) in [("meshes", "--pipeline mesh"), ("scans", "--pipeline hybrid --represent left=surfels")] {
        run(here, &format!("{line} {flags} --backend cpu -o {what}_cpu_{{frame}}.png"));
        run(here, &format!("{line} {flags} --backend gpu -o {what}_gpu_{{frame}}.png"));
        let name = |backend: &str, frame: u32| format!("{what}_{backend}_{frame:04}.png");
        for frame in 0..2 {
            hold_pictures(what, here, &name("cpu", frame), &name("gpu", frame));
        }
        let (moved, _) = differing(here, &name("gpu", 0), &name("gpu", 1));
        assert!(moved > 100, "{what}: {moved} pixels move");
    }
}
