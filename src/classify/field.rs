//! One leaf of a scene, ready to be asked: is a point inside, does the surface come within a distance of it.
//!
//! # Theory
//! Wicke 2004 §3.1.1 takes the sign of the nearest surfel's plane, §3.1.2 compares a surfel's radius with its distance to
//! the other object's surface. Here planes give way to curved surfels, blended by their weights:
//! `f(x) = Σ w (n·e + ½ eᵀMe) / Σ w`, `e = x − c`, `w = (1 − |e|²/r²)⁴`.
//!
//! # Changes from the paper
//! * A leaf that is an analytic solid or a mesh is asked exactly.
//! * Far from a closed scan the sign is the winding number's, because the nearest plane is wrong beyond a sharp wedge: a
//!   point beside the edge of a 30° wedge lies behind the plane of the *other* face. Near the surface the sign counts
//!   only if the neighbouring surfels agree on it; else the ball is called `Near`, which is never wrong.
//! * A scan that is open (a single disk standing for a half-space, say) keeps the nearest plane: a winding number near
//!   0 says nothing there.
//!
//! # Practice
//! `Near` is the safe answer everywhere in this file: it costs a per-pixel test, never a wrong picture.

use glam::{DVec3, Vec3};

use crate::csg::residual::Membership;
use crate::geometry::exact::Exact;
use crate::geometry::winding::{Element, Winding};
use crate::scene::LeafKind;
use crate::space::{Motion, Ray};
use crate::surfel::SurfelCloud;
use crate::surfel::ball_tree::BallTree;

/// Area of a surfel as a share of r²: radii are 1.3 times the distance to the 6th neighbour, and a disk of that distance
/// holds about 6.5 surfels, so a = π (r / 1.3)² / 6.5.
const AREA_PER_RADIUS_SQUARED: f64 = std::f64::consts::PI / (1.3 * 1.3 * 6.5);

/// |Σ a n| / Σ a above which a scan counts as open. A scanned bone with a missing end has about 0.1, a half-space 1.
const MOST_OPENNESS: f64 = 0.3;

/// The same above which all surfels look the same way: a spread of 8°, more than noise gives.
const LEAST_OF_A_PLANE: f64 = 0.99;

/// A surfel's sign is taken where its disk is farther from the point than the point's own radius plus this share of its own: a
/// curved or noisy surface leaves its surfel's plane by less within the disk.
const PLANE_MARGIN: f32 = 0.25;

/// One leaf's geometry in world space with the searches over it.
#[derive(Debug)]
pub struct LeafField {
    /// Its surfels.
    pub cloud: SurfelCloud,
    tree: BallTree,
    /// Where the leaf is represented as itself.
    pub exact: Option<Exact>,
    /// Solid or sheet.
    pub kind: LeafKind,
    winding: Option<Inside>,
    sides: Sides,
    /// The surfels' largest radius, world units.
    largest_radius: f32,
}

/// What the sides of places far from a leaf's surfels go by.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sides {
    /// The leaf itself, or nothing: it is exact, or a sheet.
    Itself,
    /// Winding numbers: the surfels close a volume.
    Winding,
    /// The plane that all surfels lie in, or are parallel to: they stand for the half-space behind them.
    HalfSpace,
    /// The nearest surfel's plane: much of the surface has no other side.
    Open,
    /// Winding numbers; but the normals look inwards, so that nothing is inside.
    Inward,
    /// The nearest surfel's plane: the surface is closed, and its surfels do not agree where its inside is.
    Unclear,
}

/// Winding numbers with the level that separates inside from outside.
#[derive(Debug)]
struct Inside {
    winding: Winding,
    threshold: f64,
    /// Whether the normals look inwards.
    is_inward: bool,
}

impl LeafField {
    /// Over `cloud`; `exact` where the leaf is an analytic solid or a mesh that is to be asked exactly.
    pub fn new(cloud: SurfelCloud, exact: Option<Exact>, kind: LeafKind) -> Self {
        let (winding, sides) = match exact.is_none() && kind == LeafKind::Solid {
            true => match Inside::of(&cloud) {
                Ok(inside) if inside.is_inward => (Some(inside), Sides::Inward),
                Ok(inside) => (Some(inside), Sides::Winding),
                Err(sides) => (None, sides),
            },
            false => (None, Sides::Itself),
        };
        let tree = BallTree::new(&cloud);
        let largest_radius = cloud.surfels.iter().map(|surfel| surfel.radius).fold(0.0, f32::max);
        Self { cloud, tree, exact, kind, winding, sides, largest_radius }
    }

    /// The leaf moved by `motion`.
    pub fn moved(&self, motion: &Motion) -> Self {
        let exact = self.exact.as_ref().map(|exact| exact.moved(motion));
        Self::new(self.cloud.moved(motion), exact, self.kind)
    }

    /// The surfel whose centre is nearest to `p_in_world`, and its distance; `None` without surfels, or where the point is not
    /// finite.
    pub fn nearest(&self, p_in_world: DVec3) -> Option<(u32, f32)> {
        let mut found = Vec::with_capacity(1);
        self.nearest_k(p_in_world, 1, &mut found);
        found.first().copied()
    }

    /// Fills `found` with the `k` surfels whose centres are nearest to `p_in_world`: index and distance, nearest first.
    pub fn nearest_k(&self, p_in_world: DVec3, k: usize, found: &mut Vec<(u32, f32)>) {
        self.tree.nearest_k(&self.cloud, p_in_world, k, found);
    }

    /// Fills `found` with the surfels whose support balls meet a ball: index and distance of the centres, by index.
    pub fn touching(&self, centre_in_world: DVec3, radius: f64, found: &mut Vec<(u32, f32)>) {
        self.tree.touching(&self.cloud, centre_in_world, radius, found);
    }

    /// Whether a surfel's support ball meets a ball.
    pub fn reaches(&self, centre_in_world: DVec3, radius: f64) -> bool {
        self.tree.touches(&self.cloud, centre_in_world, radius)
    }

    /// Whether the leaf can decide anything about others' surfels by its own (a solid that is not exact).
    pub fn lends_surfels(&self) -> bool {
        self.exact.is_none() && self.kind == LeafKind::Solid
    }

    /// The winding numbers that tell sides far from the surface, and the one above which a point is inside; `None` where the
    /// nearest surfel's plane tells them.
    #[cfg(feature = "gpu")]
    pub(crate) fn winding(&self) -> Option<(&Winding, f64)> {
        self.winding.as_ref().map(|inside| (&inside.winding, inside.threshold))
    }

    /// The tree over the surfels' balls.
    #[cfg(feature = "gpu")]
    pub(crate) fn ball_tree(&self) -> &BallTree {
        &self.tree
    }

    /// Whether sides far from the surface hold for some distance at all: not those of a scan that is open.
    pub fn has_steady_sides(&self) -> bool {
        self.winding.is_some()
    }

    /// What its sides go by far from its surfels.
    pub fn sides(&self) -> Sides {
        self.sides
    }

    /// Whether a ray enters and leaves it by turns, and what surfels say can be held to that.
    pub fn takes_turns(&self) -> bool {
        self.kind == LeafKind::Solid && self.has_steady_sides()
    }

    /// How a whole ball of world space lies to this leaf; `Near` unless the surface certainly misses it.
    pub fn ball(&self, centre_in_world: DVec3, radius: f64) -> Membership {
        if self.kind == LeafKind::Sheet {
            return Membership::Out; // INVARIANT: a sheet never cuts
        }
        if let Some(exact) = &self.exact {
            return match exact.is_farther_than(centre_in_world, radius) {
                true => side(exact.contains(centre_in_world)),
                false => Membership::Near,
            };
        }
        // With a winding number the next step asks for a larger clearance than this one.
        if self.winding.is_none() && self.tree.touches(&self.cloud, centre_in_world, radius) {
            return Membership::Near;
        }
        self.unreached_ball(centre_in_world, radius)
    }

    /// How a ball that no support reaches lies to this leaf: `Near` where its side may change within it, as it does beside a
    /// hole of a scan or beyond the border of an open one.
    fn unreached_ball(&self, centre_in_world: DVec3, radius: f64) -> Membership {
        // A side that is steady up to a share of the distance to the surface holds in the ball where the surface is as much
        // farther away than the ball reaches. The largest share there is tells most balls without a winding number.
        let is_clear = |share: f64| share > 0.0 && !self.tree.touches(&self.cloud, centre_in_world, radius / share);
        let most = steady_share(0.0);
        if self.winding.is_some() && !is_clear(most) {
            return Membership::Near;
        }
        let far = self.far_side(centre_in_world);
        let holds = match self.winding {
            Some(_) => far.steady_share >= most || is_clear(far.steady_share),
            None => match self.nearest(centre_in_world) {
                // Beyond its disk the nearest surfel's plane decides.
                Some((nearest, _)) => {
                    let e = centre_in_world - self.cloud.centre(nearest as usize);
                    e.dot(self.cloud.surfels[nearest as usize].normal.as_dvec3()).abs() > radius
                }
                None => true,
            },
        };
        if holds { side(far.inside) } else { Membership::Near }
    }

    /// How far around the point that was asked about `far` holds, world units.
    pub fn steady_distance(&self, far: &FarSide, p_in_world: DVec3) -> f64 {
        // Radii are at least 1.25 times the distance from a surfel to the farthest place that it has to cover.
        const COVERED_SHARE: f32 = 0.8;
        if !(far.steady_share > 0.0) {
            return 0.0;
        }
        far.steady_share * f64::from(self.tree.clearance(&self.cloud, p_in_world, COVERED_SHARE)).max(0.0)
    }

    /// How the ball of one surfel lies to this leaf: tighter than [`ball`](Self::ball), which said `Near`. `scratch` may
    /// hold what neighbours of the surfel were told.
    pub fn surfel_ball(&self, centre_in_world: DVec3, radius: f32, scratch: &mut BallScratch) -> Membership {
        if self.exact.is_some() || self.kind == LeafKind::Sheet {
            return self.ball(centre_in_world, f64::from(radius));
        }
        let holds =
            |(p, distance, _): &&(DVec3, f64, Membership)| centre_in_world.distance(*p) + f64::from(radius) < *distance;
        if let Some((_, _, membership)) = scratch.steady.iter().rev().find(holds) {
            return *membership;
        }
        let found = &mut scratch.found;
        self.tree.touching(&self.cloud, centre_in_world, f64::from(radius), found);
        let Some(&(nearest, _)) = found.iter().min_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0))) else {
            if self.winding.is_none() {
                return self.unreached_ball(centre_in_world, f64::from(radius));
            }
            let far = self.far_side(centre_in_world);
            let distance = self.steady_distance(&far, centre_in_world);
            if !(f64::from(radius) < distance) {
                return Membership::Near;
            }
            scratch.steady.push((centre_in_world, distance, side(far.inside)));
            return side(far.inside);
        };
        let height = |t: u32| {
            let e = (centre_in_world - self.cloud.centre(t as usize)).as_vec3();
            e.dot(self.cloud.surfels[t as usize].normal)
        };
        let is_inside = height(nearest) < 0.0;
        // Each disk must keep clear of the ball, not the nearest alone: under irregular sampling a large disk with a far centre
        // may pass through the ball while the small one nearest to it lies aside.
        let clear = |&(t, distance): &(u32, f32)| {
            let (h, disk) = (height(t), self.cloud.surfels[t as usize].radius);
            let beyond_border = ((distance * distance - h * h).max(0.0).sqrt() - disk).max(0.0);
            (h < 0.0) == is_inside && h.hypot(beyond_border) > radius + PLANE_MARGIN * disk
        };
        if found.iter().all(clear) { side(is_inside) } else { Membership::Near }
    }

    /// Whether a point is inside, decided by the curved field where surfels reach it, else by the nearest one's plane or
    /// the winding number. `found` is scratch.
    pub fn contains(&self, p_in_world: DVec3, found: &mut Vec<(u32, f32)>) -> bool {
        if self.kind == LeafKind::Sheet {
            return false;
        }
        if let Some(exact) = &self.exact {
            return exact.contains(p_in_world);
        }
        let FieldAt { weights, values, .. } = self.field_at(p_in_world, found);
        if weights > 0.0 {
            return values < 0.0;
        }
        self.far_inside(p_in_world)
    }

    /// The curved field's sums at a point.
    fn field_at(&self, p_in_world: DVec3, found: &mut Vec<(u32, f32)>) -> FieldAt {
        self.tree.touching(&self.cloud, p_in_world, 0.0, found);
        let mut sums = FieldAt::default();
        for &(t, _) in found.iter() {
            let surfel = &self.cloud.surfels[t as usize];
            let e = (p_in_world - self.cloud.centre(t as usize)).as_vec3();
            let support = match &self.cloud.supports {
                Some(supports) => e.dot(supports[t as usize].mul(e)),
                None => e.length_squared() / (surfel.radius * surfel.radius),
            };
            let v = (1.0 - support).max(0.0);
            let w = (v * v) * (v * v);
            let bend = surfel.curvature.mul(e);
            sums.weights += w;
            sums.values += w * (e.dot(surfel.normal) + 0.5 * e.dot(bend));
            sums.normals += (surfel.normal + bend) * w;
            sums.radii += w * surfel.radius;
        }
        sums
    }

    /// The largest radius of the leaf's surfels, world units; infinite where it has none, and is exact.
    pub fn largest_radius(&self) -> f32 {
        if self.cloud.is_empty() { f32::INFINITY } else { self.largest_radius }
    }

    /// The outward unit normal of the leaf's surface where that is as near to `p_in_world` as `share` of `radius` (world units), or
    /// of the mean radius of the surfels there where that is less: of the curved field's surface, or of an exact leaf's along the unit
    /// direction `along_in_world`. `found` is scratch.
    pub fn surface_within(
        &self,
        p_in_world: DVec3,
        along_in_world: DVec3,
        (share, radius): (f32, f32),
        found: &mut Vec<(u32, f32)>,
    ) -> Option<DVec3> {
        if let Some(exact) = &self.exact {
            let tolerance = f64::from(share * radius.min(self.largest_radius()));
            if exact.is_farther_than(p_in_world, tolerance) {
                return None;
            }
            let line = Ray { origin: p_in_world, dir: along_in_world };
            let crossing = |front| exact.nearest_crossing(&line, 0.0, tolerance, front);
            let hits = [crossing(true), crossing(false)].into_iter().flatten();
            return hits.min_by(|a, b| a.t.abs().total_cmp(&b.t.abs())).map(|hit| hit.normal_in_world);
        }
        let FieldAt { weights, values, normals, radii } = self.field_at(p_in_world, found);
        // NaN, where no surfel reaches, is not near.
        let is_near = (values / weights).abs() <= share * radius.min(radii / weights);
        is_near.then(|| normals.as_dvec3().normalize_or_zero())
    }

    /// The side of a point that no surfel reaches.
    pub fn far_inside(&self, p_in_world: DVec3) -> bool {
        self.far_side(p_in_world).inside
    }

    /// As [`far_inside`](Self::far_inside), with how far around the point it holds.
    pub fn far_side(&self, p_in_world: DVec3) -> FarSide {
        if let Some(inside) = &self.winding {
            let level = 0.5 * inside.winding.at(p_in_world) / inside.threshold;
            return FarSide { inside: level > 0.5, steady_share: steady_share(level.min(1.0 - level)) };
        }
        let before_plane = |nearest: u32| {
            let e = (p_in_world - self.cloud.centre(nearest as usize)).as_vec3();
            e.dot(self.cloud.surfels[nearest as usize].normal) < 0.0
        };
        // A plane goes on beyond its disk, so no distance from the surfels keeps a point on its side of it.
        FarSide {
            inside: self.nearest(p_in_world).is_some_and(|(nearest, _)| before_plane(nearest)),
            steady_share: 0.0,
        }
    }
}

/// Sums over the surfels that reach a point, with their weights.
#[derive(Debug, Clone, Copy, Default)]
struct FieldAt {
    weights: f32,
    /// Of their quadrics' values.
    values: f32,
    /// Of their quadrics' normals.
    normals: Vec3,
    /// Of their radii.
    radii: f32,
}

/// Reused between the surfels of a chunk, which lie near each other.
#[derive(Debug, Default)]
pub struct BallScratch {
    found: Vec<(u32, f32)>,
    /// Points that no surfel of the leaf reaches, and how far around each which side holds; at most one for each surfel of the
    /// chunk, and the last is the likeliest to hold.
    steady: Vec<(DVec3, f64, Membership)>,
}

/// The side of a point that no surfel reaches.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FarSide {
    /// Whether it is inside.
    pub inside: bool,
    /// The same side holds within this share of the distance to the nearest surface element.
    pub steady_share: f64,
}

/// How far the side of a winding number holds, as a share of the distance R to the surface, where the number is `doubt` away
/// from certainty (0 or 1).
///
/// Between surface elements the winding number is harmonic and lies between 0 and 1, so by Harnack's inequality in space
/// `doubt` grows at distance sR to at most doubt (1 + s) / (1 − s)². It stays below ½ up to the s solved for here; a point in
/// the middle of a scan's hole, half in doubt, answers for itself alone.
fn steady_share(doubt: f64) -> f64 {
    const LEAST_DOUBT: f64 = 0.02; // what the dipoles' own error may hide
    if !(doubt < 0.5) {
        return 0.0;
    }
    let growth = 0.5 / doubt.max(LEAST_DOUBT);
    ((2.0 * growth + 1.0) - (8.0 * growth + 1.0).sqrt()) / (2.0 * growth)
}

fn side(inside: bool) -> Membership {
    if inside { Membership::In } else { Membership::Out }
}

impl Inside {
    /// Or what sides go by where the winding numbers of `cloud` mean nothing.
    fn of(cloud: &SurfelCloud) -> Result<Self, Sides> {
        let winding = Winding::new(
            (0..cloud.len())
                .map(|i| {
                    let s = &cloud.surfels[i];
                    let area = AREA_PER_RADIUS_SQUARED * f64::from(s.radius).powi(2);
                    Element { position: cloud.centre(i), area_normal: s.normal.as_dvec3() * area }
                })
                .collect(),
        );
        match winding.openness() {
            openness if openness < MOST_OPENNESS => {}
            openness if openness > LEAST_OF_A_PLANE => return Err(Sides::HalfSpace),
            _ => return Err(Sides::Open),
        }
        // The area estimate is wrong by a constant where the file brought its own radii or scans overlap, so "inside"
        // is calibrated just below the surface: far enough for dipoles, near enough not to cross a thin part. A tail or a toe is
        // thinner than the deeper probe goes; there the other one tells.
        const PROBES: usize = 33;
        const DEPTHS_IN_RADII: [f64; 2] = [3.0, 1.5];
        // Where a probe finds less than this share of what half as deep a one finds, it has gone through.
        const THROUGH_SHARE: f64 = 0.5;
        let step = (cloud.len() / PROBES).max(1);
        let probe = |i: usize| {
            let s = &cloud.surfels[i];
            let [deep, shallow] = DEPTHS_IN_RADII.map(|depth| {
                let below = s.normal.as_dvec3() * (depth * f64::from(s.radius));
                let (below, above) = (winding.at(cloud.centre(i) - below), winding.at(cloud.centre(i) + below));
                (below - above, below + above)
            });
            if deep.0 >= THROUGH_SHARE * shallow.0 { deep } else { shallow }
        };
        let (mut levels, mut sums): (Vec<f64>, Vec<f64>) = (0..cloud.len()).step_by(step).map(probe).unzip();
        levels.sort_by(f64::total_cmp);
        sums.sort_by(f64::total_cmp);
        let (level, low) = (levels[levels.len() / 2], levels[levels.len() / 4]);
        // A leaf of a few dozen surfels is thinner than the probes are deep, and they come out on its other side.
        const LEAST_LEVEL: f64 = 0.2; // radii half as large as estimated ones would give a quarter
        const AGREED_SHARE: f64 = 0.5;
        if !(level > LEAST_LEVEL && low > AGREED_SHARE * level) {
            return Err(Sides::Unclear);
        }
        // Inside of normals that look outwards the number is 1, inside of others −1, and 0 outside of either.
        let is_inward = sums[sums.len() / 2] < 0.0;
        Ok(Self { winding, threshold: 0.5 * level, is_inward })
    }
}

#[cfg(test)]
mod tests {
    use glam::DAffine3;

    use super::*;
    use crate::geometry::Solid;
    use crate::surfel::from_solid;

    fn field_of(solid: &Solid, spacing: f64, is_inside_out: bool) -> LeafField {
        let mut cloud = from_solid(solid, DAffine3::IDENTITY, spacing).unwrap();
        if is_inside_out {
            cloud.surfels.iter_mut().for_each(|surfel| surfel.normal = -surfel.normal);
        }
        LeafField::new(cloud, None, LeafKind::Solid)
    }

    #[test]
    fn sides_go_by_winding_numbers_however_thin_the_leaf_is() {
        // As thin as a probe is deep, and thinner.
        for radius in [0.8, 0.3, 0.22] {
            let rod = Solid::Cylinder { from: DVec3::ZERO, to: DVec3::Z * 20.0, radius };
            let field = field_of(&rod, 0.1, false);
            assert_eq!(field.sides(), Sides::Winding, "{radius}");
            assert!(field.far_inside(DVec3::Z * 10.0) && !field.far_inside(DVec3::new(9.0, 3.0, 10.0)), "{radius}");
            assert_eq!(field_of(&rod, 0.1, true).sides(), Sides::Inward, "{radius}");
        }
    }

    #[test]
    fn what_has_no_inside_says_so() {
        let plane = Solid::HalfSpace { point: DVec3::ZERO, normal: DVec3::Z, extent: 1.0 };
        assert_eq!(field_of(&plane, 0.1, false).sides(), Sides::HalfSpace);
        let ball = Solid::Sphere { centre: DVec3::ZERO, radius: 1.0 };
        // What looks up is turned to look down.
        let mut bowl = from_solid(&ball, DAffine3::IDENTITY, 0.1).unwrap();
        bowl.surfels.iter_mut().for_each(|surfel| surfel.normal.z = -surfel.normal.z.abs());
        assert_eq!(LeafField::new(bowl, None, LeafKind::Solid).sides(), Sides::Open);
        let mut muddle = from_solid(&ball, DAffine3::IDENTITY, 0.1).unwrap();
        muddle.surfels.iter_mut().step_by(3).for_each(|surfel| surfel.normal = -surfel.normal);
        assert_eq!(LeafField::new(muddle, None, LeafKind::Solid).sides(), Sides::Unclear);
    }

    #[test]
    fn a_side_holds_as_far_as_harnack_lets_it() {
        assert_eq!(steady_share(0.5), 0.0);
        assert_eq!(steady_share(f64::NAN), 0.0);
        for doubt in [0.02, 0.1, 0.3, 0.49] {
            let s = steady_share(doubt);
            assert!((0.0..1.0).contains(&s));
            assert!((doubt * (1.0 + s) / ((1.0 - s) * (1.0 - s)) - 0.5).abs() < 1e-12);
        }
    }
}
