//! A point cloud as a file holds it, in leaf space.

use glam::{DVec3, Vec3};

use super::mesh::PositionTable;

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
    /// Unit normals in leaf space, outward; [`PointCloud::NO_NORMAL`] where the file has none for that point.
    pub normals: Option<Vec<Vec3>>,
    /// Radii in leaf units, positive and finite once loaded.
    pub radii: Option<Vec<f32>>,
    /// Tangent ellipses (Gaussian splats); they win over `radii`.
    pub ellipses: Option<Vec<Ellipse>>,
    /// sRGB colours, 0 to 255.
    pub colours: Option<Vec<[u8; 3]>>,
    /// Opacities, 0 to 1.
    pub opacities: Option<Vec<f32>>,
}

impl PointCloud {
    /// What stands in `normals` for a point whose normal is missing.
    pub const NO_NORMAL: Vec3 = Vec3::ZERO;

    /// The number of points.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Whether there is no point.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// The normal of point `index` in leaf space, unless it is missing.
    pub fn normal(&self, index: usize) -> Option<Vec3> {
        self.normals.as_ref().map(|normals| normals[index]).filter(|&n| n != Self::NO_NORMAL)
    }

    /// How many points lie at exactly the position of an earlier point.
    pub fn duplicates(&self) -> usize {
        let mut table = PositionTable::with_capacity(self.len());
        (0..self.len()).filter(|&i| table.find_or_insert(&self.positions, i as u32) != i as u32).count()
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn duplicates_are_counted_beyond_the_first() {
        let at = |x: f64| DVec3::new(x, 1.0, 2.0);
        let cloud = PointCloud { positions: vec![at(0.0), at(1.0), at(-0.0), at(1.0), at(1.0)], ..Default::default() };
        assert_eq!(cloud.duplicates(), 3);
    }

    #[test]
    fn retain_filters_every_attribute() {
        let mut cloud = PointCloud {
            positions: vec![DVec3::X, DVec3::Y, DVec3::Z],
            normals: Some(vec![Vec3::X, PointCloud::NO_NORMAL, Vec3::Z]),
            colours: Some(vec![[1; 3], [2; 3], [3; 3]]),
            ..Default::default()
        };
        cloud.retain(|i| i != 0);
        assert_eq!(cloud.positions, [DVec3::Y, DVec3::Z]);
        assert_eq!((cloud.normal(0), cloud.normal(1)), (None, Some(Vec3::Z)));
        assert_eq!(cloud.colours, Some(vec![[2; 3], [3; 3]]));
    }
}
