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

use glam::{DMat3, DVec3, Mat3, Vec3};

use crate::classify::Class;
use crate::space::{Camera, PixelRect, Projection};
use crate::surfel::{CHUNK, Surfel, SurfelCloud, Sym3};

/// Rays with t below this many radii in front of the eye are not hit.
pub(crate) const NEAREST_REFERENCE_IN_RADII: f64 = 0.5;

/// By how much rough bounds are widened, pixels: far above what `f32` loses within a picture.
pub(crate) const BOUNDS_ROUNDING_PX: f64 = 1e-2;

/// Rounding of the cosine between a ray and a normal.
pub(crate) const COSINE_ROUNDING: f32 = 1e-3;

/// The least cosine between ray and normal that depths are spread by.
pub(crate) const LEAST_SPREAD_COSINE: f32 = 0.05;

/// The farthest that fragments of one surface lie apart in depth.
pub(crate) const MOST_REACH_IN_RADII: f32 = 4.0;

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
    /// Whether a ray can enter the leaf here.
    pub may_enter: bool,
    /// Whether a ray can leave the leaf here.
    pub may_leave: bool,
}

impl ViewSurfel {
    /// Whether rays can both enter and leave the leaf here, as beside a silhouette.
    pub fn is_edge_on(&self) -> bool {
        self.may_enter && self.may_leave
    }
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

impl Bounds {
    /// The same, in pixels from the corner of `rect`.
    pub fn from_corner(self, rect: PixelRect) -> Self {
        let (x, y) = (f64::from(rect.x0), f64::from(rect.y0));
        Self { left: self.left - x, right: self.right - x, top: self.top - y, bottom: self.bottom - y }
    }
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

    /// Surfel `index` of `cloud` as the camera sees it.
    #[inline]
    pub fn sight(&self, cloud: &SurfelCloud, index: usize) -> Sight {
        self.sight_in_chunk(cloud, index, self.chunk_origin(cloud, index / CHUNK))
    }

    /// The origin of a chunk's offsets in view space.
    #[inline]
    pub fn chunk_origin(&self, cloud: &SurfelCloud, chunk: usize) -> DVec3 {
        self.point(cloud.chunks[chunk].origin)
    }

    /// As [`View::sight`], for a surfel of the chunk whose origin is given: the large coordinates are rotated once a chunk.
    #[inline]
    pub fn sight_in_chunk(&self, cloud: &SurfelCloud, index: usize, origin_in_view: DVec3) -> Sight {
        let surfel = &cloud.surfels[index];
        let centre = origin_in_view + (self.rotation32 * surfel.offset).as_dvec3();
        let normal = self.rotation32 * surfel.normal;
        let (cosine, swing) = self.facing(centre.as_vec3(), normal, surfel);
        Sight { centre, normal, cosine, swing }
    }

    /// Pixel bounds of the ball of `surfel`, as [`View::bounds`] but a little larger and cheaper, since most are only
    /// compared with those of tiles and blocks.
    #[inline]
    pub fn rough_bounds(&self, sight: &Sight, radius: f32) -> Option<Bounds> {
        let c = sight.centre;
        let radius = f64::from(radius);
        let Projection::Perspective { focal_px } = self.camera.projection else { return self.bounds(c, radius) };
        if c.z < 2.0 * radius {
            return self.bounds(c, radius);
        }
        // With θ the angle of the centre off the axis, in one of the two planes, and α that of the ball's tangent off the
        // centre, tan(θ + α) − tan θ = sin α / (cos θ cos(θ + α)); with d ≤ |c| the distance in the plane, cos θ = z/d,
        // sin α = r/d, cos α ≥ 1 − (r/d)², and sin θ ≤ 1.
        let distance = f64::from(sight.centre.as_vec3().length());
        let per_z = 1.0 / c.z;
        let cosine = c.z * (1.0 - (radius * per_z).powi(2)) - radius;
        let half = focal_px * radius * distance * (per_z / cosine) + BOUNDS_ROUNDING_PX;
        let x = 0.5 * f64::from(self.camera.width) + focal_px * c.x * per_z;
        let y = 0.5 * f64::from(self.camera.height) + focal_px * c.y * per_z;
        let bounds = Bounds { left: x - half, right: x + half, top: y - half, bottom: y + half };
        let (width, height) = (f64::from(self.camera.width), f64::from(self.camera.height));
        let hidden = bounds.right < 0.0 || bounds.bottom < 0.0 || bounds.left > width || bounds.top > height;
        (!hidden).then_some(bounds)
    }

    /// The cosine between the ray through the centre and the normal, and by how much that of another ray that meets the
    /// surfel can differ, by the bend of the surfel and by perspective across the ball.
    #[inline]
    fn facing(&self, centre_in_view: Vec3, normal_in_view: Vec3, surfel: &Surfel) -> (f32, f32) {
        // No eigenvalue of a symmetric matrix is larger than its largest row's sum.
        let [xx, xy, xz, yy, yz, zz] = surfel.curvature.0.map(f32::abs);
        let bend = (xx + xy + xz).max(xy + yy + yz).max(xz + yz + zz) * surfel.radius;
        match self.camera.projection {
            Projection::Perspective { .. } => {
                let distance = centre_in_view.length();
                let cosine = if distance > 0.0 { normal_in_view.dot(centre_in_view) / distance } else { 0.0 };
                (cosine, bend + surfel.radius / distance.max(surfel.radius) + COSINE_ROUNDING)
            }
            Projection::Orthographic { .. } => (normal_in_view.z, bend + COSINE_ROUNDING),
        }
    }

    /// Curvature and support of surfel `index`, view axes.
    pub fn shape(&self, cloud: &SurfelCloud, index: usize) -> (Sym3, Option<Sym3>) {
        let support = cloud.supports.as_ref().map(|s| Sym3(self.rotated(s[index])));
        (Sym3(self.rotated(cloud.surfels[index].curvature)), support)
    }

    /// Surfel `index` of `cloud`, seen as `sight`, whose ball has the `bounds` from the corner of the tile `rect`. The tile's
    /// depths are relative to `anchor`.
    pub fn surfel(
        &self,
        (cloud, index): (&SurfelCloud, usize),
        sight: &Sight,
        bounds: &Bounds,
        (rect, anchor): (PixelRect, f64),
        leaf: LeafLook,
    ) -> ViewSurfel {
        let surfel = &cloud.surfels[index];
        let radius = f64::from(surfel.radius);
        let c = sight.centre;
        let reference = match self.camera.projection {
            Projection::Perspective { .. } => c.z.max(NEAREST_REFERENCE_IN_RADII * radius),
            Projection::Orthographic { .. } => c.z,
        };
        let at_reference = self.camera.px_from_view(DVec3::new(c.x, c.y, reference));
        let (curvature, support) = self.shape(cloud, index);
        ViewSurfel {
            u: (at_reference.x - f64::from(rect.x0)) as f32,
            v: (at_reference.y - f64::from(rect.y0)) as f32,
            z: (reference - anchor) as f32,
            scale: self.camera.footprint(reference) as f32,
            lift: (reference - c.z) as f32,
            normal: sight.normal.to_array(),
            curvature: curvature.0,
            inverse_radius_squared: (1.0 / (radius * radius)) as f32,
            support: support.map(|s| s.0),
            radius: surfel.radius,
            reach: sight.reach(surfel.radius),
            near: (c.z - radius - anchor) as f32,
            far: (c.z + radius - anchor) as f32,
            top: bounds.top as f32,
            bottom: bounds.bottom as f32,
            left: bounds.left as f32,
            right: bounds.right as f32,
            colour: leaf.colour_of(surfel),
            opacity: leaf.opacity_of(surfel),
            index: index as u32,
            class: leaf.class,
            may_enter: sight.may_enter(),
            may_leave: sight.may_leave(),
        }
    }
}

/// Where a surfel is and how it is turned, before anything is known of its place in a tile.
#[derive(Debug, Clone, Copy)]
pub struct Sight {
    /// Centre, view space.
    pub centre: DVec3,
    /// Unit normal, view axes.
    pub normal: Vec3,
    /// Between the ray through the centre and the normal.
    pub cosine: f32,
    /// By how much that of another ray that meets the surfel may differ.
    pub swing: f32,
}

impl Sight {
    /// Whether a ray can enter the leaf here.
    #[inline]
    pub fn may_enter(&self) -> bool {
        self.cosine < self.swing
    }

    /// Whether a ray can leave the leaf here.
    #[inline]
    pub fn may_leave(&self) -> bool {
        self.cosine > -self.swing
    }

    /// How far apart in depth fragments of one surface may lie, for a surfel of `radius`: a group of fragments stays open
    /// ε = min(4r, ½ r (tan θ + ½)), cos θ ≥ 0.05, behind its last one. Factors from ¼ to 2 of it give right layer counts; a
    /// tenth breaks them.
    pub fn reach(&self, radius: f32) -> f32 {
        let c = self.cosine.abs().clamp(LEAST_SPREAD_COSINE, 1.0);
        let tangent = (1.0 - c * c).max(0.0).sqrt() / c;
        (0.5 * radius * (tangent + 0.5)).min(MOST_REACH_IN_RADII * radius)
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

impl LeafLook {
    /// Linear RGB of one of its surfels.
    #[inline]
    pub fn colour_of(&self, surfel: &Surfel) -> [f32; 3] {
        let own = |k: usize| srgb_to_linear(surfel.colour[k]);
        self.colour.unwrap_or_else(|| [own(0), own(1), own(2)])
    }

    /// Opacity of one of its surfels.
    #[inline]
    pub fn opacity_of(&self, surfel: &Surfel) -> f32 {
        self.opacity * f32::from(surfel.colour[3]) / 255.0
    }
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
