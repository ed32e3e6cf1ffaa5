//! The layer stack on the GPU: the records of [`layers`](crate::layers) in buffers, band by band.
//!
//! *Practice.* A band is any rectangle of the picture. Its records stand in pixel order, front to back within a pixel, as in a
//! [`LayerTile`]; whoever wants a band that fits no buffer gets [`GpuError::TooLarge`] and asks for its halves.

use super::device::{Gpu, GpuError};
use crate::gpu_struct;
use crate::layers::{Boundary, Facing, LayerSource, LayerStack, LayerTile};
use crate::space::{Camera, PixelRect};

gpu_struct! {
    /// A [`Boundary`], as buffers hold it.
    pub struct LayerRecord {
        /// Unit normal of the result, world space.
        normal: [f32; 3],
        /// Planar view depth, world units.
        depth: f32,
        /// Linear RGB, unlit.
        colour: [f32; 3],
        /// 0 to 1.
        opacity: f32,
        /// Index into the scene's leaves.
        leaf: u32,
        /// The leaf whose material lies behind.
        body: u32,
        /// 1 where the ray enters the result, −1 where it leaves.
        facing: i32,
        /// A bit for each sample of the pixel that sees it.
        samples: u32,
    }
}

impl From<&Boundary> for LayerRecord {
    fn from(boundary: &Boundary) -> Self {
        Self {
            normal: boundary.normal.to_array(),
            depth: boundary.depth,
            colour: boundary.colour,
            opacity: boundary.opacity,
            leaf: boundary.leaf,
            body: boundary.body,
            facing: boundary.facing as i32,
            samples: u32::from(boundary.samples),
        }
    }
}

impl From<&LayerRecord> for Boundary {
    fn from(record: &LayerRecord) -> Self {
        Self {
            depth: record.depth,
            normal: record.normal.into(),
            colour: record.colour,
            opacity: record.opacity,
            leaf: record.leaf,
            body: record.body,
            facing: if record.facing > 0 { Facing::Front } else { Facing::Back },
            samples: record.samples as u16,
        }
    }
}

/// The boundaries of one band, on the GPU.
#[derive(Debug, Clone)]
pub struct GpuLayers {
    /// Which pixels.
    pub rect: PixelRect,
    /// `area() + 1` numbers: where each pixel's records begin, pixels row by row.
    pub offsets: wgpu::Buffer,
    /// The records, [`LayerRecord`].
    pub records: wgpu::Buffer,
    /// How many records there are.
    pub count: usize,
}

impl GpuLayers {
    /// What the CPU drew.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`].
    pub fn upload(gpu: &Gpu, tile: &LayerTile) -> Result<Self, GpuError> {
        let records: Vec<LayerRecord> = tile.boundaries.iter().map(LayerRecord::from).collect();
        Ok(Self {
            rect: tile.rect,
            offsets: gpu.upload("offsets", &tile.offsets)?,
            records: gpu.upload("records", &records)?,
            count: records.len(),
        })
    }

    /// For the CPU to draw with.
    ///
    /// # Errors
    /// [`GpuError::Lost`].
    pub fn download(&self, gpu: &Gpu) -> Result<LayerTile, GpuError> {
        let records: Vec<LayerRecord> = gpu.download(&self.records, self.count)?;
        Ok(LayerTile {
            rect: self.rect,
            offsets: gpu.download(&self.offsets, self.rect.area() + 1)?,
            boundaries: records.iter().map(Boundary::from).collect(),
        })
    }
}

/// A pipeline on the GPU, ready to draw one frame: the twin of [`LayerSource`].
pub trait GpuLayerSource {
    /// The camera, with the picture's size.
    fn camera(&self) -> &Camera;
    /// Samples a pixel.
    fn samples(&self) -> u32;
    /// The boundaries of `rect`, which lies within the picture. The same bits whenever this `rect` is asked for. A pixel of another one
    /// may differ where triangles are rasterised, by the rounding of the device's viewport: on the common edge of two triangles it may
    /// take the other one, and on a silhouette come or go.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`] where the rectangle has too many records, or too much went into them, for one buffer: ask for its
    /// parts. Else what befell the device.
    fn draw(&self, gpu: &Gpu, rect: PixelRect) -> Result<GpuLayers, GpuError>;
}

/// A pipeline of the CPU as one of the GPU: what it draws is uploaded.
#[derive(Debug)]
pub struct Uploaded<S>(pub S);

impl<S: LayerSource> GpuLayerSource for Uploaded<S> {
    fn camera(&self) -> &Camera {
        self.0.camera()
    }

    fn samples(&self) -> u32 {
        self.0.samples()
    }

    fn draw(&self, gpu: &Gpu, rect: PixelRect) -> Result<GpuLayers, GpuError> {
        GpuLayers::upload(gpu, &drawn(&self.0, rect))
    }
}

/// All layers of a frame, for the CPU to draw with.
///
/// # Errors
/// Those of [`GpuLayerSource::draw`].
pub fn collect(gpu: &Gpu, source: &dyn GpuLayerSource) -> Result<LayerStack, GpuError> {
    let camera = source.camera();
    let mut parts = Vec::new();
    let mut draw = |rect| {
        parts.push(source.draw(gpu, rect)?.download(gpu)?);
        Ok(())
    };
    in_parts(PixelRect { x0: 0, y0: 0, x1: camera.width, y1: camera.height }, &mut draw)?;
    Ok(LayerStack::collect(&Parts { camera: camera.clone(), samples: source.samples(), parts }))
}

/// A frame in parts of any size.
struct Parts {
    camera: Camera,
    samples: u32,
    parts: Vec<LayerTile>,
}

impl LayerSource for Parts {
    fn camera(&self) -> &Camera {
        &self.camera
    }

    fn samples(&self) -> u32 {
        self.samples
    }

    fn draw(&self, rect: PixelRect) -> LayerTile {
        let holds = |part: &PixelRect, x: u32, y: u32| part.x0 <= x && x < part.x1 && part.y0 <= y && y < part.y1;
        let mut tile = LayerTile { rect, offsets: Vec::with_capacity(rect.area() + 1), boundaries: Vec::new() };
        tile.offsets.push(0);
        for y in rect.y0..rect.y1 {
            for x in rect.x0..rect.x1 {
                let part = self.parts.iter().find(|part| holds(&part.rect, x, y));
                part.into_iter().for_each(|part| tile.boundaries.extend_from_slice(part.at(x, y)));
                tile.offsets.push(tile.boundaries.len() as u32);
            }
        }
        tile
    }
}

/// `rect` of a source of the CPU, its tiles in parallel.
fn drawn(source: &dyn LayerSource, rect: PixelRect) -> LayerTile {
    use rayon::prelude::*;
    let tiles = crate::layers::TILE_SIDE;
    let columns: Vec<(u32, u32)> = (rect.x0 / tiles..=(rect.x1 - 1) / tiles)
        .map(|column| ((column * tiles).max(rect.x0), ((column + 1) * tiles).min(rect.x1)))
        .collect();
    let rows: Vec<(u32, u32)> = (rect.y0 / tiles..=(rect.y1 - 1) / tiles)
        .map(|row| ((row * tiles).max(rect.y0), ((row + 1) * tiles).min(rect.y1)))
        .collect();
    let rects: Vec<PixelRect> =
        rows.iter().flat_map(|&(y0, y1)| columns.iter().map(move |&(x0, x1)| PixelRect { x0, y0, x1, y1 })).collect();
    let parts: Vec<LayerTile> = rects.into_par_iter().map(|part| source.draw(part)).collect();
    let mut whole = LayerTile { rect, offsets: Vec::with_capacity(rect.area() + 1), boundaries: Vec::new() };
    whole.offsets.push(0);
    for of_row in parts.chunks(columns.len()) {
        for y in of_row[0].rect.y0..of_row[0].rect.y1 {
            for part in of_row {
                for x in part.rect.x0..part.rect.x1 {
                    whole.boundaries.extend_from_slice(part.at(x, y));
                    whole.offsets.push(whole.boundaries.len() as u32);
                }
            }
        }
    }
    whole
}

/// Calls `draw` for `rect`, or for its halves where it is too large for the device's buffers, until each part fits.
///
/// # Errors
/// Those of `draw`; [`GpuError::TooLarge`] where a single pixel does not fit.
pub fn in_parts(rect: PixelRect, draw: &mut dyn FnMut(PixelRect) -> Result<(), GpuError>) -> Result<(), GpuError> {
    if rect.area() == 0 {
        return Ok(());
    }
    match draw(rect) {
        Err(GpuError::TooLarge { .. }) if rect.area() > 1 => {
            let (first, second) = halves(rect);
            in_parts(first, draw)?;
            in_parts(second, draw)
        }
        result => result,
    }
}

/// Rows apart, or columns where there are few rows: a band of rows has the least border.
fn halves(rect: PixelRect) -> (PixelRect, PixelRect) {
    /// Bands get no flatter than this.
    const MOST_FLAT: u32 = 64;
    if rect.height() > 1 && rect.width() / rect.height() < MOST_FLAT {
        let y = rect.y0 + rect.height() / 2;
        (PixelRect { y1: y, ..rect }, PixelRect { y0: y, ..rect })
    } else {
        let x = rect.x0 + rect.width() / 2;
        (PixelRect { x1: x, ..rect }, PixelRect { x0: x, ..rect })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_struct_is_the_shaders() {
        crate::gpu::layout::assert_same_layout::<LayerRecord>();
    }

    #[test]
    fn what_is_too_large_is_drawn_in_parts_that_cover_it_once() {
        let whole = PixelRect { x0: 3, y0: 5, x1: 40, y1: 21 };
        for most in [1, 2, 7, 100, 10_000] {
            let mut seen = vec![0; 50 * 50];
            let mut draw = |rect: PixelRect| {
                if rect.area() > most {
                    return Err(GpuError::TooLarge { what: "it".into(), needed: 0, limit: 0 });
                }
                for y in rect.y0..rect.y1 {
                    (rect.x0..rect.x1).for_each(|x| seen[(y * 50 + x) as usize] += 1);
                }
                Ok(())
            };
            in_parts(whole, &mut draw).unwrap();
            let within = |at: usize| (3..40).contains(&(at % 50)) && (5..21).contains(&(at / 50));
            assert!(seen.iter().enumerate().all(|(at, count)| *count == i32::from(within(at))));
        }
    }
}
