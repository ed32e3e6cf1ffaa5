//! Surfaces of different leaves that coincide: on one ray they toggle together.
//!
//! # Theory
//! Where surfaces of two leaves lie in each other, each asks on which side of the other it is, and rounding answers: the picture is
//! speckled. The rule that every pipeline keeps (DESIGN §3.8; Blister, Hable and Rossignac 2005 §4.3) is that coincident crossings
//! toggle together: there is a boundary where the expression *before* all of them differs from the expression *after* all of them. So
//! `a - b` is empty where the surfaces of a and b are one, and `a | b` shows one surface, not two. It is owned by a leaf that matters,
//! then by one that goes the result's way, then by the least index.
//!
//! # Changes from the paper
//! Blister's fragments coincide where their depths are equal. Surfels of two samplings of one surface never give equal depths. They
//! *coincide* here where, at the hit, the other leaf's surface is nearer than [`TIED_SHARE`] of the smaller of both surfels' radii and as
//! parallel as [`MOST_SINE`] says. That is far below what a picture shows of a surfel, and above the rounding of hits and of fields that
//! were fitted to the same surface; two noisy scans of one object do not coincide.
//!
//! # Practice
//! A hit that is told that the other surface is there is not decided but kept ([`Tied`]) until all of the ray's surfaces are found:
//! then those that lie together are one [`boundary`]. A hit whose counterpart was not found, since the other leaf sees it a little
//! farther away, or never asks (no solid asks a sheet), lets the other toggle along and shows itself where that makes a boundary: so
//! nothing is lost at the rim of where surfaces coincide. Only where the boundary is the other's alone, as in `(b | c) & a` within c, does
//! it show nothing: the other did not have to ask it, and has a hit of its own. Partner lists (`--partners`, `--clip fragment`) know no ties, as in the paper.

use std::cell::RefCell;

use glam::{DVec2, DVec3, Vec3};

use super::body::body_at;
use super::hits::Hit;
use crate::classify::{LeafField, Model};
use crate::csg::LeafId;
use crate::layers::Facing;
use crate::scene::LeafKind;
use crate::space::Camera;

/// Surfaces nearer to each other than this share of a surfel's radius are one.
pub(crate) const TIED_SHARE: f32 = 1e-3;

/// The sine of the angle between two surfaces that stay within [`TIED_SHARE`] of the radius over a disk, one leaning on either side.
pub(crate) const MOST_SINE: f32 = 2.0 * TIED_SHARE;

/// Rays are taken to meet a surface no more obliquely than this where depths are compared: below, hits are not exact enough.
pub(crate) const LEAST_COSINE: f32 = 0.05;

/// No reach is longer, as a share of the surfel's radius, where the ray's direction is no shorter than one.
pub(crate) const MOST_REACH_IN_RADII: f32 = 2.0 * TIED_SHARE / LEAST_COSINE;

/// A crossing with the surface of a leaf where that of another may coincide with it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Tied {
    /// Depth less the tile's anchor.
    pub t: f32,
    /// The depths of crossings that coincide differ by no more.
    pub reach: f32,
    /// Of the surfel, world units; infinite where there is none.
    pub radius: f32,
    pub leaf: LeafId,
    /// Whether the ray is inside of the leaf behind it.
    pub enters: bool,
    /// The leaf's outward unit normal, view axes.
    pub normal: Vec3,
    pub colour: [f32; 3],
    pub opacity: f32,
    /// Whether the surface shows there: a half-space shows only within its square.
    pub is_drawn: bool,
}

/// How far apart in depth crossings of surfaces are that coincide, where a ray along `dir` meets one on a surfel of `radius`; the normal
/// is in view axes, and `dir` moves by one in depth.
pub(crate) fn reach(radius: f32, normal: Vec3, dir: Vec3) -> f32 {
    let along = normal.dot(dir).abs().max(LEAST_COSINE * dir.length());
    // Each of the two may be that far from the other.
    2.0 * TIED_SHARE * radius / along
}

/// The outward unit normal of `field`'s surface where it coincides at `p_in_world` with a surface whose unit normal there is
/// `normal_in_world`, facing either way, and whose surfel has `radius`; infinite where it has none.
pub(crate) fn coincident(
    field: &LeafField,
    p_in_world: DVec3,
    normal_in_world: DVec3,
    radius: f32,
    found: &mut Vec<(u32, f32)>,
) -> Option<DVec3> {
    let normal = field.surface_within(p_in_world, normal_in_world, (TIED_SHARE, radius), found)?;
    (normal.cross(normal_in_world).length() <= f64::from(MOST_SINE)).then_some(normal)
}

/// Calls `each` with the crossings of a ray that coincide, front to back; `all` come in any order.
pub(crate) fn clusters(all: &mut [Tied], mut each: impl FnMut(&[Tied])) {
    all.sort_by(|a, b| a.t.total_cmp(&b.t).then(a.leaf.cmp(&b.leaf)));
    let mut rest = &*all;
    while let Some(first) = rest.first() {
        let together = |other: &&Tied| {
            other.t - first.t <= first.reach.max(other.reach)
                && other.normal.cross(first.normal).length() <= 2.0 * MOST_SINE
        };
        // Those in between that lean otherwise are for themselves, in order.
        let count = rest.iter().take_while(together).count().max(1);
        each(&rest[..count]);
        rest = &rest[count..];
    }
}

/// Memberships of one point before and after the crossings that coincide there. Leaves are asked only when they matter, once.
struct Sides<'m> {
    model: &'m Model,
    members: &'m [Tied],
    p_in_world: DVec3,
    /// The first member's normal, and the ray's direction.
    normal_in_world: DVec3,
    dir_in_world: DVec3,
    asked: RefCell<Vec<(LeafId, [bool; 2])>>,
}

impl Sides<'_> {
    fn is_solid(&self, leaf: LeafId) -> bool {
        self.model.fields[leaf.0 as usize].kind == LeafKind::Solid
    }

    /// The side of `leaf`, before the crossings and after them.
    fn of(&self, leaf: LeafId) -> [bool; 2] {
        if !self.is_solid(leaf) {
            return [false; 2];
        }
        let mut own = self.members.iter().filter(|member| member.leaf == leaf);
        if let Some(first) = own.next() {
            // Two groups of surfels may have found one crossing.
            let last = own.next_back().unwrap_or(first);
            return [!first.enters, last.enters];
        }
        if let Some((_, known)) = self.asked.borrow().iter().find(|(other, _)| *other == leaf) {
            return *known;
        }
        let (field, mut found) = (&self.model.fields[leaf.0 as usize], Vec::new());
        let radius = self.members[0].radius;
        let sides = match coincident(field, self.p_in_world, self.normal_in_world, radius, &mut found) {
            Some(normal) => {
                let enters = normal.dot(self.dir_in_world) < 0.0;
                [!enters, enters]
            }
            None => [field.contains(self.p_in_world, &mut found); 2],
        };
        self.asked.borrow_mut().push((leaf, sides));
        sides
    }

    /// The leaves that were asked and have a crossing there too.
    fn toggled_along(&self) -> Vec<LeafId> {
        self.asked.borrow().iter().filter(|(_, [before, after])| before != after).map(|(leaf, _)| *leaf).collect()
    }

    /// The expression before the crossings or after them, where `turned` is on its other side.
    fn eval(&self, is_after: bool, turned: Option<LeafId>) -> bool {
        self.model.list.eval(|leaf| self.of(leaf)[usize::from(is_after)] != (turned == Some(leaf)))
    }
}

/// What the crossings `members` of the ray through `px`, which coincide, are together on the result; `None` where they are no
/// boundary. Depths are less `anchor`.
pub(crate) fn boundary(model: &Model, camera: &Camera, px: DVec2, anchor: f64, members: &[Tied]) -> Option<Hit> {
    let ray = camera.ray(px);
    let sides = Sides {
        model,
        members,
        p_in_world: ray.at(anchor + f64::from(members[0].t)),
        normal_in_world: camera.rotate_to_world(members[0].normal.as_dvec3()),
        dir_in_world: ray.dir,
        asked: RefCell::default(),
    };
    // Step 1: whose boundary it is.
    let [was, is] = [false, true].map(|is_after| sides.eval(is_after, None));
    let goes_with = |leaf: LeafId| sides.of(leaf)[1] == is;
    let owner = if was != is {
        let changes = |member: &&Tied| sides.of(member.leaf)[0] != sides.of(member.leaf)[1];
        let matters = |leaf: LeafId| sides.eval(false, Some(leaf)) == is || sides.eval(true, Some(leaf)) != is;
        let rank = |member: &&Tied| (!matters(member.leaf), !goes_with(member.leaf), member.leaf);
        let owner = members.iter().filter(changes).min_by_key(rank)?;
        if !matters(owner.leaf) && sides.toggled_along().into_iter().any(matters) {
            return None;
        }
        owner
    } else {
        // A sheet shows where the result would have it if it were a solid, and does not otherwise.
        let shows = |member: &&Tied| {
            let turned = Some(member.leaf);
            (!was && sides.eval(false, turned)) || (!is && sides.eval(true, turned))
        };
        members.iter().filter(|member| !sides.is_solid(member.leaf)).find(shows)?
    };
    if !owner.is_drawn {
        return None;
    }
    // Step 2: what it looks like. Material lies on the side that is in the result; a sheet has none, and shows its front.
    let enters_result = was == is || is;
    let body = if was == is || goes_with(owner.leaf) {
        None
    } else {
        body_at(model, owner.leaf, |leaf| sides.of(leaf)[usize::from(is)])
    };
    Some(Hit {
        t: owner.t,
        // The leaf's outward normal is the result's where both are entered, or both left.
        normal: if owner.enters == enters_result { owner.normal } else { -owner.normal },
        colour: owner.colour,
        opacity: owner.opacity,
        leaf: owner.leaf.0,
        body: body.unwrap_or(owner.leaf).0,
        facing: if enters_result { Facing::Front } else { Facing::Back },
    })
}
