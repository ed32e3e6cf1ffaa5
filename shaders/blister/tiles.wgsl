// Twin of blister/raster.rs and peel.rs in one kernel: a workgroup is a tile, a thread a pixel, which looks through the tile's
// triangles once for each layer. Nothing is stored but boundaries, so nothing can be too much.

// Where each tile's pieces are, two numbers each; from `frame.single_offsets` on, by pixel of the band, where its single fragments
// begin, which no triangle has; and from `frame.singles` on their pieces.
@group(0) @binding(22) var<storage, read> places: array<u32>;
@group(0) @binding(23) var<storage, read> pieces: array<Piece>;
@group(0) @binding(24) var<storage, read_write> tile_boundaries: array<TileBoundary>;

// What a look through a pixel's pieces has found.
struct Next {
    key: f32,
    // Fragments that have it.
    count: u32,
    // The first of them.
    slot: u32,
    surface: u32,
    piece: u32,
}

var<private> next: Next;

fn slot_of(number: u32) -> u32 {
    return pieces[number].slot & ~PIECE_HIDDEN;
}

fn key_of_piece(number: u32, within: vec2<f32>) -> f32 {
    let key = pieces[number].key;
    return clamp(fma(key.x, within.x, fma(key.y, within.y, key.z)), pieces[number].low, pieces[number].high);
}

fn covers(number: u32, within: vec2<i32>) -> bool {
    let a = pieces[number].a;
    let b = pieces[number].b;
    let c = pieces[number].c;
    // Each is the edge's value at the tile's corner, and what a pixel to the right and one down add.
    return ((a.x + a.y * within.x + a.z * within.y) | (b.x + b.y * within.x + b.z * within.y)
        | (c.x + c.y * within.x + c.z * within.y)) >= 0;
}

// Takes a fragment for the next layer where it is the nearest so far.
fn look_at(number: u32, key: f32, last: f32) {
    if key >= last || key < next.key {
        return;
    }
    if key > next.key {
        next = Next(key, 1u, slot_of(number), pieces[number].surface, number);
        return;
    }
    next.count++;
    if pieces[number].surface < next.surface {
        next.slot = slot_of(number);
        next.surface = pieces[number].surface;
        next.piece = number;
    }
}

// Toggles one of several fragments of a layer.
fn toggle(number: u32) {
    let slot = slot_of(number);
    if !is_sheet(slot) {
        after[word_of(slot)] ^= bit_of(slot);
    }
}

fn is_closed(slot: u32) -> bool {
    return (slots[slot].flags & (SLOT_SHEET | SLOT_ENDLESS)) == 0u;
}

// Where a pixel's single fragments are.
fn singles_of(at: vec2<u32>) -> vec2<u32> {
    if frame.singles == 0u {
        return vec2<u32>(0u);
    }
    let pixel = frame.single_offsets + at.y * frame.size.x + at.x;
    return vec2<u32>(places[pixel], places[pixel + 1u]);
}

fn single(number: u32) -> u32 {
    return places[frame.singles + number];
}

@compute @workgroup_size(WORKGROUP)
fn resolve_tiles(thread: Thread) {
    let number = group_number(thread);
    let first_tile = frame.origin / TILE;
    let tiles_here = (frame.origin + frame.size + TILE - 1u) / TILE - first_tile;
    if number >= tiles_here.x * tiles_here.y {
        return;
    }
    let tile = first_tile + vec2<u32>(number % tiles_here.x, number / tiles_here.x);
    let local = vec2<u32>(thread.local % TILE, thread.local / TILE);
    let whole = tile * TILE + local;
    if any(whole < frame.origin) || any(whole >= frame.origin + frame.size) {
        return;
    }
    let at = whole - frame.origin;
    let pixel = at.y * frame.size.x + at.x;
    let range = 2u * (tile.y * frame.tiles_across + tile.x);
    let first = places[range];
    let own = singles_of(at);
    kept[pixel] = peel_pixel(pixel, at, vec2<i32>(local), first, first + places[range + 1u], own.x, own.y);
}

// The boundaries of one pixel; returns how many there are.
fn peel_pixel(pixel: u32, at: vec2<u32>, within: vec2<i32>, first: u32, end: u32, first_single: u32, end_single: u32) -> u32 {
    let within_f = vec2<f32>(within);
    for (var word = 0u; word < WORDS; word++) {
        after[word] = 0u;
    }
    // Beyond the last crossing every closed leaf is out, so their parity is where the ray begins.
    next = Next(NO_KEY, 0u, NO_SLOT, NO_SLOT, NO_SLOT);
    for (var i = first; i < end; i++) {
        if covers(i, within) {
            let slot = slot_of(i);
            if is_closed(slot) {
                after[word_of(slot)] ^= bit_of(slot);
            }
            look_at(i, key_of_piece(i, within_f), ALL_KEYS);
        }
    }
    for (var i = first_single; i < end_single; i++) {
        let slot = slot_of(single(i));
        if is_closed(slot) {
            after[word_of(slot)] ^= bit_of(slot);
        }
        look_at(single(i), key_of_piece(single(i), within_f), ALL_KEYS);
    }
    for (var slot = 0u; frame.endless > 0u && slot < frame.slots; slot++) {
        if is_endless(slot) && begins_inside(slot, at) {
            after[word_of(slot)] |= bit_of(slot);
        }
    }
    if next.count == 0u && !is_cut_short() {
        return 0u;
    }
    var was = eval_after();
    var found = 0u;
    loop {
        for (var word = 0u; word < WORDS; word++) {
            before[word] = after[word];
        }
        let layer = next;
        next = Next(NO_KEY, 0u, NO_SLOT, NO_SLOT, NO_SLOT);
        var shown = layer.slot;
        if layer.count == 1u {
            if !is_sheet(layer.slot) {
                after[word_of(layer.slot)] ^= bit_of(layer.slot);
            }
        } else {
            // All that coincide toggle together.
            for (var i = first; i < end; i++) {
                if covers(i, within) && key_of_piece(i, within_f) == layer.key {
                    toggle(i);
                }
            }
            for (var i = first_single; i < end_single; i++) {
                if key_of_piece(single(i), within_f) == layer.key {
                    toggle(single(i));
                }
            }
        }
        let is = eval_after();
        var owner = NO_SLOT;
        var behind = NO_SLOT;
        var is_front = is;
        if is != was {
            owner = layer.slot;
            if layer.count > 1u {
                owner = owner_of_changes(is);
            }
            behind = owner;
            if is_in_after(owner) != is {
                behind = body(is);
                behind = select(behind, owner, behind == NO_SLOT);
            }
        } else if layer.count > 1u || is_sheet(layer.slot) {
            owner = first_sheet(within, layer.key, first, end, first_single, end_single, was, is);
            behind = owner;
            is_front = true;
        }
        was = is;
        if owner != NO_SLOT {
            var piece = layer.piece;
            if layer.count > 1u {
                piece = first_piece(within, layer.key, first, end, first_single, end_single, owner);
            }
            if (pieces[piece].slot & PIECE_HIDDEN) == 0u {
                keep_boundary(pixel, found, layer.key, pieces[piece].surface, behind, is_front);
                found++;
                if frame.is_nearest != 0u && slots[owner].opacity >= 1.0 {
                    break;
                }
            }
        }
        for (var i = first; i < end; i++) {
            if covers(i, within) {
                look_at(i, key_of_piece(i, within_f), layer.key);
            }
        }
        for (var i = first_single; i < end_single; i++) {
            look_at(single(i), key_of_piece(single(i), within_f), layer.key);
        }
        if next.count == 0u {
            break;
        }
    }
    if is_cut_short() {
        atomicMax(&length[1], CUT_SHORT);
    }
    return found;
}

fn keep_boundary(pixel: u32, number: u32, key: f32, surface: u32, behind: u32, is_front: bool) {
    // Where there is at most one a pixel it has its place; others have to find one.
    var place = pixel;
    if frame.is_single == 0u {
        place = atomicAdd(&length[0], 1u);
    }
    if place < arrayLength(&tile_boundaries) {
        tile_boundaries[place] = TileBoundary(pixel, number, key, surface, behind, u32(is_front));
    }
}

// Puts every boundary where its pixel's begin.
@compute @workgroup_size(WORKGROUP)
fn place_tile_boundaries(thread: Thread) {
    let number = thread_number(thread);
    if number >= min(atomicLoad(&length[0]), arrayLength(&tile_boundaries)) {
        return;
    }
    let own = tile_boundaries[number];
    sorted[offsets[own.pixel] + own.number] = Survivor(own.key, own.surface, own.body, own.is_front);
}

// As `write`, for the only boundary that a pixel can have.
@compute @workgroup_size(WORKGROUP)
fn write_single(thread: Thread) {
    let pixel = thread_number(thread);
    if pixel >= pixel_count() {
        return;
    }
    let place = record_offsets[pixel];
    if record_offsets[pixel + 1u] > place {
        let own = tile_boundaries[pixel];
        let at = vec2<u32>(pixel % frame.size.x, pixel / frame.size.x);
        write_record(place, at, Survivor(own.key, own.surface, own.body, own.is_front));
    }
}

// Of the slots that toggle the one with the best claim; of equal ones the first.
fn owner_of_changes(is: bool) -> u32 {
    return owner_of_toggles(is, true);
}

// The first sheet at the layer that shows.
fn first_sheet(within: vec2<i32>, key: f32, first: u32, end: u32, first_single: u32, end_single: u32, was: bool, is: bool) -> u32 {
    var shown = NO_SLOT;
    for (var i = first; i < end + (end_single - first_single); i++) {
        var number = i;
        if i >= end {
            number = single(first_single + i - end);
        }
        let slot = slot_of(number);
        if is_sheet(slot) && slot < shown && (i >= end || covers(i, within))
            && key_of_piece(number, vec2<f32>(within)) == key
            && ((!was && eval_before_turned(slot)) || (!is && eval_after_turned(slot))) {
            shown = slot;
        }
    }
    return shown;
}

// The piece of a leaf's first surface at the layer.
fn first_piece(within: vec2<i32>, key: f32, first: u32, end: u32, first_single: u32, end_single: u32, slot: u32) -> u32 {
    var surface = NO_SLOT;
    var piece = first;
    for (var i = first; i < end + (end_single - first_single); i++) {
        var number = i;
        if i >= end {
            number = single(first_single + i - end);
        }
        if slot_of(number) == slot && pieces[number].surface < surface && (i >= end || covers(i, within))
            && key_of_piece(number, vec2<f32>(within)) == key {
            surface = pieces[number].surface;
            piece = number;
        }
    }
    return piece;
}
