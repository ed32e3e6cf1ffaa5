// Twin of blister/write.rs: what survived, as records of layers.

// Boundaries by pixel, and where each pixel's begin.
@group(0) @binding(6) var<storage, read> offsets: array<u32>;
@group(0) @binding(8) var<storage, read_write> sorted: array<Survivor>;
// Where each pixel's records begin.
@group(0) @binding(10) var<storage, read> record_offsets: array<u32>;
@group(0) @binding(11) var<storage, read_write> records: array<LayerRecord>;
// Of triangles, three each.
@group(0) @binding(12) var<storage, read> corners: array<PlacedCorner>;

fn slot_of_surface(surface: u32) -> u32 {
    return surfaces[surface].slot & SLOT_NUMBER;
}

fn linear_from_srgb(channel: f32) -> f32 {
    return select(pow((channel + 0.055) / 1.055, 2.4), channel / 12.92, channel <= 0.04045);
}

fn unpacked(colour: u32) -> vec3<f32> {
    let srgb = unpack4x8unorm(colour).xyz;
    return vec3<f32>(linear_from_srgb(srgb.x), linear_from_srgb(srgb.y), linear_from_srgb(srgb.z));
}

// The colours of a triangle's corners, mixed linearly over the surface: on the picture, by the corners' keys.
fn mixed_colour(surface: u32, at: vec2<u32>) -> vec3<f32> {
    let p = vec2<f32>(at + frame.origin) + 0.5;
    let a = vec2<f32>(corners[3u * surface].x, corners[3u * surface].y) - p;
    let b = vec2<f32>(corners[3u * surface + 1u].x, corners[3u * surface + 1u].y) - p;
    let c = vec2<f32>(corners[3u * surface + 2u].x, corners[3u * surface + 2u].y) - p;
    var weights = vec3<f32>(b.x * c.y - b.y * c.x, c.x * a.y - c.y * a.x, a.x * b.y - a.y * b.x);
    if frame.is_perspective != 0u {
        let key = surfaces[surface].key.xy;
        let here = key_at(surfaces[surface].key, surfaces[surface].anchor, surfaces[surface].range, at);
        // Keys at the corners; the plane's, as at the fragment.
        weights *= vec3<f32>(here + dot(key, a), here + dot(key, b), here + dot(key, c));
    }
    let sum = weights.x + weights.y + weights.z;
    if !(abs(sum) > 0.0) {
        return slots[slot_of_surface(surface)].colour;
    }
    weights = max(weights / sum, vec3<f32>(0.0));
    let colours = surfaces[surface].colour;
    return weights.x * unpacked(colours.x) + weights.y * unpacked(colours.y) + weights.z * unpacked(colours.z);
}

fn colour_of(surface: u32, at: vec2<u32>) -> vec3<f32> {
    if HAS_COLOURS != 0u {
        let flags = surfaces[surface].flags;
        if (flags & SURFACE_OWN_COLOUR) != 0u {
            return bitcast<vec3<f32>>(surfaces[surface].colour);
        }
        if (flags & SURFACE_CORNER_COLOURS) != 0u {
            return mixed_colour(surface, at);
        }
    }
    return slots[slot_of_surface(surface)].colour;
}

fn depth_of(key: f32) -> f32 {
    return select(-key, 1.0 / key, frame.is_perspective != 0u);
}

fn write_record(place: u32, at: vec2<u32>, survivor: Survivor) {
    let whole = vec2<f32>(at + frame.origin);
    let dir = frame.first_dir + frame.dir_across * whole.x + frame.dir_down * whole.y;
    let slot = slot_of_surface(survivor.surface);
    let is_front = survivor.is_front != 0u;
    let normal = surfaces[survivor.surface].normal;
    // Outward from the result: against the ray where it is entered, along it where it is left.
    let is_along = dot(normal, dir) > 0.0;
    var record: LayerRecord;
    record.normal = select(normal, -normal, is_along == is_front);
    record.depth = depth_of(survivor.key);
    record.colour = colour_of(survivor.surface, at);
    record.opacity = slots[slot].opacity;
    record.leaf = slots[slot].leaf;
    record.body = slots[survivor.slot].leaf;
    record.facing = select(-1, 1, is_front);
    record.samples = frame.samples;
    records[place] = record;
}

// As `write`, of what `resolve` left in the lists.
@compute @workgroup_size(WORKGROUP)
fn write_list(thread: Thread) {
    let pixel = thread_number(thread);
    if pixel >= pixel_count() {
        return;
    }
    let at = vec2<u32>(pixel % frame.size.x, pixel / frame.size.x);
    let end = record_offsets[pixel + 1u];
    var node = firsts[pixel];
    for (var place = record_offsets[pixel]; place < end; place++) {
        let own = nodes[node - 1u];
        let is_front = u32((own.slot & BOUNDARY_FRONT) != 0u);
        write_record(place, at, Survivor(own.key, own.surface, own.slot & ~BOUNDARY_FRONT, is_front));
        node = own.next;
    }
}

@compute @workgroup_size(WORKGROUP)
fn write(thread: Thread) {
    let pixel = thread_number(thread);
    if pixel >= pixel_count() {
        return;
    }
    let first = record_offsets[pixel];
    let count = record_offsets[pixel + 1u] - first;
    let at = vec2<u32>(pixel % frame.size.x, pixel / frame.size.x);
    for (var i = 0u; i < count; i++) {
        write_record(first + i, at, sorted[offsets[pixel] + i]);
    }
}
