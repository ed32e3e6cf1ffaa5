//! Any style, from any source.

use super::layered::layered;
use super::legend;
use super::merge::{Contents, compose};
use super::recolour::Recoloured;
use super::section::{Hatched, Hatching};
use super::shaded::shaded;
use super::shadow::Shadows;
use super::shown::{Shown, Watched};
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
    /// What a legend calls them.
    pub names: &'a [String],
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
    styled_with(source, look, style, leaves, &Contents::default(), None, on_tile)
}

/// As [`styled`], composed with other content by depth, which throws no shadows and takes none, and with `shadows` of the result.
pub fn styled_with(
    source: &dyn LayerSource,
    look: &Look,
    style: &Style,
    leaves: Leaves,
    contents: &Contents,
    shadows: Option<&Shadows>,
    on_tile: &(dyn Fn() + Sync),
) -> Picture {
    let shadows = shadows.filter(|_| style.shadow_strength().is_some());
    let Some(corner) = style.legend else {
        return composed(source, look, style, leaves, (contents, shadows), None, on_tile);
    };
    let shown = Shown::new(style);
    let mut picture = composed(source, look, style, leaves, (contents, shadows), Some(&shown), on_tile);
    legend::draw(&mut picture, corner, &shown.into_surfaces(), source.camera(), look, style, leaves);
    picture
}

/// The picture without a legend; `shown` learns what one has to tell of.
fn composed(
    source: &dyn LayerSource,
    look: &Look,
    style: &Style,
    leaves: Leaves,
    (contents, shadows): (&Contents, Option<&Shadows>),
    shown: Option<&Shown>,
    on_tile: &(dyn Fn() + Sync),
) -> Picture {
    let watch = shown.map(|shown| (shown, contents));
    if contents.is_empty() || style.kind != StyleKind::Sketchy {
        return prepared(source, style, leaves, watch, |source| match style.kind {
            _ if contents.is_empty() && shadows.is_none() && is_plain(style, leaves) => shaded(source, look, on_tile),
            StyleKind::Sketchy => sketchy(source, look, style, leaves.heavy, shadows, on_tile),
            _ => layered(source, look, style, leaves.heavy, contents, shadows, on_tile),
        });
    }
    const NOTHING: [f32; 4] = [0.0; 4];
    let look_over_nothing = Look { background: NOTHING, ..*look };
    // The ink that suits the paper is still that of the paper.
    let mut inked = *style;
    inked.lines.ink = Some(style.ink(look.background));
    let mut picture = prepared(source, style, leaves, watch, |source| {
        sketchy(source, &look_over_nothing, &inked, leaves.heavy, shadows, on_tile)
    });
    compose(&mut picture, contents, look.background);
    picture
}

/// Whether surfaces are drawn with neither lines nor shade: sections are outlined in every style.
pub(crate) fn is_plain(style: &Style, leaves: Leaves) -> bool {
    !style.kind.has_lines() && style.hollow_shade().is_none() && !leaves.heavy.contains(&true)
}

/// Calls `draw` with `source` as `style` and `leaves` change it. `watch` learns what shows of it, before caps are hatched.
pub(super) fn prepared<T>(
    source: &dyn LayerSource,
    style: &Style,
    leaves: Leaves,
    watch: Option<(&Shown, &Contents)>,
    draw: impl FnOnce(&dyn LayerSource) -> T,
) -> T {
    let recoloured = Recoloured::new(source, style, leaves.colours);
    let source = if recoloured.is_plain() { source } else { &recoloured };
    let watched = watch.map(|(shown, contents)| Watched::new(source, shown, contents));
    let source = watched.as_ref().map_or(source, |watched| watched);
    match leaves.hatching.filter(|hatching| !hatching.is_empty()) {
        Some(hatching) => draw(&Hatched::new(source, hatching)),
        None => draw(source),
    }
}
