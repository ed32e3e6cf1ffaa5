//! Where a line crosses the surface of a solid.
//!
//! All solids but the torus and the blend are convex: a line meets them in one interval, which is the intersection of the
//! intervals of their bounding surfaces. Interval arithmetic, unlike testing every face's hit by itself, cannot lose a line
//! that passes exactly through an edge.

use glam::DVec3;

use super::{Axial, BlendField, Frustum, Solid};

/// One crossing of a line and a solid's surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// The line's parameter, in units of the direction's length.
    pub t: f64,
    /// Outward unit normal in leaf space.
    pub normal: DVec3,
}

/// A part of the line, with the outward normals at both ends.
#[derive(Clone, Copy)]
struct Span {
    from: Hit,
    to: Hit,
}

impl Span {
    /// The whole line.
    const ALL: Self = Self {
        from: Hit { t: f64::NEG_INFINITY, normal: DVec3::ZERO },
        to: Hit { t: f64::INFINITY, normal: DVec3::ZERO },
    };

    fn meet(self, other: Self) -> Option<Self> {
        let from = if other.from.t > self.from.t { other.from } else { self.from };
        let to = if other.to.t < self.to.t { other.to } else { self.to };
        (from.t < to.t).then_some(Self { from, to })
    }

    /// Where `offset + t · slope < 0`: the inside of a plane with the outward `normal`.
    fn behind_plane(offset: f64, slope: f64, normal: DVec3) -> Option<Self> {
        let hit = Hit { t: -offset / slope, normal };
        if slope == 0.0 || !hit.t.is_finite() {
            (offset < 0.0).then_some(Self::ALL)
        } else if slope < 0.0 {
            Some(Self { from: hit, ..Self::ALL })
        } else {
            Some(Self { to: hit, ..Self::ALL })
        }
    }
}

/// The real roots of a·t² + 2·b·t + c, in order, without cancellation; `None` without two distinct ones.
fn quadratic(a: f64, b: f64, c: f64) -> Option<(f64, f64)> {
    let discriminant = b * b - a * c;
    if !(discriminant > 0.0) || a == 0.0 {
        return None;
    }
    let q = -(b + discriminant.sqrt().copysign(b));
    let (t0, t1) = (q / a, c / q);
    Some((t0.min(t1), t0.max(t1)))
}

/// A root of `f` between `a` and `b`, given with their values of opposite sign: Illinois' rule, with bisection wherever that
/// is slow. Stops at `settled` times the bracket's scale, or when the bracket cannot be halved.
pub(super) fn bracketed_root(f: impl Fn(f64) -> f64, a: (f64, f64), b: (f64, f64), settled: f64) -> f64 {
    let (mut low, mut high) = (a, b);
    let tolerance = settled * low.0.abs().max(high.0.abs());
    // The values that the secant goes through; Illinois' rule halves the one that stays.
    let (mut f_low, mut f_high) = (low.1, high.1);
    let mut width = high.0 - low.0;
    let mut steps = 0;
    while high.0 - low.0 > tolerance {
        let middle = 0.5 * (low.0 + high.0);
        let secant = (low.0 * f_high - high.0 * f_low) / (f_high - f_low);
        // Every fourth step the bracket must have shrunk to a quarter, else it is halved.
        steps += 1;
        let slow = steps % 4 == 0 && high.0 - low.0 > 0.25 * width;
        if steps % 4 == 0 {
            width = high.0 - low.0;
        }
        let t = if !slow && secant > low.0 && secant < high.0 { secant } else { middle };
        if t <= low.0 || t >= high.0 {
            break;
        }
        let value = f(t);
        if value == 0.0 {
            return t;
        }
        if (value < 0.0) == (low.1 < 0.0) {
            low = (t, value);
            f_low = value;
            f_high *= 0.5;
        } else {
            high = (t, value);
            f_high = value;
            f_low *= 0.5;
        }
    }
    if low.1.abs() < high.1.abs() { low.0 } else { high.0 }
}

impl Solid {
    /// Fills `hits` with all crossings of the line `origin + t · dir` (leaf space, `dir` of any length but zero), at negative
    /// t too, in order of t. Where the line only touches the surface there is no crossing.
    pub fn intersect(&self, origin: DVec3, dir: DVec3, hits: &mut Vec<Hit>) {
        hits.clear();
        let Some((line, t_of_middle, unit)) = self.near_line(origin, dir) else { return };
        self.intersect_near(line, unit, hits);
        if hits.is_empty() {
            return;
        }
        let per_unit = 1.0 / dir.length();
        for hit in hits {
            hit.t = t_of_middle + hit.t * per_unit;
        }
    }

    /// The crossing whose parameter is nearest to `t_guess`, as [`Self::intersect`] would find it.
    pub fn nearest_crossing(&self, origin: DVec3, dir: DVec3, t_guess: f64) -> Option<Hit> {
        if let Self::Blend { balls, smoothness } = self {
            let (line, t_of_middle, unit) = self.near_line(origin, dir)?;
            let length = dir.length();
            let field = BlendField::new(balls, *smoothness);
            let s = field.nearest_crossing(line, unit, (t_guess - t_of_middle) * length)?;
            return Some(Hit { t: t_of_middle + s / length, normal: self.normal(line + unit * s) });
        }
        let mut hits = Vec::with_capacity(4);
        self.intersect(origin, dir, &mut hits);
        hits.into_iter().min_by(|a, b| (a.t - t_guess).abs().total_cmp(&(b.t - t_guess).abs()))
    }

    /// The line restarted at its point nearest to the solid's middle, so that nothing cancels for a far origin: the new
    /// origin, its parameter on the old line, and the unit direction.
    fn near_line(&self, origin: DVec3, dir: DVec3) -> Option<(DVec3, f64, DVec3)> {
        let t = (self.a_place_within() - origin).dot(dir) / dir.length_squared();
        Some((origin + dir * t, t, dir.try_normalize()?)).filter(|_| t.is_finite())
    }

    /// A point in the midst of the surface. Asked for every line, so that it must cost nothing.
    fn a_place_within(&self) -> DVec3 {
        match self {
            Self::HalfSpace { point, .. } => *point,
            Self::Box { min, max } => 0.5 * (*min + *max),
            Self::Sphere { centre, .. } | Self::Torus { centre, .. } => *centre,
            Self::Cylinder { from, to, .. } | Self::Cone { from, to, .. } => 0.5 * (*from + *to),
            Self::Blend { balls, .. } => {
                balls.iter().map(|ball| ball.centre).sum::<DVec3>() / (balls.len() as f64).max(1.0)
            }
        }
    }

    fn intersect_near(&self, o: DVec3, d: DVec3, hits: &mut Vec<Hit>) {
        let span = match self {
            Self::HalfSpace { point, normal, .. } => {
                let n = normal.normalize_or(DVec3::Z);
                Span::behind_plane((o - *point).dot(n), d.dot(n), n)
            }
            Self::Box { min, max } => [DVec3::X, DVec3::Y, DVec3::Z].into_iter().try_fold(Span::ALL, |span, axis| {
                let (from, along) = (o.dot(axis), d.dot(axis));
                span.meet(Span::behind_plane(min.dot(axis) - from, -along, -axis)?)?.meet(Span::behind_plane(
                    from - max.dot(axis),
                    along,
                    axis,
                )?)
            }),
            Self::Sphere { centre, radius } => {
                let e = o - *centre;
                quadratic(1.0, e.dot(d), (e.length() - radius) * (e.length() + radius)).map(|(t0, t1)| {
                    let hit = |t: f64| Hit { t, normal: (e + d * t).normalize_or(d) };
                    Span { from: hit(t0), to: hit(t1) }
                })
            }
            Self::Cylinder { from, to, radius } => Frustum::new(*from, *to, *radius, *radius).span(o, d),
            Self::Cone { from, to, radius_from, radius_to } => {
                Frustum::new(*from, *to, *radius_from, *radius_to).span(o, d)
            }
            Self::Torus { centre, axis, radius, tube } => {
                torus(*centre, *axis, *radius, *tube, o, d, hits);
                None
            }
            Self::Blend { balls, smoothness } => {
                let found = BlendField::new(balls, *smoothness).crossings(o, d);
                hits.extend(found.into_iter().map(|t| Hit { t, normal: self.normal(o + d * t) }));
                None
            }
        };
        if let Some(span) = span {
            hits.extend([span.from, span.to].into_iter().filter(|hit| hit.t.is_finite()));
        }
    }
}

impl Frustum {
    /// The part of the line within; `d` of unit length.
    fn span(&self, o: DVec3, d: DVec3) -> Option<Span> {
        let e = o - self.from;
        let (z, dz) = (e.dot(self.axis), d.dot(self.axis));
        let slab = Span::behind_plane(-z, -dz, -self.axis)?.meet(Span::behind_plane(z - self.h, dz, self.axis)?)?;
        // Inside the side: ρ(t)² < r(t)², both quadratic in t.
        let (across, d_across) = (e - self.axis * z, d - self.axis * dz);
        let taper = (self.r1 - self.r0) / self.h;
        let (r, dr) = (self.r0 + taper * z, taper * dz);
        let a = d_across.length_squared() - dr * dr;
        let b = across.dot(d_across) - r * dr;
        let c = (across.length() - r) * (across.length() + r);
        let side_normal = self.side_normal();
        let hit = |t: f64| {
            let about = Axial::new(self.from, self.axis, o + d * t);
            Hit { t, normal: about.lift(side_normal) }
        };
        let after = |t: f64| Span { from: hit(t), ..Span::ALL };
        let before = |t: f64| Span { to: hit(t), ..Span::ALL };
        // A line that runs along the side has a quadratic term of rounding errors only.
        const PARALLEL: f64 = 1e-14;
        let side = if a.abs() <= PARALLEL {
            if b.abs() <= PARALLEL * (r.abs() + across.length()) {
                (c < 0.0).then_some(Span::ALL)
            } else if b < 0.0 {
                Some(after(-0.5 * c / b))
            } else {
                Some(before(-0.5 * c / b))
            }
        } else if a > 0.0 {
            quadratic(a, b, c).map(|(t0, t1)| Span { from: hit(t0), to: hit(t1) })
        } else {
            // Steeper than the side: inside before one root on one nappe and after the other on its mirror image. Ours is
            // where r(t) > 0. Without two roots the line passes through the apex, which is both roots.
            let (t0, t1) = quadratic(a, b, c).unwrap_or((-b / a, -b / a));
            Some(if dr > 0.0 { after(t1) } else { before(t0) })
        };
        slab.meet(side?)
    }
}

/// Crossings of a line and a torus: in the quartic (|p|² + R² − r²)² − 4R²ρ² the turning points come from those of its
/// derivative, the derivative's from those of the second, which has a closed form. Between two turning points there is at
/// most one root, and its sign and place come from the signed distance, which is better conditioned than the quartic.
fn torus(centre: DVec3, axis: DVec3, radius: f64, tube: f64, o: DVec3, d: DVec3, hits: &mut Vec<Hit>) {
    let axis = axis.normalize_or(DVec3::Z);
    let e = o - centre;
    // `o` is the line's point nearest to the centre up to rounding; make it so exactly enough to drop the cubic term.
    let shift = -e.dot(d);
    let e = e + d * shift;
    let half_squared = (radius + tube).powi(2) - e.length_squared();
    if !(half_squared > 0.0) {
        return;
    }
    // A little beyond the bounding sphere, so that both ends are outside.
    let end = half_squared.sqrt() + 1e-3 * tube;
    let (z, dz) = (e.dot(axis), d.dot(axis));
    // s⁴ + c2·s² + c1·s + constant; its derivative 4s³ + 2·c2·s + c1.
    let c2 = 2.0 * (e.length_squared() + radius * radius - tube * tube) - 4.0 * radius * radius * (1.0 - dz * dz);
    let c1 = 8.0 * radius * radius * z * dz;
    let slope = |s: f64| (4.0 * s * s + 2.0 * c2) * s + c1;
    let bend = if c2 < 0.0 { (-c2 / 6.0).sqrt() } else { 0.0 };
    let mut turns = [-end; 5];
    let mut count = 1;
    for (a, b) in [(-end, -bend), (-bend, bend), (bend, end)] {
        let (a, b) = (a.clamp(-end, end), b.clamp(-end, end));
        let (f_a, f_b) = (slope(a), slope(b));
        if a < b && (f_a < 0.0) != (f_b < 0.0) {
            turns[count] = bracketed_root(slope, (a, f_a), (b, f_b), f64::EPSILON);
            count += 1;
        }
    }
    turns[count] = end;
    let distance = |s: f64| {
        let p = e + d * s;
        let along = z + dz * s;
        let rho = (p - axis * along).length();
        (rho - radius).hypot(along) - tube
    };
    for pair in turns[..=count].windows(2) {
        let (f_a, f_b) = (distance(pair[0]), distance(pair[1]));
        if (f_a < 0.0) != (f_b < 0.0) {
            let s = bracketed_root(distance, (pair[0], f_a), (pair[1], f_b), f64::EPSILON);
            let about = Axial::new(DVec3::ZERO, axis, e + d * s);
            let normal = about.lift(glam::DVec2::new(about.rho - radius, about.z).normalize_or(glam::DVec2::X));
            hits.push(Hit { t: s + shift, normal });
        }
    }
}
