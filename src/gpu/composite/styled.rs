//! Any style, from any source on the GPU: the twin of [`composite::styled`](crate::composite::styled()).

use super::layered::{self, Canvas};
use super::occlusion::Occlusion;
use super::recolour::{Recolour, leaf_table};
use super::shaded::{self, Covered, Paints};
use super::shadow::Shadows;
use super::sketchy::Sketcher;
use super::strokes::{Lines, no_inks};
use super::view::{Band, FAR};
use crate::composite::styled::is_plain;
use crate::composite::{Leaves, Look, Picture};
use crate::gpu::layers::{GpuLayerSource, in_parts};
use crate::gpu::{Gpu, GpuError};
use crate::scene::style::{Style, StyleKind};
use crate::space::PixelRect;

/// Pixels on a side of a band: about as many in it as the CPU's strips have.
const BAND_SIDE: u32 = 1024;

/// What is the same in all bands of a frame.
struct Frame<'a, 's> {
    gpu: &'a Gpu,
    source: &'a dyn GpuLayerSource,
    is_plain: bool,
    paints: wgpu::Buffer,
    leaves: wgpu::Buffer,
    recolour: Recolour,
    lines: Option<Lines>,
    occlusion: Option<Occlusion>,
    sketcher: Option<Sketcher>,
    shadows: Option<&'a Shadows<'s>>,
}

/// The pixels of a part of the picture, row by row.
struct Part {
    pixels: Vec<[f32; 4]>,
    /// None in plain styles.
    depth: Option<Vec<f32>>,
    covered: u32,
}

/// Draws `source` as `style` says: the same picture as the CPU's of the same layers, but for rounding. What a
/// device says of its commands is heard by who runs this inside of [`Gpu::checked`].
///
/// # Errors
/// What befell the device; [`GpuError::TooLarge`] where the layers around a single pixel fit no buffer.
pub fn styled(
    gpu: &Gpu,
    source: &dyn GpuLayerSource,
    look: &Look,
    style: &Style,
    leaves: Leaves,
) -> Result<Picture, GpuError> {
    styled_with(gpu, source, look, style, leaves, None)
}

/// As [`styled`], with `shadows` of the result.
///
/// # Errors
/// Those of [`styled`].
pub fn styled_with(
    gpu: &Gpu,
    source: &dyn GpuLayerSource,
    look: &Look,
    style: &Style,
    leaves: Leaves,
    shadows: Option<&Shadows>,
) -> Result<Picture, GpuError> {
    let shadows = shadows.filter(|_| style.shadow_strength().is_some());
    let camera = source.camera();
    let (width, height) = (camera.width, camera.height);
    let frame = Frame {
        gpu,
        source,
        is_plain: is_plain(style, leaves) && shadows.is_none(),
        shadows,
        paints: gpu.uniform("paints", &Paints::new(camera, look, style)),
        leaves: gpu.upload("leaves", &leaf_table(&leaves))?,
        recolour: Recolour::new(gpu, camera, style, &leaves)?,
        lines: Lines::new(gpu, style, leaves.heavy.contains(&true)),
        occlusion: style.hollow_shade().map(|strength| Occlusion::new(gpu, camera, strength)).transpose()?,
        sketcher: (style.kind == StyleKind::Sketchy).then(|| Sketcher::new(&style.sketch)),
    };
    let area = width as usize * height as usize;
    let mut picture = Picture {
        width,
        height,
        pixels: vec![look.background; area],
        depth: (!frame.is_plain).then(|| vec![f32::INFINITY; area]),
        covered: 0,
        has_alpha: look.background[3] < 1.0,
    };
    for rect in PixelRect::tiles(width, height, BAND_SIDE) {
        in_parts(rect, &mut |rect| {
            if let Some(part) = frame.part(rect)? {
                put(&mut picture, rect, &part);
            }
            Ok(())
        })?;
    }
    Ok(picture)
}

impl Frame<'_, '_> {
    /// How far from a pixel the layers are that its picture depends on, in columns and rows.
    fn reach_px(&self) -> u32 {
        let lines = self.lines.as_ref().map_or(0, |lines| lines.reach_px);
        let hand = self.sketcher.as_ref().map_or(0, |sketcher| sketcher.reach_px);
        let neighbours = self.occlusion.as_ref().map_or(0, |occlusion| occlusion.reach_px);
        (hand + lines).max(neighbours)
    }

    /// The pixels of `rect`; `None` where nothing is.
    fn part(&self, rect: PixelRect) -> Result<Option<Part>, GpuError> {
        let (gpu, area) = (self.gpu, rect.area());
        let mut band = Band::draw(gpu, self.source, rect, self.reach_px())?;
        if band.layers.count == 0 {
            return Ok(None);
        }
        self.recolour.apply(gpu, &mut band, &self.leaves)?;
        let pixels = gpu.storage::<[f32; 4]>("pixels", area)?;
        let mut commands = gpu.commands();
        let covered = Covered::new(gpu, &band)?;
        let depths = if self.is_plain {
            shaded::blend(&mut commands, &band, self.source.samples(), &self.paints, &pixels, &covered);
            commands.submit();
            None
        } else {
            covered.count(&mut commands, &band);
            commands.submit();
            let canvas = Canvas { pixels: pixels.clone(), depths: gpu.storage::<f32>("depths", area)? };
            self.layers(&band, &canvas)?;
            Some(canvas.depths)
        };
        Ok(Some(Part {
            pixels: gpu.download(&pixels, area)?,
            depth: depths.map(|depths| gpu.download(&depths, area)).transpose()?,
            covered: covered.sum(gpu, &band)?,
        }))
    }

    /// Draws layers with what lies over and around them.
    fn layers(&self, band: &Band, canvas: &Canvas) -> Result<(), GpuError> {
        let gpu = self.gpu;
        let inks = match &self.lines {
            Some(lines) => lines.inks(gpu, band, self.source.samples(), &self.leaves)?,
            None => no_inks(gpu, band)?,
        };
        // A hand looks at surfaces around the part too.
        let of_all = self.sketcher.is_some();
        let kept_off = self.shadows.map(|shadows| shadows.fall_on(gpu, self.source, band, of_all)).transpose()?;
        let mut commands = gpu.commands();
        let surfaces = layered::surfaces(gpu, &mut commands, band, &self.paints, of_all, kept_off.as_ref())?;
        if let Some(occlusion) = &self.occlusion {
            occlusion.darken(gpu, &mut commands, band, &surfaces)?;
        }
        if let Some(sketcher) = &self.sketcher {
            commands.submit();
            return sketcher.draw(gpu, band, &self.paints, &surfaces, &inks, canvas);
        }
        layered::compose(&mut commands, band, &self.paints, &surfaces, &inks, canvas);
        commands.submit();
        Ok(())
    }
}

/// Puts the pixels of `rect` into their places.
fn put(picture: &mut Picture, rect: PixelRect, part: &Part) {
    let (across, width) = (rect.width() as usize, picture.width as usize);
    for row in 0..rect.height() as usize {
        let from = row * across..(row + 1) * across;
        let to = (rect.y0 as usize + row) * width + rect.x0 as usize;
        picture.pixels[to..to + across].copy_from_slice(&part.pixels[from.clone()]);
        if let (Some(depths), Some(of_part)) = (&mut picture.depth, &part.depth) {
            let shown = |depth: &f32| if *depth < FAR { *depth } else { f32::INFINITY };
            depths[to..to + across].iter_mut().zip(of_part[from].iter()).for_each(|(to, depth)| *to = shown(depth));
        }
    }
    picture.covered += u64::from(part.covered);
}
