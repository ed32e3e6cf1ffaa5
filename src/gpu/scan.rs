//! Prefix sums: from how many records each pixel has to where they begin.
//!
//! *Theory.* Blelloch 1990: every workgroup sums its part, the parts' sums are summed the same way, and added to the parts.

use super::buffers::Commands;
use super::device::{Gpu, GpuError};
use super::shader::{Shader, WORKGROUP};
use crate::gpu_struct;

/// Numbers that a thread sums by itself: longer means fewer barriers, shorter fewer idle threads at the end.
const NUMBERS_A_THREAD: u32 = 32;

/// Numbers of a workgroup.
const NUMBERS_A_GROUP: usize = (NUMBERS_A_THREAD * WORKGROUP) as usize;

gpu_struct! {
    /// How many numbers there are.
    struct Length {
        /// Numbers to sum.
        count: u32,
    }
}

/// The kernels' module.
pub(super) fn shader() -> Shader {
    Shader::new("scan")
        .with_constant("NUMBERS_A_THREAD", NUMBERS_A_THREAD)
        .with_text(include_str!("../../shaders/scan.wgsl"))
}

/// Replaces each of the first `count` numbers of `numbers` by the sum of those before it. Where the last is a zero it becomes the
/// sum of all.
///
/// # Errors
/// [`GpuError::TooLarge`] where the parts' sums fit no buffer.
pub fn exclusive(gpu: &Gpu, commands: &mut Commands, numbers: &wgpu::Buffer, count: usize) -> Result<(), GpuError> {
    let shader = shader();
    let (group_kernel, add_kernel) = (gpu.kernel(&shader, "scan_group"), gpu.kernel(&shader, "scan_add"));
    let groups = count.div_ceil(NUMBERS_A_GROUP);
    let sums = gpu.storage::<u32>("sums", groups)?;
    let length = gpu.uniform("length", &Length { count: count as u32 });
    let buffers = [(0, &length), (1, numbers), (2, &sums)];
    commands.dispatch_groups(&group_kernel, &gpu.bind(&group_kernel, &buffers), groups);
    if groups > 1 {
        exclusive(gpu, commands, &sums, groups)?;
        commands.dispatch_groups(&add_kernel, &gpu.bind(&add_kernel, &buffers), groups);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_struct_is_the_shaders() {
        crate::gpu::layout::assert_same_layout::<Length>();
    }
}
