//! Clipping fragments, as in the paper: the boundaries of the result for the pixels of one block, from flat disks.
//!
//! # Theory
//! Wicke 2004 §3.3, §4.2: each surfel is rasterised as an ellipse ([`super::ewa`]); each fragment's object-space point is
//! tested against the surfel's clipping partners and the tree ([`super::clip`]); what is left of a surface is blended by
//! EWA weight, and of overlapping surfaces the nearest is seen, with a tolerance in depth.
//!
//! # Changes from the paper
//! The paper keeps one visible surface a pixel. DESIGN §3.7: fragments, front to back, are grouped into surfaces by leaf,
//! facing and the side on which the result lies; a surface is open up to t + ε behind its first fragment, a fragment within
//! joins it and extends it to t + ε/2, with ε from the surfel's radius and slant. So all layers are found, not the nearest
//! alone, and where only the nearest is wanted the test stops at the first opaque surface that no fragment can join any
//! more: fragments behind it are never tested.
//!
//! # Practice
//! Scalar code: a surfel visits only the pixels of its own bounds. Fragments of equal depth are ordered by their place in
//! the tile, so pictures do not depend on threads.

use glam::{DVec2, Vec2, Vec3};

use super::clip::{ClipScratch, Clipper};
use super::ewa::{self, Splat};
use super::surface::{self, Hit, Run, Tile};
use crate::classify::Drawn;
use crate::csg::LeafId;
use crate::csg::residual::Crossing;
use crate::layers::{Facing, LayerLimit};
use crate::scene::LeafKind;

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
    corner: (u32, u32),
    side: u32,
    offset: DVec2,
    scratch: &mut FragmentScratch,
    hits: &mut Vec<Hit>,
    ends: &mut Vec<u32>,
) {
    scratch.pixels.resize_with((side * side) as usize, Vec::new);
    scratch.pixels.iter_mut().for_each(Vec::clear);
    rasterise(tile, splats, runs, corner, side, offset, &mut scratch.pixels);
    let mut pixels = std::mem::take(&mut scratch.pixels);
    for (pixel, fragments) in pixels.iter_mut().enumerate() {
        let at = (corner.0 + pixel as u32 % side, corner.1 + pixel as u32 / side);
        if !fragments.is_empty() {
            fragments.sort_unstable_by(|a, b| a.t.total_cmp(&b.t).then(a.surfel.cmp(&b.surfel)));
            resolve(tile, clipper, fragments, (at.0, at.1, offset), scratch);
            surface::finish_lane(&mut scratch.hits, tile.limit == LayerLimit::Nearest);
            hits.append(&mut scratch.hits);
        }
        ends.push(hits.len() as u32);
    }
    scratch.pixels = pixels;
}

/// The pixel columns (or rows) of a block whose sample may lie between `low` and `high`.
fn span(low: f32, high: f32, first: u32, end: u32, offset: f64) -> std::ops::Range<u32> {
    let offset = offset as f32;
    // Casts saturate: bounds beyond the block become its border, and NaN an empty range.
    let from = (low - ewa::REACH_PX - offset).ceil().max(0.0) as u32;
    let to = (high + ewa::REACH_PX - offset + 1.0).floor().max(0.0) as u32;
    from.max(first)..to.min(end)
}

/// Lists the fragments of every drawn surfel at every pixel of the block.
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
    let position = |x: u32, y: u32| DVec2::new(f64::from(x), f64::from(y)) + offset;
    let directions: Vec<Vec2> = (0..side * side)
        .map(|p| ewa::direction(tile.view, tile.rect, position(corner.0 + p % side, corner.1 + p / side)))
        .collect();
    for run in runs {
        for &member in run.members {
            let s = &tile.surfels[member as usize];
            if s.class.drawn().is_none() {
                continue;
            }
            let splat = &splats[member as usize];
            let n = Vec3::from(s.normal);
            for y in span(s.top, s.bottom, corner.1, end.1, offset.y) {
                for x in span(s.left, s.right, corner.0, end.0, offset.x) {
                    let pixel = ((y - corner.1) * side + (x - corner.0)) as usize;
                    let direction = directions[pixel];
                    let Some(f) = splat.at(s, position(x, y).as_vec2(), direction) else { continue };
                    if f.t > eye {
                        let front = n.dot(Vec3::new(direction.x, direction.y, 1.0)) < 0.0;
                        pixels[pixel].push(Listed {
                            t: f.t,
                            weight: f.weight,
                            e: f.e,
                            surfel: member,
                            leaf: run.leaf,
                            front,
                        });
                    }
                }
            }
        }
    }
}

/// Clips and groups one pixel's fragments, front to back, and keeps the surfaces as hits in `scratch`.
fn resolve(
    tile: &Tile<'_>,
    clipper: &Clipper<'_>,
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
        // The latest such surface is the farthest: earlier ones were left behind.
        let joined = surfaces
            .iter_mut()
            .rev()
            .find(|g| (g.leaf, g.front, g.crossing) == (f.leaf, f.front, crossing) && f.t <= g.open_to);
        let group = match joined {
            Some(group) => {
                group.open_to = group.open_to.max(f.t + 0.5 * s.reach);
                group
            }
            None => {
                surfaces.push(Surface {
                    leaf: f.leaf,
                    front: f.front,
                    crossing,
                    open_to: f.t + s.reach,
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
        let body = surface::body_behind(tile, g.leaf, g.crossing, index, |leaf| {
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
