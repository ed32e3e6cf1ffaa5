//! The judge's own ray-solid crossings: root isolation on an implicit function, no closed forms.
//!
//! Every solid is a function that is negative inside and changes by at most 1 per unit of length. For a convex solid it is
//! the maximum of convex functions, hence convex along a line: golden-section search finds a point inside or proves by the
//! Lipschitz bound that there is none, and bisection finds the two crossings beside it. For a torus and a blend the line is
//! halved until each piece either is too short, for the values at its ends, to hold a zero, or is shorter than
//! [`LEAST_PIECE`]; a piece with a change of sign is then bisected.

use glam::DVec3;

use crate::geometry::solid::Solid;

/// Pieces of a line, in units of the solid's size, are not halved further. Two crossings in one piece are missed; on a
/// surface whose radius of curvature is the solid's size they enclose a depth of LEAST_PIECE²/8, about 1e-13.
const LEAST_PIECE: f64 = 1e-6;

/// A crossing is settled to this part of the solid's size.
const SETTLED: f64 = 1e-16;

/// One crossing.
#[derive(Debug, Clone, Copy)]
pub(super) struct SolidCrossing {
    /// In units of the direction given.
    pub t: f64,
    /// Outward unit normal, leaf space.
    pub normal: DVec3,
    /// False on a half-space outside its drawn square.
    pub drawn: bool,
}

/// A solid with a sphere around it.
pub(super) struct Implicit {
    solid: Solid,
    centre: DVec3,
    reach: f64,
}

/// Value and gradient of one bounding surface.
type Side = (f64, DVec3);

fn greatest<const N: usize>(sides: [Side; N]) -> Side {
    sides.into_iter().reduce(|a, b| if b.0 > a.0 { b } else { a }).unwrap_or((f64::INFINITY, DVec3::ZERO))
}

impl Implicit {
    pub fn new(solid: Solid) -> Self {
        let (centre, reach) = match &solid {
            Solid::HalfSpace { point, extent, .. } => (*point, extent * 2f64.sqrt()),
            Solid::Box { min, max } => ((min + max) / 2.0, (max - min).length() / 2.0),
            Solid::Sphere { centre, radius } => (*centre, *radius),
            Solid::Cylinder { from, to, radius } => ((from + to) / 2.0, (to - from).length() / 2.0 + radius),
            Solid::Cone { from, to, radius_from, radius_to } => {
                ((from + to) / 2.0, (to - from).length() / 2.0 + radius_from.max(*radius_to))
            }
            Solid::Torus { centre, radius, tube, .. } => (*centre, radius + tube),
            Solid::Blend { balls, smoothness } => {
                let centre = balls.iter().map(|b| b.centre).sum::<DVec3>() / balls.len() as f64;
                let far = balls.iter().map(|b| b.centre.distance(centre) + b.radius).fold(0.0, f64::max);
                (centre, far + smoothness * (balls.len() as f64).ln())
            }
        };
        // A little more, so that the sphere's own surface is outside.
        const MARGIN: f64 = 1.01;
        Self { solid, centre, reach: reach * MARGIN }
    }

    /// A box around the solid; of a half-space around what is drawn.
    pub fn drawn_bounds(&self) -> (DVec3, DVec3) {
        (self.centre - self.reach, self.centre + self.reach)
    }

    /// The function, and its gradient where it has one.
    fn evaluate(&self, p: DVec3) -> Side {
        match &self.solid {
            Solid::HalfSpace { point, normal, .. } => {
                let n = normal.normalize();
                (n.dot(p) - n.dot(*point), n)
            }
            Solid::Box { min, max } => greatest([
                (min.x - p.x, DVec3::NEG_X),
                (p.x - max.x, DVec3::X),
                (min.y - p.y, DVec3::NEG_Y),
                (p.y - max.y, DVec3::Y),
                (min.z - p.z, DVec3::NEG_Z),
                (p.z - max.z, DVec3::Z),
            ]),
            Solid::Sphere { centre, radius } => (p.distance(*centre) - radius, (p - centre).normalize_or_zero()),
            Solid::Cylinder { from, to, radius } => tapered(p, *from, *to, *radius, *radius),
            Solid::Cone { from, to, radius_from, radius_to } => tapered(p, *from, *to, *radius_from, *radius_to),
            Solid::Torus { centre, axis, radius, tube } => {
                // The distance from the nearest point of the ring, less the tube.
                let axis = axis.normalize();
                let flat = (p - centre).reject_from_normalized(axis);
                let on_ring = centre + flat.normalize_or(axis.any_orthonormal_vector()) * *radius;
                (p.distance(on_ring) - tube, (p - on_ring).normalize_or_zero())
            }
            Solid::Blend { balls, smoothness } => {
                // exp(−f/k) = Σ exp(−dᵢ/k), summed pair by pair: the smooth minimum of two is
                // min − k ln(1 + exp(−|difference|/k)).
                let mut total: Option<Side> = None;
                for ball in balls {
                    let next = (p.distance(ball.centre) - ball.radius, (p - ball.centre).normalize_or_zero());
                    total = Some(match total {
                        None => next,
                        Some(so_far) => {
                            let (low, high) = if next.0 < so_far.0 { (next, so_far) } else { (so_far, next) };
                            let ratio = ((low.0 - high.0) / smoothness).exp();
                            (low.0 - smoothness * ratio.ln_1p(), (low.1 + high.1 * ratio) / (1.0 + ratio))
                        }
                    });
                }
                total.unwrap_or((f64::INFINITY, DVec3::ZERO))
            }
        }
    }

    /// Whether the line's beginning, at t → −∞, is inside: only a half-space has one.
    pub fn begins_inside(&self, origin: DVec3, dir: DVec3) -> bool {
        match &self.solid {
            Solid::HalfSpace { normal, .. } => {
                let slope = normal.dot(dir);
                slope > 0.0 || (slope == 0.0 && self.evaluate(origin).0 < 0.0)
            }
            _ => false,
        }
    }

    /// All crossings of the line, in order.
    pub fn crossings(&self, origin: DVec3, dir: DVec3) -> Vec<SolidCrossing> {
        let length = dir.length();
        let unit = dir / length;
        if let Solid::HalfSpace { point, normal, extent } = &self.solid {
            return self.plane_crossing(origin, dir, *point, *normal, *extent);
        }
        // Everything is measured from the point nearest to the solid, in leaf units.
        let middle = (self.centre - origin).dot(unit);
        let start = origin + unit * middle;
        let half_squared = self.reach.powi(2) - start.distance_squared(self.centre);
        if !(half_squared > 0.0) {
            return Vec::new();
        }
        let half = half_squared.sqrt();
        let f = |s: f64| self.evaluate(start + unit * s).0;
        let mut roots = Vec::new();
        match self.solid {
            Solid::Torus { .. } | Solid::Blend { .. } => {
                let least = LEAST_PIECE * self.reach;
                isolate(&f, (-half, f(-half)), (half, f(half)), least, SETTLED * self.reach, &mut roots);
            }
            _ => {
                if let Some(within) = point_inside(&f, -half, half, SETTLED * self.reach) {
                    roots.push(bisect(&f, -half, within, SETTLED * self.reach));
                    roots.push(bisect(&f, within, half, SETTLED * self.reach));
                }
            }
        }
        let crossing = |s: f64| SolidCrossing {
            t: (middle + s) / length,
            normal: self.evaluate(start + unit * s).1.normalize_or(unit),
            drawn: true,
        };
        roots.into_iter().map(crossing).collect()
    }

    fn plane_crossing(
        &self,
        origin: DVec3,
        dir: DVec3,
        point: DVec3,
        normal: DVec3,
        extent: f64,
    ) -> Vec<SolidCrossing> {
        let normal = normal.normalize();
        let slope = normal.dot(dir);
        let t = normal.dot(point - origin) / slope;
        if slope == 0.0 || !t.is_finite() {
            return Vec::new();
        }
        let aside = origin + dir * t - point;
        let (u, v) = normal.any_orthonormal_pair();
        let drawn = aside.dot(u).abs() <= extent && aside.dot(v).abs() <= extent;
        vec![SolidCrossing { t, normal, drawn }]
    }
}

/// A capped cone: below the tilted side, above the base, below the top.
fn tapered(p: DVec3, from: DVec3, to: DVec3, r_from: f64, r_to: f64) -> Side {
    let height = from.distance(to);
    let axis = (to - from) / height;
    let foot = (p - from).project_onto_normalized(axis);
    let z = (p - from).dot(axis);
    let away = p - from - foot;
    let taper = (r_to - r_from) / height;
    let steepness = 1.0 / taper.hypot(1.0);
    greatest([
        ((away.length() - r_from - taper * z) * steepness, (away.normalize_or_zero() - axis * taper) * steepness),
        (-z, -axis),
        (z - height, axis),
    ])
}

/// A point where the convex function `f` of slope at most 1 is negative, by golden-section search in `a..b`.
fn point_inside(f: &impl Fn(f64) -> f64, mut a: f64, mut b: f64, settled: f64) -> Option<f64> {
    const GOLDEN: f64 = 0.618_033_988_749_894_9;
    let (mut low, mut high) = (b - GOLDEN * (b - a), a + GOLDEN * (b - a));
    let (mut f_low, mut f_high) = (f(low), f(high));
    while b - a > settled {
        if f_low < 0.0 {
            return Some(low);
        }
        if f_high < 0.0 {
            return Some(high);
        }
        // No point of a..b is further than (1 − GOLDEN)(b − a) from one of the two.
        if f_low.min(f_high) > (1.0 - GOLDEN) * (b - a) {
            return None;
        }
        if f_low < f_high {
            (b, high, f_high) = (high, low, f_low);
            low = b - GOLDEN * (b - a);
            f_low = f(low);
        } else {
            (a, low, f_low) = (low, high, f_high);
            high = a + GOLDEN * (b - a);
            f_high = f(high);
        }
        if !(a < low && low < high && high < b) {
            return None; // the numbers have run out: at most a touch
        }
    }
    None
}

/// The change of sign between `a` and `b`, by halving.
fn bisect(f: &impl Fn(f64) -> f64, mut a: f64, mut b: f64, settled: f64) -> f64 {
    let a_inside = f(a) < 0.0;
    while b - a > settled {
        let middle = (a + b) / 2.0;
        if middle <= a || middle >= b {
            break;
        }
        if (f(middle) < 0.0) == a_inside { a = middle } else { b = middle }
    }
    (a + b) / 2.0
}

/// All changes of sign between `a` and `b`, given with their values; the slope of `f` is at most 1.
fn isolate(f: &impl Fn(f64) -> f64, a: (f64, f64), b: (f64, f64), least: f64, settled: f64, roots: &mut Vec<f64>) {
    let changes = (a.1 < 0.0) != (b.1 < 0.0);
    let length = b.0 - a.0;
    // To reach zero from both ends takes |f(a)| + |f(b)|.
    if !changes && a.1.abs() + b.1.abs() > length {
        return;
    }
    if length <= least {
        if changes {
            roots.push(bisect(f, a.0, b.0, settled));
        }
        return;
    }
    let middle = (a.0 + b.0) / 2.0;
    let middle = (middle, f(middle));
    isolate(f, a, middle, least, settled, roots);
    isolate(f, middle, b, least, settled, roots);
}
