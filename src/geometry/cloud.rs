//! A point cloud as a file holds it, in leaf space.

use glam::{DVec3, Vec3};

/// The tangent ellipse of a point that comes with one (Gaussian splats): two perpendicular semi-axes in leaf space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ellipse {
    /// First semi-axis: direction and length, leaf units.
    pub axis_u: Vec3,
    /// Second semi-axis, perpendicular to the first.
    pub axis_v: Vec3,
}

/// Points with whatever else their file said of them. Every `Option` is either absent or as long as `positions`.
///
/// Positions are `f64`: scans lie far from the origin (map coordinates), and `f32` there loses millimetres.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PointCloud {
    /// Positions in leaf space, leaf units. Finite once loaded.
    pub positions: Vec<DVec3>,
    /// Unit normals in leaf space, outward.
    pub normals: Option<Vec<Vec3>>,
    /// Radii in leaf units.
    pub radii: Option<Vec<f32>>,
    /// Tangent ellipses (Gaussian splats); they win over `radii`.
    pub ellipses: Option<Vec<Ellipse>>,
    /// sRGB colours, 0 to 255.
    pub colours: Option<Vec<[u8; 3]>>,
    /// Opacities, 0 to 1.
    pub opacities: Option<Vec<f32>>,
}

impl PointCloud {
    /// The number of points.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Whether there is no point.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// Keeps the points whose index satisfies `keep`, in every attribute.
    pub fn retain(&mut self, keep: impl Fn(usize) -> bool) {
        fn filter<T>(values: &mut Vec<T>, keep: &impl Fn(usize) -> bool) {
            let mut index = 0;
            values.retain(|_| {
                index += 1;
                keep(index - 1)
            });
        }
        filter(&mut self.positions, &keep);
        self.normals.iter_mut().for_each(|v| filter(v, &keep));
        self.radii.iter_mut().for_each(|v| filter(v, &keep));
        self.ellipses.iter_mut().for_each(|v| filter(v, &keep));
        self.colours.iter_mut().for_each(|v| filter(v, &keep));
        self.opacities.iter_mut().for_each(|v| filter(v, &keep));
    }
}
