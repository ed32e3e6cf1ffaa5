//! The mesh pipeline on the GPU against that on the CPU, layer by layer.

use std::path::Path;
use std::sync::Arc;

use glam::{DAffine3, DVec3};

use surfcut::blister::{MeshFrame, MeshLeaf, MeshModel, MeshShape};
use surfcut::csg::{LeafId, TreeBuilder};
use surfcut::formats::NoProgress;
use surfcut::geometry::Solid;
use surfcut::gpu::blister::{Classifier, GpuMeshFrame};
use surfcut::gpu::layers::{GpuLayerSource, in_parts};
use surfcut::gpu::{Gpu, GpuError};
use surfcut::layers::{Facing, LayerLimit, LayerStack, LayerTile};
use surfcut::pipeline::{Density, mesh_model};
use surfcut::scene::represent::Representation;
use surfcut::scene::{LeafGeometry, LeafKind, LoadedScene, Scene, load, toml_file};
use surfcut::space::{Camera, Lens, PixelRect};

use crate::Test;

pub const TESTS: &[Test] = &[
    ("meshes_have_the_layers_of_the_cpu", meshes_have_the_layers_of_the_cpu),
    ("solids_have_the_layers_of_the_cpu", solids_have_the_layers_of_the_cpu),
    ("several_samples_have_the_layers_of_the_cpu", several_samples_have_the_layers_of_the_cpu),
    ("layers_that_end_a_product_need_no_test", layers_that_end_a_product_need_no_test),
    ("a_list_that_is_too_short_grows", a_list_that_is_too_short_grows),
    ("two_hundred_layers_at_a_pixel_are_all_there", two_hundred_layers_at_a_pixel_are_all_there),
    (
        "the_nearest_surface_is_found_behind_any_number_of_layers",
        the_nearest_surface_is_found_behind_any_number_of_layers,
    ),
    ("a_walk_that_the_driver_ends_is_told", a_walk_that_the_driver_ends_is_told),
    ("no_fragment_of_twenty_million_is_lost", no_fragment_of_twenty_million_is_lost),
    ("a_result_without_a_surface_is_empty", a_result_without_a_surface_is_empty),
    ("an_eye_inside_a_solid_sees_it_from_within", an_eye_inside_a_solid_sees_it_from_within),
    ("an_eye_in_a_section_plane_sees_what_the_cpu_sees", an_eye_in_a_section_plane_sees_what_the_cpu_sees),
    ("a_comparison_of_different_scenes_fails", a_comparison_of_different_scenes_fails),
];

fn loaded(name: &str, size: (u32, u32)) -> LoadedScene {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("data/{name}.toml"));
    let scene = Scene { size, ..toml_file::read(&path).unwrap() };
    load(scene, &Default::default(), &NoProgress).unwrap()
}

/// The scene with every bounded solid as a mesh.
fn as_meshes(mut loaded: LoadedScene) -> LoadedScene {
    let names: Vec<String> = loaded.scene.leaves.iter().map(|leaf| leaf.name.clone()).collect();
    for (name, geometry) in names.iter().zip(loaded.geometry.clone()) {
        if matches!(&geometry, LeafGeometry::Solid(solid) if solid.bounds().is_some()) {
            loaded.represent(name, Representation::Mesh).unwrap();
        }
    }
    loaded
}

fn model(loaded: &LoadedScene) -> (MeshModel, Camera) {
    let camera = loaded.camera().unwrap();
    (mesh_model(loaded, &camera, Density::default()).unwrap(), camera)
}

fn whole(camera: &Camera) -> PixelRect {
    PixelRect { x0: 0, y0: 0, x1: camera.width, y1: camera.height }
}

fn drawn(gpu: &Gpu, frame: &GpuMeshFrame) -> Vec<LayerTile> {
    let mut tiles = Vec::new();
    let mut draw = |rect| {
        tiles.push(frame.draw(gpu, rect)?.download(gpu)?);
        Ok::<_, GpuError>(())
    };
    gpu.checked(|| in_parts(whole(frame.camera()), &mut draw)).unwrap();
    tiles
}

/// Pixels whose lists differ, of how many.
fn differing(cpu: &LayerStack, gpu: &[LayerTile]) -> (usize, usize) {
    let (mut wrong, mut all) = (0, 0);
    for tile in gpu {
        for y in tile.rect.y0..tile.rect.y1 {
            for x in tile.rect.x0..tile.rect.x1 {
                let (a, b) = (cpu.at(x, y), tile.at(x, y));
                let same = a.len() == b.len()
                    && a.iter().zip(b).all(|(a, b)| {
                        (a.leaf, a.body, a.facing, a.samples) == (b.leaf, b.body, b.facing, b.samples)
                            && (a.depth - b.depth).abs() <= 1e-5 * a.depth
                            && a.normal.distance(b.normal) < 1e-3
                            && a.colour.iter().zip(b.colour).all(|(a, b)| (a - b).abs() < 1e-3)
                    });
                wrong += usize::from(!same);
                all += usize::from(!a.is_empty() || !b.is_empty());
            }
        }
    }
    (wrong, all)
}

/// Holds the GPU's layers against the CPU's.
fn check(gpu: &Gpu, name: &str, loaded: &LoadedScene, samples: u32) {
    let (model, camera) = model(loaded);
    for limit in [LayerLimit::Nearest, LayerLimit::All] {
        let frame = || MeshFrame::new(&model, camera.clone(), limit, samples);
        let cpu = LayerStack::collect(&frame());
        for classifier in Classifier::ALL {
            let of_gpu = GpuMeshFrame::new(frame(), classifier);
            let (wrong, all) = differing(&cpu, &drawn(gpu, &of_gpu));
            let what = format!("{name}, {limit:?}, {}", classifier.name());
            assert!(all > 1000, "{what}: only {all} pixels show anything");
            assert!(wrong as f64 <= 0.001 * all as f64, "{what}: {wrong} of {all} pixels differ");
        }
    }
}

fn meshes_have_the_layers_of_the_cpu(gpu: &'static Gpu) {
    for name in ["widget", "spanner", "overlap", "bearing", "mesh_minus_mesh"] {
        check(gpu, name, &as_meshes(loaded(name, (200, 150))), 1);
    }
}

fn solids_have_the_layers_of_the_cpu(gpu: &'static Gpu) {
    for name in ["widget", "spanner", "overlap", "bearing"] {
        check(gpu, name, &loaded(name, (120, 90)), 1);
    }
}

fn several_samples_have_the_layers_of_the_cpu(gpu: &'static Gpu) {
    check(gpu, "widget", &as_meshes(loaded("widget", (120, 90))), 4);
}

fn layers_that_end_a_product_need_no_test(gpu: &'static Gpu) {
    // A difference of two meshes is one product, a union is none.
    for (name, is_product) in [("mesh_minus_mesh", true), ("widget", true), ("overlap", false)] {
        let (model, camera) = model(&as_meshes(loaded(name, (120, 90))));
        let frame = || MeshFrame::new(&model, camera.clone(), LayerLimit::All, 1);
        let cpu = LayerStack::collect(&frame());
        let backs = cpu.tiles().iter().flat_map(|tile| &tile.boundaries).filter(|b| b.facing == Facing::Back).count();
        for is_short in [false, true] {
            let of_gpu = GpuMeshFrame::new(frame(), Classifier::Parity).short(is_short);
            let (wrong, all) = differing(&cpu, &drawn(gpu, &of_gpu));
            assert!(wrong * 1000 <= all, "{name}, {is_short}: {wrong} of {all} pixels differ");
            let untested = of_gpu.peeling().untested as usize;
            if is_product && is_short {
                // Where a pixel differs there may be one more or one less.
                assert!(untested.abs_diff(backs) <= 2 * wrong, "{untested} layers without a test, {backs} backs");
            } else {
                assert_eq!(untested, 0, "{name}");
            }
        }
    }
}

fn a_list_that_is_too_short_grows(gpu: &'static Gpu) {
    let (model, camera) = model(&as_meshes(loaded("widget", (100, 100))));
    let frame = || MeshFrame::new(&model, camera.clone(), LayerLimit::All, 1);
    let cpu = LayerStack::collect(&frame());
    for classifier in Classifier::ALL {
        let short = GpuMeshFrame::new(frame(), classifier).with_first_length(1);
        let (wrong, all) = differing(&cpu, &drawn(gpu, &short));
        assert!(wrong * 1000 <= all, "{}: {wrong} of {all}", classifier.name());
    }
}

/// Plates one behind the other, seen from the front; the picture lies within all of them.
fn plates(count: u32, side: u32) -> (MeshModel, Camera) {
    let plate = |number: u32| {
        let z = -f64::from(number);
        let solid = Solid::Box { min: DVec3::new(-9.0, -9.0, z - 0.5), max: DVec3::new(9.0, 9.0, z) };
        leaf(number, solid)
    };
    let leaves: Vec<MeshLeaf> = (0..count).map(plate).collect();
    let mut union = TreeBuilder::default();
    for number in 0..count {
        union.leaf(LeafId(number));
        if number > 0 {
            union.or();
        }
    }
    (MeshModel::new(&leaves, &union.finish().unwrap()).unwrap(), down(side))
}

/// Straight down, without perspective.
fn down(side: u32) -> Camera {
    Camera::look_at(DVec3::new(0.0, 0.0, 5.0), DVec3::ZERO, DVec3::Y, Lens::Height(4.0), side, side).unwrap()
}

fn leaf(number: u32, solid: Solid) -> MeshLeaf {
    MeshLeaf {
        leaf: LeafId(number),
        shape: MeshShape::Mesh(Arc::new(solid.tessellate(0.01).unwrap())),
        world_from_leaf: DAffine3::IDENTITY,
        colour: [0.5; 3],
        vertex_colours: false,
        opacity: 1.0,
        kind: LeafKind::Solid,
    }
}

/// Every pixel of every tile sees the front and the back of every plate, in their order.
fn assert_all_plates(what: &str, tiles: &[LayerTile], count: u32, side: u32) {
    let pixels: usize = tiles.iter().map(|tile| tile.rect.area()).sum();
    assert_eq!(pixels, (side * side) as usize);
    for tile in tiles {
        for (x, y) in (tile.rect.y0..tile.rect.y1).flat_map(|y| (tile.rect.x0..tile.rect.x1).map(move |x| (x, y))) {
            let found = tile.at(x, y);
            assert_eq!(found.len(), 2 * count as usize, "{what}, at ({x}, {y})");
            for (i, boundary) in found.iter().enumerate() {
                let facing = if i % 2 == 0 { Facing::Front } else { Facing::Back };
                assert_eq!((boundary.leaf, boundary.facing), (i as u32 / 2, facing), "{what}, at ({x}, {y})");
            }
        }
    }
}

fn two_hundred_layers_at_a_pixel_are_all_there(gpu: &'static Gpu) {
    let (model, camera) = plates(100, 8);
    for classifier in Classifier::ALL {
        let frame = MeshFrame::new(&model, camera.clone(), LayerLimit::All, 1);
        let frame = GpuMeshFrame::new(frame, classifier).with_first_length(1);
        assert_all_plates(classifier.name(), &drawn(gpu, &frame), 100, 8);
    }
}

/// Plates of which a block takes away all but the last, down to within it, flush with it, or less far; and a sheet before a part of
/// the picture.
fn the_nearest_surface_is_found_behind_any_number_of_layers(gpu: &'static Gpu) {
    let solid = |low: f64, high: f64, half_side: f64| {
        let min = DVec3::new(-half_side, -half_side, low);
        Solid::Box { min, max: DVec3::new(half_side, half_side, high) }
    };
    for count in [2, 4, 5, 20, 40, 100] {
        let last = -f64::from(count - 1);
        for below in [0.25, 0.0, -0.25, -0.5] {
            for has_sheet in [false, true] {
                let plate = |number: u32| leaf(number, solid(-f64::from(number) - 0.5, -f64::from(number), 9.0));
                let mut leaves: Vec<MeshLeaf> = (0..count).map(plate).collect();
                leaves.push(leaf(count, solid(last + below, 1.0, 9.0)));
                let mut tree = TreeBuilder::default();
                tree.leaf(LeafId(0));
                (1..count).for_each(|number| {
                    tree.leaf(LeafId(number)).or();
                });
                tree.leaf(LeafId(count)).minus();
                if has_sheet {
                    let sheet = leaf(count + 1, solid(last / 2.0 + 0.1, last / 2.0 + 0.2, 1.0));
                    leaves.push(MeshLeaf { kind: LeafKind::Sheet, ..sheet });
                    tree.leaf(LeafId(count + 1)).or();
                }
                let model = MeshModel::new(&leaves, &tree.finish().unwrap()).unwrap();
                let frame = || MeshFrame::new(&model, down(32), LayerLimit::Nearest, 1);
                let cpu = LayerStack::collect(&frame());
                let (wrong, all) = differing(&cpu, &drawn(gpu, &GpuMeshFrame::new(frame(), Classifier::List)));
                let what = format!("{count} plates, cut {below} above the last, with a sheet: {has_sheet}");
                assert!(wrong == 0 && all >= if below > -0.5 { 32 * 32 } else { 0 }, "{what}: {wrong} of {all}");
            }
        }
    }
}

/// Plates behind one another, of which the last alone is on the result, under expressions so long that llvmpipe ends the walk
/// over them: a picture that lacks something must not pass for one.
fn a_walk_that_the_driver_ends_is_told(gpu: &'static Gpu) {
    let brick = |centre: DVec3, half: DVec3| Solid::Box { min: centre - half, max: centre + half };
    let speck = |x: f64| brick(DVec3::new(x, 0.9, 1.0), DVec3::splat(1e-3));
    const PLATES: u32 = 28;
    for products in [100, 2500] {
        let (mut leaves, mut tree) = (Vec::new(), TreeBuilder::default());
        for number in 0..products {
            let plate = brick(DVec3::new(0.0, 0.0, -0.1 * f64::from(number)), DVec3::new(1.5, 1.5, 0.01));
            leaves.push(leaf(2 * number, if number < PLATES { plate } else { speck(0.9) }));
            leaves.push(leaf(2 * number + 1, speck(-0.9)));
            tree.leaf(LeafId(2 * number)).leaf(LeafId(2 * number + 1)).and();
            if number > 0 {
                tree.or();
            }
        }
        leaves.push(leaf(2 * products, brick(DVec3::new(0.0, 0.0, -4.0), DVec3::new(1.0, 1.0, 0.5))));
        tree.leaf(LeafId(2 * products)).or();
        let model = MeshModel::new(&leaves, &tree.finish().unwrap()).unwrap();
        let frame = || MeshFrame::new(&model, down(32), LayerLimit::Nearest, 1);
        let on_gpu = GpuMeshFrame::new(frame(), Classifier::List);
        match gpu.checked(|| on_gpu.draw(gpu, whole(on_gpu.camera()))?.download(gpu)) {
            Ok(tile) => {
                let (wrong, all) = differing(&LayerStack::collect(&frame()), &[tile]);
                assert!(wrong == 0 && all > 0, "{products} products: {wrong} of {all}");
            }
            Err(error) => assert!(error == GpuError::CutShort && products > 1000, "{products} products: {error}"),
        }
    }
}

fn no_fragment_of_twenty_million_is_lost(gpu: &'static Gpu) {
    // Twenty million fragments, more than one buffer holds.
    let (model, camera) = plates(50, 448);
    let frame = MeshFrame::new(&model, camera, LayerLimit::All, 1);
    let frame = GpuMeshFrame::new(frame, Classifier::List).with_first_length(1000);
    let tiles = drawn(gpu, &frame);
    assert!(tiles.len() > 1);
    assert_all_plates("list", &tiles, 50, 448);
}

fn a_result_without_a_surface_is_empty(gpu: &'static Gpu) {
    let block = Solid::Box { min: DVec3::splat(-1.0), max: DVec3::splat(1.0) };
    let mut nothing = TreeBuilder::default();
    nothing.leaf(LeafId(0)).leaf(LeafId(1)).minus();
    // The same block twice: coincident faces toggle together.
    let leaves = [leaf(0, block.clone()), leaf(1, block)];
    let model = MeshModel::new(&leaves, &nothing.finish().unwrap()).unwrap();
    for classifier in Classifier::ALL {
        let frame = MeshFrame::new(&model, down(32), LayerLimit::All, 1);
        let tiles = drawn(gpu, &GpuMeshFrame::new(frame, classifier));
        assert!(tiles.iter().all(|tile| tile.boundaries.is_empty()), "{}", classifier.name());
    }
}

fn an_eye_inside_a_solid_sees_it_from_within(gpu: &'static Gpu) {
    // A room with a pillar, and the eye within the room's wall's reach.
    let room = Solid::Box { min: DVec3::splat(-4.0), max: DVec3::splat(4.0) };
    let pillar = Solid::Box { min: DVec3::new(-0.5, 1.0, -9.0), max: DVec3::new(0.5, 2.0, 9.0) };
    let mut tree = TreeBuilder::default();
    tree.leaf(LeafId(0)).leaf(LeafId(1)).minus();
    let model = MeshModel::new(&[leaf(0, room), leaf(1, pillar)], &tree.finish().unwrap()).unwrap();
    let eye = DVec3::new(0.3, -3.0, 0.2);
    let camera = Camera::look_at(eye, DVec3::new(0.0, 1.0, 0.0), DVec3::Z, Lens::FovY(80.0), 96, 80).unwrap();
    let frame = || MeshFrame::new(&model, camera.clone(), LayerLimit::All, 1);
    let cpu = LayerStack::collect(&frame());
    for classifier in Classifier::ALL {
        let (wrong, all) = differing(&cpu, &drawn(gpu, &GpuMeshFrame::new(frame(), classifier)));
        assert!(all == 96 * 80 && wrong * 1000 <= all, "{}: {wrong} of {all}", classifier.name());
    }
}

fn an_eye_in_a_section_plane_sees_what_the_cpu_sees(gpu: &'static Gpu) {
    let block = Solid::Box { min: DVec3::splat(-1.0), max: DVec3::splat(1.0) };
    let half = Solid::HalfSpace { point: DVec3::ZERO, normal: DVec3::X, extent: 9.0 };
    let half = MeshLeaf { shape: MeshShape::Solid(half), ..leaf(1, block.clone()) };
    let mut tree = TreeBuilder::default();
    tree.leaf(LeafId(0)).leaf(LeafId(1)).and();
    let model = MeshModel::new(&[leaf(0, block), half], &tree.finish().unwrap()).unwrap();
    for x in [0.0, 0.5, -0.5] {
        for lens in [Lens::FovY(40.0), Lens::Height(4.0)] {
            let eye = DVec3::new(x, -5.0, 2.0);
            let camera = Camera::look_at(eye, DVec3::ZERO, DVec3::Z, lens, 64, 64).unwrap();
            let frame = || MeshFrame::new(&model, camera.clone(), LayerLimit::All, 1);
            let cpu = LayerStack::collect(&frame());
            for classifier in Classifier::ALL {
                let (wrong, _) = differing(&cpu, &drawn(gpu, &GpuMeshFrame::new(frame(), classifier)));
                assert!(wrong <= 4, "eye at {x}, {lens:?}, {}: {wrong} pixels differ", classifier.name());
            }
        }
    }
}

fn a_comparison_of_different_scenes_fails(gpu: &'static Gpu) {
    let (model, camera) = model(&as_meshes(loaded("widget", (100, 100))));
    let cpu = LayerStack::collect(&MeshFrame::new(&model, camera, LayerLimit::All, 1));
    let (other, camera) = self::model(&as_meshes(loaded("bearing", (100, 100))));
    let frame = MeshFrame::new(&other, camera, LayerLimit::All, 1);
    let (wrong, all) = differing(&cpu, &drawn(gpu, &GpuMeshFrame::new(frame, Classifier::List)));
    assert!(wrong * 2 > all, "only {wrong} of {all} pixels differ between a widget and a bearing");
}
