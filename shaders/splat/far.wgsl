// The twin of src/geometry/winding.rs and of the nearest surfel's plane in src/classify/field.rs: the side of a point that no
// surfel of a leaf reaches.

// Trees and elements: see src/gpu/splat/far.rs.
@group(0) @binding(6) var<storage, read> far: array<vec4<f32>>;
// The expression: see src/gpu/splat/tables.rs.
@group(0) @binding(7) var<storage, read> tables: array<u32>;

const TAU_TWICE: f32 = 12.566370614359172;

// What tells a leaf's far sides.
struct FarLeaf {
    nodes: u32,
    runs: u32,
    elements: u32,
    count: u32,
    threshold: f32,
}

fn winding_number(leaf: FarLeaf, p: vec3<f32>) -> f32 {
    var sum = 0.0;
    // Each level of the tree leaves at most one node waiting.
    var stack: array<u32, TREE_DEPTH>;
    stack[0] = 1u;
    var waiting = 1u;
    while waiting > 0u {
        waiting -= 1u;
        let node = stack[waiting];
        let ball = far[leaf.nodes + node * ROWS_A_CLUSTER];
        let aside = ball.xyz - p;
        let distance = length(aside);
        if distance > FAR_IN_RADII * ball.w && distance > 0.0 {
            sum += dot(far[leaf.nodes + node * ROWS_A_CLUSTER + 1u].xyz, aside) / (distance * distance * distance);
        } else if node >= leaf.runs {
            let first = (node - leaf.runs) * RUN_OF_ELEMENTS;
            for (var i = first; i < min(first + RUN_OF_ELEMENTS, leaf.count); i++) {
                let to = far[leaf.elements + i * ROWS_AN_ELEMENT].xyz - p;
                let squared = dot(to, to);
                if squared > 0.0 {
                    sum += dot(far[leaf.elements + i * ROWS_AN_ELEMENT + 1u].xyz, to) / (squared * sqrt(squared));
                }
            }
        } else {
            stack[waiting] = 2u * node;
            stack[waiting + 1u] = 2u * node + 1u;
            waiting += 2u;
        }
    }
    return sum / TAU_TWICE;
}

fn gap(leaf: FarLeaf, node: u32, p: vec3<f32>) -> f32 {
    let ball = far[leaf.nodes + node];
    return select(distance(ball.xyz, p) - ball.w, FARTHEST, ball.w < 0.0);
}

// Whether the point is behind the plane of the surfel whose centre is nearest.
fn behind_nearest(leaf: FarLeaf, p: vec3<f32>) -> bool {
    var best = FARTHEST;
    var nearest = NONE;
    var stack: array<u32, TREE_DEPTH>;
    stack[0] = 1u;
    var waiting = 1u;
    while waiting > 0u {
        waiting -= 1u;
        let node = stack[waiting];
        let least = gap(leaf, node, p);
        if !(least <= best && least < FARTHEST) {
            continue;
        }
        if node >= leaf.runs {
            let first = (node - leaf.runs) * RUN_OF_ELEMENTS;
            for (var i = first; i < min(first + RUN_OF_ELEMENTS, leaf.count); i++) {
                let d = distance(far[leaf.elements + i * ROWS_AN_ELEMENT].xyz, p);
                // Of equally near ones the first.
                if d < best || (d == best && i < nearest) {
                    best = d;
                    nearest = i;
                }
            }
            continue;
        }
        let second_is_nearer = gap(leaf, 2u * node + 1u, p) < gap(leaf, 2u * node, p);
        stack[waiting] = 2u * node + select(1u, 0u, second_is_nearer);
        stack[waiting + 1u] = 2u * node + select(0u, 1u, second_is_nearer);
        waiting += 2u;
    }
    if nearest == NONE {
        return false;
    }
    let e = p - far[leaf.elements + nearest * ROWS_AN_ELEMENT].xyz;
    return dot(e, far[leaf.elements + nearest * ROWS_AN_ELEMENT + 1u].xyz) < 0.0;
}

// Whether the point, relative to the origin of what is far, is inside of a leaf that none of whose surfels reaches it.
fn far_inside(leaf: u32, p: vec3<f32>) -> bool {
    let at = tables[AT_LEAVES] + leaf * LEAF_STRIDE;
    let far_leaf =
        FarLeaf(tables[at + 2u], tables[at + 3u], tables[at + 4u], tables[at + 5u], bitcast<f32>(tables[at + 6u]));
    switch tables[at + 1u] {
        case FAR_WINDING: {
            return winding_number(far_leaf, p) > far_leaf.threshold;
        }
        case FAR_PLANE: {
            return behind_nearest(far_leaf, p);
        }
        default: {
            return false;
        }
    }
}
