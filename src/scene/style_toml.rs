//! The `[style]` table of a scene file.
//!
//! ```toml
//! [style]
//! kind = "sketchy"            # shaded, transparent, blueprint, wireframe, edge-transparent, sketchy
//! opacity = 0.4               # of every surface, times its leaf's
//! tint = 0.08                 # blueprint: opacity of a surface
//! fade = 0.25                 # how much weaker the ink of each layer is than that of the one before
//! occlusion = 0.6             # shaded: how dark hollows are
//! shadows = true              # or how dark, 0 to 1
//! line_width = 1.5            # pixels
//! crease = 25                 # degrees: surfaces that meet at more have a line
//! jump = 3                    # footprints: surfaces further apart have a line
//! hidden = "dashed"           # solid, dashed, dotted, or [dash, gap] in pixels
//! ink = "#203040"
//! cut_colour = "leaf"         # cutter, leaf, or a colour
//! max_layers = 4
//! legend = true               # names of the leaves that show, or in which corner: "bottom-right"
//! sketch = { edge = [[5, 0], [0, 5]], shade = [[-7, 2], [-2, -7]], wavelength = 90, seed = 1 }   # pixels
//! ```

use super::style::{Corner, CutColour, HIDDEN_LINES, SketchSettings, Style, StyleKind, is_dash_px};
use super::toml_file::SceneError;
use super::toml_values::Field;

const KEYS: [&str; 15] = [
    "kind",
    "opacity",
    "tint",
    "fade",
    "occlusion",
    "shadows",
    "line_width",
    "crease",
    "jump",
    "hidden",
    "ink",
    "cut_colour|cut_color",
    "max_layers",
    "legend",
    "sketch",
];

/// The style that `field` describes.
///
/// # Errors
/// [`SceneError`]: the first mistake, with its line and column.
pub(super) fn parse(field: &Field) -> Result<Style, SceneError> {
    let table = field.table("[style]", &KEYS, "a table with `kind = \"blueprint\"`")?;
    let mut style = Style::default();
    if let Some(kind) = table.get("kind")? {
        let name = kind.text("a style's name, such as \"blueprint\"")?;
        let found = StyleKind::ALL.into_iter().find(|kind| kind.name() == name);
        let names = StyleKind::ALL.map(StyleKind::name).join(", ");
        let unknown = || kind.bad(format!("\"{name}\" is no style"), format!("write one of {names}"));
        style = Style::of(found.ok_or_else(unknown)?);
    }
    for (key, value) in [("opacity", &mut style.opacity), ("tint", &mut style.tint), ("fade", &mut style.fade)] {
        if let Some(field) = table.get(key)? {
            *value = field.share()?;
        }
    }
    if let Some(occlusion) = table.get("occlusion")? {
        style.occlusion = Some(occlusion.share()?);
    }
    if let Some(shadows) = table.get("shadows")? {
        style.shadows = parse_shadows(&shadows)?;
    }
    if let Some(width) = table.get("line_width")? {
        style.lines.width_px = width.positive()? as f32;
        if !(style.lines.width_px <= super::style::WIDEST_LINE_PX) {
            let most = super::style::WIDEST_LINE_PX;
            return Err(width.bad(format!("lines are at most {most} pixels wide"), "write a smaller width"));
        }
    }
    if let Some(degrees) = table.get("crease")? {
        style.lines.crease_degrees = degrees.positive()? as f32;
        if !(style.lines.crease_degrees <= 180.0) {
            return Err(degrees.bad("surfaces meet at no more than 180 degrees", "write 180 for no creases"));
        }
    }
    if let Some(jump) = table.get("jump")? {
        style.lines.jump_px = jump.positive()? as f32;
    }
    if let Some(hidden) = table.get("hidden")? {
        style.lines.hidden_dash_px = parse_hidden(&hidden)?;
    }
    if let Some(ink) = table.get("ink")? {
        style.lines.ink = Some(ink.colour()?);
    }
    if let Some(cut) = table.get("cut_colour|cut_color")? {
        let name = if cut.is_text() { cut.text("")? } else { "" };
        style.cut_colour = match name {
            "cutter" => CutColour::Cutter,
            "leaf" => CutColour::Leaf,
            _ => CutColour::Set(cut.colour()?),
        };
    }
    if let Some(most) = table.get("max_layers")? {
        let number = most.number()?;
        if !(number >= 1.0 && number <= f64::from(u32::MAX) && number.fract() == 0.0) {
            return Err(most.bad("it is no count of layers", "write a whole number from 1"));
        }
        style.max_layers = Some(number as u32);
    }
    if let Some(legend) = table.get("legend")? {
        style.legend = parse_legend(&legend)?;
    }
    if let Some(sketch) = table.get("sketch")? {
        style.sketch = parse_sketch(&sketch)?;
    }
    Ok(style)
}

fn parse_shadows(field: &Field) -> Result<f32, SceneError> {
    match field.flag() {
        Ok(is_on) => Ok(f32::from(u8::from(is_on))),
        Err(_) => {
            field.share().map_err(|_| field.bad("it is no darkness", "write true, false or a number from 0 to 1"))
        }
    }
}

fn parse_legend(field: &Field) -> Result<Option<Corner>, SceneError> {
    if !field.is_text() {
        return Ok(field.flag()?.then(Corner::default));
    }
    let name = field.text("a corner")?;
    let names = Corner::ALL.map(Corner::name).join(", ");
    let unknown = || field.bad(format!("\"{name}\" is no corner"), format!("write true, false or one of {names}"));
    Corner::from_name(name).map(Some).ok_or_else(unknown)
}

fn parse_hidden(field: &Field) -> Result<Option<[f32; 2]>, SceneError> {
    let wanted = "\"solid\", \"dashed\", \"dotted\" or [dash, gap] in pixels";
    if field.is_list() {
        let lengths = field.numbers::<2>(wanted)?.map(|length| length as f32);
        if !lengths.into_iter().all(is_dash_px) {
            return Err(field.bad("a dash or gap is shorter than a pixel", format!("write {wanted}")));
        }
        return Ok(Some(lengths));
    }
    let name = field.text(wanted)?;
    let found = HIDDEN_LINES.iter().find(|(known, _)| *known == name);
    found.map(|(_, dash)| *dash).ok_or_else(|| field.bad(format!("\"{name}\" is no line"), format!("write {wanted}")))
}

fn parse_sketch(field: &Field) -> Result<SketchSettings, SceneError> {
    let form = "a table such as { edge = [[5, 0], [0, 5]], wavelength = 90 }";
    let table = field.table("`sketch`", &["edge", "shade", "wavelength", "seed"], form)?;
    let mut sketch = SketchSettings::default();
    for (key, matrix) in [("edge", &mut sketch.edge_px), ("shade", &mut sketch.shade_px)] {
        let Some(field) = table.get(key)? else { continue };
        let wanted = "two rows of two numbers, [[xx, xy], [yx, yy]] in pixels";
        let rows = field.list(wanted)?;
        if rows.len() != 2 {
            return Err(field.bad(format!("it has {} rows", rows.len()), format!("write {wanted}")));
        }
        for (row, values) in rows.iter().zip(matrix) {
            *values = row.numbers::<2>(wanted)?.map(|value| value as f32);
            if !values.iter().all(|value| SketchSettings::is_offset_px(*value)) {
                let most = SketchSettings::MOST_OFFSET_PX;
                return Err(row.bad(format!("offsets are at most {most} pixels"), "write smaller numbers"));
            }
        }
    }
    if let Some(wavelength) = table.get("wavelength")? {
        sketch.wavelength_px = wavelength.positive()? as f32;
        if !SketchSettings::is_wavelength_px(sketch.wavelength_px) {
            let least = SketchSettings::LEAST_WAVELENGTH_PX;
            return Err(wavelength.bad(format!("lines break up below {least} pixels"), "write a longer wavelength"));
        }
    }
    if let Some(seed) = table.get("seed")? {
        let number = seed.number()?;
        if !(number >= 0.0 && number <= f64::from(u32::MAX) && number.fract() == 0.0) {
            return Err(seed.bad("it is no seed", "write a whole number from 0"));
        }
        sketch.seed = number as u32;
    }
    Ok(sketch)
}
