//! Samples a mesh as a noisy scan without normals would see it: points spread evenly by area at random, each moved along its
//! triangle's normal.
//!
//! ```text
//! cargo run --release --example sample_mesh coxae.stl 400000 0.2 7 coxae_400k.ply
//! ```
//!
//! The arguments are the mesh, the number of points, the standard deviation of the noise in spacings, the seed and the file
//! to write.

use std::path::Path;

use anyhow::{Context, bail};
use surfcut::formats::{Geometry, NoProgress, ReadOptions, read, write_ply_cloud};
use surfcut::geometry::PointCloud;
use surfcut::measure::rng::Rng;

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [input, count, noise, seed, output] = &arguments[..] else {
        bail!("expected: the mesh, the number of points, the noise in spacings, the seed, the file to write");
    };
    let count: usize = count.parse().with_context(|| format!("the number of points, not {count:?}"))?;
    let noise: f64 = noise.parse().with_context(|| format!("the noise in spacings, not {noise:?}"))?;
    let seed: u64 = seed.parse().with_context(|| format!("the seed, not {seed:?}"))?;
    let Geometry::Mesh(mesh) = read(Path::new(input), &ReadOptions::default(), &NoProgress)?.geometry else {
        bail!("{input} holds points, not triangles");
    };
    // A triangle is drawn by its share of the area: the first whose running total exceeds the draw.
    let mut total = 0.0;
    let totals: Vec<f64> = (0..mesh.triangles.len())
        .map(|i| {
            let [a, b, c] = mesh.corners(i);
            total += 0.5 * (b - a).cross(c - a).length();
            total
        })
        .collect();
    let spacing = (total / count as f64).sqrt();
    let mut rng = Rng::new(seed, 0);
    let positions = (0..count)
        .map(|_| {
            let draw = rng.uniform() * total;
            let [a, b, c] = mesh.corners(totals.partition_point(|&sum| sum <= draw).min(totals.len() - 1));
            // Uniform over the triangle (Turk 1990): the square root evens out the narrowing towards a corner.
            let (root, share) = (rng.uniform().sqrt(), rng.uniform());
            let p = a * (1.0 - root) + b * (root * (1.0 - share)) + c * (root * share);
            p + (b - a).cross(c - a).normalize_or_zero() * (noise * spacing * rng.gaussian())
        })
        .collect();
    let cloud = PointCloud { positions, ..PointCloud::default() };
    write_ply_cloud(Path::new(output), &cloud)?;
    println!("{output}: {count} points, {spacing:.4} apart, noise {:.4}", noise * spacing);
    Ok(())
}
