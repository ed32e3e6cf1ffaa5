//! One frame of the mesh pipeline on the GPU: a [`GpuLayerSource`].

use std::cell::{Cell, RefCell};
use std::rc::Rc;

use super::arrangement::Uploaded;
use super::{list, peel, tiles};
use crate::blister::frame::MeshFrame;
use crate::gpu::layers::{GpuLayerSource, GpuLayers};
use crate::gpu::{Gpu, GpuError};
use crate::layers::LayerTile;
use crate::space::{Camera, PixelRect};

/// How what is drawn is classified.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Classifier {
    /// In compute, tile by tile of triangles, without fragments.
    Tiles,
    /// One pass into lists of fragments, resolved in compute.
    #[default]
    List,
    /// Peeling; every leaf's membership is carried from layer to layer.
    Running,
    /// Peeling; at every layer every leaf's parity is tested anew, as in the paper.
    Parity,
}

impl Classifier {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Tiles, Self::List, Self::Running, Self::Parity];

    /// As charts name it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Tiles => "tiles",
            Self::List => "list",
            Self::Running => "running",
            Self::Parity => "parity",
        }
    }
}

/// What peeling took, over all bands drawn.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Peeling {
    /// Passes over the geometry, that for the superset's bounds not counted.
    pub passes: u64,
    /// Pixels that a pass left alone since they were settled, summed over passes.
    pub rejected: u64,
    /// Layers that needed no test, since they end a product, summed over pixels.
    pub untested: u64,
}

/// One sample of a frame, uploaded; `None` where nothing is to be drawn.
#[derive(Debug, Clone)]
pub struct Sample(pub(super) Option<Rc<Uploaded>>);

/// What was uploaded, and for which part of the picture; `None` where it serves for all parts.
type UploadedFor = (Option<PixelRect>, Sample);

/// A frame of the mesh pipeline, drawn by the GPU.
#[derive(Debug)]
pub struct GpuMeshFrame<'a> {
    pub(super) frame: MeshFrame<'a>,
    /// By sample: what was uploaded last.
    uploaded: RefCell<Vec<Option<UploadedFor>>>,
    classifier: Classifier,
    /// Whether peeling keeps within the superset.
    pub(super) is_bounded: bool,
    /// Whether parity is not counted where a product's inside tells it.
    pub(super) is_short: bool,
    /// How long the next band's list is made at first: what a list that was too short had to hold, and an eighth; 0 while none was.
    pub(super) length: Rc<Cell<usize>>,
    pub(super) peeling: Cell<Peeling>,
}

impl<'a> GpuMeshFrame<'a> {
    /// Of `frame`, to be classified as `classifier` says.
    pub fn new(frame: MeshFrame<'a>, classifier: Classifier) -> Self {
        let uploaded = RefCell::new(vec![None; frame.sample_count() as usize]);
        let (length, peeling) = Default::default();
        Self { frame, uploaded, classifier, is_bounded: true, is_short: true, length, peeling }
    }

    /// One of the samples, uploaded to draw `rect`.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`] where it fits no buffer: fragments that are none of triangles do for a smaller rectangle.
    pub fn upload(&self, gpu: &Gpu, rect: PixelRect, sample: usize) -> Result<Sample, GpuError> {
        let mut uploaded = self.uploaded.borrow_mut();
        if let Some((of, uploaded)) = &uploaded[sample]
            && of.is_none_or(|of| of == rect)
        {
            return Ok(uploaded.clone());
        }
        let has_tiles = self.classifier == Classifier::Tiles;
        let new = Sample(Uploaded::new(gpu, &self.frame, sample, rect, has_tiles)?.map(Rc::new));
        uploaded[sample] = Some(((!self.frame.is_all_on_grid()).then_some(rect), new.clone()));
        Ok(new)
    }

    /// Whether peeling keeps within a superset of the result: it does unless this says otherwise.
    #[must_use]
    pub fn bounded(self, is_bounded: bool) -> Self {
        Self { is_bounded, ..self }
    }

    /// Whether the parity way leaves out the test of layers that end a single product: it does unless this says otherwise.
    #[must_use]
    pub fn short(self, is_short: bool) -> Self {
        Self { is_short, ..self }
    }

    /// Whether peeling keeps within a superset of the result.
    pub fn is_bounded(&self) -> bool {
        self.is_bounded
    }

    /// As drawn with lists that have room for `length` fragments, or boundaries, at first.
    #[must_use]
    pub fn with_first_length(self, length: usize) -> Self {
        self.length.set(length);
        self
    }

    /// As [`with_first_length`](Self::with_first_length) with what the frames before needed, which share `length`: a list that was too
    /// short is not begun too short again.
    #[must_use]
    pub fn with_length(self, length: Rc<Cell<usize>>) -> Self {
        Self { length, ..self }
    }

    /// What peeling took so far.
    pub fn peeling(&self) -> Peeling {
        self.peeling.get()
    }

    fn draw_sample(&self, gpu: &Gpu, uploaded: &Uploaded, rect: PixelRect) -> Result<GpuLayers, GpuError> {
        match self.classifier {
            Classifier::Tiles => tiles::draw(gpu, self, uploaded, rect),
            Classifier::List => list::draw(gpu, self, uploaded, rect),
            Classifier::Running | Classifier::Parity => {
                peel::draw(gpu, self, uploaded, rect, self.classifier == Classifier::Parity)
            }
        }
    }
}

impl GpuLayerSource for GpuMeshFrame<'_> {
    fn camera(&self) -> &Camera {
        self.frame.camera_of()
    }

    fn samples(&self) -> u32 {
        self.frame.sample_count()
    }

    fn draw(&self, gpu: &Gpu, rect: PixelRect) -> Result<GpuLayers, GpuError> {
        let draw = |sample: usize| match self.upload(gpu, rect, sample)? {
            Sample(Some(uploaded)) => self.draw_sample(gpu, &uploaded, rect),
            Sample(None) => GpuLayers::upload(gpu, &LayerTile::empty(rect)),
        };
        if self.samples() == 1 {
            return draw(0);
        }
        let mut passes = Vec::new();
        for sample in 0..self.samples() as usize {
            passes.push(draw(sample)?.download(gpu)?);
        }
        GpuLayers::upload(gpu, &LayerTile::of_samples(rect, &passes))
    }
}

/// Draws with room for ever more, until there is enough: `attempt` gets the room, and returns what it would have needed, and what it
/// drew where that was no more. `size` is the bytes of each.
///
/// # Errors
/// Those of `attempt`; [`GpuError::TooLarge`] where one buffer cannot have enough room.
pub(super) fn with_room<T>(
    gpu: &Gpu,
    length: &Cell<usize>,
    (what, size): (&str, usize),
    first: usize,
    mut attempt: impl FnMut(usize) -> Result<(usize, Option<T>), GpuError>,
) -> Result<T, GpuError> {
    let most = (gpu.largest_binding() as usize / size).max(1);
    let mut room = if length.get() == 0 { with_spare(first) } else { length.get() }.clamp(1, most);
    loop {
        let (needed, drawn) = attempt(room)?;
        if let Some(drawn) = drawn {
            return Ok(drawn);
        }
        if needed > most {
            let needed = needed as u64 * size as u64;
            return Err(GpuError::TooLarge { what: format!("bytes of {what}"), needed, limit: gpu.largest_binding() });
        }
        room = with_spare(needed).min(most);
        length.set(room);
    }
}

/// `count`, and somewhat more: the next frame of a camera that turns, or of a scene that moves, may need more than this one.
fn with_spare(count: usize) -> usize {
    /// As a share of the count, one part of so many.
    const SPARE: usize = 8;
    count + count / SPARE
}
