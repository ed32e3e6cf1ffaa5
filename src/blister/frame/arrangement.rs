//! What a frame draws, for a rasteriser elsewhere: triangles on the grid, and the fragments that no such triangle has.
//!
//! *Practice.* A rasteriser with 8 bits of subpixels and the top-left rule covers the same samples as [`raster`](super::super::raster)
//! does, if it gets the snapped corners. What it cannot draw as exactly is handed over as fragments: triangles that pass the
//! eye ([`beyond`](super::super::beyond)), and hits of analytic leaves ([`solids`](super::super::solids)). Every surface has its key as a
//! function of the pixel, also where it is a fragment's alone, so that those that share a plane get the same bits.

use std::collections::HashMap;

use glam::{DVec2, Vec3};
use rayon::prelude::*;

use super::super::bins::Entry;
use super::super::fragments::{BLOCK_HEIGHT, BLOCK_WIDTH, BLOCKS_ACROSS, BLOCKS_DOWN, LANES};
use super::super::planes::NO_PLANE;
pub(crate) use super::super::project::SUBPIXELS;
use super::super::project::{Affine, place};
pub(crate) use super::super::raster::owns_zero;
use super::super::raster::{Grid, Key};
use super::super::setup::held;
use super::super::solids;
use super::super::write::Writer;
use super::{MeshFrame, Pass, Scratch, pixel_of};
use crate::csg::{Kept, LeafId, Shrunk};
use crate::layers::{LayerLimit, TILE_SIDE, sample_offsets};
use crate::space::{Camera, PixelRect};

/// A surface that fragments are of.
#[derive(Debug, Clone, Copy)]
pub(crate) struct DrawnSurface {
    /// The leaf's number among [`Arranged::slots`].
    pub slot: u32,
    /// The key at the sample of pixel (x, y) is `key[0]·(x − anchor.x) + key[1]·(y − anchor.y) + key[2]`, held to `range`.
    pub key: [f32; 3],
    /// A whole pixel.
    pub anchor: [f32; 2],
    /// Least and greatest key.
    pub range: [f32; 2],
    /// Unit normal in world space, either way round.
    pub normal: Vec3,
    /// What colour it has, where that is not its leaf's.
    pub colour: SurfaceColour,
    /// Whether boundaries on it show: a half-space shows only within its square.
    pub is_drawn: bool,
}

/// The colour of a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum SurfaceColour {
    /// The leaf's.
    Leaf,
    /// Linear RGB.
    Own([f32; 3]),
    /// sRGB bytes at the corners, mixed between them.
    Corners([[u8; 3]; 3]),
}

/// How a slot looks.
#[derive(Debug, Clone, Copy)]
pub(crate) struct DrawnSlot {
    pub leaf: LeafId,
    /// Linear RGB.
    pub colour: [f32; 3],
    pub opacity: f32,
    /// Neither in nor out.
    pub is_sheet: bool,
    /// Whether it is certain that no ray begins inside.
    pub begins_outside: bool,
    /// For a half-space: at the sample of pixel (x, y) rays begin inside where `a·x + b·y + c < 0`. Its fragments do not tell.
    pub begins_inside: Option<[f64; 3]>,
}

/// Takes what a frame draws.
pub(crate) trait Arrangement {
    /// A triangle: its corners in pixels of the picture, so that samples lie at pixels' centres.
    fn triangle(&mut self, corners: [[f32; 2]; 3], surface: &DrawnSurface);
    /// A surface that has only fragments; returns its number. All triangles come before.
    fn surface(&mut self, surface: &DrawnSurface) -> u32;
    /// A fragment at a pixel.
    fn fragment(&mut self, x: u32, y: u32, surface: u32);
}

/// What of a frame is not geometry.
#[derive(Debug)]
pub(crate) struct Arranged {
    /// The expression over all leaves; `None` where it is a constant, and nothing is to be drawn.
    pub expression: Option<Shrunk>,
    /// By slot of the expression.
    pub slots: Vec<DrawnSlot>,
    /// Whether only what an opaque picture needs is wanted.
    pub is_nearest: bool,
}

/// What one fragment is of, while tiles are gathered.
enum Found {
    Triangle(u32),
    Coloured(u32, [f32; 3]),
    Hit { slot: u32, key: f32, plane: u32, normal: Vec3, is_drawn: bool },
}

impl MeshFrame<'_> {
    /// The frame's camera.
    pub(crate) fn camera_of(&self) -> &Camera {
        &self.view.camera
    }

    /// Samples a pixel.
    pub(crate) fn sample_count(&self) -> u32 {
        self.samples
    }

    /// The expression and how its leaves look, at one of the pixels' samples.
    pub(crate) fn arranged(&self, sample: usize) -> Arranged {
        let flat = &self.model.flat;
        let mut shrunk = Shrunk::default();
        let is_open = shrunk.keep(flat, flat.leaves()) == Kept::Open;
        let offset = snapped_offset(self.samples, sample);
        let slot = |leaf: &LeafId| {
            let look = self.model.look(*leaf);
            let endless = self.model.solid_of(*leaf).filter(|solid| solid.is_endless() && !look.is_sheet);
            let begins_inside = endless.map(|solid| {
                let side = |px: DVec2| {
                    let origin = self.view.camera.ray(px + offset).origin;
                    solid.solid.signed_distance_bound(solid.leaf_from_world.transform_point3(origin))
                };
                let at_corner = side(DVec2::ZERO);
                [side(DVec2::X) - at_corner, side(DVec2::Y) - at_corner, at_corner]
            });
            DrawnSlot {
                leaf: *leaf,
                colour: look.colour,
                opacity: look.opacity,
                is_sheet: look.is_sheet,
                begins_outside: self.begins_outside[leaf.0 as usize],
                begins_inside,
            }
        };
        let slots = if is_open { shrunk.slots().iter().map(slot).collect() } else { Vec::new() };
        Arranged { expression: is_open.then_some(shrunk), slots, is_nearest: self.limit == LayerLimit::Nearest }
    }

    /// Whether every fragment is of a triangle on the grid, so that what is handed over is the same for all parts of the picture.
    pub(crate) fn is_all_on_grid(&self) -> bool {
        let is_on_grid = |entry: &Entry| {
            let first = self.model.meshlets[entry.meshlet as usize].first;
            (0..u64::BITS).filter(|i| entry.triangles >> i & 1 == 1).all(|i| {
                let corners = self.model.triangles[(first + i) as usize].map(|v| self.vertices[v as usize][3]);
                corners[0] | corners[1] | corners[2] == place::FINE
            })
        };
        self.model.solids.is_empty() && self.bins.all().iter().all(is_on_grid)
    }

    /// Hands over everything that is drawn at one of the pixels' samples: all triangles, and the fragments beside them within `rect`.
    /// `shrunk` is that of [`arranged`](Self::arranged).
    pub(crate) fn arrange(&self, shrunk: &Shrunk, sample: usize, rect: PixelRect, sink: &mut impl Arrangement) {
        let offset = snapped_offset(self.samples, sample);
        let shift = (offset * f64::from(SUBPIXELS)).as_ivec2();
        let pass = Pass { frame: self, grid: Grid { x0: 0, y0: 0, sample: [0, 0] }, offset };
        let planes: Vec<Key> = self.planes.iter().map(|key| pass.at_samples(*key)).collect();
        let slot_of = |leaf: LeafId| shrunk.slots().binary_search(&leaf).ok().map(|slot| slot as u32);

        // Step 1: triangles on the grid, each once, whatever tiles it lies in.
        let mut visible = vec![0_u64; self.model.meshlets.len()];
        for entry in self.bins.all() {
            visible[entry.meshlet as usize] |= entry.triangles;
        }
        let mut any_beyond = false;
        for (meshlet, mut rest) in self.model.meshlets.iter().zip(visible) {
            let Some(slot) = slot_of(meshlet.leaf) else { continue };
            while rest != 0 {
                let number = meshlet.first + rest.trailing_zeros();
                rest &= rest - 1;
                let corners = self.model.triangles[number as usize].map(|v| &self.vertices[v as usize]);
                if corners[0][3] | corners[1][3] | corners[2][3] != place::FINE {
                    any_beyond = true;
                    continue;
                }
                let surface = self.triangle_surface(&pass, &planes, number, slot);
                const CENTRE: i32 = SUBPIXELS / 2;
                let px = |at: i32, shift: i32| (at - shift + CENTRE) as f32 / SUBPIXELS as f32;
                sink.triangle(corners.map(|v| [px(v[0], shift.x), px(v[1], shift.y)]), &surface);
            }
        }
        if !any_beyond && self.model.solids.is_empty() {
            return;
        }

        // Step 2: what has to be found pixel by pixel, tiles in parallel and then in order.
        let mut tiles = PixelRect::tiles(self.view.camera.width, self.view.camera.height, TILE_SIDE);
        tiles.retain(|tile| tile.x0 < rect.x1 && rect.x0 < tile.x1 && tile.y0 < rect.y1 && rect.y0 < tile.y1);
        let found: Vec<Vec<(u32, u32, Found)>> = tiles
            .into_par_iter()
            .map(|tile| self.fragments_of(tile, shift.to_array(), offset, any_beyond, &slot_of))
            .collect();
        let mut of_triangle: HashMap<u32, u32> = HashMap::new();
        let is_within = |x: u32, y: u32| (rect.x0..rect.x1).contains(&x) && (rect.y0..rect.y1).contains(&y);
        for (x, y, found) in found.into_iter().flatten().filter(|(x, y, _)| is_within(*x, *y)) {
            let slot_of_triangle = |number: u32| {
                let meshlet = self.model.meshlets.partition_point(|meshlet| meshlet.first <= number) - 1;
                slot_of(self.model.meshlets[meshlet].leaf).expect("only leaves of the expression are drawn")
            };
            let surface = match found {
                Found::Triangle(number) => *of_triangle.entry(number).or_insert_with(|| {
                    sink.surface(&self.triangle_surface(&pass, &planes, number, slot_of_triangle(number)))
                }),
                Found::Coloured(number, colour) => sink.surface(&DrawnSurface {
                    colour: SurfaceColour::Own(colour),
                    ..self.triangle_surface(&pass, &planes, number, slot_of_triangle(number))
                }),
                Found::Hit { slot, key, plane, normal, is_drawn } => {
                    let at_pixel = Key { over: Affine { x: 0.0, y: 0.0, c: f64::from(key) }, low: key, high: key };
                    let key = planes.get(plane as usize).copied().unwrap_or(at_pixel);
                    let colour = SurfaceColour::Leaf;
                    sink.surface(&DrawnSurface { is_drawn, ..drawn(slot, &key, [0.0; 2], normal, colour) })
                }
            };
            sink.fragment(x, y, surface);
        }
    }

    fn triangle_surface(&self, pass: &Pass, planes: &[Key], number: u32, slot: u32) -> DrawnSurface {
        let surface = &self.model.surfaces[number as usize];
        let triangle = self.model.triangles[number as usize];
        let corners = triangle.map(|v| &self.vertices[v as usize]);
        let is_beyond = corners[0][3] | corners[1][3] | corners[2][3] != place::FINE;
        let (key, anchor) = if surface.plane != NO_PLANE {
            // One function for all that share the plane.
            (planes[surface.plane as usize], [0.0; 2])
        } else if is_beyond {
            let over = pass.own_key(surface);
            (held(over, f32::MIN, f32::MAX), [0.0; 2])
        } else {
            let within = |at: i32, side: u32| (at / SUBPIXELS).clamp(0, side as i32) as f32;
            let camera = &self.view.camera;
            (pass.key(number, planes), [within(corners[0][0], camera.width), within(corners[0][1], camera.height)])
        };
        let look = self.model.look(shown(self, slot));
        let colour = if look.vertex_colours {
            SurfaceColour::Corners(triangle.map(|v| self.model.vertex_colours[v as usize]))
        } else {
            SurfaceColour::Leaf
        };
        drawn(slot, &key, anchor, surface.normal, colour)
    }

    /// The fragments of one tile that no triangle on the grid has: pixel, and what they are of.
    fn fragments_of(
        &self,
        tile: PixelRect,
        shift: [i32; 2],
        offset: DVec2,
        any_beyond: bool,
        slot_of: &(impl Fn(LeafId) -> Option<u32> + Sync),
    ) -> Vec<(u32, u32, Found)> {
        let mut out = Vec::new();
        self.with_scratch(|scratch| {
            let grid = Grid {
                x0: tile.x0,
                y0: tile.y0,
                sample: [tile.x0 as i32 * SUBPIXELS + shift[0], tile.y0 as i32 * SUBPIXELS + shift[1]],
            };
            let pass = Pass { frame: self, grid, offset };
            scratch.planes.clear();
            scratch.planes.extend(self.planes.iter().map(|key| pass.at_samples(*key)));
            if any_beyond {
                scratch.fragments.clear();
                for entry in self.bins.of(tile.x0 / TILE_SIDE, tile.y0 / TILE_SIDE) {
                    let meshlet = &self.model.meshlets[entry.meshlet as usize];
                    let Some(slot) = slot_of(meshlet.leaf) else { continue };
                    let mut rest = entry.triangles;
                    while rest != 0 {
                        let number = meshlet.first + rest.trailing_zeros();
                        rest &= rest - 1;
                        let corners = self.model.triangles[number as usize].map(|v| self.vertices[v as usize][3]);
                        if corners[0] | corners[1] | corners[2] == place::FINE {
                            continue;
                        }
                        let Scratch { planes, fragments, .. } = &mut *scratch;
                        fearless_simd::dispatch!(self.level, simd => pass.beyond(simd, number, slot, planes, fragments));
                    }
                }
                let writer = Writer {
                    model: self.model,
                    view: &self.view,
                    looks: &[],
                    hits: &[],
                    offset,
                    samples: 1,
                };
                each_fragment(scratch, tile, |x, y, slot, key, what| {
                    let look = self.model.look(shown(self, slot));
                    let found = if look.vertex_colours {
                        Found::Coloured(what, writer.colour_of(what, x, y, key, look))
                    } else {
                        Found::Triangle(what)
                    };
                    out.push((x, y, found));
                });
            }
            if !self.model.solids.is_empty() {
                scratch.fragments.clear();
                scratch.hits.clear();
                for (solid, covers) in self.model.solids.iter().zip(&self.covers) {
                    let Some(slot) = slot_of(solid.leaf) else { continue };
                    let Scratch { planes, hits, fragments, .. } = &mut *scratch;
                    solids::draw(&self.view, planes, &grid, solid, *covers, slot, hits, fragments);
                }
                let hits = std::mem::take(&mut scratch.hits);
                each_fragment(scratch, tile, |x, y, slot, key, what| {
                    let hit = &hits[what as usize];
                    let (normal, is_drawn) = (hit.normal, hit.is_drawn);
                    out.push((x, y, Found::Hit { slot, key, plane: hit.plane, normal, is_drawn }));
                });
                scratch.hits = hits;
            }
        });
        out
    }
}

/// The leaf of a slot: slots number the leaves of the whole expression.
fn shown(frame: &MeshFrame, slot: u32) -> LeafId {
    frame.model.flat.leaves()[slot as usize]
}

/// Where in its pixel a sample lies on the grid, pixels.
fn snapped_offset(samples: u32, sample: usize) -> DVec2 {
    (sample_offsets(samples)[sample] * f64::from(SUBPIXELS)).round() / f64::from(SUBPIXELS)
}

fn drawn(slot: u32, key: &Key, anchor: [f32; 2], normal: Vec3, colour: SurfaceColour) -> DrawnSurface {
    let at_anchor = key.over.at(f64::from(anchor[0]), f64::from(anchor[1]));
    let of_plane = [key.over.x as f32, key.over.y as f32, at_anchor as f32];
    // A plane that holds the eye says nothing of depth: its least key, as the CPU's clamp of NaN has it.
    let is_sound = of_plane.iter().all(|number| number.is_finite());
    DrawnSurface {
        slot,
        key: if is_sound { of_plane } else { [0.0, 0.0, key.low] },
        anchor,
        range: [key.low, key.high],
        normal,
        colour,
        is_drawn: true,
    }
}

impl Pass<'_> {
    /// The key over a triangle's plane, its own or a shared one.
    fn key(&self, number: u32, planes: &[Key]) -> Key {
        let surface = &self.frame.model.surfaces[number as usize];
        if surface.plane != NO_PLANE {
            return planes[surface.plane as usize];
        }
        let triangle = self.frame.model.triangles[number as usize];
        let [a, b, c] = triangle.map(|v| f32::from_bits(self.frame.vertices[v as usize][2] as u32));
        held(self.own_key(surface), a.min(b).min(c), a.max(b).max(c))
    }
}

/// Calls `take` with pixel, slot, key and what of every fragment of the tile that lies in the picture.
fn each_fragment(scratch: &mut Scratch, tile: PixelRect, mut take: impl FnMut(u32, u32, u32, f32, u32)) {
    for block in 0..BLOCKS_ACROSS * BLOCKS_DOWN {
        let Scratch { fragments, layers, .. } = &mut *scratch;
        fragments.layers_of(block, layers);
        let corner = (tile.x0 + block % BLOCKS_ACROSS * BLOCK_WIDTH, tile.y0 + block / BLOCKS_ACROSS * BLOCK_HEIGHT);
        for &layer in &*layers {
            let layer = fragments.layer(layer);
            for lane in (0..LANES).filter(|lane| layer.taken >> lane & 1 == 1) {
                let (x, y) = pixel_of(lane);
                let (x, y) = (corner.0 + x, corner.1 + y);
                if x < tile.x1 && y < tile.y1 {
                    take(x, y, layer.slot, layer.keys[lane], fragments.what(layer, lane));
                }
            }
        }
    }
}
