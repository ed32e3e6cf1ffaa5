//! The scene as the mesh pipeline keeps it between frames: all triangles in world space, in small groups.
//!
//! *Practice.* Triangles are put into *meshlets* of at most [`MESHLET`] that lie close together, so that one look at a
//! meshlet tells which tiles need it; vertices are numbered in the order in which meshlets use them. A vertex is stored once
//! and projected once a frame: triangles that share it share its snapped position bit for bit, and no ray slips between them.

use std::sync::Arc;

use glam::{DAffine3, DMat3, DVec3, Vec3};
use rayon::prelude::*;

use super::planes::{self, NO_PLANE, Plane, PlaneUse};
use super::project::Spare;
use super::visible::{self, Ball};
use crate::csg::{Flat, LeafId, Tree};
use crate::geometry::{Solid, TriMesh};
use crate::scene::LeafKind;

/// The most triangles a meshlet has: one bit each in a word.
pub const MESHLET: usize = 64;

/// What a leaf is drawn as.
#[derive(Debug, Clone)]
pub enum MeshShape {
    /// Triangles, in leaf space. Inside is where a ray from infinity has crossed an odd number of them.
    Mesh(Arc<TriMesh>),
    /// A formula, in leaf space: intersected exactly.
    Solid(Solid),
}

/// One leaf.
#[derive(Debug, Clone)]
pub struct MeshLeaf {
    /// Its index in the scene.
    pub leaf: LeafId,
    /// Its geometry.
    pub shape: MeshShape,
    /// Leaf space to world space; affine, invertible, may mirror.
    pub world_from_leaf: DAffine3,
    /// Linear RGB.
    pub colour: [f32; 3],
    /// Whether the mesh's vertex colours win over `colour`.
    pub vertex_colours: bool,
    /// Opacity, 0 to 1.
    pub opacity: f32,
    /// Solid or sheet.
    pub kind: LeafKind,
}

/// Why leaves cannot be drawn.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MeshModelError {
    /// Two leaves have one index.
    #[error("leaf {} was given twice", .0.0)]
    Twice(LeafId),
    /// The expression names a leaf that is not there.
    #[error("the expression names leaf {}, which was not given", .0.0)]
    Missing(LeafId),
    /// The transform flattens the leaf, or is not finite.
    #[error("the transform of leaf {} cannot be inverted: its scale must be finite and nowhere zero", .0.0)]
    Transform(LeafId),
    /// A vertex is not finite, or a triangle points beyond the vertices.
    #[error("the mesh of leaf {} is unusable: {what}", leaf.0)]
    Mesh {
        /// Which leaf.
        leaf: LeafId,
        /// What is wrong.
        what: String,
    },
    /// More vertices or triangles than a 32-bit number counts.
    #[error("the meshes have too many triangles or vertices to number: fewer than 2^32 are needed")]
    TooMany,
}

impl MeshModelError {
    /// The leaf that is at fault, where it is one.
    pub fn leaf(&self) -> Option<LeafId> {
        match self {
            Self::Twice(leaf) | Self::Missing(leaf) | Self::Transform(leaf) | Self::Mesh { leaf, .. } => Some(*leaf),
            Self::TooMany => None,
        }
    }
}

/// How a leaf looks.
#[derive(Debug, Clone, Copy)]
pub(super) struct Look {
    pub colour: [f32; 3],
    pub opacity: f32,
    pub is_sheet: bool,
    pub vertex_colours: bool,
    /// Whether the transform mirrors, so that triangles run clockwise seen from outside.
    pub is_mirrored: bool,
    /// The box of a closed mesh, world space. `None` for others, whose inside no box tells.
    pub closed_within: Option<(DVec3, DVec3)>,
}

/// Up to [`MESHLET`] triangles of one leaf that lie close together.
#[derive(Debug, Clone, Copy)]
pub(super) struct Meshlet {
    /// Its first triangle.
    pub first: u32,
    /// How many.
    pub count: u32,
    pub leaf: LeafId,
    /// Whether a triangle of it lies in a plane that leaves share.
    pub has_shared_planes: bool,
}

/// A triangle's plane in world space.
#[derive(Debug, Clone, Copy)]
pub(super) struct Surface {
    /// Among the model's planes, or [`NO_PLANE`] where no other leaf shares it.
    pub plane: u32,
    /// Unit normal; zero where the triangle has no area.
    pub normal: Vec3,
    /// Of the plane across `normal`, as rounded, through the first corner.
    pub offset: f64,
}

/// An analytic leaf.
#[derive(Debug, Clone)]
pub(super) struct SolidLeaf {
    pub leaf: LeafId,
    pub solid: Solid,
    pub world_from_leaf: DAffine3,
    pub leaf_from_world: DAffine3,
    /// Normals to world space, up to length.
    pub world_from_normal: DMat3,
    /// The planes of its flat faces that other leaves share: unit outward normal in leaf space, and the plane.
    pub shared: Vec<(DVec3, u32)>,
}

/// A scene of meshes and solids, ready to be drawn from any camera. What is large is shared with the models of other
/// expressions over the same leaves.
#[derive(Debug, Clone)]
pub struct MeshModel {
    pub(super) flat: Flat,
    /// By leaf index; `None` where there is no such leaf.
    pub(super) looks: Vec<Option<Look>>,
    /// World space; x, y and z apart, for vectors of them.
    pub(super) positions: Arc<[Vec<f64>; 3]>,
    /// By vertex, sRGB; empty where no leaf has any.
    pub(super) vertex_colours: Arc<Vec<[u8; 3]>>,
    /// By triangle: its corners. Apart from the rest, since more triangles are looked at than drawn.
    pub(super) triangles: Arc<Vec<[u32; 3]>>,
    /// By triangle.
    pub(super) surfaces: Arc<Vec<Surface>>,
    pub(super) planes: Arc<Vec<Plane>>,
    pub(super) meshlets: Vec<Meshlet>,
    /// By meshlet: a ball around it. Apart from the rest, which is looked at far more often.
    pub(super) balls: Vec<Ball>,
    /// Around groups of meshlets.
    pub(super) groups: Vec<Ball>,
    pub(super) solids: Vec<SolidLeaf>,
    pub(super) spare: Spare,
}

/// One mesh leaf, placed and grouped.
struct PlacedMesh {
    leaf: LeafId,
    positions: Vec<DVec3>,
    colours: Option<Vec<[u8; 3]>>,
    triangles: Vec<[u32; 3]>,
    /// Sizes of the meshlets, in order.
    groups: Vec<u32>,
    is_closed: bool,
}

impl MeshModel {
    /// The scene of `tree` over `leaves`. Leaves that the expression does not name are not drawn; they still share planes, so
    /// that every expression over the same leaves has the same depths.
    ///
    /// # Errors
    /// [`MeshModelError`] names the leaf.
    pub fn new(leaves: &[MeshLeaf], tree: &Tree) -> Result<Self, MeshModelError> {
        let flat = tree.positive().flat();
        let mut given: Vec<&MeshLeaf> = leaves.iter().collect();
        given.sort_by_key(|leaf| leaf.leaf);
        if let Some(pair) = given.windows(2).find(|pair| pair[0].leaf == pair[1].leaf) {
            return Err(MeshModelError::Twice(pair[0].leaf));
        }
        if let Some(missing) =
            flat.leaves().iter().find(|id| given.binary_search_by_key(*id, |leaf| leaf.leaf).is_err())
        {
            return Err(MeshModelError::Missing(*missing));
        }
        let placed: Vec<PlacedMesh> = given
            .par_iter()
            .filter_map(|leaf| match &leaf.shape {
                MeshShape::Mesh(mesh) => Some(place(leaf, mesh)),
                MeshShape::Solid(_) => None,
            })
            .collect::<Result<_, _>>()?;
        let count = |f: fn(&PlacedMesh) -> usize| placed.iter().map(f).sum::<usize>();
        let (vertices, triangles) = (count(|mesh| mesh.positions.len()), count(|mesh| mesh.triangles.len()));
        if u32::try_from(vertices.max(triangles)).is_err() {
            return Err(MeshModelError::TooMany);
        }
        let mut model = Self {
            looks: vec![None; given.last().map_or(0, |last| last.leaf.0 as usize + 1)],
            flat,
            positions: Arc::new(std::array::from_fn(|_| Vec::with_capacity(vertices))),
            vertex_colours: Arc::default(),
            triangles: Arc::new(Vec::with_capacity(triangles)),
            surfaces: Arc::new(Vec::with_capacity(triangles)),
            planes: Arc::default(),
            meshlets: Vec::new(),
            balls: Vec::new(),
            groups: Vec::new(),
            solids: Vec::new(),
            spare: Spare::default(),
        };
        for leaf in &given {
            let mesh = placed.binary_search_by_key(&leaf.leaf, |mesh| mesh.leaf).ok().map(|at| &placed[at]);
            let around = |mesh: &PlacedMesh| {
                mesh.positions
                    .iter()
                    .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), p| (low.min(*p), high.max(*p)))
            };
            model.looks[leaf.leaf.0 as usize] = Some(Look {
                colour: leaf.colour,
                opacity: leaf.opacity,
                is_sheet: leaf.kind == LeafKind::Sheet,
                vertex_colours: mesh.is_some_and(|mesh| mesh.colours.is_some()),
                is_mirrored: leaf.world_from_leaf.matrix3.determinant() < 0.0,
                closed_within: mesh.filter(|mesh| mesh.is_closed).map(around),
            });
            if let MeshShape::Solid(solid) = &leaf.shape {
                model.solids.push(SolidLeaf::new(leaf, solid)?);
            }
        }
        if placed.iter().any(|mesh| mesh.colours.is_some()) {
            let vertex_colours = Arc::make_mut(&mut model.vertex_colours);
            vertex_colours.reserve(vertices);
            for mesh in &placed {
                match &mesh.colours {
                    Some(colours) => vertex_colours.extend_from_slice(colours),
                    None => vertex_colours.extend(std::iter::repeat_n([u8::MAX; 3], mesh.positions.len())),
                }
            }
        }
        for mesh in placed {
            model.append(mesh);
        }
        model.share_planes();
        model.keep_used();
        Ok(model)
    }

    /// The same leaves under another expression; `None` where that names a leaf which this model does not draw.
    pub fn with_tree(&self, tree: &Tree) -> Option<Self> {
        let flat = tree.positive().flat();
        if flat.leaves().iter().any(|leaf| self.flat.leaves().binary_search(leaf).is_err()) {
            return None;
        }
        let mut model = Self { flat, ..self.clone() };
        model.keep_used();
        Some(model)
    }

    fn keep_used(&mut self) {
        let is_used = |leaf: LeafId| self.flat.leaves().binary_search(&leaf).is_ok();
        let mut meshlets = self.meshlets.iter();
        self.balls.retain(|_| meshlets.next().is_some_and(|meshlet| is_used(meshlet.leaf)));
        self.meshlets.retain(|meshlet| is_used(meshlet.leaf));
        self.solids.retain(|solid| is_used(solid.leaf));
        self.groups = visible::groups(&self.balls);
    }

    fn append(&mut self, mesh: PlacedMesh) {
        let base = self.positions[0].len() as u32;
        for (axis, positions) in Arc::make_mut(&mut self.positions).iter_mut().enumerate() {
            positions.extend(mesh.positions.iter().map(|p| p[axis]));
        }
        let mut first = self.triangles.len() as u32;
        let mut rest = &mesh.triangles[..];
        for count in mesh.groups {
            let own;
            (own, rest) = rest.split_at(count as usize);
            self.balls.push(Ball::around(own.as_flattened().iter().map(|v| mesh.positions[*v as usize])));
            self.meshlets.push(Meshlet { first, count, leaf: mesh.leaf, has_shared_planes: false });
            first += count;
        }
        let (triangles, surfaces) = (Arc::make_mut(&mut self.triangles), Arc::make_mut(&mut self.surfaces));
        for triangle in mesh.triangles {
            let [a, b, c] = triangle.map(|v| mesh.positions[v as usize]);
            let normal = (b - a).cross(c - a).try_normalize().unwrap_or(DVec3::ZERO).as_vec3();
            triangles.push(triangle.map(|v| v + base));
            surfaces.push(Surface { plane: NO_PLANE, normal, offset: normal.as_dvec3().dot(a) });
        }
    }

    fn share_planes(&mut self) {
        // By leaf: its first triangle.
        let mut firsts: Vec<(u32, LeafId)> =
            self.meshlets.iter().map(|meshlet| (meshlet.first, meshlet.leaf)).collect();
        firsts.dedup_by_key(|(_, leaf)| *leaf);
        let leaf_of = |triangle: u32| firsts[firsts.partition_point(|(first, _)| *first <= triangle) - 1].1;
        // The flat faces of solids follow the triangles.
        let mut of_solids = Vec::new();
        let mut faces = Vec::new();
        for (index, solid) in self.solids.iter().enumerate() {
            for (point, normal) in planes::flat_faces(&solid.solid) {
                let normal_in_world = solid.world_from_normal * normal;
                let point_in_world = solid.world_from_leaf.transform_point3(point);
                of_solids.push(PlaneUse::of_face(solid.leaf, point_in_world, normal_in_world));
                faces.push((index, normal));
            }
        }
        let triangles = self.triangles.len();
        let (planes, mut plane_of) = planes::shared(triangles + of_solids.len(), |index| {
            let Some(triangle) = self.triangles.get(index) else { return of_solids[index - triangles] };
            PlaneUse::of_triangle(leaf_of(index as u32), triangle.map(|v| self.position(v)))
        });
        let of_faces = plane_of.split_off(self.triangles.len());
        for ((index, normal), plane) in faces.into_iter().zip(of_faces) {
            if plane != NO_PLANE {
                self.solids[index].shared.push((normal, plane));
            }
        }
        self.planes = Arc::new(planes);
        for (surface, plane) in Arc::make_mut(&mut self.surfaces).iter_mut().zip(plane_of) {
            surface.plane = plane;
        }
        for meshlet in &mut self.meshlets {
            let own = &self.surfaces[meshlet.first as usize..(meshlet.first + meshlet.count) as usize];
            meshlet.has_shared_planes = own.iter().any(|surface| surface.plane != NO_PLANE);
        }
    }

    /// A vertex in world space.
    pub(super) fn position(&self, vertex: u32) -> DVec3 {
        let [x, y, z] = self.positions.as_ref();
        DVec3::new(x[vertex as usize], y[vertex as usize], z[vertex as usize])
    }

    /// The solid that a leaf is, where it is one.
    pub(super) fn solid_of(&self, leaf: LeafId) -> Option<&SolidLeaf> {
        // In the order of leaves.
        self.solids.binary_search_by_key(&leaf, |solid| solid.leaf).ok().map(|at| &self.solids[at])
    }

    pub(super) fn look(&self, leaf: LeafId) -> &Look {
        self.looks[leaf.0 as usize].as_ref().expect("every leaf of the expression has a look")
    }

    /// The solid leaves whose mesh is open: their inside is where a ray has an odd number of crossings ahead, which differs
    /// from ray to ray where some pass the hole.
    pub fn open_leaves(&self) -> impl Iterator<Item = LeafId> + '_ {
        let leaves = self.flat.leaves().iter().copied();
        leaves.filter(|&leaf| {
            let look = self.look(leaf);
            look.closed_within.is_none() && !look.is_sheet && self.solid_of(leaf).is_none()
        })
    }

    /// How many triangles are drawn.
    pub fn triangle_count(&self) -> usize {
        self.triangles.len()
    }

    /// How many planes lie on two leaves or more.
    pub fn shared_plane_count(&self) -> usize {
        self.planes.len()
    }
}

impl SolidLeaf {
    fn new(leaf: &MeshLeaf, solid: &Solid) -> Result<Self, MeshModelError> {
        let leaf_from_world = inverse(leaf)?;
        Ok(Self {
            leaf: leaf.leaf,
            solid: solid.clone(),
            world_from_leaf: leaf.world_from_leaf,
            leaf_from_world,
            world_from_normal: leaf_from_world.matrix3.transpose(),
            shared: Vec::new(),
        })
    }
}

fn inverse(leaf: &MeshLeaf) -> Result<DAffine3, MeshModelError> {
    let inverse = leaf.world_from_leaf.inverse();
    let is_sound = leaf.world_from_leaf.is_finite() && leaf.world_from_leaf.matrix3.determinant() != 0.0;
    if is_sound && inverse.is_finite() { Ok(inverse) } else { Err(MeshModelError::Transform(leaf.leaf)) }
}

/// The middle of the box around the vertices that triangles have; others may lie anywhere.
fn middle_of_used(mesh: &TriMesh) -> DVec3 {
    let of_triangle = |t: usize| {
        let [a, b, c] = mesh.corners(t);
        (a.min(b).min(c), a.max(b).max(c))
    };
    let around = |a: (DVec3, DVec3), b: (DVec3, DVec3)| (a.0.min(b.0), a.1.max(b.1));
    let (low, high) =
        (0..mesh.triangles.len()).into_par_iter().map(of_triangle).reduce_with(around).unwrap_or_default();
    0.5 * low + 0.5 * high
}

fn place(leaf: &MeshLeaf, mesh: &TriMesh) -> Result<PlacedMesh, MeshModelError> {
    inverse(leaf)?;
    let unusable = |what: String| MeshModelError::Mesh { leaf: leaf.leaf, what };
    if let Some(v) = mesh.positions.iter().position(|p| !p.is_finite()) {
        return Err(unusable(format!("vertex {v} is not finite")));
    }
    let count = mesh.positions.len();
    if let Some(t) = mesh.triangles.iter().position(|t| t.iter().any(|&v| v as usize >= count)) {
        return Err(unusable(format!("triangle {t} points beyond the {count} vertices")));
    }
    // Centroids are kept relative to the middle of what is drawn of the mesh, which may be far from the origin.
    let origin = middle_of_used(mesh);
    let mut order: Vec<Placed> = (0..mesh.triangles.len())
        .into_par_iter()
        .map(|t| {
            let sum: DVec3 = mesh.corners(t).iter().map(|corner| corner - origin).sum();
            Placed { centroid: (sum / 3.0).as_vec3(), triangle: t as u32 }
        })
        .collect();
    let groups = group(&mut order);

    // Vertices in the order of their first use.
    const UNUSED: u32 = u32::MAX;
    let mut renumbered = vec![UNUSED; count];
    let mut kept = Vec::with_capacity(count);
    let triangles: Vec<[u32; 3]> = order
        .iter()
        .map(|placed| {
            mesh.triangles[placed.triangle as usize].map(|v| {
                let number = &mut renumbered[v as usize];
                if *number == UNUSED {
                    *number = kept.len() as u32;
                    kept.push(v as usize);
                }
                *number
            })
        })
        .collect();
    let positions = kept.iter().map(|&v| leaf.world_from_leaf.transform_point3(mesh.positions[v])).collect();
    let own = mesh.colours.as_ref().filter(|_| leaf.vertex_colours);
    let colours = own.map(|colours| kept.iter().map(|&v| colours[v]).collect());
    let is_closed = mesh.is_closed();
    Ok(PlacedMesh { leaf: leaf.leaf, positions, colours, triangles, groups, is_closed })
}

/// A triangle that is being put in order, with all that its order depends on: looked up elsewhere it would take thrice as long.
#[derive(Clone, Copy)]
struct Placed {
    centroid: Vec3,
    triangle: u32,
}

/// Orders triangles by halving the longest side of their centroids' box until at most [`MESHLET`] are left, and returns the
/// sizes of the groups. All groups but the last of a half are full.
fn group(order: &mut [Placed]) -> Vec<u32> {
    /// Halves with fewer triangles are not worth a thread of their own.
    const FEW: usize = 1 << 14;
    if order.len() <= MESHLET {
        return if order.is_empty() { Vec::new() } else { vec![order.len() as u32] };
    }
    let nothing = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    let (low, high) =
        order.iter().fold(nothing, |(low, high), placed| (low.min(placed.centroid), high.max(placed.centroid)));
    let axis = (high - low).max_position();
    let middle = (order.len() / 2).next_multiple_of(MESHLET).min(order.len() - 1);
    order.select_nth_unstable_by(middle, |a, b| {
        a.centroid[axis].total_cmp(&b.centroid[axis]).then_with(|| a.triangle.cmp(&b.triangle))
    });
    let (first, second) = order.split_at_mut(middle);
    let (mut groups, others) =
        if first.len() < FEW { (group(first), group(second)) } else { rayon::join(|| group(first), || group(second)) };
    groups.extend(others);
    groups
}
