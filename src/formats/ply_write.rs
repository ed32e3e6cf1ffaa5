//! A PLY writer (binary little endian) for clouds and meshes: what this module's reader reads back as it was.
//!
//! # Practice
//! Coordinates are written as `float` where that loses nothing, else as `double`. Ellipses are written in the 2DGS layout
//! (`scale_0..1`, `rot_0..3`), which holds the normal too. The file appears at once and whole: it is written beside its
//! place under another name, then renamed.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

use glam::{DMat3, DQuat, DVec3};

use crate::geometry::{Ellipse, PointCloud, TriMesh};

/// Why a file could not be written. The place where it should be is as it was.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// The system refused.
    #[error("{path}: cannot be written: {source}", path = path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// The path names no file.
    #[error("{path}: this names no file; add a file name", path = path.display())]
    NoName {
        /// The path as given.
        path: PathBuf,
    },
    /// An attribute has not as many values as there are points.
    #[error("{path}: there are {points} points, but {values} {attribute}", path = path.display())]
    Uneven {
        /// The file.
        path: PathBuf,
        /// The attribute.
        attribute: &'static str,
        /// Its values.
        values: usize,
        /// The points.
        points: usize,
    },
    /// A triangle uses a vertex that is not there.
    #[error("{path}: triangle {triangle} uses vertex {vertex}, but there are {points}", path = path.display())]
    NoSuchVertex {
        /// The file.
        path: PathBuf,
        /// The triangle, from 0.
        triangle: usize,
        /// The vertex that it uses, from 0.
        vertex: u32,
        /// The vertices.
        points: usize,
    },
}

/// Writes a cloud to `path`, which appears whole or not at all.
///
/// # Errors
/// [`WriteError`]; then nothing is left behind.
pub fn write_ply_cloud(path: &Path, cloud: &PointCloud) -> Result<(), WriteError> {
    let lengths = [
        ("normals", cloud.normals.as_ref().map(Vec::len)),
        ("radii", cloud.radii.as_ref().map(Vec::len)),
        ("ellipses", cloud.ellipses.as_ref().map(Vec::len)),
        ("colours", cloud.colours.as_ref().map(Vec::len)),
        ("opacities", cloud.opacities.as_ref().map(Vec::len)),
    ];
    check_lengths(path, cloud.len(), &lengths)?;
    atomically(path, |out| cloud_to(out, cloud))
}

/// Writes a mesh to `path`, which appears whole or not at all.
///
/// # Errors
/// [`WriteError`]; then nothing is left behind.
pub fn write_ply_mesh(path: &Path, mesh: &TriMesh) -> Result<(), WriteError> {
    let points = mesh.positions.len();
    check_lengths(path, points, &[("colours", mesh.colours.as_ref().map(Vec::len))])?;
    for (triangle, corners) in mesh.triangles.iter().enumerate() {
        if let Some(&vertex) = corners.iter().find(|&&v| v as usize >= points) {
            return Err(WriteError::NoSuchVertex { path: path.to_owned(), triangle, vertex, points });
        }
    }
    atomically(path, |out| mesh_to(out, mesh))
}

fn check_lengths(path: &Path, points: usize, lengths: &[(&'static str, Option<usize>)]) -> Result<(), WriteError> {
    for &(attribute, values) in lengths {
        if let Some(values) = values
            && values != points
        {
            return Err(WriteError::Uneven { path: path.to_owned(), attribute, values, points });
        }
    }
    Ok(())
}

/// Removes a temporary file unless it has been renamed.
struct Temporary(Option<PathBuf>);

impl Drop for Temporary {
    fn drop(&mut self) {
        if let Some(path) = self.0.take() {
            // It cannot be mended here, and the first error is the one to report.
            let _ = fs::remove_file(path);
        }
    }
}

fn atomically(path: &Path, write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>) -> Result<(), WriteError> {
    static SERIAL: AtomicU32 = AtomicU32::new(0);
    let Some(name) = path.file_name() else { return Err(WriteError::NoName { path: path.to_owned() }) };
    let mut hidden = OsString::from(".");
    hidden.push(name);
    hidden.push(format!(".{}-{}.tmp", std::process::id(), SERIAL.fetch_add(1, Ordering::Relaxed)));
    let beside = path.with_file_name(hidden);
    let attempt = || -> io::Result<()> {
        let file = File::options().write(true).create_new(true).open(&beside)?;
        let mut temporary = Temporary(Some(beside));
        let mut out = BufWriter::new(file);
        write(&mut out)?;
        // Data first, name second: after a power cut the name must not stand for an empty file.
        out.into_inner().map_err(io::IntoInnerError::into_error)?.sync_all()?;
        if let Some(beside) = &temporary.0 {
            fs::rename(beside, path)?;
        }
        temporary.0 = None;
        Ok(())
    };
    attempt().map_err(|source| WriteError::Io { path: path.to_owned(), source })
}

/// The type that holds all coordinates exactly.
fn coordinate_type(positions: &[DVec3]) -> &'static str {
    let exact = positions.iter().all(|p| p.as_vec3().as_dvec3() == *p);
    if exact { "float" } else { "double" }
}

fn write_position(out: &mut impl Write, p: DVec3, coordinate: &str) -> io::Result<()> {
    for value in p.to_array() {
        if coordinate == "float" {
            out.write_all(&(value as f32).to_le_bytes())?;
        } else {
            out.write_all(&value.to_le_bytes())?;
        }
    }
    Ok(())
}

fn write_floats(out: &mut impl Write, values: &[f32]) -> io::Result<()> {
    values.iter().try_for_each(|value| out.write_all(&value.to_le_bytes()))
}

fn properties(out: &mut impl Write, kind: &str, names: &[&str]) -> io::Result<()> {
    names.iter().try_for_each(|name| writeln!(out, "property {kind} {name}"))
}

fn cloud_to(out: &mut impl Write, cloud: &PointCloud) -> io::Result<()> {
    let coordinate = coordinate_type(&cloud.positions);
    // Ellipses win over radii, and hold the normals.
    let normals = cloud.normals.as_ref().filter(|_| cloud.ellipses.is_none());
    let radii = cloud.radii.as_ref().filter(|_| cloud.ellipses.is_none());
    writeln!(out, "ply\nformat binary_little_endian 1.0\nelement vertex {}", cloud.len())?;
    properties(out, coordinate, &["x", "y", "z"])?;
    if normals.is_some() {
        properties(out, "float", &["nx", "ny", "nz"])?;
    }
    if radii.is_some() {
        properties(out, "float", &["radius"])?;
    }
    if cloud.ellipses.is_some() {
        properties(out, "float", &["scale_0", "scale_1", "rot_0", "rot_1", "rot_2", "rot_3"])?;
    }
    if cloud.opacities.is_some() {
        properties(out, "float", &[if cloud.ellipses.is_some() { "opacity" } else { "alpha" }])?;
    }
    if cloud.colours.is_some() {
        properties(out, "uchar", &["red", "green", "blue"])?;
    }
    writeln!(out, "end_header")?;
    for index in 0..cloud.len() {
        write_position(out, cloud.positions[index], coordinate)?;
        if let Some(normals) = normals {
            write_floats(out, &normals[index].to_array())?;
        }
        if let Some(radii) = radii {
            write_floats(out, &[radii[index]])?;
        }
        if let Some(ellipses) = &cloud.ellipses {
            write_floats(out, &splat(&ellipses[index], cloud.normals.as_ref().map(|n| n[index].as_dvec3())))?;
        }
        if let Some(opacities) = &cloud.opacities {
            let opacity = f64::from(opacities[index]);
            let logit = (opacity / (1.0 - opacity)).ln();
            write_floats(out, &[if cloud.ellipses.is_some() { logit as f32 } else { opacities[index] }])?;
        }
        if let Some(colours) = &cloud.colours {
            out.write_all(&colours[index])?;
        }
    }
    Ok(())
}

/// Logarithms of the semi-axes and the quaternion w x y z that turns x, y, z into the ellipse's axes and the normal.
fn splat(ellipse: &Ellipse, normal: Option<DVec3>) -> [f32; 6] {
    let (u, v) = (ellipse.axis_u.as_dvec3(), ellipse.axis_v.as_dvec3());
    let x = u.normalize_or(DVec3::X);
    // Turned about x where rounding left it aslant, and about the centre where the normal lies on the other side.
    let y = (v - x * v.dot(x)).normalize_or(x.any_orthonormal_vector());
    let y = if normal.is_some_and(|n| n.dot(x.cross(y)) < 0.0) { -y } else { y };
    let rotation = DQuat::from_mat3(&DMat3::from_cols(x, y, x.cross(y))).normalize();
    let [i, j, k, w] = rotation.to_array();
    [u.length().ln(), v.length().ln(), w, i, j, k].map(|value| value as f32)
}

fn mesh_to(out: &mut impl Write, mesh: &TriMesh) -> io::Result<()> {
    let coordinate = coordinate_type(&mesh.positions);
    // Many readers know `int` only; it serves unless the numbers pass its end.
    let index = if i32::try_from(mesh.positions.len()).is_ok() { "int" } else { "uint" };
    writeln!(out, "ply\nformat binary_little_endian 1.0\nelement vertex {}", mesh.positions.len())?;
    properties(out, coordinate, &["x", "y", "z"])?;
    if mesh.colours.is_some() {
        properties(out, "uchar", &["red", "green", "blue"])?;
    }
    writeln!(out, "element face {}\nproperty list uchar {index} vertex_indices\nend_header", mesh.triangles.len())?;
    for (vertex, &p) in mesh.positions.iter().enumerate() {
        write_position(out, p, coordinate)?;
        if let Some(colours) = &mesh.colours {
            out.write_all(&colours[vertex])?;
        }
    }
    for corners in &mesh.triangles {
        out.write_all(&[3])?;
        corners.iter().try_for_each(|corner| out.write_all(&corner.to_le_bytes()))?;
    }
    Ok(())
}
