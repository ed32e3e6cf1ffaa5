//! Exact questions to a leaf that is represented as itself: an analytic solid or a triangle mesh, asked in world space.
//!
//! # Theory
//! A surfel scene asks three things of an exact leaf: is a point inside, does the surface pass within a distance of a
//! point (Wicke 2004 §3.1.2, `r < d`), and where precisely does a ray cross near a depth that the splats suggest. All
//! three are answered in leaf space ([`Solid`], [`MeshBvh`]), where the shape is as the user wrote it. Insides and ray
//! parameters do not change under an affine map; distances shrink by at most its least stretch, so leaf distances times
//! that are bounds in world space.

use std::sync::Arc;

use glam::{DAffine3, DMat3, DVec3};

use super::bvh::{MeshBvh, MeshBvhError};
use super::{Solid, TriMesh};
use crate::space::{Motion, Ray};

/// Where a ray crosses an exact leaf's surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExactHit {
    /// Ray parameter (planar depth).
    pub t: f64,
    /// Unit outward normal of the leaf, world space.
    pub normal_in_world: DVec3,
}

#[derive(Clone)]
enum Shape {
    Solid(Solid),
    Mesh(Arc<MeshBvh>),
}

/// An exactly represented leaf in world space.
pub struct Exact {
    shape: Shape,
    leaf_from_world: DAffine3,
    world_normal_from_leaf: DMat3,
    /// World length of the shortest image of a leaf-space unit vector, at least.
    least_stretch: f64,
}

impl std::fmt::Debug for Exact {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let shape = match &self.shape {
            Shape::Solid(solid) => format!("{solid:?}"),
            Shape::Mesh(mesh) => format!("mesh of {} triangles", mesh.mesh().triangles.len()),
        };
        f.debug_struct("Exact").field("shape", &shape).field("leaf_from_world", &self.leaf_from_world).finish()
    }
}

/// A lower bound of the least singular value of the linear map whose *inverse* is `inverse`; exact for similarities.
pub fn least_stretch(inverse: DMat3) -> f64 {
    // σ_min(A) = 1 / ‖A⁻¹‖₂ ≥ 1 / ‖A⁻¹‖_F; of a similarity all columns are equally long and perpendicular.
    let columns = [inverse.x_axis, inverse.y_axis, inverse.z_axis];
    let longest = columns.iter().map(|c| c.length()).fold(0.0, f64::max);
    let shortest = columns.iter().map(|c| c.length()).fold(f64::INFINITY, f64::min);
    const SAME: f64 = 1e-9; // of the length: far above rounding, far below a scale that a user would write
    let perpendicular =
        [(0, 1), (0, 2), (1, 2)].iter().all(|&(i, j)| columns[i].dot(columns[j]).abs() <= SAME * longest * longest);
    let norm = if perpendicular && longest - shortest <= SAME * longest {
        longest
    } else {
        columns.iter().map(|c| c.length_squared()).sum::<f64>().sqrt()
    };
    1.0 / norm
}

impl Exact {
    fn new(shape: Shape, world_from_leaf: DAffine3) -> Self {
        let leaf_from_world = world_from_leaf.inverse();
        let inverse = leaf_from_world.matrix3;
        // A mesh's normals follow the order of its corners, which mirroring turns inside out; A⁻ᵀ does not.
        Self {
            shape,
            leaf_from_world,
            world_normal_from_leaf: inverse.transpose(),
            least_stretch: least_stretch(inverse),
        }
    }

    /// `solid` placed by the invertible map `world_from_leaf`.
    pub fn solid(solid: Solid, world_from_leaf: DAffine3) -> Self {
        Self::new(Shape::Solid(solid), world_from_leaf)
    }

    /// `mesh` placed by the invertible map `world_from_leaf`. A mesh that is open has the inside of its winding number.
    ///
    /// # Errors
    /// As [`MeshBvh::new`].
    pub fn mesh(mesh: Arc<TriMesh>, world_from_leaf: DAffine3) -> Result<Self, MeshBvhError> {
        Ok(Self::new(Shape::Mesh(Arc::new(MeshBvh::new(mesh)?)), world_from_leaf))
    }

    /// The leaf moved by `motion`; what it took to ask it is shared.
    pub fn moved(&self, motion: &Motion) -> Self {
        Self::new(self.shape.clone(), motion.affine() * self.leaf_from_world.inverse())
    }

    /// Whether `p_in_world` is inside.
    pub fn contains(&self, p_in_world: DVec3) -> bool {
        let p = self.leaf_from_world.transform_point3(p_in_world);
        match &self.shape {
            Shape::Solid(solid) => solid.contains(p),
            Shape::Mesh(mesh) => mesh.contains(p),
        }
    }

    /// Whether the surface certainly keeps a distance of more than `radius` (world units) from `p_in_world`. A `false`
    /// may be wrong for a stretched leaf, a `true` never is.
    pub fn is_farther_than(&self, p_in_world: DVec3, radius: f64) -> bool {
        let p = self.leaf_from_world.transform_point3(p_in_world);
        match &self.shape {
            Shape::Solid(solid) => solid.signed_distance_bound(p).abs() * self.least_stretch > radius,
            Shape::Mesh(mesh) => mesh.closest_within(p, radius / self.least_stretch).is_none(),
        }
    }

    /// The crossing nearest to depth `t` within `reach` of it that enters (`front`) or leaves the leaf.
    pub fn nearest_crossing(&self, ray: &Ray, t: f64, reach: f64, front: bool) -> Option<ExactHit> {
        // Anchor the line near the hit: far origins cost digits.
        let origin = self.leaf_from_world.transform_point3(ray.at(t));
        let dir = self.leaf_from_world.transform_vector3(ray.dir);
        let mut best: Option<(f64, DVec3)> = None;
        let mut offer = |tau: f64, normal: DVec3| {
            let enters = normal.dot(dir) < 0.0;
            if enters == front && tau.abs() <= reach && best.is_none_or(|(b, _)| tau.abs() < b.abs()) {
                best = Some((tau, normal));
            }
        };
        match &self.shape {
            Shape::Solid(solid) => {
                let mut hits = Vec::new();
                solid.intersect(origin, dir, &mut hits);
                hits.iter().for_each(|hit| offer(hit.t, hit.normal));
            }
            Shape::Mesh(mesh) => mesh.intersect_within(origin, dir, reach, &mut |hit| offer(hit.t, hit.normal)),
        }
        best.map(|(tau, normal)| ExactHit {
            t: t + tau,
            normal_in_world: (self.world_normal_from_leaf * normal).normalize_or_zero(),
        })
    }
}
