//! Which surfels' support balls meet a given ball.
//!
//! # Theory
//! A binary tree of balls over runs of `RUN` surfels in Morton order; a node's ball holds the *support balls* of its
//! surfels, centres and radii. A k-d tree over the centres would have to search as far as the largest radius of the leaf,
//! and one stray point of a scan, whose radius is a thousand times the others', would make every query visit everything.
//!
//! # Practice
//! Coordinates are `f32` about the cloud's own origin, and balls are widened by their rounding, so a query never misses;
//! callers that need a sharp answer test the surfels they are given.

use glam::{DVec3, Vec3};

use super::SurfelCloud;

/// Surfels a leaf of the tree.
const RUN: usize = 8;

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
    /// Per surfel.
    surfels: Vec<Ball>,
    /// What rounding the coordinates may have cost.
    slack: f32,
}

impl BallTree {
    /// Over `cloud`.
    pub fn new(cloud: &SurfelCloud) -> Self {
        let origin = cloud.chunks.get(cloud.chunks.len() / 2).map_or(DVec3::ZERO, |c| c.origin);
        let surfels: Vec<Ball> = (0..cloud.len())
            .map(|i| Ball { centre: (cloud.centre(i) - origin).as_vec3(), radius: cloud.surfels[i].radius })
            .collect();
        let farthest = surfels.iter().map(|s| s.centre.length()).fold(0.0, f32::max);
        let leaves = surfels.len().div_ceil(RUN).next_power_of_two().max(1);
        let mut balls = vec![EMPTY; 2 * leaves];
        for (run, members) in surfels.chunks(RUN).enumerate() {
            let centre = members.iter().map(|s| s.centre).sum::<Vec3>() / members.len() as f32;
            let radius = members.iter().map(|s| s.centre.distance(centre) + s.radius).fold(0.0, f32::max);
            balls[leaves + run] = Ball { centre, radius };
        }
        for node in (1..leaves).rev() {
            balls[node] = joined(balls[2 * node], balls[2 * node + 1]);
        }
        // A few roundings at the coordinates' size, with room to spare.
        const ROUNDINGS: f32 = 8.0;
        Self { origin, balls, leaves, surfels, slack: ROUNDINGS * f32::EPSILON * farthest }
    }

    fn visit(&self, centre_in_world: DVec3, radius: f64, mut each: impl FnMut(u32, f32) -> bool) {
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
            let first = (node - self.leaves) * RUN;
            let members = &self.surfels[first..(first + RUN).min(self.surfels.len())];
            for (index, s) in members.iter().enumerate() {
                let touch = reach + s.radius;
                let squared = p.distance_squared(s.centre);
                if squared <= touch * touch && !each((first + index) as u32, squared) {
                    return;
                }
            }
        }
    }

    /// Whether any support ball meets the ball.
    pub fn touches(&self, centre_in_world: DVec3, radius: f64) -> bool {
        let mut any = false;
        self.visit(centre_in_world, radius, |_, _| {
            any = true;
            false
        });
        any
    }

    /// The surfels whose support balls meet the ball, by index, with their centres' distances; `found` is cleared first.
    pub fn touching(&self, centre_in_world: DVec3, radius: f64, found: &mut Vec<(u32, f32)>) {
        found.clear();
        self.visit(centre_in_world, radius, |index, squared| {
            found.push((index, squared.sqrt()));
            true
        });
    }

    /// How far `p_in_world` is from the nearest ball of `share` times its surfel's radius; negative within one.
    pub fn clearance(&self, p_in_world: DVec3, share: f32) -> f32 {
        let p = (p_in_world - self.origin).as_vec3();
        let mut best = f32::INFINITY;
        let mut stack = [0_usize; usize::BITS as usize + 1];
        stack[0] = 1;
        let mut waiting = usize::from(self.balls.len() > 1);
        while waiting > 0 {
            waiting -= 1;
            let node = stack[waiting];
            let gap = |node: usize| match self.balls[node] {
                ball if ball.radius < 0.0 => f32::INFINITY,
                ball => p.distance(ball.centre) - ball.radius,
            };
            if gap(node) >= best {
                continue;
            }
            if node < self.leaves {
                let (near, far) = (2 * node, 2 * node + 1);
                let (near, far) = if gap(far) < gap(near) { (far, near) } else { (near, far) };
                stack[waiting] = far;
                stack[waiting + 1] = near;
                waiting += 2;
                continue;
            }
            let first = (node - self.leaves) * RUN;
            for s in &self.surfels[first..(first + RUN).min(self.surfels.len())] {
                best = best.min(p.distance(s.centre) - share * s.radius);
            }
        }
        best - self.slack - f32::EPSILON * p.length()
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
    use crate::surfel::{CHUNK, Chunk, Surfel, Sym3};

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
            tree.touching(p, radius, &mut found);
            assert_eq!(found.iter().map(|f| f.0 as usize).collect::<Vec<_>>(), expected);
            assert_eq!(tree.touches(p, radius), !expected.is_empty());
            let gap = |i: usize| distance(i) - f64::from(cloud.surfels[i].radius);
            let clearance = (0..cloud.len()).map(gap).fold(f64::INFINITY, f64::min);
            let answer = f64::from(tree.clearance(p, 1.0));
            assert!(answer <= clearance && answer > clearance - 1e-3, "{answer} {clearance}");
        }
    }

    #[test]
    fn nothing_touches_nothing() {
        let tree = BallTree::new(&SurfelCloud::default());
        assert!(!tree.touches(DVec3::ZERO, 1e9));
        assert_eq!(tree.clearance(DVec3::ZERO, 1.0), f32::INFINITY);
    }
}
