//! What a style is made of, as pictures: each layer's depth, normals, colours and lines (Blueprint Fig. 3), and for a sketch
//! the noise and what it makes of them (Sketchy Figs. 3 and 4).

use fearless_simd::Level;
use glam::{Vec2, Vec3};

use super::facets::central_sample;
use super::layered::Inks;
use super::lighting::Shader;
use super::shadow::Shadows;
use super::sketchy::Hand;
use super::strip::for_each_strip;
use super::styled::prepared;
use super::window::Window;
use super::{Leaves, Look};
use crate::layers::LayerSource;
use crate::scene::colour::srgb_byte_from_linear;
use crate::scene::style::{Style, StyleKind};

/// One map, 8-bit RGB.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Map {
    /// Fit for a file: `layer1_edges`, `noise`.
    pub name: String,
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// Red, green and blue, row by row.
    pub rgb: Vec<u8>,
}

/// A map while it is made.
struct Growing<T> {
    name: String,
    values: Vec<T>,
}

/// The maps of each layer.
struct OfLayer {
    depth: Growing<f32>,
    bytes: Vec<Growing<[u8; 3]>>,
    perturbed_depth: Option<Growing<f32>>,
}

/// The kinds of a layer's maps that are bytes, in the order of [`OfLayer::bytes`].
const BYTE_MAPS: [&str; 5] = ["normals", "colours", "edges", "perturbed_colours", "perturbed_edges"];
/// Those of every style.
const PLAIN_MAPS: usize = 3;
/// Behind everything.
const EMPTY: [u8; 3] = [255; 3];

/// Bytes that the maps of `layers` layers take for each pixel of a picture in `style`.
pub fn bytes_per_pixel(style: &Style, layers: usize) -> u64 {
    let is_sketchy = style.kind == StyleKind::Sketchy;
    let [depth, bytes] = [size_of::<f32>() as u64, size_of::<[u8; 3]>() as u64];
    let of_layer = match is_sketchy {
        true => 2 * depth + BYTE_MAPS.len() as u64 * bytes,
        false => depth + PLAIN_MAPS as u64 * bytes,
    };
    let noise = if is_sketchy { bytes } else { 0 };
    let most = style.max_layers.map_or(usize::MAX, |most| most as usize);
    // Depths become bytes one map at a time.
    layers.min(most) as u64 * of_layer + noise + bytes
}

/// The maps of `source` drawn in `style`; lines are found for styles without lines too. Depth is white at the nearest surface of
/// all layers and dark at the deepest; normals are in view space, x, y and −z as red, green and blue.
pub fn maps(
    source: &dyn LayerSource,
    look: &Look,
    style: &Style,
    leaves: Leaves,
    shadows: Option<&Shadows>,
) -> Vec<Map> {
    // Surfaces are shown whole, whatever their opacity in the style.
    let whole = Style { kind: StyleKind::EdgeTransparent, opacity: 1.0, ..*style };
    prepared(source, &whole, leaves, None, |source| maps_of(source, look, [style, &whole], leaves, shadows))
}

/// The maps of `source`, whose colours are those of the style `whole`.
fn maps_of(
    source: &dyn LayerSource,
    look: &Look,
    [style, whole]: [&Style; 2],
    leaves: Leaves,
    shadows: Option<&Shadows>,
) -> Vec<Map> {
    let camera = source.camera();
    let (width, height) = (camera.width, camera.height);
    let area = width as usize * height as usize;
    // Lines are found in any style.
    let lined = if style.kind.has_lines() { *style } else { *whole };
    let hand = (style.kind == StyleKind::Sketchy).then(|| Hand::new(&style.sketch));
    let shader = Shader::new(&look.light, camera);
    let inks = Inks::new(whole, look.background);
    let samples = source.samples();
    let sample = central_sample(samples);
    let mut layers: Vec<OfLayer> = Vec::new();
    let mut noise: Option<Vec<[u8; 3]>> = hand.as_ref().map(|_| vec![EMPTY; area]);
    let view_axes = [camera.right.as_vec3(), -camera.down.as_vec3(), -camera.forward.as_vec3()];
    for_each_strip(source, &lined, leaves.heavy, &|| (), |strip| {
        let suns = inks.suns(strip, 0..strip.tiles.len(), shadows, source);
        let surfaces = hand.as_ref().map(|_| inks.of_strip(strip, &shader, samples, &suns));
        for index in strip.own.clone() {
            let tile = &strip.tiles[index];
            let rect = tile.rect;
            let lines = strip.lines(index, rect, true);
            let place = |pixel: usize| {
                let (x, y) = (rect.x0 + pixel as u32 % rect.width(), rect.y0 + pixel as u32 / rect.width());
                (y * width + x) as usize
            };
            // A sketch looks into the tiles around too.
            let around = strip.around(index).flat_map(|near| strip.tiles[near].offsets.windows(2));
            let longest = around.map(|w| (w[1] - w[0]) as usize).max().unwrap_or(0);
            let count = longest.max(lines.len()).min(inks.most);
            for number in layers.len()..count {
                layers.push(OfLayer::new(number, area, hand.is_some()));
            }
            let lit = shader.lit_tile(tile, usize::MAX, suns.get(index).map_or(&[], |sun| &sun[..]));
            for (pixel, of_pixel) in tile.offsets.windows(2).enumerate() {
                let at = place(pixel);
                let of_pixel = of_pixel[0] as usize..of_pixel[1] as usize;
                for (layer, index) in
                    of_pixel.filter(|&i| tile.boundaries[i].samples >> sample & 1 == 1).take(count).enumerate()
                {
                    let boundary = &tile.boundaries[index];
                    let normal = Vec3::from(view_axes.map(|axis| axis.dot(boundary.normal)));
                    layers[layer].depth.values[at] = boundary.depth;
                    layers[layer].bytes[0].values[at] =
                        normal.to_array().map(|n| (127.5 + 127.5 * n).clamp(0.0, 255.0) as u8);
                    layers[layer].bytes[1].values[at] = [0, 1, 2].map(|c| srgb_byte_from_linear(lit[index][c]));
                }
                for (number, layer) in layers.iter_mut().enumerate() {
                    if let Some(map) = lines.layer(number) {
                        layer.bytes[2].values[at] = grey(1.0 - map.ink[pixel]);
                    }
                }
            }
            let (Some(hand), Some(surfaces), Some(noise)) = (&hand, &surfaces, &mut noise) else { continue };
            let offsets = hand.offsets(Level::new(), rect);
            let window = Window::new(strip, index, offsets.bounds, surfaces, true);
            let count = window.layers();
            for pixel in 0..rect.area() {
                let (at, middle) = (
                    place(pixel),
                    Vec2::new((pixel as u32 % rect.width()) as f32, (pixel as u32 / rect.width()) as f32),
                );
                let p = middle + Vec2::new(rect.x0 as f32, rect.y0 as f32);
                let values = hand.noise_at(p);
                noise[at] = [values.x, values.y, 0.0].map(|n| (127.5 + 127.5 * n).clamp(0.0, 255.0) as u8);
                let [at_edge, at_shade] = offsets.at(pixel).map(|offset| window.tap(p + offset));
                let seen = window.surfaces(&at_shade);
                for (number, layer) in layers.iter_mut().enumerate().take(count) {
                    let [r, g, b, a] = window.colour(&seen, number).to_array();
                    if a > 0.0 {
                        layer.bytes[3].values[at] = [r / a, g / a, b / a].map(srgb_byte_from_linear);
                    }
                    layer.bytes[4].values[at] = grey(1.0 - window.ink(&at_edge, number));
                    if let Some(depth) = &mut layer.perturbed_depth {
                        depth.values[at] = window.depth(&at_edge, number).min(window.depth(&at_shade, number));
                    }
                }
            }
        }
    });
    finished(layers, noise, width, height)
}

impl OfLayer {
    fn new(number: usize, area: usize, sketchy: bool) -> Self {
        let count = if sketchy { BYTE_MAPS.len() } else { PLAIN_MAPS };
        let named = |kind: &str| format!("layer{}_{kind}", number + 1);
        let bytes = BYTE_MAPS[..count].iter();
        Self {
            depth: Growing { name: named("depth"), values: vec![f32::INFINITY; area] },
            bytes: bytes.map(|kind| Growing { name: named(kind), values: vec![EMPTY; area] }).collect(),
            perturbed_depth: sketchy
                .then(|| Growing { name: named("perturbed_depth"), values: vec![f32::INFINITY; area] }),
        }
    }
}

fn grey(value: f32) -> [u8; 3] {
    [(255.0 * value).round().clamp(0.0, 255.0) as u8; 3]
}

fn finished(layers: Vec<OfLayer>, noise: Option<Vec<[u8; 3]>>, width: u32, height: u32) -> Vec<Map> {
    let depths = layers.iter().flat_map(|layer| &layer.depth.values).filter(|z| z.is_finite());
    let (near, far) = depths.fold((f32::INFINITY, f32::NEG_INFINITY), |(near, far), &z| (near.min(z), far.max(z)));
    /// The deepest surface is still darker than paper and lighter than ink.
    const DARKEST: f32 = 0.15;
    let of_depth = |growing: Growing<f32>| {
        let shade = |z: &f32| {
            let deep = if far > near { (z - near) / (far - near) } else { 0.0 };
            if z.is_finite() { grey(1.0 - (1.0 - DARKEST) * deep) } else { EMPTY }
        };
        (growing.name, growing.values.iter().map(shade).collect::<Vec<_>>())
    };
    let mut all: Vec<(String, Vec<[u8; 3]>)> = Vec::new();
    for layer in layers {
        all.push(of_depth(layer.depth));
        all.extend(layer.bytes.into_iter().map(|map| (map.name, map.values)));
        all.extend(layer.perturbed_depth.map(of_depth));
    }
    all.extend(noise.map(|noise| ("noise".to_owned(), noise)));
    all.into_iter().map(|(name, values)| Map { name, width, height, rgb: values.into_flattened() }).collect()
}
