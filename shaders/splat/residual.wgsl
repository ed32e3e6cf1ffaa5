// The twin of src/csg/residual.rs and src/csg/blist.rs: what the expression says at one hit. Whoever uses it defines
// `side(leaf: u32) -> bool`, whether the hit is inside of another leaf, and `own_leaf`, `own_index`, whose hit it is; where that is no
// leaf, `is_inside_at_peel(leaf: u32) -> bool` tells where a peel of crossings lies.

// How the result changes where the leaf is entered.
const NO_CROSSING: u32 = 0u;
const RISES: u32 = KIND_RISES;
const FALLS: u32 = KIND_FALLS;

// Truth tables, halved leaf by leaf; where both halves agree, the leaf does not matter here.
fn crossing_by_table(near: u32, count: u32, at: u32) -> u32 {
    var rises = vec2<u32>(tables[at], tables[at + 1u]);
    var falls = vec2<u32>(tables[at + 2u], tables[at + 3u]);
    for (var i = count; i > 0u; i--) {
        let half = 1u << (i - 1u);
        var inner = vec2<u32>(rises.y, falls.y);
        var outer = vec2<u32>(rises.x, falls.x);
        if half < 32u {
            let low = (1u << half) - 1u;
            inner = (outer >> vec2<u32>(half)) & vec2<u32>(low);
            outer &= vec2<u32>(low);
        }
        if any(inner != outer) && side(tables[near + i - 1u]) {
            outer = inner;
        }
        rises.x = outer.x;
        falls.x = outer.y;
    }
    if rises.x != 0u {
        return RISES;
    }
    return select(NO_CROSSING, FALLS, falls.x != 0u);
}

fn is_entry(jump: u32) -> bool {
    return jump != JUMP_IN && jump != JUMP_OUT;
}

// Two walks, outside and inside of the own leaf; the one that is behind moves, or both where they meet.
fn crossing_by_walk(at: u32) -> u32 {
    let last_own = tables[at];
    let list = at + 1u;
    var outside = 0u;
    var inside = 0u;
    while is_entry(outside) || is_entry(inside) {
        if outside == inside && outside > last_own {
            return NO_CROSSING;
        }
        // Jumps to the result are greater than any entry.
        let entry = min(outside, inside);
        let words = list + entry * ENTRY_STRIDE;
        let leaf = tables[words];
        var is_in = false;
        var is_in_too = true;
        if leaf != OWN_LEAF {
            is_in = side(leaf);
            is_in_too = is_in;
        }
        if outside == entry {
            outside = tables[words + select(3u, 2u, is_in)];
        }
        if inside == entry {
            inside = tables[words + select(3u, 2u, is_in_too)];
        }
    }
    if outside == inside {
        return NO_CROSSING;
    }
    return select(FALLS, RISES, inside == JUMP_IN);
}

// Of the residual whose words begin at `at`.
fn crossing_of(at: u32) -> u32 {
    let count = tables[at];
    let rule = at + 1u + count;
    if tables[rule] == 0u {
        return crossing_by_table(at + 1u, count, rule + 1u);
    }
    return crossing_by_walk(rule + 1u);
}

// How the hit's surfel lies to another leaf, as classification decided it.
fn status_to(leaf: u32) -> u32 {
    var status = tables[tables[AT_PAIRS] + own_leaf * view.leaves + leaf];
    if status >= FIRST_PART {
        status = tables[status - FIRST_PART + own_index / CHUNK];
    }
    if status >= FIRST_PART {
        let bit = own_index % CHUNK * STATUS_BITS;
        status = (tables[status - FIRST_PART + bit / 32u] >> (bit % 32u)) & ((1u << STATUS_BITS) - 1u);
    }
    return status;
}

// Leaves that were taken away.
var<private> gone: array<u32, LEAF_WORDS>;

fn is_gone(leaf: u32) -> bool {
    return ((gone[leaf / LEAF_BITS] >> (leaf % LEAF_BITS)) & 1u) != 0u;
}

fn is_inside(leaf: u32) -> bool {
    if own_leaf == NONE {
        return is_inside_at_peel(leaf);
    }
    if leaf == own_leaf {
        return false;
    }
    let status = status_to(leaf);
    if status == STATUS_NEAR {
        return side(leaf);
    }
    return status == STATUS_IN;
}

// Whether the result just outside of the own leaf holds where `without`, and what is gone, is taken away; complemented
// occurrences stay.
fn holds_without(without: u32) -> bool {
    var entry = 0u;
    while is_entry(entry) {
        let words = tables[AT_LIST] + entry * ENTRY_STRIDE;
        let leaf = tables[words];
        let stays = tables[words + 1u] != 0u || !(leaf == without || is_gone(leaf));
        entry = tables[words + select(3u, 2u, stays && is_inside(leaf))];
    }
    return entry == JUMP_IN;
}

fn may_hold(leaf: u32) -> bool {
    if own_leaf == NONE {
        return is_inside_at_peel(leaf);
    }
    return leaf != own_leaf && status_to(leaf) != STATUS_OUT;
}

// The leaf whose material lies behind the hit where the own leaf was subtracted: the twin of src/splat/body.rs.
fn body_of() -> u32 {
    let count = tables[POSITIVE_COUNT];
    let leaves = tables[AT_POSITIVE];
    for (var word = 0u; word < LEAF_WORDS; word++) {
        gone[word] = 0u;
    }
    for (var i = 0u; i < count; i++) {
        let leaf = tables[leaves + i];
        if may_hold(leaf) && !holds_without(leaf) {
            return leaf;
        }
    }
    for (var i = count; i > 0u; i--) {
        let leaf = tables[leaves + i - 1u];
        if may_hold(leaf) && holds_without(leaf) {
            gone[leaf / LEAF_BITS] |= 1u << (leaf % LEAF_BITS);
        }
    }
    for (var i = 0u; i < count; i++) {
        let leaf = tables[leaves + i];
        if may_hold(leaf) && !is_gone(leaf) {
            return leaf;
        }
    }
    return own_leaf;
}
