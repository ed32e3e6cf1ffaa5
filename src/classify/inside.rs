//! Whether a point is inside a leaf, asked of those of its surfels that may clip there.
//!
//! # Theory
//! Wicke 2004 §3.1.1. A surfel *clips* a point that is not behind it: x is inside where (x − c)·n < 0 (eq. 3). One nearest
//! surfel makes jagged edges, so the paper takes the two nearest, s₁ and s₂: they are *concave* where each clips the
//! other's centre (Fig. 3), and then either may let the point in (eq. 4), else both must (eq. 5). Zwicker 2004 discards
//! what any clipping plane discards, which is wrong at concave edges. Two more are ours: planes blended by
//! w = (1 − |e|²/r²)⁴, e = x − c, and the same with curved surfels, f(x) = Σ w (n·e + ½ eᵀMe) / Σ w.
//!
//! # Changes from the paper
//! * "Any plane" asks only partners whose ball holds the point: of all partners, some plane of a concave surface always
//!   objects.
//! * Where no ball holds the point, `any_plane`, `blend` and `curved` fall back on the nearest surfel's *plane*: an
//!   extrapolated quadric changes sign.
//!
//! # Practice
//! Coordinates are `f32` relative to the surfel that is clipped, so a scene far from the origin loses nothing. Of equally
//! near partners the first in the list counts, so answers follow the list's order and nothing else.

use glam::Vec3;

use crate::surfel::{Surfel, Sym3};

/// A clipping partner as the tests read it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PartnerDisk {
    /// Centre relative to the centre of the surfel that it clips, world axes and units.
    pub centre: Vec3,
    /// Unit outward normal of its leaf, world axes.
    pub normal: Vec3,
    /// Radius of its support ball, world units.
    pub radius: f32,
    /// Curvature M.
    pub curvature: Sym3,
    /// Where elliptical, S with eᵀSe = 1 on the support's border.
    pub support: Option<Sym3>,
}

impl PartnerDisk {
    /// `surfel` with its centre at `centre`, relative to whatever the points asked about are relative to.
    #[inline]
    pub fn new(surfel: &Surfel, centre: Vec3, support: Option<Sym3>) -> Self {
        Self { centre, normal: surfel.normal, radius: surfel.radius, curvature: surfel.curvature, support }
    }

    /// Eq. 3: whether the point is *not* behind the surfel; `sign` is −1 for a patch with all normals reversed.
    #[inline]
    fn clips(&self, x: Vec3, sign: f32) -> bool {
        !(sign * (x - self.centre).dot(self.normal) < 0.0)
    }

    /// |e|²/r², or eᵀSe: below 1 where the support holds centre + e.
    #[inline]
    fn support_at(&self, e: Vec3) -> f32 {
        match &self.support {
            None => e.length_squared() / (self.radius * self.radius),
            Some(s) => e.dot(s.mul(e)),
        }
    }
}

/// A patch: the surfels of one leaf that may clip a point, or the same with all normals reversed, which is how the paper
/// represents the leaf's complement (Wicke 2004 §4.1).
///
/// All tests tell whether the point is inside the *leaf*, whichever way it is asked, and `None` where there is no surfel to
/// ask. The two ways differ where a test prefers one side: `any_plane`, and pairs of `two_nearest` that clip one another
/// only one way.
#[derive(Debug, Clone, Copy)]
pub struct Patch<'a> {
    /// The surfels.
    pub disks: &'a [PartnerDisk],
    /// Whether the complement is asked.
    pub reversed: bool,
}

impl Patch<'_> {
    fn sign(&self) -> f32 {
        if self.reversed { -1.0 } else { 1.0 }
    }

    /// From inside the patch to inside the leaf.
    fn of_leaf(&self, inside: bool) -> bool {
        inside != self.reversed
    }

    fn nearest_disk(&self, x: Vec3) -> Option<&PartnerDisk> {
        // `min_by` keeps the first of equals.
        let square = |d: &PartnerDisk| d.centre.distance_squared(x);
        self.disks.iter().min_by(|a, b| square(a).total_cmp(&square(b)))
    }

    /// The side of the nearest surfel's plane (eq. 3).
    pub fn nearest(&self, x: Vec3) -> Option<bool> {
        let disk = self.nearest_disk(x)?;
        Some(self.of_leaf(!disk.clips(x, self.sign())))
    }

    /// The two nearest surfels' planes (eqs. 3 to 5).
    pub fn two_nearest(&self, x: Vec3) -> Option<bool> {
        let (first, second) = self.two_nearest_disks(x)?;
        let sign = self.sign();
        let Some(second) = second else { return Some(self.of_leaf(!first.clips(x, sign))) };
        let concave = first.clips(second.centre, sign) && second.clips(first.centre, sign);
        let (in_first, in_second) = (!first.clips(x, sign), !second.clips(x, sign));
        Some(self.of_leaf(if concave { in_first || in_second } else { in_first && in_second }))
    }

    fn two_nearest_disks(&self, x: Vec3) -> Option<(&PartnerDisk, Option<&PartnerDisk>)> {
        let (mut first, mut second): ((f32, Option<usize>), (f32, Option<usize>)) =
            ((f32::INFINITY, None), (f32::INFINITY, None));
        for (i, disk) in self.disks.iter().enumerate() {
            let square = disk.centre.distance_squared(x);
            if square < first.0 || first.1.is_none() {
                second = first;
                first = (square, Some(i));
            } else if square < second.0 || second.1.is_none() {
                second = (square, Some(i));
            }
        }
        Some((&self.disks[first.1?], second.1.map(|i| &self.disks[i])))
    }

    /// Outside where the plane of any surfel whose ball holds the point says so.
    pub fn any_plane(&self, x: Vec3) -> Option<bool> {
        let sign = self.sign();
        let mut close = self.disks.iter().filter(|d| d.support_at(x - d.centre) < 1.0).peekable();
        if close.peek().is_none() {
            return self.nearest(x);
        }
        Some(self.of_leaf(close.all(|d| !d.clips(x, sign))))
    }

    /// The sign of the planes' weighted mean.
    pub fn blend(&self, x: Vec3) -> Option<bool> {
        self.weighted(x, |disk, e| disk.normal.dot(e))
    }

    /// The sign of the weighted mean of curved surfels.
    pub fn curved(&self, x: Vec3) -> Option<bool> {
        self.weighted(x, |disk, e| disk.normal.dot(e) + 0.5 * e.dot(disk.curvature.mul(e)))
    }

    #[inline]
    fn weighted(&self, x: Vec3, height: impl Fn(&PartnerDisk, Vec3) -> f32) -> Option<bool> {
        let (mut weights, mut heights) = (0.0_f32, 0.0_f32);
        for disk in self.disks {
            let e = x - disk.centre;
            let v = (1.0 - disk.support_at(e)).max(0.0);
            let w = (v * v) * (v * v);
            weights += w;
            heights += w * height(disk, e);
        }
        if weights > 0.0 { Some(heights < 0.0) } else { self.nearest(x) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A test by name.
    type Test = (&'static str, fn(&Patch<'_>, Vec3) -> Option<bool>);

    const TESTS: [Test; 5] = [
        ("nearest", |p, x| p.nearest(x)),
        ("two-nearest", |p, x| p.two_nearest(x)),
        ("any-plane", |p, x| p.any_plane(x)),
        ("blend", |p, x| p.blend(x)),
        ("curved", |p, x| p.curved(x)),
    ];

    fn disk(centre: Vec3, normal: Vec3) -> PartnerDisk {
        PartnerDisk { centre, normal: normal.normalize(), radius: 2.0, curvature: Sym3::default(), support: None }
    }

    /// A sphere of radius `big` about `middle`: a Fibonacci lattice of `n` surfels.
    fn sphere(middle: Vec3, big: f32, n: usize) -> Vec<PartnerDisk> {
        let golden = std::f32::consts::PI * (3.0 - 5f32.sqrt());
        // Area a surfel, so that about a dozen balls hold each point of the surface.
        let radius = 2.0 * big * (4.0 / n as f32).sqrt();
        (0..n)
            .map(|i| {
                let z = 1.0 - (2.0 * i as f32 + 1.0) / n as f32;
                let (s, c) = (golden * i as f32).sin_cos();
                let side = (1.0 - z * z).sqrt();
                let normal = Vec3::new(c * side, s * side, z);
                let curvature = Sym3::from_mat3(glam::Mat3::IDENTITY * (1.0 / big));
                PartnerDisk { centre: middle + normal * big, normal, radius, curvature, support: None }
            })
            .collect()
    }

    #[test]
    fn nobody_to_ask() {
        for (name, test) in TESTS {
            assert_eq!(test(&Patch { disks: &[], reversed: false }, Vec3::ZERO), None, "{name}");
        }
    }

    #[test]
    fn one_plane_is_a_half_space_for_every_test() {
        // z = 1, facing up; inside is below. On the plane itself the point is clipped (eq. 3 is strict).
        let disks = [disk(Vec3::Z, Vec3::Z)];
        let patch = Patch { disks: &disks, reversed: false };
        for (name, test) in TESTS {
            assert_eq!(test(&patch, Vec3::new(0.3, 0.2, 0.9)), Some(true), "{name}");
            assert_eq!(test(&patch, Vec3::new(0.3, 0.2, 1.1)), Some(false), "{name}");
            assert_eq!(test(&patch, Vec3::new(0.0, 0.0, 1.0)), Some(false), "{name}");
            assert_eq!(test(&patch, Vec3::new(40.0, 0.0, 0.9)), Some(true), "{name} out of reach");
        }
    }

    /// Figure 3 (a): a valley between two slopes, material below both surfaces' union of half-spaces.
    #[test]
    fn figure_3a_a_concave_pair_lets_in_what_either_lets_in() {
        // Slopes z = -x for x < 0 seen from the right and z = x for x > 0: normals lean towards each other.
        let disks = [
            disk(Vec3::new(-1.0, 0.0, 1.0), Vec3::new(1.0, 0.0, 1.0)),
            disk(Vec3::new(1.0, 0.0, 1.0), Vec3::new(-1.0, 0.0, 1.0)),
        ];
        let patch = Patch { disks: &disks, reversed: false };
        // Left of the valley's left slope, below it, and above the plane of the right slope.
        let x = Vec3::new(-0.5, 0.0, 0.2);
        assert!(x.dot(Vec3::new(1.0, 0.0, 1.0)) < 0.0 && x.dot(Vec3::new(-1.0, 0.0, 1.0)) > 0.0);
        assert_eq!(patch.two_nearest(x), Some(true));
        assert_eq!(patch.nearest(x), Some(true));
        // Zwicker's rule is wrong here: the right slope's plane discards it.
        assert_eq!(patch.any_plane(x), Some(false));
        // In the valley, above both.
        assert_eq!(patch.two_nearest(Vec3::new(0.0, 0.0, 0.5)), Some(false));
    }

    /// Figure 3 (b): a ridge.
    #[test]
    fn figure_3b_a_convex_pair_lets_in_what_both_let_in() {
        let disks = [
            disk(Vec3::new(-1.0, 0.0, -1.0), Vec3::new(-1.0, 0.0, 1.0)),
            disk(Vec3::new(1.0, 0.0, -1.0), Vec3::new(1.0, 0.0, 1.0)),
        ];
        let patch = Patch { disks: &disks, reversed: false };
        // Behind the left plane, where the nearest surfel is, but beyond the ridge: in front of the right plane.
        let x = Vec3::new(-0.1, 0.0, 0.15);
        let (left, right) = (x.dot(Vec3::new(-1.0, 0.0, 1.0)), x.dot(Vec3::new(1.0, 0.0, 1.0)));
        assert!(left > 0.0 && right > 0.0);
        assert_eq!(patch.two_nearest(x), Some(false));
        let x = Vec3::new(0.2, 0.0, 0.1);
        assert!(x.dot(Vec3::new(-1.0, 0.0, 1.0)) < 0.0 && x.dot(Vec3::new(1.0, 0.0, 1.0)) > 0.0);
        assert_eq!(patch.two_nearest(x), Some(false));
        assert_eq!(patch.any_plane(x), Some(false));
        assert_eq!(patch.two_nearest(Vec3::new(0.0, 0.0, -0.2)), Some(true));
    }

    #[test]
    fn only_the_two_nearest_count() {
        // A third surfel, farther away, that would clip everything.
        let disks = [disk(Vec3::X, Vec3::Z), disk(Vec3::new(0.0, 9.0, -9.0), Vec3::Z), disk(-Vec3::X, Vec3::Z)];
        let patch = Patch { disks: &disks, reversed: false };
        assert_eq!(patch.two_nearest(Vec3::new(0.1, 0.0, -0.5)), Some(true));
        assert_eq!(patch.nearest(Vec3::new(0.1, 0.0, -0.5)), Some(true));
    }

    #[test]
    fn a_reversed_patch_of_a_mixed_pair_is_convex_too() {
        // s2's centre is before s1, s1's behind s2: convex by the paper's "otherwise", and so is the reversed pair.
        let disks = [disk(Vec3::ZERO, Vec3::Z), disk(Vec3::new(0.5, 0.0, 0.2), Vec3::new(0.6, 0.0, 0.8))];
        let x = Vec3::new(0.2, 0.0, 0.05);
        let heights = disks.map(|d| (x - d.centre).dot(d.normal));
        assert!(heights[0] > 0.0 && heights[1] < 0.0);
        assert_eq!(Patch { disks: &disks, reversed: false }.two_nearest(x), Some(false));
        // Reversed, the second surfel clips it from the complement: outside of that, so inside the leaf.
        assert_eq!(Patch { disks: &disks, reversed: true }.two_nearest(x), Some(true));
    }

    #[test]
    fn a_curved_surfel_is_a_sphere_where_its_plane_is_not() {
        let ball = sphere(Vec3::ZERO, 1.0, 1);
        let one = [PartnerDisk { centre: Vec3::Z, normal: Vec3::Z, radius: 0.9, ..ball[0] }];
        let patch = Patch { disks: &one, reversed: false };
        // Under the tangent plane, outside the unit sphere: 0.6² + 0.9² > 1.
        let x = Vec3::new(0.6, 0.0, 0.9);
        assert_eq!(patch.curved(x), Some(false));
        assert_eq!(patch.blend(x), Some(true));
        assert_eq!(patch.curved(Vec3::new(0.6, 0.0, 0.79)), Some(true));
    }

    #[test]
    fn an_ellipse_reaches_as_far_as_its_support() {
        // Long along x: its border is at |x| = 2, |y| = 0.5.
        let s = Sym3([0.25, 0.0, 0.0, 4.0, 0.0, 4.0]);
        let flat = PartnerDisk { support: Some(s), ..disk(Vec3::ZERO, Vec3::Z) };
        let other = disk(Vec3::new(0.0, 3.0, 0.0), -Vec3::Z);
        let disks = [flat, other];
        let patch = Patch { disks: &disks, reversed: false };
        // At y = 1.4 only the second surfel reaches, though the first one is nearer.
        assert_eq!(patch.blend(Vec3::new(0.0, 1.4, -0.1)), Some(false));
        assert_eq!(patch.nearest(Vec3::new(0.0, 1.4, -0.1)), Some(true));
        assert_eq!(patch.blend(Vec3::new(1.5, 0.0, -0.1)), Some(true));
    }

    #[test]
    fn a_dense_sphere_is_classified_right_by_every_test() {
        for (big, n) in [(1.0_f32, 3000), (0.01, 3000), (50.0, 2000)] {
            let middle = Vec3::new(0.3, -0.2, 0.1) * big;
            let disks = sphere(middle, big, n);
            // Flat disks leave the sphere by at most r²/2R within their radius.
            let margin = disks[0].radius * disks[0].radius / (2.0 * big) / big * 1.05;
            let golden = std::f32::consts::PI * (3.0 - 5f32.sqrt());
            for reversed in [false, true] {
                let patch = Patch { disks: &disks, reversed };
                for i in 0..400 {
                    let z = 1.0 - (2.0 * i as f32 + 1.0) / 400.0;
                    let (s, c) = (golden * i as f32 + 0.7).sin_cos();
                    let side = (1.0 - z * z).sqrt();
                    let direction = Vec3::new(c * side, s * side, z);
                    for depth in [-0.5, -0.1, -margin, margin, 0.1, 0.5] {
                        let x = middle + direction * (big * (1.0 + depth));
                        for (name, test) in TESTS {
                            assert_eq!(test(&patch, x), Some(depth < 0.0), "{name} {reversed} {big} {depth}");
                        }
                    }
                }
            }
        }
    }
}
