//! The mesh pipeline against the judge: the same boundaries at every pixel that is not within snapping distance of an edge.

use std::sync::Arc;

use glam::{DAffine3, DMat3, DQuat, DVec2, DVec3, Vec3};

use super::{MeshFrame, MeshLeaf, MeshModel, MeshModelError, MeshShape};
use crate::composite::{Look, shaded};
use crate::csg::expression::parse;
use crate::csg::{LeafId, Tree};
use crate::geometry::solid::Ball;
use crate::geometry::{Solid, TriMesh};
use crate::layers::{Boundary, LayerLimit, LayerSource, LayerStack, OpaqueTile, TILE_SIDE};
use crate::measure::algebra::{ball_mesh, block};
use crate::measure::rng::Rng;
use crate::reference::{RayBoundary, Reference, TruthLeaf, TruthShape};
use crate::scene::{LeafKind, Light};
use crate::space::{Camera, Lens, PixelRect};

fn tree(text: &str) -> Tree {
    parse(text, &mut |name| Some(LeafId(u32::from(name.as_bytes()[0] - b'a')))).unwrap()
}

fn leaf(id: u32, shape: MeshShape, world_from_leaf: DAffine3) -> MeshLeaf {
    MeshLeaf {
        leaf: LeafId(id),
        shape,
        world_from_leaf,
        colour: [0.5; 3],
        vertex_colours: false,
        opacity: 1.0,
        kind: LeafKind::Solid,
    }
}

fn mesh(mesh: TriMesh) -> MeshShape {
    MeshShape::Mesh(Arc::new(mesh))
}

fn at(x: f64, y: f64, z: f64) -> DAffine3 {
    DAffine3::from_translation(DVec3::new(x, y, z))
}

fn truth(leaf: &MeshLeaf) -> TruthLeaf {
    TruthLeaf {
        world_from_leaf: leaf.world_from_leaf,
        colour: leaf.colour,
        vertex_colours: leaf.vertex_colours,
        opacity: leaf.opacity,
        kind: leaf.kind,
        ..TruthLeaf::new(
            leaf.leaf.0,
            match &leaf.shape {
                MeshShape::Mesh(mesh) => TruthShape::Mesh(mesh.clone()),
                MeshShape::Solid(solid) => TruthShape::Solid(solid.clone()),
            },
        )
    }
}

/// What must be equal for certain.
fn key(found: &[RayBoundary]) -> Vec<(u32, u32, i8)> {
    found.iter().map(|b| (b.leaf, b.body, b.facing as i8)).collect()
}

/// Holds every pixel of the frame against rays. Returns how many pixels show something.
fn check(leaves: &[MeshLeaf], expression: &str, camera: &Camera) -> u32 {
    // Snapping moves edges by at most this far, pixels.
    const SNAP: f64 = 1.0 / 256.0;
    // Of the depth; a plane's key in f32 is this good at all but grazing angles.
    const DEPTH_TOLERANCE: f64 = 2e-6;
    // Below this cosine depth is not compared.
    const GRAZING: f64 = 0.02;
    let model = MeshModel::new(leaves, &tree(expression)).unwrap();
    let stack = LayerStack::collect(&MeshFrame::new(&model, camera.clone(), LayerLimit::All, 1));
    let truths = leaves.iter().map(truth).collect();
    let judge = Reference::new(truths, tree(expression), camera.clone(), 1, LayerLimit::All).unwrap();
    let mut covered = 0;
    for (x, y) in (0..camera.height).flat_map(|y| (0..camera.width).map(move |x| (x, y))) {
        let px = DVec2::new(f64::from(x), f64::from(y)) + 0.5;
        let found = stack.at(x, y);
        covered += u32::from(!found.is_empty());
        let wanted = judge.cast(px);
        let same = |wanted: &[RayBoundary], found: &[Boundary]| {
            wanted.len() == found.len()
                && wanted.iter().zip(found).all(|(w, f)| {
                    let ray = camera.ray(px).dir.normalize();
                    (w.leaf, w.body, w.facing) == (f.leaf, f.body, f.facing)
                        && (w.normal.dot(ray).abs() < GRAZING
                            || (w.depth - f64::from(f.depth)).abs() <= DEPTH_TOLERANCE * w.depth)
                        && w.normal.dot(f.normal.as_dvec3()) > 0.999
                })
        };
        if same(&wanted, found) {
            continue;
        }
        // Within the snapping distance of an edge the rays themselves differ.
        let around = (0..8).map(|i| judge.cast(px + DVec2::from_angle(f64::from(i) * 0.785) * SNAP));
        let is_edge = around.into_iter().any(|other| {
            key(&other) != key(&wanted) || other.iter().zip(&wanted).any(|(a, b)| a.normal.dot(b.normal) < 0.9999)
        });
        assert!(is_edge, "{expression} at {x},{y}: {found:?} instead of {wanted:?}");
    }
    covered
}

fn look(eye: DVec3, target: DVec3, lens: Lens) -> Camera {
    Camera::look_at(eye, target, DVec3::Z, lens, 97, 70).unwrap()
}

const FAR_EYE: DVec3 = DVec3::new(2.6, -3.1, 2.2);

fn cameras() -> [Camera; 3] {
    [
        look(FAR_EYE, DVec3::ZERO, Lens::FovY(40.0)),
        look(FAR_EYE, DVec3::ZERO, Lens::Height(3.5)),
        // From inside, triangles on all sides of the eye.
        look(DVec3::new(0.31, 0.17, -0.23), DVec3::new(-1.0, 0.4, 0.3), Lens::FovY(95.0)),
    ]
}

#[test]
fn meshes_under_every_operator_are_the_judge_s() {
    let turned = DAffine3::from_mat3_translation(
        DMat3::from_quat(DQuat::from_axis_angle(DVec3::new(1.0, 2.0, 0.5).normalize(), 0.7)) * 0.8,
        DVec3::new(0.4, -0.3, 0.35),
    );
    let mirrored =
        DAffine3::from_mat3_translation(DMat3::from_diagonal(DVec3::new(-0.5, 1.3, 0.7)), DVec3::new(-0.3, -0.2, 0.3));
    let leaves = [
        leaf(0, mesh(block([2, 3, 1])), DAffine3::IDENTITY),
        leaf(1, mesh(ball_mesh(2)), turned),
        leaf(2, mesh(ball_mesh(1)), mirrored),
    ];
    for camera in &cameras() {
        for expression in
            ["a", "a - b", "a | b | c", "a & b - c", "(a - b) | (b - a)", "((a - b) | b) - c", "!(a | b)", "c - a - b"]
        {
            let covered = check(&leaves, expression, camera);
            assert!(covered > 20, "{expression}: only {covered} pixels are covered");
        }
    }
}

#[test]
fn analytic_leaves_are_exact_and_cut_meshes() {
    let solids = [
        Solid::Sphere { centre: DVec3::ZERO, radius: 0.8 },
        Solid::Box { min: DVec3::splat(-0.6), max: DVec3::new(0.7, 0.5, 0.9) },
        Solid::Cylinder { from: DVec3::new(0.0, -2.0, 0.1), to: DVec3::new(0.2, 2.0, 0.0), radius: 0.4 },
        Solid::Cone { from: DVec3::ZERO, to: DVec3::new(0.0, -0.3, 1.5), radius_from: 0.7, radius_to: 0.1 },
        Solid::Torus { centre: DVec3::ZERO, axis: DVec3::new(0.3, 0.2, 1.0), radius: 0.8, tube: 0.3 },
        Solid::HalfSpace { point: DVec3::new(0.1, 0.0, 0.0), normal: DVec3::new(1.0, -1.0, 0.4), extent: 1.5 },
        Solid::Blend {
            balls: vec![
                Ball { centre: DVec3::ZERO, radius: 0.7 },
                Ball { centre: DVec3::new(0.9, 0.1, 0.2), radius: 0.4 },
            ],
            smoothness: 0.15,
        },
    ];
    for solid in solids {
        let leaves = [
            leaf(0, mesh(ball_mesh(2)), DAffine3::from_scale(DVec3::splat(1.1))),
            leaf(1, MeshShape::Solid(solid), at(0.2, -0.3, 0.1)),
        ];
        for camera in &cameras() {
            for expression in ["b", "a - b", "b - a", "a & b", "!b"] {
                check(&leaves, expression, camera);
            }
        }
    }
}

#[test]
fn coincident_faces_toggle_together_however_they_are_cut() {
    // Unit blocks beside each other, their common face tessellated in two ways; and one inside the other.
    let beside = [
        leaf(0, mesh(block([1, 1, 1])), at(-1.0, 0.0, 0.0)),
        leaf(1, mesh(block([3, 5, 2])), at(1.0, 0.0, 0.0)),
        leaf(
            2,
            mesh(block([2, 2, 4])),
            DAffine3::from_scale_rotation_translation(
                DVec3::new(1.0, 0.5, 0.5),
                DQuat::IDENTITY,
                DVec3::new(1.0, 0.5, 0.5),
            ),
        ),
        leaf(3, MeshShape::Solid(Solid::Box { min: DVec3::NEG_ONE, max: DVec3::ONE }), at(-1.0, 0.0, 0.0)),
        leaf(
            4,
            MeshShape::Solid(Solid::HalfSpace { point: DVec3::ZERO, normal: DVec3::X, extent: 9.0 }),
            at(0.0, 0.0, 0.0),
        ),
    ];
    // The last camera lies in the plane of a face: its triangles are seen edge on.
    let edge_on = look(DVec3::new(4.0, -5.0, 1.0), DVec3::new(0.0, 0.0, 1.0), Lens::FovY(50.0));
    for camera in [&look(DVec3::new(3.3, -5.1, 3.2), DVec3::ZERO, Lens::FovY(45.0)), &edge_on] {
        for expression in [
            "a | b",
            "a - b",
            "a & b",
            "b - c",
            "c - b",
            "b & c",
            "d - a",
            "a - d",
            "(a | b) & e",
            "(a | b) - e",
            "b & e",
        ] {
            check(&beside, expression, camera);
        }
    }
}

#[test]
fn many_coincident_copies_of_one_leaf_are_that_leaf() {
    const COPIES: u32 = 200;
    let ball = Arc::new(ball_mesh(1));
    let leaves: Vec<MeshLeaf> =
        (0..COPIES).map(|id| leaf(id, MeshShape::Mesh(ball.clone()), DAffine3::IDENTITY)).collect();
    let camera = look(FAR_EYE, DVec3::ZERO, Lens::FovY(40.0));
    let draw = |tree: &Tree| {
        let model = MeshModel::new(&leaves, tree).unwrap();
        LayerStack::collect(&MeshFrame::new(&model, camera.clone(), LayerLimit::All, 1)).tiles()[0].boundaries.clone()
    };
    let one = draw(&Tree::leaf(LeafId(0)));
    assert!(one.len() > 1000);
    let all = (1..COPIES).map(|id| Tree::leaf(LeafId(id)));
    let union = draw(&all.clone().fold(Tree::leaf(LeafId(0)), Tree::or));
    assert_eq!(union.len(), one.len());
    // The depth of shared planes is computed from another corner.
    let close = |a: f32, b: f32| (a - b).abs() <= 1e-6 * b;
    let same =
        |a: &Boundary, b: &Boundary| (a.leaf, a.body, a.facing, a.normal) == (b.leaf, b.body, b.facing, b.normal);
    assert!(union.iter().zip(&one).all(|(a, b)| same(a, b) && close(a.depth, b.depth)));
    assert!(draw(&all.fold(Tree::leaf(LeafId(0)), Tree::minus)).is_empty());
}

#[test]
fn sheets_show_and_never_cut() {
    let quad = TriMesh {
        positions: vec![
            DVec3::new(-1.5, -1.5, 0.1),
            DVec3::new(1.5, -1.5, 0.1),
            DVec3::new(1.5, 1.5, 0.1),
            DVec3::new(-1.5, 1.5, 0.1),
        ],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        colours: None,
    };
    let sheet = MeshLeaf { kind: LeafKind::Sheet, ..leaf(1, mesh(quad), DAffine3::IDENTITY) };
    let leaves = [leaf(0, mesh(ball_mesh(2)), DAffine3::IDENTITY), sheet];
    for expression in ["b", "a | b", "b - a", "a & b"] {
        assert!(check(&leaves, expression, &cameras()[0]) > 300, "{expression}");
    }
}

#[test]
fn a_scan_seen_from_within_a_hundredth_of_a_pixel_is_closed() {
    // So near that most vertices lie far outside of the grid.
    let leaves = [leaf(0, mesh(ball_mesh(3)), DAffine3::IDENTITY), leaf(1, mesh(block([4, 4, 4])), at(0.9, 0.9, 0.9))];
    for zoom in [10.0, 300.0, 20_000.0] {
        let far = look(FAR_EYE, DVec3::ZERO, Lens::FovY(40.0));
        let camera = far.zoomed(DVec3::new(0.53, -0.62, 0.51), zoom).unwrap();
        assert!(check(&leaves, "a - b", &camera) > 1000, "at {zoom}");
    }
}

#[test]
fn nearest_is_the_head_of_all_down_to_what_is_opaque() {
    let mut leaves =
        [leaf(0, mesh(ball_mesh(2)), DAffine3::IDENTITY), leaf(1, mesh(block([1, 1, 1])), at(1.1, 0.2, 0.0))];
    leaves[0].opacity = 0.5;
    let model = MeshModel::new(&leaves, &tree("a | b")).unwrap();
    let camera = look(DVec3::new(-4.0, -3.0, 2.0), DVec3::new(0.5, 0.0, 0.0), Lens::FovY(40.0));
    let stack = |limit| LayerStack::collect(&MeshFrame::new(&model, camera.clone(), limit, 1));
    let (all, nearest) = (stack(LayerLimit::All), stack(LayerLimit::Nearest));
    let mut lengths = [0; 4];
    for (x, y) in (0..70).flat_map(|y| (0..97).map(move |x| (x, y))) {
        let all = all.at(x, y);
        let end = all.iter().position(|b| b.opacity >= 1.0).map_or(all.len(), |opaque| opaque + 1);
        assert_eq!(nearest.at(x, y), &all[..end]);
        lengths[end.min(3)] += 1;
    }
    assert!(lengths.iter().all(|&pixels| pixels > 50), "{lengths:?}");
}

#[test]
fn samples_count_as_the_judge_counts_them() {
    let leaves = [leaf(0, mesh(ball_mesh(2)), DAffine3::IDENTITY), leaf(1, mesh(block([1, 1, 1])), at(1.1, 0.2, 0.0))];
    let camera = look(FAR_EYE, DVec3::ZERO, Lens::FovY(40.0));
    let model = MeshModel::new(&leaves, &tree("a - b")).unwrap();
    let truths = leaves.iter().map(truth).collect();
    for samples in [1, 4, 16] {
        let stack = LayerStack::collect(&MeshFrame::new(&model, camera.clone(), LayerLimit::Nearest, samples));
        let judge = Reference::new(Vec::clone(&truths), tree("a - b"), camera.clone(), samples, LayerLimit::Nearest);
        let judge = LayerStack::collect(&judge.unwrap());
        let counts = |stack: &LayerStack, x, y| -> [u32; 2] {
            std::array::from_fn(|leaf| {
                let of_leaf = stack.at(x, y).iter().filter(|b| b.leaf as usize == leaf);
                of_leaf.map(|b| b.samples.count_ones()).sum()
            })
        };
        let pixels = (0..70).flat_map(|y| (0..97).map(move |x| (x, y)));
        let differ = pixels.filter(|&(x, y)| counts(&stack, x, y) != counts(&judge, x, y)).count();
        // One sample in five hundred lies within the snapping distance of one of a few hundred edge pixels.
        assert!(differ <= 4, "{samples} samples: {differ} pixels differ");
    }
}

#[test]
fn any_rectangle_is_cut_from_the_whole() {
    let leaves = [leaf(0, mesh(ball_mesh(2)), DAffine3::IDENTITY), leaf(1, mesh(block([2, 1, 1])), at(0.8, 0.2, 0.0))];
    let model = MeshModel::new(&leaves, &tree("a - b")).unwrap();
    let camera = Camera::look_at(FAR_EYE, DVec3::ZERO, DVec3::Z, Lens::FovY(40.0), 201, 150).unwrap();
    let frame = MeshFrame::new(&model, camera, LayerLimit::All, 1);
    let stack = LayerStack::collect(&frame);
    for rect in [
        PixelRect { x0: 0, y0: 0, x1: 201, y1: 150 },
        PixelRect { x0: 37, y0: 61, x1: 171, y1: 131 },
        PixelRect { x0: 100, y0: 70, x1: 101, y1: 71 },
    ] {
        let part = frame.draw(rect);
        for (x, y) in (rect.y0..rect.y1).flat_map(|y| (rect.x0..rect.x1).map(move |x| (x, y))) {
            assert_eq!(part.at(x, y), stack.at(x, y));
        }
    }
}

#[test]
fn vertex_colours_are_mixed_as_the_judge_mixes_them() {
    let mut ball = ball_mesh(1);
    ball.colours = Some((0..ball.positions.len()).map(|i| [(i * 37 % 256) as u8, (i * 91 % 256) as u8, 40]).collect());
    let leaves = [MeshLeaf { vertex_colours: true, ..leaf(0, mesh(ball), DAffine3::IDENTITY) }];
    let camera = look(FAR_EYE, DVec3::ZERO, Lens::FovY(40.0));
    let model = MeshModel::new(&leaves, &tree("a")).unwrap();
    let stack = LayerStack::collect(&MeshFrame::new(&model, camera.clone(), LayerLimit::Nearest, 1));
    let judge = Reference::new(vec![truth(&leaves[0])], tree("a"), camera, 1, LayerLimit::Nearest).unwrap();
    for (x, y) in (25..45).flat_map(|y| (38..58).map(move |x| (x, y))) {
        let wanted = judge.cast(DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5));
        let found = stack.at(x, y);
        assert!((0..3).all(|k| (found[0].colour[k] - wanted[0].colour[k]).abs() < 2e-3), "at {x},{y}");
    }
}

#[test]
fn an_open_mesh_is_named_and_still_drawn_as_the_judge_draws_it() {
    let mut open = block([2, 2, 2]);
    open.triangles.truncate(open.triangles.len() - 8);
    let leaves = [leaf(0, mesh(open), DAffine3::IDENTITY), leaf(1, mesh(ball_mesh(2)), at(0.7, 0.7, 0.7))];
    let model = MeshModel::new(&leaves, &tree("a - b")).unwrap();
    assert_eq!(model.open_leaves().collect::<Vec<_>>(), [LeafId(0)]);
    for expression in ["a", "a - b", "b - a"] {
        assert!(check(&leaves, expression, &cameras()[0]) > 300, "{expression}");
    }
}

#[test]
fn unusable_leaves_are_refused_by_number() {
    let good = leaf(0, mesh(block([1, 1, 1])), DAffine3::IDENTITY);
    let new = |leaves: &[MeshLeaf], text| MeshModel::new(leaves, &tree(text)).map(|_| ());
    assert_eq!(new(std::slice::from_ref(&good), "a - b"), Err(MeshModelError::Missing(LeafId(1))));
    assert_eq!(new(&[good.clone(), good.clone()], "a"), Err(MeshModelError::Twice(LeafId(0))));
    let flat = MeshLeaf { world_from_leaf: DAffine3::from_scale(DVec3::new(1.0, 0.0, 1.0)), ..good.clone() };
    assert_eq!(new(&[flat], "a"), Err(MeshModelError::Transform(LeafId(0))));
    let mut broken = block([1, 1, 1]);
    broken.positions[3].x = f64::NAN;
    let found = new(&[leaf(0, mesh(broken), DAffine3::IDENTITY)], "a");
    assert!(matches!(found, Err(MeshModelError::Mesh { leaf: LeafId(0), .. })));
}

/// Many balls, and blocks on a lattice, so that faces coincide.
fn heap(rng: &mut Rng, count: u32) -> Vec<MeshLeaf> {
    let (ball, cube) = (mesh(ball_mesh(3)), mesh(block([2, 3, 1])));
    let one = |id: u32| {
        let is_ball = rng.below(2) == 0;
        let step = |rng: &mut Rng| rng.below(9) as f64 * 0.25 - 1.0;
        let place = DVec3::new(step(rng), step(rng), step(rng));
        let size = if is_ball { 0.3 + 0.1 * rng.below(8) as f64 } else { 0.25 * (1 + rng.below(3)) as f64 };
        let placed = DAffine3::from_translation(place) * DAffine3::from_scale(DVec3::splat(size));
        let colour = [id as f32 / count as f32, 0.5, 0.5];
        MeshLeaf { colour, ..leaf(id, if is_ball { ball.clone() } else { cube.clone() }, placed) }
    };
    (0..count).map(one).collect()
}

#[test]
fn looks_taken_early_and_the_short_cut_show_the_head_of_all() {
    let mut rng = Rng::new(20, 0);
    let mut covered_by_all = 0;
    // Few leaves, several words of them, and more words than lanes are made for.
    for count in [9, 48, 90, 300] {
        let leaves = heap(&mut rng, count);
        // (… | …) & (… | …) - (… & …), as the paper's gear.
        let join = |from: u32, to: u32, operator: fn(Tree, Tree) -> Tree| {
            (from..to).map(|id| Tree::leaf(LeafId(id))).reduce(operator).unwrap()
        };
        let (third, two) = (count / 3, 2 * count / 3);
        let both = Tree::and(join(0, third, Tree::or), join(third, two, Tree::or));
        let tree = Tree::minus(both, join(two, two + 2, Tree::and));
        let tree = Tree::minus(tree, join(two + 2, two + 2 + (count - two - 2).min(6), Tree::and));
        let model = MeshModel::new(&leaves, &tree).unwrap();
        let camera = Camera::look_at(FAR_EYE, DVec3::ZERO, DVec3::Z, Lens::FovY(30.0), 150, 130).unwrap();
        let frame = |limit| MeshFrame::new(&model, camera.clone(), limit, 1);
        let all = LayerStack::collect(&frame(LayerLimit::All));
        let nearest = frame(LayerLimit::Nearest);
        let mut covered = 0;
        let mut short = OpaqueTile::default();
        for rect in PixelRect::tiles(camera.width, camera.height, TILE_SIDE) {
            let tile = nearest.draw(rect);
            assert!(nearest.draw_opaque(rect, &mut short));
            for (x, y) in (rect.y0..rect.y1).flat_map(|y| (rect.x0..rect.x1).map(move |x| (x, y))) {
                let (head, found) = (&all.at(x, y)[..all.at(x, y).len().min(1)], tile.at(x, y));
                assert_eq!(found, head, "{count} leaves at {x},{y}");
                let seen = short.at(x, y);
                assert_eq!(seen.is_some(), !head.is_empty());
                let (Some(head), Some(seen)) = (head.first(), seen) else { continue };
                covered += 1;
                let normal = Vec3::from_array(seen.normal);
                assert!(normal == head.normal || normal == -head.normal);
                assert_eq!(seen.colour, head.colour);
            }
        }
        covered_by_all += covered;
        let look = Look { light: Light::default(), background: [0.2, 0.3, 0.4, 1.0] };
        let (lit, slow) = (shaded(&nearest, &look, &|| ()), shaded(&LayerStack::collect(&nearest), &look, &|| ()));
        assert_eq!((lit.covered, slow.covered), (covered, covered));
        let differ = |(a, b): (&[f32; 4], &[f32; 4])| a.iter().zip(b).any(|(a, b)| !((a - b).abs() < 1e-6));
        assert!(!lit.pixels.iter().zip(&slow.pixels).any(differ));
    }
    assert!(covered_by_all > 1000, "{covered_by_all} pixels are covered");
}

#[test]
fn there_is_no_short_cut_where_more_than_a_surface_shows() {
    let ball = leaf(0, mesh(ball_mesh(2)), DAffine3::IDENTITY);
    let cases = [
        (ball.clone(), LayerLimit::Nearest, 1, true),
        (ball.clone(), LayerLimit::All, 1, false),
        (ball.clone(), LayerLimit::Nearest, 4, false),
        (MeshLeaf { opacity: 0.5, ..ball.clone() }, LayerLimit::Nearest, 1, false),
        (MeshLeaf { kind: LeafKind::Sheet, ..ball }, LayerLimit::Nearest, 1, false),
    ];
    for (leaf, limit, samples, is_short) in cases {
        let model = MeshModel::new(&[leaf], &tree("a")).unwrap();
        let frame = MeshFrame::new(&model, look(FAR_EYE, DVec3::ZERO, Lens::FovY(40.0)), limit, samples);
        let rect = PixelRect { x0: 0, y0: 0, x1: 64, y1: 64 };
        assert_eq!(frame.draw_opaque(rect, &mut OpaqueTile::default()), is_short);
    }
}
