//! The laws of Boolean algebra on pictures: two expressions that are equal by a law must be drawn alike, bit for bit.
//!
//! Random trees over random closed meshes, some of which share faces exactly, are slivers, or are seen edge on. Nothing is
//! compared with a stored picture: the law is the truth. Who owns a boundary depends on the expression's value alone, so the
//! leaves are compared too.

use std::collections::HashMap;
use std::sync::Arc;

use glam::{DAffine3, DMat3, DQuat, DVec3};

use super::rng::Rng;
use crate::blister::{MeshFrame, MeshLeaf, MeshModel, MeshModelError, MeshShape};
use crate::csg::{LeafId, Tree};
use crate::geometry::TriMesh;
use crate::layers::{LayerLimit, LayerStack};
use crate::scene::LeafKind;
use crate::space::{Camera, CameraError, Lens};

/// The most leaves of a scene.
const MOST_LEAVES: usize = 8;

/// A law that a picture breaks.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Broken {
    /// The law.
    pub law: &'static str,
    /// Pixels that differ.
    pub pixels: usize,
}

/// Why a scene of the laws cannot be drawn: a bug.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum AlgebraError {
    /// Its leaves.
    #[error(transparent)]
    Model(#[from] MeshModelError),
    /// Its camera.
    #[error(transparent)]
    Camera(#[from] CameraError),
}

/// Draws both sides of every law on the scene of `seed` at `side`² pixels; returns the laws that do not hold.
///
/// # Errors
/// [`AlgebraError`] where the scene cannot be drawn.
pub fn broken_laws(seed: u64, side: u32) -> Result<Vec<Broken>, AlgebraError> {
    let mut rng = Rng::new(seed, 0);
    let leaves = random_leaves(&mut rng);
    let camera = random_camera(&mut rng, side)?;
    let mut random = || random_tree(&mut rng, leaves.len());
    let (a, b, c) = (random(), random(), random());
    let draw = |tree: &Tree| -> Result<LayerStack, AlgebraError> {
        let model = MeshModel::new(&leaves, tree)?;
        Ok(LayerStack::collect(&MeshFrame::new(&model, camera.clone(), LayerLimit::All, 1)))
    };
    let mut broken = Vec::new();
    for (law, one, other) in laws(&a, &b, &c) {
        let one = draw(&one)?;
        let pixels = match other {
            Some(other) => {
                let other = draw(&other)?;
                let differ = |i: &u32| one.at(i % side, i / side) != other.at(i % side, i / side);
                (0..side * side).filter(differ).count()
            }
            None => (0..side * side).filter(|i| !one.at(i % side, i / side).is_empty()).count(),
        };
        if pixels > 0 {
            broken.push(Broken { law, pixels });
        }
    }
    Ok(broken)
}

/// Each law with its two sides; `None` is nothing at all.
fn laws(a: &Tree, b: &Tree, c: &Tree) -> Vec<(&'static str, Tree, Option<Tree>)> {
    let (not, and, or, minus) = (
        |a: &Tree| Tree::not(a.clone()),
        |a: &Tree, b: &Tree| Tree::and(a.clone(), b.clone()),
        |a: &Tree, b: &Tree| Tree::or(a.clone(), b.clone()),
        |a: &Tree, b: &Tree| Tree::minus(a.clone(), b.clone()),
    );
    vec![
        ("a - a is empty", minus(a, a), None),
        ("a & !a is empty", and(a, &not(a)), None),
        ("a | !a has no boundary", or(a, &not(a)), None),
        ("a | a = a", or(a, a), Some(a.clone())),
        ("a & a = a", and(a, a), Some(a.clone())),
        ("!(a | b) = !a & !b", not(&or(a, b)), Some(and(&not(a), &not(b)))),
        ("!(a & b) = !a | !b", not(&and(a, b)), Some(or(&not(a), &not(b)))),
        ("a | a & b = a", or(a, &and(a, b)), Some(a.clone())),
        ("a & (a | b) = a", and(a, &or(a, b)), Some(a.clone())),
        ("a & (b | c) = a & b | a & c", and(a, &or(b, c)), Some(or(&and(a, b), &and(a, c)))),
        ("a | b & c = (a | b) & (a | c)", or(a, &and(b, c)), Some(and(&or(a, b), &or(a, c)))),
        ("(a | b) | c = a | (b | c)", or(&or(a, b), c), Some(or(a, &or(b, c)))),
        ("(a & b) & c = a & (b & c)", and(&and(a, b), c), Some(and(a, &and(b, c)))),
        ("a - b - c = a - (b | c)", minus(&minus(a, b), c), Some(minus(a, &or(b, c)))),
        ("a | b = b | a", or(a, b), Some(or(b, a))),
    ]
}

/// A tree in which leaves may occur any number of times.
fn random_tree(rng: &mut Rng, leaves: usize) -> Tree {
    let mut parts: Vec<Tree> =
        (0..1 + rng.below(2 * leaves)).map(|_| Tree::leaf(LeafId(rng.below(leaves) as u32))).collect();
    while parts.len() > 1 {
        let b = parts.swap_remove(rng.below(parts.len()));
        let a = parts.swap_remove(rng.below(parts.len()));
        parts.push(match rng.below(7) {
            0 | 1 => Tree::and(a, b),
            2 | 3 => Tree::or(a, b),
            4 | 5 => Tree::minus(a, b),
            _ => Tree::not(Tree::or(a, b)),
        });
    }
    parts.swap_remove(0)
}

fn random_leaves(rng: &mut Rng) -> Vec<MeshLeaf> {
    let count = 1 + rng.below(MOST_LEAVES);
    let mut leaves: Vec<MeshLeaf> = Vec::with_capacity(count);
    for id in 0..count {
        let (mesh, world_from_leaf) = match rng.below(6) {
            // On a lattice: faces of different leaves coincide, and are cut into triangles differently.
            0..=2 => {
                let mesh = block(std::array::from_fn(|_| 1 + rng.below(3)));
                let on_lattice = |rng: &mut Rng| 0.5 * (rng.below(4) as f64 - 1.5);
                let middle = DVec3::new(on_lattice(rng), on_lattice(rng), on_lattice(rng));
                let half = DVec3::new(0.25, 0.25, 0.25) * (1 + rng.below(2)) as f64;
                (mesh, DAffine3::from_scale_rotation_translation(half, DQuat::IDENTITY, middle))
            }
            // A sliver.
            3 => (block([1, 1, 1]), placed(rng, DVec3::new(1.0, 0.7, 1e-4))),
            4 => (ball_mesh(rng.below(3)), placed(rng, DVec3::splat(0.6))),
            _ => (block([1, 2, 1]), placed(rng, DVec3::new(0.5, 0.3, -0.6))),
        };
        // Now and then the very copy of another leaf.
        let (shape, world_from_leaf) = match leaves.last() {
            Some(last) if rng.below(5) == 0 => (last.shape.clone(), last.world_from_leaf),
            _ => (MeshShape::Mesh(Arc::new(mesh)), world_from_leaf),
        };
        leaves.push(MeshLeaf {
            leaf: LeafId(id as u32),
            shape,
            world_from_leaf,
            colour: [0.5; 3],
            vertex_colours: false,
            opacity: 1.0,
            kind: LeafKind::Solid,
        });
    }
    leaves
}

fn placed(rng: &mut Rng, scale: DVec3) -> DAffine3 {
    let turn = DQuat::from_axis_angle(rng.direction(), 6.3 * rng.uniform());
    let moved = rng.direction() * 0.6 * rng.uniform();
    DAffine3::from_mat3_translation(DMat3::from_quat(turn) * DMat3::from_diagonal(scale), moved)
}

fn random_camera(rng: &mut Rng, side: u32) -> Result<Camera, CameraError> {
    // On the lattice's planes now and then, whose faces are then seen edge on; now and then inside of everything.
    let mut eye = rng.direction() * if rng.below(8) == 0 { 0.3 } else { 4.0 };
    if rng.below(3) == 0 {
        eye.z = 0.5 * eye.z.round();
    }
    let lens = if rng.below(4) == 0 { Lens::Height(3.0) } else { Lens::FovY(45.0) };
    let up = if eye.x.abs() + eye.y.abs() < 0.1 { DVec3::X } else { DVec3::Z };
    Camera::look_at(eye, DVec3::new(0.0, 0.0, eye.z * 0.2), up, lens, side, side)
}

/// The cube from −1 to 1, its sides cut into so many strips along x, y and z: closed, seen from outside anticlockwise.
pub fn block(strips: [usize; 3]) -> TriMesh {
    let mut mesh = TriMesh::default();
    let mut known: HashMap<[u64; 3], u32> = HashMap::new();
    for axis in 0..3 {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        for side in [-1.0, 1.0] {
            let mut vertex = |i: usize, j: usize| {
                let at = |i: usize, n: usize| -1.0 + 2.0 * i as f64 / n as f64;
                let mut p = DVec3::ZERO;
                (p[axis], p[u], p[v]) = (side, at(i, strips[u]), at(j, strips[v]));
                *known.entry(p.to_array().map(f64::to_bits)).or_insert_with(|| {
                    mesh.positions.push(p);
                    mesh.positions.len() as u32 - 1
                })
            };
            for i in 0..strips[u] {
                for j in 0..strips[v] {
                    let (a, b, c, d) = (vertex(i, j), vertex(i + 1, j), vertex(i + 1, j + 1), vertex(i, j + 1));
                    let quad = if side > 0.0 { [[a, b, c], [a, c, d]] } else { [[a, c, b], [a, d, c]] };
                    mesh.triangles.extend(quad);
                }
            }
        }
    }
    mesh
}

/// The unit sphere as an octahedron, each of whose triangles is cut into four `times` times: closed, outward.
pub fn ball_mesh(times: usize) -> TriMesh {
    let mut positions: Vec<DVec3> = DVec3::AXES.into_iter().flat_map(|axis| [axis, -axis]).collect();
    let mut triangles = Vec::new();
    for (x, y, z) in (0..8).map(|corner| (corner & 1, corner >> 1 & 1, corner >> 2 & 1)) {
        let triangle = [x, 2 + y, 4 + z].map(|v| v as u32);
        let is_turned = (x + y + z) % 2 == 1;
        triangles.push(if is_turned { [triangle[0], triangle[2], triangle[1]] } else { triangle });
    }
    for _ in 0..times {
        let mut middles: HashMap<(u32, u32), u32> = HashMap::new();
        let mut middle = |a: u32, b: u32| {
            *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
                positions.push((positions[a as usize] + positions[b as usize]).normalize());
                positions.len() as u32 - 1
            })
        };
        triangles = triangles
            .into_iter()
            .flat_map(|[a, b, c]| {
                let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
                [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
            })
            .collect();
    }
    TriMesh { positions, triangles, colours: None }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shapes_are_closed_and_outward() {
        for mesh in [block([1, 2, 3]), ball_mesh(0), ball_mesh(2)] {
            let mut balance: HashMap<(u32, u32), i32> = HashMap::new();
            for &[a, b, c] in &mesh.triangles {
                for (from, to) in [(a, b), (b, c), (c, a)] {
                    *balance.entry((from.min(to), from.max(to))).or_default() += if from < to { 1 } else { -1 };
                }
            }
            assert!(balance.values().all(|&count| count == 0));
            assert!(mesh.signed_volume() > 0.0);
        }
        assert!((block([2, 2, 2]).signed_volume() - 8.0).abs() < 1e-12);
    }

    #[test]
    fn the_laws_hold_on_the_first_seeds() {
        for seed in 0..24 {
            assert_eq!(broken_laws(seed, 64), Ok(Vec::new()), "seed {seed}");
        }
    }
}
