// Twin of blister/frame/crossings.rs: every crossing of a pixel's ray, front to back, and where rays begin. Nothing is classified.

// By pixel and word: the leaves that the ray begins inside of.
@group(0) @binding(25) var<storage, read_write> begins: array<u32>;
@group(0) @binding(26) var<storage, read_write> crossings: array<CrossingRecord>;

fn dir_at(at: vec2<u32>) -> vec3<f32> {
    let whole = vec2<f32>(at + frame.origin);
    return frame.first_dir + frame.dir_across * whole.x + frame.dir_down * whole.y;
}

// Sorts and counts a pixel's fragments, and marks those that enter their leaf.
@compute @workgroup_size(WORKGROUP)
fn order_crossings(thread: Thread) {
    let pixel = thread_number(thread);
    if pixel >= pixel_count() {
        return;
    }
    let at = vec2<u32>(pixel % frame.size.x, pixel / frame.size.x);
    var head = 0u;
    if firsts[pixel] != 0u {
        head = sort(firsts[pixel]);
        firsts[pixel] = head;
    }
    // Beyond the last crossing every closed leaf is out, so their parity is where the ray begins.
    for (var word = 0u; word < WORDS; word++) {
        after[word] = 0u;
    }
    var count = 0u;
    for (var node = head; node != 0u; node = nodes[node - 1u].next) {
        toggle_if_closed(nodes[node - 1u].slot);
        count++;
    }
    kept[pixel] = count;
    begin_endless(pixel);
    for (var word = 0u; word < frame.begins_words; word++) {
        begins[pixel * frame.begins_words + word] = 0u;
    }
    for (var word = 0u; word < WORDS; word++) {
        for (var rest = after[word]; rest != 0u; rest &= rest - 1u) {
            let leaf = slots[word * 32u + firstTrailingBit(rest)].leaf;
            begins[pixel * frame.begins_words + leaf / LEAVES_A_WORD] |= 1u << (leaf % LEAVES_A_WORD);
        }
    }
    for (var node = head; node != 0u; node = nodes[node - 1u].next) {
        let slot = slot_of_node(node);
        toggle_after(slot);
        var enters = is_in_after(slot);
        if is_endless(slot) {
            enters = dot(surfaces[nodes[node - 1u].surface].normal, dir_at(at)) < 0.0;
        }
        nodes[node - 1u].slot = slot | select(0u, BOUNDARY_FRONT, enters);
    }
    if is_cut_short() {
        atomicMax(&length[1], CUT_SHORT);
    }
}

// Fewer turns than the kernel before took for a pixel.
@compute @workgroup_size(WORKGROUP)
fn write_crossings(thread: Thread) {
    let pixel = thread_number(thread);
    if pixel >= pixel_count() {
        return;
    }
    let at = vec2<u32>(pixel % frame.size.x, pixel / frame.size.x);
    let end = record_offsets[pixel + 1u];
    var node = firsts[pixel];
    for (var place = record_offsets[pixel]; place < end; place++) {
        let own = nodes[node - 1u];
        let slot = own.slot & ~BOUNDARY_FRONT;
        let surface = surfaces[own.surface];
        var crossing: CrossingRecord;
        crossing.normal = surface.normal;
        crossing.depth = depth_of(own.key);
        crossing.colour = colour_of(own.surface, at);
        crossing.opacity = slots[slot].opacity;
        crossing.leaf = slots[slot].leaf;
        crossing.flags = select(0u, CROSSING_ENTERS, (own.slot & BOUNDARY_FRONT) != 0u)
            | select(CROSSING_SHOWS, 0u, (surface.flags & SURFACE_HIDDEN) != 0u);
        crossings[place] = crossing;
        node = own.next;
    }
}
