//! Scenes where every leaf keeps its own representation: scans as surfels, meshes as triangles, solids as formulas.
//!
//! ```text
//! surfel leaves ─► splat::Frame ──────────────► the result's boundaries, one LayerStack
//!                       ▲ crossings of a tile's rays
//! exact leaves ──► blister::MeshFrame ─► open::Decided
//! ```
//!
//! *Theory.* DESIGN §3.8, *Hybrid scenes*: a surfel's hit asks a mesh leaf by the parity of its ray's crossings, a mesh's crossing
//! asks a surfel leaf by its field. One expression decides over both.
//!
//! *Practice.* Neither pipeline knows the other: the seam is [`CrossingSource`](crate::crossings::CrossingSource), plain data. The surfel
//! pipeline draws, since what it cannot settle at once is what takes its care; the mesh pipeline finds the crossings of a tile's rays,
//! which are cheap to have (20 ns each) and exact. An exact leaf then needs no surfels at all, and no hit of it can be missed.

pub mod open;

use crate::blister::{MeshFrame, MeshLeaf, MeshModel, MeshModelError};
use crate::classify::Model;
use crate::csg::{LeafId, Tree};
use crate::layers::LayerLimit;
use crate::space::{Camera, Motion};
use crate::splat::{Frame, SplatSettings};
use open::{Decided, Undecided};

/// A scene ready to be drawn from any camera, every leaf in its own form.
#[derive(Debug)]
pub struct HybridModel {
    surfels: Model,
    /// The leaves that have no surfels.
    exact: Option<MeshModel>,
    /// Those leaves where the scene has them, so that they can move.
    at_rest: Vec<MeshLeaf>,
    undecided: Undecided,
}

/// The leaves that are found by their own form, ready to be asked for their crossings; `None` without any.
///
/// # Errors
/// As [`MeshModel::new`].
pub fn exact_model(leaves: &[MeshLeaf]) -> Result<Option<MeshModel>, MeshModelError> {
    let ids: Vec<LeafId> = leaves.iter().map(|leaf| leaf.leaf).collect();
    any_of(&ids).map(|tree| MeshModel::new(leaves, &tree)).transpose()
}

/// What the leaves mean is decided where they meet the surfels: here any expression does that names them all.
fn any_of(leaves: &[LeafId]) -> Option<Tree> {
    leaves.iter().map(|leaf| Tree::leaf(*leaf)).reduce(Tree::or)
}

impl HybridModel {
    /// `surfels` knows all leaves; those of `exact` are exact in it and have no surfels.
    pub fn new(surfels: Model, exact: Option<MeshModel>) -> Self {
        let open = exact.iter().flat_map(MeshModel::open_leaves).collect();
        Self { surfels, exact, at_rest: Vec::new(), undecided: Undecided::new(open) }
    }

    /// The same, with the exact leaves as they were when the model was made of them, so that [`pose`](Self::pose) can move
    /// them.
    pub fn with_leaves_at_rest(self, at_rest: Vec<MeshLeaf>) -> Self {
        Self { at_rest, ..self }
    }

    /// Brings the leaves to the pose `motions`, each from where the model was made with it; leaves without a motion go back
    /// there.
    ///
    /// # Errors
    /// As [`MeshModel::new`].
    pub fn pose(&mut self, motions: &[(LeafId, Motion)]) -> Result<(), MeshModelError> {
        self.surfels.pose(motions);
        let mut leaves = self.at_rest.clone();
        for leaf in &mut leaves {
            if let Some((_, motion)) = motions.iter().find(|(other, _)| *other == leaf.leaf) {
                leaf.world_from_leaf = motion.affine() * leaf.world_from_leaf;
            }
        }
        if !leaves.is_empty() {
            self.exact = exact_model(&leaves)?;
        }
        Ok(())
    }

    /// The same leaves, as they are now, under another expression over some of them.
    pub fn with_tree(&self, tree: &Tree) -> Self {
        let mut named = tree.leaves();
        named.retain(|leaf| self.at_rest.iter().any(|exact| exact.leaf == *leaf));
        let exact = self.exact.as_ref().zip(any_of(&named)).and_then(|(exact, tree)| exact.with_tree(&tree));
        Self::new(self.surfels.with_tree(tree), exact)
    }

    /// The classified scene.
    pub fn surfels(&self) -> &Model {
        &self.surfels
    }

    /// The leaves that have no surfels.
    pub fn exact(&self) -> Option<&MeshModel> {
        self.exact.as_ref()
    }

    /// The solid leaves whose mesh is open, each with the pixels of all [`frame`](Self::frame)s so far at which its crossings did not
    /// tell its inside.
    pub fn undecided(&self) -> Vec<(LeafId, u64)> {
        self.undecided.counts()
    }

    /// One frame, `samples` a pixel.
    pub fn frame(&self, camera: &Camera, limit: LayerLimit, samples: u32) -> Frame<'_> {
        self.frame_of(camera, limit, samples, true)
    }

    /// The same frame of a view that nobody is shown, such as the light's: its pixels are not [`undecided`](Self::undecided) ones.
    pub fn frame_aside(&self, camera: &Camera, limit: LayerLimit, samples: u32) -> Frame<'_> {
        self.frame_of(camera, limit, samples, false)
    }

    fn frame_of(&self, camera: &Camera, limit: LayerLimit, samples: u32, is_counted: bool) -> Frame<'_> {
        let frame = Frame::new(&self.surfels, camera.clone(), limit, samples, SplatSettings::default(), None);
        let Some(exact) = &self.exact else { return frame };
        let meshes = MeshFrame::new(exact, camera.clone(), LayerLimit::All, samples);
        if self.undecided.is_empty() {
            return frame.with_crossings(Box::new(meshes));
        }
        let decided = Decided::new(meshes, &self.surfels, camera, &self.undecided);
        frame.with_crossings(Box::new(if is_counted { decided } else { decided.uncounted() }))
    }
}

#[cfg(test)]
mod tests;
