// The twin of src/splat/clip.rs: whether a point on an edge surfel is on the result, asked of the surfel's own partners. Its words
// are laid out in src/gpu/splat/clip.rs.

// The disk of the surfel that is clipped.
var<private> clip_disk: u32;
// Whether the expression asks partners; else it asks fields, whose material lies behind a hit.
var<private> asks_partners: bool;
// Whether any leaf was known at the point, by the paper's rule.
var<private> any_known: bool;

fn clip_leaf(leaf: u32) -> u32 {
    return tables[view.clip + CLIP_LEAVES] + leaf * CLIP_LEAF_STRIDE;
}

// Whether surfel `index` of `leaf` has a disk.
fn is_disk(leaf: u32, index: u32) -> bool {
    let chunk = tables[clip_leaf(leaf)] + index / CHUNK * CLIP_CHUNK_STRIDE;
    let place = index % CHUNK;
    return ((tables[chunk + 1u + place / 32u] >> (place % 32u)) & 1u) != 0u;
}

// The number of the disk of surfel `index` of `leaf`: those before its chunk's, and those before it in its chunk.
fn disk_of(leaf: u32, index: u32) -> u32 {
    let chunk = tables[clip_leaf(leaf)] + index / CHUNK * CLIP_CHUNK_STRIDE;
    var disk = tables[chunk];
    var place = index % CHUNK;
    var word = chunk + 1u;
    while place >= 32u {
        disk += countOneBits(tables[word]);
        word++;
        place -= 32u;
    }
    return disk + countOneBits(tables[word] & ((1u << place) - 1u));
}

// The first place from `first` to `end` whose word is `least` or more.
fn first_from(least: u32, first: u32, end: u32) -> u32 {
    var low = first;
    var high = end;
    while low < high {
        let middle = low + (high - low) / 2u;
        if tables[middle] < least {
            low = middle + 1u;
        } else {
            high = middle;
        }
    }
    return low;
}

// The places of the partners that belong to a leaf.
fn partners_of(leaf: u32) -> vec2<u32> {
    let lists = tables[view.clip + CLIP_LISTS];
    let partners = lists + tables[view.clip + CLIP_DISKS] + 1u;
    let words = clip_leaf(leaf);
    let end = partners + tables[lists + clip_disk + 1u];
    let first = first_from(tables[words + 1u], partners + tables[lists + clip_disk], end);
    return vec2<u32>(first, first_from(tables[words + 2u], first, end));
}

// The resolved rule: whether the point is inside of a near leaf.
fn side_by_partners(leaf: u32) -> bool {
    let partners = partners_of(leaf);
    if partners.x < partners.y {
        // Of very many only those count that a search about the point finds.
        let is_nearest = view.inside == INSIDE_NEAREST || view.inside == INSIDE_TWO_NEAREST;
        let holding = partners.y - partners.x > LONGEST_WALK && !is_nearest;
        let sign = select(1.0, -1.0, tables[clip_leaf(leaf) + 3u] != 0u);
        let inside = ask(Patch(partners.x, partners.y, sign, holding));
        if inside >= 0 {
            return inside > 0;
        }
    }
    return far_inside(leaf, clip_centre + (clip_centre_rest + clip_point));
}

// The paper's rule: unknown without partners.
fn known_inside(leaf: u32, is_reversed: bool) -> u32 {
    var inside = UNKNOWN;
    if leaf == own_leaf {
        return inside;
    }
    if is_sheet(leaf) {
        inside = FALSE;
    } else {
        let partners = partners_of(leaf);
        if partners.x < partners.y {
            let answer = ask(Patch(partners.x, partners.y, select(1.0, -1.0, is_reversed), false));
            inside = select(FALSE, TRUE, answer > 0);
        } else {
            // A leaf that is near, but whose side is the same all over the surfel.
            let sides = tables[view.clip + CLIP_SIDES];
            let first = sides + tables[view.clip + CLIP_DISKS] + 1u;
            for (var i = tables[sides + clip_disk]; i < tables[sides + clip_disk + 1u]; i++) {
                if tables[first + i] / 2u == leaf {
                    inside = tables[first + i] % 2u;
                }
            }
        }
    }
    any_known = any_known || inside != UNKNOWN;
    return inside;
}

fn crossing_by_paper() -> u32 {
    any_known = false;
    // The occurrences of the leaf, in order.
    let words = clip_leaf(own_leaf);
    for (var i = tables[words + 4u]; i < tables[words + 5u]; i++) {
        if !is_clipped(tables[i]) {
            // Where all is unknown the surfel is whole, if its centre is on the result.
            if !any_known && far[view.disks + clip_disk * ROWS_A_DISK + 1u].w == 0.0 {
                return NO_CROSSING;
            }
            return select(RISES, FALLS, tables[paper_node(tables[i]) + 2u] != 0u);
        }
    }
    return NO_CROSSING;
}

// Partners know no crossings, and no surfaces that coincide.
fn is_inside_at_peel(leaf: u32) -> bool {
    return false;
}

fn coincides(field: FieldAt) -> bool {
    return false;
}

fn side(leaf: u32) -> bool {
    if asks_partners {
        return side_by_partners(leaf);
    }
    return side_by_field(leaf);
}

// How the result changes where the ray of the hit meets the edge surfel with view `id`, `tau` behind its reference depth.
fn edge_crossing(id: u32, tau: f32) -> u32 {
    let e = at_reference(hit_ray, id) + hit_ray.dir * tau;
    clip_point = view.axes[0].xyz * e.x + view.axes[1].xyz * e.y + view.axes[2].xyz * e.z;
    clip_disk = disk_of(own_leaf, own_index);
    clip_centre = far[view.disks + clip_disk * ROWS_A_DISK].xyz;
    clip_centre_rest = far[view.disks + clip_disk * ROWS_A_DISK + 1u].xyz;
    if tables[view.clip + CLIP_PAPER] != NONE {
        return crossing_by_paper();
    }
    asks_partners = true;
    let crossing = crossing_of(views[id].kind);
    asks_partners = false;
    return crossing;
}
