//! Points that belong to no surface: their disks are made small.
//!
//! *Practice.* A scanner's stray points hang in the air. Where nothing about one faces alike, the radius rule has only
//! distances, and would give it a disk as large as the gap to the surface. A point is *isolated* where its radius is more than [`RATIO`] times that of the surfels about
//! it and it also lies off their tangent planes: a sparse point beside a dense part of the same surface lies in them, and
//! needs its large disk.

use rayon::prelude::*;

use super::around::Sheets;
use super::{CHUNK, Chunk, Surfel};

/// How much larger than those about it an isolated point's radius is. Twice is common in random samplings.
const RATIO: f32 = 4.0;

/// How far off the tangent planes about it an isolated point lies, in radii of the surfels about it.
const HEIGHT: f32 = 2.0;

/// Surfels asked.
const ASKED: usize = 16;

/// Gives isolated surfels the radius that is usual about them, except those for which `keeps` holds; returns how many.
pub(crate) fn settle(
    sheets: &Sheets<'_>,
    surfels: &mut [Surfel],
    chunks: &mut [Chunk],
    keeps: impl Fn(usize) -> bool + Sync,
) -> usize {
    let Sheets { neighbours, points, normals, .. } = *sheets;
    if surfels.len() <= ASKED {
        return 0;
    }
    let mut radii: Vec<f32> = surfels.iter().map(|s| s.radius).collect();
    let middle = radii.len() / 2;
    let usual = *radii.select_nth_unstable_by(middle, f32::total_cmp).1;
    drop(radii);
    let look = |i: usize, (found, radii, heights): &mut (Vec<(u32, f32)>, Vec<f32>, Vec<f32>)| {
        neighbours.nearest_k(points[i], ASKED + 1, found);
        let others = || found.iter().map(|f| f.0 as usize).filter(|j| *j != i);
        radii.clear();
        radii.extend(others().map(|j| surfels[j].radius));
        heights.clear();
        heights.extend(others().map(|j| normals[j].dot(points[i] - points[j]).abs()));
        let median = |values: &mut Vec<f32>| {
            let middle = values.len() / 2;
            *values.select_nth_unstable_by(middle, f32::total_cmp).1
        };
        let about = median(radii);
        (surfels[i].radius > RATIO * about && median(heights) > HEIGHT * about).then_some((i, about))
    };
    let found: Vec<(usize, f32)> = (0..surfels.len())
        .into_par_iter()
        .with_min_len(CHUNK)
        .filter(|i| surfels[*i].radius > RATIO * usual && !keeps(*i))
        .map_init(Default::default, |scratch, i| look(i, scratch))
        .flatten()
        .collect();
    for &(i, radius) in &found {
        surfels[i].radius = radius;
        let chunk = i / CHUNK;
        let members = &surfels[chunk * CHUNK..surfels.len().min((chunk + 1) * CHUNK)];
        chunks[chunk].largest_radius = members.iter().map(|s| s.radius).fold(0.0, f32::max);
    }
    found.len()
}
