//! Measures the styles: layers against the reference renderer, one compositor for every pipeline, lines against noise, how alike
//! a drawing stays with fewer layers and from frame to frame, and what composing costs. Prints the tables of
//! `docs/measurements.md`.
//!
//! ```text
//! cargo run --release --example styles              # all of it
//! cargo run --release --example styles -- layers    # only what is named: layers, pipelines, noise, fewer, coherence, cost
//! ```

use std::hint::black_box;
use std::path::Path;

use glam::{DVec2, DVec3};
use surfcut::composite::{Leaves, Look, Picture, styled};
use surfcut::layers::{LayerLimit, LayerSource, LayerStack};
use surfcut::measure::line_likeness::{Ink, layer_agreement};
use surfcut::measure::open::{open_meshes, open_own_forms, open_reference, open_surfels};
use surfcut::measure::quality::quality;
use surfcut::measure::scenes::{self, Case, CaseLeaf};
use surfcut::measure::simulate::{Sampling, ScanOptions};
use surfcut::measure::suite::DrawError;
use surfcut::output::png;
use surfcut::output::report::{FrameTimes, Stopwatch};
use surfcut::pipeline::Density;
use surfcut::scene::style::{LineSettings, Style, StyleKind};
use surfcut::scene::{Representation, Scene, toml_file};
use surfcut::space::Camera;
use surfcut::splat::SplatSettings;

/// The scenes with solids alone, drawn by every pipeline.
const SOLID_SCENES: [&str; 3] = ["widget", "spanner", "overlap"];
/// The scenes with points.
const POINT_SCENES: [&str; 5] =
    ["femoral_head", "five_spheres_union", "five_spheres_minus", "icosahedron", "cube_1_25_900"];

/// How closely solids are sampled and tessellated where surfels are compared with meshes.
const TESSELLATED: Density = Density::MaxErrorPx(0.1);

fn main() -> Result<(), DrawError> {
    let chosen: Vec<String> = std::env::args().skip(1).collect();
    let wanted = |name: &str| chosen.is_empty() || chosen.iter().any(|c| c == name);
    let parts: [(&str, fn() -> Result<(), DrawError>); 6] = [
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

fn camera(scene: &Scene) -> Result<Camera, DrawError> {
    Ok(scene.camera.ok_or("the scene names no camera")?.camera(scene.size)?)
}

fn drawn(source: &dyn LayerSource, scene: &Scene, style: &Style) -> Picture {
    let look = Look { light: scene.light, background: scene.background_for(style) };
    styled(source, &look, style, Leaves::default(), &|| ())
}

/// Black lines on white.
fn plain_lines(scene: &mut Scene) -> Style {
    scene.background = Some([1.0; 4]);
    let lines = LineSettings { ink: Some([0.0; 3]), ..LineSettings::default() };
    Style { lines, fade: 0.0, ..Style::of(StyleKind::Wireframe) }
}

fn layers() -> Result<(), DrawError> {
    println!("| scene | pipeline | layers | boundaries | wrong | worst layer, % |");
    println!("| --- | --- | --- | --- | --- | --- |");
    for name in SOLID_SCENES.into_iter().chain(POINT_SCENES) {
        let scene = scene(name)?;
        let camera = camera(&scene)?;
        let truth = open_reference(&scene, LayerLimit::All)?(&camera)?;
        let mut pipelines = vec![
            ("surfels", open_surfels(&scene, LayerLimit::All, SplatSettings::default())?),
            ("own forms", open_own_forms(&scene, LayerLimit::All, Density::default())?),
        ];
        if SOLID_SCENES.contains(&name) {
            pipelines.push(("mesh", open_meshes(&scene, LayerLimit::All, Density::default())?));
        }
        for (pipeline, drawer) in pipelines {
            let agreement = layer_agreement(&drawer(&camera)?, &truth);
            println!(
                "| {name} | {pipeline} | {} | {} | {} | {:.3} |",
                agreement.layers,
                agreement.boundaries,
                agreement.wrong,
                100.0 * agreement.worst_layer
            );
        }
    }
    Ok(())
}

fn ssim(a: &Picture, b: &Picture, covered: &[bool]) -> Result<f64, DrawError> {
    Ok(quality(&png::rgb(a), &png::rgb(b), covered)?.ssim)
}

/// By pixel: whether the stack shows anything there.
fn covered(stack: &LayerStack) -> Vec<bool> {
    let (width, height) = (stack.camera.width, stack.camera.height);
    (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| !stack.at(x, y).is_empty()).collect()
}

fn pipelines() -> Result<(), DrawError> {
    println!("| scene | style | surfels against meshes | measure |");
    println!("| --- | --- | --- | --- |");
    for name in SOLID_SCENES {
        let mut scene = scene(name)?;
        let camera = camera(&scene)?;
        // Nothing but surfels against nothing but triangles.
        scene.leaves.iter_mut().for_each(|leaf| leaf.represent = Some(Representation::Surfels));
        let surfels = open_own_forms(&scene, LayerLimit::All, TESSELLATED)?(&camera)?;
        scene.leaves.iter_mut().for_each(|leaf| leaf.represent = Some(Representation::Mesh));
        let meshes = open_meshes(&scene, LayerLimit::All, TESSELLATED)?(&camera)?;
        let covered = covered(&meshes);
        for kind in [StyleKind::Shaded, StyleKind::Transparent] {
            let [a, b] = [&surfels, &meshes].map(|stack| drawn(stack, &scene, &Style::of(kind)));
            println!("| {name} | {} | {:.4} | SSIM |", kind.name(), ssim(&a, &b, &covered)?);
        }
        let lines = plain_lines(&mut scene);
        let [a, b] = [&surfels, &meshes].map(|stack| Ink::black_on_white(&drawn(stack, &scene, &lines)));
        let share = a.found_in(&b, 1.0).unwrap_or(0.0).min(b.found_in(&a, 1.0).unwrap_or(0.0));
        println!("| {name} | wireframe | {:.2} % | lines within 1 px of each other |", 100.0 * share);
    }
    Ok(())
}

/// A ball of points and a block of points, met and drilled: creases where two scans meet and where a scan meets a solid.
fn noisy_scan(noise: f64) -> Case {
    /// The spread of normals that a scanner's software makes of positions with a noise of one spacing, degrees.
    const NORMALS_DEGREES: f64 = 30.0;
    let scan = |count, seed| {
        ScanOptions::regular(count, seed).sampled(Sampling::Poisson).noisy(noise, NORMALS_DEGREES * noise)
    };
    let block = surfcut::geometry::Solid::Box { min: DVec3::splat(-0.8), max: DVec3::splat(0.8) };
    let drill = scenes::cylinder([0.0; 3], [0.0, 0.0, 1.0], 1.5, 0.4);
    let leaves: Vec<CaseLeaf> = vec![
        scenes::leaf("ball", scenes::sphere([0.0; 3], 1.05), scan(60_000, 11)),
        scenes::leaf("block", block, scan(60_000, 12)),
        scenes::leaf("drill", drill, scan(30_000, 13)),
    ];
    let about = "Two scans that meet, drilled by a third";
    Case::new("noisy_scan", about, leaves, "ball & block - drill", scenes::view_from([2.6, -3.4, 2.2]))
}

fn noise() -> Result<(), DrawError> {
    println!(
        "| noise, spacings | layers | lines that are true (precision), % | true lines that are drawn (recall), % |"
    );
    println!("| --- | --- | --- | --- |");
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("target/styles");
    std::fs::create_dir_all(&folder)?;
    for noise in [0.0, 0.1, 0.5] {
        let case = noisy_scan(noise);
        let mut scene = case.scene()?;
        scene.size = (768, 768);
        let camera = case.camera.camera(scene.size)?;
        let scan = open_surfels(&scene, LayerLimit::All, SplatSettings::default())?(&camera)?;
        // The drill's own scan is as noisy; the truth is drawn from what was scanned.
        let truth = open_reference(&scene, LayerLimit::All)?(&camera)?;
        let style = plain_lines(&mut scene);
        for (layers, most) in [("first", Some(1)), ("all", None)] {
            let style = Style { max_layers: most, ..style };
            let pictures = [&scan, &truth].map(|stack| drawn(stack, &scene, &style));
            let file = folder.join(format!("noise_{noise}_{layers}.png"));
            png::rgb(&pictures[0]).save(&file)?;
            let [scan, truth] = pictures.map(|picture| Ink::black_on_white(&picture));
            println!(
                "| {noise} | {layers} | {:.1} | {:.1} |",
                100.0 * scan.found_in(&truth, 2.0).unwrap_or(0.0),
                100.0 * truth.found_in(&scan, 2.0).unwrap_or(0.0)
            );
        }
    }
    Ok(())
}

fn fewer() -> Result<(), DrawError> {
    println!("| spanner | {} |", StyleKind::ALL[1..].iter().map(|kind| kind.name()).collect::<Vec<_>>().join(" | "));
    println!("| --- |{}", " --- |".repeat(StyleKind::ALL.len() - 1));
    let scene = scene("spanner")?;
    let camera = camera(&scene)?;
    let stack = open_meshes(&scene, LayerLimit::All, Density::default())?(&camera)?;
    let covered = covered(&stack);
    for (few, many) in [(2, 3), (3, 4), (2, 4)] {
        print!("| {few} and {many} layers, SSIM |");
        for kind in &StyleKind::ALL[1..] {
            let style = |most| Style { max_layers: Some(most), ..Style::of(*kind) };
            let [a, b] = [few, many].map(|most| drawn(&stack, &scene, &style(most)));
            print!(" {:.3} |", ssim(&a, &b, &covered)?);
        }
        println!();
    }
    Ok(())
}

/// A camera turned by one degree about the scene's upright axis.
fn turned(camera: &Camera, target: DVec3) -> Camera {
    let turn = glam::DQuat::from_axis_angle(DVec3::Z, 1f64.to_radians());
    Camera {
        eye: target + turn * (camera.eye - target),
        right: turn * camera.right,
        down: turn * camera.down,
        forward: turn * camera.forward,
        ..camera.clone()
    }
}

fn coherence() -> Result<(), DrawError> {
    println!(
        "| scene | lines of a sketch | moved by the geometry's motion and at most 1 px more, % | 99th percentile beyond it, px |"
    );
    println!("| --- | --- | --- | --- |");
    for name in SOLID_SCENES {
        let mut scene = scene(name)?;
        let first = camera(&scene)?;
        let target = scene.camera.ok_or("no camera")?.target;
        let next = turned(&first, target);
        let meshes = open_meshes(&scene, LayerLimit::All, Density::default())?;
        let mut style = Style { opacity: 0.0, max_layers: Some(1), ..Style::of(StyleKind::Sketchy) };
        style.lines.ink = Some([0.0; 3]);
        // A pixel's depth is the nearer of a line's and a surface's at two places: here one place, so that it is the line's.
        style.sketch.shade_px = style.sketch.edge_px;
        scene.background = Some([1.0; 4]);
        let pictures = [&first, &next].map(|camera| meshes(camera).map(|stack| drawn(&stack, &scene, &style)));
        let [before, after] = pictures;
        let before = before?;
        let depth = before.depth.clone().ok_or("a sketch has depths")?;
        let (before, after) = (Ink::black_on_white(&before), Ink::black_on_white(&after?));
        const REACH_PX: f64 = 12.0;
        let mut beyond: Vec<f64> = Vec::new();
        for (x, y) in before.lines() {
            let px = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
            let z = f64::from(depth[(y * before.width + x) as usize]);
            if !z.is_finite() {
                continue;
            }
            let p_in_world = first.ray(px).at(z);
            let moved = next.px_from_view(next.view_from_world(p_in_world));
            // How far a line of the next frame is from where the motion alone would bring this one: the hand's own part.
            beyond.push(after.distance(moved, REACH_PX).min(REACH_PX));
        }
        beyond.sort_by(f64::total_cmp);
        let within = beyond.iter().filter(|d| **d <= 1.0).count();
        let percentile = beyond.get(beyond.len() * 99 / 100).copied().unwrap_or(0.0);
        println!(
            "| {name} | {} px | {:.1} | {percentile:.2} |",
            beyond.len(),
            100.0 * within as f64 / beyond.len() as f64
        );
    }
    Ok(())
}

/// The four nearest layers of a stack, as a pipeline hands them over.
fn cost() -> Result<(), DrawError> {
    const REPEATS: usize = 15;
    println!("| scene, 4 layers | pixels | {} |", StyleKind::ALL.map(StyleKind::name).join(" | "));
    println!("| --- | --- |{}", " --- |".repeat(StyleKind::ALL.len()));
    for (name, size) in
        [("widget", (1024, 1024)), ("spanner", (1024, 533)), ("widget", (512, 512)), ("spanner", (768, 400))]
    {
        let mut scene = scene(name)?;
        scene.size = size;
        let camera = camera(&scene)?;
        let stack = open_meshes(&scene, LayerLimit::All, Density::default())?(&camera)?;
        print!("| {name}, CPU ms | {}x{} |", size.0, size.1);
        // What handing over the layers costs here, which is copying them.
        let copying = median(REPEATS, || {
            black_box(LayerStack::collect(&stack));
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
