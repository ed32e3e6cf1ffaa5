//! The triangles of a tile at one sample of its pixels: each to the code that draws its kind.

use fearless_simd::Simd;
use glam::DVec2;

use super::super::beyond;
use super::super::bins::Entry;
use super::super::fragments::{Fragments, LANES};
use super::super::model::Surface;
use super::super::planes::NO_PLANE;
use super::super::project::{Affine, place};
use super::super::raster::{self, Grid, Key, Offsets};
use super::super::setup;
use super::MeshFrame;

/// One sample of a tile's pixels.
pub(super) struct Pass<'a> {
    pub frame: &'a MeshFrame<'a>,
    pub grid: Grid,
    /// Of the sample in its pixel, pixels.
    pub offset: DVec2,
}

impl Pass<'_> {
    /// A key over positions as one over whole pixels' samples.
    pub fn at_samples(&self, key: Key) -> Key {
        Key { over: key.over.counted_from(self.offset), ..key }
    }

    #[inline(always)]
    pub fn meshlet<S: Simd>(
        &self,
        simd: S,
        offsets: &Offsets<S>,
        entry: &Entry,
        slot: u32,
        planes: &[Key],
        fragments: &mut Fragments,
    ) {
        let (model, vertices) = (self.frame.model, &self.frame.vertices);
        let first = model.meshlets[entry.meshlet as usize].first;
        let mut rest = entry.triangles;
        let mut batch = setup::Batch::default();
        while rest != 0 {
            let number = first + rest.trailing_zeros();
            rest &= rest - 1;
            let corners = model.triangles[number as usize].map(|v| &vertices[v as usize]);
            if corners[0][3] | corners[1][3] | corners[2][3] == place::FINE {
                batch.push(number, corners);
            } else {
                self.beyond(simd, number, slot, planes, fragments);
            }
            if batch.len < LANES && rest != 0 {
                continue;
            }
            let ready = batch.ready(simd, &self.grid);
            let (mut small, mut medium, mut large) = (ready.visible(), ready.medium, ready.large);
            if small | medium | large != 0 {
                let (surfaces, view) = (&model.surfaces[..], &self.frame.view);
                let keys = batch.keys(small | medium | large, surfaces, view, self.offset);
                while small != 0 {
                    let lane = small.trailing_zeros() as usize;
                    small &= small - 1;
                    ready.draw(lane, &keys.of(lane, &ready, planes), &self.grid, slot, batch.numbers[lane], fragments);
                }
                while medium != 0 {
                    let lane = medium.trailing_zeros() as usize;
                    medium &= medium - 1;
                    let (within, edges) = ready.outline(lane);
                    let (key, number) = (keys.of(lane, &ready, planes), batch.numbers[lane]);
                    raster::blocks(simd, offsets, &self.grid, within, &edges, &key, slot, number, fragments);
                }
                while large != 0 {
                    let lane = large.trailing_zeros() as usize;
                    large &= large - 1;
                    let number = batch.numbers[lane];
                    let corners = model.triangles[number as usize].map(|v| &vertices[v as usize]);
                    let key = keys.of(lane, &ready, planes);
                    raster::triangle(simd, offsets, &self.grid, corners, &key, slot, number, fragments);
                }
            }
            batch.len = 0;
        }
    }

    #[inline(always)]
    pub fn own_key(&self, surface: &Surface) -> Affine {
        self.frame.view.key_over(surface.normal.as_dvec3(), surface.offset).counted_from(self.offset)
    }

    /// Draws a triangle that is not on the grid.
    #[inline(never)]
    pub fn beyond<S: Simd>(&self, simd: S, number: u32, slot: u32, planes: &[Key], fragments: &mut Fragments) {
        let (model, view) = (self.frame.model, &self.frame.view);
        let (triangle, surface) = (model.triangles[number as usize], &model.surfaces[number as usize]);
        let over = if surface.plane == NO_PLANE { self.own_key(surface) } else { planes[surface.plane as usize].over };
        let corner = |i: usize| {
            let vertex = triangle[i];
            let p_in_view = view.camera.view_from_world(model.position(vertex));
            beyond::Corner { vertex, snapped: &self.frame.vertices[vertex as usize], p_in_view }
        };
        let corners = [corner(0), corner(1), corner(2)];
        beyond::triangle(simd, view, &self.grid, corners, over, slot, number, fragments);
    }
}
