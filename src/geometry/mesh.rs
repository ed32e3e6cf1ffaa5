//! A triangle mesh as a file holds it, in leaf space.

use glam::DVec3;

/// An indexed triangle mesh. Corners run anticlockwise seen from outside.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TriMesh {
    /// Vertices in leaf space, leaf units. Finite once loaded; identical positions are one vertex.
    pub positions: Vec<DVec3>,
    /// Three vertex indices a triangle, each below `positions.len()`.
    pub triangles: Vec<[u32; 3]>,
    /// sRGB colours of the vertices, 0 to 255, as long as `positions` where present.
    pub colours: Option<Vec<[u8; 3]>>,
}

impl TriMesh {
    /// The corners of triangle `index`, in leaf space.
    pub fn corners(&self, index: usize) -> [DVec3; 3] {
        self.triangles[index].map(|v| self.positions[v as usize])
    }

    /// Surface area in squared leaf units.
    pub fn area(&self) -> f64 {
        let twice = |t: usize| {
            let [a, b, c] = self.corners(t);
            (b - a).cross(c - a).length()
        };
        0.5 * (0..self.triangles.len()).map(twice).sum::<f64>()
    }

    /// Signed volume in cubed leaf units; negative where the mesh is inside-out, meaningless where it is open.
    pub fn signed_volume(&self) -> f64 {
        let anchor = self.positions.first().copied().unwrap_or_default();
        let six_volumes: f64 = (0..self.triangles.len())
            .map(|t| {
                let [a, b, c] = self.corners(t).map(|p| p - anchor);
                a.dot(b.cross(c))
            })
            .sum();
        six_volumes / 6.0
    }

    /// Whether every edge is used as often one way as the other, so that every line crosses the mesh an even number of times. Each
    /// edge adds a number of its own, one way, or takes it away, the other: what is left of a closed mesh is nothing, and of an
    /// open one something, but for a chance of 1 in 2^64.
    pub fn is_closed(&self) -> bool {
        let of_edge = |from: u32, to: u32| {
            // Steele, Lea and Flood's splitmix64.
            let edge = u64::from(from.min(to)) << 32 | u64::from(from.max(to));
            let mut mixed = edge.wrapping_add(0x9E37_79B9_7F4A_7C15);
            mixed = (mixed ^ mixed >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
            mixed = (mixed ^ mixed >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
            mixed ^= mixed >> 31;
            if from < to { mixed } else { mixed.wrapping_neg() }
        };
        let add = |sum: u64, &[a, b, c]: &[u32; 3]| {
            sum.wrapping_add(of_edge(a, b)).wrapping_add(of_edge(b, c)).wrapping_add(of_edge(c, a))
        };
        self.triangles.iter().fold(0, add) == 0
    }

    /// Whether the faces look inwards: the mesh encloses a negative volume. Of an open mesh the volume is that between its
    /// faces and the middle of its box, and must be more than nothing beside its area and size: a sheet encloses none.
    pub fn is_inside_out(&self) -> bool {
        const LEAST_SHARE: f64 = 0.02; // a ball has 1/6, a cube 0.1
        let corners = || (0..self.triangles.len()).flat_map(|t| self.corners(t));
        let (low, high) = corners().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(a, b), p| (a.min(p), b.max(p)));
        let middle = 0.5 * (low + high);
        let six_volumes: f64 = (0..self.triangles.len())
            .map(|t| {
                let [a, b, c] = self.corners(t).map(|p| p - middle);
                a.dot(b.cross(c))
            })
            .sum();
        let least = if self.is_closed() { 0.0 } else { LEAST_SHARE * self.area() * (high - low).length() };
        six_volumes / 6.0 < -least
    }

    /// Joins vertices at exactly the same position (the first one's colour stays); returns how many vanished.
    /// Vertices that are not finite stay apart.
    ///
    /// # Panics
    /// If there are more vertices than a `u32` can number.
    pub fn weld(&mut self) -> usize {
        assert!(u32::try_from(self.positions.len()).is_ok(), "vertices are numbered by u32");
        let mut table = PositionTable::with_capacity(self.positions.len());
        let first: Vec<u32> =
            (0..self.positions.len() as u32).map(|v| table.find_or_insert(&self.positions, v)).collect();
        self.triangles.as_flattened_mut().iter_mut().for_each(|v| *v = first[*v as usize]);
        self.keep_vertices(|v| first[v] == v as u32)
    }

    /// Removes the triangles that use a vertex twice; returns how many.
    pub fn drop_degenerate(&mut self) -> usize {
        let before = self.triangles.len();
        self.triangles.retain(|&[a, b, c]| a != b && b != c && c != a);
        before - self.triangles.len()
    }

    /// Removes the vertices that no triangle uses; returns how many.
    pub fn drop_unreferenced(&mut self) -> usize {
        let mut used = vec![false; self.positions.len()];
        self.triangles.as_flattened().iter().for_each(|&v| used[v as usize] = true);
        self.keep_vertices(|v| used[v])
    }

    /// The triangles whose corners differ and yet lie on one line, as far as `f64` can tell.
    pub fn count_flat(&self) -> usize {
        let is_flat = |t: &usize| {
            let [a, b, c] = self.corners(*t);
            (b - a).cross(c - a) == DVec3::ZERO
        };
        (0..self.triangles.len()).filter(is_flat).count()
    }

    /// Removes the vertices that `keep` refuses, none of which a triangle may use, and renumbers; returns how many.
    fn keep_vertices(&mut self, keep: impl Fn(usize) -> bool) -> usize {
        let before = self.positions.len();
        let mut kept = 0;
        let renumbered: Vec<u32> = (0..before)
            .map(|v| {
                kept += u32::from(keep(v));
                kept.wrapping_sub(1)
            })
            .collect();
        if kept as usize == before {
            return 0;
        }
        self.triangles.as_flattened_mut().iter_mut().for_each(|v| *v = renumbered[*v as usize]);
        let mut v = 0..before;
        self.positions.retain(|_| v.next().is_some_and(&keep));
        let mut v = 0..before;
        self.colours.iter_mut().for_each(|colours| colours.retain(|_| v.next().is_some_and(&keep)));
        before - self.positions.len()
    }
}

/// Finds, among numbered positions, the first one that is exactly equal to a given one. −0 equals +0; NaN equals nothing.
///
/// An open-addressing table of numbers alone: 4 to 8 bytes a position, where a `HashMap` keyed by coordinates takes 40.
#[derive(Debug, Clone)]
pub struct PositionTable {
    /// A position's number, or [`Self::FREE`]. A power of two long, at most half full.
    slots: Vec<u32>,
    filled: usize,
}

impl PositionTable {
    const FREE: u32 = u32::MAX;

    /// A table with room for `positions` different positions; it grows beyond.
    pub fn with_capacity(positions: usize) -> Self {
        Self { slots: vec![Self::FREE; (2 * positions).next_power_of_two().max(16)], filled: 0 }
    }

    /// The number of the first position inserted that equals `positions[candidate]`; `candidate` itself, which is then
    /// inserted, if there is none. All calls must show the same positions, at least as far as the greatest candidate.
    pub fn find_or_insert(&mut self, positions: &[DVec3], candidate: u32) -> u32 {
        if 2 * (self.filled + 1) > self.slots.len() {
            self.grow(positions);
        }
        let p = positions[candidate as usize];
        if p.is_nan() {
            return candidate; // equal to nothing, so nobody will look for it
        }
        let mask = self.slots.len() - 1;
        let mut slot = Self::hash(p) as usize & mask;
        loop {
            let found = self.slots[slot];
            if found == Self::FREE {
                self.slots[slot] = candidate;
                self.filled += 1;
                return candidate;
            }
            if positions[found as usize] == p {
                return found;
            }
            slot = (slot + 1) & mask;
        }
    }

    fn grow(&mut self, positions: &[DVec3]) {
        let old = std::mem::take(&mut self.slots);
        self.slots = vec![Self::FREE; 2 * old.len()];
        let mask = self.slots.len() - 1;
        for number in old.into_iter().filter(|&number| number != Self::FREE) {
            let mut slot = Self::hash(positions[number as usize]) as usize & mask;
            while self.slots[slot] != Self::FREE {
                slot = (slot + 1) & mask;
            }
            self.slots[slot] = number;
        }
    }

    /// Spreads positions over 64 bits. Lattices and planes are the common case, and their coordinates differ in few bits,
    /// so each coordinate passes a full multiply-and-fold.
    fn hash(p: DVec3) -> u64 {
        /// An odd number without pattern: 2⁶⁴ divided by the golden ratio.
        const ODD: u64 = 0x9e37_79b9_7f4a_7c15;
        let fold = |a: u64, b: u64| {
            let product = u128::from(a) * u128::from(b);
            (product as u64) ^ ((product >> 64) as u64)
        };
        // Adding +0 turns −0 into +0.
        (p + DVec3::ZERO).to_array().iter().fold(ODD, |hash, c| fold(hash ^ c.to_bits(), ODD).wrapping_add(ODD))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A unit tetrahedron, every triangle with corners of its own: volume 1/6.
    fn tetrahedron_soup() -> TriMesh {
        let corners = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
        let faces = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
        let positions: Vec<_> = faces.as_flattened().iter().map(|&v: &usize| corners[v]).collect();
        TriMesh { positions, triangles: (0..4).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect(), colours: None }
    }

    #[test]
    fn welding_a_soup_leaves_its_corners_and_its_volume() {
        let mut mesh = tetrahedron_soup();
        assert_eq!(mesh.weld(), 8);
        assert_eq!(mesh.positions.len(), 4);
        assert!((mesh.signed_volume() - 1.0 / 6.0).abs() < 1e-15);
        assert_eq!(mesh.weld(), 0);
    }

    #[test]
    fn welding_keeps_colours_beside_their_vertices_and_nan_apart() {
        let nan = DVec3::new(f64::NAN, 0.0, 0.0);
        let mut mesh = TriMesh {
            positions: vec![DVec3::X, nan, DVec3::X, DVec3::Y, nan, DVec3::new(0.0, -0.0, 1.0), DVec3::Z],
            triangles: vec![[2, 3, 6], [0, 1, 4]],
            colours: Some((0..7).map(|v| [v; 3]).collect()),
        };
        assert_eq!(mesh.weld(), 2);
        assert_eq!(mesh.colours, Some(vec![[0; 3], [1; 3], [3; 3], [4; 3], [5; 3]]));
        assert_eq!(mesh.triangles, [[0, 2, 4], [0, 1, 3]]);
    }

    #[test]
    fn what_nothing_uses_goes() {
        let mut mesh = tetrahedron_soup();
        mesh.triangles = vec![[0, 1, 0], [3, 4, 5], [3, 3, 3]];
        assert_eq!(mesh.drop_degenerate(), 2);
        assert_eq!(mesh.drop_unreferenced(), 9);
        assert_eq!(mesh.triangles, [[0, 1, 2]]);
        assert_eq!(mesh.corners(0), [DVec3::ZERO, DVec3::X, DVec3::Z]);
        assert_eq!(mesh.count_flat(), 0);
        mesh.positions[2] = DVec3::X * 5.0;
        assert_eq!(mesh.count_flat(), 1);
    }

    #[test]
    fn the_table_grows_and_finds_a_lattice_again() {
        let side = 20_u32;
        let lattice: Vec<DVec3> = (0..side.pow(3))
            .map(|i| DVec3::new(f64::from(i % side), f64::from(i / side % side), f64::from(i / side / side)))
            .collect();
        let twice = [lattice.clone(), lattice.clone()].concat();
        let mut table = PositionTable::with_capacity(0);
        for i in 0..twice.len() as u32 {
            assert_eq!(table.find_or_insert(&twice, i), i % side.pow(3));
        }
    }
}
