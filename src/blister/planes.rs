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
//! one cell nearly always. Most faces share no plane with anybody: which cells faces of several leaves lie in is found first, and
//! only the faces there are gone into.

use std::collections::HashMap;
use std::hash::{BuildHasher, BuildHasherDefault, DefaultHasher};
use std::sync::atomic::{AtomicU32, Ordering};

use glam::DVec3;
use rayon::prelude::*;

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

/// The cells of the table that a plane's tolerance touches: one nearly always.
struct Cells {
    below: [i64; 4],
    above: [i64; 4],
}

impl Cells {
    /// Around a `place` in units of the tolerance.
    fn around(place: &[f64; 4]) -> Self {
        let cell = |v: f64| (v / CELL).floor() as i64;
        Self { below: place.map(|v| cell(v - 1.0)), above: place.map(|v| cell(v + 1.0)) }
    }

    fn iter(&self) -> impl Iterator<Item = [i64; 4]> + '_ {
        // The same cell twice where both ends of the tolerance lie in it.
        let twice = |corner: usize| (0..4).any(|axis| corner >> axis & 1 == 1 && self.below[axis] == self.above[axis]);
        (0..1 << 4).filter(move |corner| !twice(*corner)).map(|corner: usize| {
            std::array::from_fn(|axis| if corner >> axis & 1 == 0 { self.below[axis] } else { self.above[axis] })
        })
    }
}

/// Where planes are of several leaves: for each cell, which share places by their hash, whose plane there is.
struct Owners {
    places: Vec<AtomicU32>,
    hasher: BuildHasherDefault<DefaultHasher>,
}

impl Owners {
    /// No plane yet.
    const NOBODY: u32 = u32::MAX;
    /// Planes of several leaves.
    const SEVERAL: u32 = u32::MAX - 1;
    /// Places for each face: with so many few cells share one.
    const PLACES_A_FACE: usize = 4;

    fn new(faces: usize) -> Self {
        let places = (faces * Self::PLACES_A_FACE).next_power_of_two();
        let places = (0..places).into_par_iter().map(|_| AtomicU32::new(Self::NOBODY)).collect();
        Self { places, hasher: BuildHasherDefault::default() }
    }

    fn place(&self, cell: &[i64; 4]) -> &AtomicU32 {
        &self.places[self.hasher.hash_one(cell) as usize & (self.places.len() - 1)]
    }

    /// Notes a plane of `leaf`. What a place says at the end does not depend on the order.
    fn note(&self, cells: &Cells, leaf: LeafId) {
        for cell in cells.iter() {
            let place = self.place(&cell);
            if let Err(other) = place.compare_exchange(Self::NOBODY, leaf.0, Ordering::Relaxed, Ordering::Relaxed)
                && other != leaf.0
            {
                place.store(Self::SEVERAL, Ordering::Relaxed);
            }
        }
    }

    /// Whether another leaf may have the plane too.
    fn are_several(&self, cells: &Cells) -> bool {
        cells.iter().any(|cell| self.place(&cell).load(Ordering::Relaxed) == Self::SEVERAL)
    }
}

/// The planes that faces of different leaves share, and for each of `count` faces its plane or [`NO_PLANE`]. `face` tells the faces, and is
/// asked more than once for each: all of them at once would be more than all else that is known of a mesh.
pub(super) fn shared(count: usize, face: impl Fn(usize) -> PlaneUse + Sync) -> (Vec<Plane>, Vec<u32>) {
    let mut plane_of = vec![NO_PLANE; count];
    // Step 1: how large everything is. A half-space's plane may lie far from everything: sizes are those of the triangles where
    // there are any.
    let seen = (0..count).into_par_iter().map(|index| Seen::of(&face(index))).reduce(Seen::nothing, Seen::and);
    if seen.leaves.0 >= seen.leaves.1 {
        return (Vec::new(), plane_of);
    }
    let (low, high) =
        if seen.triangles.0.is_finite() && seen.triangles.1.is_finite() { seen.triangles } else { seen.all };
    let centre = 0.5 * (low + high);
    let size = (high - low).length().max(f64::MIN_POSITIVE);
    // In units of the tolerance: normal and offset.
    let place_of = |face: &PlaneUse| {
        let offset = face.normal.dot(face.point - centre) / (OFFSET_TOLERANCE * size);
        let n = face.normal / NORMAL_TOLERANCE;
        [n.x, n.y, n.z, offset]
    };
    // Step 2: the faces that may share anything. Of meshes of scans those are next to none.
    let owners = Owners::new(count);
    let placed = |index: usize| {
        let face = face(index);
        (face.normal != DVec3::ZERO).then(|| (place_of(&face), face))
    };
    (0..count)
        .into_par_iter()
        .filter_map(placed)
        .for_each(|(place, face)| owners.note(&Cells::around(&place), face.leaf));
    let may_share = |index: usize| {
        let (place, face) = placed(index)?;
        owners.are_several(&Cells::around(&place)).then_some((index, place, face))
    };
    let uses: Vec<(usize, [f64; 4], PlaneUse)> = (0..count).into_par_iter().filter_map(may_share).collect();

    // Step 3: classes of planes that agree.
    struct Class {
        place: [f64; 4],
        /// Among `uses`.
        largest: usize,
        low: DVec3,
        high: DVec3,
        leaf: LeafId,
        is_shared: bool,
    }
    let mut classes: Vec<Class> = Vec::new();
    let mut cells: HashMap<[i64; 4], Vec<u32>> = HashMap::new();
    let mut class_of = Vec::with_capacity(uses.len());
    for (number, (_, place, face)) in uses.iter().enumerate() {
        let agrees = |class: &Class| class.place.iter().zip(place).all(|(a, b)| (a - b).abs() < 1.0);
        let found = Cells::around(place).iter().find_map(|cell| {
            let in_cell = cells.get(&cell).into_iter().flatten().copied();
            in_cell.into_iter().find(|&class| agrees(&classes[class as usize]))
        });
        let class = found.unwrap_or_else(|| {
            let class = classes.len() as u32;
            cells.entry(place.map(|v| (v / CELL).floor() as i64)).or_default().push(class);
            classes.push(Class {
                place: *place,
                largest: number,
                low: face.low,
                high: face.high,
                leaf: face.leaf,
                is_shared: false,
            });
            class
        });
        class_of.push(class);
        let class = &mut classes[class as usize];
        class.is_shared |= class.leaf != face.leaf;
        (class.low, class.high) = (class.low.min(face.low), class.high.max(face.high));
        if face.weight > uses[class.largest].2.weight {
            class.largest = number;
        }
    }
    // Step 4: those of several leaves are planes.
    let mut planes = Vec::new();
    let mut plane_of_class = vec![NO_PLANE; classes.len()];
    for (class, plane) in classes.iter().zip(&mut plane_of_class).filter(|(class, _)| class.is_shared) {
        *plane = planes.len() as u32;
        let (_, _, face) = &uses[class.largest];
        // A solid's face, where there is one, is the largest.
        let extent = face.weight.is_finite().then_some((class.low, class.high));
        planes.push(Plane { normal: face.normal, point: face.point, extent });
    }
    for ((index, _, _), class) in uses.iter().zip(class_of) {
        plane_of[*index] = plane_of_class[class as usize];
    }
    (planes, plane_of)
}

/// What there is to see of some faces, at a glance.
#[derive(Clone, Copy)]
struct Seen {
    /// First and last.
    leaves: (LeafId, LeafId),
    /// A box around the triangles.
    triangles: (DVec3, DVec3),
    /// A box around all faces.
    all: (DVec3, DVec3),
}

impl Seen {
    fn nothing() -> Self {
        let none = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        Self { leaves: (LeafId(u32::MAX), LeafId(0)), triangles: none, all: none }
    }

    fn of(face: &PlaneUse) -> Self {
        let all = (face.low, face.high);
        let triangles = if face.weight.is_finite() { all } else { Self::nothing().triangles };
        Self { leaves: (face.leaf, face.leaf), triangles, all }
    }

    fn and(self, other: Self) -> Self {
        let both = |a: (DVec3, DVec3), b: (DVec3, DVec3)| (a.0.min(b.0), a.1.max(b.1));
        Self {
            leaves: (self.leaves.0.min(other.leaves.0), self.leaves.1.max(other.leaves.1)),
            triangles: both(self.triangles, other.triangles),
            all: both(self.all, other.all),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shared(uses: &[PlaneUse]) -> (Vec<Plane>, Vec<u32>) {
        super::shared(uses.len(), |index| uses[index])
    }

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
