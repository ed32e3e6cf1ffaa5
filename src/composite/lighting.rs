//! How surfaces are lit.
//!
//! *Practice.* A surface is lit by one directional light (Lambert) and by a hemisphere that is brighter above than below,
//! so that faces turned from the light still differ; a faint highlight and a faint rim tell round from flat. Both sides of
//! a surface are lit alike: the normal is turned to the viewer, because a result's back face is as much a surface as its
//! front. Eight pixels are lit at once, by the same steps as one.

use std::ops::Range;

use fearless_simd::prelude::*;
use fearless_simd::{Level, Simd, f32x8};
use glam::{DVec2, DVec3, Vec3};

use crate::layers::opaque::{
    BLOCK_AREA, BLOCK_HEIGHT, BLOCK_WIDTH, BLOCKS_ACROSS, OpaquePixels, OpaqueShown, OpaqueSurface, blocks_of,
};
use crate::layers::{Boundary, LayerTile, OpaqueTile, TILE_SIDE};
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

/// The rows of one tile's pixels in the picture.
pub(super) type Rows<'a> = [&'a mut [[f32; 4]]];

/// Pixels that are lit at once.
pub(super) const LANES: usize = 8;

/// Surfaces that wait to be lit together: so many that what is written here has left the processor's store buffer before it is
/// read again.
const BATCH: usize = 8 * LANES;

/// Surfaces that wait to be lit together.
#[derive(Debug)]
pub(super) struct Batch {
    len: usize,
    /// Their numbers among what is lit.
    index: [usize; BATCH],
    /// Pixel centres, from the picture's middle.
    at: [[f32; BATCH]; 2],
    normal: [[f32; BATCH]; 3],
    colour: [[f32; BATCH]; 3],
    opacity: [f32; BATCH],
}

impl Default for Batch {
    fn default() -> Self {
        Self {
            len: 0,
            index: [0; BATCH],
            at: [[0.0; BATCH]; 2],
            normal: [[0.0; BATCH]; 3],
            colour: [[0.0; BATCH]; 3],
            opacity: [0.0; BATCH],
        }
    }
}

/// Boundaries of a tile that wait to be lit together.
#[derive(Debug)]
struct Queue {
    len: usize,
    number: [usize; BATCH],
    /// Pixel centres, from the picture's middle.
    at: [[f32; BATCH]; 2],
}

impl Default for Queue {
    fn default() -> Self {
        Self { len: 0, number: [0; BATCH], at: [[0.0; BATCH]; 2] }
    }
}

impl Batch {
    /// Adds the boundary that is number `index` of what is lit, at a pixel centre counted from the picture's middle, where
    /// all of the light arrives. A batch that [is full](Self::is_full) takes no more.
    #[inline(always)]
    pub fn push(&mut self, index: usize, at: [f32; 2], boundary: &Boundary) {
        let lane = self.len;
        self.len += 1;
        self.index[lane] = index;
        self.opacity[lane] = boundary.opacity.clamp(0.0, 1.0);
        (self.at[0][lane], self.at[1][lane]) = (at[0], at[1]);
        let (normal, colour) = (boundary.normal.to_array(), boundary.colour);
        for k in 0..3 {
            self.normal[k][lane] = normal[k];
            self.colour[k][lane] = colour[k];
        }
    }

    /// Whether it waits to be lit.
    #[inline(always)]
    pub fn is_full(&self) -> bool {
        self.len == BATCH
    }
}

/// The unit vector towards `light`, seen by `camera`, in world space.
pub fn towards(light: &Light, camera: &Camera) -> DVec3 {
    let towards = if light.in_world { light.towards } else { camera.rotate_to_world(light.towards) };
    // A light from nowhere comes from the eye.
    towards.try_normalize().unwrap_or(-camera.forward)
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
        let towards_light = towards(light, camera).as_vec3();
        Self { level: Level::new(), camera, towards_light, ambient: light.ambient }
    }

    /// The unit vector from the surface towards the eye at the centre of pixel (`x`, `y`), in world space.
    pub fn towards_eye(&self, x: u32, y: u32) -> Vec3 {
        let ray = self.camera.ray(DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5));
        (-ray.dir).normalize().as_vec3()
    }

    /// The centre of a pixel, counted from the picture's middle.
    #[inline(always)]
    pub(super) fn centre_of(&self, x: u32, y: u32) -> [f32; 2] {
        let along = |at: u32, side: u32| at as f32 + 0.5 - 0.5 * side as f32;
        [along(x, self.camera.width), along(y, self.camera.height)]
    }

    /// Lights what `batch` holds, writes it with its opacity to its places in `lit`, and empties it. The same light as
    /// [`lit`](Self::lit).
    pub(super) fn light(&self, batch: &mut Batch, lit: &mut [[f32; 4]]) {
        fearless_simd::dispatch!(self.level, simd => simd.vectorize(#[inline(always)] || self.light_batch(simd, batch, lit)));
        batch.len = 0;
    }

    #[inline(always)]
    fn light_batch<S: Simd>(&self, simd: S, batch: &Batch, lit: &mut [[f32; 4]]) {
        for from in (0..batch.len).step_by(LANES) {
            let load = |of: &[f32; BATCH]| f32x8::from_slice(simd, &of[from..from + LANES]);
            let at = [load(&batch.at[0]), load(&batch.at[1])];
            let [n_x, n_y, n_z] = &batch.normal;
            let [r, g, b] = &batch.colour;
            let (normal, colour) = ([load(n_x), load(n_y), load(n_z)], [load(r), load(g), load(b)]);
            let [r, g, b] = self.lit_lanes(simd, at, normal, colour, f32x8::splat(simd, 1.0));
            let opacity = &batch.opacity[from..from + LANES];
            for (lane, &index) in batch.index[from..batch.len.min(from + LANES)].iter().enumerate() {
                lit[index] = [r[lane], g[lane], b[lane], opacity[lane]];
            }
        }
    }

    /// The lit colours of the boundaries of `tile`, in their order, each with its opacity. The same light as
    /// [`lit`](Self::lit), of which the share of `sun` arrives at each boundary, all of it where `sun` is empty. Boundaries beyond
    /// the first `most` of a pixel are nothing.
    pub fn lit_tile(&self, tile: &LayerTile, most: usize, sun: &[f32]) -> Vec<[f32; 4]> {
        let mut lit = vec![[0.0; 4]; tile.boundaries.len()];
        self.light_tile(tile, most, sun, &mut lit);
        lit
    }

    /// The same, written into `lit`, of which boundaries beyond the first `most` of a pixel keep what they have.
    pub(super) fn light_tile(&self, tile: &LayerTile, most: usize, sun: &[f32], lit: &mut [[f32; 4]]) {
        fearless_simd::dispatch!(self.level, simd => simd.vectorize(
            #[inline(always)]
            || self.light_tile_lanes(simd, tile, most, sun, lit),
        ));
    }

    #[inline(always)]
    fn light_tile_lanes<S: Simd>(&self, simd: S, tile: &LayerTile, most: usize, sun: &[f32], lit: &mut [[f32; 4]]) {
        let across = tile.rect.width() as usize;
        debug_assert!(sun.is_empty() || sun.len() == tile.boundaries.len());
        let mut queue = Queue::default();
        for (row, y) in (tile.rect.y0..tile.rect.y1).enumerate() {
            let offsets = &tile.offsets[row * across..=(row + 1) * across];
            if offsets[0] == offsets[across] {
                continue;
            }
            for (of_pixel, x) in offsets.windows(2).zip(tile.rect.x0..) {
                let centre = self.centre_of(x, y);
                let (from, to) = (of_pixel[0] as usize, of_pixel[1] as usize);
                for number in from..to.min(from.saturating_add(most)) {
                    queue.number[queue.len] = number;
                    (queue.at[0][queue.len], queue.at[1][queue.len]) = (centre[0], centre[1]);
                    queue.len += 1;
                    if queue.len == BATCH {
                        self.light_queue(simd, &queue, &tile.boundaries, sun, lit);
                        queue.len = 0;
                    }
                }
            }
        }
        self.light_queue(simd, &queue, &tile.boundaries, sun, lit);
    }

    /// Lights the boundaries of `queue`. What they say is put side by side straight from their records: going through a
    /// [`Batch`]'s arrays would write and read each value once more.
    #[inline(always)]
    fn light_queue<S: Simd>(&self, simd: S, queue: &Queue, boundaries: &[Boundary], sun: &[f32], lit: &mut [[f32; 4]]) {
        for from in (0..queue.len).step_by(LANES) {
            let count = (queue.len - from).min(LANES);
            let mut number = [queue.number[from]; LANES];
            number[..count].copy_from_slice(&queue.number[from..from + count]);
            let [a, b, c, d, e, f, g, h] = number.map(|number| &boundaries[number]);
            macro_rules! lanes {
                ($field:ident $(. $part:tt)?) => {
                    f32x8::simd_from(simd, [
                        a.$field $(.$part)?, b.$field $(.$part)?, c.$field $(.$part)?, d.$field $(.$part)?,
                        e.$field $(.$part)?, f.$field $(.$part)?, g.$field $(.$part)?, h.$field $(.$part)?,
                    ])
                };
                ($field:ident [$part:expr]) => {
                    f32x8::simd_from(simd, [
                        a.$field[$part], b.$field[$part], c.$field[$part], d.$field[$part],
                        e.$field[$part], f.$field[$part], g.$field[$part], h.$field[$part],
                    ])
                };
            }
            let normal = [lanes!(normal.x), lanes!(normal.y), lanes!(normal.z)];
            let colour = [lanes!(colour[0]), lanes!(colour[1]), lanes!(colour[2])];
            let opacity = lanes!(opacity).max(0.0).min(1.0);
            let at = [
                f32x8::from_slice(simd, &queue.at[0][from..from + LANES]),
                f32x8::from_slice(simd, &queue.at[1][from..from + LANES]),
            ];
            let sun = match sun {
                [] => f32x8::splat(simd, 1.0),
                sun => f32x8::simd_from(simd, number.map(|number| sun[number])),
            };
            let [r, g, b] = self.lit_lanes(simd, at, normal, colour, sun);
            let place = number[0];
            if count == LANES
                && number[LANES - 1] == place + LANES - 1
                && let ([left, right], []) = lit[place..place + LANES].as_flattened_mut().as_chunks_mut()
            {
                let (r, g, b, opacity) = (r.split(), g.split(), b.split(), opacity.split());
                simd.store_four_interleaved_f32x4([r.0, g.0, b.0, opacity.0], left);
                simd.store_four_interleaved_f32x4([r.1, g.1, b.1, opacity.1], right);
                continue;
            }
            for (lane, &number) in number[..count].iter().enumerate() {
                lit[number] = [r[lane], g[lane], b[lane], opacity[lane]];
            }
        }
    }

    /// Lights the pixels of an opaque tile at `rect` into `rows`, those without a surface as `background`. The same light as
    /// [`lit`](Self::lit). Returns how many show a surface.
    pub(super) fn light_opaque(
        &self,
        tile: &OpaqueTile,
        rect: PixelRect,
        rows: &mut Rows,
        background: [f32; 4],
    ) -> u64 {
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
        const WIDTH: usize = BLOCK_WIDTH as usize;
        const { assert!(BLOCK_AREA == LANES && LANES == 2 * WIDTH) };
        let steps = [
            f32x8::from_slice(simd, &[0.0, 1.0, 2.0, 3.0, 0.0, 1.0, 2.0, 3.0]),
            f32x8::from_slice(simd, &[0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0]),
        ];
        let (tile_x, tile_y) = (rect.x0 / TILE_SIDE * TILE_SIDE, rect.y0 / TILE_SIDE * TILE_SIDE);
        let [across, down] = blocks_of(rect);
        let one = f32x8::splat(simd, 1.0);
        let mut count = 0;
        for block_y in down.0..=down.1 {
            for block_x in across.0..=across.1 {
                let (covered, shown) = tile.block(block_y * BLOCKS_ACROSS + block_x);
                let corner = (tile_x + block_x * BLOCK_WIDTH, tile_y + block_y * BLOCK_HEIGHT);
                if covered == 0 {
                    let (columns, lines) = within(corner, rect);
                    let places = (columns.start - rect.x0) as usize..(columns.end - rect.x0) as usize;
                    lines.for_each(|y| rows[(y - rect.y0) as usize][places.clone()].fill(background));
                    continue;
                }
                count += u64::from(covered.count_ones());
                let (normal, colour) = match shown {
                    OpaqueShown::One(OpaqueSurface { normal: [x, y, z], colour: [r, g, b] }) => {
                        let splat = |number: &f32| f32x8::splat(simd, *number);
                        ([splat(x), splat(y), splat(z)], [splat(r), splat(g), splat(b)])
                    }
                    OpaqueShown::Mixed(OpaquePixels { normals: [x, y, z], colours: [r, g, b] }) => {
                        let load = |numbers: &[f32; LANES]| f32x8::from_slice(simd, numbers);
                        ([load(x), load(y), load(z)], [load(r), load(g), load(b)])
                    }
                };
                let [x, y] = self.centre_of(corner.0, corner.1);
                let [r, g, b] = self.lit_lanes(simd, [steps[0] + x, steps[1] + y], normal, colour, one);
                let (r, g, b, one) = (r.split(), g.split(), b.split(), one.split());
                if covered == u8::MAX {
                    // All of the block is in the rectangle.
                    let (left, top) = ((corner.0 - rect.x0) as usize, (corner.1 - rect.y0) as usize);
                    let upper = rows[top][left..left + WIDTH].as_flattened_mut();
                    let upper = upper.try_into().expect("all of the block's row");
                    simd.store_four_interleaved_f32x4([r.0, g.0, b.0, one.0], upper);
                    let lower = rows[top + 1][left..left + WIDTH].as_flattened_mut();
                    let lower = lower.try_into().expect("all of the block's row");
                    simd.store_four_interleaved_f32x4([r.1, g.1, b.1, one.1], lower);
                    continue;
                }
                let mut lit = [[[0.0; 4]; WIDTH]; 2];
                let [upper, lower] = &mut lit;
                let upper = upper.as_flattened_mut().try_into().expect("a row of the block");
                simd.store_four_interleaved_f32x4([r.0, g.0, b.0, one.0], upper);
                let lower = lower.as_flattened_mut().try_into().expect("a row of the block");
                simd.store_four_interleaved_f32x4([r.1, g.1, b.1, one.1], lower);
                let (columns, lines) = within(corner, rect);
                for y in lines {
                    for x in columns.clone() {
                        let (column, line) = ((x - corner.0) as usize, (y - corner.1) as usize);
                        let is_covered = covered >> (line * WIDTH + column) & 1 == 1;
                        let pixel = &mut rows[(y - rect.y0) as usize][(x - rect.x0) as usize];
                        *pixel = if is_covered { lit[line][column] } else { background };
                    }
                }
            }
        }
        count
    }

    /// Lit colours of surfaces at pixel centres `at`, with unit normals and unlit colours, where a share `sun` of the light arrives.
    #[inline(always)]
    fn lit_lanes<S: Simd>(
        &self,
        simd: S,
        at: [f32x8<S>; 2],
        [n_x, n_y, n_z]: [f32x8<S>; 3],
        [r, g, b]: [f32x8<S>; 3],
        sun: f32x8<S>,
    ) -> [f32x8<S>; 3] {
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
        let diffuse = hemisphere + facing_light * (1.0 - self.ambient) * sun + rim;
        let is_lit = facing_light.simd_gt(0.0);
        let mut highlight = f32x8::splat(simd, 0.0);
        if is_lit.any_true() {
            let (b_x, b_y, b_z) = (e_x + light.x, e_y + light.y, e_z + light.z);
            let squared = b_x * b_x + b_y * b_y + b_z * b_z;
            // Straight from behind there is no direction between; nothing shines there.
            let per_length = squared.simd_gt(f32::MIN_POSITIVE).select(one / squared.sqrt(), one);
            let mirrored = (side * (n_x * b_x + n_y * b_y + n_z * b_z) * per_length).max(0.0);
            let shine = power::<HIGHLIGHT_EXPONENT, S>(mirrored) * HIGHLIGHT * sun;
            highlight = is_lit.select(shine, highlight);
        }
        [r * diffuse + highlight, g * diffuse + highlight, b * diffuse + highlight]
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

/// The columns and rows of the picture that a block of an opaque tile has in `rect`.
#[inline(always)]
fn within(corner: (u32, u32), rect: PixelRect) -> (Range<u32>, Range<u32>) {
    let columns = corner.0.max(rect.x0)..(corner.0 + BLOCK_WIDTH).min(rect.x1);
    (columns, corner.1.max(rect.y0)..(corner.1 + BLOCK_HEIGHT).min(rect.y1))
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

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::layers::Facing;
    use crate::space::Lens;

    fn camera(width: u32, height: u32) -> Camera {
        Camera::look_at(DVec3::new(0.0, -4.0, 0.0), DVec3::ZERO, DVec3::Z, Lens::Height(2.0), width, height).unwrap()
    }

    fn boundary(depth: f32, colour: [f32; 3], opacity: f32, samples: u16) -> Boundary {
        let normal = Vec3::NEG_Y;
        Boundary { depth, normal, colour, opacity, leaf: 0, body: 0, facing: Facing::Front, samples }
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
