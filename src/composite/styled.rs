//! Any style, from any source.

use super::layered::layered;
use super::merge::{Contents, compose};
use super::recolour::Recoloured;
use super::section::{Hatched, Hatching};
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
    /// How the caps of sections are hatched.
    pub hatching: Option<&'a Hatching>,
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
    prepared(source, style, leaves, |source| match style.kind {
        _ if is_plain(style, leaves) => shaded(source, look, on_tile),
        StyleKind::Sketchy => sketchy(source, look, style, leaves.heavy, on_tile),
        _ => layered(source, look, style, leaves.heavy, &Contents::default(), on_tile),
    })
}

/// As [`styled`], composed with other content by depth.
pub fn styled_with(
    source: &dyn LayerSource,
    look: &Look,
    style: &Style,
    leaves: Leaves,
    contents: &Contents,
    on_tile: &(dyn Fn() + Sync),
) -> Picture {
    if contents.is_empty() {
        return styled(source, look, style, leaves, on_tile);
    }
    if style.kind == StyleKind::Sketchy {
        const NOTHING: [f32; 4] = [0.0; 4];
        let look_over_nothing = Look { background: NOTHING, ..*look };
        // The ink that suits the paper is still that of the paper.
        let mut inked = *style;
        inked.lines.ink = Some(style.ink(look.background));
        let mut picture = styled(source, &look_over_nothing, &inked, leaves, on_tile);
        compose(&mut picture, contents, look.background);
        return picture;
    }
    prepared(source, style, leaves, |source| layered(source, look, style, leaves.heavy, contents, on_tile))
}

/// Whether surfaces are drawn with neither lines nor shade: sections are outlined in every style.
pub(crate) fn is_plain(style: &Style, leaves: Leaves) -> bool {
    !style.kind.has_lines() && style.hollow_shade().is_none() && !leaves.heavy.contains(&true)
}

/// Calls `draw` with `source` as `style` and `leaves` change it.
pub(super) fn prepared<T>(
    source: &dyn LayerSource,
    style: &Style,
    leaves: Leaves,
    draw: impl FnOnce(&dyn LayerSource) -> T,
) -> T {
    let recoloured = Recoloured::new(source, style, leaves.colours);
    let source = if recoloured.is_plain() { source } else { &recoloured };
    match leaves.hatching.filter(|hatching| !hatching.is_empty()) {
        Some(hatching) => draw(&Hatched::new(source, hatching)),
        None => draw(source),
    }
}
