//! Where the lines of each layer run.
//!
//! *Theory.* Blueprint CSG §5.1: visually important edges are silhouettes, where the depth of a layer is discontinuous, and
//! creases, where its normal is; Sketchy CSG §3.1 adds the borders of open surfaces. Both papers find them by comparing
//! neighbouring texels of a layer's depth and normal maps, and so put a line on whole pixels, two wide.
//!
//! *Changes from the paper.* Neighbouring pixels' *lists* of boundaries are matched, front to back: a boundary goes on where
//! the other pixel's is near one of the two tangent planes and faces the same way. The k-th layer has an edge where the
//! k-th boundaries of the two do not match each other, which is the paper's discontinuity; but now it is also known why,
//! and with it where between the two pixels the line runs:
//!
//! * a *crease* is where two tangent planes of one matched pair meet: both know where, to a fraction of a pixel;
//! * a *silhouette* is where a front and the back behind it end together, which is where the solid's thickness goes to
//!   nothing: again two planes. On a smooth body the thickness goes as the square root of the distance, which halves it;
//! * elsewhere (a step seen from above, the border of a sheet) only the pair of pixels is known.
//!
//! [`strokes`](super::strokes) makes lines of these points. Thresholds are in footprints and degrees, so that they mean the
//! same at any size and zoom: a footprint is a pixel's width at the surface.
//!
//! *Practice.* A surface that bends within a few pixels, as a scan's corner that its surfels round off, has a crease where
//! its normal turns fastest, if over three pixels it turns by more than the threshold; a curved surface turns evenly and has
//! none. Where nothing changes between two pixels, which is nearly everywhere, [`FacetRow::compare`] is all that runs. Each pair
//! of pixels is looked at by the tile of its left or upper one alone.

use fearless_simd::{Level, Simd};
use glam::Vec2;

use super::facets::{Facet, FacetRow, FacetStrip, Fates, Limits};
use crate::layers::NO_LEAF;
use crate::scene::style::LineSettings;

/// Why a layer has an edge.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum EdgeKind {
    /// A surface ends, or jumps.
    Silhouette,
    /// A surface folds.
    Crease,
}

/// A place between two neighbouring pixels that a line passes.
#[derive(Debug, Clone, Copy)]
pub(super) struct EdgePoint {
    /// In pixels, (0, 0) the picture's top left corner.
    pub at: Vec2,
    /// Unit vector across the line; zero where unknown.
    pub across: Vec2,
    /// Of the nearer surface, world units.
    pub depth: f32,
    /// The layer whose surface has the edge, from 0.
    pub layer: u16,
    /// One past the last layer whose picture changes here, since deeper boundaries move up where this one ends.
    pub until: u16,
    /// Why.
    pub kind: EdgeKind,
    /// 0 to 1.
    pub strength: f32,
    /// Whether the line is drawn stronger.
    pub heavy: bool,
}

/// The edge points of a tile, by the left or upper pixel of the pair that each lies between.
#[derive(Debug, Default)]
pub(super) struct EdgePoints {
    /// Points, row by row of pixels.
    pub points: Vec<EdgePoint>,
    /// `area + 1` offsets into `points`; empty where there is none.
    pub offsets: Vec<u32>,
}

/// Of the steps that two tangent planes foresee, so much may be amiss: what a curved surface does between two pixels.
pub(crate) const CURVED_SHARE: f32 = 0.5;
/// A crease is at full strength from so many times the threshold on, so that lines fade in and do not flicker.
pub(crate) const FULL_CREASE: f32 = 1.3;
/// A rounded crease turns by so much more between its middle pixels than between those beside them.
pub(crate) const PEAK: f32 = 1.1;
/// Below this share of the threshold, as chords, a single pair of pixels is no part of a rounded crease either: three pixels turn
/// by at most what the middle two do and twice what a peak allows beside them. A hundredth less, for rounding.
const SUSPICIOUS_SHARE: f32 = 0.99 / (1.0 + 2.0 / PEAK);
/// Normals of front and back at a silhouette: nearly the same on a smooth body…
pub(crate) const SMOOTH_COS: f32 = 0.7;
/// …apart at a sharp edge.
pub(crate) const SHARP_COS: f32 = 0.2;
/// A line found so far outside of its pair of pixels, as a share of the way between them, is that of other planes.
pub(crate) const SLACK: f32 = 0.35;

/// The angle `crease_degrees` as a chord of the unit circle, and the least cosine of normals that are no part of a crease of it.
pub(crate) fn crease_limits(crease_degrees: f32) -> (f32, f32) {
    let crease = 2.0 * (0.5 * crease_degrees.to_radians()).sin();
    let suspicious = SUSPICIOUS_SHARE * crease;
    (crease, 1.0 - 0.5 * suspicious * suspicious)
}

/// Finds edges by one set of thresholds.
pub(super) struct Detector<'a> {
    level: Level,
    strip: &'a FacetStrip<'a>,
    limits: Limits,
    /// As a chord of the unit circle.
    crease: f32,
    /// By leaf: whether lines that bound it are heavy.
    heavy: &'a [bool],
}

/// Buffers of a tile.
#[derive(Default)]
struct Scratch {
    fates: Fates,
    /// The facets of two pixels.
    pair: [Vec<Facet>; 2],
    /// By pixel of the tile.
    found: Vec<(u32, EdgePoint)>,
    points: Vec<EdgePoint>,
}

/// A row of a tile's pixels.
#[derive(Clone, Copy)]
struct Row<'a> {
    facets: &'a FacetRow,
    /// Of the tile.
    across: usize,
    /// Number of its first pixel in the tile.
    first: u32,
    x0: u32,
    y: u32,
}

impl Row<'_> {
    /// The pixel that facet number `i` is of.
    fn pixel_of(&self, i: usize) -> usize {
        self.facets.columns[i] as usize
    }
}

/// Two pixels side by side (`axis` 0) or one above the other (1).
#[derive(Clone, Copy)]
struct Place {
    x: u32,
    y: u32,
    axis: usize,
}

impl<'a> Detector<'a> {
    /// Over `strip`, by the thresholds of `settings`.
    pub fn new(strip: &'a FacetStrip, settings: &LineSettings, heavy: &'a [bool]) -> Self {
        let (crease, least_cos) = crease_limits(settings.crease_degrees);
        let limits = Limits { jump_px: settings.jump_px, curved_share: CURVED_SHARE, least_cos };
        Self { level: Level::new(), strip, limits, crease, heavy }
    }

    /// The edge points of tile `index`.
    pub fn tile(&self, index: usize) -> EdgePoints {
        let rect = self.strip.tile(index).rect;
        let beside = if rect.x1 < self.strip.width { index + 1 } else { index };
        let below = if rect.y1 < self.strip.y1 { index + self.strip.across } else { index };
        if [index, beside, below].iter().all(|&near| self.strip.tile(near).boundaries.is_empty()) {
            return EdgePoints::default();
        }
        let found =
            fearless_simd::dispatch!(self.level, simd => simd.vectorize(#[inline(always)] || self.found(simd, index)));
        if found.is_empty() {
            return EdgePoints::default();
        }
        // Sorted by counting; a pixel's points stay in their order.
        let mut offsets = vec![0; rect.area() + 1];
        found.iter().for_each(|(pixel, _)| offsets[*pixel as usize + 1] += 1);
        for i in 1..offsets.len() {
            offsets[i] += offsets[i - 1];
        }
        let mut next = offsets.clone();
        let mut points = vec![found[0].1; found.len()];
        for (pixel, point) in &found {
            let place = &mut next[*pixel as usize];
            points[*place as usize] = *point;
            *place += 1;
        }
        EdgePoints { points, offsets }
    }

    /// The points of tile `index` with the numbers of their pixels, row by row.
    #[inline(always)]
    fn found<S: Simd>(&self, simd: S, index: usize) -> Vec<(u32, EdgePoint)> {
        let rect = self.strip.tile(index).rect;
        let mut scratch = Scratch::default();
        let (mut upper, mut lower) = (FacetRow::default(), FacetRow::default());
        upper.fill(self.strip, index, 0);
        for y in rect.y0..rect.y1 {
            let (first, across) = ((y - rect.y0) * rect.width(), rect.width() as usize);
            let row = Row { facets: &upper, across, first, x0: rect.x0, y };
            self.beside(simd, row, &mut scratch);
            if y + 1 < rect.y1 {
                lower.fill(self.strip, index, y + 1 - rect.y0);
            } else if y + 1 < self.strip.y1 {
                // The tile below begins with its first row.
                lower.fill(self.strip, index + self.strip.across, 0);
            } else {
                break;
            }
            self.below(simd, row, &lower, &mut scratch);
            std::mem::swap(&mut upper, &mut lower);
        }
        scratch.found
    }

    /// Compares the pixels of a row each with the next, the last one with the next tile's first.
    #[inline(always)]
    fn beside<S: Simd>(&self, simd: S, row: Row, scratch: &mut Scratch) {
        let offsets = &row.facets.offsets[..];
        let pixels = offsets.len() - 1;
        let mut x = 0;
        while x + 1 < pixels {
            // Pixels of as many facets each: those of one lie as far before those of the next.
            let (begin, count) = (x, offsets[x + 1] - offsets[x]);
            while x + 1 < pixels && offsets[x + 2] - offsets[x + 1] == count {
                x += 1;
            }
            let (a, count) = (offsets[begin] as usize..offsets[x] as usize, count as usize);
            let (first, next) = (a.start, a.start + count);
            if !row.facets.compare(simd, a, (row.facets, next), 0, &self.limits, &mut scratch.fates) {
                self.slow_pairs(row, row.facets, (first, next), (1, 0), scratch);
            }
            if x + 1 < pixels {
                self.slow_pair(row, x, (row.facets, x + 1), 0, scratch);
            }
            x += 1;
        }
    }

    /// Compares the pixels of a row with those of the row below.
    #[inline(always)]
    fn below<S: Simd>(&self, simd: S, row: Row, below: &FacetRow, scratch: &mut Scratch) {
        let (offsets, others) = (&row.facets.offsets[..], &below.offsets[..]);
        let across = row.across;
        let is_one_run = offsets == others;
        let mut x = 0;
        while x < across {
            // Pixels of as many facets as the one below: facets lie side by side in both rows.
            let begin = x;
            if is_one_run {
                x = across;
            }
            while x < across && offsets[x + 1] - offsets[x] == others[x + 1] - others[x] {
                x += 1;
            }
            let a = offsets[begin] as usize..offsets[x] as usize;
            let (first, under) = (a.start, others[begin] as usize);
            if !row.facets.compare(simd, a, (below, under), 1, &self.limits, &mut scratch.fates) {
                self.slow_pairs(row, below, (first, under), (0, 1), scratch);
            }
            if x < across {
                self.slow_pair(row, x, (below, x), 1, scratch);
                x += 1;
            }
        }
    }

    /// Compares the pixels of which a facet does not go on with those `step` columns further in the row `others`. Facets are counted
    /// from the numbers `first` of the two rows.
    #[inline(never)]
    fn slow_pairs(
        &self,
        row: Row,
        others: &FacetRow,
        first: (usize, usize),
        (step, axis): (usize, usize),
        scratch: &mut Scratch,
    ) {
        let mut from = 0;
        while let Some(number) = scratch.fates.first_from(from) {
            let pixel = row.pixel_of(first.0 + number);
            let of_pixel = [pixel, pixel + 1].map(|pixel| row.facets.offsets[pixel] as usize - first.0);
            from = of_pixel[1];
            if (of_pixel[0]..of_pixel[1]).any(|i| scratch.fates.ends(i)) {
                self.slow_pair(row, pixel, (others, pixel + step), axis, scratch);
                continue;
            }
            // Each is matched with its like, so all there can be is creases.
            let place = Place { x: row.x0 + pixel as u32, y: row.y, axis };
            for (layer, i) in (of_pixel[0]..of_pixel[1]).enumerate() {
                if !scratch.fates.turns(i) {
                    continue;
                }
                let (a, b) = (row.facets.get(first.0 + i), others.get(first.1 + i));
                if let Some(edge) = self.crease(&a, &b, place) {
                    let point = EdgePoint { layer: layer as u16, until: layer as u16 + 1, ..edge };
                    scratch.found.push((row.first + pixel as u32, point));
                }
            }
        }
    }

    /// Compares pixel `i` of `row` with pixel `j` of `others`, which is beside or below it.
    #[inline(never)]
    fn slow_pair(&self, row: Row, i: usize, (others, j): (&FacetRow, usize), axis: usize, scratch: &mut Scratch) {
        let Scratch { pair: [p, q], points, found, .. } = scratch;
        let of_pixel = |facets: &FacetRow, i: usize| facets.offsets[i] as usize..facets.offsets[i + 1] as usize;
        p.clear();
        q.clear();
        p.extend(of_pixel(row.facets, i).map(|k| row.facets.get(k)));
        q.extend(of_pixel(others, j).map(|k| others.get(k)));
        points.clear();
        self.pair(p, q, Place { x: row.x0 + i as u32, y: row.y, axis }, points);
        found.extend(points.drain(..).map(|point| (row.first + i as u32, point)));
    }

    /// Whether `q`, the next pixel along `axis`, shows the surface of `p`.
    #[inline]
    fn goes_on(&self, p: &Facet, q: &Facet, axis: usize) -> bool {
        p.facing == q.facing && self.limits.goes_on(p.deeper(q), p.step[axis], q.step[axis])
    }

    fn pair(&self, p: &[Facet], q: &[Facet], place: Place, out: &mut Vec<EdgePoint>) {
        let deepest = p.len().max(q.len()) as u16;
        let mut first_open = out.len();
        let (mut i, mut j) = (0, 0);
        while i < p.len() || j < q.len() {
            let (a, b) = (p.get(i), q.get(j));
            if let (Some(a), Some(b)) = (a, b)
                && self.goes_on(a, b, place.axis)
            {
                let layer = i.min(j) as u16;
                if i == j {
                    // From here on, layers are the same surfaces again.
                    let open = out[first_open..].iter_mut().filter(|edge| edge.kind == EdgeKind::Silhouette);
                    open.for_each(|edge| edge.until = layer.max(edge.layer + 1));
                }
                if a.normal.dot(b.normal) < self.limits.least_cos
                    && let Some(edge) = self.crease(a, b, place)
                {
                    out.push(EdgePoint { layer, until: layer + 1, ..edge });
                }
                if i == j {
                    first_open = out.len();
                }
                (i, j) = (i + 1, j + 1);
                continue;
            }
            // The nearer of the two has no match: whatever matched it would be nearer than the other.
            let p_is_nearer = match (a, b) {
                (Some(a), Some(b)) => a.depth <= b.depth,
                (a, _) => a.is_some(),
            };
            let (near, at, others, other) = if p_is_nearer { (p, i, q, j) } else { (q, j, p, i) };
            let facet = &near[at];
            let mate = near.get(at + 1).filter(|mate| mate.facing != facet.facing);
            let mate_goes_on = mate.is_some_and(|mate| {
                others[other.min(others.len())..].iter().any(|o| {
                    let (a, b) = if p_is_nearer { (mate, o) } else { (o, mate) };
                    self.goes_on(a, b, place.axis)
                })
            });
            let mate = mate.filter(|_| !mate_goes_on);
            let layer = i.min(j) as u16;
            out.push(EdgePoint {
                layer,
                until: deepest,
                ..self.silhouette(facet, mate, others.get(other), place, p_is_nearer)
            });
            // A surface that stepped is both pixels' k-th; one that ended is one pixel's alone.
            let stepped = mate_goes_on && others.get(other).is_some_and(|o| o.facing == facet.facing);
            let ended = 1 + usize::from(mate.is_some());
            match (p_is_nearer, stepped) {
                (_, true) => (i, j) = (i + 1, j + 1),
                (true, false) => i += ended,
                (false, false) => j += ended,
            }
        }
        // Edges with nothing behind them end with the last layer.
        out[first_open..].iter_mut().for_each(|edge| edge.until = edge.until.max(edge.layer + 1));
    }

    /// Where the surface of `p` folds into that of `q`.
    fn crease(&self, p: &Facet, q: &Facet, place: Place) -> Option<EdgePoint> {
        let mut turned = turn(p, q);
        // The fastest turn is the crease; of two alike, the first.
        let before = self.neighbour(p, place, -1);
        let turn_before = before.map_or(0.0, |before| turn(&before, p));
        if !(turned >= turn_before) {
            return None;
        }
        let after = self.neighbour(q, place, 2);
        let turn_after = after.map_or(0.0, |after| turn(q, &after));
        if !(turned > turn_after) {
            return None;
        }
        let mut ends = (*p, *q, 0.0, 1.0);
        if turned < self.crease {
            // Towards a silhouette every body turns faster; only a turn that slows down again is a crease.
            let (Some(before), Some(after)) = (before, after) else { return None };
            if !(turned >= PEAK * turn_before.max(turn_after)) {
                return None;
            }
            turned = turn(&before, &after);
            ends = (before, after, -1.0, 2.0);
        }
        let strength = (turned / self.crease - 1.0) / (FULL_CREASE - 1.0);
        if !(strength > 0.0) {
            return None;
        }
        // The planes z_a + s_a (r − a) and z_b + s_b (r − b) meet where their difference is 0.
        let (a, b, from, to) = ends;
        let bend = Vec2::from(a.step) - Vec2::from(b.step);
        let t = (a.deeper(&b) + from * a.step[place.axis] - to * b.step[place.axis]) / bend[place.axis];
        let (t, across) = trusted(t, bend);
        Some(EdgePoint {
            at: place.between(t),
            across,
            depth: p.depth.min(q.depth),
            layer: 0,
            until: 0,
            kind: EdgeKind::Crease,
            strength: strength.min(1.0),
            heavy: self.is_heavy(p) || self.is_heavy(q),
        })
    }

    /// Where the surface of `facet`, with the back `mate` where that ends with it, ends before the other pixel.
    fn silhouette(
        &self,
        facet: &Facet,
        mate: Option<&Facet>,
        other: Option<&Facet>,
        place: Place,
        ends_in_q: bool,
    ) -> EdgePoint {
        let (mut t, mut across) = (0.5, Vec2::ZERO);
        if let Some(mate) = mate {
            let smooth = ((facet.normal.dot(mate.normal) - SHARP_COS) / (SMOOTH_COS - SHARP_COS)).clamp(0.0, 1.0);
            let thinning = Vec2::from(mate.step) - Vec2::from(facet.step);
            let along = if ends_in_q { thinning[place.axis] } else { -thinning[place.axis] };
            let reach = -facet.deeper(mate) / along * (1.0 - 0.5 * smooth);
            (t, across) = trusted(if ends_in_q { reach } else { 1.0 - reach }, thinning);
        }
        EdgePoint {
            at: place.between(t),
            across,
            depth: facet.depth,
            layer: 0,
            until: 0,
            kind: EdgeKind::Silhouette,
            strength: 1.0,
            heavy: self.is_heavy(facet) || other.is_some_and(|other| self.is_heavy(other)),
        }
    }

    /// The facet that goes on from `facet`, at `offset` pixels from the place's first pixel.
    fn neighbour(&self, facet: &Facet, place: Place, offset: i32) -> Option<Facet> {
        let mut at = [place.x, place.y];
        at[place.axis] = at[place.axis].checked_add_signed(offset)?;
        let mut candidates = self.strip.at(at[0], at[1], facet.facing)?;
        let goes_on = |c: &Facet| {
            if offset < 0 { self.goes_on(c, facet, place.axis) } else { self.goes_on(facet, c, place.axis) }
        };
        candidates.find(goes_on)
    }

    fn is_heavy(&self, facet: &Facet) -> bool {
        facet.leaf != NO_LEAF && self.heavy.get(facet.leaf as usize).copied().unwrap_or(false)
    }
}

impl Place {
    /// The point a share `t` of the way from the middle of the first pixel to that of the second.
    fn between(self, t: f32) -> Vec2 {
        let mut at = Vec2::new(self.x as f32 + 0.5, self.y as f32 + 0.5);
        at[self.axis] += t;
        at
    }
}

/// The share of the way at which a line crosses, and its unit normal, as two planes have it; half way and no normal where
/// they cannot be right.
fn trusted(t: f32, across: Vec2) -> (f32, Vec2) {
    match across.try_normalize() {
        Some(across) if t > -SLACK && t < 1.0 + SLACK => (t.clamp(0.0, 1.0), across),
        _ => (0.5, Vec2::ZERO),
    }
}

/// How far two facets' normals are apart, as a chord of the unit circle: it grows with the angle, and keeps its digits where a
/// cosine near 1 has lost them.
fn turn(a: &Facet, b: &Facet) -> f32 {
    a.normal.distance(b.normal)
}
