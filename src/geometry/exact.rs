//! Exact questions to a leaf that is represented as itself: an analytic solid or a triangle mesh, asked in world space.
//!
//! # Theory
//! A surfel scene asks three things of an exact leaf: is a point inside, does the surface pass within a distance of a
//! point (Wicke 2004 §3.1.2, `r < d`), and where precisely does a ray cross near a depth that the splats suggest. Solids
//! answer by formula. A mesh answers through a bounding volume hierarchy (obvhs): inside by the parity of crossings,
//! or, where the mesh is open, by the generalised winding number; distance by closest points; crossings by ray-triangle
//! tests whose edge functions are evaluated from the same two vertices in the same order on both sides of an edge, so
//! that no ray slips between two triangles.
//!
//! # Practice
//! The hierarchy is `f32` about the mesh's own origin and its boxes are widened by their rounding; every decision is made
//! on `f64` vertices.

use glam::{DAffine3, DMat3, DVec3, Vec3A};
use obvhs::BvhBuildParams;
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::builder::build_bvh2;
use obvhs::ray::Ray as BoxRay;

use super::winding::{Element, Winding};
use super::{Solid, TriMesh};
use crate::space::Ray;

/// Where a ray crosses an exact leaf's surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExactHit {
    /// Ray parameter (planar depth).
    pub t: f64,
    /// Unit outward normal of the leaf, world space.
    pub normal_in_world: DVec3,
    /// The triangle, for a mesh; 0 for a solid.
    pub triangle: u32,
}

/// An exactly represented leaf in world space.
#[derive(Debug)]
pub enum Exact {
    /// An analytic solid.
    Solid(ExactSolid),
    /// A triangle mesh.
    Mesh(Box<ExactMesh>),
}

/// An analytic solid under an affine map.
#[derive(Debug)]
pub struct ExactSolid {
    solid: Solid,
    leaf_from_world: DAffine3,
    world_normal_from_leaf: DMat3,
    /// World length of the shortest image of a leaf-space unit vector, at least: turns leaf distances into world bounds.
    least_stretch: f64,
}

impl ExactSolid {
    /// `solid` placed by the invertible map `world_from_leaf`.
    pub fn new(solid: Solid, world_from_leaf: DAffine3) -> Self {
        let leaf_from_world = world_from_leaf.inverse();
        // ‖A⁻¹‖ ≤ its Frobenius norm, and σ_min(A) = 1 / ‖A⁻¹‖₂; a similarity is common and gets its exact factor.
        let m = leaf_from_world.matrix3;
        let columns = [m.x_axis, m.y_axis, m.z_axis];
        let longest = columns.iter().map(|c| c.length()).fold(0.0, f64::max);
        let shortest = columns.iter().map(|c| c.length()).fold(f64::INFINITY, f64::min);
        const SAME: f64 = 1e-9;
        let orthogonal =
            [(0, 1), (0, 2), (1, 2)].iter().all(|&(i, j)| columns[i].dot(columns[j]).abs() <= SAME * longest * longest);
        let norm = if orthogonal && longest - shortest <= SAME * longest {
            longest
        } else {
            columns.iter().map(|c| c.length_squared()).sum::<f64>().sqrt()
        };
        Self { solid, leaf_from_world, world_normal_from_leaf: m.transpose(), least_stretch: 1.0 / norm }
    }
}

/// A triangle mesh in world space with its hierarchy.
pub struct ExactMesh {
    origin: DVec3,
    /// Vertices relative to `origin`, world units.
    positions: Vec<DVec3>,
    /// In the hierarchy's order.
    triangles: Vec<[u32; 3]>,
    /// Original index of each triangle of `triangles`.
    source: Vec<u32>,
    bvh: Bvh2,
    /// Where the mesh is open, its inside is the winding number's.
    winding: Option<Winding>,
    /// 1 where the map kept orientation, −1 where it mirrored.
    handedness: f64,
}

impl std::fmt::Debug for ExactMesh {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("ExactMesh").field("triangles", &self.triangles.len()).finish_non_exhaustive()
    }
}

struct TriangleBox(Aabb);
impl obvhs::Boundable for TriangleBox {
    fn aabb(&self) -> Aabb {
        self.0
    }
}

/// An `f32` box that holds `f64` points whose coordinates were rounded: one unit in the last place each way.
fn widened(min: DVec3, max: DVec3) -> Aabb {
    let lower = |x: f64| (x as f32).next_down();
    let upper = |x: f64| (x as f32).next_up();
    Aabb::new(
        Vec3A::new(lower(min.x), lower(min.y), lower(min.z)),
        Vec3A::new(upper(max.x), upper(max.y), upper(max.z)),
    )
}

impl ExactMesh {
    /// `mesh` placed by the invertible map `world_from_leaf`.
    pub fn new(mesh: &TriMesh, world_from_leaf: DAffine3) -> Self {
        let world: Vec<DVec3> = mesh.positions.iter().map(|p| world_from_leaf.transform_point3(*p)).collect();
        let (mut min, mut max) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for p in &world {
            min = min.min(*p);
            max = max.max(*p);
        }
        let origin = if world.is_empty() { DVec3::ZERO } else { 0.5 * (min + max) };
        let positions: Vec<DVec3> = world.iter().map(|p| *p - origin).collect();
        let boxes: Vec<TriangleBox> = mesh
            .triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.map(|v| positions[v as usize]);
                TriangleBox(widened(a.min(b).min(c), a.max(b).max(c)))
            })
            .collect();
        let bvh = build_bvh2(&boxes, BvhBuildParams::fast_build(), &mut std::time::Duration::default());
        let source = bvh.primitive_indices.clone();
        let triangles: Vec<[u32; 3]> = source.iter().map(|&t| mesh.triangles[t as usize]).collect();
        let handedness = world_from_leaf.matrix3.determinant().signum();
        let mut exact = Self { origin, positions, triangles, source, bvh, winding: None, handedness };
        if !is_closed(&mesh.triangles) {
            exact.winding = Some(Winding::new(exact.elements()));
        }
        exact
    }

    /// Whether every directed edge has its opposite, so that parity is meaningful.
    pub fn is_closed(&self) -> bool {
        self.winding.is_none()
    }

    fn corners(&self, triangle: usize) -> [DVec3; 3] {
        self.triangles[triangle].map(|v| self.positions[v as usize])
    }

    /// The triangles as dipoles, in the hierarchy's order, which is spatial.
    fn elements(&self) -> Vec<Element> {
        (0..self.triangles.len())
            .map(|t| {
                let [a, b, c] = self.corners(t);
                let area_normal = 0.5 * self.handedness * (b - a).cross(c - a);
                Element { position: self.origin + (a + b + c) / 3.0, area_normal }
            })
            .collect()
    }

    fn normal(&self, triangle: usize) -> DVec3 {
        let [a, b, c] = self.corners(triangle);
        (self.handedness * (b - a).cross(c - a)).normalize_or_zero()
    }

    /// Calls `each(triangle, t)` for every crossing of the line `origin + t dir` (both relative to `self.origin`) with
    /// `t` in `range`.
    fn crossings(&self, origin: DVec3, dir: DVec3, range: (f64, f64), mut each: impl FnMut(usize, f64)) {
        // The f32 ray only steers the search: start it at the range's beginning, where its rounding is smallest, and
        // widen boxes by that rounding through a slightly longer range.
        let start = origin + dir * range.0;
        let length = range.1 - range.0;
        const SLACK: f64 = 1e-4; // of the range: far more than f32 rounding of its end points
        let slack = SLACK * length;
        let ray = BoxRay::new((start - dir * slack).as_vec3a(), dir.as_vec3a(), 0.0, (length + 2.0 * slack) as f32);
        self.bvh.ray_traverse_anyhit(ray, |_, triangle| {
            if let Some(t) = self.cross_triangle(triangle, origin, dir)
                && t >= range.0
                && t <= range.1
            {
                each(triangle, t);
            }
        });
    }

    /// The parameter where the line crosses a triangle. An edge function is computed from its two vertices in index
    /// order, so both triangles of an edge see the same number with opposite signs and a line crosses exactly one.
    fn cross_triangle(&self, triangle: usize, origin: DVec3, dir: DVec3) -> Option<f64> {
        let [i, j, k] = self.triangles[triangle];
        let edge = |u: u32, v: u32| {
            let (lo, hi, sign) = if u < v { (u, v, 1.0) } else { (v, u, -1.0) };
            let (a, b) = (self.positions[lo as usize] - origin, self.positions[hi as usize] - origin);
            let side = a.cross(b).dot(dir);
            // On the edge exactly: the lower vertex's side, the same decision for both triangles.
            sign * if side == 0.0 { f64::MIN_POSITIVE } else { side }
        };
        let (ij, jk, ki) = (edge(i, j), edge(j, k), edge(k, i));
        let all_in = (ij > 0.0 && jk > 0.0 && ki > 0.0) || (ij < 0.0 && jk < 0.0 && ki < 0.0);
        if !all_in {
            return None;
        }
        let [a, b, c] = self.corners(triangle);
        let sum = ij + jk + ki;
        // Barycentric weights are the opposite edges' functions; interpolating depth keeps the hit inside the triangle.
        let p = ((a - origin) * jk + (b - origin) * ki + (c - origin) * ij) / sum;
        Some(p.dot(dir) / dir.length_squared())
    }

    fn contains(&self, p_in_world: DVec3) -> bool {
        if let Some(winding) = &self.winding {
            return winding.at(p_in_world) > 0.5;
        }
        // Any direction serves; this one is parallel to no axis, face diagonal or common draft angle.
        const PROBE: DVec3 = DVec3::new(0.529_134, 0.413_017, 0.741_203);
        let p = p_in_world - self.origin;
        let mut crossings = 0_u32;
        let reach = 2.0 * (p.length() + self.radius());
        self.crossings(p, PROBE, (0.0, reach), |_, _| crossings += 1);
        crossings % 2 == 1
    }

    fn radius(&self) -> f64 {
        self.bvh.nodes.first().map_or(0.0, |n| {
            let b = n.aabb();
            b.min.abs().max(b.max.abs()).length().into()
        })
    }

    fn is_farther_than(&self, p_in_world: DVec3, radius: f64) -> bool {
        let p = p_in_world - self.origin;
        let mut far = true;
        let probe = widened(p - DVec3::splat(radius), p + DVec3::splat(radius));
        self.bvh.aabb_traverse(probe, |bvh, node| {
            let node = &bvh.nodes[node as usize];
            for t in node.first_index..node.first_index + node.prim_count {
                if closest_on_triangle(p, self.corners(t as usize)).distance_squared(p) <= radius * radius {
                    far = false;
                    return false;
                }
            }
            true
        });
        far
    }
}

/// Whether each directed edge is matched by its opposite as often as it occurs.
fn is_closed(triangles: &[[u32; 3]]) -> bool {
    let mut balance: std::collections::HashMap<(u32, u32), i32> = std::collections::HashMap::new();
    for &[a, b, c] in triangles {
        for (u, v) in [(a, b), (b, c), (c, a)] {
            if u != v {
                *balance.entry((u.min(v), u.max(v))).or_default() += if u < v { 1 } else { -1 };
            }
        }
    }
    balance.values().all(|&b| b == 0)
}

/// The point of a triangle closest to `p` (Ericson, "Real-Time Collision Detection", §5.1.5: Voronoi regions).
fn closest_on_triangle(p: DVec3, [a, b, c]: [DVec3; 3]) -> DVec3 {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return a;
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(bp), ac.dot(bp));
    if d3 >= 0.0 && d4 <= d3 {
        return b;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return a + ab * (d1 / (d1 - d3));
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    if d6 >= 0.0 && d5 <= d6 {
        return c;
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return a + ac * (d2 / (d2 - d6));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        return b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)));
    }
    let sum = va + vb + vc;
    if sum > 0.0 { a + ab * (vb / sum) + ac * (vc / sum) } else { a }
}

impl Exact {
    /// Whether `p_in_world` is inside.
    pub fn contains(&self, p_in_world: DVec3) -> bool {
        match self {
            Self::Solid(s) => s.solid.contains(s.leaf_from_world.transform_point3(p_in_world)),
            Self::Mesh(m) => m.contains(p_in_world),
        }
    }

    /// Whether the surface certainly keeps a distance of more than `radius` (world units) from `p_in_world`. A `false`
    /// may be wrong for a stretched solid, a `true` never is.
    pub fn is_farther_than(&self, p_in_world: DVec3, radius: f64) -> bool {
        match self {
            Self::Solid(s) => {
                let p = s.leaf_from_world.transform_point3(p_in_world);
                s.solid.signed_distance_bound(p).abs() * s.least_stretch > radius
            }
            Self::Mesh(m) => m.is_farther_than(p_in_world, radius),
        }
    }

    /// The crossing nearest to depth `t` within `reach` of it that enters (`front`) or leaves the leaf.
    pub fn nearest_crossing(&self, ray: &Ray, t: f64, reach: f64, front: bool) -> Option<ExactHit> {
        let mut best: Option<ExactHit> = None;
        let mut offer = |hit: ExactHit| {
            let faces = (hit.normal_in_world.dot(ray.dir) < 0.0) == front;
            let gap = (hit.t - t).abs();
            if faces && gap <= reach && best.is_none_or(|b| gap < (b.t - t).abs()) {
                best = Some(hit);
            }
        };
        match self {
            Self::Solid(s) => {
                // Anchor the line near the hit: far origins cost digits in the quadratics.
                let origin = s.leaf_from_world.transform_point3(ray.at(t));
                let dir = s.leaf_from_world.transform_vector3(ray.dir);
                let mut hits = Vec::new();
                s.solid.intersect(origin, dir, &mut hits);
                for hit in hits {
                    let normal_in_world = (s.world_normal_from_leaf * hit.normal).normalize_or_zero();
                    offer(ExactHit { t: t + hit.t, normal_in_world, triangle: 0 });
                }
            }
            Self::Mesh(m) => {
                let origin = ray.at(t) - m.origin;
                m.crossings(origin, ray.dir, (-reach, reach), |triangle, tau| {
                    let normal_in_world = m.normal(triangle);
                    offer(ExactHit { t: t + tau, normal_in_world, triangle: m.source[triangle] });
                });
            }
        }
        best
    }
}
