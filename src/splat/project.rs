//! Surfels in view space: what the row kernels read.
//!
//! # Theory
//! A pixel's ray is x(t) = eye + t d with d = (X, Y, 1) in view axes (right, down, forward), so t is planar depth. Written
//! about a surfel's centre c at a reference depth z, the ray is e(τ) = (s·dx, s·dy, lift) + τ d, where (dx, dy) is the
//! pixel minus the centre's projection *in pixels* and s the footprint at z. Nothing large is left in these numbers: the
//! projection is subtracted in `f64`, and all else is `f32` of the size of the surfel.
//!
//! # Practice
//! `lift` is zero except within half a radius of the eye, where the reference depth is pushed in front of the eye so that
//! a projection exists. Bounds are those of the support *ball*, not of the disk: a ray that passes a curved surfel at a
//! grazing angle may miss the disk and still hit the surface.

use glam::{DMat3, DVec3, Mat3};

use crate::classify::{Class, Drawn};
use crate::space::{Camera, PixelRect, Projection};
use crate::surfel::{SurfelCloud, Sym3};

/// Surface surfels of a smaller radius on the screen are [plain](ViewSurfel::plain).
const PLAIN_RADIUS_PX: f64 = 4.0;

/// Rays with t below this many radii in front of the eye are not hit.
const NEAREST_REFERENCE_IN_RADII: f64 = 0.5;

/// A group of fragments stays open this far behind its last one: ε = min(4r, ½ r (tan θ + ½)), cos θ ≥ 0.05
/// (DESIGN §3.7; factors from ¼ to 2 of it give right layer counts, a tenth breaks them).
fn grouping_reach(radius: f32, cosine: f32) -> f32 {
    const LEAST_COSINE: f32 = 0.05;
    const MOST_RADII: f32 = 4.0;
    let c = cosine.abs().clamp(LEAST_COSINE, 1.0);
    let tangent = (1.0 - c * c).max(0.0).sqrt() / c;
    (0.5 * radius * (tangent + 0.5)).min(MOST_RADII * radius)
}

/// A surfel as one tile sees it. Lengths in world units, view axes; pixels are relative to the tile's corner.
#[derive(Debug, Clone, Copy)]
pub struct ViewSurfel {
    /// Projection of the centre, pixels from the tile's corner.
    pub u: f32,
    /// As `u`, down.
    pub v: f32,
    /// Reference depth minus the tile's anchor depth.
    pub z: f32,
    /// Footprint at the reference depth.
    pub scale: f32,
    /// Reference depth minus the centre's depth.
    pub lift: f32,
    /// Unit normal.
    pub normal: [f32; 3],
    /// Curvature M.
    pub curvature: [f32; 6],
    /// 1 / radius².
    pub inverse_radius_squared: f32,
    /// Where elliptical, S with eᵀSe = 1 on the support's border.
    pub support: Option<[f32; 6]>,
    /// Radius of the support ball.
    pub radius: f32,
    /// How far apart in depth fragments of one surface may lie.
    pub reach: f32,
    /// Least depth of the support ball minus the tile's anchor depth.
    pub near: f32,
    /// Greatest depth of the support ball minus the tile's anchor depth.
    pub far: f32,
    /// First row of pixel centres (tile-relative) that the ball may touch.
    pub top: f32,
    /// Last such row.
    pub bottom: f32,
    /// First such column.
    pub left: f32,
    /// Last such column.
    pub right: f32,
    /// Linear RGB.
    pub colour: [f32; 3],
    /// Opacity, 0 to 1.
    pub opacity: f32,
    /// Index in its leaf.
    pub index: u32,
    /// What it is drawn as.
    pub class: Class,
    /// Whether it is a surface surfel so small on the screen that the mean of such surfels' hits is as good as the solution of
    /// their field: it is not clipped, and what they differ by is of third order in a radius of a few pixels.
    pub plain: bool,
    /// Whether a ray can enter the leaf here.
    pub may_enter: bool,
    /// Whether a ray can leave the leaf here.
    pub may_leave: bool,
}

/// A camera with the view axes in both precisions.
#[derive(Debug, Clone)]
pub struct View {
    /// The camera.
    pub camera: Camera,
    /// World to view rotation.
    rotation: DMat3,
    rotation32: Mat3,
}

/// The pixels a ball may touch: left, right, top, bottom in picture pixels, possibly infinite.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounds {
    /// Least x.
    pub left: f64,
    /// Greatest x.
    pub right: f64,
    /// Least y.
    pub top: f64,
    /// Greatest y.
    pub bottom: f64,
}

impl View {
    /// Of `camera`.
    pub fn new(camera: Camera) -> Self {
        let rotation = DMat3::from_cols(camera.right, camera.down, camera.forward).transpose();
        Self { camera, rotation, rotation32: rotation.as_mat3() }
    }

    /// Pixel bounds of a ball of `radius` about `centre_in_view`; `None` where it lies behind the eye or outside the
    /// picture.
    pub fn bounds(&self, centre_in_view: DVec3, radius: f64) -> Option<Bounds> {
        let half_width = 0.5 * f64::from(self.camera.width);
        let half_height = 0.5 * f64::from(self.camera.height);
        let c = centre_in_view;
        let bounds = match self.camera.projection {
            Projection::Perspective { focal_px } => {
                if c.z + radius <= 0.0 {
                    return None;
                }
                // The two planes through the eye that touch the ball: tangents of the circle in the x-z (y-z) plane.
                let span = |a: f64, half: f64| {
                    let square = c.z * c.z - radius * radius;
                    if square <= 0.0 || c.z <= radius {
                        return (f64::NEG_INFINITY, f64::INFINITY);
                    }
                    let root = radius * (a * a + square).sqrt();
                    (half + focal_px * (a * c.z - root) / square, half + focal_px * (a * c.z + root) / square)
                };
                let (left, right) = span(c.x, half_width);
                let (top, bottom) = span(c.y, half_height);
                Bounds { left, right, top, bottom }
            }
            Projection::Orthographic { px_per_unit } => {
                if c.z + radius <= 0.0 {
                    return None;
                }
                let (x, y, r) = (half_width + c.x * px_per_unit, half_height + c.y * px_per_unit, radius * px_per_unit);
                Bounds { left: x - r, right: x + r, top: y - r, bottom: y + r }
            }
        };
        let hidden = bounds.right < 0.0
            || bounds.bottom < 0.0
            || bounds.left > 2.0 * half_width
            || bounds.top > 2.0 * half_height;
        (!hidden).then_some(bounds)
    }

    /// A point of world space in view space.
    #[inline]
    pub fn point(&self, p_in_world: DVec3) -> DVec3 {
        self.rotation * (p_in_world - self.camera.eye)
    }

    /// World from view, for a normal.
    #[inline]
    pub fn normal_to_world(&self, n_in_view: glam::Vec3) -> glam::Vec3 {
        self.rotation32.transpose() * n_in_view
    }

    fn rotated(&self, m: Sym3) -> [f32; 6] {
        if m.0 == [0.0; 6] {
            return m.0; // flat surfels are common and the product is half of this stage's cost
        }
        Sym3::from_mat3(self.rotation32 * m.to_mat3() * self.rotation32.transpose()).0
    }

    /// Surfel `index` of `cloud` for a tile whose corner is `rect`'s and whose depths are relative to `anchor`.
    pub fn surfel(
        &self,
        cloud: &SurfelCloud,
        index: usize,
        rect: PixelRect,
        anchor: f64,
        leaf: LeafLook,
    ) -> Option<ViewSurfel> {
        let surfel = &cloud.surfels[index];
        let radius = f64::from(surfel.radius);
        let c = self.point(cloud.centre(index));
        let bounds = self.bounds(c, radius)?;
        let (corner_x, corner_y) = (f64::from(rect.x0), f64::from(rect.y0));
        let reference = match self.camera.projection {
            Projection::Perspective { .. } => c.z.max(NEAREST_REFERENCE_IN_RADII * radius),
            Projection::Orthographic { .. } => c.z,
        };
        let at_reference = self.camera.px_from_view(DVec3::new(c.x, c.y, reference));
        let n = self.rotation32 * surfel.normal;
        let m = self.rotated(surfel.curvature);
        // The ray through the centre, for angles.
        let to = match self.camera.projection {
            Projection::Perspective { .. } => c.normalize_or(DVec3::Z),
            Projection::Orthographic { .. } => DVec3::Z,
        };
        let cosine = n.dot(to.as_vec3());
        // A ray's facing can differ from the centre's by the bend of the surfel and by perspective across the ball.
        let stiffest = m.iter().fold(0.0_f32, |a, b| a.max(b.abs()));
        let bend = 3.0 * stiffest * surfel.radius;
        let spread = match self.camera.projection {
            Projection::Perspective { .. } => (radius / c.length().max(radius)) as f32,
            Projection::Orthographic { .. } => 0.0,
        };
        const ROUNDING: f32 = 1e-3;
        let swing = bend + spread + ROUNDING;
        let linear = |k: usize| srgb_to_linear(surfel.colour[k]);
        let colour = match leaf.colour {
            Some(colour) => colour,
            None => [linear(0), linear(1), linear(2)],
        };
        Some(ViewSurfel {
            u: (at_reference.x - corner_x) as f32,
            v: (at_reference.y - corner_y) as f32,
            z: (reference - anchor) as f32,
            scale: self.camera.footprint(reference) as f32,
            lift: (reference - c.z) as f32,
            normal: n.to_array(),
            curvature: m,
            inverse_radius_squared: (1.0 / (radius * radius)) as f32,
            support: cloud.supports.as_ref().map(|s| self.rotated(s[index])),
            radius: surfel.radius,
            reach: grouping_reach(surfel.radius, cosine),
            near: (c.z - radius - anchor) as f32,
            far: (c.z + radius - anchor) as f32,
            top: (bounds.top - corner_y) as f32,
            bottom: (bounds.bottom - corner_y) as f32,
            left: (bounds.left - corner_x) as f32,
            right: (bounds.right - corner_x) as f32,
            colour,
            opacity: leaf.opacity * f32::from(surfel.colour[3]) / 255.0,
            index: index as u32,
            class: leaf.class,
            plain: matches!(leaf.class.drawn(), Some(Drawn::Surface(_)))
                && radius < PLAIN_RADIUS_PX * self.camera.footprint(reference),
            may_enter: cosine < swing,
            may_leave: cosine > -swing,
        })
    }
}

/// What a leaf adds to the look of a surfel.
#[derive(Debug, Clone, Copy)]
pub struct LeafLook {
    /// Linear RGB that replaces the surfels' own.
    pub colour: Option<[f32; 3]>,
    /// The leaf's opacity.
    pub opacity: f32,
    /// The surfel's class.
    pub class: Class,
}

/// IEC 61966-2-1, tabulated once.
fn srgb_to_linear(value: u8) -> f32 {
    static TABLE: std::sync::LazyLock<[f32; 256]> = std::sync::LazyLock::new(|| {
        std::array::from_fn(|i| {
            let s = i as f32 / 255.0;
            if s <= 0.040_45 { s / 12.92 } else { ((s + 0.055) / 1.055).powf(2.4) }
        })
    });
    TABLE[usize::from(value)]
}
