//! One frame of the surfel pipeline: a tile's boundaries on demand.
//!
//! # Practice
//! A tile first *settles* what it can ([`super::settle`]); the rays of what is left are traced block by block
//! ([`super::surface`], or [`super::fragment`] as in the paper). Within a leaf, surfels that rays can *enter* come first: most
//! of what they hide is then skipped by depth without sorting.

use std::borrow::Cow;
use std::cell::Cell;
use std::ops::Range;

use fearless_simd::{Level, Simd};
use glam::{DVec2, DVec3};
use rayon::prelude::*;

use super::bins::{self, BLOCK, Bins, BlockSet, Blocks, Member, Members};
use super::body::body_behind;
use super::clip::Clipping;
use super::clip_buffer;
use super::crossed::{Crossed, Walk};
use super::ewa::{self, Splat};
use super::fragment::{self, FragmentScratch};
use super::hits::{BlockHits, Hit};
use super::project::{Bounds, LeafLook, View, ViewSurfel};
use super::rows::{LANES, Span};
use super::settings::{Clip, Partners, SplatSettings};
use super::settle::{Owner, Patch, Settled};
use super::sides::SideCache;
use super::surface::{self, Run, Scratch, Tile};
use crate::classify::partners::{Among, PartnerLists};
use crate::classify::{Class, Drawn, Model};
use crate::crossings::CrossingSource;
use crate::csg::LeafId;
use crate::csg::residual::Crossing;
use crate::layers::{Boundary, Facing, LayerLimit, LayerSource, LayerTile, SampleMerger, TILE_SIDE, sample_offsets};
use crate::scene::LeafKind;
use crate::space::{Camera, PixelRect};

/// Pixels of a block.
const BLOCK_AREA: usize = (BLOCK * BLOCK) as usize;

/// A frame of a classified scene.
pub struct Frame<'a> {
    model: &'a Model,
    view: View,
    limit: LayerLimit,
    samples: u32,
    bins: Bins,
    level: Level,
    settings: SplatSettings,
    /// Where the settings ask for partners.
    clipping: Option<Clipping<'a>>,
    /// Finds the leaves that have no surfels.
    source: Option<Box<dyn CrossingSource + 'a>>,
}

impl<'a> Frame<'a> {
    /// Bins the surfels of `model` for `camera`, and finds partners where `settings` ask for any
    /// ([`SplatSettings::partners_among`]). `partners` are lists that the caller keeps from frame to frame; they serve
    /// where the settings search space, follow the same rule and were found for the model as it is.
    pub fn new(
        model: &'a Model,
        camera: Camera,
        limit: LayerLimit,
        samples: u32,
        settings: SplatSettings,
        partners: Option<&'a PartnerLists>,
    ) -> Self {
        let view = View::new(camera);
        let bins = Bins::new(model, &view, margin_px(settings));
        let (level, clipping, source) = (Level::new(), None, None);
        let mut frame = Self { model, view, limit, samples, bins, level, settings, clipping, source };
        frame.clipping = settings.partners_among().map(|among| {
            let lists = match (settings.partners, partners) {
                (Partners::ObjectSpace, Some(kept)) if kept.serve(model, among) => Cow::Borrowed(kept),
                (Partners::ObjectSpace, _) => Cow::Owned(PartnerLists::in_space(model, among)),
                (Partners::ClipBuffer, _) => Cow::Owned(frame.clip_buffer(among)),
            };
            Clipping::new(model, lists, settings)
        });
        frame
    }

    /// The same frame with leaves that `source` finds, which must be exact, without surfels, in the model. Serves where surfaces
    /// are clipped on the field ([`SplatSettings::takes_crossings`]).
    pub fn with_crossings(mut self, source: Box<dyn CrossingSource + 'a>) -> Self {
        self.source = Some(source);
        self
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
                let members = self.bins.of(rect);
                let anchor = bins::anchor_of(&members, self.model, &self.view);
                let everywhere = BlockSet::new(rect, true);
                let takes_part = |class| clip_buffer::takes_part(class, among);
                let (tile, leaves) = self.tile(rect, anchor, &members.all(), &everywhere, takes_part);
                clip_buffer::pairs_of_tile(&tile, &leaves, among)
            })
            .collect();
        PartnerLists::from_pairs(among, self.model.fields.len(), pairs)
    }

    fn look(&self, member: Member) -> LeafLook {
        let look = self.model.looks[member.leaf as usize];
        let class = self.model.classes[member.leaf as usize].classes[member.index as usize];
        LeafLook { colour: look.colour, opacity: look.opacity, class }
    }

    /// Those of `members` that may touch one of `blocks` and whose class is `wanted`, ready for the kernels.
    fn tile(
        &self,
        rect: PixelRect,
        anchor: f64,
        members: &[Member],
        blocks: &BlockSet,
        wanted: impl Fn(Class) -> bool,
    ) -> (Tile<'_>, Vec<(LeafId, Range<usize>)>) {
        let margin = f64::from(margin_px(self.settings));
        let mut surfels: Vec<ViewSurfel> = Vec::new();
        let mut leaves = Vec::new();
        let mut leaving: Vec<ViewSurfel> = Vec::new();
        for of_leaf in members.chunk_by(|a, b| a.leaf == b.leaf) {
            let leaf = of_leaf[0].leaf as usize;
            let cloud = &self.model.fields[leaf].cloud;
            let first = surfels.len();
            for m in of_leaf {
                let (index, look) = (m.index as usize, self.look(*m));
                if !wanted(look.class) {
                    continue;
                }
                let sight = self.view.sight(cloud, index);
                let radius = cloud.surfels[index].radius;
                let Some(b) = self.view.rough_bounds(&sight, radius).map(|b| b.from_corner(rect)) else { continue };
                let across = ((b.left - margin) as f32, (b.right + margin) as f32);
                let down = ((b.top - margin) as f32, (b.bottom + margin) as f32);
                if blocks.meets(across, down)
                    && let Some(b) = self.view.bounds(sight.centre, f64::from(radius)).map(|b| b.from_corner(rect))
                {
                    let s = self.view.surfel((cloud, index), &sight, &b, (rect, anchor), look);
                    if s.may_enter { surfels.push(s) } else { leaving.push(s) }
                }
            }
            surfels.append(&mut leaving);
            leaves.push((LeafId(leaf as u32), first..surfels.len()));
        }
        let tile = Tile {
            model: self.model,
            view: &self.view,
            rect,
            anchor,
            spans: surfels.iter().map(Span::of).collect(),
            surfels,
            limit: self.limit,
            clipper: None,
        };
        (tile, leaves)
    }

    /// What the rays of a tile cross of the leaves without surfels: at the middle of the pixels, then at each other place within
    /// them that is sampled; and the depth that all of the tile's are relative to.
    fn crossed(&self, rect: PixelRect, members: &Members<'_>) -> (f64, Vec<(DVec2, Crossed<'_>)>) {
        let mut anchor = bins::anchor_of(members, self.model, &self.view);
        let Some(source) = &self.source else { return (anchor, Vec::new()) };
        let middle = DVec2::splat(0.5);
        let others = sample_offsets(self.samples).iter().copied().filter(|offset| *offset != middle);
        let tiles: Vec<_> =
            std::iter::once(middle).chain(others).map(|offset| (offset, source.crossings(rect, offset))).collect();
        let Some(first) = tiles.iter().find_map(|(_, tile)| tile.crossings.first()) else {
            return (anchor, Vec::new());
        };
        if members.is_empty() {
            anchor = f64::from(first.depth);
        }
        let crossed =
            |(offset, tile)| (offset, Crossed::new(self.model, &self.view, &**source, tile, (rect, anchor), offset));
        (anchor, tiles.into_iter().map(crossed).collect())
    }

    /// Whether pixels can be settled at all: only the nearest boundary is wanted, and whole surfaces do not depend on how
    /// edges are clipped.
    fn settles(&self) -> bool {
        self.limit == LayerLimit::Nearest && self.settings.clip == Clip::Surface
    }

    /// What of a tile can be scattered.
    fn scatter(&self, rect: PixelRect, anchor: f64, members: &Members<'_>, scattered: &mut Scattered) {
        scattered.clear();
        for m in members.near.iter() {
            let (leaf, index) = (LeafId(m.leaf), m.index as usize);
            let field = &self.model.fields[m.leaf as usize];
            let look = self.look(*m);
            let Some(drawn) = look.class.drawn() else { continue };
            let surfel = &field.cloud.surfels[index];
            let sight = self.view.sight(&field.cloud, index);
            let mut patch = || {
                let Drawn::Surface(crossing) = drawn else { return None };
                let opaque = look.opacity_of(surfel) >= 1.0;
                if !opaque || (sight.may_enter() && sight.may_leave()) {
                    return None;
                }
                let front = sight.may_enter();
                let outward = match (field.kind, crossing) {
                    (LeafKind::Sheet, _) => front,
                    (LeafKind::Solid, Crossing::Rises) => true,
                    (LeafKind::Solid, Crossing::Falls) => false,
                };
                let mut decided = true;
                let body = body_behind(self.model, leaf, crossing, index, |_| {
                    decided = false;
                    true
                });
                if !decided {
                    return None;
                }
                let owner = Owner { leaf: m.leaf, body, front, outward, exact: field.exact.is_some() };
                let number = scattered.number_of(owner);
                let shape = || self.view.shape(&field.cloud, index);
                let at = (rect, anchor);
                Patch::of(surfel, &sight, &self.view, at, shape, look.colour_of(surfel), (owner, number))
            };
            match patch() {
                Some(patch) => scattered.patches.push(patch),
                None => scattered.blockers.extend(self.blocker(rect, anchor, *m)),
            }
        }
    }

    /// Whether the surfaces of the block at `corner` of the tile go on smoothly from pixel to pixel.
    fn is_smooth(&self, rect: PixelRect, anchor: f64, corner: (u32, u32), hits: &BlockHits) -> bool {
        let Some(first) = hits.hits.first() else { return true };
        let half = 0.5 * f64::from(BLOCK);
        let middle = DVec2::new(f64::from(rect.x0 + corner.0) + half, f64::from(rect.y0 + corner.1) + half);
        let towards = self.view.camera.rotate_to_view(self.view.camera.ray(middle).dir).as_vec3().normalize_or_zero();
        let footprint = self.view.camera.footprint(anchor + f64::from(first.t)) as f32;
        hits.is_smooth(BLOCK as usize, towards, footprint)
    }

    /// Where in a tile a surfel may show, and its nearest depth.
    fn blocker(&self, rect: PixelRect, anchor: f64, m: Member) -> Option<(Bounds, f32)> {
        let cloud = &self.model.fields[m.leaf as usize].cloud;
        let radius = cloud.surfels[m.index as usize].radius;
        let sight = self.view.sight(cloud, m.index as usize);
        let bounds = self.view.rough_bounds(&sight, radius)?;
        Some((bounds.from_corner(rect), (sight.centre.z - f64::from(radius) - anchor) as f32))
    }
}

/// One tile being drawn.
#[derive(Clone, Copy)]
struct TilePass<'a> {
    frame: &'a Frame<'a>,
    rect: PixelRect,
    anchor: f64,
    members: &'a Members<'a>,
}

/// What of a tile is scattered, and what blocks it.
#[derive(Debug, Default)]
struct Scattered {
    patches: Vec<Patch>,
    owners: Vec<Owner>,
    blockers: Vec<(Bounds, f32)>,
    /// The same of the far members, once they are asked for.
    far: Option<Vec<(Bounds, f32)>>,
}

impl Scattered {
    /// Forgets everything, but keeps the memory.
    fn clear(&mut self) {
        self.patches.clear();
        self.owners.clear();
        self.blockers.clear();
        self.far = None;
    }

    /// The index of `owner`.
    fn number_of(&mut self, owner: Owner) -> u32 {
        let known = self.owners.iter().rposition(|&o| o == owner);
        known.unwrap_or_else(|| {
            self.owners.push(owner);
            self.owners.len() - 1
        }) as u32
    }

    /// Finds what is settled at `offset` within the pixels.
    fn settle(
        &mut self,
        of: &TilePass<'_>,
        offset: DVec2,
        crossed: Option<&Crossed<'_>>,
        sides: &mut SideCache,
        settled: &mut Settled,
    ) {
        let TilePass { frame, rect, anchor, members } = *of;
        settled.scatter(frame.level, rect, offset, &self.patches, &self.owners);
        self.blockers.iter().for_each(|(bounds, depth)| settled.block(bounds, *depth));
        let mut found: Vec<((u32, u32), Hit)> = Vec::new();
        if let Some(crossed) = crossed {
            let mut walk = Walk::default();
            let blocks = BlockSet::new(rect, true);
            for corner in blocks.iter().map(|block| blocks.corner(block)) {
                let (end_x, end_y) = ((corner.0 + BLOCK).min(rect.width()), (corner.1 + BLOCK).min(rect.height()));
                // A block with one ray that takes a closer look is traced anyway: no scan is searched for its others.
                let mut searches = true;
                for place in (corner.1..end_y).flat_map(|y| (corner.0..end_x).map(move |x| (x, y))) {
                    let side =
                        |leaf: LeafId, point| sides.steady(&frame.model.fields[leaf.0 as usize], leaf, point, searches);
                    match steady_hit(crossed, place, &mut walk, side, settled) {
                        Steady::Uncrossed => settled.pass(place),
                        Steady::Passed => {}
                        Steady::Hit(hit) => found.push((place, hit)),
                        Steady::Unknown(depth) => {
                            searches = false;
                            settled.block_pixel(place, depth);
                        }
                    }
                }
            }
        }
        let deepest = found.iter().map(|(_, hit)| hit.t).fold(settled.deepest(), f32::max);
        if f64::from(deepest) >= members.far_from - anchor {
            let far = self
                .far
                .get_or_insert_with(|| members.far.iter().filter_map(|m| frame.blocker(rect, anchor, *m)).collect());
            far.iter().for_each(|(bounds, depth)| settled.block(bounds, *depth));
        }
        found.iter().for_each(|(place, hit)| settled.show(*place, hit));
        settled.settle(|owner, (x, y), t, within| {
            let exact = frame.model.fields[owner.leaf as usize].exact.as_ref()?;
            let px = DVec2::new(f64::from(rect.x0 + x), f64::from(rect.y0 + y)) + offset;
            let ray = frame.view.camera.ray(px);
            let hit = exact.nearest_crossing(&ray, anchor + f64::from(t), f64::from(within), owner.front)?;
            let normal = frame.view.camera.rotate_to_view(hit.normal_in_world).as_vec3();
            (hit.t > 0.0).then_some(((hit.t - anchor) as f32, normal))
        });
    }
}

/// What the crossings of one ray come to without a look at surfels.
enum Steady {
    /// None is on the result.
    Uncrossed,
    /// None is on the result in front of what hides the rest.
    Passed,
    /// The nearest one is.
    Hit(Hit),
    /// From this depth on it takes a closer look.
    Unknown(f32),
}

/// The nearest boundary among the crossings of the ray at `place`, in front of what is scattered there, as far as `side` knows
/// on which side of the leaves that must be asked a point is.
fn steady_hit(
    crossed: &Crossed<'_>,
    place: (u32, u32),
    walk: &mut Walk,
    mut side: impl FnMut(LeafId, DVec3) -> Option<bool>,
    settled: &Settled,
) -> Steady {
    if !crossed.is_crossed(place) {
        return Steady::Uncrossed;
    }
    let Some(hidden_from) = settled.hidden_from(place) else { return Steady::Unknown(f32::NEG_INFINITY) };
    crossed.begin(place, walk);
    while let Some(peel) = crossed.next(walk).filter(|peel| peel.t < hidden_from) {
        let point = crossed.point(walk, &peel);
        let mut is_known = true;
        let hit = crossed.boundary(walk, &peel, |leaf| {
            let side = side(leaf, point);
            is_known &= side.is_some();
            side.unwrap_or(false)
        });
        match hit {
            _ if !is_known => return Steady::Unknown(peel.t),
            None => {}
            Some(hit) if hit.opacity >= 1.0 && hit.facing == Facing::Front => return Steady::Hit(hit),
            Some(hit) => return Steady::Unknown(hit.t),
        }
    }
    if hidden_from == f32::INFINITY { Steady::Uncrossed } else { Steady::Passed }
}

/// What the rays of a set of blocks may meet.
struct Traced<'a> {
    set: BlockSet,
    tile: Tile<'a>,
    blocks: Blocks,
    /// As the paper draws them; empty where surfaces are clipped.
    splats: Vec<Splat>,
}

impl<'a> Traced<'a> {
    fn new(of: &TilePass<'a>, set: BlockSet) -> Self {
        let TilePass { frame, rect, anchor, members } = *of;
        let (mut tile, leaves) = frame.tile(rect, anchor, &members.all(), &set, |_| true);
        tile.clipper = frame.clipping.as_ref().map(|clipping| clipping.of_tile(&tile.surfels, &leaves));
        let splat = |s: &ViewSurfel| Splat::of(s, &frame.view, (rect.x0, rect.y0), anchor);
        let splats = match frame.settings.clip {
            Clip::Fragment => tile.surfels.iter().map(splat).collect(),
            Clip::Surface => Vec::new(),
        };
        let blocks = Blocks::of(&set, &tile.surfels, &leaves, margin_px(frame.settings));
        Self { set, tile, blocks, splats }
    }
}

/// What a thread keeps from tile to tile: memory that is fresh costs more than what is written to it.
#[derive(Debug, Default)]
struct Kept {
    scattered: Scattered,
    settled: Settled,
}

thread_local! {
    static KEPT: Cell<Option<Box<Kept>>> = const { Cell::new(None) };
}

/// Draws one tile at one place within the pixels after the other, keeping what does not depend on the place.
struct TileTracer<'a> {
    of: TilePass<'a>,
    kept: Box<Kept>,
    traced: Option<Traced<'a>>,
    sides: SideCache,
    fragments: FragmentScratch,
    /// By place within the pixels; none where no ray crosses a leaf without surfels.
    crossed: Vec<(DVec2, Crossed<'a>)>,
}

impl<'a> TileTracer<'a> {
    fn new(of: TilePass<'a>, crossed: Vec<(DVec2, Crossed<'a>)>) -> Self {
        let frame = of.frame;
        let mut kept = KEPT.take().unwrap_or_default();
        if frame.settles() {
            frame.scatter(of.rect, of.anchor, of.members, &mut kept.scattered);
        }
        Self {
            of,
            kept,
            traced: None,
            sides: SideCache::new(frame.model.fields.len()),
            fragments: FragmentScratch::default(),
            crossed,
        }
    }

    /// Whether the rays of a block's samples cross other leaves than those at the middle of its pixels, nearer than `depth`.
    fn is_crossed_unevenly(&self, corner: (u32, u32), depth: f32) -> bool {
        let Some(((_, middle), others)) = self.crossed.split_first() else { return false };
        let rect = self.of.rect;
        let mut places = (corner.1..(corner.1 + BLOCK).min(rect.height()))
            .flat_map(|y| (corner.0..(corner.0 + BLOCK).min(rect.width())).map(move |x| (x, y)));
        places.any(|place| others.iter().any(|(_, other)| middle.differs_at(other, place, depth)))
    }

    /// Calls `each` with what every block of `set` shows at `offset` within its pixels.
    fn trace(&mut self, set: &BlockSet, offset: DVec2, mut each: impl FnMut(usize, Seen<'_>)) {
        let frame = self.of.frame;
        // Step 1: settle what can be.
        let crossed = self.crossed.iter().find(|(place, _)| *place == offset).map(|(_, crossed)| crossed);
        let Kept { scattered, settled } = &mut *self.kept;
        let settled = frame.settles().then(|| {
            scattered.settle(&self.of, offset, crossed, &mut self.sides, settled);
            &*settled
        });
        // Step 2: make ready the surfels that the other blocks' rays may meet, or, where those of an earlier place do not
        // serve, those of all blocks, so that they serve all places that follow.
        let mut open = BlockSet::new(self.of.rect, false);
        for block in set.iter() {
            match settled {
                Some(settled) if settled.is_block_settled(set.corner(block)) => each(block, Seen::Settled(settled)),
                _ => open.insert(block),
            }
        }
        if open.is_empty() {
            return;
        }
        let known = self.traced.take();
        let wanted = if known.is_none() { &open } else { set };
        let known = known.filter(|traced| traced.set.holds(&open));
        let traced = self.traced.insert(known.unwrap_or_else(|| Traced::new(&self.of, wanted.clone())));
        // Step 3: trace them block by block.
        let Traced { tile, blocks, splats, .. } = traced;
        let mut hits = BlockHits::default();
        for block in open.iter() {
            hits.clear();
            let corner = set.corner(block);
            let runs: Vec<Run<'_>> = blocks
                .runs(block)
                .map(|(leaf, members)| {
                    let entering = members.partition_point(|&m| tile.surfels[m as usize].may_enter);
                    Run { leaf, members, entering }
                })
                .collect();
            match &tile.clipper {
                Some(clipper) if frame.settings.clip == Clip::Fragment => {
                    let at = (corner, BLOCK, offset);
                    fragment::trace_block(tile, clipper, splats, &runs, at, &mut self.fragments, &mut hits);
                }
                _ => {
                    let beside = (settled, crossed);
                    trace_surfaces(frame.level, tile, &runs, (corner, offset), beside, &mut self.sides, &mut hits);
                }
            }
            let surfels = || runs.iter().flat_map(|run| run.members).map(|&m| &tile.surfels[m as usize]);
            let edge_on = |s: &ViewSurfel| s.class.drawn().is_some() && s.is_edge_on();
            let may_be_crossed = surfels().any(|s| s.class.is_edge() || edge_on(s));
            each(block, Seen::Traced { hits: &hits, may_be_crossed });
        }
    }
}

/// What a block shows at one place within its pixels.
enum Seen<'a> {
    /// All its pixels are settled.
    Settled(&'a Settled),
    /// Hits, and whether an edge or a silhouette may run between them.
    Traced { hits: &'a BlockHits, may_be_crossed: bool },
}

/// [`trace_block`] with the best instructions at hand. Two sets on x86-64, not all four that could be told apart: each is
/// another copy of every kernel, and half of the crate's build time.
fn trace_surfaces(
    level: Level,
    tile: &Tile<'_>,
    runs: &[Run<'_>],
    at: ((u32, u32), DVec2),
    beside: (Option<&Settled>, Option<&Crossed<'_>>),
    sides: &mut SideCache,
    out: &mut BlockHits,
) {
    #[cfg(target_arch = "x86_64")]
    {
        if let Some(avx2) = level.as_avx2() {
            avx2.vectorize(
                #[inline(always)]
                || trace_block(avx2, tile, runs, at, beside, sides, out),
            );
        } else if let Some(sse2) = level.as_sse2() {
            sse2.vectorize(
                #[inline(always)]
                || trace_block(sse2, tile, runs, at, beside, sides, out),
            );
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    fearless_simd::dispatch!(level, simd => trace_block(simd, tile, runs, at, beside, sides, out));
}

#[inline(always)]
fn trace_block<S: Simd>(
    simd: S,
    tile: &Tile<'_>,
    runs: &[Run<'_>],
    (corner, offset): ((u32, u32), DVec2),
    (settled, crossed): (Option<&Settled>, Option<&Crossed<'_>>),
    sides: &mut SideCache,
    out: &mut BlockHits,
) {
    let mut scratch = Scratch::<S>::default();
    let mut lanes: [Vec<Hit>; LANES] = Default::default();
    for y in corner.1..corner.1 + BLOCK {
        if y < tile.rect.height() {
            let at = (corner.0, y, offset);
            surface::trace_row(simd, tile, runs, at, settled, crossed, sides, &mut scratch, &mut lanes);
        } else {
            lanes.iter_mut().for_each(Vec::clear);
        }
        lanes.iter().for_each(|lane| out.push(lane));
    }
}

/// How far outside of its ball a surfel is drawn, pixels.
pub(crate) fn margin_px(settings: SplatSettings) -> f32 {
    // The clip buffer uses the fragments' footprints.
    let flat = settings.clip == Clip::Fragment
        || (settings.partners == Partners::ClipBuffer && settings.partners_among().is_some());
    if flat { ewa::REACH_PX } else { 0.0 }
}

impl LayerSource for Frame<'_> {
    fn camera(&self) -> &Camera {
        &self.view.camera
    }

    fn samples(&self) -> u32 {
        self.samples
    }

    fn draw(&self, rect: PixelRect) -> LayerTile {
        let members = self.bins.of(rect);
        let (anchor, crossed) = self.crossed(rect, &members);
        if members.is_empty() && crossed.is_empty() {
            return LayerTile::empty(rect);
        }
        let mut tracer = TileTracer::new(TilePass { frame: self, rect, anchor, members: &members }, crossed);
        let record = |hit: &Hit, samples: u16| Boundary {
            depth: (anchor + f64::from(hit.t)) as f32,
            normal: self.view.normal_to_world(hit.normal),
            colour: hit.colour,
            opacity: hit.opacity,
            leaf: hit.leaf,
            body: hit.body,
            facing: hit.facing,
            samples,
        };
        let everywhere = BlockSet::new(rect, true);
        let all = ((1_u32 << self.samples) - 1) as u16;
        // What each block shows; `None` where it is settled at the middle of its pixels.
        let mut blocks: Vec<Option<LayerTile>> = vec![None; everywhere.count()];
        let traced = |block: usize, hits: &BlockHits| {
            everywhere.tile(block, |pixel, out| out.extend(hits.of(pixel).iter().map(|hit| record(hit, all))))
        };
        // Step 1: all blocks at the middle of their pixels, which does for those that an edge does not cross.
        let mut crossed = BlockSet::new(rect, false);
        // Behind the deepest surface that a block shows, where all its pixels show one, nothing matters.
        let mut shows_to = vec![f32::INFINITY; everywhere.count()];
        let nearest_only = self.limit == LayerLimit::Nearest;
        tracer.trace(&everywhere, DVec2::splat(0.5), |block, seen| {
            let corner = everywhere.corner(block);
            let mut one_surface = |hits: &BlockHits| {
                let is_one = hits.is_uniform() && self.is_smooth(rect, anchor, corner, hits);
                if is_one && nearest_only && !hits.hits.is_empty() {
                    shows_to[block] = hits.hits.iter().map(|hit| hit.t).fold(f32::NEG_INFINITY, f32::max);
                }
                is_one
            };
            match seen {
                Seen::Settled(settled) if self.samples == 1 || one_surface(&settled.block_hits(corner)) => {}
                Seen::Traced { hits, may_be_crossed }
                    if self.samples == 1 || (!may_be_crossed && one_surface(hits)) =>
                {
                    blocks[block] = Some(traced(block, hits))
                }
                _ => crossed.insert(block),
            }
        });
        for block in everywhere.iter() {
            let is_decided = self.samples == 1 || crossed.contains(block);
            if !is_decided && tracer.is_crossed_unevenly(everywhere.corner(block), shows_to[block]) {
                crossed.insert(block);
                blocks[block] = None;
            }
        }
        // Step 2: the others, every sample for itself.
        if !crossed.is_empty() {
            let mut merging: Vec<Vec<SampleMerger>> = vec![Vec::new(); crossed.count()];
            for block in everywhere.iter() {
                let corner = everywhere.corner(block);
                if crossed.contains(block) {
                    merging[block] = vec![SampleMerger::default(); BLOCK_AREA];
                } else if blocks[block].is_none() {
                    // Other places' sums will take the place of these.
                    let settled = &tracer.kept.settled;
                    let shown = |pixel: u32| settled.shown(corner.0 + pixel % BLOCK, corner.1 + pixel / BLOCK);
                    blocks[block] =
                        Some(everywhere.tile(block, |pixel, out| out.push(record(&shown(pixel as u32), all))));
                }
            }
            for (sample, offset) in sample_offsets(self.samples).iter().enumerate() {
                tracer.trace(&crossed, *offset, |block, seen| {
                    let corner = everywhere.corner(block);
                    for (pixel, merger) in merging[block].iter_mut().enumerate() {
                        let (x, y) = (corner.0 + pixel as u32 % BLOCK, corner.1 + pixel as u32 / BLOCK);
                        match seen {
                            Seen::Settled(settled) if x < rect.width() && y < rect.height() => {
                                merger.add(std::iter::once(record(&settled.shown(x, y), 1 << sample)));
                            }
                            Seen::Settled(_) => {}
                            Seen::Traced { hits, .. } => {
                                merger.add(hits.of(pixel).iter().map(|hit| record(hit, 1 << sample)))
                            }
                        }
                    }
                });
            }
            for block in crossed.iter() {
                let merge = |pixel: usize, out: &mut Vec<Boundary>| {
                    out.extend(std::mem::take(&mut merging[block][pixel]).finish());
                };
                blocks[block] = Some(everywhere.tile(block, merge));
            }
        }
        // Step 3: the blocks as one tile, row by row.
        let mut boundaries = Vec::with_capacity(rect.area());
        let mut offsets = Vec::with_capacity(rect.area() + 1);
        offsets.push(0);
        for y in 0..rect.height() {
            for x in 0..rect.width() {
                match &blocks[everywhere.at(x, y)] {
                    None => boundaries.push(record(&tracer.kept.settled.shown(x, y), all)),
                    Some(tile) => boundaries.extend_from_slice(tile.at(x, y)),
                }
                offsets.push(boundaries.len() as u32);
            }
        }
        KEPT.set(Some(tracer.kept));
        LayerTile { rect, offsets, boundaries }
    }
}

#[cfg(test)]
mod settle_tests;
