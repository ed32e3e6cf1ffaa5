//! The layers of a tile and of the pixels around it, for whoever looks beside a pixel.
//!
//! *Practice.* Surfaces stay lists, as they come: a pixel's are a run of one array, those of its layers in order. Where a pixel has
//! no such layer, number 0 of the array stands for it, which is nothing. Lines are few, so they are a map for each layer that has
//! any. What four neighbouring pixels have at most is known beforehand: most lookups meet no line, and many nothing.

use std::ops::Range;

use glam::{Vec2, Vec4};

use super::strip::Strip;
use super::strokes::LineMap;
use crate::layers::{LayerTile, MAX_SAMPLES};
use crate::space::PixelRect;

/// Pixels, some of them outside of the picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Bounds {
    pub x: (i32, i32),
    pub y: (i32, i32),
}

/// The layers of the pixels within some bounds.
pub(super) struct Window {
    bounds: Bounds,
    across: usize,
    /// By pixel.
    lists: Vec<List>,
    /// Of surfaces, premultiplied; the first is nothing.
    colour: Vec<Vec4>,
    /// Of surfaces; that of nothing is +∞.
    depth: Vec<f32>,
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
    /// The number of the surface in `layer`.
    #[inline(always)]
    fn at(self, layer: usize) -> usize {
        if layer < self.count as usize { self.first as usize + layer } else { 0 }
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

impl Window {
    /// The pixels of `bounds`, which lie in the tiles around tile `index` or outside of the picture. `surfaces` are those of all
    /// tiles of the strip, `most` layers of them. `repeated` says in which layers lines are.
    pub fn new(
        strip: &Strip,
        index: usize,
        bounds: Bounds,
        samples: u32,
        surfaces: &[Vec<[f32; 4]>],
        most: usize,
        repeated: bool,
    ) -> Self {
        let across = (bounds.x.1 - bounds.x.0) as usize;
        let area = across * (bounds.y.1 - bounds.y.0) as usize;
        let expected = strip.tiles[index].boundaries.len() + area;
        let mut window = Self {
            bounds,
            across,
            lists: vec![List::default(); area],
            colour: Vec::with_capacity(expected),
            depth: Vec::with_capacity(expected),
            lines: Vec::new(),
            deepest: vec![0; area],
            crossed: vec![false; area],
        };
        window.colour.push(Vec4::ZERO);
        window.depth.push(f32::INFINITY);
        for near in strip.around(index) {
            let tile = &strip.tiles[near];
            let columns = within(tile.rect.x0..tile.rect.x1, bounds.x);
            for y in within(tile.rect.y0..tile.rect.y1, bounds.y) {
                if samples == 1 {
                    window.add_row(tile, &surfaces[near], columns.clone(), y, most);
                } else {
                    for x in columns.clone() {
                        window.add_pixel(tile, &surfaces[near], x, y, samples, most);
                    }
                }
            }
        }
        window.add_lines(strip, index, repeated);
        window.look_ahead();
        window
    }

    /// Adds the surfaces of the only sample of a row's pixels.
    fn add_row(&mut self, tile: &LayerTile, surfaces: &[[f32; 4]], columns: Range<u32>, y: u32, most: usize) {
        if columns.is_empty() {
            return;
        }
        let begin = ((y - tile.rect.y0) * tile.rect.width()) as usize;
        let [from, to] = [columns.start, columns.end].map(|x| begin + (x - tile.rect.x0) as usize);
        let offsets = &tile.offsets[from..=to];
        let of_row = offsets[0] as usize..offsets[to - from] as usize;
        if of_row.is_empty() {
            return;
        }
        let first = self.colour.len() as u32;
        let premultiplied = |&[r, g, b, a]: &[f32; 4]| Vec4::new(a * r, a * g, a * b, a);
        self.colour.extend(surfaces[of_row.clone()].iter().map(premultiplied));
        self.depth.extend(tile.boundaries[of_row].iter().map(|boundary| boundary.depth));
        let place = self.place(columns.start, y);
        let most = u32::try_from(most).unwrap_or(u32::MAX);
        for (list, of_pixel) in self.lists[place..].iter_mut().zip(offsets.windows(2)) {
            *list = List { first: first + of_pixel[0] - offsets[0], count: (of_pixel[1] - of_pixel[0]).min(most) };
        }
    }

    /// Adds the surfaces of a pixel of several samples, each with its share of the pixel.
    fn add_pixel(&mut self, tile: &LayerTile, surfaces: &[[f32; 4]], x: u32, y: u32, samples: u32, most: usize) {
        let pixel = ((y - tile.rect.y0) * tile.rect.width() + (x - tile.rect.x0)) as usize;
        let first = self.colour.len();
        let mut seen = [0; MAX_SAMPLES as usize];
        let of_pixel = tile.offsets[pixel] as usize..tile.offsets[pixel + 1] as usize;
        for (boundary, &[r, g, b, a]) in tile.boundaries[of_pixel.clone()].iter().zip(&surfaces[of_pixel]) {
            // A boundary may be the k-th of one sample and another of the next.
            for sample in (0..samples).filter(|s| boundary.samples >> s & 1 == 1) {
                let layer = &mut seen[sample as usize];
                if *layer >= most {
                    continue;
                }
                let number = first + *layer;
                if number == self.colour.len() {
                    self.colour.push(Vec4::ZERO);
                    self.depth.push(f32::INFINITY);
                }
                self.colour[number] += a / samples as f32 * Vec4::new(r, g, b, 1.0);
                self.depth[number] = self.depth[number].min(boundary.depth);
                *layer += 1;
            }
        }
        let place = self.place(x, y);
        self.lists[place] = List { first: first as u32, count: (self.colour.len() - first) as u32 };
    }

    /// Adds the lines of all tiles around, over the part of the window that the picture has.
    fn add_lines(&mut self, strip: &Strip, index: usize, repeated: bool) {
        let near: Vec<PixelRect> = strip.around(index).map(|near| strip.tiles[near].rect).collect();
        let (first, last) = (near[0], near[near.len() - 1]);
        let (columns, rows) = (within(first.x0..last.x1, self.bounds.x), within(first.y0..last.y1, self.bounds.y));
        let seen = PixelRect { x0: columns.start, y0: rows.start, x1: columns.end, y1: rows.end };
        let maps = strip.lines(index, seen, repeated);
        let area = self.lists.len();
        for layer in 0..maps.len() {
            let Some(map) = maps.layer(layer) else {
                self.lines.push(None);
                continue;
            };
            let mut lines = LineMap { ink: vec![0.0; area], depth: vec![f32::INFINITY; area] };
            let width = seen.width() as usize;
            for (row, y) in rows.clone().enumerate() {
                let (from, to) = (self.place(seen.x0, y), row * width);
                for column in (0..width).filter(|column| map.ink[to + column] > 0.0) {
                    lines.ink[from + column] = map.ink[to + column];
                    lines.depth[from + column] = map.depth[to + column];
                    self.crossed[from + column] = true;
                }
            }
            self.lines.push(Some(lines));
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
        let mut mixed = Vec4::ZERO;
        for (list, share) in tap.lists.into_iter().zip(tap.shares) {
            mixed += share * self.colour[list.at(layer)];
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
        self.depth[self.lists[tap.nearest].at(layer)].min(of_line)
    }
}

/// What of `range` lies within `bounds`.
fn within(range: Range<u32>, bounds: (i32, i32)) -> Range<u32> {
    let inside = |at: u32| (at as i32).clamp(bounds.0.max(0), bounds.1.max(0)) as u32;
    inside(range.start)..inside(range.end)
}
