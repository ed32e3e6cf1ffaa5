use glam::{DMat3, DQuat, EulerRot};

use super::*;
use crate::geometry::solid::Ball;
use crate::layers::LayerStack;
use crate::space::Lens;

fn numbers(seed: u64) -> impl FnMut() -> f64 {
    let mut state = seed;
    move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let mixed = (state ^ (state >> 33)).wrapping_mul(0xFF51_AFD7_ED55_8CCD);
        ((mixed ^ (mixed >> 33)) >> 11) as f64 / (1u64 << 53) as f64
    }
}

fn random_point(uniform: &mut dyn FnMut() -> f64) -> DVec3 {
    DVec3::new(2.0 * uniform() - 1.0, 2.0 * uniform() - 1.0, 2.0 * uniform() - 1.0)
}

fn sphere(leaf: u32, x: f64, radius: f64) -> TruthLeaf {
    TruthLeaf::new(leaf, TruthShape::Solid(Solid::Sphere { centre: DVec3::X * x, radius }))
}

fn cube(leaf: u32, half: f64) -> TruthLeaf {
    TruthLeaf::new(leaf, TruthShape::Solid(Solid::Box { min: DVec3::splat(-half), max: DVec3::splat(half) }))
}

fn camera(lens: Lens, side: u32) -> Camera {
    Camera::look_at(DVec3::new(4.0, -2.5, 1.5), DVec3::ZERO, DVec3::Z, lens, side, side).unwrap()
}

/// Looks along +y from (0, −5, 0).
fn ahead(side: u32) -> Camera {
    Camera::look_at(DVec3::new(0.0, -5.0, 0.0), DVec3::ZERO, DVec3::Z, Lens::Height(4.0), side, side).unwrap()
}

fn judge(
    leaves: Vec<TruthLeaf>,
    camera: Camera,
    inside: impl Fn(&dyn Fn(u32) -> bool) -> bool + Send + Sync + 'static,
) -> Reference {
    Reference::with_expression(leaves, Box::new(inside), camera, 1, LayerLimit::All).unwrap()
}

fn tetrahedron() -> TriMesh {
    TriMesh {
        positions: vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z],
        triangles: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
        colours: None,
    }
}

/// A sphere of `rows` by `2·rows` quadrilaterals, each two triangles.
fn mesh_sphere(rows: u32, radius: f64) -> TriMesh {
    let columns = 2 * rows;
    let mut positions = vec![DVec3::Z * radius, DVec3::NEG_Z * radius];
    for i in 1..rows {
        for j in 0..columns {
            let (theta, phi) = (
                std::f64::consts::PI * f64::from(i) / f64::from(rows),
                std::f64::consts::TAU * f64::from(j) / f64::from(columns),
            );
            positions.push(DVec3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()) * radius);
        }
    }
    let at = |i: u32, j: u32| 2 + (i - 1) * columns + j % columns;
    let mut triangles = Vec::new();
    for j in 0..columns {
        triangles.push([0, at(1, j), at(1, j + 1)]);
        triangles.push([1, at(rows - 1, j + 1), at(rows - 1, j)]);
        for i in 1..rows - 1 {
            triangles.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
            triangles.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
        }
    }
    TriMesh { positions, triangles, colours: None }
}

#[test]
fn a_sphere_has_the_depths_that_geometry_says() {
    for lens in [Lens::FovY(40.0), Lens::Height(3.0)] {
        let camera = camera(lens, 64);
        let judge = judge(vec![sphere(0, 0.0, 1.0)], camera.clone(), |leaf| leaf(0));
        let mut covered = 0;
        for y in 0..64 {
            for x in 0..64 {
                let px = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
                let ray = camera.ray(px);
                let nearest = -ray.origin.dot(ray.dir) / ray.dir.length_squared();
                let clearance = ray.at(nearest).length();
                let found = judge.cast(px);
                if clearance >= 1.0 {
                    assert!(found.is_empty());
                    continue;
                }
                covered += 1;
                let half = (1.0 - clearance * clearance).sqrt() / ray.dir.length();
                assert_eq!(found.len(), 2);
                assert!((found[0].depth - (nearest - half)).abs() < 1e-12);
                assert!((found[1].depth - (nearest + half)).abs() < 1e-12);
                assert_eq!((found[0].facing, found[1].facing), (Facing::Front, Facing::Back));
                for b in found {
                    assert!((b.normal - ray.at(b.depth)).length() < 1e-12);
                    assert_eq!((b.leaf, b.body), (0, 0));
                }
            }
        }
        assert!(covered > 500);
    }
}

#[test]
fn a_drilled_box_shows_its_bore_as_the_drills_surface_and_the_boxes_body() {
    let drill = Solid::Cylinder { from: DVec3::Y * -3.0, to: DVec3::Y * 3.0, radius: 0.5 };
    let leaves = vec![TruthLeaf::new(0, TruthShape::Solid(drill)), cube(1, 1.0)];
    // Seen from aside, so that rays enter the front face or the bore's wall.
    let eye = DVec3::new(1.0, -5.0, 0.0);
    let camera = Camera::look_at(eye, DVec3::ZERO, DVec3::Z, Lens::FovY(40.0), 64, 64).unwrap();
    let judge = judge(leaves, camera.clone(), |leaf| leaf(1) && !leaf(0));
    // Through the middle of the picture: from (1, −5, 0) towards the origin. At y = −1 it is at x = 0.2, inside the bore;
    // it stays in the bore while |x| < 0.5, that is until y = 2.5: nothing is hit.
    assert!(judge.cast(DVec2::splat(32.0)).is_empty());
    // Towards (−0.6, 0, 0): at y = −1 it is at x = −0.28, in the bore; the wall x = −0.5 comes at y = −5 + 1.5/0.32.
    let target = camera.px_from_view(camera.view_from_world(DVec3::X * -0.6));
    let found = judge.cast(target);
    let wall = DVec3::new(-0.5, -5.0 + 1.5 / 0.32, 0.0);
    assert!((found[0].depth - camera.view_from_world(wall).z).abs() < 1e-10);
    assert_eq!((found[0].leaf, found[0].body, found[0].facing), (0, 1, Facing::Front));
    assert!((found[0].normal - DVec3::X).length() < 1e-9);
    // It leaves through the box's side x = −1, or its back y = 1, whichever is first: y at x = −1 is −5 + 2/0.32 = 1.25.
    assert_eq!((found[1].leaf, found[1].body, found[1].facing, found.len()), (1, 1, Facing::Back, 2));
    assert!((found[1].normal - DVec3::Y).length() < 1e-9);
}

#[test]
fn the_volume_of_a_lens_is_what_its_formula_says() {
    // Two unit spheres a distance d apart share π(4 + d)(2 − d)²/12.
    let d = 0.9;
    let side = 400;
    let judge = judge(vec![sphere(0, -0.5 * d, 1.0), sphere(1, 0.5 * d, 1.0)], ahead(side), |leaf| leaf(0) && leaf(1));
    let mut volume = 0.0;
    for tile in LayerStack::collect(&judge).tiles() {
        for b in &tile.boundaries {
            volume -= f64::from(b.depth) * f64::from(b.facing as i8);
        }
    }
    volume *= (4.0 / f64::from(side)).powi(2);
    let expected = std::f64::consts::PI * (4.0 + d) * (2.0 - d).powi(2) / 12.0;
    assert!((volume / expected - 1.0).abs() < 1e-3, "{volume} for {expected}");
}

fn three() -> Vec<TruthLeaf> {
    let mut tilted = cube(1, 0.7);
    tilted.world_from_leaf = DAffine3::from_quat(DQuat::from_euler(EulerRot::XYZ, 0.3, 0.5, 0.2));
    let mut mesh = TruthLeaf::new(2, TruthShape::Mesh(Arc::new(mesh_sphere(12, 0.9))));
    mesh.world_from_leaf = DAffine3::from_translation(DVec3::new(0.4, -0.3, 0.3));
    vec![sphere(0, 0.3, 0.8), tilted, mesh]
}

fn picture(judge: &Reference) -> Vec<Boundary> {
    LayerStack::collect(judge).tiles().iter().flat_map(|tile| tile.boundaries.clone()).collect()
}

#[test]
fn a_minus_a_is_empty_and_a_and_a_is_a() {
    let camera = camera(Lens::FovY(40.0), 48);
    for make in [
        |leaf| TruthLeaf { leaf, ..three().remove(0) },
        |leaf| TruthLeaf { leaf, ..three().remove(1) },
        |leaf| TruthLeaf { leaf, ..three().remove(2) },
    ] {
        let pair = || vec![make(0), make(1)];
        assert!(picture(&judge(pair(), camera.clone(), |leaf| leaf(0) && !leaf(1))).is_empty());
        let alone = picture(&judge(vec![make(0)], camera.clone(), |leaf| leaf(0)));
        assert!(!alone.is_empty());
        assert_eq!(picture(&judge(pair(), camera.clone(), |leaf| leaf(0) && leaf(1))), alone);
        assert_eq!(picture(&judge(pair(), camera.clone(), |leaf| leaf(0) || leaf(1))), alone);
    }
}

#[test]
fn coplanar_faces_of_a_union_show_no_seam() {
    let slab = |leaf, x0: f64, x1: f64| {
        let (min, max) = (DVec3::new(x0, -1.0, -1.0), DVec3::new(x1, 1.0, 1.0));
        TruthLeaf::new(leaf, TruthShape::Solid(Solid::Box { min, max }))
    };
    let camera = Camera::look_at(DVec3::X * -5.0, DVec3::ZERO, DVec3::Z, Lens::FovY(10.0), 16, 16).unwrap();
    let judge = judge(vec![slab(0, -1.0, 0.2), slab(1, 0.2, 1.0)], camera, |leaf| leaf(0) || leaf(1));
    let found = judge.cast(DVec2::splat(7.3));
    assert_eq!(found.len(), 2);
    assert_eq!((found[0].leaf, found[1].leaf), (0, 1));
}

#[test]
fn faces_that_coincide_but_for_rounding_toggle_together() {
    // A solid cube and a mesh of one, turned: their crossings are found by different sums.
    let turned = DAffine3::from_quat(DQuat::from_euler(EulerRot::XYZ, 0.3, 0.5, 0.2));
    let corner = |i: u32| DVec3::new(f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2)) * 1.4 - 0.7;
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let mesh = TriMesh {
        positions: (0..8).map(corner).collect(),
        triangles: quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect(),
        colours: None,
    };
    assert!((mesh.signed_volume() - 1.4f64.powi(3)).abs() < 1e-12);
    let mesh = TruthShape::Mesh(Arc::new(mesh));
    let pair =
        || [cube(0, 0.7), TruthLeaf::new(1, mesh.clone())].map(|l| TruthLeaf { world_from_leaf: turned, ..l }).to_vec();
    let camera = camera(Lens::FovY(40.0), 48);
    assert!(picture(&judge(pair(), camera.clone(), |leaf| leaf(0) && !leaf(1))).is_empty());
    assert!(picture(&judge(pair(), camera.clone(), |leaf| leaf(1) && !leaf(0))).is_empty());
    let both = picture(&judge(pair(), camera, |leaf| leaf(0) || leaf(1)));
    // Of leaves that tie the first owns.
    assert!(!both.is_empty() && both.iter().all(|b| b.leaf == 0));
}

#[test]
fn where_a_cutter_ends_and_a_solid_begins_the_solid_owns_the_face() {
    let slab = |leaf, x0: f64, x1: f64| {
        let (min, max) = (DVec3::new(x0, -1.0, -1.0), DVec3::new(x1, 1.0, 1.0));
        TruthLeaf::new(leaf, TruthShape::Solid(Solid::Box { min, max }))
    };
    let camera = Camera::look_at(DVec3::X * -5.0, DVec3::ZERO, DVec3::Z, Lens::FovY(10.0), 16, 16).unwrap();
    let judge = judge(vec![slab(0, -1.0, 0.2), slab(1, 0.2, 1.0)], camera, |leaf| leaf(1) && !leaf(0));
    let told: Vec<_> = judge.cast(DVec2::splat(7.3)).iter().map(|b| (b.leaf, b.body, b.facing)).collect();
    assert_eq!(told, [(1, 1, Facing::Front), (1, 1, Facing::Back)]);
}

#[test]
fn de_morgans_images_and_any_order_of_leaves_are_the_same_bits() {
    let camera = camera(Lens::FovY(40.0), 48);
    let plain = picture(&judge(three(), camera.clone(), |leaf| (leaf(0) || leaf(1)) && !leaf(2)));
    let turned = picture(&judge(three(), camera.clone(), |leaf| !((!leaf(0) && !leaf(1)) || leaf(2))));
    assert!(!plain.is_empty());
    assert_eq!(plain, turned);
    let mut leaves = three();
    leaves.rotate_left(1);
    assert_eq!(plain, picture(&judge(leaves, camera, |leaf| (leaf(0) || leaf(1)) && !leaf(2))));
}

#[test]
fn a_result_that_faces_both_ways_tells_bodies_and_normals_apart() {
    // The symmetric difference of two spheres, along the axis through both: −1.5, −0.5, 0.5, 1.5 from the middle.
    let camera = Camera::look_at(DVec3::X * -5.0, DVec3::ZERO, DVec3::Z, Lens::FovY(10.0), 16, 16).unwrap();
    let judge = judge(vec![sphere(0, -0.5, 1.0), sphere(1, 0.5, 1.0)], camera, |leaf| leaf(0) != leaf(1));
    let found = judge.cast(DVec2::splat(8.0));
    let told: Vec<_> = found.iter().map(|b| (b.leaf, b.body, b.facing, b.normal.x.round() as i32)).collect();
    use Facing::{Back, Front};
    assert_eq!(told, [(0, 0, Front, -1), (1, 0, Back, 1), (0, 1, Front, -1), (1, 1, Back, 1)]);
    for (b, depth) in found.iter().zip([3.5, 4.5, 5.5, 6.5]) {
        assert!((b.depth - depth).abs() < 1e-9);
    }
}

#[test]
fn an_eye_inside_sees_the_inside() {
    let camera = Camera::look_at(DVec3::ZERO, DVec3::X, DVec3::Z, Lens::FovY(40.0), 16, 16).unwrap();
    for leaf in [sphere(0, 0.1, 1.0), TruthLeaf::new(0, TruthShape::Mesh(Arc::new(mesh_sphere(9, 1.0))))] {
        let own = judge(vec![leaf.clone()], camera.clone(), |leaf| leaf(0)).cast(DVec2::splat(7.9));
        assert_eq!((own.len(), own[0].facing), (1, Facing::Back));
        let hollow = judge(vec![leaf], camera.clone(), |leaf| !leaf(0)).cast(DVec2::splat(7.9));
        assert_eq!((hollow.len(), hollow[0].facing), (1, Facing::Front));
        assert!((hollow[0].depth, hollow[0].normal.x < -0.9) == (own[0].depth, true));
    }
}

#[test]
fn a_half_space_cuts_everywhere_and_shows_within_its_square() {
    let plane = Solid::HalfSpace { point: DVec3::ZERO, normal: DVec3::NEG_Y, extent: 0.5 };
    let leaves = || vec![sphere(0, 0.0, 1.0), TruthLeaf::new(1, TruthShape::Solid(plane.clone()))];
    // Behind the plane y > 0 only: the section at y = 0, then the sphere's back.
    let judge = judge(leaves(), ahead(100), |leaf| leaf(0) && leaf(1));
    let middle = judge.cast(DVec2::splat(50.0));
    assert_eq!(middle.len(), 2);
    assert!((middle[0].depth - 5.0).abs() < 1e-12 && (middle[0].normal - DVec3::NEG_Y).length() < 1e-12);
    assert_eq!((middle[0].leaf, middle[0].body), (1, 1));
    // At x = 0.8 the plane is not drawn, but it has cut the sphere's front away.
    let aside = judge.cast(DVec2::new(70.0, 50.0));
    assert_eq!((aside.len(), aside[0].facing, aside[0].leaf), (1, Facing::Back, 0));
}

#[test]
fn a_sheet_is_cut_and_never_cuts() {
    let square = TriMesh {
        positions: vec![
            DVec3::new(-1.5, 0.0, -1.5),
            DVec3::new(1.5, 0.0, -1.5),
            DVec3::new(1.5, 0.0, 1.5),
            DVec3::new(-1.5, 0.0, 1.5),
        ],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        colours: None,
    };
    let sheet =
        |leaf| TruthLeaf { kind: LeafKind::Sheet, ..TruthLeaf::new(leaf, TruthShape::Mesh(Arc::new(square.clone()))) };
    // Pixel (50.2, 49.7) is near the middle, (77, 50.3) at x = 1.08.
    let (middle, aside) = (DVec2::new(50.2, 49.7), DVec2::new(77.0, 50.3));
    let cut = judge(vec![sheet(0), sphere(1, 0.0, 1.0)], ahead(100), |leaf| leaf(0) && !leaf(1));
    assert!(cut.cast(middle).is_empty());
    let found = cut.cast(aside);
    assert_eq!((found.len(), found[0].leaf, found[0].facing), (1, 0, Facing::Front));
    assert!((found[0].depth - 5.0).abs() < 1e-12 && (found[0].normal - DVec3::NEG_Y).length() < 1e-12);
    // A union shows it where it is not buried, and leaves the sphere whole.
    let union = judge(vec![sheet(0), sphere(1, 0.0, 1.0)], ahead(100), |leaf| leaf(0) || leaf(1));
    assert_eq!(union.cast(middle).iter().map(|b| b.leaf).collect::<Vec<_>>(), [1, 1]);
    assert_eq!(union.cast(aside).iter().map(|b| b.leaf).collect::<Vec<_>>(), [0]);
}

#[test]
fn a_mesh_sphere_is_the_sphere_to_within_its_sagitta() {
    let rows = 40;
    // Facets span at most π/rows along both directions; the diagonal is √2 times that.
    let sagitta = 1.0 - (std::f64::consts::PI / f64::from(rows) * 2f64.sqrt() / 2.0).cos();
    let (mut compared, camera) = (0, camera(Lens::FovY(35.0), 128));
    let exact = judge(vec![sphere(0, 0.0, 1.0)], camera.clone(), |leaf| leaf(0));
    let leaf = TruthLeaf::new(0, TruthShape::Mesh(Arc::new(mesh_sphere(rows, 1.0))));
    let faceted = judge(vec![leaf], camera.clone(), |leaf| leaf(0));
    for y in 0..128 {
        for x in 0..128 {
            let px = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
            let (a, b) = (exact.cast(px), faceted.cast(px));
            assert!(b.len() == 2 || b.is_empty());
            for hit in &b {
                let radius = camera.ray(px).at(hit.depth).length();
                assert!(radius <= 1.0 + 1e-12 && radius >= 1.0 - sagitta);
            }
            if let (Some(a), Some(b)) = (a.first(), b.first()) {
                let cos = -a.normal.dot(camera.ray(px).dir.normalize());
                if cos > 0.3 {
                    assert!((a.depth - b.depth).abs() < 1.2 * sagitta / cos);
                    compared += 1;
                }
            }
        }
    }
    assert!(compared > 3000);
}

#[test]
fn rays_through_edges_and_corners_of_a_mesh_keep_their_parity() {
    // An orthographic view along a diagonal of a tetrahedron and a sphere whose corners and edges fall on pixel centres.
    for mesh in [tetrahedron(), mesh_sphere(8, 1.0)] {
        let leaf = TruthLeaf::new(0, TruthShape::Mesh(Arc::new(mesh)));
        let judge = judge(vec![leaf], ahead(64), |leaf| leaf(0));
        for y in 0..=64 {
            for x in 0..=64 {
                let found = judge.cast(DVec2::new(f64::from(x), f64::from(y)));
                assert!(found.len() == 2 || found.is_empty(), "{x} {y}: {found:?}");
            }
        }
        // The middle of the picture is the origin: a corner of the tetrahedron, and inside the sphere.
        assert!(judge.cast(DVec2::new(36.0, 28.0)).len() == 2);
    }
}

#[test]
fn a_mirrored_uneven_transform_makes_an_ellipsoid_with_outward_normals() {
    let radii = DVec3::new(1.2, -0.6, 0.9);
    let rotation = DMat3::from_euler(EulerRot::ZYX, 0.4, 0.2, -0.7);
    let matrix = rotation * DMat3::from_diagonal(radii);
    let shapes = [
        TruthShape::Solid(Solid::Sphere { centre: DVec3::ZERO, radius: 1.0 }),
        TruthShape::Mesh(Arc::new(mesh_sphere(60, 1.0))),
    ];
    for (shape, tolerance) in shapes.into_iter().zip([1e-10, 0.1]) {
        let leaf = TruthLeaf { world_from_leaf: DAffine3::from_mat3(matrix), ..TruthLeaf::new(0, shape) };
        let camera = camera(Lens::FovY(40.0), 48);
        let judge = judge(vec![leaf], camera.clone(), |leaf| leaf(0));
        let mut seen = 0;
        for i in 0..48 {
            for b in judge.cast(DVec2::new(24.5, f64::from(i) + 0.5)) {
                // On Σ (xᵢ/rᵢ)² = 1 the normal is along xᵢ/rᵢ².
                let p = rotation.transpose() * camera.ray(DVec2::new(24.5, f64::from(i) + 0.5)).at(b.depth);
                let normal = rotation * (p / (radii * radii)).normalize();
                assert!(((p / radii).length() - 1.0).abs() < tolerance);
                assert!(normal.dot(b.normal) > 1.0 - tolerance);
                seen += 1;
            }
        }
        assert!(seen > 20);
    }
}

#[test]
fn several_samples_merge_to_one_record_inside_and_to_masks_at_edges() {
    let camera = ahead(20);
    let source = |samples| {
        Reference::with_expression(
            vec![sphere(0, 0.0, 1.013)],
            Box::new(|leaf: &dyn Fn(u32) -> bool| leaf(0)),
            camera.clone(),
            samples,
            LayerLimit::All,
        )
        .unwrap()
    };
    for samples in [1, 2, 4, 8, 16] {
        let stack = LayerStack::collect(&source(samples));
        let every = ((1u32 << samples) - 1) as u16;
        assert_eq!(stack.at(10, 10).len(), 2);
        assert!(stack.at(10, 10).iter().all(|b| b.samples == every));
        let mut covered = 0;
        for y in 0..20 {
            for x in 0..20 {
                let fronts = stack.at(x, y).iter().filter(|b| b.facing == Facing::Front).map(|b| b.samples);
                let (mut union, mut count) = (0u16, 0);
                for mask in fronts {
                    assert_eq!(union & mask, 0);
                    union |= mask;
                    count += mask.count_ones();
                }
                covered += count;
                for (i, offset) in sample_offsets(samples).iter().enumerate() {
                    let p = DVec2::new(f64::from(x), f64::from(y)) + *offset - 10.0;
                    assert_eq!(union >> i & 1 == 1, p.length() / 5.0 < 1.013);
                }
            }
        }
        let area = f64::from(covered) / f64::from(samples) / 25.0;
        assert!((area / (std::f64::consts::PI * 1.013f64.powi(2)) - 1.0).abs() < 0.06);
    }
}

#[test]
fn the_nearest_limit_hands_over_the_first_boundary_alone() {
    let camera = camera(Lens::FovY(40.0), 32);
    let build = |limit| {
        let inside = Box::new(|leaf: &dyn Fn(u32) -> bool| (leaf(0) || leaf(1)) && !leaf(2));
        Reference::with_expression(three(), inside, camera.clone(), 1, limit).unwrap()
    };
    let (all, nearest) =
        (LayerStack::collect(&build(LayerLimit::All)), LayerStack::collect(&build(LayerLimit::Nearest)));
    for y in 0..32 {
        for x in 0..32 {
            assert_eq!(all.at(x, y).first(), nearest.at(x, y).first());
            assert!(nearest.at(x, y).len() <= 1);
        }
    }
}

#[test]
fn the_judges_crossings_agree_with_the_pipelines() {
    let v = DVec3::new;
    let ball = |x, y, z, radius| Ball { centre: v(x, y, z), radius };
    let solids = [
        Solid::HalfSpace { point: v(0.1, -0.2, 0.3), normal: v(1.0, 2.0, -0.5), extent: 1.5 },
        Solid::Box { min: v(-0.7, -0.4, -0.9), max: v(0.5, 0.8, 0.3) },
        Solid::Sphere { centre: v(0.1, 0.2, -0.1), radius: 0.8 },
        Solid::Cylinder { from: v(-0.4, -0.3, -0.5), to: v(0.3, 0.5, 0.4), radius: 0.5 },
        Solid::Cone { from: v(-0.4, 0.3, -0.5), to: v(0.3, -0.2, 0.6), radius_from: 0.7, radius_to: 0.2 },
        Solid::Cone { from: v(-0.4, 0.3, -0.5), to: v(0.3, -0.2, 0.6), radius_from: 0.0, radius_to: 0.6 },
        Solid::Cone { from: v(0.0, 0.0, -0.2), to: v(0.0, 0.1, 0.2), radius_from: 0.9, radius_to: 0.0 },
        Solid::Torus { centre: v(0.1, 0.0, 0.1), axis: v(0.3, 0.2, 1.0), radius: 0.7, tube: 0.25 },
        Solid::Torus { centre: v(0.0, 0.1, 0.1), axis: v(0.3, -2.0, 1.0), radius: 0.5, tube: 0.45 },
        Solid::Blend {
            balls: vec![ball(-0.4, 0.0, 0.1, 0.4), ball(0.4, 0.1, 0.0, 0.35), ball(0.0, 0.5, -0.2, 0.3)],
            smoothness: 0.08,
        },
    ];
    let mut uniform = numbers(7);
    let mut theirs = Vec::new();
    for solid in solids {
        let own = Implicit::new(solid.clone());
        let mut met = 0;
        for round in 0..5000 {
            let through = random_point(&mut uniform);
            // Some lines along an axis of coordinates, where a component of the direction is exactly 0.
            let dir = if round % 10 == 0 { DVec3::AXES[round / 10 % 3] } else { random_point(&mut uniform) };
            let origin = through - dir * 3.0 * uniform();
            let mine = own.crossings(origin, dir);
            solid.intersect(origin, dir, &mut theirs);
            if mine.len() != theirs.len() {
                // Only where one of the two sees a touch: a chord too short to matter.
                let all: Vec<f64> = mine.iter().map(|h| h.t).chain(theirs.iter().map(|h| h.t)).collect();
                let (low, high) = all.iter().fold((f64::MAX, f64::MIN), |(l, h), t| (l.min(*t), h.max(*t)));
                assert!(high - low < 1e-4, "{solid:?}: {mine:?} against {theirs:?}");
                continue;
            }
            met += mine.len();
            for (a, b) in mine.iter().zip(&theirs) {
                let cos = b.normal.dot(dir.normalize()).abs().max(1e-7);
                // Rounding of coordinates of this size, stretched by the angle at which the surface is met.
                let scale = 4.0 + b.t.abs() * dir.length();
                assert!(
                    (a.t - b.t).abs() * dir.length() < 16.0 * f64::EPSILON * scale / cos,
                    "{solid:?}: {a:?} against {b:?}"
                );
                // A kink within rounding of the crossing may show either side's normal.
                assert!(a.normal.dot(b.normal) > 1.0 - 1e-9 || cos < 1e-4, "{solid:?}: {a:?} against {b:?}");
            }
        }
        assert!(met > 2000);
    }
}

/// A random expression over leaves 0 to 4 of the given depth.
fn random_tree(uniform: &mut dyn FnMut() -> f64, depth: u32) -> Tree {
    if depth == 0 || uniform() < 0.15 {
        return Tree::leaf(LeafId((uniform() * 5.0) as u32));
    }
    let a = random_tree(uniform, depth - 1);
    let b = random_tree(uniform, depth - 1);
    match (uniform() * 4.0) as u32 {
        0 => Tree::and(a, b),
        1 => Tree::or(a, b),
        2 => Tree::minus(a, b),
        _ => Tree::not(Tree::minus(a, b)),
    }
}

#[test]
fn two_parts_without_a_gap_have_each_its_own_material() {
    // A shell around a core; a half-space cuts both.
    let half = Solid::HalfSpace { point: DVec3::ZERO, normal: DVec3::Y, extent: 4.0 };
    let [shell, core, cutter] = [0, 1, 2].map(|leaf| Tree::leaf(LeafId(leaf)));
    let parts = Tree::or(Tree::minus(shell, core.clone()), core);
    let tree = Tree::minus(parts, cutter);
    // However the leaves are numbered.
    for [shell, core] in [[0, 1], [1, 0]] {
        let tree = tree.map_leaves(|leaf| LeafId([shell, core, 2][leaf.0 as usize]));
        let cutter = TruthLeaf::new(2, TruthShape::Solid(half.clone()));
        let leaves = vec![sphere(shell, 0.0, 1.0), sphere(core, 0.0, 0.5), cutter];
        let judge = Reference::new(leaves, tree, ahead(100), 1, LayerLimit::Nearest).unwrap();
        // A picture of 4 units in 100 pixels: the middle, and 0.8 beside it.
        for (px, body) in [(50.0, core), (70.0, shell)] {
            let found = judge.cast(DVec2::new(px, 50.0));
            assert_eq!((found[0].leaf, found[0].body), (2, body), "{px}");
        }
    }
}

#[test]
fn between_boundaries_every_point_is_where_the_expression_says() {
    let v = DVec3::new;
    let torus = Solid::Torus { centre: v(-0.2, 0.1, 0.0), axis: v(0.2, 1.0, 0.3), radius: 0.8, tube: 0.3 };
    let cone = Solid::Cone { from: v(-0.6, -0.8, -0.8), to: v(0.3, 0.4, 0.9), radius_from: 0.8, radius_to: 0.0 };
    let plane = Solid::HalfSpace { point: v(0.1, 0.1, 0.0), normal: v(0.3, 1.0, 0.8), extent: 10.0 };
    let balls = vec![Ball { centre: v(0.3, 0.3, 0.3), radius: 0.5 }, Ball { centre: v(0.3, -0.5, 0.0), radius: 0.4 }];
    let blend = Solid::Blend { balls, smoothness: 0.1 };
    let cube = Solid::Box { min: DVec3::splat(-0.6), max: DVec3::splat(0.7) };
    let solids = [torus, cone, plane, blend, cube];
    let mut uniform = numbers(11);
    let camera = camera(Lens::FovY(40.0), 64);
    for _ in 0..60 {
        let tree = random_tree(&mut uniform, 4);
        let leaf = |i: usize| TruthLeaf::new(i as u32, TruthShape::Solid(solids[i].clone()));
        let leaves = (0..solids.len()).map(leaf).collect();
        let judge = Reference::new(leaves, tree.clone(), camera.clone(), 1, LayerLimit::All).unwrap();
        let inside = |p: DVec3| tree.eval(|leaf| solids[leaf.0 as usize].contains(p));
        for _ in 0..60 {
            let px = DVec2::new(64.0 * uniform(), 64.0 * uniform());
            let ray = camera.ray(px);
            let found = judge.cast(px);
            let just = |b: &RayBoundary, aside: f64| inside(ray.at(b.depth + aside));
            for b in &found {
                let front = b.facing == Facing::Front;
                assert_eq!((just(b, -1e-7), just(b, 1e-7)), (!front, front), "{px} {b:?}");
                assert!((b.normal.dot(ray.dir) < 0.0) == front);
                assert!(solids[b.leaf as usize].signed_distance_bound(ray.at(b.depth)).abs() < 1e-10);
                // The body's material is there, unless the result there is what is left of nothing at all.
                let behind = ray.at(b.depth + if front { 1e-7 } else { -1e-7 });
                let nothing_needed = tree.eval(|_| false);
                assert!(solids[b.body as usize].contains(behind) || nothing_needed || b.body == b.leaf);
            }
            for _ in 0..40 {
                let t = 9.0 * uniform();
                let crossed = found.iter().filter(|b| b.depth < t).count();
                assert_eq!(inside(ray.at(t)), (crossed % 2 == 1) != inside(ray.origin), "{px} {t}");
            }
        }
    }
}

#[test]
fn the_positive_form_draws_the_same_bits() {
    let camera = camera(Lens::FovY(40.0), 32);
    let mut uniform = numbers(12);
    for _ in 0..8 {
        let tree = random_tree(&mut uniform, 3);
        let positive = tree.positive();
        let [a, b, c] = <[TruthLeaf; 3]>::try_from(three()).expect("three leaves");
        let leaves = || vec![a.clone(), b.clone(), c.clone(), sphere(3, -0.4, 0.6), cube(4, 0.5)];
        let plain = Reference::new(leaves(), tree, camera.clone(), 1, LayerLimit::All).unwrap();
        let turned = judge(leaves(), camera.clone(), move |leaf| positive.eval(|id| leaf(id.0)));
        assert_eq!(picture(&plain), picture(&turned));
    }
}

#[test]
fn the_judges_mesh_crossings_agree_with_the_pipelines() {
    let mesh = Arc::new(mesh_sphere(15, 1.0));
    let own = CastMesh::new(mesh.clone()).unwrap();
    let theirs = crate::geometry::MeshBvh::new(mesh).unwrap();
    let mut uniform = numbers(8);
    let mut hits = Vec::new();
    for _ in 0..5000 {
        let (through, dir) = (random_point(&mut uniform), random_point(&mut uniform));
        let origin = through - dir * 4.0;
        let mut mine = own.crossings(origin, dir, false).unwrap();
        mine.sort_by(|a, b| a.t.total_cmp(&b.t));
        theirs.intersect(origin, dir, &mut hits);
        assert_eq!(mine.len(), hits.len());
        for (a, b) in mine.iter().zip(&hits) {
            let cos = b.normal.dot(dir.normalize()).abs();
            assert!((a.t - b.t).abs() * dir.length() < 1e-13 / cos);
            assert!((a.normal - b.normal).length() < 1e-12);
        }
    }
}

#[test]
fn unusable_leaves_are_named() {
    let refuse = |leaves: Vec<TruthLeaf>, samples| {
        let inside = Box::new(|leaf: &dyn Fn(u32) -> bool| leaf(0));
        Reference::with_expression(leaves, inside, ahead(8), samples, LayerLimit::All).err().expect("refused")
    };
    assert_eq!(refuse(vec![sphere(3, 0.0, 1.0), sphere(3, 1.0, 1.0)], 1), ReferenceError::Twice { leaf: 3 });
    let flat = TruthLeaf { world_from_leaf: DAffine3::from_scale(DVec3::new(1.0, 0.0, 1.0)), ..sphere(2, 0.0, 1.0) };
    assert_eq!(refuse(vec![flat], 1), ReferenceError::Transform { leaf: 2 });
    assert!(matches!(refuse(vec![sphere(1, 0.0, -1.0)], 1), ReferenceError::Solid { leaf: 1, .. }));
    assert_eq!(refuse(vec![sphere(1, 0.0, 1.0)], 17), ReferenceError::Samples(17));
    let broken = TriMesh { triangles: vec![[0, 1, 9]], ..tetrahedron() };
    let broken = TruthLeaf::new(5, TruthShape::Mesh(Arc::new(broken)));
    assert!(matches!(refuse(vec![broken], 1), ReferenceError::Mesh { leaf: 5, .. }));
}
