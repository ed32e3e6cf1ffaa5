//! What stands for a leaf's surfaces in a legend: a patch of their colour.
//!
//! *Practice.* A swatch has the colour that a surface of the leaf has where it is seen head on: lit, as clear as the style makes it,
//! and over the paper. Where a leaf has several, as a cutter has whose faces have the colours of what it cuts, its swatch has a
//! part for each. A section's caps are hatched as in the picture.

use super::lighting::Shader;
use super::section::Hatching;
use super::shown::Surface;
use super::{Leaves, Look};
use crate::layers::{Boundary, Facing};
use crate::scene::style::{Style, StyleKind};
use crate::space::Camera;

/// Makes the swatches of one picture.
pub(super) struct Swatches<'a> {
    light: Lit<'a>,
    /// In which surfaces are drawn that are not lit.
    ink: Option<[f32; 3]>,
    hatching: Option<&'a Hatching>,
}

impl<'a> Swatches<'a> {
    /// Of the picture of `camera` in `style`.
    pub fn new(camera: &'a Camera, look: &Look, style: &Style, leaves: Leaves<'a>) -> Self {
        let tints = matches!(style.kind, StyleKind::Blueprint | StyleKind::Wireframe);
        Self {
            light: Lit { shader: Shader::new(&look.light, camera), camera },
            ink: tints.then(|| style.ink(look.background)),
            hatching: leaves.hatching,
        }
    }

    /// What stands for `surface`.
    pub fn part_of(&self, surface: &Surface) -> Part {
        let cap = self.hatching.and_then(|hatching| Cap::of(hatching, surface, self.light.camera));
        Part {
            colour: self.as_drawn(cap.as_ref().map_or(surface.colour, |cap| cap.colour)),
            opacity: surface.opacity,
            hatch: cap.map(|cap| Hatch { ink: self.as_drawn(cap.hatch.ink), ..cap.hatch }),
        }
    }

    fn as_drawn(&self, colour: [f32; 3]) -> [f32; 3] {
        self.ink.unwrap_or_else(|| self.light.head_on(colour))
    }
}

/// A part of a swatch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Part {
    /// Linear RGB, as the picture has it.
    pub colour: [f32; 3],
    /// 0 to 1.
    pub opacity: f32,
    /// What is drawn over it.
    pub hatch: Option<Hatch>,
}

/// Lines over a part of a swatch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Hatch {
    /// Linear RGB, as the picture has it.
    ink: [f32; 3],
    width_px: f32,
    /// As a multiple of what is usual.
    spacing: f32,
    /// Whether lines go up to the right.
    rises: bool,
}

impl Part {
    /// Whether nobody could tell it from `other`.
    pub fn looks_like(&self, other: &Self) -> bool {
        /// Less than a step of an 8-bit picture, in light as in sRGB's middle.
        const ALIKE: f32 = 1.0 / 512.0;
        let near = |a: f32, b: f32| (a - b).abs() < ALIKE;
        self.hatch == other.hatch
            && near(self.opacity, other.opacity)
            && self.colour.iter().zip(other.colour).all(|(a, b)| near(*a, b))
    }

    /// Over `behind`, at column `x`, row `y` of a swatch with letters of `size` beside it.
    pub fn at(&self, x: f32, y: f32, size: f32, behind: [f32; 3]) -> [f32; 3] {
        let ink = self.hatch.map_or(0.0, |hatch| hatch.coverage(x, y, size));
        // As on the cap: lines are opaque where the surface is not.
        let bare = (1.0 - ink) * self.opacity;
        let lines = self.hatch.map_or([0.0; 3], |hatch| hatch.ink);
        std::array::from_fn(|c| ink * lines[c] + bare * self.colour[c] + (1.0 - ink - bare) * behind[c])
    }
}

impl Hatch {
    /// The share of ink in a pixel.
    fn coverage(&self, x: f32, y: f32, size: f32) -> f32 {
        /// Distance of lines as a share of the letters' size: two or three lines to a swatch.
        const SPACING: f32 = 0.45;
        let spacing = (SPACING * size * self.spacing).max(2.0);
        let width = self.width_px.min(0.4 * spacing);
        let across = (if self.rises { x + y } else { x - y }) * std::f32::consts::FRAC_1_SQRT_2;
        let off = (across + 0.5 * spacing).rem_euclid(spacing) - 0.5 * spacing;
        (0.5 + 0.5 * width - off.abs()).clamp(0.0, width.min(1.0))
    }
}

/// What a section's cap is drawn with.
struct Cap {
    colour: [f32; 3],
    hatch: Hatch,
}

impl Cap {
    /// `None` where the surface is no section's.
    fn of(hatching: &Hatching, surface: &Surface, camera: &Camera) -> Option<Self> {
        let lines = hatching.lines(surface.leaf, surface.body)?;
        let along = |axis: glam::DVec3| lines.along.dot(axis);
        let hatch = Hatch {
            ink: hatching.ink(),
            width_px: hatching.line_px() as f32,
            spacing: lines.spacing as f32,
            // Rows count downwards.
            rises: along(camera.right) * along(camera.down) < 0.0,
        };
        Some(Self { colour: hatching.colour(surface.body).unwrap_or(surface.colour), hatch })
    }
}

/// Lights colours as they are seen in the middle of the picture.
struct Lit<'a> {
    shader: Shader<'a>,
    camera: &'a Camera,
}

impl Lit<'_> {
    /// On a surface that faces the eye.
    fn head_on(&self, colour: [f32; 3]) -> [f32; 3] {
        let towards_eye = self.shader.towards_eye(self.camera.width / 2, self.camera.height / 2);
        let facing = Boundary {
            depth: 1.0,
            normal: towards_eye,
            colour,
            opacity: 1.0,
            leaf: 0,
            body: 0,
            facing: Facing::Front,
            samples: 1,
        };
        self.shader.lit(&facing, towards_eye)
    }
}
