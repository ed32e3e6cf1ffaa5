//! `surfcut compare`: two pipelines or settings on one scene, measured.

use serde_json::json;
use surfcut::composite::{Look, shaded};
use surfcut::layers::{LayerLimit, LayerStack};
use surfcut::measure::quality::quality;
use surfcut::measure::{compare, difference};
use surfcut::output::report::{Report, Stopwatch};
use surfcut::output::{Destination, png};
use surfcut::scene::LoadedScene;
use surfcut::scene::style::Style;
use surfcut::space::Camera;

use super::args::{CompareArgs, PipelineArgs};
use super::engine::{FrameArgs, engine};
use super::failure::code;
use super::memory::Held;
use super::{Session, input, memory};

mod ways;

/// Draws the scene twice and measures the first picture against the second.
pub fn run(args: &CompareArgs, session: &Session) -> anyhow::Result<u8> {
    let difference_destination = args.difference.as_deref().map(Destination::from);
    if let Some(destination) = &difference_destination {
        destination.check(session.overwrite())?;
    }
    let mut report = Report::new(std::env::args().collect());
    let loaded = report.phase("load", || input::loaded(&args.scene, Some(&args.view), session.bars))?;
    let camera = input::camera(&loaded, &args.view.camera)?;
    memory::check(&camera, Held::COMPARISON)?;
    // All boundaries unless asked otherwise: how many there are is one of the measures.
    let limit = args.view.layers.unwrap_or(LayerLimit::All);
    let frame = FrameArgs { samples: args.view.samples, limit, is_picture: true };
    let with = PipelineArgs {
        pipeline: args.with,
        clip: args.with_clip,
        inside: args.with_inside,
        unknown: args.with_unknown,
        partners: args.with_partners,
        ..args.pipeline.clone()
    };
    if !args.ways.is_empty() {
        return ways::run(args, &loaded, &with, (frame, &camera), session, report);
    }
    let test = draw(loaded.clone(), &args.pipeline, frame, &camera, session, &mut report, "frame")?;
    let look = Look { light: loaded.scene.light, background: loaded.scene.background_for(&Style::default()) };
    let truth = draw(loaded, &with, frame, &camera, session, &mut report, "second_frame")?;
    let comparison = compare(&test, &truth)?;
    let pictures = [&test, &truth].map(|stack| png::rgb(&shaded(stack, &look, &|| ())));
    let covered = |stack: &LayerStack, i: u32| !stack.at(i % camera.width, i / camera.width).is_empty();
    let mask: Vec<bool> = (0..camera.width * camera.height).map(|i| covered(&test, i) || covered(&truth, i)).collect();
    let likeness = quality(&pictures[0], &pictures[1], &mask)?;
    if let Some(destination) = &difference_destination {
        let picture = difference::difference_picture(&test, &truth)?;
        png::write_rgb(&picture, destination, session.overwrite())?;
        session.tell(&format!("wrote {destination} ({}x{})", picture.width(), picture.height()));
    }
    let psnr = likeness.psnr.map_or("no difference".to_owned(), |psnr| format!("{psnr:.2} dB"));
    let times: String = report
        .phases
        .iter()
        .map(|(name, times)| format!("{name}: {:.1} ms, {:.1} ms of CPU\n", times.ms, times.cpu_ms))
        .collect();
    session.print(&format!("{}ssim {:.5}\npsnr {psnr}\n{times}", comparison.to_text(), likeness.ssim))?;
    let mut summary = serde_json::to_string_pretty(&json!({
        "surfcut": report.surfcut,
        "command": report.command,
        "comparison": comparison,
        "ssim": likeness.ssim,
        "psnr": likeness.psnr,
        "phases": report.phases,
        "counts": report.counts,
    }))?;
    summary.push('\n');
    session.write_summary(&summary)?;
    Ok(code::OK)
}

/// One picture's layers; the frame's time goes to the phase called `phase`.
fn draw(
    mut loaded: LoadedScene,
    args: &PipelineArgs,
    frame: FrameArgs,
    camera: &Camera,
    session: &Session,
    report: &mut Report,
    phase: &str,
) -> anyhow::Result<LayerStack> {
    let engine = engine(&mut loaded, args, frame, (camera, false), session.bars, report)?;
    let watch = Stopwatch::start();
    let stack = LayerStack::collect(&*engine.frame(camera)?);
    report.add_phase(phase, watch.times());
    Ok(stack)
}
