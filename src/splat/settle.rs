//! Settled pixels: most of a picture shows one smooth, opaque surface that nothing clips, and needs no ray solved.
//!
//! # Theory
//! Where a small surface surfel faces the eye, the depth of its quadric n·e + ½ eᵀMe = 0 is a smooth function of the pixel:
//! about the projected centre, with (x, y) in pixels, d the ray through the centre, s the footprint and q = n·d,
//! * plane: t = z + g·(x, y) + (g·(x, y))²/z with g = −s (n_x, n_y)/q (the square is perspective's and absent without it);
//! * curvature: e = (s x, s y, 0) + (g·(x, y)) d to first order, and −½ eᵀMe/q is added to t;
//! * support: |e|²/r² (or eᵀSe), a quadratic form in (x, y); normal: n + Me.
//!
//! So each such surfel is *scattered*: every pixel of its ellipse takes a weighted share of depth, normal and colour. As in
//! [`super::rows`], candidates are one surface while their depths overlap within ε; a nearer surface replaces what was there.
//!
//! # Changes from the paper
//! Wicke 2004 §4 draws in two passes, visibility and then blending, on the GPU of its day. One pass does here: a pixel
//! keeps only its nearest surface, and restarts its sums when a nearer one comes.
//!
//! # Practice
//! A pixel is *settled* only if nothing else could show there: every surfel that is not scattered blocks its own pixels
//! from its nearest depth on, and a surface is scattered as far as rays would find it, so that the thin rim of a nearer one
//! takes its pixels from what lies behind and then, weighing too little, leaves them to the rays. Pixels that are not settled are traced ray by ray as if this module did not exist, so it
//! decides no edge and no silhouette. On a leaf that is exact the sums only say where to look for its surface. Leaves
//! that surfels do not find settle a pixel, or block it, by their crossings ([`super::crossed`]).
//! Sums are in surfel order, so the bits do not depend on threads.

use fearless_simd::prelude::*;
use fearless_simd::{Level, Simd, f32x8, u32x8};
use glam::{DVec2, Vec3};

use super::hits::{BlockHits, Hit};
use super::project::{Bounds, Sight, View};
use super::rows::LANES;
use crate::layers::Facing;
use crate::space::{PixelRect, Projection};
use crate::surfel::{Surfel, Sym3};

/// A cosine between ray and normal below which the expansion is not trusted.
const LEAST_COSINE: f32 = 0.1;

/// The normal may turn over a scattered surfel by this share of that cosine, from its curvature or by perspective: the terms
/// left out are of the order of its square, relative to the depth that the surfel spans.
const MOST_SWING_SHARE: f32 = 0.25;

/// The largest scattered surfel, radius in pixels. Larger ones are few, and left to the exact solution.
const MOST_RADIUS_PX: f64 = 32.0;

/// Scattered surfels are at least this many of their radii in front of the eye.
const LEAST_DEPTH_IN_RADII: f64 = 8.0;

/// The summed weight from which on a pixel counts as covered: a tenth of what one surfel weighs at its centre.
const COVERED_WEIGHT: f32 = 0.1;

/// What a scattered surface is part of: surfels of different owners are different surfaces.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Owner {
    /// Whose surface.
    pub leaf: u32,
    /// Whose material lies behind.
    pub body: u32,
    /// Whether rays enter the leaf there.
    pub front: bool,
    /// Whether the result's outward normal is the leaf's.
    pub outward: bool,
    /// Whether the leaf is exact: its surfels then only say where its surface is looked for.
    pub exact: bool,
}

/// A surfel ready to be scattered: pixels from the tile's corner, depths from its anchor.
#[derive(Debug, Clone, Copy)]
pub struct Patch {
    u: f32,
    v: f32,
    /// Depth: constant, linear (x, y), quadratic (xx, xy, yy).
    z: f32,
    g: [f32; 2],
    h: [f32; 3],
    /// Support: xx, xy, yy.
    s: [f32; 3],
    /// Normal: constant, per x, per y.
    n: [[f32; 3]; 3],
    colour: [f32; 3],
    reach: f32,
    owner: u32,
    /// Half of the ellipse's height, pixels.
    half_height: f32,
}

impl Patch {
    /// Of `surfel`, seen as `sight`, in a tile whose corner is `rect`'s and whose depths are relative to `anchor`; `None`
    /// where it is too large, too close or too oblique. `shape` gives curvature and support in view axes; `owner` comes with
    /// its number among the tile's owners.
    #[allow(clippy::too_many_arguments)]
    pub fn of(
        surfel: &Surfel,
        sight: &Sight,
        view: &View,
        (rect, anchor): (PixelRect, f64),
        shape: impl FnOnce() -> (Sym3, Option<Sym3>),
        colour: [f32; 3],
        (owner, number): (Owner, u32),
    ) -> Option<Self> {
        let c = sight.centre;
        let radius = f64::from(surfel.radius);
        let footprint = view.camera.footprint(c.z);
        let steep_enough = sight.cosine.abs() > LEAST_COSINE.max(sight.swing / MOST_SWING_SHARE);
        if !(steep_enough && radius < MOST_RADIUS_PX * footprint && c.z > LEAST_DEPTH_IN_RADII * radius) {
            return None;
        }
        let at = view.camera.px_from_view(c);
        let (dir, per_z) = match view.camera.projection {
            Projection::Perspective { .. } => {
                (Vec3::new((c.x / c.z) as f32, (c.y / c.z) as f32, 1.0), (1.0 / c.z) as f32)
            }
            Projection::Orthographic { .. } => (Vec3::Z, 0.0),
        };
        let (n, scale) = (sight.normal, footprint as f32);
        let per_q = 1.0 / n.dot(dir);
        let g = [-scale * n.x * per_q, -scale * n.y * per_q];
        let along_x = Vec3::new(scale, 0.0, 0.0) + dir * g[0];
        let along_y = Vec3::new(0.0, scale, 0.0) + dir * g[1];
        let (m, support) = shape();
        let sign = if owner.outward { 1.0 } else { -1.0 };
        let (bend_x, bend_y) = (m.mul(along_x), m.mul(along_y));
        let h = [
            g[0] * g[0] * per_z - 0.5 * per_q * along_x.dot(bend_x),
            2.0 * g[0] * g[1] * per_z - per_q * along_x.dot(bend_y),
            g[1] * g[1] * per_z - 0.5 * per_q * along_y.dot(bend_y),
        ];
        let s = match support {
            None => {
                let per_r2 = 1.0 / (surfel.radius * surfel.radius);
                [along_x.length_squared(), along_x.dot(along_y), along_y.length_squared()].map(|v| v * per_r2)
            }
            Some(q) => {
                let (qx, qy) = (q.mul(along_x), q.mul(along_y));
                [along_x.dot(qx), along_x.dot(qy), along_y.dot(qy)]
            }
        };
        let determinant = s[0] * s[2] - s[1] * s[1];
        let half_height = (s[0] / determinant).sqrt();
        if !(half_height.is_finite()
            && g.into_iter().chain(h).chain((bend_x + bend_y + n).to_array()).all(f32::is_finite))
        {
            return None;
        }
        Some(Self {
            u: (at.x - f64::from(rect.x0)) as f32,
            v: (at.y - f64::from(rect.y0)) as f32,
            z: (c.z - anchor) as f32,
            g,
            h,
            s,
            n: [(n * sign).to_array(), (bend_x * sign).to_array(), (bend_y * sign).to_array()],
            colour,
            reach: sight.reach(surfel.radius),
            owner: number,
            half_height,
        })
    }
}

/// What is summed at each pixel.
#[derive(Clone, Copy)]
enum Plane {
    /// Least depth of a candidate less its ε.
    Lower,
    /// Greatest depth of a candidate plus its ε.
    Upper,
    Weight,
    Depth,
    Normal,
    Colour = 7,
    Count = 10,
}

/// `Settled::owner` of a pixel where surfels of several owners overlap.
const CONTESTED: u32 = u32::MAX;

/// The sums of one tile at one place within its pixels.
#[derive(Debug, Default)]
pub struct Settled {
    width: u32,
    height: u32,
    /// Pixels between rows; windows of lanes may begin and end outside of the tile.
    stride: usize,
    planes: Vec<f32>,
    owner: Vec<u32>,
    owners: Vec<Owner>,
    /// The nearest depth of whatever was not scattered.
    blocked_from: Vec<f32>,
    /// A bit for each pixel, a row at a time, once [`Settled::settle`] is through.
    settled: Vec<u64>,
    /// Likewise the pixels where no crossing of a leaf without surfels is on the result.
    uncrossed: Vec<u64>,
    words_a_row: usize,
}

impl Settled {
    /// Scatters `patches` over the tile `rect`, at `offset` within each pixel. What was there is forgotten; memory is kept.
    pub fn scatter(&mut self, level: Level, rect: PixelRect, offset: DVec2, patches: &[Patch], owners: &[Owner]) {
        (self.width, self.height) = (rect.width(), rect.height());
        self.stride = (self.width as usize).next_multiple_of(LANES) + LANES;
        self.words_a_row = (self.width as usize).div_ceil(64);
        let pixels = self.stride * self.height as usize;
        self.owners.clear();
        self.owners.extend_from_slice(owners);
        self.planes.clear();
        self.planes.resize(pixels * Plane::Count as usize, 0.0);
        for row in self.planes.chunks_exact_mut(self.stride * Plane::Count as usize) {
            row[..self.stride].fill(f32::INFINITY); // Plane::Lower
        }
        self.owner.clear();
        self.owner.resize(pixels, CONTESTED);
        self.blocked_from.clear();
        self.blocked_from.resize(pixels, f32::INFINITY);
        self.settled.clear();
        self.settled.resize(self.words_a_row * self.height as usize, 0);
        self.uncrossed.clear();
        self.uncrossed.resize(self.settled.len(), 0);
        #[cfg(target_arch = "x86_64")]
        {
            if let Some(avx2) = level.as_avx2() {
                avx2.vectorize(
                    #[inline(always)]
                    || self.scatter_all(avx2, offset, patches),
                );
            } else if let Some(sse2) = level.as_sse2() {
                sse2.vectorize(
                    #[inline(always)]
                    || self.scatter_all(sse2, offset, patches),
                );
            }
        }
        #[cfg(not(target_arch = "x86_64"))]
        fearless_simd::dispatch!(level, simd => self.scatter_all(simd, offset, patches));
    }

    #[inline(always)]
    fn scatter_all<S: Simd>(&mut self, simd: S, offset: DVec2, patches: &[Patch]) {
        let (ox, oy) = (offset.x as f32, offset.y as f32);
        let lanes = f32x8::from_slice(simd, &[0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);
        let (last_row, last_column) = (self.height as f32 - 1.0, self.width as f32 - 1.0);
        let one_owner = self.owners.len() == 1;
        for p in patches {
            // Pixel centres are at column + ox; casts saturate.
            let first = (p.v - p.half_height - oy).ceil().max(0.0);
            let last = (p.v + p.half_height - oy).floor().min(last_row);
            let mut row = first;
            while row <= last {
                let dy = row + oy - p.v;
                // The row's part of the ellipse s_xx x² + 2 s_xy x y + s_yy y² < 1.
                let b = p.s[1] * dy;
                let rest = p.s[2] * dy * dy;
                let square = (b * b - p.s[0] * (rest - 1.0)).max(0.0).sqrt();
                let left = ((-b - square) / p.s[0] + p.u - ox).ceil().max(0.0);
                let right = ((-b + square) / p.s[0] + p.u - ox).floor().min(last_column);
                let t_row = p.z + (p.g[1] + p.h[2] * dy) * dy;
                let g_row = p.g[0] + p.h[1] * dy;
                let n_row: [f32; 3] = std::array::from_fn(|k| p.n[0][k] + p.n[2][k] * dy);
                let mut x = left;
                while x <= right {
                    let dx = lanes + (x + ox - p.u);
                    let u = (dx * p.s[0] + 2.0 * b) * dx + rest;
                    let inside = u.simd_lt(1.0);
                    let t = (dx * p.h[0] + g_row) * dx + t_row;
                    let v = f32x8::splat(simd, 1.0) - u;
                    self.add(simd, (x as usize, row as usize), p, inside, t, v * v, dx, n_row, one_owner);
                    x += LANES as f32;
                }
                row += 1.0;
            }
        }
    }

    /// Adds what eight neighbouring pixels, the first at column `x`, row `y`, see of `p`.
    #[inline(always)]
    #[allow(clippy::too_many_arguments)] // a kernel's inner step: its arguments live in registers
    fn add<S: Simd>(
        &mut self,
        simd: S,
        (x, y): (usize, usize),
        p: &Patch,
        inside: fearless_simd::mask32x8<S>,
        t: f32x8<S>,
        w: f32x8<S>,
        dx: f32x8<S>,
        n_row: [f32; 3],
        one_owner: bool,
    ) {
        let zero = f32x8::splat(simd, 0.0);
        let stride = self.stride;
        let row = stride * Plane::Count as usize;
        let planes = &mut self.planes[y * row..(y + 1) * row];
        let (near, far) = (t - p.reach, t + p.reach);
        let load = |planes: &[f32], plane: usize| f32x8::from_slice(simd, &planes[plane * stride + x..][..LANES]);
        let lower = load(planes, Plane::Lower as usize);
        let upper = load(planes, Plane::Upper as usize);
        // An empty pixel's lower end is infinite: whatever comes is nearer.
        let nearer = inside & far.simd_lt(lower);
        let takes = nearer | (inside & near.simd_le(upper) & far.simd_ge(lower));
        if takes.all_false() {
            return;
        }
        let w = takes.select(w, zero);
        let store = |planes: &mut [f32], plane: usize, value: f32x8<S>| {
            value.store_slice(&mut planes[plane * stride + x..][..LANES]);
        };
        store(planes, Plane::Lower as usize, takes.select(near.min(lower), lower));
        store(planes, Plane::Upper as usize, nearer.select(far, takes.select(far.max(upper), upper)));
        let add = |planes: &mut [f32], plane: usize, value: f32x8<S>| {
            let so_far = nearer.select(zero, load(planes, plane));
            store(planes, plane, so_far + value);
        };
        add(planes, Plane::Weight as usize, w);
        add(planes, Plane::Depth as usize, takes.select(w * t, zero));
        for (k, of_row) in n_row.into_iter().enumerate() {
            add(planes, Plane::Normal as usize + k, w * (dx * p.n[1][k] + of_row));
            add(planes, Plane::Colour as usize + k, w * p.colour[k]);
        }
        let of_pixel = &mut self.owner[y * stride + x..][..LANES];
        let mine = u32x8::splat(simd, p.owner);
        let before = u32x8::from_slice(simd, of_pixel);
        let joined =
            if one_owner { mine } else { (nearer | before.simd_eq(mine)).select(mine, u32x8::splat(simd, CONTESTED)) };
        takes.select(joined, before).store_slice(of_pixel);
    }

    /// Says that something that was not scattered may show within `bounds` (pixels from the tile's corner), from `depth`
    /// on (less the anchor).
    pub fn block(&mut self, bounds: &Bounds, depth: f32) {
        // A pixel more on each side than any place within a pixel can need.
        let low = |px: f64| (px - 1.0).max(0.0) as usize; // casts round towards zero
        let high = |px: f64, most: u32| (px + 2.0).clamp(0.0, f64::from(most)) as usize;
        let (x0, x1) = (low(bounds.left), high(bounds.right, self.width));
        let (y0, y1) = (low(bounds.top), high(bounds.bottom, self.height));
        if x0 >= x1 {
            return;
        }
        for y in y0..y1 {
            for from in &mut self.blocked_from[y * self.stride + x0..y * self.stride + x1] {
                *from = from.min(depth);
            }
        }
    }

    /// The greatest depth that a covered pixel shows, less the anchor.
    pub fn deepest(&self) -> f32 {
        let pixels = (0..self.height as usize).flat_map(|y| (0..self.width as usize).map(move |x| (x, y)));
        pixels.filter_map(|place| self.covered(place)).fold(f32::NEG_INFINITY, f32::max)
    }

    /// As [`block`](Self::block), at one pixel.
    pub fn block_pixel(&mut self, (x, y): (u32, u32), depth: f32) {
        let from = &mut self.blocked_from[y as usize * self.stride + x as usize];
        *from = from.min(depth);
    }

    /// From which depth on nothing of what is known so far can be seen at a pixel: that of its surface, infinite without any;
    /// `None` where there are surfels but no depth.
    pub fn hidden_from(&self, (x, y): (u32, u32)) -> Option<f32> {
        let place = (x as usize, y as usize);
        let is_empty = self.plane(Plane::Lower as usize, place) == f32::INFINITY;
        self.covered(place).or(is_empty.then_some(f32::INFINITY))
    }

    /// Notes that no crossing of a leaf without surfels is on the result at a pixel.
    pub fn pass(&mut self, (x, y): (u32, u32)) {
        self.uncrossed[y as usize * self.words_a_row + x as usize / 64] |= 1 << (x % 64);
    }

    /// Whether that was noted.
    pub fn is_uncrossed(&self, (x, y): (u32, u32)) -> bool {
        self.uncrossed[y as usize * self.words_a_row + x as usize / 64] >> (x % 64) & 1 == 1
    }

    /// Settles a pixel on `hit`, an opaque front found by other means, in front of all that was scattered there; where
    /// something may hide it, the pixel is left open.
    pub fn show(&mut self, place: (u32, u32), hit: &Hit) {
        let (x, y) = (place.0 as usize, place.1 as usize);
        if !(hit.t < self.blocked_from[y * self.stride + x]) {
            return self.block_pixel(place, hit.t);
        }
        let owner = Owner { leaf: hit.leaf, body: hit.body, front: true, outward: true, exact: false };
        let number = self.owners.iter().rposition(|&known| known == owner).unwrap_or_else(|| {
            self.owners.push(owner);
            self.owners.len() - 1
        });
        self.owner[y * self.stride + x] = number as u32;
        let values = [[1.0, hit.t].as_slice(), &hit.normal.to_array(), &hit.colour].concat();
        for (plane, value) in values.into_iter().enumerate() {
            *self.plane_mut(Plane::Weight as usize + plane, (x, y)) = value;
        }
        self.settled[y * self.words_a_row + x / 64] |= 1 << (x % 64);
    }

    fn plane(&self, plane: usize, (x, y): (usize, usize)) -> f32 {
        self.planes[(y * Plane::Count as usize + plane) * self.stride + x]
    }

    fn plane_mut(&mut self, plane: usize, (x, y): (usize, usize)) -> &mut f32 {
        &mut self.planes[(y * Plane::Count as usize + plane) * self.stride + x]
    }

    /// The depth at column and row `place` where one surface covers it.
    fn covered(&self, place: (usize, usize)) -> Option<f32> {
        let weight = self.plane(Plane::Weight as usize, place);
        (self.owner[place.1 * self.stride + place.0] != CONTESTED && weight > COVERED_WEIGHT)
            .then(|| self.plane(Plane::Depth as usize, place) / weight)
    }

    /// Decides which pixels are settled; called when everything is scattered and blocked. `crossing` solves for an exact
    /// owner's surface on the ray of a pixel (column, row): within a depth of another, the depth and the leaf's unit normal
    /// in view axes.
    pub fn settle(&mut self, crossing: impl Fn(&Owner, (u32, u32), f32, f32) -> Option<(f32, Vec3)>) {
        for y in 0..self.height as usize {
            for x in 0..self.width as usize {
                let place = (x, y);
                if self.settled[y * self.words_a_row + x / 64] >> (x % 64) & 1 == 1 {
                    continue;
                }
                let Some(mut t) = self.covered(place) else { continue };
                let from = self.blocked_from[y * self.stride + x];
                let owner = self.owners[self.owner[y * self.stride + x] as usize];
                if owner.exact && t < from {
                    // Within the depths of its candidates, so that it is the surface that their classes speak of.
                    let depths = self.plane(Plane::Upper as usize, place) - self.plane(Plane::Lower as usize, place);
                    let within = 0.5 * depths;
                    let Some((exact_t, normal)) = crossing(&owner, (x as u32, y as u32), t, within) else { continue };
                    t = exact_t;
                    let weight = self.plane(Plane::Weight as usize, place);
                    *self.plane_mut(Plane::Depth as usize, place) = t * weight;
                    let sign = if owner.outward { 1.0 } else { -1.0 };
                    for k in 0..3 {
                        *self.plane_mut(Plane::Normal as usize + k, place) = normal[k] * sign;
                    }
                }
                if t < from {
                    self.settled[y * self.words_a_row + x / 64] |= 1 << (x % 64);
                }
            }
        }
    }

    /// Which of the eight pixels from column `x` on of row `y` are settled, as bits; `x` is a multiple of eight.
    pub fn lanes(&self, x: u32, y: u32) -> u64 {
        if x >= self.width || y >= self.height {
            return 0;
        }
        let word = self.settled[y as usize * self.words_a_row + x as usize / 64];
        word >> (x % 64) & ((1 << LANES) - 1)
    }

    /// Whether all pixels of the tile from column and row `corner` on, up to eight each way, are settled.
    pub fn is_block_settled(&self, corner: (u32, u32)) -> bool {
        let live = (1_u64 << (self.width - corner.0).min(LANES as u32)) - 1;
        let rows = corner.1..(corner.1 + LANES as u32).min(self.height);
        rows.into_iter().all(|y| self.lanes(corner.0, y) & live == live)
    }

    /// What the pixels of a settled block show; those outside of the tile nothing.
    pub fn block_hits(&self, corner: (u32, u32)) -> BlockHits {
        let mut hits = BlockHits::default();
        let side = LANES as u32;
        for (x, y) in (0..side * side).map(|p| (corner.0 + p % side, corner.1 + p / side)) {
            let inside = x < self.width && y < self.height;
            hits.push(inside.then(|| self.shown(x, y)).as_slice());
        }
        hits
    }

    /// What the settled pixel at column `x`, row `y` shows.
    pub fn shown(&self, x: u32, y: u32) -> Hit {
        let place = (x as usize, y as usize);
        let share = 1.0 / self.plane(Plane::Weight as usize, place);
        let three = |plane: usize| std::array::from_fn(|k| self.plane(plane + k, place));
        let owner = self.owners[self.owner[place.1 * self.stride + place.0] as usize];
        Hit {
            t: self.plane(Plane::Depth as usize, place) * share,
            normal: Vec3::from_array(three(Plane::Normal as usize)).normalize_or_zero(),
            colour: three(Plane::Colour as usize).map(|c| c * share),
            opacity: 1.0,
            leaf: owner.leaf,
            body: owner.body,
            facing: Facing::Front,
        }
    }
}
