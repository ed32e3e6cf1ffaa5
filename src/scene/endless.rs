//! What goes on without end: half-spaces, scans of a plane that stand for one, and results that nothing bounds.
//!
//! *Theory.* Far from the origin only directions count: an intersection of half-spaces with outward normals nᵢ reaches to
//! infinity along d just where nᵢ·d ≤ 0 for all of them. Those directions form a polyhedral cone, and a cone that holds
//! any direction holds one of these: a cross product ±nᵢ×nⱼ (its edges, or its axis where all normals lie in one plane), or
//! a direction across some nᵢ (where there is one normal only). A result in positive form is a union of such cones, with
//! bounded leaves out and their complements in; so asking the expression along those few directions decides it.
//!
//! *Practice.* A direction *in* a plane counts as in, on both of its sides: whether the plane's own offset lets it in is not
//! asked. So of `a & !b` with b a half-space inside a and parallel to it, which is a slab, this says rightly that it has
//! no end, and of the same with b around a, which is empty, as well.

use glam::{DAffine3, DVec3};

use crate::csg::positive::{Folded, PositiveNode};
use crate::csg::{LeafId, Tree, Tri};
use crate::geometry::PointCloud;

/// Points lie in a plane, or on a line, where they leave it by less than this share of their extent: what 32-bit
/// coordinates round by, with room for a transform.
const FLAT: f64 = 1e-5;

/// Two unit normals whose cross product is shorter are parallel.
const PARALLEL: f64 = 1e-9;

/// What a leaf is far from the origin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Far {
    /// It ends.
    Nothing,
    /// A half-space with this outward unit normal, world space.
    HalfSpace(DVec3),
}

/// Whether the result of `tree` goes on without end; not claimed of an expression of so many half-spaces that asking would
/// take seconds.
pub fn is_endless(tree: &Tree, far: impl Fn(LeafId) -> Far) -> bool {
    // A node takes a few nanoseconds.
    const MOST_STEPS: usize = 100_000_000;
    let tri = |leaf: LeafId| if far(leaf) == Far::Nothing { Tri::False } else { Tri::Unknown };
    let positive = match tree.positive().fold(tri) {
        Folded::Constant(endless) => return endless,
        Folded::Open(positive) => positive,
    };
    let mut normals: Vec<DVec3> = Vec::new();
    for leaf in positive.leaves() {
        if let Far::HalfSpace(normal) = far(leaf)
            && !normals.iter().any(|known| known.cross(normal).length() < PARALLEL)
        {
            normals.push(normal);
        }
    }
    if normals.len().saturating_pow(2).saturating_mul(positive.nodes().len()) > MOST_STEPS {
        return false;
    }
    let holds = |direction: DVec3| {
        let mut stack = Vec::new();
        for node in positive.nodes() {
            let value = match node {
                PositiveNode::Literal(literal) => match far(literal.leaf) {
                    Far::Nothing => literal.negated,
                    Far::HalfSpace(normal) => {
                        let slope = if literal.negated { -normal } else { normal }.dot(direction);
                        slope <= PARALLEL
                    }
                },
                PositiveNode::And(..) | PositiveNode::Or(..) => {
                    let (Some(b), Some(a)) = (stack.pop(), stack.pop()) else { return false };
                    if matches!(node, PositiveNode::And(..)) { a && b } else { a || b }
                }
            };
            stack.push(value);
        }
        stack.pop().unwrap_or(false)
    };
    let across = normals.iter().map(|normal| normal.any_orthonormal_vector());
    let edges = normals.iter().enumerate().flat_map(|(i, a)| normals[..i].iter().map(|b| a.cross(*b).normalize()));
    across.chain(edges).any(|direction| holds(direction) || holds(-direction))
}

/// How far a cloud spreads.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Spread {
    /// All points at one place.
    Point,
    /// All on one line.
    Line,
    /// All in one plane, with this unit normal (of either sign), world space.
    Plane(DVec3),
    /// None of these.
    Space,
}

impl Spread {
    /// Of `cloud` as it lies in the world.
    pub fn of(cloud: &PointCloud, world_from_leaf: &DAffine3) -> Self {
        let Some(&first) = cloud.positions.first() else { return Self::Point };
        let first = world_from_leaf.transform_point3(first);
        // The first of the farthest, so that the answer does not depend on anything but the order of the points.
        let farthest = |measure: &dyn Fn(DVec3) -> f64| {
            let offsets = cloud.positions.iter().map(|&p| world_from_leaf.transform_point3(p) - first);
            offsets.map(|e| (measure(e), e)).fold((0.0, DVec3::ZERO), |a, b| if b.0 > a.0 { b } else { a })
        };
        let (extent, along) = farthest(&|e| e.length());
        if !(extent > 0.0) {
            return Self::Point;
        }
        let axis = along / extent;
        let (width, aside) = farthest(&|e| e.reject_from_normalized(axis).length());
        if !(width > FLAT * extent) {
            return Self::Line;
        }
        let normal = axis.cross(aside).normalize();
        let (height, _) = farthest(&|e| e.dot(normal).abs());
        if height > FLAT * extent { Self::Space } else { Self::Plane(normal) }
    }
}

/// The outward normal of the half-space that a solid `cloud` stands for: all its points lie in one plane (or there is one
/// point alone) and its normals look to one side of it. `None` where it is anything else.
pub fn half_space_of(cloud: &PointCloud, world_from_leaf: &DAffine3) -> Option<DVec3> {
    let normals = cloud.normals.as_ref()?;
    // Of a closed plate the normals cancel.
    const ONE_SIDE: f64 = 0.5;
    let sum = normals.iter().map(|n| n.as_dvec3()).sum::<DVec3>();
    if !(sum.length() > ONE_SIDE * normals.len() as f64) {
        return None;
    }
    let outward = (world_from_leaf.matrix3.inverse().transpose() * sum).try_normalize()?;
    match Spread::of(cloud, world_from_leaf) {
        Spread::Point | Spread::Line => Some(outward),
        Spread::Plane(normal) => Some(if normal.dot(outward) < 0.0 { -normal } else { normal }),
        Spread::Space => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::csg::expression;

    /// a and b are bounded; u, v, w are half-spaces below X, Y, Z; o is u turned round.
    fn endless(text: &str) -> bool {
        let tree = expression::parse(text, &mut |name| "abuvwo".find(name).map(|i| LeafId(i as u32))).unwrap();
        is_endless(&tree, |leaf| match leaf.0 {
            0 | 1 => Far::Nothing,
            2 => Far::HalfSpace(DVec3::X),
            3 => Far::HalfSpace(DVec3::Y),
            4 => Far::HalfSpace(DVec3::Z),
            _ => Far::HalfSpace(DVec3::NEG_X),
        })
    }

    #[test]
    fn what_nothing_bounds_is_endless() {
        for text in ["u", "!a", "a | u", "u & v", "u & v & w", "u & o", "u & o & v", "!u & v", "u - a", "!(a & u)"] {
            assert!(endless(text), "{text}");
        }
        for text in ["a", "a & u", "a - u", "a - b", "a | b", "(a | u) & b", "!(!a | u)"] {
            assert!(!endless(text), "{text}");
        }
    }

    #[test]
    fn half_spaces_that_close_a_body_are_not() {
        let golden = 0.5 * (1.0 + 5f64.sqrt());
        // The corners of an octahedron, of a cube and of a tetrahedron as normals.
        let axes = [DVec3::X, DVec3::Y, DVec3::Z];
        let cube: Vec<DVec3> = axes.iter().flat_map(|n| [*n, -*n]).collect();
        let tetrahedron: Vec<DVec3> =
            [[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]].map(DVec3::from_array).to_vec();
        let mut octahedron = tetrahedron.clone();
        octahedron.extend(tetrahedron.iter().map(|n| -*n));
        let wedge = vec![DVec3::new(golden, 1.0, 0.0), DVec3::new(-golden, 1.0, 0.0), DVec3::NEG_Y];
        for (normals, expected) in [
            (cube.clone(), false),
            (tetrahedron.clone(), false),
            (octahedron, false),
            // A triangle's prism, and bodies with one face taken away.
            (wedge, true),
            (cube[1..].to_vec(), true),
            (tetrahedron[1..].to_vec(), true),
        ] {
            let all = (1..normals.len()).fold(Tree::leaf(LeafId(0)), |t, i| Tree::and(t, Tree::leaf(LeafId(i as u32))));
            let far = |leaf: LeafId| Far::HalfSpace(normals[leaf.0 as usize].normalize());
            assert_eq!(is_endless(&all, far), expected, "{normals:?}");
        }
    }

    fn cloud(positions: Vec<DVec3>, normal: DVec3) -> PointCloud {
        let normals = vec![normal.as_vec3(); positions.len()];
        PointCloud { positions, normals: Some(normals), ..Default::default() }
    }

    #[test]
    fn scans_of_a_plane_stand_for_a_half_space_and_plates_do_not() {
        let tilted = DVec3::new(1.0, 2.0, 2.0) / 3.0;
        let (u, v) = tilted.any_orthonormal_pair();
        let point = |i: usize| DVec3::splat(7.0) + u * (i % 9) as f64 + v * (i / 9) as f64;
        let wall = cloud((0..81).map(point).collect(), tilted);
        let found = half_space_of(&wall, &DAffine3::IDENTITY).unwrap();
        assert!((found - tilted).length() < 1e-6, "{found}");
        // Flattened in leaf space, the plane turns and so does its normal.
        let squeezed = DAffine3::from_scale(DVec3::new(1.0, 1.0, 0.5));
        let found = half_space_of(&wall, &squeezed).unwrap();
        let across = [u, v].map(|d| squeezed.transform_vector3(d).normalize().dot(found).abs());
        assert!(across[0].max(across[1]) < 1e-6 && found.z > 0.0);
        let mut plate = wall.clone();
        plate.normals.as_mut().unwrap().iter_mut().step_by(2).for_each(|n| *n = -*n);
        assert_eq!(half_space_of(&plate, &DAffine3::IDENTITY), None);
        let mut bent = wall.clone();
        bent.positions[40] += tilted * 0.1;
        assert_eq!(half_space_of(&bent, &DAffine3::IDENTITY), None);
        assert_eq!(half_space_of(&cloud(vec![DVec3::ONE], DVec3::Z), &DAffine3::IDENTITY), Some(DVec3::Z));
    }

    #[test]
    fn points_lines_planes_and_bodies_are_told_apart() {
        let spread = |points: &[[f64; 3]]| {
            let positions = points.iter().map(|p| DVec3::from_array(*p)).collect();
            Spread::of(&PointCloud { positions, ..Default::default() }, &DAffine3::IDENTITY)
        };
        assert_eq!(spread(&[[3.0; 3]; 4]), Spread::Point);
        assert_eq!(spread(&[[0.0; 3], [1.0; 3], [5.0; 3]]), Spread::Line);
        assert!(
            matches!(spread(&[[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [4.0, 3.0, 0.0]]), Spread::Plane(n) if n.z.abs() == 1.0)
        );
        assert_eq!(spread(&[[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [4.0, 3.0, 0.1]]), Spread::Space);
    }
}
