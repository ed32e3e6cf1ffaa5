//! Surfels from samples of a surface that is known: what analytic solids and meshes have in common.
//!
//! *Practice.* The sampler promises a cover: every point of a patch has a sample *of the same patch*, facing alike, within a
//! stated distance. Radius and curvature are those of a cloud ([`super::around`]), but only neighbours of the same patch
//! count, so creases stay sharp, and the radius is never larger than the cover asks for.

use glam::{DAffine3, DVec3, Vec3};
use rayon::prelude::*;
use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};

use super::around::{Scratch, Sheets, median_spacing};
use super::assemble::{Body, assemble, median, morton_order};
use super::place::even_scale;
use super::radius::{COVERAGE, MARGIN};
use super::{SurfelCloud, SurfelError, normals};
use crate::geometry::neighbours::Neighbours;

/// The most samples of one leaf: about 8 GB of surfels while they are made.
pub(crate) const MOST_SAMPLES: usize = 1 << 26;

/// Samples facing further apart than this cosine (37°) do not stand for each other in thinning: the far side of a thin wall,
/// or a bend too sharp for the spacing.
const ALIKE: f32 = 0.8;

/// Least distance of the samples that a thinning keeps, in spacings. A greedy thinning leaves a mean distance about 1.3 times
/// its least.
pub(crate) const KEPT: f64 = 0.75;

/// One sample, world space.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sample {
    pub p: DVec3,
    /// Outward unit normal.
    pub normal: Vec3,
    pub patch: u32,
    /// sRGB and opacity.
    pub colour: [u8; 4],
}

/// Distances of a sampling, world units.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sampling {
    /// Wanted distance of neighbours.
    pub spacing: f64,
    /// Every point of a patch has a sample of it within this distance.
    pub cover: f64,
}

/// The factor by which `world_from_leaf` stretches lengths at most, if `spacing` and the transform can be used.
pub(crate) fn largest_stretch(world_from_leaf: DAffine3, spacing: f64) -> Result<f64, SurfelError> {
    if !(spacing > 0.0 && spacing.is_finite()) {
        return Err(SurfelError::Spacing(spacing));
    }
    super::place::normal_map(world_from_leaf)?;
    let linear = world_from_leaf.matrix3;
    Ok(even_scale(linear).unwrap_or_else(|| normals::eigenvalues(linear.transpose() * linear)[2].sqrt()))
}

/// An error where an area (world units) needs too many samples of `spacing`.
pub(crate) fn check_count(area: f64, spacing: f64) -> Result<(), SurfelError> {
    let needed = area / (spacing * spacing);
    if !(needed <= MOST_SAMPLES as f64) {
        let mend = "choose a larger spacing, or check the leaf's size";
        return Err(SurfelError::TooMany { needed, limit: MOST_SAMPLES, mend });
    }
    Ok(())
}

/// Surfels at `samples`, in their final order.
pub(crate) fn from_samples(
    mut samples: Vec<Sample>,
    sampling: Sampling,
    coloured: bool,
) -> Result<SurfelCloud, SurfelError> {
    if samples.is_empty() {
        return Err(SurfelError::Empty);
    }
    if let Some(index) = samples.par_iter().position_first(|s| !s.p.is_finite()) {
        return Err(SurfelError::NotFinite { index, p: samples[index].p });
    }
    let positions: Vec<DVec3> = samples.par_iter().map(|s| s.p).collect();
    let origin = median(&positions);
    let offset = |p: DVec3| (p - origin).as_vec3() + Vec3::ZERO;
    let offsets: Vec<Vec3> = positions.par_iter().map(|p| offset(*p)).collect();
    drop(positions);
    let order = morton_order(&offsets);
    drop(offsets);
    samples = order.par_iter().map(|i| samples[*i as usize]).collect();
    drop(order);
    // The same point of the same patch, as where a row of samples closes on itself. Other patches' samples may lie there
    // too, and between them: corners have as many samples as faces meet.
    let mut kept: Vec<Sample> = Vec::with_capacity(samples.len());
    for sample in samples {
        let here = offset(sample.p);
        let same_place = kept.iter().rev().take_while(|k| offset(k.p) == here);
        if !same_place.into_iter().any(|k| k.patch == sample.patch && k.normal.dot(sample.normal) > ALIKE) {
            kept.push(sample);
        }
    }
    let samples = kept;

    let positions: Vec<DVec3> = samples.par_iter().map(|s| s.p).collect();
    let points: Vec<Vec3> = samples.par_iter().map(|s| offset(s.p)).collect();
    let normals: Vec<Vec3> = samples.par_iter().map(|s| s.normal).collect();
    let patches: Vec<u32> = samples.par_iter().map(|s| s.patch).collect();
    let neighbours = Neighbours::new(origin, points.iter().copied());
    let sheets = Sheets { neighbours: &neighbours, points: &points, normals: &normals, patches: Some(&patches) };
    // As wide as a square grid of this spacing would need, or as the cover is.
    let most = (f64::from(COVERAGE) * std::f64::consts::SQRT_2 * sampling.spacing)
        .max(f64::from(MARGIN) * sampling.cover) as f32;
    let body = |i: usize, scratch: &mut Scratch| {
        let around = scratch.look(&sheets, i);
        let radius = if around.alone { most } else { around.radius.min(most) };
        let Sample { normal, colour, .. } = samples[i];
        Body { radius, normal, colour, curvature: around.curvature, confidence: u8::MAX }
    };
    let (surfels, chunks, confidence) = assemble(&positions, body, |_| ());
    let spacing = median_spacing(&neighbours, &points, sampling.spacing as f32);
    Ok(SurfelCloud { surfels, chunks, supports: None, confidence, coloured, spacing })
}

/// Keeps samples that are at least `distance` from those of the same patch kept before which face alike: a greedy blue-noise thinning. Every
/// sample offered then has a kept one within `distance`.
pub(crate) struct Thinner {
    distance: f64,
    origin: DVec3,
    cells: HashMap<(u32, [i32; 3]), u32, BuildHasherDefault<CellHasher>>,
    kept: Vec<Kept>,
}

struct Kept {
    p: Vec3,
    normal: Vec3,
    /// The next in its cell, or `NONE`.
    next: u32,
}

const NONE: u32 = u32::MAX;

/// Cells per `distance`. Cells are two distances wide, so that a ball of that radius meets eight of them.
const CELL: f64 = 2.0;

impl Thinner {
    /// Samples lie about `origin` (world space).
    pub(crate) fn new(origin: DVec3, distance: f64) -> Self {
        Self { distance, origin, cells: HashMap::default(), kept: Vec::new() }
    }

    /// Whether the sample is kept.
    pub(crate) fn keep(&mut self, patch: u32, p_in_world: DVec3, normal: Vec3) -> bool {
        let e = p_in_world - self.origin;
        let p = e.as_vec3();
        let in_cells = e / (CELL * self.distance);
        let home = in_cells.floor();
        // The neighbouring cell on the nearer side, along each axis.
        let side = (in_cells - home).round() * 2.0 - 1.0;
        let least = (self.distance * self.distance) as f32;
        for corner in 0..8 {
            let step = |axis: usize| if corner >> axis & 1 == 1 { side[axis] } else { 0.0 };
            let cell = home + DVec3::new(step(0), step(1), step(2));
            let mut next = self.cells.get(&key(patch, cell)).copied().unwrap_or(NONE);
            while let Some(kept) = self.kept.get(next as usize) {
                if kept.p.distance_squared(p) < least && kept.normal.dot(normal) > ALIKE {
                    return false;
                }
                next = kept.next;
            }
        }
        let place = self.kept.len() as u32;
        let before = self.cells.insert(key(patch, home), place);
        self.kept.push(Kept { p, normal, next: before.unwrap_or(NONE) });
        true
    }
}

/// A cell of one patch. The patch is part of the key, as emptying a large table for each of many small patches is slow.
fn key(patch: u32, cell: DVec3) -> (u32, [i32; 3]) {
    (patch, cell.to_array().map(|x| x as i32))
}

/// Mixes a few small integers: the default hasher guards against attackers at five times the cost.
#[derive(Default)]
pub(crate) struct CellHasher(u64);

impl Hasher for CellHasher {
    fn finish(&self) -> u64 {
        self.0 ^ self.0 >> 32
    }

    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|b| self.write_i32(i32::from(*b)));
    }

    fn write_i32(&mut self, x: i32) {
        self.write_u32(x as u32);
    }

    // Arrays write their length, which is always the same here.
    fn write_usize(&mut self, _: usize) {}

    fn write_u32(&mut self, x: u32) {
        // The golden ratio's fraction: successive cells land far apart (Knuth, 6.4).
        self.0 = (self.0.rotate_left(21) ^ u64::from(x)).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    }
}
