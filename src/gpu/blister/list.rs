//! One pass over what is drawn, into lists of fragments by pixel, resolved in compute as the CPU does.
//!
//! *Practice.* Fragments come in any order, each with its pixel and its number among that pixel's; sums of the counts tell where
//! each pixel's begin. Both counts have to be known to the CPU before the next buffer is made: two waits for each band. A
//! list that was too short is made as long as it has to be, and the band is drawn again: nothing is lost.

use super::arrangement::{Fragment, Survivor, Uploaded};
use super::draws::{KINDS, NO_COLOUR, pass, pipeline};
use super::frame::{GpuMeshFrame, with_room};
use super::shader;
use crate::gpu::layers::{GpuLayers, LayerRecord};
use crate::gpu::{Gpu, GpuError, scan};
use crate::space::PixelRect;

/// Fragments that the first list has room for, for each pixel: enough for most pictures.
const FIRST_FRAGMENTS_A_PIXEL: usize = 4;

/// The layers of a band.
pub(super) fn draw(
    gpu: &Gpu,
    frame: &GpuMeshFrame,
    uploaded: &Uploaded,
    rect: PixelRect,
) -> Result<GpuLayers, GpuError> {
    let of = ("fragments", std::mem::size_of::<Fragment>());
    with_room(gpu, &frame.length, of, rect.area() * FIRST_FRAGMENTS_A_PIXEL, |room| {
        let fragments = gpu.storage::<Fragment>("fragments", room)?;
        let (counts, length) = raster(gpu, uploaded, rect, &fragments)?;
        let has_room = length <= room;
        let layers = has_room.then(|| resolve(gpu, uploaded, rect, &fragments, &counts, length)).transpose()?;
        Ok((length, layers))
    })
}

/// Draws everything into `fragments`; returns the counts by pixel and the number of fragments, whether or not they had room.
fn raster(
    gpu: &Gpu,
    uploaded: &Uploaded,
    rect: PixelRect,
    fragments: &wgpu::Buffer,
) -> Result<(wgpu::Buffer, usize), GpuError> {
    // One more than there are pixels: sums need a last zero.
    let counts = gpu.storage::<u32>("counts", rect.area() + 1)?;
    let length = gpu.storage::<u32>("length", 1)?;
    let frame = gpu.uniform("frame", &uploaded.band(rect));
    let target = gpu.target("target", rect, NO_COLOUR)?;
    let mut commands = gpu.commands();
    let mut draws = 0;
    {
        let mut pass = pass(&mut commands.encoder, "list", &target, None);
        pass.set_vertex_buffer(0, uploaded.corners.slice(..));
        for (topology, vertices) in KINDS.into_iter().zip(uploaded.vertices()).filter(|(_, range)| !range.is_empty()) {
            let pipeline = pipeline(gpu, uploaded, "list_fragment", topology, false);
            let buffers = [(0, &frame), (3, &uploaded.surfaces), (4, &length), (5, &counts), (7, fragments)];
            pass.set_pipeline(&pipeline);
            pass.set_bind_group(0, &gpu.bind_layout(&pipeline.get_bind_group_layout(0), &buffers), &[]);
            pass.draw(vertices, 0..1);
            draws += 1;
        }
    }
    commands.count_pass(draws, u64::from(uploaded.triangles));
    commands.submit();
    let length = gpu.download::<u32>(&length, 1)?[0] as usize;
    Ok((counts, length))
}

fn resolve(
    gpu: &Gpu,
    uploaded: &Uploaded,
    rect: PixelRect,
    fragments: &wgpu::Buffer,
    counts: &wgpu::Buffer,
    length: usize,
) -> Result<GpuLayers, GpuError> {
    let shader = shader(uploaded.words);
    let pixels = rect.area();
    let frame = gpu.uniform("frame", &uploaded.band(rect));
    let sorted = gpu.storage::<Survivor>("sorted", length)?;
    let kept = gpu.storage::<u32>("kept", pixels + 1)?;
    let length_buffer = gpu.upload("length", &[length as u32])?;
    let mut commands = gpu.commands();
    scan::exclusive(gpu, &mut commands, counts, pixels + 1)?;
    let place = gpu.kernel(&shader, "place_fragments");
    let buffers = [(3, &uploaded.surfaces), (4, &length_buffer), (6, counts), (7, fragments), (8, &sorted)];
    commands.dispatch(&place, &gpu.bind(&place, &buffers), length);
    let resolve = gpu.kernel(&shader, "resolve");
    let buffers = [
        (0, &frame),
        (1, &uploaded.steps),
        (2, &uploaded.slots),
        (3, &uploaded.surfaces),
        (6, counts),
        (8, &sorted),
        (9, &kept),
    ];
    commands.dispatch(&resolve, &gpu.bind(&resolve, &buffers), pixels);
    scan::exclusive(gpu, &mut commands, &kept, pixels + 1)?;
    commands.submit();
    write(gpu, uploaded, &frame, rect, &sorted, counts, kept)
}

/// Makes records of what is in `sorted`, where each pixel's begin at its `offsets` and are as many as `kept` says.
pub(super) fn write(
    gpu: &Gpu,
    uploaded: &Uploaded,
    frame: &wgpu::Buffer,
    rect: PixelRect,
    sorted: &wgpu::Buffer,
    offsets: &wgpu::Buffer,
    kept: wgpu::Buffer,
) -> Result<GpuLayers, GpuError> {
    write_with(gpu, uploaded, frame, rect, kept, "write", &[(6, offsets), (8, sorted)])
}

/// Makes records with the kernel `entry`, which reads boundaries from `of`; `kept` are sums of how many each pixel has.
pub(super) fn write_with(
    gpu: &Gpu,
    uploaded: &Uploaded,
    frame: &wgpu::Buffer,
    rect: PixelRect,
    kept: wgpu::Buffer,
    entry: &'static str,
    of: &[(u32, &wgpu::Buffer)],
) -> Result<GpuLayers, GpuError> {
    let pixels = rect.area();
    let count = gpu.download_from::<u32>(&kept, std::mem::size_of::<u32>() as u64 * pixels as u64, 1)?[0] as usize;
    let records = gpu.storage::<LayerRecord>("records", count)?;
    let mut commands = gpu.commands();
    let write = gpu.kernel(&shader(uploaded.words), entry);
    let buffers = [
        &[
            (0, frame),
            (2, &uploaded.slots),
            (3, &uploaded.surfaces),
            (10, &kept),
            (11, &records),
            (12, &uploaded.corners),
        ],
        of,
    ]
    .concat();
    commands.dispatch(&write, &gpu.bind(&write, &buffers), pixels);
    commands.submit();
    Ok(GpuLayers { rect, offsets: kept, records, count })
}
