// Twin of blister/peel.rs and survivors.rs: a pixel's fragments, front to back, into the boundaries of the result.

// How many boundaries each pixel has.
@group(0) @binding(9) var<storage, read_write> kept: array<u32>;

// By pixel: its first fragment, plus one; and then its first boundary.
@group(0) @binding(13) var<storage, read_write> firsts: array<u32>;

// The pixels that `resolve_single` leaves to `resolve_rest`: how many, and which.
@group(0) @binding(27) var<storage, read_write> rest: array<atomic<u32>>;
// Workgroups for them.
@group(0) @binding(28) var<storage, read_write> rest_groups: array<atomic<u32>, 3>;

// The leaf of a fragment.
fn slot_of_node(node: u32) -> u32 {
    return nodes[node - 1u].slot & SLOT_NUMBER;
}

fn toggle_after(slot: u32) {
    after[word_of(slot)] ^= bit_of(slot);
}

fn toggle_if_closed(slot: u32) {
    if (slot & (FRAGMENT_SHEET | FRAGMENT_ENDLESS)) == 0u {
        toggle_after(slot & SLOT_NUMBER);
    }
}

// Half-spaces that the pixel's ray begins inside of.
fn begin_endless(pixel: u32) {
    if HAS_ENDLESS == 0u {
        return;
    }
    let at = vec2<u32>(pixel % frame.size.x, pixel / frame.size.x);
    for (var slot = 0u; slot < frame.slots; slot++) {
        if is_endless(slot) && begins_inside(slot, at) {
            after[word_of(slot)] |= bit_of(slot);
        }
    }
}

// Of a peel that toggles `owner`: whose material is behind.
fn behind_of(owner: u32, is: bool) -> u32 {
    if is_in_after(owner) == is {
        return owner;
    }
    // The owner cuts. The result is inside behind a front, and before a back.
    let behind = body(is);
    return select(behind, owner, behind == NO_SLOT);
}

// A fragment in registers; none where `node` is 0.
struct Held {
    key: f32,
    // With FRAGMENT_…
    slot: u32,
    // Plus one.
    node: u32,
}

// Leaves the nearer of both in `held`, and the other in `carried`.
fn settle(held: ptr<function, Held>, carried: ptr<function, Held>) {
    let a = *held;
    let b = *carried;
    let is_nearer = b.node != 0u && (a.node == 0u || b.key > a.key);
    *held = Held(select(a.key, b.key, is_nearer), select(a.slot, b.slot, is_nearer), select(a.node, b.node, is_nearer));
    *carried = Held(select(b.key, a.key, is_nearer), select(b.slot, a.slot, is_nearer), select(b.node, a.node, is_nearer));
}

// How many fragments are held at once.
const HELD = 8u;

// Pixels that have one boundary at most, and few fragments: the nearest are held in registers, in order, and the expression is asked
// front to back until it is known what shows. Pixels with long lists, and those where what shows is decided between coincident
// fragments or by sheets, are left to `resolve_rest`: code for them costs time here even where no pixel needs it.
@compute @workgroup_size(WORKGROUP)
fn resolve_single(thread: Thread) {
    let pixel = thread_number(thread);
    if pixel >= pixel_count() {
        return;
    }
    let head = firsts[pixel];
    if head == 0u {
        kept[pixel] = 0u;
        return;
    }
    resolve_nearest(pixel, head);
    if is_cut_short_within(2u + (head & 1u)) {
        atomicMax(&length[1], CUT_SHORT);
    }
}

// Of a pixel whose list begins at `head`.
fn resolve_nearest(pixel: u32, head: u32) {
    for (var word = 0u; word < WORDS; word++) {
        after[word] = 0u;
    }
    var was = false;
    var is_begun = false;
    var is_left = false;
    // The key of the last peel that was taken: all that is nearer was, too.
    var last_taken = 0.0;
    // What shows.
    var shown = Held();
    var is_front = false;
    loop {
        // Step 1: the nearest that were not taken.
        var held_0 = Held();
        var held_1 = Held();
        var held_2 = Held();
        var held_3 = Held();
        var held_4 = Held();
        var held_5 = Held();
        var held_6 = Held();
        var held_7 = Held();
        var walked = 0u;
        var waiting = 0u;
        var node = head;
        while node != 0u && walked < MOST_WALKED {
            walked++;
            var carried = Held(nodes[node - 1u].key, nodes[node - 1u].slot, node);
            node = nodes[node - 1u].next;
            if !is_begun {
                toggle_if_closed(carried.slot);
            } else if !(carried.key < last_taken) {
                continue;
            }
            waiting++;
            settle(&held_0, &carried);
            settle(&held_1, &carried);
            settle(&held_2, &carried);
            settle(&held_3, &carried);
            settle(&held_4, &carried);
            settle(&held_5, &carried);
            settle(&held_6, &carried);
            settle(&held_7, &carried);
        }
        if !is_begun {
            // Beyond the last crossing every closed leaf is out, so their parity is where the ray begins.
            begin_endless(pixel);
            was = eval_after();
            is_begun = true;
        }
        // Step 2: front to back. A peel that may go on beyond what is held waits for the next round.
        let has_more = waiting > HELD;
        let edge = held_7.key;
        is_left = node != 0u || (has_more && held_0.key == edge);
        var members = 0u;
        var has_sheet = false;
        while !is_left && shown.node == 0u && held_0.node != 0u && !(has_more && held_0.key == edge) {
            let own = held_0;
            held_0 = held_1;
            held_1 = held_2;
            held_2 = held_3;
            held_3 = held_4;
            held_4 = held_5;
            held_5 = held_6;
            held_6 = held_7;
            held_7 = Held();
            if (own.slot & FRAGMENT_SHEET) != 0u {
                has_sheet = true;
            } else {
                toggle_after(own.slot & SLOT_NUMBER);
            }
            members++;
            // A peel: all fragments of the same key.
            if held_0.node != 0u && held_0.key == own.key {
                continue;
            }
            last_taken = own.key;
            let is = eval_after();
            if is != was || has_sheet {
                is_left = members > 1u || has_sheet;
                if (own.slot & FRAGMENT_HIDDEN) == 0u {
                    shown = own;
                    is_front = is;
                }
            }
            was = is;
            members = 0u;
            has_sheet = false;
        }
        if is_left || shown.node != 0u || !has_more {
            break;
        }
    }
    if is_left {
        let place = atomicAdd(&rest[0], 1u);
        atomicStore(&rest[place + 1u], pixel);
        // Where there are more than groups in a row, threads take several.
        if place % WORKGROUP == 0u && place / WORKGROUP < MOST_GROUPS {
            atomicAdd(&rest_groups[0], 1u);
        }
        return;
    }
    kept[pixel] = u32(shown.node != 0u);
    if shown.node == 0u {
        return;
    }
    let owner = shown.slot & SLOT_NUMBER;
    for (var word = 0u; word < WORDS; word++) {
        before[word] = after[word];
    }
    before[word_of(owner)] ^= bit_of(owner);
    firsts[pixel] = shown.node;
    nodes[shown.node - 1u].slot = behind_of(owner, is_front) | select(0u, BOUNDARY_FRONT, is_front);
}

@compute @workgroup_size(WORKGROUP)
fn resolve_rest(thread: Thread) {
    let count = atomicLoad(&rest[0]);
    for (var number = thread_number(thread); number < count; number += MOST_GROUPS * WORKGROUP) {
        resolve_pixel(atomicLoad(&rest[number + 1u]));
    }
    if is_cut_short() {
        atomicMax(&length[1], CUT_SHORT);
    }
}

@compute @workgroup_size(WORKGROUP)
fn resolve(thread: Thread) {
    let pixel = thread_number(thread);
    if pixel >= pixel_count() {
        return;
    }
    resolve_pixel(pixel);
    if is_cut_short() {
        atomicMax(&length[1], CUT_SHORT);
    }
}

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
fn resolve_pixel(pixel: u32) {
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
        toggle_if_closed(nodes[node - 1u].slot);
    }
    begin_endless(pixel);
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
            if (slot & FRAGMENT_SHEET) != 0u {
                has_sheet = true;
            } else {
                toggle_after(slot & SLOT_NUMBER);
            }
            members++;
            node = nodes[node - 1u].next;
        }
        let is = eval_after();
        var owner = NO_SLOT;
        var behind = NO_SLOT;
        var is_front = is;
        if is != was {
            owner = slot_of_node(peel);
            if members > 1u {
                owner = owner_of_peel(peel, node, is);
            }
            behind = behind_of(owner, is);
        } else if HAS_SHEETS != 0u && has_sheet {
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
        while slot_of_node(shown) != owner {
            shown = nodes[shown - 1u].next;
        }
        let what = nodes[shown - 1u].slot;
        if (what & FRAGMENT_HIDDEN) != 0u {
            continue;
        }
        let surface = nodes[shown - 1u].surface;
        // Its place is the peel's first, whose members are not looked at again.
        nodes[peel - 1u] = Fragment(key, surface, behind | select(0u, BOUNDARY_FRONT, is_front), 0u);
        if last_kept == 0u {
            firsts[pixel] = peel;
        } else {
            nodes[last_kept - 1u].next = peel;
        }
        last_kept = peel;
        found++;
        if frame.is_nearest != 0u && (what & FRAGMENT_OPAQUE) != 0u {
            break;
        }
    }
    kept[pixel] = found;
}

// Of the slots that the peel toggles the one with the best claim; of equal ones the first.
fn owner_of_peel(first: u32, end: u32, is: bool) -> u32 {
    var best = 4u;
    var owner = NO_SLOT;
    for (var member = first; member != end; member = nodes[member - 1u].next) {
        let slot = slot_of_node(member);
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
        let slot = slot_of_node(member);
        if is_sheet(slot) && slot < shown
            && ((!was && eval_before_turned(slot)) || (!is && eval_after_turned(slot))) {
            shown = slot;
        }
    }
    return shown;
}
