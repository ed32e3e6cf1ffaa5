//! OpenEXR: the picture in linear light with, for every pixel and layer, what surface is seen there.
//!
//! Channels, all 32-bit floats:
//!
//! | name | what |
//! | --- | --- |
//! | `R G B A` | the picture, premultiplied by alpha as the format asks |
//! | `Z` | planar view depth of the nearest boundary, scene units; +∞ where empty |
//! | `Normal.X` `.Y` `.Z` | outward unit normal of the result, world space; 0 where empty |
//! | `Leaf` | index of the leaf whose surface it is, in the scene's order; −1 where empty |
//! | `Facing` | +1 where the ray enters the result, −1 where it leaves it, 0 where empty |
//! | `layer1.R` … `layer1.Facing` | the same of the next boundary, and so on |
//!
//! The colour of a deeper layer is that surface alone, lit, times its opacity and the share of the pixel that it covers.
//! Where the samples of a pixel see different boundaries, a layer holds the one that most of them see.

use std::io::{self, Cursor};

use ::exr::block::{BlockIndex, UncompressedBlock};
use ::exr::image::write::channels::{ChannelsWriter, WritableChannels};
use ::exr::image::{Blocks, Encoding, Image, Layer};
use ::exr::math::{RoundingMode, Vec2};
use ::exr::meta::attribute::{AttributeValue, ChannelDescription, ChannelList, LevelMode, LineOrder, SampleType, Text};
use ::exr::meta::header::{Header, LayerAttributes};
use ::exr::prelude::{Compression, WritableImage};

use super::{Destination, OutputError, PictureInfo, SOFTWARE};
use crate::composite::Picture;
use crate::composite::lighting::Shader;
use crate::layers::{Boundary, LayerStack};
use crate::scene::Light;

/// Writes `picture` and the layers that it was drawn from, `max_layers` of them at most, to `destination`.
///
/// # Errors
/// [`OutputError`]; nothing is left half-written.
///
/// # Panics
/// If `picture` and `stack` differ in size.
pub fn write(
    picture: &Picture,
    stack: &LayerStack,
    light: &Light,
    max_layers: Option<usize>,
    info: &PictureInfo,
    destination: &Destination,
    overwrite: bool,
) -> Result<(), OutputError> {
    let size = (stack.camera.width, stack.camera.height);
    assert_eq!((picture.width, picture.height), size, "a picture and its layers have one size");
    destination.check(overwrite)?;
    let layers = layer_count(stack).min(max_layers.unwrap_or(usize::MAX)).max(1);
    let channels = Channels::new(picture, stack, light, layers);
    let mut attributes = LayerAttributes {
        owner: None,
        comments: Some(text(SOFTWARE)),
        software_name: Some(text(SOFTWARE)),
        ..LayerAttributes::default()
    };
    let note = |value: &str| AttributeValue::Text(text(value));
    attributes.other.extend(info.scene.as_deref().map(|scene| (text("scene"), note(scene))));
    // Run lengths in scan lines: 3 times as fast as ZIP; every reader takes scan lines.
    let encoding =
        Encoding { compression: Compression::RLE, blocks: Blocks::ScanLines, line_order: LineOrder::Increasing };
    let layer = Layer::new((size.0 as usize, size.1 as usize), attributes, encoding, channels);
    let mut image = Image::from_layer(layer);
    // The crate keeps further attributes in two tables without an order: with one in each, files with the same content are the
    // same bytes.
    image.attributes.other.extend(info.units.as_deref().map(|units| (text("units"), note(units))));
    // The format goes back to fill in its table of offsets, which neither a pipe nor a plain writer can.
    let mut encoded = Cursor::new(Vec::new());
    image.write().to_buffered(&mut encoded).map_err(|error| match error {
        ::exr::error::Error::Io(source) => OutputError::Io { destination: destination.clone(), source },
        other => OutputError::Encode { destination: destination.clone(), reason: other.to_string() },
    })?;
    destination.write_with(overwrite, |sink| io::Write::write_all(sink, encoded.get_ref()))
}

/// Text as the format holds it: bytes.
fn text(value: &str) -> Text {
    Text::new_or_none(value).unwrap_or_else(|| Text::from_bytes_unchecked(value.bytes().collect()))
}

/// The boundary of layer `layer` (0 is the nearest) that most samples of a pixel see; the nearer one where two tie.
pub fn layer_of_pixel(boundaries: &[Boundary], samples: u32, layer: usize) -> Option<&Boundary> {
    if samples <= 1 {
        return boundaries.get(layer);
    }
    // The boundary that each sample meets as its `layer`-th, as (index, samples that meet it).
    let mut met: Vec<(usize, u32)> = Vec::new();
    for sample in 0..samples {
        let seen = (0..boundaries.len()).filter(|&i| boundaries[i].samples >> sample & 1 == 1).nth(layer);
        let Some(index) = seen else { continue };
        match met.iter_mut().find(|(i, _)| *i == index) {
            Some((_, count)) => *count += 1,
            None => met.push((index, 1)),
        }
    }
    let (index, _) = met.into_iter().max_by_key(|&(index, count)| (count, usize::MAX - index))?;
    Some(&boundaries[index])
}

/// The most boundaries that one sample meets anywhere, at least 1.
fn layer_count(stack: &LayerStack) -> usize {
    if stack.samples <= 1 {
        return stack.depth_complexity().max(1);
    }
    let mut most = 1;
    for tile in stack.tiles() {
        for pixel in tile.offsets.windows(2) {
            let boundaries = &tile.boundaries[pixel[0] as usize..pixel[1] as usize];
            // A pixel with no more boundaries than the record so far cannot beat it.
            if boundaries.len() > most {
                let met = |sample: u32| boundaries.iter().filter(|b| b.samples >> sample & 1 == 1).count();
                most = (0..stack.samples).map(met).max().unwrap_or(0).max(most);
            }
        }
    }
    most
}

/// What a channel holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Quantity {
    /// Red, green, blue, alpha.
    Colour(usize),
    Depth,
    Normal(usize),
    Leaf,
    Facing,
}

const QUANTITIES: [(&str, Quantity); 10] = [
    ("R", Quantity::Colour(0)),
    ("G", Quantity::Colour(1)),
    ("B", Quantity::Colour(2)),
    ("A", Quantity::Colour(3)),
    ("Z", Quantity::Depth),
    ("Normal.X", Quantity::Normal(0)),
    ("Normal.Y", Quantity::Normal(1)),
    ("Normal.Z", Quantity::Normal(2)),
    ("Leaf", Quantity::Leaf),
    ("Facing", Quantity::Facing),
];

/// Hands the encoder one block of lines at a time, made from the layers when asked: no dense layer is ever in memory.
struct Channels<'a> {
    picture: &'a Picture,
    stack: &'a LayerStack,
    shader: Shader<'a>,
    /// In the file's order, which is the alphabet's: name, layer, quantity.
    list: Vec<(String, usize, Quantity)>,
}

impl<'a> Channels<'a> {
    fn new(picture: &'a Picture, stack: &'a LayerStack, light: &Light, layers: usize) -> Self {
        let mut list = Vec::new();
        for layer in 0..layers {
            for (name, quantity) in QUANTITIES {
                let name = if layer == 0 { name.to_owned() } else { format!("layer{layer}.{name}") };
                list.push((name, layer, quantity));
            }
        }
        list.sort_by(|(a, ..), (b, ..)| a.cmp(b));
        Self { picture, stack, shader: Shader::new(light, &stack.camera), list }
    }

    fn value(&self, layer: usize, quantity: Quantity, x: u32, y: u32) -> f32 {
        if let (0, Quantity::Depth, Some(depth)) = (layer, quantity, &self.picture.depth) {
            return depth[(y * self.picture.width + x) as usize];
        }
        if let (0, Quantity::Colour(channel)) = (layer, quantity) {
            let pixel = self.picture.at(x, y);
            return if channel < 3 { pixel[channel] * pixel[3] } else { pixel[3] };
        }
        let samples = self.stack.samples;
        let Some(boundary) = layer_of_pixel(self.stack.at(x, y), samples, layer) else {
            return match quantity {
                Quantity::Depth => f32::INFINITY,
                Quantity::Leaf => -1.0,
                Quantity::Colour(_) | Quantity::Normal(_) | Quantity::Facing => 0.0,
            };
        };
        match quantity {
            Quantity::Depth => boundary.depth,
            Quantity::Normal(axis) => boundary.normal[axis],
            Quantity::Leaf => boundary.leaf as f32,
            Quantity::Facing => f32::from(boundary.facing as i8),
            Quantity::Colour(channel) => {
                let alpha = boundary.opacity * boundary.samples.count_ones() as f32 / samples.max(1) as f32;
                let lit = |channel| self.shader.lit(boundary, self.shader.towards_eye(x, y))[channel];
                if channel < 3 { lit(channel) * alpha } else { alpha }
            }
        }
    }
}

impl<'s, 'a: 's> WritableChannels<'s> for Channels<'a> {
    type Writer = &'s Self;

    fn infer_channel_list(&self) -> ChannelList {
        let describe =
            |(name, ..): &(String, usize, Quantity)| ChannelDescription::named(name.as_str(), SampleType::F32);
        ChannelList::new(self.list.iter().map(describe).collect())
    }

    fn infer_level_modes(&self) -> (LevelMode, RoundingMode) {
        (LevelMode::Singular, RoundingMode::Down)
    }

    fn create_writer(&'s self, _: &Header) -> Self::Writer {
        self
    }
}

impl ChannelsWriter for &Channels<'_> {
    fn extract_uncompressed_block(&self, header: &Header, block: BlockIndex) -> Vec<u8> {
        UncompressedBlock::collect_block_data_from_lines(&header.channels, block, |line| {
            let (_, layer, quantity) = self.list[line.location.channel];
            let Vec2(x0, y) = line.location.position;
            let written = line.write_samples(|i| self.value(layer, quantity, (x0 + i) as u32, y as u32));
            debug_assert!(written.is_ok(), "a line of memory takes its samples");
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layers::{Facing, LayerSource, LayerTile};
    use crate::scene::colour::leaf_colour;
    use crate::space::{Camera, Lens, PixelRect};
    use glam::{DVec3, Vec3};
    use std::collections::HashMap;

    const WIDTH: u32 = 70;
    const HEIGHT: u32 = 5;

    /// Pixel (x, y) has `x % 3` boundaries.
    struct Steps(Camera);

    fn boundaries(x: u32, y: u32) -> Vec<Boundary> {
        (0..x % 3)
            .map(|layer| Boundary {
                depth: (x + 100 * layer) as f32 + 0.25,
                normal: Vec3::new(0.6, -0.8, 0.0),
                colour: leaf_colour(layer as usize),
                opacity: 0.5,
                leaf: layer + y,
                body: 0,
                facing: if layer == 0 { Facing::Front } else { Facing::Back },
                samples: 1,
            })
            .collect()
    }

    impl LayerSource for Steps {
        fn camera(&self) -> &Camera {
            &self.0
        }
        fn samples(&self) -> u32 {
            1
        }
        fn draw(&self, rect: PixelRect) -> LayerTile {
            let mut tile = LayerTile { rect, offsets: vec![0], boundaries: Vec::new() };
            for y in rect.y0..rect.y1 {
                for x in rect.x0..rect.x1 {
                    tile.boundaries.extend(boundaries(x, y));
                    tile.offsets.push(tile.boundaries.len() as u32);
                }
            }
            tile
        }
    }

    #[test]
    fn another_reader_gets_back_every_channel() {
        use ::exr::prelude::{ReadChannels, ReadLayers, read};
        let camera =
            Camera::look_at(DVec3::new(0.0, -4.0, 0.0), DVec3::ZERO, DVec3::Z, Lens::FovY(35.0), WIDTH, HEIGHT)
                .unwrap();
        let stack = LayerStack::collect(&Steps(camera));
        let pixels = (0..WIDTH * HEIGHT).map(|i| [i as f32, 0.5, 1e-6, 0.5]).collect();
        let picture = Picture { width: WIDTH, height: HEIGHT, pixels, depth: None, covered: 1, has_alpha: true };
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.exr");
        let destination = Destination::File(path.clone());
        let info = PictureInfo { scene: Some("Hüfte".into()), units: Some("mm".into()), px_per_unit: None };
        write(&picture, &stack, &Light::default(), None, &info, &destination, false).unwrap();
        assert!(matches!(
            write(&picture, &stack, &Light::default(), None, &info, &destination, false),
            Err(OutputError::Exists { .. })
        ));
        // The same bytes each time, whatever order the crate's tables have.
        let bytes = std::fs::read(&path).unwrap();
        for _ in 0..8 {
            write(&picture, &stack, &Light::default(), None, &info, &destination, true).unwrap();
            assert!(std::fs::read(&path).unwrap() == bytes);
        }
        let image = read()
            .no_deep_data()
            .largest_resolution_level()
            .all_channels()
            .first_valid_layer()
            .all_attributes()
            .from_file(&path)
            .unwrap();
        let layer = &image.layer_data;
        assert_eq!(layer.attributes.software_name, Some(text(SOFTWARE)));
        assert_eq!(layer.attributes.other.get(&text("units")), Some(&AttributeValue::Text(text("mm"))));
        let channels: HashMap<String, Vec<f32>> = layer
            .channel_data
            .list
            .iter()
            .map(|channel| (channel.name.to_string(), channel.sample_data.values_as_f32().collect()))
            .collect();
        assert_eq!(channels.len(), 2 * QUANTITIES.len());
        for y in 0..HEIGHT {
            for x in 0..WIDTH {
                let i = (y * WIDTH + x) as usize;
                let at = |name: &str| channels[name][i];
                assert_eq!((at("R"), at("G"), at("A")), (i as f32 * 0.5, 0.25, 0.5));
                let wanted = boundaries(x, y);
                for (layer, prefix) in ["", "layer1."].into_iter().enumerate() {
                    let at = |name: &str| at(&format!("{prefix}{name}"));
                    match wanted.get(layer) {
                        None => {
                            assert_eq!((at("Z"), at("Leaf"), at("Facing")), (f32::INFINITY, -1.0, 0.0));
                            assert_eq!(at("Normal.X"), 0.0);
                        }
                        Some(b) => {
                            assert_eq!((at("Z"), at("Leaf")), (b.depth, b.leaf as f32));
                            assert_eq!(at("Facing"), if layer == 0 { 1.0 } else { -1.0 });
                            assert_eq!((at("Normal.X"), at("Normal.Y"), at("Normal.Z")), (0.6, -0.8, 0.0));
                        }
                    }
                }
                assert_eq!(at("layer1.A"), if wanted.len() > 1 { 0.5 } else { 0.0 });
            }
        }
    }

    #[test]
    fn a_layer_is_what_most_samples_see() {
        let with = |samples: u16| Boundary { samples, ..boundaries(1, 0)[0] };
        let pixel = [with(0b0001), with(0b1110), with(0b0011)];
        let index = |layer| {
            layer_of_pixel(&pixel, 4, layer).map(|found| pixel.iter().position(|b| std::ptr::eq(b, found)).unwrap())
        };
        // First boundaries: 0 of one sample, 1 of three. Second: 2 of two samples. Third: none.
        assert_eq!((index(0), index(1), index(2)), (Some(1), Some(2), None));
    }
}
