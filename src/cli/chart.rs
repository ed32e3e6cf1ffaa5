//! `surfcut chart`: accuracy against time over the settings that trade them.
//!
//! The reference draws each view once; the scene is converted and classified once. Every setting then draws each view
//! with that one model: once to warm up and to be measured against the reference, and as often as asked for its time. A
//! frame's time is all that a moving camera pays: binning, partners found in the picture, splatting, shading.

use std::ffi::OsStr;
use std::hint::black_box;
use std::path::Path;

use serde_json::json;
use surfcut::composite::{Look, shaded};
use surfcut::layers::LayerStack;
use surfcut::measure::chart::{Chart, Point, Series};
use surfcut::measure::outline::zoomed_onto_cut;
use surfcut::measure::{Comparison, compare};
use surfcut::output::Destination;
use surfcut::output::report::{FrameTimes, Report, Stopwatch};
use surfcut::scene::style::Style;
use surfcut::space::Camera;
use surfcut::splat::{Clip, Inside, SplatSettings};

use super::args::ChartArgs;
use super::engine::{self, Engine, SplatScene};
use super::failure::{InputError, UsageError, code};
use super::memory::Held;
use super::render::frame_args;
use super::{Session, input, memory};

/// The files of a chart, by their endings.
const ENDINGS: [&str; 4] = ["svg", "png", "csv", "json"];

/// A line of the chart's legend: the settings that it joins, each with its label.
struct Curve {
    name: &'static str,
    settings: Vec<(&'static str, SplatSettings)>,
}

/// One view and what is truly seen there.
struct View {
    magnification: f64,
    camera: Camera,
    truth: LayerStack,
}

/// One setting at one view.
struct Measured {
    comparison: Comparison,
    times: FrameTimes,
}

/// Draws, measures, and writes the chart; what would be refused is refused before the first ray.
pub fn run(args: &ChartArgs, session: &Session) -> anyhow::Result<u8> {
    let destinations = destinations(&args.output, session)?;
    let mut report = Report::new(std::env::args().collect());
    let mut loaded = report.phase("load", || input::loaded(&args.scene, Some(&args.view), session.bars))?;
    let camera = input::camera(&loaded, &args.view.camera)?;
    memory::check(&camera, Held::COMPARISON)?;
    let frame = frame_args(&args.view, &loaded, &Style::default(), false);
    let look = Look { light: loaded.scene.light, background: loaded.scene.background_for(&Style::default()) };
    let reference = engine::reference(&loaded, frame)?;
    let views = report.phase("reference", || views(&*reference, &camera, args, session))?;
    let mut scene = SplatScene::new(&mut loaded, args.density.density(), &camera, session.bars, &mut report)?;

    let curves = curves();
    let settings: usize = curves.iter().map(|curve| curve.settings.len()).sum();
    let frames = settings as u64 * views.len() as u64 * (1 + u64::from(args.repeat));
    let bar = session.bars.count(frames, "drawing");
    let mut series = Vec::new();
    let mut points = Vec::new();
    let mut table = format!("{:<22} {:<12} {:>10} {:>10} {:>10}\n", "series", "setting", "cpu_ms", "ms", "edge_px");
    for view in &views {
        for curve in &curves {
            let name = format!("{}, {}x", curve.name, view.magnification);
            let mut of_series = Vec::new();
            for (label, settings) in &curve.settings {
                let engine = scene.engine(*settings, frame, &mut report);
                let Measured { comparison, times } = measure(&*engine, view, &look, args.repeat, &|| bar.inc(1))?;
                let edge_px = comparison.edge_px.ok_or_else(|| no_cut_edge(view.magnification))?;
                table.push_str(&format!(
                    "{name:<22} {label:<12} {:>10.2} {:>10.2} {edge_px:>10.5}\n",
                    times.cpu_ms, times.ms
                ));
                of_series.push(Point { label: (*label).to_owned(), x: times.cpu_ms, y: edge_px });
                points.push(json!({
                    "magnification": view.magnification,
                    "clip": settings.clip.name(),
                    "inside": settings.inside.name(),
                    "unknown": settings.unknown.name(),
                    "partners": settings.partners.name(),
                    "frame": times,
                    "comparison": comparison,
                }));
            }
            series.push(Series { name, points: of_series });
        }
    }
    bar.finish_and_clear();

    let title = format!("Accuracy against time: {}", input::name(&args.scene));
    let mut chart = Chart::accuracy_against_time(title, series);
    chart.x.label = "processor time of a frame [ms]".to_owned();
    for (destination, (_, content)) in destinations.iter().zip(chart.files()?) {
        destination.write(session.overwrite(), &content)?;
        session.tell(&format!("wrote {destination}"));
    }
    session.print(&table)?;
    let mut summary = serde_json::to_string_pretty(&json!({
        "surfcut": report.surfcut,
        "command": report.command,
        "points": points,
        "phases": report.phases,
        "counts": report.counts,
    }))?;
    summary.push('\n');
    session.write_summary(&summary)?;
    Ok(code::OK)
}

/// The settings that trade accuracy against time, and the paper's own choice beside them.
fn curves() -> Vec<Curve> {
    let of_clip = |clip: Clip| Curve {
        name: clip.name(),
        settings: Inside::ALL
            .map(|inside| (inside.name(), SplatSettings { clip, inside, ..SplatSettings::default() }))
            .to_vec(),
    };
    let paper = Curve { name: "paper", settings: vec![("paper", SplatSettings::PAPER)] };
    vec![of_clip(Clip::Surface), of_clip(Clip::Fragment), paper]
}

/// The four files, in the order of [`Chart::files`], each known to be writable.
fn destinations(name: &Path, session: &Session) -> anyhow::Result<Vec<Destination>> {
    let stem = match name.file_name() {
        Some(stem) if stem != OsStr::new("-") => stem,
        _ => {
            let problem = format!("{} names no file: a chart is four files, such as chart.svg", name.display());
            return Err(UsageError(problem).into());
        }
    };
    let mut destinations = Vec::new();
    for ending in ENDINGS {
        let mut file = stem.to_owned();
        file.push(".");
        file.push(ending);
        let destination = Destination::File(name.with_file_name(file));
        if session.summary_destination().as_ref() == Some(&destination) {
            let problem = format!("{destination} would be both chart and summary: give the summary another name");
            return Err(UsageError(problem).into());
        }
        destination.check(session.overwrite())?;
        destinations.push(destination);
    }
    Ok(destinations)
}

/// The views that the flags ask for, each drawn once by the judge.
fn views(reference: &dyn Engine, camera: &Camera, args: &ChartArgs, session: &Session) -> anyhow::Result<Vec<View>> {
    let bar = session.bars.count(args.magnify.len() as u64, "reference");
    // What was drawn on the way to one magnification is the truth of another.
    let mut drawn: Vec<LayerStack> = Vec::new();
    let mut truth_at = |camera: &Camera| -> anyhow::Result<LayerStack> {
        if let Some(known) = drawn.iter().find(|stack| stack.camera == *camera) {
            return Ok(known.clone());
        }
        let stack = LayerStack::collect(&*reference.frame(camera)?);
        drawn.push(stack.clone());
        Ok(stack)
    };
    let mut views = Vec::new();
    for &magnification in &args.magnify {
        let camera =
            zoomed_onto_cut(camera, magnification, &mut truth_at)?.ok_or_else(|| no_cut_edge(magnification))?;
        let truth = truth_at(&camera)?;
        views.push(View { magnification, camera, truth });
        bar.inc(1);
    }
    bar.finish_and_clear();
    Ok(views)
}

/// One frame measured against the truth, which warms up too, then the median time of `repeats` frames. Nothing of a frame
/// is kept for the next but what [`SplatScene`] keeps for all views.
fn measure(
    engine: &dyn Engine,
    view: &View,
    look: &Look,
    repeats: u32,
    progress: &dyn Fn(),
) -> anyhow::Result<Measured> {
    let comparison = compare(&LayerStack::collect(&*engine.frame(&view.camera)?), &view.truth)?;
    progress();
    let mut frames = Vec::new();
    for _ in 0..repeats {
        let watch = Stopwatch::start();
        black_box(shaded(&*engine.frame(&view.camera)?, look, &|| ()));
        frames.push(watch.times());
        progress();
    }
    // At least one frame is asked for, so there is a median.
    let times = FrameTimes::median(&frames).unwrap_or(FrameTimes { ms: 0.0, cpu_ms: 0.0, repeats: 0 });
    Ok(Measured { comparison, times })
}

fn no_cut_edge(magnification: f64) -> InputError {
    InputError(format!(
        "no two surfaces of the result meet in the picture at magnification {magnification}, so there is no cut edge to \
         measure at: aim the camera at one with --eye, --target or --zoom and --at, or draw a scene that is cut"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_are_charted_once_each() {
        let all: Vec<SplatSettings> =
            curves().iter().flat_map(|curve| curve.settings.iter().map(|(_, settings)| *settings)).collect();
        let distinct: std::collections::HashSet<_> = all.iter().collect();
        assert_eq!(distinct.len(), all.len());
        assert!(distinct.contains(&SplatSettings::default()) && distinct.contains(&SplatSettings::PAPER));
    }

    #[test]
    fn the_endings_are_those_of_the_chart() {
        let point = Point { label: String::new(), x: 1.0, y: 1.0 };
        let chart = Chart::accuracy_against_time("a", vec![Series { name: String::new(), points: vec![point] }]);
        assert_eq!(chart.files().unwrap().map(|file| file.0), ENDINGS);
    }
}
