// Lists of partners without repetition: the twin of PartnerLists::from_pairs in src/classify/partners.rs. A thread is a list, which
// is sorted.

@group(0) @binding(0) var<storage, read> starts: array<u32>;
@group(0) @binding(1) var<storage, read> sorted: array<u32>;
// How many partners are left of each list, or where they go; behind the sum of all, whether loops were cut short.
@group(0) @binding(2) var<storage, read_write> kept: array<u32>;
@group(0) @binding(3) var<storage, read_write> partners: array<u32>;

fn is_new(i: u32, first: u32) -> bool {
    if i == first {
        return true;
    }
    return sorted[i] != sorted[i - 1u];
}

@compute @workgroup_size(WORKGROUP)
fn count_distinct(thread: Thread) {
    let list = thread_number(thread);
    if list + 1u >= arrayLength(&starts) {
        return;
    }
    var count = 0u;
    var is_sorted = true;
    for (var i = starts[list]; i < starts[list + 1u]; i++) {
        if is_new(i, starts[list]) {
            count++;
        }
        if i > starts[list] {
            is_sorted = is_sorted && sorted[i - 1u] <= sorted[i];
        }
    }
    kept[list] = count;
    // The sorting may have been cut short too. The first list begins at 0.
    if !is_sorted || are_loops_cut(starts[0]) {
        kept[arrayLength(&starts)] = 1u;
    }
}

@compute @workgroup_size(WORKGROUP)
fn keep_distinct(thread: Thread) {
    let list = thread_number(thread);
    if list + 1u >= arrayLength(&starts) {
        return;
    }
    var place = kept[list];
    for (var i = starts[list]; i < starts[list + 1u]; i++) {
        if is_new(i, starts[list]) {
            partners[place] = sorted[i];
            place++;
        }
    }
}
