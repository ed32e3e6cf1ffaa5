//! One frame of the surfel pipeline on the GPU: a rectangle's boundaries on demand.

use super::bins::Bins;
use super::clip::GpuClipping;
use super::fragment;
use super::model::GpuSplatModel;
use super::project::{ChunkView, Chunks, SplatView, SurfelView};
use super::shaders;
use super::trace::{Room, Scene, Way, grid};
use crate::classify::Model;
use crate::gpu::{Gpu, GpuError, GpuLayerSource, GpuLayers};
use crate::layers::LayerLimit;
use crate::space::{Camera, PixelRect};
use crate::splat::bins::BLOCK;
use crate::splat::frame::margin_px;
use crate::splat::project::View;
use crate::splat::{Clip, SplatSettings};

/// Groups and hits that a frame has room for at first: what a quarter of a million pixels with four surfaces each take.
const FIRST_ROOM: u32 = 1 << 20;

/// A frame of a classified scene: the twin of [`crate::splat::Frame`].
#[derive(Debug)]
pub struct GpuSplatFrame<'a> {
    model: &'a GpuSplatModel,
    clipping: Option<&'a GpuClipping>,
    camera: Camera,
    limit: LayerLimit,
    samples: u32,
    chunks: Chunks,
    room: Room,
}

impl<'a> GpuSplatFrame<'a> {
    /// Of `scene`, which was uploaded as `model`, for `camera`, drawn with the settings of `clipping`, or without it with those that
    /// ask for no partners: surfaces, clipped on the curved field.
    pub fn new(
        scene: &Model,
        model: &'a GpuSplatModel,
        camera: Camera,
        limit: LayerLimit,
        samples: u32,
        clipping: Option<&'a GpuClipping>,
    ) -> Self {
        let view = View::new(camera);
        let chunks = Chunks::new(scene, &model.parts, &view);
        Self { model, clipping, camera: view.camera, limit, samples, chunks, room: Room::new(FIRST_ROOM) }
    }

    /// What it is drawn with.
    fn settings(&self) -> SplatSettings {
        self.clipping.map_or(SplatSettings::default(), GpuClipping::settings)
    }

    /// The same with room for `count` groups and hits at first. It grows where that does not do.
    #[must_use]
    pub fn with_room(mut self, count: u32) -> Self {
        self.room = Room::new(count);
        self
    }

    /// The chunks that may touch `rect`, projected.
    fn project(&self, gpu: &Gpu, of: &mut SplatView, rect: PixelRect) -> Result<Option<wgpu::Buffer>, GpuError> {
        let (parts, count) = self.chunks.within(rect, of.margin_px);
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
        of.margin_px = margin_px(self.settings());
        if let Some(clipping) = self.clipping {
            of.inside = clipping.inside();
            of.disks = clipping.disks;
            of.clip = clipping.clip;
        }
        // A block's surfels are the same whatever part of it is drawn.
        let [x, y, across, down] = grid.map(|blocks| blocks * BLOCK);
        let blocks = PixelRect { x0: x, y0: y, x1: x + across, y1: y + down };
        let Some(views) = self.project(gpu, &mut of, blocks)? else {
            return GpuLayers::upload(gpu, &crate::layers::LayerTile::empty(rect));
        };
        let bins = Bins::new(gpu, &of, &views)?;
        let leaf_words = self.model.leaf_words;
        let (mut far, mut tables) = (&self.model.far, &self.model.tables);
        let mut footprints = None;
        if let Some(clipping) = self.clipping {
            (far, tables) = (&clipping.rows, &clipping.words);
            if clipping.settings().clip == Clip::Fragment {
                footprints = Some(fragment::footprints(gpu, &of, &views, (leaf_words, clipping.stack_words))?);
            }
        }
        let way = match (&footprints, self.clipping) {
            (Some(footprints), Some(clipping)) => Way::Fragments { footprints, stack_words: clipping.stack_words },
            _ => Way::Surfaces,
        };
        let scene = Scene { views: &views, bins: &bins, far, tables, leaf_words, way };
        scene.trace(gpu, &of, rect, self.samples, &self.room)
    }
}
