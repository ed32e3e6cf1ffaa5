//! Buffers, and the commands that fill, read and use them, with every byte and pass counted.

use std::sync::atomic::Ordering;

use super::device::{Gpu, GpuError};
use super::shader::WORKGROUP;
use crate::space::PixelRect;

/// Bytes that the smallest buffer has: a binding cannot be empty.
const LEAST_BYTES: u64 = 16;

/// The most workgroups in one dimension of a dispatch, of what WebGPU promises (65 535): a power of two.
pub(super) const MOST_GROUPS: u32 = 1 << 15;

impl Gpu {
    /// A storage buffer of zeros for `count` of `T`, one at least, which kernels, copies and draws can use.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`] where one binding cannot hold it.
    pub fn storage<T>(&self, label: &str, count: usize) -> Result<wgpu::Buffer, GpuError> {
        let size = self.fitting(label, count.max(1) as u64 * std::mem::size_of::<T>() as u64)?;
        Ok(self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size,
            usage: USAGES,
            mapped_at_creation: false,
        }))
    }

    /// A storage buffer that holds `data`.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`] where one binding cannot hold it.
    pub fn upload<T: bytemuck::Pod>(&self, label: &str, data: &[T]) -> Result<wgpu::Buffer, GpuError> {
        // Not mapped when it is made: that panics where it could not be made.
        let buffer = self.storage::<T>(label, data.len())?;
        self.write(&buffer, data);
        Ok(buffer)
    }

    /// Overwrites the beginning of `buffer`, before the commands that are submitted next.
    pub fn write<T: bytemuck::Pod>(&self, buffer: &wgpu::Buffer, data: &[T]) {
        let bytes: &[u8] = bytemuck::cast_slice(data);
        if !bytes.is_empty() {
            self.counters.uploaded.fetch_add(bytes.len() as u64, Ordering::Relaxed);
            self.queue.write_buffer(buffer, 0, bytes);
        }
    }

    /// A uniform buffer that holds `value`, whose size is a multiple of 16 bytes or is padded to one.
    pub fn uniform<T: bytemuck::Pod>(&self, label: &str, value: &T) -> wgpu::Buffer {
        let mut bytes = bytemuck::bytes_of(value).to_vec();
        bytes.resize(bytes.len().next_multiple_of(LEAST_BYTES as usize), 0);
        let buffer = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size: bytes.len() as u64,
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        self.write(&buffer, &bytes);
        buffer
    }

    /// A texture to draw the pixels of `rect` into; it begins at its first one.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`] where a texture cannot have as many pixels across or down.
    pub fn target(
        &self,
        label: &str,
        rect: PixelRect,
        format: wgpu::TextureFormat,
    ) -> Result<wgpu::TextureView, GpuError> {
        let (needed, limit) = (rect.width().max(rect.height()), self.limits.max_texture_dimension_2d);
        if needed > limit {
            let (needed, limit) = (u64::from(needed), u64::from(limit));
            return Err(GpuError::TooLarge { what: format!("pixels across or down of the {label}"), needed, limit });
        }
        let texture = self.device.create_texture(&wgpu::TextureDescriptor {
            label: Some(label),
            size: wgpu::Extent3d { width: rect.width(), height: rect.height(), depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::TEXTURE_BINDING,
            view_formats: &[],
        });
        Ok(texture.create_view(&wgpu::TextureViewDescriptor::default()))
    }

    fn fitting(&self, what: &str, bytes: u64) -> Result<u64, GpuError> {
        let (needed, limit) = (bytes.max(LEAST_BYTES).next_multiple_of(4), self.largest_binding());
        if needed > limit {
            return Err(GpuError::TooLarge { what: format!("bytes of {what}"), needed, limit });
        }
        Ok(needed)
    }

    /// The first `count` of `T` in `buffer`, once all that was submitted is done.
    ///
    /// # Errors
    /// [`GpuError::Lost`], and [`GpuError::Refused`] where the buffer is smaller.
    pub fn download<T: bytemuck::Pod>(&self, buffer: &wgpu::Buffer, count: usize) -> Result<Vec<T>, GpuError> {
        self.download_from(buffer, 0, count)
    }

    /// `count` of `T` in `buffer` from the byte `offset` on, a multiple of four, once all that was submitted is done.
    ///
    /// # Errors
    /// As [`download`](Self::download).
    pub fn download_from<T: bytemuck::Pod>(
        &self,
        buffer: &wgpu::Buffer,
        offset: u64,
        count: usize,
    ) -> Result<Vec<T>, GpuError> {
        let bytes = count * std::mem::size_of::<T>();
        if bytes == 0 {
            return Ok(Vec::new());
        }
        let size = (bytes as u64).next_multiple_of(4);
        let staging = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("download"),
            size,
            usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let mut commands = self.commands();
        commands.encoder.copy_buffer_to_buffer(buffer, offset, &staging, 0, size);
        commands.submit();
        staging.map_async(wgpu::MapMode::Read, .., |_| ());
        self.wait()?;
        let mapped = staging.get_mapped_range(..).map_err(|error| GpuError::Refused(error.to_string()))?;
        self.counters.downloaded.fetch_add(bytes as u64, Ordering::Relaxed);
        let mut data: Vec<T> = bytemuck::zeroed_vec(count);
        bytemuck::cast_slice_mut::<T, u8>(&mut data).copy_from_slice(&mapped[..bytes]);
        Ok(data)
    }

    /// Commands that have begun.
    pub fn commands(&self) -> Commands<'_> {
        Commands { gpu: self, encoder: self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default()) }
    }

    /// Group 0 of a kernel: its buffers by their binding.
    pub fn bind(&self, kernel: &wgpu::ComputePipeline, buffers: &[(u32, &wgpu::Buffer)]) -> wgpu::BindGroup {
        self.bind_layout(&kernel.get_bind_group_layout(0), buffers)
    }

    /// A group of buffers by their binding.
    pub fn bind_layout(&self, layout: &wgpu::BindGroupLayout, buffers: &[(u32, &wgpu::Buffer)]) -> wgpu::BindGroup {
        let entries: Vec<_> = buffers
            .iter()
            .map(|(binding, buffer)| wgpu::BindGroupEntry { binding: *binding, resource: buffer.as_entire_binding() })
            .collect();
        self.device.create_bind_group(&wgpu::BindGroupDescriptor { label: None, layout, entries: &entries })
    }
}

/// At least `groups` workgroups, across and down.
pub(super) fn grid(groups: usize) -> [u32; 2] {
    let across = groups.clamp(1, MOST_GROUPS as usize);
    [across as u32, groups.div_ceil(across) as u32]
}

/// What storage buffers can be used for.
const USAGES: wgpu::BufferUsages = wgpu::BufferUsages::STORAGE
    .union(wgpu::BufferUsages::VERTEX)
    .union(wgpu::BufferUsages::INDIRECT)
    .union(wgpu::BufferUsages::COPY_SRC)
    .union(wgpu::BufferUsages::COPY_DST);

/// Commands that are being written down.
#[derive(Debug)]
pub struct Commands<'g> {
    gpu: &'g Gpu,
    /// Where they are written.
    pub encoder: wgpu::CommandEncoder,
}

impl<'g> Commands<'g> {
    /// The device that they are for.
    pub fn gpu(&self) -> &'g Gpu {
        self.gpu
    }

    /// Runs `kernel` with `threads` threads, at least; a kernel passes by numbers that are none of its own.
    pub fn dispatch(&mut self, kernel: &wgpu::ComputePipeline, group: &wgpu::BindGroup, threads: usize) {
        self.dispatch_groups(kernel, group, threads.div_ceil(WORKGROUP as usize));
    }

    /// Runs `kernel` with at least `groups` workgroups, in two dimensions.
    pub fn dispatch_groups(&mut self, kernel: &wgpu::ComputePipeline, group: &wgpu::BindGroup, groups: usize) {
        if groups == 0 {
            return;
        }
        let [across, down] = grid(groups);
        self.gpu.counters.dispatches.fetch_add(1, Ordering::Relaxed);
        let mut pass = self.encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        pass.set_pipeline(kernel);
        pass.set_bind_group(0, group, &[]);
        pass.dispatch_workgroups(across, down, 1);
    }

    /// Runs `kernel` with as many workgroups as `arguments` say from the byte `offset` on.
    pub fn dispatch_indirect(
        &mut self,
        kernel: &wgpu::ComputePipeline,
        group: &wgpu::BindGroup,
        arguments: &wgpu::Buffer,
        offset: u64,
    ) {
        self.gpu.counters.dispatches.fetch_add(1, Ordering::Relaxed);
        let mut pass = self.encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        pass.set_pipeline(kernel);
        pass.set_bind_group(0, group, &[]);
        pass.dispatch_workgroups_indirect(arguments, offset);
    }

    /// Counts a render pass with its draws and triangles.
    pub fn count_pass(&self, draws: u64, triangles: u64) {
        let counters = &self.gpu.counters;
        counters.passes.fetch_add(1, Ordering::Relaxed);
        counters.draws.fetch_add(draws, Ordering::Relaxed);
        counters.triangles.fetch_add(triangles, Ordering::Relaxed);
    }

    /// Fills `buffer` with zeros.
    pub fn clear(&mut self, buffer: &wgpu::Buffer) {
        self.encoder.clear_buffer(buffer, 0, None);
    }

    /// Hands the commands to the device, which begins with them.
    pub fn submit(self) {
        self.gpu.queue.submit([self.encoder.finish()]);
    }
}
