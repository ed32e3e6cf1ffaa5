//! Every layer under its lines: blueprint, wireframe, edge-enhanced transparency, and what else has lines or shade.
//!
//! *Theory.* Blueprint CSG §5.3 and §5.4: the layers are blended in depth order, each with its edge map. In a blueprint the
//! edge intensity is the alpha, of one colour; a wireframe leaves out what is no edge; edge-enhanced transparency multiplies
//! a layer's shading by its edges.
//!
//! *Changes from the paper.* All three are one formula. A layer is its surface, of colour `c` and opacity `a`, under its
//! ink, which covers a share `e`: it lets (1−a)(1−e) through and adds e·ink + (1−e)·a·c. A blueprint's surface has the ink's
//! colour and an opacity that only tints, so that many layers in a row are deeper in tone (the paper's depth complexity
//! cueing); a wireframe's surface has none; edge × shade is black ink. Ink is weaker by the style's `fade` on each layer.
//! The lines of two layers are taken to cover the same part of a pixel, as far as they go: an outline is an edge of every
//! layer that ends at it, and blending it so many times over would make it wider and its borders hard.
//!
//! Shaded and transparent pictures come here too where something is drawn over or into them that needs neighbours: the
//! outlines of sections, the shade of `occlusion`, and shadows.
//!
//! *Practice.* With several samples a pixel, each sample's layers are counted and blended on their own; lines are a pixel's.
//! The picture's depth is that of the nearest thing that shows: a surface that is not quite clear, or ink that covers half
//! of the pixel.

use super::Look;
use super::lighting::Shader;
use super::merge::{Content, Contents};
use super::occlusion::{Depths, Shade};
use super::picture::Picture;
use super::shaded::{blend_one, over};
use super::shadow::Shadows;
use super::strip::{Strip, for_each_strip};
use super::strokes::LineMaps;
use crate::layers::{Boundary, LayerSource, LayerTile, TILE_SIDE};
use crate::scene::style::{Style, StyleKind};

use std::ops::Range;

use rayon::prelude::*;

/// Ink that covers less of a pixel than this gives it no depth.
pub(crate) const INK_HAS_DEPTH: f32 = 0.5;

/// The pixels of a tile, row by row.
pub(super) struct Composed {
    pub pixels: Vec<[f32; 4]>,
    pub depth: Vec<f32>,
    pub covered: u64,
}

/// Draws the layers of `source` with their lines, `contents` among them. `heavy` says by leaf whether its outline is drawn
/// stronger; `shadows` fall on surfaces that are lit.
pub(super) fn layered(
    source: &dyn LayerSource,
    look: &Look,
    style: &Style,
    heavy: &[bool],
    contents: &Contents,
    shadows: Option<&Shadows>,
    on_tile: &(dyn Fn() + Sync),
) -> Picture {
    let shader = Shader::new(&look.light, source.camera());
    let inks = Inks::new(style, look.background);
    let samples = source.samples();
    let shade = style.hollow_shade().map(|strength| Shade::new(source.camera(), strength));
    from_strips(
        source,
        look,
        style,
        heavy,
        on_tile,
        |strip| (inks.suns(strip, strip.own.clone(), shadows, source), shade.as_ref().map(|_| Depths::new(strip))),
        |strip, (suns, depths), index| {
            let tile = &strip.tiles[index];
            let lines = strip.lines(index, tile.rect, false);
            let mut surfaces = inks.surfaces(tile, &shader, samples, suns.get(index).map_or(&[], |sun| &sun[..]));
            if let (Some(shade), Some(depths)) = (&shade, depths) {
                shade.darken(strip, index, depths, &mut surfaces);
            }
            compose(tile, &lines, &surfaces, samples, &inks, contents, look.background)
        },
    )
}

/// Draws `source` strip by strip; `prepare` makes what a strip's tiles share, `compose` a tile's pixels.
pub(super) fn from_strips<P: Sync>(
    source: &dyn LayerSource,
    look: &Look,
    style: &Style,
    heavy: &[bool],
    on_tile: &(dyn Fn() + Sync),
    prepare: impl Fn(&Strip) -> P,
    compose: impl Fn(&Strip, &P, usize) -> Composed + Sync,
) -> Picture {
    let (width, height) = (source.camera().width, source.camera().height);
    let across = width as usize;
    let mut pixels = vec![[0.0; 4]; across * height as usize];
    let mut depth = vec![0.0; pixels.len()];
    let mut covered = 0;
    for_each_strip(source, style, heavy, on_tile, |strip| {
        let shared = prepare(strip);
        let (first, last) = (&strip.tiles[strip.own.start], &strip.tiles[strip.own.end - 1]);
        let places = first.rect.y0 as usize * across..last.rect.y1 as usize * across;
        let pixels = rows_of_tiles(&mut pixels[places.clone()], across);
        let depth = rows_of_tiles(&mut depth[places], across);
        let tiles = strip.own.clone().into_par_iter().zip(pixels).zip(depth);
        covered += tiles
            .map(|((index, pixels), depth)| {
                let composed = compose(strip, &shared, index);
                copy_rows(&composed.pixels, pixels);
                copy_rows(&composed.depth, depth);
                composed.covered
            })
            .sum::<u64>();
    });
    Picture { width, height, pixels, depth: Some(depth), covered, has_alpha: look.background[3] < 1.0 }
}

/// The rows of each tile of `band`, some rows of tiles of a picture `across` pixels wide.
fn rows_of_tiles<T>(band: &mut [T], across: usize) -> Vec<Vec<&mut [T]>> {
    let side = TILE_SIDE as usize;
    let mut tiles = Vec::new();
    for of_row in band.chunks_mut((across * side).max(1)) {
        let first = tiles.len();
        tiles.extend((0..across.div_ceil(side)).map(|_| Vec::with_capacity(side)));
        for line in of_row.chunks_mut(across) {
            tiles[first..].iter_mut().zip(line.chunks_mut(side)).for_each(|(rows, row)| rows.push(row));
        }
    }
    tiles
}

/// Copies a tile's values, row by row, to their `rows`.
fn copy_rows<T: Copy>(values: &[T], rows: Vec<&mut [T]>) {
    let mut rest = values;
    for row in rows {
        let (values, below) = rest.split_at(row.len());
        row.copy_from_slice(values);
        rest = below;
    }
}

/// The ink of each layer.
pub(crate) struct Inks {
    pub(crate) colour: [f32; 3],
    pub(crate) kept: f32,
    /// Whether surfaces have the ink's colour.
    pub(crate) tints: bool,
    /// Layers drawn at most.
    pub most: usize,
}

impl Inks {
    /// The inks of `style` on paper of the colour `background`.
    pub fn new(style: &Style, background: [f32; 4]) -> Self {
        let tints = matches!(style.kind, StyleKind::Blueprint | StyleKind::Wireframe);
        let most = style.max_layers.map_or(usize::MAX, |most| most as usize);
        Self { colour: style.ink(background), kept: 1.0 - style.fade.clamp(0.0, 1.0), tints, most }
    }

    /// The share of the light that reaches each boundary of the tiles `which` of `strip`, seen as `source` is; nothing where nothing
    /// keeps it off or nothing is lit.
    pub fn suns(
        &self,
        strip: &Strip,
        which: Range<usize>,
        shadows: Option<&Shadows>,
        source: &dyn LayerSource,
    ) -> Vec<Vec<f32>> {
        let of_strip = |shadows: &Shadows| shadows.of_strip(strip, which, source.camera(), source.samples());
        shadows.filter(|_| !self.tints).map(of_strip).unwrap_or_default()
    }

    /// The colours of the surfaces of each tile of `strip`, where the share of `suns` of the light arrives.
    pub fn of_strip(&self, strip: &Strip, shader: &Shader, samples: u32, suns: &[Vec<f32>]) -> Vec<Vec<[f32; 4]>> {
        let sun = |index: usize| suns.get(index).map_or(&[][..], |sun| sun);
        let tiles = strip.tiles.par_iter().enumerate();
        tiles.map(|(index, tile)| self.surfaces(tile, shader, samples, sun(index))).collect()
    }

    /// The colours of a tile's surfaces, in the order of its boundaries, with their opacities; those beyond the last layer drawn
    /// may be nothing. The share of `sun` of the light arrives, or all where that is empty.
    pub fn surfaces(&self, tile: &LayerTile, shader: &Shader, samples: u32, sun: &[f32]) -> Vec<[f32; 4]> {
        if self.tints {
            let [r, g, b] = self.colour;
            tile.boundaries.iter().map(|boundary| [r, g, b, boundary.opacity.clamp(0.0, 1.0)]).collect()
        } else {
            // The first boundaries of a pixel are the first layers of its only sample.
            shader.lit_tile(tile, if samples == 1 { self.most } else { usize::MAX }, sun)
        }
    }
}

/// What a ray has gathered so far, front to back.
pub(super) struct Gathered {
    light: [f32; 3],
    /// What the surfaces so far let through.
    through: f32,
    /// The share of the pixel that ink covers so far.
    inked: f32,
    depth: f32,
    /// Strength of the next layer's ink.
    strength: f32,
}

impl Gathered {
    pub fn new() -> Self {
        Self { light: [0.0; 3], through: 1.0, inked: 0.0, depth: f32::INFINITY, strength: 1.0 }
    }

    /// Adds a layer: ink that covers a share `ink` at `ink_depth`, over a surface of *premultiplied* colour and alpha.
    #[inline]
    pub fn add(&mut self, inks: &Inks, ink: f32, ink_depth: f32, surface: [f32; 4], surface_depth: f32) {
        if self.depth == f32::INFINITY {
            if surface[3] > 0.0 {
                self.depth = surface_depth.min(if ink > 0.0 { ink_depth } else { f32::INFINITY });
            } else if ink >= INK_HAS_DEPTH {
                self.depth = ink_depth.min(surface_depth);
            }
        }
        let inked = self.inked.max(ink * self.strength);
        let (fresh, bare) = (self.through * (inked - self.inked), self.through * (1.0 - inked));
        for ((light, ink), surface) in self.light.iter_mut().zip(inks.colour).zip(surface) {
            *light += fresh * ink + bare * surface;
        }
        self.inked = inked;
        self.through *= 1.0 - surface[3];
        self.strength *= inks.kept;
    }

    /// Adds what another picture shows, which is no layer and has no ink.
    fn add_content(&mut self, content: &Content) {
        let [r, g, b, alpha] = content.colour;
        let bare = self.transmitted();
        for (light, c) in self.light.iter_mut().zip([r, g, b]) {
            *light += bare * c;
        }
        if self.depth == f32::INFINITY && alpha > 0.0 {
            self.depth = content.depth;
        }
        self.through *= 1.0 - alpha;
    }

    /// Whether nothing deeper shows.
    #[inline]
    pub fn is_opaque(&self) -> bool {
        self.through <= 0.0
    }

    /// The share of what lies behind that shows.
    #[inline]
    fn transmitted(&self) -> f32 {
        self.through * (1.0 - self.inked)
    }
}

impl Gathered {
    /// Over `background`: linear RGB, straight alpha; and the depth.
    pub fn finish(&self, background: [f32; 4]) -> ([f32; 4], f32) {
        (over(self.light, self.transmitted(), background), self.depth)
    }
}

/// The pixels of a tile: its layers, of the lit colours and opacities `surfaces`, under their `lines`, and `contents` among
/// them.
pub(super) fn compose(
    tile: &LayerTile,
    lines: &LineMaps,
    surfaces: &[[f32; 4]],
    samples: u32,
    inks: &Inks,
    contents: &Contents,
    background: [f32; 4],
) -> Composed {
    let area = tile.rect.area();
    let (mut pixels, mut depth) = (vec![background; area], vec![f32::INFINITY; area]);
    let mut covered = 0;
    if tile.boundaries.is_empty() && lines.len() == 0 && contents.is_empty() {
        return Composed { pixels, depth, covered };
    }
    if lines.len() == 0 && samples == 1 && contents.is_empty() {
        // Surfaces alone, as most tiles of a shaded scan are.
        for (pixel, of_pixel) in tile.offsets.windows(2).enumerate().filter(|(_, of_pixel)| of_pixel[0] < of_pixel[1]) {
            let (from, to) = (of_pixel[0] as usize, of_pixel[1] as usize);
            let to = to.min(from.saturating_add(inks.most));
            let shown = surfaces[from..to].iter().position(|surface| surface[3] > 0.0);
            depth[pixel] = shown.map_or(f32::INFINITY, |first| tile.boundaries[from + first].depth);
            pixels[pixel] = blend_one(&surfaces[from..to], background);
            covered += 1;
        }
        return Composed { pixels, depth, covered };
    }
    let ink_at = |layer: usize, pixel: usize| {
        lines.layer(layer).map_or((0.0, f32::INFINITY), |map| (map.ink[pixel], map.depth[pixel]))
    };
    let is_crossed = crossed(lines, area);
    let mut found = Vec::new();
    for pixel in 0..area {
        let (from, to) = (tile.offsets[pixel] as usize, tile.offsets[pixel + 1] as usize);
        covered += u64::from(from < to);
        if samples == 1 && contents.is_empty() && !is_crossed[pixel] {
            if from < to {
                let to = to.min(from.saturating_add(inks.most));
                (pixels[pixel], depth[pixel]) = bare(&tile.boundaries[from..to], &surfaces[from..to], background);
            }
            continue;
        }
        let (x, y) = (pixel as u32 % tile.rect.width(), pixel as u32 / tile.rect.width());
        contents.at(tile.rect.x0 + x, tile.rect.y0 + y, &mut found);
        if from == to && found.is_empty() && (0..lines.len()).all(|layer| ink_at(layer, pixel).0 == 0.0) {
            continue;
        }
        let (mut light, mut through) = ([0.0; 3], 0.0);
        for sample in 0..samples {
            let mut gathered = Gathered::new();
            let mut layer = 0;
            let mut waiting = found.iter().peekable();
            for (boundary, &[r, g, b, a]) in tile.boundaries[from..to].iter().zip(&surfaces[from..to]) {
                if samples > 1 && boundary.samples >> sample & 1 == 0 {
                    continue;
                }
                while let Some(content) = waiting.next_if(|content| content.depth < boundary.depth) {
                    gathered.add_content(content);
                }
                let (ink, ink_depth) = ink_at(layer, pixel);
                gathered.add(inks, ink, ink_depth, [a * r, a * g, a * b, a], boundary.depth);
                layer += 1;
                if gathered.is_opaque() || layer >= inks.most {
                    break;
                }
            }
            // Lines stand half a width over the border of their surface.
            while layer < lines.len() && !gathered.is_opaque() {
                let (ink, ink_depth) = ink_at(layer, pixel);
                while let Some(content) = waiting.next_if(|content| content.depth < ink_depth && ink > 0.0) {
                    gathered.add_content(content);
                }
                gathered.add(inks, ink, ink_depth, [0.0; 4], f32::INFINITY);
                layer += 1;
            }
            waiting.for_each(|content| gathered.add_content(content));
            (0..3).for_each(|c| light[c] += gathered.light[c]);
            through += gathered.transmitted();
            depth[pixel] = depth[pixel].min(gathered.depth);
        }
        let share = 1.0 / samples as f32;
        pixels[pixel] = over(light.map(|c| c * share), through * share, background);
    }
    Composed { pixels, depth, covered }
}

/// By pixel, of `area`, whether a line of any layer crosses it.
fn crossed(lines: &LineMaps, area: usize) -> Vec<bool> {
    let mut crossed = vec![false; area];
    for map in (0..lines.len()).filter_map(|layer| lines.layer(layer)) {
        crossed.iter_mut().zip(&map.ink).for_each(|(crossed, ink)| *crossed |= *ink != 0.0);
    }
    crossed
}

/// A pixel of one sample that no line crosses, and its depth: what [`Gathered`] makes of it, which adds zeros for ink.
#[inline]
fn bare(boundaries: &[Boundary], surfaces: &[[f32; 4]], background: [f32; 4]) -> ([f32; 4], f32) {
    let (mut light, mut through, mut depth) = ([0.0; 3], 1.0, f32::INFINITY);
    for (boundary, &[r, g, b, a]) in boundaries.iter().zip(surfaces) {
        if a > 0.0 && depth == f32::INFINITY {
            depth = boundary.depth;
        }
        light = [light[0] + through * (a * r), light[1] + through * (a * g), light[2] + through * (a * b)];
        through *= 1.0 - a;
        if through <= 0.0 {
            break;
        }
    }
    (over(light, through, background), depth)
}
