//! A simulated range scanner: stations around an object, a grid of rays from each, and what they hit.
//!
//! Unlike [`super::simulate`], which knows the whole surface, a scanner sees only what faces it and what nothing hides. So
//! density falls with distance and slant, undercuts stay empty, and places that several stations see are covered several
//! times, with noise along each station's own rays.
//!
//! *Changes from a real one*: normals are the surface's own with noise, where a scanner fits them to neighbouring ranges;
//! stations are registered without error.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::rng::Rng;
use super::simulate::{Places, ScanError, tilted};
use crate::geometry::{PointCloud, Solid};

/// A scanner and where it is set up; lengths in the solid's units.
#[derive(Debug, Clone, PartialEq)]
pub struct Scanner {
    /// Where it stands.
    pub stations: Vec<DVec3>,
    /// What it looks at, and how far around it.
    pub target: DVec3,
    /// Radius about `target` that its rays fill.
    pub reach: f64,
    /// Rays along each side of the square grid of a station.
    pub rays_across: usize,
    /// Standard deviation of the range.
    pub range_noise: f64,
    /// Standard deviation of the normals, degrees.
    pub normal_noise_deg: f64,
    /// Hits more slanted than this come back too weak, degrees from the normal.
    pub most_slant_deg: f64,
    /// Of everything random.
    pub seed: u64,
}

impl Scanner {
    /// What the scanner sees of `solid`, past `obstacles` that stand in the way. Station by station, row by row.
    ///
    /// # Errors
    /// [`ScanError::NothingSeen`] where no ray comes back, [`ScanError::Solid`] where a solid is unusable.
    pub fn scan(&self, solid: &Solid, obstacles: &[Solid]) -> Result<PointCloud, ScanError> {
        for solid in obstacles.iter().chain([solid]) {
            solid.validate()?;
        }
        let seen: Vec<(DVec3, Vec3)> = (0..self.stations.len())
            .into_par_iter()
            .flat_map_iter(|station| self.seen_from(station, solid, obstacles))
            .collect();
        if seen.is_empty() {
            return Err(ScanError::NothingSeen);
        }
        let (positions, normals) = seen.into_iter().unzip();
        Ok(PointCloud { positions, normals: Some(normals), ..PointCloud::default() })
    }

    fn seen_from(&self, station: usize, solid: &Solid, obstacles: &[Solid]) -> Vec<(DVec3, Vec3)> {
        let eye = self.stations[station];
        let mut rng = Rng::new(self.seed, station as u64);
        let away = self.target - eye;
        let forward = away.normalize_or(DVec3::X);
        let (u, v) = forward.any_orthonormal_pair();
        // The grid fills the cone around the sphere that the scanner is to see.
        let half_width = self.reach / (away.length_squared() - self.reach * self.reach).max(f64::MIN_POSITIVE).sqrt();
        let least_cosine = self.most_slant_deg.to_radians().cos();
        let mut hits = Vec::new();
        let mut first_hit = |solid: &Solid, dir: DVec3| {
            solid.intersect(eye, dir, &mut hits);
            hits.iter().find(|hit| hit.t > 0.0).copied()
        };
        let mut seen = Vec::new();
        for cell in 0..self.rays_across * self.rays_across {
            let (column, row) = (cell % self.rays_across, cell / self.rays_across);
            // A ray leaves anywhere within its cell: a lattice in step with the surface would be too kind.
            let mut place = |i: usize| (2.0 * (i as f64 + rng.uniform()) / self.rays_across as f64 - 1.0) * half_width;
            let dir = (forward + u * place(column) + v * place(row)).normalize();
            // Drawn for every ray, so that an obstacle does not change the noise of what it leaves visible.
            let (range_error, tilt, side) = (rng.gaussian(), rng.gaussian(), rng.direction());
            let Some(hit) = first_hit(solid, dir) else { continue };
            if !(-hit.normal.dot(dir) >= least_cosine) {
                continue;
            }
            if obstacles.iter().any(|obstacle| first_hit(obstacle, dir).is_some_and(|other| other.t < hit.t)) {
                continue;
            }
            let normal = tilted(hit.normal, side, tilt * self.normal_noise_deg.to_radians());
            seen.push((eye + dir * (hit.t + range_error * self.range_noise), normal.as_vec3()));
        }
        seen
    }
}

/// Keeps at most `count` points, spread evenly: in random order, a point stays where none that stayed is closer than a
/// distance, which is halved and doubled until just enough stay. A cloud that is smaller already stays as it is.
pub fn thin(cloud: &mut PointCloud, count: usize, seed: u64) {
    if cloud.len() <= count {
        return;
    }
    let mut order: Vec<usize> = (0..cloud.len()).collect();
    let mut rng = Rng::new(seed, 0);
    for i in (1..order.len()).rev() {
        order.swap(i, rng.below(i + 1));
    }
    let positions = &cloud.positions;
    let staying = |distance: f64| {
        let mut places = Places::new(distance);
        order.iter().copied().filter(|&i| places.add_if_free(positions[i])).collect::<Vec<_>>()
    };
    let (min, max) =
        positions.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(min, max), p| (min.min(*p), max.max(*p)));
    // Bisection to a thousandth of the answer.
    const STEPS: u32 = 24;
    let (mut near, mut far) = (0.0, (max - min).length());
    let mut kept = order[..count].to_vec();
    for _ in 0..STEPS {
        let middle = 0.5 * (near + far);
        let staying = staying(middle);
        if staying.len() >= count {
            near = middle;
            kept = staying[..count].to_vec();
        } else {
            far = middle;
        }
    }
    let mut keep = vec![false; cloud.len()];
    kept.into_iter().for_each(|i| keep[i] = true);
    cloud.retain(|i| keep[i]);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scanner(stations: Vec<DVec3>) -> Scanner {
        Scanner {
            stations,
            target: DVec3::ZERO,
            reach: 1.2,
            rays_across: 60,
            range_noise: 0.0,
            normal_noise_deg: 0.0,
            most_slant_deg: 80.0,
            seed: 5,
        }
    }

    fn ball() -> Solid {
        Solid::Sphere { centre: DVec3::ZERO, radius: 1.0 }
    }

    #[test]
    fn one_station_sees_the_side_that_faces_it() {
        let cloud = scanner(vec![DVec3::X * 4.0]).scan(&ball(), &[]).unwrap();
        assert!(cloud.len() > 1000);
        // The horizon of a unit ball from 4 away lies at x = 1/4; 80° of slant end before it.
        assert!(cloud.positions.iter().all(|p| p.x > 0.25 && (p.length() - 1.0).abs() < 1e-9));
        let outward = |(p, n): (&DVec3, &Vec3)| p.as_vec3().dot(*n) > 0.999;
        assert!(cloud.positions.iter().zip(cloud.normals.as_ref().unwrap()).all(outward));
    }

    #[test]
    fn an_obstacle_hides_what_is_behind_it_and_nothing_else() {
        let scanner = scanner(vec![DVec3::X * 4.0]);
        let all = scanner.scan(&ball(), &[]).unwrap();
        let in_front = Solid::Sphere { centre: DVec3::X * 2.0, radius: 0.2 };
        let behind = Solid::Sphere { centre: DVec3::X * -2.0, radius: 0.2 };
        assert_eq!(scanner.scan(&ball(), std::slice::from_ref(&behind)).unwrap(), all);
        let partly = scanner.scan(&ball(), std::slice::from_ref(&in_front)).unwrap();
        assert!(partly.len() < all.len() && partly.positions.iter().all(|p| all.positions.contains(p)));
        let shadowed = |p: &&DVec3| (p.y * p.y + p.z * p.z).sqrt() < 0.15;
        assert_eq!(partly.positions.iter().filter(shadowed).count(), 0);
    }

    #[test]
    fn range_noise_is_along_the_ray() {
        let noisy = Scanner { range_noise: 0.01, ..scanner(vec![DVec3::X * 4.0]) };
        let (clean, noisy) = (scanner(vec![DVec3::X * 4.0]).scan(&ball(), &[]), noisy.scan(&ball(), &[]));
        let (clean, noisy) = (clean.unwrap(), noisy.unwrap());
        let errors = clean.positions.iter().zip(&noisy.positions).map(|(a, b)| {
            let ray = (a - DVec3::X * 4.0).normalize();
            assert!((b - a).cross(ray).length() < 1e-12);
            (b - a).length_squared()
        });
        let rms = (errors.sum::<f64>() / clean.len() as f64).sqrt();
        assert!((rms - 0.01).abs() < 1e-3, "{rms}");
    }

    #[test]
    fn nothing_seen_is_an_error() {
        assert_eq!(scanner(vec![]).scan(&ball(), &[]), Err(ScanError::NothingSeen));
    }

    #[test]
    fn thinning_keeps_what_is_asked_for_and_spreads_it() {
        let stations = vec![DVec3::X * 4.0, DVec3::new(3.0, 2.5, 0.0)];
        let mut cloud = scanner(stations).scan(&ball(), &[]).unwrap();
        let before = cloud.len();
        let closest = |cloud: &PointCloud| {
            let mut least = f64::INFINITY;
            for (i, p) in cloud.positions.iter().enumerate() {
                least = cloud.positions[..i].iter().map(|q| q.distance(*p)).fold(least, f64::min);
            }
            least
        };
        let least_before = closest(&cloud);
        thin(&mut cloud, 800, 1);
        assert_eq!((cloud.len(), cloud.normals.as_ref().unwrap().len()), (800, 800));
        assert!(closest(&cloud) > 10.0 * least_before && before > 2000);
        thin(&mut cloud, 1000, 1);
        assert_eq!(cloud.len(), 800);
    }
}
