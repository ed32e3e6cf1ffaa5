//! Any style, from any source.

use super::layered::layered;
use super::occlusion::occluded;
use super::recolour::Recoloured;
use super::shaded::shaded;
use super::sketchy::sketchy;
use super::{Look, Picture};
use crate::layers::LayerSource;
use crate::scene::style::{Style, StyleKind};

/// What styles know of leaves beside their boundaries, by leaf index; leaves beyond the end have nothing of it.
#[derive(Debug, Clone, Copy, Default)]
pub struct Leaves<'a> {
    /// Linear RGB, for cut faces in the colour of what was cut.
    pub colours: &'a [[f32; 3]],
    /// Whether the leaf's outline is drawn stronger, as a section's is.
    pub heavy: &'a [bool],
}

/// Draws `source` as `style` says. The same bits on any number of threads. `on_tile` is called once for each tile drawn, from
/// any thread.
pub fn styled(
    source: &dyn LayerSource,
    look: &Look,
    style: &Style,
    leaves: Leaves,
    on_tile: &(dyn Fn() + Sync),
) -> Picture {
    let recoloured = Recoloured::new(source, style, leaves.colours);
    let source = if recoloured.is_plain() { source } else { &recoloured };
    match style.kind {
        StyleKind::Shaded if style.occlusion.is_some_and(|strength| strength > 0.0) => {
            occluded(source, look, style, style.occlusion.unwrap_or_default().min(1.0), on_tile)
        }
        StyleKind::Shaded | StyleKind::Transparent => shaded(source, look, on_tile),
        StyleKind::Sketchy => sketchy(source, look, style, leaves.heavy, on_tile),
        StyleKind::Blueprint | StyleKind::Wireframe | StyleKind::EdgeTransparent => {
            layered(source, look, style, leaves.heavy, on_tile)
        }
    }
}
