//! Crossings of rays and leaves: what one pipeline tells another of the leaves that it finds.
//!
//! In a scene of scans, meshes and solids, scans are found by their surfels and the others by their triangles and formulas.
//! Neither pipeline knows the other: the one that finds a leaf by its exact form is a [`CrossingSource`], the other asks it
//! where the rays of a tile cross those leaves, and so on which side of them they are in between.

use glam::{DVec2, Vec3};

use crate::csg::LeafId;
use crate::space::PixelRect;

/// One crossing of a pixel's ray and a leaf's surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Crossing {
    /// Planar view depth, world units. Crossings that coincide have exactly the same.
    pub depth: f32,
    /// Whose surface.
    pub leaf: LeafId,
    /// Whether the ray is inside of the leaf behind it.
    pub enters: bool,
    /// Unit normal, world space, either way.
    pub normal: Vec3,
    /// Whether the surface shows there: a half-space shows only within its square.
    pub is_drawn: bool,
    /// What the source knows it by.
    pub what: u32,
}

/// A bit for each pixel of a tile.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct PixelBits(Vec<u64>);

impl PixelBits {
    /// No bit of `pixels` is set.
    pub fn new(pixels: usize) -> Self {
        Self(vec![0; pixels.div_ceil(64)])
    }

    /// Sets a pixel's.
    pub fn set(&mut self, pixel: usize) {
        self.0[pixel / 64] |= 1 << (pixel % 64);
    }

    /// A pixel's.
    pub fn get(&self, pixel: usize) -> bool {
        self.0[pixel / 64] >> (pixel % 64) & 1 == 1
    }

    /// How many are set.
    pub fn count(&self) -> u64 {
        self.0.iter().map(|word| u64::from(word.count_ones())).sum()
    }
}

/// The crossings of all rays of a rectangle of pixels, at one place within them.
#[derive(Debug, Clone, Default)]
pub struct CrossingTile {
    /// Columns of the rectangle.
    pub width: u32,
    /// `area() + 1` offsets into `crossings`, pixels row by row.
    pub offsets: Vec<u32>,
    /// Front to back within a pixel; those that coincide by leaf.
    pub crossings: Vec<Crossing>,
    /// The leaves inside of which some ray begins, each with those rays' pixels; by leaf.
    pub begins: Vec<(LeafId, PixelBits)>,
    /// Pixels where crossings do not tell which side of a leaf the ray is on; by leaf.
    pub undecided: Vec<(LeafId, PixelBits)>,
}

/// The entry of `leaf` in a list by leaf.
fn of_leaf(list: &[(LeafId, PixelBits)], leaf: LeafId) -> Option<&PixelBits> {
    list.binary_search_by_key(&leaf, |entry| entry.0).ok().map(|at| &list[at].1)
}

impl CrossingTile {
    /// From crossings in any order, each with its pixel, of a rectangle of `area` pixels, `width` to a row.
    pub fn from_placed(width: u32, area: usize, placed: &[(u32, Crossing)]) -> Self {
        let mut offsets = vec![0_u32; area + 1];
        for (pixel, _) in placed {
            offsets[*pixel as usize + 1] += 1;
        }
        for i in 1..offsets.len() {
            offsets[i] += offsets[i - 1];
        }
        let mut crossings = placed.iter().map(|(_, crossing)| *crossing).collect::<Vec<_>>();
        let mut next = offsets.clone();
        for (pixel, crossing) in placed {
            let place = &mut next[*pixel as usize];
            crossings[*place as usize] = *crossing;
            *place += 1;
        }
        let in_order = |a: &Crossing, b: &Crossing| {
            a.depth.total_cmp(&b.depth).then(a.leaf.cmp(&b.leaf)).then(a.what.cmp(&b.what))
        };
        for of_pixel in offsets.windows(2) {
            crossings[of_pixel[0] as usize..of_pixel[1] as usize].sort_unstable_by(in_order);
        }
        Self { width, offsets, crossings, begins: Vec::new(), undecided: Vec::new() }
    }

    /// A pixel's crossings, front to back; pixels are counted row by row.
    pub fn of(&self, pixel: usize) -> &[Crossing] {
        &self.crossings[self.offsets[pixel] as usize..self.offsets[pixel + 1] as usize]
    }

    /// Whether the ray of `pixel` begins inside of `leaf`.
    pub fn begins_inside(&self, pixel: usize, leaf: LeafId) -> bool {
        of_leaf(&self.begins, leaf).is_some_and(|bits| bits.get(pixel))
    }

    /// Whether crossings leave open on which side of `leaf` the ray of `pixel` is.
    pub fn is_undecided(&self, pixel: usize, leaf: LeafId) -> bool {
        of_leaf(&self.undecided, leaf).is_some_and(|bits| bits.get(pixel))
    }

    /// Whether the ray of `pixel` is inside of `leaf` at `depth`; `None` where its crossings do not tell.
    pub fn inside(&self, pixel: usize, leaf: LeafId, depth: f32) -> Option<bool> {
        if self.is_undecided(pixel, leaf) {
            return None;
        }
        let before = self.of(pixel).iter().take_while(|crossing| crossing.depth < depth);
        let last = before.filter(|crossing| crossing.leaf == leaf).last();
        Some(last.map_or_else(|| self.begins_inside(pixel, leaf), |crossing| crossing.enters))
    }
}

/// Whoever finds leaves by their exact form.
pub trait CrossingSource: Sync {
    /// The leaves that it finds, ascending.
    fn leaves(&self) -> Vec<LeafId>;
    /// All crossings of its leaves and the rays of `rect`, which lies within the picture, at `offset` within its pixels. The
    /// same whatever thread asks.
    fn crossings(&self, rect: PixelRect, offset: DVec2) -> CrossingTile;
    /// Linear RGB and opacity at a crossing of the ray through `px`.
    fn paint(&self, crossing: &Crossing, px: DVec2) -> ([f32; 3], f32);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn crossing(depth: f32, leaf: u32, enters: bool) -> Crossing {
        Crossing { depth, leaf: LeafId(leaf), enters, normal: Vec3::Z, is_drawn: true, what: 0 }
    }

    #[test]
    fn a_ray_is_inside_from_a_crossing_that_enters_to_the_next() {
        let placed = [(1, crossing(3.0, 0, false)), (1, crossing(1.0, 0, true)), (0, crossing(2.0, 1, false))];
        let mut tile = CrossingTile::from_placed(2, 2, &placed);
        let mut bits = PixelBits::new(2);
        bits.set(0);
        tile.begins.push((LeafId(1), bits.clone()));
        assert_eq!(tile.of(1).iter().map(|c| c.depth).collect::<Vec<_>>(), [1.0, 3.0]);
        let inside = |pixel, leaf, depth| tile.inside(pixel, LeafId(leaf), depth).unwrap();
        assert_eq!([0.5, 1.5, 3.5].map(|depth| inside(1, 0, depth)), [false, true, false]);
        assert_eq!([1.5, 2.5].map(|depth| inside(0, 1, depth)), [true, false]);
        assert!(!inside(1, 1, 9.0));
        tile.undecided.push((LeafId(1), bits));
        assert_eq!((tile.inside(0, LeafId(1), 1.0), tile.inside(1, LeafId(1), 1.0)), (None, Some(false)));
    }
}
