// Every boundary that the central sample sees, with the slope of its tangent plane: the twin of composite::facets.

@group(0) @binding(1) var<storage, read> offsets: array<u32>;
@group(0) @binding(2) var<storage, read> records: array<LayerRecord>;
@group(0) @binding(3) var<storage, read> leaves: array<LeafPaint>;
@group(0) @binding(4) var<storage, read_write> facet_counts: array<u32>;
@group(0) @binding(5) var<storage, read> facet_offsets: array<u32>;
@group(0) @binding(6) var<storage, read_write> facets: array<Facet>;

fn is_central(mask: u32) -> bool {
    return (view.samples == 1u) | ((mask >> view.central_sample & 1u) == 1u);
}

// How many facets each pixel has.
@compute @workgroup_size(WORKGROUP)
fn count_facets(thread: Thread) {
    let place = thread_number(thread);
    if place >= part_area() {
        return;
    }
    var count = 0u;
    for (var i = offsets[place]; i < offsets[place + 1u]; i++) {
        count += select(0u, 1u, is_central(records[i].samples));
    }
    facet_counts[place] = count;
}

// The facets themselves.
@compute @workgroup_size(WORKGROUP)
fn make_facets(thread: Thread) {
    let place = thread_number(thread);
    if place >= part_area() {
        return;
    }
    let ray = ray_at(part_pixel(place));
    var next = facet_offsets[place];
    for (var i = offsets[place]; i < offsets[place + 1u]; i++) {
        let record = records[i];
        if !is_central(record.samples) {
            continue;
        }
        var facet: Facet;
        facet.normal = record.normal;
        facet.depth = record.depth;
        facet.step = steps(record.normal, ray);
        facet.px_per_unit = px_per_unit_at(record.depth);
        facet.marks = select(0u, IS_FRONT, record.facing > 0);
        if record.leaf < arrayLength(&leaves) {
            facet.marks |= leaves[record.leaf].known & IS_HEAVY;
        }
        facets[next] = facet;
        next += 1u;
    }
}
