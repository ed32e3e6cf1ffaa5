//! A solid as a closed mesh of triangles that leaves it by no more than a given length.
//!
//! *Theory.* A chord of an arc of radius R over the angle 2φ is R(1 − cos φ) inside of it, its *sagitta*. Solids of revolution
//! are a profile turned about an axis: both the profile and the circles are cut into chords, each allowed half of the error.
//! A blend has no such form: its surface is found in tetrahedra (Doi and Koide 1991), the six into which a cube is cut along
//! its diagonal, which fit together from cube to cube.
//!
//! *Changes from the paper.* The grid is not walked cell by cell: since a blend's function is 1-Lipschitz, a cube whose
//! middle is farther from 0 than its half diagonal holds no surface, and its eight parts are not looked at. Vertices lie on the
//! surface itself, not where the function's values at the ends of an edge interpolate to 0.
//!
//! *Practice.* Vertices are on the solid, so the mesh is inside of it where it is convex.

use std::collections::HashMap;
use std::f64::consts::{PI, TAU};

use glam::{DVec2, DVec3, IVec3};

use super::{BlendField, Solid};
use crate::geometry::TriMesh;

/// Why a solid has no mesh.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum TessellateError {
    /// A half-space has no end.
    #[error("a half-space has no end, so no mesh is its surface")]
    Endless,
    /// The error is not a positive length.
    #[error("the largest error must be a positive length, not {0}")]
    Error(f64),
    /// More triangles than are worth having.
    #[error(
        "with an error of {error} the mesh would have about {triangles:.0} triangles, more than {MOST_TRIANGLES}: allow more"
    )]
    TooMany {
        /// What was asked for, leaf units.
        error: f64,
        /// An estimate.
        triangles: f64,
    },
}

/// As many as fit in a few gigabytes.
const MOST_TRIANGLES: u32 = 50_000_000;

/// The fewest chords of a circle: fewer show no circle, however large the error.
const LEAST_AROUND: f64 = 12.0;

impl Solid {
    /// A closed mesh, corners anticlockwise from outside, whose surface and the solid's are within `error` of each other; leaf
    /// space and units.
    ///
    /// # Errors
    /// [`TessellateError`].
    pub fn tessellate(&self, error: f64) -> Result<TriMesh, TessellateError> {
        if !(error > 0.0 && error.is_finite()) {
            return Err(TessellateError::Error(error));
        }
        match self {
            Self::HalfSpace { .. } => Err(TessellateError::Endless),
            Self::Box { min, max } => Ok(cuboid(*min, *max)),
            Self::Sphere { centre, radius } => {
                let steps = (0.5 * chords(*radius, 0.5 * error)).ceil();
                let point = |i: f64| radius * DVec2::from_angle(PI * (i / steps - 0.5));
                let profile = (0..=steps as usize).map(|i| {
                    if i == 0 || i == steps as usize {
                        DVec2::new(0.0, if i == 0 { -radius } else { *radius })
                    } else {
                        point(i as f64)
                    }
                });
                let around = around(*radius, 0.5 * error, steps, error)?;
                Ok(turned(*centre, DVec3::Z, &profile.collect::<Vec<_>>(), around, false))
            }
            Self::Cylinder { from, to, radius } => frustum(*from, *to, [*radius; 2], error),
            Self::Cone { from, to, radius_from, radius_to } => frustum(*from, *to, [*radius_from, *radius_to], error),
            Self::Torus { centre, axis, radius, tube } => {
                let steps = chords(*tube, 0.5 * error);
                let point = |i: usize| DVec2::new(*radius, 0.0) + *tube * DVec2::from_angle(TAU * i as f64 / steps);
                let profile: Vec<DVec2> = (0..steps as usize).map(point).collect();
                let around = around(radius + tube, 0.5 * error, steps, error)?;
                Ok(turned(*centre, axis.normalize_or(DVec3::Z), &profile, around, true))
            }
            Self::Blend { balls, smoothness } => {
                let least = balls.iter().map(|ball| ball.radius).fold(f64::INFINITY, f64::min).min(*smoothness);
                // An edge of a tetrahedron is at most √3 cells long: its sagitta over a radius R is 3 cell² / 8R.
                let cell = (8.0 * least * error / 3.0).sqrt().min(least);
                Marching::new(BlendField::new(balls, *smoothness), cell, error)?.run()
            }
        }
    }
}

/// The chords of a circle of `radius` whose sagitta is `error` at most.
fn chords(radius: f64, error: f64) -> f64 {
    let half_angle = (1.0 - error / radius).max(0.0).acos();
    (PI / half_angle).ceil().max(LEAST_AROUND)
}

/// The chords around a solid whose profile has `along`.
fn around(radius: f64, share: f64, along: f64, error: f64) -> Result<usize, TessellateError> {
    let around = chords(radius, share);
    let triangles = 2.0 * around * along;
    // Written so that NaN fails.
    if !(triangles <= f64::from(MOST_TRIANGLES)) {
        return Err(TessellateError::TooMany { error, triangles });
    }
    Ok(around as usize)
}

fn frustum(from: DVec3, to: DVec3, radii: [f64; 2], error: f64) -> Result<TriMesh, TessellateError> {
    let (axis, height) = ((to - from).normalize_or(DVec3::Z), (to - from).length());
    let corners = [(0.0, 0.0), (radii[0], 0.0), (radii[1], height), (0.0, height)];
    let mut profile: Vec<DVec2> = corners.into_iter().map(DVec2::from).collect();
    profile.dedup(); // where a radius is 0
    let around = around(radii[0].max(radii[1]), error, 3.0, error)?;
    Ok(turned(from, axis, &profile, around, false))
}

fn cuboid(min: DVec3, max: DVec3) -> TriMesh {
    let corner = |i: usize| {
        DVec3::from_array(std::array::from_fn(|axis| if i >> axis & 1 == 0 { min[axis] } else { max[axis] }))
    };
    let faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    TriMesh {
        positions: (0..8).map(corner).collect(),
        triangles: faces.into_iter().flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]]).collect(),
        colours: None,
    }
}

/// A profile, points (away from the axis, along it) with the inside to its left, turned about the `axis` through `foot`.
/// A closed one goes on from its last point to the first.
fn turned(foot: DVec3, axis: DVec3, profile: &[DVec2], around: usize, is_closed: bool) -> TriMesh {
    let (u, v) = axis.any_orthonormal_pair();
    // (u, v, axis) must be right-handed for corners to run anticlockwise.
    let v = if u.cross(v).dot(axis) < 0.0 { -v } else { v };
    let mut mesh = TriMesh::default();
    // Each point's vertices: one on the axis, a ring elsewhere.
    let rings: Vec<(u32, bool)> = profile
        .iter()
        .map(|p| {
            let first = mesh.positions.len() as u32;
            if p.x == 0.0 {
                mesh.positions.push(foot + axis * p.y);
                return (first, false);
            }
            mesh.positions.extend((0..around).map(|i| {
                let away = DVec2::from_angle(TAU * i as f64 / around as f64) * p.x;
                foot + u * away.x + v * away.y + axis * p.y
            }));
            (first, true)
        })
        .collect();
    let pairs = rings.len() - usize::from(!is_closed);
    for pair in 0..pairs {
        let (lower, upper) = (rings[pair], rings[(pair + 1) % rings.len()]);
        let vertex =
            |(first, is_ring): (u32, bool), i: usize| if is_ring { first + (i % around) as u32 } else { first };
        for i in 0..around {
            let [a, b, c, d] = [vertex(lower, i), vertex(lower, i + 1), vertex(upper, i + 1), vertex(upper, i)];
            mesh.triangles.extend([[a, b, c], [a, c, d]].into_iter().filter(|[a, b, c]| a != b && b != c && c != a));
        }
    }
    mesh
}

/// The surface of a blend in the tetrahedra of a grid.
struct Marching<'a> {
    field: BlendField<'a>,
    origin: DVec3,
    cell: f64,
    error: f64,
    /// log2 of the cells along a side of the cube that holds everything.
    levels: u32,
    values: HashMap<IVec3, f64>,
    /// By the ends of an edge of the grid.
    vertices: HashMap<(IVec3, IVec3), u32>,
    mesh: TriMesh,
}

/// The corners of a cube, in the order of their bits x, y, z.
fn cube_corner(i: usize) -> IVec3 {
    IVec3::new((i & 1) as i32, (i >> 1 & 1) as i32, (i >> 2 & 1) as i32)
}

/// The tetrahedra of a cube: a path from its first corner to its last along the axes, one for each order of these.
const TETRAHEDRA: [[usize; 4]; 6] =
    [[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]];

impl<'a> Marching<'a> {
    fn new(field: BlendField<'a>, cell: f64, error: f64) -> Result<Self, TessellateError> {
        let (low, high) = field.bounds();
        let side = (high - low).max_element() + 2.0 * cell;
        // A surface of about the box's area, some twelve triangles a cell.
        let size = (high - low) / cell;
        let triangles = 24.0 * (size.x * size.y + size.y * size.z + size.z * size.x);
        if !(triangles <= f64::from(MOST_TRIANGLES)) {
            return Err(TessellateError::TooMany { error, triangles });
        }
        Ok(Self {
            field,
            origin: low - cell,
            cell,
            error,
            levels: (side / cell).log2().ceil().max(0.0) as u32,
            values: HashMap::new(),
            vertices: HashMap::new(),
            mesh: TriMesh::default(),
        })
    }

    fn run(mut self) -> Result<TriMesh, TessellateError> {
        self.cube(IVec3::ZERO, self.levels);
        Ok(self.mesh)
    }

    fn at(&self, p: IVec3) -> DVec3 {
        self.origin + p.as_dvec3() * self.cell
    }

    fn cube(&mut self, corner: IVec3, level: u32) {
        let side = f64::from(1_u32 << level) * self.cell;
        let half_diagonal = 0.5 * side * 3f64.sqrt();
        if self.field.value(self.at(corner) + 0.5 * side).abs() > half_diagonal {
            return;
        }
        if level > 0 {
            let half = 1 << (level - 1);
            (0..8).for_each(|i| self.cube(corner + cube_corner(i) * half, level - 1));
            return;
        }
        let corners: [IVec3; 8] = std::array::from_fn(|i| corner + cube_corner(i));
        let values = corners.map(|p| {
            let at = self.at(p);
            let field = &self.field;
            *self.values.entry(p).or_insert_with(|| field.value(at))
        });
        for tetrahedron in TETRAHEDRA {
            self.tetrahedron(tetrahedron.map(|i| (corners[i], values[i])));
        }
    }

    /// The triangles of one tetrahedron, whose corners are right-handed.
    fn tetrahedron(&mut self, corners: [(IVec3, f64); 4]) {
        let inside: Vec<usize> = (0..4).filter(|&i| corners[i].1 < 0.0).collect();
        let outside: Vec<usize> = (0..4).filter(|&i| !(corners[i].1 < 0.0)).collect();
        let mut cut = |i: usize, o: usize| self.vertex(corners[i], corners[o]);
        let triangles = match (&inside[..], &outside[..]) {
            (&[i], &[a, b, c]) | (&[a, b, c], &[i]) => vec![[cut(i, a), cut(i, b), cut(i, c)]],
            (&[i, j], &[a, b]) => {
                let [p, q, r, s] = [cut(i, a), cut(i, b), cut(j, b), cut(j, a)];
                vec![[p, q, r], [p, r, s]]
            }
            _ => return,
        };
        // Outward is from the corners inside to those outside.
        let middle = |of: &[usize]| of.iter().map(|&i| corners[i].0.as_dvec3()).sum::<DVec3>() / of.len() as f64;
        let outward = middle(&outside) - middle(&inside);
        for triangle in triangles {
            let [a, b, c] = triangle;
            if a == b || b == c || c == a {
                continue;
            }
            let [p, q, r] = triangle.map(|v| self.mesh.positions[v as usize]);
            let is_outward = (q - p).cross(r - p).dot(outward) > 0.0;
            self.mesh.triangles.push(if is_outward { triangle } else { [a, c, b] });
        }
    }

    /// The vertex where the surface crosses an edge.
    fn vertex(&mut self, a: (IVec3, f64), b: (IVec3, f64)) -> u32 {
        // One order for both directions, so that all tetrahedra around the edge have the same point.
        let (from, to) = if a.0.to_array() < b.0.to_array() { (a, b) } else { (b, a) };
        if let Some(&known) = self.vertices.get(&(from.0, to.0)) {
            return known;
        }
        let (p, q) = (self.at(from.0), self.at(to.0));
        // Bisection, to far below the error: the function may be far from linear on the edge.
        let least = self.error / 1024.0 / (q - p).length();
        let (mut low, mut high) = (0.0, 1.0);
        while high - low > least {
            let middle = 0.5 * (low + high);
            if middle <= low || middle >= high {
                break;
            }
            if (self.field.value(p.lerp(q, middle)) < 0.0) == (from.1 < 0.0) { low = middle } else { high = middle }
        }
        let number = self.mesh.positions.len() as u32;
        self.mesh.positions.push(p.lerp(q, 0.5 * (low + high)));
        self.vertices.insert((from.0, to.0), number);
        number
    }
}

#[cfg(test)]
mod tests {
    use super::super::Ball;
    use super::*;

    fn solids() -> Vec<Solid> {
        let (from, to) = (DVec3::new(0.3, -0.2, 0.1), DVec3::new(-0.4, 0.9, 1.5));
        let ball = |x: f64, radius: f64| Ball { centre: DVec3::new(x, 0.2, -0.1), radius };
        vec![
            Solid::Box { min: DVec3::new(-1.0, 0.0, 2.0), max: DVec3::new(0.5, 0.7, 2.2) },
            Solid::Sphere { centre: from, radius: 1.3 },
            Solid::Cylinder { from, to, radius: 0.6 },
            Solid::Cone { from, to, radius_from: 0.7, radius_to: 0.0 },
            Solid::Cone { from, to, radius_from: 0.0, radius_to: 0.7 },
            Solid::Cone { from, to, radius_from: 0.2, radius_to: 0.7 },
            Solid::Torus { centre: from, axis: to, radius: 1.0, tube: 0.3 },
            Solid::Blend { balls: vec![ball(0.0, 0.8), ball(1.1, 0.5)], smoothness: 0.2 },
        ]
    }

    /// Every edge is used once each way, the volume is positive, and no point of a triangle is further than the error from the
    /// solid: its distance bound is exact enough at that scale.
    #[test]
    fn meshes_are_closed_outward_and_within_the_error() {
        for solid in solids() {
            for error in [0.05, 0.002] {
                let mesh = solid.tessellate(error).unwrap();
                let mut edges: HashMap<(u32, u32), i32> = HashMap::new();
                for &[a, b, c] in &mesh.triangles {
                    for (from, to) in [(a, b), (b, c), (c, a)] {
                        *edges.entry((from.min(to), from.max(to))).or_default() += if from < to { 1 } else { -1 };
                    }
                }
                assert!(edges.values().all(|&sides| sides == 0), "{solid:?} at {error} is open");
                assert!(mesh.signed_volume() > 0.0, "{solid:?} at {error} is inside-out");
                for t in 0..mesh.triangles.len() {
                    let [a, b, c] = mesh.corners(t);
                    for p in [a, b, c, 0.5 * (a + b), 0.5 * (b + c), (a + b + c) / 3.0] {
                        let distance = solid.signed_distance_bound(p).abs();
                        assert!(distance <= error * 1.001, "{solid:?} at {error}: {distance}");
                    }
                }
            }
        }
    }

    #[test]
    fn what_has_no_mesh_says_so() {
        let half = Solid::HalfSpace { point: DVec3::ZERO, normal: DVec3::Z, extent: 1.0 };
        assert_eq!(half.tessellate(0.1), Err(TessellateError::Endless));
        let ball = Solid::Sphere { centre: DVec3::ZERO, radius: 1.0 };
        assert!(matches!(ball.tessellate(1e-13), Err(TessellateError::TooMany { .. })));
        assert!(matches!(ball.tessellate(f64::NAN), Err(TessellateError::Error(_))));
    }
}
