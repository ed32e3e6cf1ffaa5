//! Every vertex on the picture's grid, and what turns a plane in world space into depth on the picture.
//!
//! *Theory.* On the picture of a perspective camera the reciprocal of planar depth is affine in the pixel's position over a
//! plane: with the ray `eye + t·(X, Y, 1)` in view axes and the plane n·(p − p₀) = 0, 1/t = n·(X, Y, 1) / n·(p₀ − eye). On
//! that of an orthographic one depth itself is. So a fragment's *key* is 1/t or −t: affine either way, and larger nearer.
//!
//! *Practice.* Positions are snapped to 1/256 pixel in `f64`; whoever shares a vertex shares its snapped position. A vertex
//! that is not in front of the eye, or so far aside that edge functions would not fit their integers, is marked, and its
//! triangles go to [`beyond`](super::beyond). Keys come from the plane in world space, not from the snapped corners, so
//! that snapping moves edges by 1/512 pixel and depth not at all.

use std::ops::Deref;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use fearless_simd::{Level, Simd};
use glam::{DVec2, DVec3};
use rayon::prelude::*;

use super::fragments::LANES;
use super::model::MeshModel;
use super::planes::Plane;
use super::raster::Key;
use crate::space::{Camera, Projection};

/// Positions of the grid within a pixel, each way.
pub(crate) const SUBPIXELS: i32 = 256;

/// Vertices further than this aside, in pixels from the picture's corner, do not go through the integer rasteriser. The
/// span from [`LEAST_PX`] to [`MOST_PX`] is 2^16 pixels, so the difference of two positions has 24 bits, an edge function
/// changes by at most 2·2^24 a pixel and by less than 2^31 over the 63 pixels of a tile.
const LEAST_PX: f64 = -16_384.0;
const MOST_PX: f64 = 49_152.0;

/// Meshlets that are worth a task.
const MESHLETS_A_TASK: usize = 64;

/// A vertex on the picture: x and y in [`SUBPIXELS`], the bits of its key, and a [`place`].
pub(super) type Snapped = [i32; 4];

/// The fourth number of a [`Snapped`]; the numbers are bits, so that a triangle's are the union of its corners'.
pub(super) mod place {
    /// In front of the eye, and x and y hold.
    pub const FINE: i32 = 0;
    /// In front of the eye, but too far aside.
    pub const ASIDE: i32 = 1;
    /// Not in front of the eye.
    pub const BEHIND: i32 = 2;
}

/// A key that is affine in the picture's position: `x·px + y·py + c`, pixels.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Affine {
    pub x: f64,
    pub y: f64,
    pub c: f64,
}

impl Affine {
    #[inline(always)]
    pub fn at(&self, px: f64, py: f64) -> f64 {
        self.x * px + self.y * py + self.c
    }

    /// The same function of positions that are counted from `origin`.
    #[inline(always)]
    pub fn counted_from(&self, origin: DVec2) -> Self {
        Self { c: self.at(origin.x, origin.y), ..*self }
    }
}

/// Eight of [`Affine`].
#[derive(Debug, Clone, Copy)]
pub(super) struct Affines {
    x: [f64; LANES],
    y: [f64; LANES],
    c: [f64; LANES],
}

impl Affines {
    /// As [`Affine::counted_from`].
    #[inline(always)]
    pub fn counted_from(mut self, origin: DVec2) -> Self {
        for lane in 0..LANES {
            self.c[lane] = self.get(lane).at(origin.x, origin.y);
        }
        self
    }

    #[inline(always)]
    pub fn get(&self, lane: usize) -> Affine {
        Affine { x: self.x[lane], y: self.y[lane], c: self.c[lane] }
    }
}

/// A camera, as numbers that the kernels use.
#[derive(Debug, Clone)]
pub(super) struct View {
    pub camera: Camera,
    /// Pixels per unit of tangent, or per world unit.
    scale: f64,
    /// Its reciprocal.
    per_scale: f64,
    pub is_perspective: bool,
    middle: DVec2,
}

impl View {
    pub fn new(camera: Camera) -> Self {
        let (scale, is_perspective) = match camera.projection {
            Projection::Perspective { focal_px } => (focal_px, true),
            Projection::Orthographic { px_per_unit } => (px_per_unit, false),
        };
        let middle = DVec2::new(f64::from(camera.width), f64::from(camera.height)) * 0.5;
        Self { camera, scale, per_scale: 1.0 / scale, is_perspective, middle }
    }

    /// The key of planar depth `t`.
    pub fn key(&self, t: f64) -> f64 {
        if self.is_perspective { 1.0 / t } else { -t }
    }

    /// The planar depth of a key.
    #[inline(always)]
    pub fn depth(&self, key: f32) -> f32 {
        if self.is_perspective { 1.0 / key } else { -key }
    }

    /// Whether a key is of a point in front of the eye.
    pub fn is_in_front(&self, key: f32) -> bool {
        if self.is_perspective { key > 0.0 } else { key < 0.0 }
    }

    /// Where `across`, X or Y in view axes at depth `z`, lies on the picture, pixels from its middle.
    #[inline(always)]
    pub fn on_picture(&self, across: f64, z: f64) -> f64 {
        if self.is_perspective { across * (self.scale / z) } else { across * self.scale }
    }

    /// The picture's middle, pixels.
    pub fn middle(&self) -> DVec2 {
        self.middle
    }

    /// View axes' X and Y of picture position `px`: of the ray's direction, or of its origin.
    pub fn across(&self, px: DVec2) -> DVec2 {
        (px - self.middle) / self.scale
    }

    /// The key over the plane of the points p with `normal`·p = `offset`, in world space. Not finite where the eye, or the
    /// direction of an orthographic view, lies in the plane.
    #[inline(always)]
    pub fn key_over(&self, normal: DVec3, offset: f64) -> Affine {
        let n = self.camera.rotate_to_view(normal);
        let offset = offset - normal.dot(self.camera.eye);
        let (share, constant) = if self.is_perspective {
            let share = 1.0 / offset;
            (share, n.z * share)
        } else {
            let share = 1.0 / n.z;
            (share, -offset * share)
        };
        let gradient = DVec2::new(n.x, n.y) * (share * self.per_scale);
        Affine { x: gradient.x, y: gradient.y, c: constant - gradient.dot(self.middle) }
    }

    /// [`key_over`](Self::key_over) eight planes, the same bits: normals by axis. Written so that the compiler makes vectors of
    /// it.
    #[inline(always)]
    pub fn keys_over(&self, normals: &[[f64; LANES]; 3], offsets: &[f64; LANES]) -> Affines {
        let Camera { eye, right, down, forward, .. } = &self.camera;
        let dot = |lane: usize, v: &DVec3| normals[0][lane] * v.x + normals[1][lane] * v.y + normals[2][lane] * v.z;
        let none = [0.0; LANES];
        let (mut share, mut constant) = (none, none);
        for lane in 0..LANES {
            let offset = offsets[lane] - dot(lane, eye);
            let n_z = dot(lane, forward);
            let by = if self.is_perspective { offset } else { n_z };
            share[lane] = 1.0 / by;
            constant[lane] = (if self.is_perspective { n_z } else { -offset }) * share[lane];
        }
        let mut over = Affines { x: none, y: none, c: none };
        for lane in 0..LANES {
            let scale = share[lane] * self.per_scale;
            over.x[lane] = dot(lane, right) * scale;
            over.y[lane] = dot(lane, down) * scale;
            over.c[lane] = constant[lane] - (over.x[lane] * self.middle.x + over.y[lane] * self.middle.y);
        }
        over
    }

    /// Whether no ray begins in a box in world space.
    pub fn begins_outside(&self, low: DVec3, high: DVec3) -> bool {
        let eye = self.camera.eye;
        let holds_eye = low.cmple(eye).all() && eye.cmple(high).all();
        let is_in_front = || corners(low, high).into_iter().all(|p| self.camera.view_from_world(p).z > 0.0);
        (self.is_perspective && !holds_eye) || is_in_front()
    }

    /// The range of keys of a box in world space; half open to the front where it reaches behind the eye.
    pub fn key_range(&self, low: DVec3, high: DVec3) -> (f32, f32) {
        let (mut near, mut far) = (f64::INFINITY, f64::NEG_INFINITY);
        for corner in corners(low, high) {
            let z = self.camera.view_from_world(corner).z;
            (near, far) = (near.min(z), far.max(z));
        }
        if near > 0.0 {
            (self.key(far) as f32, self.key(near) as f32)
        } else if self.is_perspective {
            ((1.0 / far) as f32, f32::INFINITY)
        } else {
            (-far as f32, 0.0)
        }
    }
}

/// The corners of a box.
pub(super) fn corners(low: DVec3, high: DVec3) -> [DVec3; 8] {
    let pick = |corner: usize, axis: usize| if corner >> axis & 1 == 0 { low[axis] } else { high[axis] };
    std::array::from_fn(|corner| DVec3::new(pick(corner, 0), pick(corner, 1), pick(corner, 2)))
}

/// Every shared plane's key on the picture, over positions in pixels.
pub(super) fn planes(view: &View, planes: &[Plane]) -> Vec<Key> {
    let on_picture = |plane: &Plane| {
        let (low, high) = match plane.extent {
            Some((low, high)) => view.key_range(low, high),
            None => (f32::MIN, f32::MAX),
        };
        Key { over: view.key_over(plane.normal, plane.normal.dot(plane.point)), low, high }
    };
    planes.iter().map(on_picture).collect()
}

/// The vertices of `meshlets` on the picture, in parallel, by their numbers among all of `model`'s; those of no such meshlet mean nothing.
pub(super) fn vertices<'a>(level: Level, view: &View, model: &'a MeshModel, meshlets: &[u32]) -> Vertices<'a> {
    /// Vertices that are projected or left out together: most of a meshlet's follow each other.
    const TOGETHER: usize = 256;
    const A_TASK: usize = 32 * TOGETHER;
    let [xs, ys, zs] = model.positions.as_ref();
    let mut snapped = model.spare.take(xs.len());
    // Step 1: which are asked for; where most are, it costs more to find out than it spares.
    let all = 2 * meshlets.len() > model.meshlets.len();
    let is_used: Vec<AtomicBool> = (0..xs.len().div_ceil(TOGETHER)).map(|_| AtomicBool::new(all)).collect();
    if !all {
        meshlets.par_iter().with_min_len(MESHLETS_A_TASK).for_each(|meshlet| {
            let meshlet = &model.meshlets[*meshlet as usize];
            let triangles = &model.triangles[meshlet.first as usize..(meshlet.first + meshlet.count) as usize];
            for vertex in triangles.as_flattened() {
                is_used[*vertex as usize / TOGETHER].store(true, Ordering::Relaxed);
            }
        });
    }
    // Step 2: those.
    snapped.par_chunks_mut(A_TASK).enumerate().for_each(|(task, out)| {
        fearless_simd::dispatch!(level, simd => simd.vectorize(#[inline(always)] || {
            for (number, out) in out.chunks_mut(TOGETHER).enumerate() {
                let first = task * A_TASK + number * TOGETHER;
                if is_used[first / TOGETHER].load(Ordering::Relaxed) {
                    let range = first..first + out.len();
                    snap(view, [&xs[range.clone()], &ys[range.clone()], &zs[range]], out);
                }
            }
        }));
    });
    Vertices { snapped, spare: &model.spare }
}

/// Vertices on the picture.
#[derive(Debug)]
pub(super) struct Vertices<'a> {
    snapped: Vec<Snapped>,
    spare: &'a Spare,
}

impl Deref for Vertices<'_> {
    type Target = [Snapped];

    fn deref(&self) -> &[Snapped] {
        &self.snapped
    }
}

impl Drop for Vertices<'_> {
    fn drop(&mut self) {
        self.spare.buffers().push(std::mem::take(&mut self.snapped));
    }
}

/// Buffers of frames that are done, for those to come: to be given as much memory by the system in every frame takes as long as to
/// fill it.
#[derive(Debug, Default)]
pub(super) struct Spare(Mutex<Vec<Vec<Snapped>>>);

impl Spare {
    fn buffers(&self) -> MutexGuard<'_, Vec<Vec<Snapped>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A buffer of this length, of any content.
    fn take(&self, length: usize) -> Vec<Snapped> {
        let spare = self.buffers().pop();
        spare.filter(|buffer| buffer.len() == length).unwrap_or_else(|| vec![[0; 4]; length])
    }
}

impl Clone for Spare {
    /// Buffers are not shared: a model of the same leaves gets its own when it is drawn.
    fn clone(&self) -> Self {
        Self::default()
    }
}

/// Written so that the compiler makes vectors of it.
#[inline(always)]
fn snap(view: &View, [xs, ys, zs]: [&[f64]; 3], out: &mut [Snapped]) {
    let Camera { eye, right, down, forward, .. } = view.camera;
    let scale = view.scale * f64::from(SUBPIXELS);
    let middle = view.middle * f64::from(SUBPIXELS);
    let least = LEAST_PX * f64::from(SUBPIXELS);
    let most = MOST_PX * f64::from(SUBPIXELS);
    // Adding 1.5·2^52 rounds to an integer, which is then in the lowest bits.
    const ROUND: f64 = 6_755_399_441_055_744.0;
    for (((x, y), z), out) in xs.iter().zip(ys).zip(zs).zip(out) {
        let (x, y, z) = (x - eye.x, y - eye.y, z - eye.z);
        let depth = forward.x * x + forward.y * y + forward.z * z;
        let reciprocal = 1.0 / depth;
        let (shrink, key) = if view.is_perspective { (reciprocal, reciprocal) } else { (1.0, -depth) };
        let px = (right.x * x + right.y * y + right.z * z) * (shrink * scale) + middle.x;
        let py = (down.x * x + down.y * y + down.z * z) * (shrink * scale) + middle.y;
        let is_aside = !((px >= least) & (px < most) & (py >= least) & (py < most));
        let is_behind = !(depth > 0.0);
        let place = (i32::from(is_aside) * place::ASIDE) | (i32::from(is_behind) * place::BEHIND);
        let grid = |px: f64| (px.clamp(least, most) + ROUND).to_bits() as u32 as i32;
        *out = [grid(px), grid(py), (key as f32).to_bits() as i32, place];
    }
}
