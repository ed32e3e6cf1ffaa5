//! Smooth pseudo-random numbers over the picture.
//!
//! *Theory.* Perlin's gradient noise (SIGGRAPH 1985, with the fade of 2002), which Sketchy CSG §4 uses for its uncertainty
//! values: neighbouring pixels get neighbouring values, so a perturbed line stays one line, and the noise stands still while
//! the scene moves below it.

use std::sync::LazyLock;

use glam::Vec2;

/// Unit vectors in 2⁸ directions.
static GRADIENTS: LazyLock<[Vec2; 256]> =
    LazyLock::new(|| std::array::from_fn(|i| Vec2::from_angle(i as f32 / 256.0 * std::f32::consts::TAU)));

/// Gradient noise in two dimensions, −1 to 1, zero at whole coordinates.
#[derive(Debug, Clone, Copy)]
pub(super) struct Perlin {
    seed: u32,
}

impl Perlin {
    /// One of 2³² noises.
    pub fn new(seed: u32) -> Self {
        Self { seed }
    }

    /// The value at `p`.
    pub fn at(self, p: Vec2) -> f32 {
        let cell = p.floor();
        let within = p - cell;
        let fade = |t: f32| t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
        let corner = |x: f32, y: f32| {
            let gradient = self.gradient((cell.x + x) as i32, (cell.y + y) as i32);
            gradient.dot(within - Vec2::new(x, y))
        };
        let (u, v) = (fade(within.x), fade(within.y));
        let between = |y: f32| {
            let (left, right) = (corner(0.0, y), corner(1.0, y));
            left + u * (right - left)
        };
        let (top, bottom) = (between(0.0), between(1.0));
        /// The most that unit gradients give, in the middle of a cell.
        const MOST: f32 = std::f32::consts::FRAC_1_SQRT_2;
        (top + v * (bottom - top)) / MOST
    }

    /// One of [`GRADIENTS`].
    fn gradient(self, x: i32, y: i32) -> Vec2 {
        // Multiply and shift, as in Jenkins' and Murmur's finishers.
        let mut hash = self.seed ^ (x as u32).wrapping_mul(0x85eb_ca6b) ^ (y as u32).wrapping_mul(0xc2b2_ae35);
        for _ in 0..2 {
            hash = (hash ^ (hash >> 16)).wrapping_mul(0x7feb_352d);
            hash = (hash ^ (hash >> 15)).wrapping_mul(0x846c_a68b);
        }
        GRADIENTS[(hash >> 24) as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_is_bounded_smooth_and_fair() {
        let noise = Perlin::new(7);
        let (mut sum, mut square, mut most, mut steepest) = (0.0f64, 0.0f64, 0.0f32, 0.0f32);
        const SIDE: i32 = 400;
        const STEP: f32 = 0.05;
        for y in 0..SIDE {
            for x in 0..SIDE {
                let p = Vec2::new(x as f32 * STEP - 3.0, y as f32 * STEP - 7.0);
                let value = noise.at(p);
                let next = noise.at(p + Vec2::new(STEP, 0.0));
                (sum, square) = (sum + f64::from(value), square + f64::from(value * value));
                (most, steepest) = (most.max(value.abs()), steepest.max((next - value).abs() / STEP));
            }
        }
        let count = f64::from(SIDE * SIDE);
        assert!((sum / count).abs() < 0.1, "mean {}", sum / count);
        let deviation = (square / count).sqrt();
        assert!((0.2..0.5).contains(&deviation), "deviation {deviation}");
        assert!(most <= 1.0 && most > 0.6, "{most}");
        // No gradient is steeper than that of a corner and of its fade: about 4 / cell.
        assert!(steepest < 4.5, "{steepest}");
    }

    #[test]
    fn seeds_differ_and_lattice_points_are_zero() {
        let (a, b) = (Perlin::new(1), Perlin::new(2));
        let p = Vec2::new(0.4, 0.7);
        assert_ne!(a.at(p), b.at(p));
        assert_eq!(a.at(Vec2::new(3.0, -5.0)), 0.0);
    }
}
