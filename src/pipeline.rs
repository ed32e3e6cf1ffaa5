//! From a loaded scene to a classified one: every leaf's surfels, its exact form where it has one, and their classes.
//!
//! A cloud *is* its surfels. A mesh or an analytic solid keeps its own form and is found on the screen by its triangles and its
//! formula ([`crate::hybrid`]), unless the user wants it to be nothing but surfels ([`crate::scene::represent`]). The paper's ways of
//! clipping are about surfels: for them exact leaves are sampled as well ([`ExactLeaves::Sampled`]), so that their surface is found;
//! every hit is then solved on the exact surface, so those samples need not resolve what the picture cannot show.

use std::sync::Arc;

use crate::blister::{MeshLeaf, MeshModel, MeshModelError, MeshShape};
use crate::classify::{LeafField, LeafLook, Model};
use crate::csg::LeafId;
use crate::geometry::bvh::MeshBvhError;
use crate::geometry::exact::Exact;
use crate::geometry::solid::TessellateError;
use crate::geometry::{PointCloud, Solid, TriMesh};
use crate::hybrid::{self, HybridModel};
use crate::scene::represent::{self, RepresentError, Representation};
use crate::scene::{LeafGeometry, LeafKind, LoadedScene};
use crate::space::Camera;
use crate::surfel::{self, CloudNotes, CloudOptions, SurfelCloud, SurfelError};

/// How densely meshes and solids are sampled.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Density {
    /// So that the surface leaves a flat surfel by at most this many pixels at the leaf's nearest depth.
    MaxErrorPx(f64),
    /// At this spacing, world units.
    Spacing(f64),
}

/// The error of a sampled or tessellated leaf where nobody asks for another, pixels: none that a picture shows.
const DEFAULT_ERROR_PX: f64 = 0.5;

impl Default for Density {
    fn default() -> Self {
        Self::MaxErrorPx(DEFAULT_ERROR_PX)
    }
}

/// How leaves that keep their own form are found on the screen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ExactLeaves {
    /// By their triangles and formulas.
    #[default]
    Crossed,
    /// By surfels sampled from them, as deep as the pipeline of the paper needs it.
    Sampled,
}

/// Why a scene cannot be made ready to be drawn.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PrepareError {
    /// A leaf's geometry makes no surfels.
    #[error("leaf `{leaf}`: {source}")]
    Surfels {
        /// Its name.
        leaf: String,
        /// What is wrong.
        source: SurfelError,
    },
    /// A mesh cannot be asked.
    #[error("leaf `{leaf}`: {source}")]
    Mesh {
        /// Its name.
        leaf: String,
        /// What is wrong.
        source: MeshBvhError,
    },
    /// The mesh pipeline was asked to draw points.
    #[error(
        "leaf `{leaf}` is a cloud of points, which the mesh pipeline cannot draw: use --pipeline splat, or give the leaf a \
         mesh file in its place"
    )]
    CloudAsMesh {
        /// The leaf.
        leaf: String,
    },
    /// The mesh pipeline was asked to draw a leaf that is to be surfels.
    #[error(
        "leaf `{leaf}` is to be drawn as surfels, which the mesh pipeline cannot do: use --pipeline auto or splat, or leave \
         its representation out"
    )]
    SurfelsAsMesh {
        /// The leaf.
        leaf: String,
    },
    /// A leaf cannot be drawn as the user wants.
    #[error(transparent)]
    Represent(#[from] RepresentError),
    /// A solid has no mesh.
    #[error("leaf `{leaf}` cannot be a mesh: {source}")]
    Tessellate {
        /// Its name.
        leaf: String,
        /// What is wrong.
        source: TessellateError,
    },
    /// Leaves that cannot be drawn as meshes.
    #[error("{}{source}", leaf.as_ref().map_or(String::new(), |leaf| format!("leaf `{leaf}`: ")))]
    Triangles {
        /// The leaf, where it is one's fault.
        leaf: Option<String>,
        /// What is wrong.
        source: MeshModelError,
    },
}

/// A scene ready to be drawn from any camera, and what its conversion had to say.
#[derive(Debug)]
pub struct Prepared {
    /// The classified scene.
    pub model: Model,
    /// By leaf: what was done to a cloud.
    pub notes: Vec<Option<CloudNotes>>,
    /// The leaves that are not found by surfels, and where the scene has them.
    pub crossed: Option<(MeshModel, Vec<MeshLeaf>)>,
}

impl Prepared {
    /// The scene as one that draws every leaf in its own form.
    pub fn into_hybrid(self) -> HybridModel {
        match self.crossed {
            Some((crossed, leaves)) => HybridModel::new(self.model, Some(crossed)).with_leaves_at_rest(leaves),
            None => HybridModel::new(self.model, None),
        }
    }
}

/// The leaves of a scene, before classification.
#[derive(Debug)]
pub struct Converted {
    fields: Vec<LeafField>,
    looks: Vec<LeafLook>,
    notes: Vec<Option<CloudNotes>>,
    crossed: Option<(MeshModel, Vec<MeshLeaf>)>,
    tree: crate::csg::Tree,
}

/// A leaf as it is drawn.
enum Drawn {
    /// As its surfels and nothing else.
    Surfels,
    Mesh(Arc<TriMesh>),
    Solid(Solid),
}

/// What leaf `id` is drawn as; a solid that is to be a mesh is tessellated for the pixels of `camera`.
fn drawn(loaded: &LoadedScene, id: LeafId, camera: &Camera, density: Density) -> Result<Drawn, PrepareError> {
    let index = id.0 as usize;
    let leaf = &loaded.scene.leaves[index];
    let geometry = &loaded.geometry[index];
    Ok(match (represent::resolved(&leaf.name, geometry, leaf.represent)?, geometry) {
        (Representation::Surfels, _) | (_, LeafGeometry::Cloud(_)) => Drawn::Surfels,
        (_, LeafGeometry::Mesh(mesh)) => Drawn::Mesh(Arc::clone(mesh)),
        (Representation::Exact, LeafGeometry::Solid(solid)) => Drawn::Solid(solid.clone()),
        (Representation::Mesh, LeafGeometry::Solid(solid)) => {
            let px = match density {
                Density::MaxErrorPx(px) => px,
                Density::Spacing(_) => DEFAULT_ERROR_PX,
            };
            let stretch = loaded.scene.leaves[index].world_from_leaf.matrix3;
            let longest = [stretch.x_axis, stretch.y_axis, stretch.z_axis].map(|axis| axis.length_squared());
            // No direction is stretched by more than the columns together.
            let error = px * footprint_of(loaded, index, camera) / longest.iter().sum::<f64>().sqrt();
            let mesh = solid.tessellate(error);
            let mesh = mesh.map_err(|source| PrepareError::Tessellate { leaf: leaf.name.clone(), source })?;
            Drawn::Mesh(Arc::new(mesh))
        }
    })
}

/// The leaf as the mesh pipeline takes it, where it is drawn in its own form.
fn mesh_leaf(loaded: &LoadedScene, id: LeafId, drawn: &Drawn) -> Option<MeshLeaf> {
    let index = id.0 as usize;
    let shape = match drawn {
        Drawn::Surfels => return None,
        Drawn::Mesh(mesh) => MeshShape::Mesh(Arc::clone(mesh)),
        Drawn::Solid(solid) => MeshShape::Solid(solid.clone()),
    };
    Some(MeshLeaf {
        leaf: id,
        shape,
        world_from_leaf: loaded.scene.leaves[index].world_from_leaf,
        colour: loaded.colour(id),
        vertex_colours: loaded.has_own_colours(id),
        opacity: loaded.scene.leaves[index].opacity,
        kind: if loaded.is_sheet(id) { LeafKind::Sheet } else { LeafKind::Solid },
    })
}

/// The leaves of `loaded` as the mesh pipeline draws them: meshes as they are, solids exactly or, where they are to be meshes,
/// tessellated for the pixels of `camera`.
///
/// # Errors
/// As [`mesh_leaves`], and [`PrepareError::Triangles`] for an unusable mesh.
pub fn mesh_model(loaded: &LoadedScene, camera: &Camera, density: Density) -> Result<MeshModel, PrepareError> {
    mesh_model_of(loaded, &mesh_leaves(loaded, camera, density)?)
}

/// The mesh pipeline's scene over `leaves`, which [`mesh_leaves`] made of `loaded`.
///
/// # Errors
/// [`PrepareError::Triangles`] for an unusable mesh.
pub fn mesh_model_of(loaded: &LoadedScene, leaves: &[MeshLeaf]) -> Result<MeshModel, PrepareError> {
    MeshModel::new(leaves, &loaded.canonical_tree()).map_err(|source| triangles(loaded, source))
}

fn triangles(loaded: &LoadedScene, source: MeshModelError) -> PrepareError {
    let name = |id: LeafId| loaded.scene.leaves[id.0 as usize].name.clone();
    PrepareError::Triangles { leaf: source.leaf().map(name), source }
}

/// The leaves of `loaded` as the mesh pipeline draws them.
///
/// # Errors
/// [`PrepareError::CloudAsMesh`] for a leaf of points, [`PrepareError::SurfelsAsMesh`] for one that is to be surfels,
/// [`PrepareError::Represent`] and [`PrepareError::Tessellate`] for one that cannot be what it is to be.
pub fn mesh_leaves(loaded: &LoadedScene, camera: &Camera, density: Density) -> Result<Vec<MeshLeaf>, PrepareError> {
    let tree = loaded.canonical_tree();
    let name = |id: LeafId| loaded.scene.leaves[id.0 as usize].name.clone();
    let leaf = |id: LeafId| {
        let drawn = drawn(loaded, id, camera, density)?;
        mesh_leaf(loaded, id, &drawn).ok_or_else(|| match &loaded.geometry[id.0 as usize] {
            LeafGeometry::Cloud(_) => PrepareError::CloudAsMesh { leaf: name(id) },
            _ => PrepareError::SurfelsAsMesh { leaf: name(id) },
        })
    };
    tree.leaves().into_iter().map(leaf).collect()
}

/// Whether a leaf that the expression names is drawn as surfels and nothing else.
///
/// # Errors
/// [`PrepareError::Represent`] for a leaf that cannot be drawn as the user wants.
pub fn has_surfels(loaded: &LoadedScene) -> Result<bool, PrepareError> {
    let mut any = false;
    for id in loaded.canonical_tree().leaves() {
        let leaf = &loaded.scene.leaves[id.0 as usize];
        let representation = represent::resolved(&leaf.name, &loaded.geometry[id.0 as usize], leaf.represent)?;
        any |= representation == Representation::Surfels;
    }
    Ok(any)
}

/// Makes every leaf of `loaded` ready: surfels, and leaves in their own form, found as `exact` says; `camera` is the first view,
/// whose pixels decide how densely meshes and solids are sampled. Clouds are taken out of `loaded`, since they may be most of the memory. `progress` hears how many
/// points are done.
///
/// # Errors
/// [`PrepareError`] names the leaf.
pub fn convert(
    loaded: &mut LoadedScene,
    camera: &Camera,
    density: Density,
    exact: ExactLeaves,
    progress: &(dyn Fn(u64) + Sync),
) -> Result<Converted, PrepareError> {
    let tree = loaded.canonical_tree();
    let used = tree.leaves();
    let (mut fields, mut looks, mut notes) = (Vec::new(), Vec::new(), Vec::new());
    let mut crossed = Vec::new();
    for index in 0..loaded.scene.leaves.len() {
        let id = LeafId(index as u32);
        let opacity = loaded.scene.leaves[index].opacity;
        let colour = (!loaded.has_own_colours(id)).then(|| loaded.colour(id));
        looks.push(LeafLook { colour, opacity });
        if used.binary_search(&id).is_err() {
            fields.push(LeafField::new(SurfelCloud::default(), None, LeafKind::Sheet));
            notes.push(None);
            continue;
        }
        let drawn = drawn(loaded, id, camera, density)?;
        if exact == ExactLeaves::Crossed {
            crossed.extend(mesh_leaf(loaded, id, &drawn));
        }
        let (field, note) = leaf_field(loaded, id, &drawn, camera, density, exact, progress)?;
        fields.push(field);
        notes.push(note);
    }
    let model = hybrid::exact_model(&crossed).map_err(|source| triangles(loaded, source))?;
    Ok(Converted { fields, looks, notes, crossed: model.map(|model| (model, crossed)), tree })
}

impl Converted {
    /// The leaves, in the scene's order.
    pub fn fields(&self) -> &[LeafField] {
        &self.fields
    }

    /// The number of surfels over all leaves.
    pub fn surfels(&self) -> usize {
        self.fields.iter().map(|f| f.cloud.len()).sum()
    }

    /// Classifies the surfels.
    pub fn classify(self) -> Prepared {
        let model = Model::new(&self.tree, self.fields, self.looks);
        Prepared { model, notes: self.notes, crossed: self.crossed }
    }
}

fn leaf_field(
    loaded: &mut LoadedScene,
    id: LeafId,
    drawn: &Drawn,
    camera: &Camera,
    density: Density,
    exact_leaves: ExactLeaves,
    progress: &(dyn Fn(u64) + Sync),
) -> Result<(LeafField, Option<CloudNotes>), PrepareError> {
    let index = id.0 as usize;
    let kind = if loaded.is_sheet(id) { LeafKind::Sheet } else { LeafKind::Solid };
    let leaf = &loaded.scene.leaves[index];
    let (name, world_from_leaf) = (leaf.name.clone(), leaf.world_from_leaf);
    let surfels = |source| PrepareError::Surfels { leaf: name.clone(), source };
    let spacing = |curvature_radius: f64, area: f64| match (leaf.spacing, density) {
        (Some(spacing), _) | (None, Density::Spacing(spacing)) => spacing,
        (None, Density::MaxErrorPx(px)) => {
            spacing_for(px, curvature_radius, footprint_of(loaded, index, camera)).max(roomy(area, curvature_radius))
        }
    };
    let stretch = world_from_leaf.matrix3.determinant().abs().cbrt();
    let of_mesh = |mesh: &TriMesh| {
        let extent = loaded.bounds[index].map_or(1.0, |b| (b.max - b.min).length());
        // A mesh says nothing of its curvature; a feature of a twentieth of its size is what such scans show.
        const FEATURE_SHARE: f64 = 1.0 / 20.0;
        let area = stretch * stretch * mesh.area();
        surfel::from_mesh(mesh, world_from_leaf, spacing(extent * FEATURE_SHARE, area)).map_err(surfels)
    };
    let of_solid = |solid: &Solid| {
        let area = stretch * stretch * solid.patches().iter().map(|patch| patch.area()).sum::<f64>();
        surfel::from_solid(solid, world_from_leaf, spacing(stretch * least_radius(solid), area)).map_err(surfels)
    };
    let is_sampled = exact_leaves == ExactLeaves::Sampled;
    let (cloud, exact) = match (drawn, &loaded.geometry[index]) {
        (Drawn::Surfels, LeafGeometry::Cloud(_)) => {
            let taken = std::mem::replace(&mut loaded.geometry[index], LeafGeometry::Cloud(Arc::default()));
            let LeafGeometry::Cloud(cloud) = taken else { unreachable!("it was a cloud a line ago") };
            let cloud: PointCloud = Arc::unwrap_or_clone(cloud);
            let (cloud, note) =
                surfel::from_cloud(cloud, world_from_leaf, &CloudOptions::default(), progress).map_err(surfels)?;
            return Ok((LeafField::new(cloud, None, kind), Some(note)));
        }
        (Drawn::Surfels, LeafGeometry::Mesh(mesh)) => (of_mesh(mesh)?, None),
        (Drawn::Surfels, LeafGeometry::Solid(solid)) => (of_solid(solid)?, None),
        (Drawn::Mesh(mesh), _) => {
            let cloud = if is_sampled { of_mesh(mesh)? } else { SurfelCloud::default() };
            let exact = Exact::mesh(Arc::clone(mesh), world_from_leaf)
                .map_err(|source| PrepareError::Mesh { leaf: name.clone(), source })?;
            (cloud, Some(exact))
        }
        (Drawn::Solid(solid), _) => {
            let cloud = if is_sampled { of_solid(solid)? } else { SurfelCloud::default() };
            (cloud, Some(Exact::solid(solid.clone(), world_from_leaf)))
        }
    };
    Ok((LeafField::new(cloud, exact, kind), None))
}

/// The footprint at the nearest depth of leaf `index` in front of the camera, world units.
fn footprint_of(loaded: &LoadedScene, index: usize, camera: &Camera) -> f64 {
    // From inside a leaf's ball, or with the leaf behind the eye, there is no nearest depth: a share of its size stands in.
    const CLOSEST_SHARE: f64 = 0.01;
    let (middle, radius) = match loaded.bounds[index] {
        Some(b) => (0.5 * (b.min + b.max), 0.5 * (b.max - b.min).length()),
        None => (camera.eye + camera.forward, 1.0), // a half-space is everywhere
    };
    let depth = camera.view_from_world(middle).z;
    camera.footprint((depth - radius).max(CLOSEST_SHARE * depth.abs().max(radius)))
}

/// Flat faces need samples too, and a leaf of one surfel a face groups badly.
const LEAST_SAMPLES_A_RADIUS: f64 = 4.0;

/// The spacing whose surfels a surface of radius of curvature `radius` leaves by `px` pixels: a disk of radius ρ on a
/// sphere of radius R has the sagitta ρ²/2R, and disks have about 1.3 spacings.
fn spacing_for(px: f64, radius: f64, footprint: f64) -> f64 {
    const DISK_RADIUS_IN_SPACINGS: f64 = 1.3;
    let by_sagitta = (2.0 * radius * px * footprint).sqrt() / DISK_RADIUS_IN_SPACINGS;
    by_sagitta.min(radius / LEAST_SAMPLES_A_RADIUS).max(footprint)
}

/// The spacing that keeps a leaf of `area` at a quarter of a million surfels, as long as that resolves its curvature: a
/// cutter may be a thousand times larger than what it cuts, and its hits are solved exactly however large its surfels are.
fn roomy(area: f64, radius: f64) -> f64 {
    const MOST_SURFELS: f64 = 250_000.0;
    (area / MOST_SURFELS).sqrt().min(radius / LEAST_SAMPLES_A_RADIUS)
}

/// The least radius of curvature of a solid, or a quarter of its least side where it has none; leaf units.
fn least_radius(solid: &Solid) -> f64 {
    match solid {
        Solid::HalfSpace { extent, .. } => 0.25 * extent,
        Solid::Box { min, max } => 0.25 * (*max - *min).min_element(),
        Solid::Sphere { radius, .. } => *radius,
        Solid::Cylinder { from, to, radius } => radius.min(0.5 * from.distance(*to)),
        Solid::Cone { from, to, radius_from, radius_to } => {
            (0.5 * radius_from.max(*radius_to)).min(0.5 * from.distance(*to))
        }
        Solid::Torus { tube, .. } => *tube,
        Solid::Blend { balls, .. } => balls.iter().map(|b| b.radius).fold(f64::INFINITY, f64::min),
    }
}
