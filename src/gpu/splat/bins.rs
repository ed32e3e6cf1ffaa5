//! Which surfels touch which block of pixels, sorted.
//!
//! A block has two lists, as on the CPU: surfels through which rays can enter their leaf, and the others. Views of surfels are
//! numbered by leaf and index, so a sorted list has its leaves one after the other.

use super::project::{MAY_ENTER, OWNER_SHIFT, SplatView, SurfelView};
use super::tables;
use crate::gpu::shader::Shader;
use crate::gpu::{Gpu, GpuError, scan};
use crate::splat::bins::BLOCK;

/// Lists of a block.
pub(super) const LISTS: u32 = 2;

/// Blocks of a band at most: a surfel around the eye is put into all of them by one thread, and llvmpipe ends the loops of a thread
/// after 65 535 turns without a word.
const MOST_BLOCKS: u32 = 60_000;

/// The lists of all blocks of a grid.
#[derive(Debug)]
pub(super) struct Bins {
    /// Where each list begins, and where the last ends.
    pub starts: wgpu::Buffer,
    /// Numbers of views.
    pub members: wgpu::Buffer,
}

pub(super) fn shader() -> Shader {
    tables::with_kinds(Shader::new("splat bins").with_struct::<SplatView>().with_struct::<SurfelView>())
        .with_constant("BLOCK", BLOCK)
        .with_constant("LISTS", LISTS)
        .with_constant("MAY_ENTER", MAY_ENTER)
        .with_constant("OWNER_SHIFT", OWNER_SHIFT)
        .with_text(include_str!("../../../shaders/splat/bins.wgsl"))
}

impl Bins {
    /// Bins `views`, as many as `of` says, into its grid.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`], [`GpuError::Lost`].
    pub fn new(gpu: &Gpu, of: &SplatView, views: &wgpu::Buffer) -> Result<Self, GpuError> {
        let shader = shader();
        let [count, fill, sort] = ["bin_count", "bin_fill", "bin_sort"].map(|entry| gpu.kernel(&shader, entry));
        let [_, _, across, down] = of.grid;
        let (blocks, most) = (u64::from(across) * u64::from(down), u64::from(MOST_BLOCKS));
        if blocks > most {
            return Err(GpuError::TooLarge { what: "blocks of a band".to_owned(), needed: blocks, limit: most });
        }
        let lists = (LISTS * across * down) as usize;
        let uniform = gpu.uniform("splat view", of);
        let starts = gpu.storage::<u32>("lists", lists + 1)?;
        // Step 1: how many members each list has, and so where it begins.
        let mut commands = gpu.commands();
        let buffers = [(0, &uniform), (1, views), (2, &starts)];
        commands.dispatch(&count, &gpu.bind(&count, &buffers), of.views as usize);
        scan::exclusive(gpu, &mut commands, &starts, lists + 1)?;
        // Where the next member of each goes.
        let next = gpu.storage::<u32>("next members", lists + 1)?;
        commands.encoder.copy_buffer_to_buffer(&starts, 0, &next, 0, starts.size());
        commands.submit();
        let total = gpu.download_from::<u32>(&starts, 4 * lists as u64, 1)?[0] as usize;
        // Step 2: the members, in any order, then sorted.
        let members = gpu.storage::<u32>("members", total)?;
        let mut commands = gpu.commands();
        let buffers = [(0, &uniform), (1, views), (2, &next), (3, &members)];
        commands.dispatch(&fill, &gpu.bind(&fill, &buffers), of.views as usize);
        let buffers = [(3, &members), (4, &starts)];
        commands.dispatch_groups(&sort, &gpu.bind(&sort, &buffers), lists);
        commands.submit();
        Ok(Self { starts, members })
    }
}
