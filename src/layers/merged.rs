//! Several sources of layers as one: the layers of a pixel merged by depth.
//!
//! *Theory.* Blueprint 2006 Fig. 7a: the layers of each product of an expression by itself, so that overlaps show in a tone
//! of their own. Each boundary is still one of its product; none is a boundary of the union only.
//!
//! *Practice.* Each source hands over a pixel's boundaries front to back, and they are merged without being sorted anew, so
//! that each source's own order stays. Where depths are equal, what a ray leaves comes before what it enters, then the lower
//! leaf: the order of the sources changes nothing.

use super::{Boundary, Facing, LayerSource, LayerTile};
use crate::space::{Camera, PixelRect};

/// The layers of several sources, which share one camera and one number of samples.
pub struct MergedLayers<S> {
    camera: Camera,
    samples: u32,
    sources: Vec<S>,
}

impl<S: LayerSource> MergedLayers<S> {
    /// Of `sources`, all of `camera` and with `samples` samples a pixel; without any, the picture is empty.
    pub fn new(camera: Camera, samples: u32, sources: Vec<S>) -> Self {
        debug_assert!(sources.iter().all(|source| *source.camera() == camera && source.samples() == samples));
        Self { camera, samples, sources }
    }
}

/// Whether `a` comes before `b` along a ray.
fn comes_first(a: &Boundary, b: &Boundary) -> bool {
    let key = |boundary: &Boundary| (boundary.facing == Facing::Front, boundary.leaf, boundary.body);
    a.depth.total_cmp(&b.depth).then(key(a).cmp(&key(b))).is_lt()
}

/// Appends the boundaries of one pixel, front to back. `queues` are the sources' own, and used up.
fn merge(queues: &mut [&[Boundary]], into: &mut Vec<Boundary>) {
    loop {
        let mut first: Option<usize> = None;
        for (index, queue) in queues.iter().enumerate() {
            if let Some(head) = queue.first()
                && first.is_none_or(|best| comes_first(head, &queues[best][0]))
            {
                first = Some(index);
            }
        }
        let Some(first) = first else { return };
        into.push(queues[first][0]);
        queues[first] = &queues[first][1..];
    }
}

impl<S: LayerSource> LayerSource for MergedLayers<S> {
    fn camera(&self) -> &Camera {
        &self.camera
    }

    fn samples(&self) -> u32 {
        self.samples
    }

    fn draw(&self, rect: PixelRect) -> LayerTile {
        let mut tiles: Vec<LayerTile> = self.sources.iter().map(|source| source.draw(rect)).collect();
        tiles.retain(|tile| !tile.boundaries.is_empty());
        match tiles.len() {
            0 => return LayerTile::empty(rect),
            1 => return tiles.swap_remove(0),
            _ => {}
        }
        let total = tiles.iter().map(|tile| tile.boundaries.len()).sum();
        let mut merged =
            LayerTile { rect, offsets: Vec::with_capacity(rect.area() + 1), boundaries: Vec::with_capacity(total) };
        merged.offsets.push(0);
        let mut queues: Vec<&[Boundary]> = Vec::with_capacity(tiles.len());
        for pixel in 0..rect.area() {
            queues.clear();
            let of_pixel = |tile: &LayerTile| tile.offsets[pixel] as usize..tile.offsets[pixel + 1] as usize;
            queues.extend(tiles.iter().map(|tile| &tile.boundaries[of_pixel(tile)]));
            merge(&mut queues, &mut merged.boundaries);
            merged.offsets.push(merged.boundaries.len() as u32);
        }
        merged
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_layers::{boundary, camera};
    use super::*;
    use crate::layers::LayerStack;

    #[test]
    fn layers_come_by_depth_and_the_order_of_sources_changes_nothing() {
        let at = |depth: f32, leaf: u32, facing: Facing| Boundary { leaf, facing, ..boundary(depth) };
        let ball = vec![at(1.0, 0, Facing::Front), at(3.0, 0, Facing::Back)];
        let other = vec![at(2.0, 1, Facing::Front), at(3.0, 1, Facing::Back)];
        let behind = vec![at(3.0, 2, Facing::Front), at(4.0, 2, Facing::Back)];
        let lists = [ball, other, behind];
        let leaves_of = |order: [usize; 3]| {
            let sources = order.map(|i| {
                LayerStack::from_fn(camera(70, 5), 1, {
                    let list = lists[i].clone();
                    move |x, _| if x % 2 == 0 { list.clone() } else { Vec::new() }
                })
            });
            let merged = MergedLayers::new(camera(70, 5), 1, sources.into_iter().collect());
            let tile = merged.draw(PixelRect { x0: 64, y0: 0, x1: 70, y1: 5 });
            assert!(tile.at(65, 3).is_empty());
            tile.at(66, 3).iter().map(|b| (b.depth, b.leaf)).collect::<Vec<_>>()
        };
        let wanted = [(1.0, 0), (2.0, 1), (3.0, 0), (3.0, 1), (3.0, 2), (4.0, 2)];
        for order in [[0, 1, 2], [2, 1, 0], [1, 2, 0]] {
            assert_eq!(leaves_of(order), wanted);
        }
    }
}
