use glam::DVec3;

use super::*;

/// Random numbers in [0, 1), by SplitMix64.
fn numbers(seed: u64) -> impl FnMut() -> f64 {
    let mut state = seed;
    move || {
        state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = state;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }
}

fn point(uniform: &mut dyn FnMut() -> f64, reach: f64) -> DVec3 {
    DVec3::new(2.0 * uniform() - 1.0, 2.0 * uniform() - 1.0, 2.0 * uniform() - 1.0) * reach
}

fn ball(x: f64, y: f64, z: f64, radius: f64) -> Ball {
    Ball { centre: DVec3::new(x, y, z), radius }
}

/// One of each, none in a special position.
pub(crate) fn examples() -> Vec<Solid> {
    let v = DVec3::new;
    vec![
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
        Solid::Blend { balls: vec![ball(0.1, 0.2, 0.3, 0.5)], smoothness: 0.1 },
    ]
}

/// How far the surface is from `p`, by asking a dense sampling of it: never less than the truth, and at most `spacing` more.
fn distance_by_samples(samples: &[SurfacePoint], p: DVec3) -> f64 {
    samples.iter().map(|s| s.p.distance(p)).fold(f64::INFINITY, f64::min)
}

fn samples(solid: &Solid, spacing: f64) -> Vec<SurfacePoint> {
    let mut found = Vec::new();
    for patch in solid.patches() {
        patch.sample(spacing, &mut |s| found.push(s));
    }
    found
}

#[test]
fn samples_lie_on_the_surface_and_point_outward() {
    for solid in examples() {
        assert_eq!(solid.validate(), Ok(()));
        for s in samples(&solid, 0.07) {
            assert!(solid.signed_distance_bound(s.p).abs() < 1e-9, "{solid:?} {s:?}");
            assert!((s.normal.length() - 1.0).abs() < 1e-9);
            // A tip or rim is left both ways, so only inward must be inside.
            let step = 1e-4;
            assert!(solid.signed_distance_bound(s.p + s.normal * step) > 0.3 * step, "{solid:?} {s:?}");
        }
    }
}

#[test]
fn every_point_of_a_patch_has_a_sample_within_cover() {
    let mut uniform = numbers(1);
    for solid in examples() {
        for spacing in [0.05, 0.2, 0.9] {
            for patch in solid.patches() {
                let mut found = Vec::new();
                patch.sample(spacing, &mut |s| found.push(s));
                for _ in 0..1500 {
                    let p = patch.sample_random(&mut uniform).p;
                    let gap = distance_by_samples(&found, p);
                    assert!(gap <= COVER * spacing, "{solid:?} at {spacing}: {p} is {} spacings away", gap / spacing);
                }
            }
        }
    }
}

#[test]
fn sampling_spends_no_more_than_it_needs() {
    // A triangular lattice of this spacing has one point per √3/2 squared spacings.
    let spacing = 0.02;
    for solid in examples() {
        let area: f64 = solid.patches().iter().map(Patch::area).sum();
        let least = area / (0.866 * spacing * spacing);
        let count = samples(&solid, spacing).len() as f64;
        let most = if matches!(solid, Solid::Blend { .. }) { 3.0 } else { 1.25 };
        assert!(count > 0.9 * least && count < most * least, "{solid:?}: {count} of {least}");
    }
}

#[test]
fn random_points_are_spread_evenly() {
    // Of the points in a random ball around a surface point, the area says how many there should be. The area inside the
    // ball is measured by random lines (Crofton: crossings are spread evenly over any surface).
    let mut uniform = numbers(2);
    for solid in examples() {
        let (min, max) = solid.drawn_bounds();
        let (centre, reach) = (0.5 * (min + max), 0.5 * (max - min).length());
        let mut crossings = Vec::new();
        let mut hits = Vec::new();
        for _ in 0..60_000 {
            let dir = patch::random_direction(&mut uniform);
            let (u, v) = dir.any_orthonormal_pair();
            let (a, b) = (2.0 * uniform() - 1.0, 2.0 * uniform() - 1.0);
            solid.intersect(centre + (u * a + v * b) * reach, dir, &mut hits);
            crossings.extend(hits.iter().map(|h| centre + (u * a + v * b) * reach + dir * h.t));
        }
        if let Solid::HalfSpace { point, extent, normal } = &solid {
            let (u, v) = normal.normalize().any_orthonormal_pair();
            crossings.retain(|p| (p - point).dot(u).abs() < *extent && (p - point).dot(v).abs() < *extent);
        }
        // Lines per area: each of the 60 000 falls on the square 2·reach wide, and crosses an area A ½A/(2·reach)² times.
        let area = crossings.len() as f64 * 2.0 * (2.0 * reach).powi(2) / 60_000.0;
        let told: f64 = solid.patches().iter().map(Patch::area).sum();
        assert!((told / area - 1.0).abs() < 0.04, "{solid:?}: area {told}, by lines {area}");

        let points: Vec<DVec3> = (0..20_000).map(|_| solid.sample_random(&mut uniform).0).collect();
        for p in &points {
            assert!(solid.signed_distance_bound(*p).abs() < 1e-9);
        }
        for _ in 0..20 {
            let around = points[(uniform() * 20_000.0) as usize];
            let share =
                |of: &[DVec3]| of.iter().filter(|p| p.distance(around) < 0.5 * reach).count() as f64 / of.len() as f64;
            let (expected, found) = (share(&crossings), share(&points));
            assert!((found - expected).abs() < 0.025, "{solid:?}: {found} for {expected}");
        }
    }
}

#[test]
fn distances_are_exact_where_promised_and_bounds_everywhere() {
    let mut uniform = numbers(3);
    let spacing = 0.02;
    for solid in examples() {
        let surface = samples(&solid, spacing);
        for _ in 0..400 {
            let p = point(&mut uniform, 1.3);
            if let Solid::HalfSpace { point: q, normal, .. } = &solid {
                let expected = (p - q).dot(normal.normalize());
                assert!((solid.signed_distance_bound(p) - expected).abs() < 1e-12);
                continue;
            }
            let truth = distance_by_samples(&surface, p);
            let told = solid.signed_distance_bound(p).abs();
            assert!(told <= truth + 1e-9, "{solid:?} at {p}: {told} > {truth}");
            if !matches!(solid, Solid::Blend { .. }) {
                // A sample within COVER spacings of the nearest point.
                assert!(told >= truth - COVER * spacing, "{solid:?} at {p}: {told} < {truth}");
                // Going the distance against the normal ends on the surface.
                let (d, n) = solid.distance_and_normal(p);
                assert!(solid.signed_distance_bound(p - n * d).abs() < 1e-9, "{solid:?} at {p}");
            }
        }
    }
}

#[test]
fn inside_agrees_with_the_parity_of_crossings() {
    let mut uniform = numbers(4);
    let mut hits = Vec::new();
    for solid in examples() {
        let (min, max) = solid.drawn_bounds();
        for _ in 0..4000 {
            let p = point(&mut uniform, 1.2);
            let dir = patch::random_direction(&mut uniform) * (0.1 + 3.0 * uniform());
            solid.intersect(p, dir, &mut hits);
            assert!(hits.windows(2).all(|w| w[0].t <= w[1].t));
            let ahead = hits.iter().filter(|h| h.t > 0.0).count();
            let odd = match &solid {
                // At t → ∞ a half-space is inside where the line goes against its normal.
                Solid::HalfSpace { normal, .. } => (ahead % 2 == 1) != (normal.dot(dir) < 0.0),
                _ => ahead % 2 == 1,
            };
            assert_eq!(odd, solid.contains(p), "{solid:?} {p}");
            for h in &hits {
                let on = p + dir * h.t;
                assert!(solid.signed_distance_bound(on).abs() < 1e-10);
                assert!((h.normal.length() - 1.0).abs() < 1e-12);
            }
            for (i, h) in hits.iter().enumerate() {
                // Crossings alternate between entering and leaving.
                let entering =
                    if matches!(solid, Solid::HalfSpace { .. }) { h.normal.dot(dir) < 0.0 } else { i % 2 == 0 };
                assert_eq!(h.normal.dot(dir) <= 1e-9, entering || h.normal.dot(dir).abs() <= 1e-9, "{solid:?}");
            }
            if solid.bounds().is_some() && solid.contains(p) {
                assert!(p.cmpge(min).all() && p.cmple(max).all());
            }
            let guess = 4.0 * uniform() - 2.0;
            let nearest = solid.nearest_crossing(p, dir, guess);
            let expected = hits.iter().map(|h| (h.t - guess).abs()).fold(f64::INFINITY, f64::min);
            match nearest {
                Some(h) => assert!(((h.t - guess).abs() - expected).abs() < 1e-9, "{solid:?}"),
                None => assert!(hits.is_empty()),
            }
        }
    }
}

#[test]
fn lines_that_only_just_enter_are_not_missed() {
    let torus = Solid::Torus { centre: DVec3::ZERO, axis: DVec3::Z, radius: 1.0, tube: 0.25 };
    let mut hits = Vec::new();
    // Along y at x = 1.25 − depth the line enters the outer equator by `depth`; half the chord is √(2·1.25·depth).
    for depth in [1e-3, 1e-6, 1e-9, 1e-12] {
        torus.intersect(DVec3::new(1.25 - depth, -3.0, 0.0), DVec3::Y, &mut hits);
        assert_eq!(hits.len(), 2, "{depth}");
        let half = (1.25f64.powi(2) - (1.25 - depth).powi(2)).sqrt();
        assert!((hits[1].t - hits[0].t - 2.0 * half).abs() < 1e-3 * half);
        torus.intersect(DVec3::new(1.25 + depth, -3.0, 0.0), DVec3::Y, &mut hits);
        assert_eq!(hits.len(), 0);
        // And the top, across the tube, on both sides of the hole.
        torus.intersect(DVec3::new(-3.0, 0.0, 0.25 - depth), DVec3::X, &mut hits);
        assert_eq!(hits.len(), 4, "{depth}");
    }
    // Lines through the rim of a cylinder and the tip of a cone: two crossings or none, never one.
    let mut uniform = numbers(5);
    let cylinder = Solid::Cylinder { from: DVec3::ZERO, to: DVec3::Z, radius: 1.0 };
    let cone = Solid::Cone { from: DVec3::ZERO, to: DVec3::Z, radius_from: 1.0, radius_to: 0.0 };
    for _ in 0..2000 {
        let dir = patch::random_direction(&mut uniform);
        let (sin, cos) = (6.3 * uniform()).sin_cos();
        cylinder.intersect(DVec3::new(cos, sin, 1.0) - dir * 2.0, dir, &mut hits);
        assert!(hits.len() != 1, "{dir}");
        cone.intersect(DVec3::Z - dir * 2.0, dir, &mut hits);
        assert!(hits.len() != 1, "{dir}");
    }
}

#[test]
fn a_far_origin_costs_no_digits() {
    let sphere = Solid::Sphere { centre: DVec3::ZERO, radius: 1.0 };
    let mut hits = Vec::new();
    sphere.intersect(DVec3::new(-1e6, 0.0, 0.6), DVec3::X, &mut hits);
    assert!((hits[0].t - (1e6 - 0.8)).abs() < 1e-9 && (hits[1].t - (1e6 + 0.8)).abs() < 1e-9);
}

#[test]
fn unusable_solids_are_refused_by_field() {
    let message = |solid: Solid| solid.validate().expect_err("unusable").to_string();
    let sphere = |radius| Solid::Sphere { centre: DVec3::ZERO, radius };
    assert!(message(sphere(0.0)).contains("radius"));
    assert!(message(sphere(f64::NAN)).contains("finite"));
    let flat = Solid::Box { min: DVec3::ZERO, max: DVec3::new(1.0, 0.0, 1.0) };
    assert!(message(flat).contains("along y"));
    let torus = Solid::Torus { centre: DVec3::ZERO, axis: DVec3::Z, radius: 1.0, tube: 1.0 };
    assert!(message(torus).contains("tube"));
    let axis = Solid::Torus { centre: DVec3::ZERO, axis: DVec3::ZERO, radius: 1.0, tube: 0.5 };
    assert!(message(axis).contains("axis"));
    let short = Solid::Cylinder { from: DVec3::X, to: DVec3::X, radius: 1.0 };
    assert!(message(short).contains("from"));
    let cone = |a, b| Solid::Cone { from: DVec3::X, to: DVec3::Y, radius_from: a, radius_to: b };
    assert!(message(cone(0.0, 0.0)).contains("radii"));
    assert!(message(cone(-1.0, 2.0)).contains("radii"));
    let plane = Solid::HalfSpace { point: DVec3::ZERO, normal: DVec3::Z, extent: 0.0 };
    assert!(message(plane).contains("extent"));
    let blend = |balls| Solid::Blend { balls, smoothness: 0.1 };
    assert!(message(blend(vec![])).contains("balls"));
    assert!(message(blend(vec![ball(0.0, 0.0, 0.0, 1.0), ball(0.0, 0.0, 0.0, -1.0)])).contains("balls[1].radius"));
}
