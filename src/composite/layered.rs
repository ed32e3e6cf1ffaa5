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
use super::canvas::{Canvas, TileRows};
use super::lighting::Shader;
use super::merge::{Content, Contents};
use super::occlusion::{Depths, Shade};
use super::picture::Picture;
use super::shaded::over;
use super::shadow::Shadows;
use super::strip::{Strip, for_each_strip};
use super::strokes::LineMaps;
use super::window::Surfaces;
use crate::layers::{Boundary, LayerSource, LayerTile};
use crate::scene::style::{Style, StyleKind};

use std::ops::Range;

use rayon::prelude::*;

/// Ink that covers less of a pixel than this gives it no depth.
pub(crate) const INK_HAS_DEPTH: f32 = 0.5;

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
        |strip, (suns, depths), index, rows| {
            let tile = &strip.tiles[index];
            let lines = strip.lines(index, tile.rect, false);
            let layers = Layers { tile, lines: &lines, samples, inks: &inks, contents, background: look.background };
            if inks.tints {
                return layers.compose(|number| inks.tint(&tile.boundaries[number]), rows);
            }
            let mut surfaces = shader.lit_tile(tile, inks.lit(samples), suns.get(index).map_or(&[], |sun| &sun[..]));
            if let (Some(shade), Some(depths)) = (&shade, depths) {
                shade.darken(strip, index, depths, &mut surfaces);
            }
            layers.compose(|number| surfaces[number], rows)
        },
    )
}

/// Draws `source` strip by strip; `prepare` makes what a strip's tiles share, `compose` draws a tile into its rows and returns
/// how many of its pixels show a surface.
pub(super) fn from_strips<P: Sync>(
    source: &dyn LayerSource,
    look: &Look,
    style: &Style,
    heavy: &[bool],
    on_tile: &(dyn Fn() + Sync),
    prepare: impl Fn(&Strip) -> P,
    compose: impl Fn(&Strip, &P, usize, &mut TileRows) -> u64 + Sync,
) -> Picture {
    let mut canvas = Canvas::new(source.camera().width, source.camera().height);
    let mut covered = 0;
    for_each_strip(source, style, heavy, on_tile, |strip| {
        let shared = prepare(strip);
        let (first, last) = (strip.tiles[strip.own.start].rect, strip.tiles[strip.own.end - 1].rect);
        let tiles = strip.own.clone().into_par_iter().zip(canvas.tiles(first.y0, last.y1));
        covered += tiles.map(|(index, mut rows)| compose(strip, &shared, index, &mut rows)).sum::<u64>();
    });
    canvas.finish(covered, look.background[3] < 1.0)
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

    /// The surfaces of all tiles of `strip`, where the share of `suns` of the light arrives: those that look beside a pixel look into
    /// the tiles around too.
    pub(super) fn of_strip(&self, strip: &Strip, shader: &Shader, samples: u32, suns: &[Vec<f32>]) -> Surfaces {
        Surfaces::new(strip, samples, self.most, |index, lit| {
            let tile = &strip.tiles[index];
            if self.tints {
                lit.iter_mut().zip(&tile.boundaries).for_each(|(lit, boundary)| *lit = self.tint(boundary));
            } else {
                shader.light_tile(tile, self.lit(samples), suns.get(index).map_or(&[], |sun| &sun[..]), lit);
            }
        })
    }

    /// The colour and opacity of a surface that has the ink's.
    #[inline(always)]
    fn tint(&self, boundary: &Boundary) -> [f32; 4] {
        let [r, g, b] = self.colour;
        [r, g, b, boundary.opacity.clamp(0.0, 1.0)]
    }

    /// Boundaries of a pixel that are lit: the first ones are the first layers of its only sample.
    fn lit(&self, samples: u32) -> usize {
        if samples == 1 { self.most } else { usize::MAX }
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

/// What a tile's pixels are composed of.
pub(super) struct Layers<'a> {
    pub tile: &'a LayerTile,
    pub lines: &'a LineMaps,
    pub samples: u32,
    pub inks: &'a Inks,
    /// What stands among the layers.
    pub contents: &'a Contents,
    pub background: [f32; 4],
}

impl Layers<'_> {
    /// Draws the layers, with the colours and opacities of `surface` by the number of the boundary, under their lines. Returns how
    /// many pixels show a surface.
    pub fn compose(&self, surface: impl Fn(usize) -> [f32; 4] + Copy, rows: &mut TileRows) -> u64 {
        let Self { tile, lines, samples, inks, contents, background } = *self;
        if tile.boundaries.is_empty() && lines.len() == 0 && contents.is_empty() {
            rows.clear(background);
            return 0;
        }
        let are_surfaces_alone = samples == 1 && contents.is_empty();
        let across = tile.rect.width() as usize;
        let mut covered = 0;
        let mut found = Vec::new();
        for (row, (pixels, depths)) in rows.pixels.iter_mut().zip(&mut rows.depth).enumerate() {
            let first = row * across;
            let offsets = &tile.offsets[first..=first + across];
            for (column, ((of_pixel, pixel), depth)) in
                offsets.windows(2).zip(pixels.iter_mut()).zip(depths.iter_mut()).enumerate()
            {
                let of_pixel = of_pixel[0] as usize..of_pixel[1] as usize;
                covered += u64::from(!of_pixel.is_empty());
                if are_surfaces_alone && !lines.cross(first + column) {
                    let to = of_pixel.end.min(of_pixel.start.saturating_add(inks.most));
                    (*pixel, *depth) = match of_pixel.is_empty() {
                        true => (background, f32::INFINITY),
                        false => self.bare(of_pixel.start..to, surface),
                    };
                    continue;
                }
                let (x, y) = (tile.rect.x0 + column as u32, tile.rect.y0 + row as u32);
                contents.at(x, y, &mut found);
                (*pixel, *depth) = match of_pixel.is_empty() && found.is_empty() && !lines.cross(first + column) {
                    true => (background, f32::INFINITY),
                    false => self.inked(first + column, of_pixel, surface, &found),
                };
            }
        }
        covered
    }

    /// A pixel of the boundaries `of_pixel` under its lines, with what is `found` among them; and its depth.
    #[inline(never)]
    fn inked(
        &self,
        pixel: usize,
        of_pixel: Range<usize>,
        surface: impl Fn(usize) -> [f32; 4],
        found: &[Content],
    ) -> ([f32; 4], f32) {
        let Self { tile, lines, samples, inks, background, .. } = *self;
        let ink_at =
            |layer: usize| lines.layer(layer).map_or((0.0, f32::INFINITY), |map| (map.ink[pixel], map.depth[pixel]));
        let (mut light, mut through, mut depth) = ([0.0; 3], 0.0, f32::INFINITY);
        for sample in 0..samples {
            let mut gathered = Gathered::new();
            let mut layer = 0;
            let mut waiting = found.iter().peekable();
            for number in of_pixel.clone() {
                let boundary = &tile.boundaries[number];
                if samples > 1 && boundary.samples >> sample & 1 == 0 {
                    continue;
                }
                while let Some(content) = waiting.next_if(|content| content.depth < boundary.depth) {
                    gathered.add_content(content);
                }
                let ((ink, ink_depth), [r, g, b, a]) = (ink_at(layer), surface(number));
                gathered.add(inks, ink, ink_depth, [a * r, a * g, a * b, a], boundary.depth);
                layer += 1;
                if gathered.is_opaque() || layer >= inks.most {
                    break;
                }
            }
            // Lines stand half a width over the border of their surface.
            while layer < lines.len() && !gathered.is_opaque() {
                let (ink, ink_depth) = ink_at(layer);
                while let Some(content) = waiting.next_if(|content| content.depth < ink_depth && ink > 0.0) {
                    gathered.add_content(content);
                }
                gathered.add(inks, ink, ink_depth, [0.0; 4], f32::INFINITY);
                layer += 1;
            }
            waiting.for_each(|content| gathered.add_content(content));
            (0..3).for_each(|c| light[c] += gathered.light[c]);
            through += gathered.transmitted();
            depth = depth.min(gathered.depth);
        }
        let share = 1.0 / samples as f32;
        (over(light.map(|c| c * share), through * share, background), depth)
    }

    /// A pixel of one sample that no line crosses, and its depth: what [`Gathered`] makes of it, which adds zeros for ink.
    #[inline(always)]
    fn bare(&self, of_pixel: Range<usize>, surface: impl Fn(usize) -> [f32; 4]) -> ([f32; 4], f32) {
        let (mut light, mut through, mut depth) = ([0.0; 3], 1.0, f32::INFINITY);
        for number in of_pixel {
            let [r, g, b, a] = surface(number);
            if a > 0.0 && depth == f32::INFINITY {
                depth = self.tile.boundaries[number].depth;
            }
            light = [light[0] + through * (a * r), light[1] + through * (a * g), light[2] + through * (a * b)];
            through *= 1.0 - a;
            if through <= 0.0 {
                break;
            }
        }
        (over(light, through, self.background), depth)
    }
}
