//! One frame of the mesh pipeline: a [`LayerSource`] whose tiles are drawn on demand.
//!
//! *Practice.* A tile asks which leaves have anything in it, shrinks the expression to them, and is done where that is
//! constant; triangles of leaves that cannot matter are not drawn. Several samples a pixel are so many passes over the tile.

use std::sync::Mutex;

use fearless_simd::prelude::*;
use fearless_simd::{Level, Simd, u32x8};
use glam::{DVec2, DVec3, Vec3};

use super::beyond;
use super::bins::{Bins, Entry};
use super::fragments::{BLOCK_HEIGHT, BLOCK_WIDTH, BLOCKS_ACROSS, BLOCKS_DOWN, Fragments, LANES};
use super::model::{Look, MeshModel};
use super::peel::{Block, LaneScratch, Peel, PeelScratch, Sink, SlotKind};
use super::planes::NO_PLANE;
use super::project::{self, SUBPIXELS, Snapped, View, place};
use super::raster::{self, Grid, Key, Offsets};
use super::solids::{self, SolidHit};
use super::ties::Judge;
use crate::csg::{Kept, LeafId, Shrunk};
use crate::layers::{
    Boundary, Facing, LayerLimit, LayerSource, LayerTile, MAX_SAMPLES, SampleMerger, TILE_SIDE, sample_offsets,
};
use crate::scene::colour::linear_from_bytes;
use crate::space::{Camera, PixelRect};

/// A frame of a [`MeshModel`].
#[derive(Debug)]
pub struct MeshFrame<'a> {
    model: &'a MeshModel,
    view: View,
    limit: LayerLimit,
    samples: u32,
    level: Level,
    vertices: Vec<Snapped>,
    bins: Bins,
    /// By solid of the model: its pixels.
    covers: Vec<PixelRect>,
    /// Over positions in pixels.
    planes: Vec<Key>,
    /// Buffers of the tiles drawn so far, for those to come.
    spare: Mutex<Vec<Box<Scratch>>>,
}

/// Buffers that are kept from tile to tile.
#[derive(Debug, Default)]
struct Scratch {
    fragments: Fragments,
    shrunk: Shrunk,
    present: Vec<LeafId>,
    kinds: Vec<SlotKind>,
    hits: Vec<SolidHit>,
    planes: Vec<Key>,
    layers: Vec<u32>,
    begins_inside: Vec<(u32, u8)>,
    peel: PeelScratch,
    judge: Judge,
    /// By sample: boundaries and their pixels.
    found: Vec<Vec<(u32, Boundary)>>,
}

impl<'a> MeshFrame<'a> {
    /// Projects and bins `model` for `camera`. `samples` a pixel are held to 1 to [`MAX_SAMPLES`].
    pub fn new(model: &'a MeshModel, camera: Camera, limit: LayerLimit, samples: u32) -> Self {
        let samples = samples.clamp(1, MAX_SAMPLES);
        let level = Level::new();
        let view = View::new(camera);
        let vertices = project::vertices(level, &view, model);
        let bins = Bins::new(&view, model, &vertices, samples > 1);
        let covers = model.solids.iter().map(|solid| solid.covers(&view)).collect();
        let planes = project::planes(&view, &model.planes);
        Self { model, view, limit, samples, level, vertices, bins, covers, planes, spare: Mutex::default() }
    }

    fn draw_into(&self, rect: PixelRect, scratch: &mut Scratch) -> LayerTile {
        #[cfg(target_arch = "x86_64")]
        {
            // Two sets of instructions, as in `splat::frame`: each is another copy of every kernel.
            if let Some(avx2) = self.level.as_avx2() {
                return avx2.vectorize(
                    #[inline(always)]
                    || self.draw_with(avx2, rect, scratch),
                );
            }
            let sse2 = self.level.as_sse2().expect("every x86-64 processor has SSE2");
            sse2.vectorize(
                #[inline(always)]
                || self.draw_with(sse2, rect, scratch),
            )
        }
        #[cfg(not(target_arch = "x86_64"))]
        fearless_simd::dispatch!(self.level, simd => self.draw_with(simd, rect, scratch))
    }

    #[inline(always)]
    fn draw_with<S: Simd>(&self, simd: S, rect: PixelRect, scratch: &mut Scratch) -> LayerTile {
        scratch.found.resize_with(self.samples as usize, Vec::new);
        scratch.found.iter_mut().for_each(Vec::clear);
        let mut lanes = LaneScratch::default();
        for row in rect.y0 / TILE_SIDE..=(rect.y1 - 1) / TILE_SIDE {
            for column in rect.x0 / TILE_SIDE..=(rect.x1 - 1) / TILE_SIDE {
                let (x0, y0) = (column * TILE_SIDE, row * TILE_SIDE);
                let wanted = PixelRect {
                    x0: rect.x0.max(x0),
                    y0: rect.y0.max(y0),
                    x1: rect.x1.min(x0 + TILE_SIDE),
                    y1: rect.y1.min(y0 + TILE_SIDE),
                };
                self.tile(simd, (column, row), wanted, rect, scratch, &mut lanes);
            }
        }
        if let [only] = &scratch.found[..] {
            return LayerTile::from_placed(rect, only);
        }
        let tiles: Vec<LayerTile> = scratch.found.iter().map(|placed| LayerTile::from_placed(rect, placed)).collect();
        let mut merged = LayerTile { rect, offsets: Vec::with_capacity(rect.area() + 1), boundaries: Vec::new() };
        merged.offsets.push(0);
        for y in rect.y0..rect.y1 {
            for x in rect.x0..rect.x1 {
                if tiles.iter().any(|tile| !tile.at(x, y).is_empty()) {
                    let mut merger = SampleMerger::default();
                    tiles.iter().for_each(|tile| merger.add(tile.at(x, y).iter().copied()));
                    merged.boundaries.extend(merger.finish());
                }
                merged.offsets.push(merged.boundaries.len() as u32);
            }
        }
        merged
    }

    /// Finds the boundaries of the pixels `wanted` of one tile; `rect` is what they are counted in.
    #[inline(always)]
    fn tile<S: Simd>(
        &self,
        simd: S,
        (column, row): (u32, u32),
        wanted: PixelRect,
        rect: PixelRect,
        scratch: &mut Scratch,
        lanes: &mut LaneScratch<S>,
    ) {
        let entries = self.bins.of(column, row);
        let overlaps = |covers: &PixelRect| {
            covers.x0 < wanted.x1 && wanted.x0 < covers.x1 && covers.y0 < wanted.y1 && wanted.y0 < covers.y1
        };
        let present = &mut scratch.present;
        present.clear();
        for entry in entries {
            let leaf = self.model.meshlets[entry.meshlet as usize].leaf;
            if present.last() != Some(&leaf) {
                present.push(leaf);
            }
        }
        let solids = || self.model.solids.iter().zip(&self.covers).filter(|(_, covers)| overlaps(covers));
        present.extend(solids().map(|(solid, _)| solid.leaf));
        present.sort_unstable();
        present.dedup();
        if scratch.shrunk.keep(&self.model.flat, present) != Kept::Open {
            return;
        }
        let slots = scratch.shrunk.slots();
        let slot_of = |leaf: LeafId| slots.binary_search(&leaf).ok().map(|slot| slot as u32);
        scratch.kinds.clear();
        scratch.kinds.extend(
            slots.iter().map(|leaf| if self.model.look(*leaf).is_sheet { SlotKind::Sheet } else { SlotKind::Closed }),
        );
        for (solid, _) in solids().filter(|(solid, _)| solid.is_endless()) {
            if let Some(slot) = slot_of(solid.leaf)
                && scratch.kinds[slot as usize] == SlotKind::Closed
            {
                scratch.kinds[slot as usize] = SlotKind::Endless;
            }
        }
        scratch.judge.reset();
        lanes.nodes.resize(scratch.shrunk.node_count(), u32x8::splat(simd, 0));

        let offsets = Offsets::new(simd);
        for (sample, offset) in sample_offsets(self.samples).iter().enumerate() {
            let shift = (*offset * f64::from(SUBPIXELS)).round();
            let (x0, y0) = (column * TILE_SIDE, row * TILE_SIDE);
            let grid = Grid {
                x0,
                y0,
                sample: [x0 as i32 * SUBPIXELS + shift.x as i32, y0 as i32 * SUBPIXELS + shift.y as i32],
            };
            let pass = Pass { frame: self, grid, offset: shift / f64::from(SUBPIXELS) };
            scratch.planes.clear();
            scratch.planes.extend(self.planes.iter().map(|key| pass.at_samples(*key)));
            scratch.fragments.clear();
            scratch.hits.clear();
            for entry in entries {
                let leaf = self.model.meshlets[entry.meshlet as usize].leaf;
                if let Some(slot) = slot_of(leaf) {
                    pass.meshlet(simd, &offsets, entry, slot, &scratch.planes, &mut scratch.fragments);
                }
            }
            for (solid, covers) in solids() {
                if let Some(slot) = slot_of(solid.leaf) {
                    let (hits, fragments) = (&mut scratch.hits, &mut scratch.fragments);
                    solids::draw(simd, &self.view, &scratch.planes, &grid, solid, *covers, slot, hits, fragments);
                }
            }
            let corner = self.view.camera.ray(DVec2::new(f64::from(x0), f64::from(y0)) + pass.offset).dir;
            let step = |x: f64, y: f64| {
                (self.view.camera.ray(DVec2::new(f64::from(x0) + x, f64::from(y0) + y) + pass.offset).dir - corner)
                    .as_vec3()
            };
            let mut emit = Emit {
                pass: &pass,
                slots,
                hits: &scratch.hits,
                judge: &mut scratch.judge,
                dirs: [corner.as_vec3(), step(1.0, 0.0), step(0.0, 1.0)],
                samples: if self.samples == 1 { 1 } else { 1 << sample },
                rect,
                block: (0, 0),
                out: &mut scratch.found[sample],
            };
            let blocks =
                |first: u32, end: u32, block: u32| first % TILE_SIDE / block..((end - 1) % TILE_SIDE) / block + 1;
            for block_y in blocks(wanted.y0, wanted.y1, BLOCK_HEIGHT) {
                for block_x in blocks(wanted.x0, wanted.x1, BLOCK_WIDTH) {
                    let number = block_y * BLOCKS_ACROSS + block_x;
                    debug_assert!(block_y < BLOCKS_DOWN);
                    scratch.fragments.layers_of(number, &mut scratch.layers);
                    if scratch.layers.is_empty() {
                        continue;
                    }
                    emit.block = (x0 + block_x * BLOCK_WIDTH, y0 + block_y * BLOCK_HEIGHT);
                    scratch.begins_inside.clear();
                    for (solid, _) in solids().filter(|(solid, _)| solid.is_endless()) {
                        if let Some(slot) = slot_of(solid.leaf)
                            && scratch.kinds[slot as usize] == SlotKind::Endless
                        {
                            let inside = (0..LANES).fold(0, |inside, lane| {
                                let (x, y) = pixel_of(lane);
                                let (x, y) = (block_x * BLOCK_WIDTH + x, block_y * BLOCK_HEIGHT + y);
                                let ray = solids::ray(&self.view, &grid, x, y);
                                inside | u8::from(solid.begins_inside(&ray)) << lane
                            });
                            scratch.begins_inside.push((slot, inside));
                        }
                    }
                    let block = Block {
                        shrunk: &scratch.shrunk,
                        fragments: &scratch.fragments,
                        kinds: &scratch.kinds,
                        layers: &scratch.layers,
                        begins_inside: &scratch.begins_inside,
                        wanted: wanted_lanes(emit.block, wanted),
                    };
                    block.peel(simd, lanes, &mut scratch.peel, &mut emit);
                }
            }
        }
    }
}

/// The column and row of a block's pixel.
fn pixel_of(lane: usize) -> (u32, u32) {
    (lane as u32 % BLOCK_WIDTH, lane as u32 / BLOCK_WIDTH)
}

/// Which pixels of the block at `corner` lie in `wanted`.
fn wanted_lanes(corner: (u32, u32), wanted: PixelRect) -> u8 {
    let is_inner = wanted.x0 <= corner.0
        && corner.0 + BLOCK_WIDTH <= wanted.x1
        && wanted.y0 <= corner.1
        && corner.1 + BLOCK_HEIGHT <= wanted.y1;
    if is_inner {
        return u8::MAX;
    }
    (0..LANES).fold(0, |lanes, lane| {
        let (x, y) = pixel_of(lane);
        let (x, y) = (corner.0 + x, corner.1 + y);
        let is_wanted = (wanted.x0..wanted.x1).contains(&x) && (wanted.y0..wanted.y1).contains(&y);
        lanes | u8::from(is_wanted) << lane
    })
}

/// One sample of a tile's pixels.
struct Pass<'a> {
    frame: &'a MeshFrame<'a>,
    grid: Grid,
    /// Of the sample in its pixel, pixels.
    offset: DVec2,
}

impl Pass<'_> {
    /// A key over positions as one over whole pixels' samples.
    fn at_samples(&self, key: Key) -> Key {
        Key { over: key.over.counted_from(self.offset), ..key }
    }

    #[inline(always)]
    fn meshlet<S: Simd>(
        &self,
        simd: S,
        offsets: &Offsets<S>,
        entry: &Entry,
        slot: u32,
        planes: &[Key],
        fragments: &mut Fragments,
    ) {
        let (model, view, vertices) = (self.frame.model, &self.frame.view, &self.frame.vertices);
        let first = model.meshlets[entry.meshlet as usize].first;
        let mut rest = entry.triangles;
        while rest != 0 {
            let number = first + rest.trailing_zeros();
            rest &= rest - 1;
            let numbers = model.triangles[number as usize];
            let corners = numbers.map(|v| &vertices[v as usize]);
            let [a, b, c] = corners;
            let plane = model.plane_of[number as usize];
            let own = || {
                let normal = model.normals[number as usize].as_dvec3();
                view.key_over(normal, model.position(numbers[0])).counted_from(self.offset)
            };
            if a[3] | b[3] | c[3] == place::FINE {
                let key = || {
                    if plane != NO_PLANE {
                        return planes[plane as usize];
                    }
                    let key = |v: &Snapped| f32::from_bits(v[2] as u32);
                    let (low, high) = (key(a).min(key(b)).min(key(c)), key(a).max(key(b)).max(key(c)));
                    held(own(), low, high)
                };
                raster::triangle(simd, offsets, &self.grid, corners, key, slot, number, fragments);
            } else {
                let over = if plane == NO_PLANE { own() } else { planes[plane as usize].over };
                let corner = |i: usize| beyond::Corner {
                    vertex: numbers[i],
                    snapped: corners[i],
                    p_in_view: view.camera.view_from_world(model.position(numbers[i])),
                };
                let corners = [corner(0), corner(1), corner(2)];
                beyond::triangle(simd, view, &self.grid, corners, over, slot, number, fragments);
            }
        }
    }
}

/// A triangle's own key, held to its corners' range. One that is seen edge on has no plane that says anything: it has its
/// nearest corner's key.
fn held(over: project::Affine, low: f32, high: f32) -> Key {
    let is_sound = over.x.is_finite() && over.y.is_finite() && over.c.is_finite();
    if is_sound { Key { over, low, high } } else { Key { over: project::Affine::default(), low: high, high } }
}

/// Writes the boundaries of one pass.
struct Emit<'a> {
    pass: &'a Pass<'a>,
    slots: &'a [LeafId],
    hits: &'a [SolidHit],
    judge: &'a mut Judge,
    /// The ray's direction at the tile's first pixel, and its steps to the next column and row.
    dirs: [Vec3; 3],
    /// The sample's bit.
    samples: u16,
    rect: PixelRect,
    /// The block's first pixel.
    block: (u32, u32),
    out: &'a mut Vec<(u32, Boundary)>,
}

impl Sink for Emit<'_> {
    fn take(&mut self, shrunk: &Shrunk, peel: &Peel<'_>) -> bool {
        let (owner, body, facing) = if peel.was != peel.is {
            let owner = match peel.members {
                [(slot, _)] => *slot,
                _ => self.judge.owner(shrunk, peel.before, peel.after, peel.is),
            };
            let goes_with_result = super::ties::is_inside(peel.after, owner) == peel.is;
            let inside = if peel.is { peel.after } else { peel.before };
            let body = if goes_with_result { owner } else { self.judge.body(shrunk, inside).unwrap_or(owner) };
            (owner, body, if peel.is { Facing::Front } else { Facing::Back })
        } else {
            let Some(owner) = self.sheet(shrunk, peel) else { return false };
            (owner, owner, Facing::Front)
        };
        let Some(what) = peel.members.iter().filter(|(slot, _)| *slot == owner).map(|(_, what)| *what).min() else {
            return false;
        };
        self.write(peel, owner, body, facing, what)
    }
}

impl Emit<'_> {
    /// The first of the peel's sheets that shows: the result would have it there if it were a solid, and does not otherwise.
    fn sheet(&mut self, shrunk: &Shrunk, peel: &Peel<'_>) -> Option<u32> {
        let is_sheet = |slot: &u32| self.pass.frame.model.look(self.slots[*slot as usize]).is_sheet;
        let mut sheets: Vec<u32> = peel.members.iter().map(|(slot, _)| *slot).filter(is_sheet).collect();
        sheets.sort_unstable();
        sheets.into_iter().find(|&slot| {
            [peel.before, peel.after]
                .into_iter()
                .any(|state| !self.judge.eval(shrunk, state) && self.judge.eval_turned(shrunk, state, slot))
        })
    }

    /// Writes a boundary, unless it is where a half-space does not show. Returns whether the pixel needs nothing behind it.
    fn write(&mut self, peel: &Peel<'_>, owner: u32, body: u32, facing: Facing, what: u32) -> bool {
        let frame = self.pass.frame;
        let leaf = self.slots[owner as usize];
        let look = frame.model.look(leaf);
        let (column, row) = pixel_of(peel.lane);
        let (x, y) = (self.block.0 + column, self.block.1 + row);
        let depth = frame.view.depth(f64::from(peel.key));
        let is_solid = frame.model.solid_of(leaf).is_some();
        let normal = if is_solid {
            let hit = &self.hits[what as usize];
            if !hit.is_drawn {
                return false;
            }
            hit.normal
        } else {
            frame.model.normals[what as usize]
        };
        let [dir, across, down] = self.dirs;
        let (x_in_tile, y_in_tile) = (x - self.pass.grid.x0, y - self.pass.grid.y0);
        let dir = dir + across * x_in_tile as f32 + down * y_in_tile as f32;
        // Outward from the result: against the ray where it is entered, along it where it is left.
        let outward = match facing {
            Facing::Front => -1.0,
            Facing::Back => 1.0,
        };
        let normal = if normal.dot(dir) * outward < 0.0 { -normal } else { normal };
        let colour =
            if look.vertex_colours && !is_solid { self.mixed_colour(what, x, y, depth, look) } else { look.colour };
        let boundary = Boundary {
            depth: depth as f32,
            normal,
            colour,
            opacity: look.opacity,
            leaf: leaf.0,
            body: self.slots[body as usize].0,
            facing,
            samples: self.samples,
        };
        self.out.push(((y - self.rect.y0) * self.rect.width() + (x - self.rect.x0), boundary));
        frame.limit == LayerLimit::Nearest && look.opacity >= 1.0
    }

    /// The vertex colours of a triangle, mixed linearly at the pixel's point.
    fn mixed_colour(&self, triangle: u32, x: u32, y: u32, depth: f64, look: &Look) -> [f32; 3] {
        let model = self.pass.frame.model;
        let numbers = model.triangles[triangle as usize];
        let [a, b, c] = numbers.map(|v| model.position(v));
        let ray = self.pass.frame.view.camera.ray(DVec2::new(f64::from(x), f64::from(y)) + self.pass.offset);
        let p = ray.at(depth);
        let normal = (b - a).cross(c - a);
        let weight = |q: DVec3, r: DVec3| (q - p).cross(r - p).dot(normal).max(0.0);
        let weights = [weight(b, c), weight(c, a), weight(a, b)];
        let sum: f64 = weights.iter().sum();
        if !(sum > 0.0) {
            return look.colour;
        }
        let mut mixed = [0.0; 3];
        for (number, weight) in numbers.into_iter().zip(weights) {
            let own = linear_from_bytes(model.vertex_colours[number as usize]);
            (0..3).for_each(|k| mixed[k] += (weight / sum) as f32 * own[k]);
        }
        mixed
    }
}

impl LayerSource for MeshFrame<'_> {
    fn camera(&self) -> &Camera {
        &self.view.camera
    }

    fn samples(&self) -> u32 {
        self.samples
    }

    fn draw(&self, rect: PixelRect) -> LayerTile {
        let spare = || self.spare.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        let mut scratch = spare().pop().unwrap_or_default();
        let tile = self.draw_into(rect, &mut scratch);
        spare().push(scratch);
        tile
    }
}
