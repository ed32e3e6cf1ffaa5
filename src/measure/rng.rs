//! The one source of randomness of simulated scans and searches: small, seeded, the same on every machine.
//!
//! *Theory*: PCG-XSH-RR 64/32 (M. O'Neill, "PCG: A Family of Simple Fast Space-Efficient Statistically Good Algorithms
//! for Random Number Generation", HMC-CS-2014-0905): a 64-bit linear congruential state whose high bits are permuted
//! into 32 output bits.
//!
//! *Practice*: everything here is integer arithmetic or exactly rounded floating point, so a seed gives the same numbers
//! on every platform; [`Rng::gaussian`] therefore sums uniforms, since `ln` and `cos` differ between maths libraries.

use glam::DVec3;

/// A seeded generator of uniform and Gaussian numbers.
#[derive(Debug, Clone)]
pub struct Rng {
    state: u64,
    increment: u64,
}

impl Rng {
    /// The multiplier of O'Neill's 64-bit generator (Knuth's MMIX constant).
    const MULTIPLIER: u64 = 6_364_136_223_846_793_005;

    /// The generator of `seed`. Different `stream`s of one seed are independent sequences: give every leaf its own.
    pub fn new(seed: u64, stream: u64) -> Self {
        let mut rng = Self { state: 0, increment: (stream << 1) | 1 }; // the increment must be odd
        rng.next_u32();
        rng.state = rng.state.wrapping_add(seed);
        rng.next_u32();
        rng
    }

    /// 32 uniform bits.
    pub fn next_u32(&mut self) -> u32 {
        let old = self.state;
        self.state = old.wrapping_mul(Self::MULTIPLIER).wrapping_add(self.increment);
        let folded = (((old >> 18) ^ old) >> 27) as u32;
        folded.rotate_right((old >> 59) as u32)
    }

    /// Uniform in [0, 1), 53 bits.
    pub fn uniform(&mut self) -> f64 {
        const BITS: u32 = f64::MANTISSA_DIGITS;
        let bits = (u64::from(self.next_u32()) << 32) | u64::from(self.next_u32());
        (bits >> (u64::BITS - BITS)) as f64 / (1u64 << BITS) as f64
    }

    /// Uniform in `0..bound`, without bias that a simulation could notice (below 2⁻²¹ for 32-bit bounds).
    pub fn below(&mut self, bound: usize) -> usize {
        ((self.uniform() * bound as f64) as usize).min(bound.saturating_sub(1))
    }

    /// Mean 0, standard deviation 1: the sum of twelve uniforms less six (Irwin-Hall), so never beyond ±6.
    pub fn gaussian(&mut self) -> f64 {
        const TERMS: u32 = 12; // the variance of one uniform is 1/12
        (0..TERMS).map(|_| self.uniform()).sum::<f64>() - 0.5 * f64::from(TERMS)
    }

    /// A uniformly distributed unit vector: a point of the cube that falls inside the unit ball, normalised.
    pub fn direction(&mut self) -> DVec3 {
        loop {
            let mut coordinate = || 2.0 * self.uniform() - 1.0;
            let v = DVec3::new(coordinate(), coordinate(), coordinate());
            // Very short vectors would lose digits when normalised.
            if (1e-6..=1.0).contains(&v.length_squared()) {
                return v.normalize();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_numbers_are_those_of_the_published_generator() {
        // The demo of the PCG reference implementation, seed 42, stream 54.
        let mut rng = Rng::new(42, 54);
        let first: Vec<u32> = (0..6).map(|_| rng.next_u32()).collect();
        assert_eq!(first, [0xa15c02b7, 0x7b47f409, 0xba1d3330, 0x83d2f293, 0xbfa4784b, 0xcbed606e]);
    }

    #[test]
    fn moments_are_those_of_the_distributions() {
        const N: usize = 100_000;
        let mut rng = Rng::new(1, 1);
        let moments = |values: Vec<f64>| {
            let mean = values.iter().sum::<f64>() / N as f64;
            (mean, values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / N as f64)
        };
        let (mean, variance) = moments((0..N).map(|_| rng.uniform()).collect());
        assert!((mean - 0.5).abs() < 0.005 && (variance - 1.0 / 12.0).abs() < 0.002);
        let (mean, variance) = moments((0..N).map(|_| rng.gaussian()).collect());
        assert!(mean.abs() < 0.015 && (variance - 1.0).abs() < 0.02);
        let sum: DVec3 = (0..N).map(|_| rng.direction()).sum();
        assert!(sum.length() / (N as f64) < 0.01);
        assert!((0..N).all(|_| rng.below(3) < 3));
    }

    #[test]
    fn seeds_and_streams_differ() {
        let first = |seed, stream| Rng::new(seed, stream).next_u32();
        assert_ne!(first(1, 1), first(2, 1));
        assert_ne!(first(1, 1), first(1, 2));
        assert_eq!(first(1, 1), first(1, 1));
    }
}
