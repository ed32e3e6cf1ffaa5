//! PNG: 8 bits a channel, sRGB, with the scene's name, unit and scale in its metadata.

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder, RgbImage};
use rayon::prelude::*;

use super::{Destination, OutputError, PictureInfo, SOFTWARE};
use crate::composite::Picture;
use crate::scene::colour::srgb_byte_from_linear;

/// Bytes before the first chunk that may hold metadata: the signature (8) and the header chunk (4 + 4 + 13 + 4).
const HEADER_BYTES: usize = 33;

/// Writes `picture` to `destination`.
///
/// # Errors
/// [`OutputError`]; nothing is left half-written.
pub fn write(
    picture: &Picture,
    info: &PictureInfo,
    destination: &Destination,
    overwrite: bool,
) -> Result<(), OutputError> {
    destination.check(overwrite)?;
    let encoded = encode(picture)
        .map_err(|error| OutputError::Encode { destination: destination.clone(), reason: error.to_string() })?;
    // The encoder knows no text, so the metadata's chunks go in between its header and its pixels.
    destination.write_with(overwrite, |sink| {
        sink.write_all(&encoded[..HEADER_BYTES])?;
        sink.write_all(&metadata(info))?;
        sink.write_all(&encoded[HEADER_BYTES..])
    })
}

/// The picture without its alpha, 8-bit sRGB.
pub fn rgb(picture: &Picture) -> RgbImage {
    RgbImage::from_fn(picture.width, picture.height, |x, y| {
        let [r, g, b, _] = picture.at(x, y);
        image::Rgb([r, g, b].map(srgb_byte_from_linear))
    })
}

/// Writes an 8-bit sRGB picture that no scene's metadata belongs to.
///
/// # Errors
/// As [`write()`].
pub fn write_rgb(picture: &RgbImage, destination: &Destination, overwrite: bool) -> Result<(), OutputError> {
    destination.check(overwrite)?;
    let mut encoded = Vec::new();
    let encoder = PngEncoder::new_with_quality(&mut encoded, CompressionType::Fast, FilterType::Adaptive);
    encoder
        .write_image(picture.as_raw(), picture.width(), picture.height(), ExtendedColorType::Rgb8)
        .map_err(|error| OutputError::Encode { destination: destination.clone(), reason: error.to_string() })?;
    destination.write(overwrite, &encoded)
}

fn encode(picture: &Picture) -> Result<Vec<u8>, image::ImageError> {
    let channels = if picture.has_alpha { 4 } else { 3 };
    let mut bytes = vec![0u8; picture.pixels.len() * channels];
    bytes.par_chunks_exact_mut(channels).zip(&picture.pixels).with_min_len(4096).for_each(|(bytes, pixel)| {
        (0..3).for_each(|c| bytes[c] = srgb_byte_from_linear(pixel[c]));
        if let [_, _, _, alpha] = bytes {
            // Alpha is a share, not a light: it has no curve.
            *alpha = (pixel[3].clamp(0.0, 1.0) * 255.0).round() as u8;
        }
    });
    let mut encoded = Vec::new();
    // The default effort takes 17 times as long for files hardly smaller.
    let encoder = PngEncoder::new_with_quality(&mut encoded, CompressionType::Fast, FilterType::Adaptive);
    let colours = if picture.has_alpha { ExtendedColorType::Rgba8 } else { ExtendedColorType::Rgb8 };
    encoder.write_image(&bytes, picture.width, picture.height, colours)?;
    Ok(encoded)
}

/// The metadata's chunks.
fn metadata(info: &PictureInfo) -> Vec<u8> {
    let mut chunks = Vec::new();
    push_chunk(&mut chunks, b"sRGB", &[0]); // rendering intent: perceptual
    if let (Some(per_unit), Some(metres)) = (info.px_per_unit, info.units.as_deref().and_then(metres_per_unit)) {
        let per_metre = (per_unit / metres).round();
        if per_metre >= 1.0 && per_metre <= f64::from(i32::MAX) {
            let side = (per_metre as u32).to_be_bytes();
            const METRE: u8 = 1; // the only unit that the format knows
            push_chunk(&mut chunks, b"pHYs", &[&side[..], &side[..], &[METRE]].concat());
        }
    }
    let entries = [("Software", Some(SOFTWARE)), ("Title", info.scene.as_deref()), ("Units", info.units.as_deref())];
    for (key, text) in entries.into_iter().filter_map(|(key, text)| Some((key, text?))) {
        if text.is_ascii() {
            push_chunk(&mut chunks, b"tEXt", &[key.as_bytes(), b"\0", text.as_bytes()].concat());
        } else {
            // Key, no compression (two bytes), no language, no translated key, text.
            push_chunk(&mut chunks, b"iTXt", &[key.as_bytes(), b"\0\0\0\0\0", text.as_bytes()].concat());
        }
    }
    chunks
}

/// How many metres a unit of length has, where it is one of the common ones.
fn metres_per_unit(unit: &str) -> Option<f64> {
    Some(match unit.trim().to_ascii_lowercase().as_str() {
        "nm" => 1e-9,
        "um" | "µm" | "μm" => 1e-6,
        "mm" => 1e-3,
        "cm" => 1e-2,
        "dm" => 1e-1,
        "m" => 1.0,
        "km" => 1e3,
        "in" | "inch" | "inches" => 0.0254,
        "ft" | "feet" => 0.3048,
        _ => return None,
    })
}

fn push_chunk(chunks: &mut Vec<u8>, kind: &[u8; 4], data: &[u8]) {
    chunks.extend((data.len() as u32).to_be_bytes());
    let checked_from = chunks.len();
    chunks.extend(kind);
    chunks.extend(data);
    let check = crc32(&chunks[checked_from..]);
    chunks.extend(check.to_be_bytes());
}

/// The checksum of PNG's chunks (ISO 3309), bit by bit: metadata is short.
fn crc32(bytes: &[u8]) -> u32 {
    const REVERSED_POLYNOMIAL: u32 = 0xedb8_8320;
    let folded = bytes.iter().fold(u32::MAX, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |crc, _| (crc >> 1) ^ if crc & 1 == 1 { REVERSED_POLYNOMIAL } else { 0 })
    });
    !folded
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::colour::linear_from_bytes;

    fn picture(has_alpha: bool) -> Picture {
        let [r, g, b] = linear_from_bytes([10, 128, 250]);
        let pixels = vec![[r, g, b, 1.0], [r, g, b, 0.5], [0.0; 4], [2.0, f32::NAN, -1.0, 2.0], [1.0; 4], [r; 4]];
        Picture { width: 3, height: 2, pixels, depth: None, covered: 4, has_alpha }
    }

    #[test]
    fn checksums_are_those_of_the_standard() {
        // The check value that every catalogue of checksums gives, and PNG's end chunk.
        assert_eq!(crc32(b"123456789"), 0xcbf4_3926);
        assert_eq!(crc32(b"IEND"), 0xae42_6082);
    }

    #[test]
    fn pixels_come_back_and_the_metadata_is_there() {
        let directory = tempfile::tempdir().unwrap();
        for has_alpha in [false, true] {
            let path = directory.path().join(format!("{has_alpha}.png"));
            let info = PictureInfo { scene: Some("Hüfte".into()), units: Some("mm".into()), px_per_unit: Some(10.0) };
            write(&picture(has_alpha), &info, &Destination::File(path.clone()), false).unwrap();
            assert_eq!(rgb(&picture(has_alpha)).get_pixel(0, 0).0, [10, 128, 250]);
            let bytes = std::fs::read(&path).unwrap();
            let back = image::load_from_memory(&bytes).unwrap();
            assert_eq!(back.color().has_alpha(), has_alpha);
            let back = back.to_rgba8();
            assert_eq!(back.dimensions(), (3, 2));
            assert_eq!(back.get_pixel(0, 0).0, [10, 128, 250, 255]);
            assert_eq!(back.get_pixel(1, 0).0, [10, 128, 250, if has_alpha { 128 } else { 255 }]);
            assert_eq!(back.get_pixel(0, 1).0, [255, 0, 0, 255]);
            let holds = |part: &[u8]| bytes.windows(part.len()).any(|window| window == part);
            assert!(holds(SOFTWARE.as_bytes()) && holds("Title\0\0\0\0\0Hüfte".as_bytes()) && holds(b"Units\0mm"));
            // Ten pixels a millimetre are ten thousand a metre.
            assert!(holds(&[&b"pHYs"[..], &10_000u32.to_be_bytes()].concat()));
        }
    }

    #[test]
    fn unknown_units_give_no_scale() {
        assert_eq!(metres_per_unit("MM"), Some(1e-3));
        assert_eq!(metres_per_unit("parsnip"), None);
        let info = PictureInfo { units: Some("parsnip".into()), px_per_unit: Some(1.0), scene: None };
        assert!(!metadata(&info).windows(4).any(|window| window == b"pHYs"));
    }
}
