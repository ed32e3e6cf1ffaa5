//! How alike two line drawings are, and the layers of two pipelines.

use glam::DVec2;

use crate::composite::Picture;
use crate::layers::{Boundary, Facing, LayerStack};
use crate::space::Camera;

/// Pixels of a drawing with at least this much ink are its lines.
pub const IS_LINE: f32 = 0.5;
/// A line of another drawing is found where there is at least this much ink: half of a line that lies between two pixels.
pub const IS_FOUND: f32 = 0.25;

/// How much ink each pixel of a drawing has, 0 to 1: how far it is from paper to ink, in linear light.
#[derive(Debug, Clone)]
pub struct Ink {
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// Row by row.
    pub ink: Vec<f32>,
}

impl Ink {
    /// Of a drawing in black on white.
    pub fn black_on_white(picture: &Picture) -> Self {
        let ink = picture.pixels.iter().map(|pixel| 1.0 - pixel[1]).collect();
        Self { width: picture.width, height: picture.height, ink }
    }

    /// The pixels that are lines, as (column, row).
    pub fn lines(&self) -> impl Iterator<Item = (u32, u32)> + '_ {
        let is_line = |(_, ink): &(usize, &f32)| **ink >= IS_LINE;
        self.ink.iter().enumerate().filter(is_line).map(|(i, _)| (i as u32 % self.width, i as u32 / self.width))
    }

    /// The distance from a position in pixels to the middle of the nearest pixel with ink, up to `reach` pixels; infinite
    /// beyond.
    pub fn distance(&self, from: DVec2, reach: f64) -> f64 {
        let clamp = |value: f64, most: u32| value.clamp(0.0, f64::from(most)) as u32;
        let (x0, x1) = (clamp((from.x - reach).floor(), self.width), clamp((from.x + reach).ceil(), self.width));
        let (y0, y1) = (clamp((from.y - reach).floor(), self.height), clamp((from.y + reach).ceil(), self.height));
        let mut nearest = f64::INFINITY;
        for y in y0..y1 {
            for x in x0..x1 {
                if self.ink[(y * self.width + x) as usize] >= IS_FOUND {
                    nearest = nearest.min(from.distance(DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5)));
                }
            }
        }
        if nearest <= reach { nearest } else { f64::INFINITY }
    }

    /// The share of this drawing's lines with lines of `other` within `reach` pixels; `None` without lines.
    pub fn found_in(&self, other: &Self, reach: f64) -> Option<f64> {
        let (mut found, mut count) = (0u64, 0u64);
        for (x, y) in self.lines() {
            let middle = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
            found += u64::from(other.distance(middle, reach).is_finite());
            count += 1;
        }
        (count > 0).then(|| found as f64 / count as f64)
    }
}

/// How the layers of a pipeline agree with the truth's.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LayerAgreement {
    /// Boundaries of the truth, off silhouettes and edges, over all layers.
    pub boundaries: u64,
    /// Boundaries there that are missing, too many, of another leaf, facing another way, or at another depth.
    pub wrong: u64,
    /// The largest share of wrong boundaries in any layer with at least [`LEAST_LAYER`] pixels.
    pub worst_layer: f64,
    /// The most layers of the truth at a pixel.
    pub layers: usize,
}

/// Layers smaller than this many pixels have no share worth naming.
pub const LEAST_LAYER: u64 = 500;
/// Depths may differ by so many footprints, times the surface's slope.
const DEPTH_FOOTPRINTS: f64 = 1.0;
/// Steeper surfaces than this are at a silhouette: their depth is nothing to go by.
const STEEPEST: f64 = 12.0;

/// Compares two stacks of one camera, one sample a pixel, where the truth's eight neighbours have the boundaries that the pixel
/// has: off silhouettes and edges of every layer.
pub fn layer_agreement(test: &LayerStack, truth: &LayerStack) -> LayerAgreement {
    let camera = &truth.camera;
    let mut agreement = LayerAgreement::default();
    let mut by_layer: Vec<(u64, u64)> = Vec::new();
    for y in 1..camera.height.saturating_sub(1) {
        for x in 1..camera.width.saturating_sub(1) {
            let wanted = truth.at(x, y);
            let kinds = |list: &[Boundary]| list.iter().map(|b| (b.leaf, b.facing)).collect::<Vec<(u32, Facing)>>();
            let here = kinds(wanted);
            let at_edge = (y - 1..=y + 1).any(|v| (x - 1..=x + 1).any(|u| kinds(truth.at(u, v)) != here));
            if at_edge || wanted.iter().any(|b| slope(camera, b, x, y) > STEEPEST) {
                continue;
            }
            let got = test.at(x, y);
            agreement.layers = agreement.layers.max(wanted.len());
            for layer in 0..wanted.len().max(got.len()) {
                let right = match (wanted.get(layer), got.get(layer)) {
                    (Some(w), Some(g)) => {
                        let off = f64::from((w.depth - g.depth).abs()) / camera.footprint(f64::from(w.depth));
                        (w.leaf, w.facing) == (g.leaf, g.facing)
                            && off <= DEPTH_FOOTPRINTS * slope(camera, w, x, y).max(1.0)
                    }
                    _ => false,
                };
                if by_layer.len() <= layer {
                    by_layer.resize(layer + 1, (0, 0));
                }
                by_layer[layer].0 += 1;
                by_layer[layer].1 += u64::from(!right);
            }
        }
    }
    agreement.boundaries = by_layer.iter().map(|(count, _)| count).sum();
    agreement.wrong = by_layer.iter().map(|(_, wrong)| wrong).sum();
    let share = |(count, wrong): &(u64, u64)| *wrong as f64 / *count as f64;
    agreement.worst_layer = by_layer.iter().filter(|l| l.0 >= LEAST_LAYER).map(share).fold(0.0, f64::max);
    agreement
}

/// How many footprints a surface deepens by in a pixel.
fn slope(camera: &Camera, boundary: &Boundary, x: u32, y: u32) -> f64 {
    let ray = camera.ray(DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5));
    let normal = boundary.normal.as_dvec3();
    let along = normal.dot(ray.dir).abs();
    normal.cross(ray.dir).length() / along.max(f64::MIN_POSITIVE)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn column(at: u32) -> Ink {
        let ink = (0..400).map(|i| if i % 20 == at { 1.0 } else { 0.0 }).collect();
        Ink { width: 20, height: 20, ink }
    }

    #[test]
    fn lines_are_found_within_reach_and_not_beyond() {
        assert_eq!(column(5).found_in(&column(7), 2.0), Some(1.0));
        assert_eq!(column(5).found_in(&column(8), 2.0), Some(0.0));
        assert_eq!(column(30).found_in(&column(5), 2.0), None);
        assert_eq!(column(5).distance(DVec2::new(9.5, 3.5), 6.0), 4.0);
    }
}
