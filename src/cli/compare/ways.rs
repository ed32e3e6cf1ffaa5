//! `surfcut compare --as`: one scene drawn in several ways, each measured against the same picture, as one table.

use std::borrow::Cow;

use serde_json::json;
use surfcut::composite::{Look, shaded};
use surfcut::geometry::Solid;
use surfcut::layers::LayerStack;
use surfcut::measure::compare;
use surfcut::measure::quality::quality;
use surfcut::output::png;
use surfcut::output::report::{Report, Stopwatch};
use surfcut::scene::style::Style;
use surfcut::scene::{LeafGeometry, LoadedScene, Representation};
use surfcut::space::Camera;

use super::super::Session;
use super::super::args::{CompareArgs, Pipeline, PipelineArgs, Way};
use super::super::engine::{FrameArgs, engine};
use super::super::failure::code;

impl Way {
    fn name(self) -> &'static str {
        match self {
            Self::Splats => "splats",
            Self::Meshes => "meshes",
            Self::Hybrid => "hybrid",
        }
    }

    /// The scene as it is drawn this way, and the pipeline that draws it.
    fn of(self, loaded: &LoadedScene) -> (LoadedScene, Pipeline) {
        let mut loaded = loaded.clone();
        match self {
            Self::Hybrid => (loaded, Pipeline::Hybrid),
            Self::Splats => {
                loaded.scene.leaves.iter_mut().for_each(|leaf| leaf.represent = Some(Representation::Surfels));
                (loaded, Pipeline::Auto)
            }
            Self::Meshes => {
                let mut loaded = loaded.as_truths();
                for (leaf, geometry) in loaded.scene.leaves.iter_mut().zip(&loaded.geometry) {
                    let is_endless = matches!(geometry, LeafGeometry::Solid(Solid::HalfSpace { .. }));
                    leaf.represent = Some(if is_endless { Representation::Exact } else { Representation::Mesh });
                }
                (loaded, Pipeline::Mesh)
            }
        }
    }
}

/// Column heads of the table, and what is in them.
const COLUMNS: [&str; 13] = [
    "way",
    "surfels",
    "triangles",
    "wrong_%",
    "edge_px",
    "p95",
    "max",
    "depth_px",
    "normal_deg",
    "ssim",
    "psnr_db",
    "prepare_cpu_ms",
    "frame_cpu_ms",
];

/// Draws `loaded` in every way of `args` and once `with` the pipeline that they are measured against.
pub fn run(
    args: &CompareArgs,
    loaded: &LoadedScene,
    with: &PipelineArgs,
    (frame, camera): (FrameArgs, &Camera),
    session: &Session,
    mut report: Report,
) -> anyhow::Result<u8> {
    let truth = super::draw(loaded.clone(), with, frame, camera, session, &mut report, "second_frame")?;
    let look = Look { light: loaded.scene.light, background: loaded.scene.background_for(&Style::default()) };
    let true_picture = png::rgb(&shaded(&truth, &look, &|| ()));
    let mut rows = vec![COLUMNS.map(str::to_owned)];
    let mut summaries = Vec::new();
    for way in &args.ways {
        let (mut scene, pipeline) = way.of(loaded);
        let args = PipelineArgs { pipeline, ..args.pipeline.clone() };
        let mut of_way = Report::new(std::env::args().collect());
        let watch = Stopwatch::start();
        let engine = engine(&mut scene, &args, frame, (camera, false), session.bars, &mut of_way)?;
        let prepare = watch.times();
        // The first frame pays for fresh memory.
        drop(LayerStack::collect(&*engine.frame(camera)?));
        let watch = Stopwatch::start();
        let stack = LayerStack::collect(&*engine.frame(camera)?);
        let drawn = watch.times();
        let comparison = compare(&stack, &truth)?;
        let covered = |stack: &LayerStack, i: u32| !stack.at(i % camera.width, i / camera.width).is_empty();
        let mask: Vec<bool> =
            (0..camera.width * camera.height).map(|i| covered(&stack, i) || covered(&truth, i)).collect();
        let likeness = quality(&png::rgb(&shaded(&stack, &look, &|| ())), &true_picture, &mask)?;
        let count = |name: &str| of_way.counts.get(name).map_or("0".to_owned(), ToString::to_string);
        let number = |value: Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:.4}"));
        rows.push([
            way.name().to_owned(),
            count("surfels"),
            count("triangles"),
            format!("{:.4}", 100.0 * comparison.wrong_pixels),
            number(comparison.edge_px),
            number(comparison.edge_px_p95),
            number(comparison.edge_px_max),
            number(comparison.depth_px),
            number(comparison.normal_deg),
            format!("{:.5}", likeness.ssim),
            likeness.psnr.map_or("-".to_owned(), |psnr| format!("{psnr:.2}")),
            format!("{:.0}", prepare.cpu_ms),
            format!("{:.0}", drawn.cpu_ms),
        ]);
        summaries.push(json!({
            "way": way.name(),
            "pipeline": engine.pipeline(),
            "comparison": comparison,
            "ssim": likeness.ssim,
            "psnr": likeness.psnr,
            "prepare": prepare,
            "frame": drawn,
            "counts": of_way.counts,
        }));
    }
    session.print(&markdown(&rows))?;
    let mut summary = serde_json::to_string_pretty(&json!({
        "surfcut": report.surfcut,
        "command": report.command,
        "ways": summaries,
    }))?;
    summary.push('\n');
    session.write_summary(&summary)?;
    Ok(code::OK)
}

/// The rows, the first one the heads, as an aligned Markdown table.
fn markdown(rows: &[[String; COLUMNS.len()]]) -> String {
    let width = |column: usize| rows.iter().map(|row| row[column].len()).max().unwrap_or(0);
    let line = |cells: [Cow<'_, str>; COLUMNS.len()]| {
        let padded = cells.iter().enumerate().map(|(column, cell)| format!("{cell:>width$}", width = width(column)));
        format!("| {} |\n", padded.collect::<Vec<_>>().join(" | "))
    };
    let mut text = String::new();
    for (number, row) in rows.iter().enumerate() {
        text.push_str(&line(row.each_ref().map(|cell| Cow::Borrowed(cell.as_str()))));
        if number == 0 {
            text.push_str(&line(std::array::from_fn(|column| Cow::Owned("-".repeat(width(column))))));
        }
    }
    text
}
