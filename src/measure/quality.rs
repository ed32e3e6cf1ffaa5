//! Likeness of two shaded pictures: structural similarity and peak signal-to-noise ratio.
//!
//! *Theory*: Wang, Bovik, Sheikh and Simoncelli, "Image Quality Assessment: From Error Visibility to Structural
//! Similarity", IEEE TIP 13 (2004), §III: means, variances and covariance under a Gaussian window of 11 × 11 pixels and
//! σ = 1.5, on luma, with C1 = (0.01 · 255)² and C2 = (0.03 · 255)².
//!
//! *Practice*: the mean is taken over a mask, the pixels that either picture covers, since a large empty background would
//! flatter any renderer. Windows that stick out of the picture are cut and weighted anew.

use image::RgbImage;
use serde::{Deserialize, Serialize};

/// The likeness of two pictures.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Quality {
    /// Mean structural similarity, 1 where they are equal.
    pub ssim: f64,
    /// Peak signal-to-noise ratio over red, green and blue, decibels; `None` where there is no difference.
    pub psnr: Option<f64>,
}

/// Why two pictures have no likeness.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum QualityError {
    /// Their sizes, or the mask's, differ.
    #[error("the pictures differ in size: {test:?} and {truth:?} pixels, the mask has {mask} pixels")]
    SizesDiffer {
        /// Columns and rows of the picture under test.
        test: (u32, u32),
        /// Columns and rows of the truth.
        truth: (u32, u32),
        /// Entries of the mask.
        mask: usize,
    },
    /// The mask holds no pixel.
    #[error("the mask holds no pixel, so there is nothing to compare")]
    EmptyMask,
}

/// The Gaussian window reaches this many pixels to each side.
const REACH: usize = 5;
/// Its standard deviation in pixels.
const SIGMA: f64 = 1.5;
/// The largest value of a channel.
const PEAK: f64 = 255.0;

/// Compares two sRGB pictures over the pixels where `mask`, row by row, is true.
///
/// # Errors
/// [`QualityError`] where the sizes differ or the mask is empty.
pub fn quality(test: &RgbImage, truth: &RgbImage, mask: &[bool]) -> Result<Quality, QualityError> {
    let area = truth.width() as usize * truth.height() as usize;
    if test.dimensions() != truth.dimensions() || mask.len() != area {
        let (test, truth) = (test.dimensions(), truth.dimensions());
        return Err(QualityError::SizesDiffer { test, truth, mask: mask.len() });
    }
    let count = mask.iter().filter(|inside| **inside).count();
    if count == 0 {
        return Err(QualityError::EmptyMask);
    }
    let inside = || mask.iter().zip(test.pixels().zip(truth.pixels())).filter(|(inside, _)| **inside);
    let squared: f64 =
        inside().flat_map(|(_, (a, b))| (0..3).map(move |c| (f64::from(a[c]) - f64::from(b[c])).powi(2))).sum();
    let mean_squared = squared / (3 * count) as f64;
    let psnr = (mean_squared > 0.0).then(|| 10.0 * (PEAK * PEAK / mean_squared).log10());

    let similarity = similarity(&luma(test), &luma(truth), truth.width() as usize);
    let sum: f64 = similarity.iter().zip(mask).filter(|(_, inside)| **inside).map(|(value, _)| value).sum();
    Ok(Quality { ssim: sum / count as f64, psnr })
}

/// Rec. 601 luma of the sRGB values, as the paper takes it.
fn luma(picture: &RgbImage) -> Vec<f64> {
    picture.pixels().map(|p| 0.299 * f64::from(p[0]) + 0.587 * f64::from(p[1]) + 0.114 * f64::from(p[2])).collect()
}

/// The similarity index at every pixel (equation 13).
fn similarity(a: &[f64], b: &[f64], width: usize) -> Vec<f64> {
    const C1: f64 = (0.01 * PEAK) * (0.01 * PEAK);
    const C2: f64 = (0.03 * PEAK) * (0.03 * PEAK);
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).collect::<Vec<_>>();
    let (mean_a, mean_b) = (blur(a, width), blur(b, width));
    let (square_a, square_b) = (blur(&product(a, a), width), blur(&product(b, b), width));
    let cross = blur(&product(a, b), width);
    (0..a.len())
        .map(|i| {
            let (ma, mb) = (mean_a[i], mean_b[i]);
            let (variance_a, variance_b) = (square_a[i] - ma * ma, square_b[i] - mb * mb);
            let covariance = cross[i] - ma * mb;
            ((2.0 * ma * mb + C1) * (2.0 * covariance + C2))
                / ((ma * ma + mb * mb + C1) * (variance_a + variance_b + C2))
        })
        .collect()
}

/// Gaussian means, rows then columns.
fn blur(values: &[f64], width: usize) -> Vec<f64> {
    let height = values.len() / width.max(1);
    let weights: Vec<f64> = (0..=REACH).map(|d| (-0.5 * (d as f64 / SIGMA).powi(2)).exp()).collect();
    let mean = |at: usize, length: usize, value: &dyn Fn(usize) -> f64| {
        let window = at.saturating_sub(REACH)..(at + REACH + 1).min(length);
        let (sum, total) = window.fold((0.0, 0.0), |(sum, total), i| {
            let weight = weights[i.abs_diff(at)];
            (sum + weight * value(i), total + weight)
        });
        sum / total
    };
    let cells = || (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
    let rows: Vec<f64> = cells().map(|(x, y)| mean(x, width, &|i| values[y * width + i])).collect();
    cells().map(|(x, y)| mean(y, height, &|i| rows[i * width + x])).collect()
}

#[cfg(test)]
mod tests {
    use image::Rgb;

    use super::*;

    const SIDE: u32 = 64;

    fn picture(value: impl Fn(u32, u32) -> u8) -> RgbImage {
        RgbImage::from_fn(SIDE, SIDE, |x, y| Rgb([value(x, y); 3]))
    }

    fn full() -> Vec<bool> {
        vec![true; (SIDE * SIDE) as usize]
    }

    #[test]
    fn equal_pictures_are_equal() {
        let p = picture(|x, y| (x * 3 + y) as u8);
        let q = quality(&p, &p, &full()).unwrap();
        assert!((q.ssim - 1.0).abs() < 1e-12);
        assert_eq!(q.psnr, None);
    }

    #[test]
    fn a_constant_offset_has_the_ratio_that_arithmetic_says() {
        let q = quality(&picture(|_, _| 110), &picture(|_, _| 100), &full()).unwrap();
        assert!((q.psnr.unwrap() - 10.0 * (255.0f64 * 255.0 / 100.0).log10()).abs() < 1e-9);
        // Without structure only the luminance term is left: (2ab + C1) / (a² + b² + C1).
        let c1 = 2.55f64 * 2.55;
        let luminance = (2.0 * 110.0 * 100.0 + c1) / (110.0f64.powi(2) + 100.0f64.powi(2) + c1);
        assert!((q.ssim - luminance).abs() < 1e-9);
    }

    #[test]
    fn opposite_structure_is_dissimilar() {
        let board = |x: u32, y: u32| (x / 2 + y / 2).is_multiple_of(2);
        let (a, b) =
            (picture(|x, y| if board(x, y) { 255 } else { 0 }), picture(|x, y| if board(x, y) { 0 } else { 255 }));
        assert!(quality(&a, &b, &full()).unwrap().ssim < -0.9);
    }

    #[test]
    fn only_the_mask_counts() {
        let (a, b) = (picture(|_, _| 50), picture(|x, _| if x < 32 { 50 } else { 200 }));
        let left: Vec<bool> = (0..SIDE * SIDE).map(|i| i % SIDE < 20).collect();
        let q = quality(&a, &b, &left).unwrap();
        assert!(q.psnr.is_none() && q.ssim > 0.999999);
        assert!(quality(&a, &b, &full()).unwrap().ssim < 0.95);
        assert_eq!(quality(&a, &b, &vec![false; full().len()]), Err(QualityError::EmptyMask));
        assert!(matches!(quality(&a, &b, &[true]), Err(QualityError::SizesDiffer { .. })));
    }
}
