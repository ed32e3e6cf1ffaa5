//! Several sources of layers as one, on the GPU: the twin of [`crate::layers::merged`].
//!
//! *Practice.* The sources draw a band one after the other, and what they drew is put into one buffer: a kernel has eight, and
//! there may be hundreds of products. Where a pixel's records begin is the sum of where each source's do, so one pass over the pixels
//! merges them all.

use super::device::{Gpu, GpuError};
use super::layers::{GpuLayerSource, GpuLayers, LayerRecord};
use super::shader::Shader;
use crate::gpu_struct;
use crate::layers::LayerTile;
use crate::space::{Camera, PixelRect};

gpu_struct! {
    /// How much there is to merge.
    struct Merging {
        /// Of the band.
        pixels: u32,
        /// Two at least.
        sources: u32,
    }
}

/// The kernel's module.
pub(super) fn shader() -> Shader {
    Shader::new("merged layers")
        .with_struct::<LayerRecord>()
        .with_struct::<Merging>()
        .with_text(include_str!("../../shaders/merged.wgsl"))
}

/// The layers of several sources, which share one camera and one number of samples.
pub struct GpuMergedLayers<'a> {
    camera: Camera,
    samples: u32,
    sources: Vec<Box<dyn GpuLayerSource + 'a>>,
}

impl<'a> GpuMergedLayers<'a> {
    /// Of `sources`, all of `camera` and with `samples` samples a pixel; without any, the picture is empty.
    pub fn new(camera: Camera, samples: u32, sources: Vec<Box<dyn GpuLayerSource + 'a>>) -> Self {
        debug_assert!(sources.iter().all(|source| *source.camera() == camera && source.samples() == samples));
        Self { camera, samples, sources }
    }
}

impl GpuLayerSource for GpuMergedLayers<'_> {
    fn camera(&self) -> &Camera {
        &self.camera
    }

    fn samples(&self) -> u32 {
        self.samples
    }

    fn draw(&self, gpu: &Gpu, rect: PixelRect) -> Result<GpuLayers, GpuError> {
        let mut layers = Vec::new();
        for source in &self.sources {
            let drawn = source.draw(gpu, rect)?;
            if drawn.count > 0 {
                layers.push(drawn);
            }
        }
        match layers.len() {
            0 => GpuLayers::upload(gpu, &LayerTile::empty(rect)),
            1 => Ok(layers.swap_remove(0)),
            _ => merged(gpu, rect, &layers),
        }
    }
}

/// The records of `layers`, two or more, all of `rect`.
fn merged(gpu: &Gpu, rect: PixelRect, layers: &[GpuLayers]) -> Result<GpuLayers, GpuError> {
    const RECORD: u64 = std::mem::size_of::<LayerRecord>() as u64;
    const WORD: u64 = std::mem::size_of::<u32>() as u64;
    let (pixels, sources) = (rect.area(), layers.len());
    let count = layers.iter().map(|layers| layers.count).sum();
    let starts = gpu.storage::<u32>("offsets of all sources", sources * (pixels + 1))?;
    let records = gpu.storage::<LayerRecord>("records of all sources", count)?;
    let queues = gpu.storage::<[u32; 2]>("queues of sources", sources * pixels)?;
    let offsets = gpu.storage::<u32>("offsets", pixels + 1)?;
    let merged = gpu.storage::<LayerRecord>("records", count)?;
    let unfinished = gpu.storage::<u32>("unfinished", 1)?;
    let mut commands = gpu.commands();
    let mut firsts: Vec<u32> = Vec::with_capacity(sources);
    let mut first = 0;
    for (source, layers) in layers.iter().enumerate() {
        let words = WORD * (pixels as u64 + 1);
        commands.encoder.copy_buffer_to_buffer(&layers.offsets, 0, &starts, source as u64 * words, words);
        let bytes = RECORD * layers.count as u64;
        commands.encoder.copy_buffer_to_buffer(&layers.records, 0, &records, RECORD * u64::from(first), bytes);
        firsts.push(first);
        // All of them fit one buffer.
        first += layers.count as u32;
    }
    let merging = gpu.uniform("merging", &Merging { pixels: pixels as u32, sources: sources as u32 });
    let firsts = gpu.upload("first records of sources", &firsts)?;
    let kernel = gpu.kernel(&shader(), "merge_layers");
    let buffers = [
        (0, &merging),
        (1, &starts),
        (2, &firsts),
        (3, &records),
        (4, &queues),
        (5, &offsets),
        (6, &merged),
        (7, &unfinished),
    ];
    commands.dispatch(&kernel, &gpu.bind(&kernel, &buffers), pixels + 1);
    commands.submit();
    if gpu.download::<u32>(&unfinished, 1)? != [0] {
        return Err(GpuError::CutShort);
    }
    Ok(GpuLayers { rect, offsets, records: merged, count })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_struct_is_the_shaders() {
        crate::gpu::layout::assert_same_layout::<Merging>();
    }
}
