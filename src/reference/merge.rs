//! The boundaries of a pixel's samples as one list.
//!
//! Samples that see the same surface share a record with a bit each. The order of every sample's own boundaries is kept:
//! a style that composites the records in order, sample by sample, gets every sample right.

use glam::DVec3;

use super::RayBoundary;
use crate::layers::Boundary;
use crate::space::Camera;

/// The steepest slope, depth over width, that two samples' depths are compared with: the reciprocal of the least cosine
/// (0.05) at which surfaces are told apart anywhere in the crate.
const STEEPEST: f64 = 20.0;

struct Record {
    /// Of the first sample.
    first: RayBoundary,
    /// How far another sample's depth may be from the first's if it sees the same surface.
    reach: f64,
    depth: f64,
    normal: DVec3,
    colour: [f32; 3],
    samples: u16,
}

impl Record {
    fn new(camera: &Camera, found: &RayBoundary, bit: u16) -> Self {
        // Samples are at most a pixel's diagonal, below two footprints, apart.
        let slope = |cos: f64| (1.0 / cos.abs()).min(STEEPEST);
        let reach = 2.0 * camera.footprint(found.depth) * slope(found.normal.dot(camera.forward));
        Self { first: *found, reach, depth: found.depth, normal: found.normal, colour: found.colour, samples: bit }
    }

    fn is_same(&self, other: &RayBoundary) -> bool {
        (self.first.leaf, self.first.facing, self.first.body) == (other.leaf, other.facing, other.body)
            && (self.first.depth - other.depth).abs() <= self.reach
    }

    fn add(&mut self, other: &RayBoundary, bit: u16) {
        self.depth += other.depth;
        self.normal += other.normal;
        (0..3).for_each(|i| self.colour[i] += other.colour[i]);
        self.samples |= bit;
    }

    fn finish(self) -> Boundary {
        let count = f64::from(self.samples.count_ones());
        Boundary {
            depth: (self.depth / count) as f32,
            normal: self.normal.normalize_or(self.first.normal).as_vec3(),
            colour: self.colour.map(|sum| sum / count as f32),
            opacity: self.first.opacity,
            leaf: self.first.leaf,
            body: self.first.body,
            facing: self.first.facing,
            samples: self.samples,
        }
    }
}

/// Merges the boundaries of a pixel's samples, each front to back.
pub(super) fn merge(camera: &Camera, samples: &[Vec<RayBoundary>]) -> Vec<Boundary> {
    let mut records: Vec<Record> = Vec::new();
    for (index, sample) in samples.iter().enumerate() {
        let bit = 1u16 << index;
        // This sample's next boundary must come at or after here.
        let mut next = 0;
        for found in sample {
            let same = records[next..].iter().position(|record| record.is_same(found));
            let at = match same {
                Some(skipped) => {
                    records[next + skipped].add(found, bit);
                    next + skipped
                }
                None => {
                    let before = records[next..].iter().take_while(|r| r.first.depth <= found.depth).count();
                    records.insert(next + before, Record::new(camera, found, bit));
                    next + before
                }
            };
            next = at + 1;
        }
    }
    records.into_iter().map(Record::finish).collect()
}
