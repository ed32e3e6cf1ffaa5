//! Rays that graze a closed scan: they meet it by turns, first a side that faces the eye, and beside it nothing.

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

/// Of the pixels that a noisy scan covers, those that may see its far side through it, per thousand: 17 of 9766 do, and 69 if
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

/// Rays that just miss a scan meet nothing: at a hundredfold magnification of its silhouettes no pixel is covered whose
/// neighbours on both sides, left and right or above and below, are not. (Met by the half of the surfels that faces it, such
/// rays drew dashes there, of 228 pixels.)
#[test]
fn nothing_is_drawn_beside_a_silhouette() {
    const VIEWS: u32 = 12;
    const SIZE: u32 = 96;
    const DISTANCE: f64 = 4.0;
    /// A pixel is 4e-5 wide at the silhouette, where the scan's spacing is 0.02.
    const FOV_Y_DEGREES: f64 = 0.06;
    let (radius, tube) = (1.0, 0.4);
    let torus = Solid::Torus { centre: DVec3::ZERO, axis: DVec3::Z, radius, tube };
    let cloud = scan(&torus, &ScanOptions::regular(10_000, 1).sampled(Sampling::IRREGULAR)).unwrap();
    let surfels = from_cloud(cloud, DAffine3::IDENTITY, &CloudOptions::default(), &|_| ()).unwrap().0;
    let model = Model::new(&tree("a"), vec![LeafField::new(surfels, None, LeafKind::Solid)], looks(1));
    let (mut covered, mut alone) = (0, 0);
    for view in 0..VIEWS {
        // The outermost circle's tangent from the eye, which is in its plane.
        let azimuth = std::f64::consts::TAU * f64::from(view) / f64::from(VIEWS);
        let aside = ((radius + tube) / DISTANCE).acos();
        let eye = DVec3::new(azimuth.cos(), azimuth.sin(), 0.0) * DISTANCE;
        let target = DVec3::new((azimuth + aside).cos(), (azimuth + aside).sin(), 0.0) * (radius + tube);
        for limit in [LayerLimit::All, LayerLimit::Nearest] {
            let camera = camera(eye, target, FOV_Y_DEGREES, SIZE);
            let stack = LayerStack::collect(&Frame::new(&model, camera, limit, 1, SplatSettings::default(), None));
            let is_covered = |x: u32, y: u32| !stack.at(x, y).is_empty();
            for (x, y) in (1..SIZE - 1).flat_map(|y| (1..SIZE - 1).map(move |x| (x, y))) {
                let beside = [(x - 1, y), (x + 1, y)].map(|(x, y)| is_covered(x, y));
                let above = [(x, y - 1), (x, y + 1)].map(|(x, y)| is_covered(x, y));
                covered += usize::from(is_covered(x, y));
                alone += usize::from(is_covered(x, y) && (beside == [false; 2] || above == [false; 2]));
            }
        }
    }
    println!("{alone} of {covered} alone");
    assert!(covered > 10_000, "{covered} covered");
    assert_eq!(alone, 0, "of {covered}");
}
