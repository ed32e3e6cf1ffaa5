//! A seeded search for scenes in which Wicke's rule for *unknown* leaves fails.
//!
//! *Theory.* Wicke 2004 §3.3.1 drops a leaf without clipping partners from the expression, and partners are edge surfels
//! alone. Whether a surfel is an edge surfel is decided by its own radius, whether two are partners by the sum of their
//! radii: so where sampling densities differ, a coarse edge surfel beside fine surface surfels finds no partners, and a
//! leaf that matters is dropped. Whether that shows depends on where single surfels lie; so it is searched, not derived.
//!
//! *Practice.* [`random_case`] makes a scene from a seed: three to five spheres, joined by a random tree, each scanned at a
//! density of its own. [`judge`] draws it under the paper's rule and under the resolved one, all else as in
//! the paper, and under the defaults. What tells is the *difference* of the first two: the flat disks of a coarse scan
//! make both wrong alike.

use glam::DVec3;

use super::compare::{CompareError, compare};
use super::open::{open_reference, open_surfels};
use super::rng::Rng;
use super::scenes::{Case, CaseLeaf, leaf, sphere, view_from};
use super::simulate::ScanOptions;
use super::suite::DrawError;
use crate::layers::LayerLimit;
use crate::splat::{Partners, SplatSettings, Unknown};

/// Pixels a side of the pictures that are judged.
const SIDE: u32 = 128;

/// The rng's stream of these scenes; clouds have streams of their own.
const STREAM: u64 = 0x756e_6b6e;

/// The paper's way under either rule; partners are searched in space, so that pictures do not depend on what is in view.
const PAPER: SplatSettings = SplatSettings { partners: Partners::ObjectSpace, ..SplatSettings::PAPER };
const RESOLVED: SplatSettings = SplatSettings { unknown: Unknown::Resolved, ..PAPER };

/// The worst four of a thousand seeds for the paper's rule, of those whose result is not empty: `examples/search_unknown.rs` found them.
pub const WORST: [u64; 4] = [369, 616, 700, 540];

/// What a scene showed: shares of wrong pixels, 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Found {
    /// The scene's seed.
    pub seed: u64,
    /// Whether its result is empty, or out of the picture: then a share is 1 where anything is drawn.
    pub is_empty: bool,
    /// Under the paper's rule.
    pub paper: f64,
    /// Under the resolved rule, all else as in the paper.
    pub resolved: f64,
    /// Under the defaults.
    pub ours: f64,
}

impl Found {
    /// What the paper's rule alone gets wrong.
    pub fn lost(&self) -> f64 {
        self.paper - self.resolved
    }
}

/// The scene with this seed, named after it.
pub fn random_case(seed: u64) -> Case {
    // Powers of two apart, up to a ratio of 128.
    const COUNTS: [usize; 8] = [60, 120, 240, 480, 960, 1920, 3840, 7680];
    let mut rng = Rng::new(seed, STREAM);
    let mut between = |low: f64, high: f64| low + (high - low) * rng.uniform();
    let count = between(3.0, 6.0) as usize;
    let mut leaves: Vec<CaseLeaf> = Vec::new();
    for (i, name) in ["a", "b", "c", "d", "e"].into_iter().enumerate().take(count) {
        let point = DVec3::new(between(-0.7, 0.7), between(-0.7, 0.7), between(-0.7, 0.7));
        let solid = sphere(point.to_array(), between(0.35, 0.9));
        let points = COUNTS[between(0.0, 8.0) as usize];
        leaves.push(leaf(name, solid, ScanOptions::regular(points, seed * 8 + i as u64)));
    }
    let mut parts: Vec<String> = leaves.iter().map(|leaf| leaf.name.clone()).collect();
    while parts.len() > 1 {
        let right = parts.remove((between(0.0, 1.0) * parts.len() as f64) as usize);
        let left = parts.remove((between(0.0, 1.0) * parts.len() as f64) as usize);
        let operator = ["&", "|", "&", "|", "-"][between(0.0, 5.0) as usize];
        parts.push(format!("({left} {operator} {right})"));
    }
    let csg = parts.remove(0);
    let eye = DVec3::new(between(-1.0, 1.0), between(-1.0, 1.0), between(-0.3, 0.8)).normalize_or(DVec3::NEG_Y) * 3.6;
    let about = "Found by a search for scenes in which the paper's rule for unknown leaves fails";
    let case = Case::new(format!("unknown_seed_{seed}"), about, leaves, csg, view_from(eye.to_array()));
    Case { zooms: vec![1.0], ..case }
}

/// Draws the scene with this seed under both rules.
///
/// # Errors
/// Where a pipeline cannot draw it.
pub fn judge(seed: u64) -> Result<Found, DrawError> {
    let case = random_case(seed);
    let mut scene = case.scene()?;
    scene.size = (SIDE, SIDE);
    let camera = case.camera.camera(scene.size)?;
    let truth = open_reference(&scene, LayerLimit::Nearest)?(&camera)?;
    let wrong = |settings| -> Result<f64, DrawError> {
        let picture = open_surfels(&scene, LayerLimit::Nearest, settings)?(&camera)?;
        match compare(&picture, &truth) {
            Ok(comparison) => Ok(comparison.wrong_pixels),
            Err(CompareError::BothEmpty) => Ok(0.0),
            Err(error) => Err(error.into()),
        }
    };
    let [paper, resolved, ours] = [wrong(PAPER)?, wrong(RESOLVED)?, wrong(SplatSettings::default())?];
    let is_empty = truth.tiles().iter().all(|tile| tile.boundaries.is_empty());
    Ok(Found { seed, is_empty, paper, resolved, ours })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_seed_is_a_scene_and_another_seed_another() {
        assert_eq!(random_case(7), random_case(7));
        assert_ne!(random_case(7).csg, random_case(8).csg);
        for seed in 0..50 {
            let case = random_case(seed);
            let scene = case.scene().unwrap();
            // Every leaf is used once.
            assert_eq!(scene.tree.leaves().len(), case.leaves.len(), "{}", case.csg);
        }
    }

    #[test]
    fn the_worst_are_wrong_under_the_papers_rule_alone() {
        for seed in WORST {
            let found = judge(seed).unwrap();
            println!("{found:?}");
            assert!(found.lost() > 0.4 && found.resolved < 0.5 * found.paper && found.ours == 0.0, "{found:?}");
        }
    }

    /// The search itself, small: the defaults are right everywhere, and the paper's rule is not.
    #[test]
    fn a_small_search_finds_the_papers_rule_wrong_and_the_defaults_right() {
        const SEEDS: u64 = 16;
        let found: Vec<Found> = (0..SEEDS).map(|seed| judge(seed).unwrap()).collect();
        assert!(found.iter().filter(|f| !f.is_empty).count() > 10);
        assert!(found.iter().all(|f| f.ours < 1e-3), "{found:?}");
        assert!(found.iter().any(|f| !f.is_empty && f.lost() > 0.02), "{found:?}");
    }
}
