//! Which surfels' support balls meet a given ball, and which surfels are nearest to a point.
//!
//! # Theory
//! A binary tree of balls over runs of `RUN` surfels in Morton order; a node's ball holds the *support balls* of its
//! surfels, centres and radii. A k-d tree over the centres would have to search as far as the largest radius of the leaf,
//! and one stray point of a scan, whose radius is a thousand times the others', would make every query visit everything.
//!
//! The same tree finds nearest centres: no centre in a node is nearer than the node's ball. Another tree for that would cost
//! another 20 bytes a surfel.
//!
//! # Practice
//! The tree keeps no surfels: every question brings the cloud that it was made of. Coordinates are `f32` about the cloud's own origin, and balls are widened by their rounding, so a query never misses;
//! callers that need a sharp answer test the surfels they are given.

use glam::{DVec3, Vec3};

use super::{CHUNK, Surfel, SurfelCloud};

/// Surfels a leaf of the tree; a chunk holds a whole number of them.
pub(crate) const RUN: usize = 8;
const _: () = assert!(CHUNK.is_multiple_of(RUN));

#[derive(Debug, Clone, Copy)]
struct Ball {
    centre: Vec3,
    /// Negative where the node is empty.
    radius: f32,
}

const EMPTY: Ball = Ball { centre: Vec3::ZERO, radius: -1.0 };

/// The tree over one cloud's support balls.
#[derive(Debug, Clone, Default)]
pub struct BallTree {
    origin: DVec3,
    /// Root at 1, children of i at 2i and 2i + 1.
    balls: Vec<Ball>,
    leaves: usize,
    /// What rounding the coordinates may have cost.
    slack: f32,
}

impl BallTree {
    /// Over `cloud`.
    pub fn new(cloud: &SurfelCloud) -> Self {
        let origin = cloud.chunks.get(cloud.chunks.len() / 2).map_or(DVec3::ZERO, |c| c.origin);
        let leaves = cloud.len().div_ceil(RUN).next_power_of_two().max(1);
        let mut tree = Self { origin, balls: vec![EMPTY; 2 * leaves], leaves, slack: 0.0 };
        let mut farthest = 0.0_f32;
        for run in 0..cloud.len().div_ceil(RUN) {
            let members = tree.run(cloud, run);
            let count = members.len() as f32;
            let centre = members.clone().map(|(_, s)| s.centre).sum::<Vec3>() / count;
            let radius = members.clone().map(|(_, s)| s.centre.distance(centre) + s.radius).fold(0.0, f32::max);
            farthest = members.map(|(_, s)| s.centre.length()).fold(farthest, f32::max);
            tree.balls[leaves + run] = Ball { centre, radius };
        }
        for node in (1..leaves).rev() {
            tree.balls[node] = joined(tree.balls[2 * node], tree.balls[2 * node + 1]);
        }
        // A few roundings at the coordinates' size, with room to spare.
        const ROUNDINGS: f32 = 8.0;
        tree.slack = ROUNDINGS * f32::EPSILON * farthest;
        tree
    }

    /// The origin of its coordinates, and the balls, centre and radius (negative where there is none): the root at 1, children
    /// of i at 2i and 2i + 1, runs of [`RUN`] surfels last.
    #[cfg(feature = "gpu")]
    pub(crate) fn balls(&self) -> (DVec3, impl ExactSizeIterator<Item = (Vec3, f32)> + '_) {
        (self.origin, self.balls.iter().map(|ball| (ball.centre, ball.radius)))
    }

    /// The surfels of one run with their indices, about the tree's origin.
    #[inline]
    fn run<'c>(&self, cloud: &'c SurfelCloud, run: usize) -> impl ExactSizeIterator<Item = (u32, Ball)> + Clone + 'c {
        let first = run * RUN;
        // A run lies within a chunk.
        let chunk = (cloud.chunks[first / CHUNK].origin - self.origin).as_vec3();
        let surfels = &cloud.surfels[first..(first + RUN).min(cloud.len())];
        let ball = move |s: &Surfel| Ball { centre: chunk + s.offset, radius: s.radius };
        surfels.iter().enumerate().map(move |(i, s)| ((first + i) as u32, ball(s)))
    }

    fn visit(&self, cloud: &SurfelCloud, centre_in_world: DVec3, radius: f64, mut each: impl FnMut(u32, f32) -> bool) {
        let p = (centre_in_world - self.origin).as_vec3();
        let reach = radius as f32 + self.slack + f32::EPSILON * p.length();
        // Each level leaves at most one node waiting.
        let mut stack = [0_usize; usize::BITS as usize + 1];
        stack[0] = 1;
        let mut waiting = usize::from(self.balls.len() > 1);
        while waiting > 0 {
            waiting -= 1;
            let node = stack[waiting];
            let ball = self.balls[node];
            let touch = reach + ball.radius;
            if ball.radius < 0.0 || p.distance_squared(ball.centre) > touch * touch {
                continue;
            }
            if node < self.leaves {
                stack[waiting] = 2 * node + 1;
                stack[waiting + 1] = 2 * node;
                waiting += 2;
                continue;
            }
            for (index, s) in self.run(cloud, node - self.leaves) {
                let touch = reach + s.radius;
                let squared = p.distance_squared(s.centre);
                if squared <= touch * touch && !each(index, squared) {
                    return;
                }
            }
        }
    }

    /// Whether any support ball meets the ball.
    pub fn touches(&self, cloud: &SurfelCloud, centre_in_world: DVec3, radius: f64) -> bool {
        let mut any = false;
        self.visit(cloud, centre_in_world, radius, |_, _| {
            any = true;
            false
        });
        any
    }

    /// The surfels whose support balls meet the ball, by index, with their centres' distances; `found` is cleared first.
    pub fn touching(&self, cloud: &SurfelCloud, centre_in_world: DVec3, radius: f64, found: &mut Vec<(u32, f32)>) {
        found.clear();
        self.visit(cloud, centre_in_world, radius, |index, squared| {
            found.push((index, squared.sqrt()));
            true
        });
    }

    /// How far `p_in_world` is from the nearest ball of `share` times its surfel's radius; negative within one.
    pub fn clearance(&self, cloud: &SurfelCloud, p_in_world: DVec3, share: f32) -> f32 {
        let p = (p_in_world - self.origin).as_vec3();
        let mut best = f32::INFINITY;
        self.descend(p, |run| {
            let gap = |(_, s): (u32, Ball)| p.distance(s.centre) - share * s.radius;
            best = self.run(cloud, run).map(gap).fold(best, f32::min);
            best
        });
        best - self.slack - f32::EPSILON * p.length()
    }

    /// Fills `found` with the `k` surfels whose centres are nearest to `p_in_world` (all, if there are fewer), as index and
    /// distance, by distance, then index; none where `p_in_world` is not finite.
    pub fn nearest_k(&self, cloud: &SurfelCloud, p_in_world: DVec3, k: usize, found: &mut Vec<(u32, f32)>) {
        found.clear();
        let p = (p_in_world - self.origin).as_vec3();
        if k == 0 || !p.is_finite() {
            return;
        }
        self.descend(p, |run| {
            for (index, s) in self.run(cloud, run) {
                let entry = (index, p.distance(s.centre));
                let place = found.partition_point(|known| (known.1, known.0) < (entry.1, entry.0));
                if place < k {
                    found.truncate(k - 1);
                    found.insert(place, entry);
                }
            }
            if found.len() == k { found[k - 1].1 } else { f32::INFINITY }
        });
    }

    /// Calls `look` with the runs whose balls are nearer to `p` than what `look` last returned, the nearer first.
    fn descend(&self, p: Vec3, mut look: impl FnMut(usize) -> f32) {
        let mut best = f32::INFINITY;
        let gap = |node: usize| match self.balls[node] {
            ball if ball.radius < 0.0 => f32::INFINITY,
            ball => p.distance(ball.centre) - ball.radius,
        };
        // Each level leaves at most one node waiting.
        let mut stack = [(0_usize, 0.0_f32); usize::BITS as usize + 1];
        let mut waiting = usize::from(self.balls.len() > 1);
        stack[0] = (1, if waiting > 0 { gap(1) } else { f32::INFINITY });
        while waiting > 0 {
            waiting -= 1;
            let (node, least) = stack[waiting];
            // Equally near ones may have a lower index.
            if !(least - self.slack <= best && least < f32::INFINITY) {
                continue;
            }
            if node >= self.leaves {
                best = look(node - self.leaves);
                continue;
            }
            let (a, b) = ((2 * node, gap(2 * node)), (2 * node + 1, gap(2 * node + 1)));
            let (near, far) = if b.1 < a.1 { (b, a) } else { (a, b) };
            stack[waiting] = far;
            stack[waiting + 1] = near;
            waiting += 2;
        }
    }
}

/// The smallest ball around two balls, widened by its rounding.
fn joined(a: Ball, b: Ball) -> Ball {
    let gap = a.centre.distance(b.centre);
    if b.radius < 0.0 || gap + b.radius <= a.radius {
        return a;
    }
    if a.radius < 0.0 || gap + a.radius <= b.radius {
        return b;
    }
    let radius = 0.5 * (gap + a.radius + b.radius);
    const WIDENED: f32 = 1.0 + 4.0 * f32::EPSILON;
    Ball { centre: a.centre + (b.centre - a.centre) * ((radius - a.radius) / gap), radius: radius * WIDENED }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surfel::{Chunk, Sym3};

    /// A line of surfels of growing radius, far from the world's origin.
    fn cloud() -> SurfelCloud {
        let origin = DVec3::new(1e6, -1e6, 0.0);
        let surfel = |i: usize| Surfel {
            offset: Vec3::X * i as f32,
            radius: if i == 150 { 40.0 } else { 0.7 },
            normal: Vec3::Z,
            colour: [255; 4],
            curvature: Sym3::default(),
        };
        let surfels: Vec<Surfel> = (0..200).map(surfel).collect();
        let chunk = |_: &[Surfel]| Chunk { origin, centre: Vec3::ZERO, extent: 200.0, largest_radius: 40.0 };
        SurfelCloud { chunks: surfels.chunks(CHUNK).map(chunk).collect(), surfels, ..SurfelCloud::default() }
    }

    #[test]
    fn finds_what_a_look_at_every_surfel_finds() {
        let cloud = cloud();
        let tree = BallTree::new(&cloud);
        let mut found = Vec::new();
        for (x, radius) in [(3.2, 0.1), (10.0, 2.5), (-5.0, 1.0), (120.0, 0.0), (500.0, 3.0)] {
            let p = cloud.chunks[0].origin + DVec3::new(x, 0.3, 0.2);
            let distance = |i: usize| cloud.centre(i).distance(p);
            let meets = |i: &usize| distance(*i) <= radius + f64::from(cloud.surfels[*i].radius);
            let expected: Vec<usize> = (0..cloud.len()).filter(meets).collect();
            tree.touching(&cloud, p, radius, &mut found);
            assert_eq!(found.iter().map(|f| f.0 as usize).collect::<Vec<_>>(), expected);
            assert_eq!(tree.touches(&cloud, p, radius), !expected.is_empty());
            let gap = |i: usize| distance(i) - f64::from(cloud.surfels[i].radius);
            let clearance = (0..cloud.len()).map(gap).fold(f64::INFINITY, f64::min);
            let answer = f64::from(tree.clearance(&cloud, p, 1.0));
            assert!(answer <= clearance && answer > clearance - 1e-3, "{answer} {clearance}");
            let mut by_distance: Vec<u32> = (0..cloud.len() as u32).collect();
            by_distance.sort_by(|&a, &b| distance(a as usize).total_cmp(&distance(b as usize)));
            for k in [0, 1, 2, 7, 1000] {
                tree.nearest_k(&cloud, p, k, &mut found);
                let expected = &by_distance[..k.min(cloud.len())];
                assert_eq!(found.iter().map(|f| f.0).collect::<Vec<_>>(), expected);
                assert!(found.iter().all(|f| (f64::from(f.1) - distance(f.0 as usize)).abs() < 1e-3));
            }
        }
        tree.nearest_k(&cloud, DVec3::NAN, 3, &mut found);
        assert!(found.is_empty());
    }

    #[test]
    fn nothing_touches_nothing() {
        let none = SurfelCloud::default();
        let tree = BallTree::new(&none);
        assert!(!tree.touches(&none, DVec3::ZERO, 1e9));
        assert_eq!(tree.clearance(&none, DVec3::ZERO, 1.0), f32::INFINITY);
        let mut found = Vec::new();
        tree.nearest_k(&none, DVec3::ZERO, 1, &mut found);
        assert!(found.is_empty());
    }
}
