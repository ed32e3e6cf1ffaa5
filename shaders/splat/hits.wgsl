// The twin of src/splat/hits.rs: from a pixel's list of hits to its records.

@group(0) @binding(0) var<uniform> view: SplatView;
@group(0) @binding(1) var<storage, read> views: array<SurfelView>;
@group(0) @binding(2) var<storage, read> members: array<u32>;
@group(0) @binding(3) var<storage, read> starts: array<u32>;
@group(0) @binding(4) var<storage, read> hits: array<Hit>;
@group(0) @binding(5) var<storage, read> pixels: array<u32>;
@group(0) @binding(6) var<storage, read_write> offsets: array<u32>;
@group(0) @binding(7) var<storage, read_write> records: array<LayerRecord>;

const NONE: u32 = 0xffffffffu;

fn number_of_pixels() -> u32 {
    return (view.rect.z - view.rect.x) * (view.rect.w - view.rect.y);
}

// Whether nothing behind a hit is wanted.
fn ends_at(hit: u32) -> bool {
    return view.nearest_only != 0u && hits[hit].opacity >= 1.0;
}

@compute @workgroup_size(WORKGROUP)
fn count_hits(thread: Thread) {
    let pixel = thread_number(thread);
    if pixel > number_of_pixels() {
        return;
    }
    var count = 0u;
    if pixel < number_of_pixels() {
        var hit = pixels[FIRST_PIXEL + pixel];
        while hit != NONE {
            count++;
            hit = select(hits[hit].next, NONE, ends_at(hit));
        }
    }
    offsets[pixel] = count;
}

@compute @workgroup_size(WORKGROUP)
fn write_records(thread: Thread) {
    let pixel = thread_number(thread);
    if pixel >= number_of_pixels() {
        return;
    }
    let width = view.rect.z - view.rect.x;
    let px = view.rect.xy + vec2<u32>(pixel % width, pixel / width);
    let aside = px / BLOCK - view.grid.xy;
    let block = aside.y * view.grid.z + aside.x;
    let first = starts[block * LISTS];
    let anchor = select(vec2<f32>(), views[members[first]].depth, first < starts[(block + 1u) * LISTS]);
    var hit = pixels[FIRST_PIXEL + pixel];
    var place = offsets[pixel];
    while hit != NONE {
        let seen = hits[hit];
        var record: LayerRecord;
        let n = seen.normal;
        record.normal = view.axes[0].xyz * n.x + view.axes[1].xyz * n.y + view.axes[2].xyz * n.z;
        record.depth = anchor.x + (anchor.y + seen.t);
        record.colour = seen.colour;
        record.opacity = seen.opacity;
        record.leaf = seen.leaf;
        record.body = seen.body;
        record.facing = sign(seen.seen);
        record.samples = u32(abs(seen.seen));
        records[place] = record;
        place++;
        hit = select(seen.next, NONE, ends_at(hit));
    }
}
