// What all rays of a block share, and the sides of other leaves at a hit: the twin of src/splat/sides.rs. A workgroup
// is a block, a thread a pixel.

// The hit that the expression is asked about.
var<private> hit_ray: Ray;
var<private> hit_t: f32;
var<private> hit_pixel: u32;
// Its unit normal, view axes, and the radius of its surfel; `FARTHEST` where it has none.
var<private> hit_normal: vec3<f32>;
var<private> hit_radius: f32;
var<private> own_leaf: u32;
var<private> own_index: u32;
// The block's lists.
var<private> list_first: array<u32, LISTS>;
var<private> list_end: array<u32, LISTS>;
// What is known of the hit: a bit for each leaf that was asked, and its answer, that before the hit where its surface is there too.
var<private> asked: array<u32, LEAF_WORDS>;
var<private> answers: array<u32, LEAF_WORDS>;
// The leaves whose surfaces coincide with that of the hit: behind it the answer is the other one. Whether there are any, and the
// largest radius that any of their surfels has.
var<private> turns: array<u32, LEAF_WORDS>;
var<private> is_tied: bool;
var<private> tied_radius: f32;
// Whether the sides of leaves whose surfaces are not there do not matter any more.
var<private> asks_ties_only: bool;

fn leaf_at(i: u32) -> u32 {
    return views[members[i]].owner >> OWNER_SHIFT;
}

// The first place between `first` and `end` whose surfel is of `leaf` or a later one.
fn leaf_begins(leaf: u32, first: u32, end: u32) -> u32 {
    var low = first;
    var high = end;
    while low < high {
        let middle = low + (high - low) / 2u;
        if leaf_at(middle) < leaf {
            low = middle + 1u;
        } else {
            high = middle;
        }
    }
    return low;
}

fn run_of(leaf: u32) -> Run {
    var run: Run;
    run.leaf = leaf;
    for (var list = 0u; list < LISTS; list++) {
        run.first[list] = leaf_begins(leaf, list_first[list], list_end[list]);
        run.end[list] = leaf_begins(leaf + 1u, run.first[list], list_end[list]);
    }
    return run;
}

// A point of a ray relative to the origin of what is far, world axes.
fn point_at(ray: Ray, t: f32) -> vec3<f32> {
    let depth = ray.anchor.x + (ray.anchor.y + t);
    var p = ray.dir * depth;
    if view.is_perspective == 0u {
        p += vec3<f32>((ray.px - view.half_size) / view.focal_px, 0.0);
    }
    return view.eye + view.axes[0].xyz * p.x + view.axes[1].xyz * p.y + view.axes[2].xyz * p.z;
}

fn is_sheet(leaf: u32) -> bool {
    return (tables[tables[AT_LEAVES] + leaf * LEAF_STRIDE] & LEAF_SHEET) != 0u;
}

// Before another hit is asked about.
fn forget_sides() {
    for (var word = 0u; word < LEAF_WORDS; word++) {
        asked[word] = 0u;
        answers[word] = 0u;
        turns[word] = 0u;
    }
    is_tied = false;
    tied_radius = 0.0;
}

fn is_known(leaf: u32) -> bool {
    return ((asked[leaf / LEAF_BITS] >> (leaf % LEAF_BITS)) & 1u) != 0u;
}

// The side of a known leaf before the hit or behind it.
fn known_side(leaf: u32, is_behind: bool) -> bool {
    let word = select(answers[leaf / LEAF_BITS], answers[leaf / LEAF_BITS] ^ turns[leaf / LEAF_BITS], is_behind);
    return ((word >> (leaf % LEAF_BITS)) & 1u) != 0u;
}

fn with_bit(word: u32, leaf: u32, is_set: bool) -> u32 {
    let bit = 1u << (leaf % LEAF_BITS);
    return select(word & ~bit, word | bit, is_set);
}

// Notes a leaf's side before the hit and behind it.
fn note(leaf: u32, was_inside: bool, is_inside: bool) {
    let word = leaf / LEAF_BITS;
    asked[word] = with_bit(asked[word], leaf, true);
    answers[word] = with_bit(answers[word], leaf, was_inside);
    turns[word] = with_bit(turns[word], leaf, was_inside != is_inside);
}

// Notes that a leaf's surface coincides with that of the hit, and whether the ray enters the leaf there.
fn note_tie(leaf: u32, enters: bool) {
    note(leaf, !enters, enters);
    is_tied = true;
    tied_radius = max(tied_radius, bitcast<f32>(tables[tables[AT_LEAVES] + leaf * LEAF_STRIDE + LEAF_RADIUS]));
}

// Whether the hit is inside of another leaf, by the leaf's field.
fn side_by_field(leaf: u32) -> bool {
    if is_known(leaf) {
        return known_side(leaf, false);
    }
    var inside = false;
    if !is_sheet(leaf) {
        let field = field_at(hit_ray, run_of(leaf), hit_t);
        if !(field.weight > LEAST_WEIGHT) {
            if !asks_ties_only {
                inside = far_inside(leaf, point_at(hit_ray, hit_t));
            }
        } else if coincides(field) {
            note_tie(leaf, dot(field.normal, hit_ray.dir) < 0.0);
            return known_side(leaf, false);
        } else {
            inside = field.value < 0.0;
        }
    }
    note(leaf, inside, inside);
    return inside;
}

// The depth that those of a block are relative to: its first surfel's.
fn anchor_of(block: u32) -> vec2<f32> {
    let first = starts[block * LISTS];
    return select(vec2<f32>(), views[members[first]].depth, first < starts[(block + 1u) * LISTS]);
}

// The column and row of a thread's pixel.
fn pixel_of(block: u32, local: u32) -> vec2<u32> {
    let corner = view.grid.xy + vec2<u32>(block % view.grid.z, block / view.grid.z);
    return corner * BLOCK + vec2<u32>(local % BLOCK, local / BLOCK);
}

fn is_drawn(block: u32, px: vec2<u32>) -> bool {
    return block < view.grid.z * view.grid.w && all(px >= view.rect.xy) && all(px < view.rect.zw);
}

// The number of a pixel in the rectangle that is drawn.
fn number_of(px: vec2<u32>) -> u32 {
    let aside = px - view.rect.xy;
    return aside.y * (view.rect.z - view.rect.x) + aside.x;
}

// The ray through a pixel, without an anchor.
fn ray_through(px: vec2<u32>) -> Ray {
    var ray: Ray;
    ray.px = vec2<f32>(px) + view.place;
    ray.dir = vec3<f32>(0.0, 0.0, 1.0);
    if view.is_perspective != 0u {
        ray.dir = vec3<f32>((ray.px - view.half_size) / view.focal_px, 1.0);
    }
    return ray;
}

// The ray through a pixel of a block, whose lists it takes.
fn ray_of(block: u32, px: vec2<u32>) -> Ray {
    for (var list = 0u; list < LISTS; list++) {
        list_first[list] = starts[block * LISTS + list];
        list_end[list] = starts[block * LISTS + list + 1u];
    }
    var ray = ray_through(px);
    ray.anchor = anchor_of(block);
    return ray;
}

// Says so where this thread's loops were cut short, at its end.
fn check_loops() {
    if are_loops_cut(view.has_supports) {
        atomicStore(&pixels[UNFINISHED], 1u);
    }
}
