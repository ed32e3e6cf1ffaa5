//! Simulated scans: points on an analytic solid, as a modeller, a scanner's software or a careless hand would leave them.
//!
//! Everything happens in leaf space, and everything random comes from the seed: one stream of [`Rng`] places the points,
//! another disturbs them, so that the same places can be had with and without noise.
//!
//! * **Regular**: spheres by Fibonacci's lattice, planes by square grids, blends by Fibonacci's directions from their
//!   middle where no part of the surface is too oblique to that; other solids as Poisson.
//! * **Poisson**: dart throwing, no two points closer than [`POISSON_DISTANCE`] of the mean spacing.
//! * **Irregular**: darts kept with a probability that varies by more than a factor of ten over the surface, clusters and
//!   gaps as they fall.

use std::collections::HashMap;
use std::f64::consts::PI;

use glam::{DVec3, IVec3};

use super::rng::Rng;
use crate::geometry::{PointCloud, Solid, SolidError};

/// The least distance between Poisson-disk points in units of √(area / count). Dart throwing fills a surface to about 1.24
/// times as many points as are asked for at this distance.
pub const POISSON_DISTANCE: f64 = 0.75;

/// Regular grids of at most this many points on a half-space carry radii: so few points have too few neighbours to tell.
pub const FEW_POINTS: usize = 4;

/// The radius of such a point in units of its grid cell's side: the cell's corners lie at 0.71.
pub const FEW_POINTS_RADIUS: f64 = 0.75;

/// Where the points lie.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Sampling {
    /// As evenly as the solid allows.
    Regular,
    /// Blue noise.
    Poisson,
    /// A point at p of the leaf is kept with probability `least` + (1 − `least`)·s², s = ½ + ½ sin(5x + 3y + 4z).
    Irregular {
        /// From 0 (exclusive) to 1.
        least: f64,
    },
}

impl Sampling {
    /// The irregular sampling of the accuracy tables: the density varies by a factor of twelve.
    pub const IRREGULAR: Self = Self::Irregular { least: 0.08 };
}

/// Patches where the scanner saw nothing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gaps {
    /// How many, centred at points of the scan.
    pub count: u32,
    /// Radius in units of the mean spacing.
    pub radius: f64,
}

/// How a solid is scanned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScanOptions {
    /// Points; a regular grid takes the nearest number that fills it.
    pub count: usize,
    /// Of everything random.
    pub seed: u64,
    /// Where the points lie.
    pub sampling: Sampling,
    /// Standard deviation of the displacement along the normal, in units of the mean spacing √(area / count).
    pub position_noise: f64,
    /// Standard deviation of the normal's deviation in degrees, in a random direction.
    pub normal_noise_deg: f64,
    /// Whether the scan has normals.
    pub with_normals: bool,
    /// Share of normals that point the wrong way, 0 to 1.
    pub flipped: f64,
    /// Missing patches.
    pub gaps: Option<Gaps>,
}

impl ScanOptions {
    /// A clean, regular scan of `count` points with normals.
    pub const fn regular(count: usize, seed: u64) -> Self {
        Self {
            count,
            seed,
            sampling: Sampling::Regular,
            position_noise: 0.0,
            normal_noise_deg: 0.0,
            with_normals: true,
            flipped: 0.0,
            gaps: None,
        }
    }

    /// The same with another sampling.
    pub const fn sampled(self, sampling: Sampling) -> Self {
        Self { sampling, ..self }
    }

    /// The same with noise: positions in units of spacing, normals in degrees.
    pub const fn noisy(self, position_noise: f64, normal_noise_deg: f64) -> Self {
        Self { position_noise, normal_noise_deg, ..self }
    }

    /// The same without normals.
    pub const fn without_normals(self) -> Self {
        Self { with_normals: false, ..self }
    }
}

/// Why a scan cannot be simulated.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ScanError {
    /// No point was asked for.
    #[error("a scan needs at least one point")]
    NoPoints,
    /// A number of the options is out of range.
    #[error("`{field}` of a simulated scan must be {allowed}, not {value}")]
    Range {
        /// Which.
        field: &'static str,
        /// What it may be.
        allowed: &'static str,
        /// What it is.
        value: f64,
    },
    /// The solid cannot be used.
    #[error("the solid to be scanned is unusable: {0}")]
    Solid(#[from] SolidError),
    /// Not as many points as asked for found room.
    #[error("only {placed} of {count} points found room on the surface")]
    Crowded {
        /// Points that did.
        placed: usize,
        /// Points asked for.
        count: usize,
    },
    /// Nothing was seen, or nothing is left.
    #[error("no point of the surface was seen")]
    NothingSeen,
}

/// A point of a surface and the outward unit normal there.
type SurfacePoint = (DVec3, DVec3);

/// Scans `solid` in its leaf space.
///
/// # Errors
/// [`ScanError`] names what cannot be done.
pub fn scan(solid: &Solid, options: &ScanOptions) -> Result<PointCloud, ScanError> {
    check(options)?;
    solid.validate()?;
    let mut rng = Rng::new(options.seed, PLACES);
    let mut points = match options.sampling {
        Sampling::Regular => match regular(solid, options.count) {
            Some(points) => points,
            None => poisson(solid, options.count, &mut rng)?,
        },
        Sampling::Poisson => poisson(solid, options.count, &mut rng)?,
        Sampling::Irregular { least } => irregular(solid, options.count, least, &mut rng),
    };
    let radii = match (solid, options.sampling) {
        (Solid::HalfSpace { extent, .. }, Sampling::Regular) if points.len() <= FEW_POINTS => {
            let cell_side = 2.0 * extent / (points.len() as f64).sqrt();
            Some(vec![(FEW_POINTS_RADIUS * cell_side) as f32; points.len()])
        }
        _ => None,
    };
    let mut rng = Rng::new(options.seed, DISTURBANCES);
    let needs_spacing = options.position_noise > 0.0 || options.gaps.is_some();
    let spacing = if needs_spacing { (area(solid) / points.len() as f64).sqrt() } else { 0.0 };
    disturb(&mut points, options, spacing, &mut rng);
    let mut cloud = PointCloud {
        positions: points.iter().map(|point| point.0).collect(),
        normals: options.with_normals.then(|| points.iter().map(|point| point.1.as_vec3()).collect()),
        radii,
        ..PointCloud::default()
    };
    if let Some(gaps) = options.gaps {
        let radius = gaps.radius * spacing;
        let centres: Vec<DVec3> = (0..gaps.count).map(|_| points[rng.below(points.len())].0).collect();
        cloud.retain(|i| centres.iter().all(|centre| centre.distance(points[i].0) > radius));
    }
    if cloud.is_empty() { Err(ScanError::NothingSeen) } else { Ok(cloud) }
}

/// The random stream that places points.
const PLACES: u64 = 1;
/// The random stream that moves and turns them.
const DISTURBANCES: u64 = 2;

fn check(options: &ScanOptions) -> Result<(), ScanError> {
    if options.count == 0 {
        return Err(ScanError::NoPoints);
    }
    let not_negative = |field, value: f64| {
        let fits = value >= 0.0 && value.is_finite();
        if fits { Ok(()) } else { Err(ScanError::Range { field, allowed: "0 or more", value }) }
    };
    not_negative("position_noise", options.position_noise)?;
    not_negative("normal_noise_deg", options.normal_noise_deg)?;
    if let Some(gaps) = options.gaps {
        not_negative("gaps.radius", gaps.radius)?;
    }
    if !(0.0..=1.0).contains(&options.flipped) {
        return Err(ScanError::Range { field: "flipped", allowed: "0 to 1", value: options.flipped });
    }
    match options.sampling {
        Sampling::Irregular { least } if !(least > 0.0 && least <= 1.0) => {
            Err(ScanError::Range { field: "least", allowed: "above 0, at most 1", value: least })
        }
        _ => Ok(()),
    }
}

/// The area that is sampled, in squared leaf units.
pub fn area(solid: &Solid) -> f64 {
    solid.patches().iter().map(|patch| patch.area()).sum()
}

/// `count` directions spread evenly over the sphere: heights at equal steps, angles at golden ones.
pub fn fibonacci_directions(count: usize) -> impl Iterator<Item = DVec3> {
    let golden_angle = PI * (3.0 - 5f64.sqrt());
    (0..count).map(move |i| {
        let z = 1.0 - (2 * i + 1) as f64 / count as f64;
        let (sin, cos) = (golden_angle * i as f64).sin_cos();
        let ring = (1.0 - z * z).sqrt();
        DVec3::new(ring * cos, ring * sin, z)
    })
}

/// Even points where the solid allows them by construction.
fn regular(solid: &Solid, count: usize) -> Option<Vec<SurfacePoint>> {
    match solid {
        Solid::Sphere { centre, radius } => {
            Some(fibonacci_directions(count).map(|direction| (*centre + direction * *radius, direction)).collect())
        }
        Solid::HalfSpace { point, normal, extent } => {
            let normal = normal.normalize();
            // The square that is drawn lies in this frame.
            let (u, v) = normal.any_orthonormal_pair();
            Some(grid(*point, u * *extent, v * *extent, normal, side_of_grid(count)).collect())
        }
        Solid::Box { min, max } => {
            let (middle, half) = (0.5 * (min + max), 0.5 * (max - min));
            let side = side_of_grid(count.div_ceil(6));
            let axes = [DVec3::X, DVec3::Y, DVec3::Z];
            let faces = (0..3).flat_map(|k| [(k, -1.0), (k, 1.0)]);
            let face = |(k, sign): (usize, f64)| {
                let (n, u, v) = (axes[k] * sign, axes[(k + 1) % 3], axes[(k + 2) % 3]);
                grid(middle + n * half, u * half, v * half, n, side)
            };
            Some(faces.flat_map(face).collect())
        }
        Solid::Blend { balls, .. } => {
            let middle = balls.iter().map(|ball| ball.centre).sum::<DVec3>() / balls.len() as f64;
            from_middle(solid, middle, count)
        }
        Solid::Cylinder { .. } | Solid::Cone { .. } | Solid::Torus { .. } => None,
    }
}

/// Points a side of the square grid that holds nearest to `count`.
fn side_of_grid(count: usize) -> usize {
    ((count as f64).sqrt().round() as usize).max(1)
}

/// The cell centres of a grid over the rectangle of half-sides `u` and `v` about `middle`.
fn grid(middle: DVec3, u: DVec3, v: DVec3, normal: DVec3, side: usize) -> impl Iterator<Item = SurfacePoint> {
    let along = move |i: usize| (2 * i + 1) as f64 / side as f64 - 1.0;
    (0..side * side).map(move |i| (middle + u * along(i % side) + v * along(i / side), normal))
}

/// Where even directions from `middle` leave the solid; `None` where one does so more than once, or too obliquely.
fn from_middle(solid: &Solid, middle: DVec3, count: usize) -> Option<Vec<SurfacePoint>> {
    // Seen from the middle, spacing is stretched by one over this cosine.
    const LEAST_COSINE: f64 = 0.5;
    let mut hits = Vec::new();
    fibonacci_directions(count)
        .map(|direction| {
            solid.intersect(middle, direction, &mut hits);
            let mut ahead = hits.iter().filter(|hit| hit.t > 0.0);
            let (only, next) = (ahead.next()?, ahead.next());
            (next.is_none() && only.normal.dot(direction) >= LEAST_COSINE)
                .then(|| (middle + direction * only.t, only.normal))
        })
        .collect()
}

/// Points found again by place: which of them lie near a given one.
pub(super) struct Places {
    cell: f64,
    cells: HashMap<IVec3, Vec<DVec3>>,
}

impl Places {
    /// For questions about distances of at most `reach`.
    pub(super) fn new(reach: f64) -> Self {
        Self { cell: reach, cells: HashMap::new() }
    }

    fn cell_of(&self, p: DVec3) -> IVec3 {
        (p / self.cell).floor().as_ivec3()
    }

    /// Adds `p` unless a point lies closer than the reach; whether it did.
    pub(super) fn add_if_free(&mut self, p: DVec3) -> bool {
        let cell = self.cell_of(p);
        let around = (0..27).map(|i| cell + IVec3::new(i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1));
        let taken = around
            .filter_map(|cell| self.cells.get(&cell))
            .flatten()
            .any(|q| q.distance_squared(p) < self.cell * self.cell);
        if !taken {
            self.cells.entry(cell).or_default().push(p);
        }
        !taken
    }
}

fn poisson(solid: &Solid, count: usize, rng: &mut Rng) -> Result<Vec<SurfacePoint>, ScanError> {
    // At 1.24 times the density asked for darts hardly ever find room; up to it a few a point do.
    const DARTS_PER_POINT: usize = 100;
    let mut places = Places::new(POISSON_DISTANCE * (area(solid) / count as f64).sqrt());
    let middle = {
        let (min, max) = solid.drawn_bounds();
        0.5 * (min + max)
    };
    let mut points = Vec::with_capacity(count);
    for _ in 0..count.saturating_mul(DARTS_PER_POINT) {
        let point = solid.sample_random(&mut || rng.uniform());
        // Cells are counted from the solid, which may lie far from the origin.
        if places.add_if_free(point.0 - middle) {
            points.push(point);
            if points.len() == count {
                return Ok(points);
            }
        }
    }
    Err(ScanError::Crowded { placed: points.len(), count })
}

fn irregular(solid: &Solid, count: usize, least: f64, rng: &mut Rng) -> Vec<SurfacePoint> {
    let wave = DVec3::new(5.0, 3.0, 4.0);
    let mut points = Vec::with_capacity(count);
    while points.len() < count {
        let point = solid.sample_random(&mut || rng.uniform());
        let swell = 0.5 + 0.5 * point.0.dot(wave).sin();
        if rng.uniform() < least + (1.0 - least) * swell * swell {
            points.push(point);
        }
    }
    points
}

fn disturb(points: &mut [SurfacePoint], options: &ScanOptions, spacing: f64, rng: &mut Rng) {
    let displacement = options.position_noise * spacing;
    let deviation = options.normal_noise_deg.to_radians();
    for (p, normal) in points {
        // The same numbers are drawn whatever is asked for, so that one kind of noise does not change another.
        let (along, angle, side, flip) = (rng.gaussian(), rng.gaussian(), rng.direction(), rng.uniform());
        *p += *normal * (along * displacement);
        if deviation > 0.0 {
            *normal = tilted(*normal, side, angle * deviation);
        }
        if flip < options.flipped {
            *normal = -*normal;
        }
    }
}

/// `normal` turned by `angle` radians towards the part of `side` that is across it.
pub(super) fn tilted(normal: DVec3, side: DVec3, angle: f64) -> DVec3 {
    let across = (side - normal * side.dot(normal)).normalize_or(normal.any_orthonormal_vector());
    (normal * angle.cos() + across * angle.sin()).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::solid::Ball;

    fn sphere() -> Solid {
        Solid::Sphere { centre: DVec3::new(0.3, -0.2, 0.5), radius: 0.7 }
    }

    fn torus() -> Solid {
        Solid::Torus { centre: DVec3::ZERO, axis: DVec3::Z, radius: 0.8, tube: 0.35 }
    }

    fn solids() -> Vec<Solid> {
        let (from, to) = (DVec3::new(0.0, 0.1, -1.0), DVec3::new(0.2, 0.0, 1.0));
        let ball = |x: f64, radius| Ball { centre: DVec3::X * x, radius };
        vec![
            sphere(),
            torus(),
            Solid::HalfSpace { point: DVec3::ONE, normal: DVec3::new(1.0, 2.0, 2.0), extent: 0.5 },
            Solid::Box { min: DVec3::ZERO, max: DVec3::new(1.0, 2.0, 1.0) },
            Solid::Cylinder { from, to, radius: 0.4 },
            Solid::Cone { from, to, radius_from: 0.6, radius_to: 0.1 },
            Solid::Blend { balls: vec![ball(0.0, 1.0), ball(0.5, 0.8)], smoothness: 0.2 },
            Solid::Blend { balls: vec![ball(0.0, 1.0), ball(1.5, 0.4), ball(2.2, 0.4)], smoothness: 0.2 },
        ]
    }

    #[test]
    fn every_point_lies_on_the_surface_with_its_normal() {
        for solid in solids() {
            for sampling in [Sampling::Regular, Sampling::Poisson, Sampling::IRREGULAR] {
                let cloud = scan(&solid, &ScanOptions::regular(900, 1).sampled(sampling)).unwrap();
                assert!((cloud.len() as f64 / 900.0 - 1.0).abs() < 0.1, "{} of {solid:?}", cloud.len());
                for (p, normal) in cloud.positions.iter().zip(cloud.normals.unwrap()) {
                    // Dart for dart, a blend's points are on its field to rounding, as the others are.
                    assert!(solid.signed_distance_bound(*p).abs() < 1e-9, "{solid:?}");
                    let inside = *p - normal.as_dvec3() * 1e-6; // not past a rim
                    assert!(solid.signed_distance_bound(inside) < 0.0, "{solid:?}");
                }
            }
        }
    }

    fn nearest_distances(cloud: &PointCloud) -> Vec<f64> {
        let distance = |i: usize, j: usize| cloud.positions[i].distance(cloud.positions[j]);
        let others = |i: usize| (0..cloud.len()).filter(move |j| *j != i);
        (0..cloud.len()).map(|i| others(i).map(|j| distance(i, j)).fold(f64::INFINITY, f64::min)).collect()
    }

    #[test]
    fn samplings_are_as_even_as_they_say() {
        let spread = |sampling| {
            let cloud = scan(&sphere(), &ScanOptions::regular(1500, 4).sampled(sampling)).unwrap();
            let spacing = (area(&sphere()) / 1500.0).sqrt();
            let near = nearest_distances(&cloud);
            let least = near.iter().copied().fold(f64::INFINITY, f64::min);
            (least / spacing, near.iter().copied().fold(0.0, f64::max) / spacing)
        };
        let (regular, poisson, irregular) =
            (spread(Sampling::Regular), spread(Sampling::Poisson), spread(Sampling::IRREGULAR));
        assert!(regular.0 > 0.8 && regular.1 < 1.2, "{regular:?}");
        assert!(poisson.0 >= POISSON_DISTANCE && poisson.1 < 1.6, "{poisson:?}");
        assert!(irregular.0 < 0.2 && irregular.1 > 1.6, "{irregular:?}");
    }

    #[test]
    fn irregular_density_follows_its_formula() {
        let plane = Solid::HalfSpace { point: DVec3::ZERO, normal: DVec3::Z, extent: 1.0 };
        let cloud = scan(&plane, &ScanOptions::regular(20_000, 2).sampled(Sampling::IRREGULAR)).unwrap();
        let share = |low: f64, high: f64| {
            let phase = |p: &&DVec3| (low..high).contains(&(5.0 * p.x + 3.0 * p.y).sin());
            cloud.positions.iter().filter(phase).count() as f64
        };
        let mut rng = Rng::new(9, 9);
        let mut even = |low: f64, high: f64| {
            let place = || (5.0 * (2.0 * rng.uniform() - 1.0) + 3.0 * (2.0 * rng.uniform() - 1.0)).sin();
            std::iter::repeat_with(place).take(20_000).filter(|s| (low..high).contains(s)).count() as f64
        };
        let density_high = share(0.9, 1.0) / even(0.9, 1.0);
        let density_low = share(-1.0, -0.9) / even(-1.0, -0.9);
        assert!((8.0..14.0).contains(&(density_high / density_low)), "{}", density_high / density_low);
    }

    #[test]
    fn noise_is_as_large_as_asked_for() {
        let spacing = (area(&torus()) / 4000.0).sqrt();
        let clean = scan(&torus(), &ScanOptions::regular(4000, 6)).unwrap();
        let noisy = scan(&torus(), &ScanOptions::regular(4000, 6).noisy(0.1, 5.0)).unwrap();
        let rms = |values: &mut dyn Iterator<Item = f64>| (values.map(|v| v * v).sum::<f64>() / 4000.0).sqrt();
        let moved = rms(&mut clean.positions.iter().zip(&noisy.positions).map(|(a, b)| a.distance(*b) / spacing));
        assert!((moved - 0.1).abs() < 0.01, "{moved}");
        let (a, b) = (clean.normals.unwrap(), noisy.normals.unwrap());
        let turned = rms(&mut a.iter().zip(&b).map(|(a, b)| f64::from(a.angle_between(*b).to_degrees())));
        assert!((turned - 5.0).abs() < 0.4, "{turned}");
    }

    #[test]
    fn normals_can_be_flipped_or_missing_and_patches_too() {
        let base = ScanOptions::regular(2000, 8);
        let truth = scan(&sphere(), &base).unwrap().normals.unwrap();
        let flipped = scan(&sphere(), &ScanOptions { flipped: 0.25, ..base }).unwrap().normals.unwrap();
        let share = truth.iter().zip(&flipped).filter(|(a, b)| a.dot(**b) < 0.0).count() as f64 / 2000.0;
        assert!((share - 0.25).abs() < 0.03);
        assert!(scan(&sphere(), &base.without_normals()).unwrap().normals.is_none());
        let gaps = Some(Gaps { count: 3, radius: 5.0 });
        let holey = scan(&sphere(), &ScanOptions { gaps, ..base }).unwrap();
        // A disk of five spacings holds 25 π points.
        assert!((2000 - 3 * 90..2000 - 70).contains(&holey.len()), "{}", holey.len());
        assert_eq!(holey.normals.unwrap().len(), holey.positions.len());
    }

    #[test]
    fn a_plane_of_few_points_says_how_far_they_reach() {
        let plane = Solid::HalfSpace { point: DVec3::ZERO, normal: DVec3::Z, extent: 0.8 };
        let one = scan(&plane, &ScanOptions::regular(1, 0)).unwrap();
        assert_eq!((one.positions, one.radii), (vec![DVec3::ZERO], Some(vec![1.2])));
        let four = scan(&plane, &ScanOptions::regular(4, 0)).unwrap();
        assert_eq!(four.radii, Some(vec![0.6; 4]));
        assert_eq!(scan(&plane, &ScanOptions::regular(25, 0)).unwrap().radii, None);
        assert_eq!(scan(&plane, &ScanOptions::regular(25, 0)).unwrap().len(), 25);
    }

    #[test]
    fn a_seed_says_all() {
        let options = ScanOptions::regular(300, 11).sampled(Sampling::Poisson).noisy(0.1, 1.0);
        let first = scan(&torus(), &options).unwrap();
        assert_eq!(first, scan(&torus(), &options).unwrap());
        assert_ne!(first, scan(&torus(), &ScanOptions { seed: 12, ..options }).unwrap());
    }

    #[test]
    fn what_cannot_be_scanned_is_refused() {
        let base = ScanOptions::regular(10, 0);
        let error = |options| scan(&sphere(), &options).unwrap_err();
        assert_eq!(error(ScanOptions { count: 0, ..base }), ScanError::NoPoints);
        let range = |options| matches!(error(options), ScanError::Range { .. });
        assert!(range(base.noisy(f64::NAN, 0.0)) && range(base.noisy(0.0, -1.0)));
        assert!(range(ScanOptions { flipped: 1.5, ..base }));
        assert!(range(base.sampled(Sampling::Irregular { least: 0.0 })));
        assert_eq!(error(ScanOptions { gaps: Some(Gaps { count: 1, radius: 1e6 }), ..base }), ScanError::NothingSeen);
        let bad = Solid::Sphere { centre: DVec3::ZERO, radius: f64::NAN };
        assert!(matches!(scan(&bad, &base), Err(ScanError::Solid(_))));
    }
}
