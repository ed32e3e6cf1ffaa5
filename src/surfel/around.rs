//! What the neighbours of a surfel say of its radius, its curvature and its normal.

use glam::{Vec2, Vec3};

use super::Sym3;
use super::curvature::{self, SAME_SHEET};
use super::orient::{DEGREE, agreement};
use super::radius::{self, COVERAGE, RING, coverage};
use crate::geometry::neighbours::Neighbours;

/// Neighbours looked at first: about two rings.
const NEIGHBOURS: usize = 16;

/// How many are asked where those leave a sector, or the surfel's own sheet, empty.
const WIDER: [usize; 2] = [64, 256];

/// A surfel that is not of one sheet with most of those about it is a corner's, or its normal is wrong. In the corner of a cube a
/// third of the neighbours are on each face, at √3 times the distances; further ones on other walls must not make it larger.
const MINORITY: f32 = 2.0;

/// A surfel whose radius is more than this many times the distance of the neighbours that its curvature is fitted to bridges a gap
/// of the scan: what bends a spacing about it says little of what bends there, so it is fitted to all neighbours that were looked at.
const BRIDGE: f32 = 3.0;

/// Points with final normals. Two are on one sheet where their normals agree within [`SAME_SHEET`] and, where it is known,
/// their patch is the same.
#[derive(Clone, Copy)]
pub(crate) struct Sheets<'a> {
    pub neighbours: &'a Neighbours,
    pub points: &'a [Vec3],
    pub normals: &'a [Vec3],
    pub patches: Option<&'a [u32]>,
}

/// What a point's neighbours say of it.
pub(crate) struct Around {
    /// By the rule of [`super::radius`].
    pub radius: f32,
    /// Whether there were too few neighbours on its sheet to trust that.
    pub alone: bool,
    pub curvature: Sym3,
    /// How well the nearest normals agree, sign and all: 0 to 1.
    pub agreement: f32,
}

/// Buffers of one thread.
#[derive(Debug, Default)]
pub(crate) struct Scratch {
    found: Vec<(u32, f32)>,
    sheet: Vec<(Vec3, Vec3)>,
    flat: Vec<Vec2>,
    radius: radius::Scratch,
}

impl Scratch {
    pub(crate) fn look(&mut self, sheets: &Sheets<'_>, i: usize) -> Around {
        let Sheets { neighbours, points, normals, .. } = *sheets;
        let (p, n) = (points[i], normals[i]);
        neighbours.nearest_k(p, NEIGHBOURS + 1, &mut self.found);
        let ring = self.found.iter().filter(|f| f.0 != i as u32).take(RING).last().map_or(0.0, |f| f.1);
        self.keep_sheet(sheets, i);
        let mut curvature = curvature::fit(n, &self.sheet);
        let fitted_to = self.sheet.iter().take(curvature::NEIGHBOURS).next_back().map_or(0.0, |(e, _)| e.length());
        let agreement = self.agreement(points, normals, i);
        let minority = self.sheet.len() < RING;
        let mut cover = self.cover(n);
        for wider in WIDER {
            if !(cover.open || self.sheet.len() < RING) || self.found.len() == points.len() {
                break;
            }
            neighbours.nearest_k(p, wider + 1, &mut self.found);
            self.keep_sheet(sheets, i);
            cover = self.cover(n);
        }
        let alone = self.sheet.len() < RING || !(cover.radius > 0.0);
        let radius = if alone {
            // The distance from the others, whatever they are, must do.
            COVERAGE * ring
        } else if minority {
            cover.radius.min(MINORITY * COVERAGE * ring)
        } else {
            cover.radius
        };
        if !alone && radius > BRIDGE * fitted_to {
            curvature = curvature::fit_widely(n, &self.sheet);
        }
        Around { radius, alone, curvature, agreement }
    }

    /// Keeps the neighbours whose normals say that they are on the sheet of surfel `i`.
    fn keep_sheet(&mut self, sheets: &Sheets<'_>, i: usize) {
        let Sheets { points, normals, patches, .. } = *sheets;
        let same_patch = |j: usize| patches.is_none_or(|patches| patches[i] == patches[j]);
        self.sheet.clear();
        for &(j, _) in self.found.iter().filter(|f| f.0 != i as u32) {
            let j = j as usize;
            if same_patch(j) && normals[j].dot(normals[i]) > SAME_SHEET {
                self.sheet.push((points[j] - points[i], normals[j]));
            }
        }
    }

    fn cover(&mut self, n: Vec3) -> radius::Coverage {
        let (u, v) = n.any_orthonormal_pair();
        self.flat.clear();
        self.flat.extend(self.sheet.iter().map(|(e, _)| Vec2::new(e.dot(u), e.dot(v))));
        coverage(&self.flat, &mut self.radius)
    }

    fn agreement(&self, points: &[Vec3], normals: &[Vec3], i: usize) -> f32 {
        let nearest = self.found.iter().filter(|f| f.0 != i as u32).take(DEGREE);
        let (mut sum, mut count) = (0.0f32, 0.0f32);
        for &(j, _) in nearest {
            let j = j as usize;
            sum += agreement(points[j] - points[i], normals[i], normals[j]).0.max(0.0);
            count += 1.0;
        }
        if count > 0.0 { (sum / count).min(1.0) } else { 1.0 }
    }
}

/// Median distance to the nearest other point, of a sample; `alone` for a single point.
pub(crate) fn median_spacing(neighbours: &Neighbours, points: &[Vec3], alone: f32) -> f32 {
    /// Points asked.
    const SAMPLE: usize = 4096;
    let step = points.len().div_ceil(SAMPLE).max(1);
    let mut found = Vec::new();
    let mut distances: Vec<f32> = points
        .iter()
        .step_by(step)
        .filter_map(|p| {
            neighbours.nearest_k(*p, 2, &mut found);
            found.get(1).map(|f| f.1)
        })
        .collect();
    if distances.is_empty() {
        return alone;
    }
    let middle = distances.len() / 2;
    *distances.select_nth_unstable_by(middle, f32::total_cmp).1
}
