//! Edge points into lines: smoothed along the line, drawn one stroke a point, anti-aliased.
//!
//! *Practice.* Points whose surfaces say where the line runs lie on it already; those that know only their pair of pixels
//! make a staircase. Either kind is moved onto the line that its neighbours fit, which leaves the first where they are and
//! takes the steps out of the second. A point with too few neighbours is a speck of noise and draws nothing. A stroke is a
//! little longer than the distance between points, so that a line has no gaps whatever its slope; strokes of one layer are
//! joined by the stronger, so that overlapping ones are no darker.
//!
//! Dashes need the length along a line, which no pixel knows. The position in the picture along the nearest of a few
//! directions ([`DASH_DIRECTIONS`]) stands in for it: dashes are at most 8 % longer than asked, a straight line's are even,
//! and a bend has an uneven one where it passes from one direction to the next. More directions would be no better: a line
//! between two of them, seen in perspective or through noise, would have both.

use std::f32::consts::PI;

use glam::Vec2;

use super::edges::{EdgePoint, EdgePoints};
use crate::layers::TILE_SIDE;
use crate::scene::style::LineSettings;
use crate::space::PixelRect;

/// Points this many pixels away, by column and by row, take part in smoothing.
pub(crate) const NEAR_PX: u32 = 3;
/// The weight of a neighbour falls with its distance and ends here: (1 − d²/r²)², which is near a Gaussian of 1.5 pixels.
pub(crate) const WEIGHT_ENDS_PX: f32 = 4.0;
/// Neighbours of lines that run another way do not take part: cosine between the two.
pub(crate) const SAME_WAY: f32 = 0.85;
/// Nor those of a line beside it: points of one line, found between one pair of pixels or the next, are no further off it.
pub(crate) const SAME_LINE_PX: f32 = 1.25;
/// A point with fewer neighbours than this is a speck.
pub(crate) const FEWEST_NEIGHBOURS: usize = 3;
/// A stroke is whole for this long to either side, in pixels, and then fades: points lie at most a pixel apart.
pub(crate) const WHOLE_PX: f32 = 0.5;
/// …until here.
pub(crate) const FADED_PX: f32 = 0.9;
/// Directions that dashes tell apart: level, upright, and the two between.
pub(crate) const DASH_DIRECTIONS: f32 = 4.0;
/// How much wider heavy lines are.
pub(crate) const HEAVY: f32 = 2.0;

/// A piece of a line.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Stroke {
    /// Its middle, in pixels.
    pub at: Vec2,
    /// Unit vector along it.
    along: Vec2,
    depth: f32,
    /// Its surface's layer.
    pub layer: u16,
    /// One past the last layer that it is drawn in.
    pub until: u16,
    strength: f32,
    width: f32,
    /// Whether it outlines what is drawn stronger.
    pub heavy: bool,
}

/// The edge points of some rows of tiles.
#[derive(Debug)]
pub(super) struct EdgeStrip {
    /// Tiles side by side.
    pub across: usize,
    /// The pixels of each tile.
    pub rects: Vec<PixelRect>,
    /// Their points.
    pub tiles: Vec<EdgePoints>,
}

impl EdgeStrip {
    /// Finds the points between pixels of the strip at most [`NEAR_PX`] away from (`x`, `y`), in runs, row by row.
    #[inline(always)]
    fn near<'a>(&'a self, x: u32, y: u32, runs: &mut Vec<&'a [EdgePoint]>) {
        runs.clear();
        let (first, last) = (self.rects[0], self.rects[self.rects.len() - 1]);
        let (x0, x1) = (x.saturating_sub(NEAR_PX), (x + NEAR_PX + 1).min(last.x1));
        let (y0, y1) = (y.saturating_sub(NEAR_PX).max(first.y0), (y + NEAR_PX + 1).min(last.y1));
        // They lie in one tile or two beside each other, and in those below.
        for of_row in (y0 - first.y0) / TILE_SIDE..=(y1 - 1 - first.y0) / TILE_SIDE {
            let first_of_row = of_row as usize * self.across;
            let tiles = first_of_row + (x0 / TILE_SIDE) as usize..=first_of_row + ((x1 - 1) / TILE_SIDE) as usize;
            let rows = &self.rects[*tiles.start()];
            for row in y0.max(rows.y0)..y1.min(rows.y1) {
                for (tile, rect) in self.tiles[tiles.clone()].iter().zip(&self.rects[tiles.clone()]) {
                    // The points of a tile's row lie side by side.
                    let begin = ((row - rect.y0) * rect.width()) as usize;
                    let (from, to) = ((x0.max(rect.x0) - rect.x0) as usize, (x1.min(rect.x1) - rect.x0) as usize);
                    let Some(offsets) = tile.offsets.get(begin + from..=begin + to) else { continue };
                    let run = offsets[0] as usize..offsets[to - from] as usize;
                    if !run.is_empty() {
                        runs.push(&tile.points[run]);
                    }
                }
            }
        }
    }

    /// The strokes of tile `index`.
    pub fn strokes(&self, index: usize, settings: &LineSettings) -> Vec<Stroke> {
        let (tile, rect) = (&self.tiles[index], &self.rects[index]);
        let mut strokes = Vec::with_capacity(tile.points.len());
        let (mut runs, mut alike) = (Vec::new(), Vec::new());
        for (row, y) in (rect.y0..rect.y1).enumerate() {
            let across = rect.width() as usize;
            let Some(offsets) = tile.offsets.get(row * across..=(row + 1) * across) else { break };
            if offsets[0] == offsets[across] {
                continue;
            }
            for (x, of_pixel) in (rect.x0..).zip(offsets.windows(2)) {
                if of_pixel[0] == of_pixel[1] {
                    continue;
                }
                self.near(x, y, &mut runs);
                for point in &tile.points[of_pixel[0] as usize..of_pixel[1] as usize] {
                    alike.clear();
                    let mut near = 0;
                    for other in runs.iter().copied().flatten() {
                        if other.layer < point.until && point.layer < other.until {
                            near += 1;
                            alike.extend(Alike::new(other, point));
                        }
                    }
                    // Itself is one of them.
                    if near > FEWEST_NEIGHBOURS {
                        strokes.extend(stroke(point, &alike, settings));
                    }
                }
            }
        }
        strokes
    }
}

/// A neighbour that takes part in smoothing.
#[derive(Clone, Copy)]
struct Alike {
    at: Vec2,
    across: Vec2,
    weight: f32,
}

impl Alike {
    /// `other` as a neighbour of `point`, if it is of its kind and near enough to count.
    #[inline(always)]
    fn new(other: &EdgePoint, point: &EdgePoint) -> Option<Self> {
        let left = (1.0 - other.at.distance_squared(point.at) / (WEIGHT_ENDS_PX * WEIGHT_ENDS_PX)).max(0.0);
        let weight = left * left;
        (other.kind == point.kind && weight > 0.0).then_some(Self { at: other.at, across: other.across, weight })
    }
}

/// The stroke at `point`, of whose neighbours those that are `alike`, itself among them, take part; `None` where they have no
/// direction.
fn stroke(point: &EdgePoint, alike: &[Alike], settings: &LineSettings) -> Option<Stroke> {
    // The direction: of the surfaces where they know it, else of the points.
    let mut across = if point.across == Vec2::ZERO {
        let (mut sum, mut middle) = (0.0, Vec2::ZERO);
        for p in alike {
            sum += p.weight;
            middle += p.weight * p.at;
        }
        middle /= sum;
        let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
        for p in alike {
            let (w, d) = (p.weight, p.at - middle);
            (xx, xy, yy) = (xx + w * d.x * d.x, xy + w * d.x * d.y, yy + w * d.y * d.y);
        }
        // Half the angle of (xx − yy, 2 xy) is the longer axis; across it is a quarter turn on.
        let angle = 0.5 * f32::atan2(2.0 * xy, xx - yy) + 0.5 * PI;
        if !angle.is_finite() {
            return None;
        }
        Vec2::from_angle(angle)
    } else {
        point.across
    };
    let (mut sum, mut aside, mut mean) = (0.0, 0.0, Vec2::ZERO);
    for p in alike {
        let (turned, off) = (p.across.dot(across), across.dot(p.at - point.at));
        if (p.across == Vec2::ZERO || turned.abs() > SAME_WAY) && off.abs() < SAME_LINE_PX {
            sum += p.weight;
            aside += p.weight * off;
            let side = if turned < 0.0 { -1.0 } else { 1.0 };
            mean += p.weight * side * p.across;
        }
    }
    // The point itself is one of them, so there is a mean. Along a straight line this moves nothing but the points off it.
    if point.across != Vec2::ZERO {
        across = mean.normalize_or(across);
    }
    Some(Stroke {
        at: point.at + across * (aside / sum),
        along: across.perp(),
        depth: point.depth,
        layer: point.layer,
        until: point.until,
        strength: point.strength,
        width: settings.width_px * if point.heavy { HEAVY } else { 1.0 },
        heavy: point.heavy,
    })
}

/// How far from its middle a stroke can ink a pixel, in pixels.
pub(super) fn reach_px(settings: &LineSettings) -> f32 {
    0.5 * HEAVY * settings.width_px + FADED_PX + 1.0
}

/// The lines of one layer over one tile.
#[derive(Debug, Clone)]
pub(crate) struct LineMap {
    /// By pixel: 0 to 1.
    pub ink: Vec<f32>,
    /// By pixel: depth of the nearest line; +∞ where there is none.
    pub depth: Vec<f32>,
}

/// The lines of one tile, by layer.
#[derive(Debug, Default)]
pub(crate) struct LineMaps {
    layers: Vec<Option<LineMap>>,
    /// By pixel, a bit each: whether a line of any layer crosses it.
    crossed: Vec<u64>,
}

impl LineMaps {
    /// Layers in which there may be lines.
    pub fn len(&self) -> usize {
        self.layers.len()
    }

    /// Whether a line of any layer crosses pixel number `pixel`.
    #[inline(always)]
    pub fn cross(&self, pixel: usize) -> bool {
        self.crossed.get(pixel / 64).is_some_and(|bits| bits >> (pixel % 64) & 1 == 1)
    }

    /// The numbers of the pixels that lines cross.
    pub fn crossed(&self) -> impl Iterator<Item = usize> {
        self.crossed.iter().enumerate().flat_map(|(word, bits)| {
            let mut rest = *bits;
            std::iter::from_fn(move || {
                let bit = (rest != 0).then(|| rest.trailing_zeros() as usize)?;
                rest &= rest - 1;
                Some(word * 64 + bit)
            })
        })
    }

    /// The lines of layer `layer`; `None` where there is none.
    pub fn layer(&self, layer: usize) -> Option<&LineMap> {
        self.layers.get(layer)?.as_ref()
    }

    /// Draws `strokes` over `rect`, in layers below `most`: each in its own layer, or, `repeated`, in all layers whose picture
    /// changes at it.
    pub fn draw<'a>(
        rect: PixelRect,
        strokes: impl Iterator<Item = &'a Stroke>,
        most: usize,
        repeated: bool,
        settings: &LineSettings,
    ) -> Self {
        let mut maps = Self::default();
        let reach = reach_px(settings);
        let (low, high) = (
            Vec2::new(rect.x0 as f32 - reach, rect.y0 as f32 - reach),
            Vec2::new(rect.x1 as f32 + reach, rect.y1 as f32 + reach),
        );
        for stroke in strokes.filter(|s| s.at.cmpge(low).all() && s.at.cmple(high).all()) {
            let until = if repeated { stroke.until } else { stroke.layer + 1 };
            let until = usize::from(until).min(most);
            if maps.layers.len() < until {
                maps.layers.resize(until, None);
                maps.crossed.resize(rect.area().div_ceil(64), 0);
            }
            for layer in usize::from(stroke.layer)..until {
                let map = maps.layers[layer].get_or_insert_with(|| LineMap {
                    ink: vec![0.0; rect.area()],
                    depth: vec![f32::INFINITY; rect.area()],
                });
                let dash = settings.hidden_dash_px.filter(|_| layer > 0);
                map.draw(rect, stroke, dash, &mut maps.crossed);
            }
        }
        maps
    }
}

impl LineMap {
    fn draw(&mut self, rect: PixelRect, stroke: &Stroke, dash: Option<[f32; 2]>, crossed: &mut [u64]) {
        let half = 0.5 * stroke.width;
        let reach = (half + 0.5).max(FADED_PX);
        let bound = |at: f32, low: u32, high: u32| {
            let first = (at - reach - 0.5).ceil().max(low as f32) as u32;
            let last = (at + reach - 0.5).floor();
            first..if last < low as f32 { first } else { (last as u32 + 1).min(high) }
        };
        for y in bound(stroke.at.y, rect.y0, rect.y1) {
            for x in bound(stroke.at.x, rect.x0, rect.x1) {
                let from_middle = Vec2::new(x as f32 + 0.5, y as f32 + 0.5) - stroke.at;
                let aside = stroke.along.perp_dot(from_middle).abs();
                let ahead = stroke.along.dot(from_middle).abs();
                // A line of `width` through a pixel's box covers so much of it; a hair line is pale, not thin.
                let covered = (half + 0.5 - aside).clamp(0.0, stroke.width.min(1.0));
                // Round ends, so that wide strokes meet in corners.
                let end =
                    ((FADED_PX + half - 0.5 - ahead).max(FADED_PX - ahead) / (FADED_PX - WHOLE_PX)).clamp(0.0, 1.0);
                let mut ink = covered * end * stroke.strength;
                if let Some(dash) = dash {
                    ink *= dash_at(Vec2::new(x as f32, y as f32), stroke.along, dash);
                }
                if ink > 0.0 {
                    let index = ((y - rect.y0) * rect.width() + (x - rect.x0)) as usize;
                    self.ink[index] = self.ink[index].max(ink);
                    self.depth[index] = self.depth[index].min(stroke.depth);
                    crossed[index / 64] |= 1 << (index % 64);
                }
            }
        }
    }
}

/// Whether position `at` of a line along `along` is in a dash: 1, in a gap: 0, between at their borders.
fn dash_at(at: Vec2, along: Vec2, [dash, gap]: [f32; 2]) -> f32 {
    let step = PI / DASH_DIRECTIONS;
    let direction = Vec2::from_angle((along.to_angle() / step).round() * step);
    // Lines have no direction: one half of the circle stands for both.
    let direction = if direction.y < -0.5 * step.sin() || direction.x < -1.0 + 1e-4 { -direction } else { direction };
    let phase = at.dot(direction).rem_euclid(dash + gap);
    (0.5 + phase).min(0.5 + dash - phase).max(0.5 + phase - dash - gap).clamp(0.0, 1.0)
}
