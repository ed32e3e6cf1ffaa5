//! Other scene content between the layers: pictures with depth, such as another renderer's, composed pixel by pixel.
//!
//! *Theory.* Blueprint 2006 §6 and Sketchy 2006 §4 keep the depth of what they draw, as a depth sprite, so that other content
//! can stand before, behind and within the result. Here the other content is the sprite: at each pixel its colour is a layer
//! of its own, at its own depth.
//!
//! *Practice.* Where every layer is drawn in its place, content takes its place among them: `layered` does that. A sketch looks its
//! layers up beside their places, so its finished picture is composed by the depth of the nearest thing that it shows:
//! [`compose`]. Content has one depth a pixel; it covers all samples of the pixel
//! alike. Colours are linear and premultiplied while they are blended. At equal depth the result is in front.

use rayon::prelude::*;

use super::picture::Picture;
use crate::formats::depth_picture::DepthPicture;

/// What another picture shows at one pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Content {
    /// Planar view depth, world units.
    pub depth: f32,
    /// Premultiplied linear RGB and alpha.
    pub colour: [f32; 4],
}

/// Light gathered front to back, premultiplied.
#[derive(Debug, Clone, Copy)]
struct Ray {
    light: [f32; 3],
    through: f32,
    depth: f32,
}

impl Ray {
    const FRESH: Self = Self { light: [0.0; 3], through: 1.0, depth: f32::INFINITY };

    /// Passes something of a premultiplied colour.
    fn pass(&mut self, [r, g, b, alpha]: [f32; 4], depth: f32) {
        for (light, c) in self.light.iter_mut().zip([r, g, b]) {
            *light += self.through * c;
        }
        self.through *= 1.0 - alpha;
        if alpha > 0.0 {
            self.depth = self.depth.min(depth);
        }
    }
}

/// Premultiplied.
fn premultiplied([r, g, b, a]: [f32; 4]) -> [f32; 4] {
    [r * a, g * a, b * a, a]
}

/// Straight alpha, from gathered light.
fn straight(light: [f32; 3], through: f32) -> [f32; 4] {
    let alpha = 1.0 - through;
    if alpha > 0.0 { [light[0] / alpha, light[1] / alpha, light[2] / alpha, alpha] } else { [0.0; 4] }
}

/// Pictures that are composed with the result.
#[derive(Debug, Clone, Default)]
pub struct Contents {
    pictures: Vec<DepthPicture>,
}

impl Contents {
    /// Of pictures that all have the size of the picture that they join.
    pub fn new(pictures: Vec<DepthPicture>) -> Self {
        Self { pictures }
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.pictures.is_empty()
    }

    /// What the pictures show at pixel (`x`, `y`), front to back, into `found`.
    pub fn at(&self, x: u32, y: u32, found: &mut Vec<Content>) {
        found.clear();
        for picture in &self.pictures {
            let index = y as usize * picture.width as usize + x as usize;
            let (depth, colour) = (picture.depth[index], picture.pixels[index]);
            if depth < f32::INFINITY && colour != [0.0; 4] {
                found.push(Content { depth, colour });
            }
        }
        found.sort_by(|a, b| a.depth.total_cmp(&b.depth));
    }
}

/// Puts `contents` before and behind a finished `picture` that was drawn over nothing, by the depth of the nearest thing
/// that each pixel shows, and all over `background`. A picture without depths lies behind all content. What the contents cover
/// is not counted as covered.
pub fn compose(picture: &mut Picture, contents: &Contents, background: [f32; 4]) {
    let width = picture.width as usize;
    let mut depths = picture.depth.take().unwrap_or_else(|| vec![f32::INFINITY; picture.pixels.len()]);
    let rows = picture.pixels.par_chunks_mut(width.max(1)).zip(depths.par_chunks_mut(width.max(1)));
    rows.enumerate().for_each(|(y, (pixels, depths))| {
        let mut found = Vec::new();
        for (x, (pixel, depth)) in pixels.iter_mut().zip(depths).enumerate() {
            contents.at(x as u32, y as u32, &mut found);
            let mut ray = Ray::FRESH;
            let in_front = found.partition_point(|content| content.depth < *depth);
            found[..in_front].iter().for_each(|content| ray.pass(content.colour, content.depth));
            ray.pass(premultiplied(*pixel), *depth);
            found[in_front..].iter().for_each(|content| ray.pass(content.colour, content.depth));
            *depth = ray.depth;
            ray.pass(premultiplied(background), f32::INFINITY);
            *pixel = straight(ray.light, ray.through);
        }
    });
    picture.has_alpha = background[3] < 1.0;
    picture.depth = Some(depths);
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::super::canvas::TileRows;
    use super::super::layered::{Inks, Layers};
    use super::super::strokes::LineMaps;
    use super::*;
    use crate::layers::{Boundary, Facing, LayerTile};
    use crate::scene::style::{Style, StyleKind};
    use crate::space::PixelRect;

    const WHITE: [f32; 4] = [1.0; 4];
    const CLEAR: [f32; 4] = [0.0; 4];

    fn boundary(depth: f32, colour: [f32; 3], opacity: f32, samples: u16) -> Boundary {
        let normal = Vec3::NEG_Y;
        Boundary { depth, normal, colour, opacity, leaf: 0, body: 0, facing: Facing::Front, samples }
    }

    fn near(got: [f32; 4], wanted: [f32; 4]) {
        assert!(got.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-6), "{got:?} instead of {wanted:?}");
    }

    /// One pixel of unlit layers with contents among them, and its depth.
    fn blended(boundaries: &[Boundary], contents: &[Content], samples: u32, background: [f32; 4]) -> ([f32; 4], f32) {
        let rect = PixelRect { x0: 0, y0: 0, x1: 1, y1: 1 };
        let tile = LayerTile { rect, offsets: vec![0, boundaries.len() as u32], boundaries: boundaries.to_vec() };
        let surfaces: Vec<[f32; 4]> =
            boundaries.iter().map(|b| [b.colour[0], b.colour[1], b.colour[2], b.opacity]).collect();
        let picture = |c: &Content| DepthPicture { width: 1, height: 1, pixels: vec![c.colour], depth: vec![c.depth] };
        let contents = Contents::new(contents.iter().map(picture).collect());
        let inks = Inks::new(&Style::of(StyleKind::Transparent), background);
        let lines = LineMaps::default();
        let layers = Layers { tile: &tile, lines: &lines, samples, inks: &inks, contents: &contents, background };
        let (mut pixel, mut depth) = ([CLEAR], [0.0]);
        let mut rows = TileRows { pixels: vec![&mut pixel], depth: vec![&mut depth] };
        layers.compose(|number| surfaces[number], &mut rows);
        (pixel[0], depth[0])
    }

    #[test]
    fn content_stands_where_its_depth_says() {
        let (red, green) = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]);
        let glass = [boundary(1.0, red, 0.5, 1), boundary(3.0, green, 0.5, 1)];
        let blue = |depth: f32| [Content { depth, colour: [0.0, 0.0, 0.5, 0.5] }];
        // Before, between and behind two panes, over white: c = Σ αᵢ cᵢ Π (1 − αⱼ).
        for (depth, wanted, nearest) in [
            (0.5, [0.25 + 0.125, 0.125 + 0.125, 0.5 + 0.125, 1.0], 0.5),
            (2.0, [0.5 + 0.125, 0.125 + 0.125, 0.25 + 0.125, 1.0], 1.0),
            (4.0, [0.5 + 0.125, 0.25 + 0.125, 0.125 + 0.125, 1.0], 1.0),
        ] {
            let (colour, shown) = blended(&glass, &blue(depth), 1, WHITE);
            near(colour, wanted);
            assert_eq!(shown, nearest);
        }
        // Opaque content hides what is behind it.
        let wall = [Content { depth: 0.5, colour: [0.2, 0.3, 0.4, 1.0] }];
        near(blended(&glass, &wall, 1, CLEAR).0, [0.2, 0.3, 0.4, 1.0]);
        // Equal depths: the result is in front.
        let flush = [Content { depth: 1.0, colour: [0.0, 0.0, 1.0, 1.0] }];
        near(blended(&[boundary(1.0, red, 1.0, 1)], &flush, 1, WHITE).0, [1.0, 0.0, 0.0, 1.0]);
    }

    #[test]
    fn samples_are_blended_each_on_its_own_and_nothing_is_clear() {
        let half = [boundary(2.0, [1.0, 0.0, 0.0], 1.0, 0b0011)];
        let behind = [Content { depth: 3.0, colour: [0.0, 1.0, 0.0, 1.0] }];
        let (colour, depth) = blended(&half, &behind, 4, WHITE);
        near(colour, [0.5, 0.5, 0.0, 1.0]);
        assert_eq!(depth, 2.0);
        assert_eq!(blended(&[], &[], 4, CLEAR), (CLEAR, f32::INFINITY));
        near(blended(&[], &behind, 4, CLEAR).0, [0.0, 1.0, 0.0, 1.0]);
    }

    #[test]
    fn without_lines_a_finished_picture_is_composed_as_its_only_layer_would_be() {
        let contents = Contents::new(vec![
            DepthPicture {
                width: 3,
                height: 1,
                pixels: vec![[0.0, 0.0, 0.5, 0.5]; 3],
                depth: vec![1.0, 3.0, f32::INFINITY],
            },
            DepthPicture { width: 3, height: 1, pixels: vec![[0.1, 0.0, 0.0, 0.2]; 3], depth: vec![5.0, 0.5, 7.0] },
        ]);
        let paper = [0.9, 0.8, 0.7, 1.0];
        let mut picture = Picture {
            width: 3,
            height: 1,
            pixels: vec![[0.3, 0.6, 0.2, 0.4], [0.3, 0.6, 0.2, 0.4], CLEAR],
            depth: Some(vec![2.0, 2.0, f32::INFINITY]),
            covered: 2,
            has_alpha: true,
        };
        compose(&mut picture, &contents, paper);
        let mut found = Vec::new();
        for x in 0..3 {
            contents.at(x, 0, &mut found);
            let layer = boundary(2.0, [0.3, 0.6, 0.2], 0.4, 1);
            let layers = if x < 2 { &[layer][..] } else { &[] };
            let (wanted, depth) = blended(layers, &found, 1, paper);
            near(picture.at(x, 0), wanted);
            assert_eq!(picture.depth.as_ref().unwrap()[x as usize], depth);
        }
        assert_eq!((picture.covered, picture.has_alpha), (2, false));
    }
}
