//! The flags that say how the result is drawn.

use clap::Args;
use surfcut::scene::colour;
use surfcut::scene::style::{CutColour, HIDDEN_LINES, Style, StyleKind, WIDEST_LINE_PX};

use super::args::{choice, positive};

/// The style; what is not given is the scene's.
#[derive(Debug, Clone, Default, Args)]
pub struct StyleArgs {
    /// How it is drawn [default: the scene's, else shaded]
    #[arg(long, value_parser = choice(&StyleKind::ALL, StyleKind::name, StyleKind::summary), help_heading = "Style")]
    pub style: Option<StyleKind>,
    /// Opacity of surfaces in transparent styles, times each leaf's own
    #[arg(long, value_name = "0..1", value_parser = share, help_heading = "Style")]
    pub opacity: Option<f32>,
    /// How much weaker the ink of each layer is than that of the layer before it
    #[arg(long, value_name = "0..1", value_parser = share, help_heading = "Style")]
    pub fade: Option<f32>,
    /// Opacity of surfaces in a blueprint
    #[arg(long, value_name = "0..1", value_parser = share, help_heading = "Style")]
    pub tint: Option<f32>,
    /// How dark hollows are in shaded pictures [default: the scene's, else 0.6 where there are points and 0 elsewhere]
    #[arg(long, value_name = "0..1", value_parser = share, help_heading = "Style")]
    pub occlusion: Option<f32>,
    /// Width of lines in pixels
    #[arg(long, value_name = "PX", value_parser = line_width, help_heading = "Style")]
    pub line_width: Option<f32>,
    /// Surfaces that meet at more than this angle have a line there
    #[arg(long, value_name = "DEGREES", value_parser = angle, help_heading = "Style")]
    pub crease: Option<f32>,
    /// Surfaces further apart than this many footprints of a pixel have a line between them
    #[arg(long, value_name = "PX", value_parser = positive, help_heading = "Style")]
    pub jump: Option<f64>,
    /// Lines that a nearer layer hides: solid, dashed or dotted
    #[arg(long, value_name = "LINE", value_parser = clap::builder::PossibleValuesParser::new(HIDDEN_LINES.map(|(name, _)| name)), help_heading = "Style")]
    pub hidden: Option<String>,
    /// Colour of lines: #rrggbb or a name
    #[arg(long, value_name = "COLOUR", value_parser = rgb, help_heading = "Style")]
    pub ink: Option<[f32; 3]>,
    /// Colour of cut faces: cutter, leaf (that was cut), #rrggbb or a name
    #[arg(long, alias = "cut-color", value_name = "WHOSE|COLOUR", value_parser = cut_colour, help_heading = "Style")]
    pub cut_colour: Option<CutColour>,
    /// Write what the picture is made of into this folder: each layer's depth, normals, colours and lines
    #[arg(long, value_name = "FOLDER", value_hint = clap::ValueHint::DirPath, help_heading = "Style")]
    pub dump_maps: Option<std::path::PathBuf>,
    /// Another hand for the sketchy style
    #[arg(long, value_name = "N", help_heading = "Style")]
    pub seed: Option<u32>,
}

impl StyleArgs {
    /// The scene's style with what the flags change of it.
    pub fn style(&self, scene: &Style, max_layers: Option<u32>) -> Style {
        let mut style = *scene;
        if let Some(kind) = self.style.filter(|&kind| kind != scene.kind) {
            // What suits one style's opacities does not suit another's; lines and colours are the scene's still.
            let Style { lines, sketch, cut_colour, max_layers, .. } = *scene;
            style = Style { lines, sketch, cut_colour, max_layers, ..Style::of(kind) };
        }
        style.opacity = self.opacity.unwrap_or(style.opacity);
        style.fade = self.fade.unwrap_or(style.fade);
        style.tint = self.tint.unwrap_or(style.tint);
        style.occlusion = self.occlusion.or(style.occlusion);
        style.lines.width_px = self.line_width.unwrap_or(style.lines.width_px);
        style.lines.crease_degrees = self.crease.unwrap_or(style.lines.crease_degrees);
        style.lines.jump_px = self.jump.map_or(style.lines.jump_px, |jump| jump as f32);
        if let Some((_, dash)) = self.hidden.as_ref().and_then(|hidden| HIDDEN_LINES.iter().find(|l| l.0 == hidden)) {
            style.lines.hidden_dash_px = *dash;
        }
        style.lines.ink = self.ink.or(style.lines.ink);
        style.cut_colour = self.cut_colour.unwrap_or(style.cut_colour);
        style.sketch.seed = self.seed.unwrap_or(style.sketch.seed);
        style.max_layers = max_layers.or(style.max_layers);
        style
    }
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
