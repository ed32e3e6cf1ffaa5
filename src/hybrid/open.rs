//! Open meshes: which side of one a ray is on where its crossings do not tell.
//!
//! *Theory.* A ray that begins outside of a closed, consistently oriented mesh enters and leaves it in turn. Where a mesh has
//! holes or triangles that face the wrong way, the crossings of some rays do not alternate. There the inside is where the generalised
//! winding number is above ½ (Jacobson, Kavan and Sorkine-Hornung 2013, §3): a hole is closed by the surface on which it is ½, and
//! which is not drawn.
//!
//! *Practice.* Only rays whose crossings do not alternate are decided so, pixel by pixel, and they are counted: everywhere else the
//! picture is what a closed mesh would give. A crossing is kept where the winding number passes ½ at it; between crossings the
//! leaf is asked at the point.

use std::sync::atomic::{AtomicU64, Ordering};

use glam::DVec2;

use crate::classify::Model;
use crate::crossings::{Crossing, CrossingSource, CrossingTile, PixelBits};
use crate::csg::LeafId;
use crate::geometry::exact::Exact;
use crate::space::{Camera, PixelRect};

/// The open leaves of a scene, and at how many pixels their crossings did not tell the inside.
#[derive(Debug)]
pub struct Undecided(Vec<(LeafId, AtomicU64)>);

impl Undecided {
    /// Over the leaves `open`, ascending.
    pub fn new(open: Vec<LeafId>) -> Self {
        Self(open.into_iter().map(|leaf| (leaf, AtomicU64::new(0))).collect())
    }

    /// Whether no leaf is open.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// By leaf: the pixels of all frames so far, each counted at its middle.
    pub fn counts(&self) -> Vec<(LeafId, u64)> {
        self.0.iter().map(|(leaf, count)| (*leaf, count.load(Ordering::Relaxed))).collect()
    }
}

/// A source whose open leaves are decided by their winding numbers where crossings do not alternate.
pub struct Decided<'a, S> {
    source: S,
    camera: Camera,
    open: Vec<(LeafId, &'a Exact, &'a AtomicU64)>,
    is_counted: bool,
}

/// How far before and behind a crossing the side is asked, as a share of its depth: a few of the smallest differences of depth.
const BESIDE: f64 = 8.0 * f32::EPSILON as f64;

impl<'a, S: CrossingSource> Decided<'a, S> {
    /// Over `source`, for rays of `camera`; the leaves are exact in `model`.
    pub fn new(source: S, model: &'a Model, camera: &Camera, undecided: &'a Undecided) -> Self {
        let exact = |leaf: &LeafId| model.fields[leaf.0 as usize].exact.as_ref();
        let open = undecided.0.iter().filter_map(|(leaf, count)| Some((*leaf, exact(leaf)?, count))).collect();
        Self { source, camera: camera.clone(), open, is_counted: true }
    }

    /// The same, where pixels that it decides are not counted.
    pub fn uncounted(self) -> Self {
        Self { is_counted: false, ..self }
    }

    /// Which of the crossings `of_pixel` remain, where those of `leaf` are decided by its winding number; they are told their
    /// directions.
    fn decide(&self, leaf: LeafId, exact: &Exact, px: DVec2, of_pixel: &mut Vec<Crossing>) {
        let ray = self.camera.ray(px);
        of_pixel.retain_mut(|crossing| {
            if crossing.leaf != leaf {
                return true;
            }
            let depth = f64::from(crossing.depth);
            let [before, after] = [-BESIDE, BESIDE].map(|share| exact.contains(ray.at(depth * (1.0 + share))));
            crossing.enters = after;
            before != after
        });
    }
}

/// Whether the crossings of `leaf` enter and leave it in turn, the first one entering.
fn alternate(of_pixel: &[Crossing], leaf: LeafId) -> bool {
    let mut inside = false;
    for crossing in of_pixel.iter().filter(|crossing| crossing.leaf == leaf) {
        if crossing.enters == inside {
            return false;
        }
        inside = crossing.enters;
    }
    !inside
}

impl<S: CrossingSource> CrossingSource for Decided<'_, S> {
    fn leaves(&self) -> Vec<LeafId> {
        self.source.leaves()
    }

    fn crossings(&self, rect: PixelRect, offset: DVec2) -> CrossingTile {
        let mut tile = self.source.crossings(rect, offset);
        for (leaf, exact, count) in &self.open {
            let mut bits = PixelBits::new(rect.area());
            (0..rect.area()).filter(|&pixel| !alternate(tile.of(pixel), *leaf)).for_each(|pixel| bits.set(pixel));
            if bits.count() == 0 {
                continue;
            }
            if self.is_counted && offset == DVec2::splat(0.5) {
                count.fetch_add(bits.count(), Ordering::Relaxed);
            }
            let mut kept = Vec::with_capacity(tile.crossings.len());
            let mut offsets = vec![0];
            for pixel in 0..rect.area() {
                let mut of_pixel = tile.of(pixel).to_vec();
                if bits.get(pixel) {
                    let (x, y) = (pixel as u32 % rect.width(), pixel as u32 / rect.width());
                    let px = DVec2::new(f64::from(rect.x0 + x), f64::from(rect.y0 + y)) + offset;
                    self.decide(*leaf, exact, px, &mut of_pixel);
                }
                kept.append(&mut of_pixel);
                offsets.push(kept.len() as u32);
            }
            (tile.crossings, tile.offsets) = (kept, offsets);
            tile.undecided.push((*leaf, bits));
        }
        tile
    }

    fn paint(&self, crossing: &Crossing, px: DVec2) -> ([f32; 3], f32) {
        self.source.paint(crossing, px)
    }
}
