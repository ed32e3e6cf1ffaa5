// The twin of src/splat/surface.rs: the boundaries of the result on the rays of one block of pixels. A workgroup is a block, a
// thread a pixel.

@group(0) @binding(8) var<storage, read_write> hits: array<Hit>;

// The hit that the expression is asked about.
var<private> hit_ray: Ray;
var<private> hit_t: f32;
var<private> hit_pixel: u32;
var<private> own_leaf: u32;
var<private> own_index: u32;
// The block's lists.
var<private> list_first: array<u32, LISTS>;
var<private> list_end: array<u32, LISTS>;
// The pixel's hit that was found last.
var<private> newest: u32;
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

fn forget_answers() {
    for (var word = 0u; word < LEAF_WORDS; word++) {
        asked[word] = 0u;
        answers[word] = 0u;
    }
}

// Whether the hit is inside of another leaf.
fn side(leaf: u32) -> bool {
    let word = leaf / LEAF_BITS;
    let bit = 1u << (leaf % LEAF_BITS);
    if (asked[word] & bit) != 0u {
        return (answers[word] & bit) != 0u;
    }
    var inside = false;
    if is_crossed(leaf) {
        inside = !is_sheet(leaf) && side_by_crossings(hit_ray, hit_pixel, leaf, hit_t);
    } else if !is_sheet(leaf) {
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

// Puts a hit into the pixel's list, front to back; one that two groups found twice counts once. Crossings, which have no `own_leaf`,
// cannot be found twice: equal ones are two that rounding made so.
fn insert(pixel: u32, hit: Hit) {
    var before = NONE;
    var after = atomicLoad(&pixels[FIRST_PIXEL + pixel]);
    // Most hits come behind the one before.
    if newest != NONE {
        if hits[newest].t < hit.t {
            before = newest;
            after = hits[newest].next;
        }
    }
    while after != NONE {
        if own_leaf != NONE && hits[after].t == hit.t && hits[after].leaf == hit.leaf && hits[after].seen == hit.seen {
            return;
        }
        if hits[after].t > hit.t || (hits[after].t == hit.t && hits[after].leaf > hit.leaf) {
            break;
        }
        before = after;
        after = hits[after].next;
    }
    let place = atomicAdd(&pixels[HITS_NEEDED], 1u);
    if place >= view.room.y {
        return;
    }
    newest = place;
    hits[place] = hit;
    hits[place].next = after;
    if before != NONE {
        hits[before].next = place;
    } else {
        atomicStore(&pixels[FIRST_PIXEL + pixel], place);
    }
}

// Opaque where only rounding keeps a weighted mean from being so.
fn snapped(opacity: f32) -> f32 {
    return select(max(opacity, 0.0), 1.0, opacity > 1.0 - OPACITY_ROUNDING);
}

// Solves one surface, clips it and keeps what is on the result; returns the depth from which on nothing is seen.
fn resolve(ray: Ray, run: Run, group: Group, front: bool, pixel: u32, hidden_from: f32) -> f32 {
    if !(group.weighted_depth / group.weight < hidden_from) {
        return hidden_from;
    }
    let kind = views[group.best].kind;
    let is_edge = kind != KIND_RISES && kind != KIND_FALLS;
    // Step 1: where the ray meets the surface, in front of the eye.
    let solution = solve(ray, run, group, front, select(0u, EDGE_STEPS, is_edge));
    if !solution.hit || !(solution.t > -(ray.anchor.x + ray.anchor.y)) {
        return hidden_from;
    }
    // Step 2: ask the residual of the nearest surfel.
    hit_ray = ray;
    hit_t = solution.t;
    hit_pixel = pixel;
    own_leaf = run.leaf;
    own_index = views[group.best].index;
    forget_answers();
    var crossing = kind;
    if is_edge {
        crossing = crossing_of(kind);
    }
    if crossing == NO_CROSSING {
        return hidden_from;
    }
    // Step 3: keep what is on the result.
    let sheet = is_sheet(run.leaf);
    let enters_result = sheet || (crossing == RISES) == front;
    let outward = select(crossing == RISES, front, sheet);
    var hit: Hit;
    hit.t = solution.t;
    let length_squared = dot(solution.normal, solution.normal);
    if length_squared > 0.0 {
        hit.normal = solution.normal * (select(-1.0, 1.0, outward) / sqrt(length_squared));
    }
    hit.colour = solution.colour;
    hit.opacity = snapped(solution.opacity);
    hit.leaf = run.leaf;
    hit.body = run.leaf;
    if crossing == FALLS {
        hit.body = body_of();
    }
    hit.seen = select(-1, 1, enters_result) * i32(view.samples);
    insert(pixel, hit);
    return select(hidden_from, min(hidden_from, hit.t), view.nearest_only != 0u && hit.opacity >= 1.0);
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

// The lists of a block.
fn find_lists(block: u32) {
    for (var list = 0u; list < LISTS; list++) {
        list_first[list] = starts[block * LISTS + list];
        list_end[list] = starts[block * LISTS + list + 1u];
    }
}

fn ray_through(px: vec2<u32>, block: u32) -> Ray {
    var ray: Ray;
    ray.px = vec2<f32>(px) + view.place;
    ray.dir = vec3<f32>(0.0, 0.0, 1.0);
    if view.is_perspective != 0u {
        ray.dir = vec3<f32>((ray.px - view.half_size) / view.focal_px, 1.0);
    }
    ray.anchor = anchor_of(block);
    return ray;
}

// A driver that ends loops after so many steps leaves them without a word: then these steps are too many as well.
fn note_unfinished() {
    var step = 0u;
    while step < 2u + view.has_supports {
        step++;
    }
    if step < 2u {
        atomicStore(&pixels[UNFINISHED], 1u);
    }
}

@compute @workgroup_size(WORKGROUP)
fn trace(thread: Thread) {
    let block = group_number(thread);
    let px = pixel_of(block, thread.local);
    if !is_drawn(block, px) {
        return;
    }
    let pixel = number_of(px);
    atomicStore(&pixels[FIRST_PIXEL + pixel], NONE);
    entering = NONE;
    leaving = NONE;
    unused = NONE;
    newest = NONE;
    let ray = ray_through(px, block);
    find_lists(block);
    var hidden_from = FARTHEST;
    // Leaf by leaf.
    var at = list_first;
    loop {
        var leaf = NONE;
        for (var list = 0u; list < LISTS; list++) {
            if at[list] < list_end[list] {
                leaf = min(leaf, leaf_at(at[list]));
            }
        }
        if leaf == NONE {
            break;
        }
        var run: Run;
        run.leaf = leaf;
        for (var list = 0u; list < LISTS; list++) {
            run.first[list] = at[list];
            run.end[list] = leaf_begins(leaf + 1u, at[list], list_end[list]);
            at[list] = run.end[list];
        }
        // Surfaces that rays enter are found and resolved first: what they hide of the others is then not even looked at.
        for (var list = 0u; list < LISTS; list++) {
            let front = list == 0u;
            detect(ray, run.first[list], run.end[list], hidden_from);
            var group = select(leaving, entering, front);
            while group != NONE {
                hidden_from = resolve(ray, run, groups[group], front, pixel, hidden_from);
                group = groups[group].next;
            }
        }
        give_back(entering);
        give_back(leaving);
        entering = NONE;
        leaving = NONE;
    }
    note_unfinished();
}
