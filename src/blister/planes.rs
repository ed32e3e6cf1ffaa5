//! Planes that two leaves or more share.
//!
//! *Theory.* Coincident faces must toggle together, so they need one depth, bit for bit, however each is cut into triangles.
//! A depth that comes from a triangle's own corners differs in the last bits from one triangle to the next, and the order
//! of two coincident faces is then noise: a box minus its neighbour shows speckles of the shared face.
//!
//! *Changes from the paper.* Blister's coincidences are what a depth buffer's rounding makes them. Here planes are
//! *interned*: faces of different leaves whose planes agree within a tolerance get one equation, that of the largest face.
//!
//! *Practice.* Rounded hash keys alone are fragile, since two equal planes may lie on both sides of a rounding border.
//! So a plane is looked up in every cell that its tolerance touches; cells are [`CELL`] tolerances wide, which makes that
//! one cell nearly always.

use std::collections::HashMap;

use glam::DVec3;

use crate::csg::LeafId;
use crate::geometry::Solid;

/// A triangle's plane is its own.
pub(super) const NO_PLANE: u32 = u32::MAX;

/// Unit normals of one plane differ by less than this in every coordinate. Files hold `f32` positions, whose rounding
/// turns the normal of a face of a tenth of its coordinates by a ten-millionth or so.
const NORMAL_TOLERANCE: f64 = 1e-6;

/// Offsets of one plane differ by less than this share of the scene's size.
const OFFSET_TOLERANCE: f64 = 1e-6;

/// Width of a cell of the table, in tolerances.
const CELL: f64 = 64.0;

/// A direction that no plane of a drawn part contains but by chance, so that rounding cannot turn a normal over: its
/// coordinates are in no ratio of small numbers.
const SIDE: DVec3 = DVec3::new(0.813_071, 0.493_149, 0.310_327);

/// A plane that leaves share, in world space.
#[derive(Debug, Clone, Copy)]
pub(super) struct Plane {
    pub normal: DVec3,
    pub point: DVec3,
    /// A box around the faces that lie in it: depths are held to its range. `None` where a solid's face is among them.
    pub extent: Option<(DVec3, DVec3)>,
}

/// A flat face of a leaf.
#[derive(Debug, Clone, Copy)]
pub(super) struct PlaneUse {
    leaf: LeafId,
    /// Unit and canonical; zero where the face has no area.
    normal: DVec3,
    point: DVec3,
    low: DVec3,
    high: DVec3,
    /// Twice the area; infinite for the face of a solid, which is exact.
    weight: f64,
}

impl PlaneUse {
    /// The face is a triangle.
    pub fn of_triangle(leaf: LeafId, corners: [DVec3; 3]) -> Self {
        let [a, b, c] = corners;
        let across = (b - a).cross(c - a);
        let (low, high) = (a.min(b).min(c), a.max(b).max(c));
        Self { leaf, normal: canonical(across), point: a, low, high, weight: across.length() }
    }

    /// The face of a solid.
    pub fn of_face(leaf: LeafId, point: DVec3, normal: DVec3) -> Self {
        Self { leaf, normal: canonical(normal), point, low: point, high: point, weight: f64::INFINITY }
    }
}

/// The unit normal of which every plane has just one: of its two that which looks the way of [`SIDE`].
fn canonical(normal: DVec3) -> DVec3 {
    let Some(unit) = normal.try_normalize() else { return DVec3::ZERO };
    if unit.dot(SIDE) < 0.0 { -unit } else { unit }
}

/// The planes of a solid's flat faces: a point and the outward normal, leaf space.
pub(super) fn flat_faces(solid: &Solid) -> Vec<(DVec3, DVec3)> {
    match solid {
        Solid::HalfSpace { point, normal, .. } => vec![(*point, normal.normalize_or(DVec3::Z))],
        Solid::Box { min, max } => DVec3::AXES.into_iter().flat_map(|axis| [(*min, -axis), (*max, axis)]).collect(),
        Solid::Cylinder { from, to, .. } | Solid::Cone { from, to, .. } => {
            let axis = (to - from).normalize_or(DVec3::Z);
            vec![(*from, -axis), (*to, axis)]
        }
        Solid::Sphere { .. } | Solid::Torus { .. } | Solid::Blend { .. } => Vec::new(),
    }
}

/// The planes that faces of different leaves share, and for each face its plane or [`NO_PLANE`].
pub(super) fn shared(uses: &[PlaneUse]) -> (Vec<Plane>, Vec<u32>) {
    let mut plane_of = vec![NO_PLANE; uses.len()];
    let one_leaf = uses.windows(2).all(|pair| pair[0].leaf == pair[1].leaf);
    if one_leaf {
        return (Vec::new(), plane_of);
    }
    // A half-space's plane may lie far from everything: sizes are those of the triangles where there are any.
    let is_triangle = |face: &&PlaneUse| face.weight.is_finite();
    let around = |faces: &mut dyn Iterator<Item = &PlaneUse>| {
        faces.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), face| (low.min(face.low), high.max(face.high)))
    };
    let (mut low, mut high) = around(&mut uses.iter().filter(is_triangle));
    if !(low.is_finite() && high.is_finite()) {
        (low, high) = around(&mut uses.iter());
    }
    let centre = 0.5 * (low + high);
    let size = (high - low).length().max(f64::MIN_POSITIVE);

    /// Planes that agree.
    struct Class {
        /// In units of the tolerance: normal and offset.
        place: [f64; 4],
        largest: usize,
        low: DVec3,
        high: DVec3,
        leaf: LeafId,
        is_shared: bool,
    }
    let mut classes: Vec<Class> = Vec::new();
    let mut cells: HashMap<[i64; 4], Vec<u32>> = HashMap::new();
    let mut class_of = vec![NO_PLANE; uses.len()];
    for (index, face) in uses.iter().enumerate() {
        if face.normal == DVec3::ZERO {
            continue;
        }
        let offset = face.normal.dot(face.point - centre) / (OFFSET_TOLERANCE * size);
        let n = face.normal / NORMAL_TOLERANCE;
        let place = [n.x, n.y, n.z, offset];
        let below = place.map(|v| ((v - 1.0) / CELL).floor() as i64);
        let above = place.map(|v| ((v + 1.0) / CELL).floor() as i64);
        let agrees = |class: &Class| class.place.iter().zip(&place).all(|(a, b)| (a - b).abs() < 1.0);
        let mut found = None;
        for corner in 0..16_usize {
            let pick = |axis: usize| if corner >> axis & 1 == 0 { below[axis] } else { above[axis] };
            // The same cell twice where both ends of the tolerance lie in it.
            if (0..4).any(|axis| corner >> axis & 1 == 1 && below[axis] == above[axis]) {
                continue;
            }
            let cell = cells.get(&std::array::from_fn(pick));
            found = cell.into_iter().flatten().copied().find(|&class| agrees(&classes[class as usize]));
            if found.is_some() {
                break;
            }
        }
        let number = found.unwrap_or_else(|| {
            let number = classes.len() as u32;
            cells.entry(place.map(|v| (v / CELL).floor() as i64)).or_default().push(number);
            classes.push(Class {
                place,
                largest: index,
                low: face.low,
                high: face.high,
                leaf: face.leaf,
                is_shared: false,
            });
            number
        });
        let class = &mut classes[number as usize];
        class.is_shared |= class.leaf != face.leaf;
        (class.low, class.high) = (class.low.min(face.low), class.high.max(face.high));
        if face.weight > uses[class.largest].weight {
            class.largest = index;
        }
        class_of[index] = number;
    }
    let mut planes = Vec::new();
    let mut plane_of_class = vec![NO_PLANE; classes.len()];
    for (class, plane) in classes.iter().zip(&mut plane_of_class).filter(|(class, _)| class.is_shared) {
        *plane = planes.len() as u32;
        let face = &uses[class.largest];
        // A solid's face, where there is one, is the largest.
        let extent = face.weight.is_finite().then_some((class.low, class.high));
        planes.push(Plane { normal: face.normal, point: face.point, extent });
    }
    for (plane, class) in plane_of.iter_mut().zip(class_of).filter(|(_, class)| *class != NO_PLANE) {
        *plane = plane_of_class[class as usize];
    }
    (planes, plane_of)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn triangle(leaf: u32, z: f64, tilt: f64) -> PlaneUse {
        let at = |x: f64, y: f64| DVec3::new(x, y, z + tilt * x);
        PlaneUse::of_triangle(LeafId(leaf), [at(0.0, 0.0), at(1.0, 0.0), at(0.0, 1.0)])
    }

    #[test]
    fn planes_of_different_leaves_are_one_within_the_tolerance_wherever_cells_end() {
        // Positions on both sides of every kind of cell border.
        for step in 0..200 {
            let z = f64::from(step) * 0.137e-4;
            let uses =
                [triangle(0, z, 0.0), triangle(1, z + 3e-7, 2e-7), triangle(1, z + 0.1, 0.0), triangle(2, -1.0, 0.1)];
            let (planes, plane_of) = shared(&uses);
            assert_eq!(planes.len(), 1, "at {z}");
            assert_eq!(plane_of, [0, 0, NO_PLANE, NO_PLANE]);
        }
    }

    #[test]
    fn opposite_orientations_are_one_plane_and_one_leaf_alone_shares_nothing() {
        let turned = |leaf, [a, b, c]: [DVec3; 3]| PlaneUse::of_triangle(LeafId(leaf), [a, c, b]);
        let corners = [DVec3::ZERO, DVec3::X, DVec3::Y];
        assert_eq!(shared(&[triangle(0, 0.0, 0.0), turned(1, corners)]).1, [0, 0]);
        assert_eq!(shared(&[triangle(0, 0.0, 0.0), turned(0, corners)]).1, [NO_PLANE; 2]);
        assert_eq!(shared(&[PlaneUse::of_face(LeafId(4), DVec3::X, -DVec3::Z), triangle(0, 0.0, 0.0)]).1, [0, 0]);
    }
}
