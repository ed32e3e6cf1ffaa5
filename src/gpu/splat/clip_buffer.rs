//! The clip buffer on the GPU: the twin of [`crate::splat::clip_buffer`].
//!
//! ```text
//! views, footprints ─► surfels of every cell ─► partners that meet ─► sorted ─► each once
//!                      count, sum, fill         count, sum, fill
//! ```
//!
//! *Practice.* Everything that is listed is counted first, so no list has a longest length. A picture whose cells fit no buffer is
//! gone through in parts, once to count and once to fill; lists of partners are those of the whole picture.

use super::clip::joined;
use super::project::SplatView;
use super::{bins, shaders};
use crate::gpu::layers::in_parts;
use crate::gpu::{Gpu, GpuError, scan};
use crate::space::PixelRect;

/// A part of the picture, ready.
pub(super) struct Part {
    pub view: SplatView,
    pub views: wgpu::Buffer,
    pub footprints: wgpu::Buffer,
}

/// What is the same for all parts.
pub(super) struct ClipBuffer<'a> {
    pub far: &'a wgpu::Buffer,
    pub tables: &'a wgpu::Buffer,
    pub leaf_words: u32,
    pub stack_words: u32,
    /// How many disks there are.
    pub disks: usize,
}

/// The surfels of every cell of a part.
struct Cells {
    starts: wgpu::Buffer,
    members: wgpu::Buffer,
}

impl ClipBuffer<'_> {
    /// The tables, and behind them the partners of every disk that meet in `picture`, of which `part` makes parts ready where they
    /// hold any surfel: where each list begins and the last ends, and the numbers of disks.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`] where all pairs that meet in a row of cells fit no buffer; [`GpuError::CutShort`] where the driver ends
    /// loops early; [`GpuError::Lost`].
    pub fn partners(
        &self,
        gpu: &Gpu,
        picture: PixelRect,
        part: &dyn Fn(PixelRect) -> Result<Option<Part>, GpuError>,
    ) -> Result<wgpu::Buffer, GpuError> {
        let shader = shaders::clip_buffer(self.leaf_words, self.stack_words);
        let [count, fill] = ["count_partners", "fill_partners"].map(|entry| gpu.kernel(&shader, entry));
        let counts = gpu.storage::<u32>("partners of disks", self.disks + 2)?;
        // Who only counts writes no partners, but shares the code of who does.
        let none = gpu.storage::<u32>("partners", 0)?;
        // Step 1: how many each has. What fails for want of room does so before anything is counted.
        let mut whole = None;
        in_parts(picture, &mut |rect| {
            let Some(part) = part(rect)? else { return Ok(()) };
            let cells = self.cells(gpu, &part)?;
            let uniform = gpu.uniform("splat view", &part.view);
            let mut commands = gpu.commands();
            let group = gpu.bind(&count, &self.bindings(&part, &uniform, &cells, &counts, &none));
            commands.dispatch_groups(&count, &group, part.view.views as usize);
            commands.submit();
            if rect == picture {
                whole = Some((part, cells));
            }
            Ok(())
        })?;
        let total = sum(gpu, &counts, self.disks)?;
        let starts = gpu.storage::<u32>("lists of partners", self.disks + 1)?;
        let mut commands = gpu.commands();
        commands.encoder.copy_buffer_to_buffer(&counts, 0, &starts, 0, starts.size());
        commands.submit();
        // Step 2: who they are.
        let found = gpu.storage::<u32>("partners", total)?;
        let fill_part = |part: &Part, cells: &Cells| {
            let uniform = gpu.uniform("splat view", &part.view);
            let buffers = self.bindings(part, &uniform, cells, &counts, &found);
            let mut commands = gpu.commands();
            commands.dispatch_groups(&fill, &gpu.bind(&fill, &buffers), part.view.views as usize);
            commands.submit();
        };
        match &whole {
            Some((part, cells)) => fill_part(part, cells),
            None => in_parts(picture, &mut |rect| {
                let Some(part) = part(rect)? else { return Ok(()) };
                fill_part(&part, &self.cells(gpu, &part)?);
                Ok(())
            })?,
        }
        self.distinct(gpu, &starts, &found)
    }

    fn bindings<'b>(
        &'b self,
        part: &'b Part,
        uniform: &'b wgpu::Buffer,
        cells: &'b Cells,
        counts: &'b wgpu::Buffer,
        found: &'b wgpu::Buffer,
    ) -> [(u32, &'b wgpu::Buffer); 9] {
        [
            (0, uniform),
            (1, &part.views),
            (6, self.far),
            (7, self.tables),
            (9, &part.footprints),
            (12, &cells.members),
            (13, &cells.starts),
            (14, counts),
            (15, found),
        ]
    }

    fn cells(&self, gpu: &Gpu, part: &Part) -> Result<Cells, GpuError> {
        let shader = shaders::clip_buffer(self.leaf_words, self.stack_words);
        let [count, fill] = ["count_cells", "fill_cells"].map(|entry| gpu.kernel(&shader, entry));
        let [x0, y0, x1, y1] = part.view.rect;
        let cells = ((x1 - x0) * (y1 - y0)) as usize;
        let surfels = part.view.views as usize;
        let uniform = gpu.uniform("splat view", &part.view);
        let counts = gpu.storage::<u32>("surfels of cells", cells + 2)?;
        let mut buffers = vec![(0, &uniform), (1, &part.views), (7, self.tables), (9, &part.footprints), (11, &counts)];
        let mut commands = gpu.commands();
        commands.dispatch_groups(&count, &gpu.bind(&count, &buffers), surfels);
        commands.submit();
        let total = sum(gpu, &counts, cells)?;
        let members = gpu.storage::<u32>("surfels of cells", total)?;
        let starts = gpu.storage::<u32>("cells", cells + 1)?;
        buffers.push((12, &members));
        let mut commands = gpu.commands();
        commands.encoder.copy_buffer_to_buffer(&counts, 0, &starts, 0, starts.size());
        commands.dispatch_groups(&fill, &gpu.bind(&fill, &buffers), surfels);
        commands.submit();
        Ok(Cells { starts, members })
    }

    /// The tables, and behind them each list sorted, without repetition.
    fn distinct(&self, gpu: &Gpu, starts: &wgpu::Buffer, found: &wgpu::Buffer) -> Result<wgpu::Buffer, GpuError> {
        let sort = gpu.kernel(&bins::shader(), "bin_sort");
        let [count, keep] = ["count_distinct", "keep_distinct"].map(|entry| gpu.kernel(&shaders::partners(), entry));
        let kept = gpu.storage::<u32>("lists of partners", self.disks + 2)?;
        let mut commands = gpu.commands();
        let buffers = [(3, found), (4, starts)];
        commands.dispatch_groups(&sort, &gpu.bind(&sort, &buffers), self.disks);
        let buffers = [(0, starts), (1, found), (2, &kept)];
        commands.dispatch(&count, &gpu.bind(&count, &buffers), self.disks);
        commands.submit();
        let total = sum(gpu, &kept, self.disks)?;
        let partners = gpu.storage::<u32>("partners", total)?;
        let mut commands = gpu.commands();
        let buffers = [(0, starts), (1, found), (2, &kept), (3, &partners)];
        commands.dispatch(&keep, &gpu.bind(&keep, &buffers), self.disks);
        commands.submit();
        let bytes = |count: usize| (count * size_of::<u32>()) as u64;
        let lists = [(&kept, bytes(self.disks + 1)), (&partners, bytes(total))];
        joined(gpu, "partners", &[&[(self.tables, self.tables.size())], &lists[..]].concat())
    }
}

/// Replaces each of the first `lists` counts by the sum of those before it, and the zero behind them by the sum of all, which is
/// given back. The word behind that says whether the loops of who counted were cut short.
///
/// # Errors
/// [`GpuError::CutShort`] where they were; [`GpuError::Lost`].
fn sum(gpu: &Gpu, counts: &wgpu::Buffer, lists: usize) -> Result<usize, GpuError> {
    let mut commands = gpu.commands();
    scan::exclusive(gpu, &mut commands, counts, lists + 1)?;
    commands.submit();
    let [total, cut] = gpu.download_from::<u32>(counts, 4 * lists as u64, 2)?[..] else { return Ok(0) };
    if cut != 0 { Err(GpuError::CutShort) } else { Ok(total as usize) }
}
