//! Analytic solids in leaf space: what the user may write without a file.
//!
//! A solid answers the pipelines' exact questions in `f64`: is a point inside ([`Solid::contains`]), how far is the
//! surface at least ([`Solid::signed_distance_bound`]), which way is out ([`Solid::normal`]), where does a line cross the
//! surface ([`Solid::intersect`]), and points all over the surface ([`Solid::patches`], [`Solid::sample_random`]). Inside
//! means a negative signed distance: the surface itself counts as outside.
//!
//! The methods expect a solid that passed [`Solid::validate`]; on another they return, but what they return means nothing.

use glam::{DVec2, DVec3};

mod blend;
mod intersect;
mod patch;
mod tessellate;
#[cfg(test)]
mod tests;

use blend::BlendField;
pub use intersect::Hit;
pub use patch::{COVER, Patch, SurfacePoint};
pub use tessellate::TessellateError;

/// One ball of a [`Solid::Blend`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ball {
    /// Centre, leaf units.
    pub centre: DVec3,
    /// Radius, leaf units, positive.
    pub radius: f64,
}

/// A closed solid given by a formula. Lengths in leaf units; axes may have any length but zero, and
/// are normalised where they are used.
#[derive(Debug, Clone, PartialEq)]
pub enum Solid {
    /// All points p with (p − point) · normal < 0. Infinite; drawn as far as `extent` from `point`, in its plane: on
    /// the square whose sides run along the unit normal's `any_orthonormal_pair`.
    HalfSpace {
        /// A point of the boundary plane.
        point: DVec3,
        /// Outward normal, of any length but zero.
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
        /// Axis of revolution, of any length but zero.
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

/// Why a solid cannot be used, and what would mend it. Fields are named as they are written in a scene.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SolidError {
    /// A number is NaN or infinite.
    #[error("`{field}` is not a finite number: write a finite one")]
    NotFinite {
        /// Which.
        field: String,
    },
    /// A length must be positive.
    #[error("`{field}` must be greater than 0, not {value}")]
    NotPositive {
        /// Which.
        field: String,
        /// What was written.
        value: f64,
    },
    /// A radius of a cone is negative, or both are zero.
    #[error("a cone's radii must be 0 or more and not both 0, not {radius_from} and {radius_to}")]
    ConeRadii {
        /// Radius at `from`.
        radius_from: f64,
        /// Radius at `to`.
        radius_to: f64,
    },
    /// A direction has no length.
    #[error("`{field}` has no length: give a direction, such as [0, 0, 1]")]
    NoDirection {
        /// Which.
        field: String,
    },
    /// `from` and `to` coincide.
    #[error("`from` and `to` are the same point: move one of them along the axis")]
    NoAxis,
    /// A box is flat or inside-out.
    #[error("the box is empty along {axis}: `min` is {min} and `max` is {max}; `max` must be greater")]
    EmptyBox {
        /// `x`, `y` or `z`.
        axis: char,
        /// Least coordinate.
        min: f64,
        /// Greatest coordinate.
        max: f64,
    },
    /// The tube of a torus reaches its axis.
    #[error("the torus' `tube` ({tube}) must be less than its `radius` ({radius}): only ring tori are solids here")]
    TubeTooThick {
        /// Radius of the tube.
        tube: f64,
        /// Radius of the ring's centre line.
        radius: f64,
    },
    /// A blend of nothing.
    #[error("`balls` is empty: a blend needs at least one ball")]
    NoBalls,
}

fn finite(field: &str, value: f64) -> Result<(), SolidError> {
    if value.is_finite() { Ok(()) } else { Err(SolidError::NotFinite { field: field.into() }) }
}

fn finite_point(field: &str, value: DVec3) -> Result<(), SolidError> {
    if value.is_finite() { Ok(()) } else { Err(SolidError::NotFinite { field: field.into() }) }
}

fn positive(field: &str, value: f64) -> Result<(), SolidError> {
    finite(field, value)?;
    if value > 0.0 { Ok(()) } else { Err(SolidError::NotPositive { field: field.into(), value }) }
}

fn direction(field: &str, value: DVec3) -> Result<(), SolidError> {
    finite_point(field, value)?;
    match value.try_normalize() {
        Some(_) => Ok(()),
        None => Err(SolidError::NoDirection { field: field.into() }),
    }
}

impl Solid {
    /// Checks every number.
    ///
    /// # Errors
    /// [`SolidError`] names the first unusable field and what would mend it.
    pub fn validate(&self) -> Result<(), SolidError> {
        match self {
            Self::HalfSpace { point, normal, extent } => {
                finite_point("point", *point)?;
                direction("normal", *normal)?;
                positive("extent", *extent)
            }
            Self::Box { min, max } => {
                finite_point("min", *min)?;
                finite_point("max", *max)?;
                for (axis, min, max) in [('x', min.x, max.x), ('y', min.y, max.y), ('z', min.z, max.z)] {
                    if !(min < max) {
                        return Err(SolidError::EmptyBox { axis, min, max });
                    }
                }
                Ok(())
            }
            Self::Sphere { centre, radius } => {
                finite_point("centre", *centre)?;
                positive("radius", *radius)
            }
            Self::Cylinder { from, to, radius } => {
                finite_point("from", *from)?;
                finite_point("to", *to)?;
                positive("radius", *radius)?;
                (*to - *from).try_normalize().map(|_| ()).ok_or(SolidError::NoAxis)
            }
            Self::Cone { from, to, radius_from, radius_to } => {
                finite_point("from", *from)?;
                finite_point("to", *to)?;
                finite("radius_from", *radius_from)?;
                finite("radius_to", *radius_to)?;
                if !(*radius_from >= 0.0 && *radius_to >= 0.0 && radius_from + radius_to > 0.0) {
                    return Err(SolidError::ConeRadii { radius_from: *radius_from, radius_to: *radius_to });
                }
                (*to - *from).try_normalize().map(|_| ()).ok_or(SolidError::NoAxis)
            }
            Self::Torus { centre, axis, radius, tube } => {
                finite_point("centre", *centre)?;
                direction("axis", *axis)?;
                positive("radius", *radius)?;
                positive("tube", *tube)?;
                if tube < radius { Ok(()) } else { Err(SolidError::TubeTooThick { tube: *tube, radius: *radius }) }
            }
            Self::Blend { balls, smoothness } => {
                if balls.is_empty() {
                    return Err(SolidError::NoBalls);
                }
                for (i, ball) in balls.iter().enumerate() {
                    finite_point(&format!("balls[{i}].centre"), ball.centre)?;
                    positive(&format!("balls[{i}].radius"), ball.radius)?;
                }
                positive("smoothness", *smoothness)
            }
        }
    }

    /// Least and greatest corner of a box around the solid, leaf space; `None` for a half-space, which has none. Tight but
    /// for a blend, whose box holds it with a margin of at most `smoothness · ln(number of balls)`.
    pub fn bounds(&self) -> Option<(DVec3, DVec3)> {
        /// How far a disk of unit radius across `axis` reaches along x, y and z.
        fn disk_reach(axis: DVec3) -> DVec3 {
            let a = axis.normalize_or_zero();
            (DVec3::ONE - a * a).max(DVec3::ZERO).map(f64::sqrt)
        }
        match self {
            Self::HalfSpace { .. } => None,
            Self::Box { min, max } => Some((*min, *max)),
            Self::Sphere { centre, radius } => Some((centre - *radius, centre + *radius)),
            Self::Cylinder { from, to, radius } => {
                let reach = disk_reach(to - from) * *radius;
                Some((from.min(*to) - reach, from.max(*to) + reach))
            }
            Self::Cone { from, to, radius_from, radius_to } => {
                let reach = disk_reach(to - from);
                let (a, b) = (reach * *radius_from, reach * *radius_to);
                Some(((from - a).min(to - b), (from + a).max(to + b)))
            }
            Self::Torus { centre, axis, radius, tube } => {
                let reach = disk_reach(*axis) * *radius + *tube;
                Some((centre - reach, centre + reach))
            }
            Self::Blend { balls, smoothness } => Some(BlendField::new(balls, *smoothness).bounds()),
        }
    }

    /// As [`Self::bounds`], and for a half-space the square of its plane that is drawn.
    pub fn drawn_bounds(&self) -> (DVec3, DVec3) {
        match (self.bounds(), self) {
            (Some(bounds), _) => bounds,
            (None, Self::HalfSpace { point, normal, extent }) => {
                let (u, v) = normal.normalize_or(DVec3::Z).any_orthonormal_pair();
                let reach = (u.abs() + v.abs()) * *extent;
                (point - reach, point + reach)
            }
            (None, _) => (DVec3::ZERO, DVec3::ZERO), // only a half-space has no bounds
        }
    }

    /// Whether `p` (leaf space) is inside: strictly, so a point of the surface is outside.
    pub fn contains(&self, p: DVec3) -> bool {
        self.signed_distance_bound(p) < 0.0
    }

    /// Negative inside, positive outside, zero on the surface, and never further from zero than the surface is from `p`
    /// (leaf space and units). The exact distance for all but a blend, where it is the blend's f.
    pub fn signed_distance_bound(&self, p: DVec3) -> f64 {
        self.distance_and_normal(p).0
    }

    /// Unit normal at the surface point nearest to `p`, outward, leaf space; for a blend the direction of f's gradient at
    /// `p`. Where several points are nearest (the centre of a sphere, an edge seen from outside) it is one of those possible.
    pub fn normal(&self, p: DVec3) -> DVec3 {
        self.distance_and_normal(p).1
    }

    /// [`Self::signed_distance_bound`] and [`Self::normal`] at once.
    pub fn distance_and_normal(&self, p: DVec3) -> (f64, DVec3) {
        match self {
            Self::HalfSpace { point, normal, .. } => {
                let n = normal.normalize_or(DVec3::Z);
                ((p - *point).dot(n), n)
            }
            Self::Box { min, max } => box_distance(p, *min, *max),
            Self::Sphere { centre, radius } => {
                let e = p - *centre;
                (e.length() - radius, e.normalize_or(DVec3::Z))
            }
            Self::Cylinder { from, to, radius } => Frustum::new(*from, *to, *radius, *radius).distance(p),
            Self::Cone { from, to, radius_from, radius_to } => {
                Frustum::new(*from, *to, *radius_from, *radius_to).distance(p)
            }
            Self::Torus { centre, axis, radius, tube } => {
                let about = Axial::new(*centre, *axis, p);
                let e = DVec2::new(about.rho - radius, about.z);
                (e.length() - tube, about.lift(e.normalize_or(DVec2::X)))
            }
            Self::Blend { balls, smoothness } => {
                let (f, gradient) = BlendField::new(balls, *smoothness).value_and_gradient(p);
                (f, gradient.normalize_or(DVec3::Z))
            }
        }
    }
}

/// Signed distance to a box and the normal at its nearest point.
fn box_distance(p: DVec3, min: DVec3, max: DVec3) -> (f64, DVec3) {
    let e = p - 0.5 * (min + max);
    let side = e.map(|x| if x < 0.0 { -1.0 } else { 1.0 });
    // Per axis from the nearer face, so that a point on a face of the box as written is at exactly 0.
    let beyond = (min - p).max(p - max);
    let axis_of = |v: DVec3| match v.max_position() {
        0 => DVec3::X,
        1 => DVec3::Y,
        _ => DVec3::Z,
    };
    let out = beyond.max(DVec3::ZERO);
    let d = out.length();
    if d > 0.0 {
        (d, (out * side).normalize_or(axis_of(beyond) * side))
    } else {
        (beyond.max_element(), axis_of(beyond) * side)
    }
}

/// A point in cylinder coordinates about an axis.
struct Axial {
    /// Unit axis.
    axis: DVec3,
    /// Unit direction away from the axis; any across it where the point lies on the axis.
    away: DVec3,
    /// Distance from the axis.
    rho: f64,
    /// Height along the axis.
    z: f64,
}

impl Axial {
    fn new(foot: DVec3, axis: DVec3, p: DVec3) -> Self {
        let axis = axis.normalize_or(DVec3::Z);
        let e = p - foot;
        let z = e.dot(axis);
        let across = e - axis * z;
        let rho = across.length();
        let away = if rho > 0.0 { across / rho } else { axis.any_orthonormal_vector() };
        Self { axis, away, rho, z }
    }

    /// A direction of the half-plane (away, along) in leaf space.
    fn lift(&self, v: DVec2) -> DVec3 {
        self.away * v.x + self.axis * v.y
    }
}

/// A capped cylinder or cone: radius `r0` at `from`, `r1` at height `h` along the unit `axis`.
#[derive(Debug, Clone, Copy)]
struct Frustum {
    from: DVec3,
    axis: DVec3,
    h: f64,
    r0: f64,
    r1: f64,
}

impl Frustum {
    fn new(from: DVec3, to: DVec3, r0: f64, r1: f64) -> Self {
        let h = (to - from).length();
        Self { from, axis: (to - from) / h, h, r0, r1 }
    }

    /// Outward normal of the side in the half-plane (away from the axis, along it).
    fn side_normal(&self) -> DVec2 {
        DVec2::new(self.h, self.r0 - self.r1).normalize_or(DVec2::X)
    }

    /// Signed distance and normal: everything happens in the half-plane (away, along), where the solid is the convex
    /// polygon (0, 0), (r0, 0), (r1, h), (0, h).
    fn distance(&self, p: DVec3) -> (f64, DVec3) {
        let about = Axial::new(self.from, self.axis, p);
        let q = DVec2::new(about.rho, about.z);
        let side_normal = self.side_normal();
        let (base, top) = (DVec2::new(self.r0, 0.0), DVec2::new(self.r1, self.h));
        // The three bounding lines: signed distance, normal, and the piece of the line that is the solid's.
        let lines = [
            (-q.y, DVec2::NEG_Y, DVec2::ZERO, base),
            (q.y - self.h, DVec2::Y, DVec2::new(0.0, self.h), top),
            ((q - base).dot(side_normal), side_normal, base, top),
        ];
        let deepest = lines.iter().fold(lines[0], |a, b| if b.0 > a.0 { *b } else { a });
        if deepest.0 <= 0.0 {
            return (deepest.0, about.lift(deepest.1));
        }
        let mut nearest = (f64::INFINITY, DVec2::ZERO, DVec2::Y);
        for (_, n, a, b) in lines {
            let along = ((q - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
            // A cap of radius zero is a point: its parameter is 0/0.
            let e = q - a - (b - a) * if along.is_finite() { along } else { 0.0 };
            if e.length() < nearest.0 {
                nearest = (e.length(), e, n);
            }
        }
        let (d, e, n) = nearest;
        (d, about.lift(if d > 0.0 { e / d } else { n }))
    }
}
