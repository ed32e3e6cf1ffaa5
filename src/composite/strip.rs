//! The picture in strips of tile rows, each with the rows around it that lines and loose hands reach into.
//!
//! *Practice.* Lines need their neighbours' layers, and whole layers of a large picture do not fit in memory. A strip holds
//! about [`STRIP_PIXELS`] pixels' layers and one row of tiles above and below. The rows that the next strip needs too are
//! handed on with the edges found in them, so that no tile is drawn or searched twice: where a row's edges are to be whole, the row
//! below it is drawn already.

use rayon::prelude::*;

use super::edges::{Detector, EdgePoints};
use super::facets::FacetStrip;
use super::strokes::{EdgeStrip, LineMaps, Stroke, reach_px};
use crate::layers::{LayerSource, LayerTile, TILE_SIDE};
use crate::scene::style::{LineSettings, SketchSettings, Style, WIDEST_LINE_PX};
use crate::space::PixelRect;

/// Pixels of a strip and of the row of tiles that is drawn ahead of it; the rows around it are not counted.
const STRIP_PIXELS: usize = 1 << 20;

// Whatever a pixel looks at lies in its tile or in one beside it.
const _: () = assert!(SketchSettings::MOST_OFFSET_PX * std::f32::consts::SQRT_2 + WIDEST_LINE_PX < TILE_SIDE as f32);

/// Some rows of tiles, drawn, with the strokes of their lines.
#[derive(Debug)]
pub(crate) struct Strip {
    /// Tiles side by side.
    pub across: usize,
    /// The tiles that are this strip's own, by index; the others are around them.
    pub own: std::ops::Range<usize>,
    /// Row by row.
    pub tiles: Vec<LayerTile>,
    /// The strokes of each tile; none in styles without lines.
    strokes: Vec<Vec<Stroke>>,
    settings: LineSettings,
    most: usize,
}

impl Strip {
    /// The tiles beside tile `index`, itself among them.
    pub fn around(&self, index: usize) -> impl Iterator<Item = usize> {
        around(index, self.across, self.tiles.len())
    }

    /// Whether tile `index` has neither surfaces nor lines of its own.
    pub fn is_empty(&self, index: usize) -> bool {
        self.tiles[index].boundaries.is_empty() && self.strokes.get(index).is_none_or(Vec::is_empty)
    }

    /// The lines over `rect`, which lies within the tiles around tile `index`. Maps of deep scenes are large, so they are made
    /// for a tile at a time.
    ///
    /// `repeated` lines are drawn in every layer whose picture changes there, as the papers' edge maps have them. Blended front
    /// to back, one over the other covers nothing more, so pictures need each line once.
    pub fn lines(&self, index: usize, rect: PixelRect, repeated: bool) -> LineMaps {
        let strokes = self.around(index).filter_map(|near| self.strokes.get(near)).flatten();
        LineMaps::draw(rect, strokes, self.most, repeated, &self.settings)
    }
}

/// Indices of the up to nine tiles around `index`, of `count` in rows of `across`.
fn around(index: usize, across: usize, count: usize) -> impl Iterator<Item = usize> {
    let (row, column) = (index / across, index % across);
    let rows = row.saturating_sub(1)..=(row + 1).min(count / across - 1);
    rows.flat_map(move |r| (column.saturating_sub(1)..=(column + 1).min(across - 1)).map(move |c| r * across + c))
}

/// Draws `source` strip by strip, from the top, and hands each to `use_strip`. `heavy` says by leaf whether its outline is
/// drawn stronger. `on_tile` is called once for each tile.
pub(super) fn for_each_strip(
    source: &dyn LayerSource,
    style: &Style,
    heavy: &[bool],
    on_tile: &(dyn Fn() + Sync),
    mut use_strip: impl FnMut(&Strip),
) {
    let camera = source.camera();
    let rects = PixelRect::tiles(camera.width, camera.height, TILE_SIDE);
    let across = camera.width.div_ceil(TILE_SIDE) as usize;
    let rows = rects.len() / across;
    let fitting = STRIP_PIXELS / (across * (TILE_SIDE * TILE_SIDE) as usize);
    let rows_a_strip = if rows <= fitting { rows } else { fitting.saturating_sub(1).max(1) };
    let has_strokes = style.kind.has_lines() || heavy.contains(&true);
    let settings = LineSettings { width_px: style.lines.width_px.clamp(0.0, WIDEST_LINE_PX), ..style.lines };
    debug_assert!(reach_px(&settings) < TILE_SIDE as f32);
    let most = style.max_layers.map_or(usize::MAX, |most| most as usize);
    // What the strip before has left: tiles of some rows from `first_kept` on, and the edges of the first of them.
    let (mut tiles, mut points): (Vec<LayerTile>, Vec<EdgePoints>) = Default::default();
    let mut first_kept = 0;
    for first in (0..rows).step_by(rows_a_strip) {
        let last = (first + rows_a_strip).min(rows);
        let (outer_first, outer_last) = (first.saturating_sub(1), (last + 1).min(rows));
        let drawn_last = if has_strokes { (outer_last + 1).min(rows) } else { outer_last };
        // 1. Rows that the strip before drew, and those that it did not.
        let passed = (outer_first - first_kept) * across;
        tiles.drain(..passed);
        points.drain(..passed.min(points.len()));
        first_kept = outer_first;
        let new = rects[outer_first * across + tiles.len()..drawn_last * across].par_iter().map(|rect| {
            let tile = source.draw(*rect);
            on_tile();
            tile
        });
        tiles.par_extend(new);
        // 2. Their lines.
        let count = (outer_last - outer_first) * across;
        let mut strokes = Vec::new();
        if has_strokes {
            let facets = FacetStrip::new(&tiles, camera, source.samples());
            let detector = Detector::new(&facets, &settings, heavy);
            points.par_extend((points.len()..count).into_par_iter().map(|index| detector.tile(index)));
            let rects = tiles[..count].iter().map(|tile| tile.rect).collect();
            let edges = EdgeStrip { across, rects, tiles: points };
            let is_drawn = |stroke: &Stroke| style.kind.has_lines() || stroke.heavy;
            strokes.par_extend((0..count).into_par_iter().map(|index| {
                let mut strokes = edges.strokes(index, &settings);
                strokes.retain(is_drawn);
                strokes
            }));
            points = edges.tiles;
        }
        // 3. The strip, without the row that was drawn ahead.
        let ahead = tiles.split_off(count);
        let own = (first - outer_first) * across..(last - outer_first) * across;
        let strip = Strip { across, own, tiles, strokes, settings, most };
        use_strip(&strip);
        tiles = strip.tiles;
        tiles.extend(ahead);
    }
}
