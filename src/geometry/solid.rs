//! Analytic solids in leaf space: what the user may write without a file.

use glam::DVec3;

/// One ball of a [`Solid::Blend`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ball {
    /// Centre, leaf units.
    pub centre: DVec3,
    /// Radius, leaf units, positive.
    pub radius: f64,
}

/// A closed solid given by a formula. Lengths in leaf units; axes are normalised by [`Solid::validate`]'s callers.
#[derive(Debug, Clone, PartialEq)]
pub enum Solid {
    /// All points p with (p − point) · normal ≤ 0. Infinite; drawn as far as `extent` from `point`, in its plane.
    HalfSpace {
        /// A point of the boundary plane.
        point: DVec3,
        /// Outward unit normal.
        normal: DVec3,
        /// Half the side of the square of the boundary plane that is sampled and drawn.
        extent: f64,
    },
    /// An axis-aligned box.
    Box {
        /// Least corner.
        min: DVec3,
        /// Greatest corner.
        max: DVec3,
    },
    /// A ball; an ellipsoid by an uneven scale.
    Sphere {
        /// Centre.
        centre: DVec3,
        /// Radius.
        radius: f64,
    },
    /// A capped circular cylinder.
    Cylinder {
        /// Centre of one cap.
        from: DVec3,
        /// Centre of the other.
        to: DVec3,
        /// Radius.
        radius: f64,
    },
    /// A capped circular cone or frustum; one of the radii may be zero.
    Cone {
        /// Centre of one cap.
        from: DVec3,
        /// Centre of the other.
        to: DVec3,
        /// Radius at `from`.
        radius_from: f64,
        /// Radius at `to`.
        radius_to: f64,
    },
    /// A ring torus.
    Torus {
        /// Centre.
        centre: DVec3,
        /// Unit axis of revolution.
        axis: DVec3,
        /// Radius of the ring's centre line.
        radius: f64,
        /// Radius of the tube, less than `radius`.
        tube: f64,
    },
    /// Balls melted into one smooth body: f(p) = −k ln Σ exp(−(|p − cᵢ| − rᵢ)/k) ≤ 0 with k = `smoothness`, the
    /// logarithmic smooth minimum of the balls' signed distances (its gradient is never longer than 1).
    Blend {
        /// The balls; at least one.
        balls: Vec<Ball>,
        /// Length over which they melt; positive.
        smoothness: f64,
    },
}
