//! Clipping on surfaces: the boundaries of the result for the rays of one block of pixels.
//!
//! # Theory
//! Wicke 2004 §3.3 clips every fragment on its flat disk. Here clipping is *deferred*: gather all unclipped fragments of a
//! pixel, group them into surfaces, solve one hit per surface ([`super::rows`]), then ask the tree once per surface. The
//! expression that is asked is the residual
//! of the surfel nearest to the hit: that surfel's ball holds the hit, so every leaf that classification decided for the
//! ball is decided for the hit, and the near ones are asked at the hit itself.
//!
//! # Changes from the paper
//! Wicke 2004 §3.2 collects clipping partners per surfel. Here the block's list of surfels *is* the clip buffer: a surfel
//! of leaf B can weigh on f_B at a point only if its ball holds the point, hence only if the point's ray passes its ball,
//! hence only if it is in the list of the block. So there are no partner lists to store, and a dense partner costs no
//! more than it would to draw.
//!
//! # Practice
//! Other leaves are asked by [`super::sides`], and whose material lies behind a cut is `super::body`'s to say.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x8, mask32x8};
use glam::{DVec2, DVec3, Vec3};

use super::body::{body_at, body_behind};
use super::clip::{ClipScratch, Clipper};
use super::crossed::{Crossed, Peel, Walk};
use super::hits::{Hit, finish_ray};
use super::project::{View, ViewSurfel};
use super::rows::{self, LANES, Row, Slot, Span};
use super::settle::Settled;
use super::sides::{Hits, OnSurface, SideCache, Told, sides};
use super::tied::{self, Tied};
use super::turns::{self, Dropped, Found, Mended};
use crate::classify::{Drawn, Model};
use crate::csg::LeafId;
use crate::csg::residual::Crossing;
use crate::layers::{Facing, LayerLimit};
use crate::scene::LeafKind;
use crate::space::{PixelRect, Projection, Ray};

/// Newton steps on the field for surfaces that are clipped: one brings the hit onto the field that others ask; the second
/// is for grazing rays.
pub(crate) const EDGE_STEPS: u32 = 2;

/// How far below 1 a mean opacity is by rounding alone: far below 1/255, the least step of a surfel's opacity.
pub(crate) const OPACITY_ROUNDING: f32 = 1e-5;

/// One tile's surfels, ready for the kernels.
pub struct Tile<'a> {
    /// The scene.
    pub model: &'a Model,
    /// The camera.
    pub view: &'a View,
    /// The tile's pixels.
    pub rect: PixelRect,
    /// Depths are relative to this.
    pub anchor: f64,
    /// All surfels that may touch the tile.
    pub surfels: Vec<ViewSurfel>,
    /// Their spans.
    pub spans: Vec<Span>,
    /// How many boundaries to find.
    pub limit: LayerLimit,
    /// Where partners are asked instead of the field.
    pub clipper: Option<Clipper<'a>>,
}

/// The surfels of one leaf that may touch one block: positions in [`Tile::surfels`], those that rays can enter first.
#[derive(Debug, Clone, Copy)]
pub struct Run<'a> {
    /// The leaf.
    pub leaf: LeafId,
    /// Positions in [`Tile::surfels`].
    pub members: &'a [u32],
    /// How many of `members`, from the first, rays can enter the leaf through.
    pub entering: usize,
}

/// Reused between rows.
pub struct Scratch<S: Simd> {
    slots: Vec<Slot<S>>,
    pub(super) found: Vec<(u32, f32)>,
    touching: Vec<u32>,
    pub(super) reaching: Vec<u32>,
    known: Vec<Option<Told>>,
    clip: ClipScratch,
    walks: [Walk; LANES],
    /// Crossings with the leaf of the run, on the result or not, and the groups of candidates that were dropped.
    crossings: [Vec<Found>; LANES],
    dropped: [Vec<Dropped>; LANES],
    mended: Mended,
    /// The groups to resolve, each with bits of lanes.
    groups: Vec<(usize, u64)>,
    /// Crossings with surfaces that others may coincide with.
    tied: [Vec<Tied>; LANES],
}

impl<S: Simd> Default for Scratch<S> {
    fn default() -> Self {
        Self {
            slots: Vec::new(),
            found: Vec::new(),
            touching: Vec::new(),
            reaching: Vec::new(),
            known: Vec::new(),
            clip: ClipScratch::default(),
            walks: Default::default(),
            crossings: Default::default(),
            dropped: Default::default(),
            mended: Mended::default(),
            groups: Vec::new(),
            tied: Default::default(),
        }
    }
}

/// A bit for each lane.
const ALL_LANES: u64 = (1 << LANES) - 1;

/// Where a row is traced: first column and row, tile-relative, and the place within the pixel.
pub type At = (u32, u32, DVec2);

/// Traces eight rays of the tile from `at` on, but for the pixels that are `settled`, whose hits are known; `crossed` are the
/// leaves that surfels do not find. `hits[lane]` are what each meets, front to back.
#[inline(always)]
#[allow(clippy::too_many_arguments)]
pub fn trace_row<S: Simd>(
    simd: S,
    tile: &Tile<'_>,
    runs: &[Run<'_>],
    at: At,
    settled: Option<&Settled>,
    crossed: Option<&Crossed<'_>>,
    cache: &mut SideCache,
    scratch: &mut Scratch<S>,
    hits: &mut [Vec<Hit>; LANES],
) {
    hits.iter_mut().for_each(Vec::clear);
    scratch.tied.iter_mut().for_each(Vec::clear);
    let mut row = row_of(simd, tile, at.0, at.1, at.2);
    if let Some(settled) = settled {
        let known = settled.lanes(at.0, at.1);
        for lane in (0..LANES as u32).filter(|lane| known >> lane & 1 == 1) {
            hits[lane as usize].push(settled.shown(at.0 + lane, at.1));
        }
        row.live &= mask32x8::from_bitmask(simd, !known & ALL_LANES);
        if row.live.all_false() {
            return;
        }
    }
    let nearest_only = tile.limit == LayerLimit::Nearest;
    let mut hidden_from = f32x8::splat(simd, f32::INFINITY);
    for run in runs {
        let field = &tile.model.fields[run.leaf.0 as usize];
        let generous = field.exact.is_some();
        scratch.crossings.iter_mut().for_each(Vec::clear);
        scratch.dropped.iter_mut().for_each(Vec::clear);
        let mut slots = std::mem::take(&mut scratch.slots);
        slots.clear();
        // Surfaces that rays enter are found and resolved first: what they hide of the others is then not even looked at.
        let (entering, leaving) = run.members.split_at(run.entering);
        let mut touching = std::mem::take(&mut scratch.touching);
        touching.clear();
        // Last come those that were dropped and are crossings after all.
        let mut groups = std::mem::take(&mut scratch.groups);
        for turn in [Turn::Entering, Turn::Leaving, Turn::Mended] {
            groups.clear();
            let front = turn == Turn::Entering;
            match turn {
                Turn::Entering | Turn::Leaving => {
                    let members = if front { entering } else { leaving };
                    let before = touching.len();
                    let depths = (f32::NEG_INFINITY, hidden_from.reduce_max());
                    rows::touching(&row, &tile.spans, members, depths, &mut touching);
                    rows::detect(&row, &tile.surfels, &touching[before..], generous, hidden_from, &mut slots);
                    let of_turn = slots.iter().enumerate().filter(|(_, slot)| slot.front == front);
                    groups.extend(of_turn.map(|(number, _)| (number, ALL_LANES)));
                }
                Turn::Mended => {
                    put_in_turn(tile, run.leaf, nearest_only, &mut hidden_from, at, cache, scratch, hits, &mut groups)
                }
            }
            for &(number, lanes) in &groups {
                let lanes = mask32x8::from_bitmask(simd, lanes);
                let group = Group { slot: &slots[number], number, lanes, crosses: turn == Turn::Mended };
                resolve(
                    &row,
                    tile,
                    runs,
                    crossed,
                    run,
                    &touching,
                    group,
                    nearest_only,
                    &mut hidden_from,
                    at,
                    cache,
                    scratch,
                    hits,
                );
            }
        }
        scratch.groups = groups;
        scratch.slots = slots;
        scratch.touching = touching;
    }
    if let Some(crossed) = crossed {
        let beside = (settled, crossed);
        resolve_crossed(&row, tile, runs, beside, nearest_only, &mut hidden_from, at, cache, scratch, hits);
    }
    for (lane, hits) in hits.iter_mut().enumerate() {
        if !scratch.tied[lane].is_empty() {
            let (px, camera) = (px_of(tile, at, lane), &tile.view.camera);
            tied::clusters(&mut scratch.tied[lane], |members| {
                hits.extend(tied::boundary(tile.model, camera, px, tile.anchor, members));
            });
        }
        finish_ray(hits, nearest_only);
    }
}

/// What is resolved of a leaf at a time.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Turn {
    Entering,
    Leaving,
    Mended,
}

/// Puts the crossings of all rays with `leaf` in turn ([`turns`]): takes those that are none out of `hits`, and adds the groups that
/// were dropped and are crossings to `groups`, each with the bit of its lane.
#[inline(always)]
#[allow(clippy::too_many_arguments)]
fn put_in_turn<S: Simd>(
    tile: &Tile<'_>,
    leaf: LeafId,
    nearest_only: bool,
    hidden_from: &mut f32x8<S>,
    at: At,
    cache: &mut SideCache,
    scratch: &mut Scratch<S>,
    hits: &mut [Vec<Hit>; LANES],
    groups: &mut Vec<(usize, u64)>,
) {
    let Scratch { crossings, dropped, mended, tied, .. } = scratch;
    for lane in 0..LANES {
        if crossings[lane].is_empty() || (turns::are_taken(&mut crossings[lane]) && dropped[lane].is_empty()) {
            continue;
        }
        let (ray, from) = (ray_of(tile, at, lane), (-tile.anchor) as f32);
        let field = &tile.model.fields[leaf.0 as usize];
        let holds = |t: f32| cache.inside(field, leaf, ray.at(tile.anchor + f64::from(t)));
        let is_hit = |hit: &Hit, t: f32| hit.leaf == leaf.0 && hit.t == t;
        let shows = |t: f32| {
            hits[lane].iter().any(|hit| is_hit(hit, t)) || tied[lane].iter().any(|hit| hit.leaf == leaf && hit.t == t)
        };
        turns::mend(&crossings[lane], &dropped[lane], from, holds, shows, mended);
        for t in &mended.stray {
            hits[lane].retain(|hit| !is_hit(hit, *t));
            tied[lane].retain(|hit| !(hit.leaf == leaf && hit.t == *t));
        }
        if nearest_only && !mended.stray.is_empty() {
            let opaque = hits[lane].iter().filter(|hit| hit.opacity >= 1.0).map(|hit| hit.t);
            hidden_from[lane] = opaque.fold(f32::INFINITY, f32::min);
        }
        groups.extend(mended.needed.iter().map(|&number| (number, 1 << lane)));
    }
}

#[inline(always)]
fn row_of<S: Simd>(simd: S, tile: &Tile<'_>, x0: u32, y: u32, offset: DVec2) -> Row<S> {
    let camera = &tile.view.camera;
    let x: [f32; LANES] = std::array::from_fn(|lane| (f64::from(x0) + lane as f64 + offset.x) as f32);
    let px = |lane: usize| f64::from(tile.rect.x0 + x0) + lane as f64 + offset.x - 0.5 * f64::from(camera.width);
    let py = f64::from(tile.rect.y0 + y) + offset.y - 0.5 * f64::from(camera.height);
    let (dir_x, dir_y): ([f32; LANES], f32) = match camera.projection {
        Projection::Perspective { focal_px } => {
            (std::array::from_fn(|lane| (px(lane) / focal_px) as f32), (py / focal_px) as f32)
        }
        Projection::Orthographic { .. } => ([0.0; LANES], 0.0),
    };
    let width = tile.rect.width();
    let live = (0..LANES as u32).filter(|lane| x0 + lane < width).fold(0_u64, |bits, lane| bits | 1 << lane);
    Row {
        simd,
        x: f32x8::load_array(simd, x),
        y: (f64::from(y) + offset.y) as f32,
        dir_x: f32x8::load_array(simd, dir_x),
        dir_y,
        live: mask32x8::from_bitmask(simd, live),
    }
}

/// The world-space ray of one lane.
pub(super) fn ray_of(tile: &Tile<'_>, at: At, lane: usize) -> Ray {
    tile.view.camera.ray(px_of(tile, at, lane))
}

/// Where on the picture it is.
fn px_of(tile: &Tile<'_>, at: At, lane: usize) -> DVec2 {
    DVec2::new(f64::from(tile.rect.x0 + at.0) + lane as f64 + at.2.x, f64::from(tile.rect.y0 + at.1) + at.2.y)
}

/// Candidates for one surface of a leaf.
struct Group<'s, S: Simd> {
    slot: &'s Slot<S>,
    /// Its place among those of the leaf.
    number: usize,
    /// The rays that are asked for.
    lanes: mask32x8<S>,
    /// Whether the rays are known to cross it.
    crosses: bool,
}

/// Solves one surface, clips it and keeps what is on the result.
#[inline(always)]
#[allow(clippy::too_many_arguments)]
fn resolve<S: Simd>(
    row: &Row<S>,
    tile: &Tile<'_>,
    runs: &[Run<'_>],
    crossed: Option<&Crossed<'_>>,
    run: &Run<'_>,
    touching: &[u32],
    Group { slot, number, lanes: wanted, crosses }: Group<'_, S>,
    nearest_only: bool,
    hidden_from: &mut f32x8<S>,
    at: At,
    cache: &mut SideCache,
    scratch: &mut Scratch<S>,
    hits: &mut [Vec<Hit>; LANES],
) {
    let field = &tile.model.fields[run.leaf.0 as usize];
    let best: [u32; LANES] = slot.best.into();
    let depth = if crosses { slot.best_depth } else { slot.depth() };
    let visible = wanted & slot.lanes & depth.simd_lt(*hidden_from);
    if visible.all_false() {
        return;
    }
    let class_of = |lane: usize| tile.surfels[best[lane] as usize].class;
    let index_of = |lane: usize| tile.surfels[best[lane] as usize].index as usize;
    // Step 1: where each ray meets the surface.
    let any_edge = (0..LANES).any(|lane| slot.lanes.test(lane) && class_of(lane).is_edge());
    let mut lanes = 0_u64;
    let t: [f32; LANES];
    let mut normals = [Vec3::ZERO; LANES];
    let mut colours = [[0.0_f32; 3]; LANES];
    let mut opacities = [1.0_f32; LANES];
    if let Some(exact) = &field.exact {
        let guess: [f32; LANES] = slot.depth().into();
        let mut depth = [f32::INFINITY; LANES];
        for lane in (0..LANES).filter(|&lane| visible.test(lane)) {
            let surfel = &tile.surfels[best[lane] as usize];
            let reach = f64::from(surfel.radius.max(surfel.reach)) * 2.0;
            let ray = ray_of(tile, at, lane);
            if let Some(hit) = exact.nearest_crossing(&ray, tile.anchor + f64::from(guess[lane]), reach, slot.front)
                && hit.t > 0.0
            {
                lanes |= 1 << lane;
                depth[lane] = (hit.t - tile.anchor) as f32;
                normals[lane] = tile.view.camera.rotate_to_view(hit.normal_in_world).as_vec3();
                colours[lane] = surfel.colour;
                opacities[lane] = surfel.opacity;
            }
        }
        t = depth;
    } else {
        let steps = if any_edge { EDGE_STEPS } else { 0 };
        let solution = rows::solve(row, &tile.surfels, touching, slot, visible, steps, crosses, &mut scratch.reaching);
        // In front of the eye, and not behind what is already certain to hide it.
        let ahead = solution.t.simd_gt((-tile.anchor) as f32);
        lanes = (solution.lanes & ahead).to_bitmask();
        t = solution.t.into();
        let [nx, ny, nz]: [[f32; LANES]; 3] = solution.normal.map(Into::into);
        let [r, g, b]: [[f32; LANES]; 3] = solution.colour.map(Into::into);
        let opacity: [f32; LANES] = solution.opacity.into();
        for lane in 0..LANES {
            normals[lane] = Vec3::new(nx[lane], ny[lane], nz[lane]).normalize_or_zero();
            colours[lane] = [r[lane], g[lane], b[lane]];
            opacities[lane] = opacity[lane];
            if solution.weightless.test(lane) {
                let surfel = &tile.surfels[best[lane] as usize];
                normals[lane] = Vec3::from_array(surfel.normal);
                colours[lane] = surfel.colour;
                opacities[lane] = surfel.opacity;
            }
        }
        if field.takes_turns() {
            let found = |lane: usize, t: f32| Found {
                t,
                enters: slot.front,
                radius: slot.best_radius[lane],
                steepness: normals[lane].dot(Vec3::new(row.dir_x[lane], row.dir_y, 1.0)).abs(),
            };
            for lane in (0..LANES).filter(|&l| lanes >> l & 1 == 1) {
                scratch.crossings[lane].push(found(lane, t[lane]));
            }
            let dropped = solution.dropped & slot.best_depth.simd_gt((-tile.anchor) as f32);
            for lane in (0..LANES).filter(|&l| dropped.test(l)) {
                let crossing = found(lane, slot.best_depth[lane]);
                scratch.dropped[lane].push(Dropped { crossing, weight: slot.best_weight(lane), slot: number });
            }
        }
    }
    if lanes == 0 {
        return;
    }
    let mut points = [DVec3::ZERO; LANES];
    // An exact surface may turn away from its samples (a step, a crease) and be met outside of the ball of the nearest one,
    // whose class then says nothing about the hit.
    let mut strayed = 0_u64;
    if any_edge || field.exact.is_some() {
        for lane in (0..LANES).filter(|&l| lanes >> l & 1 == 1) {
            points[lane] = ray_of(tile, at, lane).at(tile.anchor + f64::from(t[lane]));
            let surfel = &tile.surfels[best[lane] as usize];
            let distance = points[lane].distance(field.cloud.centre(surfel.index as usize));
            if field.exact.is_some() && distance > f64::from(surfel.radius) {
                strayed |= 1 << lane;
            }
        }
    }
    // Step 2: ask the residual of the nearest surfel, once for each residual that occurs.
    let mut crossings: [Option<(Crossing, u32)>; LANES] = [None; LANES];
    let in_world = |lane: usize| OnSurface {
        p_in_world: points[lane],
        normal_in_world: tile.view.normal_to_world(normals[lane]),
        radius: tile.surfels[best[lane] as usize].radius,
    };
    // A hit with whose surface another may coincide.
    let tied = |lane: usize| Tied {
        t: t[lane],
        reach: tied::reach(in_world(lane).radius, normals[lane], Vec3::new(row.dir_x[lane], row.dir_y, 1.0)),
        radius: in_world(lane).radius,
        leaf: run.leaf,
        enters: slot.front,
        normal: normals[lane],
        colour: colours[lane],
        opacity: snapped(opacities[lane]),
        is_drawn: true,
    };
    let mut pending = lanes;
    while pending != 0 {
        let first = pending.trailing_zeros() as usize;
        let drawn = class_of(first).drawn();
        let same = (0..LANES).filter(|&l| pending >> l & 1 == 1 && class_of(l).drawn() == drawn);
        let mask = same.fold(0_u64, |bits, lane| bits | 1 << lane);
        pending &= !mask;
        match drawn {
            None => {}
            Some(Drawn::Surface(crossing)) => {
                for lane in (0..LANES).filter(|&l| mask >> l & 1 == 1) {
                    if strayed >> lane & 1 == 1 {
                        match crossing_of_tree(tile, run.leaf, in_world(lane), &mut scratch.found) {
                            Ok(crossing) => crossings[lane] = crossing,
                            Err(IsTied) => scratch.tied[lane].push(tied(lane)),
                        }
                        continue;
                    }
                    let body = body_behind(tile.model, run.leaf, crossing, index_of(lane), |leaf| {
                        let p = ray_of(tile, at, lane).at(tile.anchor + f64::from(t[lane]));
                        tile.model.fields[leaf.0 as usize].contains(p, &mut scratch.found)
                    });
                    crossings[lane] = Some((crossing, body));
                }
            }
            Some(Drawn::Edge(_)) if mask & strayed != 0 => {
                // Rare enough to ask the whole tree for the others too.
                for lane in (0..LANES).filter(|&l| mask >> l & 1 == 1) {
                    match crossing_of_tree(tile, run.leaf, in_world(lane), &mut scratch.found) {
                        Ok(crossing) => crossings[lane] = crossing,
                        Err(IsTied) => scratch.tied[lane].push(tied(lane)),
                    }
                }
            }
            Some(Drawn::Edge(number)) => {
                if let Some(clipper) = &tile.clipper {
                    for lane in (0..LANES).filter(|&l| mask >> l & 1 == 1) {
                        let px = DVec2::new(f64::from(at.0) + lane as f64, f64::from(at.1)) + at.2;
                        let place = best[lane] as usize;
                        let crossing = clipper.crossing_on_ray(tile, run.leaf, place, px, t[lane], &mut scratch.clip);
                        crossings[lane] = crossing.map(|crossing| {
                            let body = body_behind(tile.model, run.leaf, crossing, index_of(lane), |leaf| {
                                let p = ray_of(tile, at, lane).at(tile.anchor + f64::from(t[lane]));
                                tile.model.fields[leaf.0 as usize].contains(p, &mut scratch.found)
                            });
                            (crossing, body)
                        });
                    }
                    continue;
                }
                let residual = &tile.model.classes[run.leaf.0 as usize].residuals[number as usize];
                // A leaf is asked for all rays at once, but only when the first of them needs its answer.
                let mut known = std::mem::take(&mut scratch.known);
                known.clear();
                known.resize(residual.near.len(), None);
                for lane in (0..LANES).filter(|&l| mask >> l & 1 == 1) {
                    let mut is_tied = false;
                    let crossing = residual.crossing(|place| {
                        let near = residual.near[place];
                        let told = *known[place].get_or_insert_with(|| {
                            let hits = Hits { t: &t, of_lane: &in_world, at, mask };
                            sides(row, tile, runs, crossed, near, hits, cache, scratch)
                        });
                        is_tied |= told.is_tied(lane);
                        told.is_inside(lane)
                    });
                    if is_tied {
                        scratch.tied[lane].push(tied(lane));
                        continue;
                    }
                    crossings[lane] = crossing.map(|crossing| {
                        let body = body_behind(tile.model, run.leaf, crossing, index_of(lane), |leaf| {
                            let place = residual.near.binary_search(&leaf).ok();
                            match place.and_then(|place| known[place]) {
                                Some(told) => told.is_inside(lane),
                                None => tile.model.fields[leaf.0 as usize].contains(points[lane], &mut scratch.found),
                            }
                        });
                        (crossing, body)
                    });
                }
                scratch.known = known;
            }
        }
    }
    // Step 3: keep what is on the result.
    let mut seen = f32x8::splat(row.simd, f32::INFINITY);
    for lane in (0..LANES).filter(|&l| lanes >> l & 1 == 1) {
        let Some((crossing, body)) = crossings[lane] else { continue };
        let sheet = field.kind == LeafKind::Sheet;
        let enters_result = sheet || (crossing == Crossing::Rises) == slot.front;
        let facing = if enters_result { Facing::Front } else { Facing::Back };
        let outward = if sheet { slot.front } else { crossing == Crossing::Rises };
        let normal = if outward { normals[lane] } else { -normals[lane] };
        let opacity = snapped(opacities[lane]);
        let hit = Hit { t: t[lane], normal, colour: colours[lane], opacity, leaf: run.leaf.0, body, facing };
        hits[lane].push(hit);
        if opacity >= 1.0 {
            seen[lane] = t[lane];
        }
    }
    if nearest_only {
        *hidden_from = hidden_from.min(seen);
    }
}

/// Adds what the rays see of the leaves that surfels do not find. The i-th peels of all rays that may be boundaries are
/// resolved together, so that a scan is asked for all of them at once.
#[inline(always)]
#[allow(clippy::too_many_arguments)]
fn resolve_crossed<S: Simd>(
    row: &Row<S>,
    tile: &Tile<'_>,
    runs: &[Run<'_>],
    (settled, crossed): (Option<&Settled>, &Crossed<'_>),
    nearest_only: bool,
    hidden_from: &mut f32x8<S>,
    at: At,
    cache: &mut SideCache,
    scratch: &mut Scratch<S>,
    hits: &mut [Vec<Hit>; LANES],
) {
    let place = |lane: usize| (at.0 + lane as u32, at.1);
    let mut walks = std::mem::take(&mut scratch.walks);
    let mut open = 0_u64;
    let is_known = |lane: usize| settled.is_some_and(|settled| settled.is_uncrossed(place(lane)));
    let is_wanted = |lane: usize| row.live.test(lane) && crossed.is_crossed(place(lane)) && !is_known(lane);
    for lane in (0..LANES).filter(|lane| is_wanted(*lane)) {
        crossed.begin(place(lane), &mut walks[lane]);
        open |= 1 << lane;
    }
    let mut hidden: [f32; LANES] = (*hidden_from).into();
    let mut known = std::mem::take(&mut scratch.known);
    while open != 0 {
        let mut peels: [Option<Peel<'_>>; LANES] = [None; LANES];
        let (mut t, mut of_peel) = ([f32::INFINITY; LANES], [OnSurface::default(); LANES]);
        let going = open;
        for lane in (0..LANES).filter(|lane| going >> lane & 1 == 1) {
            match crossed.next(&mut walks[lane]) {
                Some(peel) if !(nearest_only && peel.t >= hidden[lane]) => {
                    t[lane] = peel.t;
                    of_peel[lane] = OnSurface {
                        p_in_world: crossed.point(&walks[lane], &peel),
                        normal_in_world: peel.normal_in_world(),
                        radius: f32::INFINITY,
                    };
                    peels[lane] = Some(peel);
                }
                _ => open &= !(1 << lane),
            }
        }
        known.clear();
        known.resize(tile.model.fields.len(), None);
        let mask = open;
        for lane in (0..LANES).filter(|lane| mask >> lane & 1 == 1) {
            let Some(peel) = &peels[lane] else { continue };
            // The largest of the scans that coincide with the peel.
            let mut radius: Option<f32> = None;
            let hit = crossed.boundary(&mut walks[lane], peel, |leaf| {
                let told = *known[leaf.0 as usize].get_or_insert_with(|| {
                    let hits = Hits { t: &t, of_lane: &|lane| of_peel[lane], at, mask };
                    sides(row, tile, runs, None, leaf, hits, cache, scratch)
                });
                if told.is_tied(lane) {
                    let own = tile.model.fields[leaf.0 as usize].largest_radius();
                    radius = Some(radius.map_or(own, |other| other.max(own)));
                }
                told.is_inside(lane)
            });
            if let Some(radius) = radius {
                crossed.tie(&walks[lane], peel, radius, &mut scratch.tied[lane]);
                continue;
            }
            let Some(hit) = hit else { continue };
            if hit.opacity >= 1.0 {
                hidden[lane] = hidden[lane].min(hit.t);
                if nearest_only {
                    open &= !(1 << lane);
                }
            }
            hits[lane].push(hit);
        }
    }
    scratch.known = known;
    scratch.walks = walks;
    *hidden_from = f32x8::load_array(row.simd, hidden);
}

/// The surface of another leaf, on which the answer depends, coincides with that of the hit.
struct IsTied;

/// How the result changes where `own` is crossed at a point, by the whole expression, and whose material lies behind.
fn crossing_of_tree(
    tile: &Tile<'_>,
    own: LeafId,
    on_surface: OnSurface,
    found: &mut Vec<(u32, f32)>,
) -> Result<Option<(Crossing, u32)>, IsTied> {
    let model = tile.model;
    let field = |leaf: LeafId| &model.fields[leaf.0 as usize];
    let mut is_tied = false;
    let mut with_own = |inside_own: bool| {
        model.list.eval(|leaf| {
            if leaf == own {
                return inside_own;
            }
            is_tied |= on_surface.is_tied(field(leaf), found);
            field(leaf).contains(on_surface.p_in_world, found)
        })
    };
    let crossing = Crossing::between(with_own(false), with_own(true));
    if is_tied {
        return Err(IsTied);
    }
    Ok(crossing.map(|crossing| {
        let body = match crossing {
            Crossing::Rises => None,
            Crossing::Falls => body_at(model, own, |leaf| field(leaf).contains(on_surface.p_in_world, found)),
        };
        (crossing, body.unwrap_or(own).0)
    }))
}

/// An opacity that is a weighted mean, held to 0 to 1, and opaque where only rounding keeps it from being so.
fn snapped(opacity: f32) -> f32 {
    if opacity > 1.0 - OPACITY_ROUNDING { 1.0 } else { opacity.max(0.0) }
}
