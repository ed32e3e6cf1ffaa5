// Each pixel's hits: a list, front to back, in a pool that all pixels share. See src/splat/hits.rs for what is kept of it.

@group(0) @binding(8) var<storage, read_write> hits: array<Hit>;

// The pixel's hit that was put into its list last; NONE before the first.
var<private> newest: u32;

// A hit with which others may coincide is not decided but kept: `seen` says so, and whether the ray enters the leaf and the surface
// shows; `normal` is the leaf's outward one, and `body` the bits of the surfel's radius.
fn as_tied(hit: Hit, radius: f32, enters: bool, shows: bool) -> Hit {
    var tied = hit;
    tied.body = bitcast<u32>(radius);
    tied.seen = i32(TIED | select(0u, TIED_ENTERS, enters) | select(0u, TIED_SHOWS, shows));
    return tied;
}

// Whether a hit is kept so, where `flag` is TIED, and whether it has the flag, where it is.
fn tied_flag(hit: u32, flag: u32) -> bool {
    return hits[hit].seen > 0 && (u32(hits[hit].seen) & flag) != 0u;
}

// A place for another hit; NONE where the pool has no room, which is counted, so that the next one has.
fn new_hit() -> u32 {
    let place = atomicAdd(&pixels[HITS_NEEDED], 1u);
    return select(NONE, place, place < view.room.y);
}

// Puts the hit at `place` into the pixel's list; one that two groups found twice counts once. Crossings, which have no `own_leaf`,
// cannot be found twice: equal ones are two that rounding made so.
fn link(pixel: u32, place: u32) {
    let t = hits[place].t;
    let leaf = hits[place].leaf;
    var before = NONE;
    var after = atomicLoad(&pixels[FIRST_PIXEL + pixel]);
    // Most hits come behind the one before.
    if newest != NONE {
        if hits[newest].t < t {
            before = newest;
            after = hits[newest].next;
        }
    }
    while after != NONE {
        if own_leaf != NONE && hits[after].t == t && hits[after].leaf == leaf && hits[after].seen == hits[place].seen {
            return;
        }
        if hits[after].t > t || (hits[after].t == t && hits[after].leaf > leaf) {
            break;
        }
        before = after;
        after = hits[after].next;
    }
    hits[place].next = after;
    newest = place;
    if before != NONE {
        hits[before].next = place;
    } else {
        atomicStore(&pixels[FIRST_PIXEL + pixel], place);
    }
}

// Adds a hit to the pixel's list.
fn insert(pixel: u32, hit: Hit) {
    let place = new_hit();
    if place == NONE {
        return;
    }
    hits[place] = hit;
    link(pixel, place);
}
