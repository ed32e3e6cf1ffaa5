//! Surfels from a triangle mesh: its smooth patches, sampled evenly in world space.
//!
//! *Practice.* An edge is a **crease** where its two triangles' planes meet at more than [`CREASE_DEGREES`], where they are wound
//! against each other, or where there are not exactly two. Triangles joined across other edges are a **patch**. A vertex
//! has one normal for each *fan*, the triangles about it that are joined across non-crease edges: so a crease that fades out in
//! the middle of a patch is sharp as far as it goes. A fan's normal weights its triangles by their angle at the vertex
//! (Thürmer & Wüthrich 1998), which does not depend on how the faces are cut into triangles, as weights by area do.
//!
//! Candidates are the triangles' corners and, where triangles are larger than the spacing, the points at which they are halved
//! along their longest edges until all pieces are small; so borders and slivers get what they need and no more. Those of
//! each patch are thinned to the spacing. Normals are interpolated between the fans', so that curvature fits are smooth.

use glam::{DAffine3, DVec3, Vec3};
use rayon::prelude::*;

use super::assemble::median;
use super::place::normal_map;
use super::sampled::{Sample, Sampling, Thinner, check_count, from_samples, largest_stretch};
use super::{SurfelCloud, SurfelError};
use crate::geometry::TriMesh;

/// Dihedral angle (between the triangles' normals, degrees) above which an edge is a crease.
pub const CREASE_DEGREES: f64 = 30.0;

/// Longest edge of the pieces between candidates, in spacings.
const STEP: f64 = 0.4;

/// Least distance of the samples that are kept, in spacings. A greedy thinning leaves a mean distance about 1.3 times its
/// least.
const KEPT: f64 = 0.75;

/// Every point of a triangle has a corner within its longest edge over √3 (equilateral; of an obtuse one, over 2).
const PIECE_COVER: f64 = 0.577_350_27;

/// Surfels over `mesh` (leaf space), in world space, about `spacing` world units apart.
///
/// Every point of the surface has a surfel of its own patch within that surfel's radius, except where the mesh bends by
/// more than the crease angle within one spacing. Triangles without area are left out.
///
/// # Errors
/// [`SurfelError::Spacing`], [`SurfelError::Transform`], [`SurfelError::TooMany`], [`SurfelError::NotFinite`], and [`SurfelError::Empty`]
/// for a mesh without area.
pub fn from_mesh(mesh: &TriMesh, world_from_leaf: DAffine3, spacing: f64) -> Result<SurfelCloud, SurfelError> {
    largest_stretch(world_from_leaf, spacing)?;
    normal_map(world_from_leaf)?;
    let positions: Vec<DVec3> = mesh.positions.par_iter().map(|p| world_from_leaf.transform_point3(*p)).collect();
    if let Some(index) = positions.par_iter().position_first(|p| !p.is_finite()) {
        return Err(SurfelError::NotFinite { index, p: positions[index] });
    }
    // A mirror turns the winding over.
    let outward = world_from_leaf.matrix3.determinant().signum();
    let faces = Faces::new(mesh, &positions, outward, spacing);
    check_count(faces.area + faces.length * spacing, spacing)?;
    let smooth = Smooth::new(&faces, &positions);
    let samples = sample(mesh, &positions, &faces, &smooth, spacing);
    let cover = (KEPT + STEP * PIECE_COVER) * spacing;
    from_samples(samples, Sampling { spacing, cover }, mesh.colours.is_some())
}

/// The triangles that have an area, and their normals.
struct Faces {
    corners: Vec<[u32; 3]>,
    /// Outward unit normals, world space.
    normals: Vec<DVec3>,
    /// Sum of the areas, squared world units.
    area: f64,
    /// Sum of the lengths of the triangles that are longer than the spacing: slivers are sampled along it.
    length: f64,
}

impl Faces {
    fn new(mesh: &TriMesh, positions: &[DVec3], outward: f64, spacing: f64) -> Self {
        let (mut corners, mut normals, mut area, mut length) = (Vec::new(), Vec::new(), 0.0, 0.0);
        for triangle in &mesh.triangles {
            let [a, b, c] = triangle.map(|v| positions[v as usize]);
            let double = (b - a).cross(c - a) * outward;
            if let Some(normal) = double.try_normalize() {
                corners.push(*triangle);
                normals.push(normal);
                area += 0.5 * double.length();
                let longest = (b - a).length().max((c - b).length()).max((a - c).length());
                length += if longest > spacing { longest } else { 0.0 };
            }
        }
        Self { corners, normals, area, length }
    }
}

/// Patches, and a normal for every corner of every triangle.
struct Smooth {
    /// Triangles, patch by patch.
    order: Vec<u32>,
    /// The patch of each triangle.
    patch: Vec<u32>,
    /// The fan of corner 3 t + i, by its first corner.
    fan: Vec<u32>,
    /// The normals of fans, at their first corners.
    normal: Vec<Vec3>,
}

impl Smooth {
    fn new(faces: &Faces, positions: &[DVec3]) -> Self {
        let count = faces.corners.len();
        // Each edge of each triangle by its ends, least first, and whether it runs from the least.
        let mut edges: Vec<(u32, u32, u32)> = (0..3 * count as u32)
            .into_par_iter()
            .map(|corner| {
                let triangle = faces.corners[corner as usize / 3];
                let (a, b) = (triangle[corner as usize % 3], triangle[(corner as usize + 1) % 3]);
                (a.min(b), a.max(b), corner)
            })
            .collect();
        edges.par_sort_unstable();
        let mut patches = Sets::new(count);
        let mut fans = Sets::new(3 * count);
        let least_cosine = CREASE_DEGREES.to_radians().cos();
        for shared in edges.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
            let &[(low, _, first), (_, _, second)] = shared else { continue };
            let (t1, t2) = (first / 3, second / 3);
            let starts_low = |corner: u32| faces.corners[corner as usize / 3][corner as usize % 3] == low;
            let wound_alike = starts_low(first) != starts_low(second);
            let cosine = faces.normals[t1 as usize].dot(faces.normals[t2 as usize]);
            if !(wound_alike && cosine >= least_cosine) {
                continue;
            }
            patches.join(t1, t2);
            // Wound alike, the first edge starts where the second ends.
            fans.join(first, next_corner(second));
            fans.join(next_corner(first), second);
        }
        let patch: Vec<u32> = (0..count as u32).map(|t| patches.root(t)).collect();
        let mut order: Vec<u32> = (0..count as u32).collect();
        order.par_sort_unstable_by_key(|t| (patch[*t as usize], *t));
        let fan: Vec<u32> = (0..3 * count as u32).map(|corner| fans.root(corner)).collect();
        let mut sums = vec![DVec3::ZERO; 3 * count];
        for (corner, root) in fan.iter().enumerate() {
            let triangle = faces.corners[corner / 3].map(|v| positions[v as usize]);
            let (a, b, c) = (triangle[corner % 3], triangle[(corner + 1) % 3], triangle[(corner + 2) % 3]);
            sums[*root as usize] += faces.normals[corner / 3] * (b - a).angle_between(c - a);
        }
        let own = |(corner, sum): (usize, &DVec3)| sum.normalize_or(faces.normals[corner / 3]).as_vec3();
        let normal = sums.par_iter().enumerate().map(own).collect();
        Self { order, patch, fan, normal }
    }
}

/// The next corner of the same triangle.
fn next_corner(corner: u32) -> u32 {
    corner - corner % 3 + (corner + 1) % 3
}

/// Disjoint sets; a set's root is its least member, so that names do not depend on the order of joining.
struct Sets(Vec<u32>);

impl Sets {
    fn new(count: usize) -> Self {
        Self((0..count as u32).collect())
    }

    fn root(&mut self, mut x: u32) -> u32 {
        while self.0[x as usize] != x {
            let grandparent = self.0[self.0[x as usize] as usize];
            self.0[x as usize] = grandparent;
            x = grandparent;
        }
        x
    }

    fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        self.0[a.max(b) as usize] = a.min(b);
    }
}

/// A point of a triangle by its barycentric coordinates, and where it is.
#[derive(Clone, Copy)]
struct At {
    weights: [f64; 3],
    p: DVec3,
}

fn sample(mesh: &TriMesh, positions: &[DVec3], faces: &Faces, smooth: &Smooth, spacing: f64) -> Vec<Sample> {
    let mut thinner = Thinner::new(median(positions), KEPT * spacing);
    let mut samples = Vec::new();
    let mut seen = vec![false; smooth.fan.len()];
    let mut pieces: Vec<[At; 3]> = Vec::new();
    let mut patch = None;
    for &t in &smooth.order {
        let t = t as usize;
        if patch.replace(smooth.patch[t]) != Some(smooth.patch[t]) {
            thinner.clear();
        }
        let corners = faces.corners[t];
        let fan_normals = [0, 1, 2].map(|i| smooth.normal[smooth.fan[3 * t + i] as usize]);
        let mut offer = |at: &At| {
            let [a, b, c] = at.weights.map(|w| w as f32);
            let sum = fan_normals[0] * a + fan_normals[1] * b + fan_normals[2] * c;
            let normal = sum.normalize_or(faces.normals[t].as_vec3());
            if thinner.keep(at.p, normal) {
                let colour = colour(mesh, corners, at.weights);
                samples.push(Sample { p: at.p, normal, patch: smooth.patch[t], colour });
            }
        };
        let whole = [0, 1, 2].map(|i| {
            let mut weights = [0.0; 3];
            weights[i] = 1.0;
            At { weights, p: positions[corners[i] as usize] }
        });
        for (i, at) in whole.iter().enumerate() {
            // A fan's corners are one candidate.
            if !std::mem::replace(&mut seen[smooth.fan[3 * t + i] as usize], true) {
                offer(at);
            }
        }
        pieces.clear();
        pieces.push(whole);
        while let Some(piece) = pieces.pop() {
            let edge = |i: usize| piece[i].p.distance_squared(piece[(i + 1) % 3].p);
            let longest = if edge(0) >= edge(1) && edge(0) >= edge(2) { 0 } else { 1 + usize::from(edge(2) > edge(1)) };
            if !(edge(longest) > (STEP * spacing) * (STEP * spacing)) {
                continue;
            }
            let (a, b, c) = (piece[longest], piece[(longest + 1) % 3], piece[(longest + 2) % 3]);
            let weights = [0, 1, 2].map(|i| 0.5 * (a.weights[i] + b.weights[i]));
            let middle = At { weights, p: a.p.midpoint(b.p) };
            offer(&middle);
            pieces.push([a, middle, c]);
            pieces.push([middle, b, c]);
        }
    }
    samples
}

fn colour(mesh: &TriMesh, corners: [u32; 3], weights: [f64; 3]) -> [u8; 4] {
    let Some(colours) = &mesh.colours else { return [u8::MAX; 4] };
    let channel = |k: usize| {
        let value: f64 = (0..3).map(|i| f64::from(colours[corners[i] as usize][k]) * weights[i]).sum();
        value.round() as u8
    };
    [channel(0), channel(1), channel(2), u8::MAX]
}
