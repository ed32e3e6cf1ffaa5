//! One frame of the mesh pipeline: a [`LayerSource`] whose tiles are drawn on demand.
//!
//! *Practice.* A tile asks which leaves have anything in it, shrinks the expression to them, and is done where that is
//! constant; triangles of leaves that cannot matter are not drawn. Several samples a pixel are so many passes over the tile.

#[cfg(feature = "gpu")]
pub(crate) mod arrangement;
mod crossings;
mod pass;
mod settling;

use std::sync::Mutex;

use fearless_simd::prelude::*;
use fearless_simd::{Level, Simd, u32x8};

use self::pass::Pass;
use self::settling::Settling;
use super::bins::{Bins, Entry};
use super::few::{FEW, FewLayers};
use super::fragments::{ABSENT, BLOCK_HEIGHT, BLOCK_WIDTH, BLOCKS_ACROSS, BLOCKS_DOWN, Fragments, LANES};
use super::model::{Look, MeshModel};
use super::peel::{Block, LaneScratch, PeelScratch, SlotKind};
use super::project::{self, SUBPIXELS, Vertices, View};
use super::raster::{Grid, Key, Offsets};
use super::solids::{self, SolidHit};
use super::survivors::{Chooser, Eight, SlotLook, Survivors};
use super::ties::Judge;
use super::visible;
use super::write::Writer;
use crate::csg::{Kept, LeafId, Shrunk};
use crate::layers::opaque::{OpaquePixels, OpaqueSurface, blocks_of};
use crate::layers::{LayerLimit, LayerSource, LayerTile, MAX_SAMPLES, OpaqueTile, TILE_SIDE, sample_offsets};
use crate::space::{Camera, PixelRect};

/// A frame of a [`MeshModel`].
#[derive(Debug)]
pub struct MeshFrame<'a> {
    model: &'a MeshModel,
    view: View,
    limit: LayerLimit,
    samples: u32,
    level: Level,
    vertices: Vertices<'a>,
    bins: Bins,
    /// By solid of the model: its pixels.
    covers: Vec<PixelRect>,
    /// By leaf index: whether no ray begins inside.
    begins_outside: Vec<bool>,
    /// Over positions in pixels.
    planes: Vec<Key>,
    /// Whether every pixel shows at most one surface, an opaque triangle in its leaf's colour.
    is_opaque: bool,
    /// Buffers of the tiles drawn so far, for those to come.
    spare: Mutex<Vec<Scratch>>,
}

/// Where a tile's boundaries go.
enum Target<'a> {
    /// Tiles side by side.
    Layers(&'a mut Vec<LayerTile>),
    /// Only one tile, of a frame that [is opaque](MeshFrame::is_opaque).
    Opaque(&'a mut OpaqueTile),
}

/// Buffers that are kept from tile to tile.
#[derive(Debug, Default)]
struct Scratch {
    looks: Vec<SlotLook>,
    fragments: Fragments,
    shrunk: Shrunk,
    present: Vec<LeafId>,
    kinds: Vec<SlotKind>,
    hits: Vec<SolidHit>,
    planes: Vec<Key>,
    layers: Vec<u32>,
    /// Half-spaces: slot, and number among the model's solids.
    endless: Vec<(u32, usize)>,
    begins_inside: Vec<(u32, u8)>,
    peel: PeelScratch,
    judge: Judge,
    survivors: Survivors,
    entries: Vec<Entry>,
    /// Boundaries of the tile before: those of the next are about as many.
    expected: usize,
    /// By block: what has been found of its pixels.
    found: Vec<Eight>,
    /// By block and word: its pixels' memberships where the last look ended.
    states: Vec<[u32; LANES]>,
}

impl<'a> MeshFrame<'a> {
    /// Projects and bins `model` for `camera`. `samples` a pixel are held to 1 to [`MAX_SAMPLES`].
    pub fn new(model: &'a MeshModel, camera: Camera, limit: LayerLimit, samples: u32) -> Self {
        let samples = samples.clamp(1, MAX_SAMPLES);
        let level = Level::new();
        let view = View::new(camera);
        let meshlets = visible::meshlets(&view, model);
        let vertices = project::vertices(level, &view, model, &meshlets);
        let planes = project::planes(&view, &model.planes);
        let bins = Bins::new(level, &view, model, &meshlets, &vertices, &planes, samples > 1);
        let covers = model.solids.iter().map(|solid| solid.covers(&view)).collect();
        let outside = |look: &Option<Look>| {
            let around = look.as_ref().and_then(|look| look.closed_within);
            around.is_some_and(|(low, high)| view.begins_outside(low, high))
        };
        let begins_outside = model.looks.iter().map(outside).collect();
        let mut looks = model.flat.leaves().iter().map(|leaf| model.look(*leaf));
        let is_opaque = limit == LayerLimit::Nearest
            && samples == 1
            && model.solids.is_empty()
            && looks.all(|look| look.opacity >= 1.0 && !look.is_sheet && !look.vertex_colours);
        let spare = Mutex::default();
        Self { model, view, limit, samples, level, vertices, bins, covers, begins_outside, planes, is_opaque, spare }
    }

    /// Lends buffers.
    fn with_scratch(&self, draw: impl FnOnce(&mut Scratch)) {
        let spare = || self.spare.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        let mut scratch = spare().pop().unwrap_or_default();
        draw(&mut scratch);
        spare().push(scratch);
    }

    fn draw_into(&self, rect: PixelRect, scratch: &mut Scratch, target: Target) {
        #[cfg(target_arch = "x86_64")]
        {
            // Two sets of instructions, as in `splat::frame`: each is another copy of every kernel.
            if let Some(avx2) = self.level.as_avx2() {
                return avx2.vectorize(
                    #[inline(always)]
                    || self.draw_with(avx2, rect, scratch, target),
                );
            }
            let sse2 = self.level.as_sse2().expect("every x86-64 processor has SSE2");
            sse2.vectorize(
                #[inline(always)]
                || self.draw_with(sse2, rect, scratch, target),
            )
        }
        #[cfg(not(target_arch = "x86_64"))]
        fearless_simd::dispatch!(self.level, simd => self.draw_with(simd, rect, scratch, target))
    }

    #[inline(always)]
    fn draw_with<S: Simd>(&self, simd: S, rect: PixelRect, scratch: &mut Scratch, mut target: Target) {
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
                self.tile(simd, (column, row), wanted, scratch, &mut lanes, &mut target);
            }
        }
    }

    /// The tiles of `rect`, which stand row by row in `parts`, as one.
    fn joined(rect: PixelRect, mut parts: Vec<LayerTile>) -> LayerTile {
        if parts.len() == 1 {
            return parts.swap_remove(0);
        }
        // Tiles side by side, as rows of the rectangle.
        let mut whole = LayerTile { rect, offsets: Vec::with_capacity(rect.area() + 1), boundaries: Vec::new() };
        whole.offsets.push(0);
        for of_row in parts.chunk_by(|a, b| a.rect.y0 == b.rect.y0) {
            for y in of_row[0].rect.y0..of_row[0].rect.y1 {
                for (part, x) in of_row.iter().flat_map(|part| (part.rect.x0..part.rect.x1).map(move |x| (part, x))) {
                    whole.boundaries.extend_from_slice(part.at(x, y));
                    whole.offsets.push(whole.boundaries.len() as u32);
                }
            }
        }
        whole
    }

    /// Adds the boundaries of the pixels `wanted` of one tile to `target`.
    #[inline(always)]
    fn tile<S: Simd>(
        &self,
        simd: S,
        (column, row): (u32, u32),
        wanted: PixelRect,
        scratch: &mut Scratch,
        lanes: &mut LaneScratch<S>,
        target: &mut Target,
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
            return match target {
                Target::Layers(parts) => parts.push(LayerTile::empty(wanted)),
                Target::Opaque(tile) => tile.clear(),
            };
        }
        let slots = scratch.shrunk.slots().to_vec();
        let slot_of = |leaf: LeafId| slots.binary_search(&leaf).ok().map(|slot| slot as u32);
        scratch.kinds.clear();
        scratch.kinds.extend(
            slots.iter().map(|leaf| if self.model.look(*leaf).is_sheet { SlotKind::Sheet } else { SlotKind::Closed }),
        );
        scratch.endless.clear();
        for (number, solid) in self.model.solids.iter().enumerate().filter(|(_, solid)| solid.is_endless()) {
            if let Some(slot) = slot_of(solid.leaf)
                && scratch.kinds[slot as usize] == SlotKind::Closed
            {
                scratch.kinds[slot as usize] = SlotKind::Endless;
                scratch.endless.push((slot, number));
            }
        }
        let has_sheets = scratch.kinds.contains(&SlotKind::Sheet);
        scratch.looks.clear();
        scratch.looks.extend(slots.iter().map(|leaf| SlotLook {
            leaf: *leaf,
            look: *self.model.look(*leaf),
            is_solid: self.model.solid_of(*leaf).is_some(),
            stops: self.limit == LayerLimit::Nearest && self.model.look(*leaf).opacity >= 1.0,
        }));
        // Then any boundary is all that a pixel needs, and a block can be settled before everything is drawn.
        let ends = scratch.looks.iter().all(|look| look.stops);
        let is_plain = (ends || !scratch.looks.iter().any(|look| look.stops))
            && scratch.looks.iter().all(|look| !look.is_solid && !look.look.is_sheet);
        let may_settle = is_plain && ends && slots.iter().all(|leaf| self.begins_outside[leaf.0 as usize]);
        if may_settle {
            let blocks = (BLOCKS_ACROSS * BLOCKS_DOWN) as usize;
            scratch.found.resize(blocks, Eight::default());
        }
        scratch.entries.clear();
        scratch.entries.extend(
            entries
                .iter()
                .filter(|entry| slots.binary_search(&self.model.meshlets[entry.meshlet as usize].leaf).is_ok()),
        );
        if may_settle {
            scratch.entries.sort_unstable_by(|a, b| {
                let by_name = || (a.meshlet, a.triangles).cmp(&(b.meshlet, b.triangles));
                b.nearest.total_cmp(&a.nearest).then_with(by_name)
            });
        }
        let wants_bodies = matches!(target, Target::Layers(_));
        scratch.judge.reset();
        lanes.nodes.resize(scratch.shrunk.node_count(), u32x8::splat(simd, 0));

        let offsets = Offsets::new(simd);
        let mut passes = Vec::with_capacity(self.samples as usize);
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
            // Then only what is seen matters, not what lies behind it.
            let may_be_few = may_settle && !wants_bodies && scratch.shrunk.words() == 1;
            let mut settling = Settling::new(wanted, grid, may_settle, may_be_few, wants_bodies);
            if may_settle {
                scratch.states.clear();
                scratch.states.resize(scratch.found.len() * scratch.shrunk.words(), [0; LANES]);
            }
            for i in 0..scratch.entries.len() {
                let entry = scratch.entries[i];
                if may_settle && settling.hides(&entry, &scratch.fragments) {
                    continue;
                }
                if let Some(slot) = slot_of(self.model.meshlets[entry.meshlet as usize].leaf) {
                    pass.meshlet(simd, &offsets, &entry, slot, &scratch.planes, &mut scratch.fragments);
                }
                let Some(next) = scratch.entries.get(i + 1) else { break };
                if settling.is_due(next.nearest, &scratch.fragments) {
                    settling.settle(simd, next.nearest, scratch, lanes);
                    if settling.open == 0 {
                        break;
                    }
                }
            }
            for (solid, covers) in solids() {
                if let Some(slot) = slot_of(solid.leaf) {
                    let (hits, fragments) = (&mut scratch.hits, &mut scratch.fragments);
                    solids::draw(&self.view, &scratch.planes, &grid, solid, *covers, slot, hits, fragments);
                }
            }
            let writer = Writer {
                model: self.model,
                view: &self.view,
                looks: &scratch.looks,
                hits: &scratch.hits,
                offset: pass.offset,
                samples: if self.samples == 1 { 1 } else { 1 << sample },
            };
            let mut chooser = Chooser {
                looks: &scratch.looks,
                hits: &scratch.hits,
                judge: &mut scratch.judge,
                out: &mut scratch.survivors,
                wants_bodies,
            };
            let area = if self.is_opaque { 0 } else { wanted.area() };
            let mut tile = LayerTile {
                rect: wanted,
                offsets: Vec::with_capacity(area + 1),
                boundaries: Vec::with_capacity(area.max(scratch.expected)),
            };
            tile.offsets.push(0);
            if let Target::Opaque(tile) = target {
                tile.clear();
            }
            let [columns, rows] = blocks_of(wanted);
            for block_y in rows.0..=rows.1 {
                for block_x in columns.0..=columns.1 {
                    let corner = (x0 + block_x * BLOCK_WIDTH, y0 + block_y * BLOCK_HEIGHT);
                    let wanted_here = wanted_lanes(corner, wanted);
                    let number = block_y * BLOCKS_ACROSS + block_x;
                    let done = scratch.fragments.done(number);
                    if let (Target::Opaque(tile), u8::MAX) = (&mut *target, done) {
                        let found = &scratch.found[number as usize];
                        self.put(&scratch.looks, found, number, wanted_here, tile);
                        continue;
                    }
                    scratch.fragments.layers_of(number, &mut scratch.layers);
                    if settling.may_be_few && scratch.layers.len() <= FEW {
                        let few = FewLayers {
                            shrunk: &scratch.shrunk,
                            fragments: &scratch.fragments,
                            layers: &scratch.layers,
                            wanted: wanted_here & !done,
                            floor: ABSENT,
                            ceiling: settling.ceiling(),
                        };
                        let found = &mut scratch.found[number as usize];
                        let state = &mut scratch.states[number as usize];
                        if let Some(new) = few.peel(simd, &mut lanes.nodes, state, found)
                            && let Target::Opaque(tile) = &mut *target
                        {
                            self.put(&scratch.looks, found, number, (done | new) & wanted_here, tile);
                            continue;
                        }
                    }
                    if done != 0 {
                        chooser.out.put_block(&scratch.found[number as usize], done);
                    }
                    if done != u8::MAX && !scratch.layers.is_empty() {
                        scratch.begins_inside.clear();
                        for (slot, solid) in &scratch.endless {
                            let solid = &self.model.solids[*solid];
                            let inside = (0..LANES).fold(0, |inside, lane| {
                                let (x, y) = pixel_of(lane);
                                let (x, y) = (block_x * BLOCK_WIDTH + x, block_y * BLOCK_HEIGHT + y);
                                let ray = solids::ray(&self.view, &grid, x, y);
                                inside | u8::from(solid.begins_inside(&ray)) << lane
                            });
                            scratch.begins_inside.push((*slot, inside));
                        }
                        let block = Block {
                            shrunk: &scratch.shrunk,
                            fragments: &scratch.fragments,
                            kinds: &scratch.kinds,
                            layers: &scratch.layers,
                            begins_inside: &scratch.begins_inside,
                            wanted: wanted_here & !done,
                            has_sheets,
                            is_plain,
                            ends,
                            is_partial: may_settle,
                            floor: ABSENT,
                            ceiling: settling.ceiling(),
                        };
                        if may_settle {
                            let words = scratch.shrunk.words();
                            let state = &mut scratch.states[number as usize * words..][..words];
                            block.peel_on(simd, state, lanes, &mut scratch.peel, &mut chooser);
                        } else {
                            block.peel(simd, lanes, &mut scratch.peel, &mut chooser);
                        }
                    }
                    match target {
                        Target::Layers(_) => chooser.out.end_block(wanted_here),
                        Target::Opaque(tile) => {
                            let (first, has) = chooser.out.take_block();
                            self.put(&scratch.looks, &first, number, has & wanted_here, tile);
                        }
                    }
                }
                for (number, row) in chooser.out.rows.iter().enumerate().filter(|(_, row)| !row.counts.is_empty()) {
                    writer.row(wanted.x0, y0 + block_y * BLOCK_HEIGHT + number as u32, row, &mut tile);
                }
                chooser.out.clear_rows();
            }
            scratch.expected = tile.boundaries.len();
            passes.push(tile);
        }
        if let Target::Layers(parts) = target {
            parts.push(if passes.len() == 1 { passes.swap_remove(0) } else { LayerTile::of_samples(wanted, &passes) });
        }
    }

    /// Puts what the pixels `seen` of a block show into an opaque tile.
    #[inline(always)]
    fn put(&self, looks: &[SlotLook], first: &Eight, block: u32, seen: u8, tile: &mut OpaqueTile) {
        if seen == 0 {
            return;
        }
        let (what, owners) = (first.what(), first.owners());
        let of = |lane: usize| OpaqueSurface {
            normal: self.model.surfaces[what[lane] as usize].normal.to_array(),
            colour: looks[owners[lane] as usize].look.colour,
        };
        let some = seen.trailing_zeros() as usize;
        // A triangle is of one leaf.
        let others = (0..LANES).fold(0, |others, lane| others | u8::from(what[lane] != what[some]) << lane);
        let is_same = |lane: usize| (others | !seen) >> lane & 1 == 1 || owners[lane] == owners[some];
        debug_assert!((0..LANES).all(is_same), "one triangle, two owners");
        if others & seen == 0 {
            // Most blocks show one triangle.
            return tile.put_one(block, seen, of(some));
        }
        let mut pixels = OpaquePixels { normals: [[0.0; LANES]; 3], colours: [[0.0; LANES]; 3] };
        let mut rest = seen;
        while rest != 0 {
            let lane = rest.trailing_zeros() as usize;
            rest &= rest - 1;
            let OpaqueSurface { normal, colour } = of(lane);
            for axis in 0..3 {
                pixels.normals[axis][lane] = normal[axis];
                pixels.colours[axis][lane] = colour[axis];
            }
        }
        tile.put_mixed(block, seen, pixels);
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

impl LayerSource for MeshFrame<'_> {
    fn camera(&self) -> &Camera {
        &self.view.camera
    }

    fn samples(&self) -> u32 {
        self.samples
    }

    fn draw(&self, rect: PixelRect) -> LayerTile {
        let mut parts = Vec::new();
        self.with_scratch(|scratch| self.draw_into(rect, scratch, Target::Layers(&mut parts)));
        Self::joined(rect, parts)
    }

    fn draw_opaque(&self, rect: PixelRect, tile: &mut OpaqueTile) -> bool {
        if self.is_opaque {
            self.with_scratch(|scratch| self.draw_into(rect, scratch, Target::Opaque(tile)));
        }
        self.is_opaque
    }
}
