//! What the user wrote: leaves, the expression over them, and how to look at it.
//!
//! A [`Scene`] is plain data: nothing in it depends on a pipeline, and nothing has been read from disk but the scene
//! file itself. [`load`](crate::scene::load()) turns its files into geometry.

use std::path::PathBuf;
use std::sync::Arc;

use glam::{DAffine3, DVec3};

use crate::csg::{LeafId, Tree};
use crate::geometry::{PointCloud, Solid, TriMesh};
use crate::space::{Camera, CameraError, Lens};

pub mod animation;
pub mod colour;
pub mod endless;
pub mod framing;
pub mod inline_solid;
pub mod inspect;
mod keyframes;
pub mod load;
pub mod nearest_name;
pub mod one_liner;
pub mod represent;
pub mod style;
mod style_toml;
pub mod toml_file;
mod toml_values;
pub mod tree_json;

pub use animation::Animation;
pub use load::{LeafGeometry, LoadedScene, load};
pub use represent::{RepresentError, Representation};

/// Picture size where nobody asks for one: width, height in pixels.
pub const DEFAULT_SIZE: (u32, u32) = (1024, 768);

/// Linear RGB and opacity behind everything where nobody asks for one: warm white paper (sRGB #f6f4f0).
pub const DEFAULT_BACKGROUND: [f32; 4] = [0.921_58, 0.904_66, 0.871_37, 1.0];

/// Whether a leaf has an inside.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum LeafKind {
    /// It has an inside: it can be cut, can cut, and has a complement.
    #[default]
    Solid,
    /// An open surface: it can be cut by others but never cuts, and has no complement.
    Sheet,
}

/// Where a leaf's geometry comes from.
#[derive(Debug, Clone)]
pub enum LeafSource {
    /// A file, its path already relative to the working directory.
    File(PathBuf),
    /// An analytic solid in leaf space.
    Solid(Solid),
    /// Points handed over by a caller of the library.
    Cloud(Arc<PointCloud>),
    /// A mesh handed over by a caller of the library.
    Mesh(Arc<TriMesh>),
}

/// What a point leaf was sampled from, for the reference renderer alone; in the leaf's own space.
#[derive(Debug, Clone)]
pub enum Truth {
    /// A mesh file.
    File(PathBuf),
    /// An analytic solid.
    Solid(Solid),
    /// A mesh handed over by a caller of the library.
    Mesh(Arc<TriMesh>),
}

/// One operand of the expression.
#[derive(Debug, Clone)]
pub struct Leaf {
    /// Its name in expressions.
    pub name: String,
    /// Its geometry.
    pub source: LeafSource,
    /// Leaf space to world space; affine, invertible, may mirror.
    pub world_from_leaf: DAffine3,
    /// Linear RGB; `None` takes the file's colours, or a colour by the leaf's index.
    pub colour: Option<[f32; 3]>,
    /// Opacity, 0 to 1.
    pub opacity: f32,
    /// Solid or sheet.
    pub kind: LeafKind,
    /// For the reference renderer.
    pub truth: Option<Truth>,
    /// Surfel spacing in world units for a sampled leaf, overriding the picture's needs.
    pub spacing: Option<f64>,
    /// What it is drawn as; `None` takes what it is.
    pub represent: Option<Representation>,
    /// Where a half-space is a section: its cut faces are hatched.
    pub section: Option<Section>,
}

/// How a section is hatched.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Section {
    /// Distance of the lines, world units; `None` goes by the scene's size.
    pub hatch_spacing: Option<f64>,
}

impl Leaf {
    /// An opaque solid leaf without transform.
    pub fn new(name: impl Into<String>, source: LeafSource) -> Self {
        Self {
            name: name.into(),
            source,
            world_from_leaf: DAffine3::IDENTITY,
            colour: None,
            opacity: 1.0,
            kind: LeafKind::Solid,
            truth: None,
            spacing: None,
            represent: None,
            section: None,
        }
    }
}

/// A camera as the user wrote it; the picture's size is the scene's.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraSpec {
    /// World space.
    pub eye: DVec3,
    /// World space.
    pub target: DVec3,
    /// World space, any length.
    pub up: DVec3,
    /// Perspective or orthographic.
    pub lens: Lens,
}

impl CameraSpec {
    /// The camera for a picture of `size` (width, height) pixels.
    ///
    /// # Errors
    /// As [`Camera::look_at`].
    pub fn camera(&self, size: (u32, u32)) -> Result<Camera, CameraError> {
        Camera::look_at(self.eye, self.target, self.up, self.lens, size.0, size.1)
    }
}

/// One directional light and an ambient term, linear, relative to the camera or the world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Light {
    /// Direction *towards* the light. In view space (right, down, forward) unless `in_world`.
    pub towards: DVec3,
    /// Whether `towards` is in world space.
    pub in_world: bool,
    /// Share of light that arrives from everywhere, 0 to 1.
    pub ambient: f32,
}

impl Default for Light {
    /// Over the viewer's left shoulder.
    fn default() -> Self {
        Self { towards: DVec3::new(-0.45, -0.65, -1.0), in_world: false, ambient: 0.22 }
    }
}

/// A scene: leaves, expression, view.
#[derive(Debug, Clone)]
pub struct Scene {
    /// The leaves; a leaf's index here is its index everywhere (`Leaf` channel, [`crate::csg::LeafId`]).
    pub leaves: Vec<Leaf>,
    /// The expression over them.
    pub tree: Tree,
    /// `None` frames the scene.
    pub camera: Option<CameraSpec>,
    /// Picture size in pixels: width, height.
    pub size: (u32, u32),
    /// Linear RGB and opacity behind everything; `None` is the style's paper, or [`DEFAULT_BACKGROUND`].
    pub background: Option<[f32; 4]>,
    /// How it is drawn.
    pub style: style::Style,
    /// The light.
    pub light: Light,
    /// The unit of lengths, such as `mm`, where the scene names one.
    pub units: Option<String>,
    /// How it moves, where it has keyframes.
    pub animation: Option<Animation>,
}

impl Scene {
    /// A scene of `leaves` combined by `tree`, with everything else as where a user does not ask for it.
    pub fn new(leaves: Vec<Leaf>, tree: Tree) -> Self {
        Self {
            leaves,
            tree,
            camera: None,
            size: DEFAULT_SIZE,
            background: None,
            style: style::Style::default(),
            light: Light::default(),
            units: None,
            animation: None,
        }
    }

    /// What lies behind everything in a picture of `style`: linear RGB and opacity.
    pub fn background_for(&self, style: &style::Style) -> [f32; 4] {
        self.background.or(style.paper()).unwrap_or(DEFAULT_BACKGROUND)
    }

    /// The first sheet that the expression subtracts or complements, which no sheet can be: it has no inside.
    pub fn subtracted_sheet(&self) -> Option<LeafId> {
        let is_sheet = |leaf: LeafId| self.leaves[leaf.0 as usize].kind == LeafKind::Sheet;
        // Most scenes have none, and an expression may be long.
        if self.leaves.iter().all(|leaf| leaf.kind == LeafKind::Solid) {
            return None;
        }
        self.tree.positive().literals().find(|literal| literal.negated && is_sheet(literal.leaf)).map(|l| l.leaf)
    }
}
