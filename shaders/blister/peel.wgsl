// Blister's own way: layer by layer, every pass draws everything. Twin of nothing on the CPU; what a layer means is in resolve.wgsl.

struct Control {
    // Boundaries found over all pixels.
    length: atomic<u32>,
    // Pixels that want another layer.
    waiting: atomic<u32>,
    // Pixels that were passed over, summed over the layers.
    rejected: atomic<u32>,
    // Passes that found active pixels.
    passes: u32,
    // Pixels whose layer needed no test, summed over the layers.
    known: atomic<u32>,
}

// Arguments of the passes that follow, which do nothing once no pixel is active.
struct Arguments {
    triangles: vec4<u32>,
    fragments: vec4<u32>,
    groups: vec4<u32>,
}

@group(0) @binding(14) var<storage, read_write> pixels: array<PeelPixel>;
// By pixel and word: memberships before the layer.
@group(0) @binding(15) var<storage, read_write> states: array<atomic<u32>>;
// By pixel and word: what toggles at the layer; then, as many words on, sheets that are there, and solids that do not show there.
@group(0) @binding(16) var<storage, read_write> toggles: array<atomic<u32>>;
// The first surface of each boundary's owner.
@group(0) @binding(17) var<storage, read_write> kept_surfaces: array<atomic<u32>>;
@group(0) @binding(18) var<storage, read_write> boundaries: array<KeptBoundary>;
@group(0) @binding(19) var<storage, read_write> control: Control;
@group(0) @binding(20) var depth: texture_depth_2d;
@group(0) @binding(21) var<storage, read_write> arguments: Arguments;

// A key as a whole number, larger nearer, whose bits are those of a float from 0 to 1: so the depth buffer keeps all of them.
fn order_of(key: f32) -> u32 {
    let bits = bitcast<u32>(abs(key));
    let order = select(LAST_KEY - min(bits, LAST_KEY), max(bits, FIRST_KEY) - FIRST_KEY, frame.is_perspective != 0u);
    return clamp(order, 1u, LAST_KEY - FIRST_KEY);
}

fn key_of(order: u32) -> f32 {
    return select(-bitcast<f32>(LAST_KEY - order), bitcast<f32>(order + FIRST_KEY), frame.is_perspective != 0u);
}

// Where the superset begins and ends.
@fragment
fn bound_fragment(drawn: Drawn) -> @location(0) vec4<f32> {
    let at = vec2<u32>(drawn.position.xy);
    let pixel = at.y * frame.size.x + at.x;
    let order = order_of(key_of_drawn(drawn, at));
    if (slots[slot_of_drawn(drawn)].flags & SLOT_IN_SUPERSET) == 0u {
        return vec4<f32>(0.0);
    }
    atomicMax(&states[2u * pixel], order);
    atomicMax(&states[2u * pixel + 1u], ALL_ORDERS - order);
    return vec4<f32>(0.0);
}

// Begins every pixel, with the bounds in `states`, or without.
@compute @workgroup_size(WORKGROUP)
fn begin_pixels(thread: Thread) {
    let pixel = thread_number(thread);
    if pixel >= pixel_count() {
        return;
    }
    var begun = PeelPixel(ALL_ORDERS, 0u, 0u, NO_SLOT, NO_SLOT, NO_SLOT, 0u, 0u);
    if frame.is_bounded != 0u {
        begun.front = atomicLoad(&states[2u * pixel]);
        begun.back = ALL_ORDERS - atomicLoad(&states[2u * pixel + 1u]);
        begun.is_done = u32(begun.front == 0u);
    }
    pixels[pixel] = begun;
}

struct Peeled {
    @builtin(frag_depth) depth: f32,
    @location(0) nothing: vec4<f32>,
}

// Notes the surface of the boundary that the last layer had.
fn note_surface(pixel: u32, order: u32, drawn: Drawn) {
    if order == pixels[pixel].kept_order && slot_of_drawn(drawn) == pixels[pixel].kept_owner {
        atomicMin(&kept_surfaces[pixels[pixel].kept_place], drawn.surface);
    }
}

// Toggles what is at the layer.
fn note_toggle(pixel: u32, slot: u32, surface: u32) {
    let word = word_of(slot);
    if is_sheet(slot) {
        atomicOr(&toggles[2u * WORDS * pixel + WORDS + word], bit_of(slot));
        return;
    }
    atomicXor(&toggles[2u * WORDS * pixel + word], bit_of(slot));
    if (surfaces[surface].flags & SURFACE_HIDDEN) != 0u {
        atomicOr(&toggles[2u * WORDS * pixel + WORDS + word], bit_of(slot));
    }
}

// Counts what is at the layer or beyond: closed leaves are out beyond their last crossing. Half-spaces have another beginning.
fn note_parity(pixel: u32, slot: u32, order: u32) {
    let counts = select(order <= pixels[pixel].front, order > pixels[pixel].front, is_endless(slot));
    if counts && !is_sheet(slot) {
        atomicXor(&states[WORDS * pixel + word_of(slot)], bit_of(slot));
    }
}

// Toggles the fragments of the layer, and finds the next among those behind it.
@fragment
fn running_fragment(drawn: Drawn) -> Peeled {
    let at = vec2<u32>(drawn.position.xy);
    let pixel = at.y * frame.size.x + at.x;
    let order = order_of(key_of_drawn(drawn, at));
    note_surface(pixel, order, drawn);
    if pixels[pixel].is_done != 0u || order > pixels[pixel].front {
        discard;
    }
    if order == pixels[pixel].front {
        note_toggle(pixel, slot_of_drawn(drawn), drawn.surface);
        discard;
    }
    return Peeled(bitcast<f32>(order), vec4<f32>(0.0));
}

// The first pass of the running way: where rays are before the first layer, beside what later passes do.
@fragment
fn first_fragment(drawn: Drawn) -> Peeled {
    let at = vec2<u32>(drawn.position.xy);
    let pixel = at.y * frame.size.x + at.x;
    let order = order_of(key_of_drawn(drawn, at));
    if pixels[pixel].is_done != 0u {
        discard;
    }
    note_parity(pixel, slot_of_drawn(drawn), order);
    if order == pixels[pixel].front {
        note_toggle(pixel, slot_of_drawn(drawn), drawn.surface);
    }
    if order >= pixels[pixel].front {
        discard;
    }
    return Peeled(bitcast<f32>(order), vec4<f32>(0.0));
}

// The next layer, and nothing else.
@fragment
fn peel_fragment(drawn: Drawn) -> Peeled {
    let at = vec2<u32>(drawn.position.xy);
    let pixel = at.y * frame.size.x + at.x;
    let order = order_of(key_of_drawn(drawn, at));
    note_surface(pixel, order, drawn);
    if pixels[pixel].is_done != 0u || order >= pixels[pixel].front {
        discard;
    }
    return Peeled(bitcast<f32>(order), vec4<f32>(0.0));
}

// The paper's parity test of a layer: everything at it or beyond, from the beginning.
@fragment
fn parity_fragment(drawn: Drawn) -> @location(0) vec4<f32> {
    let at = vec2<u32>(drawn.position.xy);
    let pixel = at.y * frame.size.x + at.x;
    if pixels[pixel].is_done != 0u {
        return vec4<f32>(0.0);
    }
    let order = order_of(key_of_drawn(drawn, at));
    // Inside a product every leaf is where the product wants it: no need to count (Blueprint, Nienhaus et al. 2006, section 4.4).
    if pixels[pixel].is_known == 0u {
        note_parity(pixel, slot_of_drawn(drawn), order);
    }
    if order == pixels[pixel].front {
        note_toggle(pixel, slot_of_drawn(drawn), drawn.surface);
    }
    return vec4<f32>(0.0);
}

// Decides the layer of one pixel, and appends its boundary. Returns whether the result is entered or goes on there.
fn classify(pixel: u32, at: vec2<u32>) -> bool {
    let front = pixels[pixel].front;
    pixels[pixel].kept_order = NO_SLOT;
    var has_sheet = false;
    var several = 0u;
    for (var word = 0u; word < WORDS; word++) {
        let toggled = atomicLoad(&toggles[2u * WORDS * pixel + word]);
        before[word] = atomicLoad(&states[WORDS * pixel + word]);
        after[word] = before[word] ^ toggled;
        several += countOneBits(toggled);
        has_sheet = has_sheet || atomicLoad(&toggles[2u * WORDS * pixel + WORDS + word]) != 0u;
    }
    let was = eval_before();
    let is = eval_after();
    var owner = NO_SLOT;
    var behind = NO_SLOT;
    var is_front = is;
    if is != was {
        owner = owner_of_toggles(is, several > 1u);
        behind = owner;
        if is_in_after(owner) != is {
            behind = body(is);
            behind = select(behind, owner, behind == NO_SLOT);
        }
        let unseen = atomicLoad(&toggles[2u * WORDS * pixel + WORDS + word_of(owner)]);
        if (unseen & bit_of(owner)) != 0u {
            owner = NO_SLOT;
        }
    } else if has_sheet {
        owner = sheet_of_layer(pixel, was, is);
        behind = owner;
        is_front = true;
    }
    for (var word = 0u; word < WORDS; word++) {
        atomicStore(&states[WORDS * pixel + word], after[word]);
        atomicStore(&toggles[2u * WORDS * pixel + word], 0u);
        atomicStore(&toggles[2u * WORDS * pixel + WORDS + word], 0u);
    }
    if owner == NO_SLOT {
        return is;
    }
    let place = atomicAdd(&control.length, 1u);
    if place < arrayLength(&boundaries) {
        boundaries[place] = KeptBoundary(pixel, pixels[pixel].count, key_of(front), behind, u32(is_front), 0u);
        atomicStore(&kept_surfaces[place], NO_SLOT);
        pixels[pixel].kept_order = front;
        pixels[pixel].kept_owner = owner;
        pixels[pixel].kept_place = place;
    }
    pixels[pixel].count++;
    if frame.is_nearest != 0u && slots[owner].opacity >= 1.0 {
        pixels[pixel].is_done = 1u;
    }
    return is;
}

// Of the slots that toggle the one with the best claim; of equal ones the first.
fn owner_of_toggles(is: bool, several: bool) -> u32 {
    var best = 4u;
    var owner = NO_SLOT;
    for (var word = 0u; word < WORDS; word++) {
        var rest = before[word] ^ after[word];
        while rest != 0u {
            let slot = 32u * word + firstTrailingBit(rest);
            rest &= rest - 1u;
            var own = 0u;
            if several {
                own = claim(slot, is);
            }
            if own < best {
                best = own;
                owner = slot;
            }
        }
    }
    return owner;
}

fn sheet_of_layer(pixel: u32, was: bool, is: bool) -> u32 {
    for (var word = 0u; word < WORDS; word++) {
        var rest = atomicLoad(&toggles[2u * WORDS * pixel + WORDS + word]);
        while rest != 0u {
            let slot = 32u * word + firstTrailingBit(rest);
            rest &= rest - 1u;
            if is_sheet(slot) && ((!was && eval_before_turned(slot)) || (!is && eval_after_turned(slot))) {
                return slot;
            }
        }
    }
    return NO_SLOT;
}

fn begin_half_spaces(pixel: u32, at: vec2<u32>) {
    for (var slot = 0u; frame.endless > 0u && slot < frame.slots; slot++) {
        if is_endless(slot) && begins_inside(slot, at) {
            atomicXor(&states[WORDS * pixel + word_of(slot)], bit_of(slot));
        }
    }
}

// Ends a pass of the running way: decides the layer whose fragments toggled, and goes on to the next.
@compute @workgroup_size(WORKGROUP)
fn running_layer(thread: Thread) {
    let pixel = thread_number(thread);
    if pixel >= pixel_count() {
        return;
    }
    if pixels[pixel].is_done != 0u {
        pixels[pixel].kept_order = NO_SLOT;
        if control.passes > 0u {
            atomicAdd(&control.rejected, 1u);
        }
        return;
    }
    let at = vec2<u32>(pixel % frame.size.x, pixel / frame.size.x);
    if control.passes == 0u {
        begin_half_spaces(pixel, at);
    }
    if pixels[pixel].front != ALL_ORDERS {
        _ = classify(pixel, at);
    }
    go_on(pixel, at);
}

// Ends a parity pass: decides the layer.
@compute @workgroup_size(WORKGROUP)
fn parity_layer(thread: Thread) {
    let pixel = thread_number(thread);
    if pixel >= pixel_count() {
        return;
    }
    pixels[pixel].kept_order = NO_SLOT;
    if pixels[pixel].is_done != 0u {
        atomicAdd(&control.rejected, 1u);
        return;
    }
    let at = vec2<u32>(pixel % frame.size.x, pixel / frame.size.x);
    if pixels[pixel].is_known == 0u {
        begin_half_spaces(pixel, at);
    } else {
        atomicAdd(&control.known, 1u);
    }
    let is_inside = classify(pixel, at);
    pixels[pixel].is_known = u32(is_inside && frame.is_product != 0u);
    // Any other layer is counted from the beginning.
    for (var word = 0u; word < WORDS && pixels[pixel].is_known == 0u; word++) {
        atomicStore(&states[WORDS * pixel + word], 0u);
    }
    if pixels[pixel].is_done == 0u || pixels[pixel].kept_order != NO_SLOT {
        atomicAdd(&control.waiting, 1u);
    }
}

// Ends a pass that looked for the next layer of the parity way.
@compute @workgroup_size(WORKGROUP)
fn peel_layer(thread: Thread) {
    let pixel = thread_number(thread);
    if pixel >= pixel_count() {
        return;
    }
    if pixels[pixel].is_done == 0u {
        go_on(pixel, vec2<u32>(pixel % frame.size.x, pixel / frame.size.x));
    }
}

// Moves a pixel to the layer that the depth buffer holds; done where there is none, or it is behind the superset.
fn go_on(pixel: u32, at: vec2<u32>) {
    let next = bitcast<u32>(textureLoad(depth, at, 0));
    pixels[pixel].front = next;
    if next == 0u || next < pixels[pixel].back {
        pixels[pixel].is_done = 1u;
    }
    if pixels[pixel].is_done == 0u || pixels[pixel].kept_order != NO_SLOT {
        atomicAdd(&control.waiting, 1u);
    }
}

// Decides whether there is anything for the next pass to do.
@compute @workgroup_size(1)
fn next_pass(thread: Thread) {
    let is_waiting = atomicLoad(&control.waiting) != 0u;
    atomicStore(&control.waiting, 0u);
    if is_waiting {
        control.passes += 1u;
    } else {
        arguments.triangles.x = 0u;
        arguments.fragments.x = 0u;
        arguments.groups.x = 0u;
    }
}

// Puts every boundary where its pixel's begin.
@compute @workgroup_size(WORKGROUP)
fn place_boundaries(thread: Thread) {
    let number = thread_number(thread);
    if number >= min(atomicLoad(&control.length), arrayLength(&boundaries)) {
        return;
    }
    let own = boundaries[number];
    let surface = atomicLoad(&kept_surfaces[number]);
    sorted[offsets[own.pixel] + own.number] = Survivor(own.key, surface, own.body, own.is_front);
}

// How many boundaries each pixel has.
@compute @workgroup_size(WORKGROUP)
fn count_boundaries(thread: Thread) {
    let pixel = thread_number(thread);
    if pixel < pixel_count() {
        kept[pixel] = pixels[pixel].count;
    }
}
