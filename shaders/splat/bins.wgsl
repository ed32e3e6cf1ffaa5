// The twin of src/splat/bins.rs: the surfels of every block of pixels.

@group(0) @binding(0) var<uniform> view: SplatView;
@group(0) @binding(1) var<storage, read> views: array<SurfelView>;
// How many members each list has, or where its next one goes.
@group(0) @binding(2) var<storage, read_write> next: array<atomic<u32>>;
@group(0) @binding(3) var<storage, read_write> members: array<u32>;
@group(0) @binding(4) var<storage, read> starts: array<u32>;

// First column and row of the blocks that surfel `id` may touch, and those past the last.
fn blocks_of(id: u32) -> vec4<u32> {
    if views[id].kind == KIND_UNNEEDED {
        return vec4<u32>();
    }
    let b = views[id].bounds;
    let least = (vec2<f32>(b.x, b.z) - view.margin_px) / f32(BLOCK) - vec2<f32>(view.grid.xy);
    let most = (vec2<f32>(b.y, b.w) + view.margin_px) / f32(BLOCK) - vec2<f32>(view.grid.xy);
    // Infinite bounds become the grid's.
    let size = vec2<f32>(view.grid.zw);
    let first = vec2<u32>(clamp(floor(least), vec2<f32>(), size));
    let end = vec2<u32>(clamp(floor(most) + 1.0, vec2<f32>(), size));
    return vec4<u32>(first, end);
}

fn list_of(id: u32, x: u32, y: u32) -> u32 {
    return (y * view.grid.z + x) * LISTS + select(1u, 0u, (views[id].owner & MAY_ENTER) != 0u);
}

@compute @workgroup_size(WORKGROUP)
fn bin_count(thread: Thread) {
    let id = thread_number(thread);
    if id >= view.views {
        return;
    }
    let blocks = blocks_of(id);
    for (var y = blocks.y; y < blocks.w; y++) {
        for (var x = blocks.x; x < blocks.z; x++) {
            atomicAdd(&next[list_of(id, x, y)], 1u);
        }
    }
}

@compute @workgroup_size(WORKGROUP)
fn bin_fill(thread: Thread) {
    let id = thread_number(thread);
    if id >= view.views {
        return;
    }
    let blocks = blocks_of(id);
    for (var y = blocks.y; y < blocks.w; y++) {
        for (var x = blocks.x; x < blocks.z; x++) {
            members[atomicAdd(&next[list_of(id, x, y)], 1u)] = id;
        }
    }
}

fn put_in_order(start: u32, count: u32, a: u32, b: u32) {
    if b < count {
        let first = members[start + a];
        let second = members[start + b];
        if first > second {
            members[start + a] = second;
            members[start + b] = first;
        }
    }
}

// Sorts one list by a bitonic network whose every step puts the lesser number first, so that a list of any length is one of the
// next power of two whose end is missing (Batcher 1968).
@compute @workgroup_size(WORKGROUP)
fn bin_sort(thread: Thread) {
    let list = thread.group.y * thread.groups.x + thread.group.x;
    var start = 0u;
    var count = 0u;
    if list + 1u < arrayLength(&starts) {
        start = starts[list];
        count = starts[list + 1u] - start;
    }
    for (var run = 2u; run < 2u * count; run *= 2u) {
        // Mirrored halves, so that both become one run that rises and falls.
        for (var pair = thread.local; pair < (count + run) / 2u; pair += WORKGROUP) {
            let block = pair / (run / 2u) * run;
            let place = pair % (run / 2u);
            put_in_order(start, count, block + place, block + run - 1u - place);
        }
        storageBarrier();
        for (var reach = run / 4u; reach > 0u; reach /= 2u) {
            for (var pair = thread.local; pair < (count + run) / 2u; pair += WORKGROUP) {
                let first = pair / reach * 2u * reach + pair % reach;
                put_in_order(start, count, first, first + reach);
            }
            storageBarrier();
        }
    }
}
