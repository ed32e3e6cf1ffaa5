// The twin of src/splat/surface.rs: the boundaries of the result on the rays of one block of pixels. A workgroup is a block, a
// thread a pixel.

// Opaque where only rounding keeps a weighted mean from being so.
fn snapped(opacity: f32) -> f32 {
    return select(max(opacity, 0.0), 1.0, opacity > 1.0 - OPACITY_ROUNDING);
}

// Solves one surface, clips it and keeps what is on the result; returns the depth from which on nothing is seen. `crosses` says that
// the ray is known to meet it.
fn resolve(ray: Ray, run: Run, number: u32, front: bool, crosses: bool, pixel: u32, hidden_from: f32) -> f32 {
    let group = groups[number];
    if !(select(group.weighted_depth / group.weight, group.best_depth, crosses) < hidden_from) {
        return hidden_from;
    }
    let kind = views[group.best].kind;
    let is_edge = kind != KIND_RISES && kind != KIND_FALLS;
    // Step 1: where the ray meets the surface, in front of the eye.
    let solution = solve(ray, run, group, front, select(0u, EDGE_STEPS, is_edge), crosses);
    let is_ahead = group.best_depth > -(ray.anchor.x + ray.anchor.y);
    if solution.dropped && is_ahead && takes_turns(run.leaf) {
        note_found(number, DROPPED, front, group.best_depth, 0.0);
    }
    if !solution.hit || !(solution.t > -(ray.anchor.x + ray.anchor.y)) {
        return hidden_from;
    }
    // Step 2: ask the residual of the nearest surfel.
    hit_ray = ray;
    hit_t = solution.t;
    hit_pixel = pixel;
    own_leaf = run.leaf;
    own_index = views[group.best].index;
    forget_sides();
    var hit: Hit;
    hit.t = solution.t;
    let length_squared = dot(solution.normal, solution.normal);
    if length_squared > 0.0 {
        hit.normal = solution.normal / sqrt(length_squared);
    }
    hit.colour = solution.colour;
    hit.opacity = snapped(solution.opacity);
    hit.leaf = run.leaf;
    hit.body = run.leaf;
    if takes_turns(run.leaf) {
        note_found(number, FOUND, front, hit.t, abs(dot(hit.normal, ray.dir)));
    }
    hit_normal = hit.normal;
    hit_radius = views[group.best].radius;
    var crossing = kind;
    if is_edge {
        crossing = edge_crossing(group.best, solution.t - reference_depth(ray, group.best));
    }
    if is_tied {
        insert(pixel, as_tied(hit, hit_radius, front, true));
        return hidden_from;
    }
    if crossing == NO_CROSSING {
        return hidden_from;
    }
    // Step 3: keep what is on the result.
    let sheet = is_sheet(run.leaf);
    let enters_result = sheet || (crossing == RISES) == front;
    hit.normal *= select(-1.0, 1.0, select(crossing == RISES, front, sheet));
    if crossing == FALLS {
        hit.body = body_of();
    }
    hit.seen = select(-1, 1, enters_result) * i32(view.samples);
    insert(pixel, hit);
    return select(hidden_from, min(hidden_from, hit.t), view.nearest_only != 0u && hit.opacity >= 1.0);
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
    let ray = ray_of(block, px);
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
        // Surfaces that rays enter are found and resolved first: what they hide of the others is then not even looked at. Last come
        // those that were dropped and are crossings.
        for (var turn = 0u; turn < select(LISTS, LISTS + 1u, takes_turns(leaf)); turn++) {
            var group = NONE;
            if turn < LISTS || TAKES_TURNS == 0u {
                detect(ray, run.first[turn], run.end[turn], hidden_from);
                group = select(leaving, entering, turn == 0u);
            } else {
                hidden_from = put_in_turn(ray, leaf, pixel, hidden_from);
                group = groups_needed;
                // Given back with the others.
                entering = groups_needed;
            }
            while group != NONE {
                let front = turn == 0u || (turn == LISTS && group_enters(group));
                hidden_from = resolve(ray, run, group, front, turn == LISTS, pixel, hidden_from);
                group = groups[group].next;
            }
        }
        give_back(entering);
        give_back(leaving);
        entering = NONE;
        leaving = NONE;
    }
    check_loops();
}
