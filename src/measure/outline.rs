//! Where a picture's surfaces end and meet: silhouettes and cut edges, as *cracks* between neighbouring pixels.
//!
//! A picture sampled at pixel centres does not hold its edges; it holds pairs of neighbouring pixels that see different
//! things, and the edge runs between them. The line between two neighbours is a crack, and there are two kinds:
//!
//! * a **silhouette** where one of the two sees nothing, or where the depth jumps: one surface occludes another;
//! * a **cut edge** where both see a surface, of different leaf or facing, and the depth runs on: two surfaces meet.
//!
//! Two pixels' depth *runs on* when their tangent planes meet between them: with the planes' slopes s per pixel, there is
//! a position α in [0, 1] of the way where t_a + α s_a and t_b − (1 − α) s_b agree within a few footprints. So a steep
//! surface is no silhouette, and a crease seen at a grazing angle is none either.
//!
//! *Length.* A line crosses |sin| vertical and |cos| horizontal cracks per pixel of its length, so a crack that counts for
//! the |component| of the edge's direction along itself makes every straight line as long as it is (sin² + cos² = 1).
//! The direction comes from counting the cracks of both orientations nearby.

use glam::{DVec2, DVec3};

use super::distance::squared_distances;
use crate::layers::{Boundary, Facing, LayerStack};
use crate::space::Camera;

/// What of a boundary must be right: whose surface is seen, and from which side.
pub type Label = (u32, Facing);

/// The kind of edge that runs along a crack.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CrackKind {
    /// A surface ends in front of nothing, or in front of another.
    Silhouette,
    /// Two surfaces meet.
    Cut,
}

/// The line between two neighbouring pixels that see different things.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Crack {
    /// Column and row of the left or upper pixel.
    pub pixel: (u32, u32),
    /// Whether the other pixel is to the right (the crack is then vertical) or below.
    pub to_the_right: bool,
    /// What runs along it.
    pub kind: CrackKind,
    /// Whether both pixels see a surface, of different leaf or facing: every cut edge, and some silhouettes.
    pub between_labels: bool,
}

/// What every pixel sees first, and the cracks between them.
#[derive(Debug, Clone)]
pub struct Outline {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Row by row; `None` where nothing is seen.
    pub nearest: Vec<Option<Boundary>>,
    /// Row by row, the cracks to the right before those below.
    pub cracks: Vec<Crack>,
}

/// The nearest boundary's leaf and facing.
pub fn label(boundary: &Boundary) -> Label {
    (boundary.leaf, boundary.facing)
}

impl Outline {
    /// Finds the cracks among the nearest boundaries of `stack`.
    pub fn of(stack: &LayerStack) -> Self {
        let (width, height) = (stack.camera.width, stack.camera.height);
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let nearest: Vec<_> = pixels.clone().map(|(x, y)| stack.at(x, y).first().copied()).collect();
        let mut outline = Self { width, height, nearest, cracks: Vec::new() };
        let mut cracks = Vec::new();
        for pixel in pixels {
            for to_the_right in [true, false] {
                cracks.extend(outline.crack(&stack.camera, pixel, to_the_right));
            }
        }
        outline.cracks = cracks;
        outline
    }

    /// What the pixel at column `x`, row `y` sees first.
    pub fn at(&self, (x, y): (u32, u32)) -> Option<&Boundary> {
        self.nearest[(y * self.width + x) as usize].as_ref()
    }

    fn crack(&self, camera: &Camera, pixel: (u32, u32), to_the_right: bool) -> Option<Crack> {
        let other = neighbour(pixel, to_the_right);
        if other.0 >= self.width || other.1 >= self.height {
            return None;
        }
        let crack = |kind, between_labels| Some(Crack { pixel, to_the_right, kind, between_labels });
        match (self.at(pixel), self.at(other)) {
            (None, None) => None,
            (Some(_), None) | (None, Some(_)) => crack(CrackKind::Silhouette, false),
            (Some(a), Some(b)) => {
                let differ = label(a) != label(b);
                if !depth_runs_on(camera, (pixel, a), (other, b)) {
                    crack(CrackKind::Silhouette, differ)
                } else if differ {
                    crack(CrackKind::Cut, true)
                } else {
                    None
                }
            }
        }
    }

    /// The cracks of one kind.
    pub fn cracks_of(&self, kind: CrackKind) -> impl Iterator<Item = &Crack> {
        self.cracks.iter().filter(move |crack| crack.kind == kind)
    }

    /// The length in pixels of the edges of one kind.
    pub fn length_px(&self, kind: CrackKind) -> f64 {
        // Cracks up to this many pixels away, in columns and rows, tell an edge's direction: enough of them for any
        // slope to show, few enough to follow a bend.
        const REACH: usize = 3;
        let (width, height) = (self.width as usize, self.height as usize);
        let columns = width + 1;
        // Sums over everything above and to the left, for vertical and horizontal cracks.
        let mut sums = vec![[0u32; 2]; columns * (height + 1)];
        for crack in self.cracks_of(kind) {
            let (x, y) = crack.pixel;
            sums[(y as usize + 1) * columns + x as usize + 1][usize::from(!crack.to_the_right)] += 1;
        }
        for y in 1..=height {
            for x in 1..=width {
                let (above, left, corner) =
                    (sums[(y - 1) * columns + x], sums[y * columns + x - 1], sums[(y - 1) * columns + x - 1]);
                let sum = &mut sums[y * columns + x];
                // The corner is in both: add first, these are unsigned.
                *sum = [0, 1]
                    .map(|orientation| sum[orientation] + above[orientation] + left[orientation] - corner[orientation]);
            }
        }
        let window = |crack: &Crack, orientation: usize| {
            let (x, y) = (crack.pixel.0 as usize, crack.pixel.1 as usize);
            let (x0, y0) = (x.saturating_sub(REACH), y.saturating_sub(REACH));
            let (x1, y1) = ((x + REACH + 1).min(width), (y + REACH + 1).min(height));
            let sum = |x: usize, y: usize| f64::from(sums[y * columns + x][orientation]);
            sum(x1, y1) - sum(x0, y1) - sum(x1, y0) + sum(x0, y0)
        };
        let weight = |crack: &Crack| {
            let counts = DVec2::new(window(crack, 0), window(crack, 1)); // never both zero: the crack itself is inside
            let own = if crack.to_the_right { counts.x } else { counts.y };
            own / counts.length()
        };
        self.cracks_of(kind).map(weight).sum()
    }

    /// Distances in pixels to the nearest of `cracks`, exact, from pixel centres and from the middles of cracks.
    pub fn distances<'a>(&self, cracks: impl Iterator<Item = &'a Crack>) -> CrackDistances {
        let columns = 2 * self.width as usize + 1;
        let rows = 2 * self.height as usize + 1;
        let mut seeds = Vec::new();
        for crack in cracks {
            let (x, y) = crack.middle();
            let middle = y * columns + x;
            let step = if crack.to_the_right { columns } else { 1 };
            // From a pixel centre or the middle of a crack, the nearest point of a crack is its middle or an end.
            seeds.extend([middle - step, middle, middle + step]);
        }
        CrackDistances { columns, squared: squared_distances(columns, rows, &seeds) }
    }
}

impl Crack {
    /// Its middle on the lattice of half pixels: pixel (x, y) has its centre at (2x + 1, 2y + 1).
    fn middle(&self) -> (usize, usize) {
        let (x, y) = (2 * self.pixel.0 as usize + 1, 2 * self.pixel.1 as usize + 1);
        if self.to_the_right { (x + 1, y) } else { (x, y + 1) }
    }

    /// Picture position of its middle, in pixels.
    pub fn middle_px(&self) -> DVec2 {
        let (x, y) = self.middle();
        0.5 * DVec2::new(x as f64, y as f64)
    }

    /// The other pixel's column and row.
    pub fn other_pixel(&self) -> (u32, u32) {
        neighbour(self.pixel, self.to_the_right)
    }
}

/// Exact distances to a set of cracks; see [`Outline::distances`].
#[derive(Debug, Clone)]
pub struct CrackDistances {
    columns: usize,
    squared: Vec<f64>,
}

impl CrackDistances {
    fn at_lattice(&self, (x, y): (usize, usize)) -> f64 {
        0.5 * self.squared[y * self.columns + x].sqrt()
    }

    /// From the centre of the pixel at column `x`, row `y`, in pixels; infinite where there is no crack.
    pub fn from_pixel(&self, (x, y): (u32, u32)) -> f64 {
        self.at_lattice((2 * x as usize + 1, 2 * y as usize + 1))
    }

    /// From the middle of `crack`, in pixels; infinite where there is no crack.
    pub fn from_crack(&self, crack: &Crack) -> f64 {
        self.at_lattice(crack.middle())
    }
}

fn neighbour((x, y): (u32, u32), to_the_right: bool) -> (u32, u32) {
    if to_the_right { (x + 1, y) } else { (x, y + 1) }
}

/// The picture position of a pixel's centre.
fn centre_px((x, y): (u32, u32)) -> DVec2 {
    DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5)
}

/// Whether the surfaces at two neighbouring pixels meet between them; see the module's text.
fn depth_runs_on(camera: &Camera, a: ((u32, u32), &Boundary), b: ((u32, u32), &Boundary)) -> bool {
    // Bends between two pixels take the surface off its tangent planes by less than this many footprints; a step this
    // small between two surfaces cannot be told from a meeting.
    const FOOTPRINTS: f64 = 2.0;
    // Depths are stored in 32 bits: at high zoom their rounding is larger than a footprint.
    const ROUNDINGS: f64 = 4.0;
    let (t_a, t_b) = (f64::from(a.1.depth), f64::from(b.1.depth));
    let slack = FOOTPRINTS * camera.footprint(t_a.min(t_b)) + ROUNDINGS * f64::from(f32::EPSILON) * t_a.max(t_b);
    // Depth at α = 0 and at α = 1 by which a's plane lies behind b's.
    let at_a = t_a - depth_of_plane(camera, b, a.0);
    let at_b = depth_of_plane(camera, a, b.0) - t_b;
    at_a.abs() <= slack || at_b.abs() <= slack || (at_a < 0.0) != (at_b < 0.0)
}

/// Depth at which the ray of pixel `at` meets the tangent plane of the boundary seen at another pixel; infinite where the
/// ray runs away from it.
fn depth_of_plane(camera: &Camera, (seen_at, boundary): ((u32, u32), &Boundary), at: (u32, u32)) -> f64 {
    let normal = boundary.normal.as_dvec3();
    let seen_along = camera.ray(centre_px(seen_at));
    let ray = camera.ray(centre_px(at));
    let p_in_world = seen_along.at(f64::from(boundary.depth));
    let approach = ray.dir.dot(normal);
    if approach * seen_along.dir.dot(normal) > 0.0 {
        (p_in_world - ray.origin).dot(normal) / approach
    } else {
        f64::INFINITY
    }
}

/// The point of a cut edge nearest to the middle of the picture, in world space: the target to zoom onto. `None` where
/// no two surfaces meet in the picture.
pub fn find_cut_edge(truth: &LayerStack) -> Option<DVec3> {
    let outline = Outline::of(truth);
    let middle = 0.5 * DVec2::new(f64::from(outline.width), f64::from(outline.height));
    let off_centre = |crack: &&Crack| crack.middle_px().distance_squared(middle);
    let crack = outline.cracks_of(CrackKind::Cut).min_by(|a, b| off_centre(a).total_cmp(&off_centre(b)))?;
    let depth = |pixel| outline.at(pixel).map(|boundary| f64::from(boundary.depth));
    let depth = 0.5 * (depth(crack.pixel)? + depth(crack.other_pixel())?);
    Some(truth.camera.ray(crack.middle_px()).at(depth))
}

/// `camera` turned onto the cut edge nearest to its picture's middle and magnified by `zoom`; the edge is searched again
/// at every factor of ten on the way, since a pixel of the first picture is a hundred of the last. `None` where the
/// picture has no cut edge; a `zoom` of 1 or less gives the camera as it is.
///
/// # Errors
/// Whatever `draw_truth` returns.
pub fn zoomed_onto_cut<E>(
    camera: &Camera,
    zoom: f64,
    draw_truth: &mut dyn FnMut(&Camera) -> Result<LayerStack, E>,
) -> Result<Option<Camera>, E> {
    const STEP: f64 = 10.0;
    let mut current = camera.clone();
    let mut reached = 1.0;
    while reached < zoom {
        let Some(target) = find_cut_edge(&draw_truth(&current)?) else { return Ok(None) };
        reached = (reached * STEP).min(zoom);
        let Ok(next) = camera.zoomed(target, reached) else { return Ok(None) };
        current = next;
    }
    Ok(Some(current))
}

#[cfg(test)]
pub(crate) mod tests {
    use glam::Vec3;

    use super::*;
    use crate::space::Lens;

    pub const SIDE: u32 = 96;

    /// A camera that looks straight down -Z from height 10, one world unit per pixel.
    pub fn camera() -> Camera {
        let lens = Lens::Height(f64::from(SIDE));
        Camera::look_at(DVec3::Z * 10.0, DVec3::ZERO, DVec3::Y, lens, SIDE, SIDE).unwrap()
    }

    pub fn boundary(leaf: u32, depth: f64, normal: DVec3) -> Boundary {
        Boundary {
            depth: depth as f32,
            normal: normal.as_vec3(),
            colour: [1.0; 3],
            opacity: 1.0,
            leaf,
            body: leaf,
            facing: Facing::Front,
            samples: 1,
        }
    }

    /// Flat at depth 10 everywhere; the leaf by the pixel's centre.
    pub fn flat(leaf_at: impl Fn(DVec2) -> Option<u32> + Sync) -> LayerStack {
        LayerStack::from_fn(camera(), 1, |x, y| {
            leaf_at(centre_px((x, y))).map(|leaf| boundary(leaf, 10.0, DVec3::Z)).into_iter().collect()
        })
    }

    #[test]
    fn straight_edges_are_as_long_as_they_are_whatever_their_direction() {
        let middle = DVec2::splat(0.5 * f64::from(SIDE));
        for degrees in [0.0, 7.0, 20.0, 33.0, 45.0, 60.0, 90.0, 118.0] {
            let across = DVec2::from_angle(f64::to_radians(degrees));
            let outline = Outline::of(&flat(|px| Some(u32::from((px - middle).dot(across) > 0.3))));
            let side = f64::from(SIDE);
            let expected = side / across.x.abs().max(across.y.abs());
            let measured = outline.length_px(CrackKind::Cut);
            assert!((measured / expected - 1.0).abs() < 0.04, "{degrees}°: {measured} for {expected}");
            assert_eq!(outline.length_px(CrackKind::Silhouette), 0.0);
        }
    }

    #[test]
    fn a_circle_is_as_long_as_it_is() {
        let middle = DVec2::splat(0.5 * f64::from(SIDE));
        let outline = Outline::of(&flat(|px| ((px - middle).length() < 30.0).then_some(0)));
        let length = outline.length_px(CrackKind::Silhouette);
        assert!((length / (60.0 * std::f64::consts::PI) - 1.0).abs() < 0.04, "{length}");
    }

    #[test]
    fn depth_tells_a_cut_edge_from_an_occlusion() {
        let step = |drop: f64| {
            let stack = LayerStack::from_fn(camera(), 1, |x, _| {
                let far = x >= SIDE / 2;
                vec![boundary(u32::from(far), 10.0 + if far { drop } else { 0.0 }, DVec3::Z)]
            });
            let outline = Outline::of(&stack);
            (outline.cracks_of(CrackKind::Cut).count(), outline.cracks_of(CrackKind::Silhouette).count())
        };
        assert_eq!(step(1.0), (SIDE as usize, 0));
        assert_eq!(step(20.0), (0, SIDE as usize));
    }

    /// A roof whose two sides fall away at `degrees`, the ridge at column 48.25.
    fn roof(degrees: f64) -> LayerStack {
        let slope = degrees.to_radians();
        LayerStack::from_fn(camera(), 1, move |x, y| {
            let across = centre_px((x, y)).x - 48.25;
            let normal = DVec3::new(across.signum() * slope.sin(), 0.0, slope.cos());
            vec![boundary(u32::from(across > 0.0), 10.0 + across.abs() * slope.tan(), normal)]
        })
    }

    #[test]
    fn a_steep_crease_is_a_cut_edge_and_a_steep_surface_no_silhouette() {
        for degrees in [10.0, 60.0, 85.0, 88.0] {
            let outline = Outline::of(&roof(degrees));
            assert_eq!(outline.cracks.len(), SIDE as usize, "{degrees}°");
            assert!(outline.cracks.iter().all(|crack| crack.kind == CrackKind::Cut && crack.pixel.0 == 47));
        }
    }

    #[test]
    fn a_sphere_has_no_silhouette_inside_its_outline() {
        let radius = 40.0;
        let stack = LayerStack::from_fn(camera(), 1, |x, y| {
            let at = centre_px((x, y)) - 48.0;
            let z = (radius * radius - at.length_squared()).sqrt();
            if !(z > 0.0) {
                return vec![];
            }
            vec![boundary(0, 60.0 - z, DVec3::new(at.x, -at.y, z) / radius)]
        });
        let outline = Outline::of(&stack);
        let covered = |crack: &&Crack| outline.at(crack.pixel).is_some() && outline.at(crack.other_pixel()).is_some();
        assert_eq!(outline.cracks.iter().filter(covered).count(), 0);
        assert!(!outline.cracks.is_empty());
    }

    #[test]
    fn the_edge_nearest_the_middle_is_found_in_world_space() {
        // The ridge of the roof lies at world x = 48.25 − 48 and height 0 (depth 10 from 10 up).
        let target = find_cut_edge(&roof(60.0)).unwrap();
        assert!((target.x - 0.25).abs() < 0.5 && target.y.abs() < 1.0 && target.z.abs() < 1.5, "{target}");
        assert_eq!(find_cut_edge(&flat(|_| Some(0))), None);
        assert_eq!(find_cut_edge(&flat(|_| None)), None);
    }

    #[test]
    fn zooming_stays_on_the_edge() {
        let slope = 30f64.to_radians();
        let mut draw = |camera: &Camera| {
            let at = camera.clone();
            let stack = LayerStack::from_fn(camera.clone(), 1, move |x, y| {
                let ray = at.ray(centre_px((x, y)));
                // Heights of the two half-planes of the roof along this ray.
                let depth = 10.0 + (ray.origin.x - 0.25).abs() * slope.tan();
                let side = (ray.origin.x - 0.25).signum();
                vec![boundary(u32::from(side > 0.0), depth, DVec3::new(side * slope.sin(), 0.0, slope.cos()))]
            });
            Ok::<_, std::convert::Infallible>(stack)
        };
        let near = zoomed_onto_cut(&camera(), 1000.0, &mut draw).unwrap().unwrap();
        let edge_in_view = near.view_from_world(DVec3::new(0.25, 0.0, 0.0));
        let px = near.px_from_view(edge_in_view);
        assert!((px.x - 48.0).abs() < 10.0, "the edge left the middle: {px}");
        let mut flat_truth = |_: &Camera| Ok::<_, std::convert::Infallible>(flat(|_| Some(0)));
        assert_eq!(zoomed_onto_cut(&camera(), 10.0, &mut flat_truth).unwrap(), None);
    }

    #[test]
    fn distances_to_cracks_are_exact() {
        let outline = Outline::of(&flat(|px| Some(u32::from(px.x > 40.0))));
        let distances = outline.distances(outline.cracks.iter());
        assert_eq!(distances.from_pixel((39, 5)), 0.5);
        assert_eq!(distances.from_pixel((40, 5)), 0.5);
        assert_eq!(distances.from_pixel((43, 5)), 3.5);
        assert!(outline.cracks.iter().all(|crack| distances.from_crack(crack) == 0.0));
        assert_eq!(outline.distances([].iter()).from_pixel((0, 0)), f64::INFINITY);
        assert_eq!(Vec3::Z, boundary(0, 1.0, DVec3::Z).normal);
    }
}
