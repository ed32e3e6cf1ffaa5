//! The paper's way of splatting on the GPU against the CPU's, boundary by boundary.

use glam::DVec3;
use surfcut::classify::{LeafField, Model};
use surfcut::geometry::Solid;
use surfcut::gpu::splat::{GpuClipping, GpuSplatFrame, GpuSplatModel};
use surfcut::gpu::{Gpu, GpuError, GpuLayerSource};
use surfcut::layers::{LayerLimit, LayerSource, LayerTile};
use surfcut::scene::LeafKind;
use surfcut::space::{Camera, Lens, PixelRect};
use surfcut::splat::{Clip, Frame, Inside, Partners, SplatSettings, Unknown};

use crate::Test;
use crate::splat::{
    ALLOWED, SIDE, camera, compare, elliptical_spheres, looks, model, name, nine_near_spheres, same_pixel, scan,
    sphere, stack_of_squares, torus_and_cylinder, tree, whole,
};

pub const TESTS: &[Test] = &[
    ("paper_spheres_with_every_setting", spheres_with_every_setting),
    ("paper_surfaces_with_every_setting", surfaces_with_every_setting),
    ("paper_partners_that_meet_in_the_picture", partners_that_meet_in_the_picture),
    ("paper_partners_about_the_eye", partners_about_the_eye),
    ("paper_figure_4_a_cube_of_half_spaces", figure_4_a_cube_of_half_spaces),
    ("paper_figure_5_an_unknown_leaf_drops_out", figure_5_an_unknown_leaf_drops_out),
    ("paper_surfels_smaller_than_pixels", surfels_smaller_than_pixels),
    ("paper_coarse_surfels_beside_dense_ones", coarse_surfels_beside_dense_ones),
    ("paper_a_leaf_that_occurs_twice", a_leaf_that_occurs_twice),
    ("paper_a_tree_deeper_than_a_word", a_tree_deeper_than_a_word),
    ("paper_more_near_leaves_than_a_truth_table_has", more_near_leaves_than_a_truth_table_has),
    ("paper_an_orthographic_camera", an_orthographic_camera),
    ("paper_far_from_the_origin_and_magnified", far_from_the_origin_and_magnified),
    ("paper_the_eye_among_the_surfels", the_eye_among_the_surfels),
    ("paper_leaves_that_light_shines_through", leaves_that_light_shines_through),
    ("paper_a_sheet_is_cut_and_never_cuts", a_sheet_is_cut_and_never_cuts),
    ("paper_surfels_that_are_ellipses", surfels_that_are_ellipses),
    ("paper_several_samples_a_pixel", several_samples_a_pixel),
    ("paper_parts_of_a_picture_are_the_same_bits", parts_of_a_picture_are_the_same_bits),
    ("paper_no_surfel_is_lost_where_room_is_short", no_surfel_is_lost_where_room_is_short),
    ("paper_too_many_fragments_for_the_driver_are_told", too_many_fragments_for_the_driver_are_told),
    ("paper_the_comparison_can_fail", the_comparison_can_fail),
];

/// Every point test, by both rules, with partners found in space.
fn every_setting(clip: Clip) -> impl Iterator<Item = SplatSettings> {
    let of_rule = move |unknown| {
        Inside::ALL.map(|inside| SplatSettings { clip, inside, unknown, partners: Partners::ObjectSpace })
    };
    Unknown::ALL.into_iter().flat_map(of_rule)
}

/// The paper's way, and the same with our rule for *unknown*; partners found in space.
const BOTH_RULES: [SplatSettings; 2] = [
    SplatSettings { partners: Partners::ObjectSpace, ..SplatSettings::PAPER },
    SplatSettings { partners: Partners::ObjectSpace, unknown: Unknown::Resolved, ..SplatSettings::PAPER },
];

fn draw_both(
    gpu: &Gpu,
    model: &Model,
    camera: &Camera,
    (limit, samples): (LayerLimit, u32),
    settings: SplatSettings,
) -> (LayerTile, LayerTile) {
    let on_cpu = Frame::new(model, camera.clone(), limit, samples, settings, None).draw(whole(camera));
    let drawn = gpu.checked(|| {
        let uploaded = GpuSplatModel::new(gpu, model).unwrap();
        let clipping = GpuClipping::new(gpu, model, &uploaded, settings, None).unwrap();
        let frame = GpuSplatFrame::new(model, &uploaded, camera.clone(), limit, samples, clipping.as_ref()).unwrap();
        frame.draw(gpu, whole(camera))?.download(gpu)
    });
    (on_cpu, drawn.unwrap())
}

/// Both limits, held to the bar.
fn hold(gpu: &Gpu, model: &Model, camera: &Camera, samples: u32, settings: SplatSettings) {
    [LayerLimit::Nearest, LayerLimit::All]
        .into_iter()
        .for_each(|limit| hold_limit(gpu, model, camera, (limit, samples), settings));
}

fn hold_limit(gpu: &Gpu, model: &Model, camera: &Camera, (limit, samples): (LayerLimit, u32), settings: SplatSettings) {
    let (on_cpu, on_gpu) = draw_both(gpu, model, camera, (limit, samples), settings);
    let compared = compare(camera, &on_cpu, &on_gpu);
    assert!(compared.covered > 700, "{compared:?}");
    // A tie is one pixel, however small the picture is.
    let allowed = (ALLOWED * compared.covered as f64).max(1.0);
    assert!(compared.differing as f64 <= allowed, "{settings:?} {limit:?}: {compared:?}");
    let draw = |camera: &Camera| Frame::new(model, camera.clone(), limit, samples, settings, None).draw(whole(camera));
    let off = without_ties(camera, compared.places, &on_gpu, draw);
    assert!(off.is_empty(), "{settings:?} {limit:?}: {off:?}");
}

/// Those of the pixels `places` of `on_gpu` that the CPU does not draw the same way from a thousandth of a pixel aside either.
///
/// A fragment ends at its disk's border with a third of its weight, so pixels whose ray passes the border of one show a step, and
/// whether they are within or beyond is rounding.
fn without_ties(
    camera: &Camera,
    mut places: Vec<(u32, u32)>,
    on_gpu: &LayerTile,
    draw: impl Fn(&Camera) -> LayerTile,
) -> Vec<(u32, u32)> {
    const ASIDE_PX: f64 = 1e-3;
    for (x, y) in [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)] {
        let Some(&(u, v)) = places.first() else { break };
        let depth = on_gpu.at(u, v).first().map_or(1.0, |boundary| f64::from(boundary.depth));
        let mut aside = camera.clone();
        aside.eye += (camera.right * x + camera.down * y) * (ASIDE_PX * camera.footprint(depth));
        let on_cpu = draw(&aside);
        places.retain(|&(x, y)| !same_pixel(camera, on_cpu.at(x, y), on_gpu.at(x, y)));
    }
    places
}

/// Both rules, each with one of the limits; both limits of either are held where there are several samples, and about the eye.
fn hold_both(gpu: &Gpu, model: &Model, camera: &Camera) {
    for (settings, limit) in BOTH_RULES.into_iter().zip([LayerLimit::Nearest, LayerLimit::All]) {
        hold_limit(gpu, model, camera, (limit, 1), settings);
    }
}

fn three_spheres() -> [Solid; 3] {
    [sphere([0.0; 3], 1.0), sphere([0.8, 0.1, 0.2], 0.7), sphere([0.2, -0.9, 0.3], 0.6)]
}

fn before_spheres() -> Camera {
    camera([1.0, -5.0, 2.0], [0.2, 0.0, 0.0], 30.0)
}

fn spheres_with_every_setting(gpu: &'static Gpu) {
    let model = model("(a | b) - c", &three_spheres(), 0.08);
    for settings in every_setting(Clip::Fragment) {
        hold_limit(gpu, &model, &before_spheres(), (LayerLimit::All, 1), settings);
    }
}

fn surfaces_with_every_setting(gpu: &'static Gpu) {
    let model = model("(a | b) - c", &three_spheres(), 0.08);
    for settings in every_setting(Clip::Surface) {
        hold_limit(gpu, &model, &before_spheres(), (LayerLimit::All, 1), settings);
    }
}

/// The paper's choices, and those of them that are ours.
fn in_picture(clip: Clip, unknown: Unknown) -> SplatSettings {
    SplatSettings { clip, unknown, ..SplatSettings::PAPER }
}

fn partners_that_meet_in_the_picture(gpu: &'static Gpu) {
    let model = model("(a | b) - c", &three_spheres(), 0.08);
    for clip in Clip::ALL {
        Unknown::ALL.into_iter().for_each(|unknown| hold(gpu, &model, &before_spheres(), 1, in_picture(clip, unknown)));
    }
}

fn partners_about_the_eye(gpu: &'static Gpu) {
    // Surfels whose cells are all of the picture's.
    let model = model("a - b", &[sphere([0.0; 3], 1.0), sphere([0.3, 0.0, 0.0], 0.71)], 0.12);
    let camera = camera([-0.99, 0.05, 0.03], [1.0, 0.2, 0.1], 70.0);
    Unknown::ALL.into_iter().for_each(|unknown| hold(gpu, &model, &camera, 1, in_picture(Clip::Fragment, unknown)));
}

fn half_space(point: [f64; 3], normal: [f64; 3]) -> Solid {
    Solid::HalfSpace { point: point.into(), normal: normal.into(), extent: 1.8 }
}

fn figure_4_a_cube_of_half_spaces(gpu: &'static Gpu) {
    let normals = [DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::NEG_Y, DVec3::Z, DVec3::NEG_Z];
    let leaves = normals.map(|normal| half_space((normal * 0.5).to_array(), normal.to_array()));
    hold_both(gpu, &model("a & b & c & d & e & f", &leaves, 0.12), &camera([2.2, -2.9, 2.0], [0.0; 3], 25.0));
}

fn figure_5_an_unknown_leaf_drops_out(gpu: &'static Gpu) {
    let leaves = [
        half_space([0.5, 0.0, 0.0], [1.0, 0.0, 0.0]),
        half_space([0.0, 0.5, 0.0], [0.0, 1.0, 0.0]),
        half_space([0.0; 3], [0.0, 0.0, 1.0]),
    ];
    let camera = Camera::look_at(DVec3::new(0.03, 0.02, 5.0), DVec3::ZERO, DVec3::Y, Lens::FovY(25.0), SIDE, SIDE);
    hold_both(gpu, &model("a & b & c", &leaves, 0.06), &camera.unwrap());
}

fn surfels_smaller_than_pixels(gpu: &'static Gpu) {
    hold_both(gpu, &model("(a | b) - c", &three_spheres(), 0.05), &camera([2.0, -10.0, 4.0], [0.2, 0.0, 0.0], 30.0));
}

fn coarse_surfels_beside_dense_ones(gpu: &'static Gpu) {
    // Lists of partners longer than are walked.
    let leaves = [sphere([0.75, -0.75, 0.0], 0.45), sphere([0.75, -0.75, 0.55], 0.55), sphere([0.0; 3], 1.0)];
    let fields = leaves.iter().zip([0.3, 0.03, 0.03]).map(|(solid, spacing)| scan(solid, spacing, DVec3::ZERO));
    let model = Model::new(&tree("c & (a | b)"), fields.collect(), looks(3));
    for inside in [Inside::TwoNearest, Inside::AnyPlane, Inside::Curved] {
        let settings = SplatSettings { inside, ..BOTH_RULES[1] };
        hold(gpu, &model, &camera([2.4, -2.6, 1.6], [0.6, -0.6, 0.2], 25.0), 1, settings);
    }
}

fn a_leaf_that_occurs_twice(gpu: &'static Gpu) {
    hold_both(gpu, &model("(a - b) | (b - a) | c", &three_spheres(), 0.08), &before_spheres());
}

fn a_tree_deeper_than_a_word(gpu: &'static Gpu) {
    // Every right operand is an expression: more of them wait than a word has bits.
    let count = 36;
    let mut text = name(count - 1);
    let mut leaves = Vec::new();
    for i in 0..count {
        let turn = 2.4 * f64::from(i);
        let height = 1.0 - 2.0 * f64::from(i) / f64::from(count);
        let across = (1.0 - height * height).sqrt();
        leaves.push(sphere([across * turn.cos(), across * turn.sin(), height], 0.3 + 0.02 * f64::from(i % 5)));
    }
    for i in (0..count - 1).rev() {
        text = format!("{} {} ({text})", name(i), if i % 3 == 2 { "-" } else { "|" });
    }
    hold_both(gpu, &model(&text, &leaves, 0.07), &camera([1.0, -5.0, 2.0], [0.0; 3], 32.0));
}

fn more_near_leaves_than_a_truth_table_has(gpu: &'static Gpu) {
    hold_both(gpu, &nine_near_spheres(), &camera([0.5, -2.0, 4.5], [0.0; 3], 30.0));
}

fn an_orthographic_camera(gpu: &'static Gpu) {
    let camera = Camera::look_at(DVec3::new(2.0, -4.0, 3.0), DVec3::ZERO, DVec3::Z, Lens::Height(3.2), SIDE, SIDE);
    hold_both(gpu, &model("a - b", &torus_and_cylinder(), 0.07), &camera.unwrap());
}

fn far_from_the_origin_and_magnified(gpu: &'static Gpu) {
    let shift = DVec3::new(1e6, -2e6, 5e5);
    let [torus, cylinder] = torus_and_cylinder();
    let fields = vec![scan(&torus, 0.07, shift), scan(&cylinder, 0.07, shift)];
    let model = Model::new(&tree("a - b"), fields, looks(2));
    let camera = camera((shift + DVec3::new(2.0, -4.0, 3.0)).to_array(), shift.to_array(), 35.0);
    hold(gpu, &model, &camera, 1, BOTH_RULES[0]);
    let edge = shift + DVec3::new(1.0, -0.35, 0.3);
    hold_both(gpu, &model, &camera.zoomed(edge, 10.0).unwrap());
}

fn the_eye_among_the_surfels(gpu: &'static Gpu) {
    let model = model("a - b", &[sphere([0.0; 3], 1.0), sphere([0.3, 0.0, 0.0], 0.7)], 0.08);
    for eye in [[-0.9, 0.0, 0.0], [-0.99, 0.05, 0.03], [-1.02, 0.05, 0.03], [0.2, 0.1, 0.0]] {
        hold_both(gpu, &model, &camera(eye, [1.0, 0.2, 0.1], 70.0));
    }
}

fn leaves_that_light_shines_through(gpu: &'static Gpu) {
    let fields = three_spheres().iter().map(|solid| scan(solid, 0.08, DVec3::ZERO)).collect();
    let mut looks = looks(3);
    looks[0].opacity = 0.4;
    looks[2].opacity = 0.7;
    hold_both(gpu, &Model::new(&tree("(a | b) - c"), fields, looks), &before_spheres());
}

fn a_sheet_is_cut_and_never_cuts(gpu: &'static Gpu) {
    let sheet = Solid::HalfSpace { point: DVec3::ZERO, normal: DVec3::new(0.2, -1.0, 0.3), extent: 1.4 };
    let mut fields: Vec<LeafField> =
        [sheet, sphere([0.3, 0.0, 0.2], 0.6)].iter().map(|solid| scan(solid, 0.07, DVec3::ZERO)).collect();
    fields[0].kind = LeafKind::Sheet;
    hold_both(gpu, &Model::new(&tree("a - b"), fields, looks(2)), &camera([1.0, -5.0, 2.0], [0.0; 3], 30.0));
}

fn surfels_that_are_ellipses(gpu: &'static Gpu) {
    let model = elliptical_spheres();
    for inside in [Inside::AnyPlane, Inside::Blend, Inside::Curved] {
        let settings = SplatSettings { inside, ..BOTH_RULES[1] };
        hold(gpu, &model, &camera([1.0, -5.0, 2.0], [0.0; 3], 30.0), 1, settings);
    }
}

fn several_samples_a_pixel(gpu: &'static Gpu) {
    let fields = three_spheres().iter().map(|solid| scan(solid, 0.08, DVec3::ZERO)).collect();
    let mut looks = looks(3);
    looks[1].opacity = 0.5;
    let model = Model::new(&tree("(a | b) - c"), fields, looks);
    hold(gpu, &model, &before_spheres(), 4, BOTH_RULES[0]);
}

/// A frame in the paper's way of which parts can be drawn, with room for so many fragments and hits at first.
fn with_frame<T>(
    gpu: &Gpu,
    model: &Model,
    camera: &Camera,
    room: Option<u32>,
    draw: impl FnOnce(&dyn Fn(PixelRect) -> LayerTile) -> T,
) -> T {
    let uploaded = GpuSplatModel::new(gpu, model).unwrap();
    let clipping = GpuClipping::new(gpu, model, &uploaded, BOTH_RULES[0], None).unwrap();
    let frame = GpuSplatFrame::new(model, &uploaded, camera.clone(), LayerLimit::All, 1, clipping.as_ref()).unwrap();
    let frame = match room {
        Some(room) => frame.with_room(room),
        None => frame,
    };
    draw(&|rect| gpu.checked(|| frame.draw(gpu, rect)?.download(gpu)).unwrap())
}

fn parts_of_a_picture_are_the_same_bits(gpu: &'static Gpu) {
    let model = model("a - b", &torus_and_cylinder(), 0.08);
    let camera = camera([2.0, -4.0, 3.0], [0.0; 3], 35.0);
    with_frame(gpu, &model, &camera, None, |draw| {
        let picture = draw(whole(&camera));
        for rect in [PixelRect { x0: 13, y0: 5, x1: 60, y1: 71 }, PixelRect { x0: 0, y0: 40, x1: SIDE, y1: 41 }] {
            let part = draw(rect);
            for y in rect.y0..rect.y1 {
                (rect.x0..rect.x1).for_each(|x| assert_eq!(part.at(x, y), picture.at(x, y), "{x} {y}"));
            }
        }
    });
}

fn no_surfel_is_lost_where_room_is_short(gpu: &'static Gpu) {
    // More than a hundred fragments a pixel.
    let model = stack_of_squares(20);
    let camera = camera([0.0, -40.0, 0.0], [0.0; 3], 0.288);
    let middle = SIDE / 2;
    let rect = PixelRect { x0: middle - 8, y0: middle - 7, x1: middle + 9, y1: middle + 8 };
    let drawn = |room| with_frame(gpu, &model, &camera, room, |draw| draw(rect));
    let (short, ample) = (drawn(Some(1)), drawn(None));
    assert_eq!(short.offsets, ample.offsets);
    assert_eq!(short.boundaries, ample.boundaries);
    let most = ample.offsets.windows(2).map(|w| w[1] - w[0]).max();
    assert_eq!(most, Some(20));
    let on_cpu = Frame::new(&model, camera.clone(), LayerLimit::All, 1, BOTH_RULES[0], None).draw(rect);
    let compared = compare(&camera, &on_cpu, &ample);
    assert!(compared.differing as f64 <= ALLOWED * compared.covered as f64, "{compared:?}");
}

fn too_many_fragments_for_the_driver_are_told(gpu: &'static Gpu) {
    // More than a thousand fragments a pixel: llvmpipe ends loops early, which must not be a picture with less.
    let model = stack_of_squares(200);
    let camera = camera([0.0, -40.0, 0.0], [0.0; 3], 0.288);
    let rect = PixelRect { x0: SIDE / 2, y0: SIDE / 2, x1: SIDE / 2 + 4, y1: SIDE / 2 + 4 };
    let uploaded = GpuSplatModel::new(gpu, &model).unwrap();
    let clipping = GpuClipping::new(gpu, &model, &uploaded, BOTH_RULES[0], None).unwrap();
    let frame = GpuSplatFrame::new(&model, &uploaded, camera, LayerLimit::All, 1, clipping.as_ref()).unwrap();
    match gpu.checked(|| frame.draw(gpu, rect)?.download(gpu)) {
        Ok(drawn) => assert!(drawn.offsets.windows(2).all(|w| w[1] - w[0] == 200)),
        Err(error) => assert_eq!(error, GpuError::CutShort),
    }
}

fn the_comparison_can_fail(gpu: &'static Gpu) {
    let camera = before_spheres();
    let of = |radius: f64| {
        let leaves = [sphere([0.0; 3], 1.0), sphere([0.2, -0.9, 0.3], radius)];
        draw_both(gpu, &model("a - b", &leaves, 0.08), &camera, (LayerLimit::Nearest, 1), BOTH_RULES[0])
    };
    // A cutter that is half a pixel larger.
    let (on_cpu, on_gpu) = (of(0.6).0, of(0.6 + 0.5 * camera.footprint(5.0)).1);
    let compared = compare(&camera, &on_cpu, &on_gpu);
    assert!(compared.off_edges as f64 > ALLOWED * compared.covered as f64, "{compared:?}");
}
