//! Measures how a frame of the mesh pipeline grows: with the leaves, with the triangles and with the pixels; prints the tables
//! of `docs/measurements.md` and draws the chart beside its data in `target/growth`.
//!
//! ```text
//! cargo run --release --example growth                # bumpy balls for the triangles
//! cargo run --release --example growth -- bunny.ply   # that closed mesh, as it is and with every triangle cut in 4 and in 16
//! ```
//!
//! Times are milliseconds of processor time over all threads, medians of repeats: the nearest surface, shaded.

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use glam::{DAffine3, DVec3};
use surfcut::blister::{MeshFrame, MeshLeaf, MeshModel, MeshShape};
use surfcut::composite::{Look, Picture, shaded};
use surfcut::csg::{LeafId, Tree};
use surfcut::formats::{self, Geometry, NoProgress, ReadOptions};
use surfcut::geometry::TriMesh;
use surfcut::layers::LayerLimit;
use surfcut::measure::chart::{Chart, Point, Series};
use surfcut::measure::suite::short;
use surfcut::output::Destination;
use surfcut::output::resources::{cpu_ms, peak_memory_bytes};
use surfcut::scene::{LeafKind, Light};
use surfcut::space::{Camera, Lens};

/// Frames a figure is the median of.
const REPEATS: usize = 7;

/// The picture's side where the pixels are not what grows.
const SIDE: u32 = 512;

fn main() -> anyhow::Result<()> {
    // Memory first: the peak of a process never falls.
    let series = vec![pixels()?, leaves()?, triangles(std::env::args().nth(1).as_deref())?];
    let title = "mesh pipeline: a frame against what grows";
    let chart = Chart::growth(title, "size [least size measured = 1]", "frame [ms of CPU]", 0.1, series);
    std::fs::create_dir_all("target/growth")?;
    let stem = Path::new("target/growth/mesh_growth");
    for (ending, bytes) in chart.files()? {
        Destination::File(stem.with_extension(ending)).write(true, &bytes)?;
    }
    println!("\ntarget/growth/mesh_growth.png");
    Ok(())
}

/// A plate minus a hundred balls, at more and more pixels.
fn pixels() -> anyhow::Result<Series> {
    let model = plate(100)?;
    println!("\n| pixels | frame | peak MB | without the picture |");
    println!("| --- | --- | --- | --- |");
    let mut points = Vec::new();
    for side in [256, 512, 1024, 2048, 4096] {
        let camera = plate_camera(side)?;
        let ms = frame_ms(&model, &camera);
        let peak = peak_memory_bytes().unwrap_or(0) as f64 / 1e6;
        let picture = f64::from(side).powi(2) * size_of::<[f32; 4]>() as f64 / 1e6;
        println!("| {side}² | {} | {} | {} |", short(ms), short(peak), short(peak - picture));
        points.push((f64::from(side).powi(2), ms));
    }
    Ok(series("pixels, 256² to 4096²", &points))
}

/// A plate minus more and more balls.
fn leaves() -> anyhow::Result<Series> {
    println!("\n| balls | triangles | prepare | frame |");
    println!("| --- | --- | --- | --- |");
    let mut points = Vec::new();
    for balls in [10, 30, 100, 300, 1000] {
        let before = cpu_ms();
        let model = plate(balls)?;
        let prepare = cpu_ms() - before;
        let ms = frame_ms(&model, &plate_camera(SIDE)?);
        println!("| {balls} | {} | {} | {} |", model.triangle_count(), short(prepare), short(ms));
        points.push((f64::from(balls), ms));
    }
    Ok(series("leaves, 11 to 1001", &points))
}

/// The union of three of one mesh, minus a fourth, as it is and cut finer.
fn triangles(file: Option<&str>) -> anyhow::Result<Series> {
    let mut mesh = match file {
        Some(file) => match formats::read(Path::new(file), &ReadOptions::default(), &NoProgress)?.geometry {
            Geometry::Mesh(mesh) => mesh,
            Geometry::Cloud(_) => anyhow::bail!("{file} holds points, not triangles"),
        },
        None => bumpy_ball(6),
    };
    println!("\n| triangles a leaf | prepare | frame |");
    println!("| --- | --- | --- |");
    let mut points = Vec::new();
    for cut in 0..3 {
        if cut > 0 {
            mesh = subdivided(&mesh);
        }
        let before = cpu_ms();
        let model = three_minus_one(&mesh)?;
        let prepare = cpu_ms() - before;
        let eye = DVec3::new(2.6, -3.4, 1.8);
        let camera = Camera::look_at(eye, DVec3::ZERO, DVec3::Z, Lens::FovY(40.0), SIDE, SIDE)?;
        let ms = frame_ms(&model, &camera);
        println!("| {} | {} | {} |", mesh.triangles.len(), short(prepare), short(ms));
        points.push((mesh.triangles.len() as f64, ms));
    }
    Ok(series("triangles of four leaves, times 1 to 16", &points))
}

/// The points over the least size, named with their exponent.
fn series(name: &str, points: &[(f64, f64)]) -> Series {
    let exponent = exponent(points);
    println!("exponent {}", short(exponent));
    let point = |(x, y): &(f64, f64)| Point { label: String::new(), x: x / points[0].0, y: *y };
    Series { name: format!("{name}: exponent {}", short(exponent)), points: points.iter().map(point).collect() }
}

/// The least-squares slope of log cost over log size.
fn exponent(points: &[(f64, f64)]) -> f64 {
    let logs: Vec<(f64, f64)> = points.iter().map(|(x, y)| (x.ln(), y.ln())).collect();
    let count = logs.len() as f64;
    let (mx, my) = logs.iter().fold((0.0, 0.0), |sum, p| (sum.0 + p.0 / count, sum.1 + p.1 / count));
    let above = |p: &(f64, f64)| ((p.0 - mx) * (p.1 - my), (p.0 - mx).powi(2));
    let (top, bottom) = logs.iter().map(above).fold((0.0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1));
    top / bottom
}

/// The median over [`REPEATS`] frames, after one to warm up.
fn frame_ms(model: &MeshModel, camera: &Camera) -> f64 {
    let frame = || -> Picture {
        let frame = MeshFrame::new(model, camera.clone(), LayerLimit::Nearest, 1);
        shaded(&frame, &Look { light: Light::default(), background: [1.0; 4] }, &|| ())
    };
    frame();
    let mut times: Vec<f64> = (0..REPEATS)
        .map(|_| {
            let before = cpu_ms();
            std::hint::black_box(frame());
            cpu_ms() - before
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[REPEATS / 2]
}

fn leaf(number: u32, mesh: &Arc<TriMesh>, world_from_leaf: DAffine3, colour: [f32; 3]) -> MeshLeaf {
    MeshLeaf {
        leaf: LeafId(number),
        shape: MeshShape::Mesh(Arc::clone(mesh)),
        world_from_leaf,
        colour,
        vertex_colours: false,
        opacity: 1.0,
        kind: LeafKind::Solid,
    }
}

/// A plate of 2 by 2 with a square grid of pits, `balls` of them, each cut by a ball of 320 triangles.
fn plate(balls: u32) -> anyhow::Result<MeshModel> {
    const COLOURS: [[f32; 3]; 2] = [[0.75, 0.72, 0.65], [0.3, 0.5, 0.75]];
    let half = DVec3::new(1.0, 1.0, 0.15);
    let ball = Arc::new(subdivided_ball(2));
    let across = f64::from(balls).sqrt().ceil();
    let pitch = 2.0 / across;
    let mut leaves = vec![leaf(0, &Arc::new(cuboid(half)), DAffine3::IDENTITY, COLOURS[0])];
    let mut tree = Tree::leaf(LeafId(0));
    for number in 0..balls {
        let (column, row) = (f64::from(number) % across, (f64::from(number) / across).floor());
        let centre = DVec3::new((column + 0.5) * pitch - 1.0, (row + 0.5) * pitch - 1.0, half.z);
        let placed = DAffine3::from_translation(centre) * DAffine3::from_scale(DVec3::splat(0.4 * pitch));
        leaves.push(leaf(number + 1, &ball, placed, COLOURS[1]));
        tree = Tree::minus(tree, Tree::leaf(LeafId(number + 1)));
    }
    Ok(MeshModel::new(&leaves, &tree)?)
}

fn plate_camera(side: u32) -> anyhow::Result<Camera> {
    let eye = DVec3::new(2.2, -2.8, 2.4);
    Ok(Camera::look_at(eye, DVec3::ZERO, DVec3::Z, Lens::FovY(40.0), side, side)?)
}

/// Three of `mesh` side by side, turned a little, minus a fourth between them.
fn three_minus_one(mesh: &TriMesh) -> anyhow::Result<MeshModel> {
    let mesh = Arc::new(mesh.clone());
    let places = [(-0.7, 0.0, 0.0), (0.7, 0.1, 0.4), (0.0, 0.5, 0.8), (0.1, -0.6, 0.3)];
    let leaves: Vec<MeshLeaf> = places
        .into_iter()
        .enumerate()
        .map(|(number, (x, y, turn))| {
            let placed = DAffine3::from_translation(DVec3::new(x, y, 0.0)) * DAffine3::from_rotation_z(turn);
            let colour = if number == 3 { [0.8, 0.35, 0.3] } else { [0.7, 0.7, 0.75] };
            leaf(number as u32, &mesh, placed, colour)
        })
        .collect();
    let [a, b, c, d] = [0, 1, 2, 3].map(|number| Tree::leaf(LeafId(number)));
    Ok(MeshModel::new(&leaves, &Tree::minus(Tree::or(Tree::or(a, b), c), d))?)
}

fn mesh(positions: Vec<DVec3>, triangles: Vec<[u32; 3]>) -> TriMesh {
    TriMesh { positions, triangles, colours: None }
}

fn cuboid(half: DVec3) -> TriMesh {
    let sign = |i: usize, axis: usize| if i >> axis & 1 == 1 { 1.0 } else { -1.0 };
    let corners = (0..8).map(|i| half * DVec3::new(sign(i, 0), sign(i, 1), sign(i, 2))).collect();
    let faces: [[u32; 4]; 6] = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    mesh(corners, faces.into_iter().flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]]).collect())
}

/// Every triangle in four, cut at the middles of its edges.
fn subdivided(coarse: &TriMesh) -> TriMesh {
    let mut positions = coarse.positions.clone();
    let mut middles: HashMap<(u32, u32), u32> = HashMap::new();
    let mut triangles = Vec::with_capacity(4 * coarse.triangles.len());
    for &[a, b, c] in &coarse.triangles {
        let [ab, bc, ca] = [(a, b), (b, c), (c, a)].map(|(p, q)| {
            *middles.entry((p.min(q), p.max(q))).or_insert_with(|| {
                positions.push(0.5 * (coarse.positions[p as usize] + coarse.positions[q as usize]));
                positions.len() as u32 - 1
            })
        });
        triangles.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
    }
    mesh(positions, triangles)
}

/// The unit ball as an icosahedron, subdivided so often.
fn subdivided_ball(times: u32) -> TriMesh {
    let golden = (1.0 + 5.0_f64.sqrt()) / 2.0;
    let corners = [
        (-1.0, golden, 0.0),
        (1.0, golden, 0.0),
        (-1.0, -golden, 0.0),
        (1.0, -golden, 0.0),
        (0.0, -1.0, golden),
        (0.0, 1.0, golden),
        (0.0, -1.0, -golden),
        (0.0, 1.0, -golden),
        (golden, 0.0, -1.0),
        (golden, 0.0, 1.0),
        (-golden, 0.0, -1.0),
        (-golden, 0.0, 1.0),
    ];
    #[rustfmt::skip]
    let triangles = vec![
        [0, 11, 5], [0, 5, 1], [0, 1, 7], [0, 7, 10], [0, 10, 11], [1, 5, 9], [5, 11, 4], [11, 10, 2], [10, 7, 6], [7, 1, 8],
        [3, 9, 4], [3, 4, 2], [3, 2, 6], [3, 6, 8], [3, 8, 9], [4, 9, 5], [2, 4, 11], [6, 2, 10], [8, 6, 7], [9, 8, 1],
    ];
    let mut ball = mesh(corners.into_iter().map(|(x, y, z)| DVec3::new(x, y, z).normalize()).collect(), triangles);
    for _ in 0..times {
        ball = subdivided(&ball);
        ball.positions.iter_mut().for_each(|p| *p = p.normalize());
    }
    ball
}

/// A ball of about unit size with dents.
fn bumpy_ball(times: u32) -> TriMesh {
    let mut ball = subdivided_ball(times);
    for p in &mut ball.positions {
        *p *= 0.8 + 0.12 * (7.0 * p.x).sin() * (6.0 * p.y).cos() * (5.0 * p.z + 1.0).sin();
    }
    ball
}
