//! The judge's own ray-mesh crossings: a plain tree of boxes, every triangle along the line, in `f64`.
//!
//! # Theory
//! With corners a, b, c relative to a point of the line of direction d, the line passes inside the triangle where the triple
//! products d·(b × c), d·(c × a), d·(a × b) have one sign. The product of an edge is, bit for bit, the negative of the same
//! edge's in the neighbouring triangle: so a line that is not exactly in an edge's plane is inside just one of the two, and no
//! line slips through. Where a product is exactly 0 the line grazes, and is cast again beside; so is one that crosses a
//! closed mesh an odd number of times.

use std::collections::HashMap;
use std::sync::Arc;

use glam::DVec3;

use super::Grazed;
use crate::geometry::TriMesh;

/// Triangles a leaf of the tree holds at most.
const LEAF_SIZE: usize = 4;

/// Boxes are enlarged by this part of the mesh's size, so that rounding in the box test loses no triangle.
const BOX_MARGIN: f64 = 1e-9;

/// One crossing.
#[derive(Debug, Clone, Copy)]
pub(super) struct MeshCrossing {
    /// In units of the direction given.
    pub t: f64,
    /// Outward unit normal by the order of corners, leaf space.
    pub normal: DVec3,
    triangle: usize,
    /// Weights of the corners; they add up to 1.
    weights: DVec3,
}

struct Node {
    min: DVec3,
    max: DVec3,
    /// A leaf's triangles, as a range of `order`; empty for an inner node.
    triangles: std::ops::Range<usize>,
    /// An inner node's second child; the first follows the node.
    second: usize,
}

/// A mesh, ready for casting.
pub(super) struct CastMesh {
    mesh: Arc<TriMesh>,
    nodes: Vec<Node>,
    order: Vec<usize>,
    /// Every edge is used as often one way as the other: every line crosses an even number of times.
    closed: bool,
}

impl CastMesh {
    /// # Errors
    /// Says what is wrong with the mesh.
    pub fn new(mesh: Arc<TriMesh>) -> Result<Self, String> {
        if let Some(i) = mesh.positions.iter().position(|p| !p.is_finite()) {
            return Err(format!("vertex {i} is not finite"));
        }
        let beyond = |t: &[u32; 3]| t.iter().any(|&v| v as usize >= mesh.positions.len());
        if let Some(i) = mesh.triangles.iter().position(beyond) {
            return Err(format!("triangle {i} points beyond the {} vertices", mesh.positions.len()));
        }
        let mut balance: HashMap<(u32, u32), i64> = HashMap::new();
        for &[a, b, c] in &mesh.triangles {
            for (from, to) in [(a, b), (b, c), (c, a)] {
                *balance.entry((from.min(to), from.max(to))).or_default() += if from < to { 1 } else { -1 };
            }
        }
        let closed = balance.values().all(|&count| count == 0);
        let mut cast = Self { nodes: Vec::new(), order: (0..mesh.triangles.len()).collect(), mesh, closed };
        if !cast.order.is_empty() {
            let size = cast.mesh.positions.iter().fold(0.0, |size: f64, p| size.max(p.abs().max_element()));
            let centroids: Vec<DVec3> =
                (0..cast.order.len()).map(|t| cast.mesh.corners(t).iter().sum::<DVec3>()).collect();
            cast.split(0, cast.order.len(), &centroids, BOX_MARGIN * size);
        }
        Ok(cast)
    }

    /// A box around the mesh; infinite and inside-out if there is no triangle.
    pub fn bounds(&self) -> (DVec3, DVec3) {
        self.nodes.first().map_or((DVec3::INFINITY, DVec3::NEG_INFINITY), |root| (root.min, root.max))
    }

    fn split(&mut self, begin: usize, end: usize, centroids: &[DVec3], margin: f64) {
        let (mut min, mut max) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for &t in &self.order[begin..end] {
            for p in self.mesh.corners(t) {
                (min, max) = (min.min(p), max.max(p));
            }
        }
        let node = self.nodes.len();
        self.nodes.push(Node { min: min - margin, max: max + margin, triangles: begin..end, second: 0 });
        if end - begin <= LEAF_SIZE {
            return;
        }
        let axis = (max - min).max_position();
        let middle = (begin + end) / 2;
        self.order[begin..end]
            .select_nth_unstable_by(middle - begin, |&a, &b| centroids[a][axis].total_cmp(&centroids[b][axis]));
        self.split(begin, middle, centroids, margin);
        self.nodes[node].triangles = 0..0;
        self.nodes[node].second = self.nodes.len();
        self.split(middle, end, centroids, margin);
    }

    /// All crossings of the line, in no particular order. With `tolerant` a graze counts as a crossing.
    ///
    /// # Errors
    /// [`Grazed`] where the line must be cast again beside.
    pub fn crossings(&self, origin: DVec3, dir: DVec3, tolerant: bool) -> Result<Vec<MeshCrossing>, Grazed> {
        let mut found = Vec::new();
        let Some(root) = self.nodes.first() else { return Ok(found) };
        // From the point nearest to the mesh: triple products of far points have no digits left.
        let shift = ((root.min + root.max) / 2.0 - origin).dot(dir) / dir.length_squared();
        let start = origin + dir * shift;
        let mut stack = vec![0];
        while let Some(index) = stack.pop() {
            let node = &self.nodes[index];
            if !meets_box(start, dir, node.min, node.max) {
                continue;
            }
            if node.triangles.is_empty() {
                stack.extend([node.second, index + 1]);
            }
            for &triangle in &self.order[node.triangles.clone()] {
                match self.crossing(triangle, start, dir, tolerant) {
                    Ok(Some(hit)) => found.push(MeshCrossing { t: hit.t + shift, ..hit }),
                    Ok(None) => {}
                    Err(grazed) => return Err(grazed),
                }
            }
        }
        if self.closed && found.len() % 2 == 1 && !tolerant {
            return Err(Grazed);
        }
        Ok(found)
    }

    fn crossing(
        &self,
        triangle: usize,
        start: DVec3,
        dir: DVec3,
        tolerant: bool,
    ) -> Result<Option<MeshCrossing>, Grazed> {
        let [a, b, c] = self.mesh.corners(triangle).map(|p| p - start);
        let sides = DVec3::new(dir.dot(b.cross(c)), dir.dot(c.cross(a)), dir.dot(a.cross(b)));
        let (least, most) = (sides.min_element(), sides.max_element());
        if least < 0.0 && most > 0.0 {
            return Ok(None);
        }
        let sum = sides.element_sum();
        if sum == 0.0 {
            // Edge on, or no triangle at all: its neighbours take the crossing.
            return Ok(None);
        }
        if (least == 0.0 || most == 0.0) && !tolerant {
            return Err(Grazed);
        }
        let weights = sides / sum;
        // The plane's depth where it is well defined, held to the corners' range, which a sliver's rounding may leave.
        let along = DVec3::new(a.dot(dir), b.dot(dir), c.dot(dir)) / dir.length_squared();
        let normal = (b - a).cross(c - a);
        let t = (normal.dot(a) / normal.dot(dir)).clamp(along.min_element(), along.max_element());
        let t = if t.is_finite() { t } else { weights.dot(along) };
        Ok(Some(MeshCrossing { t, normal: normal.normalize_or_zero(), triangle, weights }))
    }

    /// The mesh's own colour there, linear RGB, where it has any.
    pub fn colour(&self, hit: &MeshCrossing) -> Option<[f32; 3]> {
        let colours = self.mesh.colours.as_ref()?;
        let corners = self.mesh.triangles[hit.triangle];
        let mut mixed = [0.0; 3];
        for (corner, weight) in corners.into_iter().zip(hit.weights.to_array()) {
            let own = colours.get(corner as usize)?;
            for channel in 0..3 {
                mixed[channel] += weight * linear_from_srgb(own[channel]);
            }
        }
        Some(mixed.map(|value| value as f32))
    }
}

/// IEC 61966-2-1.
fn linear_from_srgb(code: u8) -> f64 {
    let value = f64::from(code) / 255.0;
    if value <= 0.040_45 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
}

/// Whether the line meets the box.
fn meets_box(start: DVec3, dir: DVec3, min: DVec3, max: DVec3) -> bool {
    let (mut enter, mut leave) = (f64::NEG_INFINITY, f64::INFINITY);
    for axis in 0..3 {
        let (o, d) = (start[axis], dir[axis]);
        if d == 0.0 {
            if o < min[axis] || o > max[axis] {
                return false;
            }
            continue;
        }
        let (t0, t1) = ((min[axis] - o) / d, (max[axis] - o) / d);
        enter = enter.max(t0.min(t1));
        leave = leave.min(t0.max(t1));
    }
    enter <= leave
}
