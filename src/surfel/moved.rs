//! Surfels that move as one: a leaf that turns, shifts or grows evenly keeps its surfels.
//!
//! *Practice.* Every number of a surfel is one of its surface's (a place, a normal, a radius, a curvature), so a motion that
//! keeps shapes says what becomes of it; nothing is estimated again. Move the surfels of the scene's own pose each time, not
//! those of the frame before: roundings would add up, and a frame would depend on which frames were drawn before it.

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use super::assemble::chunk_over;
use super::{CHUNK, SurfelCloud, Sym3};
use crate::space::Motion;

impl SurfelCloud {
    /// The surfels moved by `motion`.
    pub fn moved(&self, motion: &Motion) -> Self {
        let turn = DMat3::from_quat(motion.rotation).as_mat3();
        let (scale, linear) = (motion.scale as f32, turn * motion.scale as f32);
        // A form of second degree: R M Rᵀ times a power of the scale.
        let turned = |form: Sym3, factor: f32| Sym3::from_mat3(turn * form.to_mat3() * turn.transpose() * factor);
        let mut surfels = self.surfels.clone();
        let chunks = surfels
            .par_chunks_mut(CHUNK)
            .zip(&self.chunks)
            .map(|(surfels, chunk)| {
                for surfel in surfels.iter_mut() {
                    surfel.offset = linear * surfel.offset;
                    surfel.radius *= scale;
                    surfel.normal = (turn * surfel.normal).normalize_or(surfel.normal);
                    surfel.curvature = turned(surfel.curvature, 1.0 / scale);
                }
                let origin: DVec3 = motion.point(chunk.origin);
                chunk_over(origin, surfels)
            })
            .collect();
        let supports = self.supports.as_ref().map(|supports| {
            let factor = 1.0 / (scale * scale);
            supports.par_iter().map(|support| turned(*support, factor)).collect()
        });
        Self {
            surfels,
            chunks,
            supports,
            confidence: self.confidence.clone(),
            coloured: self.coloured,
            spacing: self.spacing * scale,
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::{DAffine3, DQuat};

    use super::*;
    use crate::geometry::PointCloud;
    use crate::surfel::{CloudOptions, from_cloud};

    #[test]
    fn moved_surfels_are_those_of_the_moved_scan() {
        // An ellipsoid, so that curvature has directions; far from the origin, as scans are.
        let own = DAffine3::from_scale_rotation_translation(
            DVec3::new(1.0, 1.5, 0.7),
            DQuat::from_rotation_y(0.3),
            DVec3::new(1e4, -2e4, 30.0),
        );
        let points = (0..4000).map(|i| {
            let z = 1.0 - (f64::from(i) + 0.5) / 2000.0;
            let (sin, cos) = (f64::from(i) * 2.399_963_229_728_653).sin_cos();
            DVec3::new(cos * (1.0 - z * z).sqrt(), sin * (1.0 - z * z).sqrt(), z)
        });
        let positions: Vec<DVec3> = points.collect();
        let normals = positions.iter().map(|p| p.as_vec3()).collect();
        let cloud = PointCloud { positions, normals: Some(normals), ..PointCloud::default() };
        let surfels = |map| from_cloud(cloud.clone(), map, &CloudOptions::default(), &|_| ()).unwrap().0;
        let motion = Motion {
            scale: 1.25,
            rotation: DQuat::from_rotation_x(0.9) * DQuat::from_rotation_z(-0.4),
            translation: DVec3::new(-3e3, 5.0, 7e3),
        };
        let (moved, anew) = (surfels(own).moved(&motion), surfels(motion.affine() * own));
        assert_eq!(moved.len(), anew.len());
        // Their order may differ, as the curve through them does.
        let mut order: Vec<usize> = (0..anew.len()).collect();
        let key = |cloud: &SurfelCloud, i: usize| (cloud.centre(i).x * 1e4).round() as i64;
        order.sort_by_key(|&i| key(&anew, i));
        for i in (0..moved.len()).step_by(7) {
            let centre = moved.centre(i);
            let first = order.partition_point(|&k| key(&anew, k) < key(&moved, i) - 2);
            let near = order[first..].iter().take(50).copied();
            let same =
                near.min_by(|&a, &b| anew.centre(a).distance(centre).total_cmp(&anew.centre(b).distance(centre)));
            let same = same.unwrap();
            assert!(anew.centre(same).distance(centre) < 1e-4);
            let (a, b) = (&moved.surfels[i], &anew.surfels[same]);
            assert!(a.normal.dot(b.normal) > 0.99999, "{} {}", a.normal, b.normal);
            assert!((a.radius / b.radius - 1.0).abs() < 0.01, "{} {}", a.radius, b.radius);
            let size = b.curvature.0.iter().fold(0.0, |m: f32, x| m.max(x.abs()));
            let apart = a.curvature.0.iter().zip(b.curvature.0).fold(0.0, |m: f32, (x, y)| m.max((x - y).abs()));
            assert!(apart < 0.02 * size, "{:?} {:?}", a.curvature, b.curvature);
            let chunk = &moved.chunks[i / CHUNK];
            assert!(a.offset.distance(chunk.centre) <= chunk.extent && a.radius <= chunk.largest_radius);
        }
    }
}
