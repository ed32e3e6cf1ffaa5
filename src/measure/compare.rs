//! How far one picture's nearest boundaries are from the truth's.
//!
//! Each measure is defined on [`Comparison`]. What a pixel sees is its nearest boundary, whichever of its samples saw it, so
//! tables are drawn with one sample. The pixels judged are those that either picture covers. Silhouettes and cut
//! edges are those of [`super::outline`]; "within 1 px" of one means that a pixel's centre is at most 1 px from a crack of
//! it, which holds for the pixels on both sides of the crack and for those that touch an end of it.

use serde::{Deserialize, Serialize};

use super::outline::{Crack, CrackKind, Outline, label};
use crate::layers::LayerStack;

/// Pixels closer to an edge than this are not blamed for what a sample at a pixel's centre cannot know.
const NEAR_PX: f64 = 1.0;

/// The share of sorted errors below a "95 %" figure.
const P95: f64 = 0.95;

/// Why two pictures cannot be compared.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CompareError {
    /// Their sizes differ.
    #[error("the pictures differ in size: {test:?} and {truth:?} pixels; draw both with one camera")]
    SizesDiffer {
        /// Columns and rows of the picture under test.
        test: (u32, u32),
        /// Columns and rows of the truth.
        truth: (u32, u32),
    },
    /// Neither covers a pixel.
    #[error("both pictures are empty, so there is nothing to compare: is the camera looking at the scene?")]
    BothEmpty,
}

/// The measures of one picture against the truth. Shares are from 0 to 1.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Comparison {
    /// Pixels that either picture covers; the shares below are of these.
    pub pixels: u64,
    /// Share of pixels whose coverage, leaf or facing differs from the truth's and that lie further than 1 px from the
    /// truth's silhouettes and cut edges.
    pub wrong_pixels: f64,
    /// Share of pixels that differ likewise, within 1 px of them.
    pub near_edge_wrong: f64,
    /// Length of the truth's cut edges in pixels.
    pub cut_edge_length_px: f64,
    /// Mean error of the cut edge: the number of pixels that differ further than 1 px from the truth's silhouettes (holes
    /// and spill included), divided by `cut_edge_length_px`. `None` where the truth has no cut edge.
    pub edge_px: Option<f64>,
    /// The distance in pixels below which 95 % of the two pictures' cut edges lie from each other. Taken both ways: from
    /// the truth's cut edges to the nearest border between leaves in the test, and from the test's borders, further than
    /// 1 px from the truth's silhouettes, to the nearest cut edge or silhouette of the truth. Where the test has no border
    /// at all, the picture's diagonal. `None` where the truth has no cut edge.
    pub edge_px_p95: Option<f64>,
    /// The largest of those distances.
    pub edge_px_max: Option<f64>,
    /// Root mean square difference of depth in footprints, over the pixels of equal leaf and facing further than 1 px from
    /// the truth's silhouettes. `None` where there is none.
    pub depth_px: Option<f64>,
    /// Mean angle between the normals, degrees, over the same pixels.
    pub normal_deg: Option<f64>,
    /// The angle below which 95 % of them lie.
    pub normal_deg_p95: Option<f64>,
    /// Pixels that the truth covers and the test does not, further than 1 px from the truth's silhouettes.
    pub holes: u64,
    /// Pixels that the test covers and the truth does not, further than 1 px from the truth's silhouettes.
    pub spill: u64,
    /// Share of pixels whose number of boundaries differs.
    pub layers_wrong: f64,
}

/// How a pixel of the test differs from the truth.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Difference {
    /// Both see the same leaf from the same side, or nothing.
    None,
    /// Both see something, of different leaf or facing.
    WrongLeaf,
    /// The truth sees something, the test nothing.
    Hole,
    /// The test sees something, the truth nothing.
    Spill,
}

/// Two pictures' outlines and the distances to the truth's edges: what measures and pictures of differences share.
pub(super) struct Judge {
    pub truth: Outline,
    pub test: Outline,
    to_silhouette: super::outline::CrackDistances,
    to_any_edge: super::outline::CrackDistances,
}

impl Judge {
    pub fn new(test: &LayerStack, truth: &LayerStack) -> Result<Self, CompareError> {
        let size = |stack: &LayerStack| (stack.camera.width, stack.camera.height);
        if size(test) != size(truth) {
            return Err(CompareError::SizesDiffer { test: size(test), truth: size(truth) });
        }
        let (truth, test) = (Outline::of(truth), Outline::of(test));
        let to_silhouette = truth.distances(truth.cracks_of(CrackKind::Silhouette));
        let to_any_edge = truth.distances(truth.cracks.iter());
        Ok(Self { truth, test, to_silhouette, to_any_edge })
    }

    pub fn pixels(&self) -> impl Iterator<Item = (u32, u32)> + use<> {
        let (width, height) = (self.truth.width, self.truth.height);
        (0..height).flat_map(move |y| (0..width).map(move |x| (x, y)))
    }

    pub fn difference(&self, pixel: (u32, u32)) -> Difference {
        match (self.test.at(pixel), self.truth.at(pixel)) {
            (None, None) => Difference::None,
            (None, Some(_)) => Difference::Hole,
            (Some(_), None) => Difference::Spill,
            (Some(a), Some(b)) if label(a) == label(b) => Difference::None,
            _ => Difference::WrongLeaf,
        }
    }

    pub fn near_silhouette(&self, pixel: (u32, u32)) -> bool {
        self.to_silhouette.from_pixel(pixel) <= NEAR_PX
    }

    pub fn near_edge(&self, pixel: (u32, u32)) -> bool {
        self.to_any_edge.from_pixel(pixel) <= NEAR_PX
    }

    /// Symmetric distances between the cut edges of both, in pixels, ascending; see [`Comparison::edge_px_p95`].
    fn edge_distances(&self) -> Vec<f64> {
        let diagonal = f64::from(self.truth.width).hypot(f64::from(self.truth.height));
        let borders = || self.test.cracks.iter().filter(|crack| crack.between_labels);
        let to_test = self.test.distances(borders());
        let from_truth = self.truth.cracks_of(CrackKind::Cut).map(|crack| to_test.from_crack(crack).min(diagonal));
        let off_silhouette = |crack: &&Crack| !(self.to_silhouette.from_crack(crack) <= NEAR_PX);
        let from_test = borders().filter(off_silhouette).map(|crack| self.to_any_edge.from_crack(crack).min(diagonal));
        let mut distances: Vec<f64> = from_truth.chain(from_test).collect();
        distances.sort_by(f64::total_cmp);
        distances
    }
}

/// Measures `test` against `truth`: the nearest boundaries of two pictures drawn with one camera.
///
/// # Errors
/// [`CompareError`] where the sizes differ or both are empty.
pub fn compare(test: &LayerStack, truth: &LayerStack) -> Result<Comparison, CompareError> {
    let judge = Judge::new(test, truth)?;
    let (mut pixels, mut far, mut near, mut off_silhouette) = (0u64, 0u64, 0u64, 0u64);
    let (mut holes, mut spill, mut layers_wrong) = (0u64, 0u64, 0u64);
    let mut squared_depth_error = 0.0;
    let mut angles = Vec::new();
    for pixel @ (x, y) in judge.pixels() {
        let (seen, expected) = (judge.test.at(pixel), judge.truth.at(pixel));
        if seen.is_none() && expected.is_none() {
            continue;
        }
        pixels += 1;
        layers_wrong += u64::from(test.at(x, y).len() != truth.at(x, y).len());
        let difference = judge.difference(pixel);
        if difference != Difference::None {
            *if judge.near_edge(pixel) { &mut near } else { &mut far } += 1;
        }
        if judge.near_silhouette(pixel) {
            continue;
        }
        off_silhouette += u64::from(difference != Difference::None);
        holes += u64::from(difference == Difference::Hole);
        spill += u64::from(difference == Difference::Spill);
        if let (Difference::None, Some(seen), Some(expected)) = (difference, seen, expected) {
            let (depth, expected_depth) = (f64::from(seen.depth), f64::from(expected.depth));
            squared_depth_error += ((depth - expected_depth) / truth.camera.footprint(expected_depth)).powi(2);
            angles.push(seen.normal.as_dvec3().angle_between(expected.normal.as_dvec3()).to_degrees());
        }
    }
    if pixels == 0 {
        return Err(CompareError::BothEmpty);
    }
    let share = |count: u64| count as f64 / pixels as f64;
    let cut_edge_length_px = judge.truth.length_px(CrackKind::Cut);
    let has_edge = cut_edge_length_px > 0.0;
    let edge_distances = if has_edge { judge.edge_distances() } else { Vec::new() };
    angles.sort_by(f64::total_cmp);
    let mean = |sum: f64| (!angles.is_empty()).then(|| sum / angles.len() as f64);
    Ok(Comparison {
        pixels,
        wrong_pixels: share(far),
        near_edge_wrong: share(near),
        cut_edge_length_px,
        edge_px: has_edge.then(|| off_silhouette as f64 / cut_edge_length_px),
        edge_px_p95: quantile(&edge_distances, P95),
        edge_px_max: edge_distances.last().copied(),
        depth_px: mean(squared_depth_error).map(f64::sqrt),
        normal_deg: mean(angles.iter().sum()),
        normal_deg_p95: quantile(&angles, P95),
        holes,
        spill,
        layers_wrong: share(layers_wrong),
    })
}

/// The least value of ascending `sorted` that is not below `share` of them; `None` where there is none.
fn quantile(sorted: &[f64], share: f64) -> Option<f64> {
    let rank = (share * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.saturating_sub(1)).copied()
}

impl Comparison {
    /// The measures as an aligned table of name, value and unit, one a line.
    pub fn to_text(&self) -> String {
        let percent = |share: f64| format!("{:.4}", 100.0 * share);
        let number = |value: f64| format!("{value:.4}");
        let edge = |value: Option<f64>| value.map_or("no cut edge in the truth".to_owned(), number);
        let over_pixels = |value: Option<f64>| value.map_or("no pixel to judge".to_owned(), number);
        let rows = [
            ("pixels", self.pixels.to_string(), ""),
            ("wrong_pixels", percent(self.wrong_pixels), "%"),
            ("near_edge_wrong", percent(self.near_edge_wrong), "%"),
            ("cut_edge_length", format!("{:.1}", self.cut_edge_length_px), "px"),
            ("edge_px", edge(self.edge_px), "px"),
            ("edge_px_p95", edge(self.edge_px_p95), "px"),
            ("edge_px_max", edge(self.edge_px_max), "px"),
            ("depth_px", over_pixels(self.depth_px), "px"),
            ("normal_deg", over_pixels(self.normal_deg), "deg"),
            ("normal_deg_p95", over_pixels(self.normal_deg_p95), "deg"),
            ("holes", self.holes.to_string(), "px"),
            ("spill", self.spill.to_string(), "px"),
            ("layers_wrong", percent(self.layers_wrong), "%"),
        ];
        let name_width = rows.iter().map(|row| row.0.len()).max().unwrap_or(0);
        let value_width = rows.iter().map(|row| row.1.len()).max().unwrap_or(0);
        let mut text = String::new();
        for (name, value, unit) in rows {
            text.push_str(format!("{name:<name_width$}  {value:>value_width$} {unit}").trim_end());
            text.push('\n');
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use glam::{DVec2, DVec3};

    use super::super::outline::tests::{SIDE, boundary, camera, flat};
    use super::*;
    use crate::layers::{Boundary, Facing};
    use crate::space::{Camera, Lens};

    /// Leaf 0 left of column `x`, leaf 1 right of it, everywhere covered.
    fn halves(x: f64) -> LayerStack {
        flat(|px| Some(u32::from(px.x > x)))
    }

    /// A covered disc of `radius` pixels, halved at column 48.
    fn disc(radius: f64) -> LayerStack {
        flat(|px| ((px - DVec2::splat(48.0)).length() < radius).then_some(u32::from(px.x > 48.0)))
    }

    /// `halves(48)` with each pixel's boundary changed.
    fn halves_with(change: impl Fn(u32, u32, &mut Boundary) + Sync) -> LayerStack {
        let base = halves(48.0);
        LayerStack::from_fn(camera(), 1, |x, y| {
            let mut boundary = base.at(x, y)[0];
            change(x, y, &mut boundary);
            vec![boundary]
        })
    }

    #[test]
    fn the_truth_is_perfect() {
        for stack in [halves(48.0), disc(40.0)] {
            let c = compare(&stack, &stack).unwrap();
            assert_eq!((c.wrong_pixels, c.near_edge_wrong, c.layers_wrong), (0.0, 0.0, 0.0));
            assert_eq!((c.edge_px, c.edge_px_p95, c.edge_px_max), (Some(0.0), Some(0.0), Some(0.0)));
            assert_eq!((c.depth_px, c.normal_deg, c.normal_deg_p95), (Some(0.0), Some(0.0), Some(0.0)));
            assert_eq!((c.holes, c.spill), (0, 0));
        }
    }

    #[test]
    fn an_edge_moved_by_five_pixels_is_five_pixels_off() {
        let c = compare(&halves(53.0), &halves(48.0)).unwrap();
        let side = f64::from(SIDE);
        assert_eq!(c.cut_edge_length_px, side);
        assert_eq!((c.edge_px, c.edge_px_p95, c.edge_px_max), (Some(5.0), Some(5.0), Some(5.0)));
        // Of the five columns, one lies within 1 px of the true edge.
        assert_eq!(c.wrong_pixels, 4.0 / side);
        assert_eq!(c.near_edge_wrong, 1.0 / side);
        assert_eq!((c.holes, c.spill), (0, 0));
    }

    #[test]
    fn an_edge_moved_by_one_pixel_is_near_edge_only_but_edge_px_sees_it() {
        let c = compare(&halves(49.0), &halves(48.0)).unwrap();
        assert_eq!(c.wrong_pixels, 0.0);
        assert_eq!(c.near_edge_wrong, 1.0 / f64::from(SIDE));
        assert_eq!((c.edge_px, c.edge_px_max), (Some(1.0), Some(1.0)));
    }

    #[test]
    fn a_stray_island_shows_in_the_maximum_and_not_in_the_95_percent() {
        let island = |px: DVec2| (px - DVec2::new(20.5, 40.5)).abs().max_element() < 0.6;
        let test = flat(|px| Some(u32::from(px.x > 48.0 || island(px))));
        let c = compare(&test, &halves(48.0)).unwrap();
        assert_eq!(c.edge_px_p95, Some(0.0));
        assert_eq!(c.edge_px_max, Some(28.0));
        assert_eq!(c.edge_px, Some(1.0 / f64::from(SIDE)));
        assert_eq!(c.wrong_pixels, 1.0 / f64::from(SIDE * SIDE));
    }

    #[test]
    fn a_missing_edge_is_a_diagonal_away() {
        let c = compare(&flat(|_| Some(0)), &halves(48.0)).unwrap();
        let diagonal = f64::from(SIDE).hypot(f64::from(SIDE));
        assert_eq!((c.edge_px_p95, c.edge_px_max), (Some(diagonal), Some(diagonal)));
        assert_eq!(c.edge_px, Some(f64::from(SIDE) / 2.0));
    }

    #[test]
    fn holes_and_spill_are_counted_off_the_silhouette_only() {
        let truth = disc(40.0);
        let grown = compare(&disc(40.9), &truth).unwrap();
        assert_eq!((grown.holes, grown.spill, grown.wrong_pixels), (0, 0, 0.0));
        assert!(grown.near_edge_wrong > 0.0);
        let ring = compare(&disc(44.0), &truth).unwrap();
        let area = std::f64::consts::PI * (44f64.powi(2) - 41f64.powi(2));
        assert!((ring.spill as f64 / area - 1.0).abs() < 0.1, "{} of {area}", ring.spill);
        assert_eq!(ring.holes, 0);
        let shrunk = compare(&disc(36.0), &truth).unwrap();
        assert!(shrunk.holes > 500 && shrunk.spill == 0);
        let hole = compare(&flat(|px| (px.x > 1.0 || px.y > 1.0).then_some(u32::from(px.x > 48.0))), &halves(48.0));
        let hole = hole.unwrap();
        assert_eq!((hole.holes, hole.pixels), (1, u64::from(SIDE * SIDE)));
        assert_eq!(hole.edge_px, Some(1.0 / f64::from(SIDE)));
    }

    #[test]
    fn facing_counts_like_the_leaf() {
        let turned = halves_with(|x, _, boundary| {
            if x < 10 {
                boundary.facing = Facing::Back;
            }
        });
        let c = compare(&turned, &halves(48.0)).unwrap();
        assert_eq!(c.wrong_pixels, 10.0 / f64::from(SIDE));
        assert_eq!(c.edge_px, Some(10.0));
    }

    #[test]
    fn depth_error_is_in_footprints() {
        let deeper = halves_with(|_, _, boundary| boundary.depth += 0.5);
        let c = compare(&deeper, &halves(48.0)).unwrap();
        assert!((c.depth_px.unwrap() - 0.5).abs() < 1e-6); // one unit per pixel
        assert_eq!((c.edge_px, c.wrong_pixels), (Some(0.0), 0.0));

        // With a perspective camera the footprint grows with depth.
        let lens = Lens::FovY(90.0);
        let camera = Camera::look_at(DVec3::Z, DVec3::ZERO, DVec3::Y, lens, 64, 64).unwrap();
        let wall = |depth| LayerStack::from_fn(camera.clone(), 1, |_, _| vec![boundary(0, depth, DVec3::Z)]);
        let c = compare(&wall(32.5), &wall(32.0)).unwrap();
        assert!((c.depth_px.unwrap() - 0.5).abs() < 1e-6); // at depth 32, 64 pixels span 64 units
    }

    #[test]
    fn normal_error_is_in_degrees_and_its_tail_shows() {
        let tilt = |degrees: f64| DVec3::new(degrees.to_radians().sin(), 0.0, degrees.to_radians().cos()).as_vec3();
        // One column in twelve (8.3 %) is off by 30°, the others by 3°.
        let tilted = halves_with(|x, _, b| b.normal = tilt(if x % 12 == 0 { 30.0 } else { 3.0 }));
        let c = compare(&tilted, &halves(48.0)).unwrap();
        assert!((c.normal_deg.unwrap() - (30.0 + 11.0 * 3.0) / 12.0).abs() < 1e-3);
        assert!((c.normal_deg_p95.unwrap() - 30.0).abs() < 1e-3);
    }

    #[test]
    fn a_differing_number_of_boundaries_counts() {
        let truth = halves(48.0);
        let deeper = LayerStack::from_fn(camera(), 1, |x, y| {
            let nearest = truth.at(x, y)[0];
            if x == 7 { vec![nearest, Boundary { depth: 20.0, ..nearest }] } else { vec![nearest] }
        });
        let c = compare(&deeper, &truth).unwrap();
        assert_eq!(c.layers_wrong, 1.0 / f64::from(SIDE));
        assert_eq!(c.wrong_pixels, 0.0);
    }

    #[test]
    fn a_truth_without_cut_edge_says_so() {
        let c = compare(&halves(48.0), &flat(|_| Some(0))).unwrap();
        assert_eq!((c.edge_px, c.edge_px_p95, c.edge_px_max), (None, None, None));
        assert_eq!(c.wrong_pixels, 0.5);
        assert!(c.to_text().contains("no cut edge in the truth"));
    }

    #[test]
    fn nothing_to_compare_is_an_error() {
        let empty = flat(|_| None);
        assert_eq!(compare(&empty, &empty), Err(CompareError::BothEmpty));
        let lens = Lens::Height(1.0);
        let small = Camera::look_at(DVec3::Z, DVec3::ZERO, DVec3::Y, lens, 8, 8).unwrap();
        let small = LayerStack::from_fn(small, 1, |_, _| vec![]);
        assert!(matches!(compare(&small, &empty), Err(CompareError::SizesDiffer { .. })));
        // One empty picture is not an error but as wrong as can be.
        let c = compare(&empty, &halves(48.0)).unwrap();
        assert_eq!(c.holes, c.pixels);
        assert_eq!((c.depth_px, c.normal_deg), (None, None));
    }

    #[test]
    fn survives_json_and_lines_up_as_text() {
        let c = compare(&halves(53.0), &halves(48.0)).unwrap();
        let json = serde_json::to_string(&c).unwrap();
        assert_eq!(serde_json::from_str::<Comparison>(&json).unwrap(), c);
        let text = c.to_text();
        assert!(text.lines().any(|line| line.starts_with("edge_px ") && line.ends_with("5.0000 px")), "{text}");
    }
}
