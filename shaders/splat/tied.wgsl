// The twin of src/splat/tied.rs: surfaces of different leaves that coincide. A hit that is told that another leaf's surface is there
// goes to the pixel's list undecided. Once all hits of the ray are there, those that lie together are decided as one.

fn is_parallel(a: vec3<f32>, b: vec3<f32>, most_sine: f32) -> bool {
    return length(cross(a, b)) <= most_sine * length(a) * length(b);
}

// Whether a leaf's surface, with that field at the hit, coincides with that of the hit.
fn coincides(field: FieldAt) -> bool {
    let near = TIED_SHARE * min(hit_radius, field.radius / field.weight);
    return abs(field.value) <= near * field.weight && is_parallel(field.normal, hit_normal, MOST_SINE);
}

// The nearest crossing of the hit's ray where the surface of a leaf without surfels coincides with that of the hit; NONE without one.
// That surface is asked only along the ray: where it is flat, it is as far away as its crossing is from the hit along the normal.
fn coincident_crossing(leaf: u32) -> u32 {
    let all = crossings_of(hit_pixel);
    let reach = MOST_TIED_REACH_IN_RADII * hit_radius;
    var least = TIED_SHARE * hit_radius;
    var nearest = NONE;
    for (var i = all.x; i < all.y; i++) {
        let behind = from_anchor(hit_ray, crossing_depth(i)) - hit_t;
        if behind > reach {
            break;
        }
        if crossing_leaf(i) != leaf || -behind > reach {
            continue;
        }
        let normal = to_view(crossing_vector(i, CROSSING_NORMAL));
        let distance = abs(behind * dot(normal, hit_ray.dir));
        if distance <= least && is_parallel(normal, hit_normal, MOST_SINE) {
            least = distance;
            nearest = i;
        }
    }
    return nearest;
}

// The depths of hits that coincide differ by no more.
fn tied_reach(ray: Ray, hit: u32) -> f32 {
    let along = max(abs(dot(hits[hit].normal, ray.dir)), LEAST_TIED_COSINE * length(ray.dir));
    return 2.0 * TIED_SHARE * bitcast<f32>(hits[hit].body) / along;
}

// Takes the hits that are not decided out of the pixel's list, and returns the first of them: a list of their own, in the same order.
fn take_tied(pixel: u32) -> u32 {
    var first = NONE;
    var last = NONE;
    var kept = NONE;
    var hit = atomicLoad(&pixels[FIRST_PIXEL + pixel]);
    while hit != NONE {
        let next = hits[hit].next;
        if !tied_flag(hit, TIED) {
            kept = hit;
        } else {
            if kept == NONE {
                atomicStore(&pixels[FIRST_PIXEL + pixel], next);
            } else {
                hits[kept].next = next;
            }
            if last == NONE {
                first = hit;
            } else {
                hits[last].next = hit;
            }
            hits[hit].next = NONE;
            last = hit;
        }
        hit = next;
    }
    return first;
}

// The hit behind those that coincide with `first`. What is in between and leans otherwise is for itself, in order.
fn end_of_cluster(ray: Ray, first: u32) -> u32 {
    let reach = tied_reach(ray, first);
    var hit = hits[first].next;
    while hit != NONE {
        let together = hits[hit].t - hits[first].t <= max(reach, tied_reach(ray, hit))
            && is_parallel(hits[hit].normal, hits[first].normal, 2.0 * MOST_SINE);
        if !together {
            break;
        }
        hit = hits[hit].next;
    }
    return hit;
}

// Whether any leaf that turns where the hits coincide matters.
fn any_turned_matters() -> bool {
    for (var leaf = 0u; leaf < view.leaves; leaf++) {
        if is_known(leaf) && turns_at_peel(leaf) {
            if rank_at_peel(leaf, false) < NOT_MATTERING {
                return true;
            }
        }
    }
    return false;
}

// Decides the cluster from `first` to before `end` as far as sides are known: the owner is a hit.
fn decide_cluster(first: u32, end: u32) {
    begin_decision();
    var least = WORST_RANK;
    for (var hit = first; hit != end; hit = hits[hit].next) {
        let leaf = hits[hit].leaf;
        if peel_was == peel_is {
            if is_sheet(leaf) && shows_at_peel(leaf) {
                peel_owner = hit;
                break;
            }
        } else if turns_at_peel(leaf) {
            // Of equal rank the least leaf, and of that the first.
            let rank = rank_at_peel(leaf, false);
            if rank < least || (rank == least && leaf < hits[peel_owner].leaf) {
                least = rank;
                peel_owner = hit;
            }
        }
    }
    // Where only a leaf matters that has no hit here, its own hit shows the boundary.
    if peel_was != peel_is && least >= NOT_MATTERING && any_turned_matters() {
        peel_owner = NONE;
    }
    if peel_owner != NONE {
        find_peel_body(hits[peel_owner].leaf);
    }
}

// Puts what the hits from `first` to before `end`, which coincide, are together into the pixel's list, in place of one of them.
fn resolve_cluster(ray: Ray, pixel: u32, first: u32, end: u32) {
    // All others are asked at the first.
    hit_ray = ray;
    hit_pixel = pixel;
    hit_t = hits[first].t;
    hit_normal = hits[first].normal;
    hit_radius = bitcast<f32>(hits[first].body);
    own_leaf = NONE;
    forget_sides();
    for (var hit = first; hit != end; hit = hits[hit].next) {
        // Two groups of surfels may have found one crossing: the sides are that before the first and that behind the last.
        let leaf = hits[hit].leaf;
        let enters = tied_flag(hit, TIED_ENTERS);
        let was_inside = select(!enters, known_side(leaf, false), is_known(leaf));
        note(leaf, was_inside && !is_sheet(leaf), enters && !is_sheet(leaf));
    }
    loop {
        decide_cluster(first, end);
        if missing == NONE {
            break;
        }
        // Each turn asks another leaf.
        side(missing);
    }
    if peel_owner == NONE || !tied_flag(peel_owner, TIED_SHOWS) {
        return;
    }
    // The leaf's outward normal is the result's where both are entered, or both left.
    if tied_flag(peel_owner, TIED_ENTERS) != peel_enters {
        hits[peel_owner].normal = -hits[peel_owner].normal;
    }
    hits[peel_owner].body = peel_body;
    hits[peel_owner].seen = select(-1, 1, peel_enters) * i32(view.samples);
    own_leaf = hits[peel_owner].leaf;
    link(pixel, peel_owner);
}

// Decides what a pixel's ray meets where surfaces coincide, once `trace` and `trace_crossed` have found it all.
@compute @workgroup_size(WORKGROUP)
fn trace_tied(thread: Thread) {
    let block = group_number(thread);
    let px = pixel_of(block, thread.local);
    if !is_drawn(block, px) {
        return;
    }
    let pixel = number_of(px);
    var first = take_tied(pixel);
    newest = NONE;
    is_peel = false;
    if first != NONE {
        let ray = ray_of(block, px);
        while first != NONE {
            let end = end_of_cluster(ray, first);
            resolve_cluster(ray, pixel, first, end);
            first = end;
        }
    }
    check_loops();
}
