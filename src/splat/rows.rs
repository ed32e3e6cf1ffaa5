//! The kernels: what eight neighbouring rays of one row meet of one leaf's surfels.
//!
//! # Theory
//! A leaf's surface near its surfels is f(x) = Σ w (n·e + ½ eᵀMe) / Σ w = 0. A ray meets it by
//! *detecting* candidate depths, *grouping* them into surfaces by facing and overlap in depth, and *solving* one
//! quadratic per group: with weights w taken at the group's mean hit x₀,
//! a0 = Σw(n·e + ½eᵀMe), a1 = Σw(n·d + dᵀMe), a2 = ½Σw dᵀMd, τ = 2a0 / (−a1 ± √(a1² − 4a0a2)),
//! + for a surface that faces the eye and − for one facing away.
//!
//! # Changes from the paper
//! * Wicke 2004 §3.3 takes fragments where a ray meets a *disk*. Here each surfel offers the ray's roots with its own
//!   quadric inside its support ball: a grazing ray that passes between edge-on disks still finds the surface, and one
//!   surfel at a silhouette serves both the surface facing the eye and the one facing away.
//! * All surfels of a sheet that the ray meets edge-on count in the solve, also those that turn the other way (`Sheet`): a disk
//!   faces one way, and a silhouette both.
//! * The weights of the solve are those of the field that other leaves ask, (1 − |e|²/r²)⁴, over every surfel whose
//!   ball reaches x₀; so a leaf's own hits lie on the very surface that clips its partners, and edges stay closed.
//!
//! # Practice
//! Lanes are pixels. Nothing here contracts to a fused multiply-add, so results do not depend on the processor. A lane
//! that has no value carries garbage under a mask: mask last.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x8, mask32x8, u32x8};

use super::project::ViewSurfel;
use crate::surfel::SAME_SHEET;

/// Squared cosine between a ray and the normal below which the surface is met edge-on, and a miss is a silhouette: 75° and more off
/// the normal.
pub(crate) const GRAZING_COSINE_SQUARED: f32 = 0.067;

/// A candidate's weight (1 − |e|²/r²)² above which it alone proves the surface: the ray passes within 0.7 of its radius.
pub(crate) const SURE_WEIGHT: f32 = 0.25;

/// Rays a row kernel handles at once.
pub const LANES: usize = 8;

/// Supports end where |e|² = r²; weights below this are as good as none and their quotients all rounding.
pub(crate) const LEAST_WEIGHT: f32 = 1e-12;

/// A hit may lie this many radii from where its group's candidates were.
pub(crate) const FARTHEST_SOLVE_IN_RADII: f32 = 4.0;

/// A step on the field of more radii than this diverges.
pub(crate) const MOST_STEP_IN_RADII: f32 = 0.5;

/// Eight rays of one row of a tile.
#[derive(Clone, Copy)]
pub struct Row<S: Simd> {
    /// The token that proves the instruction set.
    pub simd: S,
    /// Pixel positions, from the tile's corner.
    pub x: f32x8<S>,
    /// As `x`, down.
    pub y: f32,
    /// X of the rays' directions (X, Y, 1) in view axes.
    pub dir_x: f32x8<S>,
    /// Y of the directions.
    pub dir_y: f32,
    /// Which lanes are pixels of the tile.
    pub live: mask32x8<S>,
}

/// A surfel's part in one row: everything of its quadric that does not depend on depth.
#[derive(Clone, Copy)]
struct Quadric<S: Simd> {
    /// e at the reference depth.
    ex: f32x8<S>,
    ey: f32,
    ez: f32,
    /// M d.
    md_x: f32x8<S>,
    md_y: f32x8<S>,
    md_z: f32x8<S>,
    /// n·d.
    nd: f32x8<S>,
    /// ½ dᵀMd.
    a2: f32x8<S>,
}

impl<S: Simd> Row<S> {
    #[inline(always)]
    fn splat(&self, v: f32) -> f32x8<S> {
        f32x8::splat(self.simd, v)
    }

    /// Least and greatest of `t` over `lanes`.
    #[inline(always)]
    pub fn span(&self, t: f32x8<S>, lanes: mask32x8<S>) -> (f32, f32) {
        let least = lanes.select(t, self.splat(f32::INFINITY)).reduce_min();
        (least, lanes.select(t, self.splat(f32::NEG_INFINITY)).reduce_max())
    }

    #[inline(always)]
    fn quadric(&self, s: &ViewSurfel) -> Quadric<S> {
        let m = &s.curvature;
        let (dx, dy) = (self.dir_x, self.dir_y);
        let md_x = dx * m[0] + (m[1] * dy + m[2]);
        let md_y = dx * m[1] + (m[3] * dy + m[4]);
        let md_z = dx * m[2] + (m[4] * dy + m[5]);
        Quadric {
            ex: (self.x - s.u) * s.scale,
            ey: (self.y - s.v) * s.scale,
            ez: s.lift,
            md_x,
            md_y,
            md_z,
            nd: dx * s.normal[0] + (s.normal[1] * dy + s.normal[2]),
            a2: (dx * md_x + md_y * dy + md_z) * 0.5,
        }
    }

    /// |e|²/r² (or eᵀSe) for e given by components.
    #[inline(always)]
    fn support(&self, s: &ViewSurfel, ex: f32x8<S>, ey: f32x8<S>, ez: f32x8<S>) -> f32x8<S> {
        match &s.support {
            None => (ex * ex + ey * ey + ez * ez) * s.inverse_radius_squared,
            Some(q) => {
                let qx = ex * q[0] + ey * q[1] + ez * q[2];
                let qy = ex * q[1] + ey * q[3] + ez * q[4];
                let qz = ex * q[2] + ey * q[4] + ez * q[5];
                ex * qx + ey * qy + ez * qz
            }
        }
    }
}

/// One surface that some of a row's rays meet; which surface may differ from lane to lane.
#[derive(Clone, Copy)]
pub struct Slot<S: Simd> {
    /// Whether the leaf is entered.
    pub front: bool,
    /// Lanes in use.
    pub lanes: mask32x8<S>,
    /// Least depth of a candidate, less its reach.
    lower: f32x8<S>,
    /// Greatest depth of a candidate, plus its reach.
    upper: f32x8<S>,
    weight: f32x8<S>,
    weighted_depth: f32x8<S>,
    /// Largest candidate weight, and whose.
    best_weight: f32x8<S>,
    /// Depth of that candidate.
    pub best_depth: f32x8<S>,
    /// Position, in the list that was searched, of the surfel nearest to the hit.
    pub best: u32x8<S>,
    /// Radius of that surfel.
    pub best_radius: f32x8<S>,
}

impl<S: Simd> Slot<S> {
    /// Largest weight of a candidate of `lane`.
    pub fn best_weight(&self, lane: usize) -> f32 {
        self.best_weight[lane]
    }

    /// Mean depth of the candidates, relative to the tile's anchor.
    #[inline(always)]
    pub fn depth(&self) -> f32x8<S> {
        self.weighted_depth / self.weight
    }
}

/// What a surfel's support ball spans, tile-relative: a part of a cache line, since most surfels of a block are looked at
/// only to be passed over.
#[derive(Debug, Clone, Copy)]
pub struct Span {
    left: f32,
    right: f32,
    top: f32,
    bottom: f32,
    near: f32,
    far: f32,
}

impl Span {
    /// Of `s`.
    pub fn of(s: &ViewSurfel) -> Self {
        Self { left: s.left, right: s.right, top: s.top, bottom: s.bottom, near: s.near, far: s.far }
    }
}

/// Appends to `touching` those of `members` whose balls reach a live ray of the row between the depths `nearest` and
/// `farthest`.
#[inline(always)]
pub fn touching<S: Simd>(
    row: &Row<S>,
    spans: &[Span],
    members: &[u32],
    (nearest, farthest): (f32, f32),
    touching: &mut Vec<u32>,
) {
    let (y, (first, last)) = (row.y, row.span(row.x, row.live));
    // Without branches: which surfels reach a row is as good as random, and a wrong guess costs more than a store.
    let mut end = touching.len();
    touching.resize(end + members.len(), 0);
    for &member in members {
        let s = &spans[member as usize];
        touching[end] = member;
        let in_row = (s.top <= y) & (s.bottom >= y) & (s.left <= last) & (s.right >= first);
        end += usize::from(in_row & (s.near <= farthest) & (s.far >= nearest));
    }
    touching.truncate(end);
}

/// Adds the surfaces of one leaf that the row's rays meet to `slots`.
///
/// `hidden_from` bounds, per lane, the depth from which on nothing can be seen any more. `generous` detection, for exact
/// leaves, takes every ray that passes a support ball as a candidate: the leaf's own surface decides later.
#[inline(always)]
pub fn detect<S: Simd>(
    row: &Row<S>,
    surfels: &[ViewSurfel],
    members: &[u32],
    generous: bool,
    hidden_from: f32x8<S>,
    slots: &mut Vec<Slot<S>>,
) {
    for &member in members {
        let s = &surfels[member as usize];
        if s.class.drawn().is_none() {
            continue;
        }
        let q = row.quadric(s);
        let m = &s.curvature;
        // Step 1: the quadric along the ray, about the reference depth.
        let me_x = q.ex * m[0] + (m[1] * q.ey + m[2] * q.ez);
        let me_y = q.ex * m[1] + (m[3] * q.ey + m[4] * q.ez);
        let me_z = q.ex * m[2] + (m[4] * q.ey + m[5] * q.ez);
        let ne = q.ex * s.normal[0] + (s.normal[1] * q.ey + s.normal[2] * q.ez);
        let a0 = ne + (q.ex * me_x + me_y * q.ey + me_z * q.ez) * 0.5;
        let a1 = q.nd + (row.dir_x * me_x + me_y * row.dir_y + me_z);
        let square = a1 * a1 - a0 * q.a2 * 4.0;
        let (root, real) =
            if generous { (square.max(0.0).sqrt(), row.live) } else { (square.sqrt(), square.simd_ge(0.0) & row.live) };
        // Step 2: the root that enters and the one that leaves, where inside the support.
        for front in [true, false] {
            if !(if front { s.may_enter } else { s.may_leave }) {
                continue;
            }
            let tau = crossing(a0, a1, q.a2, if front { root } else { -root });
            let (ex, ey, ez) = (q.ex + row.dir_x * tau, tau * row.dir_y + q.ey, tau + q.ez);
            let u = row.support(s, ex, ey, ez);
            let t = tau + s.z;
            // Comparisons are false for NaN, so a vanishing denominator drops the lane.
            let hit = real & u.simd_lt(1.0) & t.simd_lt(hidden_from);
            if hit.all_false() {
                continue;
            }
            let v = row.splat(1.0) - u;
            let w = v * v;
            join(row, slots, front, hit, t, w, s, member);
        }
    }
}

/// Where a0 + a1 τ + a2 τ² vanishes with the slope −`root`: of the two forms of that solution the one that subtracts no
/// nearly equal numbers (Press et al., *Numerical Recipes*, §5.6). Not a number, or infinite, where there is none.
#[inline(always)]
fn crossing<S: Simd>(a0: f32x8<S>, a1: f32x8<S>, a2: f32x8<S>, root: f32x8<S>) -> f32x8<S> {
    let cancels = (a1 * root).simd_gt(0.0);
    cancels.select(-a1 - root, a0 * 2.0) / cancels.select(a2 * 2.0, root - a1)
}

/// Adds candidates to the first slot whose surface they belong to, or opens a slot.
#[inline(always)]
#[allow(clippy::too_many_arguments)] // a kernel's inner step: its arguments live in registers
fn join<S: Simd>(
    row: &Row<S>,
    slots: &mut Vec<Slot<S>>,
    front: bool,
    mut pending: mask32x8<S>,
    t: f32x8<S>,
    w: f32x8<S>,
    s: &ViewSurfel,
    member: u32,
) {
    let zero = row.splat(0.0);
    for slot in slots.iter_mut() {
        if slot.front != front {
            continue;
        }
        let reach = row.splat(s.reach);
        let overlaps = (t + reach).simd_ge(slot.lower) & (t - reach).simd_le(slot.upper);
        let fresh = !slot.lanes;
        let takes = pending & (fresh | overlaps);
        if takes.all_false() {
            continue;
        }
        let w = takes.select(w, zero);
        slot.lower = takes.select(fresh.select(t - reach, slot.lower.min(t - reach)), slot.lower);
        slot.upper = takes.select(fresh.select(t + reach, slot.upper.max(t + reach)), slot.upper);
        slot.weight += w;
        slot.weighted_depth += takes.select(w * t, zero);
        let better = takes & w.simd_ge(slot.best_weight);
        slot.best_weight = better.select(w, slot.best_weight);
        slot.best_depth = better.select(t, slot.best_depth);
        slot.best_radius = better.select(row.splat(s.radius), slot.best_radius);
        slot.best = better.select(u32x8::splat(row.simd, member), slot.best);
        slot.lanes |= takes;
        pending &= !takes;
        if pending.all_false() {
            return;
        }
    }
    let w = pending.select(w, zero);
    slots.push(Slot {
        front,
        lanes: pending,
        lower: t - s.reach,
        upper: t + s.reach,
        weight: w,
        weighted_depth: pending.select(w * t, zero),
        best_weight: w,
        best_depth: t,
        best: u32x8::splat(row.simd, member),
        best_radius: row.splat(s.radius),
    });
}

/// Where and how a row's rays meet one surface.
#[derive(Clone, Copy)]
pub struct Solution<S: Simd> {
    /// Lanes that hit.
    pub lanes: mask32x8<S>,
    /// Lanes that seem to pass the surface although they meet it by what the nearest surfel says.
    pub dropped: mask32x8<S>,
    /// Those of them where no surfel but the nearest speaks for the surface: its normal and colour count.
    pub weightless: mask32x8<S>,
    /// Depth relative to the tile's anchor.
    pub t: f32x8<S>,
    /// The leaf's outward normal in view axes, of any length.
    pub normal: [f32x8<S>; 3],
    /// Linear RGB.
    pub colour: [f32x8<S>; 3],
    /// Opacity.
    pub opacity: f32x8<S>,
}

/// Solves for the surface of `slot` on the field of its leaf (module text, *Theory*). `refine` adds that many steps on
/// the field with its weights renewed at the hit. With `crosses` the rays are known to meet the surface, and none is dropped.
#[inline(always)]
#[allow(clippy::too_many_arguments)] // a kernel's inner step: its arguments live in registers
pub fn solve<S: Simd>(
    row: &Row<S>,
    surfels: &[ViewSurfel],
    members: &[u32],
    slot: &Slot<S>,
    wanted: mask32x8<S>,
    refine: u32,
    crosses: bool,
    reaching: &mut Vec<u32>,
) -> Solution<S> {
    let zero = row.splat(0.0);
    let start = slot.depth();
    let mut lanes = wanted & slot.lanes;
    // Step 1: the quadratic about the mean candidate.
    let (mut a0, mut a1, mut a2, mut weight) = (zero, zero, zero, zero);
    let (mut normal, mut slope, mut colour, mut opacity) = ([zero; 3], [zero; 3], [zero; 3], zero);
    reaching.clear();
    let span = row.span(start, lanes);
    let sheet = Sheet::of(row, surfels, slot);
    for &member in members {
        let s = &surfels[member as usize];
        if s.near > span.1 || s.far < span.0 {
            continue;
        }
        let q = row.quadric(s);
        let f = field(row, s, &q, start);
        let faces = sheet.holds(s, f.slope);
        let counts = lanes & faces & f.support.simd_lt(1.0);
        if counts.all_false() {
            continue;
        }
        reaching.push(member);
        let w = counts.select(f.weight(row), zero);
        weight += w;
        a0 += w * counts.select(f.value, zero);
        a1 += w * f.slope;
        a2 += w * q.a2;
        for (k, md) in [q.md_x, q.md_y, q.md_z].into_iter().enumerate() {
            normal[k] += w * (f.me[k] + s.normal[k]);
            slope[k] += w * md;
            colour[k] += w * s.colour[k];
        }
        opacity += w * s.opacity;
    }
    let square = a1 * a1 - a0 * a2 * 4.0;
    let root = square.max(0.0).sqrt();
    let tau = crossing(a0, a1, a2, if slot.front { root } else { -root });
    // Edge-on, the mean candidate may lie beyond where the ray is nearest to the surface: the root lies before.
    let sign_right = sheet.may_face(a1 / weight);
    let near = tau.abs().simd_lt(slot.best_radius * FARTHEST_SOLVE_IN_RADII);
    let solved = lanes & square.simd_ge(0.0) & sign_right & near & weight.simd_gt(LEAST_WEIGHT);
    // A ray that misses passes the surface at a grazing angle: that is a silhouette, and the group is dropped. A steep ray
    // that has no solution meets a surface whose surfels disagree (noise, a crease): it keeps its nearest surfel's hit.
    let along = normal[0] * row.dir_x + normal[1] * row.dir_y + normal[2];
    let length = normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2];
    let ray = row.dir_x * row.dir_x + (row.dir_y * row.dir_y + 1.0);
    let steep = (along * along).simd_gt(length * ray * GRAZING_COSINE_SQUARED) | weight.simd_le(LEAST_WEIGHT);
    let sure = lanes & !solved & slot.best_weight.simd_gt(SURE_WEIGHT);
    let kept = if crosses { sure } else { sure & steep };
    let dropped = sure & !kept;
    lanes = solved | kept;
    let tau = solved.select(tau, zero);
    let mut t = solved.select(start + tau, slot.best_depth);
    let normal: [f32x8<S>; 3] = std::array::from_fn(|k| normal[k] + slope[k] * tau);
    // Step 2: Newton steps on the field, weights renewed, over the surfels that reached the first guess: one that only
    // reaches the hit has next to no weight there. A step that diverges keeps the hit it had.
    for _ in 0..refine {
        if lanes.all_false() {
            break;
        }
        let (mut value, mut rate, mut total) = (zero, zero, zero);
        for &member in reaching.iter() {
            let s = &surfels[member as usize];
            let q = row.quadric(s);
            let f = field(row, s, &q, t);
            let faces = sheet.holds(s, f.slope);
            let counts = lanes & faces & f.support.simd_lt(1.0);
            if counts.all_false() {
                continue;
            }
            let w = counts.select(f.weight(row), zero);
            total += w;
            value += w * counts.select(f.value, zero);
            rate += w * f.slope;
        }
        let step = value / rate;
        let small = step.abs().simd_lt(slot.best_radius * MOST_STEP_IN_RADII);
        let good = solved & total.simd_gt(LEAST_WEIGHT) & sheet.faces(rate) & small;
        t = good.select(t - step, t);
    }
    let share = row.splat(1.0) / weight;
    let weightless = lanes & weight.simd_le(LEAST_WEIGHT);
    Solution { lanes, dropped, weightless, t, normal, colour: colour.map(|c| c * share), opacity: opacity * share }
}

/// Which surfels are of the surface that a slot is about: those that the ray meets from its side, and, where the nearest is met
/// edge-on, those of the same sheet that are so too, whichever way they turn. Without the latter a ray that just misses a silhouette
/// meets the half of it that faces it.
struct Sheet<S: Simd> {
    front: bool,
    /// Normals of the slot's nearest surfels.
    normal: [f32x8<S>; 3],
    /// Slopes along the ray up to which a surfel is met edge-on; 0 where the nearest is not.
    edge_on: f32x8<S>,
}

impl<S: Simd> Sheet<S> {
    #[inline(always)]
    fn of(row: &Row<S>, surfels: &[ViewSurfel], slot: &Slot<S>) -> Self {
        let best: [u32; LANES] = slot.best.into();
        let of_best = |k: usize| std::array::from_fn(|lane| surfels[best[lane] as usize].normal[k]);
        let normal = std::array::from_fn(|k| f32x8::load_array(row.simd, of_best(k)));
        let grazing = std::array::from_fn(|lane| match &surfels[best[lane] as usize] {
            s if s.is_edge_on() => GRAZING_COSINE_SQUARED,
            _ => 0.0,
        });
        let ray = row.dir_x * row.dir_x + (row.dir_y * row.dir_y + 1.0);
        Self { front: slot.front, normal, edge_on: (ray * f32x8::load_array(row.simd, grazing)).sqrt() }
    }

    /// Whether a field of this slope is met from the slot's side.
    #[inline(always)]
    fn faces(&self, slope: f32x8<S>) -> mask32x8<S> {
        if self.front { slope.simd_lt(0.0) } else { slope.simd_gt(0.0) }
    }

    /// Whether it is so, or edge-on.
    #[inline(always)]
    fn may_face(&self, slope: f32x8<S>) -> mask32x8<S> {
        if self.front { slope.simd_lt(self.edge_on) } else { slope.simd_gt(-self.edge_on) }
    }

    #[inline(always)]
    fn holds(&self, s: &ViewSurfel, slope: f32x8<S>) -> mask32x8<S> {
        if !s.is_edge_on() {
            return self.faces(slope);
        }
        let [x, y, z] = self.normal;
        let same = (x * s.normal[0] + y * s.normal[1] + z * s.normal[2]).simd_gt(SAME_SHEET);
        self.faces(slope) | (same & self.may_face(slope))
    }
}

/// One surfel's terms of the field at depth `t`.
struct Field<S: Simd> {
    /// |e|²/r².
    support: f32x8<S>,
    /// n·e + ½ eᵀMe.
    value: f32x8<S>,
    /// Its derivative along the ray.
    slope: f32x8<S>,
    /// M e.
    me: [f32x8<S>; 3],
}

impl<S: Simd> Field<S> {
    /// (1 − |e|²/r²)⁴.
    #[inline(always)]
    fn weight(&self, row: &Row<S>) -> f32x8<S> {
        let v = row.splat(1.0) - self.support;
        let v = v * v;
        v * v
    }
}

#[inline(always)]
fn field<S: Simd>(row: &Row<S>, s: &ViewSurfel, q: &Quadric<S>, t: f32x8<S>) -> Field<S> {
    let tau = t - s.z;
    let (ex, ey, ez) = (q.ex + row.dir_x * tau, tau * row.dir_y + q.ey, tau + q.ez);
    let m = &s.curvature;
    let me = [ex * m[0] + ey * m[1] + ez * m[2], ex * m[1] + ey * m[3] + ez * m[4], ex * m[2] + ey * m[4] + ez * m[5]];
    let ne = ex * s.normal[0] + ey * s.normal[1] + ez * s.normal[2];
    Field {
        support: row.support(s, ex, ey, ez),
        value: ne + (ex * me[0] + ey * me[1] + ez * me[2]) * 0.5,
        slope: q.nd + (row.dir_x * me[0] + me[1] * row.dir_y + me[2]),
        me,
    }
}

/// The field of another leaf at the rays' points of depth `t`: value (its sign is the side, inside negative) and the
/// weight of the surfels that reach it, by which it is multiplied.
#[inline(always)]
pub fn ask<S: Simd>(
    row: &Row<S>,
    surfels: &[ViewSurfel],
    members: &[u32],
    t: f32x8<S>,
    lanes: mask32x8<S>,
) -> (f32x8<S>, f32x8<S>) {
    let zero = row.splat(0.0);
    let (mut value, mut weight) = (zero, zero);
    for &member in members {
        let s = &surfels[member as usize];
        let tau = t - s.z;
        let (ex, ey, ez) =
            ((row.x - s.u) * s.scale + row.dir_x * tau, tau * row.dir_y + (row.y - s.v) * s.scale, tau + s.lift);
        let support = row.support(s, ex, ey, ez);
        let counts = lanes & support.simd_lt(1.0);
        if counts.all_false() {
            continue;
        }
        let m = &s.curvature;
        let me_x = ex * m[0] + ey * m[1] + ez * m[2];
        let me_y = ex * m[1] + ey * m[3] + ez * m[4];
        let me_z = ex * m[2] + ey * m[4] + ez * m[5];
        let ne = ex * s.normal[0] + ey * s.normal[1] + ez * s.normal[2];
        let v = row.splat(1.0) - support;
        let v = v * v;
        let w = counts.select(v * v, zero);
        weight += w;
        value += w * counts.select(ne + (ex * me_x + ey * me_y + ez * me_z) * 0.5, zero);
    }
    (value, weight)
}
