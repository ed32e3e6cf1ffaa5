//! One frame of the surfel pipeline on the GPU: a rectangle's boundaries on demand.

use super::bins::Bins;
use super::model::{GpuSplatError, GpuSplatModel};
use super::project::{ChunkView, Chunks, SplatView, SurfelView};
use super::shaders;
use super::trace::{Room, Scene, grid};
use crate::classify::Model;
use crate::csg::LeafId;
use crate::gpu::crossings::GpuCrossingSource;
use crate::gpu::{Gpu, GpuError, GpuLayerSource, GpuLayers};
use crate::layers::LayerLimit;
use crate::space::{Camera, PixelRect};
use crate::splat::bins::BLOCK;
use crate::splat::project::View;
use crate::splat::{Clip, SplatSettings};

/// A frame of a classified scene: the twin of [`crate::splat::Frame`] where surfaces are clipped.
#[derive(Debug)]
pub struct GpuSplatFrame<'a> {
    model: &'a GpuSplatModel,
    camera: Camera,
    limit: LayerLimit,
    samples: u32,
    chunks: Chunks,
    /// In place of the model's.
    room: Option<Room>,
    /// Finds the leaves that have no surfels.
    source: Option<Box<dyn GpuCrossingSource + 'a>>,
}

impl<'a> GpuSplatFrame<'a> {
    /// Of `scene`, which was uploaded as `model`, for `camera`.
    ///
    /// # Errors
    /// [`GpuSplatError::Settings`]; [`GpuSplatError::ExactLeaf`] where a leaf has no surfels: see [`crossed`](Self::crossed).
    pub fn new(
        scene: &Model,
        model: &'a GpuSplatModel,
        camera: Camera,
        limit: LayerLimit,
        samples: u32,
        settings: SplatSettings,
    ) -> Result<Self, GpuSplatError> {
        Self::allow(settings)?;
        match model.exact {
            Some(leaf) => Err(GpuSplatError::ExactLeaf { leaf }),
            None => Ok(Self::of(scene, model, camera, limit, samples, None)),
        }
    }

    /// Whether surfels are clipped as the GPU does it.
    ///
    /// # Errors
    /// [`GpuSplatError::Settings`] where not.
    pub fn allow(settings: SplatSettings) -> Result<(), GpuSplatError> {
        if settings.clip != Clip::Surface || settings.partners_among().is_some() {
            return Err(GpuSplatError::Settings);
        }
        Ok(())
    }

    /// The same with leaves that `source` finds, which must be exact, without surfels, in `scene`; it draws frames of `camera` with as many
    /// samples. Surfaces are clipped on the field.
    ///
    /// # Errors
    /// [`GpuSplatError::ExactLeaf`] for a leaf without surfels that `source` does not find.
    pub fn crossed(
        scene: &Model,
        model: &'a GpuSplatModel,
        camera: Camera,
        limit: LayerLimit,
        samples: u32,
        source: Box<dyn GpuCrossingSource + 'a>,
    ) -> Result<Self, GpuSplatError> {
        let found = source.leaves();
        let is_missing = |leaf: &LeafId| scene.fields[leaf.0 as usize].exact.is_some() && !found.contains(leaf);
        match scene.tree.leaves().into_iter().find(is_missing) {
            Some(leaf) => Err(GpuSplatError::ExactLeaf { leaf }),
            None => Ok(Self::of(scene, model, camera, limit, samples, Some(source))),
        }
    }

    fn of(
        scene: &Model,
        model: &'a GpuSplatModel,
        camera: Camera,
        limit: LayerLimit,
        samples: u32,
        source: Option<Box<dyn GpuCrossingSource + 'a>>,
    ) -> Self {
        let view = View::new(camera);
        let chunks = Chunks::new(scene, &model.parts, &view);
        Self { model, camera: view.camera, limit, samples, chunks, room: None, source }
    }

    /// The same with room for `count` groups and hits at first, in place of what the frames before took. It grows where that does not do.
    #[must_use]
    pub fn with_room(mut self, count: u32) -> Self {
        self.room = Some(Room::new(count));
        self
    }

    /// The chunks that may touch `rect`, projected.
    fn project(&self, gpu: &Gpu, of: &mut SplatView, rect: PixelRect) -> Result<Option<wgpu::Buffer>, GpuError> {
        let (parts, count) = self.chunks.within(rect);
        if count == 0 {
            return Ok(None);
        }
        of.views = count;
        let views = gpu.storage::<SurfelView>("views of surfels", count as usize)?;
        let kernel = gpu.kernel(&shaders::project(), "project");
        let mut commands = gpu.commands();
        for (part, chunks) in self.model.parts.iter().zip(&parts) {
            let uniform = gpu.uniform("splat view", &SplatView { has_supports: part.supports.is_some().into(), ..*of });
            let uploaded = gpu.upload::<ChunkView>("chunks", chunks)?;
            let supports = part.supports.as_ref().unwrap_or(&part.surfels);
            let buffers = [(0, &uniform), (1, &uploaded), (2, &part.surfels), (3, supports), (4, &views)];
            commands.dispatch_groups(&kernel, &gpu.bind(&kernel, &buffers), chunks.len());
        }
        commands.submit();
        Ok(Some(views))
    }
}

impl GpuLayerSource for GpuSplatFrame<'_> {
    fn camera(&self) -> &Camera {
        &self.camera
    }

    fn samples(&self) -> u32 {
        self.samples
    }

    fn draw(&self, gpu: &Gpu, rect: PixelRect) -> Result<GpuLayers, GpuError> {
        let grid = grid(rect);
        let mut of = SplatView::new(&self.camera, rect, grid, self.model.origin);
        of.nearest_only = (self.limit == LayerLimit::Nearest).into();
        of.leaves = self.model.leaves as u32;
        // A block's surfels are the same whatever part of it is drawn.
        let [x, y, across, down] = grid.map(|blocks| blocks * BLOCK);
        let blocks = PixelRect { x0: x, y0: y, x1: x + across, y1: y + down };
        let views = match (self.project(gpu, &mut of, blocks)?, &self.source) {
            (Some(views), _) => views,
            (None, Some(_)) => gpu.storage::<SurfelView>("no views", 0)?,
            (None, None) => return GpuLayers::upload(gpu, &crate::layers::LayerTile::empty(rect)),
        };
        let bins = Bins::new(gpu, &of, &views)?;
        let scene = Scene {
            views: &views,
            bins: &bins,
            far: &self.model.far,
            tables: &self.model.tables,
            leaf_words: self.model.leaf_words,
            source: self.source.as_deref(),
        };
        scene.trace(gpu, &of, rect, self.samples, self.room.as_ref().unwrap_or(&self.model.room))
    }
}
