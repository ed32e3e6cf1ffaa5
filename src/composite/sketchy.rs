//! The sketchy style: lines and surfaces drawn by a loose hand.
//!
//! *Theory.* Sketchy CSG §4 to §6: a pixel looks up its layer's edge map and its shade map not at itself but at two places
//! beside it, `p + E·n(p)` and `p + S·n(p)`, where `n` is smooth noise of two values and E and S are 2×2 matrices: edges
//! and surfaces move apart. Its depth is the nearer of the depths at the two places, so that the drawing still stands in
//! front of and behind other content as the body does. All layers use one noise, so what coincides in two layers still
//! coincides in the drawing.
//!
//! *Practice.* The noise belongs to the picture: it stands still while the scene moves, and a line that moves by a pixel is
//! moved on by at most the noise's slope, [`SketchSettings`]'s offset over its wavelength. It changes over tens of pixels,
//! so it is computed on a coarse grid and interpolated. Lookups are bilinear in premultiplied colour, or the border of a
//! surface would be jagged. Surfaces at the two places are lit where they are, not where they are drawn.

use glam::Vec2;

use super::Look;
use super::layered::{Composed, Gathered, Inks, from_strips};
use super::lighting::Shader;
use super::noise::Perlin;
use super::picture::Picture;
use super::shadow::Shadows;
use super::strip::Strip;
use crate::layers::LayerSource;
use crate::scene::style::{SketchSettings, Style};
use crate::space::PixelRect;

/// Pixels between the places where the noise is computed.
pub(crate) const NOISE_GRID_PX: u32 = 8;
/// The second value of the noise is the same noise this far away, in wavelengths.
const SECOND_VALUE: Vec2 = Vec2::new(57.3, 131.7);

/// Draws the layers of `source` sketchily. `heavy` says by leaf whether its outline is drawn stronger; `shadows` fall
/// on its surfaces.
pub(super) fn sketchy(
    source: &dyn LayerSource,
    look: &Look,
    style: &Style,
    heavy: &[bool],
    shadows: Option<&Shadows>,
    on_tile: &(dyn Fn() + Sync),
) -> Picture {
    let shader = Shader::new(&look.light, source.camera());
    let inks = Inks::new(style, look.background);
    let samples = source.samples();
    let hand = Hand::new(&style.sketch);
    // A tile's surfaces are looked up from the tiles around it too.
    let surfaces = |strip: &Strip| {
        let suns = inks.suns(strip, 0..strip.tiles.len(), shadows, source);
        inks.of_strip(strip, &shader, samples, &suns)
    };
    from_strips(source, look, style, heavy, on_tile, surfaces, |strip, surfaces, index| {
        let rect = strip.tiles[index].rect;
        let area = rect.area();
        let covered = strip.tiles[index].offsets.windows(2).filter(|w| w[0] < w[1]).count() as u64;
        if strip.around(index).all(|tile| strip.is_empty(tile)) {
            return Composed { pixels: vec![look.background; area], depth: vec![f32::INFINITY; area], covered };
        }
        let window = Window::new(strip, index, hand.reach_px(), samples, surfaces, inks.most, false);
        let offsets = hand.offsets(rect);
        let (mut pixels, mut depth) = (Vec::with_capacity(area), Vec::with_capacity(area));
        for (pixel, &[edge, shade]) in offsets.iter().enumerate() {
            let x = rect.x0 + pixel as u32 % rect.width();
            let y = rect.y0 + pixel as u32 / rect.width();
            let at = Vec2::new(x as f32, y as f32);
            let (at_edge, at_shade) = (window.tap(at + edge), window.tap(at + shade));
            let mut gathered = Gathered::new();
            for layer in &window.layers {
                let ink = at_edge.mix(&layer.ink);
                let surface = at_shade.mix_colour(&layer.colour);
                if ink > 0.0 || surface[3] > 0.0 {
                    let nearer = layer.depth[at_edge.nearest].min(layer.depth[at_shade.nearest]);
                    gathered.add(&inks, ink, nearer, surface, nearer);
                    if gathered.is_opaque() {
                        break;
                    }
                } else {
                    gathered.add(&inks, 0.0, f32::INFINITY, [0.0; 4], f32::INFINITY);
                }
            }
            let (colour, z) = gathered.finish(look.background);
            pixels.push(colour);
            depth.push(z);
        }
        Composed { pixels, depth, covered }
    })
}

/// How far each pixel's lookups are off.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Hand {
    noise: Perlin,
    settings: SketchSettings,
}

impl Hand {
    pub fn new(settings: &SketchSettings) -> Self {
        Self { noise: Perlin::new(settings.seed), settings: *settings }
    }

    /// The noise at a position in the picture: two values of −1 to 1.
    pub fn noise_at(&self, at: Vec2) -> Vec2 {
        let p = at / self.settings.wavelength_px;
        Vec2::new(self.noise.at(p), self.noise.at(p + SECOND_VALUE))
    }

    /// The offsets in pixels of the edge and the shade lookup, for a noise value.
    fn turned(&self, noise: Vec2) -> [Vec2; 2] {
        [self.settings.edge_px, self.settings.shade_px].map(|rows| {
            let offset = Vec2::new(Vec2::from(rows[0]).dot(noise), Vec2::from(rows[1]).dot(noise));
            offset.clamp_length_max(SketchSettings::MOST_OFFSET_PX)
        })
    }

    /// The longest offset, in pixels.
    pub fn reach_px(&self) -> u32 {
        let corners = [Vec2::ONE, Vec2::new(1.0, -1.0)];
        let longest = corners.into_iter().flat_map(|noise| self.turned(noise)).map(Vec2::length).fold(0.0, f32::max);
        longest.ceil() as u32
    }

    /// For each pixel of `rect`, row by row: the offsets of its edge and its shade lookup, in pixels.
    pub fn offsets(&self, rect: PixelRect) -> Vec<[Vec2; 2]> {
        // Grid points lie at the same pixels whatever the tile.
        let first = |at: u32| at / NOISE_GRID_PX;
        let last = |end: u32| (end - 1) / NOISE_GRID_PX + 1;
        let (gx0, gy0, gx1, gy1) = (first(rect.x0), first(rect.y0), last(rect.x1), last(rect.y1));
        let across = (gx1 - gx0 + 1) as usize;
        let mut grid = Vec::with_capacity(across * (gy1 - gy0 + 1) as usize);
        for gy in gy0..=gy1 {
            for gx in gx0..=gx1 {
                grid.push(self.noise_at(Vec2::new((gx * NOISE_GRID_PX) as f32, (gy * NOISE_GRID_PX) as f32)));
            }
        }
        let mut offsets = Vec::with_capacity(rect.area());
        for y in rect.y0..rect.y1 {
            let row = (y / NOISE_GRID_PX - gy0) as usize * across;
            let v = (y % NOISE_GRID_PX) as f32 / NOISE_GRID_PX as f32;
            for x in rect.x0..rect.x1 {
                let at = row + (x / NOISE_GRID_PX - gx0) as usize;
                let u = (x % NOISE_GRID_PX) as f32 / NOISE_GRID_PX as f32;
                let top = grid[at].lerp(grid[at + 1], u);
                let bottom = grid[at + across].lerp(grid[at + across + 1], u);
                offsets.push(self.turned(top.lerp(bottom, v)));
            }
        }
        offsets
    }
}

/// One layer over a tile and what lies around it.
pub(super) struct LayerWindow {
    /// Premultiplied.
    pub colour: Vec<[f32; 4]>,
    pub ink: Vec<f32>,
    /// Of the surface or the line; +∞ where there is neither.
    pub depth: Vec<f32>,
}

/// The layers of a tile and of the pixels within reach of it.
pub(super) struct Window {
    /// Of its first pixel; may lie outside of the picture.
    x0: i32,
    y0: i32,
    across: usize,
    pub layers: Vec<LayerWindow>,
}

/// Where four pixels meet, by what shares.
pub(super) struct Tap {
    corner: usize,
    across: usize,
    shares: [f32; 4],
    pub nearest: usize,
}

impl Tap {
    #[inline]
    fn corners(&self) -> [usize; 4] {
        [self.corner, self.corner + 1, self.corner + self.across, self.corner + self.across + 1]
    }

    #[inline]
    pub fn mix(&self, of: &[f32]) -> f32 {
        self.corners().iter().zip(self.shares).map(|(&i, share)| share * of[i]).sum()
    }

    #[inline]
    pub fn mix_colour(&self, of: &[[f32; 4]]) -> [f32; 4] {
        let mut mixed = [0.0; 4];
        for (i, share) in self.corners().into_iter().zip(self.shares) {
            (0..4).for_each(|c| mixed[c] += share * of[i][c]);
        }
        mixed
    }
}

impl Window {
    /// Around tile `index`, `reach` pixels in each direction; `surfaces` are those of all tiles of the strip, `most` layers of
    /// them.
    /// `repeated` says in which layers lines are.
    pub fn new(
        strip: &Strip,
        index: usize,
        reach: u32,
        samples: u32,
        surfaces: &[Vec<[f32; 4]>],
        most: usize,
        repeated: bool,
    ) -> Self {
        let rect = strip.tiles[index].rect;
        // One more for the second of two pixels that a lookup lies between.
        let reach = reach as i32 + 1;
        let (x0, y0) = (rect.x0 as i32 - reach, rect.y0 as i32 - reach);
        let across = (rect.width() as i32 + 2 * reach) as usize;
        let down = (rect.height() as i32 + 2 * reach) as usize;
        let mut window = Self { x0, y0, across, layers: Vec::new() };
        for near in strip.around(index) {
            let tile = &strip.tiles[near];
            let clip = |at: u32, low: i32, len: usize| (at as i32).clamp(low, low + len as i32) as u32;
            let (cx0, cx1) = (clip(tile.rect.x0, x0.max(0), across), clip(tile.rect.x1, x0, across));
            let (cy0, cy1) = (clip(tile.rect.y0, y0.max(0), down), clip(tile.rect.y1, y0, down));
            if cx0 >= cx1 || cy0 >= cy1 {
                continue;
            }
            let surfaces = &surfaces[near];
            for y in cy0..cy1 {
                for x in cx0..cx1 {
                    let pixel = ((y - tile.rect.y0) * tile.rect.width() + (x - tile.rect.x0)) as usize;
                    let place = (y as i32 - y0) as usize * across + (x as i32 - x0) as usize;
                    let of_pixel = tile.offsets[pixel] as usize..tile.offsets[pixel + 1] as usize;
                    let mut seen = [0u16; crate::layers::MAX_SAMPLES as usize];
                    for index in of_pixel {
                        let boundary = &tile.boundaries[index];
                        let [r, g, b, a] = surfaces[index];
                        // A boundary may be the k-th of one sample and another of the next.
                        for sample in (0..samples).filter(|s| boundary.samples >> s & 1 == 1) {
                            let layer = &mut seen[sample as usize];
                            if usize::from(*layer) >= most {
                                continue;
                            }
                            let share = a / samples as f32;
                            let of_layer = window.layer(usize::from(*layer), down);
                            let colour = &mut of_layer.colour[place];
                            for (sum, c) in colour.iter_mut().zip([r, g, b, 1.0]) {
                                *sum += share * c;
                            }
                            of_layer.depth[place] = of_layer.depth[place].min(boundary.depth);
                            *layer += 1;
                        }
                    }
                }
            }
        }
        // Lines of all tiles around, over the part of the window that the picture has.
        let near: Vec<PixelRect> = strip.around(index).map(|near| strip.tiles[near].rect).collect();
        let (first, last) = (near[0], near[near.len() - 1]);
        let seen = PixelRect {
            x0: first.x0.max(x0.max(0) as u32),
            y0: first.y0.max(y0.max(0) as u32),
            x1: last.x1.min((x0 + across as i32) as u32),
            y1: last.y1.min((y0 + down as i32) as u32),
        };
        let lines = strip.lines(index, seen, repeated);
        for layer in 0..lines.len() {
            let Some(map) = lines.layer(layer) else { continue };
            let of_layer = window.layer(layer, down);
            for (pixel, &ink) in map.ink.iter().enumerate().filter(|(_, ink)| **ink > 0.0) {
                let (x, y) = (seen.x0 + pixel as u32 % seen.width(), seen.y0 + pixel as u32 / seen.width());
                let place = (y as i32 - y0) as usize * across + (x as i32 - x0) as usize;
                of_layer.ink[place] = ink;
                of_layer.depth[place] = of_layer.depth[place].min(map.depth[pixel]);
            }
        }
        window
    }

    fn layer(&mut self, layer: usize, down: usize) -> &mut LayerWindow {
        let area = self.across * down;
        while self.layers.len() <= layer {
            self.layers.push(LayerWindow {
                colour: vec![[0.0; 4]; area],
                ink: vec![0.0; area],
                depth: vec![f32::INFINITY; area],
            });
        }
        &mut self.layers[layer]
    }

    /// The pixels around a position, in pixel indices: whole numbers are pixels' middles.
    pub fn tap(&self, at: Vec2) -> Tap {
        let low = at.floor();
        let (u, v) = (at.x - low.x, at.y - low.y);
        let corner = (low.y as i32 - self.y0) as usize * self.across + (low.x as i32 - self.x0) as usize;
        let nearest = corner + usize::from(u >= 0.5) + if v >= 0.5 { self.across } else { 0 };
        let shares = [(1.0 - u) * (1.0 - v), u * (1.0 - v), (1.0 - u) * v, u * v];
        Tap { corner, across: self.across, shares, nearest }
    }
}
