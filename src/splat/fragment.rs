//! Clipping fragments, as in the paper: the boundaries of the result for the pixels of one block, from flat disks.
//!
//! # Theory
//! Wicke 2004 §3.3, §4.2: each surfel is rasterised as an ellipse ([`super::ewa`]); each fragment's object-space point is
//! tested against the surfel's clipping partners and the tree ([`super::clip`]); what is left of a surface is blended by
//! EWA weight, and of overlapping surfaces the nearest is seen, with a tolerance in depth.
//!
//! # Changes from the paper
//! The paper keeps one visible surface a pixel. Here fragments, front to back, are grouped into surfaces by leaf,
//! facing and the side on which the result lies; a surface is open up to t + ε behind its first fragment, a fragment within
//! joins it and extends it to t + ε/2, with ε from the surfel's radius and slant. So all layers are found, not the nearest
//! alone, and where only the nearest is wanted the test stops at the first opaque surface that no fragment can join any
//! more: fragments behind it are never tested.
//!
//! # Practice
//! Scalar code: a surfel visits only the pixels of its own bounds. Fragments of equal depth are ordered by their place in
//! the tile, so pictures do not depend on threads.

use glam::{DVec2, Vec2, Vec3};

use super::body::body_behind;
use super::clip::{ClipScratch, Clipper};
use super::ewa::{self, Splat};
use super::hits::{BlockHits, Hit, finish_ray};
use super::surface::{self, Run, Tile};
use crate::classify::Drawn;
use crate::csg::LeafId;
use crate::csg::residual::Crossing;
use crate::layers::{Facing, LayerLimit};
use crate::scene::LeafKind;

/// A surface's fragments at one pixel lie within this many reaches of each other: the centres are at most a drawn radius ρ
/// from the pixel on either side, so their depths differ by at most 2 ρ tan θ, and a reach is at least ½ ρ tan θ.
pub(crate) const REACHES_OF_A_SURFACE: f32 = 4.0;

/// A fragment in its pixel's list.
#[derive(Debug, Clone, Copy)]
struct Listed {
    t: f32,
    weight: f32,
    e: Vec3,
    /// Place in [`Tile::surfels`].
    surfel: u32,
    leaf: LeafId,
    /// Whether the ray enters the leaf.
    front: bool,
}

/// Fragments that form one surface.
#[derive(Debug, Clone, Copy)]
struct Surface {
    leaf: LeafId,
    front: bool,
    crossing: Crossing,
    /// Fragments up to here join.
    open_to: f32,
    weight: f32,
    /// Sums, weighted.
    depth: f32,
    normal: Vec3,
    colour: Vec3,
    opacity: f32,
    /// The heaviest fragment's weight and surfel.
    heaviest: (f32, u32),
}

impl Surface {
    fn mean_depth(&self) -> f32 {
        self.depth / self.weight
    }

    fn is_opaque(&self) -> bool {
        self.opacity >= self.weight
    }
}

/// Reused between blocks.
#[derive(Default)]
pub struct FragmentScratch {
    pixels: Vec<Vec<Listed>>,
    surfaces: Vec<Surface>,
    clip: ClipScratch,
    found: Vec<(u32, f32)>,
    hits: Vec<Hit>,
}

/// Traces one block of `side` × `side` pixels with its corner at `corner` (tile-relative), at sub-pixel `offset`. Appends
/// each pixel's hits to `hits`, front to back, and their end to `ends`, pixels row by row.
#[allow(clippy::too_many_arguments)]
pub fn trace_block(
    tile: &Tile<'_>,
    clipper: &Clipper<'_>,
    splats: &[Splat],
    runs: &[Run<'_>],
    (corner, side, offset): ((u32, u32), u32, DVec2),
    scratch: &mut FragmentScratch,
    out: &mut BlockHits,
) {
    scratch.pixels.resize_with((side * side) as usize, Vec::new);
    scratch.pixels.iter_mut().for_each(Vec::clear);
    rasterise(tile, splats, runs, corner, side, offset, &mut scratch.pixels);
    let mut pixels = std::mem::take(&mut scratch.pixels);
    for (pixel, fragments) in pixels.iter_mut().enumerate() {
        let at = (corner.0 + pixel as u32 % side, corner.1 + pixel as u32 / side);
        if !fragments.is_empty() {
            fragments.sort_unstable_by(|a, b| a.t.total_cmp(&b.t).then(a.surfel.cmp(&b.surfel)));
            resolve(tile, clipper, splats, fragments, (at.0, at.1, offset), scratch);
            finish_ray(&mut scratch.hits, tile.limit == LayerLimit::Nearest);
        }
        out.push(&scratch.hits);
        scratch.hits.clear();
    }
    scratch.pixels = pixels;
}

/// The pixel columns (or rows) `first..end` whose sample may lie between `low` and `high`.
fn span(low: f32, high: f32, first: u32, end: u32, offset: f32) -> std::ops::Range<u32> {
    // Casts saturate: bounds beyond the block become its border, and NaN an empty range.
    let from = (low - offset).ceil().max(0.0) as u32;
    let to = (high - offset + 1.0).floor().max(0.0) as u32;
    from.max(first)..to.min(end)
}

/// Lists the fragments of every drawn surfel at every pixel of the block; where only the nearest opaque surface is wanted,
/// not those that a whole surface fragment is certain to hide.
fn rasterise(
    tile: &Tile<'_>,
    splats: &[Splat],
    runs: &[Run<'_>],
    corner: (u32, u32),
    side: u32,
    offset: DVec2,
    pixels: &mut [Vec<Listed>],
) {
    let end = ((corner.0 + side).min(tile.rect.width()), (corner.1 + side).min(tile.rect.height()));
    let eye = -tile.anchor as f32;
    let nearest_only = tile.limit == LayerLimit::Nearest;
    let offset32 = offset.as_vec2();
    let directions: Vec<Vec2> = (0..side * side)
        .map(|p| {
            let px = DVec2::new(f64::from(corner.0 + p % side), f64::from(corner.1 + p / side)) + offset;
            ewa::direction(tile.view, tile.rect, px)
        })
        .collect();
    // From which depth on each pixel is hidden, and the block.
    let mut hidden_from = vec![f32::INFINITY; directions.len()];
    let inside = |p: &usize| corner.0 + *p as u32 % side < end.0 && corner.1 + *p as u32 / side < end.1;
    let mut farthest = f32::INFINITY;
    for run in runs {
        for &member in run.members {
            let s = &tile.surfels[member as usize];
            if s.class.drawn().is_none() || s.near > farthest {
                continue;
            }
            let splat = &splats[member as usize];
            let n = Vec3::from(s.normal);
            let hides = nearest_only && !s.class.is_edge() && s.opacity >= 1.0;
            let mut hid_more = false;
            for y in span(s.top - ewa::REACH_PX, s.bottom + ewa::REACH_PX, corner.1, end.1, offset32.y) {
                let Some((left, right)) = splat.columns(s, y as f32 + offset32.y) else { continue };
                for x in span(left, right, corner.0, end.0, offset32.x) {
                    let pixel = ((y - corner.1) * side + (x - corner.0)) as usize;
                    let direction = directions[pixel];
                    let Some(f) = splat.at(s, Vec2::new(x as f32, y as f32) + offset32, direction) else { continue };
                    if !(f.t > eye && f.t <= hidden_from[pixel]) {
                        continue;
                    }
                    let front = n.dot(direction.extend(1.0)) < 0.0;
                    pixels[pixel].push(Listed {
                        t: f.t,
                        weight: f.weight,
                        e: f.e,
                        surfel: member,
                        leaf: run.leaf,
                        front,
                    });
                    if hides {
                        hidden_from[pixel] = hidden_from[pixel].min(f.t + REACHES_OF_A_SURFACE * splat.reach);
                        hid_more = true;
                    }
                }
            }
            if hid_more {
                farthest = (0..hidden_from.len()).filter(inside).map(|p| hidden_from[p]).fold(0.0, f32::max);
            }
        }
    }
}

/// Clips and groups one pixel's fragments, front to back, and keeps the surfaces as hits in `scratch`.
fn resolve(
    tile: &Tile<'_>,
    clipper: &Clipper<'_>,
    splats: &[Splat],
    fragments: &[Listed],
    at: (u32, u32, DVec2),
    scratch: &mut FragmentScratch,
) {
    let nearest_only = tile.limit == LayerLimit::Nearest;
    let surfaces = &mut scratch.surfaces;
    surfaces.clear();
    for f in fragments {
        if nearest_only && is_hidden(surfaces, f.t) {
            break;
        }
        let s = &tile.surfels[f.surfel as usize];
        let crossing = match s.class.drawn() {
            None => None,
            Some(Drawn::Surface(crossing)) => Some(crossing),
            Some(Drawn::Edge(_)) => clipper.crossing(tile.view, f.leaf, f.surfel as usize, s, f.e, &mut scratch.clip),
        };
        let Some(crossing) = crossing else { continue };
        let reach = splats[f.surfel as usize].reach;
        // The latest such surface is the farthest: earlier ones were left behind.
        let joined = surfaces
            .iter_mut()
            .rev()
            .find(|g| (g.leaf, g.front, g.crossing) == (f.leaf, f.front, crossing) && f.t <= g.open_to);
        let group = match joined {
            Some(group) => {
                group.open_to = group.open_to.max(f.t + 0.5 * reach);
                group
            }
            None => {
                surfaces.push(Surface {
                    leaf: f.leaf,
                    front: f.front,
                    crossing,
                    open_to: f.t + reach,
                    weight: 0.0,
                    depth: 0.0,
                    normal: Vec3::ZERO,
                    colour: Vec3::ZERO,
                    opacity: 0.0,
                    heaviest: (0.0, f.surfel),
                });
                surfaces.last_mut().expect("one was just added")
            }
        };
        group.weight += f.weight;
        group.depth += f.weight * f.t;
        group.normal += f.weight * Vec3::from(s.normal);
        group.colour += f.weight * Vec3::from(s.colour);
        group.opacity += f.weight * s.opacity;
        if f.weight > group.heaviest.0 {
            group.heaviest = (f.weight, f.surfel);
        }
    }
    for g in surfaces.iter() {
        let sheet = tile.model.fields[g.leaf.0 as usize].kind == LeafKind::Sheet;
        let enters_result = sheet || (g.crossing == Crossing::Rises) == g.front;
        let outward = if sheet { g.front } else { g.crossing == Crossing::Rises };
        let normal = g.normal.normalize_or_zero();
        let share = 1.0 / g.weight;
        let t = g.mean_depth();
        let index = tile.surfels[g.heaviest.1 as usize].index as usize;
        let body = body_behind(tile.model, g.leaf, g.crossing, index, |leaf| {
            let p = surface::ray_of(tile, at, 0).at(tile.anchor + f64::from(t));
            tile.model.fields[leaf.0 as usize].contains(p, &mut scratch.found)
        });
        scratch.hits.push(Hit {
            t,
            normal: if outward { normal } else { -normal },
            colour: (g.colour * share).to_array(),
            // A mean of ones must be one, whatever its rounding.
            opacity: if g.is_opaque() { 1.0 } else { (g.opacity * share).clamp(0.0, 1.0) },
            leaf: g.leaf.0,
            body,
            facing: if enters_result { Facing::Front } else { Facing::Back },
        });
    }
}

/// Whether nothing at depth `t` or behind can be seen: an opaque surface is complete, and none that is not is before it.
fn is_hidden(surfaces: &[Surface], t: f32) -> bool {
    let complete = |g: &&Surface| g.open_to < t && g.is_opaque();
    let Some(hiding) = surfaces.iter().filter(complete).map(Surface::mean_depth).min_by(f32::total_cmp) else {
        return false;
    };
    surfaces.iter().all(|g| g.open_to < t || g.mean_depth() > hiding)
}
