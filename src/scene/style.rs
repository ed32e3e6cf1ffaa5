//! How the result is drawn, as the user says it: the `[style]` table of a scene and the flags of the same names.

use super::colour::linear_from_bytes;

/// The styles (Nienhaus et al., Blueprint CSG and Sketchy CSG, 2006; the first two are everybody's).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum StyleKind {
    /// Lit surfaces.
    #[default]
    Shaded,
    /// Lit surfaces that let deeper ones through.
    Transparent,
    /// The edges of every layer, and a tint that is deeper where more layers lie behind each other.
    Blueprint,
    /// The edges of every layer alone.
    Wireframe,
    /// Transparent surfaces with the edges of every layer.
    EdgeTransparent,
    /// As edge-transparent, drawn by a loose hand.
    Sketchy,
}

impl StyleKind {
    /// All styles.
    pub const ALL: [Self; 6] =
        [Self::Shaded, Self::Transparent, Self::Blueprint, Self::Wireframe, Self::EdgeTransparent, Self::Sketchy];

    /// The name in files and flags.
    pub fn name(self) -> &'static str {
        match self {
            Self::Shaded => "shaded",
            Self::Transparent => "transparent",
            Self::Blueprint => "blueprint",
            Self::Wireframe => "wireframe",
            Self::EdgeTransparent => "edge-transparent",
            Self::Sketchy => "sketchy",
        }
    }

    /// One line of help.
    pub fn summary(self) -> &'static str {
        match self {
            Self::Shaded => "Lit surfaces",
            Self::Transparent => "Lit surfaces that let deeper ones through",
            Self::Blueprint => "Edges of every layer, tinted by how many layers lie behind each other",
            Self::Wireframe => "Edges of every layer alone",
            Self::EdgeTransparent => "Transparent surfaces with the edges of every layer",
            Self::Sketchy => "Edges and surfaces drawn by a loose hand",
        }
    }

    /// Whether the style draws lines.
    pub fn has_lines(self) -> bool {
        !matches!(self, Self::Shaded | Self::Transparent)
    }

    /// Whether surfaces are lit, so that shadows can fall on them.
    pub fn is_lit(self) -> bool {
        !matches!(self, Self::Blueprint | Self::Wireframe)
    }
}

/// A corner of the picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Corner {
    /// Where a reader begins.
    TopLeft,
    /// Top right.
    TopRight,
    /// Where pictures seldom show anything.
    #[default]
    BottomLeft,
    /// Bottom right.
    BottomRight,
}

impl Corner {
    /// All corners.
    pub const ALL: [Self; 4] = [Self::TopLeft, Self::TopRight, Self::BottomLeft, Self::BottomRight];

    /// The name in files and flags.
    pub fn name(self) -> &'static str {
        match self {
            Self::TopLeft => "top-left",
            Self::TopRight => "top-right",
            Self::BottomLeft => "bottom-left",
            Self::BottomRight => "bottom-right",
        }
    }

    /// The corner called `name`.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|corner| corner.name() == name)
    }

    /// Whether it is one of the left two.
    pub fn is_left(self) -> bool {
        matches!(self, Self::TopLeft | Self::BottomLeft)
    }

    /// Whether it is one of the upper two.
    pub fn is_top(self) -> bool {
        matches!(self, Self::TopLeft | Self::TopRight)
    }
}

/// Whose colour a cut face has: where a cutter's surface bounds the result.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum CutColour {
    /// The cutter's.
    #[default]
    Cutter,
    /// That of the leaf that was cut.
    Leaf,
    /// One colour, linear RGB.
    Set([f32; 3]),
}

/// How hidden lines may be drawn, by name: lengths of a dash and a gap in pixels.
pub const HIDDEN_LINES: [(&str, Option<[f32; 2]>); 3] =
    [("solid", None), ("dashed", Some([7.0, 5.0])), ("dotted", Some([1.5, 3.5]))];

/// Whether a dash or a gap may have this length in pixels: shorter ones would be grey.
pub fn is_dash_px(length: f32) -> bool {
    length >= 1.0 && length.is_finite()
}

/// Lines are at most this wide, so that those of one tile end in the next.
pub const WIDEST_LINE_PX: f32 = 16.0;

/// Where lines stand and how they look.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LineSettings {
    /// Width in pixels.
    pub width_px: f32,
    /// Surfaces of two neighbouring pixels are apart where one is deeper than the other's tangent plane by more than this
    /// many footprints.
    pub jump_px: f32,
    /// Two surfaces that meet at more than this angle meet in a crease; degrees.
    pub crease_degrees: f32,
    /// Length of a dash and of the gap after it, in pixels, of lines that a nearer layer hides; `None` draws them whole.
    pub hidden_dash_px: Option<[f32; 2]>,
    /// Linear RGB; `None` is the style's own.
    pub ink: Option<[f32; 3]>,
}

impl Default for LineSettings {
    fn default() -> Self {
        Self { width_px: 1.0, jump_px: 3.0, crease_degrees: 25.0, hidden_dash_px: None, ink: None }
    }
}

/// How loose the hand of the sketchy style is: image-space noise, and two 2×2 matrices that turn its two values into
/// offsets in pixels (Sketchy §4).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SketchSettings {
    /// Offset of the edges, in pixels for a noise of 1: rows of a 2×2 matrix.
    pub edge_px: [[f32; 2]; 2],
    /// Offset of the surfaces.
    pub shade_px: [[f32; 2]; 2],
    /// Distance over which the noise changes, in pixels.
    pub wavelength_px: f32,
    /// Which noise.
    pub seed: u32,
}

impl SketchSettings {
    /// Offsets are held below this, so that a strip of tiles around a row of them is all that a picture needs.
    pub const MOST_OFFSET_PX: f32 = 32.0;
    /// The noise is computed every eighth pixel.
    pub const LEAST_WAVELENGTH_PX: f32 = 16.0;

    /// Whether a matrix may hold this number, in pixels.
    pub fn is_offset_px(offset: f32) -> bool {
        offset.abs() <= Self::MOST_OFFSET_PX
    }

    /// Whether the noise may change over this distance, in pixels.
    pub fn is_wavelength_px(length: f32) -> bool {
        length >= Self::LEAST_WAVELENGTH_PX && length.is_finite()
    }
}

impl Default for SketchSettings {
    /// Edges and surfaces go opposite ways, which is what makes the drawing look as if coloured after it was inked.
    fn default() -> Self {
        Self { edge_px: [[5.0, 0.0], [0.0, 5.0]], shade_px: [[-7.0, 2.0], [-2.0, -7.0]], wavelength_px: 90.0, seed: 1 }
    }
}

/// How dark the hollows of a shaded scan are.
pub const SCAN_OCCLUSION: f32 = 0.6;

/// The blue of cyanotypes.
const CYANOTYPE: [u8; 3] = [22, 58, 112];

/// A style with its parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Style {
    /// Which.
    pub kind: StyleKind,
    /// Opacity of a surface, by which its leaf's opacity is multiplied (transparent, edge-transparent, sketchy); 0 to 1.
    pub opacity: f32,
    /// Opacity of a surface in a blueprint: how much each layer tints; 0 to 1.
    pub tint: f32,
    /// How much weaker the ink of each layer is than that of the layer before it; 0 to 1.
    pub fade: f32,
    /// How dark hollows are (shaded alone); 0 to 1. `None` is [`SCAN_OCCLUSION`] in scenes with points and none in others.
    pub occlusion: Option<f32>,
    /// How dark shadows are (where surfaces are lit): 0 without any, 1 without any of the light.
    pub shadows: f32,
    /// Lines.
    pub lines: LineSettings,
    /// Sketchy alone.
    pub sketch: SketchSettings,
    /// Whose colour cut faces have.
    pub cut_colour: CutColour,
    /// Layers drawn at most.
    pub max_layers: Option<u32>,
    /// Where the names of the leaves that show stand beside their colours; `None` draws no legend.
    pub legend: Option<Corner>,
}

impl Default for Style {
    fn default() -> Self {
        Self::of(StyleKind::default())
    }
}

impl Style {
    /// The style `kind` with parameters that suit it.
    pub fn of(kind: StyleKind) -> Self {
        Self {
            kind,
            opacity: if kind == StyleKind::Shaded { 1.0 } else { 0.4 },
            tint: 0.08,
            fade: if matches!(kind, StyleKind::Blueprint | StyleKind::Wireframe) { 0.25 } else { 0.0 },
            occlusion: None,
            shadows: 0.0,
            lines: LineSettings::default(),
            sketch: SketchSettings::default(),
            cut_colour: CutColour::default(),
            max_layers: None,
            legend: None,
        }
    }

    /// The paper that the style is drawn on where the user names no background; linear RGB and alpha.
    pub fn paper(&self) -> Option<[f32; 4]> {
        let [r, g, b] = match self.kind {
            StyleKind::Blueprint => linear_from_bytes(CYANOTYPE),
            StyleKind::Wireframe => [1.0; 3],
            _ => return None,
        };
        Some([r, g, b, 1.0])
    }

    /// The colour of lines on paper of the colour `background`; linear RGB.
    pub fn ink(&self, background: [f32; 4]) -> [f32; 3] {
        const CHALK: [u8; 3] = [226, 238, 250];
        const GRAPHITE: [u8; 3] = [28, 30, 36];
        let [r, g, b, alpha] = background;
        // Luminance (Rec. 709); what shows through a clear background is not known, and mostly white.
        let is_dark = alpha > 0.5 && 0.2126 * r + 0.7152 * g + 0.0722 * b < 0.18;
        self.lines.ink.unwrap_or_else(|| match (is_dark, self.kind) {
            (true, _) => linear_from_bytes(CHALK),
            (false, StyleKind::Blueprint) => linear_from_bytes(CYANOTYPE),
            (false, _) => linear_from_bytes(GRAPHITE),
        })
    }

    /// The style in a scene that `has_points`, or has none: how dark hollows are by default depends on it.
    pub fn for_points(self, has_points: bool) -> Self {
        let occlusion = self.occlusion.or(has_points.then_some(SCAN_OCCLUSION));
        Self { occlusion, ..self }
    }

    /// How dark hollows are, above 0 to 1, where the style shows them.
    pub fn hollow_shade(&self) -> Option<f32> {
        let strength = self.occlusion.filter(|strength| self.kind == StyleKind::Shaded && *strength > 0.0);
        strength.map(|strength| strength.min(1.0))
    }

    /// How dark shadows are, above 0 to 1, where the style shows them.
    pub fn shadow_strength(&self) -> Option<f32> {
        (self.kind.is_lit() && self.shadows > 0.0).then_some(self.shadows.min(1.0))
    }

    /// The factor of every surface's opacity.
    pub fn opacity_factor(&self) -> f32 {
        match self.kind {
            StyleKind::Shaded => 1.0,
            StyleKind::Transparent | StyleKind::EdgeTransparent | StyleKind::Sketchy => self.opacity,
            StyleKind::Blueprint => self.tint,
            StyleKind::Wireframe => 0.0,
        }
    }

    /// Whether deeper layers than the nearest opaque one show.
    pub fn needs_all_layers(&self) -> bool {
        self.kind != StyleKind::Shaded
    }
}
