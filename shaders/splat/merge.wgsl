// The twin of SampleMerger in src/layers.rs: joins what the samples of a pixel see, one sample after the other.

@group(0) @binding(0) var<uniform> view: SplatView;
@group(0) @binding(1) var<storage, read_write> hits: array<Hit>;
// What the current sample sees; at last what all do.
@group(0) @binding(2) var<storage, read_write> pixels: array<atomic<u32>>;
// By pixel: the first hit of all samples so far.
@group(0) @binding(3) var<storage, read_write> merged: array<u32>;

const NONE: u32 = 0xffffffffu;

fn number_of_pixels() -> u32 {
    return (view.rect.z - view.rect.x) * (view.rect.w - view.rect.y);
}

fn is_there(hit: u32) -> bool {
    // Where the pool was too small the lists are traced anew, and what is found here does not count.
    return hit < view.room.y;
}

// Puts `after` behind `before`, or at the beginning.
fn link(pixel: u32, before: u32, after: u32) {
    if before == NONE {
        merged[pixel] = after;
    } else {
        hits[before].next = after;
    }
}

// Adds a hit to the record of the samples before, whose running mean it keeps.
fn join(record: u32, hit: u32) {
    let bits = u32(abs(hits[record].seen));
    let share = 1.0 / f32(countOneBits(bits) + 1u);
    hits[record].t += (hits[hit].t - hits[record].t) * share;
    hits[record].normal += (hits[hit].normal - hits[record].normal) * share;
    hits[record].opacity += (hits[hit].opacity - hits[record].opacity) * share;
    hits[record].colour += (hits[hit].colour - hits[record].colour) * share;
    hits[record].seen = sign(hits[record].seen) * i32(bits | view.samples);
}

// A driver that ends loops after so many steps leaves them without a word: then these steps are too many as well.
fn note_unfinished() {
    var step = 0u;
    while step < 2u + view.has_supports {
        step++;
    }
    if step < 2u {
        atomicStore(&pixels[UNFINISHED], 1u);
    }
}

@compute @workgroup_size(WORKGROUP)
fn merge_sample(thread: Thread) {
    let pixel = thread_number(thread);
    if pixel >= number_of_pixels() {
        return;
    }
    if pixel == 0u {
        // The next sample takes groups from the first on.
        atomicMax(&pixels[GROUPS_MOST], atomicExchange(&pixels[GROUPS_NEEDED], 0u));
    }
    if view.samples == 1u {
        merged[pixel] = NONE;
    }
    // What comes next in the list is put, or looked for, behind here.
    var before = NONE;
    var hit = atomicLoad(&pixels[FIRST_PIXEL + pixel]);
    while is_there(hit) {
        let next = hits[hit].next;
        let is_last = view.nearest_only != 0u && hits[hit].opacity >= 1.0;
        var record = merged[pixel];
        if before != NONE {
            record = hits[before].next;
        }
        let first = record;
        while is_there(record) {
            let is_same = hits[record].leaf == hits[hit].leaf && hits[record].body == hits[hit].body
                && sign(hits[record].seen) == sign(hits[hit].seen)
                && (u32(abs(hits[record].seen)) & view.samples) == 0u;
            if is_same {
                break;
            }
            record = hits[record].next;
        }
        if is_there(record) {
            join(record, hit);
            before = record;
        } else {
            hits[hit].next = first;
            link(pixel, before, hit);
            before = hit;
        }
        hit = select(next, NONE, is_last);
    }
    note_unfinished();
}

// Sorts the records by their mean depths, and hands them over as the pixel's list.
@compute @workgroup_size(WORKGROUP)
fn finish_merge(thread: Thread) {
    let pixel = thread_number(thread);
    if pixel >= number_of_pixels() {
        return;
    }
    var record = merged[pixel];
    merged[pixel] = NONE;
    // The record that was put last.
    var newest = NONE;
    while is_there(record) {
        let next = hits[record].next;
        let square = dot(hits[record].normal, hits[record].normal);
        if square > 0.0 {
            hits[record].normal /= sqrt(square);
        }
        // Behind all that are not deeper.
        var before = NONE;
        var after = merged[pixel];
        // Most come behind the one before: means of depths are nearly sorted.
        if newest != NONE {
            if hits[newest].t <= hits[record].t {
                before = newest;
                after = hits[newest].next;
            }
        }
        while is_there(after) {
            if hits[after].t > hits[record].t {
                break;
            }
            before = after;
            after = hits[after].next;
        }
        hits[record].next = after;
        link(pixel, before, record);
        newest = record;
        record = next;
    }
    atomicStore(&pixels[FIRST_PIXEL + pixel], merged[pixel]);
    note_unfinished();
}
