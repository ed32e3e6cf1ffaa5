// The twin of src/csg/paper.rs: clipping bottom up, with *unknown* that drops out. Whoever uses it defines
// `known_inside(leaf: u32, is_reversed: bool) -> u32`.

const FALSE: u32 = 0u;
const TRUE: u32 = 1u;
const UNKNOWN: u32 = 2u;

// By level of the tree: whether the left operand whose right one is being evaluated is known.
var<private> left_known: array<u32, STACK_WORDS>;

// The words of a node: see `paper_words` in src/gpu/splat/clip.rs.
fn paper_node(node: u32) -> u32 {
    return tables[view.clip + CLIP_PAPER] + node * NODE_STRIDE;
}

fn is_and(node: u32) -> bool {
    return tables[paper_node(node)] == NODE_AND;
}

fn parent_of(node: u32) -> u32 {
    return tables[paper_node(node) + 3u];
}

fn inside_tree(root: u32) -> u32 {
    var depth = 0u;
    // The subtree's leftmost literal.
    var node = tables[paper_node(root) + 4u];
    loop {
        let words = paper_node(node);
        let is_negated = tables[words + 2u] != 0u;
        var value = known_inside(tables[words + 1u], is_negated);
        if is_negated && value != UNKNOWN {
            value = 1u - value;
        }
        // Climb with the value, until an operator needs its right operand first.
        loop {
            if node == root {
                return value;
            }
            let parent = parent_of(node);
            let deciding = select(TRUE, FALSE, is_and(parent));
            if node + 1u == parent {
                // A right operand. The left one has not decided, so it is unknown, or the operator's neutral value.
                depth--;
                let is_known = ((left_known[depth / 32u] >> (depth % 32u)) & 1u) != 0u;
                if value == UNKNOWN {
                    value = select(UNKNOWN, 1u - deciding, is_known);
                }
            } else if value != deciding {
                let bit = 1u << (depth % 32u);
                left_known[depth / 32u] &= ~bit;
                if value != UNKNOWN {
                    left_known[depth / 32u] |= bit;
                }
                depth++;
                // The right operand's leftmost literal follows the left operand.
                node++;
                break;
            }
            node = parent;
        }
    }
    return UNKNOWN;
}

fn is_clipped(literal: u32) -> bool {
    var node = literal;
    loop {
        let parent = parent_of(node);
        if parent == node {
            return false;
        }
        let words = paper_node(parent);
        let sibling = select(tables[words + 1u], tables[words + 2u], tables[words + 1u] == node);
        let inside = inside_tree(sibling);
        if inside != UNKNOWN && (inside == TRUE) != is_and(parent) {
            return true;
        }
        node = parent;
    }
    return false;
}
