//! Surfels from a point cloud: the points stay as they are; what is missing about them is estimated.
//!
//! *Practice.* Points go to world space, get Z-curve order (so that neighbours are near in memory) and lose their duplicates
//! (`place.rs`). Where normals are missing, one pass over all points' neighbours fits them (`normals.rs`) and keeps
//! a neighbour graph for their signs (`orient.rs`). A second pass, the only one where the file has normals, finds radius
//! (`radius.rs`) and curvature (`curvature.rs`) among the neighbours on the same sheet. Results do not depend on the
//! number of threads. Peak memory is about 150 bytes a point, normals or not: each stage drops what the next does not read.

use glam::{DAffine3, DMat3, Vec3};
use rayon::prelude::*;

use super::around::{Scratch, Sheets, median_spacing};
use super::assemble::{Body, assemble};
use super::isolated;
use super::orient::{self, DEGREE, orient};
use super::place::{Given, Known, Placed, ellipse, even_scale};
use super::radius::RING;
use super::{CHUNK, SurfelCloud, SurfelError, Sym3, normals};
use crate::geometry::PointCloud;
use crate::geometry::neighbours::Neighbours;

/// Given normals count as inward where they bound a volume below minus this share of a ball of the cloud's extent.
const INWARD: f64 = 0.02;

/// The most points of one cloud: the neighbour graph's edges are counted in 32 bits.
pub const MOST_POINTS: usize = u32::MAX as usize / DEGREE - 1;

/// What to make of a cloud.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct CloudOptions {
    /// Estimate all normals, even those that the file gives.
    pub ignore_normals: bool,
}

/// What was done to a cloud that its owner may want to know.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct CloudNotes {
    /// Points dropped because another lies at the same place (to the precision of `f32` about the cloud's median).
    pub duplicates: usize,
    /// Normals whose direction or sign was estimated: absent, of zero length, not finite, or ignored on request.
    pub estimated_normals: usize,
    /// Pieces that the neighbour graph fell into; 0 where no normal was estimated.
    pub components: usize,
    /// Closed pieces inside others, which were turned inward; 0 where no normal was estimated.
    pub cavities: usize,
    /// Radii or ellipses of the file that have no positive size, and were estimated instead.
    pub bad_radii: usize,
    /// Points that hang in the air, off the surface about them: their radii were made as small as those about them.
    pub isolated: usize,
    /// Whether the file's normals bound a negative volume: they seem to point inward. They were kept.
    pub inward: bool,
}

/// Surfels from `cloud` (leaf space), in world space. The cloud is taken by value so that it can be freed on the way.
///
/// Radii and ellipses of the file win over the rule of `radius.rs`; normals of the file win unless `options` say
/// otherwise, and are never turned over. A cloud of fewer than seven distinct points without radii gives each point half of
/// the cloud's extent.
///
/// `progress` is called from several threads with the number of points that are newly done; the calls add up to the number of
/// points in `cloud`.
///
/// # Errors
/// [`SurfelError`] where there is no point or too many, one is not finite in world space, the transform is not invertible, or
/// all points lie at one place and have no radius.
pub fn from_cloud(
    cloud: PointCloud,
    world_from_leaf: DAffine3,
    options: &CloudOptions,
    progress: &(dyn Fn(u64) + Sync),
) -> Result<(SurfelCloud, CloudNotes), SurfelError> {
    let Placed { origin, points, positions, mut normals, known, colours, coloured, given, duplicates } =
        Placed::new(cloud, world_from_leaf, options.ignore_normals)?;
    let mut notes = CloudNotes { duplicates, ..CloudNotes::default() };
    let neighbours = Neighbours::new(origin, points.iter().copied());
    let mut certainty = None;
    if let Some(known) = &known {
        notes.estimated_normals = known.par_iter().filter(|k| **k != Known::All).count();
        // The two passes share a point's progress; both go by chunks, so that halves add up.
        let first_half = |count: usize| progress((count / 2) as u64);
        let (graph, certainties) = estimate(&neighbours, &points, known, &mut normals, &first_half);
        certainty = Some(certainties);
        let kept: Option<Vec<bool>> =
            (notes.estimated_normals < points.len()).then(|| known.par_iter().map(|k| *k == Known::All).collect());
        let orientation = orient(&neighbours, &points, &graph, kept.as_deref(), &mut normals);
        notes.components = orientation.components;
        notes.cavities = orientation.cavities;
    }

    let supports = Supports::new(given, &normals, world_from_leaf.matrix3);
    notes.bad_radii = supports.bad();
    let half_extent = 0.5 * extent(&points);
    if !(half_extent > 0.0) && !(supports.radius(0) > 0.0) {
        return Err(SurfelError::OnePlace { points: points.len() + duplicates });
    }
    let few = points.len() <= RING;
    let sheets = Sheets { neighbours: &neighbours, points: &points, normals: &normals, patches: None };
    let body = |i: usize, scratch: &mut Scratch| {
        let around = scratch.look(&sheets, i);
        let own = supports.radius(i);
        let radius = match (own > 0.0, few) {
            (true, _) => own,
            (false, true) => half_extent,
            (false, false) => around.radius,
        };
        let confidence = match (&certainty, &known) {
            (Some(certainty), Some(known)) if known[i] != Known::All => {
                (f32::from(certainty[i]) * around.agreement).round() as u8
            }
            _ => u8::MAX,
        };
        Body { radius, normal: normals[i], colour: colours[i], curvature: around.curvature, confidence }
    };
    let both_halves = known.is_none();
    let done = |count: usize| progress(if both_halves { count } else { count - count / 2 } as u64);
    let (mut surfels, mut chunks, confidence) = assemble(&positions, body, done);
    progress(duplicates as u64);
    drop((positions, colours));
    notes.isolated = isolated::settle(&sheets, &mut surfels, &mut chunks, |i| few || supports.radius(i) > 0.0);

    let spacing = median_spacing(&neighbours, &points, half_extent);
    let supports = supports.matrices(&normals, &surfels);
    let cloud = SurfelCloud { surfels, chunks, supports, confidence, coloured, spacing };
    if notes.estimated_normals < cloud.len() {
        let ball = 4.0 / 3.0 * std::f64::consts::PI * f64::from(half_extent).powi(3);
        notes.inward = cloud.signed_volume() < -INWARD * ball;
    }
    Ok((cloud, notes))
}

/// Fits the normals that are not known; returns the neighbour graph and the fits' certainties, 0 to 255.
fn estimate(
    neighbours: &Neighbours,
    points: &[Vec3],
    known: &[Known],
    normals: &mut [Vec3],
    done: &(dyn Fn(usize) + Sync),
) -> (Vec<u32>, Vec<u8>) {
    let mut graph = vec![orient::NONE; points.len() * DEGREE];
    let mut certainties = vec![u8::MAX; points.len()];
    graph
        .par_chunks_mut(CHUNK * DEGREE)
        .zip(certainties.par_chunks_mut(CHUNK))
        .zip(normals.par_chunks_mut(CHUNK))
        .enumerate()
        .for_each_init(normals::Scratch::default, |scratch, (c, ((graph, certainties), normals))| {
            let places = graph.chunks_mut(DEGREE).zip(certainties.iter_mut()).zip(normals.iter_mut());
            for (place, ((edges, certainty), normal)) in places.enumerate() {
                let i = c * CHUNK + place;
                if known[i] == Known::Nothing {
                    let fitted = normals::fit(neighbours, points, i, scratch);
                    *normal = fitted.normal;
                    *certainty = (fitted.certainty * f32::from(u8::MAX)).round() as u8;
                } else {
                    neighbours.nearest_k(points[i], DEGREE + 1, &mut scratch.found);
                }
                let others = scratch.found.iter().map(|(j, _)| *j).filter(|j| *j != i as u32);
                edges.iter_mut().zip(others).for_each(|(edge, j)| *edge = j);
            }
            done(certainties.len());
        });
    (graph, certainties)
}

/// The supports that the file gave, in world space.
enum Supports {
    Nothing,
    Disks(Vec<f32>),
    Ellipses(Vec<(f32, Sym3)>),
}

impl Supports {
    /// A disk lies in the plane of its normal, so radii wait for the normals. An uneven scale makes ellipses of disks.
    fn new(given: Given, normals: &[Vec3], linear: DMat3) -> Self {
        match (given, even_scale(linear)) {
            (Given::Nothing, _) => Self::Nothing,
            (Given::Ellipses(ellipses), _) => Self::Ellipses(ellipses),
            (Given::Radii(mut radii), Some(scale)) => {
                radii.par_iter_mut().for_each(|r| *r = (f64::from(*r) * scale) as f32);
                Self::Disks(radii)
            }
            (Given::Radii(radii), None) => {
                let transformed = |(r, n): (&f32, &Vec3)| {
                    // Normals go to the world by the inverse transpose, so they come back by the transpose.
                    let n_in_leaf = (linear.transpose() * n.as_dvec3()).normalize_or(glam::DVec3::Z);
                    let (u, v) = n_in_leaf.any_orthonormal_pair();
                    ellipse(linear * u * f64::from(*r), linear * v * f64::from(*r))
                };
                Self::Ellipses(radii.par_iter().zip(normals).map(transformed).collect())
            }
        }
    }

    /// Radius of support `i`; 0 where the file gave none that can be used.
    fn radius(&self, i: usize) -> f32 {
        match self {
            Self::Nothing => 0.0,
            Self::Disks(radii) => radii[i],
            Self::Ellipses(ellipses) => ellipses[i].0,
        }
    }

    /// How many were given and cannot be used.
    fn bad(&self) -> usize {
        match self {
            Self::Nothing => 0,
            Self::Disks(radii) => radii.par_iter().filter(|r| !(**r > 0.0)).count(),
            Self::Ellipses(ellipses) => ellipses.par_iter().filter(|e| !(e.0 > 0.0)).count(),
        }
    }

    /// The support matrices, where there are ellipses. A surfel whose own could not be used gets its disk.
    fn matrices(self, normals: &[Vec3], surfels: &[super::Surfel]) -> Option<Vec<Sym3>> {
        let Self::Ellipses(ellipses) = self else { return None };
        let matrix = |(i, (radius, matrix)): (usize, &(f32, Sym3))| {
            if *radius > 0.0 {
                return *matrix;
            }
            let (u, v) = normals[i].any_orthonormal_pair();
            let r = surfels[i].radius;
            ellipse((u * r).as_dvec3(), (v * r).as_dvec3()).1
        };
        Some(ellipses.par_iter().enumerate().map(matrix).collect())
    }
}

/// The diagonal of the bounding box.
fn extent(points: &[Vec3]) -> f32 {
    let (low, high) = points
        .par_iter()
        .map(|p| (*p, *p))
        .reduce(|| (Vec3::INFINITY, Vec3::NEG_INFINITY), |a, b| (a.0.min(b.0), a.1.max(b.1)));
    high.distance(low)
}
