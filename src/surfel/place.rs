//! A point cloud in world space, in its final order: what every later stage of [`super::cloud`] reads.

use glam::{DAffine3, DMat3, DVec3, Vec3};
use rayon::prelude::*;

use super::assemble::{median, morton_order};
use super::cloud::MOST_POINTS;
use super::{SurfelError, Sym3};
use crate::geometry::{Ellipse, PointCloud};

/// A map is a similarity where it scales all directions alike to this share; then disks stay disks.
const SIMILAR: f64 = 1e-5;

/// The least ratio of an ellipse's axes: flatter ones are given this width, as their support matrix would not be finite.
const LEAST_ASPECT: f64 = 1e-3;

/// What is known of a point's normal beforehand.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum Known {
    /// Direction and sign.
    All,
    /// The direction: an ellipse has a plane, but no outer side.
    Direction,
    /// Nothing.
    Nothing,
}

/// Supports that came with the points.
#[derive(Debug)]
pub(crate) enum Given {
    /// None.
    Nothing,
    /// Radii in leaf units, transformed only when the normals are known; 0 where the file's is no positive number.
    Radii(Vec<f32>),
    /// Longest semi-axes (0 where the file's ellipse has none) and support matrices, world space.
    Ellipses(Vec<(f32, Sym3)>),
}

/// See the module's text.
#[derive(Debug)]
pub(crate) struct Placed {
    /// What `points` are relative to, world space: the cloud's median.
    pub origin: DVec3,
    /// Offsets from `origin`.
    pub points: Vec<Vec3>,
    /// World space.
    pub positions: Vec<DVec3>,
    /// Unit normals; zero where not known.
    pub normals: Vec<Vec3>,
    /// Absent where all normals are fully known.
    pub known: Option<Vec<Known>>,
    pub colours: Vec<[u8; 4]>,
    pub coloured: bool,
    pub given: Given,
    /// Points dropped because another lies at their place.
    pub duplicates: usize,
}

/// The map of normals, the inverse transpose: right for uneven scales and for mirrors (outward stays outward).
pub(crate) fn normal_map(world_from_leaf: DAffine3) -> Result<DMat3, SurfelError> {
    let map = world_from_leaf.matrix3.inverse().transpose();
    let usable = world_from_leaf.is_finite() && map.is_finite() && map != DMat3::ZERO;
    usable.then_some(map).ok_or(SurfelError::Transform)
}

/// The factor of lengths where `linear` is a similarity (rotation, mirror, even scale).
pub(crate) fn even_scale(linear: DMat3) -> Option<f64> {
    let metric = linear.transpose() * linear;
    let mean = (metric.x_axis.x + metric.y_axis.y + metric.z_axis.z) / 3.0;
    let rest = metric - DMat3::from_diagonal(DVec3::splat(mean));
    let largest = rest.to_cols_array().into_iter().fold(0.0, |m: f64, x| m.max(x.abs()));
    (largest <= SIMILAR * mean).then(|| mean.sqrt())
}

/// The ellipse with conjugate semi-axes `a` and `b` (a disk's transformed axes are conjugate, not perpendicular): its longest
/// semi-axis and the matrix S with eᵀSe = 1 on its border. A radius of 0 where it has no extent.
pub(crate) fn ellipse(a: DVec3, b: DVec3) -> (f32, Sym3) {
    // With P = [a b] the points are e = P s, |s| ≤ 1; so s = (PᵀP)⁻¹ Pᵀ e, and S = P (PᵀP)⁻² Pᵀ.
    let (mut aa, ab, mut bb) = (a.length_squared(), a.dot(b), b.length_squared());
    let (mean, half) = (0.5 * (aa + bb), (0.25 * (aa - bb) * (aa - bb) + ab * ab).sqrt());
    let largest = mean + half;
    if !(largest > 0.0 && largest.is_finite()) {
        return (0.0, Sym3::default());
    }
    // A needle is given some width, in the plane that its axes still span.
    let width = (LEAST_ASPECT * LEAST_ASPECT * largest - (mean - half)).max(0.0);
    aa += width;
    bb += width;
    let det = aa * bb - ab * ab;
    let (p, q) = ((a * bb - b * ab) / det, (b * aa - a * ab) / det);
    let column = |i: usize| (p * p[i] + q * q[i]).as_vec3();
    (largest.sqrt() as f32, Sym3::from_mat3(glam::Mat3::from_cols(column(0), column(1), column(2))))
}

impl Placed {
    /// Brings `cloud` to world space and into Z-curve order, without duplicates.
    pub(crate) fn new(
        mut cloud: PointCloud,
        world_from_leaf: DAffine3,
        ignore_normals: bool,
    ) -> Result<Self, SurfelError> {
        let normal_map = normal_map(world_from_leaf)?;
        if cloud.is_empty() {
            return Err(SurfelError::Empty);
        }
        if cloud.len() > MOST_POINTS {
            let mend = "thin the cloud, or split it into leaves";
            return Err(SurfelError::TooMany { needed: cloud.len() as f64, limit: MOST_POINTS, mend });
        }
        cloud.positions.par_iter_mut().for_each(|p| *p = world_from_leaf.transform_point3(*p));
        if let Some(index) = cloud.positions.par_iter().position_first(|p| !p.is_finite()) {
            return Err(SurfelError::NotFinite { index, p: cloud.positions[index] });
        }
        let origin = median(&cloud.positions);
        // + 0 turns a negative zero, which would part identical points, into a positive one.
        let offsets: Vec<Vec3> = cloud.positions.par_iter().map(|p| (*p - origin).as_vec3() + Vec3::ZERO).collect();
        let mut order = morton_order(&offsets);
        order.dedup_by(|later, earlier| offsets[*later as usize] == offsets[*earlier as usize]);
        let duplicates = offsets.len() - order.len();
        let points = gather(&order, |i| offsets[i]);
        drop(offsets);
        let positions = gather(&order, |i| cloud.positions[i]);
        cloud.positions = Vec::new();

        let to_world = |n: Vec3| (normal_map * n.as_dvec3()).normalize_or_zero().as_vec3();
        let axes_normal = |e: &Ellipse| to_world(e.axis_u.cross(e.axis_v));
        let normal = |i: usize| {
            let of_file = cloud.normals.as_ref().filter(|_| !ignore_normals).map(|n| to_world(n[i]));
            match of_file.filter(|n| *n != Vec3::ZERO) {
                Some(n) => (n, Known::All),
                None => match cloud.ellipses.as_ref().map(|e| axes_normal(&e[i])).filter(|n| *n != Vec3::ZERO) {
                    Some(n) => (n, Known::Direction),
                    None => (Vec3::ZERO, Known::Nothing),
                },
            }
        };
        let normals = gather(&order, |i| normal(i).0);
        let known = gather(&order, |i| normal(i).1);
        let known = known.par_iter().any(|k| *k != Known::All).then_some(known);
        cloud.normals = None;

        let given = match (cloud.ellipses.take(), cloud.radii.take()) {
            (Some(ellipses), _) => {
                let of = |e: Vec3| world_from_leaf.matrix3 * e.as_dvec3();
                Given::Ellipses(gather(&order, |i| ellipse(of(ellipses[i].axis_u), of(ellipses[i].axis_v))))
            }
            (None, Some(radii)) => {
                Given::Radii(gather(&order, |i| if radii[i] > 0.0 && radii[i].is_finite() { radii[i] } else { 0.0 }))
            }
            (None, None) => Given::Nothing,
        };
        let colours = gather(&order, |i| {
            // White, so that a leaf's own colour, which then counts, is not tinted.
            let [r, g, b] = cloud.colours.as_ref().map_or([u8::MAX; 3], |c| c[i]);
            let opacity = cloud.opacities.as_ref().map_or(1.0, |o| o[i]);
            // `as` takes NaN to 0, and clamps.
            [r, g, b, (opacity * f32::from(u8::MAX)).round() as u8]
        });
        let coloured = cloud.colours.is_some();
        Ok(Self { origin, points, positions, normals, known, colours, coloured, given, duplicates })
    }
}

fn gather<T: Send>(order: &[u32], of: impl Fn(usize) -> T + Sync) -> Vec<T> {
    order.par_iter().with_min_len(1 << 12).map(|i| of(*i as usize)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scaled_disk_is_an_ellipse() {
        let map = DMat3::from_diagonal(DVec3::new(3.0, 1.0, 2.0)) * DMat3::from_rotation_z(0.7);
        let (r, s) = ellipse(map * DVec3::X * 0.5, map * DVec3::Y * 0.5);
        assert!((r - 1.5).abs() < 1e-6);
        for i in 0..20 {
            let (sin, cos) = (f64::from(i) * 0.3).sin_cos();
            let on_border = (map * DVec3::new(cos, sin, 0.0) * 0.5).as_vec3();
            assert!((on_border.dot(s.mul(on_border)) - 1.0).abs() < 1e-5);
        }
        assert!(s.mul(Vec3::Z).length() < 1e-6);
    }

    #[test]
    fn needles_and_nothing() {
        let (r, s) = ellipse(DVec3::X, DVec3::Y * 1e-9);
        assert!((r - 1.0).abs() < 1e-3 && s.0.iter().all(|x| x.is_finite()));
        assert_eq!(ellipse(DVec3::ZERO, DVec3::ZERO).0, 0.0);
        assert_eq!(ellipse(DVec3::NAN, DVec3::X).0, 0.0);
    }

    #[test]
    fn similarities() {
        let turn = DMat3::from_rotation_x(0.3);
        assert!((even_scale(turn * 2.0).unwrap() - 2.0).abs() < 1e-12);
        assert!(even_scale(turn * DMat3::from_diagonal(DVec3::new(-2.0, 2.0, 2.0))).is_some());
        assert!(even_scale(turn * DMat3::from_diagonal(DVec3::new(2.0, 2.0, 2.01))).is_none());
        assert!(normal_map(DAffine3::from_scale(DVec3::new(1.0, 0.0, 1.0))).is_err());
        assert!(normal_map(DAffine3::from_scale(DVec3::new(1.0, f64::NAN, 1.0))).is_err());
    }
}
