//! How large a surfel must be so that its cloud has no holes.
//!
//! *Theory.* Disks cover a surface where every point of it lies within r of a centre. A point of the tangent plane lies
//! nearest to the centre in whose Voronoi cell it is, and a cell's farthest points are its vertices. So a surfel whose radius
//! is V, the distance to the farthest vertex of its own cell, covers its cell, and all of them cover the surface. (V is also
//! the largest circumradius of the Delaunay triangles at the point.)
//!
//! *The rule.* r = max([`COVERAGE`] · d₆, [`MARGIN`] · V), where d₆ is the distance to the sixth neighbour. In regular and
//! blue-noise samplings the first term is the larger one: it gives the blended field enough overlap to be smooth (six
//! neighbours are one ring). The second closes the holes of irregular samplings. MARGIN makes up for curvature, and for a
//! kernel that fades towards its rim.
//!
//! *Borders.* Cells at the border of an open cloud are unbounded, and triangles along it are slivers whose circumcentres
//! lie far outside. Where no neighbour lies in a sector wider than [`BORDER_GAP`], first more neighbours are asked for (a
//! change of density looks like a border from close by); if the sector stays empty, it is a border: vertices in it do not
//! count, and d₆ becomes the distance to as many neighbours as the remaining angle would hold of six.

use glam::Vec2;

/// Radius as a multiple of the distance to the sixth neighbour.
pub(crate) const COVERAGE: f32 = 1.3;

/// Radius as a multiple of the distance to the farthest vertex of the Voronoi cell.
pub(crate) const MARGIN: f32 = 1.25;

/// Neighbours in one ring: each has six in a triangulation, on average (Euler).
pub(crate) const RING: usize = 6;

/// The angle (radians, 120°) of an empty sector that speaks of a border: the angle at which a triangle's other two corners
/// both see its circumcentre nearer to straight ahead, and so cover it. Without such a sector the cell is bounded.
const BORDER_GAP: f32 = std::f32::consts::TAU / 3.0;

/// What the neighbours say of a surfel's radius.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Coverage {
    /// The radius by the module's rule, in the units of the offsets.
    pub radius: f32,
    /// Whether a sector wider than [`BORDER_GAP`] holds no neighbour: ask again with more neighbours.
    pub open: bool,
}

/// Buffers of one thread.
#[derive(Debug, Default)]
pub(crate) struct Scratch {
    cell: Vec<Corner>,
    clipped: Vec<Corner>,
    angles: Vec<f32>,
}

/// A corner of the cell and whether the edge that leaves it is a bisector (else it is one of the first square).
#[derive(Debug, Clone, Copy)]
struct Corner {
    at: Vec2,
    bisector: bool,
}

/// The radius for `neighbours`: offsets in the tangent plane, nearest first. Zero where there is none.
pub(crate) fn coverage(neighbours: &[Vec2], scratch: &mut Scratch) -> Coverage {
    let Some(reach) = neighbours.last().map(|e| e.length()) else { return Coverage { radius: 0.0, open: true } };
    let ring = neighbours[neighbours.len().min(RING) - 1].length();
    let bounded = voronoi_cell(neighbours, reach, scratch);
    let farthest = farthest_vertex(&scratch.cell, |_| true);
    if bounded && MARGIN * farthest <= COVERAGE * ring {
        return Coverage { radius: COVERAGE * ring, open: false };
    }
    let (gap, middle) = widest_gap(neighbours, &mut scratch.angles);
    if gap < BORDER_GAP {
        return Coverage { radius: (COVERAGE * ring).max(MARGIN * farthest), open: false };
    }
    let remaining = (RING as f32 * (1.0 - gap / std::f32::consts::TAU)).ceil() as usize;
    let ring = neighbours[neighbours.len().min(remaining.max(1)) - 1].length();
    let farthest = farthest_vertex(&scratch.cell, |vertex| vertex.angle_to(middle).abs() > 0.5 * gap).min(reach);
    Coverage { radius: (COVERAGE * ring).max(MARGIN * farthest), open: true }
}

/// Clips a square of half-side `reach` by the bisectors towards all neighbours; whether nothing of the square remains.
fn voronoi_cell(neighbours: &[Vec2], reach: f32, scratch: &mut Scratch) -> bool {
    let Scratch { cell, clipped, .. } = scratch;
    cell.clear();
    cell.extend(
        [(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)]
            .map(|(x, y)| Corner { at: Vec2::new(x, y) * reach, bisector: false }),
    );
    for &e in neighbours {
        // Points nearer to the neighbour than to the centre: x·e > e²/2.
        let limit = 0.5 * e.length_squared();
        if !(limit > 0.0) || !cell.iter().any(|corner| corner.at.dot(e) > limit) {
            continue;
        }
        clipped.clear();
        for (i, corner) in cell.iter().enumerate() {
            let next = cell[(i + 1) % cell.len()];
            let (a, b) = (corner.at.dot(e) - limit, next.at.dot(e) - limit);
            if a <= 0.0 {
                clipped.push(*corner);
            }
            if (a <= 0.0) != (b <= 0.0) {
                let at = corner.at + (next.at - corner.at) * (a / (a - b));
                // Leaving the kept side, the bisector is the next edge; coming back, the old edge goes on.
                clipped.push(Corner { at, bisector: if a <= 0.0 { true } else { corner.bisector } });
            }
        }
        std::mem::swap(cell, clipped);
    }
    cell.iter().all(|corner| corner.bisector)
}

/// Distance to the farthest true vertex, where two bisectors meet, among those that `counts` accepts.
fn farthest_vertex(cell: &[Corner], counts: impl Fn(Vec2) -> bool) -> f32 {
    let mut farthest2 = 0.0f32;
    for (i, corner) in cell.iter().enumerate() {
        let before = cell[(i + cell.len() - 1) % cell.len()];
        if corner.bisector && before.bisector && counts(corner.at) {
            farthest2 = farthest2.max(corner.at.length_squared());
        }
    }
    farthest2.sqrt()
}

/// The widest sector without a neighbour: its angle in radians and the direction of its middle.
fn widest_gap(neighbours: &[Vec2], angles: &mut Vec<f32>) -> (f32, Vec2) {
    angles.clear();
    angles.extend(neighbours.iter().filter(|e| e.length_squared() > 0.0).map(|e| e.y.atan2(e.x)));
    angles.sort_unstable_by(f32::total_cmp);
    let Some((&first, &last)) = angles.first().zip(angles.last()) else { return (std::f32::consts::TAU, Vec2::X) };
    let mut widest = (first + std::f32::consts::TAU - last, last);
    for pair in angles.windows(2) {
        if pair[1] - pair[0] > widest.0 {
            widest = (pair[1] - pair[0], pair[0]);
        }
    }
    (widest.0, Vec2::from_angle(widest.1 + 0.5 * widest.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn nearest_first(mut points: Vec<Vec2>) -> Vec<Vec2> {
        points.sort_by(|a, b| a.length_squared().total_cmp(&b.length_squared()));
        points
    }

    fn grid(keep: impl Fn(i32, i32) -> bool) -> Vec<Vec2> {
        let all = (-2..=2).flat_map(|y| (-2..=2).map(move |x| (x, y)));
        nearest_first(
            all.filter(|&(x, y)| (x, y) != (0, 0) && keep(x, y)).map(|(x, y)| Vec2::new(x as f32, y as f32)).collect(),
        )
    }

    #[test]
    fn a_square_grid_has_a_square_cell() {
        let mut scratch = Scratch::default();
        let points = grid(|_, _| true);
        assert!(voronoi_cell(&points, points.last().unwrap().length(), &mut scratch));
        assert!((farthest_vertex(&scratch.cell, |_| true) - 0.5f32.sqrt()).abs() < 1e-6);
        let cover = coverage(&points, &mut scratch);
        assert!(!cover.open && (cover.radius - COVERAGE * 2.0f32.sqrt()).abs() < 1e-6);
    }

    #[test]
    fn a_border_is_capped_and_said() {
        let mut scratch = Scratch::default();
        // Half of the plane is missing, and the border is slightly ragged: circumcentres lie far outside.
        let points: Vec<Vec2> = grid(|_, y| y <= 0).iter().map(|e| *e - Vec2::Y * 0.01 * e.x.abs()).collect();
        let cover = coverage(&nearest_first(points), &mut scratch);
        assert!(cover.open && cover.radius < 1.6, "{cover:?}");
    }

    #[test]
    fn a_void_on_one_side_is_covered() {
        // Near neighbours on one side, two far ones on the other: no sector is empty, so the cell's far vertices count.
        let mut points: Vec<Vec2> = (0..12).map(|i| Vec2::from_angle(i as f32 * 0.26) * 0.2).collect();
        points.extend([4.0, 5.2].map(|angle| Vec2::from_angle(angle) * 2.0));
        let cover = coverage(&nearest_first(points), &mut Scratch::default());
        assert!(!cover.open && cover.radius > MARGIN, "{cover:?}");
    }

    #[test]
    fn no_neighbour_and_one_neighbour() {
        let mut scratch = Scratch::default();
        assert_eq!(coverage(&[], &mut scratch).radius, 0.0);
        let cover = coverage(&[Vec2::X], &mut scratch);
        assert!(cover.open && cover.radius >= COVERAGE && cover.radius < 2.0);
    }
}
