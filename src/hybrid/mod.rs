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

use crate::blister::{MeshFrame, MeshModel};
use crate::classify::Model;
use crate::csg::LeafId;
use crate::layers::LayerLimit;
use crate::space::Camera;
use crate::splat::{Frame, SplatSettings};
use open::{Decided, Undecided};

/// A scene ready to be drawn from any camera, every leaf in its own form.
#[derive(Debug)]
pub struct HybridModel {
    surfels: Model,
    /// The leaves that have no surfels.
    exact: Option<MeshModel>,
    undecided: Undecided,
}

impl HybridModel {
    /// `surfels` knows all leaves; those of `exact` are exact in it and have no surfels.
    pub fn new(surfels: Model, exact: Option<MeshModel>) -> Self {
        let open = exact.iter().flat_map(MeshModel::open_leaves).collect();
        Self { surfels, exact, undecided: Undecided::new(open) }
    }

    /// The classified scene.
    pub fn surfels(&self) -> &Model {
        &self.surfels
    }

    /// The leaves that have no surfels.
    pub fn exact(&self) -> Option<&MeshModel> {
        self.exact.as_ref()
    }

    /// The solid leaves whose mesh is open, each with the pixels drawn so far at which its crossings did not tell its inside.
    pub fn undecided(&self) -> Vec<(LeafId, u64)> {
        self.undecided.counts()
    }

    /// One frame, `samples` a pixel.
    pub fn frame(&self, camera: &Camera, limit: LayerLimit, samples: u32) -> Frame<'_> {
        let frame = Frame::new(&self.surfels, camera.clone(), limit, samples, SplatSettings::default(), None);
        let Some(exact) = &self.exact else { return frame };
        let meshes = MeshFrame::new(exact, camera.clone(), LayerLimit::All, samples);
        if self.undecided.is_empty() {
            return frame.with_crossings(Box::new(meshes));
        }
        frame.with_crossings(Box::new(Decided::new(meshes, &self.surfels, camera, &self.undecided)))
    }
}

#[cfg(test)]
mod tests;
