//! Frames into one moving picture that plays over and over: APNG, which keeps every colour, or GIF, which everything shows.
//!
//! *Practice.* The frames come from PNG files, one at a time, so that a film of any length takes the memory of a few frames,
//! and a run that was stopped has lost none that it had drawn.

use std::path::{Path, PathBuf};

use image::{DynamicImage, RgbaImage};

use super::{Destination, OutputError, gif};

/// A format for moving pictures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FilmFormat {
    /// 24 bits of colour and 8 of alpha; browsers and most viewers.
    Apng,
    /// 256 colours, alpha all or nothing; everywhere.
    Gif,
}

impl FilmFormat {
    /// By the ending of a file's name: `.apng` or `.gif`.
    pub fn of(path: &Path) -> Option<Self> {
        match path.extension()?.to_str()?.to_ascii_lowercase().as_str() {
            "apng" => Some(Self::Apng),
            "gif" => Some(Self::Gif),
            _ => None,
        }
    }
}

/// Joins `frames`, PNG files of one size in their order, into a film of `fps` frames a second at `destination`. `on_frame` is
/// called after each frame.
///
/// # Errors
/// [`OutputError`]: a frame cannot be read, or the film not be written; nothing is left half-written.
pub fn join(
    frames: &[PathBuf],
    fps: f64,
    format: FilmFormat,
    destination: &Destination,
    overwrite: bool,
    on_frame: &dyn Fn(),
) -> Result<(), OutputError> {
    destination.check(overwrite)?;
    let cannot = |reason: String| OutputError::Encode { destination: destination.clone(), reason };
    if frames.is_empty() {
        return Err(cannot("a film has at least one frame".to_owned()));
    }
    let read = |frame: usize| -> Result<DynamicImage, OutputError> {
        let path = &frames[frame];
        image::open(path).map_err(|error| cannot(format!("the frame {} cannot be read: {error}", path.display())))
    };
    // The encoders write as they go; an error of a frame passes through theirs.
    let mut failed = None;
    let mut next = |frame: usize| -> Option<DynamicImage> {
        let picture = read(frame).map_err(|error| failed = Some(error)).ok()?;
        on_frame();
        Some(picture)
    };
    let encoded = match format {
        FilmFormat::Apng => apng(frames.len(), fps, &mut next),
        FilmFormat::Gif => {
            let palette = gif::Palette::of(frames.len(), &mut |frame| Some(read(frame).ok()?.into_rgba8()));
            gif::encode(&palette, frames.len(), fps, &mut |frame| Some(next(frame)?.into_rgba8()))
        }
    };
    if let Some(error) = failed {
        return Err(error);
    }
    destination.write(overwrite, &encoded.map_err(cannot)?)
}

/// The bytes of an APNG; `next` hands over the frames in turn, `None` to stop.
fn apng(count: usize, fps: f64, next: &mut dyn FnMut(usize) -> Option<DynamicImage>) -> Result<Vec<u8>, String> {
    let stopped = || "a frame is missing".to_owned();
    let first = next(0).ok_or_else(stopped)?;
    let has_alpha = first.color().has_alpha();
    let bytes = |picture: DynamicImage| {
        if has_alpha { picture.into_rgba8().into_raw() } else { picture.into_rgb8().into_raw() }
    };
    let mut encoded = Vec::new();
    let encode = || -> Result<(), png::EncodingError> {
        let mut encoder = png::Encoder::new(&mut encoded, first.width(), first.height());
        encoder.set_color(if has_alpha { png::ColorType::Rgba } else { png::ColorType::Rgb });
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
        const FOR_EVER: u32 = 0;
        encoder.set_animated(count as u32, FOR_EVER)?;
        let (numerator, denominator) = delay(fps);
        encoder.set_frame_delay(numerator, denominator)?;
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&bytes(first))?;
        for frame in 1..count {
            // The caller knows why a frame is missing.
            let Some(picture) = next(frame) else { return Ok(()) };
            writer.write_image_data(&bytes(picture))?;
        }
        writer.finish()
    };
    encode().map_err(|error| error.to_string())?;
    Ok(encoded)
}

/// The time of a frame as a fraction of a second in 16 bits.
fn delay(fps: f64) -> (u16, u16) {
    // Whole rates are kept exactly; others to a few hundredths of a per cent, up to the slowest that the format knows.
    let most = f64::from(u16::MAX);
    match [1.0, 10.0, 100.0, 1000.0].into_iter().find(|scale| (fps * scale).fract() == 0.0 && fps * scale <= most) {
        Some(scale) => (scale as u16, (fps * scale) as u16),
        None if fps >= 1.0 => ((most / fps) as u16, u16::MAX),
        None => (u16::MAX, (most * fps).max(1.0) as u16),
    }
}

/// A film's frame as colours and alpha.
pub(super) type Frame = RgbaImage;

#[cfg(test)]
mod tests {
    use super::*;
    use image::{AnimationDecoder, Rgb, RgbImage, Rgba};
    use std::io::Cursor;

    fn frames(directory: &Path, count: u32, has_alpha: bool) -> Vec<PathBuf> {
        (0..count)
            .map(|frame| {
                let path = directory.join(format!("{frame}.png"));
                let pixel = |x: u32, y: u32| [(40 * frame + x) as u8, (3 * y) as u8, 90];
                if has_alpha {
                    let alpha = |x| if x < 10 { 0 } else { 255 };
                    let with_alpha = |x, y| {
                        let [r, g, b] = pixel(x, y);
                        Rgba([r, g, b, alpha(x)])
                    };
                    RgbaImage::from_fn(40, 30, with_alpha).save(&path).unwrap();
                } else {
                    RgbImage::from_fn(40, 30, |x, y| Rgb(pixel(x, y))).save(&path).unwrap();
                }
                path
            })
            .collect()
    }

    #[test]
    fn another_reader_gets_back_every_frame_of_an_apng() {
        let directory = tempfile::tempdir().unwrap();
        for has_alpha in [false, true] {
            let frames = frames(directory.path(), 4, has_alpha);
            let path = directory.path().join(format!("{has_alpha}.apng"));
            join(&frames, 12.5, FilmFormat::Apng, &Destination::File(path.clone()), false, &|| ()).unwrap();
            let decoder = image::codecs::png::PngDecoder::new(Cursor::new(std::fs::read(&path).unwrap())).unwrap();
            let film: Vec<_> = decoder.apng().unwrap().into_frames().collect_frames().unwrap();
            assert_eq!(film.len(), 4);
            for (frame, path) in film.iter().zip(&frames) {
                assert_eq!(frame.buffer(), &image::open(path).unwrap().into_rgba8());
                assert_eq!(frame.delay().numer_denom_ms(), (80, 1));
            }
        }
    }

    #[test]
    fn a_missing_frame_leaves_no_film() {
        let directory = tempfile::tempdir().unwrap();
        let mut frames = frames(directory.path(), 2, false);
        frames.push(directory.path().join("lost.png"));
        for ending in ["gif", "apng"] {
            let path = directory.path().join(format!("film.{ending}"));
            let format = FilmFormat::of(&path).unwrap();
            let error = join(&frames, 10.0, format, &Destination::File(path.clone()), false, &|| ()).unwrap_err();
            assert!(error.to_string().contains("lost.png"), "{error}");
            assert!(!path.exists());
        }
    }

    #[test]
    fn rates_become_fractions() {
        assert_eq!(delay(24.0), (1, 24));
        assert_eq!(delay(12.5), (10, 125));
        for fps in [23.976, 1.0 / 3.0, 59.94, 1e-3, 1000.0 / 7.0] {
            let (numerator, denominator) = delay(fps);
            let made = f64::from(denominator) / f64::from(numerator);
            assert!((made / fps - 1.0).abs() < 0.01, "{fps} became {made}");
        }
    }
}
