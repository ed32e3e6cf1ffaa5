//! The flags that say how the result is drawn.

use clap::Args;
use surfcut::scene::colour;
use surfcut::scene::style::{
    Corner, CutColour, HIDDEN_LINES, SketchSettings, Style, StyleKind, WIDEST_LINE_PX, is_dash_px,
};

use super::args::{choice, positive};

/// Lengths of a dash and a gap in pixels; `None` draws lines whole.
type HiddenLines = Option<[f32; 2]>;

/// Where a legend stands; `None` draws none.
type LegendAt = Option<Corner>;

/// Rows of a 2×2 matrix, in pixels.
type Offsets = [[f32; 2]; 2];

/// The style; what is not given is the scene's.
#[derive(Debug, Clone, Default, Args)]
pub struct StyleArgs {
    /// How it is drawn [default: the scene's, else shaded]
    #[arg(long, value_parser = choice(&StyleKind::ALL, StyleKind::name, StyleKind::summary), help_heading = "Style")]
    pub style: Option<StyleKind>,
    /// Opacity of surfaces in transparent styles, times each leaf's own [default: the scene's, else 0.4]
    #[arg(long, value_name = "0..1", value_parser = share, allow_negative_numbers = true, help_heading = "Style")]
    pub opacity: Option<f32>,
    /// How much weaker the ink of each layer is than that of the layer before it [default: the scene's, else 0.25 in blueprints
    /// and wireframes and 0 elsewhere]
    #[arg(long, value_name = "0..1", value_parser = share, allow_negative_numbers = true, help_heading = "Style")]
    pub fade: Option<f32>,
    /// Opacity of surfaces in a blueprint [default: the scene's, else 0.08]
    #[arg(long, value_name = "0..1", value_parser = share, allow_negative_numbers = true, help_heading = "Style")]
    pub tint: Option<f32>,
    /// How dark hollows are in shaded pictures [default: the scene's, else 0.6 where there are points and 0 elsewhere]
    #[arg(long, value_name = "0..1", value_parser = share, allow_negative_numbers = true, help_heading = "Style")]
    pub occlusion: Option<f32>,
    /// Let the result throw shadows on itself, in styles whose surfaces are lit; with =0..1, how dark they are: 0 for none
    #[arg(long, value_name = "0..1", num_args = 0..=1, require_equals = true, default_missing_value = "1", value_parser = share, allow_negative_numbers = true, help_heading = "Style")]
    pub shadows: Option<f32>,
    /// Width of lines in pixels, in every style but shaded and transparent [default: the scene's, else 1]
    #[arg(long, value_name = "PX", value_parser = line_width, allow_negative_numbers = true, help_heading = "Style")]
    pub line_width: Option<f32>,
    /// Surfaces that meet at more than this angle have a line there [default: the scene's, else 25]
    #[arg(long, value_name = "DEGREES", value_parser = angle, allow_negative_numbers = true, help_heading = "Style")]
    pub crease: Option<f32>,
    /// Surfaces further apart than this many footprints of a pixel have a line between them [default: the scene's, else 3]
    #[arg(long, value_name = "PX", value_parser = positive, allow_negative_numbers = true, help_heading = "Style")]
    pub jump: Option<f64>,
    /// Lines that a nearer layer hides: solid, dashed, dotted, or the lengths of a dash and a gap in pixels, such as 9,4
    /// [default: the scene's, else solid]
    #[arg(long, value_name = "LINE|DASH,GAP", value_parser = hidden_lines, help_heading = "Style")]
    pub hidden: Option<HiddenLines>,
    /// Colour of lines: #rrggbb or a name [default: the scene's, else the style's]
    #[arg(long, value_name = "COLOUR", value_parser = rgb, help_heading = "Style")]
    pub ink: Option<[f32; 3]>,
    /// Colour of cut faces: cutter, leaf (that was cut), #rrggbb or a name [default: the scene's, else cutter]
    #[arg(long, alias = "cut-color", value_name = "WHOSE|COLOUR", value_parser = cut_colour, help_heading = "Style")]
    pub cut_colour: Option<CutColour>,
    /// Name the leaves that show, each beside its colour, in a corner: bottom-left where none is named, bottom-right, top-left
    /// or top-right; none for no legend where the scene has one. In an EXR it is in the picture's colours alone
    #[arg(long, value_name = "CORNER", num_args = 0..=1, default_missing_value = Corner::default().name(), value_parser = legend, help_heading = "Style")]
    pub legend: Option<LegendAt>,
    /// Write what the picture is made of into this folder: each layer's depth, normals, colours and lines
    #[arg(long, value_name = "FOLDER", value_hint = clap::ValueHint::DirPath, help_heading = "Style")]
    pub dump_maps: Option<std::path::PathBuf>,
    /// Another hand for the sketchy style [default: the scene's, else 1]
    #[arg(long, value_name = "N", help_heading = "Style")]
    pub seed: Option<u32>,
    /// How far the noise moves edges in the sketchy style: the rows of a 2x2 matrix in pixels
    /// [default: the scene's, else 5,0,0,5]
    #[arg(long, value_name = "XX,XY,YX,YY", value_parser = offsets, allow_hyphen_values = true, help_heading = "Style")]
    pub sketch_edge: Option<Offsets>,
    /// How far it moves surfaces [default: the scene's, else -7,2,-2,-7]
    #[arg(long, value_name = "XX,XY,YX,YY", value_parser = offsets, allow_hyphen_values = true, help_heading = "Style")]
    pub sketch_shade: Option<Offsets>,
    /// Distance over which the noise changes, in pixels [default: the scene's, else 90]
    #[arg(long, value_name = "PX", value_parser = wavelength, allow_negative_numbers = true, help_heading = "Style")]
    pub sketch_wavelength: Option<f32>,
}

impl StyleArgs {
    /// The scene's style with what the flags change of it.
    pub fn style(&self, scene: &Style, max_layers: Option<u32>) -> Style {
        let mut style = *scene;
        if let Some(kind) = self.style.filter(|&kind| kind != scene.kind) {
            // What suits one style's opacities does not suit another's; lines and colours are the scene's still.
            let Style { lines, sketch, cut_colour, max_layers, legend, shadows, .. } = *scene;
            style = Style { lines, sketch, cut_colour, max_layers, legend, shadows, ..Style::of(kind) };
        }
        style.opacity = self.opacity.unwrap_or(style.opacity);
        style.fade = self.fade.unwrap_or(style.fade);
        style.tint = self.tint.unwrap_or(style.tint);
        style.occlusion = self.occlusion.or(style.occlusion);
        style.shadows = self.shadows.unwrap_or(style.shadows);
        style.lines.width_px = self.line_width.unwrap_or(style.lines.width_px);
        style.lines.crease_degrees = self.crease.unwrap_or(style.lines.crease_degrees);
        style.lines.jump_px = self.jump.map_or(style.lines.jump_px, |jump| jump as f32);
        style.lines.hidden_dash_px = self.hidden.unwrap_or(style.lines.hidden_dash_px);
        style.lines.ink = self.ink.or(style.lines.ink);
        style.cut_colour = self.cut_colour.unwrap_or(style.cut_colour);
        style.sketch.seed = self.seed.unwrap_or(style.sketch.seed);
        style.sketch.edge_px = self.sketch_edge.unwrap_or(style.sketch.edge_px);
        style.sketch.shade_px = self.sketch_shade.unwrap_or(style.sketch.shade_px);
        style.sketch.wavelength_px = self.sketch_wavelength.unwrap_or(style.sketch.wavelength_px);
        style.legend = self.legend.unwrap_or(style.legend);
        style.max_layers = max_layers.or(style.max_layers);
        style
    }
}

/// `N` numbers with commas between them.
fn numbers<const N: usize>(text: &str) -> Option<[f32; N]> {
    let numbers: Option<Vec<f32>> = text.split(',').map(|part| part.trim().parse().ok()).collect();
    numbers?.try_into().ok()
}

fn hidden_lines(text: &str) -> Result<HiddenLines, String> {
    if let Some((_, dash)) = HIDDEN_LINES.iter().find(|(name, _)| *name == text) {
        return Ok(*dash);
    }
    let names = HIDDEN_LINES.map(|(name, _)| name).join(", ");
    let lengths = numbers::<2>(text).ok_or_else(|| format!("write {names}, or two lengths in pixels such as 9,4"))?;
    if lengths.into_iter().all(is_dash_px) {
        Ok(Some(lengths))
    } else {
        Err("a dash and a gap are a pixel long or more, and end".into())
    }
}

fn offsets(text: &str) -> Result<Offsets, String> {
    let wanted = "write four numbers, the rows of a 2x2 matrix in pixels, such as 5,0,0,5";
    let [xx, xy, yx, yy] = numbers::<4>(text).ok_or(wanted)?;
    if ![xx, xy, yx, yy].into_iter().all(SketchSettings::is_offset_px) {
        return Err(format!("offsets are at most {} pixels", SketchSettings::MOST_OFFSET_PX));
    }
    Ok([[xx, xy], [yx, yy]])
}

fn wavelength(text: &str) -> Result<f32, String> {
    let px = positive(text)? as f32;
    if SketchSettings::is_wavelength_px(px) {
        Ok(px)
    } else {
        Err(format!("lines break up below {} pixels", SketchSettings::LEAST_WAVELENGTH_PX))
    }
}

fn legend(text: &str) -> Result<LegendAt, String> {
    if text == "none" {
        return Ok(None);
    }
    let names = Corner::ALL.map(Corner::name).join(", ");
    // Whatever follows the flag is taken for a corner.
    let wanted = || format!("write none or one of {names}; a scene goes before the flag");
    Corner::from_name(text).map(Some).ok_or_else(wanted)
}

fn share(text: &str) -> Result<f32, String> {
    match text.parse::<f32>() {
        Ok(value) if (0.0..=1.0).contains(&value) => Ok(value),
        _ => Err("write a number from 0 to 1".into()),
    }
}

fn line_width(text: &str) -> Result<f32, String> {
    let width = positive(text)? as f32;
    if width <= WIDEST_LINE_PX { Ok(width) } else { Err(format!("lines are at most {WIDEST_LINE_PX} pixels wide")) }
}

fn angle(text: &str) -> Result<f32, String> {
    let degrees = positive(text)? as f32;
    if degrees <= 180.0 { Ok(degrees) } else { Err("surfaces meet at no more than 180 degrees".into()) }
}

fn rgb(text: &str) -> Result<[f32; 3], String> {
    match colour::parse_background(text) {
        Some([r, g, b, a]) if a >= 1.0 => Ok([r, g, b]),
        _ => Err("write #rrggbb or a name such as black".into()),
    }
}

fn cut_colour(text: &str) -> Result<CutColour, String> {
    match text {
        "cutter" => Ok(CutColour::Cutter),
        "leaf" => Ok(CutColour::Leaf),
        _ => rgb(text).map(CutColour::Set).map_err(|_| "write cutter, leaf, #rrggbb or a name such as red".into()),
    }
}
