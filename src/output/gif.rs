//! GIF: 256 colours for the whole film.
//!
//! *Theory.* The colours come from a self-organising map (Dekker 1994, "Kohonen neural networks for optimal colour
//! quantization", the crate `color_quant`). What lies between two of them is drawn as a pattern of both (ordered dither with
//! a Bayer matrix).
//!
//! *Practice.* One palette serves all frames, and the dither's pattern stands still: with a palette or an error diffusion for
//! each frame, surfaces that do not change would flicker. Colours that fill much of the film, as the background does, are
//! taken into the palette as they are and never dithered. Delays are in hundredths of a second; they are
//! rounded so that the film as a whole keeps its pace.

use std::borrow::Cow;
use std::collections::HashMap;

use color_quant::NeuQuant;
use rayon::prelude::*;

use super::film::Frame;

/// Colours of a palette; the last index may stand for nothing.
const COLOURS: usize = 255;
/// The index of pixels that show what lies behind the film.
const TRANSPARENT: u8 = 255;
/// Pixels that are less opaque are transparent.
const LEAST_ALPHA: u8 = 128;
/// A colour that fills this share of the film is kept as it is.
const FLAT_SHARE: f64 = 0.02;
/// Pixels that the palette is made from: more change nothing that can be seen, and training takes their number.
const MOST_SAMPLES: usize = 1 << 19;
/// Of `NeuQuant`: 1 learns from every sample, 30 is coarsest.
const EVERY_SAMPLE: i32 = 1;

/// The film's colours.
#[derive(Debug)]
pub(super) struct Palette {
    /// sRGB.
    colours: Vec<[u8; 3]>,
    /// How many of the first are kept as they are.
    flat: usize,
    /// How far the dither moves a colour, each way, in steps of 255.
    spread: f32,
}

impl Palette {
    /// For a film of `count` frames that `frame` hands over; those that it lacks are left out.
    pub(super) fn of(count: usize, frame: &mut dyn FnMut(usize) -> Option<Frame>) -> Self {
        let mut samples: Vec<[u8; 4]> = Vec::new();
        for index in 0..count {
            let Some(picture) = frame(index) else { continue };
            let pixels = picture.as_raw().as_chunks::<4>().0;
            // A step that is odd and no divisor of common widths, so that samples do not stand in columns.
            let step = (pixels.len() * count / MOST_SAMPLES).max(1) | 1;
            samples.extend(pixels.iter().skip(index % step).step_by(step).filter(|pixel| pixel[3] >= LEAST_ALPHA));
        }
        let mut counts: HashMap<[u8; 3], usize> = HashMap::new();
        for &[r, g, b, _] in &samples {
            *counts.entry([r, g, b]).or_default() += 1;
        }
        let least = (FLAT_SHARE * samples.len() as f64).max(1.0);
        // Where all fit, all are kept.
        let keeps = |times: usize| counts.len() <= COLOURS || times as f64 >= least;
        let mut colours: Vec<[u8; 3]> =
            counts.iter().filter(|(_, times)| keeps(**times)).map(|(colour, _)| *colour).collect();
        colours.sort_unstable();
        let flat = colours.len();
        samples.retain(|&[r, g, b, _]| colours.binary_search(&[r, g, b]).is_err());
        // The network learns from at least as many samples as it looks at in a cycle.
        if samples.len() >= COLOURS {
            let network = NeuQuant::new(EVERY_SAMPLE, COLOURS - flat, samples.as_flattened());
            colours.extend(network.color_map_rgb().as_chunks::<3>().0);
        } else {
            colours.extend(samples.iter().map(|&[r, g, b, _]| [r, g, b]).take(COLOURS - flat));
        }
        let mut palette = Self { colours, flat, spread: 0.0 };
        palette.spread = palette.error(&samples);
        palette
    }

    /// The mean distance of `samples` from their colours, a channel: a pattern of half that strength each way reaches the
    /// next colour half of the time.
    fn error(&self, samples: &[[u8; 4]]) -> f32 {
        const LOOKED_AT: usize = 1 << 14;
        let step = (samples.len() / LOOKED_AT).max(1);
        let squared: Vec<f32> = samples
            .par_iter()
            .step_by(step)
            .map(|&[r, g, b, _]| {
                let wanted = [r, g, b].map(f32::from);
                let found = self.colours[self.nearest(wanted)].map(f32::from);
                wanted.iter().zip(found).map(|(a, b)| (a - b) * (a - b)).sum::<f32>() / 3.0
            })
            .collect();
        // Summed in order: the same on any number of threads.
        (squared.iter().sum::<f32>() / squared.len().max(1) as f32).sqrt()
    }

    fn nearest(&self, colour: [f32; 3]) -> usize {
        let distance = |i: usize| {
            let other = self.colours[i];
            (0..3).map(|k| (colour[k] - f32::from(other[k])).powi(2)).sum::<f32>()
        };
        let mut best = (f32::INFINITY, 0);
        for i in 0..self.colours.len() {
            let distance = distance(i);
            if distance < best.0 {
                best = (distance, i);
            }
        }
        best.1
    }

    /// The palette's index for a pixel.
    fn index(&self, [r, g, b, alpha]: [u8; 4], x: usize, y: usize) -> u8 {
        if alpha < LEAST_ALPHA {
            return TRANSPARENT;
        }
        if let Ok(flat) = self.colours[..self.flat].binary_search(&[r, g, b]) {
            return flat as u8;
        }
        let offset = self.spread * bayer(x, y);
        self.nearest([r, g, b].map(|c| f32::from(c) + offset)) as u8
    }

    /// The picture in the palette's indices.
    fn indices(&self, picture: &Frame) -> Vec<u8> {
        let width = picture.width().max(1) as usize;
        let mut indices = vec![0; picture.width() as usize * picture.height() as usize];
        let rows = picture.as_raw().as_chunks::<4>().0.par_chunks(width);
        indices.par_chunks_mut(width).zip(rows).enumerate().for_each(|(y, (indices, pixels))| {
            let mut before: Option<([u8; 4], u8)> = None;
            for (x, (index, &pixel)) in indices.iter_mut().zip(pixels).enumerate() {
                *index = match before {
                    // A run of a colour that is not dithered.
                    Some((same, index)) if same == pixel && (index as usize) < self.flat => index,
                    _ => self.index(pixel, x, y),
                };
                before = Some((pixel, *index));
            }
        });
        indices
    }
}

/// The Bayer matrix of side 4, from −1 to 1.
fn bayer(x: usize, y: usize) -> f32 {
    const MATRIX: [[u8; 4]; 4] = [[0, 8, 2, 10], [12, 4, 14, 6], [3, 11, 1, 9], [15, 7, 13, 5]];
    (f32::from(MATRIX[y % 4][x % 4]) - 7.5) / 7.5
}

/// The bytes of a film that plays over and over; `next` hands over the frames in turn, `None` to stop.
pub(super) fn encode(
    palette: &Palette,
    count: usize,
    fps: f64,
    next: &mut dyn FnMut(usize) -> Option<Frame>,
) -> Result<Vec<u8>, String> {
    let stopped = || "a frame is missing".to_owned();
    let mut picture = next(0).ok_or_else(stopped)?;
    let side = |pixels: u32| {
        u16::try_from(pixels).map_err(|_| format!("a GIF has at most {} pixels a side: use .apng", u16::MAX))
    };
    let (width, height) = (side(picture.width())?, side(picture.height())?);
    let mut table = palette.colours.clone();
    // The transparent index needs a colour, whatever it is.
    table.resize(COLOURS + 1, [0; 3]);
    let mut encoded = Vec::new();
    let mut encode = || -> Result<(), gif::EncodingError> {
        let mut encoder = gif::Encoder::new(&mut encoded, width, height, table.as_flattened())?;
        encoder.set_repeat(gif::Repeat::Infinite)?;
        for frame in 0..count {
            if frame > 0 {
                let Some(following) = next(frame) else { return Ok(()) };
                picture = following;
            }
            let has_holes = picture.pixels().any(|pixel| pixel[3] < LEAST_ALPHA);
            encoder.write_frame(&gif::Frame {
                delay: delay(frame, fps),
                // What shows through must be cleared before the next frame.
                dispose: if has_holes { gif::DisposalMethod::Background } else { gif::DisposalMethod::Keep },
                transparent: has_holes.then_some(TRANSPARENT),
                width,
                height,
                buffer: Cow::Owned(palette.indices(&picture)),
                ..gif::Frame::default()
            })?;
        }
        Ok(())
    };
    encode().map_err(|error| error.to_string())?;
    Ok(encoded)
}

/// How long frame `frame` is shown, in hundredths of a second: from its own time, rounded, to the next one's.
fn delay(frame: usize, fps: f64) -> u16 {
    let at = |frame: usize| (100.0 * frame as f64 / fps).round();
    (at(frame + 1) - at(frame)).clamp(1.0, f64::from(u16::MAX)) as u16
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{Rgba, RgbaImage};

    /// The frames, and what another reader gets back: delays in hundredths of a second, and pixels.
    fn film(count: usize, at: impl Fn(usize, u32, u32) -> [u8; 4]) -> (Vec<Frame>, Vec<(u16, Frame)>) {
        let frames: Vec<Frame> =
            (0..count).map(|frame| RgbaImage::from_fn(64, 48, |x, y| Rgba(at(frame, x, y)))).collect();
        let mut hand_over = |frame: usize| frames.get(frame).cloned();
        let palette = Palette::of(count, &mut hand_over);
        let bytes = encode(&palette, count, 24.0, &mut hand_over).unwrap();
        let mut options = gif::DecodeOptions::new();
        options.set_color_output(gif::ColorOutput::RGBA);
        let mut decoder = options.read_info(bytes.as_slice()).unwrap();
        let mut read = Vec::new();
        while let Some(frame) = decoder.read_next_frame().unwrap() {
            read.push((frame.delay, RgbaImage::from_raw(64, 48, frame.buffer.to_vec()).unwrap()));
        }
        assert_eq!(read.len(), count);
        (frames, read)
    }

    #[test]
    fn few_colours_come_back_exactly() {
        let (frames, read) = film(3, |frame, x, y| [(x / 8) as u8 * 20, (y / 16) as u8 * 70, frame as u8 * 9, 255]);
        for (frame, (_, read)) in frames.iter().zip(&read) {
            assert_eq!(frame, read);
        }
        // 24 a second in hundredths.
        assert_eq!(read.iter().map(|(delay, _)| *delay).collect::<Vec<_>>(), [4, 4, 5]);
    }

    #[test]
    fn shades_stay_near_and_the_background_is_exact() {
        const PAPER: [u8; 4] = [246, 244, 240, 255];
        let (frames, read) = film(4, |frame, x, y| match (x, y) {
            (0..16, _) => PAPER,
            (16..20, _) => [1, 2, 3, 0],
            _ => [(x * 3 + frame as u32) as u8, (y * 5) as u8, (x * 2 + y * 2) as u8, 255],
        });
        for (frame, (_, read)) in frames.iter().zip(&read) {
            let (mut squared, mut means) = (0.0, [0.0; 3]);
            for (pixel, read) in frame.pixels().zip(read.pixels()) {
                assert_eq!(read[3] == 0, pixel[3] == 0);
                if pixel.0 == PAPER {
                    assert_eq!(read, pixel);
                } else if pixel[3] > 0 {
                    for k in 0..3 {
                        let error = f64::from(read[k]) - f64::from(pixel[k]);
                        squared += error * error;
                        means[k] += error;
                    }
                }
            }
            let count = f64::from(44 * 48);
            assert!((squared / (3.0 * count)).sqrt() < 16.0, "{squared}");
            assert!(means.iter().all(|mean| (mean / count).abs() < 3.0), "{means:?}");
        }
    }
}
