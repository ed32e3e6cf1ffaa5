//! Simulates the scan of `data/femoral_head.ply`: the upper end of a femur, head radius 24 mm, on a stand, seen by a range scanner from
//! eleven places, with noise, real occlusion and the colours of bone and cartilage.
//!
//! ```text
//! cargo run --release --example scan_femoral_head                         # 24 000 points, data/femoral_head.ply
//! cargo run --release --example scan_femoral_head 1000000 head_1m.ply     # as many as wanted
//! ```

use std::path::PathBuf;

use anyhow::Context;
use glam::DVec3;
use surfcut::formats::write_ply_cloud;
use surfcut::geometry::{PointCloud, Solid};
use surfcut::measure::scanner::{Scanner, thin};
use surfcut::measure::scenes::proximal_femur;
use surfcut::measure::simulate::fibonacci_directions;

/// Radius of the head, millimetres.
const HEAD_RADIUS: f64 = 24.0;
/// Standard deviation of the range, millimetres: that of a structured-light scanner.
const RANGE_NOISE: f64 = 0.02;
/// Standard deviation of the normals, degrees.
const NORMAL_NOISE_DEG: f64 = 1.5;
/// Points that are kept where the command line does not say.
const POINTS: usize = 24_000;
/// Rays that are cast for every point that is kept, so that thinning has a choice.
const RAYS_PER_POINT: f64 = 3.0;
/// Of everything random.
const SEED: u64 = 1;

fn main() -> anyhow::Result<()> {
    let mut arguments = std::env::args().skip(1);
    let count: usize = match arguments.next() {
        Some(text) => text.parse().with_context(|| format!("the number of points, not {text:?}"))?,
        None => POINTS,
    };
    let path = arguments
        .next()
        .map_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("data/femoral_head.ply"), PathBuf::from);

    let femur = proximal_femur(HEAD_RADIUS);
    // The shaft's end sits on a rod, which hides part of it.
    let end = DVec3::new(-1.36, 0.1, -3.1) * HEAD_RADIUS;
    let rod = Solid::Cylinder { from: end, to: end - DVec3::Z * 3.0 * HEAD_RADIUS, radius: 0.3 * HEAD_RADIUS };
    let middle = DVec3::new(-0.7, 0.0, -1.1) * HEAD_RADIUS;
    const STATIONS: usize = 11;
    let scanner = Scanner {
        stations: fibonacci_directions(STATIONS).map(|direction| middle + direction * 9.0 * HEAD_RADIUS).collect(),
        target: middle,
        reach: 2.5 * HEAD_RADIUS,
        rays_across: (RAYS_PER_POINT * count as f64).sqrt().ceil() as usize,
        range_noise: RANGE_NOISE,
        normal_noise_deg: NORMAL_NOISE_DEG,
        most_slant_deg: 75.0,
        seed: SEED,
    };
    let mut cloud = scanner.scan(&femur, &[rod])?;
    let seen = cloud.len();
    thin(&mut cloud, count, SEED);
    round_to_f32(&mut cloud);
    cloud.colours = Some(cloud.positions.iter().map(|p| bone_colour(*p)).collect());
    write_ply_cloud(&path, &cloud)?;
    println!("{}: {} of {seen} points seen from {STATIONS} places", path.display(), cloud.len());
    Ok(())
}

/// A file of `float` is half as large, and a scanner's tenth of a micrometre is below its noise.
fn round_to_f32(cloud: &mut PointCloud) {
    cloud.positions.iter_mut().for_each(|p| *p = p.as_vec3().as_dvec3());
}

/// Cartilage on the head, bone below, with soft blotches; sRGB.
fn bone_colour(p: DVec3) -> [u8; 3] {
    const CARTILAGE: DVec3 = DVec3::new(226.0, 224.0, 214.0);
    const BONE: DVec3 = DVec3::new(214.0, 190.0, 148.0);
    const BLOTCH: DVec3 = DVec3::new(-14.0, -18.0, -22.0);
    // How far along the neck, in head radii from the head's centre; the cartilage ends within a tenth of one.
    let along = p.dot(DVec3::new(-0.62, 0.0, -0.785)) / HEAD_RADIUS;
    let wave = 0.06 * (p.y * 0.35 + p.x * 0.2).sin();
    let bone = ((along + wave - 0.55) / 0.1 + 0.5).clamp(0.0, 1.0);
    let q = p / HEAD_RADIUS;
    let blotch = 0.5
        + 0.25 * (4.1 * q.x + 2.3 * q.z).sin() * (3.7 * q.y - 1.9 * q.x).cos()
        + 0.25 * (7.3 * q.z + 5.1 * q.y).sin();
    let colour = CARTILAGE.lerp(BONE, bone) + BLOTCH * blotch * (0.4 + 0.6 * bone);
    colour.to_array().map(|channel| channel.round().clamp(0.0, 255.0) as u8)
}
