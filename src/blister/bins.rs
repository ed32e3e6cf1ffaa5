//! Which triangles every tile has to draw.
//!
//! *Practice.* A triangle that holds no pixel centre is dropped here, once, whatever tiles it lies in. What is left of a
//! meshlet in a tile is one entry: the meshlet and a bit for each triangle. Entries are counted and placed by tile, tasks in
//! order, so the lists do not depend on threads.

use rayon::prelude::*;

use super::fragments::{BLOCK_HEIGHT, BLOCK_WIDTH};
use super::model::{MESHLET, MeshModel};
use super::project::{SUBPIXELS, Snapped, View, place};
use super::raster::Key;
use crate::layers::TILE_SIDE;

/// A meshlet in a tile's list.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Entry {
    pub meshlet: u32,
    /// The greatest key of the meshlet's drawn triangles: none of its fragments is nearer.
    pub nearest: f32,
    /// The pixels around all of the meshlet that is drawn: first column and row, last column and row.
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
    /// Bins the meshlets of `model`; `planes` are its shared ones over positions in pixels. `samples_apart`: whether pixels are sampled elsewhere than at their centres.
    pub fn new(view: &View, model: &MeshModel, vertices: &[Snapped], planes: &[Key], samples_apart: bool) -> Self {
        let across = view.camera.width.div_ceil(TILE_SIDE);
        let down = view.camera.height.div_ceil(TILE_SIDE);
        let picture = Picture::new(view, samples_apart);
        const A_TASK: usize = 64;
        let binned: Vec<Vec<(u32, Entry)>> = (0..model.meshlets.len().div_ceil(A_TASK))
            .into_par_iter()
            .map(|task| {
                let mut out = Vec::new();
                let mut masks = Vec::new();
                for meshlet in task * A_TASK..((task + 1) * A_TASK).min(model.meshlets.len()) {
                    bin(&picture, model, vertices, planes, meshlet, &mut masks, &mut out);
                }
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
        let first = |low: i32| (low - self.last_sample + 255) >> 8;
        let last = |high: i32| (high - self.first_sample) >> 8;
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
    // Fragments' keys are summed in `f32`: from a block's corner, its width and its height aside.
    const ROUNDINGS: f64 = 4.0 * f32::EPSILON as f64;
    let most = a.max(b).max(c);
    let aside = f64::from(BLOCK_WIDTH) * key.over.x.abs() + f64::from(BLOCK_HEIGHT) * key.over.y.abs();
    ((most + ROUNDINGS * (most.abs() + aside)) as f32).next_up().min(key.high)
}

#[allow(clippy::too_many_arguments)]
fn bin(
    picture: &Picture,
    model: &MeshModel,
    vertices: &[Snapped],
    planes: &[Key],
    meshlet: usize,
    masks: &mut Vec<u64>,
    out: &mut Vec<(u32, Entry)>,
) {
    let of = &model.meshlets[meshlet];
    let triangles = &model.triangles[of.first as usize..(of.first + of.count) as usize];
    let mut tiles = [Span::default(); MESHLET];
    let mut drawn = 0_u64;
    let mut pixels = Span { x0: i32::MAX, y0: i32::MAX, x1: i32::MIN, y1: i32::MIN };
    let mut nearest = f32::NEG_INFINITY;
    for (i, triangle) in triangles.iter().enumerate() {
        let [a, b, c] = triangle.map(|v| vertices[v as usize]);
        let low: Snapped = std::array::from_fn(|k| a[k].min(b[k]).min(c[k]));
        let high: Snapped = std::array::from_fn(|k| a[k].max(b[k]).max(c[k]));
        let places = a[3] | b[3] | c[3];
        let found = if places & place::BEHIND == 0 {
            // Positions far aside are held to the grid's border, which leaves them outside of the picture.
            picture.pixels(&low, &high)
        } else if a[3] & b[3] & c[3] & place::BEHIND != 0 {
            None
        } else {
            // Through the eye's plane: where it lies on the picture is found tile by tile.
            Some(Span { x0: 0, y0: 0, x1: picture.last_px.0, y1: picture.last_px.1 })
        };
        let Some(found) = found else { continue };
        let key = |v: &Snapped| f32::from_bits(v[2] as u32);
        let key = if places & place::BEHIND == 0 {
            key(&a).max(key(&b)).max(key(&c))
        } else if picture.is_perspective {
            f32::INFINITY
        } else {
            0.0
        };
        let key =
            if of.has_shared_planes { key.max(over_plane(model, planes, of.first + i as u32, [a, b, c])) } else { key };
        nearest = nearest.max(key);
        drawn |= 1 << i;
        tiles[i] = found.tiles();
        pixels = pixels.around(&found);
    }
    if drawn == 0 {
        return;
    }
    let all = pixels.tiles();
    let across = picture.tiles_across;
    let px = [pixels.x0, pixels.y0, pixels.x1, pixels.y1].map(|px| px as u16);
    let entry = |triangles| Entry { meshlet: meshlet as u32, nearest, px, triangles };
    let tile = |x: i32, y: i32| (y * across + x) as u32;
    if (all.x0, all.y0) == (all.x1, all.y1) {
        out.push((tile(all.x0, all.y0), entry(drawn)));
        return;
    }
    let width = all.x1 - all.x0 + 1;
    masks.clear();
    masks.resize((width * (all.y1 - all.y0 + 1)) as usize, 0);
    for (i, tiles) in tiles.iter().enumerate().filter(|(i, _)| drawn >> i & 1 == 1) {
        for y in tiles.y0..=tiles.y1 {
            for x in tiles.x0..=tiles.x1 {
                masks[((y - all.y0) * width + x - all.x0) as usize] |= 1 << i;
            }
        }
    }
    for (i, &triangles) in masks.iter().enumerate().filter(|(_, mask)| **mask != 0) {
        out.push((tile(all.x0 + i as i32 % width, all.y0 + i as i32 / width), entry(triangles)));
    }
}
