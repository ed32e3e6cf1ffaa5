//! The generalised winding number of surface elements: how much of the view from a point is surface seen from inside.
//!
//! # Theory
//! Jacobson et al. 2013 define w(p) = Σ Ωᵢ(p) / 4π over oriented surface elements: 1 inside a closed surface, 0 outside,
//! in between where the surface is open. Barill et al. 2018 ("Fast Winding Numbers for Soups and Clouds", §3) evaluate it
//! for points: each element is a dipole `a n · (x − p) / 4π|x − p|³`, and a far cluster of dipoles acts as one.
//!
//! # Changes from the paper
//! First-order clusters only, over an implicit binary tree on elements that are already in a spatial order: the sign
//! of `w − ½` is all that is asked, far from the surface, where first order is right to a few per cent.
//!
//! # Practice
//! Never ask it near the surface: point dipoles are singular there. Callers decide near points by a field or exactly.

use glam::DVec3;

/// Elements a leaf of the tree.
pub(crate) const LEAF: usize = 8;

/// A cluster acts as one dipole from beyond this many of its radii (Barill 2018 §3.3: 2 gives about 1 % error).
pub(crate) const FAR: f64 = 2.0;

/// One oriented surface element: a place and its area times its unit normal.
#[derive(Debug, Clone, Copy)]
pub struct Element {
    /// Where, in world space.
    pub position: DVec3,
    /// Area × unit outward normal, world units squared.
    pub area_normal: DVec3,
}

#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Cluster {
    pub centre: DVec3,
    pub radius: f64,
    pub area_normal: DVec3,
}

/// Winding numbers of a fixed set of elements.
#[derive(Debug, Clone, Default)]
pub struct Winding {
    elements: Vec<Element>,
    /// Implicit binary tree over runs of [`LEAF`] elements; the root at 1, children of i at 2i and 2i + 1.
    clusters: Vec<Cluster>,
    leaves: usize,
}

impl Winding {
    /// Over `elements`, neighbours in the slice being neighbours in space (Morton order).
    pub fn new(elements: Vec<Element>) -> Self {
        let leaves = elements.len().div_ceil(LEAF).next_power_of_two().max(1);
        let mut clusters = vec![Cluster::default(); 2 * leaves];
        for node in (1..2 * leaves).rev() {
            // Nodes at depth d cover leaves / 2^d runs each.
            let depth = node.ilog2();
            let runs = leaves >> depth;
            let first = (node - (1 << depth)) * runs * LEAF;
            let members = &elements[first.min(elements.len())..(first + runs * LEAF).min(elements.len())];
            if members.is_empty() {
                continue;
            }
            let mut weight = 0.0;
            let mut centre = DVec3::ZERO;
            let mut area_normal = DVec3::ZERO;
            for e in members {
                let area = e.area_normal.length();
                weight += area;
                centre += e.position * area;
                area_normal += e.area_normal;
            }
            let centre = if weight > 0.0 { centre / weight } else { members[0].position };
            let radius = members.iter().map(|e| e.position.distance(centre)).fold(0.0, f64::max);
            clusters[node] = Cluster { centre, radius, area_normal };
        }
        Self { elements, clusters, leaves }
    }

    /// The winding number at `p_in_world`.
    pub fn at(&self, p_in_world: DVec3) -> f64 {
        let mut sum = 0.0;
        // Each level of the tree leaves at most one node waiting.
        let mut stack = [0_usize; usize::BITS as usize + 1];
        stack[0] = 1;
        let mut waiting = 1;
        while waiting > 0 {
            waiting -= 1;
            let node = stack[waiting];
            let cluster = &self.clusters[node];
            let to = cluster.centre - p_in_world;
            let distance = to.length();
            if distance > FAR * cluster.radius && distance > 0.0 {
                sum += cluster.area_normal.dot(to) / (distance * distance * distance);
            } else if node >= self.leaves {
                let first = (node - self.leaves) * LEAF;
                for e in &self.elements[first.min(self.elements.len())..(first + LEAF).min(self.elements.len())] {
                    let to = e.position - p_in_world;
                    let squared = to.length_squared();
                    if squared > 0.0 {
                        sum += e.area_normal.dot(to) / (squared * squared.sqrt());
                    }
                }
            } else {
                stack[waiting] = 2 * node;
                stack[waiting + 1] = 2 * node + 1;
                waiting += 2;
            }
        }
        sum / (4.0 * std::f64::consts::PI)
    }

    /// The elements, and the tree over runs of [`LEAF`] of them: the root at 1, children of i at 2i and 2i + 1.
    #[cfg(feature = "gpu")]
    pub(crate) fn parts(&self) -> (&[Element], &[Cluster]) {
        (&self.elements, &self.clusters)
    }

    /// |Σ aᵢnᵢ| / Σ aᵢ: 0 for a closed surface, 1 for a flat one.
    pub fn openness(&self) -> f64 {
        let total: f64 = self.elements.iter().map(|e| e.area_normal.length()).sum();
        if total > 0.0 { self.clusters[1].area_normal.length() / total } else { 1.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sphere(count: usize) -> Winding {
        let golden = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
        let area = 4.0 * std::f64::consts::PI / count as f64;
        Winding::new(
            (0..count)
                .map(|i| {
                    let z = 1.0 - (2 * i + 1) as f64 / count as f64;
                    let (s, c) = (golden * i as f64).sin_cos();
                    let n = DVec3::new((1.0 - z * z).sqrt() * c, (1.0 - z * z).sqrt() * s, z);
                    Element { position: n, area_normal: n * area }
                })
                .collect(),
        )
    }

    #[test]
    fn one_inside_and_nought_outside_a_sphere() {
        let winding = sphere(5000);
        for (p, expected) in [(DVec3::ZERO, 1.0), (DVec3::new(0.5, 0.3, -0.4), 1.0), (DVec3::new(0.0, 2.0, 0.0), 0.0)] {
            assert!((winding.at(p) - expected).abs() < 0.03, "{p}: {}", winding.at(p));
        }
        assert!(winding.openness() < 1e-2);
    }

    #[test]
    fn nothing_winds_around_nothing() {
        assert_eq!(Winding::new(Vec::new()).at(DVec3::ZERO), 0.0);
    }
}
