// The twin of src/splat/crossed.rs: leaves that are not made of surfels, by the crossings of a pixel's ray.
//
// A kernel has eight storage buffers, so crossings share one with `starts`: from `view.crossings` on their offsets by pixel, the leaves
// that rays begin inside of, and the crossings. See src/gpu/splat/crossed.rs.

// Memberships of the leaves that crossings tell of, before a peel and behind it.
var<private> before: array<u32, LEAF_WORDS>;
var<private> behind: array<u32, LEAF_WORDS>;
// Which of the two is asked.
var<private> asks_behind: bool;
// The first leaf of surfels whose side of the peel was asked for and is not known yet.
var<private> missing: u32;
// Whether the point is a peel, whose crossings tell of their leaves; else it is where hits coincide, and all sides are asked.
var<private> is_peel: bool;
// The result before the point and behind it, and what it comes to: the crossing (or hit) that owns the boundary, NONE without one;
// whose material lies behind; whether the result begins.
var<private> peel_was: bool;
var<private> peel_is: bool;
var<private> peel_owner: u32;
var<private> peel_body: u32;
var<private> peel_enters: bool;

// Whether crossings tell of a leaf.
fn is_crossed(leaf: u32) -> bool {
    return (tables[tables[AT_LEAVES] + leaf * LEAF_STRIDE] & LEAF_EXACT) != 0u;
}

// The crossings of a pixel: the first, and the one past the last.
fn crossings_of(pixel: u32) -> vec2<u32> {
    if view.crossings == 0u {
        return vec2<u32>();
    }
    return vec2<u32>(starts[view.crossings + pixel], starts[view.crossings + pixel + 1u]);
}

fn crossing_word(crossing: u32, word: u32) -> u32 {
    return starts[view.first_crossing + crossing * CROSSING_WORDS + word];
}

fn crossing_leaf(crossing: u32) -> u32 {
    return crossing_word(crossing, CROSSING_LEAF);
}

fn crossing_depth(crossing: u32) -> f32 {
    return bitcast<f32>(crossing_word(crossing, CROSSING_DEPTH));
}

// Three words of a crossing.
fn crossing_vector(crossing: u32, word: u32) -> vec3<f32> {
    return bitcast<vec3<f32>>(vec3<u32>(
        crossing_word(crossing, word), crossing_word(crossing, word + 1u), crossing_word(crossing, word + 2u),
    ));
}

// A vector of world axes in those of the view.
fn to_view(v: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(dot(view.axes[0].xyz, v), dot(view.axes[1].xyz, v), dot(view.axes[2].xyz, v));
}

fn has_flag(crossing: u32, flag: u32) -> bool {
    return (crossing_word(crossing, CROSSING_FLAGS) & flag) != 0u;
}

// A depth less the ray's anchor.
fn from_anchor(ray: Ray, depth: f32) -> f32 {
    return (depth - ray.anchor.x) - ray.anchor.y;
}

// The leaves that a pixel's ray begins inside of: one word of them.
fn begins_word(pixel: u32, word: u32) -> u32 {
    if view.crossings == 0u || word >= view.begins_words {
        return 0u;
    }
    return starts[view.begins + pixel * view.begins_words + word];
}

// Whether the ray of a pixel is inside of a leaf at depth `t`: by the last crossing before it.
fn side_by_crossings(ray: Ray, pixel: u32, leaf: u32, t: f32) -> bool {
    var inside = ((begins_word(pixel, leaf / LEAF_BITS) >> (leaf % LEAF_BITS)) & 1u) != 0u;
    let all = crossings_of(pixel);
    for (var i = all.x; i < all.y; i++) {
        if !(from_anchor(ray, crossing_depth(i)) < t) {
            break;
        }
        if crossing_leaf(i) == leaf {
            inside = has_flag(i, CROSSING_ENTERS);
        }
    }
    return inside;
}

fn is_in_before(leaf: u32) -> bool {
    return ((before[leaf / LEAF_BITS] >> (leaf % LEAF_BITS)) & 1u) != 0u;
}

fn is_in_behind(leaf: u32) -> bool {
    return ((behind[leaf / LEAF_BITS] >> (leaf % LEAF_BITS)) & 1u) != 0u;
}

// Whether a point just before or just behind the peel is inside of a leaf. What has to be asked is not looked for here but noted as
// missing, so that this, which is asked from many places, stays small: compilers put it into each of them.
fn is_inside_at_peel(leaf: u32) -> bool {
    if is_peel && is_crossed(leaf) {
        if asks_behind {
            return is_in_behind(leaf);
        }
        return is_in_before(leaf);
    }
    if !is_known(leaf) {
        missing = select(missing, leaf, missing == NONE);
    }
    return known_side(leaf, asks_behind);
}

// Whether what the scans say may matter to the peel: whether two walks through the list, before and behind it, that take every way
// which a scan may send them can part. They can at an entry that both reach and whose leaf toggles.
fn may_differ() -> bool {
    // A bit for each entry. Jumps lead forward.
    var reached: array<u32, LIST_WORDS>;
    reached[0] = 1u;
    for (var entry = 0u; entry < tables[LIST_LENGTH]; entry++) {
        if ((reached[entry / 32u] >> (entry % 32u)) & 1u) == 0u {
            continue;
        }
        let words = tables[AT_LIST] + entry * ENTRY_STRIDE;
        let leaf = tables[words];
        var takes = vec2<bool>(true);
        if is_crossed(leaf) {
            if is_in_before(leaf) != is_in_behind(leaf) {
                return true;
            }
            takes = vec2<bool>(is_in_before(leaf), !is_in_before(leaf));
        }
        for (var way = 0u; way < 2u; way++) {
            let jump = tables[words + 2u + way];
            if takes[way] && is_entry(jump) {
                reached[jump / 32u] |= 1u << (jump % 32u);
            }
        }
    }
    return false;
}

// The result before or behind the peel, where one leaf is turned over; NONE turns none.
fn holds_at_peel(is_behind: bool, turned: u32) -> bool {
    asks_behind = is_behind;
    var entry = 0u;
    while is_entry(entry) {
        let words = tables[AT_LIST] + entry * ENTRY_STRIDE;
        let leaf = tables[words];
        let inside = is_inside_at_peel(leaf) != (leaf == turned);
        entry = tables[words + select(3u, 2u, inside)];
    }
    return entry == JUMP_IN;
}

// Whether the point before the peel and that behind it are on different sides of a leaf.
fn turns_at_peel(leaf: u32) -> bool {
    asks_behind = false;
    let was = is_inside_at_peel(leaf);
    asks_behind = true;
    return is_inside_at_peel(leaf) != was;
}

// From here on ranks are of leaves that do not matter, and from there on of none.
const NOT_MATTERING: u32 = 2u;
const WORST_RANK: u32 = 4u;

// Where the result changes, the least rank owns the boundary: a leaf that matters, then one that goes the result's way.
fn rank_at_peel(leaf: u32, is_alone: bool) -> u32 {
    var matters = is_alone;
    if !matters {
        matters = holds_at_peel(false, leaf) == peel_is || holds_at_peel(true, leaf) != peel_is;
    }
    asks_behind = true;
    return select(NOT_MATTERING, 0u, matters) + select(1u, 0u, is_inside_at_peel(leaf) == peel_is);
}

// Where it does not, whether a sheet shows: the result would have it if it were a solid, and does not otherwise.
fn shows_at_peel(leaf: u32) -> bool {
    return (!peel_was && holds_at_peel(false, leaf)) || (!peel_is && holds_at_peel(true, leaf));
}

// Finds the result before the peel and behind it.
fn begin_decision() {
    missing = NONE;
    peel_was = holds_at_peel(false, NONE);
    peel_is = holds_at_peel(true, NONE);
    peel_enters = peel_is || peel_was == peel_is;
    peel_owner = NONE;
}

// Finds whose material lies behind the boundary that `leaf` owns.
fn find_peel_body(leaf: u32) {
    peel_body = leaf;
    asks_behind = true;
    if peel_was != peel_is && is_inside_at_peel(leaf) != peel_is {
        asks_behind = peel_is;
        let body = body_of();
        peel_body = select(body, leaf, body == NONE);
    }
}

// Decides the peel of the crossings `first` to `end` as far as sides are known; where one is `missing` it has to be decided again.
fn decide_peel(first: u32, end: u32) {
    begin_decision();
    var least = WORST_RANK;
    for (var i = first; i < end; i++) {
        let leaf = crossing_leaf(i);
        var rank = WORST_RANK;
        if peel_was != peel_is {
            if turns_at_peel(leaf) {
                rank = rank_at_peel(leaf, end - first == 1u);
            }
        } else if is_sheet(leaf) && shows_at_peel(leaf) {
            rank = 0u;
        }
        // Of equal rank the least leaf.
        if rank < least || (rank == least && rank < WORST_RANK && leaf < crossing_leaf(peel_owner)) {
            least = rank;
            peel_owner = i;
        }
    }
    if peel_owner != NONE {
        find_peel_body(crossing_leaf(peel_owner));
    }
}

// The first leaf of the block's surfels that was not asked; NONE without one.
fn unknown_leaf() -> u32 {
    for (var list = 0u; list < LISTS; list++) {
        var i = list_first[list];
        while i < list_end[list] {
            let leaf = leaf_at(i);
            if !is_known(leaf) {
                return leaf;
            }
            i = leaf_begins(leaf + 1u, i, list_end[list]);
        }
    }
    return NONE;
}

// Adds the crossings of a peel with whose surfaces those of scans coincide, undecided.
fn tie_peel(ray: Ray, pixel: u32, first: u32, end: u32) {
    for (var i = first; i < end; i++) {
        var hit: Hit;
        hit.t = hit_t;
        hit.leaf = crossing_leaf(i);
        let enters = has_flag(i, CROSSING_ENTERS);
        let normal = to_view(crossing_vector(i, CROSSING_NORMAL));
        // Rays enter against the outward normal.
        hit.normal = select(-normal, normal, (dot(normal, ray.dir) < 0.0) == enters);
        hit.colour = crossing_vector(i, CROSSING_COLOUR);
        hit.opacity = bitcast<f32>(crossing_word(i, CROSSING_OPACITY));
        insert(pixel, as_tied(hit, tied_radius, enters, has_flag(i, CROSSING_SHOWS)));
    }
}

// Adds the boundary at a peel, where it is one; returns the depth from which on nothing is seen.
fn resolve_peel(ray: Ray, pixel: u32, first: u32, end: u32) -> f32 {
    // Scans are asked at the peel's depth. `own_leaf` is none, so that the body is that of the peel.
    hit_ray = ray;
    hit_t = from_anchor(ray, crossing_depth(first));
    hit_normal = to_view(crossing_vector(first, CROSSING_NORMAL));
    hit_radius = FARTHEST;
    own_leaf = NONE;
    forget_sides();
    asks_ties_only = false;
    loop {
        var asked_now = NONE;
        if !asks_ties_only {
            decide_peel(first, end);
            asked_now = missing;
        }
        if asked_now == NONE {
            if peel_owner == NONE && !is_tied {
                break;
            }
            // A scan whose side does not matter may coincide with the boundary: its own hit must not be another one.
            asks_ties_only = true;
            asked_now = unknown_leaf();
        }
        if asked_now == NONE {
            break;
        }
        // Each turn asks another leaf.
        side(asked_now);
    }
    asks_ties_only = false;
    if is_tied {
        tie_peel(ray, pixel, first, end);
        return FARTHEST;
    }
    if peel_owner == NONE || !has_flag(peel_owner, CROSSING_SHOWS) {
        return FARTHEST;
    }
    var hit: Hit;
    hit.t = hit_t;
    hit.leaf = crossing_leaf(peel_owner);
    hit.body = peel_body;
    // Outward from the result: against the ray where it is entered, along it where it is left.
    let normal = to_view(crossing_vector(peel_owner, CROSSING_NORMAL));
    hit.normal = select(normal, -normal, (dot(normal, ray.dir) > 0.0) == peel_enters);
    hit.colour = crossing_vector(peel_owner, CROSSING_COLOUR);
    hit.opacity = bitcast<f32>(crossing_word(peel_owner, CROSSING_OPACITY));
    hit.seen = select(-1, 1, peel_enters) * i32(view.samples);
    insert(pixel, hit);
    return select(FARTHEST, hit.t, view.nearest_only != 0u && hit.opacity >= 1.0);
}

// From which depth on the hits that surfels have hide the rest.
fn hidden_by_hits(pixel: u32) -> f32 {
    var hit = atomicLoad(&pixels[FIRST_PIXEL + pixel]);
    while view.nearest_only != 0u && hit != NONE {
        // What is not decided hides nothing yet.
        if hits[hit].opacity >= 1.0 && !tied_flag(hit, TIED) {
            return hits[hit].t;
        }
        hit = hits[hit].next;
    }
    return FARTHEST;
}

// Adds what a pixel's ray sees of the leaves that crossings tell of, once `trace` has added the surfels' hits.
@compute @workgroup_size(WORKGROUP)
fn trace_crossed(thread: Thread) {
    let block = group_number(thread);
    let px = pixel_of(block, thread.local);
    if !is_drawn(block, px) {
        return;
    }
    let pixel = number_of(px);
    let all = crossings_of(pixel);
    if all.x == all.y {
        return;
    }
    newest = NONE;
    is_peel = true;
    let ray = ray_of(block, px);
    for (var word = 0u; word < LEAF_WORDS; word++) {
        behind[word] = begins_word(pixel, word);
    }
    var hidden_from = hidden_by_hits(pixel);
    var next = all.x;
    while next < all.y {
        let first = next;
        let depth = crossing_depth(first);
        if !(from_anchor(ray, depth) < hidden_from) {
            break;
        }
        before = behind;
        var has_sheet = false;
        // The first is a member whatever its depth, so that fewer are left.
        while next < all.y && (next == first || crossing_depth(next) == depth) {
            let leaf = crossing_leaf(next);
            if is_sheet(leaf) {
                has_sheet = true;
            } else {
                let bit = 1u << (leaf % LEAF_BITS);
                let enters = has_flag(next, CROSSING_ENTERS);
                behind[leaf / LEAF_BITS] =
                    select(behind[leaf / LEAF_BITS] & ~bit, behind[leaf / LEAF_BITS] | bit, enters);
            }
            next++;
        }
        if has_sheet || may_differ() {
            hidden_from = min(hidden_from, resolve_peel(ray, pixel, first, next));
        }
    }
    check_loops();
}
