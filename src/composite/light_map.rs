//! What the light sees: the tiles of its grid that pictures have asked for.
//!
//! *Practice.* A tile is drawn by the pipeline that draws the picture, at one sample a texel, and kept as what throws shadows: in
//! each texel the surfaces from the light on, down to the first opaque one. Nothing is drawn that no pixel asks for. Tiles are kept
//! for the pixels that come next, and for the next frame, up to `MOST_KEPT`; those that were not asked for longest go first, and are
//! drawn again if they are missed. A tile is the same bits whenever it is drawn.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::convert::Infallible;

use glam::Vec3;
use rayon::prelude::*;

use super::light_frames::LightFrames;
use super::light_grid::{BlockView, LightBlock, LightGrid, LightTile, SIDE};
use crate::layers::{LayerSource, LayerTile};
use crate::space::{Camera, PixelRect};

/// What tiles are kept takes at most this many bytes, beyond those that the pixels at work ask for.
const MOST_KEPT: usize = 128 << 20;

/// A surface that throws a shadow, seen from the light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Caster {
    /// Depth of the light's cameras, world units.
    pub depth: f32,
    /// The share of the light that it lets through.
    pub through: f32,
    /// Unit normal towards the light, along the grid's axes.
    pub normal: Vec3,
}

/// The surfaces in a tile, by texel row by row.
#[derive(Debug, Clone, Default)]
pub(crate) struct CasterTile {
    /// None where nothing is.
    offsets: Vec<u32>,
    casters: Vec<Caster>,
}

impl CasterTile {
    /// What throws shadows of `tile`, whose opacities are multiplied by `opacity`.
    fn new(tile: &LayerTile, grid: &LightGrid, opacity: f32) -> Self {
        if tile.boundaries.is_empty() {
            return Self::default();
        }
        let [right, down, forward] = [grid.right, grid.down, grid.forward].map(|axis| axis.as_vec3());
        let mut casters = Vec::with_capacity(tile.rect.area());
        let mut offsets = Vec::with_capacity(tile.rect.area() + 1);
        offsets.push(0);
        for of_texel in tile.offsets.windows(2) {
            for boundary in &tile.boundaries[of_texel[0] as usize..of_texel[1] as usize] {
                let opacity = (boundary.opacity * opacity).clamp(0.0, 1.0);
                if !(opacity > 0.0) {
                    continue;
                }
                let normal = boundary.normal;
                let normal = Vec3::new(normal.dot(right), normal.dot(down), normal.dot(forward));
                let normal = if normal.z > 0.0 { -normal } else { normal };
                casters.push(Caster { depth: boundary.depth, through: 1.0 - opacity, normal });
                if opacity >= 1.0 {
                    break;
                }
            }
            offsets.push(casters.len() as u32);
        }
        if casters.is_empty() {
            return Self::default();
        }
        // A tile is kept for long, and most have much less in them than a caster a texel.
        casters.shrink_to_fit();
        Self { offsets, casters }
    }

    /// From the light on, at column `x` and row `y` of the tile.
    #[inline]
    pub fn at(&self, x: usize, y: usize) -> &[Caster] {
        let texel = y * SIDE as usize + x;
        match self.offsets.get(texel..texel + 2) {
            Some(&[from, to]) => &self.casters[from as usize..to as usize],
            _ => &[],
        }
    }

    fn bytes(&self) -> usize {
        self.offsets.capacity() * size_of::<u32>() + self.casters.capacity() * size_of::<Caster>()
    }
}

#[derive(Debug)]
struct Kept {
    tile: CasterTile,
    /// When it was asked for last.
    asked: u64,
}

/// What has been drawn of a light's grid.
#[derive(Debug)]
pub struct LightMap {
    grid: LightGrid,
    opacity: f32,
    tiles: HashMap<LightTile, Kept>,
    /// How often tiles were asked for.
    round: u64,
    drawn: u64,
}

/// What draws the scene for a camera of the light: one sample a pixel, and all that an opaque surface does not hide. `None` where
/// that failed, of which the caller knows more: nothing then throws shadows.
pub type DrawLight<'a> = dyn Fn(&Camera) -> Option<Box<dyn LayerSource + 'a>> + 'a;

/// Frames that are ready; `None` for a block where nothing is.
pub(super) type Frames<'a> = LightFrames<Option<(BlockView, Box<dyn LayerSource + 'a>)>>;

impl LightMap {
    /// Nothing of `grid` yet. Surfaces stop the light by their opacities times `opacity`.
    pub fn new(grid: LightGrid, opacity: f32) -> Self {
        Self { grid, opacity, tiles: HashMap::new(), round: 0, drawn: 0 }
    }

    /// The grid.
    pub fn grid(&self) -> &LightGrid {
        &self.grid
    }

    /// The factor of opacities.
    pub fn opacity(&self) -> f32 {
        self.opacity
    }

    /// Texels drawn so far.
    pub fn texels(&self) -> u64 {
        self.drawn * u64::from(SIDE * SIDE)
    }

    /// A tile that was [asked for](Self::ask); `None` where nothing throws a shadow.
    #[inline]
    pub(super) fn tile(&self, tile: LightTile) -> Option<&CasterTile> {
        self.tiles.get(&tile).map(|kept| &kept.tile)
    }

    /// Draws those of `wanted` that are not there yet, each with the frame of its block.
    pub(super) fn ask<'a>(&mut self, wanted: &BTreeSet<LightTile>, frames: &mut Frames<'a>, draw: &DrawLight<'a>) {
        self.round += 1;
        let mut missing: BTreeMap<LightBlock, Vec<LightTile>> = BTreeMap::new();
        for tile in wanted {
            match self.tiles.get_mut(tile) {
                Some(kept) => kept.asked = self.round,
                None => missing.entry(tile.block()).or_default().push(*tile),
            }
        }
        let mut missing: Vec<(LightBlock, Vec<LightTile>)> = missing.into_iter().collect();
        missing.sort_by_key(|(block, _)| !frames.is_ready(*block));
        for (block, tiles) in missing {
            let prepare = || {
                let view = self.grid.view(block)?;
                let source = draw(&view.camera)?;
                Some((view, source))
            };
            let Ok(Some((view, source))) = frames.get(block, || Ok::<_, Infallible>(prepare())) else { continue };
            let drawn: Vec<(LightTile, CasterTile)> = tiles
                .into_par_iter()
                .filter_map(|tile| {
                    let rect = rect_of(tile, view)?;
                    Some((tile, CasterTile::new(&source.draw(rect), &self.grid, self.opacity)))
                })
                .collect();
            self.drawn += drawn.len() as u64;
            let asked = self.round;
            self.tiles.extend(drawn.into_iter().map(|(key, tile)| (key, Kept { tile, asked })));
        }
        self.forget();
    }

    /// Lets tiles go that were not asked for just now, while there are too many.
    fn forget(&mut self) {
        let mut bytes: usize = self.tiles.values().map(|kept| kept.tile.bytes()).sum();
        if bytes <= MOST_KEPT {
            return;
        }
        let round = self.round;
        let old = self.tiles.iter().filter(|(_, kept)| kept.asked < round);
        let mut old: Vec<(u64, LightTile)> = old.map(|(tile, kept)| (kept.asked, *tile)).collect();
        old.sort_unstable();
        for (_, tile) in old {
            if bytes <= MOST_KEPT {
                break;
            }
            bytes -= self.tiles.remove(&tile).map_or(0, |kept| kept.tile.bytes());
        }
    }
}

/// Where `tile` is in the picture of its block; `None` where that picture ends before.
fn rect_of(tile: LightTile, view: &BlockView) -> Option<PixelRect> {
    let side = SIDE as i32;
    let place = |at: i32, corner: i32, end: u32| {
        let first = u32::try_from(at * side - corner).ok()?;
        (first < end).then_some((first, first + SIDE))
    };
    let (x0, x1) = place(tile.x, view.corner[0], view.camera.width)?;
    let (y0, y1) = place(tile.y, view.corner[1], view.camera.height)?;
    Some(PixelRect { x0, y0, x1, y1 })
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::layers::{Boundary, Facing, LayerStack};
    use crate::scene::framing::Bounds;

    fn tile(is_there: impl Fn(u32, u32) -> bool + Sync, opacity: f32) -> CasterTile {
        let bounds = Bounds { min: DVec3::splat(-1.0), max: DVec3::ONE };
        let grid = LightGrid::new(DVec3::Z, &bounds);
        let mut camera = grid.view(LightBlock { level: -8, x: 0, y: 0 }).unwrap().camera;
        (camera.width, camera.height) = (SIDE, SIDE);
        let normal = Vec3::Z;
        let surface = Boundary {
            depth: 1.0,
            normal,
            colour: [1.0; 3],
            opacity,
            leaf: 0,
            body: 0,
            facing: Facing::Front,
            samples: 1,
        };
        let stack = LayerStack::from_fn(camera, 1, |x, y| if is_there(x, y) { vec![surface] } else { Vec::new() });
        CasterTile::new(&stack.tiles()[0], &grid, 1.0)
    }

    #[test]
    fn a_tile_takes_what_is_in_it() {
        let of_offsets = (SIDE * SIDE + 1) as usize * size_of::<u32>();
        let one = tile(|x, y| (x, y) == (3, 5), 1.0);
        assert_eq!(one.bytes(), of_offsets + size_of::<Caster>());
        assert_eq!((one.at(3, 5).len(), one.at(5, 3).len()), (1, 0));
        assert_eq!(tile(|_, _| true, 1.0).bytes(), of_offsets + (SIDE * SIDE) as usize * size_of::<Caster>());
        assert_eq!((tile(|_, _| true, 0.0).bytes(), tile(|_, _| false, 1.0).bytes()), (0, 0));
    }
}
