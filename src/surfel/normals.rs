//! Normals of points that come without: a quadric fitted to the neighbours.
//!
//! *Theory.* Hoppe et al. 1992 (§3.1) take the plane of least squares through the nearest neighbours (PCA). Cazals &
//! Pouget 2005 fit a *jet*, z = a + bx + cy + dx² + exy + fy² over that plane, whose slope is exact to one order more where
//! the neighbourhood is lopsided. How many neighbours: Mitra, Nguyen & Guibas 2004 balance the noise, whose share of the
//! slope's error falls as the neighbourhood grows, against the surface's own bending, whose share rises.
//!
//! *Changes from the papers.* Mitra needs the noise and the curvature beforehand. We read both off the fit: the standard
//! error of the slope, from the residuals and the normal equations. The neighbourhood starts at [`FIRST`] and grows where that
//! error is above [`GOOD_ENOUGH`], falls, and the residual itself does not grow: noise leaves the residual where it is, a
//! crease raises it by √2 per doubling, bending by more. So creases are not rounded off in the search for a smoother fit.
//! In the middle of a neighbourhood slope and quadratic terms are of opposite parity, so the jet costs no accuracy there.
//!
//! *Practice.* All fits are in `f64`, in units of the neighbourhood's radius about the point. The sign of the normal is
//! arbitrary here: see [`super::orient`].

use glam::{DMat3, DVec3, Vec3};

use crate::geometry::neighbours::Neighbours;

/// Neighbours of the first fit: 2.7 times the unknowns of the quadric.
const FIRST: usize = 16;

/// Radii of the wider neighbourhoods, in radii of the first: on a surface they hold twice, four and eight times as many points.
const DOUBLE: f64 = std::f64::consts::SQRT_2;
const WIDE: f64 = 2.0;
const WIDEST: f64 = 2.0 * DOUBLE;

/// A slope known to this standard error (radians, 0.3°) needs no larger neighbourhood.
const GOOD_ENOUGH: f64 = 0.005;

/// A doubled neighbourhood counts as noisy where the residual grows by less than this; a crease gives √2.
const STEADY: f64 = 1.2;

/// The same for one four times as large, where a crease gives 2. With 11 degrees of freedom the first residual itself is
/// uncertain by a fifth, which a doubling could not tell from a crease.
const STEADY_WIDE: f64 = 1.5;

/// Slope above which the quadric is fitted again in the frame of its own normal (tangent of about 6°).
const TILTED: f64 = 0.1;

/// The standard error of the normal at which confidence in it has fallen to one half, radians (5°).
const HALF_CONFIDENT: f64 = 0.087;

/// Unknowns of the quadric.
const UNKNOWNS: usize = 6;

/// A normal without sign.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct FittedNormal {
    /// Unit length.
    pub normal: Vec3,
    /// 0 (guess) to 1 (certain), from the slope's standard error.
    pub certainty: f32,
}

/// Buffers of one thread.
#[derive(Debug, Default)]
pub(crate) struct Scratch {
    /// Index and distance of the nearest points of the last fit.
    pub found: Vec<(u32, f32)>,
    offsets: Vec<DVec3>,
}

/// The normal at `points[index]`. Leaves its nearest [`FIRST`] + 1 points, itself among them, in `scratch.found`.
pub(crate) fn fit(neighbours: &Neighbours, points: &[Vec3], index: usize, scratch: &mut Scratch) -> FittedNormal {
    let p = points[index];
    let Scratch { found, offsets } = scratch;
    neighbours.nearest_k(p, FIRST + 1, found);
    offsets.clear();
    offsets.extend(found.iter().map(|&(j, _)| (points[j as usize] - p).as_dvec3()));
    let mut best = first_fit(offsets);
    if best.error > GOOD_ENOUGH && points.len() > 2 * FIRST && best.scale > 0.0 {
        let (scale, frame) = (best.scale, best.normal);
        offsets.clear();
        neighbours.for_each_within(p, (WIDEST * scale) as f32, |j, _| {
            offsets.push((points[j as usize] - p).as_dvec3());
        });
        let wider = |factor: f64, steady: f64, than: &Fit| {
            let fit = mended_jet(offsets, factor * scale, frame)?;
            (fit.residual <= steady * than.residual && fit.error < than.error).then_some(fit)
        };
        if let Some(wide) = wider(WIDE, STEADY_WIDE, &best) {
            best = wider(WIDEST, STEADY, &wide).unwrap_or(wide);
        } else if let Some(wide) = wider(DOUBLE, STEADY, &best) {
            best = wide;
        }
    }
    let doubt = best.error / HALF_CONFIDENT;
    FittedNormal {
        normal: best.normal.as_vec3().normalize_or(Vec3::Z),
        certainty: (1.0 / (1.0 + doubt * doubt)) as f32,
    }
}

struct Fit {
    normal: DVec3,
    /// Radius of the neighbourhood, world units.
    scale: f64,
    /// Root mean square residual, world units.
    residual: f64,
    /// Standard error of the slope, radians.
    error: f64,
}

/// Fits to `offsets` from the point, nearest first; the point itself is among them.
fn first_fit(offsets: &[DVec3]) -> Fit {
    let scale = offsets.last().map_or(0.0, |e| e.length());
    let (normal, flatness) = plane(offsets);
    if offsets.len() > UNKNOWNS
        && scale > 0.0
        && let Some(fit) = mended_jet(offsets, scale, normal)
    {
        return fit;
    }
    // What a plane alone says: with residual s over a disk of radius ρ the slope's standard error is 2 s / (ρ √k).
    let error = (2.0 * flatness / (offsets.len() as f64).sqrt()).max(HALF_CONFIDENT);
    Fit { normal, scale, residual: scale * flatness, error }
}

/// The quadric over the plane with `normal`; where it leans, again over its own tangent plane.
fn mended_jet(offsets: &[DVec3], scale: f64, normal: DVec3) -> Option<Fit> {
    let (first, slope) = jet(offsets, scale, normal)?;
    if slope <= TILTED {
        return Some(first);
    }
    // A quadric that runs away when its frame is mended follows outliers, not a surface.
    jet(offsets, scale, first.normal).and_then(|(second, slope)| (slope <= 1.0).then_some(second))
}

/// Normal of the plane of least squares through `offsets` and the root mean square distance from it, as a share of the
/// neighbourhood's radius.
fn plane(offsets: &[DVec3]) -> (DVec3, f64) {
    let count = offsets.len().max(1) as f64;
    let mean = offsets.iter().sum::<DVec3>() / count;
    let mut covariance = DMat3::ZERO;
    for &e in offsets {
        let d = e - mean;
        covariance += DMat3::from_cols(d * d.x, d * d.y, d * d.z);
    }
    let (least, normal) = least_eigenvector(covariance * (1.0 / count));
    let radius = offsets.last().map_or(0.0, |e| e.length());
    (normal, if radius > 0.0 { least.max(0.0).sqrt() / radius } else { 0.0 })
}

/// Least eigenvalue of a symmetric, positive matrix and its unit eigenvector (any of several where it is not unique).
fn least_eigenvector(m: DMat3) -> (f64, DVec3) {
    let size = m.x_axis.x + m.y_axis.y + m.z_axis.z;
    if !(size > 0.0) {
        return (0.0, DVec3::Z);
    }
    let a = m * (1.0 / size);
    let [least, ..] = eigenvalues(a);
    // The rows of A − λI are perpendicular to the eigenvector: the longest cross product is the most certain.
    let c = a - DMat3::from_diagonal(DVec3::splat(least));
    let crosses = [c.x_axis.cross(c.y_axis), c.y_axis.cross(c.z_axis), c.z_axis.cross(c.x_axis)];
    let longest =
        crosses.into_iter().fold(DVec3::ZERO, |l, v| if v.length_squared() > l.length_squared() { v } else { l });
    let normal = longest.try_normalize().unwrap_or_else(|| {
        // Two equal least eigenvalues (points along a line): any direction across the line.
        let along = [c.x_axis, c.y_axis, c.z_axis]
            .into_iter()
            .fold(DVec3::ZERO, |l, v| if v.length_squared() > l.length_squared() { v } else { l });
        along.try_normalize().map_or(DVec3::Z, |along| along.any_orthonormal_vector())
    });
    // Where the other two roots are equal, the arc cosine has lost half of the digits: the Rayleigh quotient has not.
    (normal.dot(m * normal), normal)
}

/// Eigenvalues of a symmetric matrix, ascending, by the cosine formula (Smith 1961).
pub(crate) fn eigenvalues(m: DMat3) -> [f64; 3] {
    let mean = (m.x_axis.x + m.y_axis.y + m.z_axis.z) / 3.0;
    let b = m - DMat3::from_diagonal(DVec3::splat(mean));
    let squares = b.x_axis.length_squared() + b.y_axis.length_squared() + b.z_axis.length_squared();
    let spread = (squares / 6.0).sqrt();
    if !(spread > f64::EPSILON * mean.abs()) {
        return [mean; 3];
    }
    let half_det = (b * (1.0 / spread)).determinant() * 0.5;
    let angle = half_det.clamp(-1.0, 1.0).acos() / 3.0;
    let third_of_turn = std::f64::consts::TAU / 3.0;
    let root = |angle: f64| mean + 2.0 * spread * angle.cos();
    [root(angle + third_of_turn), root(angle - third_of_turn), root(angle)]
}

/// The quadric over the plane with `normal`, of the offsets not longer than `scale`; also its slope at the point. `None`
/// where the points do not determine it.
fn jet(offsets: &[DVec3], scale: f64, normal: DVec3) -> Option<(Fit, f64)> {
    let (u, v) = normal.any_orthonormal_pair();
    // The normal equations hold only sums of products xⁱyʲ, i + j ≤ 4, and those with z: 22 sums.
    let mut moments = [[0.0f64; 5]; 5];
    let mut right = [0.0f64; UNKNOWNS];
    let (mut zz, mut count) = (0.0, 0);
    let per_scale = 1.0 / scale;
    // The farthest of the first neighbours lies at the scale itself.
    let reach2 = scale * scale * (1.0 + 1e-12);
    for e in offsets {
        if e.length_squared() > reach2 {
            continue;
        }
        let (x, y, z) = (e.dot(u) * per_scale, e.dot(v) * per_scale, e.dot(normal) * per_scale);
        let (xx, xy, yy) = (x * x, x * y, y * y);
        moments[1][0] += x;
        moments[0][1] += y;
        moments[2][0] += xx;
        moments[1][1] += xy;
        moments[0][2] += yy;
        moments[3][0] += xx * x;
        moments[2][1] += xx * y;
        moments[1][2] += x * yy;
        moments[0][3] += yy * y;
        moments[4][0] += xx * xx;
        moments[3][1] += xx * xy;
        moments[2][2] += xx * yy;
        moments[1][3] += xy * yy;
        moments[0][4] += yy * yy;
        right[0] += z;
        right[1] += x * z;
        right[2] += y * z;
        right[3] += xx * z;
        right[4] += xy * z;
        right[5] += yy * z;
        zz += z * z;
        count += 1;
    }
    if count <= UNKNOWNS {
        return None;
    }
    moments[0][0] = f64::from(count as u32);
    let powers = [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)];
    let entry = |i: usize, j: usize| moments[powers[i].0 + powers[j].0][powers[i].1 + powers[j].1];
    let system = std::array::from_fn(|i| std::array::from_fn(|j| entry(i, j)));
    let factor = cholesky(system)?;
    let solution = solve(&factor, right);
    let explained: f64 = solution.iter().zip(&right).map(|(s, r)| s * r).sum();
    let freedom = (count - UNKNOWNS) as f64;
    // Rounding leaves a negative residual where the fit is perfect.
    let variance = ((zz - explained) / freedom).max(0.0);
    let variance_of = |i: usize| {
        let mut unit = [0.0; UNKNOWNS];
        unit[i] = 1.0;
        solve(&factor, unit)[i]
    };
    let (bx, by) = (solution[1], solution[2]);
    let fit = Fit {
        normal: (normal - u * bx - v * by).normalize(),
        scale,
        residual: variance.sqrt() * scale,
        error: (variance * variance_of(1).max(variance_of(2))).sqrt(),
    };
    fit.normal.is_finite().then_some((fit, bx.hypot(by)))
}

/// Lower factor of a symmetric matrix given by its lower half; `None` where it is not safely positive.
fn cholesky(mut m: [[f64; UNKNOWNS]; UNKNOWNS]) -> Option<[[f64; UNKNOWNS]; UNKNOWNS]> {
    /// A pivot below this share of its diagonal entry has lost nearly all digits: the points lie on a conic.
    const LEAST_PIVOT: f64 = 1e-6;
    for j in 0..UNKNOWNS {
        let diagonal = m[j][j];
        let pivot = diagonal - (0..j).map(|k| m[j][k] * m[j][k]).sum::<f64>();
        if !(pivot > LEAST_PIVOT * diagonal) {
            return None;
        }
        let root = pivot.sqrt();
        m[j][j] = root;
        for i in j + 1..UNKNOWNS {
            let rest = m[i][j] - (0..j).map(|k| m[i][k] * m[j][k]).sum::<f64>();
            m[i][j] = rest / root;
        }
    }
    Some(m)
}

/// Solves L Lᵀ x = b.
fn solve(l: &[[f64; UNKNOWNS]; UNKNOWNS], mut b: [f64; UNKNOWNS]) -> [f64; UNKNOWNS] {
    for i in 0..UNKNOWNS {
        for k in 0..i {
            b[i] -= l[i][k] * b[k];
        }
        b[i] /= l[i][i];
    }
    for i in (0..UNKNOWNS).rev() {
        for k in i + 1..UNKNOWNS {
            b[i] -= l[k][i] * b[k];
        }
        b[i] /= l[i][i];
    }
    b
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surfel::test_shapes::{Random, torus_point, torus_points};

    #[test]
    fn eigenvectors_of_hard_matrices() {
        let axis = DVec3::new(1.0, -2.0, 0.5).normalize();
        let (u, v) = axis.any_orthonormal_pair();
        for (a, b, c) in [(0.0, 1.0, 1.0), (1e-9, 1.0, 2.0), (0.0, 1e-9, 1.0), (3.0, 3.5, 1e6), (0.0, 0.0, 1.0)] {
            let outer = |w: DVec3, s: f64| DMat3::from_cols(w * w.x, w * w.y, w * w.z) * s;
            let m = outer(axis, a) + outer(u, b) + outer(v, c);
            let (value, vector) = least_eigenvector(m);
            assert!((value - a).abs() <= 2e-9 * c, "{value} {a}");
            assert!((vector.length() - 1.0).abs() < 1e-12);
            assert!((m * vector - vector * value).length() < 1e-6 * c, "{a} {b} {c}");
        }
        assert_eq!(least_eigenvector(DMat3::ZERO).1, DVec3::Z);
    }

    /// Root mean square angle to the true normal of a torus, degrees, and the largest.
    fn torus_error(count: usize, noise_in_spacings: f64) -> (f64, f64) {
        let (centre_line, tube) = (1.0, 0.4);
        let mut random = Random::new(11);
        let spacing = (4.0 * std::f64::consts::PI.powi(2) * centre_line * tube / count as f64).sqrt();
        let exact = torus_points(centre_line, tube, count, &mut random);
        let points: Vec<Vec3> =
            exact.iter().map(|(p, n)| (*p + *n * (random.normal() * noise_in_spacings * spacing)).as_vec3()).collect();
        let neighbours = Neighbours::new(DVec3::ZERO, points.iter().copied());
        let mut scratch = Scratch::default();
        let mut worst: f64 = 0.0;
        let mut sum = 0.0;
        for (i, p) in points.iter().enumerate() {
            let truth = torus_point(centre_line, tube, p.as_dvec3()).1;
            let fitted = fit(&neighbours, &points, i, &mut scratch).normal.as_dvec3();
            let angle = fitted.dot(truth).abs().min(1.0).acos().to_degrees();
            worst = worst.max(angle);
            sum += angle * angle;
        }
        ((sum / count as f64).sqrt(), worst)
    }

    #[test]
    fn normals_of_a_torus_with_and_without_noise() {
        let (rms, worst) = torus_error(20_000, 0.0);
        eprintln!("clean: {rms:.4} {worst:.3}");
        assert!(rms < 0.2 && worst < 4.0);
        let (rms, worst) = torus_error(20_000, 0.2);
        eprintln!("noise 0.2: {rms:.3} {worst:.3}");
        assert!(rms < 2.0);
    }
}
