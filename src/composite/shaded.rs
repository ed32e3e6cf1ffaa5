//! The plain style: lit surfaces, transparent ones letting deeper ones through.
//!
//! *Practice.* A surface is lit by one directional light (Lambert) and by a hemisphere that is brighter above than below,
//! so that faces turned from the light still differ; a faint highlight and a faint rim tell round from flat. Both sides of
//! a surface are lit alike: the normal is turned to the viewer, because a result's back face is as much a surface as its
//! front. Samples are blended in linear light, each front to back on its own, so that edges between two leaves of one
//! pixel show neither background nor halo.

use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

use fearless_simd::prelude::*;
use fearless_simd::{Level, Simd, f32x8};
use glam::{DVec2, Vec3};
use rayon::prelude::*;

use super::Picture;
use crate::layers::{Boundary, LayerSource, LayerTile, MAX_SAMPLES, OpaqueTile, TILE_SIDE};
use crate::scene::Light;
use crate::space::{Camera, PixelRect, Projection};

/// How the hemisphere's light spreads: from below comes this share of what comes from above.
pub(crate) const GROUND_SHARE: f32 = 0.45;
/// Strength of the highlight where the light is mirrored to the eye; faint, as of bone or plaster.
pub(crate) const HIGHLIGHT: f32 = 0.10;
/// Sharpness of the highlight (Blinn-Phong exponent): a spot of about 15° around the mirror direction.
pub(crate) const HIGHLIGHT_EXPONENT: i32 = 32;
/// Light added at grazing angles, as a share of the surface's colour.
pub(crate) const RIM: f32 = 0.10;
/// The rim reaches this far in from a silhouette: Schlick's exponent.
pub(crate) const RIM_EXPONENT: i32 = 4;

/// What the style needs beside the layers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Look {
    /// The light.
    pub light: Light,
    /// Linear RGB and straight alpha behind everything.
    pub background: [f32; 4],
}

/// Pixels that are lit at once.
const LANES: usize = 8;

/// Opaque pixels that wait to be lit together.
#[derive(Debug, Default)]
struct Batch {
    len: usize,
    /// Where in the tile they are.
    index: [usize; LANES],
    /// Pixel centres, from the picture's middle.
    at: [[f32; LANES]; 2],
    normal: [[f32; LANES]; 3],
    colour: [[f32; LANES]; 3],
}

impl Batch {
    #[inline(always)]
    fn push(&mut self, index: usize, at: [f32; 2], boundary: &Boundary) {
        let lane = self.len;
        self.len += 1;
        self.index[lane] = index;
        (self.at[0][lane], self.at[1][lane]) = (at[0], at[1]);
        let (normal, colour) = (boundary.normal.to_array(), boundary.colour);
        for k in 0..3 {
            self.normal[k][lane] = normal[k];
            self.colour[k][lane] = colour[k];
        }
    }
}

/// A [`Look`] as one camera sees it.
#[derive(Debug, Clone)]
pub struct Shader<'a> {
    level: Level,
    camera: &'a Camera,
    pub(crate) towards_light: Vec3,
    pub(crate) ambient: f32,
}

impl<'a> Shader<'a> {
    /// For pictures of `camera` under `light`.
    pub fn new(light: &Light, camera: &'a Camera) -> Self {
        let towards = if light.in_world { light.towards } else { camera.rotate_to_world(light.towards) };
        // A light from nowhere comes from the eye.
        let towards = towards.try_normalize().unwrap_or(-camera.forward);
        Self { level: Level::new(), camera, towards_light: towards.as_vec3(), ambient: light.ambient }
    }

    /// The unit vector from the surface towards the eye at the centre of pixel (`x`, `y`), in world space.
    pub fn towards_eye(&self, x: u32, y: u32) -> Vec3 {
        let ray = self.camera.ray(DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5));
        (-ray.dir).normalize().as_vec3()
    }

    /// The centre of a pixel, counted from the picture's middle.
    #[inline(always)]
    fn centre_of(&self, x: u32, y: u32) -> [f32; 2] {
        let along = |at: u32, side: u32| at as f32 + 0.5 - 0.5 * side as f32;
        [along(x, self.camera.width), along(y, self.camera.height)]
    }

    /// Lights what `batch` holds, writes it to its places in `pixels`, and empties it. The same light as [`lit`](Self::lit).
    fn light(&self, batch: &mut Batch, pixels: &mut [[f32; 4]]) {
        let lit = fearless_simd::dispatch!(self.level, simd => simd.vectorize(#[inline(always)] || self.lit_batch(simd, batch)));
        for (lane, &index) in batch.index[..batch.len].iter().enumerate() {
            pixels[index] = [lit[0][lane], lit[1][lane], lit[2][lane], 1.0];
        }
        batch.len = 0;
    }

    /// The lit colours of all boundaries of `tile`, in their order, each with its opacity. The same light as
    /// [`lit`](Self::lit).
    pub fn lit_tile(&self, tile: &LayerTile) -> Vec<[f32; 4]> {
        let mut lit = vec![[0.0; 4]; tile.boundaries.len()];
        let mut batch = Batch::default();
        for (row, y) in (tile.rect.y0..tile.rect.y1).enumerate() {
            for (column, x) in (tile.rect.x0..tile.rect.x1).enumerate() {
                let pixel = row * tile.rect.width() as usize + column;
                let centre = self.centre_of(x, y);
                for index in tile.offsets[pixel] as usize..tile.offsets[pixel + 1] as usize {
                    batch.push(index, centre, &tile.boundaries[index]);
                    if batch.len == LANES {
                        self.light(&mut batch, &mut lit);
                    }
                }
            }
        }
        self.light(&mut batch, &mut lit);
        lit.iter_mut().zip(&tile.boundaries).for_each(|(lit, boundary)| lit[3] = boundary.opacity.clamp(0.0, 1.0));
        lit
    }

    /// Lights the pixels of an opaque tile at `rect` into `rows`, those without a surface as `background`. The same light as
    /// [`lit`](Self::lit). Returns how many show a surface.
    fn light_opaque(&self, tile: &OpaqueTile, rect: PixelRect, rows: &mut Rows, background: [f32; 4]) -> u64 {
        fearless_simd::dispatch!(self.level, simd => simd.vectorize(
            #[inline(always)]
            || self.light_opaque_lanes(simd, tile, rect, rows, background),
        ))
    }

    #[inline(always)]
    fn light_opaque_lanes<S: Simd>(
        &self,
        simd: S,
        tile: &OpaqueTile,
        rect: PixelRect,
        rows: &mut Rows,
        background: [f32; 4],
    ) -> u64 {
        const STEPS: [f32; LANES] = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0];
        let steps = f32x8::from_slice(simd, &STEPS);
        let mut count = 0;
        for (row, pixels) in rows.iter_mut().enumerate() {
            let covered = tile.covered[row];
            count += u64::from(covered.count_ones());
            for (number, pixels) in pixels.chunks_mut(LANES).enumerate() {
                let covered = covered >> (number * LANES) & u64::from(u8::MAX);
                if covered == 0 {
                    pixels.fill(background);
                    continue;
                }
                let column = number * LANES;
                let place = row * TILE_SIDE as usize + column;
                let [x, y] = self.centre_of(rect.x0 + column as u32, rect.y0 + row as u32);
                let load = |plane: &[f32]| f32x8::from_slice(simd, &plane[place..place + LANES]);
                let lit = self.lit_lanes(
                    simd,
                    [steps + x, f32x8::splat(simd, y)],
                    [load(&tile.normals[0][..]), load(&tile.normals[1][..]), load(&tile.normals[2][..])],
                    [load(&tile.colours[0][..]), load(&tile.colours[1][..]), load(&tile.colours[2][..])],
                );
                if covered == u64::from(u8::MAX)
                    && let Ok(pixels) = <&mut [[f32; 4]; LANES]>::try_from(&mut *pixels)
                {
                    for (lane, pixel) in pixels.iter_mut().enumerate() {
                        *pixel = [lit[0][lane], lit[1][lane], lit[2][lane], 1.0];
                    }
                    continue;
                }
                for (lane, pixel) in pixels.iter_mut().enumerate() {
                    let is_covered = covered >> lane & 1 == 1;
                    *pixel = if is_covered { [lit[0][lane], lit[1][lane], lit[2][lane], 1.0] } else { background };
                }
            }
        }
        count
    }

    #[inline(always)]
    fn lit_batch<S: Simd>(&self, simd: S, batch: &Batch) -> [[f32; LANES]; 3] {
        let load = |lanes: &[f32; LANES]| f32x8::from_slice(simd, lanes);
        let [n_x, n_y, n_z] = &batch.normal;
        let [r, g, b] = &batch.colour;
        let at = [load(&batch.at[0]), load(&batch.at[1])];
        self.lit_lanes(simd, at, [load(n_x), load(n_y), load(n_z)], [load(r), load(g), load(b)])
    }

    /// Lit colours of surfaces at pixel centres `at`, with unit normals and unlit colours.
    #[inline(always)]
    fn lit_lanes<S: Simd>(
        &self,
        simd: S,
        at: [f32x8<S>; 2],
        [n_x, n_y, n_z]: [f32x8<S>; 3],
        [r, g, b]: [f32x8<S>; 3],
    ) -> [[f32; LANES]; 3] {
        let (forward, right, down) =
            (self.camera.forward.as_vec3(), self.camera.right.as_vec3(), self.camera.down.as_vec3());
        // Towards the eye.
        let (mut e_x, mut e_y, mut e_z) =
            (f32x8::splat(simd, -forward.x), f32x8::splat(simd, -forward.y), f32x8::splat(simd, -forward.z));
        if let Projection::Perspective { focal_px } = self.camera.projection {
            let per_focal = (1.0 / focal_px) as f32;
            let (x, y) = (at[0] * per_focal, at[1] * per_focal);
            e_x -= x * right.x + y * down.x;
            e_y -= x * right.y + y * down.y;
            e_z -= x * right.z + y * down.z;
            let per_length = f32x8::splat(simd, 1.0) / (e_x * e_x + e_y * e_y + e_z * e_z).sqrt();
            (e_x, e_y, e_z) = (e_x * per_length, e_y * per_length, e_z * per_length);
        }
        let facing_eye = n_x * e_x + n_y * e_y + n_z * e_z;
        // Both sides are lit alike: products with the normal change sign where it looks away.
        let one = f32x8::splat(simd, 1.0);
        let side = facing_eye.simd_lt(0.0).select(-one, one);
        let facing_eye = facing_eye.abs().min(1.0);
        let light = self.towards_light;
        let facing_light = (side * (n_x * light.x + n_y * light.y + n_z * light.z)).max(0.0);
        let up = -down;
        let from_above = side * (n_x * up.x + n_y * up.y + n_z * up.z) * 0.5 + 0.5;
        let hemisphere = (from_above * (1.0 - GROUND_SHARE) + GROUND_SHARE) * self.ambient;
        let rim = power::<RIM_EXPONENT, S>(one - facing_eye) * RIM;
        let diffuse = hemisphere + facing_light * (1.0 - self.ambient) + rim;
        let (b_x, b_y, b_z) = (e_x + light.x, e_y + light.y, e_z + light.z);
        let squared = b_x * b_x + b_y * b_y + b_z * b_z;
        // Straight from behind there is no direction between; nothing shines there.
        let per_length = squared.simd_gt(f32::MIN_POSITIVE).select(one / squared.sqrt(), one);
        let mirrored = (side * (n_x * b_x + n_y * b_y + n_z * b_z) * per_length).max(0.0);
        let shine = power::<HIGHLIGHT_EXPONENT, S>(mirrored) * HIGHLIGHT;
        let highlight = facing_light.simd_gt(0.0).select(shine, f32x8::splat(simd, 0.0));
        [(r * diffuse + highlight).into(), (g * diffuse + highlight).into(), (b * diffuse + highlight).into()]
    }

    /// Linear RGB of the lit surface at `boundary`, seen from `towards_eye` (world space, unit length).
    pub fn lit(&self, boundary: &Boundary, towards_eye: Vec3) -> [f32; 3] {
        let facing_eye = boundary.normal.dot(towards_eye);
        let normal = if facing_eye < 0.0 { -boundary.normal } else { boundary.normal };
        let facing_eye = facing_eye.abs().min(1.0);
        let facing_light = normal.dot(self.towards_light).max(0.0);
        let up = -self.camera.down.as_vec3();
        let from_above = 0.5 + 0.5 * normal.dot(up);
        let hemisphere = self.ambient * (GROUND_SHARE + (1.0 - GROUND_SHARE) * from_above);
        let diffuse = hemisphere + (1.0 - self.ambient) * facing_light + RIM * (1.0 - facing_eye).powi(RIM_EXPONENT);
        let between = (self.towards_light + towards_eye).normalize_or_zero();
        let highlight =
            if facing_light > 0.0 { HIGHLIGHT * normal.dot(between).max(0.0).powi(HIGHLIGHT_EXPONENT) } else { 0.0 };
        boundary.colour.map(|c| c * diffuse + highlight)
    }
}

/// `base` to a power of two, by squaring.
#[inline(always)]
fn power<const EXPONENT: i32, S: Simd>(base: f32x8<S>) -> f32x8<S> {
    const { assert!(EXPONENT > 0 && EXPONENT & (EXPONENT - 1) == 0) };
    let mut power = base;
    for _ in 0..EXPONENT.trailing_zeros() {
        power = power * power;
    }
    power
}

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

/// The rows of one tile's pixels in the picture.
type Rows<'a> = [&'a mut [[f32; 4]]];

/// Draws the pixels of a rectangle into their places; returns how many show a surface.
type DrawTile<'a> = dyn Fn(&Shader, PixelRect, &mut Rows) -> u64 + Sync + 'a;

fn by_tiles(camera: &Camera, look: &Look, draw: &DrawTile) -> Picture {
    let (width, height) = (camera.width, camera.height);
    let shader = Shader::new(&look.light, camera);
    let mut pixels = vec![[0.0; 4]; width as usize * height as usize];
    let covered = AtomicU64::new(0);
    let side = TILE_SIDE as usize;
    let band_length = width as usize * side;
    pixels.par_chunks_mut(band_length.max(1)).enumerate().for_each(|(band_index, band)| {
        let y0 = band_index as u32 * TILE_SIDE;
        let y1 = (y0 + TILE_SIDE).min(height);
        let mut tiles: Vec<Vec<&mut [[f32; 4]]>> =
            (0..(width as usize).div_ceil(side)).map(|_| Vec::with_capacity(side)).collect();
        for line in band.chunks_mut(width as usize) {
            tiles.iter_mut().zip(line.chunks_mut(side)).for_each(|(rows, row)| rows.push(row));
        }
        tiles.into_par_iter().enumerate().for_each(|(column, mut rows)| {
            let x0 = column as u32 * TILE_SIDE;
            let rect = PixelRect { x0, y0, x1: (x0 + TILE_SIDE).min(width), y1 };
            covered.fetch_add(draw(&shader, rect, &mut rows), Ordering::Relaxed);
        });
    });
    let has_alpha = look.background[3] < 1.0;
    Picture { width, height, pixels, depth: None, covered: covered.into_inner(), has_alpha }
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
    for (row, y) in (tile.rect.y0..tile.rect.y1).enumerate() {
        for (column, x) in (tile.rect.x0..tile.rect.x1).enumerate() {
            let boundaries = tile.at(x, y);
            let Some(first) = boundaries.first() else { continue };
            covered += 1;
            let index = row * tile.rect.width() as usize + column;
            if first.samples & all == all && first.opacity >= 1.0 {
                batch.push(index, shader.centre_of(x, y), first);
                if batch.len == LANES {
                    shader.light(&mut batch, &mut pixels);
                }
            } else {
                let lit = lit.get_or_insert_with(|| shader.lit_tile(tile));
                let of_pixel = tile.offsets[index] as usize..tile.offsets[index + 1] as usize;
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
pub(super) fn over(light: [f32; 3], through: f32, background: [f32; 4]) -> [f32; 4] {
    let [r, g, b, a] = background;
    let alpha = (1.0 - through) + through * a;
    if !(alpha > 0.0) {
        return [0.0; 4];
    }
    let mix = |light: f32, behind: f32| (light + through * a * behind) / alpha;
    [mix(light[0], r), mix(light[1], g), mix(light[2], b), alpha]
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
    use glam::DVec3;

    use super::*;
    use crate::layers::{Facing, LayerStack};
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

    #[test]
    fn both_sides_of_a_surface_are_lit_alike_and_the_lit_side_is_brighter() {
        let camera = camera(8, 8);
        let light = Light { towards: DVec3::new(-1.0, -1.0, 1.0), in_world: true, ambient: 0.2 };
        let shader = Shader::new(&light, &camera);
        let eye = shader.towards_eye(4, 4);
        let lit = |normal: Vec3| shader.lit(&Boundary { normal, ..boundary(1.0, [0.5; 3], 1.0, 1) }, eye)[0];
        assert_eq!(lit(Vec3::NEG_Y), lit(Vec3::Y));
        let tilted = |x: f32| lit(Vec3::new(x, -1.0, 0.0).normalize());
        assert!(tilted(-0.5) > tilted(0.5));
        // Away from the light, up is still brighter than down.
        let away = |z: f32| lit(Vec3::new(0.99, -0.1, z).normalize());
        assert!(away(0.1) > away(-0.1));
    }
}
