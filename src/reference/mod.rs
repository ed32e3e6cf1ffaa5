//! The judge: a plain `f64` ray caster that every pipeline is measured against.
//!
//! It casts rays at the leaves' *truth* (analytic solids and triangle meshes), sorts all their crossings, and walks along
//! the ray toggling leaves. It is never fast and never clever, and shares no code with the pipelines beyond the scene, the
//! camera and the tree: its ray-solid and ray-mesh intersections are its own, by other methods than
//! [`crate::geometry::solid`]'s.
//!
//! ```text
//! pixel ─► samples ─► ray ─► all crossings of every leaf ─► rule: before ≠ after ─► boundaries ─► merged by pixel
//!                             implicit.rs, mesh.rs           rule.rs                               merge.rs
//! ```

use std::sync::Arc;

use glam::{DAffine3, DMat3, DVec2, DVec3};

use crate::csg::{LeafId, Node, Tree};
use crate::geometry::TriMesh;
use crate::geometry::solid::{Solid, SolidError};
use crate::layers::{Boundary, Facing, LayerLimit, LayerSource, LayerTile, MAX_SAMPLES, sample_offsets};
use crate::scene::LeafKind;
use crate::space::{Camera, PixelRect, Ray};

mod implicit;
mod merge;
mod mesh;
mod rule;
#[cfg(test)]
mod tests;

use implicit::Implicit;
use mesh::CastMesh;
use rule::{Crossing, Settled};

/// What a leaf really is.
#[derive(Debug, Clone)]
pub enum TruthShape {
    /// An analytic solid, in leaf space. A half-space cuts everywhere but shows only its drawn square.
    Solid(Solid),
    /// A mesh, in leaf space. Inside is where a ray to infinity crosses it an odd number of times.
    Mesh(Arc<TriMesh>),
}

/// One leaf as the judge sees it.
#[derive(Debug, Clone)]
pub struct TruthLeaf {
    /// Index in the scene: the `leaf` of the layers and the [`LeafId`] of the tree.
    pub leaf: u32,
    /// Its geometry.
    pub shape: TruthShape,
    /// Leaf space to world space; affine, invertible, may mirror.
    pub world_from_leaf: DAffine3,
    /// Linear RGB.
    pub colour: [f32; 3],
    /// Whether a mesh's own vertex colours win over `colour`.
    pub vertex_colours: bool,
    /// Opacity, 0 to 1.
    pub opacity: f32,
    /// A sheet shows its surface where the result needs it, and cuts nothing.
    pub kind: LeafKind,
}

impl TruthLeaf {
    /// An opaque grey solid without transform.
    pub fn new(leaf: u32, shape: TruthShape) -> Self {
        /// Linear light of mid grey.
        const GREY: [f32; 3] = [0.5; 3];
        Self {
            leaf,
            shape,
            world_from_leaf: DAffine3::IDENTITY,
            colour: GREY,
            vertex_colours: false,
            opacity: 1.0,
            kind: LeafKind::Solid,
        }
    }
}

/// Why the judge cannot judge.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ReferenceError {
    /// Two truths for one leaf.
    #[error("leaf {leaf} was given twice")]
    Twice {
        /// Its index.
        leaf: u32,
    },
    /// The transform flattens the leaf, or is not finite.
    #[error("the transform of leaf {leaf} cannot be inverted: its scale must be finite and nowhere zero")]
    Transform {
        /// Its index.
        leaf: u32,
    },
    /// The solid has an unusable number.
    #[error("the solid of leaf {leaf} is unusable: {source}")]
    Solid {
        /// Its index.
        leaf: u32,
        /// What is wrong with it.
        source: SolidError,
    },
    /// A triangle of the mesh points beyond its vertices, or a vertex is not finite.
    #[error("the mesh of leaf {leaf} is unusable: {what}")]
    Mesh {
        /// Its index.
        leaf: u32,
        /// What is wrong with it.
        what: String,
    },
    /// Samples a pixel out of range.
    #[error("samples a pixel must be 1 to {MAX_SAMPLES}, not {0}")]
    Samples(u32),
}

/// One boundary of the result along one ray, at full precision.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RayBoundary {
    /// Planar view depth, world units.
    pub depth: f64,
    /// Outward unit normal of the result, world space.
    pub normal: DVec3,
    /// Linear RGB.
    pub colour: [f32; 3],
    /// The leaf's opacity.
    pub opacity: f32,
    /// Whose surface it is.
    pub leaf: u32,
    /// Whose material lies behind it.
    pub body: u32,
    /// Whether the result is entered or left.
    pub facing: Facing,
}

/// The expression: given which leaves a point is in, whether it is in the result.
pub type Expression = dyn Fn(&dyn Fn(u32) -> bool) -> bool + Send + Sync;

/// As [`Expression`], asked for each occurrence of a leaf and told whether the leaf is complemented there.
type Occurrences = dyn Fn(&dyn Fn(u32, bool) -> bool) -> bool + Send + Sync;

/// Of each occurrence of a leaf in `tree`, from left to right, whether it is complemented: below an odd number of
/// complements and right sides of differences.
fn complemented(tree: &Tree) -> Vec<bool> {
    let nodes = tree.nodes();
    let mut is_odd = vec![false; nodes.len()];
    // Operands come before their operators.
    for (i, node) in nodes.iter().enumerate().rev() {
        match *node {
            Node::Leaf(_) => {}
            Node::Not(a) => is_odd[a as usize] = !is_odd[i],
            Node::And(a, b) | Node::Or(a, b) => (is_odd[a as usize], is_odd[b as usize]) = (is_odd[i], is_odd[i]),
            Node::Minus(a, b) => (is_odd[a as usize], is_odd[b as usize]) = (is_odd[i], !is_odd[i]),
        }
    }
    nodes.iter().zip(is_odd).filter(|(node, _)| matches!(node, Node::Leaf(_))).map(|(_, is_odd)| is_odd).collect()
}

enum Caster {
    Implicit(Implicit),
    Mesh(CastMesh),
}

struct Prepared {
    truth: TruthLeaf,
    caster: Caster,
    leaf_from_world: DAffine3,
    /// Normals to world space, up to length.
    world_from_normal: DMat3,
}

/// The reference renderer, ready for one frame.
pub struct Reference {
    leaves: Vec<Prepared>,
    inside: Box<Occurrences>,
    camera: Camera,
    samples: u32,
    limit: LayerLimit,
    /// Crossings closer than this in depth coincide; world units.
    coincidence: f64,
}

/// A ray that meets an edge or a vertex of a mesh so exactly that a crossing there cannot be told from a touch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Grazed;

/// Crossings coincide when closer than this part of the scene's size.
const COINCIDENCE: f64 = 1e-9;

/// How often a ray that grazes an edge is cast again, beside the old one.
const MOST_RETRIES: u32 = 16;

/// How far beside, in pixels: far below what a picture shows, far above rounding.
const JITTER_PX: f64 = 1e-7;

impl Reference {
    /// The judge for `tree` over `leaves` (in any order) seen by `camera`.
    ///
    /// # Errors
    /// [`ReferenceError`] names the leaf that cannot be cast at.
    pub fn new(
        leaves: Vec<TruthLeaf>,
        tree: Tree,
        camera: Camera,
        samples: u32,
        limit: LayerLimit,
    ) -> Result<Self, ReferenceError> {
        let complemented = complemented(&tree);
        let inside = move |leaf_in: &dyn Fn(u32, bool) -> bool| {
            let mut occurrences = complemented.iter();
            tree.eval(|leaf: LeafId| leaf_in(leaf.0, occurrences.next().is_some_and(|is_odd| *is_odd)))
        };
        Self::with_occurrences(leaves, Box::new(inside), camera, samples, limit)
    }

    /// The judge for the expression `inside` over `leaves` (in any order) seen by `camera`. Where a cut face shows a leaf that
    /// occurs both complemented and not, only [`new`](Self::new) can tell the two apart.
    ///
    /// # Errors
    /// [`ReferenceError`] names the leaf that cannot be cast at.
    pub fn with_expression(
        leaves: Vec<TruthLeaf>,
        inside: Box<Expression>,
        camera: Camera,
        samples: u32,
        limit: LayerLimit,
    ) -> Result<Self, ReferenceError> {
        let inside = move |leaf_in: &dyn Fn(u32, bool) -> bool| inside(&|leaf| leaf_in(leaf, false));
        Self::with_occurrences(leaves, Box::new(inside), camera, samples, limit)
    }

    fn with_occurrences(
        leaves: Vec<TruthLeaf>,
        inside: Box<Occurrences>,
        camera: Camera,
        samples: u32,
        limit: LayerLimit,
    ) -> Result<Self, ReferenceError> {
        if !(1..=MAX_SAMPLES).contains(&samples) {
            return Err(ReferenceError::Samples(samples));
        }
        let mut leaves = leaves.into_iter().map(Prepared::new).collect::<Result<Vec<_>, _>>()?;
        leaves.sort_by_key(|leaf| leaf.truth.leaf);
        if let Some(pair) = leaves.windows(2).find(|pair| pair[0].truth.leaf == pair[1].truth.leaf) {
            return Err(ReferenceError::Twice { leaf: pair[0].truth.leaf });
        }
        let coincidence = coincidence(&leaves, &camera);
        Ok(Self { leaves, inside, camera, samples, limit, coincidence })
    }

    /// Crossings closer than this in depth are taken as one; world units.
    pub fn coincidence(&self) -> f64 {
        self.coincidence
    }

    /// The boundaries of the result along the ray through picture position `px` (pixels), front to back, beyond depth 0.
    /// With [`LayerLimit::Nearest`] the first alone. A ray that grazes an edge of a mesh is cast again a
    /// ten-millionth of a pixel beside.
    pub fn cast(&self, px: DVec2) -> Vec<RayBoundary> {
        // Directions a golden angle apart, so that no two retries lie along one edge.
        const GOLDEN_ANGLE: f64 = 2.399_963_229_728_653;
        for retry in 0..MOST_RETRIES {
            let beside = DVec2::from_angle(f64::from(retry) * GOLDEN_ANGLE) * (f64::from(retry) * JITTER_PX);
            if let Ok(found) = self.try_cast(&self.camera.ray(px + beside), false) {
                return found;
            }
        }
        // A mesh so degenerate that every ray grazes: what its crossings say is still the best answer there is.
        self.try_cast(&self.camera.ray(px), true).unwrap_or_default()
    }

    fn try_cast(&self, ray: &Ray, tolerant: bool) -> Result<Vec<RayBoundary>, Grazed> {
        let mut crossings = Vec::new();
        let mut states = Vec::with_capacity(self.leaves.len());
        for (slot, leaf) in self.leaves.iter().enumerate() {
            states.push(leaf.cast(slot, ray, tolerant, &mut crossings)?);
        }
        let slots: Vec<(u32, bool)> =
            self.leaves.iter().map(|l| (l.truth.leaf, l.truth.kind == LeafKind::Sheet)).collect();
        let settled = rule::settle(&slots, states, crossings, self.coincidence, &*self.inside, self.limit);
        Ok(settled.into_iter().map(|found| self.describe(ray, found)).collect())
    }

    fn describe(&self, ray: &Ray, found: Settled) -> RayBoundary {
        let leaf = &self.leaves[found.crossing.slot].truth;
        // Outward from the result: against the ray where it is entered, along it where it is left.
        let outward = match found.facing {
            Facing::Front => -1.0,
            Facing::Back => 1.0,
        };
        let normal = found.crossing.normal;
        RayBoundary {
            depth: found.crossing.t,
            normal: if normal.dot(ray.dir) * outward < 0.0 { -normal } else { normal },
            colour: found.crossing.colour,
            opacity: leaf.opacity,
            leaf: leaf.leaf,
            body: self.leaves[found.body].truth.leaf,
            facing: found.facing,
        }
    }
}

/// The tolerance of coincidence: a part of the scene's size, and no less than what its coordinates resolve.
fn coincidence(leaves: &[Prepared], camera: &Camera) -> f64 {
    /// A crossing's depth carries the rounding of a few dozen operations on coordinates.
    const ROUNDINGS: f64 = 64.0;
    let world_bounds = |leaves: &mut dyn Iterator<Item = &Prepared>| {
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for leaf in leaves {
            let (min, max) = match &leaf.caster {
                Caster::Implicit(solid) => solid.drawn_bounds(),
                Caster::Mesh(mesh) => mesh.bounds(),
            };
            for corner in 0..8u32 {
                let pick = |bit: u32, a: f64, b: f64| if corner >> bit & 1 == 0 { a } else { b };
                let p_in_leaf = DVec3::new(pick(0, min.x, max.x), pick(1, min.y, max.y), pick(2, min.z, max.z));
                let p_in_world = leaf.truth.world_from_leaf.transform_point3(p_in_leaf);
                (low, high) = (low.min(p_in_world), high.max(p_in_world));
            }
        }
        (low, high)
    };
    // A half-space may be drawn far beyond everything else: it has no size unless there is nothing else.
    let is_bounded = |leaf: &&Prepared| !matches!(leaf.truth.shape, TruthShape::Solid(Solid::HalfSpace { .. }));
    let (mut low, mut high) = world_bounds(&mut leaves.iter().filter(is_bounded));
    if !(low.is_finite() && high.is_finite()) {
        (low, high) = world_bounds(&mut leaves.iter());
    }
    if !(low.is_finite() && high.is_finite()) {
        return f64::MIN_POSITIVE; // no leaf, or only empty meshes
    }
    let largest = low.abs().max(high.abs()).max(camera.eye.abs()).max_element();
    (COINCIDENCE * (high - low).length()).max(ROUNDINGS * f64::EPSILON * largest)
}

impl Prepared {
    fn new(truth: TruthLeaf) -> Result<Self, ReferenceError> {
        let leaf = truth.leaf;
        let matrix = truth.world_from_leaf.matrix3;
        let leaf_from_world = truth.world_from_leaf.inverse();
        if !(matrix.determinant() != 0.0 && truth.world_from_leaf.is_finite() && leaf_from_world.is_finite()) {
            return Err(ReferenceError::Transform { leaf });
        }
        let caster = match &truth.shape {
            TruthShape::Solid(solid) => {
                solid.validate().map_err(|source| ReferenceError::Solid { leaf, source })?;
                Caster::Implicit(Implicit::new(solid.clone()))
            }
            TruthShape::Mesh(mesh) => {
                Caster::Mesh(CastMesh::new(mesh.clone()).map_err(|what| ReferenceError::Mesh { leaf, what })?)
            }
        };
        let world_from_normal = leaf_from_world.matrix3.transpose();
        Ok(Self { truth, caster, leaf_from_world, world_from_normal })
    }

    /// Adds all crossings of the ray's whole line; returns whether its beginning, infinitely far behind the eye, is inside.
    fn cast(&self, slot: usize, ray: &Ray, tolerant: bool, crossings: &mut Vec<Crossing>) -> Result<bool, Grazed> {
        let origin = self.leaf_from_world.transform_point3(ray.origin);
        let dir = self.leaf_from_world.transform_vector3(ray.dir);
        let mut put = |t: f64, normal_in_leaf: DVec3, colour: [f32; 3], drawn: bool| {
            let normal = (self.world_from_normal * normal_in_leaf).normalize_or(-ray.dir.normalize());
            crossings.push(Crossing { t, slot, normal, colour, drawn });
        };
        match &self.caster {
            Caster::Implicit(solid) => {
                for hit in solid.crossings(origin, dir) {
                    put(hit.t, hit.normal, self.truth.colour, hit.drawn);
                }
                Ok(solid.begins_inside(origin, dir))
            }
            Caster::Mesh(mesh) => {
                let hits = mesh.crossings(origin, dir, tolerant)?;
                let odd = hits.len() % 2 == 1;
                for hit in hits {
                    let own = if self.truth.vertex_colours { mesh.colour(&hit) } else { None };
                    put(hit.t, hit.normal, own.unwrap_or(self.truth.colour), true);
                }
                // The parity beyond the last crossing is outside: so an odd count (an open mesh) begins inside.
                Ok(odd)
            }
        }
    }
}

impl LayerSource for Reference {
    fn camera(&self) -> &Camera {
        &self.camera
    }

    fn samples(&self) -> u32 {
        self.samples
    }

    fn draw(&self, rect: PixelRect) -> LayerTile {
        let mut tile = LayerTile { rect, offsets: Vec::with_capacity(rect.area() + 1), boundaries: Vec::new() };
        tile.offsets.push(0);
        let offsets = sample_offsets(self.samples);
        for y in rect.y0..rect.y1 {
            for x in rect.x0..rect.x1 {
                let corner = DVec2::new(f64::from(x), f64::from(y));
                let samples: Vec<Vec<RayBoundary>> = offsets.iter().map(|offset| self.cast(corner + *offset)).collect();
                tile.boundaries.extend::<Vec<Boundary>>(merge::merge(&self.camera, &samples));
                tile.offsets.push(tile.boundaries.len() as u32);
            }
        }
        tile
    }
}
