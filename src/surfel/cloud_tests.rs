//! Clouds against the shapes that they were taken from.

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use glam::{DAffine3, DMat3, DVec3, Vec3};

use super::test_shapes::{Random, bits, holes, sphere_points, thin, torus_point, torus_points};
use super::{CloudNotes, CloudOptions, SurfelCloud, SurfelError, from_cloud};
use crate::geometry::{Ellipse, PointCloud};

const CENTRE_LINE: f64 = 1.0;
const TUBE: f64 = 0.4;

/// Places and their normals.
type Points = Vec<(DVec3, DVec3)>;

fn with_normals(points: &[(DVec3, DVec3)]) -> PointCloud {
    PointCloud {
        positions: points.iter().map(|p| p.0).collect(),
        normals: Some(points.iter().map(|p| p.1.as_vec3()).collect()),
        ..PointCloud::default()
    }
}

fn without_normals(points: &[(DVec3, DVec3)]) -> PointCloud {
    PointCloud { normals: None, ..with_normals(points) }
}

fn build(cloud: PointCloud) -> (SurfelCloud, CloudNotes) {
    from_cloud(cloud, DAffine3::IDENTITY, &CloudOptions::default(), &|_| ()).unwrap()
}

/// Points of a square of side 2 about the origin in the plane z = 0.
fn plane_points(count: usize, random: &mut Random) -> Vec<(DVec3, DVec3)> {
    (0..count).map(|_| (DVec3::new(2.0 * random.unit() - 1.0, 2.0 * random.unit() - 1.0, 0.0), DVec3::Z)).collect()
}

/// Points of the surface of a box about the origin, even by area.
fn box_points(half: DVec3, count: usize, random: &mut Random) -> Vec<(DVec3, DVec3)> {
    let areas = [half.y * half.z, half.x * half.z, half.x * half.y];
    let total: f64 = areas.iter().sum();
    (0..count)
        .map(|_| {
            let pick = random.unit() * total;
            let axis = if pick < areas[0] { 0 } else { 1 + usize::from(pick >= areas[0] + areas[1]) };
            let mut p = DVec3::new(random.unit(), random.unit(), random.unit()) * 2.0 * half - half;
            let mut n = DVec3::ZERO;
            n[axis] = if random.unit() < 0.5 { -1.0 } else { 1.0 };
            p[axis] = n[axis] * half[axis];
            (p, n)
        })
        .collect()
}

/// How many surfels face against the normal that `truth` gives for their place.
fn wrong_way(cloud: &SurfelCloud, truth: impl Fn(DVec3) -> DVec3) -> usize {
    (0..cloud.len()).filter(|&i| cloud.surfels[i].normal.as_dvec3().dot(truth(cloud.centre(i))) < 0.0).count()
}

fn largest_and_mean_radius(cloud: &SurfelCloud) -> (f32, f32) {
    let radii = cloud.surfels.iter().map(|s| s.radius);
    (radii.clone().fold(0.0, f32::max), radii.sum::<f32>() / cloud.len() as f32)
}

#[test]
fn no_holes_in_regular_poisson_and_irregular_samplings() {
    let mut random = Random::new(1);
    let torus_truth = torus_points(CENTRE_LINE, TUBE, 40_000, &mut random);
    let sphere_truth: Vec<_> = (0..40_000).map(|_| random.direction()).map(|d| (d, d)).collect();
    // The border of an open sheet frays by the spacing.
    let plane_truth: Vec<_> = plane_points(40_000, &mut random).iter().map(|(p, n)| (*p * 0.9, *n)).collect();

    let many_on_torus = torus_points(CENTRE_LINE, TUBE, 60_000, &mut random);
    let many_on_plane = plane_points(60_000, &mut random);
    let many_on_sphere: Vec<_> = (0..60_000).map(|_| random.direction()).map(|d| (d, d)).collect();
    let grid: Vec<_> = (0..70 * 70)
        .map(|i| (DVec3::new(f64::from(i % 70) / 34.5 - 1.0, f64::from(i / 70) / 34.5 - 1.0, 0.0), DVec3::Z))
        .collect();
    // Density falls by 30 from one side to the other.
    let uneven: Vec<_> =
        many_on_torus.iter().filter(|(p, _)| random.unit() < (1.2 * p.x - 1.7).exp()).copied().collect();
    let half = DVec3::new(1.0, 0.7, 0.5);
    let box_truth = box_points(half, 40_000, &mut random);
    // 25 × 25 cell centres a face: none on an edge.
    let box_grid: Points = (0..6 * 625)
        .map(|i| {
            let (face, a, b) = (i / 625, f64::from(i % 25) / 12.5 - 0.96, f64::from(i % 625 / 25) / 12.5 - 0.96);
            let n = [DVec3::X, DVec3::Y, DVec3::Z][face as usize / 2] * f64::from(face % 2 * 2 - 1);
            let (u, v) =
                ([DVec3::Y, DVec3::Z, DVec3::X][face as usize / 2], [DVec3::Z, DVec3::X, DVec3::Y][face as usize / 2]);
            ((n + u * a + v * b) * half, n)
        })
        .collect();
    let cases: [(&str, Points, &Points); 11] = [
        ("box, grid", box_grid, &box_truth),
        ("box, blue noise", thin(&box_points(half, 100_000, &mut random), 0.04), &box_truth),
        ("sphere, spiral", sphere_points(5000), &sphere_truth),
        ("sphere, few", sphere_points(374), &sphere_truth),
        ("sphere, blue noise", thin(&many_on_sphere, 0.04), &sphere_truth),
        ("torus, blue noise", thin(&many_on_torus, 0.04), &torus_truth),
        ("torus, random", many_on_torus[..15_000].to_vec(), &torus_truth),
        ("torus, uneven", uneven, &torus_truth),
        ("plane, grid", grid, &plane_truth),
        ("plane, blue noise", thin(&many_on_plane, 0.03), &plane_truth),
        ("plane, random", many_on_plane[..8000].to_vec(), &plane_truth),
    ];
    for (name, points, truth) in cases {
        let (cloud, _) = build(with_normals(&points));
        let (largest, mean) = largest_and_mean_radius(&cloud);
        let found = holes(&cloud, truth);
        eprintln!("{name}: {} surfels, {found} holes, radius {mean:.4} mean, {largest:.4} largest", cloud.len());
        assert_eq!(found, 0, "{name}");
        assert!(cloud.surfels.iter().all(|s| s.radius > 0.0 && s.radius.is_finite()));
    }
}

#[test]
fn an_open_border_does_not_spill_far() {
    let mut random = Random::new(2);
    let points = thin(&plane_points(60_000, &mut random), 0.03);
    let (cloud, _) = build(with_normals(&points));
    let spill = (0..cloud.len())
        .map(|i| {
            let beyond = cloud.centre(i).abs() + f64::from(cloud.surfels[i].radius);
            beyond.x.max(beyond.y) - 1.0
        })
        .fold(0.0, f64::max);
    eprintln!("spill {:.2} spacings", spill / f64::from(cloud.spacing));
    assert!(spill < 3.0 * f64::from(cloud.spacing));
}

#[test]
fn estimated_normals_are_outward() {
    let mut random = Random::new(3);
    let torus = torus_points(CENTRE_LINE, TUBE, 20_000, &mut random);
    let (cloud, notes) = build(without_normals(&torus));
    assert_eq!((notes.estimated_normals, notes.components, notes.inward), (20_000, 1, false));
    assert_eq!(wrong_way(&cloud, |p| torus_point(CENTRE_LINE, TUBE, p).1), 0);
    assert!(cloud.closure() < 0.05 && cloud.signed_volume() > 0.0);
    assert!(cloud.confidence.iter().filter(|c| **c > 200).count() > 19_000);

    // Noise of a third of the spacing.
    let spacing = (4.0 * std::f64::consts::PI.powi(2) * CENTRE_LINE * TUBE / 20_000.0).sqrt();
    let noisy: Vec<_> = torus.iter().map(|(p, n)| (*p + *n * random.normal() * 0.3 * spacing, *n)).collect();
    let (cloud, notes) = build(without_normals(&noisy));
    let wrong = wrong_way(&cloud, |p| torus_point(CENTRE_LINE, TUBE, p).1);
    eprintln!("noisy torus: {wrong} wrong, {notes:?}");
    assert!(wrong <= 1);
}

#[test]
fn signs_cross_sharp_edges_and_thin_walls() {
    let mut random = Random::new(4);
    for half in [DVec3::new(1.0, 0.7, 0.5), DVec3::new(1.0, 0.7, 0.06)] {
        let points = thin(&box_points(half, 100_000, &mut random), 0.025);
        let (cloud, notes) = build(without_normals(&points));
        let outward = |p: DVec3| {
            let q = p / half;
            let far = q.abs();
            // Near an edge the estimate is a mean of both faces; any outward direction will do.
            if far.max_element() > 0.97 { p / half / half } else { DVec3::ZERO }
        };
        let wrong = wrong_way(&cloud, outward);
        eprintln!("box {half}: {} surfels, {wrong} wrong, {notes:?}", cloud.len());
        assert!(wrong * 500 < cloud.len());
    }
}

#[test]
fn bodies_cavities_and_crumbs() {
    let mut random = Random::new(5);
    let at = |centre: DVec3, radius: f64, count: usize| {
        sphere_points(count).into_iter().map(move |(p, n)| (centre + p * radius, n)).collect::<Vec<_>>()
    };
    let mut points = at(DVec3::ZERO, 1.0, 8000);
    points.extend(at(DVec3::ZERO, 0.5, 2000).into_iter().map(|(p, n)| (p, -n)));
    points.extend(at(DVec3::X * 5.0, 0.3, 700));
    // A crumb: a cap that floats just above the large ball, too far for the graph.
    let crumb: Vec<_> = (0..30)
        .map(|_| (DVec3::Z + 0.05 * DVec3::new(random.normal(), random.normal(), 0.0)).normalize())
        .map(|d| (d * 1.25, d))
        .collect();
    points.extend(&crumb);
    let (cloud, notes) = build(without_normals(&points));
    assert_eq!((notes.components, notes.cavities), (4, 1));
    let truth = |p: DVec3| {
        if p.x > 3.0 { p - DVec3::X * 5.0 } else { p * if p.length() < 0.75 { -1.0 } else { 1.0 } }
    };
    assert_eq!(wrong_way(&cloud, truth), 0);
}

#[test]
fn stray_points_get_no_large_disks_and_sparse_parts_do() {
    let mut random = Random::new(9);
    let mut points = thin(&plane_points(60_000, &mut random), 0.02);
    // The right half is five times as sparse (in spacing) as the left.
    let sparse = thin(&points, 0.1);
    points.retain(|(p, _)| p.x < 0.0);
    points.extend(sparse.iter().filter(|(p, _)| p.x >= 0.0));
    let surface = points.len();
    // Normals along the plane: nothing about them faces alike.
    points.extend((0..5).map(|i| (DVec3::new(0.15 * f64::from(i) - 0.8, 0.1, 0.6), DVec3::Y)));
    let (cloud, notes) = build(with_normals(&points));
    assert_eq!((notes.isolated, cloud.len()), (5, surface + 5));
    for i in (0..cloud.len()).filter(|i| cloud.centre(*i).z > 0.5) {
        assert!(cloud.surfels[i].radius < 0.06, "{}", cloud.surfels[i].radius);
    }
    let truth: Vec<_> = plane_points(40_000, &mut random).iter().map(|(p, n)| (*p * 0.9, *n)).collect();
    assert_eq!(holes(&cloud, &truth), 0);
    assert!(cloud.chunks.iter().all(|c| c.largest_radius < 0.4));
}

#[test]
fn given_normals_are_kept_and_their_gaps_filled() {
    let mut random = Random::new(6);
    let torus = torus_points(CENTRE_LINE, TUBE, 5000, &mut random);
    let inward: Vec<_> = torus.iter().map(|(p, n)| (*p, -*n)).collect();
    let (cloud, notes) = build(with_normals(&inward));
    assert!(notes.inward && notes.estimated_normals == 0);
    assert_eq!(wrong_way(&cloud, |p| -torus_point(CENTRE_LINE, TUBE, p).1), 0);
    assert!(cloud.confidence.iter().all(|c| *c == u8::MAX));
    assert!(!build(with_normals(&torus)).1.inward);

    // Every third normal is missing: the rest decides the sign, even inward.
    let mut holed = with_normals(&inward);
    let normals = holed.normals.as_mut().unwrap();
    for i in (0..normals.len()).step_by(3) {
        normals[i] = if i % 2 == 0 { Vec3::ZERO } else { Vec3::NAN };
    }
    let (cloud, notes) = build(holed.clone());
    assert_eq!(notes.estimated_normals, 1667);
    assert!(notes.inward);
    assert_eq!(wrong_way(&cloud, |p| -torus_point(CENTRE_LINE, TUBE, p).1), 0);

    let ignore = CloudOptions { ignore_normals: true };
    let (cloud, notes) = from_cloud(holed, DAffine3::IDENTITY, &ignore, &|_| ()).unwrap();
    assert_eq!(notes.estimated_normals, 5000);
    assert_eq!(wrong_way(&cloud, |p| torus_point(CENTRE_LINE, TUBE, p).1), 0);
}

#[test]
fn transforms_scale_mirror_and_shear() {
    let points = sphere_points(4000);
    let mut cloud = with_normals(&points);
    cloud.radii = Some(vec![0.05; points.len()]);
    let turn = DMat3::from_rotation_y(0.4);
    // A mirrored similarity: normals stay outward, radii and curvature scale.
    let mirror =
        DAffine3::from_mat3_translation(turn * DMat3::from_diagonal(DVec3::new(-2.0, 2.0, 2.0)), DVec3::X * 1e6);
    let (surfels, notes) = from_cloud(cloud.clone(), mirror, &CloudOptions::default(), &|_| ()).unwrap();
    assert_eq!(wrong_way(&surfels, |p| p - DVec3::X * 1e6), 0);
    assert!(surfels.supports.is_none() && !notes.inward);
    for (i, s) in surfels.surfels.iter().enumerate() {
        assert!((s.radius - 0.1).abs() < 1e-6);
        assert!(((surfels.centre(i) - DVec3::X * 1e6).length() - 2.0).abs() < 1e-6);
        assert!((s.curvature.mul(s.normal).dot(s.normal) - 0.5).abs() < 2e-3, "{:?}", s.curvature);
    }
    // An ellipsoid: normals by the gradient, supports are ellipses in the tangent plane.
    let axes = DVec3::new(1.0, 2.0, -0.5);
    let (surfels, _) = from_cloud(cloud, DAffine3::from_scale(axes), &CloudOptions::default(), &|_| ()).unwrap();
    let supports = surfels.supports.as_ref().unwrap();
    for (i, s) in surfels.surfels.iter().enumerate() {
        let p = surfels.centre(i);
        let gradient = (p / axes / axes).normalize();
        assert!(s.normal.as_dvec3().dot(gradient) > 1.0 - 1e-6);
        assert!(supports[i].mul(s.normal).length() < 1e-2 / 0.05 / 0.05 * 1e-2);
        assert!(s.radius > 0.0249 && s.radius < 0.1001);
        // A leaf-space tangent vector of length 0.05 ends on the border.
        let n_in_leaf = p / axes;
        let e = (axes * n_in_leaf.any_orthonormal_vector() * 0.05).as_vec3();
        assert!((e.dot(supports[i].mul(e)) - 1.0).abs() < 1e-2);
    }
    let flat = DAffine3::from_scale(DVec3::new(1.0, 1.0, 0.0));
    let refused = from_cloud(with_normals(&points), flat, &CloudOptions::default(), &|_| ());
    assert_eq!(refused.unwrap_err(), SurfelError::Transform);
}

#[test]
fn curvature_of_a_torus_with_exact_and_noisy_normals() {
    let mut random = Random::new(7);
    for (count, noise_deg, allowed) in [(4500, 0.0, 0.05), (45_000, 0.0, 0.02), (4500, 2.0, 0.3), (45_000, 2.0, 1.0)] {
        let spacing = (4.0 * std::f64::consts::PI.powi(2) * CENTRE_LINE * TUBE / count as f64).sqrt();
        let points = thin(&torus_points(CENTRE_LINE, TUBE, 20 * count, &mut random), 0.8 * spacing);
        let noisy: Vec<_> = points
            .iter()
            .map(|(p, n)| {
                let (u, v) = n.any_orthonormal_pair();
                let tilt = f64::to_radians(noise_deg) * std::f64::consts::FRAC_1_SQRT_2;
                (*p, (*n + (u * random.normal() + v * random.normal()) * tilt).normalize())
            })
            .collect();
        let (cloud, _) = build(with_normals(&noisy));
        let mut error = 0.0;
        for (i, s) in cloud.surfels.iter().enumerate() {
            let (_, n) = torus_point(CENTRE_LINE, TUBE, cloud.centre(i));
            let along = DVec3::Z.cross(n).normalize();
            let across = n.cross(along);
            let expected_along = (n.x.hypot(n.y) * DVec3::new(n.x, n.y, 0.0).dot(cloud.centre(i)).signum())
                / DVec3::new(cloud.centre(i).x, cloud.centre(i).y, 0.0).length();
            let k = |d: DVec3| f64::from(s.curvature.mul(d.as_vec3()).dot(d.as_vec3()));
            error += (k(along) - expected_along).powi(2) + (k(across) - 1.0 / TUBE).powi(2);
        }
        let rms = (0.5 * error / cloud.len() as f64).sqrt();
        eprintln!("{} surfels, {noise_deg}°: rms curvature error {rms:.4} of 2.5", cloud.len());
        assert!(rms < allowed);
    }
}

/// What a scanner did not see is bridged by surfels about it, as round as the surface is there and not as the noise about one of
/// them: a ball whose cap of 20° is missing, seven spacings in radius, with normals 1.5° off. The mean is 0.0066; 0.015 from the
/// nearest neighbours.
#[test]
fn a_gap_is_bridged_as_its_surroundings_bend() {
    const CAP_DEGREES: f64 = 20.0;
    const NOISE_DEGREES: f64 = 1.5;
    let mut random = Random::new(5);
    let seen = |p: &&(DVec3, DVec3)| p.0.z < CAP_DEGREES.to_radians().cos();
    let all = sphere_points(6000);
    let points: Points = all
        .iter()
        .filter(seen)
        .map(|(p, n)| (*p, (*n + random.direction() * (NOISE_DEGREES.to_radians() * random.normal())).normalize()))
        .collect();
    let (cloud, _) = build(with_normals(&points));
    let pole = DVec3::Z;
    let height = |i: usize| {
        let e = (pole - cloud.centre(i)).as_vec3();
        let surfel = &cloud.surfels[i];
        (surfel.normal.dot(e) + 0.5 * e.dot(surfel.curvature.mul(e))).abs()
    };
    let reaches = |i: &usize| cloud.centre(*i).distance(pole) < f64::from(cloud.surfels[*i].radius);
    let heights: Vec<f32> = (0..cloud.len()).filter(reaches).map(height).collect();
    let mean = heights.iter().sum::<f32>() / heights.len() as f32;
    assert!(heights.len() >= 10, "{} bridge it", heights.len());
    assert!(mean < 0.01, "{mean}, of {} surfels", heights.len());
}

#[test]
fn ellipses_bring_normals_and_supports() {
    let points = sphere_points(2000);
    let mut cloud = without_normals(&points);
    cloud.ellipses = Some(
        points
            .iter()
            .enumerate()
            .map(|(i, (_, n))| {
                let (u, v) = n.any_orthonormal_pair();
                // The ellipse's plane has no outer side: every other one is turned over.
                let v = if i % 2 == 0 { v } else { -v };
                Ellipse { axis_u: (u * 0.1).as_vec3(), axis_v: (v * 0.05).as_vec3() }
            })
            .collect(),
    );
    cloud.ellipses.as_mut().unwrap()[7] = Ellipse { axis_u: Vec3::ZERO, axis_v: Vec3::ZERO };
    cloud.opacities = Some(vec![0.5; points.len()]);
    let (surfels, notes) = build(cloud);
    assert_eq!((notes.bad_radii, notes.estimated_normals), (1, 2000));
    assert_eq!(wrong_way(&surfels, |p| p), 0);
    assert!(surfels.supports.as_ref().unwrap().iter().all(|s| s.0.iter().all(|x| x.is_finite())));
    assert!(surfels.surfels.iter().filter(|s| (s.radius - 0.1).abs() < 1e-6).count() >= 1999);
    assert!(surfels.surfels.iter().all(|s| s.colour[3] == 128) && !surfels.coloured);
}

#[test]
fn duplicates_few_points_and_bad_points() {
    let mut points = sphere_points(1000);
    points.extend(sphere_points(1000));
    points.push((DVec3::new(0.0, -0.0, 5.0), DVec3::Z));
    points.push((DVec3::new(-0.0, 0.0, 5.0), DVec3::Z));
    let counted = AtomicU64::new(0);
    let add = |n: u64| {
        counted.fetch_add(n, Relaxed);
    };
    for cloud in [with_normals(&points), without_normals(&points)] {
        counted.store(0, Relaxed);
        let (surfels, notes) = from_cloud(cloud, DAffine3::IDENTITY, &CloudOptions::default(), &add).unwrap();
        assert_eq!((surfels.len(), notes.duplicates), (1001, 1001));
        assert_eq!(counted.load(Relaxed), 2002);
    }

    let same = PointCloud { positions: vec![DVec3::ONE; 100_000], ..PointCloud::default() };
    let refused = from_cloud(same.clone(), DAffine3::IDENTITY, &CloudOptions::default(), &|_| ());
    assert_eq!(refused.unwrap_err(), SurfelError::OnePlace { points: 100_000 });
    let one = PointCloud { radii: Some(vec![0.5; 100_000]), normals: Some(vec![Vec3::Z; 100_000]), ..same };
    let (surfels, _) = build(one);
    assert_eq!((surfels.len(), surfels.surfels[0].radius, surfels.spacing), (1, 0.5, 0.0));

    // One surfel a face of a cube: half of the extent.
    let faces = [DVec3::X, DVec3::Y, DVec3::Z].into_iter().flat_map(|d| [(d, d), (-d, -d)]).collect::<Vec<_>>();
    let (surfels, _) = build(with_normals(&faces));
    assert!(surfels.surfels.iter().all(|s| (s.radius - 3f32.sqrt()).abs() < 1e-6));
    assert!(surfels.surfels.iter().all(|s| s.curvature == super::Sym3::default()));
    for few in 2..20 {
        let (surfels, _) = build(without_normals(&sphere_points(few)));
        assert!(surfels.surfels.iter().all(|s| s.radius > 0.0 && (s.normal.length() - 1.0).abs() < 1e-5));
    }
    // In a line, and in a line with all normals along it.
    let line: Vec<_> = (0..50).map(|i| (DVec3::X * f64::from(i), DVec3::X)).collect();
    for cloud in [with_normals(&line), without_normals(&line)] {
        let (surfels, _) = build(cloud);
        assert!(surfels.surfels.iter().all(|s| s.radius > 0.0 && s.radius.is_finite() && s.normal.is_finite()));
    }

    let bad = PointCloud { positions: vec![DVec3::ZERO, DVec3::new(1.0, f64::NAN, 0.0)], ..PointCloud::default() };
    let refused = from_cloud(bad, DAffine3::IDENTITY, &CloudOptions::default(), &|_| ()).unwrap_err();
    assert!(matches!(refused, SurfelError::NotFinite { index: 1, .. }));
    let refused = from_cloud(PointCloud::default(), DAffine3::IDENTITY, &CloudOptions::default(), &|_| ());
    assert_eq!(refused.unwrap_err(), SurfelError::Empty);
}

#[test]
fn the_same_bits_on_one_and_two_threads_and_far_away() {
    let mut random = Random::new(8);
    let torus = torus_points(CENTRE_LINE, TUBE, 30_000, &mut random);
    let on = |threads: usize, shift: DVec3| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let options = CloudOptions::default();
        let map = DAffine3::from_translation(shift);
        pool.install(|| from_cloud(without_normals(&torus), map, &options, &|_| ()).unwrap().0)
    };
    let one = on(1, DVec3::ZERO);
    assert_eq!(bits(&one), bits(&on(2, DVec3::ZERO)));
    let far = on(2, DVec3::new(1e7, 1e6, -1e7));
    assert_eq!(wrong_way(&far, |p| torus_point(CENTRE_LINE, TUBE, p - DVec3::new(1e7, 1e6, -1e7)).1), 0);
    assert!((far.spacing - one.spacing).abs() < 1e-4 * one.spacing);
    assert!((far.closure() - one.closure()).abs() < 1e-3);
}
