//! Solids and meshes against their own surfaces.

use glam::{DAffine3, DMat3, DVec3, Vec3};

use super::test_shapes::{Random, bits, holes, torus_point};
use super::{SurfelCloud, SurfelError, from_mesh, from_solid};
use crate::geometry::solid::Ball;
use crate::geometry::{Solid, TriMesh};

fn solids() -> Vec<(&'static str, Solid)> {
    let (from, to) = (DVec3::new(0.1, -0.2, -0.5), DVec3::new(0.3, 0.2, 0.6));
    let balls = vec![
        Ball { centre: DVec3::ZERO, radius: 0.5 },
        Ball { centre: DVec3::X * 0.6, radius: 0.35 },
        Ball { centre: DVec3::new(0.2, 0.5, 0.1), radius: 0.3 },
    ];
    vec![
        ("sphere", Solid::Sphere { centre: DVec3::ONE, radius: 0.7 }),
        ("box", Solid::Box { min: DVec3::new(-0.5, -0.4, -0.3), max: DVec3::new(0.5, 0.6, 0.7) }),
        ("thin box", Solid::Box { min: DVec3::new(-0.5, -0.4, -0.01), max: DVec3::new(0.5, 0.6, 0.01) }),
        ("cylinder", Solid::Cylinder { from, to, radius: 0.4 }),
        ("cone", Solid::Cone { from, to, radius_from: 0.5, radius_to: 0.0 }),
        ("frustum", Solid::Cone { from, to, radius_from: 0.2, radius_to: 0.5 }),
        ("torus", Solid::Torus { centre: DVec3::ZERO, axis: DVec3::Z, radius: 0.7, tube: 0.2 }),
        ("half-space", Solid::HalfSpace { point: DVec3::ONE, normal: DVec3::new(0.6, 0.0, 0.8), extent: 0.6 }),
        ("blend", Solid::Blend { balls, smoothness: 0.1 }),
    ]
}

fn truth(solid: &Solid, map: DAffine3, count: usize) -> Vec<(DVec3, DVec3)> {
    let mut random = Random::new(21);
    let normal_map = map.matrix3.inverse().transpose();
    (0..count)
        .map(|_| {
            let (p, n) = solid.sample_random(&mut || random.unit());
            (map.transform_point3(p), (normal_map * n).normalize())
        })
        .collect()
}

#[test]
fn solids_are_covered_at_any_spacing_and_under_any_transform() {
    let turn = DMat3::from_rotation_x(0.5) * DMat3::from_rotation_z(1.1);
    let maps = [
        DAffine3::IDENTITY,
        DAffine3::from_mat3_translation(turn * DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0)), DVec3::splat(1e5)),
        DAffine3::from_mat3_translation(turn * DMat3::from_diagonal(DVec3::new(1.0, 0.4, 2.5)), DVec3::Y),
    ];
    for (name, solid) in solids() {
        for map in maps {
            for spacing in [0.02, 0.08] {
                let cloud = from_solid(&solid, map, spacing).unwrap();
                let truth = truth(&solid, map, 20_000);
                let found = holes(&cloud, &truth);
                let mean =
                    cloud.surfels.iter().map(|s| f64::from(s.radius)).sum::<f64>() / cloud.len() as f64 / spacing;
                eprintln!("{name} at {spacing}: {} surfels, radius {mean:.2} spacings, {found} holes", cloud.len());
                assert_eq!(found, 0, "{name} {spacing} {map:?}");
                assert!(cloud.surfels.iter().all(|s| f64::from(s.radius) < 1.9 * spacing));
            }
        }
    }
}

#[test]
fn curvature_of_solids() {
    let torus = Solid::Torus { centre: DVec3::ZERO, axis: DVec3::Z, radius: 1.0, tube: 0.4 };
    let cloud = from_solid(&torus, DAffine3::IDENTITY, 0.03).unwrap();
    for (i, s) in cloud.surfels.iter().enumerate() {
        let p = cloud.centre(i);
        let (_, n) = torus_point(1.0, 0.4, p);
        let along = DVec3::Z.cross(n).try_normalize().unwrap_or(DVec3::X);
        let across = n.cross(along).as_vec3();
        assert!((s.curvature.mul(across).dot(across) - 2.5).abs() < 0.06, "{}", s.curvature.mul(across).dot(across));
    }
    // Flat faces and straight generators up to the creases: nothing is fitted across.
    let cube = Solid::Box { min: -DVec3::ONE, max: DVec3::ONE };
    let cloud = from_solid(&cube, DAffine3::IDENTITY, 0.1).unwrap();
    assert!(cloud.surfels.iter().all(|s| s.curvature.0.iter().all(|k| k.abs() < 1e-6)));
    assert!(cloud.surfels.iter().all(|s| s.normal.abs().max_element() == 1.0));
    assert!(cloud.closure() < 1e-2 && (cloud.signed_volume() - 8.0).abs() < 4.0);
    let pipe = Solid::Cylinder { from: DVec3::ZERO, to: DVec3::Z, radius: 0.5 };
    let cloud = from_solid(&pipe, DAffine3::IDENTITY, 0.03).unwrap();
    for s in &cloud.surfels {
        assert!(s.curvature.mul(Vec3::Z).dot(Vec3::Z) < 1e-3);
        if s.normal.z == 0.0 {
            let round = Vec3::Z.cross(s.normal);
            assert!((s.curvature.mul(round).dot(round) - 2.0).abs() < 0.02);
        }
    }
}

/// A bumpy ball, like a scanned figure: radius 1 + bumps over an octahedron that is split `levels` times.
fn bumpy(levels: u32) -> TriMesh {
    let mut positions = vec![DVec3::X, DVec3::Y, DVec3::Z, -DVec3::X, -DVec3::Y, -DVec3::Z];
    let mut triangles: Vec<[u32; 3]> =
        vec![[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]];
    for _ in 0..levels {
        let mut middles = std::collections::HashMap::new();
        let mut middle = |a: u32, b: u32| {
            *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
                positions.push((positions[a as usize] + positions[b as usize]).normalize());
                positions.len() as u32 - 1
            })
        };
        triangles = triangles
            .iter()
            .flat_map(|&[a, b, c]| {
                let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
                [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
            })
            .collect();
    }
    for p in &mut positions {
        *p *= 1.0 + 0.08 * (5.0 * p.x).sin() * (4.0 * p.y + 1.0).cos() + 0.05 * (7.0 * p.z).sin();
    }
    TriMesh { positions, triangles, colours: None }
}

/// A box of 12 triangles.
fn box_mesh(half: DVec3) -> TriMesh {
    let positions = (0..8)
        .map(|i| {
            half * DVec3::new((i & 1) as f64 * 2.0 - 1.0, (i >> 1 & 1) as f64 * 2.0 - 1.0, (i >> 2) as f64 * 2.0 - 1.0)
        })
        .collect();
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles = quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    TriMesh { positions, triangles, colours: None }
}

/// Random points of a mesh with the normals of their triangles, world space.
fn mesh_truth(mesh: &TriMesh, map: DAffine3, count: usize) -> Vec<(DVec3, DVec3)> {
    let mut random = Random::new(22);
    let flip = map.matrix3.determinant().signum();
    let areas: Vec<f64> = (0..mesh.triangles.len())
        .scan(0.0, |sum, t| {
            let [a, b, c] = mesh.corners(t).map(|p| map.transform_point3(p));
            *sum += (b - a).cross(c - a).length();
            Some(*sum)
        })
        .collect();
    (0..count)
        .map(|_| {
            let pick = random.unit() * areas.last().unwrap();
            let t = areas.partition_point(|sum| *sum < pick);
            let [a, b, c] = mesh.corners(t).map(|p| map.transform_point3(p));
            let (mut u, mut v) = (random.unit(), random.unit());
            if u + v > 1.0 {
                (u, v) = (1.0 - u, 1.0 - v);
            }
            (a + (b - a) * u + (c - a) * v, (b - a).cross(c - a).normalize() * flip)
        })
        .collect()
}

fn mean_radius(cloud: &SurfelCloud) -> f64 {
    cloud.surfels.iter().map(|s| f64::from(s.radius)).sum::<f64>() / cloud.len() as f64
}

#[test]
fn meshes_are_covered() {
    let squash = DAffine3::from_mat3_translation(
        DMat3::from_rotation_y(0.3) * DMat3::from_diagonal(DVec3::new(1.0, -0.5, 2.0)),
        DVec3::splat(-3e4),
    );
    for (name, mesh, spacing) in [
        ("bumpy, dense triangles", bumpy(6), 0.08),
        ("bumpy, coarse triangles", bumpy(4), 0.02),
        ("cube", box_mesh(DVec3::ONE), 0.07),
        ("thin box", box_mesh(DVec3::new(1.0, 1.0, 0.01)), 0.07),
        ("splinter", box_mesh(DVec3::new(1.0, 0.003, 0.001)), 0.07),
    ] {
        for map in [DAffine3::IDENTITY, squash] {
            let cloud = from_mesh(&mesh, map, spacing).unwrap();
            let found = holes(&cloud, &mesh_truth(&mesh, map, 20_000));
            let radius = mean_radius(&cloud) / spacing;
            let apart = f64::from(cloud.spacing) / spacing;
            eprintln!("{name}: {} surfels {apart:.2} apart, radius {radius:.2} spacings, {found} holes", cloud.len());
            assert_eq!(found, 0, "{name}");
            assert!(cloud.surfels.iter().all(|s| f64::from(s.radius) < 1.9 * spacing));
        }
    }
}

#[test]
fn creases_stay_sharp_and_smooth_parts_smooth() {
    let cloud = from_mesh(&box_mesh(DVec3::ONE), DAffine3::IDENTITY, 0.1).unwrap();
    assert!(cloud.surfels.iter().all(|s| s.normal.abs().max_element() > 0.999_999));
    assert!(cloud.surfels.iter().all(|s| s.curvature.0.iter().all(|k| k.abs() < 1e-5)));
    assert!(cloud.closure() < 0.05);
    // Each corner of the cube has a surfel of every face.
    for sign in [DVec3::ONE, DVec3::new(-1.0, 1.0, -1.0)] {
        let near = (0..cloud.len()).filter(|&i| cloud.centre(i).distance(sign) < 0.2);
        let faces: std::collections::HashSet<_> =
            near.map(|i| cloud.surfels[i].normal.round().to_array().map(|x| x as i8)).collect();
        assert_eq!(faces.len(), 3);
    }
    // A ball is one patch, with the ball's curvature.
    let mut ball = bumpy(5);
    ball.positions.iter_mut().for_each(|p| *p = p.normalize() * 2.0);
    ball.colours = Some(ball.positions.iter().map(|p| if p.x > 0.0 { [255, 0, 0] } else { [0, 0, 255] }).collect());
    let cloud = from_mesh(&ball, DAffine3::IDENTITY, 0.1).unwrap();
    assert!(cloud.coloured);
    for (i, s) in cloud.surfels.iter().enumerate() {
        assert!(s.normal.as_dvec3().dot(cloud.centre(i).normalize()) > 0.9995);
        let along = s.normal.any_orthonormal_vector();
        assert!((s.curvature.mul(along).dot(along) - 0.5).abs() < 0.05, "{:?}", s.curvature);
        if cloud.centre(i).x > 0.2 {
            assert_eq!(s.colour, [255, 0, 0, 255]);
        }
    }
}

#[test]
fn refusals() {
    let ball = Solid::Sphere { centre: DVec3::ZERO, radius: 1.0 };
    let refused = |spacing: f64| from_solid(&ball, DAffine3::IDENTITY, spacing).unwrap_err();
    assert_eq!(refused(0.0), SurfelError::Spacing(0.0));
    assert!(matches!(refused(f64::NAN), SurfelError::Spacing(_)));
    assert!(matches!(refused(1e-9), SurfelError::TooMany { .. }));
    assert_eq!(from_solid(&ball, DAffine3::from_scale(DVec3::ZERO), 0.1).unwrap_err(), SurfelError::Transform);
    let mesh = |mesh: &TriMesh| from_mesh(mesh, DAffine3::IDENTITY, 0.1).unwrap_err();
    assert_eq!(mesh(&TriMesh::default()), SurfelError::Empty);
    let mut bad = box_mesh(DVec3::ONE);
    bad.triangles = vec![[0, 0, 1], [1, 1, 1]];
    assert_eq!(mesh(&bad), SurfelError::Empty);
    bad.positions[3].x = f64::INFINITY;
    assert!(matches!(mesh(&bad), SurfelError::NotFinite { index: 3, .. }));
    let mut huge = box_mesh(DVec3::splat(1e8));
    assert!(matches!(mesh(&huge), SurfelError::TooMany { .. }));
    // A needle is long, but has nearly no area: it is the length that counts.
    huge.positions.iter_mut().for_each(|p| *p *= DVec3::new(1e6, 1e-20, 1e-20));
    assert!(matches!(mesh(&huge), SurfelError::TooMany { .. }));
}

#[test]
fn the_same_bits_on_one_and_two_threads() {
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| from_mesh(&bumpy(5), DAffine3::IDENTITY, 0.03).unwrap())
    };
    assert_eq!(bits(&on(1)), bits(&on(2)));
}
