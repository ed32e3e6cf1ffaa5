//! Exact Euclidean distances on a pixel grid.
//!
//! *Theory*: Felzenszwalb and Huttenlocher, "Distance Transforms of Sampled Functions", Theory of Computing 8 (2012):
//! the squared distance to the nearest seed is, row by row, the lower envelope of one parabola per column, whose height
//! is the squared distance to the nearest seed within that column.
//!
//! *Practice*: columns are two sweeps instead of a second envelope, and only columns that hold a seed become parabolas,
//! so no infinite number enters the arithmetic. All values are integers far below 2⁵³, so distances are exact.

/// For every cell of a `width` × `height` grid, row by row, the *squared* distance in cells to the nearest cell of
/// `seeds` (indices into the grid); infinite where there is no seed.
pub fn squared_distances(width: usize, height: usize, seeds: &[usize]) -> Vec<f64> {
    let mut squared = vec![f64::INFINITY; width * height];
    seeds.iter().for_each(|&seed| squared[seed] = 0.0);
    for x in 0..width {
        let mut sweep = |rows: &mut dyn Iterator<Item = usize>| {
            let mut steps = f64::INFINITY;
            for y in rows {
                let cell = &mut squared[y * width + x];
                steps = if *cell == 0.0 { 0.0 } else { steps + 1.0 };
                *cell = cell.min(steps * steps);
            }
        };
        sweep(&mut (0..height));
        sweep(&mut (0..height).rev());
    }
    let mut heights = Vec::with_capacity(width);
    let mut envelope = Envelope::default();
    for row in squared.chunks_exact_mut(width.max(1)) {
        heights.clear();
        heights.extend_from_slice(row);
        envelope.lower(&heights, row);
    }
    squared
}

/// The parabolas that are lowest somewhere, left to right.
#[derive(Default)]
struct Envelope {
    apexes: Vec<usize>,
    /// Where each parabola takes over from the one before it.
    starts: Vec<f64>,
}

impl Envelope {
    /// `out[x]` = least of `heights[q] + (x − q)²` over all q.
    fn lower(&mut self, heights: &[f64], out: &mut [f64]) {
        self.apexes.clear();
        self.starts.clear();
        for (q, &height) in heights.iter().enumerate().filter(|(_, height)| height.is_finite()) {
            let value = |apex: usize, height: f64| height + (apex * apex) as f64;
            let mut start = f64::NEG_INFINITY;
            while let (Some(&apex), Some(&last_start)) = (self.apexes.last(), self.starts.last()) {
                start = (value(q, height) - value(apex, heights[apex])) / (2.0 * (q - apex) as f64);
                if start > last_start {
                    break;
                }
                self.apexes.pop();
                self.starts.pop();
                start = f64::NEG_INFINITY;
            }
            self.apexes.push(q);
            self.starts.push(start);
        }
        if self.apexes.is_empty() {
            return;
        }
        let mut k = 0;
        for (x, out) in out.iter_mut().enumerate() {
            while self.starts.get(k + 1).is_some_and(|&start| start < x as f64) {
                k += 1;
            }
            let apart = x as f64 - self.apexes[k] as f64;
            *out = heights[self.apexes[k]] + apart * apart;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measure::rng::Rng;

    #[test]
    fn equals_brute_force_on_random_seeds() {
        let mut rng = Rng::new(3, 0);
        for (width, height, count) in [(1, 1, 1), (17, 1, 3), (1, 9, 2), (31, 23, 1), (31, 23, 5), (40, 37, 200)] {
            let seeds: Vec<usize> = (0..count).map(|_| rng.below(width * height)).collect();
            let measured = squared_distances(width, height, &seeds);
            for (cell, measured) in measured.iter().enumerate() {
                let apart = |a: usize, b: usize| (a as f64 - b as f64).powi(2);
                let to = |s: &usize| apart(cell % width, s % width) + apart(cell / width, s / width);
                let expected = seeds.iter().map(to).fold(f64::INFINITY, f64::min);
                assert_eq!(*measured, expected);
            }
        }
    }

    #[test]
    fn no_seed_is_infinitely_far() {
        assert!(squared_distances(4, 3, &[]).iter().all(|d| *d == f64::INFINITY));
        assert!(squared_distances(0, 0, &[]).is_empty());
    }
}
