//! What rays meet, before it is a record of the layer stack.

use glam::Vec3;

use crate::layers::Facing;

/// One boundary of the result on one ray.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// Planar depth less the tile's anchor depth.
    pub t: f32,
    /// The result's outward unit normal, view axes.
    pub normal: Vec3,
    /// Linear RGB.
    pub colour: [f32; 3],
    /// 0 to 1.
    pub opacity: f32,
    /// Whose surface.
    pub leaf: u32,
    /// Whose material lies behind.
    pub body: u32,
    /// The result's.
    pub facing: Facing,
}

/// Sorts a ray's hits and drops what two groups found twice. With `nearest_only` what an opaque hit hides is dropped too.
pub fn finish_ray(hits: &mut Vec<Hit>, nearest_only: bool) {
    hits.sort_by(|a, b| a.t.total_cmp(&b.t).then(a.leaf.cmp(&b.leaf)));
    hits.dedup_by(|b, a| a.leaf == b.leaf && a.facing == b.facing && a.t == b.t);
    if nearest_only {
        // Surfaces that let light through show what is behind them: keep up to the first opaque one.
        let opaque = hits.iter().position(|h| h.opacity >= 1.0);
        hits.truncate(opaque.map_or(hits.len(), |last| last + 1));
    }
}

/// The hits of one block of pixels at one place within them.
#[derive(Debug, Default)]
pub struct BlockHits {
    /// Pixel after pixel, row by row, each front to back.
    pub hits: Vec<Hit>,
    /// Where each pixel's hits end in `hits`.
    pub ends: Vec<u32>,
}

impl BlockHits {
    /// Forgets everything.
    pub fn clear(&mut self) {
        self.hits.clear();
        self.ends.clear();
    }

    /// Adds the next pixel.
    pub fn push(&mut self, hits: &[Hit]) {
        self.hits.extend_from_slice(hits);
        self.ends.push(self.hits.len() as u32);
    }

    /// Of a pixel, counted row by row.
    pub fn of(&self, pixel: usize) -> &[Hit] {
        let start = if pixel == 0 { 0 } else { self.ends[pixel - 1] as usize };
        &self.hits[start..self.ends[pixel] as usize]
    }

    /// Whether neighbouring pixels of a block `across` pixels wide see their surfaces turn and recede no more than one smooth
    /// surface does. `towards` is the unit direction of the block's rays, view axes; `footprint` that of its pixels.
    pub fn is_smooth(&self, across: usize, towards: Vec3, footprint: f32) -> bool {
        const LEAST_COSINE: f32 = 0.94; // of a turn of 20 degrees, between neighbours
        const MOST_STEP: f32 = 2.0; // times what the slope explains
        const LEAST_SLANT: f32 = 0.02; // below, the slope explains any step
        let joined = |a: &Hit, b: &Hit| {
            let slant = a.normal.dot(towards).abs().min(b.normal.dot(towards).abs()).max(LEAST_SLANT);
            a.normal.dot(b.normal) > LEAST_COSINE && (a.t - b.t).abs() <= MOST_STEP * footprint / slant
        };
        let count = self.ends.len();
        let pairs = (0..count).flat_map(|p| {
            let right = ((p + 1) % across != 0).then_some((p, p + 1));
            right.into_iter().chain((p + across < count).then_some((p, p + across)))
        });
        pairs.into_iter().all(|(p, q)| self.of(p).iter().zip(self.of(q)).all(|(a, b)| joined(a, b)))
    }

    /// Whether all pixels see the same surfaces, so that one sample stands for all.
    pub fn is_uniform(&self) -> bool {
        let first = self.of(0);
        (1..self.ends.len()).map(|pixel| self.of(pixel)).all(|hits| {
            hits.len() == first.len()
                && hits.iter().zip(first).all(|(a, b)| a.leaf == b.leaf && a.facing == b.facing && a.body == b.body)
        })
    }
}
