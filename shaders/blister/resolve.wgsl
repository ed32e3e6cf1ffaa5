// Twin of blister/peel.rs and survivors.rs: a pixel's fragments, front to back, into the boundaries of the result.

// How many boundaries each pixel has.
@group(0) @binding(9) var<storage, read_write> kept: array<u32>;

// By pixel: its first fragment, plus one; and then its first boundary.
@group(0) @binding(13) var<storage, read_write> firsts: array<u32>;

// Whether fragment `a` comes before `b`, both plus one: of equal keys the first surface.
fn is_before(a: u32, b: u32) -> bool {
    let key_a = nodes[a - 1u].key;
    let key_b = nodes[b - 1u].key;
    return key_a > key_b || (key_a == key_b && nodes[a - 1u].surface < nodes[b - 1u].surface);
}

// Puts a list in order, nearest first, by merging runs that double: no place is needed but the links.
fn sort(head: u32) -> u32 {
    var list = head;
    var run = 1u;
    loop {
        var left = list;
        var tail = 0u;
        var merges = 0u;
        list = 0u;
        while left != 0u {
            merges++;
            // Two runs: from `left`, and from what comes after it.
            var right = left;
            var left_count = 0u;
            while left_count < run && right != 0u {
                left_count++;
                right = nodes[right - 1u].next;
            }
            var right_count = run;
            while left_count > 0u || (right_count > 0u && right != 0u) {
                var taken = left;
                if left_count == 0u || (right_count > 0u && right != 0u && is_before(right, left)) {
                    taken = right;
                    right = nodes[right - 1u].next;
                    right_count--;
                } else {
                    left = nodes[left - 1u].next;
                    left_count--;
                }
                if tail == 0u {
                    list = taken;
                } else {
                    nodes[tail - 1u].next = taken;
                }
                tail = taken;
            }
            left = right;
        }
        nodes[tail - 1u].next = 0u;
        if merges <= 1u {
            return list;
        }
        run *= 2u;
    }
    return list;
}

// Boundaries take the places of fragments: each is of one at least.
@compute @workgroup_size(WORKGROUP)
fn resolve(thread: Thread) {
    let pixel = thread_number(thread);
    if pixel >= pixel_count() {
        return;
    }
    if firsts[pixel] == 0u {
        kept[pixel] = 0u;
        return;
    }
    let head = sort(firsts[pixel]);
    // Beyond the last crossing every closed leaf is out, so their parity is where the ray begins.
    for (var word = 0u; word < WORDS; word++) {
        after[word] = 0u;
    }
    for (var node = head; node != 0u; node = nodes[node - 1u].next) {
        let slot = nodes[node - 1u].slot;
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
    // The fragment whose place the last boundary took, plus one.
    var last_kept = 0u;
    var node = head;
    while node != 0u {
        // A peel: all fragments of the same key.
        let key = nodes[node - 1u].key;
        let peel = node;
        var members = 0u;
        var has_sheet = false;
        for (var word = 0u; word < WORDS; word++) {
            before[word] = after[word];
        }
        // The first is a member whatever its key, so that the list gets shorter.
        while node != 0u && (node == peel || nodes[node - 1u].key == key) {
            let slot = nodes[node - 1u].slot;
            if is_sheet(slot) {
                has_sheet = true;
            } else {
                after[word_of(slot)] ^= bit_of(slot);
            }
            members++;
            node = nodes[node - 1u].next;
        }
        let is = eval_after();
        var owner = NO_SLOT;
        var behind = NO_SLOT;
        var is_front = is;
        if is != was {
            owner = nodes[peel - 1u].slot;
            if members > 1u {
                owner = owner_of_peel(peel, node, is);
            }
            behind = owner;
            if is_in_after(owner) != is {
                // The owner cuts. The result is inside behind a front, and before a back.
                behind = body(is);
                behind = select(behind, owner, behind == NO_SLOT);
            }
        } else if has_sheet {
            owner = sheet_of_peel(peel, node, was, is);
            behind = owner;
            is_front = true;
        }
        was = is;
        if owner == NO_SLOT {
            continue;
        }
        // The owner's first surface: sorted that way.
        var shown = peel;
        while nodes[shown - 1u].slot != owner {
            shown = nodes[shown - 1u].next;
        }
        let surface = nodes[shown - 1u].surface;
        if (surfaces[surface].flags & SURFACE_HIDDEN) != 0u {
            continue;
        }
        // Its place is the peel's first, whose members are not looked at again.
        nodes[peel - 1u] = Fragment(key, surface, behind | select(0u, BOUNDARY_FRONT, is_front), 0u);
        if last_kept == 0u {
            firsts[pixel] = peel;
        } else {
            nodes[last_kept - 1u].next = peel;
        }
        last_kept = peel;
        found++;
        if frame.is_nearest != 0u && slots[owner].opacity >= 1.0 {
            break;
        }
    }
    kept[pixel] = found;
    if is_cut_short() {
        atomicMax(&length[1], CUT_SHORT);
    }
}

// Of the slots that the peel toggles the one with the best claim; of equal ones the first.
fn owner_of_peel(first: u32, end: u32, is: bool) -> u32 {
    var best = 4u;
    var owner = NO_SLOT;
    for (var member = first; member != end; member = nodes[member - 1u].next) {
        let slot = nodes[member - 1u].slot;
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
    for (var member = first; member != end; member = nodes[member - 1u].next) {
        let slot = nodes[member - 1u].slot;
        if is_sheet(slot) && slot < shown
            && ((!was && eval_before_turned(slot)) || (!is && eval_after_turned(slot))) {
            shown = slot;
        }
    }
    return shown;
}
