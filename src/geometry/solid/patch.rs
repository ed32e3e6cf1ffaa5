//! The smooth patches of a solid's surface, and points all over them.
//!
//! Every patch but a plane and a blend is a surface of revolution: a segment or an arc of the half-plane (away from the
//! axis, along it), turned. It is sampled in rows along that profile, every row a circle of evenly spaced points.
//!
//! *Why the rows cover*: between a point and the nearest sample of the nearest row, at distances ρ and ρ' from the axis, the
//! squared distance is that along the profile plus 4ρρ' sin²(Δφ/2). Rows are at most ROW_STEP spacings apart, and the points
//! of a row at most one spacing, measured on the widest circle of the row's band: so the distance is at most
//! √(ROW_STEP²/4 + 1/4) = 0.66 spacings, below [`COVER`]. Planes are the same with straight rows.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use glam::{DVec2, DVec3};

use super::{BlendField, Frustum, Solid};

/// Every point of a patch has a sample within this many spacings.
pub const COVER: f64 = 0.75;

/// Distance of neighbouring rows in spacings: √3/2, that of a triangular lattice.
const ROW_STEP: f64 = 0.866;

/// The fewest points on a circle that is not a point: fewer do not show a shape, however coarse the spacing.
const LEAST_AROUND: f64 = 6.0;

/// The fewest rows along an arc, for the same reason.
const LEAST_ALONG_ARC: f64 = 4.0;

/// A point of a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfacePoint {
    /// Leaf space.
    pub p: DVec3,
    /// Outward unit normal, leaf space.
    pub normal: DVec3,
}

/// A smooth piece of a solid's surface: creases run only along its border.
#[derive(Debug, Clone)]
pub struct Patch<'a> {
    shape: Shape<'a>,
}

#[derive(Debug, Clone)]
enum Shape<'a> {
    /// `corner + a·u + b·v` with a and b in [0, 1]; `u` across `v`.
    Rectangle { corner: DVec3, u: DVec3, v: DVec3, normal: DVec3 },
    /// A profile turned about the axis through `foot`.
    Revolution { foot: DVec3, axis: DVec3, profile: Profile },
    /// All of a blend.
    Blend(BlendField<'a>),
}

/// A curve of the half-plane (away from the axis, along it).
#[derive(Debug, Clone, Copy)]
enum Profile {
    /// Straight; if one end is on the axis it is `from`.
    Segment { from: DVec2, to: DVec2, normal: DVec2 },
    /// The arc about `(ring, 0)` from angle `-half` to `half` against the outward direction; closed where `half` is π.
    Arc { ring: f64, radius: f64, half: f64 },
}

impl Profile {
    fn length(&self) -> f64 {
        match *self {
            Self::Segment { from, to, .. } => (to - from).length(),
            Self::Arc { radius, half, .. } => 2.0 * radius * half,
        }
    }

    /// Point and outward normal at `part` of the length, in [0, 1].
    fn at(&self, part: f64) -> (DVec2, DVec2) {
        match *self {
            Self::Segment { from, to, normal } => (from.lerp(to, part), normal),
            Self::Arc { ring, radius, half } => {
                let normal = DVec2::from_angle(half * (2.0 * part - 1.0));
                let p = DVec2::new(ring, 0.0) + normal * radius;
                (DVec2::new(p.x.max(0.0), p.y), normal)
            }
        }
    }

    /// The greatest distance from the axis between the parts `low` and `high`.
    fn widest(&self, low: f64, high: f64) -> f64 {
        let (low, high) = (low.max(0.0), high.min(1.0));
        match self {
            Self::Arc { ring, radius, .. } if low <= 0.5 && high >= 0.5 => ring + radius,
            _ => self.at(low).0.x.max(self.at(high).0.x),
        }
    }

    /// The area when turned, by Pappus: 2π ∫ ρ.
    fn area(&self) -> f64 {
        match *self {
            Self::Segment { from, to, .. } => PI * (from.x + to.x) * (to - from).length(),
            Self::Arc { ring, radius, half } => TAU * radius * (2.0 * half * ring + 2.0 * radius * half.sin()),
        }
    }

    /// A part of the length, as likely as its circle is long.
    fn random(&self, uniform: &mut dyn FnMut() -> f64) -> f64 {
        match *self {
            Self::Segment { from, to, .. } => {
                // ∫₀ᵖ ρ ∝ 2·p·ρ₀ + p²·(ρ₁ − ρ₀), solved for p without cancellation.
                let share = uniform() * (from.x + to.x);
                share / (from.x + (from.x * from.x + share * (to.x - from.x)).max(0.0).sqrt()).max(f64::MIN_POSITIVE)
            }
            Self::Arc { ring, radius, .. } => loop {
                let part = uniform();
                if uniform() * (ring + radius) < self.at(part).0.x {
                    return part;
                }
            },
        }
    }
}

/// A direction, all equally likely.
pub(super) fn random_direction(uniform: &mut dyn FnMut() -> f64) -> DVec3 {
    let z = 2.0 * uniform() - 1.0;
    let around = DVec2::from_angle(TAU * uniform()) * (1.0 - z * z).max(0.0).sqrt();
    DVec3::new(around.x, around.y, z)
}

impl Patch<'_> {
    /// Area in squared leaf units; exact but for a blend, where it is within a few per cent.
    pub fn area(&self) -> f64 {
        match &self.shape {
            Shape::Rectangle { u, v, .. } => u.length() * v.length(),
            Shape::Revolution { profile, .. } => profile.area(),
            Shape::Blend(field) => field.area(),
        }
    }

    /// Calls `emit` with points spread over the patch, borders included: every point of the patch has one within
    /// [`COVER`]` · spacing`. In a fixed order. `spacing` in leaf units, positive; otherwise nothing is emitted.
    pub fn sample(&self, spacing: f64, emit: &mut impl FnMut(SurfacePoint)) {
        if !(spacing > 0.0 && spacing.is_finite()) {
            return;
        }
        match &self.shape {
            Shape::Rectangle { corner, u, v, normal } => {
                let rows = (v.length() / (ROW_STEP * spacing)).ceil().max(1.0) as u64;
                let columns = (u.length() / spacing).ceil().max(1.0) as u64;
                let mut put = |a: f64, b: f64| emit(SurfacePoint { p: corner + u * a + v * b, normal: *normal });
                for row in 0..=rows {
                    let b = row as f64 / rows as f64;
                    if row % 2 == 0 {
                        (0..=columns).for_each(|i| put(i as f64 / columns as f64, b));
                    } else {
                        put(0.0, b);
                        (0..columns).for_each(|i| put((i as f64 + 0.5) / columns as f64, b));
                        put(1.0, b);
                    }
                }
            }
            Shape::Revolution { foot, axis, profile } => sample_rows(*foot, *axis, profile, spacing, emit),
            Shape::Blend(field) => field.sample(spacing, &mut |p, normal| emit(SurfacePoint { p, normal })),
        }
    }

    /// A random point, all equally likely. `uniform` returns independent numbers in [0, 1).
    pub fn sample_random(&self, uniform: &mut dyn FnMut() -> f64) -> SurfacePoint {
        match &self.shape {
            Shape::Rectangle { corner, u, v, normal } => {
                SurfacePoint { p: corner + u * uniform() + v * uniform(), normal: *normal }
            }
            Shape::Revolution { foot, axis, profile } => {
                let (at, normal) = profile.at(profile.random(uniform));
                turned(*foot, *axis, at, normal, TAU * uniform())
            }
            Shape::Blend(field) => {
                let (p, normal) = field.sample_random(uniform);
                SurfacePoint { p, normal }
            }
        }
    }
}

/// A point of a profile, turned by `angle`.
fn turned(foot: DVec3, axis: DVec3, at: DVec2, normal: DVec2, angle: f64) -> SurfacePoint {
    let (u, v) = axis.any_orthonormal_pair();
    let away = u * angle.cos() + v * angle.sin();
    SurfacePoint { p: foot + away * at.x + axis * at.y, normal: away * normal.x + axis * normal.y }
}

fn sample_rows(foot: DVec3, axis: DVec3, profile: &Profile, spacing: f64, emit: &mut impl FnMut(SurfacePoint)) {
    let wanted = profile.length() / (ROW_STEP * spacing);
    let widest = profile.widest(0.0, 1.0);
    // Where each row is, as a part of the length: the first, the step, and how many.
    let (first, step, rows) = match profile {
        Profile::Arc { half, .. } if *half == PI => {
            let rows = wanted.ceil().max(LEAST_ALONG_ARC);
            (0.0, 1.0 / rows, rows as u64)
        }
        Profile::Arc { .. } => {
            let steps = wanted.ceil().max(LEAST_ALONG_ARC);
            (0.0, 1.0 / steps, steps as u64 + 1)
        }
        // At the tip of a cone there is no normal: the first row is half a step from it.
        Profile::Segment { from, to, .. } if from.x == 0.0 && from.y != to.y => {
            let steps = (wanted + 0.5).ceil().max(2.0) - 0.5;
            (0.5 / steps, 1.0 / steps, steps.ceil() as u64)
        }
        Profile::Segment { .. } => {
            let steps = wanted.ceil().max(1.0);
            (0.0, 1.0 / steps, steps as u64 + 1)
        }
    };
    for row in 0..rows {
        let part = (first + row as f64 * step).min(1.0);
        let (at, normal) = profile.at(part);
        // A pole: rounding leaves a circle of no size.
        if at.x <= 1e-12 * widest {
            emit(turned(foot, axis, DVec2::new(0.0, at.y), DVec2::new(0.0, normal.y.signum()), 0.0));
            continue;
        }
        let band = TAU * profile.widest(part - 0.5 * step, part + 0.5 * step);
        let around = (band / spacing).ceil().max(LEAST_AROUND);
        let stagger = 0.5 * (row % 2) as f64;
        for i in 0..around as u64 {
            emit(turned(foot, axis, at, normal, TAU * (i as f64 + stagger) / around));
        }
    }
}

impl Solid {
    /// The smooth patches that make up the surface: a box has six, a cylinder three, a cone two or three, the others one. Of
    /// a half-space it is the square that is drawn.
    pub fn patches(&self) -> Vec<Patch<'_>> {
        let patch = |shape| Patch { shape };
        match self {
            Self::HalfSpace { point, normal, extent } => {
                let normal = normal.normalize_or(DVec3::Z);
                let (u, v) = normal.any_orthonormal_pair();
                let corner = point - (u + v) * *extent;
                vec![patch(Shape::Rectangle { corner, u: u * 2.0 * *extent, v: v * 2.0 * *extent, normal })]
            }
            Self::Box { min, max } => {
                let size = max - min;
                let mut faces = Vec::with_capacity(6);
                for (n, u, v) in
                    [(DVec3::X, DVec3::Y, DVec3::Z), (DVec3::Y, DVec3::Z, DVec3::X), (DVec3::Z, DVec3::X, DVec3::Y)]
                {
                    for (corner, normal) in [(*min, -n), (min + n * size, n)] {
                        faces.push(patch(Shape::Rectangle { corner, u: u * size, v: v * size, normal }));
                    }
                }
                faces
            }
            Self::Sphere { centre, radius } => {
                let profile = Profile::Arc { ring: 0.0, radius: *radius, half: FRAC_PI_2 };
                vec![patch(Shape::Revolution { foot: *centre, axis: DVec3::Z, profile })]
            }
            Self::Cylinder { from, to, radius } => Frustum::new(*from, *to, *radius, *radius).patches(),
            Self::Cone { from, to, radius_from, radius_to } => {
                Frustum::new(*from, *to, *radius_from, *radius_to).patches()
            }
            Self::Torus { centre, axis, radius, tube } => {
                let profile = Profile::Arc { ring: *radius, radius: *tube, half: PI };
                vec![patch(Shape::Revolution { foot: *centre, axis: axis.normalize_or(DVec3::Z), profile })]
            }
            Self::Blend { balls, smoothness } => vec![patch(Shape::Blend(BlendField::new(balls, *smoothness)))],
        }
    }

    /// A random point of the surface (of a half-space: of the square that is drawn) and its outward unit normal, leaf space.
    /// Every part of the same area is equally likely. `uniform` must return independent numbers in [0, 1).
    pub fn sample_random(&self, uniform: &mut dyn FnMut() -> f64) -> (DVec3, DVec3) {
        let patches = self.patches();
        let mut chosen = &patches[0];
        // The area of a blend is dear and not needed: it is one patch.
        if patches.len() > 1 {
            let mut pick = uniform() * patches.iter().map(Patch::area).sum::<f64>();
            for patch in &patches {
                chosen = patch;
                pick -= patch.area();
                if pick < 0.0 {
                    break;
                }
            }
        }
        let found = chosen.sample_random(uniform);
        (found.p, found.normal)
    }
}

impl Frustum {
    fn patches<'a>(&self) -> Vec<Patch<'a>> {
        let (base, top) = (DVec2::new(self.r0, 0.0), DVec2::new(self.r1, self.h));
        // A tip comes first: see `Profile::Segment`.
        let (from, to) = if self.r1 == 0.0 { (top, base) } else { (base, top) };
        let mut profiles = vec![Profile::Segment { from, to, normal: self.side_normal() }];
        for (rim, normal) in [(base, DVec2::NEG_Y), (top, DVec2::Y)] {
            if rim.x > 0.0 {
                profiles.push(Profile::Segment { from: DVec2::new(0.0, rim.y), to: rim, normal });
            }
        }
        let revolution = |profile| Shape::Revolution { foot: self.from, axis: self.axis, profile };
        profiles.into_iter().map(|profile| Patch { shape: revolution(profile) }).collect()
    }
}
