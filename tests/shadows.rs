//! Shadows against what geometry says of them, and against rays that the reference renderer casts towards the light.

use std::path::Path;

use glam::{DVec2, DVec3};
use surfcut::composite::light_grid::LightGrid;
use surfcut::composite::light_map::LightMap;
use surfcut::composite::lighting::towards;
use surfcut::composite::merge::Contents;
use surfcut::composite::shadow::Shadows;
use surfcut::composite::{Leaves, Look, Picture, styled_with};
use surfcut::formats::{NoProgress, ReadOptions};
use surfcut::hybrid::HybridModel;
use surfcut::layers::{Boundary, LayerLimit, LayerSource, LayerStack};
use surfcut::measure::open::truth_leaf;
use surfcut::pipeline::{Density, ExactLeaves, convert};
use surfcut::reference::Reference;
use surfcut::scene::style::{Style, StyleKind};
use surfcut::scene::{Light, LoadedScene, Representation, load, toml_file};
use surfcut::space::{Camera, Lens, Motion, Projection};

/// A scene with the layers that its camera sees, and what each gets of the light.
struct Lit {
    stack: LayerStack,
    /// By pixel: the share of the light that the nearest boundary gets.
    light: Vec<f32>,
}

/// What every leaf is drawn as.
#[derive(Debug, Clone, Copy, PartialEq)]
enum As {
    Own,
    Surfels,
    /// The first leaf as surfels.
    Mixed,
}

fn loaded(text: &str) -> LoadedScene {
    let scene = toml_file::parse(text, &Path::new(env!("CARGO_MANIFEST_DIR")).join("data")).unwrap();
    load(scene, &ReadOptions::default(), &NoProgress).unwrap()
}

fn model(loaded: &mut LoadedScene, drawn_as: As) -> HybridModel {
    let names: Vec<String> = loaded.scene.leaves.iter().map(|leaf| leaf.name.clone()).collect();
    for name in names.iter().take([0, names.len(), 1][drawn_as as usize]) {
        loaded.represent(name, Representation::Surfels).unwrap();
    }
    let camera = loaded.camera().unwrap();
    let converted = convert(loaded, &camera, Density::default(), ExactLeaves::Crossed, &|_| ()).unwrap();
    converted.classify().into_hybrid()
}

fn map(loaded: &LoadedScene, camera: &Camera, opacity: f32) -> LightMap {
    let bounds = loaded.drawn_within(|_| Motion::REST);
    LightMap::new(LightGrid::new(towards(&loaded.scene.light, camera), &bounds), opacity)
}

fn lit(loaded: &mut LoadedScene, drawn_as: As) -> Lit {
    let model = model(loaded, drawn_as);
    let camera = loaded.camera().unwrap();
    let stack = LayerStack::collect(&model.frame(&camera, LayerLimit::All, 1));
    let mut map = map(loaded, &camera, 1.0);
    let draw = |light: &Camera| -> Option<Box<dyn LayerSource + '_>> {
        Some(Box::new(model.frame(light, LayerLimit::All, 1)))
    };
    let shares = Shadows::new(&mut map, 1.0, &draw, &|work| work()).on(stack.tiles(), &camera, 1);
    let towards_light = light_of(loaded);
    let mut light = vec![f32::NAN; (camera.width * camera.height) as usize];
    for (tile, shares) in stack.tiles().iter().zip(shares) {
        for (pixel, of_pixel) in tile.offsets.windows(2).enumerate().filter(|(_, of_pixel)| of_pixel[0] < of_pixel[1]) {
            let (x, y) = (pixel as u32 % tile.rect.width(), pixel as u32 / tile.rect.width());
            let (x, y) = (tile.rect.x0 + x, tile.rect.y0 + y);
            let first = of_pixel[0] as usize;
            // What looks away from the light gets none, whether or not anything keeps it off.
            let normal = tile.boundaries[first].normal.as_dvec3();
            let along = normal.dot(camera.ray(DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5)).dir);
            let looks_away = normal.dot(towards_light) * along >= 0.0;
            light[(y * camera.width + x) as usize] = if looks_away { 0.0 } else { shares[first] };
        }
    }
    Lit { stack, light }
}

/// How the light in a picture differs from the truth.
#[derive(Debug, Default)]
struct Difference {
    /// Pixels that are lit or in shadow, further than a pixel from an edge of either.
    judged: usize,
    wrong: usize,
    shadowed: usize,
    /// Where the wrong ones are, what light they get, what they should get, and how flat it falls.
    examples: Vec<(i32, i32, f64, f64, f64)>,
}

/// What a surface gets may differ from the truth by this share of the light.
const MOST_OFF: f64 = 0.02;

/// How far from an edge of a shadow or of a surface pixels are judged: of surfels alone, edges of a body are as fine as these.
fn reach(drawn_as: As) -> i32 {
    if drawn_as == As::Own { 1 } else { 3 }
}

/// Compares the light of each pixel with that which `truth` says of its nearest boundary, seen from its middle.
fn difference(lit: &Lit, truth: impl Fn(DVec3, &Boundary) -> f64, towards_light: DVec3, reach: i32) -> Difference {
    let camera = &lit.stack.camera;
    let (width, height) = (camera.width as i32, camera.height as i32);
    let first = |x: i32, y: i32| lit.stack.at(x as u32, y as u32).first();
    let point = |x: i32, y: i32, boundary: &Boundary| {
        camera.ray(DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5)).at(f64::from(boundary.depth))
    };
    let at = |x: i32, y: i32| first(x, y).map(|boundary| truth(point(x, y, boundary), boundary));
    let truths: Vec<Option<f64>> =
        (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| at(x, y)).collect();
    let mut found = Difference::default();
    for (x, y) in (reach..height - reach).flat_map(|y| (reach..width - reach).map(move |x| (x, y))) {
        let Some(boundary) = first(x, y) else { continue };
        let here = truths[(y * width + x) as usize].unwrap();
        let footprint = camera.footprint(f64::from(boundary.depth));
        let is_like = |(x, y): (i32, i32)| {
            let same = truths[(y * width + x) as usize].is_some_and(|there| (there - here).abs() < 1e-3);
            // A jump in depth is a silhouette; a slope of up to 80 degrees is none.
            same && f64::from((first(x, y).unwrap().depth - boundary.depth).abs()) < 6.0 * footprint
        };
        if !(-reach..=reach).flat_map(|dy| (-reach..=reach).map(move |dx| (x + dx, y + dy))).all(is_like) {
            continue;
        }
        found.judged += 1;
        found.shadowed += usize::from(here < 0.5);
        let light = f64::from(lit.light[(y * width + x) as usize]);
        let ray = camera.ray(DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5));
        let normal = boundary.normal.as_dvec3();
        let normal = if normal.dot(ray.dir) > 0.0 { -normal } else { normal };
        let sine = normal.dot(towards_light).max(0.0);
        if !((light - here).abs() * sine <= MOST_OFF) {
            found.wrong += 1;
            found.examples.push((x, y, light, here, sine));
        }
    }
    found
}

fn light_of(loaded: &LoadedScene) -> DVec3 {
    towards(&loaded.scene.light, &loaded.camera().unwrap())
}

/// A ground from above: pixels are places on it.
const GROUND: &str = "size = [96, 96]\n[camera]\neye = [0, 0, 9]\ntarget = [0, 0, 0]\nup = [0, 1, 0]\nheight = 6\n\
    [light]\ntowards = [0.5, -0.3, 1]\n\
    [leaf.ground]\nbox = { min = [-4, -4, -0.5], max = [4, 4, 0] }\n";

/// Asserts that all but pixels at edges are as `truth` says.
fn assert_true(text: &str, drawn_as: As, truth: impl Fn(DVec3, &Boundary) -> f64) -> Difference {
    let mut loaded = loaded(text);
    let towards_light = light_of(&loaded);
    let found = difference(&lit(&mut loaded, drawn_as), truth, towards_light, reach(drawn_as));
    assert!(found.wrong == 0 && found.judged > 4_000, "{drawn_as:?}: {found:?}");
    found
}

const WAYS: [As; 3] = [As::Own, As::Surfels, As::Mixed];

#[test]
fn a_ball_throws_an_ellipse() {
    let text =
        format!("csg = 'ground | ball'\n{GROUND}[leaf.ball]\nsphere = {{ centre = [0.2, 0.1, 1.3], radius = 0.7 }}\n");
    let (centre, radius) = (DVec3::new(0.2, 0.1, 1.3), 0.7);
    let light = DVec3::new(0.5, -0.3, 1.0).normalize();
    for drawn_as in WAYS {
        let found = assert_true(&text, drawn_as, |p, boundary| {
            let on_ball = (p - centre).length() < 1.01 * radius;
            let to_centre = centre - p;
            let is_behind = to_centre.reject_from(light).length() < radius && to_centre.dot(light) > 0.0;
            let is_lit = if on_ball { boundary.normal.as_dvec3().dot(light) > 0.0 } else { !is_behind };
            f64::from(u8::from(is_lit))
        });
        assert!(found.shadowed > 50, "{drawn_as:?}: {found:?}");
    }
}

#[test]
fn light_falls_through_a_hole() {
    let text = format!(
        "csg = '(plate - drill) | ground'\n{GROUND}[leaf.plate]\nbox = {{ min = [-1.5, -1.5, 1], max = [1.5, 1.5, 1.3] }}\n\
         [leaf.drill]\ncylinder = {{ from = [0, 0, 0.5], to = [0, 0, 2], radius = 0.9 }}\n"
    );
    let light = DVec3::new(0.5, -0.3, 1.0).normalize();
    let ways = [As::Own, As::Surfels];
    for drawn_as in ways {
        let found = assert_true(&text, drawn_as, |p, boundary| {
            let at = |z: f64| (p + light * ((z - p.z) / light.z)).truncate();
            let in_plate = |q: DVec2| q.abs().max_element() < 1.5;
            if p.z > 0.1 {
                // The plate's top is lit, and the hole's side where it faces the light and the plate's other side does not
                // stand before it.
                let top = at(1.3);
                let is_lit = boundary.normal.as_dvec3().dot(light) > 0.0 && (p.z > 1.29 || top.length() < 0.9);
                return f64::from(u8::from(is_lit));
            }
            let (low, high) = (at(1.0), at(1.3));
            let through = low.length() < 0.9 && high.length() < 0.9;
            // Past the plate: on one side of it all the way.
            let past = !in_plate(low) && !in_plate(high);
            f64::from(u8::from(through || past))
        });
        assert!(found.shadowed > 150, "{drawn_as:?}: {found:?}");
    }
}

#[test]
fn what_is_cut_away_throws_none_and_glass_throws_half() {
    let cut = format!(
        "csg = 'ground | (ball - same)'\n{GROUND}[leaf.ball]\nsphere = {{ centre = [0, 0, 1], radius = 0.7 }}\n\
         [leaf.same]\nsphere = {{ centre = [0, 0, 1], radius = 0.7 }}\n"
    );
    for drawn_as in WAYS {
        assert_eq!(assert_true(&cut, drawn_as, |_, _| 1.0).shadowed, 0);
    }
    let glass = format!(
        "csg = 'ground | ball'\n{GROUND}[leaf.ball]\nsphere = {{ centre = [0, 0, 2.2], radius = 0.7 }}\nopacity = 0.3\n"
    );
    let light = DVec3::new(0.5, -0.3, 1.0).normalize();
    // In through one side and out through the other; the ball's own far side is behind one.
    assert_true(&glass, As::Own, |p, _| {
        let to_centre = DVec3::new(0.0, 0.0, 2.2) - p;
        let on_ball = (to_centre.length() - 0.7).abs() < 0.01;
        match () {
            () if on_ball => {
                if to_centre.dot(light) < 0.0 {
                    1.0
                } else {
                    0.7
                }
            }
            () if to_centre.reject_from(light).length() < 0.7 => 0.49,
            () => 1.0,
        }
    });
}

#[test]
fn who_looks_along_the_light_sees_no_shadow() {
    for drawn_as in WAYS {
        let text = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("data/widget.toml")).unwrap();
        let mut loaded = loaded(&text);
        let eye = DVec3::new(3.1, -4.6, 2.7);
        loaded.scene.size = (100, 100);
        loaded.scene.light = Light { towards: eye, in_world: true, ambient: 0.2 };
        let spec = loaded.scene.camera.as_mut().unwrap();
        (spec.target, spec.lens) = (DVec3::ZERO, Lens::Height(3.0));
        let lit = lit(&mut loaded, drawn_as);
        assert!(matches!(lit.stack.camera.projection, Projection::Orthographic { .. }));
        let found = difference(&lit, |_, _| 1.0, eye.normalize(), reach(drawn_as));
        assert!(found.wrong == 0 && found.judged > 2_000, "{drawn_as:?}: {found:?}");
    }
}

#[test]
fn an_eye_far_away_sees_no_shadow_on_what_throws_none() {
    // A pixel is a thousandth, and a depth in 32 bits is rounded by eight of these.
    let text = "csg = 'block | ball'\nsize = [96, 96]\n[camera]\neye = [60000, -50000, 62000]\ntarget = [0, 0, 0]\nheight = 0.096\n\
        [light]\ntowards = [0.3, -0.6, 1]\n[leaf.block]\nbox = { min = [-1, 0, -1], max = [0, 1, 0] }\n\
        [leaf.ball]\nsphere = { centre = [0.3, 0.3, -0.1], radius = 0.31 }\n";
    let mut loaded = loaded(text);
    let light = light_of(&loaded);
    let found = difference(&lit(&mut loaded, As::Own), |_, _| 1.0, light, 0);
    assert!(found.wrong == 0 && found.judged > 9_000, "{found:?}");
}

/// The light that a point gets, by a ray of the judge.
fn by_ray(loaded: &LoadedScene) -> impl Fn(DVec3, &Boundary) -> f64 + use<> {
    let light = light_of(loaded);
    let tree = loaded.canonical_tree();
    let leaves = tree.leaves().into_iter().map(|leaf| truth_leaf(loaded, leaf).unwrap()).collect();
    let centre = loaded.drawn_within(|_| Motion::REST);
    let (far, centre) = (2.0 * centre.diagonal(), centre.centre());
    let up = light.any_orthonormal_vector();
    let camera = Camera::look_at(centre + light * far, centre, up, Lens::Height(1.0), 1, 1).unwrap();
    let judge = Reference::new(leaves, tree, camera.clone(), 1, LayerLimit::All).unwrap();
    move |p, boundary| {
        if boundary.normal.as_dvec3().dot(light) < 0.0 {
            return 0.0;
        }
        // What the pipeline drew a little beside the truth stands on its own surface still.
        let own = 2e-3 * far;
        let in_view = camera.view_from_world(p);
        let before = judge.cast(camera.px_from_view(in_view)).into_iter().filter(|found| found.depth < in_view.z - own);
        before.map(|found| 1.0 - f64::from(found.opacity)).product()
    }
}

/// The share of pixels whose light may differ from that of the rays…
const MOST_WRONG: f64 = 3e-3;
/// …where the sine of the angle at which it falls is less than this; elsewhere none may.
const GRAZING: f64 = 0.125;

/// Scenes, as what their leaves are drawn, and from how far from an edge on they are judged. The spanner's flat sides meet in edges
/// over which surfels stand; the scan has noise.
const SCENES: [(&str, As, i32); 6] = [
    ("widget", As::Own, 1),
    ("widget", As::Surfels, 2),
    ("widget", As::Mixed, 2),
    ("spanner", As::Own, 1),
    ("bearing", As::Own, 1),
    ("femoral_head", As::Own, 2),
];

fn scene(name: &str) -> LoadedScene {
    let text =
        std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("data/{name}.toml"))).unwrap();
    let mut loaded = loaded(&text);
    loaded.scene.size = (144, 120);
    loaded.scene.light = Light { towards: DVec3::new(0.6, -0.7, 1.0), in_world: true, ambient: 0.2 };
    loaded
}

#[test]
fn shadows_are_those_of_rays() {
    let mut wrong = Vec::new();
    for (name, drawn_as, reach) in SCENES {
        let mut loaded = scene(name);
        let truth = by_ray(&loaded);
        let light = light_of(&loaded);
        let lit = lit(&mut loaded, drawn_as);
        let found = difference(&lit, truth, light, reach);
        println!("{name} {drawn_as:?}: {found:?}");
        // Where light grazes, a texel is many pixels long, and what shades a hollow stands hardly over its tangent plane.
        let is_slight = found.examples.iter().all(|(.., sine)| *sine < GRAZING);
        if !(found.judged > 2000 && is_slight && found.wrong as f64 <= MOST_WRONG * found.judged as f64) {
            wrong.push((name, drawn_as));
        }
    }
    assert!(wrong.is_empty(), "{wrong:?}");
}

#[test]
fn the_comparison_with_rays_can_fail() {
    let mut loaded = scene("widget");
    let truth = by_ray(&loaded);
    let light = light_of(&loaded);
    // Nearly four degrees beside.
    loaded.scene.light.towards += DVec3::new(0.0, 0.0, 0.14);
    let found = difference(&lit(&mut loaded, As::Own), truth, light, 1);
    println!("{} of {} beside", found.wrong, found.judged);
    assert!(found.wrong as f64 > 1.5 * MOST_WRONG * found.judged as f64, "{found:?}");
}

/// The picture in `style` with shadows, from `map`.
fn picture(loaded: &LoadedScene, model: &HybridModel, map: &mut LightMap, style: &Style, samples: u32) -> Picture {
    let camera = loaded.camera().unwrap();
    let source = model.frame(&camera, LayerLimit::All, samples);
    let draw = |light: &Camera| -> Option<Box<dyn LayerSource + '_>> {
        Some(Box::new(model.frame(light, LayerLimit::All, 1)))
    };
    let shadows = Shadows::new(map, style.shadows, &draw, &|work| work());
    let look = Look { light: loaded.scene.light, background: [1.0; 4] };
    styled_with(&source, &look, style, Leaves::default(), &Contents::default(), Some(&shadows), &|| ())
}

#[test]
fn what_is_kept_of_the_last_frame_and_the_number_of_threads_change_nothing() {
    let mut loaded = scene("widget");
    loaded.scene.size = (70, 60);
    let model = model(&mut loaded, As::Mixed);
    for kind in [StyleKind::Shaded, StyleKind::EdgeTransparent, StyleKind::Sketchy] {
        let style = Style { shadows: 0.8, ..Style::of(kind) };
        let opacity = style.opacity_factor();
        let camera = loaded.camera().unwrap();
        let mut kept = map(&loaded, &camera, opacity);
        let first = picture(&loaded, &model, &mut kept, &style, 4);
        let texels = kept.texels();
        assert!(texels > 0);
        assert!(picture(&loaded, &model, &mut kept, &style, 4) == first);
        assert_eq!(kept.texels(), texels);
        for threads in [1, 16] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let again = pool.install(|| picture(&loaded, &model, &mut map(&loaded, &camera, opacity), &style, 4));
            assert!(again == first, "{} on {threads} threads", kind.name());
        }
    }
}

#[test]
fn lines_alone_take_none_and_lit_surfaces_do() {
    let mut loaded = scene("widget");
    loaded.scene.size = (80, 70);
    let model = model(&mut loaded, As::Own);
    let camera = loaded.camera().unwrap();
    for kind in StyleKind::ALL {
        let style = Style { shadows: 1.0, ..Style::of(kind) };
        let mut map = map(&loaded, &camera, style.opacity_factor());
        let with = picture(&loaded, &model, &mut map, &style, 1);
        let without = picture(&loaded, &model, &mut map, &Style { shadows: 0.0, ..style }, 1);
        assert_eq!(with != without, kind.is_lit(), "{}", kind.name());
        // The light that is kept off makes nothing brighter.
        let brighter = with.pixels.iter().zip(&without.pixels).any(|(a, b)| (0..3).any(|c| a[c] > b[c] + 1e-6));
        assert!(!brighter, "{}", kind.name());
    }
}

fn surfcut(directory: &Path, line: &str) -> (bool, String) {
    let output = std::process::Command::new(env!("CARGO_BIN_EXE_surfcut"))
        .current_dir(directory)
        .args(line.split_whitespace())
        .output()
        .unwrap();
    (output.status.success(), String::from_utf8(output.stderr).unwrap())
}

const MOVING: &str = "csg = 'ground | ball'\nsize = [64, 56]\n[camera]\neye = [3, -5, 6]\ntarget = [0, 0, 0]\n\
    [light]\ntowards = [1, 0.2, 1.2]\n[style]\nshadows = true\n\
    [leaf.ground]\nbox = { min = [-2, -2, -0.5], max = [2, 2, 0] }\n";

#[test]
fn the_command_tells_of_shadows_and_of_styles_that_take_none() {
    let directory = tempfile::tempdir().unwrap();
    let here = directory.path();
    let ball = "[leaf.ball]\nsphere = { centre = [0, 0, 1], radius = 0.6 }\n";
    std::fs::write(here.join("a.toml"), format!("{MOVING}{ball}")).unwrap();
    let (done, text) = surfcut(here, "render a.toml -o a.png --summary-file a.json");
    assert!(done, "{text}");
    let summary: serde_json::Value = serde_json::from_slice(&std::fs::read(here.join("a.json")).unwrap()).unwrap();
    assert!(summary["phases"]["shadow"]["ms"].as_f64().unwrap() > 0.0);
    assert!(summary["counts"]["shadow_texels"].as_u64().unwrap() > 1000);
    let (_, text) = surfcut(here, "render a.toml -o b.png --style blueprint");
    assert!(text.contains("takes no shadows"), "{text}");
    let (done, text) = surfcut(here, "render a.toml -o c.png --shadows=2");
    assert!(!done && text.contains("from 0 to 1"), "{text}");
    let (done, text) = surfcut(here, "render --shadows=0 a.toml -o d.png");
    assert!(done, "{text}");
    let picture = |name: &str| image::open(here.join(name)).unwrap().into_rgb8();
    let darker = picture("a.png").pixels().zip(picture("d.png").pixels()).filter(|(a, d)| a.0 < d.0).count();
    assert!(darker > 100, "{darker}");
}

#[test]
fn shadows_follow_what_moves_and_frames_drawn_again_are_the_same() {
    let directory = tempfile::tempdir().unwrap();
    let here = directory.path();
    let ball = |x: f64| format!("[leaf.ball]\nsphere = {{ centre = [{x}, 0, 1], radius = 0.6 }}\n");
    let keys = "[[keyframe]]\ntime = 0\n[[keyframe]]\ntime = 2\nleaf.ball.translate = [-1, 0, 0]\n";
    std::fs::write(here.join("moving.toml"), format!("{MOVING}{}{keys}", ball(0.5))).unwrap();
    std::fs::write(here.join("moved.toml"), format!("{MOVING}{}", ball(-0.5))).unwrap();
    for line in [
        "render moving.toml --animate --fps 1 -o m_{frame}.png",
        "render moved.toml -o moved.png",
        "render moved.toml --turntable 3 -o t_{frame}.png",
    ] {
        let (done, text) = surfcut(here, line);
        assert!(done, "{line}: {text}");
    }
    let picture = |name: &str| image::open(here.join(name)).unwrap().into_rgb8();
    let (last, alone) = (picture("m_0002.png"), picture("moved.png"));
    let off = last.pixels().zip(alone.pixels()).filter(|(a, b)| (0..3).any(|c| a.0[c].abs_diff(b.0[c]) > 2)).count();
    assert!(off <= 4, "{off}");
    assert_ne!(last, picture("m_0000.png"));
    // A frame that is drawn alone is the one that was drawn among others.
    let kept = std::fs::read(here.join("t_0001.png")).unwrap();
    std::fs::remove_file(here.join("t_0001.png")).unwrap();
    let (done, text) = surfcut(here, "render moved.toml --turntable 3 -o t_{frame}.png");
    assert!(done, "{text}");
    assert_eq!(std::fs::read(here.join("t_0001.png")).unwrap(), kept);
}
