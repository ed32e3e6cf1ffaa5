// The twin of src/splat/turns.rs: crossings of the ray with one leaf put in turn, once all groups of the leaf are resolved.

// What came of a group, in bits of `Group::found`: a crossing; one that was dropped; the ray enters the leaf there.
const FOUND: u32 = 1u;
const DROPPED: u32 = 2u;
const ENTERS: u32 = 4u;

// The leaf's groups that gave crossings, by depth, those that were dropped, and of these those that are crossings.
var<private> crossings_found: u32;
var<private> groups_dropped: u32;
var<private> groups_needed: u32;

// Whether a leaf is a solid of which is known on which side a point far off is: crossings of others tell nothing.
fn takes_turns(leaf: u32) -> bool {
    return TAKES_TURNS != 0u && !is_sheet(leaf) && tables[tables[AT_LEAVES] + leaf * LEAF_STRIDE + 1u] == FAR_WINDING;
}

// Notes what came of a group: at depth `t` a step of one in depth takes `steepness` along the normal.
fn note_found(group: u32, what: u32, front: bool, t: f32, steepness: f32) {
    groups[group].found = what | select(0u, ENTERS, front);
    groups[group].t = t;
    groups[group].steepness = steepness;
}

// Sorts a list of groups into those of crossings, those dropped and those to use again.
fn sort_out(first: u32) {
    var group = first;
    while group != NONE {
        let next = groups[group].next;
        if (groups[group].found & FOUND) != 0u {
            var before = NONE;
            var after = crossings_found;
            while after != NONE && groups[after].t <= groups[group].t {
                before = after;
                after = groups[after].next;
            }
            groups[group].next = after;
            if before == NONE {
                crossings_found = group;
            } else {
                groups[before].next = group;
            }
        } else if (groups[group].found & DROPPED) != 0u {
            groups[group].next = groups_dropped;
            groups_dropped = group;
        } else {
            groups[group].next = unused;
            unused = group;
        }
        group = next;
    }
}

fn group_enters(group: u32) -> bool {
    return (groups[group].found & ENTERS) != 0u;
}

// Whether the crossings take turns, if the ray begins outside of the leaf.
fn are_turns_taken() -> bool {
    var enters = true;
    var group = crossings_found;
    while group != NONE {
        if group_enters(group) != enters {
            return false;
        }
        enters = !enters;
        group = groups[group].next;
    }
    return true;
}

// The dropped group that proves most of those that would go before the crossing of `group`, behind depth `nearest`.
fn surest_dropped(group: u32, nearest: f32) -> u32 {
    var surest = NONE;
    var other = groups_dropped;
    while other != NONE {
        let lies_between = groups[other].t > nearest && groups[other].t < groups[group].t;
        if lies_between && group_enters(other) != group_enters(group) {
            if surest == NONE {
                surest = other;
            } else if groups[other].best_weight > groups[surest].best_weight {
                surest = other;
            }
        }
        other = groups[other].next;
    }
    return surest;
}

// Whether the crossing of `group`, out of turn, may be one without its other half: at a silhouette, or of a stray surfel.
fn is_stray(group: u32) -> bool {
    if groups[group].steepness < LEAST_STEEPNESS {
        return true;
    }
    let next = groups[group].next;
    if next == NONE {
        return false;
    }
    let out_of_surface = (groups[next].t - groups[group].t) * groups[next].steepness;
    let most = views[groups[group].best].radius * MOST_STRAY_IN_RADII;
    return group_enters(next) != group_enters(group) && out_of_surface < most;
}

// Whether the leaf has a hit at depth `t` in the pixel's list: only what is on the result is left out.
fn shows(pixel: u32, leaf: u32, t: f32) -> bool {
    var hit = atomicLoad(&pixels[FIRST_PIXEL + pixel]);
    while hit != NONE {
        if hits[hit].leaf == leaf && hits[hit].t == t {
            return true;
        }
        hit = hits[hit].next;
    }
    return false;
}

// Takes the leaf's hit at depth `t` out of the pixel's list.
fn take_out(pixel: u32, leaf: u32, t: f32) {
    var before = NONE;
    var hit = atomicLoad(&pixels[FIRST_PIXEL + pixel]);
    while hit != NONE {
        let next = hits[hit].next;
        if hits[hit].leaf == leaf && hits[hit].t == t {
            if before == NONE {
                atomicStore(&pixels[FIRST_PIXEL + pixel], next);
            } else {
                hits[before].next = next;
            }
        } else {
            before = hit;
        }
        hit = next;
    }
    newest = NONE;
}

// The depth from which on the pixel's hits let nothing be seen.
fn seen_until(pixel: u32) -> f32 {
    var hit = atomicLoad(&pixels[FIRST_PIXEL + pixel]);
    while hit != NONE {
        if hits[hit].opacity >= 1.0 && !tied_flag(hit, TIED) {
            return hits[hit].t;
        }
        hit = hits[hit].next;
    }
    return FARTHEST;
}

fn is_same(a: u32, b: u32) -> bool {
    return groups[a].t == groups[b].t && group_enters(a) == group_enters(b);
}

// A depth before a group's crossing that is a radius off its surface, or, where another is nearer, halfway to that.
fn depth_before(group: u32, nearest: f32) -> f32 {
    let off = views[groups[group].best].radius / max(groups[group].steepness, LEAST_STEEPNESS);
    return max(groups[group].t - off, 0.5 * (nearest + groups[group].t));
}

// Takes the group out of those that were dropped, and puts it to those that are needed.
fn take_up(group: u32) {
    var before = NONE;
    var other = groups_dropped;
    while other != group {
        before = other;
        other = groups[other].next;
    }
    if before == NONE {
        groups_dropped = groups[group].next;
    } else {
        groups[before].next = groups[group].next;
    }
    groups[group].next = groups_needed;
    groups_needed = group;
}

// Takes stray crossings out of the pixel's list and takes up the groups that are needed; returns from where on nothing is seen.
fn mend(ray: Ray, leaf: u32, pixel: u32, hidden_from: f32) -> f32 {
    var nearest = -(ray.anchor.x + ray.anchor.y);
    var inside = false;
    var has_begun = false;
    var any_stray = false;
    var last = NONE;
    var group = crossings_found;
    while group != NONE {
        // Two groups may have found one crossing.
        if has_begun && last != NONE && is_same(group, last) {
            last = group;
            group = groups[group].next;
            continue;
        }
        var surest = NONE;
        var may_be_stray = false;
        if has_begun && group_enters(group) == inside {
            surest = surest_dropped(group, nearest);
            may_be_stray = surest == NONE && is_stray(group) && shows(pixel, leaf, groups[group].t);
        }
        var counts = true;
        if !has_begun || surest != NONE || may_be_stray {
            // Where a leaf is not on the result its surfels are not looked for: then a crossing went before that nobody found.
            let at = select(nearest, depth_before(group, nearest), has_begun);
            let holds = far_inside(leaf, point_at(ray, at));
            if !has_begun {
                has_begun = true;
                inside = holds;
                continue;
            }
            if holds == inside {
                if may_be_stray {
                    take_out(pixel, leaf, groups[group].t);
                    any_stray = true;
                    counts = false;
                } else {
                    take_up(surest);
                }
            }
        }
        if counts {
            inside = group_enters(group);
            nearest = groups[group].t;
        }
        last = group;
        group = groups[group].next;
    }
    if any_stray && view.nearest_only != 0u {
        return seen_until(pixel);
    }
    return hidden_from;
}

// Puts the crossings with a leaf in turn but for those of the groups that are then to be resolved as crossings; returns the depth
// from which on nothing is seen.
fn put_in_turn(ray: Ray, leaf: u32, pixel: u32, hidden_from: f32) -> f32 {
    var seen = hidden_from;
    crossings_found = NONE;
    groups_dropped = NONE;
    groups_needed = NONE;
    sort_out(entering);
    sort_out(leaving);
    entering = NONE;
    leaving = NONE;
    if !are_turns_taken() || groups_dropped != NONE {
        seen = mend(ray, leaf, pixel, seen);
    }
    give_back(crossings_found);
    give_back(groups_dropped);
    return seen;
}
