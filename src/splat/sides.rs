//! On which side of other leaves the points of a row's hits lie.
//!
//! # Theory
//! A side is the sign of the leaf's field where surfels reach the point, and else its winding number, or the nearest surfel's
//! plane (DESIGN §3.6). Where the other leaf's own surface is at the hit it has no side but is *tied* (`super::tied`).
//!
//! # Practice
//! A leaf is asked for all rays of a row at once. Where no surfel of it reaches the hit, its side is looked up in object space, and
//! one answer serves all rays that lie closer to it than the surface can ([`SideCache`]).

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x8, mask32x8};
use glam::{DVec3, Vec3};

use super::crossed::Crossed;
use super::rows::{self, LANES, Row};
use super::surface::{At, Run, Scratch, Tile};
use super::tied;
use crate::classify::LeafField;
use crate::csg::LeafId;

/// What a leaf tells of the points of a row's rays: a bit for each lane.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Told {
    /// The point is inside.
    pub inside: u64,
    /// The leaf's surface coincides with the one that the point is on.
    pub tied: u64,
}

impl Told {
    pub fn is_inside(self, lane: usize) -> bool {
        self.inside >> lane & 1 == 1
    }

    pub fn is_tied(self, lane: usize) -> bool {
        self.tied >> lane & 1 == 1
    }
}

/// Answers that a [`SideCache`] remembers for each leaf: two rows of a block, so that a row finds those of the one above.
const REMEMBERED: usize = 2 * LANES;

/// The side of points that no surfel of a leaf reaches, remembered by leaf: an answer holds around the point that it was
/// given for as far as [`LeafField::far_side`] says.
pub struct SideCache {
    answers: Vec<Vec<Side>>,
    /// The answer to forget next, by leaf.
    oldest: Vec<usize>,
}

/// A remembered answer.
#[derive(Clone, Copy)]
struct Side {
    p_in_world: DVec3,
    clearance_squared: f64,
    inside: bool,
}

impl SideCache {
    /// For a scene of `leaves` leaves.
    pub fn new(leaves: usize) -> Self {
        Self { answers: vec![Vec::new(); leaves], oldest: vec![0; leaves] }
    }

    /// Whether `p_in_world`, which no surfel of `leaf` reaches, is inside it.
    pub fn inside(&mut self, field: &LeafField, leaf: LeafId, p_in_world: DVec3) -> bool {
        self.remembered(leaf, p_in_world).unwrap_or_else(|| self.asked(field, leaf, p_in_world).0)
    }

    /// Whether `p_in_world` is inside `leaf`, where that holds all around it; `None` near the leaf's surface, and where its side
    /// is not steady. Without `searches` only what is remembered counts.
    pub fn steady(&mut self, field: &LeafField, leaf: LeafId, p_in_world: DVec3, searches: bool) -> Option<bool> {
        if let Some(known) = self.remembered(leaf, p_in_world) {
            return Some(known);
        }
        if !searches || !field.has_steady_sides() || field.reaches(p_in_world, 0.0) {
            return None;
        }
        let (inside, is_steady) = self.asked(field, leaf, p_in_world);
        is_steady.then_some(inside)
    }

    fn remembered(&self, leaf: LeafId, p_in_world: DVec3) -> Option<bool> {
        let holds = |side: &&Side| p_in_world.distance_squared(side.p_in_world) < side.clearance_squared;
        self.answers[leaf.0 as usize].iter().find(holds).map(|side| side.inside)
    }

    /// The side of `p_in_world`, and whether it is steady and so remembered.
    fn asked(&mut self, field: &LeafField, leaf: LeafId, p_in_world: DVec3) -> (bool, bool) {
        let answers = &mut self.answers[leaf.0 as usize];
        let side = field.far_side(p_in_world);
        let clearance = field.steady_distance(&side, p_in_world);
        if !(clearance > 0.0) {
            return (side.inside, false);
        }
        let answer = Side { p_in_world, clearance_squared: clearance * clearance, inside: side.inside };
        let oldest = &mut self.oldest[leaf.0 as usize];
        match answers.get_mut(*oldest) {
            Some(place) => *place = answer,
            None => answers.push(answer),
        }
        *oldest = (*oldest + 1) % REMEMBERED;
        (side.inside, true)
    }
}

/// A point on a surface.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct OnSurface {
    pub p_in_world: DVec3,
    /// Unit normal, either way.
    pub normal_in_world: Vec3,
    /// Of the surfel there, world units; infinite where there is none.
    pub radius: f32,
}

impl OnSurface {
    /// Whether the surface of `field` coincides with this one.
    pub fn is_tied(&self, field: &LeafField, found: &mut Vec<(u32, f32)>) -> bool {
        let Self { p_in_world, normal_in_world, radius } = *self;
        tied::coincident(field, p_in_world, normal_in_world.as_dvec3(), radius, found).is_some()
    }
}

/// Points on surfaces, one for each lane of `mask`.
pub(super) struct Hits<'h> {
    /// Depths less the tile's anchor.
    pub t: &'h [f32; LANES],
    /// The point of a lane.
    pub of_lane: &'h dyn Fn(usize) -> OnSurface,
    /// Where the row is traced.
    pub at: At,
    /// The lanes.
    pub mask: u64,
}

/// What leaf `near` tells of the points of `hits`.
#[inline(always)]
#[allow(clippy::too_many_arguments)]
pub(super) fn sides<S: Simd>(
    row: &Row<S>,
    tile: &Tile<'_>,
    runs: &[Run<'_>],
    crossed: Option<&Crossed<'_>>,
    near: LeafId,
    hits: Hits<'_>,
    cache: &mut SideCache,
    scratch: &mut Scratch<S>,
) -> Told {
    let field = &tile.model.fields[near.0 as usize];
    let Hits { t, of_lane, at, mask } = hits;
    let mut is_tied = |lane: &usize| of_lane(*lane).is_tied(field, &mut scratch.found);
    let bits = |bits: u64, lane: usize| bits | 1 << lane;
    if let Some(exact) = &field.exact {
        // On a ray whose crossings with the leaf are known they tell the side.
        let place = |lane: usize| (at.0 + lane as u32, at.1);
        let told = |lane: usize| crossed.and_then(|crossed| crossed.inside(place(lane), near, t[lane]));
        let inside = |lane: &usize| told(*lane).unwrap_or_else(|| exact.contains(of_lane(*lane).p_in_world));
        // Most rays cross the leaf elsewhere, and need no closer look.
        let may_tie = |lane: &usize| {
            let within = tied::MOST_REACH_IN_RADII * of_lane(*lane).radius;
            crossed.is_none_or(|crossed| crossed.may_cross_within(place(*lane), near, t[*lane], within))
        };
        let lanes = || (0..LANES).filter(|l| mask >> l & 1 == 1);
        let tied = lanes().filter(may_tie).filter(&mut is_tied).fold(0, bits);
        return Told { inside: lanes().filter(inside).fold(0, bits), tied };
    }
    let lanes = mask32x8::from_bitmask(row.simd, mask);
    let (mut told, mut reached) = (Told::default(), 0);
    if let Some(run) = runs.iter().find(|r| r.leaf == near) {
        let depth = f32x8::load_array(row.simd, *t);
        let touching = &mut scratch.reaching;
        touching.clear();
        rows::touching(row, &tile.spans, run.members, row.span(depth, lanes), touching);
        let (value, weight) = rows::ask(row, &tile.surfels, touching, depth, lanes);
        let support = lanes & weight.simd_gt(rows::LEAST_WEIGHT);
        reached = support.to_bitmask();
        told.inside = (support & value.simd_lt(0.0)).to_bitmask();
        // Most rays are not near the other surface, and need no closer look.
        let radii: [f32; LANES] =
            std::array::from_fn(|lane| if mask >> lane & 1 == 1 { of_lane(lane).radius } else { 0.0 });
        let within = f32x8::load_array(row.simd, radii).min(field.largest_radius()) * tied::TIED_SHARE;
        let close = (support & value.abs().simd_le(weight * within)).to_bitmask();
        if close != 0 {
            told.tied = (0..LANES).filter(|l| close >> l & 1 == 1).filter(&mut is_tied).fold(0, bits);
        }
    }
    let mut unreached = mask & !reached;
    while unreached != 0 {
        let lane = unreached.trailing_zeros() as usize;
        unreached &= unreached - 1;
        told.inside |= u64::from(cache.inside(field, near, of_lane(lane).p_in_world)) << lane;
    }
    told
}
