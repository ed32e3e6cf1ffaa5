//! Scenes as TOML files.
//!
//! ```toml
//! csg = "femur - (drill | ball)"     # needless where there is one leaf
//! size = [1024, 768]
//! background = "ivory"               # or "transparent", "#rrggbb", [r, g, b]
//! units = "mm"
//!
//! [leaf.femur]
//! file = "femur.ply"                 # relative to the scene file
//! rotate = [0, 0, 30]                # degrees about x, then y, then z; or { axis = [..], angle = .. }
//! translate = [0, 0, 4.5]            # after scale and rotate
//!
//! [leaf.drill]
//! cylinder = { from = [0, 0, -5], to = [0, 0, 5], radius = 0.8 }
//! colour = "#c05030"
//!
//! [leaf.ball]
//! sphere = { centre = [1, 0, 0], radius = 0.5 }
//!
//! [leaf.cut]                         # a section: cuts the result, as `- cut` would, and its face is hatched
//! half_space = { point = [0, 0, 0], normal = [0, 1, 0] }
//! section = true
//!
//! [camera]                           # needless: without it the scene is framed
//! eye = [8, -8, 5]
//! target = [0, 0, 0]
//! fov_y = 35                         # or height = 12, which is orthographic
//!
//! [style]                            # needless: without it the result is shaded
//! kind = "blueprint"
//! line_width = 1.5
//!
//! [[keyframe]]                       # needless: for --animate; two or more
//! time = 0                           # seconds; or frame = 0
//!
//! [[keyframe]]
//! time = 2.5
//! camera = { eye = [0, -11, 5] }     # what is not named goes on its way, or stays
//! leaf.drill = { translate = [0, 0, 3], rotate = [0, 0, 90] }
//! ```
//!
//! Every mistake is an error with its line and column, and says what would mend it.

use std::io::Read;
use std::path::{Path, PathBuf};

use glam::{DAffine3, DMat3, DMat4, DQuat, DVec3};
use toml::de::DeTable;

use super::animation::Placement;
use super::inline_solid::{self, SOLID_KEYS, SolidError};
use super::keyframes;
use super::nearest_name::nearest_name;
use super::style_toml;
use super::toml_values::{Field, Source, Table};
use super::{
    CameraSpec, DEFAULT_SIZE, Leaf, LeafKind, LeafSource, Light, Representation, Scene, Section, Truth, colour,
};
use crate::csg::expression::{self, ExpressionError};
use crate::csg::{LeafId, Tree};
use crate::space::{Camera, CameraError, Lens};

/// A place in a text: line and column from 1, columns in characters.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Place {
    /// Line, from 1.
    pub line: usize,
    /// Character within the line, from 1.
    pub column: usize,
}

impl Place {
    /// The place of byte offset `byte` of `text`; past the end, the end.
    pub fn of_byte(text: &str, byte: usize) -> Self {
        let mut end = byte.min(text.len());
        while !text.is_char_boundary(end) {
            end -= 1;
        }
        let before = &text[..end];
        let line_start = before.rfind('\n').map_or(0, |newline| newline + 1);
        Self {
            line: before.bytes().filter(|b| *b == b'\n').count() + 1,
            column: before[line_start..].chars().count() + 1,
        }
    }
}

/// Why a scene cannot be used, and where.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("line {}, column {}: {problem}", place.line, place.column)]
pub struct SceneError {
    /// Where in the scene file.
    pub place: Place,
    /// What is wrong there.
    pub problem: SceneProblem,
}

/// What can be wrong with a scene.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SceneProblem {
    /// The file is not TOML.
    #[error("this is not valid TOML: {0}")]
    Syntax(String),
    /// A key that means nothing here.
    #[error("unknown key `{key}` in {table}{}; known here: {}", did_you_mean(suggestion), known.join(", "))]
    UnknownKey {
        /// As written.
        key: String,
        /// Where it stands.
        table: String,
        /// The nearest known key.
        suggestion: Option<String>,
        /// The keys that may stand there.
        known: Vec<String>,
    },
    /// A key that must be given.
    #[error("{table} lacks `{key}`: add `{key} = {form}`")]
    MissingKey {
        /// What lacks it.
        table: String,
        /// The key.
        key: String,
        /// What to write.
        form: String,
    },
    /// A value of another type than it must have.
    #[error("`{key}` is {found}: write {wanted}")]
    WrongType {
        /// Whose value.
        key: String,
        /// What to write.
        wanted: String,
        /// What stands there.
        found: &'static str,
    },
    /// A value that cannot be used.
    #[error("`{key}`: {problem}; {mend}")]
    BadValue {
        /// Whose value.
        key: String,
        /// Why not.
        problem: String,
        /// What to write.
        mend: String,
    },
    /// Two keys that exclude each other.
    #[error("`{first}` and `{second}` cannot stand together: remove one")]
    Clash {
        /// One key.
        first: String,
        /// The other.
        second: String,
    },
    /// A leaf without geometry.
    #[error("leaf `{leaf}` has no geometry: add `file = \"…\"` or one of {kinds}", kinds = SOLID_KEYS.join(", "))]
    NoGeometry {
        /// Its name.
        leaf: String,
    },
    /// A solid that does not exist, such as a sphere with a negative radius.
    #[error("`{key}`: {error}")]
    Solid {
        /// Its key.
        key: String,
        /// What is wrong with it.
        error: SolidError,
    },
    /// A scene without leaves.
    #[error("the scene has no leaf: add a table such as `[leaf.body]` with `file = \"body.ply\"`")]
    NoLeaves,
    /// Several leaves and no expression.
    #[error(
        "the scene has {} leaves and no `csg`: say how they combine, such as `csg = \"{}\"`",
        leaves.len(),
        leaves.join(" | ")
    )]
    NoExpression {
        /// The leaves' names as expressions write them.
        leaves: Vec<String>,
    },
    /// The expression names a leaf that the scene lacks.
    #[error("unknown leaf `{name}`{}; the scene's leaves: {}", did_you_mean(suggestion), known.join(", "))]
    UnknownLeaf {
        /// As written.
        name: String,
        /// The nearest leaf.
        suggestion: Option<String>,
        /// The scene's leaves.
        known: Vec<String>,
    },
    /// The expression is not well formed.
    #[error("`csg`: {0}")]
    Expression(ExpressionError),
    /// A sheet is subtracted or complemented.
    #[error(
        "`{leaf}` is a sheet (an open surface), so it has no inside to subtract or complement: cut it instead, as in \
         `{leaf} - other`, or declare it `kind = \"solid\"`"
    )]
    SheetCuts {
        /// The sheet's name.
        leaf: String,
    },
    /// No picture can be taken.
    #[error("{0}")]
    Camera(CameraError),
}

/// Why a scene file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ReadSceneError {
    /// The system failed to hand over the file.
    #[error("{}: cannot be read: {source}; check the name and the permissions", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// The file is no text, or far larger than a scene.
    #[error("{}: this is no scene file: {what}; scenes are TOML text, see `surfcut render --help`", path.display())]
    NotAScene {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        what: &'static str,
    },
    /// The scene has a mistake.
    #[error("{}:{}:{}: {}", path.display(), error.place.line, error.place.column, error.problem)]
    Scene {
        /// The file.
        path: PathBuf,
        /// The mistake.
        error: Box<SceneError>,
        /// The line with the mistake.
        line: String,
    },
}

/// The scene in the file at `path`; relative paths in it are taken from the file's directory. Reads no other file.
///
/// # Errors
/// [`ReadSceneError`] names the file, and the line and column where there is one.
pub fn read(path: &Path) -> Result<Scene, ReadSceneError> {
    /// An expression of a million leaves takes some ten megabytes.
    const LARGEST: u64 = 256 << 20;
    let io_error = |source| ReadSceneError::Io { path: path.to_owned(), source };
    let not_a_scene = |what| ReadSceneError::NotAScene { path: path.to_owned(), what };
    let mut bytes = Vec::new();
    let file = std::fs::File::open(path).map_err(io_error)?;
    file.take(LARGEST + 1).read_to_end(&mut bytes).map_err(io_error)?;
    if bytes.len() as u64 > LARGEST {
        return Err(not_a_scene("it is larger than 256 MiB"));
    }
    let text = String::from_utf8(bytes).map_err(|_| not_a_scene("it is not UTF-8 text"))?;
    let base_dir = path.parent().unwrap_or(Path::new(""));
    parse(&text, base_dir).map_err(|error| {
        let line = text.lines().nth(error.place.line - 1).unwrap_or_default();
        let line = line.strip_prefix('\u{feff}').unwrap_or(line).to_owned();
        ReadSceneError::Scene { path: path.to_owned(), error: Box::new(error), line }
    })
}

fn did_you_mean(suggestion: &Option<String>) -> String {
    suggestion.as_ref().map(|name| format!(" (did you mean `{name}`?)")).unwrap_or_default()
}

/// The scene that `text` describes. Relative paths in it are taken from `base_dir`. Reads no file.
///
/// # Errors
/// [`SceneError`]: the first mistake, with its line and column.
pub fn parse(text: &str, base_dir: &Path) -> Result<Scene, SceneError> {
    // An editor's byte order mark is no mistake of the user's; without it, columns count as the editor shows them.
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let source = Source { text };
    let document = DeTable::parse(text).map_err(|error| {
        let byte = error.span().map_or(0, |span| span.start);
        source.error(byte, SceneProblem::Syntax(error.message().to_owned()))
    })?;
    let top = Table::open(
        source,
        "the top level",
        0..text.len(),
        document.get_ref(),
        &["csg", "leaf", "size", "background", "units", "camera", "light", "style", "keyframe"],
    )?;
    let mut leaves = Vec::new();
    let mut placements = Vec::new();
    if let Some(field) = top.get("leaf")? {
        for (name, entry) in field.named_entries("tables such as `[leaf.body]`, one for each leaf")? {
            let (leaf, placement) = parse_leaf(name, &entry, base_dir)?;
            leaves.push(leaf);
            placements.push(placement);
        }
    }
    if leaves.is_empty() {
        return Err(top.error(SceneProblem::NoLeaves));
    }
    let tree = parse_tree(&top, &leaves)?;
    let size = match top.get("size")? {
        Some(field) => parse_size(&field)?,
        None => DEFAULT_SIZE,
    };
    let camera = match top.get("camera")? {
        Some(field) => Some(parse_camera(&field, size)?),
        None => None,
    };
    let mut scene = Scene::new(leaves, tree);
    scene.size = size;
    scene.camera = camera;
    if let Some(field) = top.get("background")? {
        scene.background = Some(parse_background(&field)?);
    }
    if let Some(field) = top.get("light")? {
        scene.light = parse_light(&field)?;
    }
    if let Some(field) = top.get("style")? {
        scene.style = style_toml::parse(&field)?;
    }
    if let Some(field) = top.get("units")? {
        scene.units = Some(field.text("the name of a unit, such as \"mm\"")?.to_owned());
    }
    if let Some(field) = top.get("keyframe")? {
        scene.animation = Some(keyframes::parse(&field, &scene.leaves, &placements)?);
    }
    if let (Some(sheet), Some(field)) = (scene.subtracted_sheet(), top.get("csg")?) {
        return Err(field.error(SceneProblem::SheetCuts { leaf: scene.leaves[sheet.0 as usize].name.clone() }));
    }
    Ok(scene)
}

/// The keys of a leaf beside its solid's.
const LEAF_KEYS: [&str; 14] = [
    "file",
    "translate",
    "rotate",
    "scale",
    "matrix",
    "colour|color",
    "opacity",
    "kind",
    "truth",
    "spacing",
    "represent",
    "section",
    "hatch_spacing",
    "name", // only to say that the name is in the table's header
];

/// A leaf, and what its transform is made of; `None` where that is a matrix.
fn parse_leaf(name: &str, entry: &Field, base_dir: &Path) -> Result<(Leaf, Option<Placement>), SceneError> {
    let known: Vec<&str> = LEAF_KEYS.iter().chain(&SOLID_KEYS).copied().collect();
    let table = entry.table(
        format!("[leaf.{}]", quoted(name)),
        &known,
        "a table with `file = \"…\"` or a solid, its geometry",
    )?;
    if name.is_empty() {
        return Err(entry.bad("a leaf's name is empty", "name it, as in `[leaf.body]`"));
    }
    if let Some(field) = table.get("name")? {
        return Err(field.bad("a leaf is named by its table's header", format!("write `[leaf.{}]`", quoted(name))));
    }
    let mut geometry = None;
    for key in std::iter::once("file").chain(SOLID_KEYS) {
        let Some(field) = table.get(key)? else { continue };
        if let Some(first) = &geometry {
            let first: &Field = first;
            return Err(field.error(SceneProblem::Clash { first: first.name.clone(), second: field.name.clone() }));
        }
        geometry = Some(field);
    }
    let geometry = geometry.ok_or_else(|| table.error(SceneProblem::NoGeometry { leaf: name.to_owned() }))?;
    let source = if geometry.name == "file" {
        LeafSource::File(base_dir.join(file_name(&geometry)?))
    } else {
        LeafSource::Solid(inline_solid::from_toml(&geometry)?)
    };
    let mut leaf = Leaf::new(name, source);
    let placement;
    (leaf.world_from_leaf, placement) = parse_transform(&table)?;
    leaf.colour = table.get("colour|color")?.map(|field| field.colour()).transpose()?;
    leaf.opacity = table.get("opacity")?.map_or(Ok(1.0), |field| field.share())?;
    leaf.spacing = table.get("spacing")?.map(|field| field.positive()).transpose()?;
    if let Some(field) = table.get("represent")? {
        const WANTED: &str = "\"surfels\", \"mesh\" or \"exact\"";
        let text = field.text(WANTED)?;
        let choice = Representation::from_name(text);
        leaf.represent = Some(
            choice.ok_or_else(|| field.bad(format!("\"{text}\" is no representation"), format!("write {WANTED}")))?,
        );
    }
    if let Some(field) = table.get("kind")? {
        leaf.kind = match field.text("\"solid\" or \"sheet\"")? {
            "solid" => LeafKind::Solid,
            "sheet" => LeafKind::Sheet,
            other => return Err(field.bad(format!("\"{other}\" is no kind"), "write \"solid\" or \"sheet\"")),
        };
    }
    if let Some(field) = table.get("truth")? {
        leaf.truth = Some(parse_truth(&field, base_dir)?);
    }
    leaf.section = parse_section(&table, &geometry)?;
    Ok((leaf, placement))
}

/// Where `section` is true; `geometry` is the leaf's.
fn parse_section(table: &Table, geometry: &Field) -> Result<Option<Section>, SceneError> {
    let spacing = table.get("hatch_spacing")?;
    match table.get("section")? {
        Some(field) if field.flag()? => {
            if geometry.name != "half_space" {
                return Err(field.bad("only a half-space is a section", "give the leaf a `half_space`, or remove it"));
            }
            Ok(Some(Section { hatch_spacing: spacing.map(|spacing| spacing.positive()).transpose()? }))
        }
        _ => match spacing {
            Some(spacing) => Err(spacing.bad("the leaf is no section", "add `section = true`, or remove it")),
            None => Ok(None),
        },
    }
}

fn file_name<'t>(field: &Field<'t>) -> Result<&'t str, SceneError> {
    let name = field.text("a file's path, such as \"scan.ply\"")?;
    if name.is_empty() { Err(field.bad("the path is empty", "name a file, such as \"scan.ply\"")) } else { Ok(name) }
}

fn parse_truth(field: &Field, base_dir: &Path) -> Result<Truth, SceneError> {
    if field.is_text() {
        return Ok(Truth::File(base_dir.join(file_name(field)?)));
    }
    let table = field.table("`truth`", &SOLID_KEYS, "a mesh file or a solid, such as { sphere = { … } }")?;
    let mut solid: Option<(Field, _)> = None;
    for key in SOLID_KEYS {
        let Some(inner) = table.get(key)? else { continue };
        if let Some((first, _)) = &solid {
            return Err(inner.error(SceneProblem::Clash { first: first.name.clone(), second: inner.name.clone() }));
        }
        let value = inline_solid::from_toml(&inner)?;
        solid = Some((inner, value));
    }
    let (_, solid) = solid.ok_or_else(|| field.bad("it names no solid", "write { sphere = { … } } or a mesh file"))?;
    Ok(Truth::Solid(solid))
}

/// `translate · rotate · scale`, or `matrix` alone.
fn parse_transform(table: &Table) -> Result<(DAffine3, Option<Placement>), SceneError> {
    let parts = [table.get("translate")?, table.get("rotate")?, table.get("scale")?];
    if let Some(matrix) = table.get("matrix")? {
        if let Some(part) = parts.into_iter().flatten().next() {
            return Err(matrix.error(SceneProblem::Clash { first: matrix.name.clone(), second: part.name }));
        }
        return Ok((parse_matrix(&matrix)?, None));
    }
    let [translate, rotate, scale] = parts;
    let placement = Placement {
        translate: translate.map_or(Ok(DVec3::ZERO), |field| field.vector())?,
        rotate: rotate.map_or(Ok(DQuat::IDENTITY), |field| parse_rotate(&field))?,
        scale: scale.map_or(Ok(DVec3::ONE), |field| parse_scale(&field))?,
    };
    Ok((placement.world_from_leaf(), Some(placement)))
}

pub(super) fn parse_scale(field: &Field) -> Result<DVec3, SceneError> {
    let scale = if field.is_number() { DVec3::splat(field.number()?) } else { field.vector()? };
    // A subnormal factor has no reciprocal.
    if !scale.to_array().iter().all(|s| s.is_normal()) {
        return Err(field.bad("a factor is 0, which leaves nothing", "use factors other than 0"));
    }
    Ok(scale)
}

pub(super) fn parse_rotate(field: &Field) -> Result<DQuat, SceneError> {
    if field.is_list() {
        let [x, y, z] = field.numbers::<3>("[x, y, z] in degrees")?.map(f64::to_radians);
        return Ok(DQuat::from_rotation_z(z) * DQuat::from_rotation_y(y) * DQuat::from_rotation_x(x));
    }
    let form = "[x, y, z] in degrees or { axis = [x, y, z], angle = degrees }";
    let turn = field.table("`rotate`", &["axis", "angle"], form)?;
    let axis = turn.require("axis", "[x, y, z]")?.direction()?;
    Ok(DQuat::from_axis_angle(axis, turn.require("angle", "degrees")?.number()?.to_radians()))
}

fn parse_matrix(field: &Field) -> Result<DAffine3, SceneError> {
    let wanted = "four rows of four numbers, the last [0, 0, 0, 1]";
    let rows = field.list(wanted)?;
    if rows.len() != 4 {
        return Err(field.bad(format!("it has {} rows", rows.len()), format!("write {wanted}")));
    }
    let mut entries = [[0.0; 4]; 4];
    for (row, entry) in rows.iter().zip(&mut entries) {
        *entry = row.numbers::<4>(wanted)?;
    }
    if entries[3] != [0.0, 0.0, 0.0, 1.0] {
        return Err(rows[3].bad("the last row is not [0, 0, 0, 1], so it is no affine map", format!("write {wanted}")));
    }
    let affine = DAffine3::from_mat4(DMat4::from_cols_array_2d(&entries).transpose());
    if is_singular(affine.matrix3) {
        return Err(field.bad("it is singular: it flattens the leaf", "use a matrix with an inverse"));
    }
    Ok(affine)
}

/// Whether the matrix flattens space, up to rounding: the volume of its columns, each made a unit long.
fn is_singular(matrix: DMat3) -> bool {
    // Columns written with 12 digits that ought to be coplanar are so within about this.
    const FLAT: f64 = 1e-12;
    let columns = [matrix.x_axis, matrix.y_axis, matrix.z_axis].map(|c| c.try_normalize().unwrap_or_default());
    !(columns[0].dot(columns[1].cross(columns[2])).abs() > FLAT)
}

/// The expression; sections that it does not name cut what it stands for.
fn parse_tree(top: &Table, leaves: &[Leaf]) -> Result<Tree, SceneError> {
    let tree = parse_expression(top, leaves)?;
    let named = tree.leaves();
    let is_unnamed = |leaf: &LeafId| named.binary_search(leaf).is_err();
    let sections = (0..leaves.len()).filter(|&i| leaves[i].section.is_some()).map(|i| LeafId(i as u32));
    Ok(sections.filter(is_unnamed).fold(tree, |tree, section| Tree::minus(tree, Tree::leaf(section))))
}

fn parse_expression(top: &Table, leaves: &[Leaf]) -> Result<Tree, SceneError> {
    let Some(field) = top.get("csg")? else {
        let mut others = (0..leaves.len()).filter(|&i| leaves[i].section.is_none());
        return match (others.next(), others.next(), leaves) {
            (Some(only), None, _) => Ok(Tree::leaf(LeafId(only as u32))),
            (None, _, [_]) => Ok(Tree::leaf(LeafId(0))),
            _ => {
                let leaves = leaves.iter().map(|leaf| quoted(&leaf.name)).collect();
                Err(top.error(SceneProblem::NoExpression { leaves }))
            }
        };
    };
    let text = field.text("an expression over the leaves, such as \"body - drill\"")?;
    let by_name: std::collections::HashMap<&str, u32> =
        leaves.iter().zip(0..).map(|(l, i)| (l.name.as_str(), i)).collect();
    let tree = expression::parse(text, &mut |name| by_name.get(name).copied().map(LeafId));
    tree.map_err(|error| match &error {
        ExpressionError::UnknownLeaf { name, .. } => {
            let known = leaves.iter().map(|leaf| leaf.name.as_str());
            let problem = SceneProblem::UnknownLeaf {
                name: name.clone(),
                suggestion: nearest_name(name, known.clone()).map(str::to_owned),
                known: known.map(str::to_owned).collect(),
            };
            field.error_within_text(error.offset(), problem)
        }
        _ => field.error_within_text(error.offset(), SceneProblem::Expression(error)),
    })
}

/// A name as expressions and headers write it: quoted unless it is letters, digits and `_`.
pub(super) fn quoted(name: &str) -> String {
    let plain = !name.is_empty() && name.chars().all(|c| c.is_alphanumeric() || c == '_');
    if plain { name.to_owned() } else { format!("\"{name}\"") }
}

fn parse_size(field: &Field) -> Result<(u32, u32), SceneError> {
    let [width, height] = field.whole("[width, height] in pixels")?;
    let sides = 1..=Camera::MAX_SIDE;
    if !sides.contains(&width) || !sides.contains(&height) {
        return Err(field.error(SceneProblem::Camera(CameraError::Size { width, height })));
    }
    Ok((width, height))
}

fn parse_background(field: &Field) -> Result<[f32; 4], SceneError> {
    if field.is_text()
        && let Some(background) = colour::parse_background(field.text("")?)
    {
        return Ok(background);
    }
    field.colour().map(|[r, g, b]| [r, g, b, 1.0])
}

fn parse_camera(field: &Field, size: (u32, u32)) -> Result<CameraSpec, SceneError> {
    let table =
        field.table("[camera]", &["eye", "target", "up", "fov_y", "height"], "a table with `eye` and `target`")?;
    let lens = match (table.get("fov_y")?, table.get("height")?) {
        (Some(fov_y), Some(height)) => {
            return Err(height.error(SceneProblem::Clash { first: fov_y.name, second: height.name.clone() }));
        }
        (Some(fov_y), None) => Lens::FovY(fov_y.number()?),
        (None, Some(height)) => Lens::Height(height.number()?),
        (None, None) => Lens::FovY(super::framing::FOV_Y_DEGREES),
    };
    let spec = CameraSpec {
        eye: table.require("eye", "[x, y, z]")?.vector()?,
        target: table.require("target", "[x, y, z]")?.vector()?,
        up: table.get("up")?.map_or(Ok(DVec3::Z), |up| up.vector())?,
        lens,
    };
    spec.camera(size).map_err(|error| table.error(SceneProblem::Camera(error)))?;
    Ok(spec)
}

fn parse_light(field: &Field) -> Result<Light, SceneError> {
    let table = field.table("[light]", &["towards", "in_world", "ambient"], "a table with `towards = [x, y, z]`")?;
    let mut light = Light::default();
    if let Some(towards) = table.get("towards")? {
        light.towards = towards.direction()?;
        // A direction that the user writes is one of the scene, unless they say otherwise.
        light.in_world = true;
    }
    if let Some(in_world) = table.get("in_world")? {
        light.in_world = in_world.flag()?;
    }
    if let Some(ambient) = table.get("ambient")? {
        light.ambient = ambient.share()?;
    }
    Ok(light)
}

#[cfg(test)]
mod tests;
