//! Elliptical weighted averages: how much one flat surfel weighs at one pixel.
//!
//! # Theory
//! Zwicker 2001 (*Surface Splatting*); Wicke 2004 §3.3 and §4.2. A surfel is a Gaussian on its disk whose border lies at
//! 1.4 σ. Projected to the picture and convolved with a Gaussian low-pass of σ_f = 0.7 px it stays a Gaussian, and what
//! would alias is blurred away.
//!
//! *Its covariance.* Let Σ be the Gaussian's covariance in view axes: Σ = r²/1.4² (I − n nᵀ) for a disk and
//! Σ = T (TᵀST)⁻¹ Tᵀ / 1.4² for an ellipse eᵀSe = 1 with tangent axes T. A point c + q of the disk appears at
//! f (c_xy + q_xy) / (c_z + q_z), so that its distance from the centre's picture is *exactly*
//!
//! δ = J q · c_z / (c_z + q_z), with J = f/c_z · (1 0 −c_x/c_z; 0 1 −c_y/c_z),
//!
//! J the derivative at the centre. A Gaussian is carried along by the linear part: J Σ Jᵀ, and convolution adds
//! covariances: V = J Σ Jᵀ + σ_f² I. The rest of the mapping is a factor that each pixel knows, k = (c_z + q_z) / c_z: the
//! weight is exp(−½ k² δᵀ V⁻¹ δ), which is the disk's own Gaussian where the low-pass is small, in perspective too
//! (Zwicker 2004), and the low-pass where the disk is small. Convolution keeps the Gaussian's mass, so its peak sinks by
//! √(det J Σ Jᵀ / det V): of large and small surfels that share a pixel, the small ones count by their area.
//!
//! *Where it ends.* A low-pass is cut where its weight falls under 0.02, at σ_f √(−2 ln 0.02) = 1.96 px. The drawn ellipse
//! is the disk's border widened by that radius in the way of covariances: 1.4² J Σ Jᵀ + 1.96² I. So every weight that is
//! drawn is at least 0.02 of its peak, a magnified disk ends at its border, a disk seen edge-on is a line 4 px thick, and
//! one far away is a dot of that size.
//!
//! # Changes from the paper
//! * The Gaussian's tail beyond the disk's border is not drawn, though its weight is above 0.02 up to twice the radius:
//!   classes and partners compare *radii*, so a tail would hang over cut edges unclipped.
//! * Depth is held to the disk's own range ±z about its centre. Where the ray meets the plane at a height h outside of it
//!   (a disk seen edge-on), the fragment is the ray's point at height z²/h: the border's just outside, the centre's where
//!   ray and plane are parallel. Räsänen 2002 discards such splats, and Wicke 2004 needs them for the clip buffer.
//!   Beyond the far border the factor k is the border's, with which the formula is right: a ray that passes behind the
//!   disk is off its ellipse. (With the fragment's own k it is not: the linear part of a disk whose border comes near the
//!   eye's depth reaches across the picture, and a disk *beside* the eye was drawn over all of it.)
//! * A disk whose border comes within half of its centre's depth of the eye's plane has no useful projection; there the weight
//!   is that of the point on the disk, without a low-pass, of which it needs none.
//!
//! # Practice
//! V is never singular, so there is no special case for grazing disks.

use glam::{DVec2, Vec2, Vec3};

use super::project::{View, ViewSurfel};
use crate::space::{PixelRect, Projection};
use crate::surfel::Sym3;

/// A surfel's radius in standard deviations of its Gaussian.
pub(crate) const BORDER_IN_SIGMAS: f32 = 1.4;

/// Standard deviation of the low-pass, pixels.
pub(crate) const LOW_PASS_PX: f32 = 0.7;

/// How far from its centre the low-pass falls under a weight of 0.02, pixels: `LOW_PASS_PX` · √(−2 ln 0.02).
pub const REACH_PX: f32 = 1.958;

/// A disk whose depth differs from its centre's by more than this share of the centre's depth is drawn without a
/// projection: k would vary by more than a factor of three over it.
pub(crate) const MOST_DEPTH_SHARE: f32 = 0.5;

/// The peak of a disk that is seen exactly edge-on: it has no area, but where it is alone it is still seen.
pub(crate) const LEAST_PEAK: f32 = 1e-6;

/// A quadratic form in pixels: xx, xy, yy.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Form([f32; 3]);

impl Form {
    fn determinant(&self) -> f32 {
        self.0[0] * self.0[2] - self.0[1] * self.0[1]
    }

    /// Inverse of `self` + `square` I, and its determinant before inversion; `square` > 0 and `self` ≥ 0.
    fn widened_inverse(&self, square: f32) -> (Self, f32) {
        let wide = Self([self.0[0] + square, self.0[1], self.0[2] + square]);
        // Of a matrix ≥ 0 the determinant is too, and rounding must not say otherwise.
        let determinant = self.determinant().max(0.0) + square * (self.0[0] + self.0[2] + square);
        let [xx, xy, yy] = wide.0;
        (Self([yy / determinant, -xy / determinant, xx / determinant]), determinant)
    }

    #[inline]
    fn at(&self, d: Vec2) -> f32 {
        self.0[0] * d.x * d.x + 2.0 * self.0[1] * d.x * d.y + self.0[2] * d.y * d.y
    }
}

/// A surfel's footprint in a tile.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Splat {
    /// V⁻¹.
    filter: Form,
    /// The drawn ellipse is where this is at most 1.
    outline: Form,
    /// Weight at the centre, at most 1.
    peak: f32,
    /// Half of the depth range of the disk.
    depth_reach: f32,
    /// 1 / depth of the centre; 0 for parallel rays.
    inverse_depth: f32,
    /// Whether the disk is too near the eye's plane to have a projection.
    is_close: bool,
    /// How far apart in depth neighbouring fragments of one surface may lie: the surfel's own reach, which is in
    /// proportion to its radius, for the radius that is drawn.
    pub reach: f32,
}

/// One surfel at one pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fragment {
    /// Planar depth less the tile's anchor depth.
    pub t: f32,
    /// The point on the surfel, relative to its centre, view axes.
    pub e: Vec3,
    /// EWA weight, positive.
    pub weight: f32,
}

impl Splat {
    /// The footprint of `s` in a tile whose corner pixel is `corner` and whose depths are relative to `anchor`.
    pub fn of(s: &ViewSurfel, view: &View, corner: (u32, u32), anchor: f64) -> Self {
        let n = Vec3::from(s.normal);
        let in_sigmas = 1.0 / (BORDER_IN_SIGMAS * BORDER_IN_SIGMAS);
        // Σ, times 1.4².
        let border = border_form(n, s.radius, s.support.map(Sym3));
        let centre_depth = anchor + f64::from(s.z) - f64::from(s.lift);
        // The direction (X, Y, 1) of the centre's ray.
        let (x, y, inverse_depth) = match view.camera.projection {
            Projection::Perspective { focal_px } => {
                let x = f64::from(corner.0) + f64::from(s.u) - 0.5 * f64::from(view.camera.width);
                let y = f64::from(corner.1) + f64::from(s.v) - 0.5 * f64::from(view.camera.height);
                ((x / focal_px) as f32, (y / focal_px) as f32, (1.0 / centre_depth) as f32)
            }
            Projection::Orthographic { .. } => (0.0, 0.0, 0.0),
        };
        let px = 1.0 / s.scale;
        let rows = [Vec3::new(px, 0.0, -x * px), Vec3::new(0.0, px, -y * px)];
        let product = |a: usize, b: usize| rows[a].dot(border.mul(rows[b]));
        // The border's ellipse in the picture; J Σ Jᵀ is this in sigmas.
        let ellipse = Form([product(0, 0), product(0, 1), product(1, 1)]);
        let gaussian = Form(ellipse.0.map(|v| v * in_sigmas));
        let (outline, _) = ellipse.widened_inverse(REACH_PX * REACH_PX);
        let (filter, determinant) = gaussian.widened_inverse(LOW_PASS_PX * LOW_PASS_PX);
        let peak = (gaussian.determinant().max(0.0) / determinant).sqrt().max(LEAST_PEAK);
        let widening = (1.0 + (REACH_PX * s.scale / s.radius).powi(2)).sqrt();
        let depth_reach = border.0[5].max(0.0).sqrt();
        let is_close = s.lift != 0.0 || !(depth_reach * inverse_depth <= MOST_DEPTH_SHARE);
        Self { filter, outline, peak, depth_reach, inverse_depth, is_close, reach: s.reach * widening }
    }

    /// The columns between which row `y` (both from the tile's corner) may hold fragments; `None` where it holds none.
    #[inline]
    pub fn columns(&self, s: &ViewSurfel, y: f32) -> Option<(f32, f32)> {
        if self.is_close {
            return (s.top <= y && y <= s.bottom).then_some((s.left, s.right));
        }
        // Where k is least the drawn ellipse is largest; beyond a pixel's thousandth rounding does not reach.
        const ROUNDING_PX: f32 = 1e-3;
        let least_k = 1.0 - self.depth_reach * self.inverse_depth;
        let [xx, xy, yy] = self.outline.0;
        let v = y - s.v;
        let square = xy * xy * v * v - xx * (yy * v * v - 1.0 / (least_k * least_k));
        if !(square >= 0.0) {
            return None;
        }
        let (middle, half) = (s.u - xy * v / xx, square.sqrt() / xx + ROUNDING_PX);
        Some((middle - half, middle + half))
    }

    /// The surfel at a pixel position (from the tile's corner) whose ray has direction (`dir`, 1) in view axes; `None`
    /// where it is not drawn.
    #[inline]
    pub fn at(&self, s: &ViewSurfel, px: Vec2, dir: Vec2) -> Option<Fragment> {
        let delta = px - Vec2::new(s.u, s.v);
        let d = Vec3::new(dir.x, dir.y, 1.0);
        let n = Vec3::from(s.normal);
        // The ray at the reference depth, and from there to the disk's plane.
        let start = Vec3::new(delta.x * s.scale, delta.y * s.scale, s.lift);
        let to_plane = -n.dot(start) / n.dot(d);
        let height = to_plane + s.lift;
        if self.is_close {
            // The point on the disk itself.
            let e = start + d * to_plane;
            let u = match s.support {
                None => e.length_squared() * s.inverse_radius_squared,
                Some(form) => e.dot(Sym3(form).mul(e)),
            };
            let weight = (-0.5 * BORDER_IN_SIGMAS * BORDER_IN_SIGMAS * u).exp();
            return (u <= 1.0).then_some(Fragment { t: to_plane + s.z, e, weight });
        }
        // NaN, where the ray lies in the plane, becomes the centre's depth.
        let held = if height.abs() <= self.depth_reach {
            height
        } else if height.is_nan() {
            0.0
        } else {
            self.depth_reach * self.depth_reach / height
        };
        let k = 1.0 + if height > self.depth_reach { self.depth_reach } else { held } * self.inverse_depth;
        let square = k * k;
        if !(self.outline.at(delta) * square <= 1.0) {
            return None;
        }
        let weight = self.peak * (-0.5 * square * self.filter.at(delta)).exp();
        Some(Fragment { t: held + s.z, e: start + d * held, weight })
    }
}

/// X and Y of the direction (X, Y, 1), view axes, of the ray through a pixel position relative to the corner of `rect`.
pub fn direction(view: &View, rect: PixelRect, px: DVec2) -> Vec2 {
    let camera = &view.camera;
    match camera.projection {
        Projection::Perspective { focal_px } => {
            let x = f64::from(rect.x0) + px.x - 0.5 * f64::from(camera.width);
            let y = f64::from(rect.y0) + px.y - 0.5 * f64::from(camera.height);
            DVec2::new(x / focal_px, y / focal_px).as_vec2()
        }
        Projection::Orthographic { .. } => Vec2::ZERO,
    }
}

/// The disk (or ellipse) as the form r²(I − n nᵀ): its extent along a direction a is √(aᵀ F a).
fn border_form(n: Vec3, radius: f32, support: Option<Sym3>) -> Sym3 {
    let Some(support) = support else {
        let r = radius * radius;
        return Sym3([
            r * (1.0 - n.x * n.x),
            -r * n.x * n.y,
            -r * n.x * n.z,
            r * (1.0 - n.y * n.y),
            -r * n.y * n.z,
            r * (1.0 - n.z * n.z),
        ]);
    };
    let (u, v) = n.any_orthonormal_pair();
    let (uu, uv, vv) = (u.dot(support.mul(u)), u.dot(support.mul(v)), v.dot(support.mul(v)));
    let determinant = uu * vv - uv * uv;
    let (a, b, c) = (vv / determinant, -uv / determinant, uu / determinant);
    let entry = |i: usize, j: usize| a * u[i] * u[j] + b * (u[i] * v[j] + v[i] * u[j]) + c * v[i] * v[j];
    Sym3([entry(0, 0), entry(0, 1), entry(0, 2), entry(1, 1), entry(1, 2), entry(2, 2)])
}

#[cfg(test)]
mod tests {
    use glam::{DVec3, Mat3, Quat};
    use rayon::prelude::*;

    use super::*;
    use crate::classify::{Class, LeafField, LeafLook, Model};
    use crate::layers::{LayerLimit, LayerStack};
    use crate::scene::LeafKind;
    use crate::space::{Camera, Lens};
    use crate::splat::frame::Frame;
    use crate::splat::project;
    use crate::splat::settings::SplatSettings;
    use crate::splat::test_scenes::{COVER, cloud, tree};
    use crate::surfel::SurfelCloud;

    const SIZE: u32 = 64;

    /// One surfel with its centre at the origin, seen in a picture of 64² pixels from (0.4, −3, 0.5).
    fn one(normal: Vec3, radius: f32, support: Option<Sym3>, lens: Lens) -> (View, ViewSurfel, PixelRect) {
        let eye = DVec3::new(0.4, -3.0, 0.5);
        let camera = Camera::look_at(eye, DVec3::new(0.1, 0.0, -0.1), DVec3::Z, lens, SIZE, SIZE).unwrap();
        let mut cloud: SurfelCloud = cloud(&[(DVec3::ZERO, normal.normalize(), Sym3::default())], radius);
        cloud.supports = support.map(|s| vec![s]);
        let view = View::new(camera);
        let rect = PixelRect { x0: 0, y0: 0, x1: SIZE, y1: SIZE };
        let look = project::LeafLook { colour: None, opacity: 1.0, class: Class::default() };
        let sight = view.sight(&cloud, 0);
        let bounds = view.bounds(sight.centre, f64::from(radius)).unwrap();
        let surfel = view.surfel((&cloud, 0), &sight, &bounds, (rect, 2.5), look);
        (view, surfel, rect)
    }

    #[test]
    fn the_reach_is_where_the_low_pass_ends() {
        const CUT: f32 = 0.02;
        assert!((REACH_PX - LOW_PASS_PX * (-2.0 * CUT.ln()).sqrt()).abs() < 1e-3);
    }

    /// The filter's covariance against points drawn from the Gaussian on the disk, projected one by one.
    #[test]
    fn covariance_is_that_of_projected_points() {
        let tilt = Mat3::from_quat(Quat::from_rotation_x(0.9) * Quat::from_rotation_z(0.4));
        // An ellipse with semi-axes 0.05 and 0.02 in a tilted plane.
        let axes = Mat3::from_diagonal(Vec3::new(1.0 / 0.0025, 1.0 / 0.0004, 1.0 / 0.0025));
        let ellipse = Sym3::from_mat3(tilt * axes * tilt.transpose());
        let cases = [
            (Vec3::new(0.2, -0.5, 0.8), 0.05, None, [0.05, 0.05], None),
            (tilt.z_axis, 0.05, Some(ellipse), [0.05, 0.02], Some([tilt.x_axis, tilt.y_axis])),
        ];
        for lens in [Lens::FovY(30.0), Lens::Height(1.5)] {
            for (normal, radius, support, lengths, directions) in cases {
                let (view, s, rect) = one(normal, radius, support, lens);
                let splat = Splat::of(&s, &view, (rect.x0, rect.y0), 2.5);
                let normal = normal.normalize();
                let pair = normal.any_orthonormal_pair();
                let [u, v] = directions.unwrap_or([pair.0, pair.1]);
                // A lattice of quantiles stands for random points: Box-Muller over a regular grid.
                const GRID: usize = 200;
                let (mut sum, mut count) = ([0.0_f64; 3], 0.0);
                let centre = view.camera.px_from_view(view.camera.view_from_world(DVec3::ZERO));
                for i in 0..GRID * GRID {
                    let (p, q) = (((i / GRID) as f64 + 0.5) / GRID as f64, ((i % GRID) as f64 + 0.5) / GRID as f64);
                    let (sin, cos) = (std::f64::consts::TAU * q).sin_cos();
                    let far = (-2.0 * p.ln()).sqrt() / f64::from(BORDER_IN_SIGMAS);
                    let point = u.as_dvec3() * (far * cos * lengths[0]) + v.as_dvec3() * (far * sin * lengths[1]);
                    let d = view.camera.px_from_view(view.camera.view_from_world(point)) - centre;
                    sum[0] += d.x * d.x;
                    sum[1] += d.x * d.y;
                    sum[2] += d.y * d.y;
                    count += 1.0;
                }
                let low_pass = f64::from(LOW_PASS_PX * LOW_PASS_PX);
                let expected = [sum[0] / count + low_pass, sum[1] / count, sum[2] / count + low_pass];
                // V, from its inverse.
                let f = splat.filter.0.map(f64::from);
                let determinant = f[0] * f[2] - f[1] * f[1];
                let found = [f[2] / determinant, -f[1] / determinant, f[0] / determinant];
                for (a, b) in found.iter().zip(expected) {
                    // The grid of quantiles cuts the tails, and perspective is not linear: a few percent.
                    assert!((a - b).abs() < 0.03 * (expected[0] + expected[2]), "{lens:?} {found:?} {expected:?}");
                }
            }
        }
    }

    /// A magnified disk ends at its border, and weighs what its Gaussian does at the ray's point, in perspective too.
    #[test]
    fn a_large_disk_is_its_own_gaussian() {
        let normal = Vec3::new(0.3, -0.5, 0.6);
        for lens in [Lens::FovY(40.0), Lens::Height(2.5)] {
            let (view, s, rect) = one(normal, 0.8, None, lens);
            let splat = Splat::of(&s, &view, (0, 0), 2.5);
            let (mut drawn, mut off) = (0, 0);
            for i in 0..SIZE * SIZE {
                let px = DVec2::new(f64::from(i % SIZE) + 0.5, f64::from(i / SIZE) + 0.5);
                let ray = view.camera.ray(px);
                let n = normal.normalize().as_dvec3();
                let t = -n.dot(ray.origin) / n.dot(ray.dir);
                let u = (ray.at(t).length() / 0.8).powi(2);
                match splat.at(&s, px.as_vec2(), direction(&view, rect, px)) {
                    None => off += usize::from(u < 0.9),
                    Some(f) => {
                        off += usize::from(u > 1.2);
                        if u < 1.0 {
                            drawn += 1;
                            assert!((f64::from(f.t) + 2.5 - t).abs() < 1e-5);
                            let weight = (-0.98 * u).exp();
                            assert!((f64::from(f.weight) - weight).abs() < 0.02, "{} {weight} {u}", f.weight);
                        }
                    }
                }
            }
            assert!(drawn > 300 && off == 0, "{drawn} {off}");
        }
    }

    /// Seen edge-on a disk is a line of the low-pass's width, not nothing.
    #[test]
    fn an_edge_on_disk_is_a_thick_line() {
        let eye = Vec3::new(0.4, -3.0, 0.5);
        let normal = eye.cross(Vec3::new(0.3, 0.2, 1.0)); // perpendicular to the ray through the centre
        let (view, s, rect) = one(normal, 0.3, None, Lens::FovY(40.0));
        let splat = Splat::of(&s, &view, (0, 0), 2.5);
        let covered: Vec<Fragment> = (0..SIZE * SIZE)
            .filter_map(|i| {
                let px = DVec2::new(f64::from(i % SIZE) + 0.5, f64::from(i / SIZE) + 0.5);
                splat.at(&s, px.as_vec2(), direction(&view, rect, px))
            })
            .collect();
        // An ellipse about 2 · 0.3 / 3.03 · 88 px ≈ 17 px long and 3.9 px across.
        let area = std::f32::consts::PI * 0.25 * 17.5 * 2.0 * REACH_PX;
        assert!((covered.len() as f32 / area - 1.0).abs() < 0.15, "{} {area}", covered.len());
        assert!(covered.iter().all(|f| f.weight > 0.0 && f.e.length() < 0.45 && f.t.is_finite()));
    }

    /// A floor that reaches under the eye and behind it, with disks whose centres lie just before the eye's plane: it is seen
    /// where it is, and nowhere else.
    #[test]
    fn disks_beside_the_eye_are_not_drawn_across_the_picture() {
        for angle in [0.0, 3.0, 10.0, 30.0_f64] {
            let up = DVec3::new(angle.to_radians().sin(), 0.0, angle.to_radians().cos());
            let (u, v) = up.any_orthonormal_pair();
            let place = |i: usize| (i as f64 / 74.0 - 0.5) * 5.0;
            let points: Vec<_> =
                (0..75 * 75).map(|i| (u * place(i % 75) + v * place(i / 75), up.as_vec3(), Sym3::default())).collect();
            let field = LeafField::new(cloud(&points, COVER), None, LeafKind::Solid);
            let model = Model::new(&tree("a"), vec![field], vec![LeafLook { colour: None, opacity: 1.0 }]);
            let eye = DVec3::new(0.9, -1.4, 1.6);
            let camera = Camera::look_at(eye, DVec3::ZERO, DVec3::Z, Lens::FovY(20.0), SIZE, SIZE).unwrap();
            let frame = Frame::new(&model, camera.clone(), LayerLimit::All, 1, SplatSettings::PAPER, None);
            let stack = LayerStack::collect(&frame);
            for i in 0..SIZE * SIZE {
                let ray = camera.ray(DVec2::new(f64::from(i % SIZE) + 0.5, f64::from(i / SIZE) + 0.5));
                let t = -up.dot(ray.origin) / up.dot(ray.dir);
                let seen = stack.at(i % SIZE, i / SIZE);
                // Half a pixel's footprint: at their borders disks are held to their own depths.
                let right = seen.len() == 1 && (f64::from(seen[0].depth) - t).abs() < 0.5 * camera.footprint(t);
                assert!(right, "{angle}° pixel {i}: {seen:?} for {t}");
            }
        }
    }

    /// A checkerboard whose fields are smaller than pixels, and one whose fields are two pixels wide, against the mean of
    /// many samples of the exact board under the low-pass.
    #[test]
    fn a_minified_texture_matches_supersampling() {
        let across = 400;
        let side = 4.0;
        let spacing = side / across as f64;
        let camera =
            Camera::look_at(DVec3::new(0.3, -5.5, 2.5), DVec3::ZERO, DVec3::Z, Lens::FovY(16.0), SIZE, SIZE).unwrap();
        for cell in [0.02, 0.16] {
            // Where two cells meet there is no surfel.
            let white = |x: f64, y: f64| ((x / cell).floor() + (y / cell).floor()).rem_euclid(2.0) < 1.0;
            let place = |i: usize| (i as f64 + 0.5) * spacing - 0.5 * side;
            let points: Vec<_> = (0..across * across)
                .map(|i| (DVec3::new(place(i % across), place(i / across), 0.0), Vec3::Z, Sym3::default()))
                .collect();
            let mut board = cloud(&points, COVER);
            for i in 0..board.len() {
                let p = board.centre(i);
                board.surfels[i].colour = if white(p.x, p.y) { [255; 4] } else { [0, 0, 0, 255] };
            }
            let field = LeafField::new(board, None, LeafKind::Solid);
            let model = Model::new(&tree("a"), vec![field], vec![LeafLook { colour: None, opacity: 1.0 }]);
            let frame = Frame::new(&model, camera.clone(), LayerLimit::Nearest, 1, SplatSettings::PAPER, None);
            let stack = LayerStack::collect(&frame);
            let errors: Vec<(f64, f64)> = (0..SIZE * SIZE)
                .into_par_iter()
                .filter_map(|i| {
                    let px = DVec2::new(f64::from(i % SIZE) + 0.5, f64::from(i / SIZE) + 0.5);
                    let on_board = |px: DVec2| {
                        let ray = camera.ray(px);
                        let p = ray.at(-ray.origin.z / ray.dir.z);
                        (p.x.abs().max(p.y.abs()) < 0.5 * side - 0.2).then(|| f64::from(u8::from(white(p.x, p.y))))
                    };
                    // 41² samples out to three standard deviations.
                    let (mut sum, mut weight) = (0.0, 0.0);
                    let sigma = f64::from(LOW_PASS_PX);
                    for k in 0..41 * 41 {
                        let d = DVec2::new(f64::from(k % 41 - 20), f64::from(k / 41 - 20)) * (3.0 * sigma / 20.0);
                        let w = (-0.5 * d.length_squared() / (sigma * sigma)).exp();
                        sum += w * on_board(px + d)?;
                        weight += w;
                    }
                    let truth = sum / weight;
                    let seen = f64::from(stack.at(i % SIZE, i / SIZE).first()?.colour[0]);
                    Some(((seen - truth).abs(), (on_board(px)? - truth).abs()))
                })
                .collect();
            let mean = |of: fn(&(f64, f64)) -> f64| errors.iter().map(of).sum::<f64>() / errors.len() as f64;
            let (ours, one_sample) = (mean(|e| e.0), mean(|e| e.1));
            println!("cells of {cell}: {} pixels, error {ours:.4}, of one sample {one_sample:.4}", errors.len());
            assert!(errors.len() > 2000 && ours < 0.03 && one_sample > 0.2, "{ours} {one_sample}");
        }
    }
}
