//! Shadows: the twin of [`composite::shadow`](crate::composite::shadow).
//!
//! *Practice.* The boundaries of a band tell, by size of texels, from where to where on the light's grid they ask; that much comes
//! back to the CPU, and the pipeline draws these parts of the grid, block by block and halved where they are too large. Each part
//! is asked by all boundaries of its size of texels, which add up what it keeps of their light. Nothing of the grid is kept for the
//! next band. Places are found in 32 bits, from where the camera's axis passes the scene: they
//! are as exact as the depths that they are made of.

use std::cell::{Cell, RefCell};

use super::view::{self, Band, Bound};
use crate::composite::light_frames::LightFrames;
use crate::composite::light_grid::{BLOCK_TILES, BlockView, LEVELS, LightBlock, LightGrid, SIDE, STEPS};
use crate::composite::shadow::{DEPTH_ROUNDING, LEAST_SHARE, LEAST_SINE, MOST_TEXELS, PER_REACH, TOLERANCE};
use crate::gpu::layers::{GpuLayerSource, LayerRecord, in_parts};
use crate::gpu::shader::Shader;
use crate::gpu::{Gpu, GpuError};
use crate::gpu_struct;
use crate::layers::sample_offsets;
use crate::space::{Camera, PixelRect};

gpu_struct! {
    /// The light's grid, seen from the camera.
    pub struct LightView {
        /// Unit vector along columns, world space.
        right: [f32; 3],
        /// Factor of the opacities of what throws shadows.
        opacity: f32,
        /// Along rows.
        down: [f32; 3],
        /// 0 to 1: how much of the light shadows keep off.
        strength: f32,
        /// From the light on.
        forward: [f32; 3],
        /// The power of √2 that the side of the finest texel is.
        least_level: i32,
        /// Where on the grid the middle of the picture is at `depth`, world units.
        at_depth: [f32; 3],
        /// That of the grid's middle, seen from the camera.
        depth: f32,
        /// The pixels whose boundaries are counted: first column and row, and how many of each.
        counted: [u32; 4],
    }
}

gpu_struct! {
    /// A boundary as a receiver of light; lengths in texels where nothing else is said.
    pub struct Receiver {
        /// On the grid.
        at: [f32; 2],
        /// World units.
        depth: f32,
        /// The side of a texel, world units.
        texel: f32,
        /// The pixel's two sides on the tangent plane.
        sides: [f32; 4],
        /// Unit vector along the grid's axes, towards the light.
        normal: [f32; 3],
        /// What stands less over the tangent plane is the surface itself.
        tolerance: f32,
        /// How much coarser its texels are than the finest, in powers of √2; −1 where the light does not fall on it.
        level: i32,
        /// One over the sum of the weights of its texels.
        per_weight: f32,
        /// 1 where texels are larger than the pixel, else 0.
        is_coarse: u32,
        /// Fills the row.
        unused: u32,
    }
}

gpu_struct! {
    /// A part of the light's grid.
    pub struct LightPatch {
        /// Column and row of its first texel.
        corner: [i32; 2],
        /// Columns and rows.
        size: [u32; 2],
        /// That of its texels, as receivers have it.
        level: i32,
        /// Fills the row, with the next.
        unused: u32,
        /// Fills the row.
        unused_too: [u32; 2],
    }
}

/// All of the light in whole steps: sums of shares are the same in any order.
const LIGHT_STEPS: f32 = 16_777_216.0;

/// What draws the scene for a camera of the light, as [`composite::light_map::DrawLight`](crate::composite::light_map::DrawLight)
/// does on the CPU. `None` where that failed, of which the caller knows more.
pub type DrawLight<'a> = dyn Fn(&Camera) -> Result<Option<Box<dyn GpuLayerSource + 'a>>, GpuError> + 'a;

/// Frames that are ready; `None` where that failed.
type Frames<'a> = LightFrames<Option<Box<dyn GpuLayerSource + 'a>>>;

/// What keeps the light from boundaries.
pub struct Shadows<'a> {
    grid: LightGrid,
    opacity: f32,
    strength: f32,
    draw: &'a DrawLight<'a>,
    frames: RefCell<Frames<'a>>,
    texels: Cell<u64>,
    coarse: Cell<u64>,
}

impl<'a> Shadows<'a> {
    /// Shadows on `grid`, drawn by `draw`, of what stops the light by its opacity times `opacity`; of `strength` 1 they keep all of
    /// the light off.
    pub fn new(grid: LightGrid, opacity: f32, strength: f32, draw: &'a DrawLight<'a>) -> Self {
        let (frames, texels, coarse) = Default::default();
        Self { grid, opacity, strength: strength.clamp(0.0, 1.0), draw, frames, texels, coarse }
    }

    /// Texels drawn so far.
    pub fn texels(&self) -> u64 {
        self.texels.get()
    }

    /// Boundaries so far whose texels are larger than their pixel.
    pub fn coarse(&self) -> u64 {
        self.coarse.get()
    }

    /// By boundary of `band`, seen as `source` is, or of its part alone, what share of the light is kept off, in [`LIGHT_STEPS`].
    ///
    /// # Errors
    /// [`GpuError::TooLarge`] where the band has too many boundaries, or the light sees too much at a single texel. Else what befell
    /// the device.
    pub(super) fn fall_on(
        &self,
        gpu: &Gpu,
        source: &dyn GpuLayerSource,
        band: &Band,
        of_all: bool,
    ) -> Result<wgpu::Buffer, GpuError> {
        let (shader, layers) = (shader(), &band.layers);
        let (camera, samples) = (source.camera(), source.samples());
        let receivers = gpu.storage::<Receiver>("receivers", layers.count)?;
        let kept_off = gpu.storage::<u32>("light kept off", layers.count)?;
        let none: [i32; 4] = [i32::MAX, i32::MAX, i32::MIN, i32::MIN];
        let nothing: Vec<i32> = none.into_iter().cycle().take(4 * LEVELS as usize).chain([0]).collect();
        let asked = gpu.upload("texels asked for", &nothing)?;
        let light = gpu.uniform("light", &self.view_of(camera, band.part));
        let places = sample_offsets(samples).iter().map(|place| place.as_vec2().to_array());
        let places = gpu.upload("places of samples", &places.collect::<Vec<_>>())?;
        let run = |entry: &'static str, buffers: &[Bound]| {
            let mut commands = gpu.commands();
            if of_all {
                band.for_all(&mut commands, &shader, entry, buffers);
            } else {
                band.for_part(&mut commands, &shader, entry, buffers);
            }
            commands.submit();
        };
        let of_band = [(1, &layers.offsets), (3, &light), (4, &receivers)];
        run("receive", &[&of_band[..], &[(2, &layers.records), (5, &asked), (6, &places)]].concat());
        let asked: Vec<i32> = gpu.download(&asked, nothing.len())?;
        let mut asked_of = Vec::new();
        for (level, range) in asked.chunks_exact(4).enumerate().take(LEVELS as usize) {
            let &[x0, y0, x1, y1] = range else { continue };
            if x0 > x1 || y0 > y1 {
                continue;
            }
            let grid_level = self.grid.least_level() + level as i32;
            asked_of.extend(self.blocks(grid_level, [x0, y0], [x1, y1]));
        }
        let mut frames = self.frames.borrow_mut();
        asked_of.sort_by_key(|(block, ..)| !frames.is_ready(*block));
        for (block, view, rect) in asked_of {
            let Some(source) = frames.get(block, || (self.draw)(&view.camera))? else { continue };
            in_parts(rect, &mut |rect| {
                let seen = source.draw(gpu, rect)?;
                self.texels.set(self.texels.get() + rect.area() as u64);
                if seen.count == 0 {
                    return Ok(());
                }
                let patch = LightPatch {
                    corner: [view.corner[0] + rect.x0 as i32, view.corner[1] + rect.y0 as i32],
                    size: [rect.width(), rect.height()],
                    level: block.level - self.grid.least_level(),
                    unused: 0,
                    unused_too: [0; 2],
                };
                let patch = gpu.uniform("patch of light", &patch);
                let of_light = [(7, &kept_off), (8, &seen.offsets), (9, &seen.records), (10, &patch)];
                run("shade", &[&of_band[..], &of_light].concat());
                Ok(())
            })?;
        }
        // Not before: a band that is too large comes again in parts.
        self.coarse.set(self.coarse.get() + asked[4 * LEVELS as usize] as u64);
        Ok(kept_off)
    }

    /// For `camera`; what it sees in `part` is counted.
    fn view_of(&self, camera: &Camera, part: PixelRect) -> LightView {
        let LightGrid { right, down, forward, .. } = self.grid;
        // From there on lengths are those of the scene, however far away the eye is.
        let depth = camera.view_from_world(self.grid.centre()).z as f32;
        let at_depth = self.grid.on_grid(camera.eye + camera.forward * f64::from(depth));
        LightView {
            right: right.as_vec3().to_array(),
            opacity: self.opacity,
            down: down.as_vec3().to_array(),
            strength: self.strength,
            forward: forward.as_vec3().to_array(),
            least_level: self.grid.least_level(),
            at_depth: at_depth.as_vec3().to_array(),
            depth,
            counted: [part.x0, part.y0, part.width(), part.height()],
        }
    }

    /// The blocks with texels from column and row `first` to `last`, and where in their pictures those are.
    fn blocks(&self, level: i32, first: [i32; 2], last: [i32; 2]) -> Vec<(LightBlock, BlockView, PixelRect)> {
        let side = BLOCK_TILES * SIDE as i32;
        let [x0, y0] = first.map(|at| at.div_euclid(side));
        let [x1, y1] = last.map(|at| at.div_euclid(side));
        let part = |(x, y): (i32, i32)| {
            let block = LightBlock { level, x, y };
            let view = self.grid.view(block)?;
            let within = |at: i32, corner: i32, size: u32| (at - corner).clamp(0, size as i32) as u32;
            let rect = PixelRect {
                x0: within(first[0], view.corner[0], view.camera.width),
                y0: within(first[1], view.corner[1], view.camera.height),
                x1: within(last[0] + 1, view.corner[0], view.camera.width),
                y1: within(last[1] + 1, view.corner[1], view.camera.height),
            };
            (rect.x0 < rect.x1 && rect.y0 < rect.y1).then_some((block, view, rect))
        };
        (y0..=y1).flat_map(|y| (x0..=x1).map(move |x| (x, y))).filter_map(part).collect()
    }
}

/// The kernels' module.
pub(super) fn shader() -> Shader {
    view::shader("shadow")
        .with_constant("TOLERANCE", TOLERANCE as f32)
        .with_constant("DEPTH_ROUNDING", DEPTH_ROUNDING as f32)
        .with_constant("LEAST_SHARE", LEAST_SHARE as f32)
        .with_constant("LEAST_SINE", LEAST_SINE as f32)
        .with_constant("PER_REACH", PER_REACH)
        .with_constant("MOST_TEXELS", MOST_TEXELS as f32)
        .with_constant("STEPS", STEPS as f32)
        .with_constant("LEVELS", LEVELS)
        .with_constant("TINY", f32::MIN_POSITIVE)
        .with_constant("LIGHT_STEPS", LIGHT_STEPS)
        .with_struct::<LayerRecord>()
        .with_struct::<LightView>()
        .with_struct::<Receiver>()
        .with_struct::<LightPatch>()
        .with_text(include_str!("../../../shaders/composite/shadow.wgsl"))
}

/// With what takes from surfaces the light that is kept off them.
pub(super) fn with_light_steps(shader: Shader) -> Shader {
    shader.with_constant("LIGHT_STEPS", LIGHT_STEPS)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::layout::assert_same_layout;

    #[test]
    fn the_structs_are_the_shaders() {
        assert_same_layout::<LightView>();
        assert_same_layout::<Receiver>();
        assert_same_layout::<LightPatch>();
    }
}
