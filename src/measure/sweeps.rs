//! Stability sweeps: one scene each, and one thing that is pushed until methods break.
//!
//! Each step of a sweep is an ordinary [`Case`] whose `parameter` says how far the thing was pushed. Truth stays the clean
//! solid whatever is done to the scan.

use glam::DVec3;

use super::scenes::Bars;
use super::scenes::{Case, density, half_space, leaf, sphere, torus, torus_drill, torus_minus_cylinder, view_from};
use super::simulate::{Gaps, Sampling, ScanOptions};
use crate::geometry::Solid;
use crate::scene::CameraSpec;
use crate::space::Lens;

/// One thing, pushed.
#[derive(Debug, Clone, PartialEq)]
pub struct Sweep {
    /// Its name, fit for a file.
    pub name: &'static str,
    /// What the parameter is, with its unit.
    pub parameter: &'static str,
    /// From easy to hard.
    pub cases: Vec<Case>,
}

/// Points on the torus and its drill in the sweeps of noise, of zoom and of sampling.
const TORUS_POINTS: usize = 15_000;

/// One more magnification than the tables' would make a sweep slow, one less would hide what fails: they are drawn at both.
const SWEEP_ZOOMS: [f64; 2] = [1.0, 10.0];

impl Sweep {
    fn new(
        name: &'static str,
        parameter: &'static str,
        values: &[f64],
        zooms: &[f64],
        case: impl Fn(f64) -> Case,
    ) -> Self {
        let step = |&value: &f64| {
            let case = case(value);
            Case {
                name: format!("{name}_{value}"),
                zooms: zooms.to_vec(),
                bars: Bars::NONE,
                parameter: Some(value),
                ..case
            }
        };
        Self { name, parameter, cases: values.iter().map(step).collect() }
    }
}

/// Every sweep.
pub fn sweeps() -> Vec<Sweep> {
    const DIHEDRAL_DEG: [f64; 6] = [30.0, 10.0, 3.0, 1.0, 0.3, 0.1];
    vec![
        Sweep::new("dihedral", "angle between two planes [deg]", &DIHEDRAL_DEG, &[1.0], |angle| roof(angle, 0.0, 0.0)),
        Sweep::new(
            "dihedral_noisy",
            "angle between two planes [deg], noise 1 % of spacing and 0.1 deg",
            &DIHEDRAL_DEG,
            &[1.0],
            |angle| roof(angle, 0.01, 0.1),
        ),
        Sweep::new(
            "position_noise",
            "position noise [spacings]",
            &[0.0, 0.01, 0.03, 0.1, 0.3, 0.5],
            &SWEEP_ZOOMS,
            |noise| noisy_torus(noise, 0.0),
        ),
        Sweep::new(
            "normal_noise",
            "normal noise [deg]",
            &[0.0, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0],
            &SWEEP_ZOOMS,
            |noise| noisy_torus(0.0, noise),
        ),
        Sweep::new(
            "distance",
            "distance from the origin",
            &[0.0, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7],
            &SWEEP_ZOOMS,
            far_from_origin,
        ),
        // Each step has one magnification, its parameter. Two balls lie in the model class of curved surfels, so what is wrong
        // with them are numbers; the torus does not, so what is wrong with it is mostly the model.
        zoom_sweep("zoom", "magnification of a torus minus a cylinder", noisy_torus(0.0, 0.0)),
        zoom_sweep("zoom_balls", "magnification of a ball minus a ball", far_from_origin(0.0)),
        Sweep::new("density", "ratio of densities", &[1.0, 10.0, 30.0, 100.0, 300.0, 900.0], &SWEEP_ZOOMS, |ratio| {
            density("", 30_600, ratio as usize)
        }),
        Sweep::new("flipped", "share of normals flipped", &[0.0, 0.001, 0.01, 0.05, 0.2], &SWEEP_ZOOMS, |flipped| {
            torus_scanned(|options| ScanOptions { flipped, ..options })
        }),
        Sweep::new(
            "gaps",
            "radius of 20 missing patches [spacings]",
            &[0.0, 1.0, 2.0, 4.0, 8.0],
            &SWEEP_ZOOMS,
            |radius| torus_scanned(|options| ScanOptions { gaps: Some(Gaps { count: 20, radius }), ..options }),
        ),
        Sweep::new(
            "wall",
            "thickness of a shell of radius 1, 10 000 points a side",
            &[0.3, 0.1, 0.03, 0.01, 0.003, 0.001],
            &SWEEP_ZOOMS,
            shell,
        ),
        Sweep::new("irregular", "least share of points kept", &[1.0, 0.3, 0.08, 0.03, 0.01], &SWEEP_ZOOMS, |least| {
            torus_minus_cylinder("", TORUS_POINTS, Sampling::Irregular { least }, Bars::NONE)
        }),
    ]
}

/// Two half-spaces of 5625 points whose planes meet along Y at `angle_deg`, an angle of 0 being coplanar.
fn roof(angle_deg: f64, position_noise: f64, normal_noise_deg: f64) -> Case {
    // Wider than the view, so that no border of the sampled squares is in the picture.
    const EXTENT: f64 = 2.5;
    const POINTS: usize = 75 * 75;
    let (sin, cos) = (0.5 * angle_deg).to_radians().sin_cos();
    let side = |name, sign: f64, seed| {
        let options = ScanOptions::regular(POINTS, seed).noisy(position_noise, normal_noise_deg);
        leaf(name, half_space([0.0; 3], [sign * sin, 0.0, cos], EXTENT), options)
    };
    let camera =
        CameraSpec { eye: DVec3::new(0.9, -1.4, 1.6), target: DVec3::ZERO, up: DVec3::Z, lens: Lens::FovY(20.0) };
    let leaves = vec![side("right", 1.0, 1), side("left", -1.0, 2)];
    Case::new("", format!("Two half-spaces that meet at {angle_deg} degrees"), leaves, "right & left", camera)
}

/// A torus minus a cylinder, the scans of both changed alike.
fn torus_scanned(change: impl Fn(ScanOptions) -> ScanOptions) -> Case {
    let leaves = vec![
        leaf("ring", torus(), change(ScanOptions::regular(2 * TORUS_POINTS / 3, 1))),
        leaf("drill", torus_drill(), change(ScanOptions::regular(TORUS_POINTS / 3, 2))),
    ];
    Case::new("", "A torus minus a cylinder, scanned badly", leaves, "ring - drill", view_from([2.6, -1.0, 2.2]))
}

fn noisy_torus(position_noise: f64, normal_noise_deg: f64) -> Case {
    torus_scanned(|options| options.noisy(position_noise, normal_noise_deg))
}

/// A hollow sphere, cut open.
fn shell(thickness: f64) -> Case {
    let leaves = vec![
        leaf("outer", sphere([0.0; 3], 1.0), ScanOptions::regular(10_000, 1)),
        leaf("inner", sphere([0.0; 3], 1.0 - thickness), ScanOptions::regular(10_000, 2)),
        leaf("lid", half_space([0.0, 0.0, 0.2], [0.3, -0.3, 1.0], 1.5), ScanOptions::regular(10_000, 3)),
    ];
    let about = format!("A hollow sphere with a wall of {thickness}, cut open");
    Case::new("", about, leaves, "(outer - inner) & lid", view_from([2.0, -2.2, 2.6]))
}

/// A sphere minus a sphere, everything moved by `distance`: map coordinates.
fn far_from_origin(distance: f64) -> Case {
    let away = DVec3::new(1.0, 0.7, -0.3).normalize() * distance;
    let moved = |solid| match solid {
        Solid::Sphere { centre, radius } => Solid::Sphere { centre: centre + away, radius },
        other => other,
    };
    let leaves = vec![
        leaf("body", moved(sphere([0.0; 3], 1.0)), ScanOptions::regular(10_000, 1)),
        leaf("bite", moved(sphere([0.7, -0.5, 0.5], 0.8)), ScanOptions::regular(10_000, 2)),
    ];
    let camera = view_from([2.6, -2.4, 1.8]);
    let camera = CameraSpec { eye: camera.eye + away, target: camera.target + away, ..camera };
    Case::new("", format!("A sphere minus a sphere, {distance} from the origin"), leaves, "body - bite", camera)
}

fn zoom_sweep(name: &'static str, parameter: &'static str, case: Case) -> Sweep {
    let sweep = Sweep::new(name, parameter, &[1.0, 10.0, 100.0, 1e3, 1e4], &[1.0], |_| case.clone());
    let at_its_own = |case: Case| Case { zooms: case.parameter.into_iter().collect(), ..case };
    Sweep { cases: sweep.cases.into_iter().map(at_its_own).collect(), ..sweep }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_step_is_a_scene_and_says_how_far_it_is_pushed() {
        for sweep in sweeps() {
            for case in &sweep.cases {
                assert!(case.parameter.is_some() && !case.zooms.is_empty());
                assert!(case.name.starts_with(sweep.name));
                case.scene().unwrap();
            }
            let first = sweep.cases[0].parameter;
            assert!(sweep.cases[1..].iter().all(|case| case.parameter != first));
        }
    }

    #[test]
    fn a_moved_scene_is_the_same_scene() {
        let (here, far) = (far_from_origin(0.0), far_from_origin(1e7));
        let relative = |case: &Case| {
            let cloud = &case.clouds().unwrap()[1];
            cloud.positions[17] - case.camera.eye
        };
        assert!((relative(&here) - relative(&far)).length() < 1e-7);
    }
}
