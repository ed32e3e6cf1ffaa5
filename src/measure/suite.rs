//! Runs cases through any pipeline under several settings, judges every picture, and writes tables.
//!
//! A pipeline plugs in as a closure that makes a scene ready once ([`Open`]) and returns another that draws it from any
//! camera ([`Drawer`]): so what is kept between frames is timed as `prepare`, and sampling stays what it was at 1×.

use std::cell::RefCell;
use std::error::Error;
use std::fmt::Write as _;

use glam::DQuat;
use serde::Serialize;

use super::chart::{Point, Series};
use super::compare::{Comparison, compare};
use super::outline::zoomed_onto_cut;
use super::scenes::Case;
use crate::layers::LayerStack;
use crate::output::report::{FrameTimes, Stopwatch, Times};
use crate::scene::{LeafSource, Scene};
use crate::space::{Camera, Projection};

/// Whatever kept a scene from being opened or drawn.
pub type DrawError = Box<dyn Error + Send + Sync>;

/// A scene that is ready to be drawn from any camera.
pub type Drawer = Box<dyn Fn(&Camera) -> Result<LayerStack, DrawError>>;

/// Makes a scene ready under settings of type `S`.
pub type Open<'a, S> = &'a dyn Fn(&Scene, &S) -> Result<Drawer, DrawError>;

/// One way to draw, with its name in tables.
#[derive(Debug, Clone)]
pub struct Setting<S> {
    /// Its name.
    pub name: String,
    /// What the pipeline is given.
    pub value: S,
}

/// How a suite is run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SuiteOptions {
    /// Frames that are timed after the one that is judged; with 0 the judged frame, which is cold, is timed.
    pub repeats: u32,
    /// A picture size instead of the cases' own.
    pub size: Option<(u32, u32)>,
}

/// What was measured of one picture.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Measured {
    /// Against the truth.
    pub comparison: Comparison,
    /// Times of a frame.
    pub frame: FrameTimes,
    /// Times of everything before the first frame, once per case and setting.
    pub prepare: Times,
}

/// What became of one picture.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// It was drawn and judged.
    Measured(Box<Measured>),
    /// It could not be: the reason.
    Failed(String),
}

/// One picture: a case under a setting at a magnification.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// The case's name.
    pub case: String,
    /// How far a sweep pushed it.
    pub parameter: Option<f64>,
    /// Points of all leaves.
    pub points: usize,
    /// The setting's name.
    pub setting: String,
    /// Magnification.
    pub zoom: f64,
    /// `edge_px` may be at most this.
    pub edge_px_bar: Option<f64>,
    /// `wrong_pixels` may be at most this.
    pub wrong_pixels_bar: Option<f64>,
    /// What became of it.
    pub outcome: Outcome,
}

impl Row {
    /// The measures, where there are any.
    pub fn measured(&self) -> Option<&Measured> {
        match &self.outcome {
            Outcome::Measured(measured) => Some(measured),
            Outcome::Failed(_) => None,
        }
    }

    /// Whether it was drawn and keeps its bars; a truth without cut edge fails a bar on `edge_px`.
    pub fn passes(&self) -> bool {
        self.measured().is_some_and(|measured| {
            let c = &measured.comparison;
            self.edge_px_bar.is_none_or(|bar| c.edge_px.is_some_and(|edge_px| edge_px <= bar))
                && self.wrong_pixels_bar.is_none_or(|bar| c.wrong_pixels <= bar)
        })
    }
}

/// The rows of a suite, in the order in which they were drawn: by case, by setting, by magnification.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Table {
    /// One per picture.
    pub rows: Vec<Row>,
}

/// Draws every case under every setting at every of its magnifications and judges it against what `open_truth` draws.
/// `on_row` hears of every picture as soon as it is done. A picture that cannot be drawn is a failed row, not an error.
pub fn run<S>(
    cases: &[Case],
    settings: &[Setting<S>],
    open: Open<'_, S>,
    open_truth: &dyn Fn(&Scene) -> Result<Drawer, DrawError>,
    options: SuiteOptions,
    on_row: &mut dyn FnMut(&Row),
) -> Table {
    let mut table = Table::default();
    for case in cases {
        let views = views(case, open_truth, options.size);
        for setting in settings {
            let opened = views.as_ref().map_err(Clone::clone).and_then(|(scene, _)| {
                let watch = Stopwatch::start();
                let drawer = open(scene, &setting.value).map_err(|error| error.to_string())?;
                Ok((drawer, watch.times()))
            });
            for (i, &zoom) in case.zooms.iter().enumerate() {
                let outcome = opened.as_ref().map_err(Clone::clone).and_then(|(drawer, prepare)| {
                    let (_, views) = views.as_ref().map_err(Clone::clone)?;
                    let truth = views[i].as_ref().map_err(Clone::clone)?;
                    measure(drawer, *prepare, truth, zoom, options.repeats).map_err(|error| error.to_string())
                });
                let points = views.as_ref().map_or(0, |(scene, _)| points_of(scene));
                let row = Row {
                    case: case.name.clone(),
                    parameter: case.parameter,
                    points,
                    setting: setting.name.clone(),
                    zoom,
                    edge_px_bar: case.bars.edge_px(zoom),
                    wrong_pixels_bar: case.bars.wrong_pixels,
                    outcome: outcome.map_or_else(Outcome::Failed, |measured| Outcome::Measured(Box::new(measured))),
                };
                on_row(&row);
                table.rows.push(row);
            }
        }
    }
    table
}

fn points_of(scene: &Scene) -> usize {
    let points = |source: &LeafSource| if let LeafSource::Cloud(cloud) = source { cloud.len() } else { 0 };
    scene.leaves.iter().map(|leaf| points(&leaf.source)).sum()
}

/// The truth's picture at one magnification, or why there is none.
type TruthView = Result<LayerStack, String>;

/// The scene of a case and its truth at each magnification.
fn views(
    case: &Case,
    open_truth: &dyn Fn(&Scene) -> Result<Drawer, DrawError>,
    size: Option<(u32, u32)>,
) -> Result<(Scene, Vec<TruthView>), String> {
    let mut scene = case.scene().map_err(|error| error.to_string())?;
    scene.size = size.unwrap_or(scene.size);
    let camera = case.camera.camera(scene.size).map_err(|error| error.to_string())?;
    let draw = open_truth(&scene).map_err(|error| error.to_string())?;
    // Ever larger magnifications pass through the same views on the way.
    let drawn: RefCell<Vec<LayerStack>> = RefCell::default();
    let draw_once = |camera: &Camera| {
        if let Some(known) = drawn.borrow().iter().find(|stack| stack.camera == *camera) {
            return Ok(known.clone());
        }
        let stack = draw(camera).map_err(|error| error.to_string())?;
        drawn.borrow_mut().push(stack.clone());
        Ok(stack)
    };
    let view = |zoom: f64| {
        let onto_cut = zoomed_onto_cut(&camera, zoom, &mut |camera| draw_once(camera))?;
        draw_once(&onto_cut.ok_or("the truth has no cut edge to zoom onto")?)
    };
    let views = case.zooms.iter().map(|&zoom| view(zoom)).collect();
    Ok((scene, views))
}

fn measure(
    drawer: &Drawer,
    prepare: Times,
    truth: &LayerStack,
    zoom: f64,
    repeats: u32,
) -> Result<Measured, DrawError> {
    // Degrees by which each timed frame is turned on, as an animation would; less where a pixel is smaller.
    const TURN_DEG: f64 = 1.0;
    let timed = |camera: &Camera| {
        let watch = Stopwatch::start();
        let stack = drawer(camera)?;
        Ok::<_, DrawError>((stack, watch.times()))
    };
    let (stack, cold) = timed(&truth.camera)?;
    let comparison = compare(&stack, truth)?;
    let mut times = Vec::new();
    for step in 1..=repeats {
        times.push(timed(&turned(truth, TURN_DEG / zoom * f64::from(step)))?.1);
    }
    let cold = FrameTimes { ms: cold.ms, cpu_ms: cold.cpu_ms, repeats: 0 };
    Ok(Measured { comparison, frame: FrameTimes::median(&times).unwrap_or(cold), prepare })
}

/// The camera of `stack` turned by `degrees` about what it sees in the middle.
fn turned(stack: &LayerStack, degrees: f64) -> Camera {
    let camera = &stack.camera;
    let middle = stack.at(camera.width / 2, camera.height / 2).first();
    // Where the middle is empty, turn about the point where a picture's height is as far away as it is tall.
    let depth = middle.map_or_else(
        || match camera.projection {
            Projection::Perspective { focal_px } => focal_px / f64::from(camera.height),
            Projection::Orthographic { px_per_unit } => f64::from(camera.height) / px_per_unit,
        },
        |boundary| f64::from(boundary.depth),
    );
    let pivot = camera.eye + camera.forward * depth;
    let turn = DQuat::from_axis_angle(camera.down, degrees.to_radians());
    Camera {
        eye: pivot + turn * (camera.eye - pivot),
        right: turn * camera.right,
        down: turn * camera.down,
        forward: turn * camera.forward,
        ..camera.clone()
    }
}

impl Table {
    /// Whether every row was drawn and keeps its bars.
    pub fn passes(&self) -> bool {
        self.rows.iter().all(Row::passes)
    }

    /// All rows as a Markdown table. Figures beyond their bar are bold, and the bar stands behind them.
    pub fn markdown(&self) -> String {
        let mut cells = vec![
            [
                "scene",
                "points",
                "setting",
                "zoom",
                "edge px",
                "95 %",
                "max",
                "wrong %",
                "near edge %",
                "holes",
                "spill",
                "depth px",
                "normal °",
                "frame ms",
                "CPU ms",
                "prepare ms",
            ]
            .map(str::to_owned)
            .to_vec(),
        ];
        for row in &self.rows {
            let mut line =
                vec![row.case.clone(), row.points.to_string(), row.setting.clone(), format!("{}×", row.zoom)];
            match &row.outcome {
                Outcome::Failed(reason) => line.push(format!("failed: {}", reason.replace('|', "\\|"))),
                Outcome::Measured(measured) => {
                    let c = &measured.comparison;
                    let edge = |value: Option<f64>| value.map_or("none".to_owned(), short);
                    let judged = |value: Option<f64>, bar: Option<f64>, show: &dyn Fn(f64) -> String| {
                        let text = value.map_or("none".to_owned(), show);
                        match bar {
                            Some(bar) if !value.is_some_and(|value| value <= bar) => {
                                format!("**{text}** (≤ {})", show(bar))
                            }
                            _ => text,
                        }
                    };
                    line.push(judged(c.edge_px, row.edge_px_bar, &short));
                    line.extend([edge(c.edge_px_p95), edge(c.edge_px_max)]);
                    line.push(judged(Some(c.wrong_pixels), row.wrong_pixels_bar, &|share| short(100.0 * share)));
                    line.push(short(100.0 * c.near_edge_wrong));
                    line.extend([c.holes.to_string(), c.spill.to_string()]);
                    line.extend([edge(c.depth_px), edge(c.normal_deg)]);
                    let times = [measured.frame.ms, measured.frame.cpu_ms, measured.prepare.ms];
                    line.extend(times.map(|ms| format!("{ms:.0}")));
                }
            }
            cells.push(line);
        }
        markdown_table(&cells)
    }

    /// One figure as a Markdown table: a line per case and magnification, a column per setting. `first` heads the first
    /// column, which holds the parameter of a sweep, else the case's name.
    pub fn pivot(&self, first: &str, figure: &dyn Fn(&Measured) -> String) -> String {
        let mut settings: Vec<&str> = Vec::new();
        for row in &self.rows {
            if !settings.contains(&row.setting.as_str()) {
                settings.push(&row.setting);
            }
        }
        let mut header = vec![first.to_owned(), "zoom".to_owned()];
        header.extend(settings.iter().map(|&setting| setting.to_owned()));
        let mut cells = vec![header];
        let mut done: Vec<(&str, f64)> = Vec::new();
        for row in &self.rows {
            if done.contains(&(row.case.as_str(), row.zoom)) {
                continue;
            }
            done.push((&row.case, row.zoom));
            let name = row.parameter.map_or_else(|| row.case.clone(), |parameter| parameter.to_string());
            let mut line = vec![name, format!("{}×", row.zoom)];
            for setting in &settings {
                let same = |other: &&Row| other.case == row.case && other.zoom == row.zoom && other.setting == *setting;
                let cell = self.rows.iter().find(same).map(|row| row.measured().map_or("failed".to_owned(), figure));
                line.push(cell.unwrap_or_default());
            }
            cells.push(line);
        }
        markdown_table(&cells)
    }

    /// For [`Chart::accuracy_against_time`](super::chart::Chart::accuracy_against_time): a series per setting, a point per
    /// case, at one magnification. Pictures that failed, or whose truth has no cut edge, are not in it.
    pub fn accuracy_series(&self, zoom: f64) -> Vec<Series> {
        let mut all: Vec<Series> = Vec::new();
        for row in self.rows.iter().filter(|row| row.zoom == zoom) {
            let Some((measured, edge_px)) = row.measured().and_then(|m| Some((m, m.comparison.edge_px?))) else {
                continue;
            };
            let point = Point { label: row.case.clone(), x: measured.frame.ms, y: edge_px };
            match all.iter_mut().find(|series| series.name == row.setting) {
                Some(series) => series.points.push(point),
                None => all.push(Series { name: row.setting.clone(), points: vec![point] }),
            }
        }
        all
    }
}

/// Three significant digits, without an exponent.
pub fn short(value: f64) -> String {
    const DIGITS: i32 = 3;
    if value == 0.0 || !value.is_finite() {
        return value.to_string();
    }
    let before_point = value.abs().log10().floor() as i32 + 1;
    format!("{value:.*}", (DIGITS - before_point).clamp(0, 6) as usize)
}

/// Aligned Markdown; the first line is the header, short lines are filled up.
fn markdown_table(cells: &[Vec<String>]) -> String {
    let columns = cells.iter().map(Vec::len).max().unwrap_or(0);
    let width = |column: usize| cells.iter().filter_map(|line| line.get(column)).map(|c| c.chars().count()).max();
    let widths: Vec<usize> = (0..columns).map(|column| width(column).unwrap_or(0).max(3)).collect();
    let mut text = String::new();
    for (i, line) in cells.iter().enumerate() {
        for (column, width) in widths.iter().enumerate() {
            let cell = line.get(column).map_or("", String::as_str);
            let _ = write!(text, "| {cell:<width$} ");
        }
        text.push_str("|\n");
        if i == 0 {
            widths.iter().for_each(|width| {
                let _ = write!(text, "| {:-<width$} ", "");
            });
            text.push_str("|\n");
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layers::{Boundary, LayerLimit};
    use crate::measure::open::open_reference;
    use crate::measure::scenes::{Bars, density};

    /// Two spheres of few points, small and quick.
    fn case() -> Case {
        let bars = Bars { edge_px_at_1: Some(0.5), edge_px_at_100: Some(0.5), wrong_pixels: Some(0.01) };
        Case { size: (96, 96), bars, ..density("two_balls", 300, 3) }
    }

    /// A pipeline that draws the truth, with the leaves swapped to the left of `wrong_columns`.
    fn open_wrong(scene: &Scene, wrong_columns: &u32) -> Result<Drawer, DrawError> {
        let wrong_columns = *wrong_columns;
        if wrong_columns > 1000 {
            return Err("no such pipeline".into());
        }
        let truth = open_reference(scene, LayerLimit::Nearest)?;
        Ok(Box::new(move |camera| {
            let stack = truth(camera)?;
            Ok(LayerStack::from_fn(camera.clone(), 1, |x, y| {
                let swap = |b: &Boundary| Boundary { leaf: if x < wrong_columns { 1 - b.leaf } else { b.leaf }, ..*b };
                stack.at(x, y).iter().map(swap).collect()
            }))
        }))
    }

    fn run_with(settings: &[(&str, u32)], repeats: u32) -> Table {
        let setting = |&(name, value): &(&str, u32)| Setting { name: name.to_owned(), value };
        let settings: Vec<_> = settings.iter().map(setting).collect();
        let mut heard = 0;
        let options = SuiteOptions { repeats, size: None };
        let open_truth = |scene: &Scene| open_reference(scene, LayerLimit::Nearest);
        let table = run(&[case()], &settings, &open_wrong, &open_truth, options, &mut |_| heard += 1);
        assert_eq!(heard, table.rows.len());
        table
    }

    #[test]
    fn a_right_pipeline_passes_and_a_wrong_one_does_not() {
        let table = run_with(&[("right", 0), ("wrong", 96)], 1);
        assert_eq!(table.rows.len(), 6);
        for row in &table.rows {
            let measured = row.measured().unwrap();
            assert_eq!(row.passes(), row.setting == "right", "{row:?}");
            assert!(measured.comparison.cut_edge_length_px > 50.0, "{row:?}");
            assert_eq!((measured.frame.repeats, row.points), (1, 400));
            if row.setting == "wrong" {
                assert!(measured.comparison.edge_px.unwrap() > 5.0);
            }
        }
        assert!(!table.passes());
        assert!(run_with(&[("right", 0)], 0).passes());
    }

    #[test]
    fn a_pipeline_that_fails_is_a_row_that_says_why() {
        let table = run_with(&[("absent", 2000)], 0);
        assert!(table.rows.iter().all(|row| row.outcome == Outcome::Failed("no such pipeline".to_owned())));
        assert!(!table.passes() && table.markdown().contains("failed: no such pipeline"));
    }

    #[test]
    fn tables_and_charts_hold_every_figure() {
        let table = run_with(&[("right", 0), ("wrong", 96)], 0);
        let markdown = table.markdown();
        assert_eq!(markdown.lines().count(), 2 + 6);
        assert!(markdown.contains("(≤ 0.5") && markdown.contains("two_balls"), "{markdown}");
        let widths: Vec<usize> = markdown.lines().map(|line| line.chars().count()).collect();
        assert!(widths.iter().all(|width| *width == widths[0]));
        let pivot = table.pivot("scene", &|measured| measured.comparison.holes.to_string());
        assert_eq!(pivot.lines().count(), 2 + 3);
        assert!(pivot.lines().next().unwrap().contains("right"));
        let series = table.accuracy_series(100.0);
        assert_eq!((series.len(), series[0].points.len()), (2, 1));
        assert_eq!((series[0].name.as_str(), series[0].points[0].y), ("right", 0.0));
        assert!(serde_json::to_string(&table).unwrap().contains("\"edge_px\":0.0"));
    }

    #[test]
    fn numbers_are_short() {
        assert_eq!([0.0, 0.0123456, 1.23456, 123.456, 12345.6].map(short), ["0", "0.0123", "1.23", "123", "12346"]);
    }
}
