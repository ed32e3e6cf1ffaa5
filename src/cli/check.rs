//! `surfcut check`: what will not work, before a long run.

use std::fmt::Write as _;

use serde_json::{Value, json};
use surfcut::csg::LeafId;
use surfcut::scene::framing::Extent;
use surfcut::scene::inspect::{CloudHealth, MeshHealth};
use surfcut::scene::load::SceneNote;
use surfcut::scene::{LeafGeometry, LeafKind, LoadedScene};

use super::args::CheckArgs;
use super::failure::code;
use super::info::{content, short};
use super::{Session, input};

/// Scans with fewer points than this show disks rather than a surface.
const FEWEST_POINTS: usize = 50;
/// A surface that is closed up to noise and small holes has less of its area open than this.
const OPEN: f64 = 0.15;
/// Normals of a good scan point against most of their neighbours only at sharp edges.
const AGAINST_NEIGHBOURS: f64 = 0.02;
/// Below this the normals look inwards, beyond what concave shapes and gaps explain.
const INWARD: f64 = -0.05;
/// Duplicates beyond this share are no accident of one scanner position.
const MANY_DUPLICATES: f64 = 0.1;
/// Outliers beyond this share show as specks.
const MANY_OUTLIERS: f64 = 1e-3;
/// Spacing that varies by more than this factor (5 % to 95 %) is irregular.
const IRREGULAR: f64 = 4.0;
/// Scans whose spacings differ by more than this factor cut each other coarsely.
const DENSITY_CONTRAST: f64 = 30.0;
/// Leaves whose sizes differ by more than this factor are in different units, mostly.
const SIZE_CONTRAST: f64 = 300.0;

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Severity {
    Note,
    Warning,
}

impl Severity {
    fn name(self) -> &'static str {
        match self {
            Self::Note => "note",
            Self::Warning => "warning",
        }
    }
}

/// One thing to know, and what would mend it.
#[derive(Debug, Clone)]
struct Finding {
    severity: Severity,
    leaf: Option<String>,
    what: String,
    mend: String,
}

/// Findings as they are gathered, for one leaf or for the scene.
#[derive(Debug, Default)]
struct Findings {
    list: Vec<Finding>,
    leaf: Option<String>,
}

impl Findings {
    fn note(&mut self, what: impl Into<String>, mend: impl Into<String>) {
        self.push(Severity::Note, what, mend);
    }

    fn warn(&mut self, what: impl Into<String>, mend: impl Into<String>) {
        self.push(Severity::Warning, what, mend);
    }

    fn push(&mut self, severity: Severity, what: impl Into<String>, mend: impl Into<String>) {
        self.list.push(Finding { severity, leaf: self.leaf.clone(), what: what.into(), mend: mend.into() });
    }
}

/// What inspection found of a leaf.
#[derive(Debug, Clone, Copy)]
enum Health {
    Cloud(CloudHealth),
    Mesh(MeshHealth),
    Exact,
}

/// Loads the scene, inspects every leaf and the scene as a whole.
pub fn run(args: &CheckArgs, session: &Session) -> anyhow::Result<u8> {
    let loaded = input::loaded(&args.scene, None, session.bars)?;
    let bar = session.bars.count(loaded.geometry.len() as u64, "inspecting");
    let health: Vec<Health> = (0..loaded.geometry.len())
        .map(|index| {
            let health = inspect(&loaded, index);
            bar.inc(1);
            health
        })
        .collect();
    bar.finish_and_clear();
    let mut findings = Findings::default();
    for (index, health) in health.iter().enumerate() {
        findings.leaf = Some(loaded.scene.leaves[index].name.clone());
        let is_solid = loaded.scene.leaves[index].kind == LeafKind::Solid;
        match health {
            Health::Cloud(health) => judge_cloud(health, is_solid, loaded.is_unoriented[index], &mut findings),
            Health::Mesh(health) => judge_mesh(health, is_solid, &mut findings),
            Health::Exact => {}
        }
    }
    findings.leaf = None;
    judge_scene(&loaded, &health, &mut findings);
    let is_empty = loaded.notes.contains(&SceneNote::CannotMeet);
    session.print(&text(&loaded, &health, &findings.list))?;
    let mut summary = serde_json::to_string_pretty(&summary(&loaded, &health, &findings.list))?;
    summary.push('\n');
    session.write_summary(&summary)?;
    let worst = findings.list.iter().map(|finding| finding.severity).max();
    Ok(match worst {
        _ if is_empty => code::EMPTY,
        Some(Severity::Warning) => code::FINDINGS,
        Some(Severity::Note) | None => code::OK,
    })
}

fn inspect(loaded: &LoadedScene, index: usize) -> Health {
    match &loaded.geometry[index] {
        LeafGeometry::Cloud(cloud) => {
            Health::Cloud(CloudHealth::of(cloud, &loaded.scene.leaves[index].world_from_leaf))
        }
        LeafGeometry::Mesh(mesh) => Health::Mesh(MeshHealth::of(mesh)),
        LeafGeometry::Solid(_) => Health::Exact,
    }
}

fn percent(share: f64) -> String {
    format!("{} %", short(100.0 * share))
}

fn judge_cloud(health: &CloudHealth, is_solid: bool, is_unoriented: bool, findings: &mut Findings) {
    let share = |count: usize| count as f64 / health.points.max(1) as f64;
    let spacing = health.spacing;
    if health.points - health.duplicates.min(health.points) < FEWEST_POINTS {
        let what = format!("only {} different points", health.points - health.duplicates);
        findings.warn(what, "sample more densely: so few show disks rather than a surface");
    }
    if health.duplicates > 0 {
        let what = format!("{} points lie where another does", health.duplicates);
        let mend = "they are drawn as one; remove them to save memory";
        if share(health.duplicates) > MANY_DUPLICATES { findings.warn(what, mend) } else { findings.note(what, mend) }
    }
    let (low, high) = health.spacing_range;
    if high > IRREGULAR * low {
        let what = format!("irregular sampling: the spacing is {} to {} (5 % to 95 %)", short(low), short(high));
        findings.note(what, "cuts are as fine as the coarser places allow");
    }
    if health.outliers > 0 {
        let what = format!("about {} points lie far from all others", health.outliers);
        let mend = "remove them: they would be drawn as specks";
        if share(health.outliers) > MANY_OUTLIERS { findings.warn(what, mend) } else { findings.note(what, mend) }
    }
    let Some(normals) = health.normals else {
        let mend = "they are estimated and oriented; export them with the scan if the scanner knows them";
        findings.note("no normals", mend);
        return;
    };
    if normals.missing > 0 {
        findings.note(format!("{} points have no normal", normals.missing), "theirs are estimated");
    }
    if is_unoriented && is_solid {
        findings.warn(
            "the normals may point inwards or outwards",
            "orient them, or declare the leaf kind = \"sheet\": it has no inside of its own",
        );
    }
    if normals.against_neighbours > AGAINST_NEIGHBOURS {
        let what = format!("{} of the normals point against their neighbours'", percent(normals.against_neighbours));
        findings.warn(what, "orient the normals consistently, or remove them so that they are estimated");
    }
    if is_solid && normals.openness > OPEN {
        let what = format!("an open surface: {} of its area has no other side", percent(normals.openness));
        let mend = "declare it kind = \"sheet\" unless it cuts something; what it cuts beyond its border is a guess";
        findings.warn(what, mend);
    } else if is_solid && normals.enclosed < INWARD {
        findings.warn("inside-out: the normals look inwards", "turn them round, or write !leaf in the expression");
    }
    if !(spacing > 0.0) && health.points > 1 {
        findings.warn("all points are in one place", "check the file's columns and scale");
    }
}

fn judge_mesh(health: &MeshHealth, is_solid: bool, findings: &mut Findings) {
    if health.is_inside_out() && is_solid {
        let what = format!("inside-out: its signed volume is {}", short(health.signed_volume));
        findings.warn(what, "turn its faces over, or write !leaf in the expression");
    }
    if health.boundary_edges > 0 && is_solid {
        let what = format!("open: {} edges have one triangle only", health.boundary_edges);
        if health.openness > OPEN {
            findings.warn(what, "declare it kind = \"sheet\", or close it: so wide an opening leaves no inside");
        } else {
            findings.warn(what, "its inside is decided by the winding number; close the holes to be certain");
        }
    }
    if health.non_manifold_edges > 0 {
        let what = format!("{} edges have three triangles or more", health.non_manifold_edges);
        findings.warn(what, "its inside is decided by parity there; remove inner walls and fins to be certain");
    }
    if health.inconsistent_edges > 0 {
        let what = format!("{} edges lie between triangles that face opposite sides", health.inconsistent_edges);
        findings.warn(what, "orient its faces consistently");
    }
    if health.flat_triangles > 0 {
        findings.note(format!("{} triangles have no area", health.flat_triangles), "they do no harm");
    }
}

fn judge_scene(loaded: &LoadedScene, health: &[Health], findings: &mut Findings) {
    for note in loaded.notes.iter().filter(|note| note.is_warning()) {
        findings.warn(note.to_string(), "");
    }
    let name = |index: usize| loaded.scene.leaves[index].name.as_str();
    // What is cut away must meet what it is cut from.
    let positive = loaded.scene.tree.positive();
    let used_as = |negated: bool| {
        let mut leaves: Vec<LeafId> =
            positive.literals().filter(|literal| literal.negated == negated).map(|literal| literal.leaf).collect();
        leaves.sort_unstable();
        leaves.dedup();
        leaves
    };
    let (kept, cutters) = (used_as(false), used_as(true));
    for cutter in &cutters {
        let Some(bounds) = loaded.bounds[cutter.0 as usize] else { continue };
        let meets =
            |leaf: &LeafId| loaded.bounds[leaf.0 as usize].is_none_or(|other| bounds.intersection(other).is_some());
        if !kept.is_empty() && !kept.iter().any(meets) {
            let what =
                format!("`{}` cuts nothing: it does not reach what it is subtracted from", name(cutter.0 as usize));
            findings.warn(what, "check its transform and units");
        }
    }
    // Sizes and spacings, each with its leaf.
    let sizes = loaded.bounds.iter().enumerate().filter_map(|(i, bounds)| Some((bounds.as_ref()?.diagonal(), i)));
    let by_value = |a: &(f64, usize), b: &(f64, usize)| a.0.total_cmp(&b.0);
    let (least, most) = (sizes.clone().min_by(by_value), sizes.max_by(by_value));
    if let (Some((least, a)), Some((most, b))) = (least, most)
        && most > SIZE_CONTRAST * least
    {
        let what = format!("`{}` is {} times larger than `{}`", name(b), short(most / least), name(a));
        findings.warn(what, "if they are in different units, give one a scale");
    }
    let spacings: Vec<(f64, usize)> = health
        .iter()
        .enumerate()
        .filter_map(|(i, health)| if let Health::Cloud(health) = health { Some((health.spacing, i)) } else { None })
        .filter(|(spacing, _)| *spacing > 0.0)
        .collect();
    let coarsest = spacings.iter().copied().max_by(by_value);
    let finest = spacings.iter().copied().min_by(by_value);
    if let (Some((coarse, a)), Some((fine, b))) = (coarsest, finest)
        && coarse > DENSITY_CONTRAST * fine
    {
        let what = format!("`{}` is sampled {} times more coarsely than `{}`", name(a), short(coarse / fine), name(b));
        findings.note(what, "keep --unknown resolved; --unknown paper fails where densities differ so much");
    }
    if let Some((coarse, scan)) = coarsest {
        for (index, geometry) in loaded.geometry.iter().enumerate() {
            let (LeafGeometry::Solid(_), Some(bounds)) = (geometry, loaded.bounds[index]) else { continue };
            let thinnest = (bounds.max - bounds.min).min_element();
            if thinnest < 2.0 * coarse {
                let what = format!(
                    "`{}` is {} thin, finer than the spacing {} of `{}`",
                    name(index),
                    short(thinnest),
                    short(coarse),
                    name(scan)
                );
                findings.warn(what, "the scan does not hold such detail; check the units");
            }
        }
    }
    for index in 0..loaded.geometry.len() {
        if matches!(loaded.geometry[index], LeafGeometry::Cloud(_)) && loaded.truths[index].is_none() {
            let what = format!("`{}` has no truth", name(index));
            findings
                .note(what, "--pipeline reference and compare need one: a mesh or a solid that it was sampled from");
        }
    }
}

fn text(loaded: &LoadedScene, health: &[Health], findings: &[Finding]) -> String {
    let mut out = String::new();
    for (index, leaf) in loaded.scene.leaves.iter().enumerate() {
        let detail = match &health[index] {
            Health::Cloud(health) => format!("; spacing {}", short(health.spacing)),
            Health::Mesh(health) if health.is_closed() => {
                format!("; closed, volume {}", short(health.signed_volume))
            }
            Health::Mesh(_) => "; not closed".into(),
            Health::Exact => String::new(),
        };
        let geometry = &loaded.geometry[index];
        // Writing to a string cannot fail.
        let _ = writeln!(out, "leaf {}: {}, {}{detail}", leaf.name, geometry.name(), content(geometry));
    }
    for finding in findings {
        let leaf = finding.leaf.as_ref().map(|leaf| format!("`{leaf}`: ")).unwrap_or_default();
        let mend = if finding.mend.is_empty() { String::new() } else { format!("; {}", finding.mend) };
        let _ = writeln!(out, "{}: {leaf}{}{mend}", finding.severity.name(), finding.what);
    }
    let warnings = findings.iter().filter(|finding| finding.severity == Severity::Warning).count();
    let _ = match warnings {
        0 => writeln!(out, "nothing is amiss"),
        1 => writeln!(out, "1 warning"),
        n => writeln!(out, "{n} warnings"),
    };
    out
}

fn summary(loaded: &LoadedScene, health: &[Health], findings: &[Finding]) -> Value {
    let leaves: Vec<Value> = health
        .iter()
        .enumerate()
        .map(|(index, health)| {
            let detail = match health {
                Health::Cloud(health) => json!({
                    "points": health.points,
                    "duplicates": health.duplicates,
                    "outliers": health.outliers,
                    "spacing": health.spacing,
                    "spacing_5_percent": health.spacing_range.0,
                    "spacing_95_percent": health.spacing_range.1,
                    "normals": health.normals.map(|normals| json!({
                        "missing": normals.missing,
                        "against_neighbours": normals.against_neighbours,
                        "enclosed": normals.enclosed,
                        "openness": normals.openness,
                    })),
                }),
                Health::Mesh(health) => json!({
                    "vertices": health.vertices,
                    "triangles": health.triangles,
                    "is_closed": health.is_closed(),
                    "is_inside_out": health.is_inside_out(),
                    "boundary_edges": health.boundary_edges,
                    "non_manifold_edges": health.non_manifold_edges,
                    "inconsistent_edges": health.inconsistent_edges,
                    "flat_triangles": health.flat_triangles,
                    "signed_volume": health.signed_volume,
                    "area": health.area,
                    "openness": health.openness,
                }),
                Health::Exact => Value::Null,
            };
            json!({
                "name": loaded.scene.leaves[index].name,
                "geometry": loaded.geometry[index].name(),
                "health": detail,
            })
        })
        .collect();
    let findings: Vec<Value> = findings
        .iter()
        .map(|finding| {
            json!({
                "severity": finding.severity.name(),
                "leaf": finding.leaf,
                "what": finding.what,
                "mend": finding.mend,
            })
        })
        .collect();
    json!({
        "surfcut": env!("CARGO_PKG_VERSION"),
        "is_empty": loaded.extent() == Extent::Empty,
        "leaves": leaves,
        "findings": findings,
    })
}
