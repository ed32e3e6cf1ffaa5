//! What a style changes of the layers: the twin of [`composite::recolour`](crate::composite::recolour).
//!
//! [`composite::section`](crate::composite::section)'s hatching is done in the same pass.
//!
//! *Practice.* The source keeps its records: it may hand them out again. The changed ones are another buffer.

use super::section::{stripes, with_hatching};
use super::view::{self, Band};
use crate::composite::Leaves;
use crate::composite::recolour::Recoloured;
use crate::gpu::layers::{GpuLayers, LayerRecord};
use crate::gpu::shader::Shader;
use crate::gpu::{Gpu, GpuError, scan};
use crate::gpu_struct;
use crate::layers::{LayerSource, LayerTile};
use crate::scene::style::{CutColour, Style};
use crate::space::{Camera, PixelRect};

gpu_struct! {
    /// What changes of every boundary.
    pub struct Changes {
        /// Linear RGB of cut faces.
        cut_colour: [f32; 3],
        /// Factor of opacities.
        opacity: f32,
        /// Linear RGB of hatching.
        hatch_ink: [f32; 3],
        /// Width of hatch lines, pixels.
        line_px: f32,
        /// Whose colour cut faces have: 0, `CUT_LEAF` or `CUT_SET`.
        cut: u32,
        /// Nearest boundaries that a sample keeps.
        most: u32,
        /// Fills the row.
        unused: [u32; 2],
    }
}

gpu_struct! {
    /// What the style knows of a leaf.
    pub struct LeafPaint {
        /// Linear RGB of its cut faces, where those have its colour.
        colour: [f32; 3],
        /// Bits: `KNOWS_COLOUR`, `KNOWS_CAP_COLOUR`, `IS_HEAVY`; and from `SECTION_SHIFT` on, where the leaf is a section, one
        /// more than which.
        known: u32,
        /// Linear RGB of its caps.
        cap_colour: [f32; 3],
        /// Among the leaves that are hatched: which hatching it has.
        rank: u32,
    }
}

/// Cut faces have the colour of the leaf that was cut…
const CUT_LEAF: u32 = 1;
/// …or one colour.
const CUT_SET: u32 = 2;
/// The leaf's colour is known.
const KNOWS_COLOUR: u32 = 1;
/// So is that of its caps.
const KNOWS_CAP_COLOUR: u32 = 16;
/// Bits from here on tell which section a leaf is.
const SECTION_SHIFT: u32 = 8;
/// The leaf's outline is drawn stronger.
const IS_HEAVY: u32 = 2;

/// The table of leaves, by index; at least one.
pub(super) fn leaf_table(leaves: &Leaves) -> Vec<LeafPaint> {
    let (caps, ranks, sections) = match leaves.hatching {
        Some(hatching) => (&hatching.colours[..], &hatching.ranks[..], &hatching.sections[..]),
        None => Default::default(),
    };
    let last_section = sections.iter().map(|section| section.leaf as usize + 1).max().unwrap_or(0);
    let counts = [leaves.colours.len(), leaves.heavy.len(), caps.len(), ranks.len(), last_section, 1];
    let paint = |leaf: usize| {
        let (colour, cap_colour) = (leaves.colours.get(leaf), caps.get(leaf));
        let bit = |is_set: bool, bit: u32| if is_set { bit } else { 0 };
        let section = sections.iter().position(|section| section.leaf as usize == leaf).map_or(0, |at| at as u32 + 1);
        LeafPaint {
            colour: colour.copied().unwrap_or_default(),
            known: bit(colour.is_some(), KNOWS_COLOUR)
                | bit(cap_colour.is_some(), KNOWS_CAP_COLOUR)
                | bit(leaves.heavy.get(leaf).copied().unwrap_or(false), IS_HEAVY)
                | section << SECTION_SHIFT,
            cap_colour: cap_colour.copied().unwrap_or_default(),
            rank: ranks.get(leaf).map_or(leaf, |rank| *rank) as u32,
        }
    };
    (0..counts.into_iter().max().unwrap_or(1)).map(paint).collect()
}

/// A source without layers: what a style changes of layers does not depend on them.
struct NoLayers<'a>(&'a Camera);

impl LayerSource for NoLayers<'_> {
    fn camera(&self) -> &Camera {
        self.0
    }

    fn samples(&self) -> u32 {
        1
    }

    fn draw(&self, rect: PixelRect) -> LayerTile {
        LayerTile::empty(rect)
    }
}

/// The kernels' module.
pub(super) fn shader() -> Shader {
    with_hatching(with_leaves(view::shader("recolour")))
        .with_constant("KNOWS_CAP_COLOUR", KNOWS_CAP_COLOUR)
        .with_constant("SECTION_SHIFT", SECTION_SHIFT)
        .with_constant("CUT_LEAF", CUT_LEAF)
        .with_constant("CUT_SET", CUT_SET)
        .with_struct::<LayerRecord>()
        .with_struct::<Changes>()
        .with_text(include_str!("../../../shaders/composite/section.wgsl"))
        .with_text(include_str!("../../../shaders/composite/recolour.wgsl"))
}

/// With what reads the table of leaves.
pub(super) fn with_leaves(shader: Shader) -> Shader {
    with_marks(shader).with_constant("KNOWS_COLOUR", KNOWS_COLOUR).with_struct::<LeafPaint>()
}

/// With the bits that are handed on from leaves.
pub(super) fn with_marks(shader: Shader) -> Shader {
    shader.with_constant("IS_HEAVY", IS_HEAVY)
}

/// What a style changes, ready for any band.
pub(super) struct Recolour {
    changes: wgpu::Buffer,
    stripes: wgpu::Buffer,
    is_limited: bool,
    changes_any: bool,
}

impl Recolour {
    /// What `style` changes of layers seen by `camera`.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`].
    pub fn new(gpu: &Gpu, camera: &Camera, style: &Style, leaves: &Leaves) -> Result<Self, GpuError> {
        let no_layers = NoLayers(camera);
        let recoloured = Recoloured::new(&no_layers, style, leaves.colours);
        let hatching = leaves.hatching.filter(|hatching| !hatching.is_empty());
        let (cut, cut_colour) = match recoloured.cut {
            CutColour::Cutter => (0, [0.0; 3]),
            CutColour::Leaf => (CUT_LEAF, [0.0; 3]),
            CutColour::Set(colour) => (CUT_SET, colour),
        };
        let changes = Changes {
            cut_colour,
            opacity: recoloured.opacity,
            hatch_ink: hatching.map_or([0.0; 3], |hatching| hatching.ink),
            line_px: hatching.map_or(0.0, |hatching| hatching.line_px as f32),
            cut,
            most: recoloured.max_layers.unwrap_or(u32::MAX),
            unused: [0; 2],
        };
        Ok(Self {
            changes: gpu.uniform("changes", &changes),
            stripes: gpu.upload("stripes", &stripes(hatching, camera))?,
            is_limited: recoloured.max_layers.is_some(),
            changes_any: !recoloured.is_plain() || hatching.is_some(),
        })
    }

    /// Changes the layers of `band`; `leaves` is the leaves' table.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`].
    pub fn apply(&self, gpu: &Gpu, band: &mut Band, leaves: &wgpu::Buffer) -> Result<(), GpuError> {
        if !self.changes_any {
            return Ok(());
        }
        let (shader, area) = (shader(), band.layers.rect.area());
        let GpuLayers { offsets, records, count, .. } = &band.layers;
        let both = [(1, offsets), (2, records), (3, &self.changes)];
        let mut commands = gpu.commands();
        let kept = if self.is_limited {
            let kept = gpu.storage::<u32>("kept offsets", area + 1)?;
            band.for_all(&mut commands, &shader, "count_kept", &[&both[..], &[(5, &kept)]].concat());
            scan::exclusive(gpu, &mut commands, &kept, area + 1)?;
            kept
        } else {
            offsets.clone()
        };
        let changed = gpu.storage::<LayerRecord>("changed records", *count)?;
        let others = [(4, leaves), (6, &kept), (7, &changed), (8, &self.stripes)];
        band.for_all(&mut commands, &shader, "recolour", &[&both[..], &others].concat());
        commands.submit();
        (band.layers.offsets, band.layers.records) = (kept, changed);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::layout::assert_same_layout;

    #[test]
    fn the_structs_are_the_shaders() {
        assert_same_layout::<Changes>();
        assert_same_layout::<LeafPaint>();
    }
}
