//! Every style on the GPU against the same style on the CPU, of the same layers.

use std::path::Path;
use std::sync::LazyLock;

use surfcut::composite::section::Hatching;
use surfcut::composite::{self, Leaves, Look, Picture};
use surfcut::csg::LeafId;
use surfcut::formats::{NoProgress, ReadOptions};
use surfcut::gpu::layers::{GpuLayerSource, GpuLayers, Uploaded};
use surfcut::gpu::{Gpu, GpuError, composite as twin};
use surfcut::layers::{LayerLimit, LayerStack};
use surfcut::pipeline::{Density, ExactLeaves, convert};
use surfcut::scene::style::{CutColour, LineSettings, SketchSettings, Style, StyleKind};
use surfcut::scene::{Scene, load, toml_file};
use surfcut::space::{Camera, PixelRect};

use crate::Test;

pub const TESTS: &[Test] = &[
    ("shaded_and_transparent_pictures_are_the_cpus", shaded_and_transparent_pictures_are_the_cpus),
    ("recoloured_pictures_are_the_cpus", recoloured_pictures_are_the_cpus),
    ("line_pictures_are_the_cpus", line_pictures_are_the_cpus),
    ("wide_dashed_and_few_lines_are_the_cpus", wide_dashed_and_few_lines_are_the_cpus),
    ("outlines_of_leaves_are_the_cpus", outlines_of_leaves_are_the_cpus),
    ("hollows_are_the_cpus", hollows_are_the_cpus),
    ("sketches_are_the_cpus", sketches_are_the_cpus),
    ("hatched_sections_are_the_cpus", hatched_sections_are_the_cpus),
    ("bands_leave_no_trace", bands_leave_no_trace),
    ("a_picture_of_nothing_is_paper", a_picture_of_nothing_is_paper),
    ("the_comparison_of_pictures_can_fail", the_comparison_of_pictures_can_fail),
];

/// A scene's layers, and what styles know of it.
struct Layers {
    name: &'static str,
    samples: u32,
    stack: LayerStack,
    scene: Scene,
    colours: Vec<[f32; 3]>,
    hatching: Hatching,
}

/// Pixels on a side.
const SIDE: u32 = 160;

fn layers(name: &'static str) -> Vec<Layers> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("data/{name}.toml"));
    let scene = Scene { size: (SIDE, SIDE), ..toml_file::read(&path).unwrap() };
    let mut loaded = load(scene, &ReadOptions::default(), &NoProgress).unwrap();
    let camera = loaded.camera().unwrap();
    let colours = (0..loaded.scene.leaves.len() as u32).map(|leaf| loaded.colour(LeafId(leaf))).collect::<Vec<_>>();
    let hatching = Hatching::of_scene(&loaded, &Style::default());
    let converted = convert(&mut loaded, &camera, Density::default(), ExactLeaves::Crossed, &|_| ()).unwrap();
    let model = converted.classify().into_hybrid();
    let of_samples = |samples| Layers {
        name,
        samples,
        stack: LayerStack::collect(&model.frame(&camera, LayerLimit::All, samples)),
        scene: loaded.scene.clone(),
        colours: colours.clone(),
        hatching: hatching.clone(),
    };
    [1, 4].map(of_samples).into()
}

/// The scenes, at one and at four samples a pixel.
static LAYERS: LazyLock<Vec<Layers>> = LazyLock::new(|| {
    ["widget", "spanner", "overlap", "bearing", "drilled_bone"].map(layers).into_iter().flatten().collect()
});

/// Steps of an 8-bit picture by which a pixel may differ.
const MOST_STEPS: f32 = 2.0;
/// The share of pixels that may differ by more.
const MOST_DIFFERENT: f64 = 0.001;
/// Relative difference of depths, which are copied or blended.
const MOST_DEPTH: f32 = 1e-5;

/// How two pictures differ.
#[derive(Debug, Default)]
struct Difference {
    pixels: usize,
    depths: usize,
    most: f32,
}

fn difference(a: &Picture, b: &Picture) -> Difference {
    let mut found = Difference::default();
    for (a, b) in a.pixels.iter().zip(&b.pixels) {
        let off = a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        found.most = found.most.max(off);
        found.pixels += usize::from(!(off <= MOST_STEPS / 255.0));
    }
    if let (Some(a), Some(b)) = (&a.depth, &b.depth) {
        let same = |a: &f32, b: &f32| a == b || (a - b).abs() <= MOST_DEPTH * b.abs();
        found.depths = a.iter().zip(b).filter(|(a, b)| !same(a, b)).count();
    }
    found
}

/// Asserts that the GPU's picture of `layers` is the CPU's.
fn assert_same(gpu: &Gpu, layers: &Layers, style: &Style, leaves: Leaves, what: &str) {
    let look = Look { light: layers.scene.light, background: layers.scene.background_for(style) };
    assert_same_look(gpu, layers, &look, style, leaves, what);
}

fn assert_same_look(gpu: &Gpu, layers: &Layers, look: &Look, style: &Style, leaves: Leaves, what: &str) {
    let wanted = composite::styled(&layers.stack, look, style, leaves, &|| ());
    let source = Uploaded(&layers.stack);
    let got = gpu.checked(|| twin::styled(gpu, &source, look, style, leaves)).unwrap();
    let name = format!("{what}, {} at {} samples", layers.name, layers.samples);
    assert_eq!(
        (got.width, got.height, got.covered, got.has_alpha),
        (wanted.width, wanted.height, wanted.covered, wanted.has_alpha),
        "{name}"
    );
    assert_eq!(got.depth.is_some(), wanted.depth.is_some(), "{name}");
    let found = difference(&got, &wanted);
    let most = (MOST_DIFFERENT * wanted.pixels.len() as f64) as usize;
    assert!(found.pixels <= most && found.depths <= most, "{name}: {found:?}");
}

fn shaded_and_transparent_pictures_are_the_cpus(gpu: &'static Gpu) {
    for layers in LAYERS.iter() {
        for kind in [StyleKind::Shaded, StyleKind::Transparent] {
            assert_same(gpu, layers, &Style::of(kind), Leaves::default(), kind.name());
        }
        let look = Look { light: layers.scene.light, background: [0.0; 4] };
        assert_same_look(gpu, layers, &look, &Style::of(StyleKind::Transparent), Leaves::default(), "over nothing");
    }
}

fn recoloured_pictures_are_the_cpus(gpu: &'static Gpu) {
    for layers in LAYERS.iter() {
        let leaves = Leaves { colours: &layers.colours, ..Leaves::default() };
        for cut_colour in [CutColour::Leaf, CutColour::Set([0.1, 0.7, 0.2])] {
            for (kind, max_layers) in [(StyleKind::Shaded, None), (StyleKind::Transparent, Some(2))] {
                let style = Style { cut_colour, max_layers, ..Style::of(kind) };
                assert_same(gpu, layers, &style, leaves, "recoloured");
            }
        }
        let style = Style { max_layers: Some(1), ..Style::of(StyleKind::Transparent) };
        assert_same(gpu, layers, &style, Leaves::default(), "first layers");
    }
}

fn the_comparison_of_pictures_can_fail(gpu: &'static Gpu) {
    let layers = &LAYERS[0];
    let look = Look { light: layers.scene.light, background: [1.0; 4] };
    let dimmer = surfcut::scene::Light { ambient: look.light.ambient * 0.9, ..look.light };
    let wanted = composite::styled(&layers.stack, &look, &Style::default(), Leaves::default(), &|| ());
    let dim = Look { light: dimmer, ..look };
    let source = Uploaded(&layers.stack);
    let got = gpu.checked(|| twin::styled(gpu, &source, &dim, &Style::default(), Leaves::default())).unwrap();
    let found = difference(&got, &wanted);
    assert!(found.pixels as f64 > MOST_DIFFERENT * wanted.pixels.len() as f64, "{found:?}");
}

fn line_pictures_are_the_cpus(gpu: &'static Gpu) {
    for layers in LAYERS.iter() {
        for kind in [StyleKind::Blueprint, StyleKind::Wireframe, StyleKind::EdgeTransparent] {
            assert_same(gpu, layers, &Style::of(kind), Leaves::default(), kind.name());
        }
    }
}

fn wide_dashed_and_few_lines_are_the_cpus(gpu: &'static Gpu) {
    for layers in LAYERS.iter() {
        let of = |lines: LineSettings, max_layers| Style { lines, max_layers, ..Style::of(StyleKind::EdgeTransparent) };
        let wide = LineSettings { width_px: 9.0, ..LineSettings::default() };
        assert_same(gpu, layers, &of(wide, None), Leaves::default(), "wide lines");
        let hair = LineSettings { width_px: 0.4, hidden_dash_px: Some([7.0, 5.0]), ..LineSettings::default() };
        assert_same(gpu, layers, &of(hair, None), Leaves::default(), "dashed hair lines");
        let sharp = LineSettings { crease_degrees: 8.0, jump_px: 1.0, ..LineSettings::default() };
        assert_same(gpu, layers, &of(sharp, Some(2)), Leaves::default(), "many lines of two layers");
    }
}

fn outlines_of_leaves_are_the_cpus(gpu: &'static Gpu) {
    let leaves = Leaves { heavy: &[false, true, false, true], ..Leaves::default() };
    for layers in LAYERS.iter() {
        for kind in [StyleKind::Shaded, StyleKind::Transparent, StyleKind::Blueprint] {
            assert_same(gpu, layers, &Style::of(kind), leaves, "outlines");
        }
    }
}

fn hollows_are_the_cpus(gpu: &'static Gpu) {
    for layers in LAYERS.iter() {
        let style = Style { occlusion: Some(0.8), ..Style::default() };
        assert_same(gpu, layers, &style, Leaves::default(), "hollows");
    }
}

fn sketches_are_the_cpus(gpu: &'static Gpu) {
    for layers in LAYERS.iter() {
        let style = Style::of(StyleKind::Sketchy);
        assert_same(gpu, layers, &style, Leaves::default(), "sketch");
        let far = [[70.0, 10.0], [-30.0, 50.0]];
        let sketch = SketchSettings { edge_px: far, wavelength_px: 20.0, ..SketchSettings::default() };
        let loose = Style { sketch, max_layers: Some(3), opacity: 1.0, ..style };
        assert_same(gpu, layers, &loose, Leaves::default(), "loose sketch");
    }
}

fn hatched_sections_are_the_cpus(gpu: &'static Gpu) {
    for layers in LAYERS.iter().filter(|layers| !layers.hatching.is_empty()) {
        let heavy = layers.hatching.heavy();
        let leaves = Leaves { colours: &layers.colours, heavy: &heavy, hatching: Some(&layers.hatching), names: &[] };
        for kind in StyleKind::ALL {
            assert_same(gpu, layers, &Style::of(kind), leaves, &format!("sections, {}", kind.name()));
        }
    }
}

/// A source whose bands are small.
struct Narrow<'a>(Uploaded<&'a LayerStack>);

/// Pixels of its largest band: a quarter of the picture, of which what is around a part takes most.
const NARROW: usize = (SIDE * SIDE) as usize / 4;

impl GpuLayerSource for Narrow<'_> {
    fn camera(&self) -> &Camera {
        self.0.camera()
    }

    fn samples(&self) -> u32 {
        self.0.samples()
    }

    fn draw(&self, gpu: &Gpu, rect: PixelRect) -> Result<GpuLayers, GpuError> {
        if rect.area() > NARROW {
            return Err(GpuError::TooLarge {
                what: "a band".to_owned(),
                needed: rect.area() as u64,
                limit: NARROW as u64,
            });
        }
        self.0.draw(gpu, rect)
    }
}

fn bands_leave_no_trace(gpu: &'static Gpu) {
    let is_meant = |layers: &&Layers| matches!((layers.name, layers.samples), ("bearing", 4) | ("widget", 1));
    for layers in LAYERS.iter().filter(is_meant) {
        let heavy = layers.hatching.heavy();
        let leaves = Leaves { colours: &layers.colours, heavy: &heavy, hatching: Some(&layers.hatching), names: &[] };
        for kind in StyleKind::ALL {
            let style = Style { occlusion: Some(0.7), ..Style::of(kind) };
            let look = Look { light: layers.scene.light, background: layers.scene.background_for(&style) };
            let whole = Uploaded(&layers.stack);
            let whole = gpu.checked(|| twin::styled(gpu, &whole, &look, &style, leaves)).unwrap();
            let narrow = Narrow(Uploaded(&layers.stack));
            let narrow = gpu.checked(|| twin::styled(gpu, &narrow, &look, &style, leaves)).unwrap();
            assert!(whole == narrow, "{} of {}: {:?}", kind.name(), layers.name, difference(&narrow, &whole));
        }
    }
}

fn a_picture_of_nothing_is_paper(gpu: &'static Gpu) {
    let camera = Camera { width: 70, height: 3, ..LAYERS[0].stack.camera.clone() };
    let nothing = LayerStack::from_fn(camera, 1, |_, _| Vec::new());
    let look = Look { light: LAYERS[0].scene.light, background: [0.2, 0.4, 0.6, 0.5] };
    for kind in StyleKind::ALL {
        let style = Style::of(kind);
        let wanted = composite::styled(&nothing, &look, &style, Leaves::default(), &|| ());
        let source = Uploaded(&nothing);
        let got = gpu.checked(|| twin::styled(gpu, &source, &look, &style, Leaves::default())).unwrap();
        assert!(got == wanted && got.is_empty(), "{}", kind.name());
    }
}
