//! Which surfels touch which tile of the picture, and which block of a tile.
//!
//! # Practice
//! Binning looks only at support balls; a tile computes the rest of a surfel's view when it is drawn, so that memory is
//! eight bytes a surfel and tile, not a hundred and fifty. A chunk that lies within one tile is binned as a whole.
//! Surfels that can only be the *far* side of the result are listed apart, with the nearest depth among them: where a tile
//! is covered in front of that, they are not looked at again.

use std::borrow::Cow;
use std::ops::Range;

use glam::DVec3;
use rayon::prelude::*;

use super::project::{Bounds, Sight, View, ViewSurfel};
use super::rows::LANES;
use crate::classify::{Class, Drawn, LeafField, Model};
use crate::csg::LeafId;
use crate::csg::residual::Crossing;
use crate::layers::{Boundary, LayerTile, TILE_SIDE};
use crate::scene::LeafKind;
use crate::space::PixelRect;
use crate::surfel::CHUNK;

/// Blocks are this many pixels a side: a row of lanes wide.
pub const BLOCK: u32 = LANES as u32;

/// A surfel in a tile's list.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Member {
    /// Its leaf.
    pub leaf: u32,
    /// Its index in the leaf.
    pub index: u32,
}

/// Whether all that a surfel of `field` shows is a boundary where rays *leave* the result.
fn shows_far_side(field: &LeafField, class: Class, sight: &Sight) -> bool {
    field.kind == LeafKind::Solid
        && match class.drawn() {
            Some(Drawn::Surface(Crossing::Rises)) => !sight.may_enter(),
            Some(Drawn::Surface(Crossing::Falls)) => !sight.may_leave(),
            _ => false,
        }
}

/// The surfels of every tile.
#[derive(Debug)]
pub struct Bins {
    across: u32,
    /// Where the near and then the far members of each tile start; one more than twice the tiles.
    starts: Vec<u32>,
    members: Vec<Member>,
    /// By tile: the nearest view depth of its far members' balls.
    far_from: Vec<f64>,
}

/// The surfels that may touch a rectangle, each once, by leaf and index.
#[derive(Debug)]
pub struct Members<'a> {
    /// All others.
    pub near: Cow<'a, [Member]>,
    /// Those that can only be the far side of the result.
    pub far: Cow<'a, [Member]>,
    /// The nearest view depth of the far members' balls; infinite without any.
    pub far_from: f64,
}

impl Members<'_> {
    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.near.is_empty() && self.far.is_empty()
    }

    /// All of them, by leaf.
    pub fn all(&self) -> Vec<Member> {
        let mut all = [&self.near[..], &self.far[..]].concat();
        all.sort_by_key(|m| m.leaf); // stable, and two runs merge in one pass
        all
    }
}

/// One surfel's place: a list of a tile (twice the tile, and one more for far members), the member and its nearest depth.
type Entry = (u32, Member, f32);

impl Bins {
    /// Bins the needed surfels of `model`, each up to `margin_px` outside of its ball.
    pub fn new(model: &Model, view: &View, margin_px: f32) -> Self {
        let across = view.camera.width.div_ceil(TILE_SIDE);
        let down = view.camera.height.div_ceil(TILE_SIDE);
        // Step 1: each chunk's surfels by tile, in order.
        let chunks: Vec<(u32, u32)> = (0..model.fields.len())
            .flat_map(|leaf| (0..model.fields[leaf].cloud.chunks.len()).map(move |c| (leaf as u32, c as u32)))
            .collect();
        const CHUNKS_A_TASK: usize = 64;
        let binned: Vec<Vec<Entry>> = chunks
            .par_chunks(CHUNKS_A_TASK)
            .map(|task| {
                let mut entries = Vec::with_capacity(task.len() * CHUNK);
                for &(leaf, chunk) in task {
                    bin_chunk(model, view, (leaf, chunk as usize), (across, down), margin_px, &mut entries);
                }
                entries
            })
            .collect();
        // Step 2: count, then place; tasks in order, so the lists do not depend on threads.
        let lists = 2 * (across * down) as usize;
        let mut starts = vec![0_u32; lists + 1];
        let mut far_from = vec![f64::INFINITY; lists / 2];
        for (list, _, depth) in binned.iter().flatten() {
            starts[*list as usize + 1] += 1;
            if list % 2 == 1 {
                let from = &mut far_from[*list as usize / 2];
                *from = from.min(f64::from(*depth));
            }
        }
        for i in 1..starts.len() {
            starts[i] += starts[i - 1];
        }
        let mut next = starts.clone();
        let mut members = vec![Member { leaf: 0, index: 0 }; starts[lists] as usize];
        for (list, member, _) in binned.into_iter().flatten() {
            let place = &mut next[list as usize];
            members[*place as usize] = member;
            *place += 1;
        }
        Self { across, starts, members, far_from }
    }

    fn list(&self, list: usize) -> &[Member] {
        &self.members[self.starts[list] as usize..self.starts[list + 1] as usize]
    }

    /// The members of every tile that `rect` touches.
    pub fn of(&self, rect: PixelRect) -> Members<'_> {
        let (tx0, ty0) = (rect.x0 / TILE_SIDE, rect.y0 / TILE_SIDE);
        let (tx1, ty1) = ((rect.x1 - 1) / TILE_SIDE, (rect.y1 - 1) / TILE_SIDE);
        let tiles: Vec<usize> =
            (ty0..=ty1).flat_map(|ty| (tx0..=tx1).map(move |tx| (ty * self.across + tx) as usize)).collect();
        let far_from = tiles.iter().map(|&tile| self.far_from[tile]).fold(f64::INFINITY, f64::min);
        let listed = |which: usize| match tiles[..] {
            [tile] => Cow::Borrowed(self.list(2 * tile + which)),
            _ => {
                let mut members = Vec::new();
                tiles.iter().for_each(|tile| members.extend_from_slice(self.list(2 * tile + which)));
                members.sort_unstable();
                members.dedup();
                Cow::Owned(members)
            }
        };
        Members { near: listed(0), far: listed(1), far_from }
    }
}

/// Appends the needed surfels of one chunk, (leaf, chunk), to the tiles that their balls touch, or come within `margin_px`
/// of.
fn bin_chunk(
    model: &Model,
    view: &View,
    (leaf, chunk): (u32, usize),
    (across, down): (u32, u32),
    margin_px: f32,
    entries: &mut Vec<Entry>,
) {
    let field = &model.fields[leaf as usize];
    let cloud = &field.cloud;
    let of_chunk = &cloud.chunks[chunk];
    let ball = f64::from(of_chunk.extent) + f64::from(of_chunk.largest_radius);
    let Some(bounds) = view.bounds(view.point(of_chunk.origin + of_chunk.centre.as_dvec3()), ball) else { return };
    let tiles_of = |b: Bounds| {
        // Casts of floats round towards zero and saturate, so infinite bounds become the picture's.
        let tile = |px: f64, most: u32| ((px.max(0.0) / f64::from(TILE_SIDE)) as u32).min(most);
        let margin = f64::from(margin_px);
        let (x0, x1) = (tile(b.left - margin, across - 1), tile(b.right + margin, across - 1));
        let (y0, y1) = (tile(b.top - margin, down - 1), tile(b.bottom + margin, down - 1));
        (x0, x1, y0, y1)
    };
    let (x0, x1, y0, y1) = tiles_of(bounds);
    let whole = (x0, y0) == (x1, y1);
    let classes = &model.classes[leaf as usize].classes;
    let first = chunk * CHUNK;
    let last = (first + CHUNK).min(cloud.len());
    let origin_in_view = view.chunk_origin(cloud, chunk);
    for index in (first..last).filter(|&index| classes[index].is_needed()) {
        let radius = cloud.surfels[index].radius;
        let sight = view.sight_in_chunk(cloud, index, origin_in_view);
        let (x0, x1, y0, y1) = if whole {
            (x0, x1, y0, y1)
        } else {
            let Some(bounds) = view.rough_bounds(&sight, radius) else { continue };
            tiles_of(bounds)
        };
        let far = u32::from(shows_far_side(field, classes[index], &sight));
        for ty in y0..=y1 {
            for tx in x0..=x1 {
                let member = Member { leaf, index: index as u32 };
                entries.push((
                    2 * (ty * across + tx) + far,
                    member,
                    ((sight.centre.z - f64::from(radius)) as f32).next_down(),
                ));
            }
        }
    }
}

/// A set of a tile's blocks.
#[derive(Debug, Clone)]
pub struct BlockSet {
    /// The tile's size.
    width: u32,
    height: u32,
    across: u32,
    down: u32,
    wanted: Vec<bool>,
}

impl BlockSet {
    /// All blocks of `rect`, or none.
    pub fn new(rect: PixelRect, wanted: bool) -> Self {
        let (width, height) = (rect.width(), rect.height());
        let (across, down) = (width.div_ceil(BLOCK), height.div_ceil(BLOCK));
        Self { width, height, across, down, wanted: vec![wanted; (across * down) as usize] }
    }

    /// How many blocks there are, wanted or not.
    pub fn count(&self) -> usize {
        self.wanted.len()
    }

    /// The corner of `block`, pixels from the tile's.
    pub fn corner(&self, block: usize) -> (u32, u32) {
        (block as u32 % self.across * BLOCK, block as u32 / self.across * BLOCK)
    }

    /// The block of the pixel at column `x`, row `y` of the tile.
    pub fn at(&self, x: u32, y: u32) -> usize {
        (y / BLOCK * self.across + x / BLOCK) as usize
    }

    /// The layers of `block`, whose pixels are given one by one, counted from its corner; its rectangle is relative to the
    /// tile's corner.
    pub fn tile(&self, block: usize, mut pixel: impl FnMut(usize, &mut Vec<Boundary>)) -> LayerTile {
        let (x0, y0) = self.corner(block);
        let rect = PixelRect { x0, y0, x1: (x0 + BLOCK).min(self.width), y1: (y0 + BLOCK).min(self.height) };
        let mut tile = LayerTile { rect, offsets: vec![0], boundaries: Vec::with_capacity(rect.area()) };
        for y in 0..rect.height() {
            for x in 0..rect.width() {
                pixel((y * BLOCK + x) as usize, &mut tile.boundaries);
                tile.offsets.push(tile.boundaries.len() as u32);
            }
        }
        tile
    }

    /// Adds `block`.
    pub fn insert(&mut self, block: usize) {
        self.wanted[block] = true;
    }

    /// Whether `block` is in it.
    pub fn contains(&self, block: usize) -> bool {
        self.wanted[block]
    }

    /// Whether no block is in it.
    pub fn is_empty(&self) -> bool {
        !self.wanted.contains(&true)
    }

    /// Whether all blocks of `other` are in it.
    pub fn holds(&self, other: &Self) -> bool {
        self.wanted.iter().zip(&other.wanted).all(|(&has, &needs)| has || !needs)
    }

    /// The blocks in it.
    pub fn iter(&self) -> impl Iterator<Item = usize> {
        (0..self.wanted.len()).filter(|&block| self.wanted[block])
    }

    /// The columns and rows of the blocks that hold a pixel within the given pixels from the tile's corner.
    fn span(&self, (left, right): (f32, f32), (top, bottom): (f32, f32)) -> (Range<u32>, Range<u32>) {
        // A pixel more on each side than any place within a pixel can need.
        let block = |px: f32| (px.max(0.0) / BLOCK as f32) as u32; // casts round towards zero
        let range = |low: f32, high: f32, count: u32| block(low - 1.0)..block(high + 1.0).saturating_add(1).min(count);
        (range(left, right, self.across), range(top, bottom, self.down))
    }

    /// Whether anything within the given pixels from the tile's corner lies in a block of the set.
    pub fn meets(&self, horizontal: (f32, f32), vertical: (f32, f32)) -> bool {
        let (columns, mut rows) = self.span(horizontal, vertical);
        rows.any(|y| columns.clone().any(|x| self.wanted[(y * self.across + x) as usize]))
    }
}

/// The surfels of a tile by block: for each block of a set, runs of one leaf.
pub struct Blocks {
    /// Per block: (leaf, start, end) into `members`.
    runs: Vec<Vec<(LeafId, u32, u32)>>,
    members: Vec<u32>,
}

impl Blocks {
    /// Of `surfels`, whose `leaves` are runs of one leaf and which are drawn up to `margin_px` outside of their balls.
    pub fn of(set: &BlockSet, surfels: &[ViewSurfel], leaves: &[(LeafId, Range<usize>)], margin_px: f32) -> Self {
        let each = |index: usize, f: &mut dyn FnMut(usize)| {
            let s = &surfels[index];
            let (columns, rows) =
                set.span((s.left - margin_px, s.right + margin_px), (s.top - margin_px, s.bottom + margin_px));
            for y in rows {
                for x in columns.clone() {
                    let block = (y * set.across + x) as usize;
                    if set.wanted[block] {
                        f(block);
                    }
                }
            }
        };
        // Counting sort by block; leaves stay in order within a block.
        let count = set.count();
        let mut starts = vec![0_u32; count + 1];
        for index in 0..surfels.len() {
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
        Self { runs, members }
    }

    /// The runs of `block`: leaf and positions in the surfels.
    pub fn runs(&self, block: usize) -> impl Iterator<Item = (LeafId, &[u32])> {
        self.runs[block].iter().map(|&(leaf, start, end)| (leaf, &self.members[start as usize..end as usize]))
    }
}

/// The depth that a tile's depths are relative to: it only has to be of the surfels' depth, so that `f32` resolves their
/// differences to 1e-7 of their spread.
pub fn anchor_of(members: &Members<'_>, model: &Model, view: &View) -> f64 {
    let first = members.near.first().or(members.far.first());
    let centre = |m: &Member| -> DVec3 { model.fields[m.leaf as usize].cloud.centre(m.index as usize) };
    first.map_or(0.0, |m| view.point(centre(m)).z.max(0.0))
}
