//! Exact questions to a triangle mesh: inside, nearest point, crossings of a line; as [`Solid`](super::Solid) answers them.
//!
//! *Theory.* The tree is obvhs' two-wide hierarchy, of `f32` boxes about an `f64` origin, rounded outward; only the boxes are
//! `f32`, all decisions about triangles are `f64`. Lines against triangles are Woop, Benthin and Wald, *Watertight Ray/
//! Triangle Intersection* (JCGT 2013), §3: the triangle is sheared so that the line becomes an axis, and the signs of three
//! 2D cross products decide, which agree bit for bit between triangles that share an edge. Inside an open mesh is Barill,
//! Dickson, Schmidt, Levin and Jacobson, *Fast Winding Numbers for Soups and Clouds* (SIGGRAPH 2018), with the first term of
//! their expansion (eq. 6).
//!
//! *Changes from the papers.* All crossings of the whole line are found, not the first. A product of exactly 0 is not
//! decided by higher precision: whether a point is inside is asked along another direction instead.
//!
//! *Practice.* Whether a mesh is closed is found out when it is loaded; parity then does not care how triangles are
//! oriented, the winding number does.

use std::f64::consts::TAU;
use std::sync::Arc;
use std::time::Duration;

use glam::{DVec2, DVec3, Vec3A};
use obvhs::BvhBuildParams;
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::builder::build_bvh2;

use super::TriMesh;

/// Why a mesh cannot be asked.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MeshBvhError {
    /// There is nothing to ask.
    #[error("the mesh has no triangle: is it a point cloud?")]
    Empty,
    /// A vertex is NaN or infinite.
    #[error("vertex {vertex} of the mesh is not finite: remove it and its triangles")]
    NotFinite {
        /// Its index.
        vertex: usize,
    },
    /// A triangle uses a vertex that is not there.
    #[error("triangle {triangle} of the mesh uses a vertex beyond the last: its indices must be below {vertices}")]
    NoSuchVertex {
        /// Its index.
        triangle: usize,
        /// The number of vertices.
        vertices: usize,
    },
}

/// A crossing of a line and a mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeshHit {
    /// The line's parameter, in units of the direction's length.
    pub t: f64,
    /// Unit normal of the triangle by the order of its corners, leaf space; zero for a triangle without area.
    pub normal: DVec3,
    /// Its index.
    pub triangle: u32,
    /// The corners' weights at the crossing, which add up to 1.
    pub weights: DVec3,
}

/// The point of a mesh nearest to another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeshPoint {
    /// Leaf space.
    pub p: DVec3,
    /// Leaf units.
    pub distance: f64,
    /// The triangle it lies in, the first of those that share it.
    pub triangle: u32,
}

/// What a node's triangles look like from afar, for winding numbers.
#[derive(Debug, Clone, Copy, Default)]
struct Dipole {
    /// Sum of areas times normals.
    moment: DVec3,
    /// Mean of the triangles by area.
    centre: DVec3,
    /// Sum of areas.
    area: f64,
    /// No corner is further from `centre`.
    reach: f64,
}

/// A mesh with a tree over its triangles.
pub struct MeshBvh {
    mesh: Arc<TriMesh>,
    tree: Bvh2,
    /// What the tree's boxes are relative to.
    origin: DVec3,
    bounds: (DVec3, DVec3),
    closed: bool,
    /// By node; only of an open mesh.
    dipoles: Vec<Dipole>,
}

/// An interval that a box covers of a line, or of distances.
type Reach = Option<(f64, f64)>;

impl MeshBvh {
    /// A tree over the triangles of `mesh`, the same for the same mesh.
    ///
    /// # Errors
    /// [`MeshBvhError`] names the first unusable vertex or triangle.
    pub fn new(mesh: Arc<TriMesh>) -> Result<Self, MeshBvhError> {
        if mesh.triangles.is_empty() {
            return Err(MeshBvhError::Empty);
        }
        if let Some(vertex) = mesh.positions.iter().position(|p| !p.is_finite()) {
            return Err(MeshBvhError::NotFinite { vertex });
        }
        let vertices = mesh.positions.len();
        if let Some(triangle) = mesh.triangles.iter().position(|t| t.iter().any(|&v| v as usize >= vertices)) {
            return Err(MeshBvhError::NoSuchVertex { triangle, vertices });
        }
        let corners = mesh.triangles.iter().flatten().map(|&v| mesh.positions[v as usize]);
        let bounds = corners.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(a, b), p| (a.min(p), b.max(p)));
        let origin = 0.5 * (bounds.0 + bounds.1);
        let boxes: Vec<Aabb> =
            (0..mesh.triangles.len()).map(|t| outward_box(mesh.corners(t).map(|p| p - origin))).collect();
        let mut build_time = Duration::ZERO; // obvhs reports it; nobody here asks
        let tree = build_bvh2(&boxes, BvhBuildParams::medium_build(), &mut build_time);
        let closed = mesh.is_closed();
        let mut bvh = Self { mesh, tree, origin, bounds, closed, dipoles: Vec::new() };
        if !closed {
            bvh.dipoles = vec![Dipole::default(); bvh.tree.nodes.len()];
            bvh.add_dipoles(0);
        }
        Ok(bvh)
    }

    /// The mesh.
    pub fn mesh(&self) -> &Arc<TriMesh> {
        &self.mesh
    }

    /// Whether every edge has as many triangles on one side as on the other, so that the mesh has an inside.
    pub fn is_closed(&self) -> bool {
        self.closed
    }

    /// Least and greatest corner of a box around all triangles, leaf space.
    pub fn bounds(&self) -> (DVec3, DVec3) {
        self.bounds
    }

    /// Whether `p` (leaf space) is inside: by the parity of crossings if the mesh is closed, else where its generalised
    /// winding number is above ½.
    pub fn contains(&self, p: DVec3) -> bool {
        if !self.closed {
            return self.winding_number(p) > 0.5;
        }
        if !(p.cmpge(self.bounds.0).all() && p.cmple(self.bounds.1).all()) {
            return false;
        }
        /// Directions tried before a majority decides: each fails only by meeting an edge exactly.
        const MOST_TRIES: u32 = 16;
        let mut hits = Vec::new();
        let mut votes = 0;
        for attempt in 0..MOST_TRIES {
            // Along an axis the boxes cull best; then directions from a lattice on the sphere.
            let dir = if attempt == 0 { DVec3::X } else { lattice_direction(attempt, MOST_TRIES) };
            let clean = self.collect(p, dir, &mut hits) && hits.len() % 2 == 0;
            let odd = hits.iter().filter(|hit| hit.t > 0.0).count() % 2 == 1;
            if clean {
                return odd;
            }
            votes += if odd { 1 } else { -1 };
        }
        votes > 0
    }

    /// The generalised winding number at `p`: 1 inside a closed mesh whose triangles are anticlockwise from outside.
    /// Approximate (to some hundredths) far from the triangles of an open mesh.
    pub fn winding_number(&self, p: DVec3) -> f64 {
        let mut sum = 0.0;
        let mut stack = vec![0];
        while let Some(index) = stack.pop() {
            /// A node is summed up when it is this many times its own size away: the paper's β, with more care.
            const FAR: f64 = 3.0;
            if let Some(far) = self.dipoles.get(index) {
                let e = far.centre - p;
                let distance = e.length();
                if distance > FAR * far.reach {
                    sum += far.moment.dot(e) / distance.powi(3);
                    continue;
                }
            }
            let node = &self.tree.nodes[index];
            if node.is_leaf() {
                for triangle in self.triangles_of(index) {
                    sum += solid_angle(self.mesh.corners(triangle as usize).map(|corner| corner - p));
                }
            } else {
                stack.extend([node.first_index as usize, node.first_index as usize + 1]);
            }
        }
        sum / (2.0 * TAU)
    }

    /// The distance of the mesh from `p`, negative where [`Self::contains`] says inside.
    pub fn signed_distance(&self, p: DVec3) -> f64 {
        let distance = self.closest(p).distance;
        if self.contains(p) { -distance } else { distance }
    }

    /// The point nearest to `p`, both in leaf space.
    pub fn closest(&self, p: DVec3) -> MeshPoint {
        let anywhere = MeshPoint { p, distance: f64::INFINITY, triangle: u32::MAX };
        self.closest_within(p, f64::INFINITY).unwrap_or(anywhere) // a mesh has at least one triangle
    }

    /// The point nearest to `p` if it is nearer than `radius`.
    pub fn closest_within(&self, p: DVec3, radius: f64) -> Option<MeshPoint> {
        let mut best: Option<MeshPoint> = None;
        let from_origin = p - self.origin;
        let mut limit = radius;
        let near = |node: usize| {
            let (min, max) = self.node_box(node);
            (min - from_origin).max(from_origin - max).max(DVec3::ZERO).length()
        };
        let mut stack = vec![(near(0), 0)];
        while let Some((distance, index)) = stack.pop() {
            // At equal distance the first triangle must still be found.
            if distance > limit {
                continue;
            }
            let node = &self.tree.nodes[index];
            if node.is_leaf() {
                for triangle in self.triangles_of(index) {
                    let q = closest_in_triangle(p, self.mesh.corners(triangle as usize));
                    let distance = q.distance(p);
                    let first = best.is_some_and(|b| distance == b.distance && triangle < b.triangle);
                    if distance < limit || first {
                        limit = distance;
                        best = Some(MeshPoint { p: q, distance, triangle });
                    }
                }
            } else {
                let (a, b) = (node.first_index as usize, node.first_index as usize + 1);
                let (near_a, near_b) = ((near(a), a), (near(b), b));
                // The nearer child is popped first.
                stack.extend(if near_a.0 < near_b.0 { [near_b, near_a] } else { [near_a, near_b] });
            }
        }
        best
    }

    /// Fills `hits` with all crossings of the line `origin + t · dir` (leaf space), at negative t too, in order of t.
    pub fn intersect(&self, origin: DVec3, dir: DVec3, hits: &mut Vec<MeshHit>) {
        self.collect(origin, dir, hits);
        hits.sort_by(|a, b| a.t.total_cmp(&b.t).then(a.triangle.cmp(&b.triangle)));
    }

    /// The crossing whose parameter is nearest to `t_guess`.
    pub fn nearest_crossing(&self, origin: DVec3, dir: DVec3, t_guess: f64) -> Option<MeshHit> {
        let line = Line::new(origin - self.origin, dir)?;
        let mut best: Option<MeshHit> = None;
        let mut limit = f64::INFINITY;
        // How far from the guess a box's part of the line begins.
        let beyond = |reach: Reach| reach.map(|(from, to)| (from - t_guess).max(t_guess - to).max(0.0));
        let mut stack = Vec::new();
        stack.extend(beyond(line.meet(self.node_box(0))).map(|away| (away, 0)));
        while let Some((away, index)) = stack.pop() {
            if away > limit {
                continue;
            }
            let node = &self.tree.nodes[index];
            if node.is_leaf() {
                for triangle in self.triangles_of(index) {
                    let Some((hit, _)) = self.cross(&line, triangle) else { continue };
                    let away = (hit.t - t_guess).abs();
                    if away < limit || best.is_some_and(|b| away == limit && triangle < b.triangle) {
                        limit = away;
                        best = Some(hit);
                    }
                }
            } else {
                let children = [node.first_index as usize, node.first_index as usize + 1];
                let mut next = children.map(|child| beyond(line.meet(self.node_box(child))).map(|away| (away, child)));
                next.sort_by(|a, b| {
                    let away = |next: &Option<(f64, usize)>| next.map_or(f64::INFINITY, |n| n.0);
                    away(b).total_cmp(&away(a))
                });
                stack.extend(next.into_iter().flatten());
            }
        }
        best
    }

    /// Calls `each` for every crossing with |t| ≤ `reach`, in no order.
    pub fn intersect_within(&self, origin: DVec3, dir: DVec3, reach: f64, each: &mut dyn FnMut(MeshHit)) {
        let Some(line) = Line::new(origin - self.origin, dir) else { return };
        let touches =
            |node: usize| line.meet(self.node_box(node)).is_some_and(|(from, to)| from <= reach && to >= -reach);
        let mut stack = Vec::with_capacity(64);
        stack.extend(touches(0).then_some(0));
        while let Some(index) = stack.pop() {
            let node = &self.tree.nodes[index];
            if node.is_leaf() {
                for triangle in self.triangles_of(index) {
                    if let Some((hit, _)) = self.cross(&line, triangle)
                        && hit.t.abs() <= reach
                    {
                        each(hit);
                    }
                }
            } else {
                let children = [node.first_index as usize, node.first_index as usize + 1];
                stack.extend(children.into_iter().filter(|&child| touches(child)));
            }
        }
    }

    /// All crossings in no order; returns whether none was exactly on an edge.
    fn collect(&self, origin: DVec3, dir: DVec3, hits: &mut Vec<MeshHit>) -> bool {
        hits.clear();
        let Some(line) = Line::new(origin - self.origin, dir) else { return true };
        let mut clean = true;
        let mut stack = vec![0];
        while let Some(index) = stack.pop() {
            if line.meet(self.node_box(index)).is_none() {
                continue;
            }
            let node = &self.tree.nodes[index];
            if node.is_leaf() {
                for triangle in self.triangles_of(index) {
                    if let Some((hit, on_edge)) = self.cross(&line, triangle) {
                        clean &= !on_edge;
                        hits.push(hit);
                    }
                }
            } else {
                stack.extend([node.first_index as usize, node.first_index as usize + 1]);
            }
        }
        clean
    }

    fn cross(&self, line: &Line, triangle: u32) -> Option<(MeshHit, bool)> {
        let corners = self.mesh.corners(triangle as usize).map(|p| p - self.origin);
        let (t, weights, on_edge) = line.cross(corners)?;
        let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize_or_zero();
        Some((MeshHit { t, normal, triangle, weights }, on_edge))
    }

    fn node_box(&self, index: usize) -> (DVec3, DVec3) {
        let aabb = self.tree.nodes[index].aabb();
        (aabb.min.as_dvec3(), aabb.max.as_dvec3())
    }

    fn triangles_of(&self, leaf: usize) -> impl Iterator<Item = u32> + '_ {
        let node = &self.tree.nodes[leaf];
        let range = node.first_index as usize..(node.first_index + node.prim_count) as usize;
        self.tree.primitive_indices[range].iter().copied()
    }

    fn add_dipoles(&mut self, index: usize) -> Dipole {
        let node = self.tree.nodes[index];
        let mut sum = Dipole::default();
        let mut weighted = DVec3::ZERO;
        if node.is_leaf() {
            for triangle in self.triangles_of(index).collect::<Vec<_>>() {
                let [a, b, c] = self.mesh.corners(triangle as usize);
                let moment = 0.5 * (b - a).cross(c - a);
                sum.moment += moment;
                sum.area += moment.length();
                weighted += (a + b + c) * (moment.length() / 3.0);
            }
        } else {
            for child in [node.first_index as usize, node.first_index as usize + 1] {
                let part = self.add_dipoles(child);
                sum.moment += part.moment;
                sum.area += part.area;
                weighted += part.centre * part.area;
            }
        }
        let (min, max) = self.node_box(index);
        let (min, max) = (min + self.origin, max + self.origin);
        sum.centre = if sum.area > 0.0 { weighted / sum.area } else { 0.5 * (min + max) };
        sum.reach = (sum.centre - min).max(max - sum.centre).length();
        self.dipoles[index] = sum;
        sum
    }
}

/// A triangle's box in `f32`, no smaller than in `f64`.
fn outward_box(corners: [DVec3; 3]) -> Aabb {
    let [a, b, c] = corners;
    let down = |v: DVec3| Vec3A::from(v.to_array().map(|x| (x as f32).next_down()));
    let up = |v: DVec3| Vec3A::from(v.to_array().map(|x| (x as f32).next_up()));
    Aabb::new(down(a.min(b).min(c)), up(a.max(b).max(c)))
}

/// The `index`-th of `count` directions spread over the sphere along a spiral.
fn lattice_direction(index: u32, count: u32) -> DVec3 {
    /// Turns between successive directions: the golden ratio's conjugate, of which no multiple is near a whole number.
    const TURNS: f64 = 0.618_033_988_749_894_9;
    let z = (2.0 * f64::from(index) + 1.0) / f64::from(count) - 1.0;
    let around = DVec2::from_angle(TAU * TURNS * f64::from(index)) * (1.0 - z * z).sqrt();
    DVec3::new(around.x, around.y, z)
}

/// A line, sheared so that it runs along the axis in which its direction is longest.
struct Line {
    origin: DVec3,
    dir: DVec3,
    /// The order of axes in the sheared frame.
    axes: [usize; 3],
    /// What a unit along the last axis moves along the first two.
    shear: DVec2,
}

impl Line {
    fn new(origin: DVec3, dir: DVec3) -> Option<Self> {
        let last = dir.abs().max_position();
        let axes = [(last + 1) % 3, (last + 2) % 3, last];
        let shear = DVec2::new(dir[axes[0]], dir[axes[1]]) / dir[last];
        (origin.is_finite() && shear.is_finite()).then_some(Self { origin, dir, axes, shear })
    }

    /// Parameters between which the line is in the box, a little enlarged.
    fn meet(&self, (min, max): (DVec3, DVec3)) -> Reach {
        // Rounding of the quotients below, as a part of the coordinates they come from.
        const ROUNDING: f64 = 8.0 * f64::EPSILON;
        let (mut enter, mut leave) = (f64::NEG_INFINITY, f64::INFINITY);
        for axis in 0..3 {
            let (o, d) = (self.origin[axis], self.dir[axis]);
            let margin = ROUNDING * (o.abs() + min[axis].abs().max(max[axis].abs()));
            let (low, high) = (min[axis] - margin - o, max[axis] + margin - o);
            if d == 0.0 {
                if low > 0.0 || high < 0.0 {
                    return None;
                }
                continue;
            }
            let (a, b) = (low / d, high / d);
            enter = enter.max(a.min(b));
            leave = leave.min(a.max(b));
        }
        // Also along the line: the three quotients carry a rounding each.
        let margin = ROUNDING * (enter.abs() + leave.abs());
        (enter <= leave + margin).then_some((enter - margin, leave + margin))
    }

    /// Parameter, weights of the corners, and whether the line passes exactly through an edge.
    fn cross(&self, corners: [DVec3; 3]) -> Option<(f64, DVec3, bool)> {
        let [x, y, z] = self.axes;
        let flat = corners.map(|p| {
            let e = p - self.origin;
            (DVec2::new(e[x], e[y]) - self.shear * e[z], e[z])
        });
        let [(a, _), (b, _), (c, _)] = flat;
        let sides = DVec3::new(b.perp_dot(c), c.perp_dot(a), a.perp_dot(b));
        if sides.min_element() < 0.0 && sides.max_element() > 0.0 {
            return None;
        }
        let sum = sides.element_sum();
        if sum == 0.0 {
            return None; // edge on: the neighbours take the crossing
        }
        let weights = sides / sum;
        let depth = weights.dot(DVec3::from(flat.map(|corner| corner.1)));
        let on_edge = sides.to_array().contains(&0.0);
        Some((depth / self.dir[z], weights, on_edge))
    }
}

/// The signed solid angle of a triangle seen from the origin (Van Oosterom and Strackee 1983), up to 4π.
fn solid_angle([a, b, c]: [DVec3; 3]) -> f64 {
    let (la, lb, lc) = (a.length(), b.length(), c.length());
    let volume = a.dot(b.cross(c));
    let cosines = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
    2.0 * volume.atan2(cosines)
}

/// The point of a triangle nearest to `p`: of its plane if that is within, else of its sides.
fn closest_in_triangle(p: DVec3, [a, b, c]: [DVec3; 3]) -> DVec3 {
    let normal = (b - a).cross(c - a);
    let outside = |from: DVec3, to: DVec3| normal.dot((to - from).cross(p - from)) < 0.0;
    let sides = [(a, b), (b, c), (c, a)];
    if normal != DVec3::ZERO && !sides.iter().any(|&(from, to)| outside(from, to)) {
        return p - normal * (normal.dot(p - a) / normal.length_squared());
    }
    let on_side = |(from, to): (DVec3, DVec3)| {
        let along = to - from;
        let part = ((p - from).dot(along) / along.length_squared()).clamp(0.0, 1.0);
        if part.is_finite() { from + along * part } else { from }
    };
    let candidates = sides.map(on_side);
    candidates.into_iter().reduce(|best, q| if q.distance(p) < best.distance(p) { q } else { best }).unwrap_or(a)
}

#[cfg(test)]
mod tests {
    use std::collections::HashMap;

    use super::*;

    fn numbers(mut state: u64) -> impl FnMut() -> f64 {
        move || {
            state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
            let mut z = state;
            z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
            z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
            ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
        }
    }

    fn point(uniform: &mut impl FnMut() -> f64) -> DVec3 {
        DVec3::new(2.0 * uniform() - 1.0, 2.0 * uniform() - 1.0, 2.0 * uniform() - 1.0)
    }

    /// An octahedron |x| + |y| + |z| ≤ 1 about `centre`, every face split into `n²` triangles.
    fn octahedron(n: u32, centre: DVec3) -> TriMesh {
        let mut mesh = TriMesh::default();
        let mut index = HashMap::new();
        for octant in 0..8u32 {
            let sign = |bit: u32| if octant >> bit & 1 == 0 { 1i64 } else { -1 };
            let signs = [sign(0), sign(1), sign(2)];
            let mirrored = signs[0] * signs[1] * signs[2] < 0;
            let mut at = |i: u32, j: u32| {
                let cell = [i, j, n - i - j].map(i64::from);
                let key = [cell[0] * signs[0], cell[1] * signs[1], cell[2] * signs[2]];
                *index.entry(key).or_insert_with(|| {
                    mesh.positions.push(centre + DVec3::from(key.map(|k| k as f64 / f64::from(n))));
                    mesh.positions.len() as u32 - 1
                })
            };
            let mut triangles = Vec::new();
            for i in 0..n {
                for j in 0..n - i {
                    triangles.push([at(i, j), at(i + 1, j), at(i, j + 1)]);
                    if i + j + 1 < n {
                        triangles.push([at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)]);
                    }
                }
            }
            mesh.triangles.extend(triangles.into_iter().map(|[a, b, c]| if mirrored { [a, c, b] } else { [a, b, c] }));
        }
        mesh
    }

    fn octahedron_contains(p: DVec3) -> bool {
        p.abs().element_sum() < 1.0
    }

    #[test]
    fn inside_is_inside_for_points_in_any_position_and_far_from_the_origin() {
        let mut uniform = numbers(1);
        for centre in [DVec3::ZERO, DVec3::new(4e5, -5e6, 120.0)] {
            let bvh = MeshBvh::new(Arc::new(octahedron(8, centre))).unwrap();
            assert!(bvh.is_closed());
            for round in 0..4000 {
                let p = point(&mut uniform);
                // Half of them on the lattice of corners, where lines along x meet edges and corners exactly.
                let p = if round % 2 == 0 { (p * 8.0).round() / 8.0 + DVec3::X / 16.0 } else { p };
                if (p.abs().element_sum() - 1.0).abs() > 1e-8 {
                    assert_eq!(bvh.contains(centre + p), octahedron_contains(p), "{p}");
                }
            }
        }
    }

    #[test]
    fn the_nearest_point_is_as_near_as_any_triangles() {
        let mut uniform = numbers(2);
        let mesh = octahedron(6, DVec3::splat(0.3));
        let bvh = MeshBvh::new(Arc::new(mesh.clone())).unwrap();
        for _ in 0..2000 {
            let p = point(&mut uniform) * 2.0;
            let found = bvh.closest(p);
            assert!((found.p.distance(p) - found.distance).abs() < 1e-15);
            let q = (p - 0.3).abs();
            // On the surface, in its triangle, and satisfying the condition of nearest points of a convex body: no vertex
            // lies further towards p.
            assert!(((found.p - 0.3).abs().element_sum() - 1.0).abs() < 1e-12);
            if q.element_sum() > 1.0 {
                for vertex in &mesh.positions {
                    assert!((vertex - found.p).dot(p - found.p) < 1e-12);
                }
                assert!(bvh.signed_distance(p) > 0.0);
            } else {
                let depth = (1.0 - q.element_sum()) / 3f64.sqrt();
                assert!((bvh.signed_distance(p) + depth).abs() < 1e-12);
            }
            assert_eq!(bvh.closest_within(p, found.distance * 0.999), None);
            assert_eq!(bvh.closest_within(p, found.distance * 1.001), Some(found));
        }
    }

    #[test]
    fn lines_cross_where_the_planes_say() {
        let mut uniform = numbers(3);
        let bvh = MeshBvh::new(Arc::new(octahedron(7, DVec3::ZERO))).unwrap();
        let mut hits = Vec::new();
        let mut met = 0;
        for _ in 0..4000 {
            let (through, dir) = (point(&mut uniform), point(&mut uniform) * 3.0);
            let origin = through - dir * 5.0;
            bvh.intersect(origin, dir, &mut hits);
            // The octahedron is the meeting of eight half-spaces ±x ± y ± z < 1.
            let (mut enter, mut leave) = (f64::NEG_INFINITY, f64::INFINITY);
            for octant in 0..8u32 {
                let sign = |bit: u32| if octant >> bit & 1 == 0 { 1.0 } else { -1.0 };
                let n = DVec3::new(sign(0), sign(1), sign(2));
                let t = (1.0 - n.dot(origin)) / n.dot(dir);
                if n.dot(dir) < 0.0 { enter = enter.max(t) } else { leave = leave.min(t) }
            }
            if enter > leave {
                assert!(hits.is_empty());
                continue;
            }
            met += 1;
            assert_eq!(hits.len(), 2);
            assert!((hits[0].t - enter).abs() < 1e-12 && (hits[1].t - leave).abs() < 1e-12);
            assert!(hits[0].normal.dot(dir) < 0.0 && hits[1].normal.dot(dir) > 0.0);
            let [a, b, c] = bvh.mesh().corners(hits[0].triangle as usize);
            let w = hits[0].weights;
            assert!((a * w.x + b * w.y + c * w.z).distance(origin + dir * enter) < 1e-11);
            for (guess, expected) in [(enter - 1.0, 0), (leave + 1.0, 1), (0.4 * enter + 0.6 * leave, 1)] {
                assert_eq!(bvh.nearest_crossing(origin, dir, guess), Some(hits[expected]));
            }
        }
        assert!(met > 1000);
    }

    #[test]
    fn an_open_meshs_inside_is_its_winding_number() {
        // Without one small triangle of 8 · 6² the winding number is 1 less that triangle's solid angle over 4π.
        let mut mesh = octahedron(6, DVec3::ZERO);
        let gone = mesh.corners(17);
        mesh.triangles.remove(17);
        let bvh = MeshBvh::new(Arc::new(mesh)).unwrap();
        assert!(!bvh.is_closed());
        let mut uniform = numbers(4);
        for _ in 0..2000 {
            let p = point(&mut uniform) * 1.2;
            if (p.abs().element_sum() - 1.0).abs() < 1e-6 {
                continue;
            }
            let inside = octahedron_contains(p);
            let expected = f64::from(u8::from(inside)) - solid_angle(gone.map(|corner| corner - p)) / (2.0 * TAU);
            assert!((bvh.winding_number(p) - expected).abs() < 0.02, "{p}");
            if (expected - 0.5).abs() > 0.05 {
                assert_eq!(bvh.contains(p), inside);
            }
        }
    }

    #[test]
    fn unusable_meshes_are_refused() {
        let build = |mesh: TriMesh| MeshBvh::new(Arc::new(mesh)).err();
        assert_eq!(build(TriMesh::default()), Some(MeshBvhError::Empty));
        let mut mesh = octahedron(1, DVec3::ZERO);
        mesh.positions[2].y = f64::NAN;
        assert_eq!(build(mesh), Some(MeshBvhError::NotFinite { vertex: 2 }));
        let mut mesh = octahedron(1, DVec3::ZERO);
        mesh.triangles[3][1] = 6;
        assert_eq!(build(mesh), Some(MeshBvhError::NoSuchVertex { triangle: 3, vertices: 6 }));
        // One triangle is a tree of one node.
        let one =
            TriMesh { positions: vec![DVec3::ZERO, DVec3::X, DVec3::Y], triangles: vec![[0, 1, 2]], colours: None };
        let bvh = MeshBvh::new(Arc::new(one)).unwrap();
        assert_eq!(bvh.closest(DVec3::new(-1.0, -1.0, 0.0)).distance, 2f64.sqrt());
    }
}
