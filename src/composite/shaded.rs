//! The plain style: lit surfaces, transparent ones letting deeper ones through.
//!
//! *Practice.* Surfaces are lit as [`lighting`](super::lighting) says. Samples are blended in linear light, each front to back
//! on its own, so that edges between two leaves of one pixel show neither background nor halo.

use std::sync::Mutex;

use rayon::prelude::*;

use super::Picture;
use super::canvas::rows_of_tiles;
use super::lighting::{Batch, Look, Rows, Shader};
use crate::layers::{Boundary, LayerSource, LayerTile, MAX_SAMPLES, OpaqueTile, TILE_SIDE};
use crate::space::{Camera, PixelRect};

/// Draws `source`, tile by tile in parallel; beside the picture only a few tiles are in memory at any time. The same bits
/// on any number of threads. `on_tile` is called once for each finished tile, from any thread (there are
/// [`tile_count`]).
pub fn shaded(source: &dyn LayerSource, look: &Look, on_tile: &(dyn Fn() + Sync)) -> Picture {
    let samples = source.samples().clamp(1, MAX_SAMPLES);
    let spare: Mutex<Vec<OpaqueTile>> = Mutex::default();
    let spare = || spare.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    by_tiles(source.camera(), look, &|shader, rect, rows| {
        let mut tile = spare().pop().unwrap_or_default();
        let covered = if source.draw_opaque(rect, &mut tile) {
            shader.light_opaque(&tile, rect, rows, look.background)
        } else {
            blend_tile(&source.draw(rect), samples, shader, look.background).put(rows)
        };
        spare().push(tile);
        on_tile();
        covered
    })
}

/// A tile's pixels, row by row, and how many of them show a surface.
pub(super) struct Blended {
    pub pixels: Vec<[f32; 4]>,
    pub covered: u64,
}

impl Blended {
    /// Copies the pixels to their rows; returns how many show a surface.
    fn put(&self, rows: &mut Rows) -> u64 {
        let mut rest = &self.pixels[..];
        for row in rows.iter_mut() {
            let (pixels, below) = rest.split_at(row.len());
            row.copy_from_slice(pixels);
            rest = below;
        }
        self.covered
    }
}

/// Draws the pixels of a rectangle into their places; returns how many show a surface.
type DrawTile<'a> = dyn Fn(&Shader, PixelRect, &mut Rows) -> u64 + Sync + 'a;

fn by_tiles(camera: &Camera, look: &Look, draw: &DrawTile) -> Picture {
    let (width, height) = (camera.width, camera.height);
    let shader = Shader::new(&look.light, camera);
    let mut pixels = vec![[0.0; 4]; width as usize * height as usize];
    let tiles = rows_of_tiles(&mut pixels, width as usize).into_par_iter();
    let rects = PixelRect::tiles(width, height, TILE_SIDE);
    let covered = tiles.zip(rects).map(|(mut rows, rect)| draw(&shader, rect, &mut rows)).sum();
    let has_alpha = look.background[3] < 1.0;
    Picture { width, height, pixels, depth: None, covered, has_alpha }
}

/// How many tiles [`shaded`] draws for `camera`.
pub fn tile_count(camera: &Camera) -> u64 {
    u64::from(camera.width.div_ceil(TILE_SIDE)) * u64::from(camera.height.div_ceil(TILE_SIDE))
}

pub(super) fn blend_tile(tile: &LayerTile, samples: u32, shader: &Shader, background: [f32; 4]) -> Blended {
    let mut pixels = vec![background; tile.rect.area()];
    let mut covered = 0;
    // Most pixels show one opaque surface: those are lit several at a time.
    let all = u16::MAX >> (MAX_SAMPLES - samples);
    let mut batch = Batch::default();
    // Of all boundaries, where some pixels need more than one.
    let mut lit: Option<Vec<[f32; 4]>> = None;
    let across = tile.rect.width() as usize;
    for (row, y) in (tile.rect.y0..tile.rect.y1).enumerate() {
        let offsets = &tile.offsets[row * across..=(row + 1) * across];
        for ((column, x), of_pixel) in (tile.rect.x0..tile.rect.x1).enumerate().zip(offsets.windows(2)) {
            let of_pixel = of_pixel[0] as usize..of_pixel[1] as usize;
            let boundaries = &tile.boundaries[of_pixel.clone()];
            let Some(first) = boundaries.first() else { continue };
            covered += 1;
            let index = row * across + column;
            if first.samples & all == all && first.opacity >= 1.0 {
                batch.push(index, shader.centre_of(x, y), first);
                if batch.is_full() {
                    shader.light(&mut batch, &mut pixels);
                }
            } else {
                let lit = lit.get_or_insert_with(|| shader.lit_tile(tile, usize::MAX, &[]));
                pixels[index] = if samples == 1 {
                    blend_one(&lit[of_pixel], background)
                } else {
                    let mut colours = lit[of_pixel].iter();
                    // `blend` may stop early or leave out boundaries, but asks in order.
                    let mut next = boundaries.iter();
                    blend(boundaries, samples, background, |boundary| {
                        let number = next.by_ref().position(|b| std::ptr::eq(b, boundary)).unwrap_or(0);
                        colours.nth(number).map_or([0.0; 3], |&[r, g, b, _]| [r, g, b])
                    })
                };
            }
        }
    }
    shader.light(&mut batch, &mut pixels);
    Blended { pixels, covered }
}

/// One pixel of one sample: lit colours with their opacities, front to back over `background`. Linear, straight alpha.
pub(super) fn blend_one(lit: &[[f32; 4]], background: [f32; 4]) -> [f32; 4] {
    let (mut light, mut through) = ([0.0; 3], 1.0);
    for &[r, g, b, opacity] in lit {
        let weight = through * opacity;
        light = [light[0] + weight * r, light[1] + weight * g, light[2] + weight * b];
        through *= 1.0 - opacity;
        if through <= 0.0 {
            break;
        }
    }
    over(light, through, background)
}

/// Premultiplied `light` over `background`, of which it lets a share `through`: linear RGB, straight alpha.
#[inline(always)]
pub(super) fn over(light: [f32; 3], through: f32, background: [f32; 4]) -> [f32; 4] {
    let [r, g, b, a] = background;
    let alpha = (1.0 - through) + through * a;
    if !(alpha > 0.0) {
        return [0.0; 4];
    }
    let mixed = [light[0] + through * a * r, light[1] + through * a * g, light[2] + through * a * b];
    // Nearly every picture stands on paper, where there is nothing to divide by.
    if alpha == 1.0 {
        return [mixed[0], mixed[1], mixed[2], alpha];
    }
    [mixed[0] / alpha, mixed[1] / alpha, mixed[2] / alpha, alpha]
}

/// One pixel: the mean over its samples, each blended front to back over `background`. Linear, straight alpha.
pub fn blend(
    boundaries: &[Boundary],
    samples: u32,
    background: [f32; 4],
    mut lit: impl FnMut(&Boundary) -> [f32; 3],
) -> [f32; 4] {
    let all = (1u32 << samples) - 1;
    let mut transmitted = [1.0f32; MAX_SAMPLES as usize];
    // Samples that still let light through.
    let mut open = all;
    let mut light = [0.0f32; 3]; // premultiplied, summed over samples
    for boundary in boundaries {
        let seen_by = u32::from(boundary.samples) & open;
        if seen_by == 0 {
            continue;
        }
        let opacity = boundary.opacity.clamp(0.0, 1.0);
        let mut weight = 0.0;
        let mut rest = seen_by;
        while rest != 0 {
            let sample = rest.trailing_zeros() as usize;
            rest &= rest - 1;
            weight += transmitted[sample] * opacity;
            transmitted[sample] *= 1.0 - opacity;
            if transmitted[sample] <= 0.0 {
                open &= !(1 << sample);
            }
        }
        let colour = lit(boundary);
        (0..3).for_each(|c| light[c] += weight * colour[c]);
        if open == 0 {
            break;
        }
    }
    let count = samples as f32;
    let through = transmitted[..samples as usize].iter().sum::<f32>() / count;
    over(light.map(|c| c / count), through, background)
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicU64, Ordering};

    use glam::{DVec3, Vec3};

    use super::super::lighting::GROUND_SHARE;
    use super::*;
    use crate::layers::{Facing, LayerStack};
    use crate::scene::Light;
    use crate::space::Lens;

    fn camera(width: u32, height: u32) -> Camera {
        Camera::look_at(DVec3::new(0.0, -4.0, 0.0), DVec3::ZERO, DVec3::Z, Lens::Height(2.0), width, height).unwrap()
    }

    fn boundary(depth: f32, colour: [f32; 3], opacity: f32, samples: u16) -> Boundary {
        let normal = Vec3::NEG_Y;
        Boundary { depth, normal, colour, opacity, leaf: 0, body: 0, facing: Facing::Front, samples }
    }

    const RED: [f32; 3] = [1.0, 0.0, 0.0];
    const GREEN: [f32; 3] = [0.0, 1.0, 0.0];
    const WHITE: [f32; 4] = [1.0; 4];
    const CLEAR: [f32; 4] = [0.0; 4];
    /// One step of an 8-bit picture.
    const STEP: f32 = 1.0 / 255.0;

    fn unlit(boundary: &Boundary) -> [f32; 3] {
        boundary.colour
    }

    fn assert_near(got: [f32; 4], wanted: [f32; 4]) {
        assert!(got.iter().zip(&wanted).all(|(a, b)| (a - b).abs() < STEP), "{got:?} instead of {wanted:?}");
    }

    #[test]
    fn transparent_surfaces_blend_as_the_formula_says() {
        let front = boundary(1.0, RED, 0.5, 1);
        let back = boundary(2.0, GREEN, 0.25, 1);
        // c = a₁c₁ + (1−a₁)(a₂c₂ + (1−a₂)b), over white.
        assert_near(blend(&[front, back], 1, WHITE, unlit), [0.875, 0.5, 0.375, 1.0]);
        // Over nothing: alpha = 1 − (1−a₁)(1−a₂), colour divided by it.
        let alpha = 1.0 - 0.5 * 0.75;
        assert_near(blend(&[front, back], 1, CLEAR, unlit), [0.5 / alpha, 0.125 / alpha, 0.0, alpha]);
        // Over a half-transparent background.
        let half_blue = [0.0, 0.0, 1.0, 0.5];
        assert_near(blend(&[boundary(1.0, RED, 0.5, 1)], 1, half_blue, unlit), [0.5 / 0.75, 0.0, 0.25 / 0.75, 0.75]);
    }

    #[test]
    fn samples_are_blended_each_on_its_own() {
        let left = boundary(1.0, RED, 1.0, 0b0011);
        let right = boundary(2.0, GREEN, 1.0, 0b1100);
        // Two leaves share the pixel: no background between them.
        assert_near(blend(&[left, right], 4, WHITE, unlit), [0.5, 0.5, 0.0, 1.0]);
        // A deeper boundary of all samples shows only where the first is not.
        assert_near(blend(&[left, boundary(2.0, GREEN, 1.0, 0b1111)], 4, WHITE, unlit), [0.5, 0.5, 0.0, 1.0]);
        // A silhouette: half of the pixel is background.
        assert_near(blend(&[left], 4, WHITE, unlit), [1.0, 0.5, 0.5, 1.0]);
        assert_near(blend(&[left], 4, CLEAR, unlit), [1.0, 0.0, 0.0, 0.5]);
        // Every bit, at the most samples there are.
        assert_near(blend(&[boundary(1.0, RED, 1.0, u16::MAX)], MAX_SAMPLES, CLEAR, unlit), [1.0, 0.0, 0.0, 1.0]);
    }

    #[test]
    fn nothing_is_background_and_opaque_hides_what_is_deeper() {
        assert_eq!(blend(&[], 4, CLEAR, unlit), CLEAR);
        assert_eq!(blend(&[], 4, WHITE, unlit), WHITE);
        let mut asked = 0;
        let hidden = boundary(2.0, GREEN, 1.0, 1);
        let got = blend(&[boundary(1.0, RED, 1.0, 1), hidden], 1, WHITE, |b| {
            asked += 1;
            b.colour
        });
        assert_eq!((got, asked), ([1.0, 0.0, 0.0, 1.0], 1));
    }

    #[test]
    fn every_pixel_lands_in_its_place_whatever_the_tiles() {
        // Neither side is a multiple of the tile's.
        let (width, height) = (150, 70);
        let at = |x: u32, y: u32| {
            let colour = [x as f32 / 256.0, y as f32 / 256.0, 0.0];
            if (x + y).is_multiple_of(3) { Vec::new() } else { vec![boundary(1.0, colour, 1.0, 1)] }
        };
        let source = LayerStack::from_fn(camera(width, height), 1, at);
        // Light from everywhere alone: a surface seen head on shows its colour times the hemisphere's middle.
        let light = Light { towards: DVec3::Z, in_world: true, ambient: 1.0 };
        let tiles = AtomicU64::new(0);
        let count = || {
            tiles.fetch_add(1, Ordering::Relaxed);
        };
        let picture = shaded(&source, &Look { light, background: CLEAR }, &count);
        assert_eq!(tiles.into_inner(), tile_count(&source.camera));
        let seen = (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).filter(|&(x, y)| !at(x, y).is_empty());
        assert_eq!(picture.covered, seen.count() as u64);
        let middle = GROUND_SHARE + 0.5 * (1.0 - GROUND_SHARE);
        for y in 0..height {
            for x in 0..width {
                let wanted = match at(x, y).first() {
                    None => CLEAR,
                    Some(b) => [b.colour[0] * middle, b.colour[1] * middle, 0.0, 1.0],
                };
                assert_near(picture.at(x, y), wanted);
            }
        }
    }

    #[test]
    fn pixels_lit_together_are_lit_as_each_by_itself() {
        let perspective = Camera::look_at(DVec3::new(1.0, -4.0, 2.0), DVec3::ZERO, DVec3::Z, Lens::FovY(70.0), 37, 29);
        for camera in [camera(37, 29), perspective.unwrap()] {
            let at = |x: u32, y: u32| {
                // Normals of every direction; a transparent pixel now and then breaks the row.
                let (turn, tilt) = (0.7 * x as f32 + 0.1 * y as f32, 0.3 * y as f32);
                let normal = Vec3::new(turn.cos() * tilt.cos(), turn.sin() * tilt.cos(), tilt.sin());
                let opacity = if (x + 3 * y).is_multiple_of(7) { 0.5 } else { 1.0 };
                vec![Boundary { normal, ..boundary(1.0, [0.2, 0.5, 0.9], opacity, 1) }]
            };
            let source = LayerStack::from_fn(camera.clone(), 1, at);
            for in_world in [false, true] {
                let light = Light { towards: DVec3::new(0.3, -1.0, 0.5), in_world, ambient: 0.2 };
                let picture = shaded(&source, &Look { light, background: WHITE }, &|| ());
                let shader = Shader::new(&light, &camera);
                for (x, y) in (0..29).flat_map(|y| (0..37).map(move |x| (x, y))) {
                    let alone = blend(&at(x, y), 1, WHITE, |b| shader.lit(b, shader.towards_eye(x, y)));
                    let together = picture.at(x, y);
                    assert!(alone.iter().zip(&together).all(|(a, b)| (a - b).abs() < 1e-5), "{alone:?} {together:?}");
                }
            }
        }
    }
}
