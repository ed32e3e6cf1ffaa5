//! One pass over what is drawn, into lists of fragments by pixel, resolved in compute as the CPU does.
//!
//! *Practice.* Fragments come in any order, each with its pixel and its number among that pixel's; sums of the counts tell where
//! each pixel's begin. Both counts have to be known to the CPU before the next buffer is made: two waits for each band. A
//! list that was too short is made as long as it has to be, and the band is drawn again: nothing is lost.

use std::cell::Cell;

use super::arrangement::{Fragment, PlacedCorner, Survivor, Uploaded};
use super::shader;
use crate::blister::frame::MeshFrame;
use crate::gpu::layers::{GpuLayerSource, GpuLayers, LayerRecord};
use crate::gpu::{Gpu, GpuError, scan};
use crate::layers::{LayerTile, SampleMerger};
use crate::space::{Camera, PixelRect};

/// Fragments that the first list has room for, for each pixel: enough for most pictures.
const FIRST_FRAGMENTS_A_PIXEL: usize = 4;

/// The format of the target that fragments are drawn over. Nothing is ever written to it.
const NO_COLOUR: wgpu::TextureFormat = wgpu::TextureFormat::R8Unorm;

/// A frame of the mesh pipeline, drawn by the GPU.
#[derive(Debug)]
pub struct GpuMeshFrame<'a> {
    frame: MeshFrame<'a>,
    /// By sample; `None` where nothing is to be drawn.
    uploaded: Vec<Option<Uploaded>>,
    /// Fragments that the last band needed.
    length: Cell<usize>,
}

impl<'a> GpuMeshFrame<'a> {
    /// Uploads `frame`.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`] for geometry that fits no buffer.
    pub fn new(gpu: &Gpu, frame: MeshFrame<'a>) -> Result<Self, GpuError> {
        let samples = 0..frame.sample_count() as usize;
        let uploaded = samples.map(|sample| Uploaded::new(gpu, &frame, sample)).collect::<Result<_, _>>()?;
        Ok(Self { frame, uploaded, length: Cell::new(0) })
    }

    /// As drawn with lists that have room for `length` fragments at first.
    #[must_use]
    pub fn with_first_length(self, length: usize) -> Self {
        self.length.set(length);
        self
    }

    fn draw_sample(&self, gpu: &Gpu, uploaded: &Uploaded, rect: PixelRect) -> Result<GpuLayers, GpuError> {
        let pixels = rect.area();
        let most = (gpu.largest_binding() as usize / std::mem::size_of::<Fragment>()).max(1);
        let mut room = match self.length.get() {
            0 => pixels * FIRST_FRAGMENTS_A_PIXEL,
            length => length,
        }
        .min(most);
        loop {
            let fragments = gpu.storage::<Fragment>("fragments", room)?;
            let (counts, length) = self.raster(gpu, uploaded, rect, &fragments)?;
            if length <= room {
                return self.resolve(gpu, uploaded, rect, &fragments, &counts, length);
            }
            if length > most {
                let needed = length as u64 * std::mem::size_of::<Fragment>() as u64;
                return Err(GpuError::TooLarge { what: "fragments".into(), needed, limit: gpu.largest_binding() });
            }
            room = length;
            self.length.set(length);
        }
    }

    /// Draws everything into `fragments`; returns the counts by pixel and the number of fragments, whether or not they had room.
    fn raster(
        &self,
        gpu: &Gpu,
        uploaded: &Uploaded,
        rect: PixelRect,
        fragments: &wgpu::Buffer,
    ) -> Result<(wgpu::Buffer, usize), GpuError> {
        let shader = shader(uploaded.words);
        // One more than there are pixels: sums need a last zero.
        let counts = gpu.storage::<u32>("counts", rect.area() + 1)?;
        let length = gpu.storage::<u32>("length", 1)?;
        let frame = gpu.uniform("frame", &uploaded.band(rect));
        let target = gpu.target("target", rect, NO_COLOUR)?;
        let mut commands = gpu.commands();
        let kinds = [
            (wgpu::PrimitiveTopology::TriangleList, 0, 3 * uploaded.triangles),
            (wgpu::PrimitiveTopology::PointList, 3 * uploaded.triangles, uploaded.fragments),
        ];
        let drawn: Vec<_> = kinds.into_iter().filter(|(.., vertices)| *vertices > 0).collect();
        {
            let mut pass = commands.encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("list"),
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view: &target,
                    depth_slice: None,
                    resolve_target: None,
                    ops: wgpu::Operations {
                        load: wgpu::LoadOp::Clear(wgpu::Color::BLACK),
                        store: wgpu::StoreOp::Discard,
                    },
                })],
                ..Default::default()
            });
            for &(topology, first, vertices) in &drawn {
                let pipeline = gpu.render(&shader, &format!("list {topology:?}"), |device, module| {
                    pipeline(device, module, topology)
                });
                let buffers = [(0, &frame), (3, &uploaded.surfaces), (4, &length), (5, &counts), (7, fragments)];
                pass.set_pipeline(&pipeline);
                pass.set_bind_group(0, &gpu.bind_layout(&pipeline.get_bind_group_layout(0), &buffers), &[]);
                pass.set_vertex_buffer(0, uploaded.corners.slice(..));
                pass.draw(first..first + vertices, 0..1);
            }
        }
        commands.count_pass(drawn.len() as u64, u64::from(uploaded.triangles));
        commands.submit();
        let length = gpu.download::<u32>(&length, 1)?[0] as usize;
        Ok((counts, length))
    }

    fn resolve(
        &self,
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
            (13, &uploaded.endless),
        ];
        commands.dispatch(&resolve, &gpu.bind(&resolve, &buffers), pixels);
        scan::exclusive(gpu, &mut commands, &kept, pixels + 1)?;
        commands.submit();
        let count = gpu.download_from::<u32>(&kept, 4 * pixels as u64, 1)?[0] as usize;
        let records = gpu.storage::<LayerRecord>("records", count)?;
        let mut commands = gpu.commands();
        let write = gpu.kernel(&shader, "write");
        let buffers = [
            (0, &frame),
            (2, &uploaded.slots),
            (3, &uploaded.surfaces),
            (6, counts),
            (8, &sorted),
            (10, &kept),
            (11, &records),
            (12, &uploaded.corners),
        ];
        commands.dispatch(&write, &gpu.bind(&write, &buffers), pixels);
        commands.submit();
        Ok(GpuLayers { rect, offsets: kept, records, count })
    }
}

fn pipeline(
    device: &wgpu::Device,
    module: &wgpu::ShaderModule,
    topology: wgpu::PrimitiveTopology,
) -> wgpu::RenderPipeline {
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("list"),
        layout: None,
        vertex: wgpu::VertexState {
            module,
            entry_point: Some("raster_vertex"),
            compilation_options: Default::default(),
            buffers: &[Some(corner_layout())],
        },
        primitive: wgpu::PrimitiveState { topology, ..Default::default() },
        depth_stencil: None,
        multisample: Default::default(),
        fragment: Some(wgpu::FragmentState {
            module,
            entry_point: Some("list_fragment"),
            compilation_options: Default::default(),
            targets: &[Some(wgpu::ColorTargetState {
                format: NO_COLOUR,
                blend: None,
                write_mask: wgpu::ColorWrites::empty(),
            })],
        }),
        multiview_mask: None,
        cache: None,
    })
}

/// Where a [`PlacedCorner`] has what the vertex stage reads.
pub(super) fn corner_layout() -> wgpu::VertexBufferLayout<'static> {
    const ATTRIBUTES: [wgpu::VertexAttribute; 2] = [
        wgpu::VertexAttribute {
            format: wgpu::VertexFormat::Float32x2,
            offset: std::mem::offset_of!(PlacedCorner, x) as u64,
            shader_location: 0,
        },
        wgpu::VertexAttribute {
            format: wgpu::VertexFormat::Uint32,
            offset: std::mem::offset_of!(PlacedCorner, surface) as u64,
            shader_location: 1,
        },
    ];
    wgpu::VertexBufferLayout {
        array_stride: std::mem::size_of::<PlacedCorner>() as u64,
        step_mode: wgpu::VertexStepMode::Vertex,
        attributes: &ATTRIBUTES,
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
        let empty = || GpuLayers::upload(gpu, &LayerTile::empty(rect));
        if let [only] = &self.uploaded[..] {
            return only.as_ref().map_or_else(empty, |uploaded| self.draw_sample(gpu, uploaded, rect));
        }
        let mut passes = Vec::new();
        for uploaded in self.uploaded.iter().flatten() {
            passes.push(self.draw_sample(gpu, uploaded, rect)?.download(gpu)?);
        }
        GpuLayers::upload(gpu, &merged(rect, &passes))
    }
}

/// What the samples of `rect` see, as records with sample masks.
fn merged(rect: PixelRect, passes: &[LayerTile]) -> LayerTile {
    let mut merged = LayerTile { rect, offsets: Vec::with_capacity(rect.area() + 1), boundaries: Vec::new() };
    merged.offsets.push(0);
    for y in rect.y0..rect.y1 {
        for x in rect.x0..rect.x1 {
            let mut merger = SampleMerger::default();
            passes.iter().for_each(|pass| merger.add(pass.at(x, y).iter().copied()));
            merged.boundaries.extend(merger.finish());
            merged.offsets.push(merged.boundaries.len() as u32);
        }
    }
    merged
}
