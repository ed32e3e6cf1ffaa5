//! Signs for normals: outward, and consistent over the cloud.
//!
//! *Theory.* Hoppe et al. 1992 (§3.2) carry the sign along a minimum spanning tree of the neighbour graph, whose edges cost
//! 1 − |nᵢ·nⱼ|: flat places first. Across a sharp edge nᵢ·nⱼ says nothing; Xie et al. 2003 and König & Gumhold 2009 mirror nᵢ
//! on the plane that halves the step e = pⱼ − pᵢ, which is exact on every circular arc: nᵢ' = nᵢ − 2 (nᵢ·e) e / e².
//!
//! *Changes from the papers.* (1) Mirroring turns the sign over where the step runs along the normals: right for the two sides
//! of a thin plate, wrong for two noisy samples of one surface. Neither can be told from two points, so such edges come last:
//! the cost is 1 − |a| (1 − |nᵢ·ê| |nⱼ·ê|) with a = nᵢ'·nⱼ. (2) No priority queue: costs are quantised to [`LEVELS`] and
//! sorted by counting, and Kruskal's algorithm joins the ends in a union-find whose links carry a parity, *same sign* or
//! *opposite*. That is deterministic and takes nearly linear time. (3) Hoppe starts at the topmost point. Each component's
//! sign is chosen as a whole instead: by the volume that it bounds (divergence theorem), which also serves several bodies. A
//! small open piece has no volume to speak of and follows the components about it; a closed one inside another is a cavity and
//! is turned inward. (4) Normals that the file gave are never changed: they are one component from the start.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use crate::geometry::neighbours::Neighbours;

/// Edges a point in the neighbour graph.
pub(crate) const DEGREE: usize = 8;

/// No neighbour: clouds of fewer than [`DEGREE`] + 1 points.
pub(crate) const NONE: u32 = u32::MAX;

/// Steps of the edge cost. They are spaced by its root, so that among nearly parallel normals the best still come first.
const LEVELS: usize = 1024;

/// A component is closed where its area vectors cancel to less than this share of its area.
const CLOSED: f64 = 0.2;

/// An open component smaller than this share of the cloud asks the components about it for its sign.
const SMALL: f64 = 0.05;

/// Of so many members of a small component the surroundings are asked.
const VOTERS: usize = 256;

/// Neighbours that a member asks.
const ASKED: usize = 32;

/// Components below this share of the cloud are neither cavities nor do they hold any (bounds the work: at most 100 of them).
const BODY: f64 = 0.01;

/// What was done.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Orientation {
    /// Pieces of the cloud that no edge of the neighbour graph joins.
    pub components: usize,
    /// Closed pieces inside others, turned inward.
    pub cavities: usize,
}

/// The sign of nⱼ that agrees with nᵢ, as the cosine a of the module's text, and the edge's cost, 0 to 1.
#[inline]
pub(crate) fn agreement(step: Vec3, n_i: Vec3, n_j: Vec3) -> (f32, f32) {
    let length2 = step.length_squared();
    if !(length2 > 0.0) {
        let a = n_i.dot(n_j);
        return (a, 1.0 - a.abs());
    }
    let (along_i, along_j) = (n_i.dot(step), n_j.dot(step));
    let product = along_i * along_j / length2;
    let a = n_i.dot(n_j) - 2.0 * product;
    (a, (1.0 - a.abs() * (1.0 - product.abs())).clamp(0.0, 1.0))
}

/// Turns `normals` outward. `graph` holds [`DEGREE`] neighbours a point ([`NONE`] where there are fewer); points of `given`
/// keep theirs.
pub(crate) fn orient(
    neighbours: &Neighbours,
    points: &[Vec3],
    graph: &[u32],
    given: Option<&[bool]>,
    normals: &mut [Vec3],
) -> Orientation {
    let order = edges_by_cost(points, graph, normals);
    let mut forest = Forest::new(points.len());
    if let Some(given) = given {
        let mut first = None;
        for (i, _) in given.iter().enumerate().filter(|(_, given)| **given) {
            let first = *first.get_or_insert(i as u32);
            forest.join(first, i as u32, false);
        }
    }
    for &edge in &order {
        let (i, j) = (edge / DEGREE as u32, graph[edge as usize]);
        let (a, _) = agreement(points[j as usize] - points[i as usize], normals[i as usize], normals[j as usize]);
        forest.join(i, j, a < 0.0);
    }
    drop(order);
    let roots: Vec<u32> = (0..points.len() as u32)
        .map(|i| {
            let (root, opposite) = forest.find(i);
            if opposite {
                normals[i as usize] = -normals[i as usize];
            }
            root
        })
        .collect();
    drop(forest);
    sign_components(neighbours, points, graph, given, &roots, normals)
}

/// The graph's edges as places in `graph`, each pair of points once, cheapest first.
fn edges_by_cost(points: &[Vec3], graph: &[u32], normals: &[Vec3]) -> Vec<u32> {
    assert!(graph.len() < u32::MAX as usize, "edges are counted in 32 bits");
    let neighbours_of = |i: usize| &graph[i * DEGREE..(i + 1) * DEGREE];
    const ABSENT: u16 = u16::MAX;
    let levels: Vec<u16> = (0..graph.len())
        .into_par_iter()
        .with_min_len(1 << 14)
        .map(|edge| {
            let (i, j) = (edge / DEGREE, graph[edge]);
            if j == NONE {
                return ABSENT;
            }
            let j = j as usize;
            // The other end lists this edge too, and comes first.
            if j < i && neighbours_of(j).contains(&(i as u32)) {
                return ABSENT;
            }
            let (_, cost) = agreement(points[j] - points[i], normals[i], normals[j]);
            (cost.sqrt() * (LEVELS - 1) as f32) as u16
        })
        .collect();
    let mut starts = vec![0u32; LEVELS + 1];
    for &level in levels.iter().filter(|level| **level != ABSENT) {
        starts[level as usize + 1] += 1;
    }
    for level in 0..LEVELS {
        starts[level + 1] += starts[level];
    }
    let mut order = vec![0u32; starts[LEVELS] as usize];
    for (edge, &level) in levels.iter().enumerate().filter(|(_, level)| **level != ABSENT) {
        let place = &mut starts[level as usize];
        order[*place as usize] = edge as u32;
        *place += 1;
    }
    order
}

/// Disjoint sets of points, each with a parity relative to its set's root.
struct Forest {
    parent: Vec<u32>,
    /// Whether a point's sign is opposite to its parent's; false for roots.
    opposite: Vec<bool>,
    /// Members, for roots.
    size: Vec<u32>,
}

impl Forest {
    fn new(count: usize) -> Self {
        Self { parent: (0..count as u32).collect(), opposite: vec![false; count], size: vec![1; count] }
    }

    /// Root of `x` and whether its sign is opposite to the root's. Halves the path on the way.
    fn find(&mut self, mut x: u32) -> (u32, bool) {
        let mut opposite = false;
        loop {
            let parent = self.parent[x as usize];
            if parent == x {
                return (x, opposite);
            }
            let grandparent = self.parent[parent as usize];
            // A root's own parity is `false`, so this is right where `parent` is the root, too.
            self.opposite[x as usize] ^= self.opposite[parent as usize];
            self.parent[x as usize] = grandparent;
            opposite ^= self.opposite[x as usize];
            x = grandparent;
        }
    }

    /// Joins the sets of `i` and `j`, whose signs are opposite or the same; nothing where they are one set already.
    fn join(&mut self, i: u32, j: u32, opposite: bool) {
        let ((mut a, of_a), (mut b, of_b)) = (self.find(i), self.find(j));
        if a == b {
            return;
        }
        if (self.size[a as usize], b) < (self.size[b as usize], a) {
            std::mem::swap(&mut a, &mut b);
        }
        self.parent[b as usize] = a;
        self.opposite[b as usize] = of_a ^ of_b ^ opposite;
        self.size[a as usize] += self.size[b as usize];
    }
}

/// The members of one component, with their sums.
struct Component {
    members: Vec<u32>,
    volume: f64,
    closure: f64,
    given: bool,
}

/// An area for point `i`, up to a factor common to all: the square of the distance to its last neighbour in the graph.
fn area(points: &[Vec3], graph: &[u32], i: usize) -> f64 {
    let last = graph[i * DEGREE..(i + 1) * DEGREE].iter().rev().find(|j| **j != NONE);
    last.map_or(1.0, |&j| f64::from(points[j as usize].distance_squared(points[i])))
}

/// π times the density times the squared distance to the k-th neighbour is k on average: the true area from [`area`].
const TRUE_AREA: f64 = std::f64::consts::PI / DEGREE as f64;

fn sign_components(
    neighbours: &Neighbours,
    points: &[Vec3],
    graph: &[u32],
    given: Option<&[bool]>,
    roots: &[u32],
    normals: &mut [Vec3],
) -> Orientation {
    // The component of each root.
    let mut place = vec![NONE; roots.len()];
    let mut components: Vec<Component> = Vec::new();
    for (i, root) in roots.iter().enumerate() {
        if place[*root as usize] == NONE {
            place[*root as usize] = components.len() as u32;
            components.push(Component { members: Vec::new(), volume: 0.0, closure: 0.0, given: false });
        }
        let c = place[*root as usize] as usize;
        components[c].members.push(i as u32);
        components[c].given |= given.is_some_and(|given| given[i]);
    }
    drop(place);
    // Largest first; of equals the one whose first member comes first.
    components.sort_by(|a, b| b.members.len().cmp(&a.members.len()).then(a.members[0].cmp(&b.members[0])));
    for component in &mut components {
        measure(component, points, graph, normals);
    }
    let count = points.len() as f64;
    let mut signed = vec![false; points.len()];
    let mut bodies: Vec<usize> = Vec::new();
    let mut cavities = 0;
    for c in 0..components.len() {
        let component = &components[c];
        let size = component.members.len() as f64;
        let closed = component.closure < CLOSED;
        let flip = if component.given {
            false
        } else if !closed && size < SMALL * count {
            surroundings(neighbours, points, normals, &signed, component).unwrap_or(component.volume) < 0.0
        } else {
            let mut inward = component.volume < 0.0;
            if closed && size >= BODY * count {
                let inside =
                    bodies.iter().filter(|b| holds(&components[**b], points, graph, normals, component)).count();
                if inside % 2 == 1 {
                    cavities += 1;
                    inward = !inward;
                }
                bodies.push(c);
            }
            inward
        };
        for &i in &component.members {
            if flip {
                normals[i as usize] = -normals[i as usize];
            }
            signed[i as usize] = true;
        }
    }
    Orientation { components: components.len(), cavities }
}

/// Fills in the component's volume and closure.
fn measure(component: &mut Component, points: &[Vec3], graph: &[u32], normals: &[Vec3]) {
    let members = &component.members;
    let centre = members.iter().map(|&i| points[i as usize].as_dvec3()).sum::<DVec3>() / members.len() as f64;
    let (mut volume, mut vector, mut total) = (0.0, DVec3::ZERO, 0.0);
    for &i in members {
        let i = i as usize;
        let a = area(points, graph, i);
        let n = normals[i].as_dvec3() * a;
        volume += (points[i].as_dvec3() - centre).dot(n) / 3.0;
        vector += n;
        total += a;
    }
    component.volume = volume;
    component.closure = if total > 0.0 { vector.length() / total } else { 1.0 };
}

/// How the signs of the component's members agree with those of components about it: the sum of their cosines, each weighted
/// by inverse squared distance. `None` where none is near.
fn surroundings(
    neighbours: &Neighbours,
    points: &[Vec3],
    normals: &[Vec3],
    signed: &[bool],
    component: &Component,
) -> Option<f64> {
    let step = component.members.len().div_ceil(VOTERS);
    let mut found = Vec::new();
    let (mut sum, mut any) = (0.0, false);
    for &i in component.members.iter().step_by(step) {
        neighbours.nearest_k(points[i as usize], ASKED, &mut found);
        for &(j, distance) in &found {
            // Larger components are signed already; this one's own members are not.
            if !signed[j as usize] || !(distance > 0.0) {
                continue;
            }
            // Over such a gap the step says little: plain agreement of the normals.
            let cosine = f64::from(normals[i as usize].dot(normals[j as usize]));
            sum += cosine / f64::from(distance * distance);
            any = true;
        }
    }
    any.then_some(sum)
}

/// Whether `body`, already signed, holds the component: the winding number of its surfels about three of the members.
fn holds(body: &Component, points: &[Vec3], graph: &[u32], normals: &[Vec3], component: &Component) -> bool {
    const BLOCK: usize = 4096;
    let size = component.members.len();
    let inside = [0, size / 3, 2 * size / 3].into_iter().filter(|m| {
        let p = points[component.members[*m] as usize].as_dvec3();
        let blocks: Vec<f64> = body
            .members
            .par_chunks(BLOCK)
            .map(|block| {
                block
                    .iter()
                    .map(|&i| {
                        let i = i as usize;
                        let e = points[i].as_dvec3() - p;
                        let length2 = e.length_squared();
                        if !(length2 > 0.0) {
                            return 0.0;
                        }
                        TRUE_AREA * area(points, graph, i) * normals[i].as_dvec3().dot(e) / (length2 * length2.sqrt())
                    })
                    .sum()
            })
            .collect();
        blocks.iter().sum::<f64>().abs() / (4.0 * std::f64::consts::PI) > 0.5
    });
    inside.count() >= 2
}
