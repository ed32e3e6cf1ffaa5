//! The clip buffer: clipping partners found in the picture, anew for every view.
//!
//! # Theory
//! Wicke 2004 §3.2, function `addFragment`: edge surfels are splatted into a buffer the size of the picture whose cells
//! list the surfels that cover them; two of different patches in one cell are partners where they are close enough
//! ([`crate::classify::partners`]). §4.2: none may be missed, so a splat that is close to singular is drawn as a thick line.
//!
//! # Changes from the paper
//! * The footprint is the one that fragments are drawn with, never less than 4 px across ([`super::ewa`]): it is the thick
//!   line, and there is no threshold at which a splat turns into one.
//! * With all surfels of near leaves as partners, those are splatted too, drawn or not.
//! * A row of a tile is a word with a bit for each cell, so one `&` tells whether two surfels share any cell of a row, and
//!   a pair that shares several is tested once a tile.
//!
//! # Practice
//! Memory is one tile's masks a thread and the pairs found: no list has a longest length.

use super::ewa::{self, Splat};
use super::project::ViewSurfel;
use super::surface::Tile;
use crate::classify::Class;
use crate::classify::partners::{self, Among, SurfelId};
use crate::csg::LeafId;

/// Cells a row: a tile's pixels across at most.
type Mask = u64;

/// A surfel's cells in one row.
#[derive(Debug, Clone, Copy)]
struct Covering {
    /// Among the tile's candidates.
    candidate: u32,
    cells: Mask,
}

/// Whether surfels of this class clip or may be clipped.
pub fn takes_part(class: Class, among: Among) -> bool {
    class.is_edge() || (among == Among::NearLeaves && class.is_partner())
}

/// The partners that meet in the cells of one tile, as pairs (edge surfel, partner), each once. `leaves` are the runs of
/// one leaf in the tile's surfels.
///
/// The tile must be at most 64 pixels wide.
pub fn pairs_of_tile(
    tile: &Tile<'_>,
    leaves: &[(LeafId, std::ops::Range<usize>)],
    among: Among,
) -> Vec<(SurfelId, SurfelId)> {
    debug_assert!(tile.rect.width() <= Mask::BITS);
    let corner = (tile.rect.x0, tile.rect.y0);
    // Step 1: who may clip or be clipped.
    let mut candidates: Vec<(SurfelId, &ViewSurfel)> = Vec::new();
    for (leaf, range) in leaves {
        for s in &tile.surfels[range.clone()] {
            if takes_part(s.class, among) {
                candidates.push((SurfelId { leaf: *leaf, index: s.index }, s));
            }
        }
    }
    // Step 2: splat them. Rows list candidates in order; `places` keeps where in its rows each candidate stands.
    let mut rows: Vec<Vec<Covering>> = vec![Vec::new(); tile.rect.height() as usize];
    let mut places: Vec<(u32, u32)> = Vec::new();
    let mut starts = Vec::with_capacity(candidates.len() + 1);
    for (number, (_, s)) in candidates.iter().enumerate() {
        starts.push(places.len());
        let splat = Splat::of(s, tile.view, corner, tile.anchor);
        for y in cells(s.top - ewa::REACH_PX, s.bottom + ewa::REACH_PX, tile.rect.height()) {
            let Some((left, right)) = splat.columns(s, y as f32 + 0.5) else { continue };
            let columns = cells(left, right, tile.rect.width());
            if !columns.is_empty() {
                // The cells from the first one on, less those from the end on.
                let from = |column: u32| if column < Mask::BITS { Mask::MAX << column } else { 0 };
                let mask = from(columns.start) & !from(columns.end);
                let row = &mut rows[y as usize];
                places.push((y, row.len() as u32));
                row.push(Covering { candidate: number as u32, cells: mask });
            }
        }
    }
    starts.push(places.len());
    // Step 3: each candidate with those before it that share a cell, once: `last` is whom a candidate was tested with last.
    let mut last = vec![u32::MAX; candidates.len()];
    let mut pairs = Vec::new();
    for (number, &(id_a, a)) in candidates.iter().enumerate() {
        for &(y, place) in &places[starts[number]..starts[number + 1]] {
            let (before, from) = rows[y as usize].split_at(place as usize);
            for covering in before {
                let other = covering.candidate as usize;
                if covering.cells & from[0].cells == 0 || last[other] == number as u32 {
                    continue;
                }
                last[other] = number as u32;
                let (id_b, b) = candidates[other];
                let may_clip = id_a.leaf != id_b.leaf && (a.class.is_edge() || b.class.is_edge());
                if !may_clip || !are_close(tile, id_a, id_b, a.radius + b.radius) {
                    continue;
                }
                for (s, t) in [(id_a, id_b), (id_b, id_a)] {
                    if partners::admits(tile.model, among, s, t) {
                        pairs.push((s, t));
                    }
                }
            }
        }
    }
    pairs
}

/// Whether two surfels' centres are nearer than `reach`.
fn are_close(tile: &Tile<'_>, a: SurfelId, b: SurfelId, reach: f32) -> bool {
    let centre = |s: SurfelId| tile.model.fields[s.leaf.0 as usize].cloud.centre(s.index as usize);
    (centre(a) - centre(b)).as_vec3().length() < reach
}

/// The cells of a row or column of `count` whose centres may lie in a splat with these bounds.
fn cells(low: f32, high: f32, count: u32) -> std::ops::Range<u32> {
    let from = (low - 0.5).ceil().max(0.0) as u32;
    let to = (high + 0.5).floor().max(0.0) as u32;
    from..to.min(count)
}
