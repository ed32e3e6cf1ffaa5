//! Surfels from a triangle mesh: its smooth patches, sampled evenly in world space.
//!
//! *Practice.* An edge is a **crease** where its two triangles' planes meet at more than [`CREASE_DEGREES`], where they are wound
//! against each other, or where there are not exactly two. Triangles joined across other edges are a **patch**. A vertex
//! has one normal for each *fan*, the triangles about it that are joined across non-crease edges: so a crease that fades out in
//! the middle of a patch is sharp as far as it goes. A fan's normal weights its triangles by their angle at the vertex
//! (Thürmer & Wüthrich 1998), which does not depend on how the faces are cut into triangles, as weights by area do.
//!
//! Candidates are the triangles' corners and, where triangles are larger than the spacing, rows of points along their longest
//! edges; so borders and slivers get what they need and no more. Those of each patch are thinned to the spacing. Normals are interpolated between the fans', so that curvature fits are smooth.

use glam::{DAffine3, DVec3, Vec3};
use rayon::prelude::*;

use super::assemble::median;
use super::place::normal_map;
use super::sampled::{KEPT, Sample, Sampling, Thinner, check_count, from_samples, largest_stretch};
use super::{SurfelCloud, SurfelError};
use crate::geometry::TriMesh;

/// Dihedral angle (between the triangles' normals, degrees) above which an edge is a crease.
pub const CREASE_DEGREES: f64 = 30.0;

/// Distance of candidates along a row, and of rows, in spacings.
const COLUMN_STEP: f64 = 0.5;
const ROW_STEP: f64 = 0.35;

/// Every point of a triangle has a candidate within so many spacings, √(ROW_STEP² + (COLUMN_STEP/2)²). The angles at the longest
/// edge are acute, so the row below a point extends beneath it. (A triangle with no edge longer than COLUMN_STEP
/// has a corner within COLUMN_STEP/√3, which is less.)
const CANDIDATE_COVER: f64 = 0.431;

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
    let cover = (KEPT + CANDIDATE_COVER) * spacing;
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

fn sample(mesh: &TriMesh, positions: &[DVec3], faces: &Faces, smooth: &Smooth, spacing: f64) -> Vec<Sample> {
    let origin = median(positions);
    let patches: Vec<&[u32]> =
        smooth.order.chunk_by(|s, t| smooth.patch[*s as usize] == smooth.patch[*t as usize]).collect();
    let of_patches: Vec<Vec<Sample>> = patches
        .into_par_iter()
        .map_init(
            || Thinner::new(origin, KEPT * spacing),
            |thinner, triangles| {
                let mut samples = Vec::new();
                for &t in triangles {
                    let t = t as usize;
                    let corners = faces.corners[t];
                    let normals = [0, 1, 2].map(|i| smooth.normal[smooth.fan[3 * t + i] as usize]);
                    // A fan's corners are one candidate, offered by the first of them.
                    let first = [0, 1, 2].map(|i| smooth.fan[3 * t + i] as usize == 3 * t + i);
                    candidates(corners.map(|v| positions[v as usize]), first, spacing, |weights, p| {
                        let [a, b, c] = weights.map(|w| w as f32);
                        let sum = normals[0] * a + normals[1] * b + normals[2] * c;
                        let normal = sum.normalize_or(faces.normals[t].as_vec3());
                        if thinner.keep(smooth.patch[t], p, normal) {
                            let colour = colour(mesh, corners, weights);
                            samples.push(Sample { p, normal, patch: smooth.patch[t], colour });
                        }
                    });
                }
                samples
            },
        )
        .collect();
    of_patches.concat()
}

/// Offers points of a triangle, as barycentric weights and place, so that every point of it has one within [`CANDIDATE_COVER`]
/// spacings: those corners that are `first` of their fan, and rows along the longest edge where the triangle is not small.
fn candidates(corners: [DVec3; 3], first: [bool; 3], spacing: f64, mut offer: impl FnMut([f64; 3], DVec3)) {
    let unit = |i: usize| std::array::from_fn(|j| f64::from(u8::from(i == j)));
    for i in (0..3).filter(|i| first[*i]) {
        offer(unit(i), corners[i]);
    }
    let lengths = [0, 1, 2].map(|i| corners[i].distance(corners[(i + 1) % 3]));
    let base =
        if lengths[0] >= lengths[1] && lengths[0] >= lengths[2] { 0 } else { 1 + usize::from(lengths[2] > lengths[1]) };
    let (from, to, apex) = (base, (base + 1) % 3, (base + 2) % 3);
    if lengths[base] <= COLUMN_STEP * spacing {
        return;
    }
    let double_area = (corners[1] - corners[0]).cross(corners[2] - corners[0]).length();
    let rows = (double_area / lengths[base] / (ROW_STEP * spacing)).ceil().max(1.0) as u64;
    for row in 0..rows {
        let up = row as f64 / rows as f64;
        let columns = (lengths[base] * (1.0 - up) / (COLUMN_STEP * spacing)).ceil().max(1.0) as u64;
        for column in 0..=columns {
            // The ends of the first row are corners.
            if row == 0 && (column == 0 || column == columns) {
                continue;
            }
            let along = column as f64 / columns as f64;
            let mut weights = [0.0; 3];
            weights[from] = (1.0 - up) * (1.0 - along);
            weights[to] = (1.0 - up) * along;
            weights[apex] = up;
            offer(weights, corners[0] * weights[0] + corners[1] * weights[1] + corners[2] * weights[2]);
        }
    }
}

fn colour(mesh: &TriMesh, corners: [u32; 3], weights: [f64; 3]) -> [u8; 4] {
    let Some(colours) = &mesh.colours else { return [u8::MAX; 4] };
    let channel = |k: usize| {
        let value: f64 = (0..3).map(|i| f64::from(colours[corners[i] as usize][k]) * weights[i]).sum();
        value.round() as u8
    };
    [channel(0), channel(1), channel(2), u8::MAX]
}
