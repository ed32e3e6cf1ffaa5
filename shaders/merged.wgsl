// The twin of src/layers/merged.rs: the records of several sources, merged by depth. A thread is a pixel.

@group(0) @binding(0) var<uniform> merging: Merging;
// By source and pixel, one more than there are pixels for a source: where the pixel's records begin among the source's.
@group(0) @binding(1) var<storage, read> starts: array<u32>;
// By source: where its records begin among all.
@group(0) @binding(2) var<storage, read> firsts: array<u32>;
// All sources' records, source by source.
@group(0) @binding(3) var<storage, read> records: array<LayerRecord>;
// By pixel, as many as there are sources: the next record of a source that has one left, and where they end.
@group(0) @binding(4) var<storage, read_write> queues: array<vec2<u32>>;
@group(0) @binding(5) var<storage, read_write> offsets: array<u32>;
@group(0) @binding(6) var<storage, read_write> merged: array<LayerRecord>;
// Whether a thread's loops were cut short.
@group(0) @binding(7) var<storage, read_write> unfinished: atomic<u32>;

// Whether record `a` comes before `b` along the ray. Of equals the earlier source's does, whose place is lower.
fn comes_first(a: u32, b: u32) -> bool {
    if records[a].depth != records[b].depth {
        return records[a].depth < records[b].depth;
    }
    if records[a].facing != records[b].facing {
        return records[a].facing < records[b].facing;
    }
    if records[a].leaf != records[b].leaf {
        return records[a].leaf < records[b].leaf;
    }
    if records[a].body != records[b].body {
        return records[a].body < records[b].body;
    }
    return a < b;
}

// A driver that ends loops after so many steps leaves them without a word: then these steps are too many as well. There are at
// least two sources, which compilers do not know.
fn note_unfinished() {
    var step = 0u;
    while step < min(merging.sources, 2u) {
        step++;
    }
    if step < 2u {
        atomicStore(&unfinished, 1u);
    }
}

@compute @workgroup_size(WORKGROUP)
fn merge_layers(thread: Thread) {
    let pixel = thread_number(thread);
    if pixel > merging.pixels {
        return;
    }
    // Sums of records before a pixel add up, source by source: nothing has to be counted.
    var place = 0u;
    let first_queue = pixel * merging.sources;
    var left = 0u;
    for (var source = 0u; source < merging.sources; source++) {
        let at = source * (merging.pixels + 1u) + pixel;
        place += starts[at];
        if pixel < merging.pixels {
            let queue = firsts[source] + vec2<u32>(starts[at], starts[at + 1u]);
            if queue.x < queue.y {
                queues[first_queue + left] = queue;
                left++;
            }
        }
    }
    offsets[pixel] = place;
    while left > 0u {
        var best = first_queue;
        for (var queue = first_queue + 1u; queue < first_queue + left; queue++) {
            if comes_first(queues[queue].x, queues[best].x) {
                best = queue;
            }
        }
        let queue = queues[best];
        merged[place] = records[queue.x];
        place++;
        if queue.x + 1u < queue.y {
            queues[best].x = queue.x + 1u;
        } else {
            left--;
            queues[best] = queues[first_queue + left];
        }
    }
    note_unfinished();
}
