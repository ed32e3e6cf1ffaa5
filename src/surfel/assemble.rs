//! Order and chunks: how world-space points become the arrays of a [`super::SurfelCloud`].

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::{CHUNK, Chunk, Surfel, Sym3};

/// Bits of a Morton code for each axis: three of them fill a `u64` but for its top bit.
const MORTON_BITS: u32 = 21;

/// A chunk's origin has steps of its extent over this: so few digits that differences of origins are exact in `f64`
/// whatever the chunk, and the origin does not depend on the order of a sum.
const ORIGIN_STEPS: f64 = 256.0;

/// Points about which offsets are taken: the component-wise median of a sample. The mean or the middle of the bounds would
/// follow a single far outlier and leave the bulk with few digits.
pub(crate) fn median(points: &[DVec3]) -> DVec3 {
    /// Points looked at.
    const SAMPLE: usize = 4096;
    let step = points.len().div_ceil(SAMPLE).max(1);
    let of = |axis: fn(&DVec3) -> f64| {
        let mut values: Vec<f64> = points.iter().step_by(step).map(axis).collect();
        let middle = values.len() / 2;
        if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(middle, f64::total_cmp).1 }
    };
    DVec3::new(of(|p| p.x), of(|p| p.y), of(|p| p.z))
}

/// The order in which `points` follow a Z-curve: near in the list is near in space. Identical points come side by side, by
/// index.
pub(crate) fn morton_order(points: &[Vec3]) -> Vec<u32> {
    assert!(u32::try_from(points.len()).is_ok(), "points are counted in 32 bits");
    let (low, high) = points
        .par_iter()
        .map(|p| (*p, *p))
        .reduce(|| (Vec3::INFINITY, Vec3::NEG_INFINITY), |a, b| (a.0.min(b.0), a.1.max(b.1)));
    let side = (high - low).max_element();
    let scale = if side > 0.0 { ((1u64 << MORTON_BITS) - 1) as f32 / side } else { 0.0 };
    let code = |p: Vec3| {
        let q = (p - low) * scale;
        spread(q.x as u64) | spread(q.y as u64) << 1 | spread(q.z as u64) << 2
    };
    let mut keys: Vec<(u64, u32)> = points.par_iter().enumerate().map(|(i, p)| (code(*p), i as u32)).collect();
    keys.par_sort_unstable_by(|a, b| {
        a.0.cmp(&b.0).then_with(|| {
            let (p, q) = (points[a.1 as usize], points[b.1 as usize]);
            p.x.total_cmp(&q.x).then(p.y.total_cmp(&q.y)).then(p.z.total_cmp(&q.z)).then(a.1.cmp(&b.1))
        })
    });
    keys.into_par_iter().map(|(_, index)| index).collect()
}

/// Two zero bits after each of the low [`MORTON_BITS`] bits.
fn spread(x: u64) -> u64 {
    let mut x = x & 0x1f_ffff;
    x = (x | x << 32) & 0x1f_0000_0000_ffff;
    x = (x | x << 16) & 0x1f_0000_ff00_00ff;
    x = (x | x << 8) & 0x100f_00f0_0f00_f00f;
    x = (x | x << 4) & 0x10c3_0c30_c30c_30c3;
    (x | x << 2) & 0x1249_2492_4924_9249
}

/// What a surfel is but for its place.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Body {
    pub radius: f32,
    pub normal: Vec3,
    pub colour: [u8; 4],
    pub curvature: Sym3,
    /// Confidence in the normal, 0 to 255.
    pub confidence: u8,
}

/// Surfels at `positions` (world space, in their final order), the chunks over them, and their confidences. `body` is asked once for each index,
/// from many threads, with a scratch of the thread; `done` is told how many more are ready.
pub(crate) fn assemble<S: Default + Send>(
    positions: &[DVec3],
    body: impl Fn(usize, &mut S) -> Body + Sync,
    done: impl Fn(usize) + Sync,
) -> (Vec<Surfel>, Vec<Chunk>, Vec<u8>) {
    let mut confidences = vec![0; positions.len()];
    let mut surfels =
        vec![
            Surfel { offset: Vec3::ZERO, radius: 0.0, normal: Vec3::ZERO, colour: [0; 4], curvature: Sym3::default() };
            positions.len()
        ];
    let chunks = surfels
        .par_chunks_mut(CHUNK)
        .zip(confidences.par_chunks_mut(CHUNK))
        .zip(positions.par_chunks(CHUNK))
        .enumerate()
        .map_init(S::default, |scratch, (c, ((surfels, confidences), positions))| {
            let origin = chunk_origin(positions);
            let places = surfels.iter_mut().zip(confidences).zip(positions);
            for (i, ((surfel, noted), p)) in places.enumerate() {
                let Body { radius, normal, colour, curvature, confidence } = body(c * CHUNK + i, scratch);
                *noted = confidence;
                *surfel = Surfel { offset: (*p - origin).as_vec3(), radius, normal, colour, curvature };
            }
            done(surfels.len());
            chunk_over(origin, surfels)
        })
        .collect();
    (surfels, chunks, confidences)
}

/// The centroid, with few digits.
fn chunk_origin(positions: &[DVec3]) -> DVec3 {
    let first = positions[0];
    let (mut low, mut high, mut sum) = (first, first, DVec3::ZERO);
    for p in positions {
        low = low.min(*p);
        high = high.max(*p);
        sum += *p - first;
    }
    let centroid = first + sum / positions.len() as f64;
    let step = ((high - low).max_element() / ORIGIN_STEPS).log2().floor().exp2();
    if step > 0.0 && step.is_finite() { (centroid / step).round() * step } else { centroid }
}

/// The chunk of surfels whose offsets are set.
pub(crate) fn chunk_over(origin: DVec3, surfels: &[Surfel]) -> Chunk {
    let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    for surfel in surfels {
        low = low.min(surfel.offset);
        high = high.max(surfel.offset);
    }
    let centre = 0.5 * (low + high);
    let extent = surfels.iter().map(|s| s.offset.distance(centre)).fold(0.0, f32::max);
    // A few roundings of f32 may place a centre just outside.
    let extent = extent * (1.0 + 4.0 * f32::EPSILON);
    Chunk { origin, centre, extent, largest_radius: surfels.iter().map(|s| s.radius).fold(0.0, f32::max) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_z_curve_of_a_small_cube() {
        let points: Vec<Vec3> =
            (0..8).rev().map(|i| Vec3::new((i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2) as f32)).collect();
        assert_eq!(morton_order(&points), [7, 6, 5, 4, 3, 2, 1, 0]);
        assert_eq!(morton_order(&[Vec3::ONE; 3]), [0, 1, 2]);
        assert!(morton_order(&[]).is_empty());
    }

    #[test]
    fn far_from_the_origin_nothing_is_lost() {
        let far = DVec3::new(1e7, -3e7, 5.0);
        let positions: Vec<DVec3> =
            (0..200).map(|i| far + DVec3::new(f64::from(i) * 1e-3, (f64::from(i) * 0.37).sin() * 1e-3, 0.1)).collect();
        let body = Body { radius: 1.0, normal: Vec3::Z, colour: [1; 4], curvature: Sym3::default(), confidence: 9 };
        let (surfels, chunks, confidence) = assemble::<()>(&positions, |_, ()| body, |_| ());
        assert_eq!((surfels.len(), chunks.len()), (200, 4));
        assert_eq!(confidence, [9; 200]);
        for (i, p) in positions.iter().enumerate() {
            let chunk = &chunks[i / CHUNK];
            let centre = chunk.origin + surfels[i].offset.as_dvec3();
            // f64 itself has steps of 4e-9 at 3e7.
            assert!(centre.distance(*p) < 1e-8, "{}", centre.distance(*p));
            assert!(surfels[i].offset.distance(chunk.centre) <= chunk.extent);
        }
    }

    #[test]
    fn the_median_ignores_an_outlier() {
        let mut points = vec![DVec3::ONE; 99];
        points.push(DVec3::splat(1e12));
        assert_eq!(median(&points), DVec3::ONE);
        assert_eq!(median(&[]), DVec3::ZERO);
    }
}
