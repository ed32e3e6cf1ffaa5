// What all rays of a block share, and the sides of other leaves at a hit: the twin of `sides` in src/splat/surface.rs. A workgroup
// is a block, a thread a pixel.

// The hit that the expression is asked about.
var<private> hit_ray: Ray;
var<private> hit_t: f32;
var<private> hit_pixel: u32;
var<private> own_leaf: u32;
var<private> own_index: u32;
// The block's lists.
var<private> list_first: array<u32, LISTS>;
var<private> list_end: array<u32, LISTS>;
// What is known of the hit: a bit for each leaf that was asked, and its answer.
var<private> asked: array<u32, LEAF_WORDS>;
var<private> answers: array<u32, LEAF_WORDS>;

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
    }
}

// Whether the hit is inside of another leaf, by the leaf's field.
fn side_by_field(leaf: u32) -> bool {
    let word = leaf / LEAF_BITS;
    let bit = 1u << (leaf % LEAF_BITS);
    if (asked[word] & bit) != 0u {
        return (answers[word] & bit) != 0u;
    }
    var inside = false;
    if !is_sheet(leaf) {
        let by_surfels = side_by_surfels(hit_ray, run_of(leaf), hit_t);
        inside = by_surfels > 0;
        if by_surfels < 0 {
            inside = far_inside(leaf, point_at(hit_ray, hit_t));
        }
    }
    asked[word] |= bit;
    if inside {
        answers[word] |= bit;
    }
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
