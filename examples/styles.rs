//! Measures the styles: layers against the reference renderer, one compositor for every pipeline, lines against noise, how alike
//! a drawing stays with fewer layers and from frame to frame, and what composing costs. Prints the tables of
//! `docs/measurements.md`; pictures of the noisy scans go to `target/styles`.
//!
//! ```text
//! cargo run --release --example styles              # all of it
//! cargo run --release --example styles -- layers    # only what is named: layers, pipelines, noise, fewer, coherence, cost
//! ```

use std::hint::black_box;
use std::path::Path;

use rayon::prelude::*;
use surfcut::layers::{LayerLimit, LayerSource, TILE_SIDE};
use surfcut::measure::open::open_meshes;
use surfcut::measure::styles::{
    camera, drawn, fewer_layers, layers_against_truth, lines_of_scan, noisy_scan, sketch_coherence,
    surfels_against_meshes,
};
use surfcut::measure::suite::DrawError;
use surfcut::output::png;
use surfcut::output::report::{FrameTimes, Stopwatch};
use surfcut::pipeline::Density;
use surfcut::scene::style::{Style, StyleKind};
use surfcut::scene::{Scene, toml_file};
use surfcut::space::PixelRect;

/// The scenes with solids alone, drawn by every pipeline.
const SOLID_SCENES: [&str; 3] = ["widget", "spanner", "overlap"];
/// The others that the reference renderer can judge.
const OTHER_SCENES: [&str; 6] =
    ["femoral_head", "five_spheres_union", "five_spheres_minus", "icosahedron", "cube_1_25_900", "mesh_minus_mesh"];
/// Points on the ball of the noisy scan, and its pictures' size.
const NOISY_SCAN: (usize, (u32, u32)) = (60_000, (768, 768));

/// Prints one table.
type Part = fn() -> Result<(), DrawError>;

fn main() -> Result<(), DrawError> {
    let chosen: Vec<String> = std::env::args().skip(1).collect();
    let wanted = |name: &str| chosen.is_empty() || chosen.iter().any(|c| c == name);
    let parts: [(&str, Part); 6] = [
        ("layers", layers),
        ("pipelines", pipelines),
        ("noise", noise),
        ("fewer", fewer),
        ("coherence", coherence),
        ("cost", cost),
    ];
    for (name, part) in parts {
        if wanted(name) {
            part()?;
            println!();
        }
    }
    Ok(())
}

fn scene(name: &str) -> Result<Scene, DrawError> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("data/{name}.toml"));
    Ok(toml_file::read(&path)?)
}

fn heading(columns: &[&str]) {
    println!("| {} |", columns.join(" | "));
    println!("|{}", " --- |".repeat(columns.len()));
}

fn layers() -> Result<(), DrawError> {
    heading(&["scene", "pipeline", "layers", "boundaries", "wrong", "worst layer, %"]);
    for name in SOLID_SCENES.into_iter().chain(OTHER_SCENES) {
        for (pipeline, found) in layers_against_truth(&scene(name)?)? {
            let share = 100.0 * found.worst_layer;
            println!(
                "| {name} | {pipeline} | {} | {} | {} | {share:.3} |",
                found.layers, found.boundaries, found.wrong
            );
        }
    }
    Ok(())
}

fn pipelines() -> Result<(), DrawError> {
    heading(&["scene", "SSIM shaded", "SSIM transparent", "lines within 1 px of each other, %"]);
    for name in SOLID_SCENES {
        let found = surfels_against_meshes(&scene(name)?)?;
        println!("| {name} | {:.4} | {:.4} | {:.2} |", found.shaded, found.transparent, 100.0 * found.lines);
    }
    Ok(())
}

fn noise() -> Result<(), DrawError> {
    heading(&[
        "noise, spacings",
        "layers",
        "lines that are true (precision), %",
        "true lines that are drawn (recall), %",
    ]);
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("target/styles");
    std::fs::create_dir_all(&folder)?;
    for noise in [0.0, 0.1, 0.5] {
        let scene = noisy_scan(noise, NOISY_SCAN.0, NOISY_SCAN.1)?;
        for (layers, most) in [("first", Some(1)), ("all", None)] {
            let found = lines_of_scan(&scene, most)?;
            png::rgb(&found.picture).save(folder.join(format!("noise_{noise}_{layers}.png")))?;
            println!("| {noise} | {layers} | {:.1} | {:.1} |", 100.0 * found.precision, 100.0 * found.recall);
        }
    }
    Ok(())
}

fn fewer() -> Result<(), DrawError> {
    let styles = &StyleKind::ALL[1..];
    heading(&[&["spanner, SSIM"][..], &styles.iter().map(|kind| kind.name()).collect::<Vec<_>>()].concat());
    let scene = scene("spanner")?;
    for (few, many) in [(2, 3), (3, 4), (2, 4)] {
        print!("| {few} and {many} layers |");
        for kind in styles {
            print!(" {:.3} |", fewer_layers(&scene, *kind, few, many)?);
        }
        println!();
    }
    Ok(())
}

fn coherence() -> Result<(), DrawError> {
    heading(&["scene", "pixels of line", "where the geometry's motion brings them, to 1 px, %", "99th percentile, px"]);
    for name in SOLID_SCENES {
        let found = sketch_coherence(&scene(name)?)?;
        println!("| {name} | {} | {:.1} | {:.2} |", found.lines, 100.0 * found.within_a_pixel, found.percentile_99);
    }
    Ok(())
}

fn cost() -> Result<(), DrawError> {
    const REPEATS: usize = 15;
    let columns = StyleKind::ALL.map(StyleKind::name);
    heading(&[&["4 layers, CPU ms beside the layers", "pixels"][..], &columns].concat());
    for (name, size) in
        [("widget", (1024, 1024)), ("spanner", (1024, 533)), ("widget", (512, 512)), ("spanner", (768, 400))]
    {
        let mut scene = scene(name)?;
        scene.size = size;
        let stack = open_meshes(&scene, LayerLimit::All, Density::default())?(&camera(&scene)?)?;
        print!("| {name} | {}x{} |", size.0, size.1);
        // What handing over the layers costs here, which is copying them.
        let copying = median(REPEATS, || {
            PixelRect::tiles(size.0, size.1, TILE_SIDE).into_par_iter().for_each(|rect| {
                black_box(stack.draw(rect));
            });
        });
        for kind in StyleKind::ALL {
            let style = Style { max_layers: Some(4), ..Style::of(kind) };
            let ms = median(REPEATS, || {
                black_box(drawn(&stack, &scene, &style));
            });
            print!(" {:.1} |", ms - copying);
        }
        println!();
    }
    Ok(())
}

/// The median CPU time of `work` in milliseconds.
fn median(repeats: usize, mut work: impl FnMut()) -> f64 {
    let mut times = Vec::new();
    for _ in 0..=repeats {
        let watch = Stopwatch::start();
        work();
        times.push(watch.times());
    }
    FrameTimes::median(&times[1..]).map_or(0.0, |median| median.cpu_ms)
}
