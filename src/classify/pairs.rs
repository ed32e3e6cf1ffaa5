//! How every surfel of one leaf lies to another leaf: decided for whole chunks where possible.
//!
//! # Theory
//! Wicke 2004 §3.1.2 needs, for each surfel, its side of and its distance to every other surface. Whole runs of surfels are
//! decided at once: at a node of A's hierarchy ask for one nearest surfel of B; if that is farther than the node's radius
//! plus both leaves' largest surfel radii, no surfel of the node can touch B, and all take one sign.
//!
//! # Practice
//! The result is kept per pair of leaves, so that a leaf that moves touches only its own pairs. Two thresholds exist: a
//! chunk is [`Touch::Apart`] where no *support* of B reaches it, and only then are its surfels useless to B as clipping
//! partners; a surfel may be decided by the tighter test and still be a partner.

use rayon::prelude::*;

use super::field::{BallScratch, LeafField};
use crate::csg::residual::Membership;
use crate::surfel::{CHUNK, Chunk};

/// How one chunk of A lies to B.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Touch {
    /// All its surfels are on one side and out of reach.
    Apart(Membership),
    /// Some may be near: each surfel's own status.
    Surfels(Box<[Membership]>),
}

/// How the surfels of leaf A lie to leaf B, a [`Touch`] for each chunk of A.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum PairStatus {
    /// The same for every chunk: `Touch::Apart`.
    Whole(Membership),
    /// Chunk by chunk.
    Chunks(Vec<Touch>),
}

impl PairStatus {
    /// Classifies the surfels of `a` against `b`.
    pub fn of(a: &LeafField, b: &LeafField) -> Self {
        let chunks = &a.cloud.chunks;
        if chunks.is_empty() {
            return Self::Whole(Membership::Out);
        }
        let nodes = Nodes::over(chunks);
        match descend(a, b, &nodes, 1) {
            Span::One(membership) => Self::Whole(membership),
            Span::Many(touches) => Self::Chunks(touches),
        }
    }

    /// The status of chunk `index`.
    pub fn chunk(&self, index: usize) -> TouchRef<'_> {
        match self {
            Self::Whole(m) => TouchRef::Apart(*m),
            Self::Chunks(touches) => match &touches[index] {
                Touch::Apart(m) => TouchRef::Apart(*m),
                Touch::Surfels(each) => TouchRef::Surfels(each),
            },
        }
    }
}

/// A borrowed [`Touch`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TouchRef<'a> {
    /// As [`Touch::Apart`].
    Apart(Membership),
    /// As [`Touch::Surfels`].
    Surfels(&'a [Membership]),
}

/// Bounding balls of runs of chunks: an implicit binary tree, root 1, children 2i and 2i + 1.
struct Nodes {
    /// Centre and radius of a ball that holds every *support ball* of the run.
    balls: Vec<(glam::DVec3, f64)>,
    leaves: usize,
    chunks: usize,
}

impl Nodes {
    fn over(chunks: &[Chunk]) -> Self {
        let leaves = chunks.len().next_power_of_two();
        let mut balls = vec![(glam::DVec3::ZERO, -1.0); 2 * leaves];
        for (i, c) in chunks.iter().enumerate() {
            let radius = f64::from(c.extent) + f64::from(c.largest_radius);
            balls[leaves + i] = (c.origin + c.centre.as_dvec3(), radius);
        }
        for node in (1..leaves).rev() {
            balls[node] = joined(balls[2 * node], balls[2 * node + 1]);
        }
        Self { balls, leaves, chunks: chunks.len() }
    }

    /// The chunks below `node`.
    fn run(&self, node: usize) -> std::ops::Range<usize> {
        let width = self.leaves >> node.ilog2();
        let first = (node - (1 << node.ilog2())) * width;
        first.min(self.chunks)..(first + width).min(self.chunks)
    }
}

/// The smallest ball around two balls; a negative radius is an empty ball.
fn joined(a: (glam::DVec3, f64), b: (glam::DVec3, f64)) -> (glam::DVec3, f64) {
    let gap = a.0.distance(b.0);
    if b.1 < 0.0 || gap + b.1 <= a.1 {
        return a;
    }
    if a.1 < 0.0 || gap + a.1 <= b.1 {
        return b;
    }
    let radius = 0.5 * (gap + a.1 + b.1);
    (a.0 + (b.0 - a.0) * ((radius - a.1) / gap), radius)
}

enum Span {
    One(Membership),
    Many(Vec<Touch>),
}

fn descend(a: &LeafField, b: &LeafField, nodes: &Nodes, node: usize) -> Span {
    let run = nodes.run(node);
    if run.is_empty() {
        return Span::Many(Vec::new());
    }
    let (centre, radius) = nodes.balls[node];
    match b.ball(centre, radius) {
        Membership::Near => {}
        decided => return Span::One(decided),
    }
    if node >= nodes.leaves {
        let first = run.start * CHUNK;
        let last = (first + CHUNK).min(a.cloud.len());
        let mut scratch = BallScratch::default();
        let each =
            (first..last).map(|i| b.surfel_ball(a.cloud.centre(i), a.cloud.surfels[i].radius, &mut scratch)).collect();
        return Span::Many(vec![Touch::Surfels(each)]);
    }
    let (left, right) = rayon::join(|| descend(a, b, nodes, 2 * node), || descend(a, b, nodes, 2 * node + 1));
    let mut touches = Vec::with_capacity(run.len());
    for (child, span) in [(2 * node, left), (2 * node + 1, right)] {
        match span {
            Span::One(m) => touches.extend(nodes.run(child).map(|_| Touch::Apart(m))),
            Span::Many(mut many) => touches.append(&mut many),
        }
    }
    Span::Many(touches)
}

/// All ordered pairs of `fields`, `statuses[a][b]`; a leaf does not lie to itself.
pub fn all_pairs(fields: &[&LeafField]) -> Vec<Vec<Option<PairStatus>>> {
    (0..fields.len())
        .into_par_iter()
        .map(|a| {
            (0..fields.len()).into_par_iter().map(|b| (a != b).then(|| PairStatus::of(fields[a], fields[b]))).collect()
        })
        .collect()
}
