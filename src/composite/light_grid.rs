//! Where the light looks from: one grid of texels over the plane across its direction, in many sizes.
//!
//! *Practice.* The light is directional, so its view is orthographic, and any part of it at any size of texels is an ordinary
//! camera's picture. The grid belongs to the scene and not to the viewer: it has its origin in the middle of what throws shadows,
//! and the sizes of texels are powers of √2 of a world unit. So a texel is the same whoever looks, and what was drawn of the grid
//! serves the next frame while neither leaves nor light have moved. The grid has no bounds worth drawing: it is drawn tile by tile
//! where something asks for it, out of *blocks*, each one camera.

use glam::{DVec2, DVec3};

use crate::layers::TILE_SIDE;
use crate::scene::framing::Bounds;
use crate::space::{Camera, Projection};

/// Texels on a side of a tile: as many as the pipelines' own tiles have, since a part of one of theirs takes as long as all of it.
pub(crate) const SIDE: u32 = TILE_SIDE;

/// Sizes of texels between one and its double: with one alone texels would have half the area that is asked for, on average.
pub(crate) const STEPS: f64 = 2.0;

/// Sizes of texels: the coarsest is some thousand times as large as the grid.
pub(crate) const LEVELS: u32 = 64;

/// Tiles on a side of a block. A pipeline's preparation of a frame grows with its leaves and, less, with its tiles: a block is
/// about the largest picture whose tiles do not count.
pub(crate) const BLOCK_TILES: i32 = 128;

/// What is drawn may stand this share of its bounds' diagonal over them, as the disks of coarse scans do.
const MARGIN: f64 = 0.25;

/// The finest texel, as a share of the grid's half side: four roundings of a depth in 32 bits, which is at most twice as long.
const LEAST_TEXEL: f64 = 1.0 / (1 << 20) as f64;

/// A tile of [`SIDE`]² texels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) struct LightTile {
    /// How large its texels are: the power of √2 that a texel's side is in world units.
    pub level: i32,
    /// Columns of tiles from the grid's origin.
    pub x: i32,
    /// Rows of tiles.
    pub y: i32,
}

impl LightTile {
    /// That of the texel at a column and row of the grid.
    #[inline]
    pub fn of(level: i32, x: i32, y: i32) -> Self {
        let side = SIDE as i32;
        Self { level, x: x.div_euclid(side), y: y.div_euclid(side) }
    }

    /// The block that it is a part of.
    pub fn block(self) -> LightBlock {
        let of = |at: i32| at.div_euclid(BLOCK_TILES);
        LightBlock { level: self.level, x: of(self.x), y: of(self.y) }
    }
}

/// [`BLOCK_TILES`]² tiles.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) struct LightBlock {
    pub level: i32,
    pub x: i32,
    pub y: i32,
}

/// The part of a block within the grid's bounds, as a camera sees it.
#[derive(Debug, Clone)]
pub(crate) struct BlockView {
    pub camera: Camera,
    /// The column and row in the grid of its picture's first texel.
    pub corner: [i32; 2],
}

/// The grid for one direction of light and one extent of what throws shadows.
#[derive(Debug, Clone, PartialEq)]
pub struct LightGrid {
    /// Unit vectors in world space: along columns, along rows, and from the light on.
    pub(crate) right: DVec3,
    pub(crate) down: DVec3,
    pub(crate) forward: DVec3,
    /// The middle, world space.
    centre: DVec3,
    /// How far what is drawn reaches from there along the three axes, world units.
    half: DVec3,
}

impl LightGrid {
    /// For light from the direction `towards` (world space, any length) on what lies within `bounds`.
    pub fn new(towards: DVec3, bounds: &Bounds) -> Self {
        let forward = -towards.try_normalize().unwrap_or(DVec3::Z);
        let right = forward.any_orthonormal_vector();
        let down = forward.cross(right);
        let centre = bounds.centre();
        let along = |axis: DVec3| {
            let reach = bounds.corners().map(|corner| (corner - centre).dot(axis).abs());
            reach.into_iter().fold(0.0, f64::max) + MARGIN * bounds.diagonal()
        };
        let half = DVec3::new(along(right), along(down), along(forward)).max(DVec3::splat(f64::MIN_POSITIVE));
        Self { right, down, forward, centre, half }
    }

    /// The unit vector towards the light, world space.
    pub(crate) fn towards(&self) -> DVec3 {
        -self.forward
    }

    /// The middle of what throws shadows, world space.
    #[cfg(feature = "gpu")]
    pub(crate) fn centre(&self) -> DVec3 {
        self.centre
    }

    /// `p_in_world` on the grid: world units from the origin along columns and rows, and the depth that the light's cameras see.
    pub(crate) fn on_grid(&self, p_in_world: DVec3) -> DVec3 {
        self.rotated(p_in_world - self.centre) + DVec3::new(0.0, 0.0, self.half.z)
    }

    /// A direction of world space along the grid's axes.
    pub(crate) fn rotated(&self, v_in_world: DVec3) -> DVec3 {
        DVec3::new(v_in_world.dot(self.right), v_in_world.dot(self.down), v_in_world.dot(self.forward))
    }

    /// The side of a texel, world units.
    pub(crate) fn texel(level: i32) -> f64 {
        (f64::from(level) / STEPS).exp2()
    }

    /// The level of the largest texels whose sides are at most `side` world units, or of the finest or coarsest that there are.
    pub(crate) fn level_for(&self, side: f64) -> i32 {
        let least = self.least_level();
        ((STEPS * side.log2()).floor() as i32).clamp(least, least + LEVELS as i32 - 1)
    }

    /// The level of the finest texels.
    pub(crate) fn least_level(&self) -> i32 {
        (STEPS * (self.half.max_element() * LEAST_TEXEL).log2()).ceil() as i32
    }

    /// The part of `block` where anything can be; `None` where nothing can.
    pub(crate) fn view(&self, block: LightBlock) -> Option<BlockView> {
        let texel = Self::texel(block.level);
        let side = texel * f64::from(SIDE);
        let range = |at: i32, half: f64| {
            let first = (at * BLOCK_TILES).max((-half / side).floor() as i32);
            let last = ((at + 1) * BLOCK_TILES).min((half / side).ceil() as i32);
            (first < last).then_some((first, last))
        };
        let ((x0, x1), (y0, y1)) = (range(block.x, self.half.x)?, range(block.y, self.half.y)?);
        let middle = DVec2::new(f64::from(x0 + x1), f64::from(y0 + y1)) * (0.5 * side);
        let camera = Camera {
            eye: self.centre + self.right * middle.x + self.down * middle.y - self.forward * self.half.z,
            right: self.right,
            down: self.down,
            forward: self.forward,
            projection: Projection::Orthographic { px_per_unit: 1.0 / texel },
            width: (x1 - x0) as u32 * SIDE,
            height: (y1 - y0) as u32 * SIDE,
        };
        Some(BlockView { camera, corner: [x0, y0].map(|tile| tile * SIDE as i32) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid() -> LightGrid {
        let bounds = Bounds { min: DVec3::new(9.0, -3.0, 0.5), max: DVec3::new(14.0, 2.0, 1.5) };
        LightGrid::new(DVec3::new(0.3, -0.5, 0.8), &bounds)
    }

    #[test]
    fn every_block_sees_its_own_part_of_one_grid() {
        let grid = grid();
        let p = DVec3::new(12.3, -1.1, 0.9);
        let on_grid = grid.on_grid(p);
        for level in [-19, -10, 0] {
            let texels = on_grid.truncate() / LightGrid::texel(level);
            let tile = (texels / f64::from(SIDE)).floor();
            let block = LightTile { level, x: tile.x as i32, y: tile.y as i32 }.block();
            let view = grid.view(block).unwrap();
            let in_view = view.camera.view_from_world(p);
            let px = view.camera.px_from_view(in_view) + DVec2::new(view.corner[0].into(), view.corner[1].into());
            assert!((px - texels).length() < 1e-6, "{px} {texels}");
            assert!((in_view.z - on_grid.z).abs() < 1e-9 && in_view.z > 0.0);
            assert!(view.camera.width <= SIDE * BLOCK_TILES as u32);
        }
    }

    #[test]
    fn blocks_where_nothing_can_be_are_not_drawn() {
        assert!(grid().view(LightBlock { level: -12, x: 40, y: 0 }).is_none());
        assert!(grid().view(LightBlock { level: -12, x: 0, y: 0 }).is_some());
    }

    #[test]
    fn a_texel_is_as_large_as_allowed_and_never_below_what_depths_resolve() {
        let grid = grid();
        for side in [0.3, 0.25, 0.01] {
            let texel = LightGrid::texel(grid.level_for(side));
            assert!(texel <= side && 1.5 * texel > side);
        }
        assert!(LightGrid::texel(grid.level_for(1e-30)) >= LEAST_TEXEL * grid.half.max_element());
    }
}
