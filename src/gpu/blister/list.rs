//! One pass over what is drawn, into lists of fragments by pixel, resolved in compute as the CPU does.
//!
//! *Practice.* Fragments come in any order, each linked to the one before it in its pixel; what comes out does not depend on the order.
//! Where a pixel has one boundary at most, a first kernel holds the nearest fragments of its list in registers and goes through them
//! until it is known what shows; pixels with long lists, ties that matter or sheets are few, and a second kernel takes them from a list
//! of pixels. It sorts by the links alone, as is done for all pixels where they may have several boundaries. How many fragments there
//! are has to be known to the CPU: one wait for each band, and another for how many boundaries. The first list is as long as the
//! triangles' areas tell; one that was too short is made as long as it has to be, and the band is drawn again: nothing is lost.

use super::arrangement::{Fragment, Uploaded};
use super::draws::{KINDS, NO_COLOUR, pass, pipeline};
use super::frame::{GpuMeshFrame, with_room};
use super::{CUT_SHORT, shader};
use crate::gpu::layers::{GpuLayers, LayerRecord};
use crate::gpu::{Gpu, GpuError, scan};
use crate::space::PixelRect;

/// Fragments of a pixel that are looked through again and again for the nearest ones; where there are more they are sorted.
pub(super) const MOST_WALKED: u32 = 64;

/// The layers of a band.
pub(super) fn draw(
    gpu: &Gpu,
    frame: &GpuMeshFrame,
    uploaded: &Uploaded,
    rect: PixelRect,
) -> Result<GpuLayers, GpuError> {
    listed(gpu, frame, uploaded, rect, |lists| resolve(gpu, uploaded, rect, lists))
}

/// Every fragment of a band, in a list for each pixel, in any order.
pub(super) struct Lists {
    /// How many fragments there are, and whether the driver cut a thread short.
    pub length: wgpu::Buffer,
    /// By pixel: its first fragment, plus one.
    pub heads: wgpu::Buffer,
    /// [`Fragment`].
    pub nodes: wgpu::Buffer,
}

/// What `then` makes of the lists of a band.
///
/// # Errors
/// Those of `then`; [`GpuError::TooLarge`] where one buffer does not hold all fragments.
pub(super) fn listed<T>(
    gpu: &Gpu,
    frame: &GpuMeshFrame,
    uploaded: &Uploaded,
    rect: PixelRect,
    then: impl Fn(&Lists) -> Result<T, GpuError>,
) -> Result<T, GpuError> {
    let of = ("fragments", std::mem::size_of::<Fragment>());
    let first = (uploaded.depth * rect.area() as f64) as usize;
    with_room(gpu, &frame.length, of, first, |room| {
        let lists = Lists {
            length: gpu.storage::<u32>("length", 2)?,
            heads: gpu.storage::<u32>("heads", rect.area())?,
            nodes: gpu.storage::<Fragment>("nodes", room)?,
        };
        raster(gpu, uploaded, rect, &lists)?;
        let needed = gpu.download::<u32>(&lists.length, 1)?[0] as usize;
        Ok((needed, (needed <= room).then(|| then(&lists)).transpose()?))
    })
}

/// Draws everything into the lists; their length becomes the number of fragments, whether or not they had room.
fn raster(gpu: &Gpu, uploaded: &Uploaded, rect: PixelRect, lists: &Lists) -> Result<(), GpuError> {
    let frame = gpu.uniform("frame", &uploaded.band(rect));
    let target = gpu.target("target", rect, NO_COLOUR)?;
    let mut commands = gpu.commands();
    let mut draws = 0;
    {
        let mut pass = pass(&mut commands.encoder, "list", &target, None);
        pass.set_vertex_buffer(0, uploaded.corners.slice(..));
        for (topology, vertices) in KINDS.into_iter().zip(uploaded.vertices()).filter(|(_, range)| !range.is_empty()) {
            let pipeline = pipeline(gpu, uploaded, "list_fragment", topology, false);
            let Lists { length, heads, nodes } = lists;
            let buffers = [(0, &frame), (3, &uploaded.surfaces), (4, length), (5, heads), (7, nodes)];
            pass.set_pipeline(&pipeline);
            pass.set_bind_group(0, &gpu.bind_layout(&pipeline.get_bind_group_layout(0), &buffers), &[]);
            pass.draw(vertices, 0..1);
            draws += 1;
        }
    }
    commands.count_pass(draws, u64::from(uploaded.triangles));
    commands.submit();
    Ok(())
}

fn resolve(gpu: &Gpu, uploaded: &Uploaded, rect: PixelRect, lists: &Lists) -> Result<GpuLayers, GpuError> {
    let Lists { length, heads, nodes } = lists;
    let pixels = rect.area();
    let frame = gpu.uniform("frame", &uploaded.band(rect));
    // One more than there are pixels: sums need a last zero.
    let kept = gpu.storage::<u32>("kept", pixels + 1)?;
    let mut commands = gpu.commands();
    let shader = shader(uploaded.traits);
    let buffers = [(0, &frame), (1, &uploaded.steps), (2, &uploaded.slots), (7, nodes), (9, &kept), (13, heads)];
    if uploaded.frame.is_single != 0 {
        let rest = gpu.storage::<u32>("rest", 1 + pixels)?;
        let groups = gpu.upload::<u32>("groups", &[0, 1, 1])?;
        let [single, left] = ["resolve_single", "resolve_rest"].map(|entry| gpu.kernel(&shader, entry));
        let of_single = [&buffers[..], &[(4, length), (27, &rest), (28, &groups)]].concat();
        commands.dispatch(&single, &gpu.bind(&single, &of_single), pixels);
        let of_rest = [&buffers[..], &[(4, length), (27, &rest)]].concat();
        commands.dispatch_indirect(&left, &gpu.bind(&left, &of_rest), &groups, 0);
    } else {
        let resolve = gpu.kernel(&shader, "resolve");
        let buffers = [&buffers[..], &[(4, length)]].concat();
        commands.dispatch(&resolve, &gpu.bind(&resolve, &buffers), pixels);
    }
    scan::exclusive(gpu, &mut commands, &kept, pixels + 1)?;
    commands.submit();
    if gpu.download::<u32>(length, 2)?[1] == CUT_SHORT {
        return Err(GpuError::CutShort);
    }
    write_with(gpu, uploaded, &frame, rect, kept, "write_list", &[(7, nodes), (13, heads)])
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
    let write = gpu.kernel(&shader(uploaded.traits), entry);
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
