//! The command line: every flag, its help, and how it turns into the library's own types.

use std::path::PathBuf;

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{ArgAction, ArgMatches, Args, FromArgMatches, Parser, Subcommand, ValueEnum, ValueHint};
use clap_complete::Shell;
use glam::DVec3;

use super::style_args::StyleArgs;
use surfcut::layers::{LayerLimit, MAX_SAMPLES};
use surfcut::pipeline::Density;
use surfcut::scene::one_liner::Joint;
use surfcut::scene::{Representation, colour};
use surfcut::space::Camera;
use surfcut::splat::{Clip, Inside, Partners, SplatSettings, Unknown};

/// After the help of the whole command.
const EXIT_CODES: &str = "\
Examples:
  surfcut render scene.toml -o cut.png
  surfcut render femur.ply --minus drill.stl --and box:-1,-1,-1,1,1,1 -o cut.png
  surfcut render scan.ply --minus sphere:0,0,0,2.5 --size 1024x768 --samples 4
  surfcut check scene.toml && surfcut render scene.toml -o layers.exr --layers all

Exit codes:
  0   done (render also exits with 0, and warns, when the picture is empty)
  1   check found something to look at
  2   the command line cannot be understood
  3   an input cannot be used: a file, a scene, an expression
  4   an output was refused: it exists, or cannot be written
  5   check found that the result is certainly empty
  6   the GPU cannot be used, and --backend gpu asks for it
  70  a bug in surfcut";

/// Cuts scans and meshes with Boolean expressions and draws the result, without first turning a scan into a mesh.
#[derive(Debug, Parser)]
#[command(name = "surfcut", version, after_help = EXIT_CODES, arg_required_else_help = true)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Option<Command>,
    /// Tell which GPUs there are, and do nothing else
    #[arg(long, exclusive = true)]
    pub list_gpus: bool,
    /// Flags that every command takes.
    #[command(flatten)]
    pub common: Common,
}

/// Flags that every command takes.
#[derive(Debug, Clone, Args)]
pub struct Common {
    /// Worker threads [default: one a core]
    #[arg(long, global = true, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024), help_heading = "General")]
    pub threads: Option<u16>,
    /// Print nothing but errors: no progress, no summary
    #[arg(long, short, global = true, help_heading = "General")]
    pub quiet: bool,
    /// Write a summary of the run as JSON (- is standard output)
    #[arg(long, global = true, value_name = "FILE|-", value_hint = ValueHint::FilePath, help_heading = "General")]
    pub summary_file: Option<PathBuf>,
    /// Replace outputs that exist
    #[arg(long, global = true, help_heading = "General")]
    pub overwrite: bool,
}

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Draw a scene into a PNG or EXR picture
    Render(Box<RenderArgs>),
    /// Tell what files or a scene hold
    Info(InfoArgs),
    /// Look for trouble before a long run: orientation, closedness, density, outliers
    Check(CheckArgs),
    /// Measure two pipelines or settings against each other
    Compare(CompareArgs),
    /// Chart accuracy against frame time over the settings that trade them
    Chart(ChartArgs),
    /// Print a completion script for a shell
    Completions(CompletionsArgs),
}

/// What is drawn: a scene file, or one operand and what it is joined with.
#[derive(Debug, Clone, Args)]
pub struct SceneArgs {
    /// A scene (.toml or .tree.json), a file of points or triangles (PLY, STL, OBJ, XYZ), or a solid such as sphere:x,y,z,radius
    #[arg(value_name = "SCENE|FILE|SOLID", value_hint = ValueHint::FilePath, allow_hyphen_values = false)]
    pub input: String,
    /// Operands that join it.
    #[command(flatten)]
    pub operands: Operands,
    /// Leave out points with values that are not finite, instead of refusing the file
    #[arg(long, help_heading = "Scene")]
    pub drop_invalid: bool,
}

/// `--minus`, `--and` and `--plus`, in the order in which they were written.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Operands(pub Vec<(Joint, String)>);

const JOINTS: [(&str, Joint, &str); 3] = [
    ("minus", Joint::Minus, "Cut this file or solid away"),
    ("and", Joint::And, "Keep only what lies inside this file or solid too"),
    ("plus", Joint::Plus, "Add this file or solid"),
];

const OPERANDS_HELP: &str = "\
Operands join from left to right. A solid is written as sphere:x,y,z,radius, box:x0,y0,z0,x1,y1,z1, \
cylinder:x0,y0,z0,x1,y1,z1,radius, cone:x0,y0,z0,x1,y1,z1,radius0,radius1, torus:x,y,z,axis-x,axis-y,axis-z,radius,tube, \
half-space:x,y,z,normal-x,normal-y,normal-z or blend:smoothness,x,y,z,radius,…";

impl Args for Operands {
    fn augment_args(command: clap::Command) -> clap::Command {
        JOINTS.iter().fold(command, |command, (name, _, help)| {
            command.arg(
                clap::Arg::new(*name)
                    .long(*name)
                    .value_name("FILE|SOLID")
                    .value_hint(ValueHint::FilePath)
                    .action(ArgAction::Append)
                    .help(*help)
                    .long_help(format!("{help}\n\n{OPERANDS_HELP}"))
                    .help_heading("Scene"),
            )
        })
    }

    fn augment_args_for_update(command: clap::Command) -> clap::Command {
        Self::augment_args(command)
    }
}

impl FromArgMatches for Operands {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let mut found: Vec<(usize, Joint, String)> = Vec::new();
        for (name, joint, _) in JOINTS {
            let places = matches.indices_of(name).into_iter().flatten();
            let values = matches.get_many::<String>(name).into_iter().flatten();
            found.extend(places.zip(values).map(|(place, value)| (place, joint, value.clone())));
        }
        found.sort_by_key(|(place, ..)| *place);
        Ok(Self(found.into_iter().map(|(_, joint, value)| (joint, value)).collect()))
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

/// What draws.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
pub enum Pipeline {
    /// `mesh` where every leaf is a mesh or a solid; with points `splat`, which draws fastest, or `hybrid` where a leaf says what
    /// it is drawn as, a mesh is open, or a GPU draws
    #[default]
    Auto,
    /// Every leaf in its own form: points as surfels, meshes by their triangles, solids by their formulas
    Hybrid,
    /// Every leaf is found by surfels; meshes and solids are asked exactly
    Splat,
    /// Meshes triangle by triangle and solids exactly; cannot draw points
    Mesh,
    /// The f64 ray caster that judges the others, slow; needs a mesh, a solid or a `truth` for every leaf
    Reference,
}

/// Ways to draw one scene, for a table of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Way {
    /// Every leaf as surfels and nothing else
    Splats,
    /// Every leaf as a mesh: points by the `truth` that they were sampled from, solids as triangles, half-spaces exactly
    Meshes,
    /// Every leaf in its own form
    Hybrid,
}

/// How it is drawn.
#[derive(Debug, Clone, Args)]
pub struct PipelineArgs {
    /// What draws
    #[arg(long, value_enum, default_value_t, help_heading = "Pipeline")]
    pub pipeline: Pipeline,
    /// Where fragments are clipped
    #[arg(long, default_value = Clip::default().name(), value_parser = choice(&Clip::ALL, Clip::name, Clip::summary), help_heading = "Pipeline")]
    pub clip: Clip,
    /// How a point is found to be inside a leaf made of surfels
    #[arg(long, default_value = Inside::default().name(), value_parser = choice(&Inside::ALL, Inside::name, Inside::summary), help_heading = "Pipeline")]
    pub inside: Inside,
    /// What holds for a leaf that is near but has no clipping partner
    #[arg(long, default_value = Unknown::default().name(), value_parser = choice(&Unknown::ALL, Unknown::name, Unknown::summary), help_heading = "Pipeline")]
    pub unknown: Unknown,
    /// Where clipping partners are searched
    #[arg(long, default_value = Partners::default().name(), value_parser = choice(&Partners::ALL, Partners::name, Partners::summary), help_heading = "Pipeline")]
    pub partners: Partners,
    /// Draw a leaf as `surfels` (nothing but them), `mesh` (a solid becomes triangles) or `exact` (itself); may be repeated
    #[arg(long, value_name = "LEAF=HOW", value_parser = representation, help_heading = "Pipeline")]
    pub represent: Vec<(String, Representation)>,
    /// Whose layers are drawn
    #[arg(long, value_enum, default_value_t, help_heading = "Pipeline")]
    pub union: Union,
    /// How densely meshes and solids are sampled.
    #[command(flatten)]
    pub density: DensityArgs,
}

/// Whose processor draws.
#[derive(Debug, Clone, Args)]
pub struct BackendArgs {
    /// Whose processor draws
    #[arg(long, value_enum, default_value_t, help_heading = "Pipeline")]
    pub backend: Backend,
    /// Draw with the GPU whose name has this in it (--list-gpus tells which there are)
    #[arg(long, value_name = "NAME", help_heading = "Pipeline")]
    pub gpu: Option<String>,
}

/// Whose processor draws.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
pub enum Backend {
    /// A GPU where there is one and it can draw the scene, else the CPU
    #[default]
    Auto,
    /// The CPU
    Cpu,
    /// A GPU, even one in software; fails where it cannot
    Gpu,
}

/// Whose layers are drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
pub enum Union {
    /// Those of the result: a union is one solid
    #[default]
    Volume,
    /// Those of each product of the expression by itself, so that overlaps show
    Products,
}

/// How densely meshes and solids are sampled.
#[derive(Debug, Clone, Copy, Args)]
pub struct DensityArgs {
    /// Largest error of a sampled mesh or solid, or of a solid as a mesh, in pixels
    #[arg(long, value_name = "PX", default_value_t = 0.5, value_parser = positive, allow_negative_numbers = true, conflicts_with = "spacing", help_heading = "Pipeline")]
    pub max_error: f64,
    /// Surfel spacing of sampled meshes and solids, in scene units, in place of --max-error
    #[arg(long, value_name = "LENGTH", value_parser = positive, allow_negative_numbers = true, help_heading = "Pipeline")]
    pub spacing: Option<f64>,
}

impl DensityArgs {
    /// As the pipeline takes it.
    pub fn density(&self) -> Density {
        self.spacing.map_or(Density::MaxErrorPx(self.max_error), Density::Spacing)
    }
}

impl PipelineArgs {
    /// Whether a flag asks for surfels that are clipped in a way of their own.
    pub fn asks_for_surfels(&self) -> bool {
        !self.splat_settings().takes_crossings()
    }

    /// The splat pipeline's settings.
    pub fn splat_settings(&self) -> SplatSettings {
        SplatSettings { clip: self.clip, inside: self.inside, unknown: self.unknown, partners: self.partners }
    }
}

/// The picture.
#[derive(Debug, Clone, Args)]
pub struct ViewArgs {
    /// Picture size in pixels [default: the scene's, else 1024x768]
    #[arg(long, value_name = "WxH", value_parser = size, help_heading = "Picture")]
    pub size: Option<(u32, u32)>,
    /// Samples a pixel: 1 is fast, 4 smooths edges
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=i64::from(MAX_SAMPLES)), help_heading = "Picture")]
    pub samples: u32,
    /// Colour behind everything: #rrggbb, a name, or transparent [default: the scene's]
    #[arg(long, value_name = "COLOUR", value_parser = background, help_heading = "Picture")]
    pub background: Option<[f32; 4]>,
    /// Surfaces handed on: the nearest alone, or all, which transparency needs [default: all where a leaf is transparent
    /// or an EXR is written, else nearest]
    #[arg(long, value_parser = choice(&[LayerLimit::Nearest, LayerLimit::All], layer_limit_name, layer_limit_summary), help_heading = "Picture")]
    pub layers: Option<LayerLimit>,
    /// Layers drawn, where deeper ones show, and written to an EXR at most [default: the scene's, else all]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..), help_heading = "Picture")]
    pub max_layers: Option<u32>,
    /// Stop at the first layer that has fewer than N pixels, where deeper ones show; what is left out is told
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..), help_heading = "Picture")]
    pub min_pixels: Option<u64>,
    /// Other scene content, composed by depth: an EXR of the picture's size with R, G, B, Z (planar view depth, scene units,
    /// from the same camera) and perhaps A; may be repeated; of a sequence, a name with {frame}
    #[arg(long, value_name = "FILE.exr", value_hint = ValueHint::FilePath, help_heading = "Picture")]
    pub merge: Vec<PathBuf>,
    /// The camera.
    #[command(flatten)]
    pub camera: CameraArgs,
}

/// The camera; what is not given is the scene's, or frames it.
#[derive(Debug, Clone, Copy, PartialEq, Default, Args)]
pub struct CameraArgs {
    /// Where the eye is
    #[arg(long, value_name = "X,Y,Z", value_parser = point, allow_hyphen_values = true, help_heading = "Camera")]
    pub eye: Option<DVec3>,
    /// What it looks at
    #[arg(long, value_name = "X,Y,Z", value_parser = point, allow_hyphen_values = true, help_heading = "Camera")]
    pub target: Option<DVec3>,
    /// Which way is up [default: the scene's, else 0,0,1]
    #[arg(long, value_name = "X,Y,Z", value_parser = point, allow_hyphen_values = true, help_heading = "Camera")]
    pub up: Option<DVec3>,
    /// Vertical field of view in degrees (perspective) [default: the scene's, else 35]
    #[arg(long, value_name = "DEGREES", value_parser = positive, allow_negative_numbers = true, conflicts_with = "height", help_heading = "Camera")]
    pub fov_y: Option<f64>,
    /// Height of the picture in scene units (orthographic)
    #[arg(long, value_name = "LENGTH", value_parser = positive, allow_negative_numbers = true, help_heading = "Camera")]
    pub height: Option<f64>,
    /// Magnify so many times, towards --at
    #[arg(long, value_name = "F", value_parser = positive, allow_negative_numbers = true, help_heading = "Camera")]
    pub zoom: Option<f64>,
    /// What --zoom brings to the middle of the picture [default: the target]
    #[arg(long, value_name = "X,Y,Z", value_parser = point, allow_hyphen_values = true, help_heading = "Camera")]
    pub at: Option<DVec3>,
}

/// `surfcut render`
#[derive(Debug, Clone, Args)]
#[command(after_help = "Examples:
  surfcut render scene.toml
  surfcut render femur.ply --minus drill.stl -o cut.png --size 1024x1024 --samples 4
  surfcut render scan.ply --minus cylinder:0,0,-9,0,0,9,1.5 --zoom 10 --at 1.5,0,0 -o detail.png
  surfcut render scene.toml --style blueprint --hidden dashed -o plan.png
  surfcut render scene.toml -o cut.png -o cut.exr --layers all --summary-file run.json
  surfcut render scene.toml -o - | display
  surfcut render scene.toml --turntable 72 -o turn.gif
  surfcut render scene.toml --turntable 360 -o turn_{frame}.png")]
pub struct RenderArgs {
    /// What is drawn.
    #[command(flatten)]
    pub scene: SceneArgs,
    /// Picture to write, .png or .exr by its name; may be repeated; - is a PNG on standard output; of a sequence also .gif
    /// or .apng, or a name with {frame} [default: the input's name with .png, in the working directory]
    #[arg(long, short, value_name = "FILE|-", value_hint = ValueHint::FilePath)]
    pub output: Vec<PathBuf>,
    /// The picture.
    #[command(flatten)]
    pub view: ViewArgs,
    /// How it looks.
    #[command(flatten)]
    pub style: StyleArgs,
    /// How it is drawn.
    #[command(flatten)]
    pub pipeline: PipelineArgs,
    /// Whose processor draws.
    #[command(flatten)]
    pub backend: BackendArgs,
    /// Draw N times after a warm-up, the camera turned by 1° each time, and report median times
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000), help_heading = "General")]
    pub repeat: Option<u32>,
    /// Many frames instead of one picture.
    #[command(flatten)]
    pub sequence: SequenceArgs,
}

/// Many frames instead of one picture: files numbered at `{frame}` in an output's name, or a film (.gif, .apng). A run
/// that was stopped goes on where it stopped when it is started again.
#[derive(Debug, Clone, Copy, PartialEq, Args)]
pub struct SequenceArgs {
    /// Draw N frames once around the camera's target, about its up direction
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000), conflicts_with_all = ["repeat", "dump_maps"], help_heading = "Sequence")]
    pub turntable: Option<u32>,
    /// Draw the frames between the scene's keyframes
    #[arg(long, conflicts_with_all = ["repeat", "turntable", "dump_maps"], help_heading = "Sequence")]
    pub animate: bool,
    /// Frames a second, of a film and between keyframes whose times are in seconds
    #[arg(long, value_name = "N", default_value_t = 24.0, value_parser = frame_rate, help_heading = "Sequence")]
    pub fps: f64,
}

impl SequenceArgs {
    /// Whether frames are asked for.
    pub fn is_asked_for(&self) -> bool {
        self.animate || self.turntable.is_some()
    }
}

/// `surfcut info`
#[derive(Debug, Clone, Args)]
#[command(after_help = "Examples:\n  surfcut info scan.ply\n  surfcut info scene.toml --summary-file -")]
pub struct InfoArgs {
    /// What to look at.
    #[command(flatten)]
    pub scene: SceneArgs,
}

/// `surfcut check`
#[derive(Debug, Clone, Args)]
#[command(after_help = "Exits with 0 where nothing is amiss, 1 where something should be looked at, 3 where an input
cannot be used, 5 where the result is certainly empty.

Examples:\n  surfcut check scan.ply\n  surfcut check scan.ply --minus drill.stl\n  surfcut check scene.toml")]
pub struct CheckArgs {
    /// What to look at.
    #[command(flatten)]
    pub scene: SceneArgs,
}

/// `surfcut compare`
#[derive(Debug, Clone, Args)]
#[command(after_help = "Examples:
  surfcut compare scene.toml
  surfcut compare scene.toml --clip fragment --inside two-nearest --unknown paper --difference diff.png
  surfcut compare scene.toml --with splat --with-clip fragment --zoom 100 --at 1,0,0
  surfcut compare scene.toml --as splats,meshes,hybrid")]
pub struct CompareArgs {
    /// What is drawn.
    #[command(flatten)]
    pub scene: SceneArgs,
    /// The picture.
    #[command(flatten)]
    pub view: ViewArgs,
    /// How the first picture is drawn.
    #[command(flatten)]
    pub pipeline: PipelineArgs,
    /// What draws the picture that the first is measured against
    #[arg(long, value_enum, default_value_t = Pipeline::Reference, help_heading = "Second picture")]
    pub with: Pipeline,
    /// As --clip, of the second picture
    #[arg(long, default_value = Clip::default().name(), value_parser = choice(&Clip::ALL, Clip::name, Clip::summary), help_heading = "Second picture")]
    pub with_clip: Clip,
    /// As --inside, of the second picture
    #[arg(long, default_value = Inside::default().name(), value_parser = choice(&Inside::ALL, Inside::name, Inside::summary), help_heading = "Second picture")]
    pub with_inside: Inside,
    /// As --unknown, of the second picture
    #[arg(long, default_value = Unknown::default().name(), value_parser = choice(&Unknown::ALL, Unknown::name, Unknown::summary), help_heading = "Second picture")]
    pub with_unknown: Unknown,
    /// As --partners, of the second picture
    #[arg(long, default_value = Partners::default().name(), value_parser = choice(&Partners::ALL, Partners::name, Partners::summary), help_heading = "Second picture")]
    pub with_partners: Partners,
    /// Draw the scene in each of these ways in place of the first picture, measure each, and print one table
    #[arg(long = "as", value_name = "WAY,…", value_enum, value_delimiter = ',', conflicts_with_all = ["pipeline", "represent", "difference"])]
    pub ways: Vec<Way>,
    /// Write a picture of the differences (PNG)
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub difference: Option<PathBuf>,
}

/// `surfcut chart`
#[derive(Debug, Clone, Args)]
#[command(
    after_help = "Draws the scene with the reference and with every --inside under both --clip, and as the paper does; \
charts the error of the cut edge against the processor time of a frame. Writes NAME.svg and NAME.png, and the data beside \
them as NAME.csv and NAME.json.

Examples:\n  surfcut chart scene.toml -o accuracy\n  surfcut chart scene.toml --size 512x512 --magnify 1,10,1000 --repeat 5"
)]
pub struct ChartArgs {
    /// What is drawn.
    #[command(flatten)]
    pub scene: SceneArgs,
    /// The picture.
    #[command(flatten)]
    pub view: ViewArgs,
    /// Where to write, without an ending
    #[arg(long, short, value_name = "NAME", default_value = "chart", value_hint = ValueHint::FilePath)]
    pub output: PathBuf,
    /// How densely meshes and solids are sampled.
    #[command(flatten)]
    pub density: DensityArgs,
    /// Magnifications to chart: 1 is the picture as it is, larger ones close in on the cut edge nearest to its middle
    #[arg(long, value_name = "F,…", value_delimiter = ',', default_values_t = [1.0, 100.0], value_parser = at_least_one)]
    pub magnify: Vec<f64>,
    /// Frames drawn for each time
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub repeat: u32,
}

/// `surfcut completions`
#[derive(Debug, Clone, Args)]
#[command(after_help = "Example:\n  surfcut completions bash > ~/.local/share/bash-completion/completions/surfcut")]
pub struct CompletionsArgs {
    /// The shell
    pub shell: Shell,
}

/// A parser for one of `all`, by name, with a line of help each.
pub fn choice<T: Copy + Send + Sync + 'static>(
    all: &'static [T],
    name: fn(T) -> &'static str,
    summary: fn(T) -> &'static str,
) -> impl TypedValueParser<Value = T> {
    let values = all.iter().map(|&value| PossibleValue::new(name(value)).help(summary(value)));
    PossibleValuesParser::new(values)
        .try_map(move |text| all.iter().copied().find(|&value| name(value) == text).ok_or("no such choice"))
}

/// `LEAF=HOW`; a leaf's name may hold `=`.
fn representation(text: &str) -> Result<(String, Representation), String> {
    let names = || Representation::ALL.map(Representation::name).join(", ");
    let (leaf, how) = text.rsplit_once('=').ok_or_else(|| format!("write LEAF=HOW, HOW one of {}", names()))?;
    let representation = Representation::from_name(how).ok_or_else(|| format!("`{how}` is none of {}", names()))?;
    Ok((leaf.to_owned(), representation))
}

fn layer_limit_name(limit: LayerLimit) -> &'static str {
    match limit {
        LayerLimit::Nearest => "nearest",
        LayerLimit::All => "all",
    }
}

fn layer_limit_summary(limit: LayerLimit) -> &'static str {
    match limit {
        LayerLimit::Nearest => "the nearest surface of every sample",
        LayerLimit::All => "every surface of the result, front and back",
    }
}

/// A number that is finite and larger than 0.
pub fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value > 0.0 && value.is_finite() => Ok(value),
        Ok(_) => Err("it must be larger than 0 and finite".into()),
        Err(_) => Err("write a number".into()),
    }
}

/// The slowest and the fastest film, frames a second: GIF's shortest delay is a hundredth of a second.
const FRAME_RATES: std::ops::RangeInclusive<f64> = 0.01..=100.0;

fn frame_rate(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(rate) if FRAME_RATES.contains(&rate) => Ok(rate),
        _ => Err(format!("write a number from {} to {}", FRAME_RATES.start(), FRAME_RATES.end())),
    }
}

fn at_least_one(text: &str) -> Result<f64, String> {
    positive(text).and_then(|value| if value >= 1.0 { Ok(value) } else { Err("it must be 1 or larger".into()) })
}

fn point(text: &str) -> Result<DVec3, String> {
    let form = || "write three numbers, such as 1,0,-2.5".to_owned();
    let numbers: Vec<f64> =
        text.split(',').map(|part| part.trim().parse::<f64>()).collect::<Result<_, _>>().map_err(|_| form())?;
    let vector = <[f64; 3]>::try_from(numbers).map(DVec3::from_array).map_err(|_| form())?;
    if vector.is_finite() { Ok(vector) } else { Err(form()) }
}

fn size(text: &str) -> Result<(u32, u32), String> {
    let form = || format!("write WIDTHxHEIGHT, 1 to {} each, such as 1024x768", Camera::MAX_SIDE);
    let (width, height) = text.split_once(['x', 'X', '×']).ok_or_else(form)?;
    let side = |text: &str| text.trim().parse::<u32>().ok().filter(|side| (1..=Camera::MAX_SIDE).contains(side));
    side(width).zip(side(height)).ok_or_else(form)
}

fn background(text: &str) -> Result<[f32; 4], String> {
    colour::parse_background(text).ok_or_else(|| "write #rrggbb, a name such as ivory, or transparent".to_owned())
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;
    use surfcut::scene::framing::FOV_Y_DEGREES;
    use surfcut::scene::style::{CutColour, LineSettings, Style, StyleKind};

    use super::*;

    fn render(line: &str) -> Result<RenderArgs, clap::Error> {
        let words = ["surfcut", "render"].into_iter().chain(line.split_whitespace());
        match Cli::try_parse_from(words)?.command.expect("the words name a command") {
            Command::Render(args) => Ok(*args),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn the_definition_is_sound() {
        Cli::command().debug_assert();
    }

    #[test]
    fn help_tells_what_styles_have_by_default() {
        let command = Cli::command();
        let render = command.find_subcommand("render").unwrap();
        let help = |flag: &str| {
            render.get_arguments().find(|arg| arg.get_id() == flag).unwrap().get_help().unwrap().to_string()
        };
        let (blueprint, shaded) = (Style::of(StyleKind::Blueprint), Style::of(StyleKind::Shaded));
        let LineSettings { width_px, jump_px, crease_degrees, hidden_dash_px, .. } = shaded.lines;
        let rows = |[[a, b], [c, d]]: [[f32; 2]; 2]| format!("{a},{b},{c},{d}");
        assert!(hidden_dash_px.is_none() && shaded.cut_colour == CutColour::Cutter && shaded.fade == 0.0);
        for (flag, default) in [
            ("opacity", Style::of(StyleKind::Transparent).opacity.to_string()),
            ("fade", format!("{} in blueprints and wireframes and 0 elsewhere", blueprint.fade)),
            ("tint", blueprint.tint.to_string()),
            ("line_width", width_px.to_string()),
            ("crease", crease_degrees.to_string()),
            ("jump", jump_px.to_string()),
            ("hidden", "solid".to_owned()),
            ("cut_colour", "cutter".to_owned()),
            ("seed", shaded.sketch.seed.to_string()),
            ("sketch_edge", rows(shaded.sketch.edge_px)),
            ("sketch_shade", rows(shaded.sketch.shade_px)),
            ("sketch_wavelength", shaded.sketch.wavelength_px.to_string()),
            ("fov_y", FOV_Y_DEGREES.to_string()),
        ] {
            assert!(help(flag).contains(&format!("[default: the scene's, else {default}]")), "{flag}: {}", help(flag));
        }
    }

    #[test]
    fn operands_keep_their_order() {
        let args = render("A.ply --minus B.stl --and C.ply --minus sphere:0,0,0,1 --plus D.obj").unwrap();
        let joints: Vec<_> = args.scene.operands.0.iter().map(|(joint, text)| (*joint, text.as_str())).collect();
        assert_eq!(
            joints,
            [(Joint::Minus, "B.stl"), (Joint::And, "C.ply"), (Joint::Minus, "sphere:0,0,0,1"), (Joint::Plus, "D.obj"),]
        );
    }

    #[test]
    fn settings_are_mapped_and_default_to_the_library_s() {
        let args = render("a.toml").unwrap();
        assert_eq!(args.pipeline.splat_settings(), SplatSettings::default());
        let args =
            render("a.toml --clip fragment --inside two-nearest --unknown paper --partners clip-buffer").unwrap();
        assert_eq!(args.pipeline.splat_settings(), SplatSettings::PAPER);
        for inside in Inside::ALL {
            assert_eq!(render(&format!("a --inside {}", inside.name())).unwrap().pipeline.inside, inside);
        }
    }

    #[test]
    fn a_style_s_flags_say_what_a_scene_says() {
        use surfcut::scene::style::{Corner, Style};
        let style = |line: &str| render(line).map(|args| args.style.style(&Style::default(), None));
        let sketch =
            style("a --sketch-edge -1,2,3,-4.5 --sketch-shade 0,0,0,32 --sketch-wavelength 16").unwrap().sketch;
        assert_eq!((sketch.edge_px, sketch.shade_px), ([[-1.0, 2.0], [3.0, -4.5]], [[0.0, 0.0], [0.0, 32.0]]));
        assert_eq!((sketch.wavelength_px, sketch.seed), (16.0, 1));
        for (line, dash) in [("solid", None), ("dashed", Some([7.0, 5.0])), ("9,1.5", Some([9.0, 1.5]))] {
            assert_eq!(style(&format!("a --hidden {line}")).unwrap().lines.hidden_dash_px, dash);
        }
        for (line, corner) in [
            ("a", None),
            ("a --legend", Some(Corner::BottomLeft)),
            ("a --legend --quiet", Some(Corner::BottomLeft)),
            ("a --legend top-right", Some(Corner::TopRight)),
            ("a --legend none", None),
        ] {
            assert_eq!(style(line).unwrap().legend, corner, "{line}");
        }
        // What the scene says goes with it into another style, and a flag takes it away.
        let scene = Style { legend: Some(Corner::TopLeft), ..Style::default() };
        let of_scene = |line: &str| render(line).unwrap().style.style(&scene, None).legend;
        assert_eq!(of_scene("a --style sketchy"), Some(Corner::TopLeft));
        assert_eq!(of_scene("a --style sketchy --legend none"), None);
        for (line, parts) in [
            ("a --sketch-edge 1,2,3", ["--sketch-edge", "four numbers"]),
            ("a --sketch-shade 1,2,3,33", ["--sketch-shade", "at most 32"]),
            ("a --sketch-shade 1,2,3,nan", ["--sketch-shade", "at most 32"]),
            ("a --sketch-wavelength 15", ["--sketch-wavelength", "break up"]),
            ("a --hidden 0.5,3", ["--hidden", "a pixel long or more"]),
            ("a --hidden wavy", ["--hidden", "dotted"]),
            ("a --hidden 3,inf", ["--hidden", "a pixel long or more"]),
            ("--legend a", ["--legend", "bottom-right"]),
        ] {
            let message = style(line).expect_err(line).to_string();
            assert!(parts.iter().all(|part| message.contains(part)), "{line}: {message}");
        }
    }

    #[test]
    fn numbers_are_read_and_refused_with_reason() {
        let args = render("a.toml --size 640x480 --eye -1,-2,3 --zoom 10 --at 0,0,-.5 --samples 16").unwrap();
        assert_eq!(args.view.size, Some((640, 480)));
        assert_eq!(args.view.camera.eye, Some(DVec3::new(-1.0, -2.0, 3.0)));
        assert_eq!(args.view.camera.at, Some(DVec3::new(0.0, 0.0, -0.5)));
        for (line, part) in [
            ("a --size 640", "1024x768"),
            ("a --size 0x9", "1024x768"),
            ("a --eye 1,2", "three numbers"),
            ("a --eye 1,2,nan", "three numbers"),
            ("a --zoom 0", "larger than 0"),
            ("a --zoom -1", "larger than 0"),
            ("a --line-width -1", "larger than 0"),
            ("a --opacity -0.5", "from 0 to 1"),
            ("a --samples 17", "16"),
            ("a --threads 0", "1"),
            ("a --background puce", "ivory"),
            ("a --fov-y 30 --height 2", "cannot be used with"),
            ("a --inside outside", "two-nearest"),
            ("a --max-error 1 --spacing 2", "cannot be used with"),
        ] {
            let message = render(line).expect_err(line).to_string();
            assert!(message.contains(part), "{line}: {message}");
        }
    }
}
