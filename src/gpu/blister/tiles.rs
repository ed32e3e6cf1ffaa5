//! The whole pixel in one kernel: a workgroup for each tile of [`pieces`](super::pieces), a thread for each pixel.
//!
//! *Practice.* A thread looks through its tile's triangles once for each layer, so the cost is layers times triangles, both of a tile
//! of eight pixels a side; but no fragment is ever stored, and a pixel stops at the boundary that settles it. Where a picture needs but
//! one boundary a pixel, it has its place; else boundaries are appended to a list, and put in order after.

use super::arrangement::{Survivor, Uploaded};
use super::frame::{GpuMeshFrame, with_room};
use super::pieces::{TILE, TileBoundary};
use super::{CUT_SHORT, list, shader};
use crate::gpu::layers::GpuLayers;
use crate::gpu::{Gpu, GpuError, scan};
use crate::space::PixelRect;

/// Boundaries that there is room for at first, for each pixel.
const FIRST_BOUNDARIES_A_PIXEL: usize = 2;

/// The layers of a band.
pub(super) fn draw(
    gpu: &Gpu,
    frame: &GpuMeshFrame,
    uploaded: &Uploaded,
    rect: PixelRect,
) -> Result<GpuLayers, GpuError> {
    let (pixels, is_single) = (rect.area(), uploaded.frame.is_single != 0);
    let [places, pieces] = uploaded.tiles.as_ref().expect("a frame of this classifier has its tiles uploaded");
    let shader = shader(uploaded.traits);
    let band = gpu.uniform("frame", &uploaded.band(rect));
    let of = ("boundaries", std::mem::size_of::<TileBoundary>());
    with_room(gpu, &frame.length, of, pixels * FIRST_BOUNDARIES_A_PIXEL, |room| {
        let room = if is_single { pixels } else { room };
        let kept = gpu.storage::<u32>("kept", pixels + 1)?;
        let length = gpu.storage::<u32>("length", 2)?;
        let boundaries = gpu.storage::<TileBoundary>("boundaries", room)?;
        let mut commands = gpu.commands();
        let resolve = gpu.kernel(&shader, "resolve_tiles");
        let buffers = [
            (0, &band),
            (1, &uploaded.steps),
            (2, &uploaded.slots),
            (4, &length),
            (9, &kept),
            (22, places),
            (23, pieces),
            (24, &boundaries),
        ];
        let tiles_of = |first: u32, end: u32| (end.div_ceil(TILE) - first / TILE) as usize;
        let groups = tiles_of(rect.x0, rect.x1) * tiles_of(rect.y0, rect.y1);
        commands.dispatch_groups(&resolve, &gpu.bind(&resolve, &buffers), groups);
        scan::exclusive(gpu, &mut commands, &kept, pixels + 1)?;
        commands.submit();
        let lengths = gpu.download::<u32>(&length, 2)?;
        if lengths[1] == CUT_SHORT {
            // Lists take fewer turns.
            return list::draw(gpu, frame, uploaded, rect).map(|layers| (room, Some(layers)));
        }
        if is_single {
            let layers = list::write_with(gpu, uploaded, &band, rect, kept, "write_single", &[(24, &boundaries)])?;
            return Ok((pixels, Some(layers)));
        }
        let found = lengths[0] as usize;
        if found > room {
            return Ok((found, None));
        }
        let sorted = gpu.storage::<Survivor>("sorted", found)?;
        let mut commands = gpu.commands();
        let place = gpu.kernel(&shader, "place_tile_boundaries");
        let buffers = [(4, &length), (6, &kept), (8, &sorted), (24, &boundaries)];
        commands.dispatch(&place, &gpu.bind(&place, &buffers), found);
        commands.submit();
        let offsets = kept.clone();
        Ok((found, Some(list::write(gpu, uploaded, &band, rect, &sorted, &offsets, kept)?)))
    })
}
