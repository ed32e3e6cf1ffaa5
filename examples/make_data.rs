//! Writes the small scenes of `data/` whose scans are simulated or whose meshes are built: five spheres united and cut, the
//! icosahedron of 20 surfels, the cube of 1, 25 and 900 surfels a face, and a mesh minus a mesh. (The femoral head has a
//! program of its own, `scan_femoral_head`.)
//!
//! ```text
//! cargo run --release --example make_data
//! ```

use std::f64::consts::TAU;
use std::path::Path;

use glam::{DQuat, DVec2, DVec3};
use surfcut::formats::{write_ply_cloud, write_ply_mesh};
use surfcut::geometry::TriMesh;
use surfcut::measure::scenes::{Case, cube, five_spheres_minus, five_spheres_union, icosahedron};
use surfcut::output::Destination;

fn main() -> anyhow::Result<()> {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("data");
    // Both scenes of the five spheres share their scans.
    write_case(&data, &five_spheres_union(), "five_spheres")?;
    write_case(&data, &five_spheres_minus(), "five_spheres")?;
    write_case(&data, &icosahedron(), "icosahedron")?;
    write_case(&data, &cube(), "cube_1_25_900")?;
    let meshes = data.join("mesh_minus_mesh");
    std::fs::create_dir_all(&meshes)?;
    write_ply_mesh(&meshes.join("knot.ply"), &knot())?;
    write_ply_mesh(&meshes.join("star.ply"), &star())?;
    Ok(())
}

fn write_case(data: &Path, case: &Case, scans: &str) -> anyhow::Result<()> {
    std::fs::create_dir_all(data.join(scans))?;
    for (leaf, mut cloud) in case.leaves.iter().zip(case.clouds()?) {
        // A file of `float` is half as large, and rounds by a ten-millionth of the scene.
        cloud.positions.iter_mut().for_each(|p| *p = p.as_vec3().as_dvec3());
        write_ply_cloud(&data.join(scans).join(format!("{}.ply", leaf.name)), &cloud)?;
    }
    let text = case.to_toml(&|leaf| format!("{scans}/{leaf}.ply"));
    let path = data.join(format!("{}.toml", case.name));
    Destination::File(path.clone()).write(true, text.as_bytes())?;
    println!("{}", path.display());
    Ok(())
}

/// A trefoil knot of a round tube: a closed mesh that curves both ways everywhere.
fn knot() -> TriMesh {
    const AROUND: usize = 240;
    const ACROSS: usize = 20;
    const TUBE: f64 = 0.28;
    let curve = |t: f64| {
        let (radius, height) = (0.85 + 0.38 * (3.0 * t).cos(), 0.42 * (3.0 * t).sin());
        DVec3::new(radius * (2.0 * t).cos(), radius * (2.0 * t).sin(), height)
    };
    // A frame carried along the curve without twist comes back turned by some angle, which every ring then makes up for a
    // little of.
    let at = |i: usize| curve(TAU * i as f64 / AROUND as f64);
    let tangent = |i: usize| (at(i + 1) - at(i + AROUND - 1)).normalize();
    let mut across = tangent(0).any_orthonormal_vector();
    let first = across;
    let mut frames = Vec::new();
    for i in 0..=AROUND {
        let carried = DQuat::from_rotation_arc(tangent(i.saturating_sub(1)), tangent(i)) * across;
        across = (carried - tangent(i) * carried.dot(tangent(i))).normalize();
        frames.push((tangent(i), across));
    }
    let (last_tangent, last) = frames[AROUND];
    let twist = first.cross(last).dot(last_tangent).atan2(first.dot(last));
    let mut mesh = TriMesh::default();
    for (i, (tangent, across)) in frames[..AROUND].iter().enumerate() {
        let untwist = DQuat::from_axis_angle(*tangent, -twist * i as f64 / AROUND as f64);
        let (u, v) = (untwist * *across, untwist * tangent.cross(*across));
        mesh.positions.extend((0..ACROSS).map(|j| {
            let side = DVec2::from_angle(TAU * j as f64 / ACROSS as f64) * TUBE;
            (at(i) + u * side.x + v * side.y).as_vec3().as_dvec3()
        }));
    }
    let vertex = |i: usize, j: usize| ((i % AROUND) * ACROSS + j % ACROSS) as u32;
    for i in 0..AROUND {
        for j in 0..ACROSS {
            let (a, b, c, d) = (vertex(i, j), vertex(i + 1, j), vertex(i + 1, j + 1), vertex(i, j + 1));
            mesh.triangles.extend([[a, d, c], [a, c, b]]);
        }
    }
    mesh
}

/// A prism over a five-pointed star, tapered and twisted: a closed mesh of flat faces and sharp creases.
fn star() -> TriMesh {
    const POINTS: usize = 5;
    const LEVELS: usize = 12;
    const HALF_HEIGHT: f64 = 1.1;
    const TWIST: f64 = 0.9;
    let corners = 2 * POINTS;
    let mut mesh = TriMesh::default();
    for level in 0..=LEVELS {
        let share = level as f64 / LEVELS as f64;
        let scale = 0.75 - 0.2 * share;
        for k in 0..corners {
            let radius = scale * if k % 2 == 0 { 1.0 } else { 0.55 };
            let at = DVec2::from_angle(TAU * k as f64 / corners as f64 + TWIST * share) * radius;
            let p = DVec3::new(at.x, at.y, HALF_HEIGHT * (2.0 * share - 1.0));
            mesh.positions.push(p.as_vec3().as_dvec3());
        }
    }
    let vertex = |level: usize, k: usize| (level * corners + k % corners) as u32;
    for level in 0..LEVELS {
        for k in 0..corners {
            let (a, b, c, d) = (vertex(level, k), vertex(level, k + 1), vertex(level + 1, k + 1), vertex(level + 1, k));
            mesh.triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    let (bottom, top) = (mesh.positions.len() as u32, mesh.positions.len() as u32 + 1);
    mesh.positions.extend([DVec3::Z * -HALF_HEIGHT, DVec3::Z * HALF_HEIGHT].map(|p| p.as_vec3().as_dvec3()));
    for k in 0..corners {
        mesh.triangles.push([bottom, vertex(0, k + 1), vertex(0, k)]);
        mesh.triangles.push([top, vertex(LEVELS, k), vertex(LEVELS, k + 1)]);
    }
    mesh
}
