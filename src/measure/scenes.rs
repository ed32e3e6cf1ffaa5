//! The accuracy suite: scenes of simulated scans whose truth is known, as data.
//!
//! A [`Case`] says what its leaves truly are and how they are scanned, the expression, the camera, and the errors that it
//! may have at most. [`Case::scene`] turns it into an ordinary [`Scene`] of point clouds, each with its solid as `truth`;
//! [`Case::write`](super::scene_files) puts the same scene on disk. All cases are drawn at 512² with one sample, as they are
//! and zoomed 10 and 100 times onto the cut.
//!
//! Spheres and planes lie in the model class of curved surfels; cone, cylinder, ellipsoid and torus do not, and are the
//! honest rows. Where a solid has a crease of its own (the rim of a cylinder), another leaf removes it, since a scan cannot
//! hold a crease.

use std::sync::Arc;

use glam::{DAffine3, DQuat, DVec3};
use serde::{Deserialize, Serialize};

use super::simulate::{Sampling, ScanError, ScanOptions, scan};
use crate::csg::LeafId;
use crate::csg::expression::{self, ExpressionError};
use crate::geometry::solid::Ball;
use crate::geometry::{PointCloud, Solid};
use crate::scene::{CameraSpec, Leaf, LeafSource, Scene, Truth};
use crate::space::Lens;

/// Pictures of the tables are square, with this many pixels a side.
pub const SIDE: u32 = 512;

/// Magnifications of the tables.
pub const ZOOMS: [f64; 3] = [1.0, 10.0, 100.0];

/// The share of wrong pixels that no row may exceed.
pub const WRONG_PIXELS: f64 = 0.0002;

/// The errors that a case may have at most; `None` asks nothing.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Bars {
    /// Mean `edge_px` without magnification.
    pub edge_px_at_1: Option<f64>,
    /// Mean `edge_px` magnified 100 times.
    pub edge_px_at_100: Option<f64>,
    /// Share of wrong pixels at any magnification.
    pub wrong_pixels: Option<f64>,
}

impl Bars {
    /// Nothing is asked for.
    pub const NONE: Self = Self { edge_px_at_1: None, edge_px_at_100: None, wrong_pixels: None };

    const fn edge(at_1: f64, at_100: f64) -> Self {
        Self { edge_px_at_1: Some(at_1), edge_px_at_100: Some(at_100), wrong_pixels: Some(WRONG_PIXELS) }
    }

    /// The bar of `edge_px` at `zoom`.
    pub fn edge_px(&self, zoom: f64) -> Option<f64> {
        match zoom {
            1.0 => self.edge_px_at_1,
            100.0 => self.edge_px_at_100,
            _ => None,
        }
    }
}

/// One leaf of a case.
#[derive(Debug, Clone, PartialEq)]
pub struct CaseLeaf {
    /// Its name in the expression: letters, digits and `_`.
    pub name: String,
    /// What it truly is, in leaf space.
    pub solid: Solid,
    /// Leaf space to world space.
    pub world_from_leaf: DAffine3,
    /// How it is scanned, in leaf space.
    pub scan: ScanOptions,
}

/// A scene with a known truth.
#[derive(Debug, Clone, PartialEq)]
pub struct Case {
    /// Its name, fit for a file.
    pub name: String,
    /// What it shows, in one line.
    pub about: String,
    /// The leaves, in the scene's order.
    pub leaves: Vec<CaseLeaf>,
    /// The expression over their names.
    pub csg: String,
    /// The view at 1×.
    pub camera: CameraSpec,
    /// Columns and rows.
    pub size: (u32, u32),
    /// Magnifications, ascending.
    pub zooms: Vec<f64>,
    /// What is asked of it.
    pub bars: Bars,
    /// What a sweep turned, where the case belongs to one.
    pub parameter: Option<f64>,
}

/// Why a case makes no scene.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CaseError {
    /// A leaf cannot be scanned.
    #[error("case {case}, leaf {leaf}: {source}")]
    Scan {
        /// The case's name.
        case: String,
        /// The leaf's name.
        leaf: String,
        /// What is wrong.
        source: ScanError,
    },
    /// The expression is none.
    #[error("case {case}: {source}")]
    Expression {
        /// The case's name.
        case: String,
        /// What is wrong.
        source: ExpressionError,
    },
}

impl Case {
    /// A case at 512², zoomed 1, 10 and 100 times, without bars.
    pub fn new(
        name: impl Into<String>,
        about: impl Into<String>,
        leaves: Vec<CaseLeaf>,
        csg: impl Into<String>,
        camera: CameraSpec,
    ) -> Self {
        Self {
            name: name.into(),
            about: about.into(),
            leaves,
            csg: csg.into(),
            camera,
            size: (SIDE, SIDE),
            zooms: ZOOMS.to_vec(),
            bars: Bars::NONE,
            parameter: None,
        }
    }

    fn with_bars(self, bars: Bars) -> Self {
        Self { bars, ..self }
    }

    /// The scans of all leaves, in order.
    ///
    /// # Errors
    /// [`CaseError::Scan`] names the leaf.
    pub fn clouds(&self) -> Result<Vec<PointCloud>, CaseError> {
        let one = |leaf: &CaseLeaf| {
            let named = |source| CaseError::Scan { case: self.name.clone(), leaf: leaf.name.clone(), source };
            scan(&leaf.solid, &leaf.scan).map_err(named)
        };
        self.leaves.iter().map(one).collect()
    }

    /// The case as an ordinary scene: every leaf a point cloud that names its truth.
    ///
    /// # Errors
    /// [`CaseError`] where a leaf cannot be scanned or the expression is none.
    pub fn scene(&self) -> Result<Scene, CaseError> {
        let leaf = |(leaf, cloud): (&CaseLeaf, PointCloud)| Leaf {
            world_from_leaf: leaf.world_from_leaf,
            truth: Some(Truth::Solid(leaf.solid.clone())),
            ..Leaf::new(leaf.name.clone(), LeafSource::Cloud(Arc::new(cloud)))
        };
        let leaves: Vec<Leaf> = self.leaves.iter().zip(self.clouds()?).map(leaf).collect();
        let index = |name: &str| self.leaves.iter().position(|leaf| leaf.name == name);
        let tree = expression::parse(&self.csg, &mut |name| index(name).map(|i| LeafId(i as u32)))
            .map_err(|source| CaseError::Expression { case: self.name.clone(), source })?;
        let mut scene = Scene::new(leaves, tree);
        scene.camera = Some(self.camera);
        scene.size = self.size;
        Ok(scene)
    }
}

/// A perspective view of the origin with 40° from bottom to top, +Z up.
pub fn view_from(eye: [f64; 3]) -> CameraSpec {
    CameraSpec { eye: DVec3::from_array(eye), target: DVec3::ZERO, up: DVec3::Z, lens: Lens::FovY(40.0) }
}

/// A leaf whose leaf space is world space.
pub fn leaf(name: impl Into<String>, solid: Solid, scan: ScanOptions) -> CaseLeaf {
    CaseLeaf { name: name.into(), solid, world_from_leaf: DAffine3::IDENTITY, scan }
}

/// A ball.
pub fn sphere(centre: [f64; 3], radius: f64) -> Solid {
    Solid::Sphere { centre: DVec3::from_array(centre), radius }
}

/// A cylinder by its middle, axis (any length) and half length.
pub fn cylinder(middle: [f64; 3], axis: [f64; 3], half_length: f64, radius: f64) -> Solid {
    let (middle, along) = (DVec3::from_array(middle), DVec3::from_array(axis).normalize() * half_length);
    Solid::Cylinder { from: middle - along, to: middle + along, radius }
}

/// A half-space by a point of its plane and its outward normal (any length).
pub fn half_space(point: [f64; 3], normal: [f64; 3], extent: f64) -> Solid {
    let normal = DVec3::from_array(normal).normalize();
    Solid::HalfSpace { point: DVec3::from_array(point), normal, extent }
}

/// The ring torus of the tables, about Z.
pub fn torus() -> Solid {
    Solid::Torus { centre: DVec3::ZERO, axis: DVec3::Z, radius: 0.8, tube: 0.35 }
}

/// The slanted drill through the torus' tube; its caps lie outside.
pub fn torus_drill() -> Solid {
    cylinder([0.7, 0.0, 0.0], [0.3, 0.1, 1.0], 1.2, 0.3)
}

/// A femoral head with its neck: balls melted together, the head's radius `scale`, its centre at the origin.
pub fn femoral_head(scale: f64) -> Solid {
    let ball = |x: f64, y: f64, z: f64, radius| Ball { centre: DVec3::new(x, y, z) * scale, radius: radius * scale };
    let balls = vec![
        ball(0.0, 0.0, 0.0, 1.0),
        ball(-0.42, -0.02, -0.5, 0.74),
        ball(-0.72, -0.02, -0.92, 0.66),
        ball(-1.02, 0.0, -1.3, 0.74),
    ];
    Solid::Blend { balls, smoothness: 0.14 * scale }
}

/// The upper end of a femur around the same head, as `data/femoral_head.toml` has it: head, neck, both trochanters and a
/// stump of the shaft.
pub fn proximal_femur(scale: f64) -> Solid {
    let balls = [
        [0.0, 0.0, 0.0, 1.0],
        [-0.62, 0.0, -0.58, 0.6],
        [-0.95, 0.02, -0.88, 0.6],
        [-1.6, 0.1, -0.78, 0.56],
        [-1.72, 0.12, -1.2, 0.56],
        [-1.34, 0.05, -1.36, 0.76],
        [-0.92, 0.3, -1.86, 0.36],
        [-1.34, 0.08, -2.0, 0.64],
        [-1.36, 0.1, -2.6, 0.58],
    ];
    let ball = |[x, y, z, radius]: [f64; 4]| Ball { centre: DVec3::new(x, y, z) * scale, radius: radius * scale };
    Solid::Blend { balls: balls.map(ball).to_vec(), smoothness: 0.14 * scale }
}

/// The two spheres that are cut from the femoral head, for a head of radius `scale`: they overlap, so that three surfaces
/// meet (Wicke 2004, Fig. 9).
pub fn femoral_cutters(scale: f64) -> [Solid; 2] {
    let ball = |centre: [f64; 3], radius: f64| sphere(centre.map(|c| c * scale), radius * scale);
    [ball([0.75, -0.35, 0.55], 0.62), ball([0.35, -0.95, 0.1], 0.55)]
}

/// The edge between two differently sampled surfaces (Wicke 2004, Fig. 2b and c): a fine ball cut by a coarse, irregular
/// drill. (On a sphere the plane of the closest surfel is also the highest, so a second one changes nothing.)
pub fn figure_2() -> Case {
    let drill = cylinder([0.1, 0.0, 0.0], [0.34, -0.2, 0.92], 1.5, 0.4);
    let leaves = vec![
        leaf("fine", sphere([0.0; 3], 1.0), ScanOptions::regular(6_000, 1)),
        leaf("coarse", drill, ScanOptions::regular(600, 2).sampled(Sampling::IRREGULAR)),
    ];
    let about = "A fine ball minus a coarse drill (Wicke 2004, Fig. 2): 6000 and 600 points";
    Case::new("figure_2", about, leaves, "fine - coarse", view_from([0.6, -0.9, 3.2]))
}

/// The points that the accuracy tables use: five touching spheres, 374 surfels each and one of them 375.
const SPHERE_POINTS: [usize; 5] = [375, 374, 374, 374, 374];

fn five_spheres() -> Vec<CaseLeaf> {
    let spheres = [
        ("centre", sphere([0.0, 0.0, 0.0], 1.0)),
        ("east", sphere([0.7, 0.0, 0.6], 0.7)),
        ("west", sphere([-0.7, 0.0, 0.6], 0.7)),
        ("north", sphere([0.0, 0.7, -0.6], 0.7)),
        ("south", sphere([0.0, -0.7, -0.6], 0.7)),
    ];
    let named = spheres.into_iter().zip(SPHERE_POINTS).zip(1..);
    named.map(|(((name, solid), count), seed)| leaf(name, solid, ScanOptions::regular(count, seed))).collect()
}

/// Five spheres in one (Wicke 2004, Fig. 7a): the outer ones touch in pairs.
pub fn five_spheres_union() -> Case {
    let about = "Five spheres that touch, united (Wicke 2004, Fig. 7a): 1871 points";
    Case::new(
        "five_spheres_union",
        about,
        five_spheres(),
        "centre | east | west | north | south",
        view_from([1.5, -3.6, 2.4]),
    )
    .with_bars(Bars::edge(0.02, 0.05))
}

/// Two of the five subtracted (Wicke 2004, Fig. 7b): where they touch, two thin spikes are left.
pub fn five_spheres_minus() -> Case {
    let about = "The same five spheres, two of them subtracted (Wicke 2004, Fig. 7b)";
    Case::new(
        "five_spheres_minus",
        about,
        five_spheres(),
        "(centre - east - west) | north | south",
        view_from([1.2, -3.0, 2.8]),
    )
    .with_bars(Bars::edge(0.02, 0.05))
}

/// The femoral head minus two spheres, with `count` points in all; each cutter has a twentieth of the head's.
fn femoral(name: &str, count: usize) -> Case {
    let cutter = (count as f64 / 22.0).round() as usize;
    let [upper, lower] = femoral_cutters(1.0);
    let leaves = vec![
        leaf("femur", femoral_head(1.0), ScanOptions::regular(count - 2 * cutter, 1)),
        leaf("upper", upper, ScanOptions::regular(cutter, 2)),
        leaf("lower", lower, ScanOptions::regular(cutter, 3)),
    ];
    let about = format!("A femoral head minus two spheres (Wicke 2004, Fig. 9): {count} points");
    Case::new(name, about, leaves, "femur - (upper | lower)", view_from([2.4, -2.6, 1.6]))
        .with_bars(Bars::edge(0.02, 0.05))
}

/// The icosahedron of 20 half-spaces, one surfel each (Wicke 2004, Fig. 8a).
pub fn icosahedron() -> Case {
    // A face of the icosahedron whose faces are at distance 1 has its corners at 0.764 from its middle.
    const EXTENT: f64 = 0.8;
    let golden = 0.5 * (1.0 + 5f64.sqrt());
    // The faces' normals are the corners of a dodecahedron.
    let signs = [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)];
    let mut normals = Vec::new();
    for (a, b) in signs {
        normals.extend([[a, b, -1.0], [a, b, 1.0]]);
        normals.extend([[0.0, a / golden, b * golden], [a / golden, b * golden, 0.0], [a * golden, 0.0, b / golden]]);
    }
    let face = |(i, normal): (usize, [f64; 3])| {
        let point = DVec3::from_array(normal).normalize().to_array();
        leaf(format!("face_{i:02}"), half_space(point, normal, EXTENT), ScanOptions::regular(1, 1 + i as u64))
    };
    let leaves: Vec<CaseLeaf> = normals.into_iter().enumerate().map(face).collect();
    let csg = leaves.iter().map(|leaf| leaf.name.as_str()).collect::<Vec<_>>().join(" & ");
    let about = "An icosahedron, 20 half-spaces of one surfel each (Wicke 2004, Fig. 8a)";
    Case::new("icosahedron", about, leaves, csg, view_from([3.0, 2.0, 1.4])).with_bars(Bars::edge(0.02, 0.05))
}

/// The cube whose faces have 1, 25 and 900 surfels (Wicke 2004, Fig. 8c).
pub fn cube() -> Case {
    const HALF_SIDE: f64 = 0.8;
    const EXTENT: f64 = 1.0;
    let axes = [("x", 1, DVec3::X), ("y", 25, DVec3::Y), ("z", 900, DVec3::Z)];
    let mut leaves = Vec::new();
    for (axis, count, direction) in axes {
        for (side, sign) in [("high", 1.0), ("low", -1.0)] {
            let plane = half_space((direction * sign * HALF_SIDE).to_array(), (direction * sign).to_array(), EXTENT);
            leaves.push(leaf(format!("{axis}_{side}"), plane, ScanOptions::regular(count, 1 + leaves.len() as u64)));
        }
    }
    let csg = leaves.iter().map(|leaf| leaf.name.as_str()).collect::<Vec<_>>().join(" & ");
    let about = "A cube of six half-spaces, opposite faces with 1, 25 and 900 surfels (Wicke 2004, Fig. 8c)";
    Case::new("cube_1_25_900", about, leaves, csg, view_from([2.9, 2.3, 1.9])).with_bars(Bars::edge(0.02, 0.05))
}

/// The three solids that are not in the model class, cut, with normals given or to be estimated; 20 000 points in all.
fn curved_cuts(with_normals: bool) -> Vec<Case> {
    let suffix = if with_normals { "" } else { "_estimated" };
    let told = if with_normals { "given" } else { "estimated" };
    let options = |count, seed| {
        let options = ScanOptions::regular(count, seed);
        if with_normals { options } else { options.without_normals() }
    };
    let eye = [2.6, -2.4, 1.8];
    let case = |name: &str, about: &str, leaves, csg: &str| {
        Case::new(
            format!("{name}{suffix}"),
            format!("{about}: 20 000 points, normals {told}"),
            leaves,
            csg,
            view_from(eye),
        )
        .with_bars(Bars::edge(0.05, 0.25))
    };
    let cone = Solid::Cone {
        from: DVec3::new(0.1, 0.0, -1.6),
        to: DVec3::new(-0.1, 0.0, 1.6),
        radius_from: 1.0,
        radius_to: 0.3,
    };
    let ellipsoid = |name: &str, transform, count, seed| CaseLeaf {
        world_from_leaf: transform,
        ..leaf(name, sphere([0.0; 3], 1.0), options(count, seed))
    };
    let body = DAffine3::from_scale(DVec3::new(1.1, 0.8, 0.6));
    let bite = DAffine3::from_scale_rotation_translation(
        DVec3::new(0.35, 0.55, 0.8),
        DQuat::from_rotation_z(0.6),
        DVec3::new(0.55, -0.55, 0.2),
    );
    vec![
        case(
            "cone",
            "The middle of a cone minus a drill",
            vec![
                leaf("cone", cone, options(12_000, 1)),
                leaf("ball", sphere([0.0; 3], 1.05), options(4_000, 2)),
                leaf("drill", cylinder([0.0; 3], [0.9, -0.4, 0.1], 1.5, 0.3), options(4_000, 3)),
            ],
            "(cone & ball) - drill",
        ),
        case(
            "ellipsoid",
            "An ellipsoid minus an ellipsoid",
            vec![ellipsoid("body", body, 14_000, 1), ellipsoid("bite", bite, 6_000, 2)],
            "body - bite",
        ),
        case(
            "cylinder",
            "The middle of a cylinder minus a cylinder",
            vec![
                leaf("rod", cylinder([0.0; 3], [1.0, 0.5, 0.3], 2.0, 0.6), options(12_000, 1)),
                leaf("ball", sphere([0.0; 3], 1.1), options(4_000, 2)),
                leaf("drill", cylinder([0.1, 0.0, 0.0], [0.5, -0.8, 0.6], 1.5, 0.35), options(4_000, 3)),
            ],
            "(rod & ball) - drill",
        ),
    ]
}

/// A torus minus a slanted cylinder, with two thirds of `count` points on the torus.
pub fn torus_minus_cylinder(name: &str, count: usize, sampling: Sampling, bars: Bars) -> Case {
    let about = format!("A torus minus a cylinder: {count} points");
    let leaves = vec![
        leaf("ring", torus(), ScanOptions::regular(2 * count / 3, 1).sampled(sampling)),
        leaf("drill", torus_drill(), ScanOptions::regular(count / 3, 2).sampled(sampling)),
    ];
    Case::new(name, about, leaves, "ring - drill", view_from([2.6, -1.0, 2.2])).with_bars(bars)
}

/// A sphere of `count` points minus one of `count / ratio`.
pub fn density(name: &str, count: usize, ratio: usize) -> Case {
    let about = format!("A sphere minus one scanned {ratio} times more coarsely: {count} and {} points", count / ratio);
    let leaves = vec![
        leaf("fine", sphere([0.0; 3], 1.0), ScanOptions::regular(count, 1)),
        leaf("coarse", sphere([0.7, -0.5, 0.5], 0.8), ScanOptions::regular(count / ratio, 2)),
    ];
    Case::new(name, about, leaves, "fine - coarse", view_from([2.6, -2.4, 1.8])).with_bars(Bars::edge(0.02, 0.05))
}

/// `c & (a | b)` with `count` points on a and 10 000 on the others: with 100 the paper's rule for unknown leaves fails.
pub fn unknown_contrast(count: usize) -> Case {
    let leaves = vec![
        leaf("c", sphere([0.0; 3], 1.0), ScanOptions::regular(10_000, 1)),
        leaf("a", sphere([0.75, -0.75, 0.0], 0.45), ScanOptions::regular(count, 2)),
        leaf("b", sphere([0.75, -0.75, 0.55], 0.55), ScanOptions::regular(10_000, 3)),
    ];
    let about = format!("Coarse edge surfels beside fine surface surfels: {count} points on a, 10 000 on c and b");
    let case =
        Case::new(format!("unknown_contrast_{count}"), about, leaves, "c & (a | b)", view_from([2.6, -2.4, 1.8]));
    // Only c is seen: where a and b cut it, the picture has a silhouette, and nothing to zoom onto.
    Case { zooms: vec![1.0], ..case }
}

/// The two scenes in which Wicke's rules for unknown leaves are said to be right: b far away, and b around everything.
pub fn unknown_far_and_around() -> [Case; 2] {
    let case = |name: &str, about: &str, b, csg: &str| {
        let points = |seed| ScanOptions::regular(10_000, seed);
        let leaves = vec![
            leaf("c", sphere([0.0; 3], 1.0), points(1)),
            leaf("a", sphere([0.75, -0.75, 0.0], 0.45), points(2)),
            leaf("b", b, points(3)),
            leaf("d", half_space([0.45, -0.45, 0.25], [0.2, -0.2, 1.0], 1.6), points(4)),
        ];
        Case::new(name, about, leaves, csg, view_from([2.6, -2.4, 2.0]))
    };
    [
        case("unknown_far", "b is far from where a and c meet", sphere([-0.8, 0.9, 0.6], 0.5), "(c | (a & b)) & d"),
        case("unknown_around", "b contains everything", sphere([0.0; 3], 1.6), "(c & (a | b)) & d"),
    ]
}

/// Every case of the accuracy tables, in their order.
pub fn accuracy_cases() -> Vec<Case> {
    let mut cases = vec![
        five_spheres_union(),
        five_spheres_minus(),
        femoral("femoral_head_117k", 116_650),
        femoral("femoral_head_22k", 22_000),
        icosahedron(),
        cube(),
    ];
    cases.extend(curved_cuts(true));
    cases.extend(curved_cuts(false));
    cases.extend([
        torus_minus_cylinder("torus_45k", 45_000, Sampling::Regular, Bars::edge(0.02, 0.05)),
        torus_minus_cylinder("torus_4500", 4_500, Sampling::Regular, Bars::edge(0.06, 0.25)),
        torus_minus_cylinder("torus_irregular_15k", 15_000, Sampling::IRREGULAR, Bars::edge(0.1, 1.0)),
        density("density_1_30", 30_000, 30),
        density("density_1_900", 30_600, 900),
    ]);
    cases
}

/// The cases about unknown leaves.
pub fn unknown_cases() -> Vec<Case> {
    let mut cases: Vec<Case> = [50, 100, 200].map(unknown_contrast).into();
    cases.extend(unknown_far_and_around());
    cases
}

/// The scan that speed is measured on: the femoral head alone, a million points, seed 1; what is cut from it is exact and
/// stands on the command line.
pub fn speed_head() -> Case {
    let scan = ScanOptions::regular(1_000_000, 1);
    let leaves = vec![leaf("femur", femoral_head(1.0), scan)];
    Case::new("speed_head", "A femoral head of a million points", leaves, "femur", view_from([2.4, -2.6, 1.6]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_are_those_of_the_papers_figures() {
        let points = |case: Case| case.leaves.iter().map(|leaf| leaf.scan.count).sum::<usize>();
        assert_eq!(points(five_spheres_union()), 1871);
        assert_eq!(points(femoral("", 116_650)), 116_650);
        assert_eq!(points(femoral("", 22_000)), 22_000);
        assert_eq!(points(icosahedron()), 20);
        assert_eq!(points(cube()), 2 * (1 + 25 + 900));
        for case in curved_cuts(true) {
            assert_eq!(points(case), 20_000);
        }
    }

    #[test]
    fn every_case_is_a_scene_whose_clouds_lie_on_their_truth() {
        let mut cases = accuracy_cases();
        cases.extend(unknown_cases());
        for case in cases {
            let scene = case.scene().unwrap();
            assert_eq!(scene.leaves.len(), case.leaves.len());
            for (leaf, of_case) in scene.leaves.iter().zip(&case.leaves) {
                let (LeafSource::Cloud(cloud), Some(Truth::Solid(truth))) = (&leaf.source, &leaf.truth) else {
                    panic!("{}", case.name);
                };
                assert_eq!(cloud.len(), of_case.scan.count, "{} {}", case.name, leaf.name);
                let off = cloud.positions.iter().map(|p| truth.signed_distance_bound(*p).abs()).fold(0.0, f64::max);
                assert!(off < 1e-9, "{} {}: {off}", case.name, leaf.name);
            }
        }
    }

    #[test]
    fn names_are_unique() {
        let cases: Vec<Case> = accuracy_cases().into_iter().chain(unknown_cases()).collect();
        let mut names: Vec<&str> = cases.iter().map(|case| case.name.as_str()).collect();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), cases.len());
    }

    #[test]
    fn touching_spheres_touch() {
        let spheres = five_spheres();
        let centre_and_radius = |leaf: &CaseLeaf| match leaf.solid {
            Solid::Sphere { centre, radius } => (centre, radius),
            _ => unreachable!(),
        };
        for (a, b) in [(1, 2), (3, 4)] {
            let ((ca, ra), (cb, rb)) = (centre_and_radius(&spheres[a]), centre_and_radius(&spheres[b]));
            assert!((ca.distance(cb) - ra - rb).abs() < 1e-12);
        }
    }
}
