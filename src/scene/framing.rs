//! A camera for a scene that names none: a three-quarter view that holds the result.
//!
//! *Practice.* The result is bounded by its leaves' boxes, combined as the expression combines the leaves: a difference is
//! no larger than what is cut, an intersection no larger than what its operands share. What has no bounds (a half-space, a
//! complement) does not count while anything else does. The camera then moves back until the box's corners just fit the
//! picture less its margin, which has a closed form, since each corner bounds the eye's place linearly.

use glam::{DAffine3, DVec2, DVec3};

use super::{CameraSpec, Scene};
use crate::csg::positive::PositiveNode;
use crate::csg::{LeafId, Tree};
use crate::space::Lens;

/// Vertical field of view where nobody asks for one, in degrees: about that of a portrait lens, with little distortion.
pub const FOV_Y_DEGREES: f64 = 35.0;

/// Share of the picture that stays free on each side.
const MARGIN: f64 = 0.05;

/// From the target towards the eye: from the front (−Y), the right and above.
const TOWARDS_EYE: DVec3 = DVec3::new(0.55, -1.0, 0.6);

/// An axis-aligned box in world space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounds {
    /// Least corner.
    pub min: DVec3,
    /// Greatest corner.
    pub max: DVec3,
}

impl Bounds {
    /// Around `points`; `None` where there is none.
    pub fn of_points(points: impl IntoIterator<Item = DVec3>) -> Option<Self> {
        points.into_iter().map(|p| Self { min: p, max: p }).reduce(Self::union)
    }

    /// Around both.
    pub fn union(self, other: Self) -> Self {
        Self { min: self.min.min(other.min), max: self.max.max(other.max) }
    }

    /// What both share; `None` where they do not meet.
    pub fn intersection(self, other: Self) -> Option<Self> {
        let shared = Self { min: self.min.max(other.min), max: self.max.min(other.max) };
        shared.min.cmple(shared.max).all().then_some(shared)
    }

    /// The corners.
    pub fn corners(&self) -> [DVec3; 8] {
        std::array::from_fn(|i| {
            let pick = |axis: usize| if i >> axis & 1 == 0 { self.min[axis] } else { self.max[axis] };
            DVec3::new(pick(0), pick(1), pick(2))
        })
    }

    /// Around the image of the box.
    pub fn transformed(&self, map: &DAffine3) -> Self {
        let corners = self.corners().map(|corner| map.transform_point3(corner));
        Self {
            min: corners.into_iter().fold(corners[0], DVec3::min),
            max: corners.into_iter().fold(corners[0], DVec3::max),
        }
    }

    /// The middle.
    pub fn centre(&self) -> DVec3 {
        0.5 * (self.min + self.max)
    }

    /// The length from corner to corner.
    pub fn diagonal(&self) -> f64 {
        (self.max - self.min).length()
    }
}

/// Where an expression's result can be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Extent {
    /// Nowhere: its operands do not meet.
    Empty,
    /// Within a box.
    Within(Bounds),
    /// Without bounds; with a box around the bounded leaves that shape it, if there are any.
    Unbounded(Option<Bounds>),
}

/// Where the result of `tree` can be, from where its leaves are, world space.
pub fn extent(tree: &Tree, leaf_extent: impl Fn(LeafId) -> Extent) -> Extent {
    let positive = tree.positive();
    let mut stack: Vec<Extent> = Vec::new();
    for node in positive.nodes() {
        let value = match node {
            PositiveNode::Literal(literal) => match leaf_extent(literal.leaf) {
                Extent::Within(bounds) if literal.negated => Extent::Unbounded(Some(bounds)),
                extent => extent,
            },
            PositiveNode::And(..) | PositiveNode::Or(..) => {
                let (Some(b), Some(a)) = (stack.pop(), stack.pop()) else { return Extent::Unbounded(None) };
                if matches!(node, PositiveNode::And(..)) { a.and(b) } else { a.or(b) }
            }
        };
        stack.push(value);
    }
    stack.pop().unwrap_or(Extent::Unbounded(None))
}

impl Extent {
    /// The box, if there is one.
    pub fn bounds(self) -> Option<Bounds> {
        match self {
            Self::Empty => None,
            Self::Within(bounds) => Some(bounds),
            Self::Unbounded(bounds) => bounds,
        }
    }

    fn and(self, other: Self) -> Self {
        match (self, other) {
            (Self::Empty, _) | (_, Self::Empty) => Self::Empty,
            (Self::Within(a), Self::Within(b)) => a.intersection(b).map_or(Self::Empty, Self::Within),
            (Self::Within(a), Self::Unbounded(_)) | (Self::Unbounded(_), Self::Within(a)) => Self::Within(a),
            (Self::Unbounded(a), Self::Unbounded(b)) => Self::Unbounded(around_both(a, b)),
        }
    }

    fn or(self, other: Self) -> Self {
        match (self, other) {
            (Self::Empty, other) | (other, Self::Empty) => other,
            (Self::Within(a), Self::Within(b)) => Self::Within(a.union(b)),
            (Self::Within(a), Self::Unbounded(b)) | (Self::Unbounded(b), Self::Within(a)) => {
                Self::Unbounded(around_both(Some(a), b))
            }
            (Self::Unbounded(a), Self::Unbounded(b)) => Self::Unbounded(around_both(a, b)),
        }
    }
}

fn around_both(a: Option<Bounds>, b: Option<Bounds>) -> Option<Bounds> {
    match (a, b) {
        (Some(a), Some(b)) => Some(a.union(b)),
        (one, None) | (None, one) => one,
    }
}

/// The camera that frames `scene`: `leaf_extent` tells where a leaf is in world space, and `drawn_bounds` the box of what
/// is drawn of it in any case.
pub fn frame(
    scene: &Scene,
    leaf_extent: impl Fn(LeafId) -> Extent,
    drawn_bounds: impl Fn(LeafId) -> Bounds,
) -> CameraSpec {
    let all = || (0..scene.leaves.len() as u32).map(LeafId);
    let bounds = match extent(&scene.tree, &leaf_extent) {
        Extent::Within(bounds) | Extent::Unbounded(Some(bounds)) => Some(bounds),
        // An empty picture of where something might have been.
        Extent::Empty => all().filter_map(|leaf| leaf_extent(leaf).bounds()).reduce(Bounds::union),
        Extent::Unbounded(None) => None,
    };
    let bounds = bounds.or_else(|| all().map(drawn_bounds).reduce(Bounds::union));
    frame_bounds(&bounds.unwrap_or(Bounds { min: DVec3::ZERO, max: DVec3::ONE }), scene.size)
}

/// The camera that frames a box in a picture of `size` (width, height) pixels.
pub fn frame_bounds(bounds: &Bounds, size: (u32, u32)) -> CameraSpec {
    // A point has no size to fit: one unit around it, or enough for its coordinates to tell apart what is in the picture.
    const COARSEST_VIEW: f64 = 1e-9;
    let resolution = COARSEST_VIEW * bounds.centre().abs().max_element();
    let least = if bounds.diagonal() > resolution { 0.0 } else { resolution.max(1.0) };
    let bounds = Bounds { min: bounds.min - least, max: bounds.max + least };
    let up = DVec3::Z;
    let forward = -TOWARDS_EYE.normalize();
    let right = forward.cross(up).normalize();
    let down = forward.cross(right);
    let centre = bounds.centre();
    let corners = bounds.corners().map(|corner| {
        let offset = corner - centre;
        DVec3::new(offset.dot(right), offset.dot(down), offset.dot(forward))
    });
    // Half the picture's tangents, less the margin.
    let tangent_y = (0.5 * FOV_Y_DEGREES).to_radians().tan() * (1.0 - 2.0 * MARGIN);
    let tangents = DVec2::new(tangent_y * f64::from(size.0) / f64::from(size.1.max(1)), tangent_y);
    // A corner (x, z) fits where |x − eye_x| ≤ t (z − eye_z): two lines a corner; the eye is where the outermost cross.
    let fit = |axis: usize| {
        let t = tangents[axis];
        let most = corners.iter().map(|c| c[axis] - t * c.z).fold(f64::NEG_INFINITY, f64::max);
        let least = corners.iter().map(|c| c[axis] + t * c.z).fold(f64::INFINITY, f64::min);
        (0.5 * (most + least), (least - most) / (2.0 * t))
    };
    let ((x, depth_x), (y, depth_y)) = (fit(0), fit(1));
    let eye = centre + right * x + down * y + forward * depth_x.min(depth_y);
    // The target lies on the axis of view, at the depth of the box's middle.
    let target = eye + forward * (centre - eye).dot(forward);
    CameraSpec { eye, target, up, lens: Lens::FovY(FOV_Y_DEGREES) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::csg::expression;

    fn cube(centre: DVec3, half: f64) -> Bounds {
        Bounds { min: centre - half, max: centre + half }
    }

    /// Leaves a and b overlap, c lies apart, h has no bounds, and f is a flat scan of the size of c.
    fn leaf_extent(leaf: LeafId) -> Extent {
        match leaf.0 {
            0 => Extent::Within(cube(DVec3::ZERO, 1.0)),
            1 => Extent::Within(cube(DVec3::X, 1.0)),
            2 => Extent::Within(cube(DVec3::X * 10.0, 1.0)),
            3 => Extent::Unbounded(None),
            _ => Extent::Unbounded(Some(cube(DVec3::X * 10.0, 1.0))),
        }
    }

    fn extent_of(text: &str) -> Extent {
        let tree = expression::parse(text, &mut |name| "abchf".find(name).map(|i| LeafId(i as u32))).unwrap();
        extent(&tree, leaf_extent)
    }

    #[test]
    fn an_expression_is_bounded_as_its_operators_say() {
        let within = |min: DVec3, max: DVec3| Extent::Within(Bounds { min, max });
        assert_eq!(extent_of("a - b"), extent_of("a"));
        assert_eq!(extent_of("a & b"), within(DVec3::new(0.0, -1.0, -1.0), DVec3::ONE));
        assert_eq!(extent_of("a & c"), Extent::Empty);
        assert_eq!(extent_of("a | b"), within(-DVec3::ONE, DVec3::new(2.0, 1.0, 1.0)));
        assert_eq!(extent_of("a & h"), extent_of("a"));
        assert_eq!(extent_of("a - h"), extent_of("a"));
        assert_eq!(extent_of("!!a"), extent_of("a"));
        assert_eq!(extent_of("(a & c) | b"), extent_of("b"));
        assert_eq!(extent_of("h - a"), Extent::Unbounded(leaf_extent(LeafId(0)).bounds()));
        assert_eq!(extent_of("a | h"), Extent::Unbounded(leaf_extent(LeafId(0)).bounds()));
        assert_eq!(extent_of("h"), Extent::Unbounded(None));
        // A flat scan stands for a half-space, so its box bounds nothing.
        assert_eq!(extent_of("a & f"), extent_of("a"));
        assert_eq!(extent_of("f"), extent_of("!c"));
    }

    #[test]
    fn the_box_fills_the_picture_up_to_the_margin_and_is_centred() {
        let boxes = [
            cube(DVec3::ZERO, 1.0),
            cube(DVec3::new(1e5, -3e4, 7.0), 1e-2),
            Bounds { min: DVec3::ZERO, max: DVec3::new(1.0, 20.0, 3.0) },
            Bounds { min: DVec3::ZERO, max: DVec3::new(30.0, 2.0, 0.0) },
        ];
        for bounds in boxes {
            for size in [(512, 512), (1024, 300), (200, 900)] {
                let camera = frame_bounds(&bounds, size).camera(size).unwrap();
                let px = bounds.corners().map(|c| camera.px_from_view(camera.view_from_world(c)));
                let sides = DVec2::new(f64::from(size.0), f64::from(size.1));
                let least = px.into_iter().fold(DVec2::MAX, DVec2::min) / sides;
                let most = px.into_iter().fold(DVec2::MIN, DVec2::max) / sides;
                let free = least.min(DVec2::ONE - most);
                let aside = (least + most - DVec2::ONE).abs();
                assert!(free.min_element() > MARGIN - 1e-6, "{bounds:?} {size:?}: {free}");
                assert!(free.min_element() < MARGIN + 1e-6, "{bounds:?} {size:?}: {free}");
                // In the direction that fits tightly the box is centred.
                let tight = if free.x < free.y { aside.x } else { aside.y };
                assert!(tight < 1e-6, "{bounds:?} {size:?}: {aside}");
            }
        }
    }

    #[test]
    fn a_point_and_an_empty_scene_still_get_a_camera() {
        for point in [DVec3::ZERO, DVec3::splat(1e12)] {
            let spec = frame_bounds(&Bounds { min: point, max: point }, (64, 64));
            let camera = spec.camera((64, 64)).unwrap();
            let px = camera.px_from_view(camera.view_from_world(point));
            // The box around it is centred, and perspective puts its middle somewhat aside.
            assert!((px - DVec2::splat(32.0)).length() < 8.0, "{px}");
        }
    }

    #[test]
    fn a_map_takes_the_box_with_it() {
        let turned = cube(DVec3::ZERO, 1.0).transformed(&DAffine3::from_rotation_z(45f64.to_radians()));
        assert!((turned.max.x - 2f64.sqrt()).abs() < 1e-12 && (turned.max.z - 1.0).abs() < 1e-12);
    }
}
