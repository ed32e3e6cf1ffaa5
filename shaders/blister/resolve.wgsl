// Twin of blister/peel.rs and survivors.rs: a pixel's fragments, front to back, into the boundaries of the result.

// How many boundaries each pixel has.
@group(0) @binding(9) var<storage, read_write> kept: array<u32>;

fn is_nearer(a: Survivor, b: Survivor) -> bool {
    // Of equal keys the first surface.
    return a.key > b.key || (a.key == b.key && a.surface < b.surface);
}

// Sinks the fragment at `root` of the heap that is `first` to `end`: the furthest is on top.
fn sink(first: u32, root: u32, end: u32) {
    var at = root;
    let own = sorted[first + root];
    loop {
        var child = 2u * at + 1u;
        if first + child >= end {
            break;
        }
        if first + child + 1u < end && is_nearer(sorted[first + child], sorted[first + child + 1u]) {
            child++;
        }
        if !is_nearer(own, sorted[first + child]) {
            break;
        }
        sorted[first + at] = sorted[first + child];
        at = child;
    }
    sorted[first + at] = own;
}

// Puts a pixel's fragments in order, nearest first.
fn sort(first: u32, end: u32) {
    let count = end - first;
    if count <= INSERTION_SORTED {
        for (var i = first + 1u; i < end; i++) {
            let own = sorted[i];
            var at = i;
            while at > first && is_nearer(own, sorted[at - 1u]) {
                sorted[at] = sorted[at - 1u];
                at--;
            }
            sorted[at] = own;
        }
        return;
    }
    for (var root = count / 2u; root > 0u; root--) {
        sink(first, root - 1u, end);
    }
    for (var last = end - 1u; last > first; last--) {
        let furthest = sorted[first];
        sorted[first] = sorted[last];
        sorted[last] = furthest;
        sink(first, 0u, last);
    }
}

// The boundaries of a pixel take the places of its first fragments: each is of one at least.
@compute @workgroup_size(WORKGROUP)
fn resolve(thread: Thread) {
    let pixel = thread_number(thread);
    if pixel >= pixel_count() {
        return;
    }
    let first = offsets[pixel];
    let end = offsets[pixel + 1u];
    if first == end {
        kept[pixel] = 0u;
        return;
    }
    sort(first, end);
    // Beyond the last crossing every closed leaf is out, so their parity is where the ray begins.
    for (var word = 0u; word < WORDS; word++) {
        after[word] = 0u;
    }
    for (var i = first; i < end; i++) {
        let slot = sorted[i].slot;
        if (slots[slot].flags & (SLOT_SHEET | SLOT_ENDLESS)) == 0u {
            after[word_of(slot)] ^= bit_of(slot);
        }
    }
    let at = vec2<u32>(pixel % frame.size.x, pixel / frame.size.x);
    for (var slot = 0u; frame.endless > 0u && slot < frame.slots; slot++) {
        if is_endless(slot) && begins_inside(slot, at) {
            after[word_of(slot)] |= bit_of(slot);
        }
    }
    var was = eval_after();
    var found = 0u;
    var i = first;
    while i < end {
        // A peel: all fragments of the same key.
        let key = sorted[i].key;
        let peel = i;
        var has_sheet = false;
        for (var word = 0u; word < WORDS; word++) {
            before[word] = after[word];
        }
        while i < end && sorted[i].key == key {
            let slot = sorted[i].slot;
            if is_sheet(slot) {
                has_sheet = true;
            } else {
                after[word_of(slot)] ^= bit_of(slot);
            }
            i++;
        }
        let is = eval_after();
        var owner = NO_SLOT;
        var behind = NO_SLOT;
        var is_front = is;
        if is != was {
            owner = sorted[peel].slot;
            if i - peel > 1u {
                owner = owner_of_peel(peel, i, is);
            }
            behind = owner;
            if is_in_after(owner) != is {
                // The owner cuts. The result is inside behind a front, and before a back.
                behind = body(is);
                behind = select(behind, owner, behind == NO_SLOT);
            }
        } else if has_sheet {
            owner = sheet_of_peel(peel, i, was, is);
            behind = owner;
            is_front = true;
        }
        was = is;
        if owner == NO_SLOT {
            continue;
        }
        // The owner's first surface: sorted that way.
        var surface = sorted[peel].surface;
        for (var member = peel; member < i; member++) {
            if sorted[member].slot == owner {
                surface = sorted[member].surface;
                break;
            }
        }
        if (surfaces[surface].flags & SURFACE_HIDDEN) != 0u {
            continue;
        }
        sorted[first + found] = Survivor(key, surface, behind, u32(is_front));
        found++;
        if frame.is_nearest != 0u && slots[owner].opacity >= 1.0 {
            break;
        }
    }
    kept[pixel] = found;
}

// Of the slots that the peel toggles the one with the best claim; of equal ones the first.
fn owner_of_peel(first: u32, end: u32, is: bool) -> u32 {
    var best = 4u;
    var owner = NO_SLOT;
    for (var member = first; member < end; member++) {
        let slot = sorted[member].slot;
        if is_in_before(slot) == is_in_after(slot) {
            continue;
        }
        let own = claim(slot, is);
        if own < best || (own == best && slot < owner) {
            best = own;
            owner = slot;
        }
    }
    return owner;
}

// The first of the peel's sheets that shows: the result would have it there if it were a solid, and does not otherwise.
fn sheet_of_peel(first: u32, end: u32, was: bool, is: bool) -> u32 {
    var shown = NO_SLOT;
    for (var member = first; member < end; member++) {
        let slot = sorted[member].slot;
        if is_sheet(slot) && slot < shown
            && ((!was && eval_before_turned(slot)) || (!is && eval_after_turned(slot))) {
            shown = slot;
        }
    }
    return shown;
}
