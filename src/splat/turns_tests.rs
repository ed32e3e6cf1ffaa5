//! Rays meet a closed scan by turns: from outside, what they see first is a side that faces the eye.

use glam::{DAffine3, DVec3};

use super::Frame;
use super::settings::SplatSettings;
use super::test_scenes::{camera, looks, tree};
use crate::classify::{LeafField, Model};
use crate::geometry::Solid;
use crate::layers::{Facing, LayerLimit, LayerStack};
use crate::measure::simulate::{Sampling, ScanOptions, scan};
use crate::scene::LeafKind;
use crate::surfel::{CloudOptions, from_cloud};

/// Of the pixels that a noisy scan covers, those that may see its far side through it, per thousand: 16 of 9768 do, and 69 if
/// crossings are not put in turn.
const MOST_FAR_SIDES_IN_1000: usize = 2;

/// Pixels covered, and those whose nearest surface faces away, of a torus scanned with noise and without normals.
fn far_sides(limit: LayerLimit) -> (usize, usize) {
    let torus = Solid::Torus { centre: DVec3::ZERO, axis: DVec3::Z, radius: 1.0, tube: 0.3 };
    let options = ScanOptions::regular(20_000, 7).sampled(Sampling::Poisson).noisy(0.2, 0.0).without_normals();
    let cloud = scan(&torus, &options).unwrap();
    let surfels = from_cloud(cloud, DAffine3::IDENTITY, &CloudOptions::default(), &|_| ()).unwrap().0;
    let model = Model::new(&tree("a"), vec![LeafField::new(surfels, None, LeafKind::Solid)], looks(1));
    let mut found = (0, 0);
    for eye in [DVec3::new(3.0, -3.0, 0.9), DVec3::new(3.0, -3.0, 0.3)] {
        let camera = camera(eye, DVec3::ZERO, 35.0, 128);
        let stack = LayerStack::collect(&Frame::new(&model, camera, limit, 1, SplatSettings::default(), None));
        for (x, y) in (0..128).flat_map(|y| (0..128).map(move |x| (x, y))) {
            if let Some(first) = stack.at(x, y).first() {
                found.0 += 1;
                found.1 += usize::from(first.facing == Facing::Back);
            }
        }
    }
    found
}

#[test]
fn the_far_side_of_a_noisy_scan_does_not_show_through() {
    for limit in [LayerLimit::All, LayerLimit::Nearest] {
        let (covered, far) = far_sides(limit);
        println!("{limit:?}: {far} of {covered}");
        assert!(covered > 8000);
        assert!(far * 1000 <= MOST_FAR_SIDES_IN_1000 * covered, "{limit:?}: {far} of {covered}");
    }
}
