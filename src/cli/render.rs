//! `surfcut render`: a scene into pictures.

use std::path::{Path, PathBuf};

use anyhow::Context;
use glam::{DQuat, DVec3};
use image::RgbImage;
use serde_json::json;
use surfcut::composite::legend;
use surfcut::composite::maps::maps;
use surfcut::composite::merge::Contents;
use surfcut::composite::section::Hatching;
use surfcut::composite::shaded::tile_count;
use surfcut::composite::shadow::Shadows;
use surfcut::composite::{Leaves, Look, Picture, styled_with};
use surfcut::csg::LeafId;
use surfcut::formats::depth_picture::{self, DepthPictureError};
use surfcut::layers::limit::{Counted, LayerCounts};
use surfcut::layers::{LayerLimit, LayerSource, LayerStack};
use surfcut::output::report::{FrameTimes, Report, Stopwatch, Times};
use surfcut::output::{Destination, OutputError, PictureInfo, exr, png};
use surfcut::scene::style::Style;
use surfcut::scene::{LeafGeometry, LoadedScene};
use surfcut::space::{Camera, CameraError, Lens, Projection};

use super::args::{RenderArgs, ViewArgs};
use super::backend::{self, Device};
use super::engine::{Engine, FrameArgs, engine};
use super::failure::{UsageError, code};
use super::memory::Held;
use super::progress::Bars;
use super::shadows::{ShadowCost, ShadowPass, warn_of_shadows};
use super::{Session, input, memory, sequence};

/// The picture formats.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PictureFormat {
    Png,
    Exr,
}

/// Draws the scene and writes every output, or none: what would be refused is refused before the first ray.
pub fn run(args: &RenderArgs, session: &Session) -> anyhow::Result<u8> {
    if args.sequence.is_asked_for() {
        return sequence::run(args, session);
    }
    let outputs = outputs(args, session)?;
    let (mut report, mut loaded) = opened(args, session)?;
    let camera = input::camera(&loaded, &args.view.camera)?;
    let wants_layers = outputs.iter().any(|(_, format)| *format == PictureFormat::Exr);
    let style = args.style.style(&loaded.scene.style, args.view.max_layers).for_points(has_points(&loaded));
    memory::check(&camera, Held::picture(wants_layers, args.view.merge.len()))?;
    // Maps show every layer, whatever the style draws.
    let frame = frame_args(&args.view, &loaded, &style, wants_layers || args.style.dump_maps.is_some());
    describe(args, &camera, frame, &style, &loaded, &mut report);
    warn_of_legend(&style, &camera, session, &mut report);
    warn_of_shadows(&style, session, &mut report);
    let shadows = ShadowPass::of_scene(&loaded, &style);
    if let Some(folder) = &args.style.dump_maps {
        maps_folder(folder, session)?;
    }
    let contents = contents(&args.view.merge, &camera)?;
    let told = report.warnings.len();
    let device = Device::open(&args.backend, session)?;
    let on = (&camera, device.is_some());
    let engine = engine(&mut loaded, &args.pipeline, frame, on, session.bars, &mut report)?;
    report.settings.insert("pipeline".to_owned(), json!(engine.pipeline()));
    report.warnings[told..].iter().for_each(|warning| session.tell(&format!("warning: {warning}")));
    let look = Look { light: loaded.scene.light, background: loaded.scene.background_for(&style) };
    let leaf_colours = leaf_colours(&loaded);
    let hatching = Hatching::of_scene(&loaded, &style);
    let heavy = hatching.heavy();
    let names = leaf_names(&loaded);
    let leaves = Leaves { colours: &leaf_colours, heavy: &heavy, hatching: Some(&hatching), names: &names };
    report.settings.insert("backend".to_owned(), json!(device.as_ref().map_or("cpu".to_owned(), Device::name)));
    let drawing = Drawing {
        engine: &*engine,
        device: device.as_ref(),
        look,
        style,
        leaves,
        contents: &contents,
        shadows: shadows.as_ref(),
        limit: frame.limit,
        min_pixels: args.view.min_pixels,
        wants_layers,
        wants_maps: args.style.dump_maps.is_some(),
        bars: session.bars,
    };
    let Drawn { picture, stack, style, layers } = drawing.draw(&camera, &mut report)?;
    tell_of(&*engine, session, &mut report);
    if let Some(repeats) = args.repeat {
        report.frame = drawing.repeat(&camera, &style, loaded.camera_spec().target, repeats)?;
    }

    report.count("leaves", loaded.scene.leaves.len() as u64);
    report.count("pixels_covered", picture.covered);
    if picture.is_empty() {
        let warning = "the picture is empty: no surface of the result is in view; `surfcut check` tells whether the result \
                       is empty, an input is inside-out, or the camera looks elsewhere";
        report.warnings.push(warning.into());
        session.tell(&format!("warning: {warning}"));
    }
    let info = picture_info(&report, &camera);
    let files = Files { drawn: (&picture, stack.as_ref()), look, max_layers: most_layers(&style), info };
    for (destination, format) in &outputs {
        let watch = Stopwatch::start();
        files.write(*format, destination, session.overwrite())?;
        report.add_phase("write", watch.times());
        session.tell(&format!("wrote {destination} ({}x{})", picture.width, picture.height));
    }
    if let Some(folder) = &args.style.dump_maps {
        memory::check(&camera, Held::maps(&style, layers.unwrap_or_default()))?;
        report.phase("maps", || drawing.dump_maps(&camera, &style, folder, session))?;
    }
    left_out_text(&report).into_iter().for_each(|text| session.tell(&text));
    session.tell(&times_text(&report));
    session.write_summary(&report.to_json())?;
    Ok(code::OK)
}

/// The scene with its files read, and a report that has begun with what there is to warn of.
pub fn opened(args: &RenderArgs, session: &Session) -> anyhow::Result<(Report, LoadedScene)> {
    let mut report = Report::new(std::env::args().collect());
    let loaded = report.phase("load", || input::loaded(&args.scene, Some(&args.view), session.bars))?;
    report.scene = Some(input::name(&args.scene));
    report.units = loaded.scene.units.clone();
    report.warnings.extend(loaded.notes.iter().filter(|note| note.is_warning()).map(ToString::to_string));
    report.warnings.iter().for_each(|warning| session.tell(&format!("warning: {warning}")));
    Ok((report, loaded))
}

/// The leaves' colours where they are of one, by index.
pub fn leaf_colours(loaded: &LoadedScene) -> Vec<[f32; 3]> {
    (0..loaded.scene.leaves.len()).map(|leaf| loaded.colour(LeafId(leaf as u32))).collect()
}

/// The leaves' names, by index.
pub fn leaf_names(loaded: &LoadedScene) -> Vec<String> {
    loaded.scene.leaves.iter().map(|leaf| leaf.name.clone()).collect()
}

/// Warns where a legend is asked for and has no room.
pub fn warn_of_legend(style: &Style, camera: &Camera, session: &Session, report: &mut Report) {
    if style.legend.is_some() && !legend::has_room(camera.width, camera.height) {
        let warning = format!(
            "{}x{} pixels have no room for a legend that can be read: none is drawn; make the picture larger with --size",
            camera.width, camera.height
        );
        session.tell(&format!("warning: {warning}"));
        report.warnings.push(warning);
    }
}

/// How many layers a file holds at most.
pub fn most_layers(style: &Style) -> Option<usize> {
    style.max_layers.map(|most| most as usize)
}

/// What a picture's file says of itself.
pub fn picture_info(report: &Report, camera: &Camera) -> PictureInfo {
    PictureInfo {
        scene: report.scene.clone(),
        units: report.units.clone(),
        px_per_unit: match camera.projection {
            Projection::Orthographic { px_per_unit } => Some(px_per_unit),
            Projection::Perspective { .. } => None,
        },
    }
}

/// What the files of one picture are made of.
pub struct Files<'a> {
    /// The picture, and its layers where a file holds them.
    pub drawn: (&'a Picture, Option<&'a LayerStack>),
    /// How it was drawn.
    pub look: Look,
    /// Layers of an EXR at most.
    pub max_layers: Option<usize>,
    /// What the files say of themselves.
    pub info: PictureInfo,
}

impl Files<'_> {
    /// Writes one of them.
    pub fn write(&self, format: PictureFormat, destination: &Destination, overwrite: bool) -> Result<(), OutputError> {
        let (picture, stack) = self.drawn;
        match (format, stack) {
            (PictureFormat::Exr, Some(stack)) => {
                exr::write(picture, stack, &self.look.light, self.max_layers, &self.info, destination, overwrite)
            }
            _ => png::write(picture, &self.info, destination, overwrite),
        }
    }
}

/// Makes the folder for maps; refuses one with pictures in it that may not be replaced.
fn maps_folder(folder: &Path, session: &Session) -> anyhow::Result<()> {
    let unusable = || format!("{}: no folder can be made there", folder.display());
    std::fs::create_dir_all(folder).with_context(unusable)?;
    let mut files = std::fs::read_dir(folder).with_context(unusable)?.filter_map(Result::ok).map(|entry| entry.path());
    let picture = files.find(|path| path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("png")));
    // Which layers there are is not known before they are drawn: any picture might be one of them.
    picture.map_or(Ok(()), |path| Ok(Destination::from(path.as_path()).check(session.overwrite())?))
}

/// Whether any leaf is points, whose relief ambient shade brings out.
pub fn has_points(loaded: &LoadedScene) -> bool {
    loaded.geometry.iter().any(|geometry| matches!(geometry, LeafGeometry::Cloud(_)))
}

/// Where the pictures go, each with its format; checked before anything is drawn.
fn outputs(args: &RenderArgs, session: &Session) -> anyhow::Result<Vec<(Destination, PictureFormat)>> {
    let default = [PathBuf::from(format!("{}.png", input::name(&args.scene)))];
    let paths = if args.output.is_empty() { &default[..] } else { &args.output };
    let mut outputs: Vec<(Destination, PictureFormat)> = Vec::new();
    for path in paths {
        let destination = Destination::from(path.as_path());
        let extension = path.extension().map(|extension| extension.to_ascii_lowercase());
        let format = match extension.as_ref().and_then(|extension| extension.to_str()) {
            _ if destination == Destination::Stdout => PictureFormat::Png,
            Some("png") => PictureFormat::Png,
            Some("exr") => PictureFormat::Exr,
            _ => return Err(OutputError::UnknownFormat { path: path.clone() }.into()),
        };
        if outputs.iter().any(|(other, _)| *other == destination) {
            return Err(UsageError(format!("{destination} is named twice as output: name it once")).into());
        }
        destination.check(session.overwrite())?;
        outputs.push((destination, format));
    }
    let pictures_on_stdout = outputs.iter().any(|(destination, _)| *destination == Destination::Stdout);
    if pictures_on_stdout && session.summary_destination() == Some(Destination::Stdout) {
        let problem = "the picture and the summary cannot both go to standard output: give one of them a file";
        return Err(UsageError(problem.into()).into());
    }
    Ok(outputs)
}

/// Whether any leaf lets light through, whatever the style.
pub fn is_transparent(loaded: &LoadedScene) -> bool {
    loaded.scene.leaves.iter().any(|leaf| leaf.opacity < 1.0) || loaded.has_own_opacities()
}

/// What the flags leave open: all boundaries where they show or are written, else the nearest.
pub fn frame_args(view: &ViewArgs, loaded: &LoadedScene, style: &Style, wants_layers: bool) -> FrameArgs {
    let open = if wants_layers || is_transparent(loaded) || style.needs_all_layers() {
        LayerLimit::All
    } else {
        LayerLimit::Nearest
    };
    FrameArgs { samples: view.samples, limit: view.layers.unwrap_or(open), is_picture: true }
}

pub fn describe(
    args: &RenderArgs,
    camera: &Camera,
    frame: FrameArgs,
    style: &Style,
    loaded: &LoadedScene,
    report: &mut Report,
) {
    let pipeline = &args.pipeline;
    let splat = pipeline.splat_settings();
    let layers = if frame.limit == LayerLimit::All { "all" } else { "nearest" };
    let settings = [
        ("clip", json!(splat.clip.name())),
        ("inside", json!(splat.inside.name())),
        ("unknown", json!(splat.unknown.name())),
        ("partners", json!(splat.partners.name())),
        ("max_error_px", json!(pipeline.density.max_error)),
        ("spacing", json!(pipeline.density.spacing)),
        ("samples", json!(frame.samples)),
        ("layers", json!(layers)),
        ("width", json!(camera.width)),
        ("height", json!(camera.height)),
        ("background", json!(loaded.scene.background_for(style))),
        ("style", json!(style.kind.name())),
    ];
    report.settings.extend(settings.map(|(key, value)| (key.to_owned(), value)));
}

/// How pictures are drawn.
pub struct Drawing<'a> {
    /// What draws.
    pub engine: &'a dyn Engine,
    /// Where it draws, where that is not the CPU.
    pub device: Option<&'a Device<'a>>,
    /// How surfaces look.
    pub look: Look,
    /// The style.
    pub style: Style,
    /// What the style knows of leaves.
    pub leaves: Leaves<'a>,
    /// Pictures that are composed with the result.
    pub contents: &'a Contents,
    /// The shadows that fall on it.
    pub shadows: Option<&'a ShadowPass>,
    /// How many layers `engine` hands over.
    pub limit: LayerLimit,
    /// A layer with fewer pixels is the first that is left out, where deeper ones show.
    pub min_pixels: Option<u64>,
    /// Whether an output holds layers.
    pub wants_layers: bool,
    /// Whether it is to be told how many layers there are, for their maps.
    pub wants_maps: bool,
    /// For progress.
    pub bars: Bars,
}

/// What was drawn.
pub struct Drawn {
    /// The picture.
    pub picture: Picture,
    /// Its layers, where an output holds them.
    pub stack: Option<LayerStack>,
    /// The style that it is drawn in, with as many layers as are worth drawing.
    pub style: Style,
    /// How many layers there are, where they were counted.
    pub layers: Option<usize>,
}

impl Drawing<'_> {
    /// One picture, with its layers where an output holds them.
    pub fn draw(&self, camera: &Camera, report: &mut Report) -> anyhow::Result<Drawn> {
        if let Some((picture, cost)) = report.phase("frame", || self.of_device(camera))? {
            // Its time is the frame's: a device is not waited for in between.
            if let Some(cost) = cost {
                cost.tell_counts(report);
            }
            return Ok(Drawn { picture, stack: None, style: self.style, layers: None });
        }
        let source = report.phase("prepare", || backend::source(self.device, self.engine, camera))?;
        let stack = self.wants_layers.then(|| report.phase("frame", || LayerStack::collect(&*source)));
        let source: &dyn LayerSource = stack.as_ref().map_or(&*source, |stack| stack);
        let mut style = self.style;
        let mut counts = None;
        if let Some(min_pixels) = self.min_pixels.filter(|_| self.shows_layers()) {
            let counted = report.phase("count", || LayerCounts::of(source));
            let most = tell_layers(&counted, min_pixels, &style, report);
            style.max_layers = Some(most.max(1) as u32);
            counts = Some(counted);
        }
        // A limit alone needs no pass of its own: the layers are counted as they are drawn.
        let is_limited = style.max_layers.is_some() && self.shows_layers();
        let counted = (counts.is_none() && (is_limited || self.wants_maps)).then(|| Counted::new(source));
        let source = counted.as_ref().map_or(source, |counted| counted);
        let bar = self.bars.count(tile_count(camera), "drawing");
        let watch = Stopwatch::start();
        let (picture, cost) = self.styled(source, &style, &|| bar.inc(1))?;
        let of_shadows = cost.map_or(Times::default(), |cost| cost.tell(report));
        report.add_phase("frame", watch.times() - of_shadows);
        bar.finish_and_clear();
        if let Some(counted) = counted.map(Counted::into_counts) {
            if is_limited {
                tell_layers(&counted, 0, &style, report);
            }
            counts = Some(counted);
        }
        Ok(Drawn { picture, stack, style, layers: counts.map(|counts| counts.pixels.len()) })
    }

    /// The picture, where a device can draw all of it: what counts, keeps or mixes layers is the CPU's.
    fn of_device(&self, camera: &Camera) -> anyhow::Result<Option<(Picture, Option<ShadowCost>)>> {
        let is_counted = self.min_pixels.is_some() || self.style.max_layers.is_some();
        let needs_layers = self.wants_layers
            || self.wants_maps
            || self.style.legend.is_some()
            || !self.contents.is_empty()
            || (is_counted && self.shows_layers());
        match self.device {
            Some(device) if !needs_layers => {
                device.picture(self.engine, camera, &self.look, &self.style, self.leaves, self.shadows)
            }
            _ => Ok(None),
        }
    }

    /// Whether what is drawn, or written, depends on deeper layers than the nearest, so that a limit changes it.
    fn shows_layers(&self) -> bool {
        self.limit == LayerLimit::All && (self.wants_layers || self.style.needs_all_layers())
    }

    /// Writes what the picture is made of into `folder`.
    pub fn dump_maps(&self, camera: &Camera, style: &Style, folder: &Path, session: &Session) -> anyhow::Result<()> {
        let source = backend::source(self.device, self.engine, camera)?;
        let (maps, _) = self.shadowed(camera, |shadows| maps(&*source, &self.look, style, self.leaves, shadows))?;
        let destinations: Vec<Destination> =
            maps.iter().map(|map| Destination::from(folder.join(format!("{}.png", map.name)).as_path())).collect();
        for (map, destination) in maps.into_iter().zip(&destinations) {
            let picture = RgbImage::from_raw(map.width, map.height, map.rgb).expect("a map has three bytes a pixel");
            png::write_rgb(&picture, destination, session.overwrite())?;
        }
        session.tell(&format!("wrote {} maps to {}", destinations.len(), folder.display()));
        Ok(())
    }

    fn styled(
        &self,
        source: &dyn LayerSource,
        style: &Style,
        on_tile: &(dyn Fn() + Sync),
    ) -> anyhow::Result<(Picture, Option<ShadowCost>)> {
        self.shadowed(source.camera(), |shadows| {
            styled_with(source, &self.look, style, self.leaves, self.contents, shadows, on_tile)
        })
    }

    /// What `draw` makes of the shadows that `camera` sees, and what they took.
    fn shadowed<T>(
        &self,
        camera: &Camera,
        draw: impl FnOnce(Option<&Shadows>) -> T,
    ) -> anyhow::Result<(T, Option<ShadowCost>)> {
        match self.shadows {
            Some(pass) => {
                pass.with(self.engine, camera, |shadows| draw(Some(shadows))).map(|(drawn, cost)| (drawn, Some(cost)))
            }
            None => Ok((draw(None), None)),
        }
    }

    /// The medians of `repeats` frames after a warm-up, the camera turned by one degree each time, so that nothing of a
    /// frame can be kept for the next.
    fn repeat(
        &self,
        camera: &Camera,
        style: &Style,
        centre: DVec3,
        repeats: u32,
    ) -> anyhow::Result<Option<FrameTimes>> {
        let bar = self.bars.count(u64::from(repeats), "repeating");
        let mut times: Vec<Times> = Vec::new();
        for turn in 0..=repeats {
            let turned = turned(camera, centre, f64::from(turn))?;
            // A light that stays where it is sees the same again.
            if let Some(pass) = self.shadows {
                pass.forget();
            }
            let watch = Stopwatch::start();
            match self.of_device(&turned)? {
                Some(picture) => drop(std::hint::black_box(picture)),
                None => {
                    let source = backend::source(self.device, self.engine, &turned)?;
                    std::hint::black_box(self.styled(&*source, style, &|| ())?);
                }
            }
            if turn > 0 {
                times.push(watch.times());
                bar.inc(1);
            }
        }
        bar.finish_and_clear();
        Ok(FrameTimes::median(&times))
    }
}

/// Reports how many layers of at least `min_pixels` pixels are drawn in `style`, which it returns, and what is left out.
fn tell_layers(counts: &LayerCounts, min_pixels: u64, style: &Style, report: &mut Report) -> usize {
    let most = counts.worth(min_pixels, most_layers(style));
    let left_out = counts.left_out(most);
    report.count("layers", counts.pixels.len() as u64);
    report.count("layers_drawn", most as u64);
    report.share("pixels_left_out", left_out.pixels);
    report.share("boundaries_left_out", left_out.boundaries);
    most
}

/// `camera` moved by `degrees` around `centre`, about its own upward axis.
pub fn turned(camera: &Camera, centre: DVec3, degrees: f64) -> Result<Camera, CameraError> {
    let turn = DQuat::from_axis_angle(-camera.down, degrees.to_radians());
    let eye = centre + turn * (camera.eye - centre);
    // The lens is replaced below: what the old camera's pixels measure stays.
    let any_lens = Lens::Height(1.0);
    let moved = Camera::look_at(eye, eye + turn * camera.forward, -camera.down, any_lens, camera.width, camera.height)?;
    Ok(Camera { projection: camera.projection, ..moved })
}

/// What there is to say of the frames that `engine` has drawn.
pub fn tell_of(engine: &dyn Engine, session: &Session, report: &mut Report) {
    for warning in engine.warnings() {
        session.tell(&format!("warning: {warning}"));
        report.warnings.push(warning);
    }
    let undecided = engine.undecided();
    if !undecided.is_empty() {
        report.count("undecided_pixels", undecided.iter().map(|(_, pixels)| pixels).sum());
    }
}

/// The pictures that `--merge` names.
pub fn contents(paths: &[PathBuf], camera: &Camera) -> Result<Contents, DepthPictureError> {
    let read = |path: &PathBuf| depth_picture::read(path, (camera.width, camera.height));
    Ok(Contents::new(paths.iter().map(read).collect::<Result<_, _>>()?))
}

/// What a limit of layers leaves out, for the user.
pub fn left_out_text(report: &Report) -> Option<String> {
    let (pixels, boundaries) = (report.shares.get("pixels_left_out")?, report.shares.get("boundaries_left_out")?);
    let (drawn, all) = (report.counts.get("layers_drawn")?, report.counts.get("layers")?);
    Some(format!(
        "{drawn} of {all} layers: {:.3} % of the pixels lack one, {:.3} % of all boundaries are left out",
        100.0 * pixels,
        100.0 * boundaries
    ))
}

/// The times of the phases, for the user.
pub fn times_text(report: &Report) -> String {
    let phases: Vec<String> = report.phases.iter().map(|(name, times)| format!("{name} {:.0} ms", times.ms)).collect();
    let frame = report.frame.map(|frame| {
        format!("; frame {:.1} ms, {:.1} ms of CPU (median of {})", frame.ms, frame.cpu_ms, frame.repeats)
    });
    format!("{}{}", phases.join(", "), frame.unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_turn_keeps_the_centre_in_its_pixel() {
        let centre = DVec3::new(0.3, -0.2, 0.1);
        for lens in [Lens::FovY(35.0), Lens::Height(3.0)] {
            let camera = Camera::look_at(DVec3::new(4.0, -5.0, 3.0), centre, DVec3::Z, lens, 64, 48).unwrap();
            for degrees in [1.0, 90.0, 180.0] {
                let turned = turned(&camera, centre, degrees).unwrap();
                let px = |camera: &Camera| camera.px_from_view(camera.view_from_world(centre));
                assert!((px(&turned) - px(&camera)).length() < 1e-9);
                assert_eq!(turned.projection, camera.projection);
                let angle = (turned.eye - centre).angle_between(camera.eye - centre).to_degrees();
                assert!(angle > 0.5 && angle < degrees + 1e-6);
            }
        }
    }
}
