//! Fewer layers than there are: the nearest few of every sample, and how many are worth drawing.
//!
//! *Theory.* Blueprint 2006 §4.1 peels layers until one adds fewer pixels than a threshold, which trades quality for speed.
//!
//! *Changes from the paper.* The paper learns of a layer's pixels when it has drawn it. Here a pass over the whole picture
//! counts first, since tiles are drawn one by one and the rule is the picture's; and what is left out is told.
//!
//! *Practice.* A layer is counted for each sample: the second boundary of one sample of an edge pixel may be the third of its
//! neighbour. A boundary that only some samples still see keeps those samples alone.

use std::sync::{Mutex, PoisonError};

use rayon::prelude::*;

use super::{Boundary, LayerSource, LayerTile, MAX_SAMPLES, TILE_SIDE};
use crate::space::{Camera, PixelRect};

/// Counts boundaries sample by sample along one pixel.
struct Depths {
    met: [usize; MAX_SAMPLES as usize],
    /// The samples that there are: a boundary may have more bits.
    all: u16,
}

impl Depths {
    fn new(samples: u32) -> Self {
        let samples = samples.clamp(1, MAX_SAMPLES);
        Self { met: [0; MAX_SAMPLES as usize], all: u16::MAX >> (MAX_SAMPLES - samples) }
    }

    /// Takes `boundary` into account and calls `each` with every sample that sees it and how many that sample met before.
    fn pass(&mut self, boundary: &Boundary, mut each: impl FnMut(u32, usize)) {
        let mut seen_by = boundary.samples & self.all;
        while seen_by != 0 {
            let sample = seen_by.trailing_zeros();
            seen_by &= seen_by - 1;
            let met = &mut self.met[sample as usize];
            each(sample, *met);
            *met += 1;
        }
    }
}

/// The nearest `most` boundaries that each of `samples` samples sees.
pub fn first_layers(mut tile: LayerTile, samples: u32, most: u32) -> LayerTile {
    let most = most as usize;
    if samples <= 1 {
        return first_boundaries(tile, most);
    }
    let mut kept = Vec::with_capacity(tile.boundaries.len());
    let mut from = 0;
    for pixel in 1..tile.offsets.len() {
        let to = tile.offsets[pixel] as usize;
        let boundaries = &tile.boundaries[from..to];
        if boundaries.len() <= most {
            kept.extend_from_slice(boundaries);
        } else {
            let mut depths = Depths::new(samples);
            for boundary in boundaries {
                let mut left = 0;
                depths.pass(boundary, |sample, met| left |= u16::from(met < most) << sample);
                if left != 0 {
                    kept.push(Boundary { samples: left, ..*boundary });
                }
            }
        }
        from = to;
        tile.offsets[pixel] = kept.len() as u32;
    }
    tile.boundaries = kept;
    tile
}

/// The nearest `most` boundaries of every pixel, moved up within the tile.
fn first_boundaries(mut tile: LayerTile, most: usize) -> LayerTile {
    // Boundaries that are kept up to the pixel; of them those from `from` on are not yet in their place.
    let (mut kept, mut from, mut begin) = (0, 0, 0);
    for pixel in 1..tile.offsets.len() {
        let end = tile.offsets[pixel] as usize;
        if end - begin > most {
            let run = from..begin + most;
            tile.boundaries.copy_within(run.clone(), kept);
            kept += run.len();
            from = end;
        }
        begin = end;
        tile.offsets[pixel] = (kept + (end - from)) as u32;
    }
    tile.boundaries.copy_within(from..begin, kept);
    tile.boundaries.truncate(kept + (begin - from));
    tile
}

/// How much of the picture each layer has.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct LayerCounts {
    /// By layer, the nearest first: pixels of which a sample has it.
    pub pixels: Vec<u64>,
    /// By layer: samples that have it.
    pub samples: Vec<u64>,
}

/// What a limit leaves out, as shares from 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LeftOut {
    /// Of the pixels that show anything: those that lack a layer.
    pub pixels: f64,
    /// Of all boundaries that samples meet.
    pub boundaries: f64,
}

impl LayerCounts {
    /// Counts the layers of all of `source`, in parallel.
    pub fn of(source: &dyn LayerSource) -> Self {
        let (width, height) = (source.camera().width, source.camera().height);
        PixelRect::tiles(width, height, TILE_SIDE)
            .into_par_iter()
            .map(|rect| Self::of_tile(&source.draw(rect), source.samples()))
            .reduce(Self::default, Self::add)
    }

    fn of_tile(tile: &LayerTile, samples: u32) -> Self {
        let mut counts = Self::default();
        for pixel in tile.offsets.windows(2) {
            let boundaries = &tile.boundaries[pixel[0] as usize..pixel[1] as usize];
            let (mut depths, mut deepest) = (Depths::new(samples), 0);
            for boundary in boundaries {
                depths.pass(boundary, |_, met| {
                    if met == counts.samples.len() {
                        counts.samples.push(0);
                        counts.pixels.push(0);
                    }
                    counts.samples[met] += 1;
                    deepest = deepest.max(met + 1);
                });
            }
            counts.pixels[..deepest].iter_mut().for_each(|pixels| *pixels += 1);
        }
        counts
    }

    fn add(mut self, other: Self) -> Self {
        let longest = self.pixels.len().max(other.pixels.len());
        for (own, other) in [(&mut self.pixels, &other.pixels), (&mut self.samples, &other.samples)] {
            own.resize(longest, 0);
            own.iter_mut().zip(other).for_each(|(own, other)| *own += other);
        }
        self
    }

    /// How many layers there are before the first that has fewer than `min_pixels` pixels, `max_layers` at most. The
    /// nearest always counts.
    pub fn worth(&self, min_pixels: u64, max_layers: Option<usize>) -> usize {
        let enough = self.pixels.iter().skip(1).take_while(|&&pixels| pixels >= min_pixels).count() + 1;
        enough.min(self.pixels.len()).min(max_layers.unwrap_or(usize::MAX))
    }

    /// What is left out where each sample has the nearest `most` layers alone.
    pub fn left_out(&self, most: usize) -> LeftOut {
        let share = |part: u64, whole: u64| if whole == 0 { 0.0 } else { part as f64 / whole as f64 };
        let beyond = |counts: &[u64]| counts.get(most..).unwrap_or_default().iter().sum();
        LeftOut {
            // A pixel that has any layer beyond has the first one beyond.
            pixels: share(self.pixels.get(most).copied().unwrap_or(0), self.pixels.first().copied().unwrap_or(0)),
            boundaries: share(beyond(&self.samples), self.samples.iter().sum()),
        }
    }
}

/// A source that counts the layers of what it draws, for whoever draws every tile of the picture once.
pub struct Counted<'a> {
    source: &'a dyn LayerSource,
    counts: Mutex<LayerCounts>,
}

impl<'a> Counted<'a> {
    /// `source`, with nothing counted yet.
    pub fn new(source: &'a dyn LayerSource) -> Self {
        Self { source, counts: Mutex::default() }
    }

    /// What was drawn so far.
    pub fn into_counts(self) -> LayerCounts {
        self.counts.into_inner().unwrap_or_else(PoisonError::into_inner)
    }
}

impl LayerSource for Counted<'_> {
    fn camera(&self) -> &Camera {
        self.source.camera()
    }

    fn samples(&self) -> u32 {
        self.source.samples()
    }

    fn draw(&self, rect: PixelRect) -> LayerTile {
        let tile = self.source.draw(rect);
        let of_tile = LayerCounts::of_tile(&tile, self.source.samples());
        // Sums of whole numbers: the order of the tiles changes nothing.
        let mut counts = self.counts.lock().unwrap_or_else(PoisonError::into_inner);
        *counts = std::mem::take(&mut *counts).add(of_tile);
        tile
    }
}

#[cfg(test)]
mod tests {
    use super::super::LayerStack;
    use super::super::test_layers::{boundary, camera};
    use super::*;

    fn stack(count: u32) -> Vec<Boundary> {
        (0..count).map(|i| boundary(1.0 + i as f32)).collect()
    }

    #[test]
    fn each_sample_keeps_its_nearest_layers() {
        let with = |depth: f32, samples: u16| Boundary { samples, ..boundary(depth) };
        let pixel = vec![with(1.0, 0b0011), with(2.0, 0b1111), with(3.0, 0b0111), with(4.0, 0b1000), with(5.0, 0b0001)];
        let source = LayerStack::from_fn(camera(3, 2), 4, |x, _| if x == 1 { pixel.clone() } else { Vec::new() });
        let masks = |most: u32| -> Vec<u16> {
            let tile = first_layers(source.draw(PixelRect { x0: 0, y0: 0, x1: 3, y1: 2 }), 4, most);
            assert!(tile.at(0, 1).is_empty());
            tile.at(1, 1).iter().map(|b| b.samples).collect()
        };
        assert!(masks(0).is_empty());
        assert_eq!(masks(1), [0b0011, 0b1100]);
        assert_eq!(masks(2), [0b0011, 0b1111, 0b0100, 0b1000]);
        assert_eq!(masks(3), [0b0011, 0b1111, 0b0111, 0b1000]);
        assert_eq!(masks(4), [0b0011, 0b1111, 0b0111, 0b1000, 0b0001]);
        let counts = LayerCounts::of(&source);
        // Two pixels; the samples meet 4, 3, 2 and 2 boundaries.
        assert_eq!((counts.pixels, counts.samples), (vec![2, 2, 2, 2], vec![8, 8, 4, 2]));
    }

    #[test]
    fn bits_beyond_the_samples_are_no_samples() {
        let whole =
            || vec![Boundary { samples: u16::MAX, ..boundary(1.0) }, Boundary { samples: u16::MAX, ..boundary(2.0) }];
        for samples in [1, 4, MAX_SAMPLES] {
            let source = LayerStack::from_fn(camera(5, 1), samples, |_, _| whole());
            let counts = LayerCounts::of(&source);
            let bits = u64::from(samples);
            assert_eq!((counts.pixels, counts.samples), (vec![5, 5], vec![5 * bits, 5 * bits]));
            let rect = PixelRect { x0: 0, y0: 0, x1: 5, y1: 1 };
            assert_eq!(first_layers(source.draw(rect), samples, 1).boundaries.len(), 5);
        }
    }

    #[test]
    fn layers_are_worth_their_pixels_and_what_is_left_out_is_told() {
        // 130 · 70 pixels: all have one boundary, a quarter three, one pixel nine.
        let source = LayerStack::from_fn(camera(130, 70), 1, |x, y| match (x, y) {
            (7, 9) => stack(9),
            _ if x % 2 == 0 && y % 2 == 0 => stack(3),
            _ => stack(1),
        });
        let counts = LayerCounts::of(&source);
        let counted = Counted::new(&source);
        LayerStack::collect(&counted);
        assert_eq!(counted.into_counts(), counts);
        let quarter = 65 * 35 + 1;
        assert_eq!(counts.pixels[..4], [130 * 70, quarter, quarter, 1]);
        assert_eq!((counts.worth(2, None), counts.worth(1, None), counts.worth(1_000_000, None)), (3, 9, 1));
        assert_eq!((counts.worth(2, Some(2)), counts.worth(0, None)), (2, 9));
        let left = counts.left_out(1);
        assert_eq!(left.pixels, quarter as f64 / (130.0 * 70.0));
        assert_eq!(left.boundaries, (2 * quarter + 6) as f64 / (130.0 * 70.0 + (2 * quarter + 6) as f64));
        assert_eq!(counts.left_out(9), LeftOut::default());
        let nothing = LayerCounts::of(&LayerStack::from_fn(camera(4, 4), 1, |_, _| Vec::new()));
        assert_eq!((nothing.worth(5, None), nothing.left_out(0)), (0, LeftOut::default()));
    }
}
