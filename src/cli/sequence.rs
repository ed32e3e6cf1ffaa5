//! `surfcut render --turntable` and `--animate`: many frames of a scene, converted once.
//!
//! *Practice.* A frame is drawn when one of its files is missing, and a film is joined from frames that are kept beside it
//! until it is whole. So a run that is stopped, however it is stopped, has lost one frame at most.

use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};

use glam::DQuat;
use serde_json::json;
use surfcut::composite::section::Hatching;
use surfcut::composite::{Leaves, Look};
use surfcut::csg::LeafId;
use surfcut::output::film::{self, FilmFormat};
use surfcut::output::frames::{FRAME_MARK, FrameNames, Frames, RunKey};
use surfcut::output::report::{FrameTimes, Stopwatch, Times};
use surfcut::output::{Destination, OutputError};
use surfcut::scene::{Animation, LeafSource, LoadedScene, Truth};
use surfcut::space::{Camera, CameraError, Motion};
use twox_hash::XxHash3_128;

use super::args::{Operands, RenderArgs};
use super::backend::Device;
use super::engine::engine;
use super::failure::{InputError, UsageError, code};
use super::memory::Held;
use super::progress::Bars;
use super::render::{
    Drawing, Drawn, Files, PictureFormat, contents, describe, frame_args, has_points, leaf_colours, leaf_names,
    left_out_text, most_layers, opened, picture_info, tell_of, times_text, warn_of_legend,
};
use super::shadows::{ShadowPass, warn_of_shadows};
use super::{Session, input, memory};

/// The most frames of a sequence: over an hour at 24 a second.
const MOST_FRAMES: usize = 100_000;

/// What one frame shows.
struct Shot {
    camera: Camera,
    /// Of the leaves that are elsewhere than the scene has them.
    motions: Vec<(LeafId, Motion)>,
}

impl Shot {
    fn motion(&self, leaf: LeafId) -> Motion {
        self.motions.iter().find(|(other, _)| *other == leaf).map_or(Motion::REST, |(_, motion)| *motion)
    }
}

/// Draws the frames that are missing and joins the films.
pub fn run(args: &RenderArgs, session: &Session) -> anyhow::Result<u8> {
    let targets = Targets::of(args, session)?;
    let (mut report, mut loaded) = opened(args, session)?;
    let shots = shots(args, &loaded)?;
    let merged = merged(&args.view.merge, shots.len())?;
    let key = run_key(args, &loaded, &merged, shots.len())?;
    let mut targets = targets.open(&key, session)?;
    let wants_layers = targets.frames.iter().any(|(_, format)| *format == PictureFormat::Exr);
    // Surfels are made for the camera that sees most of them.
    let closest = closest(&shots, &loaded);
    let style = args.style.style(&loaded.scene.style, args.view.max_layers).for_points(has_points(&loaded));
    memory::check(&closest.camera, Held::picture(wants_layers, merged.len()))?;
    let frame = frame_args(&args.view, &loaded, &style, wants_layers);
    describe(args, &closest.camera, frame, &style, &loaded, &mut report);
    warn_of_legend(&style, &closest.camera, session, &mut report);
    warn_of_shadows(&style, session, &mut report);
    let missing: Vec<usize> = (0..shots.len()).filter(|&frame| targets.lacks(frame)).collect();
    report.settings.insert("fps".to_owned(), json!(args.sequence.fps));
    report.count("leaves", loaded.scene.leaves.len() as u64);
    report.count("frames", shots.len() as u64);
    report.count("frames_kept", (shots.len() - missing.len()) as u64);
    if missing.len() < shots.len() {
        session.tell(&format!("{} of {} frames are there already", shots.len() - missing.len(), shots.len()));
    }
    if !missing.is_empty() {
        let told = report.warnings.len();
        let look = Look { light: loaded.scene.light, background: loaded.scene.background_for(&style) };
        let leaf_colours = leaf_colours(&loaded);
        let names = leaf_names(&loaded);
        let at_rest = Hatching::of_scene(&loaded, &style);
        let mut shadows = ShadowPass::of_scene(&loaded, &style);
        let device = Device::open(&args.backend, session)?;
        let on = (&closest.camera, device.is_some());
        let mut engine = engine(&mut loaded, &args.pipeline, frame, on, session.bars, &mut report)?;
        report.settings.insert("pipeline".to_owned(), json!(engine.pipeline()));
        report.warnings[told..].iter().for_each(|warning| session.tell(&format!("warning: {warning}")));
        report.settings.insert("backend".to_owned(), json!(device.as_ref().map_or("cpu".to_owned(), Device::name)));
        let bar = session.bars.count(missing.len() as u64, "frames");
        let mut times: Vec<Times> = Vec::new();
        let mut covered = 0;
        // The leaves that are elsewhere than the scene has them.
        let mut pose: Vec<(LeafId, Motion)> = Vec::new();
        for &index in &missing {
            let shot = &shots[index];
            let merged: Vec<PathBuf> = merged.iter().map(|names| names.path(index)).collect();
            let contents = report.phase("load", || contents(&merged, &shot.camera))?;
            let watch = Stopwatch::start();
            if shot.motions != pose {
                report.phase("move", || engine.pose(&shot.motions))?;
                pose.clone_from(&shot.motions);
                if let Some(shadows) = &mut shadows {
                    shadows.moved(loaded.drawn_within(|leaf| shot.motion(leaf)));
                }
            }
            let hatching = at_rest.moved(|leaf| shot.motion(leaf));
            let heavy = hatching.heavy();
            let drawing = Drawing {
                engine: &*engine,
                device: device.as_ref(),
                look,
                style,
                leaves: Leaves { colours: &leaf_colours, heavy: &heavy, hatching: Some(&hatching), names: &names },
                contents: &contents,
                shadows: shadows.as_ref(),
                limit: frame.limit,
                min_pixels: args.view.min_pixels,
                wants_layers,
                wants_maps: false,
                bars: Bars::hidden(),
            };
            let Drawn { picture, stack, style, .. } = drawing.draw(&shot.camera, &mut report)?;
            times.push(watch.times());
            covered += picture.covered;
            let info = picture_info(&report, &shot.camera);
            let files = Files { drawn: (&picture, stack.as_ref()), look, max_layers: most_layers(&style), info };
            report.phase("write", || targets.write(index, &files))?;
            bar.inc(1);
        }
        bar.finish_and_clear();
        tell_of(&*engine, session, &mut report);
        report.frame = FrameTimes::median(&times);
        report.count("pixels_covered", covered);
        if covered == 0 {
            let warning = "every frame is empty: no surface of the result is in view; `surfcut check` tells whether the \
                           result is empty, an input is inside-out, or the camera looks elsewhere";
            report.warnings.push(warning.into());
            session.tell(&format!("warning: {warning}"));
        }
    }
    left_out_text(&report).into_iter().for_each(|text| session.tell(&text));
    report.phase("join", || targets.join(args.sequence.fps, session))?;
    session.tell(&times_text(&report));
    session.write_summary(&report.to_json())?;
    Ok(code::OK)
}

/// The files that frames are composed with, one of each name for every frame.
fn merged(paths: &[PathBuf], frames: usize) -> Result<Vec<FrameNames>, UsageError> {
    let names = |path: &PathBuf| {
        FrameNames::parse(path, frames).ok_or_else(|| {
            UsageError(format!(
                "--merge {} is one picture for many frames, whose cameras differ: put {FRAME_MARK} into its name, for one \
                 picture a frame, numbered from 0000",
                path.display()
            ))
        })
    };
    paths.iter().map(names).collect()
}

/// What every frame shows.
fn shots(args: &RenderArgs, loaded: &LoadedScene) -> anyhow::Result<Vec<Shot>> {
    let camera = &args.view.camera;
    if let Some(frames) = args.sequence.turntable {
        let spec = input::changed(loaded.camera_spec(), camera);
        let first = input::camera_of(spec, loaded.scene.size, camera)?;
        // The camera was made with this direction, so it has a length.
        let up = spec.up.normalize();
        let centre = camera.at.unwrap_or(spec.target);
        let shot = |frame: u32| {
            let turn = DQuat::from_axis_angle(up, std::f64::consts::TAU * f64::from(frame) / f64::from(frames));
            let turned = Camera {
                eye: centre + turn * (first.eye - centre),
                right: turn * first.right,
                down: turn * first.down,
                forward: turn * first.forward,
                ..first.clone()
            };
            Shot { camera: turned, motions: Vec::new() }
        };
        return Ok((0..frames).map(shot).collect());
    }
    let animation = loaded.scene.animation.as_ref().ok_or_else(|| {
        InputError(
            "the scene has no keyframes to animate: add two or more `[[keyframe]]` tables, or use --turntable"
                .to_owned(),
        )
    })?;
    animated(animation, args, loaded)
}

fn animated(animation: &Animation, args: &RenderArgs, loaded: &LoadedScene) -> anyhow::Result<Vec<Shot>> {
    let fps = args.sequence.fps;
    let frames = animation.frames(fps);
    if !(frames <= MOST_FRAMES as f64) {
        let problem = format!(
            "the keyframes make {frames} frames at {fps} a second, more than {MOST_FRAMES}: bring them closer together, or \
             lower --fps"
        );
        return Err(InputError(problem).into());
    }
    let own = loaded.camera_spec();
    (0..frames as usize)
        .map(|frame| {
            let time = animation.time_of(frame, fps);
            let spec = input::changed(animation.camera_at(own, time), &args.view.camera);
            let camera = input::camera_of(spec, loaded.scene.size, &args.view.camera)
                .map_err(|source: CameraError| InputError(format!("frame {frame}, at time {time:.3}: {source}")))?;
            let motions = animation.leaves.iter().map(|keys| (keys.leaf, keys.motion(time)));
            let motions = motions.filter(|(_, motion)| *motion != Motion::REST).collect();
            Ok(Shot { camera, motions })
        })
        .collect()
}

/// The shot whose pixels are smallest at the middle of the scene; the first of several.
fn closest<'s>(shots: &'s [Shot], loaded: &LoadedScene) -> &'s Shot {
    let middle = loaded.extent().bounds().map_or(loaded.camera_spec().target, |bounds| bounds.centre());
    let footprint = |shot: &Shot| {
        let depth = shot.camera.view_from_world(middle).z;
        // Behind the eye it is not seen.
        if depth > 0.0 { shot.camera.footprint(depth) } else { f64::INFINITY }
    };
    let mut best = &shots[0];
    for shot in shots {
        if footprint(shot) < footprint(best) {
            best = shot;
        }
    }
    best
}

/// What the frames depend on: the flags that a frame depends on, and the scene with the content of its files and of those
/// that its frames are merged with.
fn run_key(args: &RenderArgs, loaded: &LoadedScene, merged: &[FrameNames], frames: usize) -> anyhow::Result<RunKey> {
    let hash = |text: &str| format!("{:032x}", XxHash3_128::oneshot(text.as_bytes()));
    let mut flags = args.clone();
    // Where frames go, and what is in the scene, does not belong to the flags.
    flags.output.clear();
    flags.scene.input.clear();
    flags.scene.operands = Operands::default();
    if flags.sequence.turntable.is_some() {
        flags.sequence.fps = 0.0;
    }
    let content = |path: &Path| -> anyhow::Result<PathBuf> {
        let unreadable = |error| InputError(format!("{}: the file cannot be read: {error}", path.display()));
        Ok(format!("{:032x}", XxHash3_128::oneshot(&fs::read(path).map_err(unreadable)?)).into())
    };
    let mut scene = loaded.scene.clone();
    for leaf in &mut scene.leaves {
        if let LeafSource::File(path) = &mut leaf.source {
            *path = content(path)?;
        }
        if let Some(Truth::File(path)) = &mut leaf.truth {
            *path = content(path)?;
        }
    }
    let merged = merged.iter().flat_map(|names| (0..frames).map(|frame| names.path(frame)));
    let merged: Vec<PathBuf> = merged.map(|path| content(&path)).collect::<Result<_, _>>()?;
    Ok(RunKey {
        surfcut: env!("CARGO_PKG_VERSION").to_owned(),
        frames,
        settings: hash(&format!("{flags:?}")),
        scene: hash(&format!("{scene:?}{merged:?}")),
    })
}

/// A film, and where its frames are.
struct Film {
    destination: Destination,
    format: FilmFormat,
    /// Which of the sequence's files.
    frames: usize,
    /// The folder of frames that are there for the film alone.
    own_folder: Option<PathBuf>,
}

/// What is to be written, as the command line says it.
struct Targets {
    patterns: Vec<(PathBuf, PictureFormat)>,
    films: Vec<Film>,
}

impl Targets {
    /// Checks the names.
    fn of(args: &RenderArgs, session: &Session) -> anyhow::Result<Self> {
        let default = [PathBuf::from(format!("{}_{FRAME_MARK}.png", input::name(&args.scene)))];
        let paths = if args.output.is_empty() { &default[..] } else { &args.output };
        let mut targets = Self { patterns: Vec::new(), films: Vec::new() };
        for path in paths {
            let twice = paths.iter().filter(|other| *other == path).count() > 1;
            if twice {
                return Err(UsageError(format!("{} is named twice as output: name it once", path.display())).into());
            }
            let destination = Destination::from(path.as_path());
            if destination == Destination::Stdout {
                let problem = "a sequence cannot go to standard output: name files, or a film (.gif, .apng)";
                return Err(UsageError(problem.into()).into());
            }
            if let Some(format) = FilmFormat::of(path) {
                destination.check(session.overwrite())?;
                targets.films.push(Film { destination, format, frames: 0, own_folder: None });
                continue;
            }
            let extension = path.extension().map(|extension| extension.to_ascii_lowercase());
            let format = match extension.as_ref().and_then(|extension| extension.to_str()) {
                Some("png") => PictureFormat::Png,
                Some("exr") => PictureFormat::Exr,
                _ => return Err(OutputError::UnknownFormat { path: path.clone() }.into()),
            };
            if FrameNames::parse(path, 1).is_none() {
                return Err(UsageError(format!(
                    "{} names one file for many frames: put {FRAME_MARK} into its name, as in {}_{FRAME_MARK}.{}, or name a \
                     film (.gif, .apng)",
                    path.display(),
                    path.file_stem().unwrap_or_default().to_string_lossy(),
                    extension.unwrap_or_default().to_string_lossy(),
                ))
                .into());
            }
            targets.patterns.push((path.clone(), format));
        }
        // A film is joined from PNG files that are wanted anyway, or from its own.
        for film in 0..targets.films.len() {
            let wanted = targets.patterns.iter().position(|(_, format)| *format == PictureFormat::Png);
            targets.films[film].frames = wanted.unwrap_or(targets.patterns.len());
            if let (None, Destination::File(path)) = (wanted, &targets.films[film].destination) {
                let folder = with_suffix(path, ".frames");
                targets.patterns.push((folder.join(format!("{FRAME_MARK}.png")), PictureFormat::Png));
                targets.films[film].own_folder = Some(folder);
            }
        }
        Ok(targets)
    }

    /// Begins the files of frames, or goes on with them.
    fn open(self, key: &RunKey, session: &Session) -> anyhow::Result<OpenTargets> {
        let command: Vec<String> = std::env::args().collect();
        let mut targets = OpenTargets { frames: Vec::new(), films: self.films, count: key.frames };
        for folder in targets.films.iter().filter_map(|film| film.own_folder.as_ref()) {
            match fs::create_dir(folder) {
                Err(source) if source.kind() != std::io::ErrorKind::AlreadyExists => {
                    return Err(OutputError::Io { destination: Destination::File(folder.clone()), source }.into());
                }
                _ => {}
            }
        }
        for (pattern, format) in self.patterns {
            let names = FrameNames::parse(&pattern, key.frames).expect("a pattern holds the frame's mark");
            targets.frames.push((Frames::open(names, key, &command, session.overwrite())?, format));
        }
        Ok(targets)
    }
}

/// What is being written.
struct OpenTargets {
    frames: Vec<(Frames, PictureFormat)>,
    films: Vec<Film>,
    count: usize,
}

impl OpenTargets {
    /// Whether a file of frame `frame` is missing.
    fn lacks(&self, frame: usize) -> bool {
        self.frames.iter().any(|(frames, _)| !frames.is_done(frame))
    }

    /// Writes the files of frame `frame` that are missing.
    fn write(&mut self, frame: usize, files: &Files) -> Result<(), OutputError> {
        for (frames, format) in self.frames.iter_mut().filter(|(frames, _)| !frames.is_done(frame)) {
            frames.write(frame, |destination| files.write(*format, destination, true))?;
        }
        Ok(())
    }

    /// Joins the films, and removes the frames that were there for them alone.
    fn join(&self, fps: f64, session: &Session) -> anyhow::Result<()> {
        for (frames, _) in &self.frames {
            if !self.films.iter().any(|film| film.own_folder.as_deref() == Some(frames.names().directory())) {
                let (first, last) = (frames.names().path(0), frames.names().path(self.count - 1));
                session.tell(&format!("wrote {} to {}", first.display(), last.display()));
            }
        }
        for film in &self.films {
            let names = self.frames[film.frames].0.names();
            let paths: Vec<PathBuf> = (0..self.count).map(|frame| names.path(frame)).collect();
            let bar = session.bars.count(self.count as u64, "joining");
            film::join(&paths, fps, film.format, &film.destination, session.overwrite(), &|| bar.inc(1))?;
            bar.finish_and_clear();
            session.tell(&format!("wrote {} ({} frames)", film.destination, self.count));
        }
        // Films may share frames, so all are joined first. What else the user has put there stays, and so does its folder.
        for film in &self.films {
            if film.own_folder.is_none() {
                continue;
            }
            let names = self.frames[film.frames].0.names();
            let own = (0..self.count).map(|frame| names.path(frame)).chain([names.record_path()]);
            own.for_each(|path| drop(fs::remove_file(path)));
        }
        Ok(())
    }
}

impl Drop for OpenTargets {
    /// Where no frame was drawn, nothing is left behind.
    fn drop(&mut self) {
        for folder in self.films.iter().filter_map(|film| film.own_folder.as_ref()) {
            // Only where it is empty.
            let _ = fs::remove_dir(folder);
        }
    }
}

/// `path` with `suffix` behind its name.
fn with_suffix(path: &Path, suffix: &str) -> PathBuf {
    let mut name = path.file_name().map_or_else(OsString::new, ToOwned::to_owned);
    name.push(suffix);
    path.with_file_name(name)
}
