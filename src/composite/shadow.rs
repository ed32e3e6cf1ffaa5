//! Shadows: how much of the light reaches each boundary, asked of the layers that the light sees.
//!
//! *Theory.* Blister CSG §5 and its Fig. 13: the layers of a CSG result can be peeled from the light as well as from the eye, with
//! depths that can be compared, and so the result throws shadows without ever being made into a mesh (shadow mapping; Williams
//! 1978). Where the light's layers are transparent each lets its share through, front to back, as towards the eye.
//!
//! *Changes from the paper.* A depth map alone cannot tell a surface from itself: within a texel its depth varies, and a bias that
//! hides this detaches shadows from what throws them. The light's layers know their normals too. A surface element q stands between
//! a point p and the light where q is above p's tangent plane *and* p is below q's. A surface that bends away from its tangent planes
//! lies below both, one that bends towards them above both: neither shadows itself, however much it bends within a texel and
//! however flat the light falls, nor do two faces that meet, in an edge or in a notch. What is left is noise, and surfaces bent both
//! ways: by less than `TOLERANCE` neither counts. What that leaves lit wrongly is where light grazes a hollow: on the wall of a bore
//! of radius R the light at a sine s is stopped 2R·s² over the tangent plane, so below s² = tolerance / 2R it may pass.
//!
//! *Practice.* A texel is no larger than the pixel that asks, seen from the light ([`LightGrid`] has texels of every size), but
//! not below half of the pixel's own size where light grazes, nor so small that a pixel at a grazing angle of view has more than
//! some hundreds: [`Shadows::coarse`] counts the boundaries where these two rules leave texels larger. A pixel's light is the mean over
//! the texels about its part of the tangent plane (percentage-closer filtering; Reeves, Salesin and Cook 1987), each weighted by an
//! ellipse of the same covariance (as textures are by Heckbert 1989), so that edges have neither steps nor the grain of random
//! samples. A boundary that some samples of a pixel see asks from the middle of those. The light's own cameras take one sample a
//! texel.

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};

use glam::{DVec2, DVec3, Vec2, Vec3};
use rayon::prelude::*;

use super::facets::STEEPEST;
use super::light_grid::{LightGrid, LightTile, SIDE};
use super::light_map::{CasterTile, DrawLight, Frames, LightMap};
use super::strip::Strip;
use crate::layers::{Boundary, LayerTile, MAX_SAMPLES, sample_offsets};
use crate::space::Camera;

/// What stands less than this over a tangent plane is the surface itself, in footprints of the pixel: two views of one surface each
/// find it within half a footprint, which is what sampling and tessellation leave (`--max-error`).
pub(crate) const TOLERANCE: f64 = 1.0;

/// A depth in 32 bits puts a boundary beside its surface by up to half an ulp along the ray, as a share of the depth. Four of these are
/// the surface itself: one for the depth's own rounding, the rest for the steps by which a pipeline found it. It is more than a
/// footprint where an orthographic eye is far away.
pub(crate) const DEPTH_ROUNDING: f64 = 2.0 * f32::EPSILON as f64;

/// Where light grazes, texels get no smaller than this share of a pixel: there is little light to lose.
pub(crate) const LEAST_SHARE: f64 = 0.5;

/// A pixel is at most this many texels long, up to the rounding of their size.
pub(crate) const MOST_TEXELS: f64 = 8.0;

/// A surface counts as lit at no flatter an angle than this sine of it: its plane would reach any depth within a texel.
pub(crate) const LEAST_SINE: f64 = 1.0 / 64.0;

/// A pixel's weights are (1 − r²)², and r reaches 1 where twelve times the covariance, as a quadratic form, is 12/8: the variance of
/// such weights along a diameter is ½ ∫r³(1 − r²)² dr / ∫r(1 − r²)² dr = 1/8. No texel is too large to count: the nearest is within
/// √(1/2) of the pixel's middle, and the ellipse reaches √(2/3) at least.
pub(crate) const PER_REACH: f32 = 12.0 / 8.0;

/// What keeps the light from boundaries.
pub struct Shadows<'a> {
    map: RefCell<&'a mut LightMap>,
    frames: RefCell<Frames<'a>>,
    draw: &'a DrawLight<'a>,
    strength: f32,
    watch: &'a dyn Fn(&mut dyn FnMut()),
    coarse: AtomicU64,
}

impl<'a> Shadows<'a> {
    /// Shadows from `map`, which is drawn further by `draw`; of `strength` 1 they keep all of the light off. All that is done for
    /// them is done within `watch`, which calls what it is handed once.
    pub fn new(
        map: &'a mut LightMap,
        strength: f32,
        draw: &'a DrawLight<'a>,
        watch: &'a dyn Fn(&mut dyn FnMut()),
    ) -> Self {
        let (frames, coarse) = (RefCell::default(), AtomicU64::new(0));
        Self { map: RefCell::new(map), frames, draw, strength: strength.clamp(0.0, 1.0), watch, coarse }
    }

    /// Boundaries so far whose texels are larger than their pixel.
    pub fn coarse(&self) -> u64 {
        self.coarse.load(Ordering::Relaxed)
    }

    /// For each of the tiles `which` of `strip` the share of the light that reaches its boundaries, in their order. Other tiles
    /// have an empty list. The tiles around the strip's own are another strip's to count.
    pub(super) fn of_strip(&self, strip: &Strip, which: Range<usize>, camera: &Camera, samples: u32) -> Vec<Vec<f32>> {
        let mut shares = vec![Vec::new(); strip.tiles.len()];
        let own = strip.own.start.saturating_sub(which.start)..strip.own.end.saturating_sub(which.start);
        shares.splice(which.clone(), self.on_counting(&strip.tiles[which], own, camera, samples));
        shares
    }

    /// The share of the light that reaches each boundary of `tiles`, which `camera` sees with `samples` samples a pixel.
    pub fn on(&self, tiles: &[LayerTile], camera: &Camera, samples: u32) -> Vec<Vec<f32>> {
        self.on_counting(tiles, 0..tiles.len(), camera, samples)
    }

    /// The same, where only the boundaries of the tiles `counted` are counted.
    fn on_counting(&self, tiles: &[LayerTile], counted: Range<usize>, camera: &Camera, samples: u32) -> Vec<Vec<f32>> {
        let mut shares = Vec::new();
        let mut pass = || {
            let mut map = self.map.borrow_mut();
            let receivers = Receivers::new(map.grid(), camera, samples);
            let wanted: Vec<(BTreeSet<LightTile>, u64)> = tiles.par_iter().map(|tile| receivers.wanted(tile)).collect();
            let coarse = wanted[counted.clone()].iter().map(|(_, coarse)| coarse).sum();
            self.coarse.fetch_add(coarse, Ordering::Relaxed);
            let wanted = wanted.into_iter().flat_map(|(wanted, _)| wanted).collect();
            map.ask(&wanted, &mut self.frames.borrow_mut(), self.draw);
            let map = &**map;
            let receivers = Receivers::new(map.grid(), camera, samples);
            let strength = self.strength;
            let share = |receiver: Option<Receiver>| {
                receiver.map_or(1.0, |receiver| 1.0 - strength * (1.0 - receiver.light(map)))
            };
            let of_tile = |tile: &LayerTile| {
                let mut of_tile = Vec::with_capacity(tile.boundaries.len());
                receivers.each(tile, |receiver| of_tile.push(share(receiver)));
                of_tile
            };
            shares = tiles.par_iter().map(of_tile).collect();
        };
        (self.watch)(&mut pass);
        shares
    }
}

/// Makes boundaries that one camera sees into receivers of light.
struct Receivers<'a> {
    grid: &'a LightGrid,
    camera: &'a Camera,
    samples: u32,
}

impl<'a> Receivers<'a> {
    fn new(grid: &'a LightGrid, camera: &'a Camera, samples: u32) -> Self {
        Self { grid, camera, samples: samples.clamp(1, MAX_SAMPLES) }
    }

    /// Calls `with` for each boundary of `tile`, in their order; `None` is one that looks away from the light, which lights none of it
    /// without any shadow: all of nothing arrives.
    fn each(&self, tile: &LayerTile, mut with: impl FnMut(Option<Receiver>)) {
        for (pixel, of_pixel) in tile.offsets.windows(2).enumerate() {
            let (x, y) = (pixel as u32 % tile.rect.width(), pixel as u32 / tile.rect.width());
            for boundary in &tile.boundaries[of_pixel[0] as usize..of_pixel[1] as usize] {
                with(self.receiver(tile.rect.x0 + x, tile.rect.y0 + y, boundary));
            }
        }
    }

    /// The tiles of the light's grid that the boundaries of `tile` ask for, and how many of these are coarse.
    fn wanted(&self, tile: &LayerTile) -> (BTreeSet<LightTile>, u64) {
        let (mut wanted, mut last, mut coarse) = (BTreeSet::new(), None, 0);
        self.each(tile, |receiver| {
            let Some(receiver) = receiver else { return };
            coarse += u64::from(receiver.is_coarse);
            let [low, high] = receiver.texels(receiver.shape().reach).map(|[x, y]| LightTile::of(receiver.level, x, y));
            // Neighbours ask for the same.
            if last != Some([low, high]) {
                last = Some([low, high]);
                let column = |x: i32| (low.y..=high.y).map(move |y| LightTile { level: receiver.level, x, y });
                wanted.extend((low.x..=high.x).flat_map(column));
            }
        });
        (wanted, coarse)
    }

    /// Where in the pixel the samples of `mask` are, on average.
    fn middle(&self, mask: u16) -> DVec2 {
        let all = u16::MAX >> (MAX_SAMPLES - self.samples);
        if self.samples == 1 || mask & all == all {
            return DVec2::splat(0.5);
        }
        let seen = sample_offsets(self.samples).iter().enumerate().filter(|(sample, _)| mask >> sample & 1 == 1);
        let (sum, count) = seen.fold((DVec2::ZERO, 0.0), |(sum, count), (_, offset)| (sum + offset, count + 1.0));
        if count > 0.0 { sum / count } else { DVec2::splat(0.5) }
    }

    fn receiver(&self, x: u32, y: u32, boundary: &Boundary) -> Option<Receiver> {
        let Self { grid, camera, .. } = self;
        let corner = DVec2::new(f64::from(x), f64::from(y));
        let ray = camera.ray(corner + self.middle(boundary.samples));
        let depth = f64::from(boundary.depth);
        // The side that is lit is the one that is seen, from the pixel's middle as in `lighting`.
        let normal = boundary.normal.as_dvec3();
        let normal = if normal.dot(camera.ray(corner + 0.5).dir) > 0.0 { -normal } else { normal };
        let sine = normal.dot(grid.towards());
        if !(sine > 0.0) {
            return None;
        }
        // The pixel's sides on the tangent plane, as in `facets::Slopes`.
        let along = normal.dot(ray.dir);
        let per_along = along / (along * along + 0.25 / f64::from(STEEPEST * STEEPEST));
        let footprint = camera.footprint(depth);
        let side =
            |aside: DVec3| grid.rotated((aside - ray.dir * (aside.dot(normal) * per_along)) * footprint).truncate();
        let sides = [side(camera.right), side(camera.down)];
        let long = sides[0].length().max(sides[1].length());
        let short = sides[0].perp_dot(sides[1]).abs() / long.max(f64::MIN_POSITIVE);
        let wanted = short.clamp(LEAST_SHARE * footprint, footprint).max(long / MOST_TEXELS);
        let level = grid.level_for(wanted);
        let texel = LightGrid::texel(level);
        let at = grid.on_grid(ray.at(depth));
        let normal = grid.rotated(normal);
        let normal = DVec3::new(normal.x, normal.y, -sine.max(LEAST_SINE)).normalize();
        Some(Receiver {
            level,
            texel,
            at: at.truncate() / texel,
            depth: at.z,
            sides: sides.map(|side| (side / texel).as_vec2()),
            normal: normal.as_vec3(),
            tolerance: ((TOLERANCE * footprint).max(DEPTH_ROUNDING * depth * along.abs()) / texel).max(1.0) as f32,
            is_coarse: texel > short,
        })
    }
}

/// A point of a surface that the light may fall on, on the light's grid; lengths in texels where nothing else is said.
#[derive(Debug, Clone, Copy)]
struct Receiver {
    level: i32,
    /// World units.
    texel: f64,
    /// From the grid's origin.
    at: DVec2,
    /// World units.
    depth: f64,
    /// The pixel's two sides on the tangent plane.
    sides: [Vec2; 2],
    /// Towards the light.
    normal: Vec3,
    tolerance: f32,
    /// Whether texels are larger than the pixel.
    is_coarse: bool,
}

impl Receiver {
    /// How the pixel lies on the texels.
    fn shape(&self) -> Shape {
        let [a, b] = self.sides;
        // Twelve times the covariance: a box has a twelfth of its side squared, and that of a texel is one.
        let spread =
            Vec3::new(a.x * a.x + b.x * b.x, a.x * a.y + b.x * b.y, a.y * a.y + b.y * b.y) + Vec3::new(1.0, 0.0, 1.0);
        // Its determinant, without the difference of what is large: |a|² + |b|² + 1 + (a × b)².
        let skew = a.perp_dot(b);
        let det = spread.x + spread.z - 1.0 + skew * skew;
        let shrink = Vec3::new(spread.z, -2.0 * spread.y, spread.x) * (PER_REACH / det);
        let reach = (Vec2::new(spread.x, spread.z) / PER_REACH).map(f32::sqrt);
        Shape { shrink, reach }
    }

    /// Columns and rows of the first and the last texel whose middles are within `reach`.
    fn texels(&self, reach: Vec2) -> [[i32; 2]; 2] {
        let (first, last) = ((self.at - reach.as_dvec2() - 0.5).ceil(), (self.at + reach.as_dvec2() - 0.5).floor());
        [first, last].map(|at| [at.x as i32, at.y as i32])
    }

    /// The share of the light that reaches the pixel's part of the tangent plane.
    fn light(&self, map: &LightMap) -> f32 {
        let shape = self.shape();
        let [[x0, y0], [x1, y1]] = self.texels(shape.reach);
        let (mut lit, mut all) = (0.0, 0.0);
        let mut last: Option<(LightTile, Option<&CasterTile>)> = None;
        for y in y0..=y1 {
            for x in x0..=x1 {
                let from_here = (DVec2::new(f64::from(x), f64::from(y)) + 0.5 - self.at).as_vec2();
                let weight = shape.weight(from_here);
                if !(weight > 0.0) {
                    continue;
                }
                let key = LightTile::of(self.level, x, y);
                let tile = match last {
                    Some((known, tile)) if known == key => tile,
                    _ => map.tile(key),
                };
                last = Some((key, tile));
                all += weight;
                lit += weight * tile.map_or(1.0, |tile| self.through(tile, [x, y], from_here));
            }
        }
        if all > 0.0 { lit / all } else { 1.0 }
    }

    /// The share of the light that passes what stands in texel `at` of `tile`, which lies `from_here`.
    #[inline]
    fn through(&self, tile: &CasterTile, at: [i32; 2], from_here: Vec2) -> f32 {
        let [x, y] = at.map(|at| at.rem_euclid(SIDE as i32) as usize);
        let mut through = 1.0;
        for caster in tile.at(x, y) {
            let deeper = ((f64::from(caster.depth) - self.depth) / self.texel) as f32;
            let to_caster = from_here.extend(deeper);
            let over_this = self.normal.dot(to_caster);
            let over_that = caster.normal.dot(to_caster);
            if over_this > self.tolerance && over_that > self.tolerance {
                through *= caster.through;
            }
        }
        through
    }
}

/// How a pixel lies on the texels: an ellipse with the covariance of its parallelogram and of a texel together. What makes the
/// ellipse, the sum of the sides' squares, changes little with the pixel however the sides lie to each other; the parallelogram's
/// own axes are long without end where they are nearly parallel.
#[derive(Debug, Clone, Copy)]
struct Shape {
    /// The factors of x², xy and y² in the square of how far a texel is from the pixel's middle, as a share of the way to the
    /// ellipse's edge; x and y in texels.
    shrink: Vec3,
    /// How far from the pixel's middle texels still count, in columns and rows.
    reach: Vec2,
}

impl Shape {
    /// How much a texel counts whose middle is `from_here`; of no unit. It falls smoothly to nothing at the edge of the ellipse, so
    /// that no texel comes in with a step.
    #[inline]
    fn weight(&self, from_here: Vec2) -> f32 {
        let Vec2 { x, y } = from_here;
        let within = (1.0 - self.shrink.dot(Vec3::new(x * x, x * y, y * y))).max(0.0);
        within * within
    }
}

#[cfg(test)]
mod tests {
    use super::super::light_grid::STEPS as SIZES;
    use super::*;
    use crate::layers::{Facing, LayerStack};
    use crate::scene::framing::Bounds;
    use crate::space::Lens;

    /// A pixel with these sides, in texels, `x` right of the grid's origin.
    fn receiver(sides: [Vec2; 2], x: f64) -> Receiver {
        let at = DVec2::new(x, 0.3);
        let (level, texel, depth, normal) = (0, 1.0, 0.0, Vec3::NEG_Z);
        Receiver { level, texel, at, depth, sides, normal, tolerance: 1.0, is_coarse: false }
    }

    /// The share of a pixel that lies left of the grid's origin, and how many texels are looked at for it.
    fn left_of_origin(sides: [Vec2; 2], x: f64) -> (f32, usize) {
        let receiver = receiver(sides, x);
        let shape = receiver.shape();
        let [[x0, y0], [x1, y1]] = receiver.texels(shape.reach);
        let (mut left, mut all, mut count) = (0.0, 0.0, 0);
        for (x, y) in (y0..=y1).flat_map(|y| (x0..=x1).map(move |x| (x, y))) {
            let weight = shape.weight((DVec2::new(f64::from(x), f64::from(y)) + 0.5 - receiver.at).as_vec2());
            all += weight;
            left += if x < 0 { weight } else { 0.0 };
            count += 1;
        }
        (left / all, count)
    }

    #[test]
    fn a_shadows_edge_has_no_steps_and_is_as_wide_as_the_pixel_whatever_its_shape() {
        // None narrower than a texel, as long as light does not graze; then the last ones, which are all but flat.
        let shapes = [
            [Vec2::new(1.0, 0.0), Vec2::new(0.0, 1.0)],
            [Vec2::new(1.3, 0.2), Vec2::new(-0.4, 1.1)],
            [Vec2::new(0.9, 0.9), Vec2::new(-0.8, 0.8)],
            [Vec2::new(7.0, 3.0), Vec2::new(-0.2, 0.9)],
            [Vec2::new(1.4, -0.3), Vec2::new(3.0, 2.0)],
            [Vec2::new(8.0, 0.0), Vec2::new(8.0, 0.3)],
            [Vec2::new(5.7, 5.7), Vec2::new(5.7, 5.4)],
            [Vec2::new(2.0, 1.0), Vec2::new(4.0, 2.0)],
        ];
        for sides in shapes {
            const STEP: f64 = 1.0 / 64.0;
            const STEPS: i32 = 640;
            let shares: Vec<f32> = (-STEPS..=STEPS).map(|i| left_of_origin(sides, f64::from(i) * STEP).0).collect();
            // No faster than an edge crosses the narrowest pixel there is, a texel wide, twice over.
            assert!(shares.windows(2).all(|w| (w[0] - w[1]).abs() < 2.0 * STEP as f32), "{sides:?}");
            let at = |x: f64| shares[((x / STEP).round() as i32 + STEPS) as usize];
            assert!((at(0.0) - 0.5).abs() < 0.15, "{sides:?}: {}", at(0.0));
            assert!(at(-10.0) == 1.0 && at(10.0) == 0.0, "{sides:?}");
            // How the share falls along x is how the pixel's points are spread, as blurred as boxes of two texels make it.
            let falls = shares.windows(2).map(|w| f64::from(w[0] - w[1]));
            let variance: f64 =
                falls.enumerate().map(|(i, fall)| fall * ((i as f64 + 0.5) * STEP - 10.0).powi(2)).sum();
            let true_variance = f64::from(sides[0].x.powi(2) + sides[1].x.powi(2)) / 12.0;
            let most = true_variance + 2.0 / 12.0;
            assert!(variance > 0.9 * true_variance && variance < 1.1 * most, "{sides:?}: {variance} {true_variance}");
        }
    }

    #[test]
    fn a_pixel_of_any_shape_looks_at_some_hundreds_of_texels_at_most() {
        // Texels are rounded down to a size that there is.
        let longest = MOST_TEXELS * (1.0 / SIZES).exp2();
        for (i, j) in (0..64).flat_map(|i| (0..64).map(move |j| (i, j))) {
            let angle = |i: i32| f64::from(i) * std::f64::consts::PI / 64.0;
            let sides = [angle(i), angle(j)].map(|angle| (DVec2::from_angle(angle) * longest).as_vec2());
            let (share, count) = left_of_origin(sides, 0.0);
            assert!((0.0..=1.0).contains(&share) && count < 400, "{sides:?}: {count}");
        }
    }

    #[test]
    fn what_is_coarse_is_counted_for_the_tiles_that_are_to_be_counted() {
        // Four tiles of a plane that the light hardly touches: its pixels are thinner than any texel may be.
        let lens = Lens::Height(2.0);
        let camera = Camera::look_at(DVec3::Z * 4.0, DVec3::ZERO, DVec3::Y, lens, SIDE, 4 * SIDE).unwrap();
        let plane = Boundary {
            depth: 4.0,
            normal: Vec3::Z,
            colour: [1.0; 3],
            opacity: 1.0,
            leaf: 0,
            body: 0,
            facing: Facing::Front,
            samples: 1,
        };
        let stack = LayerStack::from_fn(camera.clone(), 1, |_, _| vec![plane]);
        let bounds = Bounds { min: DVec3::splat(-1.0), max: DVec3::ONE };
        let count = |tiles: Range<usize>| {
            let mut map = LightMap::new(LightGrid::new(DVec3::new(1.0, 0.0, 0.05), &bounds), 1.0);
            let shadows = Shadows::new(&mut map, 1.0, &|_| None, &|work| work());
            let shares = shadows.on_counting(stack.tiles(), tiles, &camera, 1);
            assert!(shares.iter().flatten().all(|share| *share == 1.0));
            shadows.coarse()
        };
        let of_tile = u64::from(SIDE * SIDE);
        assert_eq!((count(0..4), count(1..3), count(0..0)), (4 * of_tile, 2 * of_tile, 0));
    }

    #[test]
    fn a_pixel_far_smaller_than_a_texel_still_asks() {
        for sides in [[Vec2::ZERO; 2], [Vec2::new(0.0, 1e-9), Vec2::new(1e-20, 0.0)]] {
            for i in 0..64 {
                let (share, _) = left_of_origin(sides, f64::from(i) / 64.0);
                assert!((0.0..=1.0).contains(&share), "{sides:?}: {share}");
            }
        }
        // The middles of four texels are equally far.
        let corner = Receiver { at: DVec2::ZERO, ..receiver([Vec2::ZERO; 2], 0.0) };
        assert!(corner.shape().weight(Vec2::splat(0.5)) > 0.0);
    }
}
