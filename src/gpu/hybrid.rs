//! Scenes where every leaf keeps its own representation, on the GPU: the twin of [`crate::hybrid`].
//!
//! ```text
//! surfel leaves ─► splat::GpuSplatFrame ──────────────► GpuLayers
//!                       ▲ crossings of a band's rays
//! exact leaves ──► blister::GpuMeshFrame
//! ```
//!
//! *Practice.* As on the CPU neither pipeline knows the other, and the seam is [`crossings`](super::crossings). A solid whose
//! mesh is open is refused: where its crossings do not alternate its inside is a winding number, which the CPU takes in `f64`
//! ([`crate::hybrid::open`]).

use std::cell::Cell;
use std::rc::Rc;

use super::blister::{Classifier, GpuMeshFrame};
use super::splat::{GpuSplatError, GpuSplatFrame, GpuSplatModel};
use super::{Gpu, GpuError};
use crate::blister::MeshFrame;
use crate::csg::LeafId;
use crate::hybrid::HybridModel;
use crate::layers::LayerLimit;
use crate::space::Camera;

/// Why the GPU does not draw a scene of several representations.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum GpuHybridError {
    /// The inside of a solid is not what its crossings tell. Open sheets are drawn: nothing is inside of them.
    #[error("leaf {} is a solid whose mesh is open, and the GPU tells inside from outside by crossings alone", leaf.0)]
    OpenMesh {
        /// Which.
        leaf: LeafId,
    },
    /// The surfels.
    #[error(transparent)]
    Surfels(#[from] GpuSplatError),
    /// The device.
    #[error(transparent)]
    Gpu(#[from] GpuError),
}

/// A [`HybridModel`] on the GPU: what does not depend on the camera.
#[derive(Debug)]
pub struct GpuHybridModel {
    surfels: GpuSplatModel,
    /// How long the lists of fragments had to be.
    list_length: Rc<Cell<usize>>,
}

impl GpuHybridModel {
    /// Uploads `model` as it is now. Where its leaves move it has to be made anew: see [`is_of`](Self::is_of).
    ///
    /// # Errors
    /// [`GpuHybridError::OpenMesh`]; those of [`GpuSplatModel::new`].
    pub fn new(gpu: &Gpu, model: &HybridModel) -> Result<Self, GpuHybridError> {
        if let Some((leaf, _)) = model.undecided().first() {
            return Err(GpuHybridError::OpenMesh { leaf: *leaf });
        }
        Ok(Self { surfels: GpuSplatModel::new(gpu, model.surfels())?, list_length: Rc::default() })
    }

    /// Whether this is `model` as it is now.
    pub fn is_of(&self, model: &HybridModel) -> bool {
        self.surfels.is_of(model.surfels())
    }

    /// One frame of `model`, which this was made of, `samples` a pixel.
    ///
    /// # Errors
    /// Those of [`GpuSplatFrame::new`].
    pub fn frame<'a>(
        &'a self,
        model: &'a HybridModel,
        camera: &Camera,
        limit: LayerLimit,
        samples: u32,
    ) -> Result<GpuSplatFrame<'a>, GpuHybridError> {
        let surfels = model.surfels();
        let Some(exact) = model.exact() else {
            return Ok(GpuSplatFrame::new(surfels, &self.surfels, camera.clone(), limit, samples, None)?);
        };
        let meshes = MeshFrame::new(exact, camera.clone(), LayerLimit::All, samples);
        let meshes = GpuMeshFrame::new(meshes, Classifier::List).with_length(Rc::clone(&self.list_length));
        Ok(GpuSplatFrame::crossed(surfels, &self.surfels, camera.clone(), limit, samples, Box::new(meshes))?)
    }
}
