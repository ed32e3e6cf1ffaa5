//! One frame of the surfel pipeline: which surfels touch which tile, and a tile's boundaries on demand.
//!
//! # Practice
//! Binning looks only at support balls (a projection and four bounds); a tile computes the rest of a surfel's view when it
//! is drawn, so that memory is eight bytes a surfel and tile, not a hundred and fifty. Within a tile, surfels are ordered
//! by leaf and, within a leaf, those that rays can *enter* come first: most of what they hide is then skipped by depth
//! without sorting.

use std::borrow::Cow;

use fearless_simd::{Level, Simd};
use glam::DVec2;
use rayon::prelude::*;

use super::clip::Clipping;
use super::clip_buffer;
use super::ewa::{self, Splat};
use super::fragment::{self, FragmentScratch};
use super::project::{LeafLook, View, ViewSurfel};
use super::rows::{LANES, Span};
use super::settings::{Clip, Partners, SplatSettings};
use super::surface::{self, Hit, Run, Scratch, SideCache, Tile};
use crate::classify::partners::{Among, PartnerLists};
use crate::classify::{Class, Model};
use crate::csg::LeafId;
use crate::layers::{Boundary, LayerLimit, LayerSource, LayerTile, SampleMerger, TILE_SIDE, sample_offsets};
use crate::space::{Camera, PixelRect};
use crate::surfel::CHUNK;

/// Blocks are this many pixels a side: a row of lanes wide.
const BLOCK: u32 = LANES as u32;

/// A surfel in a tile's list.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Member {
    leaf: u32,
    index: u32,
}

/// A frame of a classified scene.
pub struct Frame<'a> {
    model: &'a Model,
    view: View,
    limit: LayerLimit,
    samples: u32,
    across: u32,
    /// Where each tile's members start; one more than there are tiles.
    starts: Vec<u32>,
    members: Vec<Member>,
    level: Level,
    settings: SplatSettings,
    /// Where the settings ask for partners.
    clipping: Option<Clipping<'a>>,
}

impl<'a> Frame<'a> {
    /// Bins the surfels of `model` for `camera`, and finds partners where `settings` ask for any
    /// ([`SplatSettings::partners_among`]). `partners` are lists that the caller keeps from frame to frame; they serve
    /// where the settings search space and follow the same rule.
    pub fn new(
        model: &'a Model,
        camera: Camera,
        limit: LayerLimit,
        samples: u32,
        settings: SplatSettings,
        partners: Option<&'a PartnerLists>,
    ) -> Self {
        let across = camera.width.div_ceil(TILE_SIDE);
        let down = camera.height.div_ceil(TILE_SIDE);
        let view = View::new(camera);
        let margin_px = margin_px(settings);
        // Step 1: each chunk's surfels by tile, in order.
        let chunks: Vec<(u32, u32)> = (0..model.fields.len())
            .flat_map(|leaf| (0..model.fields[leaf].cloud.chunks.len()).map(move |c| (leaf as u32, c as u32)))
            .collect();
        const CHUNKS_A_TASK: usize = 64;
        let binned: Vec<Vec<(u32, Member)>> = chunks
            .par_chunks(CHUNKS_A_TASK)
            .map(|task| {
                let mut entries = Vec::with_capacity(task.len() * CHUNK);
                for &(leaf, chunk) in task {
                    bin_chunk(model, &view, (leaf, chunk as usize), across, down, margin_px, &mut entries);
                }
                entries
            })
            .collect();
        // Step 2: count, then place; tasks in order, so the lists do not depend on threads.
        let mut starts = vec![0_u32; (across * down) as usize + 1];
        for (tile, _) in binned.iter().flatten() {
            starts[*tile as usize + 1] += 1;
        }
        for i in 1..starts.len() {
            starts[i] += starts[i - 1];
        }
        let mut next = starts.clone();
        let mut members = vec![Member { leaf: 0, index: 0 }; starts[starts.len() - 1] as usize];
        for (tile, member) in binned.into_iter().flatten() {
            let place = &mut next[tile as usize];
            members[*place as usize] = member;
            *place += 1;
        }
        let level = Level::new();
        let mut frame = Self { model, view, limit, samples, across, starts, members, level, settings, clipping: None };
        frame.clipping = settings.partners_among().map(|among| {
            let lists = match (settings.partners, partners) {
                (Partners::ObjectSpace, Some(kept)) if kept.among() == among => Cow::Borrowed(kept),
                (Partners::ObjectSpace, _) => Cow::Owned(PartnerLists::in_space(model, among)),
                (Partners::ClipBuffer, _) => Cow::Owned(frame.clip_buffer(among)),
            };
            Clipping::new(model, lists, settings)
        });
        frame
    }

    /// The partners that the frame clips with; `None` where its settings need none.
    pub fn partners(&self) -> Option<&PartnerLists> {
        self.clipping.as_ref().map(Clipping::partners)
    }

    /// Finds partners in the picture.
    fn clip_buffer(&self, among: Among) -> PartnerLists {
        let camera = &self.view.camera;
        let pairs = PixelRect::tiles(camera.width, camera.height, TILE_SIDE)
            .into_par_iter()
            .flat_map_iter(|rect| {
                let (tile, leaves) = self.tile(rect, |class| clip_buffer::takes_part(class, among));
                clip_buffer::pairs_of_tile(&tile, &leaves, among)
            })
            .collect();
        PartnerLists::from_pairs(among, self.model.fields.len(), pairs)
    }

    /// The members of every tile that `rect` touches, by leaf and index, each once.
    fn members_of(&self, rect: PixelRect) -> Vec<Member> {
        let (tx0, ty0) = (rect.x0 / TILE_SIDE, rect.y0 / TILE_SIDE);
        let (tx1, ty1) = ((rect.x1 - 1) / TILE_SIDE, (rect.y1 - 1) / TILE_SIDE);
        let mut members = Vec::new();
        for ty in ty0..=ty1 {
            for tx in tx0..=tx1 {
                let tile = (ty * self.across + tx) as usize;
                members.extend_from_slice(&self.members[self.starts[tile] as usize..self.starts[tile + 1] as usize]);
            }
        }
        if (tx0, ty0) != (tx1, ty1) {
            members.sort_unstable();
            members.dedup();
        }
        members
    }

    /// The surfels of `rect` whose class is `wanted`, without partners, and where those of each leaf are.
    fn tile(
        &self,
        rect: PixelRect,
        wanted: impl Fn(Class) -> bool,
    ) -> (Tile<'_>, Vec<(LeafId, std::ops::Range<usize>)>) {
        let members = self.members_of(rect);
        // The anchor only has to be of the surfels' depth: f32 then resolves the tile's depths to 1e-7 of their spread.
        let anchor = members.first().map_or(0.0, |m| {
            self.view.point(self.model.fields[m.leaf as usize].cloud.centre(m.index as usize)).z.max(0.0)
        });
        let mut surfels: Vec<ViewSurfel> = Vec::with_capacity(members.len());
        let mut leaves = Vec::new();
        let mut leaving: Vec<ViewSurfel> = Vec::new();
        for of_leaf in members.chunk_by(|a, b| a.leaf == b.leaf) {
            let leaf = of_leaf[0].leaf as usize;
            let look = self.model.looks[leaf];
            let cloud = &self.model.fields[leaf].cloud;
            let first = surfels.len();
            for m in of_leaf {
                let class = self.model.classes[leaf].classes[m.index as usize];
                if !wanted(class) {
                    continue;
                }
                let look = LeafLook { colour: look.colour, opacity: look.opacity, class };
                if let Some(s) = self.view.surfel(cloud, m.index as usize, rect, anchor, look) {
                    if s.may_enter { surfels.push(s) } else { leaving.push(s) }
                }
            }
            surfels.append(&mut leaving);
            leaves.push((LeafId(leaf as u32), first..surfels.len()));
        }
        let spans = surfels.iter().map(Span::of).collect();
        let tile = Tile {
            model: self.model,
            view: &self.view,
            rect,
            anchor,
            spans,
            surfels,
            limit: self.limit,
            clipper: None,
        };
        (tile, leaves)
    }
}

/// How far outside of its ball a surfel is drawn, pixels.
fn margin_px(settings: SplatSettings) -> f32 {
    // The clip buffer uses the fragments' footprints.
    let flat = settings.clip == Clip::Fragment
        || (settings.partners == Partners::ClipBuffer && settings.partners_among().is_some());
    if flat { ewa::REACH_PX } else { 0.0 }
}

/// Appends the needed surfels of one chunk, (leaf, chunk), to the tiles that their balls touch, or come within `margin_px`
/// of.
fn bin_chunk(
    model: &Model,
    view: &View,
    (leaf, chunk): (u32, usize),
    across: u32,
    down: u32,
    margin_px: f32,
    entries: &mut Vec<(u32, Member)>,
) {
    let field = &model.fields[leaf as usize];
    let cloud = &field.cloud;
    let of_chunk = &cloud.chunks[chunk];
    let ball = f64::from(of_chunk.extent) + f64::from(of_chunk.largest_radius);
    if view.bounds(view.point(of_chunk.origin + of_chunk.centre.as_dvec3()), ball).is_none() {
        return;
    }
    let classes = &model.classes[leaf as usize].classes;
    let first = chunk * CHUNK;
    let last = (first + CHUNK).min(cloud.len());
    for index in (first..last).filter(|&index| classes[index].is_needed()) {
        let radius = f64::from(cloud.surfels[index].radius);
        let Some(b) = view.bounds(view.point(cloud.centre(index)), radius) else { continue };
        // Float to integer casts saturate, so infinite bounds become the picture's.
        let tile = |px: f64, most: u32| ((px / f64::from(TILE_SIDE)).floor().max(0.0) as u32).min(most);
        let margin = f64::from(margin_px);
        let (x0, x1) = (tile(b.left - margin, across - 1), tile(b.right + margin, across - 1));
        let (y0, y1) = (tile(b.top - margin, down - 1), tile(b.bottom + margin, down - 1));
        for ty in y0..=y1 {
            for tx in x0..=x1 {
                entries.push((ty * across + tx, Member { leaf, index: index as u32 }));
            }
        }
    }
}

/// The surfels of a tile by block of pixels: for each block, runs of one leaf.
struct Blocks {
    across: u32,
    /// Per block: (leaf, start, end) into `members`.
    runs: Vec<Vec<(LeafId, u32, u32)>>,
    members: Vec<u32>,
}

impl Blocks {
    /// Of a tile whose surfels are drawn up to `margin_px` outside of their balls.
    fn of(tile: &Tile<'_>, leaves: &[(LeafId, std::ops::Range<usize>)], margin_px: f32) -> Self {
        let across = tile.rect.width().div_ceil(BLOCK);
        let down = tile.rect.height().div_ceil(BLOCK);
        let count = (across * down) as usize;
        let span = |low: f32, high: f32, most: u32| {
            // The blocks that hold a pixel centre between `low` and `high`.
            let block = |px: f32| (px / BLOCK as f32).floor().max(0.0) as u32;
            (block(low - 1.0 - margin_px), block(high + 1.0 + margin_px).min(most - 1))
        };
        let each = |index: usize, f: &mut dyn FnMut(usize)| {
            let s = &tile.surfels[index];
            let (x0, x1) = span(s.left, s.right, across);
            let (y0, y1) = span(s.top, s.bottom, down);
            for y in y0..=y1 {
                for x in x0..=x1 {
                    f((y * across + x) as usize);
                }
            }
        };
        // Counting sort by block; leaves stay in order within a block.
        let mut starts = vec![0_u32; count + 1];
        for index in 0..tile.surfels.len() {
            each(index, &mut |block| starts[block + 1] += 1);
        }
        for i in 1..=count {
            starts[i] += starts[i - 1];
        }
        let mut next = starts.clone();
        let mut members = vec![0_u32; starts[count] as usize];
        let mut runs: Vec<Vec<(LeafId, u32, u32)>> = vec![Vec::new(); count];
        for (leaf, range) in leaves {
            let before = next.clone();
            for index in range.clone() {
                each(index, &mut |block| {
                    members[next[block] as usize] = index as u32;
                    next[block] += 1;
                });
            }
            for block in 0..count {
                if next[block] > before[block] {
                    runs[block].push((*leaf, before[block], next[block]));
                }
            }
        }
        Self { across, runs, members }
    }
}

/// The hits of one block at one sample position: `hits[ranges[pixel]]`, pixels row by row.
#[derive(Default)]
struct BlockHits {
    hits: Vec<Hit>,
    ends: Vec<u32>,
}

impl BlockHits {
    fn of(&self, pixel: usize) -> &[Hit] {
        let start = if pixel == 0 { 0 } else { self.ends[pixel - 1] as usize };
        &self.hits[start..self.ends[pixel] as usize]
    }
}

/// [`trace_block`] with the best instructions at hand. Two sets on x86-64, not all four that could be told apart: each is
/// another copy of every kernel, and half of the crate's build time.
#[allow(clippy::too_many_arguments)]
fn trace_surfaces(
    level: Level,
    tile: &Tile<'_>,
    runs: &[Run<'_>],
    corner: (u32, u32),
    offset: DVec2,
    sides: &mut SideCache,
    out: &mut BlockHits,
) {
    #[cfg(target_arch = "x86_64")]
    {
        if let Some(avx2) = level.as_avx2() {
            avx2.vectorize(
                #[inline(always)]
                || trace_block(avx2, tile, runs, corner, offset, sides, out),
            );
        } else if let Some(sse2) = level.as_sse2() {
            sse2.vectorize(
                #[inline(always)]
                || trace_block(sse2, tile, runs, corner, offset, sides, out),
            );
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    fearless_simd::dispatch!(level, simd => trace_block(simd, tile, runs, corner, offset, sides, out));
}

#[inline(always)]
fn trace_block<S: Simd>(
    simd: S,
    tile: &Tile<'_>,
    runs: &[Run<'_>],
    corner: (u32, u32),
    offset: DVec2,
    sides: &mut SideCache,
    out: &mut BlockHits,
) {
    out.hits.clear();
    out.ends.clear();
    let mut scratch = Scratch::<S>::default();
    let mut lanes: [Vec<Hit>; LANES] = Default::default();
    for y in corner.1..corner.1 + BLOCK {
        if y < tile.rect.height() {
            surface::trace_row(simd, tile, runs, (corner.0, y, offset), sides, &mut scratch, &mut lanes);
        } else {
            lanes.iter_mut().for_each(Vec::clear);
        }
        for lane in &lanes {
            out.hits.extend_from_slice(lane);
            out.ends.push(out.hits.len() as u32);
        }
    }
}

impl LayerSource for Frame<'_> {
    fn camera(&self) -> &Camera {
        &self.view.camera
    }

    fn samples(&self) -> u32 {
        self.samples
    }

    fn draw(&self, rect: PixelRect) -> LayerTile {
        let (mut tile, leaves) = self.tile(rect, |_| true);
        if tile.surfels.is_empty() {
            return LayerTile::empty(rect);
        }
        tile.clipper = self.clipping.as_ref().map(|clipping| clipping.of_tile(&tile.surfels, &leaves));
        let corner = (rect.x0, rect.y0);
        let splats: Vec<Splat> = match self.settings.clip {
            Clip::Fragment => tile.surfels.iter().map(|s| Splat::of(s, &self.view, corner, tile.anchor)).collect(),
            Clip::Surface => Vec::new(),
        };
        let mut scratch = FragmentScratch::default();
        let mut sides = SideCache::new(self.model.fields.len());
        let mut trace = |runs: &[Run<'_>], corner: (u32, u32), offset: DVec2, out: &mut BlockHits| match &tile.clipper {
            Some(clipper) if self.settings.clip == Clip::Fragment => {
                out.hits.clear();
                out.ends.clear();
                let BlockHits { hits, ends } = out;
                fragment::trace_block(&tile, clipper, &splats, runs, corner, BLOCK, offset, &mut scratch, hits, ends);
            }
            _ => trace_surfaces(self.level, &tile, runs, corner, offset, &mut sides, out),
        };
        let blocks = Blocks::of(&tile, &leaves, margin_px(self.settings));
        let offsets = sample_offsets(self.samples);
        let centre = DVec2::splat(0.5);
        let mut placed: Vec<(u32, Boundary)> = Vec::with_capacity(rect.area());
        let mut traced = BlockHits::default();
        let all = ((1_u32 << self.samples) - 1) as u16;
        for (block, runs) in blocks.runs.iter().enumerate() {
            if runs.is_empty() {
                continue;
            }
            let runs: Vec<Run<'_>> = runs
                .iter()
                .map(|&(leaf, start, end)| {
                    let members = &blocks.members[start as usize..end as usize];
                    let entering = members.partition_point(|&m| tile.surfels[m as usize].may_enter);
                    Run { leaf, members, entering }
                })
                .collect();
            let corner = (block as u32 % blocks.across * BLOCK, block as u32 / blocks.across * BLOCK);
            let pixel_of = |lane: u32, row: u32| -> Option<u32> {
                let (x, y) = (corner.0 + lane, corner.1 + row);
                (x < rect.width() && y < rect.height()).then_some(y * rect.width() + x)
            };
            let record = |hit: &Hit, samples: u16| Boundary {
                depth: (tile.anchor + f64::from(hit.t)) as f32,
                normal: self.view.normal_to_world(hit.normal),
                colour: hit.colour,
                opacity: hit.opacity,
                leaf: hit.leaf,
                body: hit.body,
                facing: hit.facing,
                samples,
            };
            trace(&runs, corner, centre, &mut traced);
            let live = |pixel: &usize| pixel_of(*pixel as u32 % BLOCK, *pixel as u32 / BLOCK).is_some();
            if self.samples == 1 || is_uniform((0..(BLOCK * BLOCK) as usize).filter(live).map(|p| traced.of(p))) {
                for pixel in 0..(BLOCK * BLOCK) as usize {
                    if let Some(place) = pixel_of(pixel as u32 % BLOCK, pixel as u32 / BLOCK) {
                        placed.extend(traced.of(pixel).iter().map(|hit| (place, record(hit, all))));
                    }
                }
                continue;
            }
            // An edge runs through the block: every sample for itself.
            let mut merging: Vec<SampleMerger> = vec![SampleMerger::default(); (BLOCK * BLOCK) as usize];
            for (sample, offset) in offsets.iter().enumerate() {
                trace(&runs, corner, *offset, &mut traced);
                for (pixel, merger) in merging.iter_mut().enumerate() {
                    merger.add(traced.of(pixel).iter().map(|hit| record(hit, 1 << sample)));
                }
            }
            for (pixel, merger) in merging.into_iter().enumerate() {
                if let Some(place) = pixel_of(pixel as u32 % BLOCK, pixel as u32 / BLOCK) {
                    placed.extend(merger.finish().into_iter().map(|boundary| (place, boundary)));
                }
            }
        }
        LayerTile::from_placed(rect, &placed)
    }
}

/// Whether all pixels see the same surfaces, so that one sample stands for all.
fn is_uniform<'h>(mut pixels: impl Iterator<Item = &'h [Hit]>) -> bool {
    let Some(first) = pixels.next() else { return true };
    pixels.all(|hits| {
        hits.len() == first.len()
            && hits.iter().zip(first).all(|(a, b)| a.leaf == b.leaf && a.facing == b.facing && a.body == b.body)
    })
}
