//! `surfcut check`: what will not work, before a long run.

use std::fmt::Write as _;

use glam::DVec3;
use serde_json::{Value, json};
use surfcut::classify::{ClassCounts, Model};
use surfcut::csg::LeafId;
use surfcut::pipeline::{self, Density, ExactLeaves};
use surfcut::scene::endless::Far;
use surfcut::scene::inspect::{CloudHealth, MeshHealth};
use surfcut::scene::load::SceneNote;
use surfcut::scene::{LeafGeometry, LeafKind, LoadedScene};
use surfcut::surfel::CloudNotes;

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
/// A surfel whose confidence is below this lies where neither its neighbours' fit nor their signs settle its normal.
const LOW_CONFIDENCE: f64 = 0.25;
/// Normals of a good scan are uncertain at its edges and specks only.
const MANY_UNCERTAIN: f64 = 0.05;
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

/// What became of a leaf's points on the way to surfels.
#[derive(Debug, Clone, Copy)]
struct OfCloud {
    notes: CloudNotes,
    /// Median confidence in the normals, 0 to 1, and the share of them below [`LOW_CONFIDENCE`].
    confidence: (f64, f64),
}

/// What the scene comes to as surfels.
struct AsSurfels {
    counts: ClassCounts,
    clouds: Vec<Option<OfCloud>>,
    /// Whether the result is certainly empty.
    is_empty: bool,
}

/// Loads the scene, inspects every leaf, and then the scene as a whole as the surfel pipeline would draw it.
pub fn run(args: &CheckArgs, session: &Session) -> anyhow::Result<u8> {
    let mut loaded = input::loaded(&args.scene, None, session.bars)?;
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
            Health::Cloud(health) => {
                let is_unoriented = loaded.is_unoriented[index];
                judge_cloud(health, is_solid, is_unoriented, loaded.far[index], &mut findings);
            }
            Health::Mesh(health) => judge_mesh(health, is_solid, &mut findings),
            Health::Exact => {}
        }
    }
    findings.leaf = None;
    judge_scene(&loaded, &health, &mut findings);
    // The points themselves go into the surfels: what is told about them is told first.
    let leaves = leaf_lines(&loaded, &health);
    let surfels = judge_as_surfels(&mut loaded, &health, session, &mut findings);
    let is_empty = surfels.as_ref().is_some_and(|surfels| surfels.is_empty);
    session.print(&format!("{leaves}{}", finding_lines(&findings.list)))?;
    let summary = summary(&loaded, &health, surfels.as_ref(), &findings.list);
    let mut summary = serde_json::to_string_pretty(&summary)?;
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

/// `count` with the words that go with one, or with many.
fn counted(count: usize, one: &str, many: &str) -> String {
    format!("{count} {}", if count == 1 { one } else { many })
}

fn percent(share: f64) -> String {
    format!("{} %", short(100.0 * share))
}

fn judge_cloud(health: &CloudHealth, is_solid: bool, is_unoriented: bool, far: Far, findings: &mut Findings) {
    let share = |count: usize| count as f64 / health.points.max(1) as f64;
    let spacing = health.spacing;
    // However few points it has, and with no other side.
    let is_half_space = far != Far::Nothing;
    if is_half_space {
        findings.note("its points lie in one plane: it stands for the half-space behind them", "");
    } else if health.points - health.duplicates.min(health.points) < FEWEST_POINTS {
        let what = match health.points - health.duplicates {
            1 => "only one point".to_owned(),
            n => format!("only {n} different points"),
        };
        findings.warn(what, "sample more densely: so few show disks rather than a surface");
    }
    if health.duplicates > 0 {
        let what = counted(health.duplicates, "point lies where another does", "points lie where others do");
        let mend = "they are drawn as one; remove them to save memory";
        if share(health.duplicates) > MANY_DUPLICATES { findings.warn(what, mend) } else { findings.note(what, mend) }
    }
    let (low, high) = health.spacing_range;
    if high > IRREGULAR * low {
        let what = format!("irregular sampling: the spacing is {} to {} (5 % to 95 %)", short(low), short(high));
        findings.note(what, "cuts are as fine as the coarser places allow");
    }
    if health.outliers > 0 {
        let what = format!("about {} far from all others", counted(health.outliers, "point lies", "points lie"));
        let mend = "remove them: they would be drawn as specks";
        if share(health.outliers) > MANY_OUTLIERS { findings.warn(what, mend) } else { findings.note(what, mend) }
    }
    let Some(normals) = health.normals else {
        let mend = "they are estimated and oriented; export them with the scan if the scanner knows them";
        findings.note("no normals", mend);
        return;
    };
    if normals.missing > 0 {
        findings.note(counted(normals.missing, "point has no normal", "points have no normal"), "theirs are estimated");
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
    if is_half_space {
        return;
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
        let what = format!("open: {} one triangle only", counted(health.boundary_edges, "edge has", "edges have"));
        if health.openness > OPEN {
            findings.warn(what, "declare it kind = \"sheet\", or close it: so wide an opening leaves no inside");
        } else {
            findings.warn(what, "its inside is decided by the winding number; close the holes to be certain");
        }
    }
    if health.non_manifold_edges > 0 {
        let what = format!("{} three triangles or more", counted(health.non_manifold_edges, "edge has", "edges have"));
        findings.warn(what, "its inside is decided by parity there; remove inner walls and fins to be certain");
    }
    if health.inconsistent_edges > 0 {
        let what = format!(
            "{} between triangles that face opposite sides",
            counted(health.inconsistent_edges, "edge lies", "edges lie")
        );
        findings.warn(what, "orient its faces consistently");
    }
    if health.flat_triangles > 0 {
        findings
            .note(counted(health.flat_triangles, "triangle has no area", "triangles have no area"), "they do no harm");
    }
}

fn judge_scene(loaded: &LoadedScene, health: &[Health], findings: &mut Findings) {
    for note in &loaded.notes {
        match note {
            // Whether they meet is asked of the surfels: boxes cannot tell for an open scan.
            SceneNote::CannotMeet | SceneNote::InsideOut { .. } => {} // told with the rest of the result, or of the mesh
            SceneNote::Unbounded => {
                findings.warn(note.to_string(), "intersect it with something bounded if it should be closed");
            }
            note if note.is_warning() => findings.warn(note.to_string(), ""),
            note => findings.note(note.to_string(), ""),
        }
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
    let sizes = sizes.filter(|(size, i)| *size > 0.0 && loaded.far[*i] == Far::Nothing);
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

/// Converts and classifies the scene as `render` would for its own camera, and looks at what comes of it. `None` where it
/// cannot be drawn, which is then a finding.
fn judge_as_surfels(
    loaded: &mut LoadedScene,
    health: &[Health],
    session: &Session,
    findings: &mut Findings,
) -> Option<AsSurfels> {
    let camera = match loaded.camera() {
        Ok(camera) => camera,
        Err(error) => {
            findings.warn(format!("the scene's camera cannot be used: {error}"), "");
            return None;
        }
    };
    let points = loaded.geometry.iter().map(|g| if let LeafGeometry::Cloud(c) = g { c.len() as u64 } else { 0 }).sum();
    let bar = session.bars.count(points, "surfels");
    let converted =
        pipeline::convert(loaded, &camera, Density::default(), ExactLeaves::Sampled, &|points| bar.inc(points));
    bar.finish_and_clear();
    let prepared = match converted {
        Ok(converted) => converted.classify(),
        Err(error) => {
            findings.warn(format!("the scene cannot be drawn: {error}"), "");
            return None;
        }
    };
    let of_cloud = |(index, notes): (usize, &Option<CloudNotes>)| {
        let confidence = confidence(&prepared.model.fields[index].cloud.confidence);
        notes.map(|notes| OfCloud { notes, confidence })
    };
    let clouds: Vec<Option<OfCloud>> = prepared.notes.iter().enumerate().map(of_cloud).collect();
    for (index, (of_cloud, health)) in clouds.iter().zip(health).enumerate() {
        findings.leaf = Some(loaded.scene.leaves[index].name.clone());
        if let (Some(of_cloud), Health::Cloud(health)) = (of_cloud, health) {
            judge_conversion(of_cloud, health, findings);
        }
    }
    findings.leaf = None;
    let is_empty = judge_result(&prepared.model, loaded, camera.eye, findings);
    Some(AsSurfels { counts: prepared.model.counts(), clouds, is_empty })
}

/// The median of `confidence`, 0 to 1, and the share of it below [`LOW_CONFIDENCE`].
fn confidence(confidence: &[u8]) -> (f64, f64) {
    let mut sorted = confidence.to_vec();
    sorted.sort_unstable();
    let least = (LOW_CONFIDENCE * f64::from(u8::MAX)).ceil() as u8;
    let low = sorted.partition_point(|&c| c < least);
    let median = sorted.get(sorted.len() / 2).map_or(1.0, |&c| f64::from(c) / f64::from(u8::MAX));
    (median, low as f64 / sorted.len().max(1) as f64)
}

fn judge_conversion(of_cloud: &OfCloud, health: &CloudHealth, findings: &mut Findings) {
    let OfCloud { notes, confidence: (median, low) } = of_cloud;
    if notes.estimated_normals > 0 {
        let what = format!(
            "{} normals are estimated, with a median confidence of {}; {} of the surfels are below {LOW_CONFIDENCE}",
            notes.estimated_normals,
            short(*median),
            percent(*low)
        );
        if *low > MANY_UNCERTAIN {
            findings.warn(what, "cuts are uncertain there: give the file normals, or clean and densify it");
        } else {
            findings.note(what, "");
        }
    }
    if notes.components > 1 {
        let what = format!("it falls into {} pieces, whose insides are told one by one", notes.components);
        findings.note(what, "where one comes out inside-out, give the file normals");
    }
    if notes.cavities > 0 {
        let what = counted(
            notes.cavities,
            "closed piece lies inside another and is taken for a cavity",
            "closed pieces lie inside others and are taken for cavities",
        );
        findings.note(what, "give the file normals if they are solid");
    }
    if notes.inward && !health.normals.is_some_and(|normals| normals.enclosed < INWARD) {
        findings.warn("its normals seem to look inwards", "turn them round, or write !leaf in the expression");
    }
    if notes.bad_radii > 0 {
        findings.note(
            format!(
                "{} no positive size",
                counted(notes.bad_radii, "radius of the file has", "radii of the file have")
            ),
            "theirs are estimated",
        );
    }
    if notes.isolated > 0 {
        let what =
            format!("{} in the air, off the surface about", counted(notes.isolated, "point hangs", "points hang"));
        findings.note(what, "their disks are made as small as those about them; remove them if they are noise");
    }
}

/// Whether the result is certainly empty; what else its surfels tell.
fn judge_result(model: &Model, loaded: &LoadedScene, eye: DVec3, findings: &mut Findings) -> bool {
    let counts = model.counts();
    let tree = loaded.canonical_tree();
    let mut found = Vec::new();
    let eye_inside = tree.eval(|leaf| model.fields[leaf.0 as usize].contains(eye, &mut found));
    if counts.surface + counts.edge() == 0 {
        // Without a surface it is nothing or everything, and any point tells which.
        if eye_inside {
            findings.warn("the result is all of space: it has no surface", "look at the complements");
            return false;
        }
        let what = if loaded.notes.contains(&SceneNote::CannotMeet) {
            SceneNote::CannotMeet.to_string()
        } else {
            "the result is empty: nothing of any leaf's surface is left".to_owned()
        };
        findings.warn(what, "look at the expression, the transforms and which leaves are inside-out");
        return true;
    }
    if counts.surface + counts.inside_edge == 0 {
        let what = "every surfel lies off the result: it is empty, or thinner than the surfels are wide";
        findings.warn(what, "draw it and look; sample more densely if something should be there");
    }
    if eye_inside {
        let what = "the camera's eye is inside the result: all that is seen of it is from within";
        findings.warn(what, "move the eye out of it");
    }
    false
}

fn leaf_lines(loaded: &LoadedScene, health: &[Health]) -> String {
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
    out
}

fn finding_lines(findings: &[Finding]) -> String {
    let mut out = String::new();
    for finding in findings {
        let leaf = finding.leaf.as_ref().map(|leaf| format!("`{leaf}`: ")).unwrap_or_default();
        let mend = if finding.mend.is_empty() { String::new() } else { format!("; {}", finding.mend) };
        let _ = writeln!(out, "{}: {leaf}{}{mend}", finding.severity.name(), finding.what);
    }
    let warnings = findings.iter().filter(|finding| finding.severity == Severity::Warning).count();
    let _ = match warnings {
        0 if findings.is_empty() => writeln!(out, "nothing is amiss"),
        0 => writeln!(out, "no warnings"),
        1 => writeln!(out, "1 warning"),
        n => writeln!(out, "{n} warnings"),
    };
    out
}

fn summary(loaded: &LoadedScene, health: &[Health], surfels: Option<&AsSurfels>, findings: &[Finding]) -> Value {
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
            let of_cloud = surfels.and_then(|surfels| surfels.clouds[index]).map(|of_cloud| {
                let OfCloud { notes, confidence } = of_cloud;
                json!({
                    "estimated_normals": notes.estimated_normals,
                    "median_confidence": confidence.0,
                    "low_confidence": confidence.1,
                    "components": notes.components,
                    "cavities": notes.cavities,
                    "bad_radii": notes.bad_radii,
                    "isolated": notes.isolated,
                    "inward": notes.inward,
                })
            });
            json!({
                "name": loaded.scene.leaves[index].name,
                "geometry": loaded.geometry[index].name(),
                "health": detail,
                "conversion": of_cloud,
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
        "is_empty": surfels.is_some_and(|surfels| surfels.is_empty),
        "surfels": surfels.map(|surfels| json!({
            "surface": surfels.counts.surface,
            "inside_edge": surfels.counts.inside_edge,
            "outside_edge": surfels.counts.outside_edge,
            "outside": surfels.counts.outside,
        })),
        "leaves": leaves,
        "findings": findings,
    })
}
