//! Nearest points: the only file that knows which k-d tree serves.
//!
//! *Practice.* [kiddo](https://docs.rs/kiddo) with flat leaves. Three traps are met here, once:
//!
//! * A k-d tree whose split planes are parallel to a flat face cannot part that face's points (all share one coordinate):
//!   a box was 12 times slower to ask than a sphere. So all points are turned by one fixed, arbitrary rotation first.
//! * Ties in distance come in the tree's order; lists are therefore sorted by distance, then index, and the tree is built
//!   on one thread, so that answers do not depend on the number of threads.
//! * Queries far from the points (distance ≫ spacing) visit many leaves. Ask a bounding box first where that happens, and
//!   ask in a coherent order (a leaf's surfels are in Morton order), which is two to three times faster than random order.
//!
//! More than a handful of *identical* points would pile up in one leaf: callers remove duplicates first.

use std::num::NonZeroUsize;

use glam::{DVec3, Mat3, Vec3};
use kiddo::kd_tree::KdTree;
use kiddo::leaf_strategy::FlatVec;
use kiddo::{Eytzinger, SquaredEuclidean};

/// Points a leaf of the tree: the fastest of 8, 16 and 32 for lists of 16 neighbours.
const BUCKET: usize = 16;

type Tree = KdTree<f32, u32, Eytzinger, FlatVec<f32, u32, 3, BUCKET>, 3, BUCKET>;

/// A static search structure over points in world space; about 18 bytes a point, shared freely between threads.
#[derive(Debug)]
pub struct Neighbours {
    tree: Tree,
    origin: DVec3,
    turn: Mat3,
}

/// The columns of the fixed rotation: orthonormal, no entry near 0 or ±1, so that no likely face is parallel to a split
/// plane (Rodrigues' formula, 1 radian about the axis (3, 5, 7)).
fn fixed_turn() -> Mat3 {
    Mat3::from_axis_angle(Vec3::new(3.0, 5.0, 7.0).normalize(), 1.0)
}

impl Neighbours {
    /// A search over `points`, given as offsets from `origin` (world space). A point's index is its place in the input;
    /// points that are not finite keep their index but are never found.
    ///
    /// # Panics
    /// When there are more than `u32::MAX` points.
    pub fn new(origin: DVec3, points: impl IntoIterator<Item = Vec3>) -> Self {
        let turn = fixed_turn();
        let entries: Vec<(u32, [f32; 3])> = points
            .into_iter()
            .enumerate()
            .filter(|(_, p)| p.is_finite())
            .map(|(index, p)| (u32::try_from(index).expect("at most u32::MAX points"), (turn * p).to_array()))
            .collect();
        let tree = if entries.is_empty() {
            Tree::default()
        } else {
            Tree::new_from_entries(&entries).expect("flat leaves may grow, so any input fits")
        };
        Self { tree, origin, turn }
    }

    /// The number of points that can be found.
    pub fn len(&self) -> usize {
        self.tree.size()
    }

    /// Whether there is no point.
    pub fn is_empty(&self) -> bool {
        self.tree.size() == 0
    }

    /// The world-space point that offsets are relative to.
    pub fn origin(&self) -> DVec3 {
        self.origin
    }

    /// `p_in_world` as an offset from [`Self::origin`].
    #[inline]
    pub fn offset(&self, p_in_world: DVec3) -> Vec3 {
        (p_in_world - self.origin).as_vec3()
    }

    /// Index of, and distance to, the point nearest to the offset `p`; `None` where there is no point or `p` is not finite.
    #[inline]
    pub fn nearest(&self, p: Vec3) -> Option<(u32, f32)> {
        if self.is_empty() || !p.is_finite() {
            return None;
        }
        let query = (self.turn * p).to_array();
        let found = self.tree.query(&query).nearest_one::<SquaredEuclidean<f32>>().execute();
        Some((found.item, found.distance.sqrt()))
    }

    /// [`Self::nearest`] for a world-space point.
    #[inline]
    pub fn nearest_in_world(&self, p_in_world: DVec3) -> Option<(u32, f32)> {
        self.nearest(self.offset(p_in_world))
    }

    /// Fills `found` with the `k` points nearest to the offset `p` (all, if there are fewer) as index and distance, by
    /// distance, then index. A point that lies at `p` itself is among them.
    pub fn nearest_k(&self, p: Vec3, k: usize, found: &mut Vec<(u32, f32)>) {
        found.clear();
        let Some(k) = NonZeroUsize::new(k.min(self.len())) else { return };
        if !p.is_finite() {
            return;
        }
        let query = (self.turn * p).to_array();
        let list = self.tree.query(&query).nearest_n::<SquaredEuclidean<f32>>(k).execute();
        found.extend(list.iter().map(|near| (near.item, near.distance.sqrt())));
        sort_by_distance(found);
    }

    /// Fills `found` with all points within `radius` of the offset `p`, as index and distance, by distance, then index.
    pub fn within(&self, p: Vec3, radius: f32, found: &mut Vec<(u32, f32)>) {
        found.clear();
        self.for_each_within(p, radius, |index, distance2| found.push((index, distance2.sqrt())));
        sort_by_distance(found);
    }

    /// Calls `visit` with index and *squared* distance of all points within `radius` of the offset `p`, in no useful order,
    /// but always the same. Five times faster than a list of as many nearest points, where a hundred are wanted.
    #[inline]
    pub fn for_each_within(&self, p: Vec3, radius: f32, mut visit: impl FnMut(u32, f32)) {
        if self.is_empty() || !p.is_finite() || !(radius >= 0.0) {
            return;
        }
        let query = (self.turn * p).to_array();
        let within = self.tree.query(&query).within::<SquaredEuclidean<f32>>(radius * radius);
        within.unsorted().visit(|near| visit(near.item, near.distance));
    }
}

/// By distance, then index. Lists of nearest points come in this order already, but for ties.
fn sort_by_distance(found: &mut [(u32, f32)]) {
    let order = |a: &(u32, f32), b: &(u32, f32)| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0));
    if !found.is_sorted_by(|a, b| order(a, b).is_lt()) {
        found.sort_unstable_by(order);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A plain integer hash (Lowbias32, C. Wellons), for test points.
    fn unit(seed: u32) -> f32 {
        let mut x = seed.wrapping_mul(0x9E37_79B9);
        x = (x ^ (x >> 16)).wrapping_mul(0x7FEB_352D);
        x = (x ^ (x >> 15)).wrapping_mul(0x846C_A68B);
        (x ^ (x >> 16)) as f32 / u32::MAX as f32
    }

    fn cube_surface(n: u32) -> Vec<Vec3> {
        (0..n)
            .map(|i| {
                let (a, b) = (unit(3 * i), unit(3 * i + 1));
                [Vec3::new(a, b, 0.0), Vec3::new(1.0, a, b), Vec3::new(a, 1.0, b)][(i % 3) as usize]
            })
            .collect()
    }

    #[test]
    fn lists_agree_with_a_plain_search() {
        let points = cube_surface(3000);
        let neighbours = Neighbours::new(DVec3::ZERO, points.iter().copied());
        let mut found = Vec::new();
        for i in 0..200 {
            let p = Vec3::new(unit(9000 + i), unit(19000 + i), unit(29000 + i)) * 1.5;
            let mut plain: Vec<f32> = points.iter().map(|q| q.distance(p)).collect();
            plain.sort_unstable_by(f32::total_cmp);
            neighbours.nearest_k(p, 20, &mut found);
            assert_eq!(found.len(), 20);
            for (near, distance) in found.iter().zip(&plain) {
                assert!((near.1 - distance).abs() < 1e-5, "{near:?} {distance}");
                assert!((points[near.0 as usize].distance(p) - near.1).abs() < 1e-5);
            }
            assert!((neighbours.nearest(p).unwrap().1 - plain[0]).abs() < 1e-5);
            let radius = plain[40] + 1e-4;
            neighbours.within(p, radius, &mut found);
            let expected = plain.iter().filter(|d| **d <= radius).count();
            assert!(found.len().abs_diff(expected) <= 1, "{} {expected}", found.len());
            assert!(found.windows(2).all(|w| w[0].1 <= w[1].1));
        }
    }

    #[test]
    fn few_points_and_bad_points() {
        let mut found = vec![(7, 1.0)];
        let none = Neighbours::new(DVec3::ZERO, []);
        assert!(none.is_empty() && none.nearest(Vec3::ZERO).is_none());
        none.nearest_k(Vec3::ZERO, 3, &mut found);
        assert!(found.is_empty());
        none.within(Vec3::ZERO, 3.0, &mut found);
        assert!(found.is_empty());
        let far = DVec3::new(1e7, -1e7, 3.0);
        let two = Neighbours::new(far, [Vec3::NAN, Vec3::ZERO, Vec3::X]);
        assert_eq!(two.len(), 2);
        assert_eq!(two.nearest_in_world(far + DVec3::X * 0.9).unwrap().0, 2);
        assert!(two.nearest(Vec3::NAN).is_none());
        two.nearest_k(Vec3::X * 0.5, 9, &mut found);
        assert_eq!(found.iter().map(|f| f.0).collect::<Vec<_>>(), [1, 2]);
        two.within(Vec3::ZERO, f32::NAN, &mut found);
        assert!(found.is_empty());
    }

    #[test]
    fn shared_between_threads() {
        fn shared<T: Send + Sync>() {}
        shared::<Neighbours>();
    }
}
