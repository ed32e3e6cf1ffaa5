//! Which triangles every tile has to draw.
//!
//! *Practice.* A triangle that holds no pixel centre is dropped here, once, whatever tiles it lies in. What is left of a
//! meshlet in a tile is one entry: the meshlet and a bit for each triangle. A triangle that is large beside a tile has an entry of
//! its own, which knows what part of the tile it may cover, and how near it comes there: so what lies behind can be told from
//! what lies in front. Entries are counted and placed by tile, tasks in order, so the lists do not depend on threads. Every
//! other triangle of a scan at picture size is dropped, which no processor can guess: so a meshlet's boxes are all computed
//! first, without a branch that must be guessed, and only what holds pixels is gone through after that.

use fearless_simd::prelude::*;
use fearless_simd::{Level, Simd, i32x4};
use rayon::prelude::*;

use super::fragments::{BLOCK_HEIGHT, BLOCK_WIDTH};
use super::model::{MESHLET, MeshModel};
use super::project::{Affine, SUBPIXELS, Snapped, View, place};
use super::raster::Key;
use super::setup::held;
use crate::layers::TILE_SIDE;

/// A meshlet in a tile's list.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Entry {
    pub meshlet: u32,
    /// None of the triangles' fragments in the tile has a greater key.
    pub nearest: f32,
    /// The pixels around the triangles, in the tile and perhaps beyond: first column and row, last column and row.
    pub px: [u16; 4],
    /// Which of its triangles.
    pub triangles: u64,
}

/// The entries of all tiles.
#[derive(Debug)]
pub(super) struct Bins {
    pub across: u32,
    starts: Vec<u32>,
    entries: Vec<Entry>,
}

/// Tiles or pixels that a triangle may touch, both ends included.
#[derive(Debug, Clone, Copy, Default)]
struct Span {
    x0: i32,
    y0: i32,
    x1: i32,
    y1: i32,
}

impl Span {
    /// The tiles of pixels.
    #[inline(always)]
    fn tiles(&self) -> Self {
        const SHIFT: u32 = TILE_SIDE.trailing_zeros();
        Self { x0: self.x0 >> SHIFT, y0: self.y0 >> SHIFT, x1: self.x1 >> SHIFT, y1: self.y1 >> SHIFT }
    }

    /// Every column and row, row by row.
    fn all(self) -> impl Iterator<Item = (i32, i32)> {
        (self.y0..=self.y1).flat_map(move |y| (self.x0..=self.x1).map(move |x| (x, y)))
    }

    /// Those of the pixels that lie in the tile of this column and row.
    fn within_tile(&self, x: i32, y: i32) -> Self {
        let side = TILE_SIDE as i32;
        Self {
            x0: self.x0.max(x * side),
            y0: self.y0.max(y * side),
            x1: self.x1.min(x * side + side - 1),
            y1: self.y1.min(y * side + side - 1),
        }
    }

    fn around(&self, other: &Self) -> Self {
        Self {
            x0: self.x0.min(other.x0),
            y0: self.y0.min(other.y0),
            x1: self.x1.max(other.x1),
            y1: self.y1.max(other.y1),
        }
    }
}

impl Bins {
    /// Bins `meshlets` of `model`, of which `vertices` are projected; `planes` are its shared ones over positions in pixels.
    /// `samples_apart`: whether pixels are sampled elsewhere than at their centres.
    pub fn new(
        level: Level,
        view: &View,
        model: &MeshModel,
        meshlets: &[u32],
        vertices: &[Snapped],
        planes: &[Key],
        samples_apart: bool,
    ) -> Self {
        let across = view.camera.width.div_ceil(TILE_SIDE);
        let down = view.camera.height.div_ceil(TILE_SIDE);
        let picture = Picture::new(view, samples_apart);
        const A_TASK: usize = 64;
        let binned: Vec<Vec<(u32, Entry)>> = meshlets
            .par_chunks(A_TASK)
            .map(|meshlets| {
                let mut out = Vec::new();
                let mut scratch = BinScratch::default();
                fearless_simd::dispatch!(level, simd => simd.vectorize(#[inline(always)] || {
                    for &meshlet in meshlets {
                        bin(simd, view, &picture, model, vertices, planes, meshlet as usize, &mut scratch, &mut out);
                    }
                }));
                out
            })
            .collect();
        let mut starts = vec![0_u32; (across * down) as usize + 1];
        for (tile, _) in binned.iter().flatten() {
            starts[*tile as usize + 1] += 1;
        }
        for i in 1..starts.len() {
            starts[i] += starts[i - 1];
        }
        let mut next = starts.clone();
        let mut entries = vec![Entry::default(); starts[starts.len() - 1] as usize];
        for (tile, entry) in binned.into_iter().flatten() {
            let at = &mut next[tile as usize];
            entries[*at as usize] = entry;
            *at += 1;
        }
        Self { across, starts, entries }
    }

    /// The entries of all tiles.
    #[cfg(feature = "gpu")]
    pub fn all(&self) -> &[Entry] {
        &self.entries
    }

    /// The entries of a tile, by its column and row.
    pub fn of(&self, column: u32, row: u32) -> &[Entry] {
        let tile = (row * self.across + column) as usize;
        &self.entries[self.starts[tile] as usize..self.starts[tile + 1] as usize]
    }
}

/// The picture's size, and where in a pixel samples may lie.
struct Picture {
    tiles_across: i32,
    /// Last pixel each way.
    last_px: (i32, i32),
    /// A pixel's samples lie between these, in subpixels.
    first_sample: i32,
    last_sample: i32,
    is_perspective: bool,
}

impl Picture {
    fn new(view: &View, samples_apart: bool) -> Self {
        let (width, height) = (view.camera.width as i32, view.camera.height as i32);
        let side = TILE_SIDE as i32;
        let (first_sample, last_sample) = if samples_apart { (0, 255) } else { (128, 128) };
        Self {
            tiles_across: (width - 1) / side + 1,
            last_px: (width - 1, height - 1),
            first_sample,
            last_sample,
            is_perspective: view.is_perspective,
        }
    }

    /// The pixels with a sample between the corners' least and greatest positions; `None` without such pixels.
    #[inline(always)]
    fn pixels(&self, low: &Snapped, high: &Snapped) -> Option<Span> {
        // The first pixel whose last sample is not before `low`, the last pixel whose first sample is not after `high`.
        let first = |low: i32| (low - self.last_sample + SUBPIXELS - 1).div_euclid(SUBPIXELS);
        let last = |high: i32| (high - self.first_sample).div_euclid(SUBPIXELS);
        let (x0, y0) = (first(low[0]).max(0), first(low[1]).max(0));
        let (x1, y1) = (last(high[0]).min(self.last_px.0), last(high[1]).min(self.last_px.1));
        (x0 <= x1 && y0 <= y1).then_some(Span { x0, y0, x1, y1 })
    }
}

/// The greatest key over a triangle that has it from a shared plane, which may pass its corners at a distance; else the least.
fn over_plane(model: &MeshModel, planes: &[Key], triangle: u32, corners: [Snapped; 3]) -> f32 {
    let Some(key) = planes.get(model.surfaces[triangle as usize].plane as usize) else { return f32::NEG_INFINITY };
    if corners.iter().any(|corner| corner[3] != place::FINE) {
        return key.high;
    }
    let at = |v: Snapped| key.over.at(f64::from(v[0]) / f64::from(SUBPIXELS), f64::from(v[1]) / f64::from(SUBPIXELS));
    let [a, b, c] = corners.map(at);
    rounded_up(a.max(b).max(c), &key.over).min(key.high)
}

/// Bits that are lost where keys are summed in `f32`: from a block's corner, its width and its height aside.
fn rounded_up(most: f64, over: &Affine) -> f32 {
    const ROUNDINGS: f64 = 4.0 * f32::EPSILON as f64;
    let aside = f64::from(BLOCK_WIDTH) * over.x.abs() + f64::from(BLOCK_HEIGHT) * over.y.abs();
    ((most + ROUNDINGS * (most.abs() + aside)) as f32).next_up()
}

/// A triangle with a box of this many pixels along a side has entries of its own.
const LARGE_PX: i32 = TILE_SIDE as i32 / 2;

/// A triangle that is large beside a tile.
struct LargeTriangle {
    key: Key,
    /// Corners, area positive; `None` where they do not lie on the grid.
    corners: Option<[[i64; 2]; 3]>,
}

impl LargeTriangle {
    fn new(view: &View, model: &MeshModel, planes: &[Key], number: u32, corners: [Snapped; 3]) -> Self {
        let surface = &model.surfaces[number as usize];
        let is_fine = corners[0][3] | corners[1][3] | corners[2][3] == place::FINE;
        let key = match planes.get(surface.plane as usize) {
            _ if !is_fine => Key { over: Affine::default(), low: f32::INFINITY, high: f32::INFINITY },
            Some(key) => *key,
            None => {
                let [a, b, c] = corners.map(|corner| f32::from_bits(corner[2] as u32));
                let over = view.key_over(surface.normal.as_dvec3(), surface.offset);
                held(over, a.min(b).min(c), a.max(b).max(c))
            }
        };
        let corners = is_fine.then(|| {
            let [a, b, c] = corners.map(|corner| [i64::from(corner[0]), i64::from(corner[1])]);
            let area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1]);
            if area < 0 { [a, c, b] } else { [a, b, c] }
        });
        Self { key, corners }
    }

    /// No fragment at these pixels has a greater key.
    fn nearest(&self, pixels: &Span) -> f32 {
        let over = &self.key.over;
        // Wherever in their pixels the samples lie.
        let most = |slope: f64, first: i32, last: i32| (slope * f64::from(first)).max(slope * f64::from(last + 1));
        let most = over.c + most(over.x, pixels.x0, pixels.x1) + most(over.y, pixels.y0, pixels.y1);
        // A plane seen edge on tells nothing.
        if most.is_finite() { rounded_up(most, over).max(self.key.low).min(self.key.high) } else { self.key.high }
    }

    /// Whether it may cover a sample of these pixels.
    fn may_cover(&self, picture: &Picture, pixels: &Span) -> bool {
        let Some(corners) = &self.corners else { return true };
        let first = |px: i32| i64::from(px * SUBPIXELS + picture.first_sample);
        let last = |px: i32| i64::from(px * SUBPIXELS + picture.last_sample);
        (0..3).all(|i| {
            let ([x, y], [to_x, to_y]) = (corners[i], corners[(i + 1) % 3]);
            let (dx, dy) = (to_x - x, to_y - y);
            // The edge function at the sample that is furthest on its positive side.
            let px = if dy > 0 { first(pixels.x0) } else { last(pixels.x1) };
            let py = if dx > 0 { last(pixels.y1) } else { first(pixels.y0) };
            dx * (py - y) - dy * (px - x) >= 0
        })
    }
}

/// Buffers that are kept from meshlet to meshlet.
#[derive(Debug)]
struct BinScratch {
    /// By triangle of the meshlet, of those that hold any pixels: first column and row, the other numbers mean nothing.
    first: [[i32; 4]; MESHLET],
    /// Last column and row.
    last: [[i32; 4]; MESHLET],
    /// No fragment of it has a greater key.
    nearest: [f32; MESHLET],
    /// By tile of the meshlet's: which of its small triangles, and their greatest key.
    tiles: Vec<(u64, f32)>,
}

impl Default for BinScratch {
    fn default() -> Self {
        Self {
            first: [[0; 4]; MESHLET],
            last: [[0; 4]; MESHLET],
            nearest: [f32::NEG_INFINITY; MESHLET],
            tiles: Vec::new(),
        }
    }
}

impl BinScratch {
    /// The pixels of triangle `i`.
    #[inline(always)]
    fn pixels(&self, i: u32) -> Span {
        let (first, last) = (&self.first[i as usize], &self.last[i as usize]);
        Span { x0: first[0], y0: first[1], x1: last[0], y1: last[1] }
    }

    /// Finds the pixels and the nearest keys of a meshlet's triangles, by the vertices alone; returns which ones hold any.
    #[inline(always)]
    fn look_at<S: Simd>(&mut self, simd: S, picture: &Picture, triangles: &[[u32; 3]], vertices: &[Snapped]) -> u64 {
        // Numbers of a vertex are lanes. Keys are of one sign, since what is drawn so lies before the eye: not below zero in
        // perspective, not above it else. They are ordered as their bits are, those below zero the other way.
        let to_first = i32x4::splat(simd, SUBPIXELS - 1 - picture.last_sample);
        let to_last = i32x4::splat(simd, -picture.first_sample);
        let least = i32x4::splat(simd, 0);
        let most = i32x4::from_slice(simd, &[picture.last_px.0, picture.last_px.1, i32::MAX, i32::MAX]);
        let mut holding = 0;
        for (i, triangle) in triangles.iter().enumerate() {
            let [a, b, c] = triangle.map(|v| i32x4::from_slice(simd, &vertices[v as usize]));
            let (low, high) = (a.min(b).min(c), a.max(b).max(c));
            let (low_of, high_of): (Snapped, Snapped) = (low.into(), high.into());
            if high_of[3] != place::FINE {
                holding |= u64::from(self.look_aside(i, picture, triangle, vertices)) << i;
                continue;
            }
            // As [`Picture::pixels`].
            let first = ((low + to_first) >> SUBPIXELS.trailing_zeros()).max(least);
            let last = ((high + to_last) >> SUBPIXELS.trailing_zeros()).min(most);
            // Of x and y.
            let is_empty = first.simd_gt(last).to_bitmask() & 0b11 != 0;
            self.first[i] = first.into();
            self.last[i] = last.into();
            self.nearest[i] = f32::from_bits(if picture.is_perspective { high_of[2] } else { low_of[2] } as u32);
            holding |= u64::from(!is_empty) << i;
        }
        holding
    }

    /// As [`look_at`](Self::look_at) one triangle that is not wholly on the grid.
    #[inline(never)]
    fn look_aside(&mut self, i: usize, picture: &Picture, triangle: &[u32; 3], vertices: &[Snapped]) -> bool {
        let [a, b, c] = triangle.map(|v| vertices[v as usize]);
        let found = if (a[3] | b[3] | c[3]) & place::BEHIND == 0 {
            // Positions far aside are held to the grid's border, which leaves them outside of the picture.
            let low: Snapped = std::array::from_fn(|k| a[k].min(b[k]).min(c[k]));
            let high: Snapped = std::array::from_fn(|k| a[k].max(b[k]).max(c[k]));
            picture.pixels(&low, &high)
        } else if a[3] & b[3] & c[3] & place::BEHIND != 0 {
            None
        } else {
            // Through the eye's plane: where it lies on the picture is found tile by tile.
            Some(Span { x0: 0, y0: 0, x1: picture.last_px.0, y1: picture.last_px.1 })
        };
        let Some(found) = found else { return false };
        self.first[i] = [found.x0, found.y0, 0, 0];
        self.last[i] = [found.x1, found.y1, 0, 0];
        // What lies far aside is drawn from its plane, which rounding may put before its corners.
        self.nearest[i] = if picture.is_perspective { f32::INFINITY } else { 0.0 };
        true
    }
}

#[inline(always)]
#[allow(clippy::too_many_arguments)]
fn bin<S: Simd>(
    simd: S,
    view: &View,
    picture: &Picture,
    model: &MeshModel,
    vertices: &[Snapped],
    planes: &[Key],
    meshlet: usize,
    scratch: &mut BinScratch,
    out: &mut Vec<(u32, Entry)>,
) {
    let of = &model.meshlets[meshlet];
    let triangles = &model.triangles[of.first as usize..(of.first + of.count) as usize];
    let holding = scratch.look_at(simd, picture, triangles, vertices);
    let mut small = 0_u64;
    let mut large = 0_u64;
    let nothing = Span { x0: i32::MAX, y0: i32::MAX, x1: i32::MIN, y1: i32::MIN };
    let (mut pixels, mut of_small) = (nothing, nothing);
    let mut nearest = f32::NEG_INFINITY;
    let mut rest = holding;
    while rest != 0 {
        let i = rest.trailing_zeros();
        rest &= rest - 1;
        let found = scratch.pixels(i);
        if of.has_shared_planes {
            let corners = triangles[i as usize].map(|v| vertices[v as usize]);
            let key = &mut scratch.nearest[i as usize];
            *key = key.max(over_plane(model, planes, of.first + i, corners));
        }
        nearest = nearest.max(scratch.nearest[i as usize]);
        pixels = pixels.around(&found);
        if (found.x1 - found.x0).max(found.y1 - found.y0) < LARGE_PX {
            small |= 1 << i;
            of_small = of_small.around(&found);
        } else {
            large |= 1 << i;
        }
    }
    if small | large == 0 {
        return;
    }
    let across = picture.tiles_across;
    let entry = |pixels: &Span, nearest: f32, triangles: u64| {
        let px = [pixels.x0, pixels.y0, pixels.x1, pixels.y1].map(|px| px as u16);
        Entry { meshlet: meshlet as u32, nearest, px, triangles }
    };
    let tile = |x: i32, y: i32| (y * across + x) as u32;
    let all = pixels.tiles();
    if (all.x0, all.y0) == (all.x1, all.y1) {
        out.push((tile(all.x0, all.y0), entry(&pixels, nearest, small | large)));
        return;
    }
    while large != 0 {
        let i = large.trailing_zeros();
        large &= large - 1;
        let (pixels, nearest) = (scratch.pixels(i), scratch.nearest[i as usize]);
        let corners = triangles[i as usize].map(|v| vertices[v as usize]);
        let triangle = LargeTriangle::new(view, model, planes, of.first + i, corners);
        for (x, y) in pixels.tiles().all() {
            let here = pixels.within_tile(x, y);
            if triangle.may_cover(picture, &here) {
                out.push((tile(x, y), entry(&here, triangle.nearest(&here).min(nearest), 1 << i)));
            }
        }
    }
    if small == 0 {
        return;
    }
    let all = of_small.tiles();
    let width = all.x1 - all.x0 + 1;
    scratch.tiles.clear();
    scratch.tiles.resize((width * (all.y1 - all.y0 + 1)) as usize, (0, f32::NEG_INFINITY));
    let mut rest = small;
    while rest != 0 {
        let i = rest.trailing_zeros();
        rest &= rest - 1;
        let (pixels, nearest) = (scratch.pixels(i), scratch.nearest[i as usize]);
        for (x, y) in pixels.tiles().all() {
            let (triangles, nearest_here) = &mut scratch.tiles[((y - all.y0) * width + x - all.x0) as usize];
            *triangles |= 1 << i;
            *nearest_here = nearest_here.max(nearest);
        }
    }
    for (i, &(triangles, nearest)) in scratch.tiles.iter().enumerate().filter(|(_, (triangles, _))| *triangles != 0) {
        let (x, y) = (all.x0 + i as i32 % width, all.y0 + i as i32 / width);
        out.push((tile(x, y), entry(&of_small, nearest, triangles)));
    }
}
