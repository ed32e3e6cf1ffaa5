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
// What the peel comes to: the crossing that owns the boundary, NONE without one; whose material lies behind; whether the result begins.
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

// Whether a point just before or just behind the peel is inside of a leaf. What surfels say is not looked for here but noted as
// missing, so that this, which is asked from many places, stays small: compilers put it into each of them.
fn is_inside_at_peel(leaf: u32) -> bool {
    if !is_crossed(leaf) {
        let bit = 1u << (leaf % LEAF_BITS);
        if (asked[leaf / LEAF_BITS] & bit) == 0u {
            missing = select(missing, leaf, missing == NONE);
        }
        return (answers[leaf / LEAF_BITS] & bit) != 0u;
    }
    if asks_behind {
        return is_in_behind(leaf);
    }
    return is_in_before(leaf);
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

// The crossing that owns the boundary at the peel `first` to `end`, where the result becomes `is`: one whose leaf matters, then one that
// goes the result's way, then the least leaf.
fn owner_of_peel(first: u32, end: u32, is: bool) -> u32 {
    var owner = NONE;
    var least = 4u;
    for (var i = first; i < end; i++) {
        let leaf = crossing_leaf(i);
        if is_in_before(leaf) == is_in_behind(leaf) {
            continue;
        }
        let matters = end - first == 1u || holds_at_peel(false, leaf) == is || holds_at_peel(true, leaf) != is;
        let rank = select(2u, 0u, matters) + select(1u, 0u, is_in_behind(leaf) == is);
        if rank < least || (rank == least && leaf < crossing_leaf(owner)) {
            least = rank;
            owner = i;
        }
    }
    return owner;
}

// The first sheet of the peel that shows: the result would have it if it were a solid, and does not otherwise.
fn sheet_of_peel(first: u32, end: u32, was: bool, is: bool) -> u32 {
    var owner = NONE;
    for (var i = first; i < end; i++) {
        let leaf = crossing_leaf(i);
        if is_sheet(leaf) && (owner == NONE || leaf < crossing_leaf(owner))
            && ((!was && holds_at_peel(false, leaf)) || (!is && holds_at_peel(true, leaf))) {
            owner = i;
        }
    }
    return owner;
}

// Decides the peel as far as sides are known; where one is `missing` it has to be decided again.
fn decide_peel(first: u32, end: u32, has_sheet: bool) {
    missing = NONE;
    let was = holds_at_peel(false, NONE);
    let is = holds_at_peel(true, NONE);
    peel_owner = NONE;
    peel_enters = is || was == is;
    if was != is {
        peel_owner = owner_of_peel(first, end, is);
    } else if has_sheet {
        peel_owner = sheet_of_peel(first, end, was, is);
    }
    if peel_owner == NONE {
        return;
    }
    peel_body = crossing_leaf(peel_owner);
    if was != is && is_in_behind(peel_body) != is {
        asks_behind = is;
        let body = body_of();
        peel_body = select(body, peel_body, body == NONE);
    }
}

// Adds the boundary at a peel, where it is one; returns the depth from which on nothing is seen.
fn resolve_peel(ray: Ray, pixel: u32, first: u32, end: u32, has_sheet: bool) -> f32 {
    // Scans are asked at the peel's depth. `own_leaf` is none, so that the body is that of the peel.
    hit_ray = ray;
    hit_t = from_anchor(ray, crossing_depth(first));
    own_leaf = NONE;
    forget_sides();
    loop {
        decide_peel(first, end, has_sheet);
        if missing == NONE {
            break;
        }
        // Each turn asks another leaf.
        side(missing);
    }
    if peel_owner == NONE || !has_flag(peel_owner, CROSSING_SHOWS) {
        return FARTHEST;
    }
    var hit: Hit;
    hit.t = hit_t;
    hit.leaf = crossing_leaf(peel_owner);
    hit.body = peel_body;
    // Outward from the result: against the ray where it is entered, along it where it is left.
    let in_world = crossing_vector(peel_owner, CROSSING_NORMAL);
    let normal =
        vec3<f32>(dot(view.axes[0].xyz, in_world), dot(view.axes[1].xyz, in_world), dot(view.axes[2].xyz, in_world));
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
        if hits[hit].opacity >= 1.0 {
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
            hidden_from = min(hidden_from, resolve_peel(ray, pixel, first, next, has_sheet));
        }
    }
    check_loops();
}
