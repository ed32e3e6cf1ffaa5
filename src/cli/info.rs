//! `surfcut info`: what files or a scene hold.

use std::fmt::Write as _;

use serde_json::{Value, json};
use surfcut::csg::{First, LeafId, Positive, StatusList};
use surfcut::scene::framing::{Bounds, Extent};
use surfcut::scene::{LeafGeometry, LeafKind, LoadedScene};
use surfcut::space::Lens;

use super::args::InfoArgs;
use super::failure::code;
use super::{Session, input};

/// Loads the scene and tells what is in it.
pub fn run(args: &InfoArgs, session: &Session) -> anyhow::Result<u8> {
    let loaded = input::loaded(&args.scene, None, session.bars)?;
    session.print(&text(&loaded))?;
    let mut summary = serde_json::to_string_pretty(&summary(&loaded))?;
    summary.push('\n');
    session.write_summary(&summary)?;
    Ok(code::OK)
}

/// What a leaf consists of, in a few words.
pub fn content(geometry: &LeafGeometry) -> String {
    let with = |parts: &[(&str, bool)]| {
        let present: Vec<_> = parts.iter().filter(|(_, is)| *is).map(|(name, _)| *name).collect();
        if present.is_empty() { String::new() } else { format!(" with {}", present.join(", ")) }
    };
    match geometry {
        LeafGeometry::Cloud(cloud) => format!(
            "{} points{}",
            cloud.len(),
            with(&[
                ("normals", cloud.normals.is_some()),
                ("radii", cloud.radii.is_some()),
                ("ellipses", cloud.ellipses.is_some()),
                ("colours", cloud.colours.is_some()),
                ("opacities", cloud.opacities.is_some()),
            ])
        ),
        LeafGeometry::Mesh(mesh) => format!(
            "{} triangles, {} vertices{}",
            mesh.triangles.len(),
            mesh.positions.len(),
            with(&[("colours", mesh.colours.is_some())])
        ),
        LeafGeometry::Solid(_) => "exact".into(),
    }
}

fn kind_name(kind: LeafKind) -> &'static str {
    match kind {
        LeafKind::Solid => "solid",
        LeafKind::Sheet => "sheet",
    }
}

fn size_text(bounds: &Bounds) -> String {
    let size = bounds.max - bounds.min;
    format!("{} × {} × {}", short(size.x), short(size.y), short(size.z))
}

/// Four significant digits, without needless zeros.
pub fn short(value: f64) -> String {
    const DIGITS: i32 = 4;
    if value == 0.0 || !value.is_finite() {
        return value.to_string();
    }
    let magnitude = value.abs().log10().floor() as i32;
    if !(-4..=9).contains(&magnitude) {
        return format!("{value:.3e}");
    }
    let decimals = (DIGITS - 1 - magnitude).max(0) as usize;
    let text = format!("{value:.decimals$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

fn expression(loaded: &LoadedScene) -> String {
    loaded.scene.tree.display(|leaf| loaded.scene.leaves[leaf.0 as usize].name.as_str()).to_string()
}

/// The size of an expression's positive form.
struct Form {
    /// Occurrences of leaves.
    leaves: u32,
    depth: u32,
    /// Of a status list, in the order in which it is written and with the busier operand first.
    ids: u32,
    ids_reordered: u32,
}

impl Form {
    fn of(loaded: &LoadedScene) -> Self {
        let positive = loaded.canonical_tree().positive();
        let ids = |positive: &Positive| StatusList::from(&positive.blist()).id_count();
        Self {
            leaves: positive.literals().count() as u32,
            depth: positive.depth(),
            ids: ids(&positive),
            ids_reordered: ids(&positive.left_heavy(First::Busier)),
        }
    }
}

fn counted(count: u32, one: &str, many: &str) -> String {
    format!("{count} {}", if count == 1 { one } else { many })
}

fn text(loaded: &LoadedScene) -> String {
    /// A longer expression is of no use on a terminal; the summary file has it whole.
    const LONGEST: usize = 400;
    let scene = &loaded.scene;
    let mut out = String::new();
    // Writing to a string cannot fail.
    let mut line = |text: String| {
        let _ = writeln!(out, "{text}");
    };
    let expression = expression(loaded);
    let shown: String = expression.chars().take(LONGEST).collect();
    let rest = if shown.len() < expression.len() { " …" } else { "" };
    line(format!("expression  {shown}{rest}"));
    let form = Form::of(loaded);
    line(format!(
        "positive    {}, {} deep; as a list it takes {}, and {} with the busier operand first",
        counted(form.leaves, "leaf", "leaves"),
        counted(form.depth, "operator", "operators"),
        counted(form.ids, "ID", "IDs"),
        form.ids_reordered,
    ));
    line(format!("units       {}", scene.units.as_deref().unwrap_or("not named")));
    line(format!("picture     {} × {} pixels", scene.size.0, scene.size.1));
    line(match loaded.extent() {
        Extent::Empty => "result      empty: the operands do not meet".into(),
        Extent::Unbounded(_) => "result      without bounds".into(),
        Extent::Within(bounds) => {
            format!("result      within {}, around {}", size_text(&bounds), point_text(bounds.centre()))
        }
    });
    let camera = loaded.camera_spec();
    let lens = match camera.lens {
        Lens::FovY(degrees) => format!("perspective, {}°", short(degrees)),
        Lens::Height(height) => format!("orthographic, {} tall", short(height)),
    };
    let origin = if scene.camera.is_some() { "" } else { " (frames the scene)" };
    let (eye, target) = (point_text(camera.eye), point_text(camera.target));
    line(format!("camera      from {eye} to {target}, {lens}{origin}"));
    let name_width = scene.leaves.iter().map(|leaf| leaf.name.chars().count()).max().unwrap_or(0);
    line(String::new());
    for (index, leaf) in scene.leaves.iter().enumerate() {
        let geometry = &loaded.geometry[index];
        let size = loaded.bounds[index].as_ref().map_or_else(|| "unbounded".into(), size_text);
        let same = loaded.canonical[index];
        let same = if same == LeafId(index as u32) {
            String::new()
        } else {
            format!("; same as {}", scene.leaves[same.0 as usize].name)
        };
        line(format!(
            "leaf {:name_width$}  {} {}: {}; {size}{same}",
            leaf.name,
            kind_name(leaf.kind),
            geometry.name(),
            content(geometry)
        ));
    }
    for file in &loaded.files {
        line(String::new());
        let (points, faces) = (file.stated.points, file.stated.faces);
        let faces = if faces > 0 { format!(", {faces} faces") } else { String::new() };
        line(format!("file {}: {}, {} bytes, {points} points{faces}", file.path.display(), file.format, file.bytes));
        file.notes.iter().for_each(|note| line(format!("  {note}")));
    }
    out
}

/// `(x, y, z)` in few digits.
pub fn point_text(p: glam::DVec3) -> String {
    format!("({}, {}, {})", short(p.x), short(p.y), short(p.z))
}

fn bounds_json(bounds: Option<Bounds>) -> Value {
    bounds.map_or(Value::Null, |bounds| json!({ "min": bounds.min.to_array(), "max": bounds.max.to_array() }))
}

fn summary(loaded: &LoadedScene) -> Value {
    let scene = &loaded.scene;
    let leaves: Vec<Value> = (0..scene.leaves.len())
        .map(|index| {
            let (points, triangles) = match &loaded.geometry[index] {
                LeafGeometry::Cloud(cloud) => (Some(cloud.len()), None),
                LeafGeometry::Mesh(mesh) => (Some(mesh.positions.len()), Some(mesh.triangles.len())),
                LeafGeometry::Solid(_) => (None, None),
            };
            json!({
                "name": scene.leaves[index].name,
                "kind": kind_name(scene.leaves[index].kind),
                "geometry": loaded.geometry[index].name(),
                "points": points,
                "triangles": triangles,
                "bounds": bounds_json(loaded.bounds[index]),
                "same_as": loaded.canonical[index].0,
                "has_truth": loaded.truths[index].is_some(),
            })
        })
        .collect();
    let files: Vec<Value> = loaded
        .files
        .iter()
        .map(|file| {
            json!({
                "path": file.path.display().to_string(),
                "format": file.format.to_string(),
                "bytes": file.bytes,
                "points": file.stated.points,
                "faces": file.stated.faces,
                "notes": file.notes.iter().map(ToString::to_string).collect::<Vec<_>>(),
            })
        })
        .collect();
    let form = Form::of(loaded);
    json!({
        "surfcut": env!("CARGO_PKG_VERSION"),
        "expression": expression(loaded),
        "positive_form": {
            "leaves": form.leaves,
            "depth": form.depth,
            "ids": form.ids,
            "ids_reordered": form.ids_reordered,
        },
        "units": scene.units,
        "size": [scene.size.0, scene.size.1],
        "result_bounds": match loaded.extent() {
            Extent::Within(bounds) => bounds_json(Some(bounds)),
            Extent::Empty | Extent::Unbounded(_) => Value::Null,
        },
        "leaves": leaves,
        "files": files,
    })
}

#[cfg(test)]
mod tests {
    use super::short;

    #[test]
    fn numbers_are_short_and_true() {
        for (value, text) in [
            (0.0, "0"),
            (1.0, "1"),
            (-2.5, "-2.5"),
            (0.123456, "0.1235"),
            (1234.56, "1235"),
            (100.0, "100"),
            (1e-7, "1.000e-7"),
            (3.2e12, "3.200e12"),
        ] {
            assert_eq!(short(value), text);
        }
    }
}
