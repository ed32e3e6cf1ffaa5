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
}
