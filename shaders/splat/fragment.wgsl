// The twin of src/splat/fragment.rs: the boundaries of the result for the pixels of one block, from flat disks. A workgroup is a
// block, a thread a pixel.

// Each pixel's fragments, a heap whose first is the nearest. A slot that a fragment was taken from may hold a surface: `t` is the
// depth up to which fragments join it, `reach` the weight of its heaviest one, `weight` that of all, and `id` its hit, whose
// members are sums by weight until it is finished; there `body` is the view of the heaviest fragment's surfel.
@group(0) @binding(10) var<storage, read_write> fragments: array<Fragment>;

// A hit that is not finished: whether the ray enters the leaf, and how the result changes where the leaf is entered.
fn way_of(front: bool, crossing: u32) -> i32 {
    return i32(crossing * 2u + select(0u, 1u, front));
}

fn is_edge(id: u32) -> bool {
    return views[id].kind != KIND_RISES && views[id].kind != KIND_FALLS;
}

fn is_front(ray: Ray, id: u32) -> bool {
    return dot(views[id].normal, ray.dir) < 0.0;
}

// Where the words of a pixel's fragments are: the first, and how many.
fn range_of(pixel: u32) -> u32 {
    let size = view.rect.zw - view.rect.xy;
    return FIRST_PIXEL + size.x * size.y + 2u * pixel;
}

// Whether a surfel may be drawn at the pixel.
fn may_show(ray: Ray, id: u32) -> bool {
    let b = views[id].bounds;
    let margin = view.margin_px;
    return views[id].kind != KIND_OFF && ray.px.x >= b.x - margin && ray.px.x <= b.y + margin
        && ray.px.y >= b.z - margin && ray.px.y <= b.w + margin;
}

// Goes through the fragments of a pixel, and writes them from `first` on where they are to be `kept`; how many there are.
fn list_fragments(ray: Ray, pixel: u32, first: u32, kept: bool) -> u32 {
    let eye = -(ray.anchor.x + ray.anchor.y);
    var count = 0u;
    // Where only the nearest opaque surface is wanted, those that a whole surface is certain to hide are left out.
    var hidden_from = FARTHEST;
    for (var list = 0u; list < LISTS; list++) {
        for (var i = list_first[list]; i < list_end[list]; i++) {
            let id = members[i];
            if !may_show(ray, id) {
                continue;
            }
            let drawn = drawn_at(ray, id);
            let t = drawn.tau + reference_depth(ray, id);
            if !(drawn.is_drawn && t > eye && t <= hidden_from) {
                continue;
            }
            let reach = footprints[id].reach;
            if kept {
                fragments[first + count] = Fragment(t, drawn.tau, drawn.weight, reach, id, pixel);
            }
            count++;
            if view.nearest_only != 0u && !is_edge(id) && views[id].opacity >= 1.0 {
                hidden_from = min(hidden_from, t + REACHES_OF_A_SURFACE * reach);
            }
        }
    }
    return count;
}

// Counts the fragments of every pixel, and gives it as many places as they need, one after the other in the pool.
@compute @workgroup_size(WORKGROUP)
fn count_fragments(thread: Thread) {
    let block = group_number(thread);
    let px = pixel_of(block, thread.local);
    if !is_drawn(block, px) {
        return;
    }
    let pixel = number_of(px);
    let range = range_of(pixel);
    let count = list_fragments(ray_of(block, px), pixel, 0u, false);
    let first = atomicAdd(&pixels[GROUPS_NEEDED], count);
    // Where the pool is too small the count says so, and all is drawn anew.
    let fits = first <= view.room.x && count <= view.room.x - first;
    atomicStore(&pixels[range], first);
    atomicStore(&pixels[range + 1u], select(0u, count, fits));
    check_loops();
}

// Writes them there. A kernel of its own, since drivers may end a thread's loops after so many steps.
@compute @workgroup_size(WORKGROUP)
fn rasterise(thread: Thread) {
    let block = group_number(thread);
    let px = pixel_of(block, thread.local);
    if !is_drawn(block, px) {
        return;
    }
    let pixel = number_of(px);
    let range = range_of(pixel);
    if atomicLoad(&pixels[range + 1u]) > 0u {
        list_fragments(ray_of(block, px), pixel, atomicLoad(&pixels[range]), true);
    }
    check_loops();
}

// Tells of each fragment how the result changes there: a thread is a fragment.
@compute @workgroup_size(WORKGROUP)
fn clip_fragments(thread: Thread) {
    let place = thread_number(thread);
    let count = atomicLoad(&pixels[GROUPS_NEEDED]);
    if count > view.room.x || place >= count {
        return;
    }
    let id = fragments[place].id;
    let pixel = fragments[place].pixel;
    let width = view.rect.z - view.rect.x;
    var crossing = views[id].kind;
    if is_edge(id) {
        own_leaf = views[id].owner >> OWNER_SHIFT;
        own_index = views[id].index;
        hit_ray = ray_through(view.rect.xy + vec2<u32>(pixel % width, pixel / width));
        crossing = edge_crossing(id, fragments[place].tau);
    }
    fragments[place].pixel = crossing;
    check_loops();
}

// Front to back; of equal depth by leaf, those that rays can enter through first, then by surfel.
fn comes_before(a: Fragment, b: Fragment) -> bool {
    if a.t != b.t {
        return a.t < b.t;
    }
    let owner_a = views[a.id].owner;
    let owner_b = views[b.id].owner;
    if owner_a >> OWNER_SHIFT != owner_b >> OWNER_SHIFT {
        return owner_a < owner_b;
    }
    if (owner_a & MAY_ENTER) != (owner_b & MAY_ENTER) {
        return (owner_a & MAY_ENTER) != 0u;
    }
    return a.id < b.id;
}

// Of two places of the heap of `count` from `first` on, the first one there, that whose fragment comes first.
fn earlier(first: u32, count: u32, a: u32, b: u32) -> u32 {
    if b >= count {
        return a;
    }
    return select(a, b, comes_before(fragments[first + b], fragments[first + a]));
}

// Puts `item` into the heap of `count` from `first` on, whose place `at` is free. Every place has four children: a heap of two is
// twice as deep, and drivers may end a thread's loops after so many steps.
fn sift(first: u32, count: u32, at: u32, item: Fragment) {
    var place = at;
    loop {
        var child = 4u * place + 1u;
        if child >= count {
            break;
        }
        let other = earlier(first, count, child + 2u, child + 3u);
        child = earlier(first, count, child, child + 1u);
        child = earlier(first, count, child, other);
        if !comes_before(fragments[first + child], item) {
            break;
        }
        fragments[first + place] = fragments[first + child];
        place = child;
    }
    fragments[first + place] = item;
}

fn mean_depth(slot: u32) -> f32 {
    return hits[fragments[slot].id].t / fragments[slot].weight;
}

fn is_opaque(slot: u32) -> bool {
    return hits[fragments[slot].id].opacity >= fragments[slot].weight;
}

// How many of a pixel's surfaces, from the first, are complete: no fragment joins them any more; and the depth of the nearest
// opaque one of them.
var<private> complete: u32;
var<private> hiding: f32;

// Completes those that end before depth `t`. Surfaces are in the `count` slots before `end`, the last one first.
fn complete_surfaces(end: u32, count: u32, t: f32) {
    while complete < count {
        let slot = end - 1u - complete;
        if !(fragments[slot].t < t) {
            break;
        }
        if is_opaque(slot) {
            hiding = min(hiding, mean_depth(slot));
        }
        complete++;
    }
}

// Whether nothing at depth `t` or behind can be seen: an opaque surface is complete, and none that is not is before it.
fn is_hidden(end: u32, count: u32, t: f32) -> bool {
    var nearest = hiding;
    for (var slot = end - count; slot < end - complete; slot++) {
        if fragments[slot].t < t && is_opaque(slot) {
            nearest = min(nearest, mean_depth(slot));
        }
    }
    if !(nearest < FARTHEST) {
        return false;
    }
    for (var slot = end - count; slot < end - complete; slot++) {
        if !(fragments[slot].t < t || mean_depth(slot) > nearest) {
            return false;
        }
    }
    return true;
}

// The slot of the surface that a fragment joins, the latest, hence the farthest; or `end`.
fn joined(end: u32, count: u32, f: Fragment, leaf: u32, way: i32) -> u32 {
    for (var slot = end - count; slot < end - complete; slot++) {
        let hit = fragments[slot].id;
        if hits[hit].leaf == leaf && hits[hit].seen == way && f.t <= fragments[slot].t {
            return slot;
        }
    }
    return end;
}

// Makes a hit of a surface's sums, and puts it into the pixel's list, front to back.
fn finish(ray: Ray, pixel: u32, slot: u32) {
    let place = fragments[slot].id;
    let weight = fragments[slot].weight;
    var hit = hits[place];
    let crossing = u32(hit.seen) / 2u;
    let front = u32(hit.seen) % 2u == 1u;
    let sheet = is_sheet(hit.leaf);
    let enters_result = sheet || (crossing == RISES) == front;
    let outward = select(crossing == RISES, front, sheet);
    let share = 1.0 / weight;
    let length_squared = dot(hit.normal, hit.normal);
    if length_squared > 0.0 {
        hit.normal = hit.normal * (select(-1.0, 1.0, outward) / sqrt(length_squared));
    }
    hit.t = hit.t / weight;
    hit.colour = hit.colour * share;
    // A mean of ones must be one, whatever its rounding.
    hit.opacity = select(clamp(hit.opacity * share, 0.0, 1.0), 1.0, hit.opacity >= weight);
    hit_ray = ray;
    hit_t = hit.t;
    own_leaf = hit.leaf;
    own_index = views[hit.body].index;
    hit.body = hit.leaf;
    if crossing == FALLS {
        forget_sides();
        hit.body = body_of();
    }
    hit.seen = select(-1, 1, enters_result) * i32(view.samples);
    hits[place] = hit;
    link(pixel, place);
}

// Groups each pixel's fragments, front to back. A workgroup is a part of a block: all its threads wait for the one with the most
// fragments, and llvmpipe counts their loops' steps together.
@compute @workgroup_size(RESOLVED_TOGETHER)
fn resolve_fragments(thread: Thread) {
    let first_of_group = group_number(thread) * RESOLVED_TOGETHER;
    let block = first_of_group / (BLOCK * BLOCK);
    let px = pixel_of(block, first_of_group % (BLOCK * BLOCK) + thread.local);
    if !is_drawn(block, px) {
        return;
    }
    let pixel = number_of(px);
    let first = atomicLoad(&pixels[range_of(pixel)]);
    var left = atomicLoad(&pixels[range_of(pixel) + 1u]);
    let end = first + left;
    atomicStore(&pixels[FIRST_PIXEL + pixel], NONE);
    let ray = ray_of(block, px);
    for (var i = (left + 2u) / 4u; i > 0u; i--) {
        sift(first, left, i - 1u, fragments[first + i - 1u]);
    }
    var surfaces = 0u;
    complete = 0u;
    hiding = FARTHEST;
    newest = NONE;
    while left > 0u {
        let f = fragments[first];
        complete_surfaces(end, surfaces, f.t);
        if view.nearest_only != 0u && is_hidden(end, surfaces, f.t) {
            break;
        }
        left--;
        if left > 0u {
            sift(first, left, 0u, fragments[first + left]);
        }
        // What was clipped tells so in place of its pixel.
        if f.pixel == NO_CROSSING {
            continue;
        }
        let leaf = views[f.id].owner >> OWNER_SHIFT;
        let way = way_of(is_front(ray, f.id), f.pixel);
        var slot = joined(end, surfaces, f, leaf, way);
        if slot < end {
            fragments[slot].t = max(fragments[slot].t, f.t + 0.5 * f.reach);
        } else {
            let place = new_hit();
            if place == NONE {
                continue;
            }
            surfaces++;
            slot = end - surfaces;
            fragments[slot] = Fragment(f.t + f.reach, 0.0, 0.0, 0.0, place, 0u);
            var hit: Hit;
            hit.leaf = leaf;
            hit.body = f.id;
            hit.seen = way;
            hits[place] = hit;
        }
        let hit = fragments[slot].id;
        fragments[slot].weight += f.weight;
        hits[hit].t += f.weight * f.t;
        hits[hit].normal += f.weight * views[f.id].normal;
        hits[hit].colour += f.weight * views[f.id].colour;
        hits[hit].opacity += f.weight * views[f.id].opacity;
        if f.weight > fragments[slot].reach {
            fragments[slot].reach = f.weight;
            hits[hit].body = f.id;
        }
    }
    for (var surface = 1u; surface <= surfaces; surface++) {
        finish(ray, pixel, end - surface);
    }
    check_loops();
}
