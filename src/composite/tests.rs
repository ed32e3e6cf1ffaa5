//! Lines against edges that are known exactly, and layers against the closed form.

use glam::{DAffine3, DQuat, DVec2, DVec3, Vec3};

use super::layered::{Gathered, Inks};
use super::*;
use crate::csg::{LeafId, Tree};
use crate::geometry::Solid;
use crate::layers::{Boundary, Facing, LayerLimit, LayerSource, LayerStack};
use crate::reference::{Reference, TruthLeaf, TruthShape};
use crate::scene::Light;
use crate::scene::style::{LineSettings, Style, StyleKind};
use crate::space::{Camera, Lens, Projection};

const WHITE: [f32; 4] = [1.0; 4];

fn camera(lens: Lens, width: u32, height: u32) -> Camera {
    Camera::look_at(DVec3::new(2.1, -4.3, 2.7), DVec3::ZERO, DVec3::Z, lens, width, height).unwrap()
}

fn of_solid(solid: Solid, turn: DQuat, camera: Camera) -> Reference {
    let leaf = TruthLeaf { world_from_leaf: DAffine3::from_quat(turn), ..TruthLeaf::new(0, TruthShape::Solid(solid)) };
    Reference::new(vec![leaf], Tree::leaf(LeafId(0)), camera, 1, LayerLimit::All).unwrap()
}

/// Black lines of full strength on white.
fn plain_lines() -> Style {
    let lines = LineSettings { ink: Some([0.0; 3]), ..LineSettings::default() };
    Style { lines, fade: 0.0, ..Style::of(StyleKind::Wireframe) }
}

fn drawn(source: &dyn LayerSource, style: &Style) -> Picture {
    styled(source, &Look { light: Light::default(), background: WHITE }, style, Leaves::default(), &|| ())
}

/// Ink of a picture of black lines on white.
fn ink(picture: &Picture, x: u32, y: u32) -> f32 {
    1.0 - picture.at(x, y)[0]
}

fn distance_to_segment(p: DVec2, [a, b]: [DVec2; 2]) -> f64 {
    let along = (p - a).dot(b - a) / (b - a).length_squared();
    p.distance(a.lerp(b, along.clamp(0.0, 1.0)))
}

/// Where lines lie anywhere between pixels: one a pixel wide has its ink a third of a pixel from its middle on average.
const ANYWHERE: f64 = 0.4;
/// Where lines lie on the borders between pixels, all ink is half a pixel off.
const ON_BORDERS: f64 = 0.51;

/// Holds the lines of `picture` against `segments`, in pixels: no ink far from them, on average at most `most_off` from
/// their middle, no gap in them.
fn assert_drawn(picture: &Picture, segments: &[[DVec2; 2]], most_off: f64) {
    let (mut off, mut inked) = (0.0, 0.0);
    for y in 0..picture.height {
        for x in 0..picture.width {
            let ink = f64::from(ink(picture, x, y));
            if ink < 0.05 {
                continue;
            }
            let centre = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
            let away = segments.iter().map(|s| distance_to_segment(centre, *s)).fold(f64::INFINITY, f64::min);
            assert!(away < 1.6, "ink {ink:.2} at {x}, {y}, {away:.2} px from every edge");
            (off, inked) = (off + ink * away, inked + ink);
        }
    }
    assert!(off / inked < most_off, "ink is {:.3} px off on average", off / inked);
    let (mut gaps, mut steps) = (0, 0);
    for [a, b] in segments {
        let count = (a.distance(*b) * 2.0).ceil() as u32;
        for i in 0..=count {
            let p = a.lerp(*b, f64::from(i) / f64::from(count));
            let (x, y) = (p.x.floor() as i32, p.y.floor() as i32);
            let near = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (x + dx, y + dy)));
            let strongest = near
                .filter(|&(x, y)| x >= 0 && y >= 0 && x < picture.width as i32 && y < picture.height as i32)
                .map(|(x, y)| ink(picture, x as u32, y as u32))
                .fold(0.0, f32::max);
            steps += 1;
            gaps += u32::from(strongest < 0.4);
        }
    }
    assert_eq!(gaps, 0, "of {steps} places along the edges");
}

#[test]
fn the_twelve_edges_of_a_box_are_drawn_where_they_are() {
    for (lens, degrees) in [(Lens::FovY(38.0), 0.0), (Lens::Height(4.0), 17.0), (Lens::FovY(30.0), 41.0)] {
        let camera = camera(lens, 260, 220);
        let turn = DQuat::from_rotation_z(f64::to_radians(degrees)) * DQuat::from_rotation_x(0.1);
        let half = DVec3::new(0.9, 0.7, 0.55);
        let corner = |i: usize| {
            let sign = |bit: usize| if i >> bit & 1 == 1 { 1.0 } else { -1.0 };
            let p = turn * (half * DVec3::new(sign(0), sign(1), sign(2)));
            camera.px_from_view(camera.view_from_world(p))
        };
        let edges = (0..8usize).flat_map(|i| (0..3).map(move |bit| (i, i | 1 << bit))).filter(|(i, j)| i != j);
        let segments: Vec<[DVec2; 2]> = edges.map(|(i, j)| [corner(i), corner(j)]).collect();
        assert_eq!(segments.len(), 12);
        let source = of_solid(Solid::Box { min: -half, max: half }, turn, camera);
        assert_drawn(&drawn(&source, &plain_lines()), &segments, ANYWHERE);
    }
}

#[test]
fn a_ball_is_drawn_as_a_circle_whatever_its_size() {
    for radius_px in [6.0, 15.0, 40.0, 110.0] {
        let camera = camera(Lens::Height(1.0), 256, 256);
        let Projection::Orthographic { px_per_unit } = camera.projection else { unreachable!() };
        let solid = Solid::Sphere { centre: DVec3::ZERO, radius: radius_px / px_per_unit };
        let on_circle = |i: u32| {
            let angle = f64::from(i) / 256.0 * std::f64::consts::TAU;
            DVec2::splat(128.0) + radius_px * DVec2::from_angle(angle)
        };
        let segments: Vec<[DVec2; 2]> = (0..256).map(|i| [on_circle(i), on_circle(i + 1)]).collect();
        let source = of_solid(solid, DQuat::IDENTITY, camera);
        assert_drawn(&drawn(&source, &plain_lines()), &segments, ANYWHERE);
    }
}

#[test]
fn the_check_of_lines_can_fail() {
    let camera = camera(Lens::Height(4.0), 120, 120);
    let source = of_solid(Solid::Sphere { centre: DVec3::ZERO, radius: 1.0 }, DQuat::IDENTITY, camera);
    let picture = drawn(&source, &plain_lines());
    let elsewhere = [[DVec2::new(10.0, 10.0), DVec2::new(110.0, 10.0)]];
    assert!(std::panic::catch_unwind(|| assert_drawn(&picture, &elsewhere, ANYWHERE)).is_err());
}

#[test]
fn strips_and_threads_leave_no_trace() {
    // Several strips: a picture of a ball is its own mirror image, whose strips lie elsewhere.
    let (width, height) = (4096, 640);
    let middle = Vec3::new(0.5 * width as f32 - 0.5, 0.5 * height as f32 - 0.5, 0.0);
    let radius = 300.0f32;
    let camera = Camera::look_at(DVec3::NEG_Y * 9.0, DVec3::ZERO, DVec3::Z, Lens::Height(6.4), width, height).unwrap();
    let of_pixel = |x: u32, y: u32| {
        let aside = (Vec3::new(x as f32, y as f32, 0.0) - middle) / radius;
        let squared = 1.0 - aside.length_squared();
        if squared <= 0.0 {
            return Vec::new();
        }
        let of_side = |facing: Facing| {
            let towards = f32::from(facing as i8) * squared.sqrt();
            let normal = Vec3::new(aside.x, -towards, -aside.y);
            let depth = 9.0 - 3.0 * towards;
            Boundary { depth, normal, colour: [0.5; 3], opacity: 1.0, leaf: 0, body: 0, facing, samples: 1 }
        };
        vec![of_side(Facing::Front), of_side(Facing::Back)]
    };
    let stack = LayerStack::from_fn(camera, 1, of_pixel);
    let picture = drawn(&stack, &plain_lines());
    let mut inked = 0.0;
    for y in 0..height / 2 {
        for x in 0..width {
            let (here, there) = (ink(&picture, x, y), ink(&picture, width - 1 - x, height - 1 - y));
            assert!((here - there).abs() < 0.02, "{here} at {x}, {y}, but {there} opposite");
            inked += 2.0 * here;
        }
    }
    let circle = std::f32::consts::TAU * radius;
    assert!((inked / circle - 1.0).abs() < 0.1, "{inked} px of ink for a circle of {circle} px");
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    for kind in StyleKind::ALL {
        let style = Style::of(kind);
        assert_eq!(one.install(|| drawn(&stack, &style)), drawn(&stack, &style), "{}", kind.name());
    }
}

#[test]
fn a_layer_is_its_surface_under_its_ink() {
    let mut style = Style::of(StyleKind::EdgeTransparent);
    style.lines.ink = Some([0.2, 0.1, 0.0]);
    style.fade = 0.5;
    let inks = Inks::new(&style, WHITE);
    let mut gathered = Gathered::new();
    // Ink over a fifth of a red surface of opacity 0.4, and behind it a whole green one with a line at half strength.
    gathered.add(&inks, 0.2, 1.0, [0.4, 0.0, 0.0, 0.4], 1.0);
    gathered.add(&inks, 1.0, 2.0, [0.0, 0.25, 0.0, 0.25], 2.0);
    let (colour, depth) = gathered.finish([0.0, 0.0, 1.0, 1.0]);
    // The second line covers the fifth too, and three tenths more; behind both is half of the pixel.
    let wanted =
        [0.2 * 0.2 + 0.8 * 0.4 + 0.6 * 0.3 * 0.2, 0.2 * 0.1 + 0.6 * (0.3 * 0.1 + 0.5 * 0.25), 0.5 * 0.6 * 0.75, 1.0];
    for (got, wanted) in colour.into_iter().zip(wanted) {
        assert!((got - wanted).abs() < 1.0 / 255.0, "{colour:?} instead of {wanted}");
    }
    assert_eq!(depth, 1.0);
}

#[test]
fn the_depth_is_that_of_what_shows() {
    let camera = camera(Lens::Height(4.0), 120, 120);
    let source = of_solid(Solid::Sphere { centre: DVec3::ZERO, radius: 1.0 }, DQuat::IDENTITY, camera);
    let nearest = LayerStack::collect(&source);
    for kind in [StyleKind::Blueprint, StyleKind::EdgeTransparent] {
        let picture = drawn(&source, &Style::of(kind));
        let depth = picture.depth.as_ref().unwrap();
        assert_eq!(depth[60 * 120 + 60], nearest.at(60, 60)[0].depth);
        assert_eq!(depth[0], f32::INFINITY);
    }
    // A wireframe shows nothing inside of its lines.
    let picture = drawn(&source, &plain_lines());
    let depth = picture.depth.as_ref().unwrap();
    assert_eq!(depth[60 * 120 + 60], f32::INFINITY);
    assert!(depth.iter().any(|z| z.is_finite()));
}

#[test]
fn edges_that_layers_share_coincide_in_a_sketch() {
    // A ball in front of another: the outline of the nearer is an edge of every layer of the farther behind it too.
    let camera = camera(Lens::Height(3.2), 200, 200);
    let towards_eye = (camera.eye - DVec3::ZERO).normalize();
    let shapes =
        [Solid::Sphere { centre: towards_eye * 2.0, radius: 0.6 }, Solid::Sphere { centre: DVec3::ZERO, radius: 1.3 }];
    let leaves = (0..).zip(shapes).map(|(i, solid)| TruthLeaf::new(i, TruthShape::Solid(solid))).collect();
    let tree = crate::csg::expression::parse("a | b", &mut |name| Some(LeafId(u32::from(name == "b")))).unwrap();
    let source = Reference::new(leaves, tree, camera, 1, LayerLimit::All).unwrap();
    let look = Look { light: Light::default(), background: WHITE };
    let maps = maps::maps(&source, &look, &Style::of(StyleKind::Sketchy), Leaves::default(), None);
    let map = |name: &str| &maps.iter().find(|map| map.name == name).unwrap().rgb;
    let ink = |name: &str, pixel: usize| 255 - map(name)[3 * pixel];
    let mut moved = 0;
    for (first, second) in [(1, 2), (1, 3), (3, 4)] {
        let name = |layer: u32, kind: &str| format!("layer{layer}_{kind}");
        let mut shared = 0;
        for pixel in 0..200 * 200 {
            let (a, b) = (ink(&name(first, "edges"), pixel), ink(&name(second, "edges"), pixel));
            // Layers 1 and 2 have both outlines, 3 and 4 the nearer ball's alone where it hides the farther.
            if (first, second) == (1, 2) {
                assert_eq!(a, b, "pixel {pixel} of layers {first} and {second}");
                let (a, b) = (ink(&name(1, "perturbed_edges"), pixel), ink(&name(2, "perturbed_edges"), pixel));
                assert_eq!(a, b, "pixel {pixel} of the perturbed layers");
            }
            shared += u32::from(a.min(b) > 128);
            moved += u32::from(a > 128 && ink(&name(first, "perturbed_edges"), pixel) < 64);
        }
        assert!(shared > 100, "{shared} pixels of line in layers {first} and {second} both");
        // Where the perturbed lines of either are in what both share, so are the other's, to a pixel.
        let near = |name: &str, pixel: usize| {
            let (x, y) = (pixel as i32 % 200, pixel as i32 / 200);
            let around = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (x + dx, y + dy)));
            around
                .filter(|(x, y)| (0..200).contains(x) && (0..200).contains(y))
                .any(|(x, y)| ink(name, (y * 200 + x) as usize) > 64)
        };
        let perturbed = (0..200 * 200).filter(|&pixel| ink(&name(second, "perturbed_edges"), pixel) > 128);
        let apart = perturbed.filter(|&pixel| !near(&name(first, "perturbed_edges"), pixel)).count();
        assert_eq!(apart, 0, "pixels of layer {second}'s perturbed lines have none of layer {first}'s beside them");
    }
    assert!(moved > 100, "the hand moves lines: {moved} pixels");
}

#[test]
fn a_sheets_border_is_a_line_and_a_flat_union_has_none() {
    let camera = Camera::look_at(DVec3::NEG_Y * 5.0, DVec3::ZERO, DVec3::Z, Lens::Height(2.0), 100, 100).unwrap();
    let normal = Vec3::NEG_Y;
    let plane = |leaf: u32| Boundary {
        depth: 5.0,
        normal,
        colour: [0.5; 3],
        opacity: 1.0,
        leaf,
        body: leaf,
        facing: Facing::Front,
        samples: 1,
    };
    // Two coplanar leaves side by side; their border at column 50 is no edge of their union.
    let stack = LayerStack::from_fn(camera, 1, |x, y| {
        let inside = (20..80).contains(&x) && (20..80).contains(&y);
        if inside { vec![plane(u32::from(x >= 50))] } else { Vec::new() }
    });
    let square = [DVec2::new(20.0, 20.0), DVec2::new(80.0, 20.0), DVec2::new(80.0, 80.0), DVec2::new(20.0, 80.0)];
    let segments: Vec<[DVec2; 2]> = (0..4).map(|i| [square[i], square[(i + 1) % 4]]).collect();
    assert_drawn(&drawn(&stack, &plain_lines()), &segments, ON_BORDERS);
}

#[test]
fn hidden_lines_are_dashed_and_visible_ones_whole() {
    let camera = camera(Lens::FovY(38.0), 260, 220);
    let half = DVec3::splat(0.8);
    let source = of_solid(Solid::Box { min: -half, max: half }, DQuat::IDENTITY, camera);
    let mut style = plain_lines();
    let visible = drawn(&source, &Style { max_layers: Some(1), ..style });
    let whole = drawn(&source, &style);
    style.lines.hidden_dash_px = Some([6.0, 6.0]);
    let dashed = drawn(&source, &style);
    let sum = |picture: &Picture| picture.pixels.iter().map(|p| 1.0 - p[0]).sum::<f32>();
    let (visible, whole, dashed) = (sum(&visible), sum(&whole), sum(&dashed));
    let share = (dashed - visible) / (whole - visible);
    assert!(whole > 1.2 * visible, "{whole} px of ink, {visible} of it visible");
    assert!((0.35..0.65).contains(&share), "{share} of the hidden lines is drawn, where half was asked for");
}

/// Two planes seen along +y that meet at a right angle in column 60: a hollow edge if `hollow`, else a ridge.
fn bent_planes(hollow: bool) -> LayerStack {
    let camera = Camera::look_at(DVec3::NEG_Y * 50.0, DVec3::ZERO, DVec3::Z, Lens::Height(12.0), 120, 120).unwrap();
    LayerStack::from_fn(camera, 1, move |x, _| {
        // A tenth of a unit a pixel.
        let aside = (x as f32 - 59.5) * 0.1;
        let depth = 50.0 + if hollow { -aside.abs() } else { aside.abs() };
        let side = if (aside > 0.0) == hollow { -1.0 } else { 1.0 };
        let normal = Vec3::new(side, -1.0, 0.0).normalize();
        vec![Boundary {
            depth,
            normal,
            colour: [0.5; 3],
            opacity: 1.0,
            leaf: 0,
            body: 0,
            facing: Facing::Front,
            samples: 1,
        }]
    })
}

#[test]
fn hollows_are_darker_and_ridges_and_planes_are_not() {
    let style = |strength| Style { occlusion: Some(strength), ..Style::default() };
    let share =
        |stack: &LayerStack, x: u32| drawn(stack, &style(1.0)).at(x, 60)[0] / drawn(stack, &style(0.0)).at(x, 60)[0];
    let (hollow, ridge) = (bent_planes(true), bent_planes(false));
    assert!(share(&hollow, 58) < 0.8, "{} beside the hollow edge", share(&hollow, 58));
    assert!((share(&hollow, 20) - 1.0).abs() < 1e-3, "{} on the plane", share(&hollow, 20));
    assert!((share(&ridge, 58) - 1.0).abs() < 1e-3, "{} beside the ridge", share(&ridge, 58));
}

#[test]
fn maps_show_each_layer_and_what_a_sketch_makes_of_it() {
    let camera = camera(Lens::Height(2.6), 100, 100);
    let source = of_solid(Solid::Sphere { centre: DVec3::ZERO, radius: 1.0 }, DQuat::IDENTITY, camera);
    let look = Look { light: Light::default(), background: WHITE };
    let maps = maps::maps(&source, &look, &Style::of(StyleKind::Sketchy), Leaves::default(), None);
    let names: Vec<&str> = maps.iter().map(|map| map.name.as_str()).collect();
    let kinds = ["depth", "normals", "colours", "edges", "perturbed_colours", "perturbed_edges", "perturbed_depth"];
    let wanted: Vec<String> = (1..=2).flat_map(|layer| kinds.map(|kind| format!("layer{layer}_{kind}"))).collect();
    assert_eq!(names[..names.len() - 1], wanted);
    assert_eq!(names.last(), Some(&"noise"));
    let at = |name: &str, x: usize, y: usize| {
        let map = maps.iter().find(|map| map.name == name).unwrap();
        let place = 3 * (y * map.width as usize + x);
        [map.rgb[place], map.rgb[place + 1], map.rgb[place + 2]]
    };
    // In the middle the front is the nearest of all, looks at the eye, and has no line; the back is the deepest.
    assert!(at("layer1_depth", 50, 50)[0] >= 254);
    assert!(at("layer2_depth", 50, 50)[0] < 60);
    assert!(at("layer1_normals", 50, 50)[2] > 250 && at("layer2_normals", 50, 50)[2] < 5);
    assert_eq!(at("layer1_edges", 50, 50), [255; 3]);
    assert!((0..100).any(|x| at("layer1_edges", x, 50)[0] < 100));
    assert_eq!(at("layer1_depth", 0, 0), [255; 3]);
}

#[test]
fn pictures_of_any_width_are_drawn() {
    // Narrower than what a line's points are smoothed over, and just wider than a tile.
    for width in [1, 2, 3, 4, 5, 6, 7, 8, 65, 66] {
        let camera = camera(Lens::Height(2.0), width, 30);
        let source = of_solid(Solid::Sphere { centre: DVec3::ZERO, radius: 0.9 }, DQuat::IDENTITY, camera);
        for kind in StyleKind::ALL {
            let picture = drawn(&source, &Style { occlusion: Some(0.5), ..Style::of(kind) });
            assert_eq!(picture.pixels.len(), 30 * width as usize);
            assert!(picture.pixels.iter().flatten().all(|value| value.is_finite()), "{} at {width}", kind.name());
        }
    }
}

#[test]
fn what_is_clear_casts_and_gets_no_shade() {
    let camera = camera(Lens::Height(3.0), 90, 90);
    let shapes =
        [Solid::Sphere { centre: DVec3::X * 0.4, radius: 0.8 }, Solid::Sphere { centre: DVec3::X * -0.4, radius: 0.8 }];
    let leaf = |i: u32, solid| TruthLeaf { opacity: 0.0, ..TruthLeaf::new(i, TruthShape::Solid(solid)) };
    let leaves: Vec<TruthLeaf> = (0..).zip(shapes).map(|(i, solid)| leaf(i, solid)).collect();
    let tree = crate::csg::expression::parse("a | b", &mut |name| Some(LeafId(u32::from(name == "b")))).unwrap();
    let source = Reference::new(leaves, tree, camera, 1, LayerLimit::All).unwrap();
    let picture = drawn(&source, &Style { occlusion: Some(1.0), ..Style::default() });
    assert!(picture.pixels.iter().all(|pixel| *pixel == WHITE));
}
