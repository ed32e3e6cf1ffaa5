//! Curvature of a surfel, fitted to the normals about it.
//!
//! *Theory.* The shape operator K maps a step in the tangent plane to the change of the normal: Δn = K Δp (Rusinkiewicz 2004
//! fits it per triangle). We fit the symmetric 2×2 K by least squares over the nearest neighbours. A surfel's field is
//! n·e + ½ eᵀMe with M = K + ½ tr(K) nnᵀ; the last term makes the field of a sphere exact off the tangent plane too, where
//! K = I/R must become M = I/R in all three directions.
//!
//! *Practice.* A small ridge ([`RIDGE`]) keeps neighbours in a line from leaving K undetermined. Neighbours of another face of
//! a crease, or of the opposite sheet of a thin wall, are the caller's to leave out: [`SAME_SHEET`]. Where normals are noisy
//! (the residual is a large share of what K explains) the caller's further neighbours are used as well.

use glam::{Mat3, Vec3};

use super::Sym3;

/// Two surfels are on one sheet where the cosine between their normals is above this (60°): creases are sharper.
pub(crate) const SAME_SHEET: f32 = 0.5;

/// Ridge, as a share of the squared distances, for neighbours nearly in a line.
const RIDGE: f64 = 1e-4;

/// The same where neighbours are spread well and K is determined without it. A ridge bends every curvature by its own share:
/// with 1e-4, a sphere of 34 surfels lay half a pixel off at 100×.
const RIDGE_SPREAD: f64 = 1e-8;

/// Neighbours are spread well where their second moments' determinant is at least this share of the largest it can be.
const WELL_SPREAD: f64 = 0.1;

/// Neighbours of the fit.
pub(crate) const NEIGHBOURS: usize = 8;

/// Residual normals above this share of the fitted change of the normal count as noise: all neighbours are then used.
const NOISY: f64 = 0.25;

/// Fewest neighbours for which K (three numbers) is fitted.
const FEWEST: usize = 3;

/// M of a surfel with normal `n` from (offset, normal) of its neighbours on the same sheet, nearest first. The nearest
/// [`NEIGHBOURS`] are used, all where their normals are noisy. Zero where there are fewer than three.
pub(crate) fn fit(n: Vec3, neighbours: &[(Vec3, Vec3)]) -> Sym3 {
    let near = &neighbours[..neighbours.len().min(NEIGHBOURS)];
    if near.len() < FEWEST {
        return Sym3::default();
    }
    let (u, v) = n.any_orthonormal_pair();
    let (k, noise) = shape_operator(n, u, v, near);
    if noise > NOISY && neighbours.len() > near.len() {
        return fit_widely(n, neighbours);
    }
    field_of(n, u, v, k)
}

/// The same from all of `neighbours`: for a surfel that bridges a gap of the scan, or whose normals are noisy.
pub(crate) fn fit_widely(n: Vec3, neighbours: &[(Vec3, Vec3)]) -> Sym3 {
    if neighbours.len() < FEWEST {
        return Sym3::default();
    }
    let (u, v) = n.any_orthonormal_pair();
    field_of(n, u, v, shape_operator(n, u, v, neighbours).0)
}

/// M of the shape operator k₁₁, k₁₂, k₂₂ in the frame (u, v) of the normal; zero where it is not finite.
fn field_of(n: Vec3, u: Vec3, v: Vec3, k: [f64; 3]) -> Sym3 {
    let [k11, k12, k22] = k.map(|x| x as f32);
    if !(k11.is_finite() && k12.is_finite() && k22.is_finite()) {
        return Sym3::default();
    }
    let outer = |a: Vec3, b: Vec3| Mat3::from_cols(a * b.x, a * b.y, a * b.z);
    Sym3::from_mat3(
        outer(u, u) * k11 + (outer(u, v) + outer(v, u)) * k12 + outer(v, v) * k22 + outer(n, n) * (0.5 * (k11 + k22)),
    )
}

/// k₁₁, k₁₂, k₂₂ in the frame (u, v), and the root mean square residual as a share of the explained change.
fn shape_operator(n: Vec3, u: Vec3, v: Vec3, neighbours: &[(Vec3, Vec3)]) -> ([f64; 3], f64) {
    let in_plane = |w: Vec3| (f64::from(w.dot(u)), f64::from(w.dot(v)));
    let (mut aa, mut ab, mut bb) = (0.0, 0.0, 0.0);
    let mut right = [0.0f64; 3];
    for &(e, other) in neighbours {
        let (a, b) = in_plane(e);
        let (p, q) = in_plane(other - n);
        aa += a * a;
        ab += a * b;
        bb += b * b;
        right[0] += a * p;
        right[1] += b * p + a * q;
        right[2] += b * q;
    }
    if !(aa + bb > 0.0) {
        return ([0.0; 3], 0.0);
    }
    // [α  ab  0 ] [k₁₁]   the normal equations of Σ|K a − d|² with the ridge on the diagonal;
    // [ab  β  ab] [k₁₂]   k₁₁ and k₂₂ are eliminated first, as the corners hold zeros.
    // [0   ab  γ] [k₂₂]
    let spread = 4.0 * (aa * bb - ab * ab) / ((aa + bb) * (aa + bb)); // 1 for equal moments, 0 for a line
    let ridge = (aa + bb) * if spread > WELL_SPREAD { RIDGE_SPREAD } else { RIDGE };
    let (alpha, beta, gamma) = (aa + ridge, aa + bb + ridge, bb + ridge);
    let k12 = (right[1] - ab * (right[0] / alpha + right[2] / gamma)) / (beta - ab * ab * (1.0 / alpha + 1.0 / gamma));
    let k11 = (right[0] - ab * k12) / alpha;
    let k22 = (right[2] - ab * k12) / gamma;
    let (mut explained, mut left) = (0.0, 0.0);
    for &(e, other) in neighbours {
        let (a, b) = in_plane(e);
        let (p, q) = in_plane(other - n);
        let (kp, kq) = (k11 * a + k12 * b, k12 * a + k22 * b);
        explained += kp * kp + kq * kq;
        left += (p - kp).powi(2) + (q - kq).powi(2);
    }
    let noise = if explained > 0.0 { (left / explained).sqrt() } else { 0.0 };
    ([k11, k12, k22], noise)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ring(count: usize, radius: f32) -> impl Iterator<Item = (f32, f32)> {
        (0..count).map(move |i| {
            let (s, c) = (i as f32 * std::f32::consts::TAU / count as f32).sin_cos();
            (c * radius, s * radius)
        })
    }

    #[test]
    fn sphere_is_exact_in_all_directions() {
        let radius = 2.5;
        let n = Vec3::new(0.3, -0.5, 0.8).normalize();
        let (u, v) = n.any_orthonormal_pair();
        let neighbours: Vec<_> = ring(8, 0.2)
            .map(|(a, b)| {
                let m = (n * radius + u * a + v * b).normalize();
                (m * radius - n * radius, m)
            })
            .collect();
        let m = fit(n, &neighbours);
        for d in [Vec3::X, Vec3::Y, Vec3::Z, n] {
            assert!((m.mul(d) - d / radius).length() < 1e-3 / radius, "{d} {}", m.mul(d));
        }
    }

    #[test]
    fn cylinder_bends_across_and_not_along() {
        let radius = 0.5;
        let neighbours: Vec<_> = ring(8, 0.1)
            .map(|(a, b)| {
                let m = Vec3::new((a / radius).cos(), (a / radius).sin(), 0.0);
                (m * radius - Vec3::X * radius + Vec3::Z * b, m)
            })
            .collect();
        let m = fit(Vec3::X, &neighbours);
        assert!((m.mul(Vec3::Y).y - 1.0 / radius).abs() < 0.02 / radius);
        assert!(m.mul(Vec3::Z).length() < 1e-3 / radius);
        assert!((m.mul(Vec3::X).x - 0.5 / radius).abs() < 0.02 / radius);
    }

    #[test]
    fn too_few_or_degenerate_is_flat() {
        let one = (Vec3::Y * 0.1, Vec3::new(1.0, 0.1, 0.0).normalize());
        assert_eq!(fit(Vec3::X, &[one, one]), Sym3::default());
        let same = (Vec3::ZERO, Vec3::X);
        assert_eq!(fit(Vec3::X, &[same; 8]), Sym3::default());
        // In a line: bends along it, is flat across it.
        let line: Vec<_> =
            [-2.0, -1.0, 1.0, 2.0f32].map(|t| (Vec3::Y * 0.1 * t, Vec3::new(1.0, 0.1 * t, 0.0))).to_vec();
        let m = fit(Vec3::X, &line);
        assert!((m.mul(Vec3::Y).y - 1.0).abs() < 1e-2 && m.mul(Vec3::Z).length() < 1e-4);
    }
}
