//! The layers of a tile and of the pixels around it, for whoever looks beside a pixel.
//!
//! *Practice.* Surfaces stay lists, as they come: a pixel's are a run of one array of the whole strip, [`Surfaces`], those of
//! its layers in order. Where a pixel has no such layer, the last of the array stands for it, which is nothing. Lines are few, so
//! they are a map for each layer that has any. What four neighbouring pixels have at most is known beforehand: most lookups meet no
//! line, and many nothing.

use std::ops::Range;

use glam::{Vec2, Vec4};
use rayon::prelude::*;

use super::strip::Strip;
use super::strokes::LineMap;
use crate::layers::{Boundary, LayerTile, MAX_SAMPLES};
use crate::space::PixelRect;

/// Pixels, some of them outside of the picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Bounds {
    pub x: (i32, i32),
    pub y: (i32, i32),
}

/// The surfaces of a strip, pixel by pixel and front to back.
#[derive(Debug)]
pub(super) struct Surfaces {
    /// Premultiplied; the last is nothing.
    colour: Vec<[f32; 4]>,
    /// That of nothing is +∞.
    depth: Vec<f32>,
    /// By tile: the number of its first surface.
    first: Vec<u32>,
    /// Layers of a pixel at most.
    most: u32,
}

impl Surfaces {
    /// Those of `strip`, `most` layers of `samples` samples. `light` writes the straight colours and opacities of the boundaries of
    /// tile number so and so, which are nothing before.
    pub fn new(strip: &Strip, samples: u32, most: usize, light: impl Fn(usize, &mut [[f32; 4]]) + Sync) -> Self {
        let mut first = Vec::with_capacity(strip.tiles.len());
        let mut count = 0;
        for tile in &strip.tiles {
            first.push(u32::try_from(count).expect("a strip's boundaries are fewer than 2^32"));
            count += tile.boundaries.len();
        }
        let (mut colour, mut depth) = (vec![[0.0; 4]; count + 1], vec![f32::INFINITY; count + 1]);
        let colours = of_tiles(&mut colour, &strip.tiles).into_par_iter();
        colours.zip(of_tiles(&mut depth, &strip.tiles)).zip(&strip.tiles).enumerate().for_each(
            |(index, ((colours, depths), tile))| {
                light(index, colours);
                if samples == 1 {
                    for [r, g, b, a] in colours.iter_mut() {
                        (*r, *g, *b) = (*a * *r, *a * *g, *a * *b);
                    }
                    depths.iter_mut().zip(&tile.boundaries).for_each(|(depth, boundary)| *depth = boundary.depth);
                } else {
                    let lit = colours.to_vec();
                    for of_pixel in tile.offsets.windows(2) {
                        let of_pixel = of_pixel[0] as usize..of_pixel[1] as usize;
                        let boundaries = tile.boundaries[of_pixel.clone()].iter().zip(&lit[of_pixel.clone()]);
                        mix_samples(boundaries, samples, &mut colours[of_pixel.clone()], &mut depths[of_pixel]);
                    }
                }
            },
        );
        Self { colour, depth, first, most: u32::try_from(most).unwrap_or(u32::MAX) }
    }
}

/// The layers of a pixel of several samples, each with its share of the pixel. No layer of a sample is deeper than the pixel has
/// boundaries.
fn mix_samples<'a>(
    boundaries: impl Iterator<Item = (&'a Boundary, &'a [f32; 4])>,
    samples: u32,
    colours: &mut [[f32; 4]],
    depths: &mut [f32],
) {
    colours.fill([0.0; 4]);
    let mut seen = [0; MAX_SAMPLES as usize];
    for (boundary, &[r, g, b, a]) in boundaries {
        // A boundary may be the k-th of one sample and another of the next.
        for sample in (0..samples).filter(|s| boundary.samples >> s & 1 == 1) {
            let layer = &mut seen[sample as usize];
            let share = a / samples as f32 * Vec4::new(r, g, b, 1.0);
            colours[*layer] = (Vec4::from(colours[*layer]) + share).to_array();
            depths[*layer] = depths[*layer].min(boundary.depth);
            *layer += 1;
        }
    }
}

/// The values of each of `tiles`' boundaries, which lie one after the other in `all`.
fn of_tiles<'a, T>(all: &'a mut [T], tiles: &[LayerTile]) -> Vec<&'a mut [T]> {
    let mut rest = all;
    let next = |tile: &LayerTile| {
        let (of_tile, after) = std::mem::take(&mut rest).split_at_mut(tile.boundaries.len());
        rest = after;
        of_tile
    };
    tiles.iter().map(next).collect()
}

/// The layers of the pixels within some bounds.
pub(super) struct Window<'a> {
    bounds: Bounds,
    across: usize,
    /// By pixel.
    lists: Vec<List>,
    surfaces: &'a Surfaces,
    /// By layer and pixel; none where a layer has none.
    lines: Vec<Option<LineMap>>,
    /// By pixel: the most surfaces that it or one of the three on its right and below has.
    deepest: Vec<u32>,
    /// By pixel: whether a line crosses one of the same four.
    crossed: Vec<bool>,
}

/// The surfaces of a pixel.
#[derive(Debug, Clone, Copy, Default)]
struct List {
    first: u32,
    count: u32,
}

impl List {
    /// The number of the surface in `layer`, or `nothing`.
    #[inline(always)]
    fn at(self, layer: usize, nothing: usize) -> usize {
        if layer < self.count as usize { self.first as usize + layer } else { nothing }
    }
}

/// Where four pixels meet, by what shares.
#[derive(Debug, Clone, Copy)]
pub(super) struct Tap {
    corner: usize,
    across: usize,
    shares: [f32; 4],
    nearest: usize,
}

impl Tap {
    #[inline(always)]
    fn corners(&self) -> [usize; 4] {
        [self.corner, self.corner + 1, self.corner + self.across, self.corner + self.across + 1]
    }
}

/// The surfaces of four pixels, and by what shares.
#[derive(Debug, Clone, Copy)]
pub(super) struct SurfaceTap {
    lists: [List; 4],
    shares: [f32; 4],
}

impl<'a> Window<'a> {
    /// The pixels of `bounds`, which lie in the tiles around tile `index` or outside of the picture. `surfaces` are those of the
    /// strip. `repeated` says in which layers lines are.
    pub fn new(strip: &Strip, index: usize, bounds: Bounds, surfaces: &'a Surfaces, repeated: bool) -> Self {
        let across = (bounds.x.1 - bounds.x.0) as usize;
        let area = across * (bounds.y.1 - bounds.y.0) as usize;
        let mut window = Self {
            bounds,
            across,
            lists: vec![List::default(); area],
            surfaces,
            lines: Vec::new(),
            deepest: vec![0; area],
            crossed: vec![false; area],
        };
        for near in strip.around(index) {
            let tile = &strip.tiles[near];
            let columns = within(tile.rect.x0..tile.rect.x1, bounds.x);
            if columns.is_empty() || tile.boundaries.is_empty() {
                continue;
            }
            for y in within(tile.rect.y0..tile.rect.y1, bounds.y) {
                let begin = ((y - tile.rect.y0) * tile.rect.width()) as usize;
                let of_column = |x: u32| begin + (x - tile.rect.x0) as usize;
                let offsets = &tile.offsets[of_column(columns.start)..=of_column(columns.end)];
                let (first, place) = (surfaces.first[near], window.place(columns.start, y));
                for (list, of_pixel) in window.lists[place..].iter_mut().zip(offsets.windows(2)) {
                    *list = List { first: first + of_pixel[0], count: (of_pixel[1] - of_pixel[0]).min(surfaces.most) };
                }
            }
        }
        window.add_lines(strip, index, repeated);
        window.look_ahead();
        window
    }

    /// Adds the lines of all tiles around, over the part of the window that the picture has.
    fn add_lines(&mut self, strip: &Strip, index: usize, repeated: bool) {
        let near: Vec<PixelRect> = strip.around(index).map(|near| strip.tiles[near].rect).collect();
        let (first, last) = (near[0], near[near.len() - 1]);
        let (columns, rows) = (within(first.x0..last.x1, self.bounds.x), within(first.y0..last.y1, self.bounds.y));
        let seen = PixelRect { x0: columns.start, y0: rows.start, x1: columns.end, y1: rows.end };
        let maps = strip.lines(index, seen, repeated);
        let area = self.lists.len();
        let width = seen.width() as usize;
        let place_of = |number: usize| self.place(seen.x0 + (number % width) as u32, seen.y0 + (number / width) as u32);
        let crossed: Vec<[usize; 2]> = maps.crossed().map(|number| [number, place_of(number)]).collect();
        crossed.iter().for_each(|[_, place]| self.crossed[*place] = true);
        for layer in 0..maps.len() {
            let of_layer = maps.layer(layer).map(|map| {
                let mut lines = LineMap { ink: vec![0.0; area], depth: vec![f32::INFINITY; area] };
                for [number, place] in &crossed {
                    (lines.ink[*place], lines.depth[*place]) = (map.ink[*number], map.depth[*number]);
                }
                lines
            });
            self.lines.push(of_layer);
        }
    }

    /// Learns of each pixel what it and the three after it have.
    fn look_ahead(&mut self) {
        let across = self.across;
        for (deepest, list) in self.deepest.iter_mut().zip(&self.lists) {
            *deepest = list.count;
        }
        // Each step reads ahead of where it writes.
        for step in [1, across] {
            for place in 0..self.deepest.len() - step {
                self.deepest[place] = self.deepest[place].max(self.deepest[place + step]);
            }
        }
        if self.lines.is_empty() {
            return;
        }
        for step in [1, across] {
            for place in 0..self.crossed.len() - step {
                self.crossed[place] |= self.crossed[place + step];
            }
        }
    }

    /// Layers in which there may be anything.
    pub fn layers(&self) -> usize {
        let deepest = self.deepest.iter().copied().max().unwrap_or(0);
        self.lines.len().max(deepest as usize)
    }

    #[inline(always)]
    fn place(&self, x: u32, y: u32) -> usize {
        (y as i32 - self.bounds.y.0) as usize * self.across + (x as i32 - self.bounds.x.0) as usize
    }

    /// The pixels around a position within the bounds, in pixel indices: whole numbers are pixels' middles.
    #[inline(always)]
    pub fn tap(&self, at: Vec2) -> Tap {
        let low = at.floor();
        let (u, v) = (at.x - low.x, at.y - low.y);
        let (x, y) = ((low.x as i32 - self.bounds.x.0) as usize, (low.y as i32 - self.bounds.y.0) as usize);
        let corner = y * self.across + x;
        let nearest = corner + usize::from(u >= 0.5) + if v >= 0.5 { self.across } else { 0 };
        let shares = [(1.0 - u) * (1.0 - v), u * (1.0 - v), (1.0 - u) * v, u * v];
        Tap { corner, across: self.across, shares, nearest }
    }

    /// The layers in which the four pixels of `tap` have surfaces.
    #[inline(always)]
    pub fn deepest(&self, tap: &Tap) -> usize {
        self.deepest[tap.corner] as usize
    }

    /// The layers in which lines may cross the four pixels of `tap`.
    #[inline(always)]
    pub fn lined(&self, tap: &Tap) -> usize {
        if self.crossed[tap.corner] { self.lines.len() } else { 0 }
    }

    /// The surfaces at `tap`.
    #[inline(always)]
    pub fn surfaces(&self, tap: &Tap) -> SurfaceTap {
        let (upper, lower) = (&self.lists[tap.corner..][..2], &self.lists[tap.corner + tap.across..][..2]);
        SurfaceTap { lists: [upper[0], upper[1], lower[0], lower[1]], shares: tap.shares }
    }

    /// The premultiplied colour of a layer at a tap's surfaces.
    #[inline(always)]
    pub fn colour(&self, tap: &SurfaceTap, layer: usize) -> Vec4 {
        let (mut mixed, nothing) = (Vec4::ZERO, self.surfaces.colour.len() - 1);
        for (list, share) in tap.lists.into_iter().zip(tap.shares) {
            mixed += share * Vec4::from(self.surfaces.colour[list.at(layer, nothing)]);
        }
        mixed
    }

    /// The share of a layer that lines cover at `tap`.
    #[inline(always)]
    pub fn ink(&self, tap: &Tap, layer: usize) -> f32 {
        let Some(Some(lines)) = self.lines.get(layer) else { return 0.0 };
        tap.corners().into_iter().zip(tap.shares).map(|(place, share)| share * lines.ink[place]).sum()
    }

    /// The depth of a layer's surface or line at the pixel nearest to `tap`; +∞ where there is neither.
    #[inline(always)]
    pub fn depth(&self, tap: &Tap, layer: usize) -> f32 {
        let lines = self.lines.get(layer).and_then(|lines| lines.as_ref());
        let of_line = lines.map_or(f32::INFINITY, |lines| lines.depth[tap.nearest]);
        let depths = &self.surfaces.depth;
        depths[self.lists[tap.nearest].at(layer, depths.len() - 1)].min(of_line)
    }
}

/// What of `range` lies within `bounds`.
fn within(range: Range<u32>, bounds: (i32, i32)) -> Range<u32> {
    let inside = |at: u32| (at as i32).clamp(bounds.0.max(0), bounds.1.max(0)) as u32;
    inside(range.start)..inside(range.end)
}
