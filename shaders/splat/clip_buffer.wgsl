// The twin of src/splat/clip_buffer.rs: the surfels that cover each cell of a rectangle of the picture, and the partners that meet
// there. Cells are numbered row by row. A workgroup is a surfel, a thread every so many of the rows that it covers.

// How many surfels cover each cell, or where its next one goes; behind the sum of all, whether loops were cut short.
@group(0) @binding(11) var<storage, read_write> cells: array<atomic<u32>>;
// The surfels of all cells, and where those of each begin.
@group(0) @binding(12) var<storage, read_write> cell_members: array<u32>;
@group(0) @binding(13) var<storage, read> cell_starts: array<u32>;
// How many partners each disk has, or where its next one goes; behind the sum of all, whether loops were cut short.
@group(0) @binding(14) var<storage, read_write> counts_of_disks: array<atomic<u32>>;
@group(0) @binding(15) var<storage, read_write> found: array<u32>;

// Beyond a pixel's thousandth rounding does not reach.
const ROUNDING_PX: f32 = 1e-3;

// The cells of a row or column whose centres may lie between two places of the picture: the first, and the one past the last, of
// those from `first` to `end`.
fn cells_between(low: f32, high: f32, first: u32, end: u32) -> vec2<u32> {
    let least = clamp(ceil(low - 0.5), f32(first), f32(end));
    let most = clamp(floor(high + 0.5), f32(first), f32(end));
    return vec2<u32>(u32(least), u32(most));
}

fn rows_of(id: u32) -> vec2<u32> {
    let b = views[id].bounds;
    return cells_between(b.z - REACH_PX, b.w + REACH_PX, view.rect.y, view.rect.w);
}

// The columns that the surfel covers of a row.
fn columns_of(id: u32, row: u32) -> vec2<u32> {
    let y = f32(row) + 0.5;
    if footprints[id].is_close != 0u {
        let b = views[id].bounds;
        if !(b.z <= y && y <= b.w) {
            return vec2<u32>();
        }
        return cells_between(b.x, b.y, view.rect.x, view.rect.z);
    }
    // Where k is least the drawn ellipse is largest.
    let least_k = 1.0 - footprints[id].depth_reach * footprints[id].inverse_depth;
    let o = footprints[id].outline;
    let v = (y - views[id].middle.z) - views[id].middle.w;
    let square = o.y * o.y * v * v - o.x * (o.z * v * v - 1.0 / (least_k * least_k));
    if !(square >= 0.0) {
        return vec2<u32>();
    }
    let middle = views[id].middle.x + (views[id].middle.y - o.y * v / o.x);
    let half = sqrt(square) / o.x + ROUNDING_PX;
    return cells_between(middle - half, middle + half, view.rect.x, view.rect.z);
}

fn cell_at(column: u32, row: u32) -> u32 {
    return (row - view.rect.y) * (view.rect.z - view.rect.x) + column - view.rect.x;
}

fn leaf_of(id: u32) -> u32 {
    return views[id].owner >> OWNER_SHIFT;
}

// Whether the surfel clips or may be clipped.
fn takes_part(id: u32) -> bool {
    return id < view.views && views[id].kind != KIND_UNNEEDED && is_disk(leaf_of(id), views[id].index);
}

fn check_cells() {
    if are_loops_cut(view.has_supports) {
        atomicStore(&cells[cell_at(view.rect.z - 1u, view.rect.w - 1u) + 2u], 1u);
    }
}

@compute @workgroup_size(WORKGROUP)
fn count_cells(thread: Thread) {
    let id = group_number(thread);
    if !takes_part(id) {
        return;
    }
    let rows = rows_of(id);
    for (var row = rows.x + thread.local; row < rows.y; row += WORKGROUP) {
        let columns = columns_of(id, row);
        for (var column = columns.x; column < columns.y; column++) {
            atomicAdd(&cells[cell_at(column, row)], 1u);
        }
    }
    check_cells();
}

@compute @workgroup_size(WORKGROUP)
fn fill_cells(thread: Thread) {
    let id = group_number(thread);
    if !takes_part(id) {
        return;
    }
    let rows = rows_of(id);
    for (var row = rows.x + thread.local; row < rows.y; row += WORKGROUP) {
        let columns = columns_of(id, row);
        for (var column = columns.x; column < columns.y; column++) {
            cell_members[atomicAdd(&cells[cell_at(column, row)], 1u)] = id;
        }
    }
    check_cells();
}

// Whether an edge surfel accepts another as a partner, distance apart.
fn admits(id: u32, other: u32) -> bool {
    if leaf_of(id) == leaf_of(other) || is_sheet(leaf_of(other)) {
        return false;
    }
    if tables[view.clip + CLIP_PAPER] != NONE {
        return true;
    }
    let residual = views[id].kind;
    for (var i = 1u; i <= tables[residual]; i++) {
        if tables[residual + i] == leaf_of(other) {
            return true;
        }
    }
    return false;
}

fn are_close(disk: u32, other: u32) -> bool {
    let a = view.disks + disk * ROWS_A_DISK;
    let b = view.disks + other * ROWS_A_DISK;
    let between = (far[b].xyz - far[a].xyz) + (far[b + 1u].xyz - far[a + 1u].xyz);
    return length(between) < far[a].w + far[b].w;
}

// Goes through the partners of an edge surfel that it meets in the cells of a thread's rows; writes them down where they are to be
// `kept`. A pair that shares several cells of a row is met in the first of them.
fn meet_partners(id: u32, local: u32, kept: bool) {
    let disk = disk_of(leaf_of(id), views[id].index);
    let rows = rows_of(id);
    for (var row = rows.x + local; row < rows.y; row += WORKGROUP) {
        let columns = columns_of(id, row);
        for (var column = columns.x; column < columns.y; column++) {
            let cell = cell_at(column, row);
            for (var i = cell_starts[cell]; i < cell_starts[cell + 1u]; i++) {
                let other = cell_members[i];
                if !admits(id, other) || column != max(columns.x, columns_of(other, row).x) {
                    continue;
                }
                let partner = disk_of(leaf_of(other), views[other].index);
                if !are_close(disk, partner) {
                    continue;
                }
                let place = atomicAdd(&counts_of_disks[disk], 1u);
                if kept {
                    found[place] = partner;
                }
            }
        }
    }
    if are_loops_cut(view.has_supports) {
        atomicStore(&counts_of_disks[tables[view.clip + CLIP_DISKS] + 1u], 1u);
    }
}

fn is_clipped_surfel(id: u32) -> bool {
    if !takes_part(id) {
        return false;
    }
    let kind = views[id].kind;
    return kind != KIND_OFF && kind != KIND_RISES && kind != KIND_FALLS;
}

@compute @workgroup_size(WORKGROUP)
fn count_partners(thread: Thread) {
    let id = group_number(thread);
    if is_clipped_surfel(id) {
        meet_partners(id, thread.local, false);
    }
}

@compute @workgroup_size(WORKGROUP)
fn fill_partners(thread: Thread) {
    let id = group_number(thread);
    if is_clipped_surfel(id) {
        meet_partners(id, thread.local, true);
    }
}
