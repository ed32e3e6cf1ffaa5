//! What tells the side of a point that no surfel reaches: winding numbers, or the nearest surfel's plane.
//!
//! *Practice.* The trees are those of the CPU ([`crate::geometry::winding`], [`crate::surfel::ball_tree`]), in `f32` about one
//! origin of the scene: a point that no surfel reaches is at least about a surfel's radius away from the surface. Where no surfel of
//! one leaf comes near to another leaf nobody is ever asked. Elsewhere all may be: where surfaces of two leaves coincide the whole
//! expression is, and leaves that crossings tell of cross anywhere.

use glam::{DVec3, Vec3};

use crate::classify::pairs::PairStatus;
use crate::classify::{LeafField, Model};
use crate::csg::LeafId;
use crate::geometry::winding;
use crate::scene::LeafKind;
use crate::surfel::ball_tree;

// A run of surfels is one leaf of either tree.
const _: () = assert!(winding::LEAF == ball_tree::RUN);

/// Rows of four numbers that a node of a winding tree takes: centre and radius, area times normal.
pub(super) const ROWS_A_CLUSTER: u32 = 2;

/// Rows that an element takes: its place, and area times normal.
pub(super) const ROWS_AN_ELEMENT: u32 = 2;

/// How a leaf's far sides are told.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct FarLeaf {
    pub way: Way,
    /// The first row of its tree.
    pub nodes: u32,
    /// Runs of elements; the tree's nodes from this number on are runs.
    pub runs: u32,
    /// The first row of its elements.
    pub elements: u32,
    /// How many it has.
    pub count: u32,
    /// Winding numbers above are inside.
    pub threshold: f32,
}

/// What tells far sides.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[repr(u32)]
pub(super) enum Way {
    /// Nothing: all points are outside.
    #[default]
    Outside = 0,
    /// The winding number.
    Winding = 1,
    /// The nearest surfel's plane.
    Plane = 2,
}

/// All leaves' trees and elements.
#[derive(Debug, Default)]
pub(super) struct Far {
    pub rows: Vec<[f32; 4]>,
    /// By leaf.
    pub leaves: Vec<FarLeaf>,
}

impl Far {
    /// Of `model`, about `origin`, world space.
    pub fn of(model: &Model, origin: DVec3) -> Self {
        let mut far = Self::default();
        let leaves = || (0..model.fields.len() as u32).map(LeafId);
        let has_crossed = model.fields.iter().any(|field| field.exact.is_some());
        let may_ask = |leaf, other| !matches!(model.pair(leaf, other), None | Some(PairStatus::Whole(_)));
        let any_asked = has_crossed || leaves().any(|leaf| leaves().any(|other| may_ask(leaf, other)));
        for leaf in leaves() {
            // A leaf that takes turns is asked for its own side, whoever else is there.
            let field = &model.fields[leaf.0 as usize];
            let of_leaf = match any_asked || field.takes_turns() {
                true => far.push(field, origin),
                false => FarLeaf::default(),
            };
            far.leaves.push(of_leaf);
        }
        far
    }

    fn push(&mut self, field: &LeafField, origin: DVec3) -> FarLeaf {
        let cloud = &field.cloud;
        if field.kind == LeafKind::Sheet || cloud.is_empty() {
            return FarLeaf::default();
        }
        let nodes = self.rows.len() as u32;
        let row = |v: Vec3, last: f32| [v.x, v.y, v.z, last];
        if let Some((winding, threshold)) = field.winding() {
            let (elements, clusters) = winding.parts();
            for cluster in clusters {
                self.rows.push(row((cluster.centre - origin).as_vec3(), cluster.radius as f32));
                self.rows.push(row(cluster.area_normal.as_vec3(), 0.0));
            }
            let first = self.rows.len() as u32;
            for element in elements {
                self.rows.push(row((element.position - origin).as_vec3(), 0.0));
                self.rows.push(row(element.area_normal.as_vec3(), 0.0));
            }
            return FarLeaf {
                way: Way::Winding,
                nodes,
                runs: clusters.len() as u32 / 2,
                elements: first,
                count: elements.len() as u32,
                threshold: threshold as f32,
            };
        }
        let (own_origin, balls) = field.ball_tree().balls();
        let runs = balls.len() as u32 / 2;
        let shift = (own_origin - origin).as_vec3();
        self.rows.extend(balls.map(|(centre, radius)| row(centre + shift, radius)));
        let elements = self.rows.len() as u32;
        for (index, surfel) in cloud.surfels.iter().enumerate() {
            self.rows.push(row((cloud.centre(index) - origin).as_vec3(), 0.0));
            self.rows.push(row(surfel.normal, 0.0));
        }
        FarLeaf { way: Way::Plane, nodes, runs, elements, count: cloud.len() as u32, threshold: 0.0 }
    }
}
