//! Measures what a frame costs and how that grows, and prints the tables of `docs/measurements.md`; charts and their data go
//! to `target/speed`.
//!
//! ```text
//! cargo run --release --example speed              # all
//! cargo run --release --example speed -- growth    # the stages against the number of points, 10 k to 3 M
//! cargo run --release --example speed -- edges     # pixels that are clipped against pixels that are not
//! cargo run --release --example speed -- drill     # a drill that moves through a million points
//! ```
//!
//! Times are milliseconds of processor time over all threads, medians of repeats.

use std::path::{Path, PathBuf};

use glam::{DAffine3, DVec3};
use surfcut::classify::{LeafField, LeafLook, Model};
use surfcut::composite::{Look, Picture, shaded};
use surfcut::csg::{LeafId, Tree};
use surfcut::geometry::Solid;
use surfcut::geometry::exact::Exact;
use surfcut::layers::LayerLimit;
use surfcut::measure::chart::{Chart, Point, Series};
use surfcut::measure::scenes::{femoral_head, speed_head};
use surfcut::measure::simulate::{ScanOptions, scan};
use surfcut::measure::suite::short;
use surfcut::output::Destination;
use surfcut::output::resources::cpu_ms;
use surfcut::scene::{LeafKind, Light};
use surfcut::space::{Camera, Lens};
use surfcut::splat::{Frame, SplatSettings};
use surfcut::surfel::{CloudOptions, SurfelCloud, from_cloud, from_solid};

/// Frames a figure is the median of.
const REPEATS: usize = 5;

fn main() -> anyhow::Result<()> {
    let what = std::env::args().nth(1);
    let wanted = |name: &str| what.as_deref().is_none_or(|what| what == name);
    if let Some(what) = what.as_deref()
        && !["growth", "edges", "drill"].contains(&what)
    {
        anyhow::bail!("`{what}` is none of growth, edges, drill");
    }
    if wanted("growth") {
        growth()?;
    }
    if wanted("edges") {
        edges()?;
    }
    if wanted("drill") {
        drill()?;
    }
    Ok(())
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

fn picture(model: &Model, camera: &Camera, samples: u32, limit: LayerLimit) -> Picture {
    let frame = Frame::new(model, camera.clone(), limit, samples, SplatSettings::default(), None);
    let look = Look { light: Light::default(), background: [1.0; 4] };
    shaded(&frame, &look, &|| ())
}

/// The milliseconds of a frame, and the pixels that it covers.
fn frame_of(model: &Model, camera: &Camera, samples: u32, limit: LayerLimit) -> (f64, u64) {
    let mut covered = 0;
    let ms = median(|| {
        let (ms, picture) = timed(|| picture(model, camera, samples, limit));
        covered = picture.covered;
        ms
    });
    (ms, covered)
}

fn camera(side: u32, fov_y: f64) -> anyhow::Result<Camera> {
    let (eye, target) = (DVec3::new(2.4, -2.6, 1.6), DVec3::new(-0.35, 0.0, -0.45));
    Ok(Camera::look_at(eye, target, DVec3::Z, Lens::FovY(fov_y), side, side)?)
}

/// The vertical angle at which the femoral head fills half of the picture.
const HALF_FULL: f64 = 39.0;

fn scanned(solid: &Solid, points: usize) -> anyhow::Result<LeafField> {
    let cloud = scan(solid, &ScanOptions::regular(points, 1))?;
    let (cloud, _) = from_cloud(cloud, DAffine3::IDENTITY, &CloudOptions::default(), &|_| ())?;
    Ok(LeafField::new(cloud, None, LeafKind::Solid))
}

/// A drill, exact, moved along by `shift`. Its samples only say where its surface is.
fn drill_at(shift: DVec3, samples: &SurfelCloud) -> LeafField {
    let exact = Exact::solid(drill_solid(), DAffine3::from_translation(shift));
    let mut cloud = samples.clone();
    cloud.chunks.iter_mut().for_each(|chunk| chunk.origin += shift);
    LeafField::new(cloud, Some(exact), LeafKind::Solid)
}

fn drill_solid() -> Solid {
    Solid::Cylinder { from: DVec3::new(0.6, -1.6, 0.4), to: DVec3::new(0.1, 1.6, 0.2), radius: 0.25 }
}

/// Half a pixel's error at 1024² needs samples of the drill this far apart.
const DRILL_SPACING: f64 = 0.02;

fn looks(count: usize) -> Vec<LeafLook> {
    vec![LeafLook { colour: Some([0.8, 0.7, 0.6]), opacity: 1.0 }; count]
}

fn femur_minus_drill() -> Tree {
    Tree::minus(Tree::leaf(LeafId(0)), Tree::leaf(LeafId(1)))
}

/// The least-squares slope of log cost over log size.
fn exponent(points: &[(f64, f64)]) -> f64 {
    let logs: Vec<(f64, f64)> = points.iter().map(|(x, y)| (x.ln(), y.ln())).collect();
    let mean = |f: fn(&(f64, f64)) -> f64| logs.iter().map(f).sum::<f64>() / logs.len() as f64;
    let (mx, my) = (mean(|p| p.0), mean(|p| p.1));
    let above = |p: &(f64, f64)| ((p.0 - mx) * (p.1 - my), (p.0 - mx).powi(2));
    let (top, bottom) = logs.iter().map(above).fold((0.0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1));
    top / bottom
}

/// The femoral head minus an exact drill at 1024², from ten thousand points to three million.
fn growth() -> anyhow::Result<()> {
    let camera = camera(1024, HALF_FULL)?;
    let samples = from_solid(&drill_solid(), DAffine3::IDENTITY, DRILL_SPACING)?;
    const STAGES: [&str; 5] = ["convert", "classify", "frame", "frame, all boundaries", "frame, 4 samples"];
    let mut stages: [Vec<(f64, f64)>; STAGES.len()] = Default::default();
    println!("\n| points | {} | covered px |", STAGES.join(" | "));
    println!("| --- | {} --- |", "--- | ".repeat(STAGES.len()));
    for points in [10_000, 30_000, 100_000, 300_000, 1_000_000, 3_000_000] {
        let cloud = scan(&femoral_head(1.0), &ScanOptions::regular(points, 1))?;
        let (convert, field) = timed(|| from_cloud(cloud, DAffine3::IDENTITY, &CloudOptions::default(), &|_| ()));
        let head = LeafField::new(field?.0, None, LeafKind::Solid);
        let fields = vec![head, drill_at(DVec3::ZERO, &samples)];
        let (classify, mut model) = timed(|| Model::new(&femur_minus_drill(), fields, looks(2)));
        // The median: classify again what the drill touches, which here is all.
        let again = median(|| timed(|| model.move_leaf(LeafId(1), drill_at(DVec3::ZERO, &samples))).0);
        let (frame, covered) = frame_of(&model, &camera, 1, LayerLimit::Nearest);
        let (all, _) = frame_of(&model, &camera, 1, LayerLimit::All);
        let (four, _) = frame_of(&model, &camera, 4, LayerLimit::Nearest);
        let times = [convert, classify.min(again), frame, all, four];
        println!("| {points} | {} | {covered} |", times.map(short).join(" | "));
        stages.iter_mut().zip(times).for_each(|(stage, ms)| stage.push((points as f64, ms)));
    }
    let exponents: Vec<String> = stages.iter().map(|s| short(exponent(s))).collect();
    println!("| exponent | {} | |", exponents.join(" | "));
    let series = STAGES.iter().zip(&stages).map(|(name, points)| series_of(name, points)).collect();
    chart(
        "growth",
        &Chart::growth("A scan minus an exact drill, 1024²", "points", "processor time [ms]", LEAST_MS, series),
    )
}

const LEAST_MS: f64 = 1e-2;

fn series_of(name: &str, points: &[(f64, f64)]) -> Series {
    let point = |&(x, y): &(f64, f64)| Point { label: String::new(), x, y };
    Series { name: name.to_owned(), points: points.iter().map(point).collect() }
}

/// `depth` + 1 balls, each a little larger than the one before, so near each other that every surfel of each is near all
/// others: every pixel is clipped by `depth` leaves. `b₀ & (b₁ | (b₂ & …))`.
fn all_edges(points: usize, depth: usize) -> anyhow::Result<Model> {
    let spacing = (4.0 * std::f64::consts::PI / points as f64).sqrt();
    let ball = |i: usize| Solid::Sphere { centre: DVec3::ZERO, radius: 1.0 + 0.1 * spacing * i as f64 };
    let fields = (0..=depth).map(|i| scanned(&ball(i), points)).collect::<Result<Vec<_>, _>>()?;
    let mut tree = Tree::leaf(LeafId(depth as u32));
    for i in (0..depth).rev() {
        let leaf = Tree::leaf(LeafId(i as u32));
        tree = if i % 2 == 0 { Tree::and(leaf, tree) } else { Tree::or(leaf, tree) };
    }
    Ok(Model::new(&tree, fields, looks(depth + 1)))
}

/// What a pixel costs where every surfel is an edge surfel, against one where none is.
fn edges() -> anyhow::Result<()> {
    const POINTS: usize = 100_000;
    let ball_camera = |side: u32| -> anyhow::Result<Camera> {
        Ok(Camera::look_at(DVec3::new(2.4, -2.6, 1.6), DVec3::ZERO, DVec3::Z, Lens::FovY(36.0), side, side)?)
    };
    let plain = |points: usize| -> anyhow::Result<Model> {
        let field = scanned(&Solid::Sphere { centre: DVec3::ZERO, radius: 1.0 }, points)?;
        Ok(Model::new(&Tree::leaf(LeafId(0)), vec![field], looks(1)))
    };
    let header = |what: &str| {
        println!("\n| {what} | plain px | ms | M plain px/s | edge px | ms | M edge px/s | edge / plain a pixel |");
        println!("| --- | --- | --- | --- | --- | --- | --- | --- |");
    };
    let row = |label: &str, plain: (f64, u64), edge: (f64, u64)| {
        let rate = |(ms, px): (f64, u64)| px as f64 / ms / 1e3;
        let figures =
            [plain.1 as f64, plain.0, rate(plain), edge.1 as f64, edge.0, rate(edge), rate(plain) / rate(edge)];
        println!("| {label} | {} |", figures.map(short).join(" | "));
    };
    // Step 1: against the number of edge pixels.
    let (simple, clipped) = (plain(POINTS)?, all_edges(POINTS, 1)?);
    let (mut by_pixels, mut plain_by_pixels) = (Vec::new(), Vec::new());
    header("picture");
    for side in [128, 256, 512, 1024, 2048] {
        let camera = ball_camera(side)?;
        let a = frame_of(&simple, &camera, 1, LayerLimit::Nearest);
        let b = frame_of(&clipped, &camera, 1, LayerLimit::Nearest);
        row(&format!("{side}²"), a, b);
        plain_by_pixels.push((a.1 as f64, a.0));
        by_pixels.push((b.1 as f64, b.0));
    }
    println!("| exponent | | {} | | | {} | | |", short(exponent(&plain_by_pixels)), short(exponent(&by_pixels)));
    let series = vec![series_of("every pixel clipped", &by_pixels), series_of("no pixel clipped", &plain_by_pixels)];
    chart("edges_by_pixels", &Chart::growth("Two balls, all edge", "pixels", "processor time [ms]", LEAST_MS, series))?;
    // Step 2: against the number of surfels.
    let camera = ball_camera(512)?;
    let (mut by_surfels, mut plain_by_surfels) = (Vec::new(), Vec::new());
    header("surfels a leaf");
    for points in [1000, 10_000, 100_000, 300_000] {
        let a = frame_of(&plain(points)?, &camera, 1, LayerLimit::Nearest);
        let b = frame_of(&all_edges(points, 1)?, &camera, 1, LayerLimit::Nearest);
        row(&points.to_string(), a, b);
        plain_by_surfels.push((points as f64, a.0));
        by_surfels.push((points as f64, b.0));
    }
    let series = vec![series_of("every pixel clipped", &by_surfels), series_of("no pixel clipped", &plain_by_surfels)];
    chart(
        "edges_by_surfels",
        &Chart::growth("Two balls, 512²", "surfels a leaf", "processor time [ms]", LEAST_MS, series),
    )?;
    // Step 3: against the depth of the tree.
    let mut by_depth = Vec::new();
    println!("\n| leaves | all of them near at every pixel | edge px | ms | M edge px/s |");
    println!("| --- | --- | --- | --- | --- |");
    for depth in [1, 2, 4, 8, 16] {
        let (ms, px) = frame_of(&all_edges(POINTS / 10, depth)?, &camera, 1, LayerLimit::Nearest);
        println!("| {} | yes | {px} | {} | {} |", depth + 1, short(ms), short(px as f64 / ms / 1e3));
        by_depth.push((depth as f64, ms));
    }
    let series = vec![series_of("every pixel clipped", &by_depth)];
    chart(
        "edges_by_depth",
        &Chart::growth("Nested balls, 512²", "depth of the tree", "processor time [ms]", LEAST_MS, series),
    )
}

/// A drill that moves through a million points: what a step costs before the frame.
fn drill() -> anyhow::Result<()> {
    let points = speed_head().leaves[0].scan.count;
    let samples = from_solid(&drill_solid(), DAffine3::IDENTITY, DRILL_SPACING)?;
    let fields = vec![scanned(&femoral_head(1.0), points)?, drill_at(DVec3::ZERO, &samples)];
    let mut model = Model::new(&femur_minus_drill(), fields, looks(2));
    let mut step = 0;
    const STEP: f64 = 0.005;
    let ms = median(|| {
        step += 1;
        let shift = DVec3::new(0.0, 0.0, STEP * f64::from(step));
        timed(|| model.move_leaf(LeafId(1), drill_at(shift, &samples))).0
    });
    println!("\na step of the drill through {points} points, before the frame: {} ms", short(ms));
    Ok(())
}

fn chart(name: &str, chart: &Chart) -> anyhow::Result<()> {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("target/speed");
    std::fs::create_dir_all(&folder)?;
    for (extension, content) in chart.files()? {
        write(&folder.join(format!("{name}.{extension}")), &content)?;
    }
    Ok(())
}

fn write(path: &Path, content: &[u8]) -> anyhow::Result<()> {
    Ok(Destination::File(path.to_owned()).write(true, content)?)
}
