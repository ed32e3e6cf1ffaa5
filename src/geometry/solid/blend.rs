//! Balls melted together: the logarithmic smooth minimum of their signed distances.
//!
//! # Theory
//! With dᵢ(p) = |p − cᵢ| − rᵢ and k the smoothness, f = −k ln Σ exp(−dᵢ/k). Its gradient is Σ wᵢ uᵢ, a mean of the unit
//! vectors uᵢ away from the centres with weights wᵢ ∝ exp(−dᵢ/k), so it is never longer than 1. Hence f is 1-Lipschitz:
//! |f(p)| is never more than the distance from p to the surface, and no line can change sign within |f(p)| of p. And
//! min dᵢ − k ln n ≤ f ≤ min dᵢ, so the surface lies within k ln n outside the balls.

use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};

use glam::{DVec3, IVec3};

use super::Ball;

/// A ball's share exp(x), x ≤ 0: far balls' would not change a bit of the sum.
fn weight(x: f64) -> f64 {
    /// ln 2⁻⁵³ = −36.7: below, the share is under half a unit in the last place of a sum of at least 1.
    const NEGLIGIBLE: f64 = -37.0;
    if x < NEGLIGIBLE { 0.0 } else { x.exp() }
}

/// The function f of a blend.
#[derive(Debug, Clone, Copy)]
pub(super) struct BlendField<'a> {
    balls: &'a [Ball],
    k: f64,
}

/// A crossing is settled to this part of the blend's size: a few bits above what f can be evaluated to.
const SETTLED: f64 = 1e-15;

/// Marching along a line never steps by less than this part of the blend's size. Two crossings closer than that are seen as
/// none; on a surface of curvature 1/size the line between them is then at most step²/8 = 1e-11 sizes deep.
const LEAST_STEP: f64 = 1e-5;

impl<'a> BlendField<'a> {
    pub(super) fn new(balls: &'a [Ball], smoothness: f64) -> Self {
        Self { balls, k: smoothness }
    }

    /// How far the surface can lie outside the balls.
    pub(super) fn swelling(&self) -> f64 {
        self.k * (self.balls.len() as f64).ln()
    }

    pub(super) fn bounds(&self) -> (DVec3, DVec3) {
        let swelling = self.swelling();
        self.balls.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(min, max), ball| {
            let reach = ball.radius + swelling;
            (min.min(ball.centre - reach), max.max(ball.centre + reach))
        })
    }

    fn nearest_ball(&self, p: DVec3) -> (usize, f64) {
        let distances = self.balls.iter().map(|ball| (p - ball.centre).length() - ball.radius).enumerate();
        distances.fold((0, f64::INFINITY), |a, b| if b.1 < a.1 { b } else { a })
    }

    pub(super) fn value(&self, p: DVec3) -> f64 {
        // Relative to the least distance, so that the exponentials neither overflow nor all vanish.
        let least = self.nearest_ball(p).1;
        let sum: f64 = self.balls.iter().map(|b| ((least - ((p - b.centre).length() - b.radius)) / self.k).exp()).sum();
        least - self.k * sum.ln()
    }

    pub(super) fn value_and_gradient(&self, p: DVec3) -> (f64, DVec3) {
        let least = self.nearest_ball(p).1;
        let (mut sum, mut toward) = (0.0, DVec3::ZERO);
        for ball in self.balls {
            let e = p - ball.centre;
            let weight = weight((least - (e.length() - ball.radius)) / self.k);
            sum += weight;
            toward += e.normalize_or_zero() * weight;
        }
        (least - self.k * sum.ln(), toward / sum)
    }

    /// All t with f(origin + t·dir) = 0 and a change of sign there, in order; `dir` of unit length.
    pub(super) fn crossings(&self, origin: DVec3, dir: DVec3) -> Vec<f64> {
        let mut found = Vec::new();
        let Some((mut t, end)) = self.span(origin, dir) else { return found };
        let least_step = LEAST_STEP * (end - t);
        while let Some(crossing) = self.march(origin, dir, &mut t, end, least_step) {
            found.push(crossing);
        }
        found
    }

    /// The crossing nearest to `guess`, which is found by marching both ways from there; `dir` of unit length.
    pub(super) fn nearest_crossing(&self, origin: DVec3, dir: DVec3, guess: f64) -> Option<f64> {
        let (start, end) = self.span(origin, dir)?;
        let least_step = LEAST_STEP * (end - start);
        let guess = guess.clamp(start, end);
        let mut t = guess;
        let ahead = self.march(origin, dir, &mut t, end, least_step);
        // Behind, nothing further than what was found ahead is of interest.
        let reach = ahead.map_or(guess - start, |t| (t - guess).min(guess - start));
        let mut back = -guess;
        let behind = self.march(origin, -dir, &mut back, reach - guess, least_step).map(|t| -t);
        match (behind, ahead) {
            (Some(b), Some(a)) if guess - b < a - guess => Some(b),
            (b, a) => a.or(b),
        }
    }

    /// The part of the line within a sphere around the blend, a little enlarged.
    fn span(&self, origin: DVec3, dir: DVec3) -> Option<(f64, f64)> {
        let (min, max) = self.bounds();
        let centre = 0.5 * (min + max);
        let reach = self.balls.iter().map(|b| (b.centre - centre).length() + b.radius).fold(0.0, f64::max);
        const MARGIN: f64 = 1.001;
        let reach = (reach + self.swelling()) * MARGIN;
        let middle = (centre - origin).dot(dir);
        let half_squared = reach * reach - (origin + dir * middle - centre).length_squared();
        (half_squared > 0.0).then(|| (middle - half_squared.sqrt(), middle + half_squared.sqrt()))
    }

    /// Steps from `t` by |f| until the sign changes, and settles the crossing; leaves `t` just beyond it.
    fn march(&self, origin: DVec3, dir: DVec3, t: &mut f64, end: f64, least_step: f64) -> Option<f64> {
        let at = |t: f64| self.value(origin + dir * t);
        let mut value = at(*t);
        while *t < end {
            let next = (*t + value.abs().max(least_step)).min(end);
            let next_value = at(next);
            if (value < 0.0) != (next_value < 0.0) {
                let crossing = super::intersect::bracketed_root(at, (*t, value), (next, next_value), SETTLED);
                *t = next;
                return Some(crossing);
            }
            (*t, value) = (next, next_value);
        }
        None
    }

    /// The surface point that Newton's steps along the gradient lead to from `p`, with its unit normal.
    fn project(&self, mut p: DVec3) -> Option<(DVec3, DVec3)> {
        /// Newton's steps double the digits; from within a cell of the surface four to six do.
        const MOST_STEPS: usize = 24;
        let settled = 1e-13 * (self.balls[0].radius + p.abs().max_element());
        for _ in 0..MOST_STEPS {
            let (f, gradient) = self.value_and_gradient(p);
            if f.abs() <= settled {
                return gradient.try_normalize().map(|n| (p, n));
            }
            let step = gradient * (f / gradient.length_squared());
            if !(step.is_finite()) {
                return None;
            }
            p -= step;
        }
        None
    }

    fn least_radius(&self) -> f64 {
        self.balls.iter().map(|b| b.radius).fold(f64::INFINITY, f64::min)
    }

    /// Calls `visit` with centre, f and gradient of every cell of side `≤ side` that the surface may pass through and that no
    /// larger cell around it was `skip`ped with (given its centre and half diagonal), in a fixed order; returns the side.
    fn cells_near_surface<S>(
        &self,
        side: f64,
        state: &mut S,
        skip: &impl Fn(&S, DVec3, f64) -> bool,
        visit: &mut impl FnMut(&mut S, DVec3, f64, DVec3),
    ) -> f64 {
        let (min, max) = self.bounds();
        let extent = (max - min).max_element();
        let levels = (extent / side).log2().ceil().max(0.0) as u32;
        self.visit_cells(0.5 * (min + max), extent, levels, state, skip, visit);
        extent / 2f64.powi(levels as i32)
    }

    fn visit_cells<S>(
        &self,
        centre: DVec3,
        side: f64,
        levels: u32,
        state: &mut S,
        skip: &impl Fn(&S, DVec3, f64) -> bool,
        visit: &mut impl FnMut(&mut S, DVec3, f64, DVec3),
    ) {
        let half_diagonal = HALF_DIAGONAL * side;
        if skip(state, centre, half_diagonal) {
            return;
        }
        // f is 1-Lipschitz: beyond half the diagonal there is no zero in the cell.
        if levels == 0 {
            let (f, gradient) = self.value_and_gradient(centre);
            if f.abs() <= half_diagonal {
                visit(state, centre, f, gradient);
            }
            return;
        }
        if !(self.value(centre).abs() <= half_diagonal) {
            return;
        }
        for corner in 0..8u32 {
            let toward =
                DVec3::new(f64::from(corner & 1) - 0.5, f64::from(corner >> 1 & 1) - 0.5, f64::from(corner >> 2) - 0.5);
            self.visit_cells(centre + toward * (0.5 * side), 0.5 * side, levels - 1, state, skip, visit);
        }
    }

    /// Surface points such that every point of the surface has one within [`COVER`](super::COVER) spacings.
    ///
    /// Every cell of a fine grid that the surface may pass through is projected onto it, unless its part of the surface is
    /// covered already. A surface point lies within half a cell's diagonal of such a centre, hence about as near to its
    /// projection, and a projection is left out only if a sample is within [`APART`] spacings.
    pub(super) fn sample(&self, spacing: f64, emit: &mut impl FnMut(DVec3, DVec3)) {
        // Cells smaller than the balls too, else projections jump between them.
        let side = (CELL * spacing).min(0.5 * self.least_radius());
        let (apart, cover) = (APART * spacing, super::COVER * spacing);
        let covered = |kept: &Kept, centre: DVec3, half_diagonal: f64| {
            cover > half_diagonal && kept.any_within(centre, cover - half_diagonal)
        };
        let mut kept = Kept::new(self.balls[0].centre, cover);
        self.cells_near_surface(side, &mut kept, &covered, &mut |kept, centre, f, gradient| {
            // One Newton step tells well enough whether another sample is near.
            let about = centre - gradient * (f / gradient.length_squared());
            if about.is_finite() && kept.any_within(about, apart) {
                return;
            }
            if let Some((p, normal)) = self.project(centre) {
                kept.add(p);
                emit(p, normal);
            }
        });
    }

    /// The surface's area within a few per cent, by the co-area formula: ∫ |∇f| δ(f) dV with a hat for δ.
    pub(super) fn area(&self) -> f64 {
        /// Cells along the blend's longest side.
        const CELLS: f64 = 96.0;
        let (min, max) = self.bounds();
        let mut values = Vec::new();
        let side = (max - min).max_element() / CELLS;
        let side = self.cells_near_surface(side, &mut values, &|_, _, _| false, &mut |values, _, f, gradient| {
            values.push((f, gradient.length()));
        });
        // Cells further than half their diagonal were skipped, so the hat must end there.
        let width = HALF_DIAGONAL * side;
        let sum: f64 = values.into_iter().map(|(f, slope)| (1.0 - f.abs() / width).max(0.0) / width * slope).sum();
        sum * side.powi(3)
    }

    /// A point of the surface, every part of the same area equally likely, and its unit normal. `uniform` returns numbers
    /// in [0, 1).
    ///
    /// Points are drawn evenly from the shells that hold the surface and kept where |f| < ε with probability |∇f|: by the
    /// co-area formula those are spread evenly over the level sets from −ε to ε. Then they are moved onto the surface, which
    /// stretches areas by 1 + O(ε/k) on one side and shrinks them as much on the other.
    pub(super) fn sample_random(&self, uniform: &mut dyn FnMut() -> f64) -> (DVec3, DVec3) {
        /// ε in units of the smaller of k and the least radius.
        const HALF_WIDTH: f64 = 0.05;
        let epsilon = HALF_WIDTH * self.k.min(self.least_radius());
        let shell = |ball: &Ball| {
            let (inner, outer) = ((ball.radius - epsilon).powi(3), (ball.radius + self.swelling() + epsilon).powi(3));
            (inner, outer - inner)
        };
        let total: f64 = self.balls.iter().map(|b| shell(b).1).sum();
        loop {
            let mut pick = uniform() * total;
            let chosen = self.balls.iter().position(|b| {
                pick -= shell(b).1;
                pick < 0.0
            });
            let index = chosen.unwrap_or(self.balls.len() - 1);
            let ball = &self.balls[index];
            let (inner, volume) = shell(ball);
            let p = ball.centre + super::patch::random_direction(uniform) * (inner + uniform() * volume).cbrt();
            // Shells overlap: only the nearest ball's may speak for a point.
            if self.nearest_ball(p).0 != index {
                continue;
            }
            let (f, gradient) = self.value_and_gradient(p);
            if f.abs() < epsilon
                && uniform() < gradient.length()
                && let Some(found) = self.project(p)
            {
                return found;
            }
        }
    }
}

/// Half the diagonal of a cube of side 1, a little more for rounding: √3/2 = 0.866025….
const HALF_DIAGONAL: f64 = 0.86603;

/// Side of a grid cell in [`BlendField::sample`], in spacings.
const CELL: f64 = 0.2;

/// How near a sample must be for a projection to be left out, in spacings: what half a cell's diagonal leaves of
/// [`super::COVER`].
const APART: f64 = super::COVER - HALF_DIAGONAL * CELL;

/// Points in cubes of side `2 · reach`, so that whatever is within `reach` of a place is in the 8 cubes nearest to it.
struct Kept {
    /// Where a cube's corner is: near the points, however far they are from the leaf's origin.
    origin: DVec3,
    reach: f64,
    /// The last point added to each cube, and for each point the one added to its cube before.
    last: HashMap<IVec3, u32, BuildHasherDefault<CubeHasher>>,
    points: Vec<(DVec3, u32)>,
}

impl Kept {
    const NONE: u32 = u32::MAX;

    fn new(origin: DVec3, reach: f64) -> Self {
        Self { origin, reach, last: HashMap::default(), points: Vec::new() }
    }

    fn add(&mut self, p: DVec3) {
        let index = self.points.len() as u32;
        let before =
            self.last.insert(((p - self.origin) / (2.0 * self.reach)).floor().as_ivec3(), index).unwrap_or(Self::NONE);
        self.points.push((p, before));
    }

    /// Whether a point is within `distance`, which is at most `reach`, of `p`.
    fn any_within(&self, p: DVec3, distance: f64) -> bool {
        let first = ((p - self.origin) / (2.0 * self.reach) - 0.5).floor().as_ivec3();
        (0..8).any(|corner| {
            let cube = first + IVec3::new(corner & 1, corner >> 1 & 1, corner >> 2);
            let mut next = self.last.get(&cube).copied().unwrap_or(Self::NONE);
            while let Some((q, before)) = self.points.get(next as usize) {
                if (p - *q).length_squared() <= distance * distance {
                    return true;
                }
                next = *before;
            }
            false
        })
    }
}

/// A hash for cubes' coordinates: the standard one withstands attackers, which costs half the sampling's time.
#[derive(Default)]
struct CubeHasher(u64);

impl Hasher for CubeHasher {
    fn finish(&self) -> u64 {
        self.0 ^ (self.0 >> 32)
    }

    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|b| self.write_u64(u64::from(*b)));
    }

    fn write_i32(&mut self, value: i32) {
        self.write_u64(u64::from(value as u32));
    }

    fn write_u64(&mut self, value: u64) {
        /// 2⁶⁴ divided by the golden ratio, odd.
        const SPREAD: u64 = 0x9E37_79B9_7F4A_7C15;
        self.0 = (self.0.rotate_left(23) ^ value).wrapping_mul(SPREAD);
    }
}
