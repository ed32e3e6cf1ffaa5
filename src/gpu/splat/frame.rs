//! One frame of the surfel pipeline on the GPU: a rectangle's boundaries on demand.

use std::sync::OnceLock;

use super::bins::Bins;
use super::clip::GpuClipping;
use super::clip_buffer::{ClipBuffer, Part};
use super::fragment;
use super::model::{GpuSplatError, GpuSplatModel};
use super::project::{ChunkView, Chunks, SplatView, SurfelView};
use super::shaders;
use super::trace::{Room, Scene, Way, grid};
use crate::classify::Model;
use crate::csg::LeafId;
use crate::gpu::crossings::GpuCrossingSource;
use crate::gpu::{Gpu, GpuError, GpuLayerSource, GpuLayers};
use crate::layers::LayerLimit;
use crate::space::{Camera, PixelRect};
use crate::splat::bins::BLOCK;
use crate::splat::frame::margin_px;
use crate::splat::project::View;
use crate::splat::{Clip, Partners, SplatSettings};

/// A frame of a classified scene: the twin of [`crate::splat::Frame`].
#[derive(Debug)]
pub struct GpuSplatFrame<'a> {
    model: &'a GpuSplatModel,
    clipping: Option<&'a GpuClipping>,
    camera: Camera,
    limit: LayerLimit,
    samples: u32,
    chunks: Chunks,
    /// In place of the model's.
    room: Option<Room>,
    /// The words of the clipping with the partners that meet in the picture, once they are found.
    found: OnceLock<wgpu::Buffer>,
    /// Finds the leaves that have no surfels.
    source: Option<Box<dyn GpuCrossingSource + 'a>>,
}

impl<'a> GpuSplatFrame<'a> {
    /// Of `scene`, which was uploaded as `model`, for `camera`, drawn with the settings of `clipping`, or without it with those that
    /// ask for no partners: surfaces, clipped on the curved field.
    ///
    /// # Errors
    /// [`GpuSplatError::ExactLeaf`] where a leaf has no surfels: see [`crossed`](Self::crossed).
    pub fn new(
        scene: &Model,
        model: &'a GpuSplatModel,
        camera: Camera,
        limit: LayerLimit,
        samples: u32,
        clipping: Option<&'a GpuClipping>,
    ) -> Result<Self, GpuSplatError> {
        match model.exact {
            Some(leaf) => Err(GpuSplatError::ExactLeaf { leaf }),
            None => Ok(Self { clipping, ..Self::of(scene, model, camera, limit, samples, None) }),
        }
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
        Self {
            model,
            clipping: None,
            camera: view.camera,
            limit,
            samples,
            chunks,
            room: None,
            found: OnceLock::new(),
            source,
        }
    }

    /// What it is drawn with.
    fn settings(&self) -> SplatSettings {
        self.clipping.map_or(SplatSettings::default(), GpuClipping::settings)
    }

    /// The same with room for `count` groups and hits at first, in place of what the frames before took. It grows where that does not do.
    #[must_use]
    pub fn with_room(mut self, count: u32) -> Self {
        self.room = Some(Room::new(count));
        self
    }

    /// What kernels know of the camera and of `rect`.
    fn view_of(&self, rect: PixelRect) -> SplatView {
        let mut of = SplatView::new(&self.camera, rect, grid(rect), self.model.origin);
        of.nearest_only = (self.limit == LayerLimit::Nearest).into();
        of.leaves = self.model.leaves as u32;
        of.margin_px = margin_px(self.settings());
        if let Some(clipping) = self.clipping {
            of.inside = clipping.inside();
            of.disks = clipping.disks;
            of.clip = clipping.clip;
        }
        of
    }

    /// The words that clipping asks, with the lists of partners: for those that meet in the picture, found once a frame.
    fn words<'f>(&'f self, gpu: &Gpu, clipping: &'f GpuClipping) -> Result<&'f wgpu::Buffer, GpuError> {
        if clipping.settings().partners == Partners::ObjectSpace {
            return Ok(&clipping.words);
        }
        if let Some(found) = self.found.get() {
            return Ok(found);
        }
        let (leaf_words, stack_words) = (self.model.leaf_words, clipping.stack_words);
        let part = |rect| {
            let mut view = self.view_of(rect);
            let Some(views) = self.project(gpu, &mut view)? else { return Ok(None) };
            let footprints = fragment::footprints(gpu, &view, &views, (leaf_words, stack_words))?;
            Ok(Some(Part { view, views, footprints }))
        };
        let buffer =
            ClipBuffer { far: &clipping.rows, tables: &clipping.words, leaf_words, stack_words, disks: clipping.count };
        let picture = PixelRect { x0: 0, y0: 0, x1: self.camera.width, y1: self.camera.height };
        let words = buffer.partners(gpu, picture, &part)?;
        Ok(self.found.get_or_init(|| words))
    }

    /// The chunks that may touch what `of` tells of, projected.
    fn project(&self, gpu: &Gpu, of: &mut SplatView) -> Result<Option<wgpu::Buffer>, GpuError> {
        // A block's surfels are the same whatever part of it is drawn.
        let [x, y, across, down] = of.grid.map(|blocks| blocks * BLOCK);
        let blocks = PixelRect { x0: x, y0: y, x1: x + across, y1: y + down };
        let (parts, count) = self.chunks.within(blocks, of.margin_px);
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
        let mut of = self.view_of(rect);
        let views = match (self.project(gpu, &mut of)?, &self.source) {
            (Some(views), _) => views,
            (None, Some(_)) => gpu.storage::<SurfelView>("no views", 0)?,
            (None, None) => return GpuLayers::upload(gpu, &crate::layers::LayerTile::empty(rect)),
        };
        let bins = Bins::new(gpu, &of, &views)?;
        let leaf_words = self.model.leaf_words;
        let mut scene = Scene {
            views: &views,
            bins: &bins,
            far: &self.model.far,
            tables: &self.model.tables,
            leaf_words,
            takes_turns: self.model.takes_turns,
            way: Way::Fields { source: self.source.as_deref(), list_words: self.model.list_words },
        };
        let room = self.room.as_ref().unwrap_or(&self.model.room);
        let Some(clipping) = self.clipping else { return scene.trace(gpu, &of, rect, self.samples, room) };
        let stack_words = clipping.stack_words;
        (scene.far, scene.tables) = (&clipping.rows, self.words(gpu, clipping)?);
        let footprints;
        scene.way = match clipping.settings().clip {
            Clip::Surface => Way::Surfaces { stack_words },
            Clip::Fragment => {
                footprints = fragment::footprints(gpu, &of, &views, (leaf_words, stack_words))?;
                Way::Fragments { footprints: &footprints, stack_words }
            }
        };
        scene.trace(gpu, &of, rect, self.samples, room)
    }
}
