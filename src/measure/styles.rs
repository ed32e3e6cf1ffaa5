//! How good the styles' pictures are: layers against the reference renderer's, surfels against triangles, lines against noise, fewer
//! layers against more, a frame against the next.
//!
//! `examples/styles.rs` prints the tables; `tests/styles.rs` holds small pictures against the same measures.

use glam::{DQuat, DVec2, DVec3};

use super::line_likeness::{Ink, LayerAgreement, layer_agreement};
use super::open::{open_meshes, open_own_forms, open_reference, open_surfels};
use super::quality::quality;
use super::scenes::{self, Case, CaseLeaf};
use super::simulate::{Sampling, ScanOptions};
use super::suite::DrawError;
use crate::composite::{Leaves, Look, Picture, styled};
use crate::geometry::Solid;
use crate::layers::{LayerLimit, LayerSource, LayerStack};
use crate::output::png;
use crate::pipeline::Density;
use crate::scene::style::{LineSettings, Style, StyleKind};
use crate::scene::{LeafSource, Representation, Scene};
use crate::space::Camera;
use crate::splat::SplatSettings;

/// How closely solids are sampled and tessellated where surfels are compared with meshes.
const TESSELLATED: Density = Density::MaxErrorPx(0.1);

/// The scene's own camera.
///
/// # Errors
/// Where it names none, or one that cannot be.
pub fn camera(scene: &Scene) -> Result<Camera, DrawError> {
    Ok(scene.camera.ok_or("the scene names no camera")?.camera(scene.size)?)
}

/// `source` in `style`, with the scene's light and paper.
pub fn drawn(source: &dyn LayerSource, scene: &Scene, style: &Style) -> Picture {
    let look = Look { light: scene.light, background: scene.background_for(style) };
    styled(source, &look, style, Leaves::default(), &|| ())
}

/// Black lines on white; `scene` gets the paper.
fn plain_lines(scene: &mut Scene) -> Style {
    scene.background = Some([1.0; 4]);
    let lines = LineSettings { ink: Some([0.0; 3]), ..LineSettings::default() };
    Style { lines, fade: 0.0, ..Style::of(StyleKind::Wireframe) }
}

/// By pixel: whether the stack shows anything there.
fn covered(stack: &LayerStack) -> Vec<bool> {
    let (width, height) = (stack.camera.width, stack.camera.height);
    (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| !stack.at(x, y).is_empty()).collect()
}

fn ssim(a: &Picture, b: &Picture, covered: &[bool]) -> Result<f64, DrawError> {
    Ok(quality(&png::rgb(a), &png::rgb(b), covered)?.ssim)
}

/// The layers of every pipeline that can draw `scene`, against the reference renderer's, with the pipeline's name.
///
/// # Errors
/// Where the scene cannot be loaded, or points have no truth.
pub fn layers_against_truth(scene: &Scene) -> Result<Vec<(&'static str, LayerAgreement)>, DrawError> {
    let camera = camera(scene)?;
    let truth = open_reference(scene, LayerLimit::All)?(&camera)?;
    let clipped = SplatSettings {
        clip: crate::splat::Clip::Surface,
        partners: crate::splat::Partners::ClipBuffer,
        ..SplatSettings::default()
    };
    let mut pipelines = vec![
        ("surfels", open_surfels(scene, LayerLimit::All, clipped)?),
        ("hybrid", open_own_forms(scene, LayerLimit::All, Density::default())?),
    ];
    if scene.leaves.iter().all(|leaf| matches!(leaf.source, LeafSource::Solid(_))) {
        pipelines.push(("mesh", open_meshes(scene, LayerLimit::All, Density::default())?));
    }
    let agreement =
        |(name, drawer): (&'static str, super::suite::Drawer)| Ok((name, layer_agreement(&drawer(&camera)?, &truth)));
    pipelines.into_iter().map(agreement).collect()
}

/// How alike pictures of one scene of solids are from surfels alone and from triangles alone.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PipelineLikeness {
    /// Structural similarity of the shaded pictures.
    pub shaded: f64,
    /// Of the transparent ones.
    pub transparent: f64,
    /// The share of either drawing's lines within a pixel of the other's, the lesser of the two; 0 to 1.
    pub lines: f64,
}

/// Compares surfels and nothing else with triangles and nothing else, both of solids to a tenth of a pixel.
///
/// # Errors
/// Where the scene cannot be loaded, or has points.
pub fn surfels_against_meshes(scene: &Scene) -> Result<PipelineLikeness, DrawError> {
    let mut scene = scene.clone();
    let camera = camera(&scene)?;
    scene.leaves.iter_mut().for_each(|leaf| leaf.represent = Some(Representation::Surfels));
    let surfels = open_own_forms(&scene, LayerLimit::All, TESSELLATED)?(&camera)?;
    scene.leaves.iter_mut().for_each(|leaf| leaf.represent = Some(Representation::Mesh));
    let meshes = open_meshes(&scene, LayerLimit::All, TESSELLATED)?(&camera)?;
    let covered = covered(&meshes);
    let likeness = |kind| {
        let [a, b] = [&surfels, &meshes].map(|stack| drawn(stack, &scene, &Style::of(kind)));
        ssim(&a, &b, &covered)
    };
    let (shaded, transparent) = (likeness(StyleKind::Shaded)?, likeness(StyleKind::Transparent)?);
    let lines = plain_lines(&mut scene);
    let [a, b] = [&surfels, &meshes].map(|stack| Ink::black_on_white(&drawn(stack, &scene, &lines)));
    let lines = a.found_in(&b, 1.0).unwrap_or(0.0).min(b.found_in(&a, 1.0).unwrap_or(0.0));
    Ok(PipelineLikeness { shaded, transparent, lines })
}

/// A ball and a block of points, met, and drilled by a cylinder of points: creases wherever two scans meet. `noise` is in
/// spacings, `points` on the ball.
///
/// # Errors
/// Where it cannot be scanned.
pub fn noisy_scan(noise: f64, points: usize, size: (u32, u32)) -> Result<Scene, DrawError> {
    /// The spread of normals that a scanner's software makes of positions with a noise of one spacing, degrees.
    const NORMALS_DEGREES: f64 = 30.0;
    let scan = |count, seed| {
        ScanOptions::regular(count, seed).sampled(Sampling::Poisson).noisy(noise, NORMALS_DEGREES * noise)
    };
    let block = Solid::Box { min: DVec3::splat(-0.8), max: DVec3::splat(0.8) };
    let drill = scenes::cylinder([0.0; 3], [0.0, 0.0, 1.0], 1.5, 0.4);
    let leaves: Vec<CaseLeaf> = vec![
        scenes::leaf("ball", scenes::sphere([0.0; 3], 1.05), scan(points, 11)),
        scenes::leaf("block", block, scan(points, 12)),
        scenes::leaf("drill", drill, scan(points / 2, 13)),
    ];
    let about = "Two scans that meet, drilled by a third";
    let case = Case::new("noisy_scan", about, leaves, "ball & block - drill", scenes::view_from([2.6, -3.4, 2.2]));
    let mut scene = case.scene()?;
    scene.size = size;
    Ok(scene)
}

/// How true the lines of a scan are.
#[derive(Debug, Clone)]
pub struct LineTruth {
    /// The share of its lines within two pixels of the truth's; 0 to 1.
    pub precision: f64,
    /// The share of the truth's lines within two pixels of its; 0 to 1.
    pub recall: f64,
    /// The drawing.
    pub picture: Picture,
}

/// The lines of a scan against those of what was scanned, in the first `max_layers` layers.
///
/// # Errors
/// Where the scene cannot be loaded, or points have no truth.
pub fn lines_of_scan(scene: &Scene, max_layers: Option<u32>) -> Result<LineTruth, DrawError> {
    const NEAR_PX: f64 = 2.0;
    let mut scene = scene.clone();
    let camera = camera(&scene)?;
    let scan = open_surfels(&scene, LayerLimit::All, SplatSettings::default())?(&camera)?;
    let truth = open_reference(&scene, LayerLimit::All)?(&camera)?;
    let style = Style { max_layers, ..plain_lines(&mut scene) };
    let [picture, truth] = [&scan, &truth].map(|stack| drawn(stack, &scene, &style));
    let [lines, true_lines] = [&picture, &truth].map(Ink::black_on_white);
    let found = |a: &Ink, b: &Ink| a.found_in(b, NEAR_PX).unwrap_or(0.0);
    Ok(LineTruth { precision: found(&lines, &true_lines), recall: found(&true_lines, &lines), picture })
}

/// The likeness (SSIM) of pictures of the first `few` and the first `many` layers of a scene of solids, in style `kind`.
///
/// # Errors
/// Where the scene cannot be loaded, or has points.
pub fn fewer_layers(scene: &Scene, kind: StyleKind, few: u32, many: u32) -> Result<f64, DrawError> {
    let stack = open_meshes(scene, LayerLimit::All, Density::default())?(&camera(scene)?)?;
    let style = |most| Style { max_layers: Some(most), ..Style::of(kind) };
    let [a, b] = [few, many].map(|most| drawn(&stack, scene, &style(most)));
    ssim(&a, &b, &covered(&stack))
}

/// How the lines of a sketch move from a frame to the next.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Coherence {
    /// Pixels of line in the first frame.
    pub lines: usize,
    /// The share of them that the next frame has within a pixel of where the geometry's motion brings them; 0 to 1.
    pub within_a_pixel: f64,
    /// The 99th percentile of the distance, pixels.
    pub percentile_99: f64,
}

/// Draws the first layer's lines of a scene of solids sketchily, turns the camera by a degree about the scene's upright axis, and
/// draws them again.
///
/// # Errors
/// Where the scene cannot be loaded, or has points.
pub fn sketch_coherence(scene: &Scene) -> Result<Coherence, DrawError> {
    const REACH_PX: f64 = 12.0;
    let mut scene = scene.clone();
    let first = camera(&scene)?;
    let target = scene.camera.ok_or("the scene names no camera")?.target;
    let turn = DQuat::from_axis_angle(DVec3::Z, 1f64.to_radians());
    let next = Camera {
        eye: target + turn * (first.eye - target),
        right: turn * first.right,
        down: turn * first.down,
        forward: turn * first.forward,
        ..first.clone()
    };
    let mut style = Style { opacity: 0.0, max_layers: Some(1), ..Style::of(StyleKind::Sketchy) };
    style.lines.ink = Some([0.0; 3]);
    // A pixel's depth is the nearer of a line's and a surface's at two places: here one place, so that it is the line's.
    style.sketch.shade_px = style.sketch.edge_px;
    scene.background = Some([1.0; 4]);
    let meshes = open_meshes(&scene, LayerLimit::All, Density::default())?;
    let before = drawn(&meshes(&first)?, &scene, &style);
    let after = Ink::black_on_white(&drawn(&meshes(&next)?, &scene, &style));
    let depth = before.depth.clone().ok_or("a sketch has depths")?;
    let before = Ink::black_on_white(&before);
    let mut beyond: Vec<f64> = Vec::new();
    for (x, y) in before.lines() {
        let px = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
        let z = f64::from(depth[(y * before.width + x) as usize]);
        if z.is_finite() {
            let moved = next.px_from_view(next.view_from_world(first.ray(px).at(z)));
            beyond.push(after.distance(moved, REACH_PX).min(REACH_PX));
        }
    }
    if beyond.is_empty() {
        return Err("the sketch has no lines".into());
    }
    beyond.sort_by(f64::total_cmp);
    let within = beyond.iter().filter(|distance| **distance <= 1.0).count();
    Ok(Coherence {
        lines: beyond.len(),
        within_a_pixel: within as f64 / beyond.len() as f64,
        percentile_99: beyond[beyond.len() * 99 / 100],
    })
}
