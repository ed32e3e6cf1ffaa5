//! Scenes of scans together with meshes and solids: the GPU against the CPU, boundary by boundary.

use std::path::Path;
use std::process::Command;
use std::sync::Arc;

use glam::{DAffine3, DVec3};
use surfcut::blister::{MeshLeaf, MeshShape};
use surfcut::classify::{LeafField, LeafLook, Model};
use surfcut::csg::LeafId;
use surfcut::geometry::exact::Exact;
use surfcut::geometry::{Solid, TriMesh};
use surfcut::gpu::hybrid::{GpuHybridError, GpuHybridModel};
use surfcut::gpu::layers::in_parts;
use surfcut::gpu::splat::{GpuSplatError, GpuSplatFrame, GpuSplatModel};
use surfcut::gpu::{Gpu, GpuLayerSource};
use surfcut::hybrid::{HybridModel, exact_model};
use surfcut::layers::{LayerLimit, LayerSource, LayerTile};
use surfcut::scene::LeafKind;
use surfcut::space::{Camera, Lens, Motion, PixelRect};
use surfcut::surfel::SurfelCloud;

use crate::Test;
use crate::splat::{ALLOWED, Compared, camera, compare, looks, scan, sphere, tree, whole};

pub const TESTS: &[Test] = &[
    ("hybrid_a_scan_minus_each_kind_of_solid", a_scan_minus_each_kind_of_solid),
    ("hybrid_a_scan_minus_a_mesh", a_scan_minus_a_mesh),
    ("hybrid_a_union_of_all_kinds", a_union_of_all_kinds),
    ("hybrid_what_a_scan_has_in_a_solid_minus_a_mesh", what_a_scan_has_in_a_solid_minus_a_mesh),
    ("hybrid_what_is_in_one_alone", what_is_in_one_alone),
    ("hybrid_a_solid_inside_of_a_scan", a_solid_inside_of_a_scan),
    ("hybrid_solids_that_coincide", solids_that_coincide),
    ("hybrid_an_eye_inside_of_a_solid", an_eye_inside_of_a_solid),
    ("hybrid_a_section_without_perspective", a_section_without_perspective),
    ("hybrid_several_samples_a_pixel", several_samples_a_pixel),
    ("hybrid_many_plates_at_several_samples", many_plates_at_several_samples),
    ("hybrid_plates_whose_depths_round_to_one", plates_whose_depths_round_to_one),
    ("hybrid_leaves_that_light_shines_through", leaves_that_light_shines_through),
    ("hybrid_sheets_of_either_kind", sheets_of_either_kind),
    ("hybrid_forty_leaves", forty_leaves),
    ("hybrid_far_from_the_origin", far_from_the_origin),
    ("hybrid_no_crossing_is_lost_where_room_is_short", no_crossing_is_lost_where_room_is_short),
    ("hybrid_parts_of_a_picture_are_the_whole", parts_of_a_picture_are_the_whole),
    ("hybrid_leaves_that_move_are_uploaded_anew", leaves_that_move_are_uploaded_anew),
    ("hybrid_what_is_not_drawn_is_refused_by_name", what_is_not_drawn_is_refused_by_name),
    ("hybrid_the_program_chooses_what_a_gpu_draws", the_program_chooses_what_a_gpu_draws),
    ("hybrid_the_comparison_can_fail", the_comparison_can_fail),
];

/// What a leaf is drawn as.
#[derive(Clone)]
pub(crate) enum Form {
    Scan,
    Exact,
    Mesh,
}
pub(crate) use Form::{Exact as Own, Mesh, Scan};

/// A leaf of a test.
#[derive(Clone)]
pub(crate) struct TestLeaf {
    form: Form,
    solid: Solid,
    pub kind: LeafKind,
    opacity: f32,
}

pub(crate) fn leaf(form: Form, solid: Solid) -> TestLeaf {
    TestLeaf { form, solid, kind: LeafKind::Solid, opacity: 1.0 }
}

const SPACING: f64 = 0.05;

/// A picture that shows less proves little.
const LEAST_COVERED: usize = 250;

/// The leaves a, b, c … under an expression, moved by `shift`.
fn shifted(text: &str, leaves: &[TestLeaf], shift: DVec3) -> HybridModel {
    let world_from_leaf = DAffine3::from_translation(shift);
    let mut looks: Vec<LeafLook> = looks(leaves.len());
    let (mut fields, mut exact) = (Vec::new(), Vec::new());
    for (number, leaf) in leaves.iter().enumerate() {
        looks[number].opacity = leaf.opacity;
        let mut crossed = |shape: MeshShape| {
            exact.push(MeshLeaf {
                leaf: LeafId(number as u32),
                shape,
                world_from_leaf,
                colour: looks[number].colour.unwrap(),
                vertex_colours: false,
                opacity: leaf.opacity,
                kind: leaf.kind,
            });
        };
        let form = match leaf.form {
            Scan => {
                let mut field = scan(&leaf.solid, SPACING, shift);
                field.kind = leaf.kind;
                fields.push(field);
                continue;
            }
            Own => {
                crossed(MeshShape::Solid(leaf.solid.clone()));
                Exact::solid(leaf.solid.clone(), world_from_leaf)
            }
            Mesh => {
                let mesh = Arc::new(leaf.solid.tessellate(2e-3).unwrap());
                crossed(MeshShape::Mesh(Arc::clone(&mesh)));
                Exact::mesh(mesh, world_from_leaf).unwrap()
            }
        };
        fields.push(LeafField::new(SurfelCloud::default(), Some(form), leaf.kind));
    }
    let crossed = exact_model(&exact).unwrap();
    HybridModel::new(Model::new(&tree(text), fields, looks), crossed).with_leaves_at_rest(exact)
}

pub(crate) fn model(text: &str, leaves: &[TestLeaf]) -> HybridModel {
    shifted(text, leaves, DVec3::ZERO)
}

fn drawn(gpu: &Gpu, frame: &GpuSplatFrame, rect: PixelRect) -> LayerTile {
    gpu.checked(|| frame.draw(gpu, rect)?.download(gpu)).unwrap()
}

pub(crate) fn on_gpu(gpu: &Gpu, model: &HybridModel, camera: &Camera, limit: LayerLimit, samples: u32) -> LayerTile {
    let uploaded = GpuHybridModel::new(gpu, model).unwrap();
    drawn(gpu, &uploaded.frame(model, camera, limit, samples).unwrap(), whole(camera))
}

fn compared(gpu: &Gpu, model: &HybridModel, camera: &Camera, limit: LayerLimit, samples: u32) -> Compared {
    let on_cpu = model.frame(camera, limit, samples).draw(whole(camera));
    compare(camera, &on_cpu, &on_gpu(gpu, model, camera, limit, samples))
}

fn hold_samples(gpu: &Gpu, what: &str, model: &HybridModel, camera: &Camera, samples: u32) {
    for limit in [LayerLimit::Nearest, LayerLimit::All] {
        let compared = compared(gpu, model, camera, limit, samples);
        assert!(compared.covered > LEAST_COVERED, "{what}, {limit:?}: {compared:?}");
        assert!(compared.differing as f64 <= ALLOWED * compared.covered as f64, "{what}, {limit:?}: {compared:?}");
        assert_eq!(compared.off_edges, 0, "{what}, {limit:?}: {compared:?}");
    }
}

/// Both limits, held to the bar.
fn hold(gpu: &Gpu, what: &str, model: &HybridModel, camera: &Camera) {
    hold_samples(gpu, what, model, camera, 1);
}

fn aside() -> Camera {
    camera([1.0, -5.0, 2.0], [0.0; 3], 30.0)
}

fn ball() -> TestLeaf {
    leaf(Scan, sphere([0.0; 3], 1.0))
}

fn drill() -> Solid {
    Solid::Cylinder { from: DVec3::new(0.1, -1.6, 0.3), to: DVec3::new(-0.2, 1.5, 0.1), radius: 0.35 }
}

fn block() -> Solid {
    Solid::Box { min: DVec3::new(-1.2, -1.2, -0.6), max: DVec3::new(0.9, 0.7, 0.5) }
}

fn section() -> Solid {
    Solid::HalfSpace { point: DVec3::new(0.0, -0.3, 0.2), normal: DVec3::new(0.2, 1.0, -0.6), extent: 1.4 }
}

fn a_scan_minus_each_kind_of_solid(gpu: &'static Gpu) {
    let (from, to) = (DVec3::new(0.2, -1.8, 0.2), DVec3::new(0.0, 0.6, 0.0));
    let torus = Solid::Torus { centre: DVec3::new(0.0, -0.8, 0.1), axis: DVec3::Y, radius: 0.5, tube: 0.25 };
    for (what, solid) in [
        ("sphere", sphere([0.3, -0.8, 0.4], 0.6)),
        ("box", block()),
        ("cylinder", drill()),
        ("cone", Solid::Cone { from, to, radius_from: 0.8, radius_to: 0.1 }),
        ("torus", torus),
        ("half-space", section()),
    ] {
        hold(gpu, what, &model("a - b", &[ball(), leaf(Own, solid)]), &aside());
    }
}

fn a_scan_minus_a_mesh(gpu: &'static Gpu) {
    hold(gpu, "drill", &model("a - b", &[ball(), leaf(Mesh, drill())]), &aside());
    let both = [ball(), leaf(Mesh, drill()), leaf(Own, section())];
    hold(gpu, "drill and section", &model("a - b - c", &both), &aside());
}

fn a_union_of_all_kinds(gpu: &'static Gpu) {
    let leaves = [ball(), leaf(Mesh, block()), leaf(Own, drill())];
    hold(gpu, "union", &model("a | b | c", &leaves), &aside());
}

fn what_a_scan_has_in_a_solid_minus_a_mesh(gpu: &'static Gpu) {
    let leaves = [ball(), leaf(Own, block()), leaf(Mesh, drill())];
    hold(gpu, "a & b - c", &model("(a & b) - c", &leaves), &aside());
    hold(gpu, "a mesh minus a scan", &model("c - a", &leaves), &aside());
}

fn what_is_in_one_alone(gpu: &'static Gpu) {
    let leaves = [ball(), leaf(Own, block())];
    hold(gpu, "either", &model("(a - b) | (b - a)", &leaves), &aside());
}

fn a_solid_inside_of_a_scan(gpu: &'static Gpu) {
    // A hollow, a core in it, and a piece taken out so that both are seen.
    let leaves =
        [ball(), leaf(Own, sphere([0.0; 3], 0.8)), leaf(Mesh, sphere([0.1, 0.0, 0.0], 0.5)), leaf(Own, section())];
    hold(gpu, "core", &model("(a - b | c) & d", &leaves), &aside());
    hold(gpu, "uncut", &model("a - b | c", &leaves), &aside());
}

fn solids_that_coincide(gpu: &'static Gpu) {
    // Two boxes with a common face, one as a mesh, and a third that is the first one's twin.
    let left = Solid::Box { min: DVec3::new(-1.1, -1.3, -0.4), max: DVec3::new(0.1, 0.2, 0.4) };
    let right = Solid::Box { min: DVec3::new(0.1, -1.3, -0.4), max: DVec3::new(0.7, 0.2, 0.4) };
    let leaves = [ball(), leaf(Own, left.clone()), leaf(Mesh, right), leaf(Mesh, left)];
    for text in ["a - b - c", "a | b | c", "a - (b - d)", "(a | b) - d", "(b | c) - a", "(a & b) | (d - a)"] {
        hold(gpu, text, &model(text, &leaves), &aside());
    }
}

fn an_eye_inside_of_a_solid(gpu: &'static Gpu) {
    let leaves = [ball(), leaf(Own, block()), leaf(Mesh, drill())];
    // Few pixels: most surfels are in all of their lists.
    let side = 48;
    for (text, eye) in [("a - c", [0.0, 0.0, 0.2]), ("b | a", [0.7, 0.5, 0.3]), ("a - b", [-0.5, -0.5, 0.2])] {
        let target = DVec3::new(0.1, -1.0, 0.1);
        let camera = Camera::look_at(eye.into(), target, DVec3::Z, Lens::FovY(80.0), side, side).unwrap();
        hold(gpu, text, &model(text, &leaves), &camera);
    }
}

fn a_section_without_perspective(gpu: &'static Gpu) {
    let side = 96;
    let leaves = [ball(), leaf(Own, section()), leaf(Mesh, drill())];
    let eye = DVec3::new(0.3, -5.0, 2.0);
    let camera = Camera::look_at(eye, DVec3::ZERO, DVec3::Z, Lens::Height(2.6), side, side).unwrap();
    hold(gpu, "a & b - c", &model("a & b - c", &leaves), &camera);
    // Rays begin on either side of the section.
    let amid = Camera::look_at(DVec3::new(0.0, -0.3, 0.2), DVec3::Y, DVec3::Z, Lens::Height(2.6), side, side).unwrap();
    hold(gpu, "amid", &model("a & b - c", &leaves), &amid);
}

fn several_samples_a_pixel(gpu: &'static Gpu) {
    let mut leaves = [ball(), leaf(Own, section()), leaf(Mesh, drill())];
    hold_samples(gpu, "4", &model("a & b - c", &leaves), &aside(), 4);
    leaves[2].opacity = 0.5;
    hold_samples(gpu, "4, half through", &model("a & b | c", &leaves), &aside(), 4);
    let small = Camera::look_at(aside().eye, DVec3::ZERO, DVec3::Z, Lens::FovY(30.0), 40, 40).unwrap();
    hold_samples(gpu, "16", &model("a - c", &leaves), &small, 16);
}

/// Plates behind one another along y, from `first` on, as one mesh.
fn plates(count: usize, first: f64, apart: f64, side: f64) -> TriMesh {
    let mut all = TriMesh::default();
    for number in 0..count {
        let y = first + apart * number as f64;
        let plate = Solid::Box { min: DVec3::new(-side, y, -side), max: DVec3::new(side, y + 0.5 * apart, side) };
        let plate = plate.tessellate(1e-2).unwrap();
        let corners = all.positions.len() as u32;
        all.positions.extend(plate.positions);
        all.triangles.extend(plate.triangles.iter().map(|triangle| triangle.map(|corner| corner + corners)));
    }
    all
}

/// A scan and a mesh under an expression over `a` and `b`.
fn scan_and_mesh(text: &str, (scanned, kind): (&Solid, LeafKind), mesh: TriMesh) -> HybridModel {
    let mesh = Arc::new(mesh);
    let crossed = MeshLeaf {
        leaf: LeafId(1),
        shape: MeshShape::Mesh(Arc::clone(&mesh)),
        world_from_leaf: DAffine3::IDENTITY,
        colour: [0.5; 3],
        vertex_colours: false,
        opacity: 1.0,
        kind: LeafKind::Solid,
    };
    let exact = Exact::mesh(mesh, DAffine3::IDENTITY).unwrap();
    let field = LeafField::new(SurfelCloud::default(), Some(exact), LeafKind::Solid);
    let mut scanned = scan(scanned, SPACING, DVec3::ZERO);
    scanned.kind = kind;
    let model = Model::new(&tree(text), vec![scanned, field], looks(2));
    HybridModel::new(model, exact_model(&[crossed]).unwrap())
}

/// Eight pixels by eight.
fn few_pixels(eye: DVec3, fov_y: f64) -> Camera {
    Camera::look_at(eye, eye + DVec3::Y, DVec3::Z, Lens::FovY(fov_y), 8, 8).unwrap()
}

fn many_plates_at_several_samples(gpu: &'static Gpu) {
    // Nothing is asked of a sheet, so that all that is long are the lists of a pixel.
    let model = scan_and_mesh("a | b", (&sphere([40.0, 0.0, 0.0], 0.1), LeafKind::Sheet), plates(190, 0.0, 0.1, 1.0));
    let camera = few_pixels(DVec3::new(0.0, -4.0, 0.0), 2.0);
    let on_cpu = model.frame(&camera, LayerLimit::All, 2).draw(whole(&camera));
    assert_eq!(on_cpu.offsets.windows(2).map(|w| w[1] - w[0]).min(), Some(380));
    let compared = compare(&camera, &on_cpu, &on_gpu(gpu, &model, &camera, LayerLimit::All, 2));
    assert_eq!(compared.differing, 0, "{compared:?}");
}

fn plates_whose_depths_round_to_one(gpu: &'static Gpu) {
    // A hit's depth is told from that of the block's first surfel, which here is so far that those of all plates are one.
    let far = 1e5;
    let half = Solid::HalfSpace { point: DVec3::Y * far, normal: -DVec3::Y, extent: 1.0 };
    let model = scan_and_mesh("a | b", (&half, LeafKind::Solid), plates(5, 1.0, 1e-4, 0.5));
    let camera = few_pixels(DVec3::ZERO, 1e-3);
    let on_cpu = model.frame(&camera, LayerLimit::All, 1).draw(whole(&camera));
    let on_gpu = on_gpu(gpu, &model, &camera, LayerLimit::All, 1);
    assert!(on_cpu.offsets.windows(2).all(|w| w[1] - w[0] >= 10), "{:?}", on_cpu.offsets);
    assert_eq!(on_gpu.offsets, on_cpu.offsets);
}

fn leaves_that_light_shines_through(gpu: &'static Gpu) {
    let mut leaves = [ball(), leaf(Own, block()), leaf(Mesh, drill())];
    for (leaf, opacity) in leaves.iter_mut().zip([0.4, 0.7, 1.0]) {
        leaf.opacity = opacity;
    }
    hold(gpu, "a | b - c", &model("a | b - c", &leaves), &aside());
}

fn sheets_of_either_kind(gpu: &'static Gpu) {
    let plane = |y: f64| Solid::HalfSpace { point: DVec3::Y * y, normal: DVec3::new(0.2, -1.0, 0.3), extent: 1.3 };
    let sheet = |leaf: TestLeaf| TestLeaf { kind: LeafKind::Sheet, ..leaf };
    let leaves = [sheet(leaf(Scan, plane(0.0))), leaf(Own, drill()), sheet(leaf(Own, plane(0.4))), ball()];
    hold(gpu, "a scanned sheet", &model("a - b", &leaves), &aside());
    hold(gpu, "both", &model("(a | c) & d - b", &leaves), &aside());
}

fn forty_leaves(gpu: &'static Gpu) {
    let mut text = "a".to_owned();
    let mut leaves = vec![ball()];
    for number in 1..40_u32 {
        let turn = 2.4 * f64::from(number);
        let height = 1.0 - 2.0 * f64::from(number) / 40.0;
        let across = (1.0 - height * height).sqrt();
        let solid = sphere([across * turn.cos(), across * turn.sin(), height], 0.25 + 0.02 * f64::from(number % 5));
        leaves.push(leaf([Own, Mesh, Scan][number as usize % 3].clone(), solid));
        text = format!("({text} {} {})", if number % 4 == 0 { "|" } else { "-" }, crate::splat::name(number));
    }
    hold(gpu, "forty", &model(&text, &leaves), &camera([1.0, -5.0, 2.0], [0.0; 3], 32.0));
}

fn far_from_the_origin(gpu: &'static Gpu) {
    let shift = DVec3::new(1e6, -2e6, 5e5);
    let leaves = [ball(), leaf(Own, block()), leaf(Mesh, drill())];
    let camera = camera((shift + DVec3::new(1.0, -5.0, 2.0)).to_array(), shift.to_array(), 30.0);
    hold(gpu, "far", &shifted("(a & b) - c", &leaves, shift), &camera);
}

fn no_crossing_is_lost_where_room_is_short(gpu: &'static Gpu) {
    let leaves = [ball(), leaf(Own, block()), leaf(Mesh, drill())];
    let model = model("a | b - c", &leaves);
    let camera = aside();
    let uploaded = GpuHybridModel::new(gpu, &model).unwrap();
    let frame = || uploaded.frame(&model, &camera, LayerLimit::All, 1).unwrap();
    let ample = drawn(gpu, &frame(), whole(&camera));
    let short = drawn(gpu, &frame().with_room(1), whole(&camera));
    assert!(ample.boundaries.len() > 10_000);
    assert_eq!(short.offsets, ample.offsets);
    assert_eq!(short.boundaries, ample.boundaries);
}

fn parts_of_a_picture_are_the_whole(gpu: &'static Gpu) {
    // Solids: where two triangles of a mesh meet, a rasteriser may give another part of the picture the other one of them.
    let leaves = [ball(), leaf(Own, block()), leaf(Own, drill())];
    let model = model("(a & b) - c", &leaves);
    let camera = aside();
    let uploaded = GpuHybridModel::new(gpu, &model).unwrap();
    let frame = uploaded.frame(&model, &camera, LayerLimit::All, 1).unwrap();
    let all = drawn(gpu, &frame, whole(&camera));
    let side = camera.width;
    for (x0, y0, x1, y1) in [(0, 0, side, side), (3, 5, 70, 37), (57, 43, 58, 44), (0, 0, 8, 8)] {
        let part = drawn(gpu, &frame, PixelRect { x0, y0, x1, y1 });
        for (x, y) in (y0..y1).flat_map(|y| (x0..x1).map(move |x| (x, y))) {
            assert_eq!(part.at(x, y), all.at(x, y), "({x}, {y})");
        }
    }
    // Too much for one buffer is drawn in parts.
    let mut parts = 0;
    let mut draw = |rect: PixelRect| {
        if rect.area() > 1000 {
            return Err(surfcut::gpu::GpuError::TooLarge { what: String::new(), needed: 0, limit: 0 });
        }
        parts += 1;
        let part = frame.draw(gpu, rect)?.download(gpu)?;
        let same = (rect.y0..rect.y1).flat_map(|y| (rect.x0..rect.x1).map(move |x| (x, y)));
        same.into_iter().for_each(|(x, y)| assert_eq!(part.at(x, y), all.at(x, y), "({x}, {y})"));
        Ok(())
    };
    gpu.checked(|| in_parts(whole(&camera), &mut draw)).unwrap();
    assert!(parts > 8);
}

fn leaves_that_move_are_uploaded_anew(gpu: &'static Gpu) {
    let mut model = model("a - b", &[ball(), leaf(Own, drill())]);
    let uploaded = GpuHybridModel::new(gpu, &model).unwrap();
    assert!(uploaded.is_of(&model));
    let motion = Motion { translation: DVec3::new(0.2, 0.0, 0.3), ..Motion::REST };
    model.pose(&[(LeafId(1), motion)]).unwrap();
    assert!(!uploaded.is_of(&model));
    hold(gpu, "moved", &model, &aside());
}

fn what_is_not_drawn_is_refused_by_name(gpu: &'static Gpu) {
    // A box without its lid.
    let mut mesh = block().tessellate(1e-2).unwrap();
    let is_lid = |t: &[u32; 3]| t.iter().all(|&v| mesh.positions[v as usize].z > 0.0);
    mesh.triangles = mesh.triangles.iter().copied().filter(|t| !is_lid(t)).collect();
    let open = MeshLeaf {
        leaf: LeafId(1),
        shape: MeshShape::Mesh(Arc::new(mesh.clone())),
        world_from_leaf: DAffine3::IDENTITY,
        colour: [0.5; 3],
        vertex_colours: false,
        opacity: 1.0,
        kind: LeafKind::Solid,
    };
    let exact = Exact::mesh(Arc::new(mesh), DAffine3::IDENTITY).unwrap();
    let field = LeafField::new(SurfelCloud::default(), Some(exact), LeafKind::Solid);
    let fields = vec![scan(&sphere([0.0; 3], 1.0), SPACING, DVec3::ZERO), field];
    let model = HybridModel::new(Model::new(&tree("a - b"), fields, looks(2)), exact_model(&[open]).unwrap());
    let refused = GpuHybridModel::new(gpu, &model).err();
    assert_eq!(refused, Some(GpuHybridError::OpenMesh { leaf: LeafId(1) }));
    // An exact leaf that nobody finds.
    let model = self::model("a - b", &[ball(), leaf(Own, drill())]);
    let uploaded = GpuSplatModel::new(gpu, model.surfels()).unwrap();
    let frame = GpuSplatFrame::new(model.surfels(), &uploaded, aside(), LayerLimit::All, 1, None);
    assert_eq!(frame.err(), Some(GpuSplatError::ExactLeaf { leaf: LeafId(1) }));
}

fn the_comparison_can_fail(gpu: &'static Gpu) {
    let camera = aside();
    let of = |radius: f64| model("a - b", &[ball(), leaf(Own, sphere([0.3, -0.8, 0.4], radius))]);
    // A cutter that is a quarter of a pixel larger.
    let pixel = camera.footprint(4.5);
    let on_cpu = of(0.6).frame(&camera, LayerLimit::Nearest, 1).draw(whole(&camera));
    let larger = on_gpu(gpu, &of(0.6 + 0.25 * pixel), &camera, LayerLimit::Nearest, 1);
    let compared = compare(&camera, &on_cpu, &larger);
    assert!(compared.off_edges as f64 > ALLOWED * compared.covered as f64, "{compared:?}");
}

fn the_program_chooses_what_a_gpu_draws(_: &'static Gpu) {
    let here = tempfile::tempdir().unwrap();
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/femoral_head.toml");
    let render = |name: &str, flags: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_surfcut"));
        command.current_dir(here.path()).arg("render").arg(&scene).args(["--size", "96x72"]).args(flags);
        command.args(["-o", &format!("{name}.png"), "--summary-file", &format!("{name}.json")]).output().unwrap()
    };
    let summary = |name: &str| -> serde_json::Value {
        serde_json::from_slice(&std::fs::read(here.path().join(format!("{name}.json"))).unwrap()).unwrap()
    };
    let picture = |name: &str| image::open(here.path().join(format!("{name}.png"))).unwrap().into_rgb8();
    for (name, flags, pipeline) in [("gpu", ["--backend", "gpu"], "hybrid"), ("cpu", ["--backend", "cpu"], "splat")] {
        let output = render(name, &flags);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        assert_eq!(summary(name)["settings"]["pipeline"], pipeline);
    }
    let (on_cpu, on_gpu) = (picture("cpu"), picture("gpu"));
    let differing = on_cpu.pixels().zip(on_gpu.pixels()).filter(|(a, b)| (0..3).any(|k| a[k].abs_diff(b[k]) > 2));
    assert!(differing.count() <= 2);
    // What is asked for in another way is refused for that, not for the solids beside it.
    let clipped = render("clipped", &["--backend", "gpu", "--clip", "fragment"]);
    let told = String::from_utf8_lossy(&clipped.stderr).into_owned();
    assert!(!clipped.status.success() && told.contains("clipped in another way"), "{told}");
    let ignored = render("ignored", &["--backend", "cpu", "--pipeline", "hybrid", "--clip", "fragment"]);
    let told = String::from_utf8_lossy(&ignored.stderr).into_owned();
    assert!(ignored.status.success() && told.contains("change nothing"), "{told}");
    // Samples of solids are not what the GPU draws.
    let refused = render("splat", &["--backend", "gpu", "--pipeline", "splat"]);
    let told = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(!refused.status.success() && told.contains("--pipeline hybrid"), "{told}");
}
