//! From what the user wrote to geometry in memory: files read (each once), solids checked, equal leaves found.

use std::collections::HashMap;
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::DAffine3;
use rayon::prelude::*;

use super::endless::{self, Far, Spread};
use super::framing::{self, Bounds, Extent};
use super::inline_solid::{self, EXTENT_OF_THE_SCENE};
use super::{CameraSpec, LeafKind, LeafSource, RepresentError, Representation, Scene, Truth, colour};
use crate::csg::{LeafId, Tree};
use crate::formats::{self, Format, Geometry, LARGEST_COORDINATE, Note, Progress, ReadError, ReadOptions, Stated};
use crate::geometry::solid::SolidError;
use crate::geometry::{PointCloud, Solid, TriMesh};
use crate::space::{Camera, CameraError, Motion};

/// A leaf's geometry, in leaf space.
#[derive(Debug, Clone)]
pub enum LeafGeometry {
    /// Points.
    Cloud(Arc<PointCloud>),
    /// Triangles.
    Mesh(Arc<TriMesh>),
    /// A formula.
    Solid(Solid),
}

impl LeafGeometry {
    /// `cloud`, `mesh`, or the solid's kind, for messages.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Cloud(_) => "cloud",
            Self::Mesh(_) => "mesh",
            Self::Solid(solid) => match solid {
                Solid::HalfSpace { .. } => "half-space",
                Solid::Box { .. } => "box",
                Solid::Sphere { .. } => "sphere",
                Solid::Cylinder { .. } => "cylinder",
                Solid::Cone { .. } => "cone",
                Solid::Torus { .. } => "torus",
                Solid::Blend { .. } => "blend",
            },
        }
    }

    /// Whether both are the same geometry, number by number.
    fn same(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Cloud(a), Self::Cloud(b)) => Arc::ptr_eq(a, b) || a == b,
            (Self::Mesh(a), Self::Mesh(b)) => Arc::ptr_eq(a, b) || a == b,
            (Self::Solid(a), Self::Solid(b)) => a == b,
            _ => false,
        }
    }
}

/// What the reference renderer casts rays at in place of a leaf, in leaf space.
#[derive(Debug, Clone)]
pub enum LoadedTruth {
    /// Triangles.
    Mesh(Arc<TriMesh>),
    /// A formula.
    Solid(Solid),
}

/// Why a scene cannot be loaded.
#[derive(Debug, thiserror::Error)]
pub enum LoadError {
    /// A leaf's file cannot be read.
    #[error("leaf `{leaf}`: {source}")]
    File {
        /// The leaf.
        leaf: String,
        /// What is wrong with the file.
        source: Box<ReadError>,
    },
    /// A truth holds points, at which no ray can be cast.
    #[error(
        "leaf `{leaf}`: its truth, {}, holds points; a truth must be a mesh or a solid: name one, or leave `truth` out",
        path.display()
    )]
    TruthIsCloud {
        /// The leaf.
        leaf: String,
        /// The truth's file.
        path: PathBuf,
    },
    /// A solid that does not exist.
    #[error("leaf `{leaf}`: {source}")]
    Solid {
        /// The leaf.
        leaf: String,
        /// What is wrong with it.
        source: SolidError,
    },
    /// A half-space without an extent, and nothing to take one from.
    #[error(
        "leaf `{leaf}` is a half-space without `extent`, and the scene has nothing bounded to take one from: add \
         `extent = …`, the distance from its point as far as which it is drawn, or on the command line a seventh number \
         behind its normal"
    )]
    NoExtent {
        /// The leaf.
        leaf: String,
    },
    /// A transform without an inverse.
    #[error("leaf `{leaf}`: its transform has no inverse: it flattens the leaf or is not finite; mend it")]
    Singular {
        /// The leaf.
        leaf: String,
    },
    /// A leaf lies, or reaches, too far from the origin.
    #[error(
        "leaf `{leaf}` reaches beyond ±{LARGEST_COORDINATE:e}, where numbers are too coarse to cut with: make it smaller, or move \
         it nearer to the origin"
    )]
    TooFar {
        /// The leaf.
        leaf: String,
    },
    /// A caller of the library handed over nothing, or numbers that are not finite.
    #[error("leaf `{leaf}`: {problem}")]
    Memory {
        /// The leaf.
        leaf: String,
        /// What is wrong.
        problem: &'static str,
    },
    /// A sheet is subtracted or complemented.
    #[error(
        "leaf `{leaf}` is a sheet, so it has no inside to subtract or complement: declare it solid, or cut it instead"
    )]
    SheetCuts {
        /// The leaf.
        leaf: String,
    },
}

/// A file that was read.
#[derive(Debug, Clone)]
pub struct LoadedFile {
    /// Its path.
    pub path: PathBuf,
    /// How it was read.
    pub format: Format,
    /// Its size.
    pub bytes: u64,
    /// What it says that it holds.
    pub stated: Stated,
    /// What was noticed.
    pub notes: Vec<Note>,
    /// Whether its normals may point inwards or outwards.
    pub is_unoriented: bool,
}

/// Something that the user should know.
#[derive(Debug, Clone, PartialEq)]
pub enum SceneNote {
    /// A reader noticed it.
    File {
        /// In which file.
        path: PathBuf,
        /// What.
        note: Note,
    },
    /// A leaf has the content and the transform of an earlier one.
    SameContent {
        /// The leaf.
        leaf: String,
        /// The earlier one.
        earlier: String,
    },
    /// A leaf that no expression uses.
    Unused {
        /// The leaf.
        leaf: String,
    },
    /// A leaf's points lie on one line and have no normals.
    Line {
        /// The leaf.
        leaf: String,
    },
    /// A mesh that is a solid has faces that look inwards.
    InsideOut {
        /// The leaf.
        leaf: String,
    },
    /// The operands of the expression do not meet.
    CannotMeet,
    /// The result has no bounds.
    Unbounded,
}

impl SceneNote {
    /// Whether the user should hear of it unasked.
    pub fn is_warning(&self) -> bool {
        match self {
            Self::File { note, .. } => note.is_warning(),
            Self::SameContent { .. } | Self::Unbounded => false,
            Self::Unused { .. } | Self::Line { .. } | Self::InsideOut { .. } | Self::CannotMeet => true,
        }
    }
}

impl fmt::Display for SceneNote {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File { path, note } => write!(f, "{}: {note}", path.display()),
            Self::SameContent { leaf, earlier } => {
                write!(f, "leaf `{leaf}` has the content and the place of `{earlier}`: the two are one")
            }
            Self::Unused { leaf } => write!(f, "leaf `{leaf}` is not used by the expression"),
            Self::Line { leaf } => write!(
                f,
                "the points of leaf `{leaf}` lie on one line and have no normals, so the surface that is drawn is a guess: \
                 give the file normals, or look at its columns"
            ),
            Self::InsideOut { leaf } => write!(
                f,
                "the mesh of leaf `{leaf}` is inside-out: turn its faces over, so that corners run anticlockwise seen from \
                 outside; a closed one is drawn as if they were, but not as surfels, nor by other programs"
            ),
            Self::CannotMeet => f.write_str(
                "the operands of an intersection do not meet, so the result is empty: look at the transforms",
            ),
            Self::Unbounded => f.write_str("the result has no bounds: it is drawn as far as its surfaces reach"),
        }
    }
}

/// A scene with its geometry. Every list has one entry a leaf, in the scene's order, but for `files` and `notes`.
#[derive(Debug, Clone)]
pub struct LoadedScene {
    /// The scene; half-spaces without an extent have one now.
    pub scene: Scene,
    /// Geometry in leaf space.
    pub geometry: Vec<LeafGeometry>,
    /// For the reference renderer.
    pub truths: Vec<Option<LoadedTruth>>,
    /// Whether a cloud's normals may point inwards or outwards.
    pub is_unoriented: Vec<bool>,
    /// The first leaf with the same content, transform and kind: mostly the leaf itself.
    pub canonical: Vec<LeafId>,
    /// The leaves' boxes in world space; `None` for a half-space.
    pub bounds: Vec<Option<Bounds>>,
    /// What the leaves are far from the origin: half-spaces, and solid scans of a plane, go on without end.
    pub far: Vec<Far>,
    /// The files that were read, each once.
    pub files: Vec<LoadedFile>,
    /// What the user should know.
    pub notes: Vec<SceneNote>,
}

/// Reads the scene's files, in parallel and each once, and checks everything that needs its content. `progress` hears
/// [`set_len`](Progress::set_len) once for each file.
///
/// # Errors
/// [`LoadError`] names the leaf; the first in the scene's order.
pub fn load(scene: Scene, options: &ReadOptions, progress: &dyn Progress) -> Result<LoadedScene, LoadError> {
    if let Some(sheet) = scene.subtracted_sheet() {
        return Err(LoadError::SheetCuts { leaf: scene.leaves[sheet.0 as usize].name.clone() });
    }
    let files = Files::read(&scene, options, progress)?;
    let mut loaded = LoadedScene {
        geometry: Vec::new(),
        truths: Vec::new(),
        is_unoriented: Vec::new(),
        canonical: Vec::new(),
        bounds: Vec::new(),
        far: Vec::new(),
        files: Vec::new(),
        notes: Vec::new(),
        scene,
    };
    for leaf in &loaded.scene.leaves {
        let name = || leaf.name.clone();
        if !is_invertible(&leaf.world_from_leaf) {
            return Err(LoadError::Singular { leaf: name() });
        }
        let check =
            |solid: &Solid| inline_solid::validate(solid).map_err(|source| LoadError::Solid { leaf: name(), source });
        let mut is_unoriented = false;
        loaded.geometry.push(match &leaf.source {
            LeafSource::File(path) => {
                let file = files.get(path);
                is_unoriented = file.info.is_unoriented;
                file.geometry.clone()
            }
            LeafSource::Solid(solid) => {
                check(solid)?;
                LeafGeometry::Solid(solid.clone())
            }
            LeafSource::Cloud(cloud) => {
                check_memory(&cloud.positions).map_err(|problem| LoadError::Memory { leaf: name(), problem })?;
                LeafGeometry::Cloud(Arc::clone(cloud))
            }
            LeafSource::Mesh(mesh) => {
                check_memory(&mesh.positions).map_err(|problem| LoadError::Memory { leaf: name(), problem })?;
                LeafGeometry::Mesh(Arc::clone(mesh))
            }
        });
        loaded.is_unoriented.push(is_unoriented);
        loaded.truths.push(match &leaf.truth {
            None => None,
            Some(Truth::Mesh(mesh)) => Some(LoadedTruth::Mesh(Arc::clone(mesh))),
            Some(Truth::Solid(solid)) => {
                check(solid)?;
                Some(LoadedTruth::Solid(solid.clone()))
            }
            Some(Truth::File(path)) => match &files.get(path).geometry {
                LeafGeometry::Mesh(mesh) => Some(LoadedTruth::Mesh(Arc::clone(mesh))),
                _ => return Err(LoadError::TruthIsCloud { leaf: name(), path: path.clone() }),
            },
        });
    }
    loaded.files = files.into_infos();
    loaded.bounds = (0..loaded.geometry.len()).into_par_iter().map(|i| loaded.bounds_of(i)).collect();
    for (bounds, leaf) in loaded.bounds.iter().zip(&loaded.scene.leaves) {
        let reaches = |bounds: &Bounds| {
            let farthest = bounds.min.abs().max(bounds.max.abs()).max_element();
            !(farthest <= LARGEST_COORDINATE) || !bounds.min.is_finite() || !bounds.max.is_finite()
        };
        if bounds.as_ref().is_some_and(reaches) {
            return Err(LoadError::TooFar { leaf: leaf.name.clone() });
        }
    }
    loaded.far = (0..loaded.geometry.len()).into_par_iter().map(|i| loaded.far_of(i)).collect();
    loaded.give_extents()?;
    loaded.find_equal_leaves();
    loaded.gather_notes();
    Ok(loaded)
}

impl LoadedScene {
    /// The expression over canonical leaves: two names for one thing are one leaf.
    pub fn canonical_tree(&self) -> Tree {
        self.scene.tree.map_leaves(|leaf| self.canonical[leaf.0 as usize])
    }

    /// Draws the leaf called `leaf`, and with it every other name of the same thing, as `representation`.
    ///
    /// # Errors
    /// [`RepresentError::NoSuchLeaf`].
    pub fn represent(&mut self, leaf: &str, representation: Representation) -> Result<(), RepresentError> {
        self.scene.represent(leaf, representation)?;
        let named = self.scene.leaves.iter().zip(&self.canonical).filter(|(known, _)| known.name == leaf);
        let all: Vec<usize> = named.map(|(_, canonical)| canonical.0 as usize).collect();
        all.into_iter().for_each(|index| self.scene.leaves[index].represent = Some(representation));
        Ok(())
    }

    /// The same scene with every cloud replaced by what the scene says that it was sampled from.
    pub fn as_truths(mut self) -> Self {
        for (geometry, truth) in self.geometry.iter_mut().zip(&self.truths) {
            match truth {
                Some(LoadedTruth::Mesh(mesh)) => *geometry = LeafGeometry::Mesh(Arc::clone(mesh)),
                Some(LoadedTruth::Solid(solid)) => *geometry = LeafGeometry::Solid(solid.clone()),
                None => {}
            }
        }
        self
    }

    /// The leaf's linear RGB where it is of one colour: the scene's, or one by its index. A file's own colours win only
    /// where the scene names none: see [`has_own_colours`](Self::has_own_colours).
    pub fn colour(&self, leaf: LeafId) -> [f32; 3] {
        let index = leaf.0 as usize;
        self.scene.leaves[index].colour.unwrap_or_else(|| colour::leaf_colour(index))
    }

    /// Whether the leaf is drawn in the colours of its file.
    pub fn has_own_colours(&self, leaf: LeafId) -> bool {
        let index = leaf.0 as usize;
        self.scene.leaves[index].colour.is_none()
            && match &self.geometry[index] {
                LeafGeometry::Cloud(cloud) => cloud.colours.is_some(),
                LeafGeometry::Mesh(mesh) => mesh.colours.is_some(),
                LeafGeometry::Solid(_) => false,
            }
    }

    /// Whether a file brings opacities of its own (Gaussian splats), so that deeper surfaces show.
    pub fn has_own_opacities(&self) -> bool {
        self.geometry.iter().any(|geometry| matches!(geometry, LeafGeometry::Cloud(cloud) if cloud.opacities.is_some()))
    }

    /// The scene's camera, or one that frames the result.
    ///
    /// # Errors
    /// [`CameraError`] where the scene's camera cannot be.
    pub fn camera(&self) -> Result<Camera, CameraError> {
        self.camera_spec().camera(self.scene.size)
    }

    /// The scene's camera as a user would write it, or one that frames the result.
    pub fn camera_spec(&self) -> CameraSpec {
        self.scene.camera.unwrap_or_else(|| {
            framing::frame(&self.scene, |leaf| self.leaf_extent(leaf), |leaf| self.drawn_bounds(leaf))
        })
    }

    /// Where the result can be, world space.
    pub fn extent(&self) -> Extent {
        framing::extent(&self.scene.tree, |leaf| self.leaf_extent(leaf))
    }

    /// Around everything that may be drawn of the result while each leaf is moved by its `motion`, world space.
    pub fn drawn_within(&self, motion: impl Fn(LeafId) -> Motion) -> Bounds {
        let moved = |leaf: LeafId, bounds: Bounds| bounds.transformed(&motion(leaf).affine());
        let extent = framing::extent(&self.scene.tree, |leaf| match self.leaf_extent(leaf) {
            Extent::Within(bounds) => Extent::Within(moved(leaf, bounds)),
            Extent::Unbounded(bounds) => Extent::Unbounded(bounds.map(|bounds| moved(leaf, bounds))),
            Extent::Empty => Extent::Empty,
        });
        if let Extent::Within(bounds) = extent {
            return bounds;
        }
        let leaves = self.scene.tree.leaves().into_iter().map(|leaf| moved(leaf, self.drawn_bounds(leaf)));
        leaves.reduce(Bounds::union).unwrap_or(Bounds { min: glam::DVec3::ZERO, max: glam::DVec3::ZERO })
    }

    /// Whether the result goes on without end.
    pub fn is_endless(&self) -> bool {
        endless::is_endless(&self.scene.tree, |leaf| self.far[leaf.0 as usize])
    }

    fn leaf_extent(&self, leaf: LeafId) -> Extent {
        let index = leaf.0 as usize;
        match (self.far[index], self.bounds[index]) {
            (Far::Nothing, Some(bounds)) => Extent::Within(bounds),
            (_, bounds) => Extent::Unbounded(bounds),
        }
    }

    fn far_of(&self, index: usize) -> Far {
        let leaf = &self.scene.leaves[index];
        let normal = match &self.geometry[index] {
            LeafGeometry::Solid(Solid::HalfSpace { normal, .. }) => {
                (leaf.world_from_leaf.matrix3.inverse().transpose() * *normal).try_normalize()
            }
            LeafGeometry::Cloud(cloud) if leaf.kind == LeafKind::Solid => {
                endless::half_space_of(cloud, &leaf.world_from_leaf)
            }
            _ => None,
        };
        normal.map_or(Far::Nothing, Far::HalfSpace)
    }

    fn drawn_bounds(&self, leaf: LeafId) -> Bounds {
        let index = leaf.0 as usize;
        self.bounds[index].unwrap_or_else(|| match &self.geometry[index] {
            LeafGeometry::Solid(solid) => {
                let (min, max) = solid.drawn_bounds();
                Bounds { min, max }.transformed(&self.scene.leaves[index].world_from_leaf)
            }
            // A cloud or a mesh has bounds unless it is empty, which is refused.
            _ => Bounds { min: glam::DVec3::ZERO, max: glam::DVec3::ZERO },
        })
    }

    fn bounds_of(&self, index: usize) -> Option<Bounds> {
        let world_from_leaf = self.scene.leaves[index].world_from_leaf;
        let around = |positions: &[glam::DVec3]| {
            Bounds::of_points(positions.iter().map(|&p| world_from_leaf.transform_point3(p)))
        };
        match &self.geometry[index] {
            LeafGeometry::Cloud(cloud) => around(&cloud.positions),
            LeafGeometry::Mesh(mesh) => around(&mesh.positions),
            LeafGeometry::Solid(solid) => {
                solid.bounds().map(|(min, max)| Bounds { min, max }.transformed(&world_from_leaf))
            }
        }
    }

    /// Half-spaces whose author gave no extent reach past everything that is bounded, wherever it moves.
    fn give_extents(&mut self) -> Result<(), LoadError> {
        // Beyond the farthest corner, so that a surface at it is still cut.
        const REACH: f64 = 1.05;
        let poses = self.poses();
        for (index, (geometry, leaf)) in self.geometry.iter_mut().zip(&mut self.scene.leaves).enumerate() {
            let LeafGeometry::Solid(Solid::HalfSpace { point, normal, extent }) = geometry else { continue };
            if *extent != EXTENT_OF_THE_SCENE {
                continue;
            }
            let mut reach: Option<f64> = None;
            for (bounds, motions) in &poses {
                let Some(bounds) = bounds else { continue };
                let leaf_from_world = (motions[index].affine() * leaf.world_from_leaf).inverse();
                let in_plane = |corner| {
                    let offset = leaf_from_world.transform_point3(corner) - *point;
                    (offset - *normal * offset.dot(*normal)).length()
                };
                let farthest = REACH * bounds.corners().into_iter().map(in_plane).fold(0.0, f64::max);
                reach = Some(reach.map_or(farthest, |reach| reach.max(farthest)));
            }
            match reach {
                Some(reach) if reach > 0.0 => *extent = reach,
                _ => return Err(LoadError::NoExtent { leaf: leaf.name.clone() }),
            }
            leaf.source = LeafSource::Solid(Solid::HalfSpace { point: *point, normal: *normal, extent: *extent });
        }
        Ok(())
    }

    /// Where the bounded leaves are, and what moves each leaf, as the scene has them and at times of its animation.
    fn poses(&self) -> Vec<(Option<Bounds>, Vec<Motion>)> {
        let leaves = self.scene.leaves.len();
        let pose = |motions: Vec<Motion>| {
            let moved =
                |(bounds, motion): (&Option<Bounds>, &Motion)| Some(bounds.as_ref()?.transformed(&motion.affine()));
            (self.bounds.iter().zip(&motions).filter_map(moved).reduce(Bounds::union), motions)
        };
        let mut poses = vec![pose(vec![Motion::REST; leaves])];
        if let Some(animation) = &self.scene.animation {
            let at = |time| (0..leaves as u32).map(|leaf| animation.motion(LeafId(leaf), time)).collect();
            poses.extend(animation.sample_times().into_iter().map(|time| pose(at(time))));
        }
        poses
    }

    fn find_equal_leaves(&mut self) {
        // Most leaves differ in what is quick to compare; only those that agree in it are compared number by number.
        let mut alike: HashMap<(u8, usize, [u64; 12]), Vec<usize>> = HashMap::new();
        let moves = |index: usize| {
            let animation = self.scene.animation.as_ref();
            animation.is_some_and(|animation| animation.moves(LeafId(index as u32)))
        };
        for (index, (geometry, leaf)) in self.geometry.iter().zip(&self.scene.leaves).enumerate() {
            // What is equal now parts when one of the two moves.
            if moves(index) {
                self.canonical.push(LeafId(index as u32));
                continue;
            }
            let (tag, size) = match geometry {
                LeafGeometry::Cloud(cloud) => (0, cloud.len()),
                LeafGeometry::Mesh(mesh) => (1, mesh.triangles.len()),
                LeafGeometry::Solid(_) => (2, 0),
            };
            let transform = leaf.world_from_leaf.to_cols_array().map(f64::to_bits);
            let candidates = alike.entry((tag, size, transform)).or_default();
            let earlier = candidates
                .iter()
                .copied()
                .find(|&earlier| self.scene.leaves[earlier].kind == leaf.kind && self.geometry[earlier].same(geometry));
            match earlier {
                Some(earlier) => {
                    self.notes.push(SceneNote::SameContent {
                        leaf: leaf.name.clone(),
                        earlier: self.scene.leaves[earlier].name.clone(),
                    });
                    self.canonical.push(LeafId(earlier as u32));
                }
                None => {
                    candidates.push(index);
                    self.canonical.push(LeafId(index as u32));
                }
            }
        }
    }

    fn gather_notes(&mut self) {
        for file in &self.files {
            let note = |note: &Note| SceneNote::File { path: file.path.clone(), note: note.clone() };
            self.notes.extend(file.notes.iter().map(note));
        }
        let used = self.scene.tree.leaves();
        for (index, leaf) in self.scene.leaves.iter().enumerate() {
            if used.binary_search(&LeafId(index as u32)).is_err() {
                self.notes.push(SceneNote::Unused { leaf: leaf.name.clone() });
            }
            if let LeafGeometry::Cloud(cloud) = &self.geometry[index]
                && cloud.normals.is_none()
                && Spread::of(cloud, &leaf.world_from_leaf) == Spread::Line
            {
                self.notes.push(SceneNote::Line { leaf: leaf.name.clone() });
            }
            if let LeafGeometry::Mesh(mesh) = &self.geometry[index]
                && leaf.kind == LeafKind::Solid
                && mesh.is_inside_out()
            {
                self.notes.push(SceneNote::InsideOut { leaf: leaf.name.clone() });
            }
        }
        if self.extent() == Extent::Empty {
            self.notes.push(SceneNote::CannotMeet);
        } else if self.is_endless() {
            self.notes.push(SceneNote::Unbounded);
        }
    }

    /// Whether the leaf is a sheet.
    pub fn is_sheet(&self, leaf: LeafId) -> bool {
        self.scene.leaves[leaf.0 as usize].kind == LeafKind::Sheet
    }
}

fn check_memory(positions: &[glam::DVec3]) -> Result<(), &'static str> {
    if positions.is_empty() {
        return Err("it is empty: hand over at least one point");
    }
    if !positions.par_iter().all(|p| p.is_finite()) {
        return Err("a position is not finite: drop or mend such points first");
    }
    Ok(())
}

fn is_invertible(map: &DAffine3) -> bool {
    map.is_finite() && map.matrix3.determinant() != 0.0 && map.inverse().is_finite()
}

/// A file's geometry and what is known of it.
struct ReadFile {
    geometry: LeafGeometry,
    info: LoadedFile,
}

/// All files of a scene, by the path that names them, each content once.
struct Files {
    /// In the order of their first use.
    read: Vec<ReadFile>,
    by_path: HashMap<PathBuf, usize>,
}

impl Files {
    fn read(scene: &Scene, options: &ReadOptions, progress: &dyn Progress) -> Result<Self, LoadError> {
        let mut by_path: HashMap<PathBuf, usize> = HashMap::new();
        let mut by_real_path: HashMap<PathBuf, usize> = HashMap::new();
        // With the leaf that names it first.
        let mut paths: Vec<(&Path, &str)> = Vec::new();
        for leaf in &scene.leaves {
            let source = if let LeafSource::File(path) = &leaf.source { Some(path) } else { None };
            let truth = if let Some(Truth::File(path)) = &leaf.truth { Some(path) } else { None };
            for path in source.into_iter().chain(truth) {
                // Where the path does not resolve, reading it says why.
                let real = std::fs::canonicalize(path).unwrap_or_else(|_| path.clone());
                let number = *by_real_path.entry(real).or_insert_with(|| {
                    paths.push((path, &leaf.name));
                    paths.len() - 1
                });
                by_path.insert(path.clone(), number);
            }
        }
        let read: Vec<Result<ReadFile, ReadError>> = paths
            .par_iter()
            .map(|(path, _)| {
                let loaded = formats::read(path, options, progress)?;
                let info = LoadedFile {
                    path: path.to_path_buf(),
                    format: loaded.format,
                    bytes: loaded.bytes,
                    stated: loaded.stated,
                    is_unoriented: loaded.is_unoriented(),
                    notes: loaded.notes,
                };
                let geometry = match loaded.geometry {
                    Geometry::Cloud(cloud) => LeafGeometry::Cloud(Arc::new(cloud)),
                    Geometry::Mesh(mesh) => LeafGeometry::Mesh(Arc::new(mesh)),
                };
                Ok(ReadFile { geometry, info })
            })
            .collect();
        // The first error in the scene's order, not in time.
        let read = read
            .into_iter()
            .zip(&paths)
            .map(|(file, (_, leaf))| {
                file.map_err(|source| LoadError::File { leaf: (*leaf).to_owned(), source: source.into() })
            })
            .collect::<Result<_, _>>()?;
        Ok(Self { read, by_path })
    }

    fn get(&self, path: &Path) -> &ReadFile {
        &self.read[self.by_path[path]]
    }

    fn into_infos(self) -> Vec<LoadedFile> {
        self.read.into_iter().map(|file| file.info).collect()
    }
}

#[cfg(test)]
mod tests;
