//! Shapes with known normals and curvature, and a test for holes, for this module's tests.

use glam::{DVec3, Vec3};

use super::SurfelCloud;
use crate::geometry::neighbours::Neighbours;

/// A small generator (xorshift64*, Vigna 2016).
pub(crate) struct Random(u64);

impl Random {
    pub(crate) fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1)
    }

    /// 0 to 1.
    pub(crate) fn unit(&mut self) -> f64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Standard normal.
    pub(crate) fn normal(&mut self) -> f64 {
        (-2.0 * self.unit().max(1e-300).ln()).sqrt() * (std::f64::consts::TAU * self.unit()).cos()
    }

    /// Unit vector.
    pub(crate) fn direction(&mut self) -> DVec3 {
        loop {
            let v = DVec3::new(self.normal(), self.normal(), self.normal());
            if let Some(v) = v.try_normalize() {
                return v;
            }
        }
    }
}

/// The point of a torus about the z axis that is nearest to `p`, and its normal.
pub(crate) fn torus_point(centre_line: f64, tube: f64, p: DVec3) -> (DVec3, DVec3) {
    let ring = DVec3::new(p.x, p.y, 0.0).normalize() * centre_line;
    let n = (p - ring).normalize();
    (ring + n * tube, n)
}

/// Points spread at random, evenly by area, and their normals.
pub(crate) fn torus_points(centre_line: f64, tube: f64, count: usize, random: &mut Random) -> Vec<(DVec3, DVec3)> {
    let mut points = Vec::new();
    while points.len() < count {
        let (a, b) = (random.unit() * std::f64::consts::TAU, random.unit() * std::f64::consts::TAU);
        // The area element is proportional to the distance from the axis.
        if random.unit() * (centre_line + tube) > centre_line + tube * b.cos() {
            continue;
        }
        let ring = DVec3::new(a.cos(), a.sin(), 0.0);
        let n = ring * b.cos() + DVec3::Z * b.sin();
        points.push((ring * centre_line + n * tube, n));
    }
    points
}

/// Even points of a unit sphere (Fibonacci spiral); they are their own normals.
pub(crate) fn sphere_points(count: usize) -> Vec<(DVec3, DVec3)> {
    let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    (0..count)
        .map(|i| {
            let z = 1.0 - (2.0 * i as f64 + 1.0) / count as f64;
            let r = (1.0 - z * z).sqrt();
            let (s, c) = (golden * i as f64).sin_cos();
            let p = DVec3::new(r * c, r * s, z);
            (p, p)
        })
        .collect()
}

/// Thins `points` to a blue-noise sampling: none is nearer than `distance` to one before it.
pub(crate) fn thin(points: &[(DVec3, DVec3)], distance: f64) -> Vec<(DVec3, DVec3)> {
    let mut kept: Vec<(DVec3, DVec3)> = Vec::new();
    let mut cells: std::collections::HashMap<[i64; 3], Vec<usize>> = Default::default();
    let cell = |p: DVec3| (p / distance).floor().to_array().map(|x| x as i64);
    for &(p, n) in points {
        let [x, y, z] = cell(p);
        let around = (0..27).map(|i| [x + i % 3 - 1, y + i / 3 % 3 - 1, z + i / 9 - 1]);
        let mut near = around.filter_map(|c| cells.get(&c)).flatten();
        if near.all(|&j| kept[j].0.distance(p) >= distance) {
            cells.entry([x, y, z]).or_default().push(kept.len());
            kept.push((p, n));
        }
    }
    kept
}

/// How many of the true surface's points (with normals) are on no disk: a line along the normal must meet a disk that faces
/// the same way, at most its radius from the point.
pub(crate) fn holes(cloud: &SurfelCloud, truth: &[(DVec3, DVec3)]) -> usize {
    let origin = cloud.chunks[0].origin;
    let neighbours = Neighbours::new(origin, (0..cloud.len()).map(|i| (cloud.centre(i) - origin).as_vec3()));
    let largest = cloud.chunks.iter().map(|c| c.largest_radius).fold(0.0, f32::max);
    let mut found = Vec::new();
    let mut holes = 0;
    for (p, n) in truth {
        let (q, n) = ((*p - origin).as_vec3(), n.as_vec3());
        neighbours.within(q, 1.5 * largest, &mut found);
        let covered = found.iter().any(|(j, _)| {
            let surfel = &cloud.surfels[*j as usize];
            let e = q - (cloud.centre(*j as usize) - origin).as_vec3();
            let cosine = n.dot(surfel.normal);
            let t = -e.dot(surfel.normal) / cosine;
            cosine > 0.3 && t.abs() <= surfel.radius && (e + n * t).length() <= surfel.radius
        });
        holes += usize::from(!covered);
    }
    holes
}

/// Bits of everything in the cloud, for comparing runs.
pub(crate) fn bits(cloud: &SurfelCloud) -> Vec<u32> {
    let f = |v: Vec3| v.to_array().map(f32::to_bits);
    let mut out = Vec::new();
    for s in &cloud.surfels {
        out.extend(f(s.offset));
        out.extend(f(s.normal));
        out.push(s.radius.to_bits());
        out.extend(s.curvature.0.map(f32::to_bits));
        out.push(u32::from_le_bytes(s.colour));
    }
    for c in &cloud.chunks {
        out.extend(c.origin.to_array().map(|x| x.to_bits() as u32));
        out.extend(f(c.centre));
        out.push(c.extent.to_bits());
    }
    out.extend(cloud.confidence.iter().map(|c| u32::from(*c)));
    out
}
