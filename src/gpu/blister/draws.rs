//! The render pipelines of the mesh pipeline: what is drawn is always the same, with another fragment stage.

use super::arrangement::{PlacedCorner, Uploaded};
use super::shader;
use crate::gpu::Gpu;

/// The format of the target that fragments are drawn over. Nothing is ever written to it.
pub(super) const NO_COLOUR: wgpu::TextureFormat = wgpu::TextureFormat::R8Unorm;

/// The depth buffer of peeling: all bits of an order.
pub(super) const DEPTH: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;

/// Triangles, and the fragments that no triangle has, which are drawn as points.
pub(super) const KINDS: [wgpu::PrimitiveTopology; 2] =
    [wgpu::PrimitiveTopology::TriangleList, wgpu::PrimitiveTopology::PointList];

/// The pipeline that hands what is drawn to `fragment`; where that writes depths, the greatest stays.
pub(super) fn pipeline(
    gpu: &Gpu,
    uploaded: &Uploaded,
    fragment: &'static str,
    topology: wgpu::PrimitiveTopology,
    has_depth: bool,
) -> wgpu::RenderPipeline {
    gpu.render(&shader(uploaded.traits), &format!("{fragment} {topology:?}"), |device, module| {
        device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some(fragment),
            layout: None,
            vertex: wgpu::VertexState {
                module,
                entry_point: Some("raster_vertex"),
                compilation_options: Default::default(),
                buffers: &[Some(corner_layout())],
            },
            primitive: wgpu::PrimitiveState { topology, ..Default::default() },
            depth_stencil: has_depth.then(|| wgpu::DepthStencilState {
                format: DEPTH,
                depth_write_enabled: Some(true),
                depth_compare: Some(wgpu::CompareFunction::Greater),
                stencil: Default::default(),
                bias: Default::default(),
            }),
            multisample: Default::default(),
            fragment: Some(wgpu::FragmentState {
                module,
                entry_point: Some(fragment),
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
    })
}

/// Where a [`PlacedCorner`] has what the vertex stage reads.
fn corner_layout() -> wgpu::VertexBufferLayout<'static> {
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

/// Begins a pass over `target`, and over `depth` from the far end.
pub(super) fn pass<'e>(
    encoder: &'e mut wgpu::CommandEncoder,
    label: &str,
    target: &wgpu::TextureView,
    depth: Option<&wgpu::TextureView>,
) -> wgpu::RenderPass<'e> {
    encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
        label: Some(label),
        color_attachments: &[Some(wgpu::RenderPassColorAttachment {
            view: target,
            depth_slice: None,
            resolve_target: None,
            ops: wgpu::Operations { load: wgpu::LoadOp::Clear(wgpu::Color::BLACK), store: wgpu::StoreOp::Discard },
        })],
        depth_stencil_attachment: depth.map(|view| wgpu::RenderPassDepthStencilAttachment {
            view,
            depth_ops: Some(wgpu::Operations { load: wgpu::LoadOp::Clear(0.0), store: wgpu::StoreOp::Store }),
            stencil_ops: None,
        }),
        ..Default::default()
    })
}
