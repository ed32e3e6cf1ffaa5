//! What the mesh pipeline tells others on the GPU: the twin of `blister::frame::crossings`.
//!
//! *Practice.* The same lists of fragments as for a picture; they are sorted, told which way they go, and written out, and the
//! expression is not asked. A closed leaf's crossings enter and leave it in turn, and whether a ray begins inside is their parity. A
//! sheet's, closed or open, say only where it is: which of them have `CROSSING_ENTERS` means nothing. A solid whose mesh is open is not
//! decided here: whoever has one does not ask.

use super::arrangement::{Frame, Uploaded};
use super::frame::{GpuMeshFrame, Sample};
use super::list::{Lists, listed};
use super::{CUT_SHORT, shader};
use crate::crossings::CrossingSource;
use crate::csg::LeafId;
use crate::gpu::crossings::{CrossingRecord, GpuCrossingSource, GpuCrossings, words_for};
use crate::gpu::{Gpu, GpuError, scan};
use crate::space::PixelRect;

impl GpuCrossingSource for GpuMeshFrame<'_> {
    fn leaves(&self) -> Vec<LeafId> {
        self.frame.leaves()
    }

    fn crossings(&self, gpu: &Gpu, rect: PixelRect, sample: usize) -> Result<GpuCrossings, GpuError> {
        let begins_words = self.leaves().last().map_or(0, |last| words_for(*last));
        match self.upload(gpu, rect, sample)? {
            Sample(Some(uploaded)) => {
                listed(gpu, self, &uploaded, rect, |lists| ordered(gpu, &uploaded, rect, begins_words, lists))
            }
            Sample(None) => Ok(GpuCrossings {
                rect,
                offsets: gpu.storage::<u32>("offsets of crossings", rect.area() + 1)?,
                begins: gpu.storage::<u32>("begins", 0)?,
                begins_words: 0,
                crossings: gpu.storage::<CrossingRecord>("crossings", 0)?,
                count: 0,
            }),
        }
    }
}

fn ordered(
    gpu: &Gpu,
    uploaded: &Uploaded,
    rect: PixelRect,
    begins_words: u32,
    lists: &Lists,
) -> Result<GpuCrossings, GpuError> {
    let pixels = rect.area();
    let frame = gpu.uniform("frame", &Frame { begins_words, ..uploaded.band(rect) });
    let begins = gpu.storage::<u32>("begins", pixels * begins_words as usize)?;
    // One more than there are pixels: sums need a last zero.
    let offsets = gpu.storage::<u32>("offsets of crossings", pixels + 1)?;
    let [order, write] =
        ["order_crossings", "write_crossings"].map(|entry| gpu.kernel(&shader(uploaded.traits), entry));
    let mut commands = gpu.commands();
    let buffers = [
        (0, &frame),
        (2, &uploaded.slots),
        (3, &uploaded.surfaces),
        (4, &lists.length),
        (7, &lists.nodes),
        (9, &offsets),
        (13, &lists.heads),
        (25, &begins),
    ];
    commands.dispatch(&order, &gpu.bind(&order, &buffers), pixels);
    scan::exclusive(gpu, &mut commands, &offsets, pixels + 1)?;
    commands.submit();
    let lengths = gpu.download::<u32>(&lists.length, 2)?;
    if lengths[1] == CUT_SHORT {
        return Err(GpuError::CutShort);
    }
    // All fragments are crossings.
    let count = lengths[0] as usize;
    let crossings = gpu.storage::<CrossingRecord>("crossings", count)?;
    let mut commands = gpu.commands();
    let buffers = [
        (0, &frame),
        (2, &uploaded.slots),
        (3, &uploaded.surfaces),
        (7, &lists.nodes),
        (10, &offsets),
        (12, &uploaded.corners),
        (13, &lists.heads),
        (26, &crossings),
    ];
    commands.dispatch(&write, &gpu.bind(&write, &buffers), pixels);
    commands.submit();
    Ok(GpuCrossings { rect, offsets, begins, begins_words, crossings, count })
}
