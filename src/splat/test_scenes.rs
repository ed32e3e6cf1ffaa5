//! Scenes with known answers, for tests: surfels of spheres and planes, and rays cast at the shapes themselves.
//!
//! The truth here shares nothing with the code under test but the expression.

use glam::{DMat3, DVec3, Mat3, Vec3};
use rayon::prelude::*;

use crate::classify::{LeafField, LeafLook, Model};
use crate::csg::expression::parse;
use crate::csg::{LeafId, Tree};
use crate::geometry::neighbours::Neighbours;
use crate::layers::{Facing, LayerStack};
use crate::scene::LeafKind;
use crate::space::{Camera, Lens, Ray};
use crate::surfel::{CHUNK, Chunk, Surfel, SurfelCloud, Sym3};

/// The turn from one point of a Fibonacci lattice to the next.
const GOLDEN_ANGLE: f64 = std::f64::consts::PI * 0.763_932_022_500_210_3;

/// A shape whose crossings with a ray are known.
#[derive(Debug, Clone, Copy)]
pub enum Shape {
    /// Centre, radius.
    Sphere(DVec3, f64),
    /// A point of the border, outward unit normal.
    HalfSpace(DVec3, DVec3),
}

impl Shape {
    pub fn contains(&self, p: DVec3) -> bool {
        match *self {
            Self::Sphere(centre, radius) => p.distance(centre) < radius,
            Self::HalfSpace(point, normal) => (p - point).dot(normal) < 0.0,
        }
    }

    fn crossings(&self, ray: &Ray) -> Vec<f64> {
        match *self {
            Self::Sphere(centre, radius) => {
                let to = ray.origin - centre;
                let (a, b, c) = (ray.dir.length_squared(), to.dot(ray.dir), to.length_squared() - radius * radius);
                let square = b * b - a * c;
                if square <= 0.0 { vec![] } else { vec![(-b - square.sqrt()) / a, (-b + square.sqrt()) / a] }
            }
            Self::HalfSpace(point, normal) => vec![(point - ray.origin).dot(normal) / ray.dir.dot(normal)],
        }
    }

    /// As [`Self::surfels`] of a sphere, its lattice turned.
    pub fn turned_surfels(&self, n: usize, turn: DMat3) -> SurfelCloud {
        cloud(&self.points(n, 1.0, turn), COVER)
    }

    /// `n` surfels of a sphere, or `n` = m² of a half-space's square of side `side` about its point, with radii of `cover`
    /// times the distance to the sixth neighbour.
    pub fn surfels(&self, n: usize, side: f64, cover: f32) -> SurfelCloud {
        cloud(&self.points(n, side, DMat3::IDENTITY), cover)
    }

    fn points(&self, n: usize, side: f64, turn: DMat3) -> Vec<(DVec3, Vec3, Sym3)> {
        match *self {
            Self::Sphere(centre, radius) => (0..n)
                .map(|i| {
                    let z = 1.0 - (2.0 * i as f64 + 1.0) / n as f64;
                    let (s, c) = (GOLDEN_ANGLE * i as f64).sin_cos();
                    let normal = turn * DVec3::new(c * (1.0 - z * z).sqrt(), s * (1.0 - z * z).sqrt(), z);
                    let curvature = Sym3::from_mat3(Mat3::IDENTITY * (1.0 / radius) as f32);
                    (centre + normal * radius, normal.as_vec3(), curvature)
                })
                .collect(),
            Self::HalfSpace(point, normal) => {
                let (u, v) = normal.any_orthonormal_pair();
                let across = (n as f64).sqrt().round() as usize;
                let place = |i: usize| ((i as f64 + 0.5) / across as f64 - 0.5) * side;
                (0..across * across)
                    .map(|i| (point + u * place(i % across) + v * place(i / across), normal.as_vec3(), Sym3::default()))
                    .collect()
            }
        }
    }
}

/// A Morton code of 10 bits an axis.
fn morton(p: DVec3, low: DVec3, size: f64) -> u32 {
    let spread = |v: f64| {
        let mut x = ((v / size * 1023.0) as u32).min(1023);
        x = (x | x << 16) & 0x0300_00FF;
        x = (x | x << 8) & 0x0300_F00F;
        x = (x | x << 4) & 0x030C_30C3;
        (x | x << 2) & 0x0924_9249
    };
    spread(p.x - low.x) | spread(p.y - low.y) << 1 | spread(p.z - low.z) << 2
}

/// A cloud of points with normals and curvatures; radii are `cover` times the distance to the sixth neighbour.
pub fn cloud(points: &[(DVec3, Vec3, Sym3)], cover: f32) -> SurfelCloud {
    let (low, high) = points.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(a, b), p| (a.min(p.0), b.max(p.0)));
    let size = (high - low).max_element().max(1e-9);
    let mut points = points.to_vec();
    points.sort_by_key(|p| morton(p.0, low, size));
    let search = Neighbours::new(low, points.iter().map(|p| (p.0 - low).as_vec3()));
    let mut found = Vec::new();
    let mut result = SurfelCloud { spacing: 0.0, ..SurfelCloud::default() };
    for of_chunk in points.chunks(CHUNK) {
        let origin = of_chunk.iter().map(|p| p.0).sum::<DVec3>() / of_chunk.len() as f64;
        let mut chunk = Chunk { origin, centre: Vec3::ZERO, extent: 0.0, largest_radius: 0.0 };
        for &(p, normal, curvature) in of_chunk {
            search.nearest_k((p - low).as_vec3(), 7, &mut found);
            // A point alone in the world stands for all of its surface.
            let radius = if found.len() > 1 { cover * found[found.len() - 1].1 } else { cover };
            let offset = (p - origin).as_vec3();
            chunk.extent = chunk.extent.max(offset.length());
            chunk.largest_radius = chunk.largest_radius.max(radius);
            result.surfels.push(Surfel { offset, radius, normal, colour: [255; 4], curvature });
        }
        result.chunks.push(chunk);
    }
    result.confidence = vec![255; points.len()];
    result
}

/// An expression over the leaves a, b, c …
pub fn tree(text: &str) -> Tree {
    parse(text, &mut |name| Some(LeafId(u32::from(name.as_bytes()[0] - b'a')))).unwrap()
}

/// A plain colour for each leaf, opaque.
pub fn looks(count: usize) -> Vec<LeafLook> {
    let colours =
        [[0.9, 0.2, 0.2], [0.2, 0.9, 0.2], [0.2, 0.2, 0.9], [0.9, 0.9, 0.2], [0.2, 0.9, 0.9], [0.9, 0.2, 0.9]];
    (0..count).map(|i| LeafLook { colour: Some(colours[i % colours.len()]), opacity: 1.0 }).collect()
}

/// The usual radii.
pub const COVER: f32 = 1.3;

/// A model of solid leaves, each a shape with its number of surfels; half-spaces as squares of side 4.
pub fn model(text: &str, leaves: &[(Shape, usize)]) -> Model {
    let fields =
        leaves.iter().map(|(shape, n)| LeafField::new(shape.surfels(*n, 4.0, COVER), None, LeafKind::Solid)).collect();
    Model::new(&tree(text), fields, looks(leaves.len()))
}

/// A perspective camera.
pub fn camera(eye: DVec3, target: DVec3, fov_y: f64, size: u32) -> Camera {
    let up = if (target - eye).normalize().z.abs() > 0.9 { DVec3::Y } else { DVec3::Z };
    Camera::look_at(eye, target, up, Lens::FovY(fov_y), size, size).unwrap()
}

/// A boundary of the truth: leaf, facing, depth.
pub type Truth = (u32, Facing, f64);

/// All boundaries of `tree` over `shapes` on a ray, front to back.
pub fn cast(tree: &Tree, shapes: &[Shape], ray: &Ray) -> Vec<Truth> {
    let mut crossings: Vec<(f64, u32)> = shapes
        .iter()
        .enumerate()
        .flat_map(|(leaf, shape)| shape.crossings(ray).into_iter().map(move |t| (t, leaf as u32)))
        .filter(|c| c.0 > 0.0)
        .collect();
    crossings.sort_by(|a, b| a.0.total_cmp(&b.0));
    let inside_at = |p: DVec3| tree.eval(|leaf| shapes[leaf.0 as usize].contains(p));
    let mut boundaries = Vec::new();
    for (i, &(t, leaf)) in crossings.iter().enumerate() {
        let before = if i == 0 { 0.5 * t } else { 0.5 * (crossings[i - 1].0 + t) };
        let after = crossings.get(i + 1).map_or(t + 1.0, |next| 0.5 * (t + next.0));
        match (inside_at(ray.at(before)), inside_at(ray.at(after))) {
            (false, true) => boundaries.push((leaf, Facing::Front, t)),
            (true, false) => boundaries.push((leaf, Facing::Back, t)),
            _ => {}
        }
    }
    boundaries
}

/// The truth of every pixel's centre, row by row.
pub fn cast_all(tree: &Tree, shapes: &[Shape], camera: &Camera) -> Vec<Vec<Truth>> {
    (0..camera.width * camera.height)
        .into_par_iter()
        .map(|i| {
            let px = glam::DVec2::new(f64::from(i % camera.width) + 0.5, f64::from(i / camera.width) + 0.5);
            cast(tree, shapes, &camera.ray(px))
        })
        .collect()
}

/// What a picture got wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Wrong {
    /// Pixels judged, and of those the ones that the truth covers.
    pub judged: usize,
    pub covered: usize,
    /// Another leaf than the truth's.
    pub leaf: usize,
    /// Nothing where the truth has a surface.
    pub holes: usize,
    /// Something where it has none.
    pub spill: usize,
}

impl Wrong {
    pub fn all(&self) -> usize {
        self.leaf + self.holes + self.spill
    }
}

/// Compares nearest boundaries, away from where the truth's leaf changes within `apart` pixels.
pub fn compare(truth: &[Vec<Truth>], stack: &LayerStack, apart: i64) -> Wrong {
    let (width, height) = (i64::from(stack.camera.width), i64::from(stack.camera.height));
    let leaf = |x: i64, y: i64| truth[(y * width + x) as usize].first().map(|b| b.0);
    let mut wrong = Wrong::default();
    for y in apart..height - apart {
        for x in apart..width - apart {
            let here = leaf(x, y);
            if !(-apart..=apart).all(|dy| (-apart..=apart).all(|dx| leaf(x + dx, y + dy) == here)) {
                continue;
            }
            let seen = stack.at(x as u32, y as u32).first().map(|b| b.leaf);
            wrong.judged += 1;
            wrong.covered += usize::from(here.is_some());
            match (here, seen) {
                (Some(_), None) => wrong.holes += 1,
                (None, Some(_)) => wrong.spill += 1,
                (a, b) => wrong.leaf += usize::from(a != b),
            }
        }
    }
    wrong
}
