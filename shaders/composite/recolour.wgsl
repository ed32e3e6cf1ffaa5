// A style's opacity, cut colours and number of layers: the twin of composite::recolour and, with
// section.wgsl, of layers::limit::first_layers.

@group(0) @binding(1) var<storage, read> offsets: array<u32>;
@group(0) @binding(2) var<storage, read> records: array<LayerRecord>;
@group(0) @binding(3) var<uniform> changes: Changes;
@group(0) @binding(4) var<storage, read> leaves: array<LeafPaint>;
// How many records each pixel keeps; their sums once that is known.
@group(0) @binding(5) var<storage, read_write> kept: array<u32>;
@group(0) @binding(6) var<storage, read> kept_offsets: array<u32>;
@group(0) @binding(7) var<storage, read_write> changed: array<LayerRecord>;

// What the samples of a pixel met so far.
struct Depths {
    met: array<u32, MAX_SAMPLES>,
}

// The samples to which a boundary seen by `mask` is one of the nearest that are drawn.
fn pass_by(depths: ptr<function, Depths>, mask: u32) -> u32 {
    var rest = seen_by(mask);
    var left = 0u;
    while rest != 0u {
        let sample = firstTrailingBit(rest);
        rest &= rest - 1u;
        if (*depths).met[sample] < changes.most {
            left |= 1u << sample;
        }
        (*depths).met[sample] += 1u;
    }
    return left;
}

// How many boundaries of each pixel are left.
@compute @workgroup_size(WORKGROUP)
fn count_kept(thread: Thread) {
    let place = thread_number(thread);
    if place >= part_area() {
        return;
    }
    var depths: Depths;
    var count = 0u;
    for (var i = offsets[place]; i < offsets[place + 1u]; i++) {
        count += select(0u, 1u, pass_by(&depths, records[i].samples) != 0u);
    }
    kept[place] = count;
}

fn recoloured(was: LayerRecord) -> LayerRecord {
    var record = was;
    record.opacity *= changes.opacity;
    // No branch by a uniform alone: see `px_per_unit_at`.
    let is_cut = record.leaf != record.body;
    if is_cut & (changes.cut == CUT_LEAF) & (record.body < arrayLength(&leaves)) {
        if (leaves[record.body].known & KNOWS_COLOUR) != 0u {
            record.colour = leaves[record.body].colour;
        }
    }
    record.colour = select(record.colour, changes.cut_colour, is_cut & (changes.cut == CUT_SET));
    return record;
}

// The boundaries that are left, changed.
@compute @workgroup_size(WORKGROUP)
fn recolour(thread: Thread) {
    let place = thread_number(thread);
    if place >= part_area() {
        return;
    }
    var depths: Depths;
    var next = kept_offsets[place];
    for (var i = offsets[place]; i < offsets[place + 1u]; i++) {
        let record = records[i];
        let left = pass_by(&depths, record.samples);
        if left != 0u {
            changed[next] = hatched(recoloured(record), part_pixel(place));
            changed[next].samples = left;
            next += 1u;
        }
    }
}
