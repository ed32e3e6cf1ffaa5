// Exclusive prefix sums: each workgroup sums its part, the parts' sums are summed in turn, and added.

struct Length {
    // Numbers to sum.
    count: u32,
}

@group(0) @binding(0) var<uniform> length: Length;
@group(0) @binding(1) var<storage, read_write> numbers: array<u32>;
@group(0) @binding(2) var<storage, read_write> sums: array<u32>;

var<workgroup> shared_sums: array<u32, WORKGROUP>;

// Replaces the numbers of a group by the sums of those before them in the group; the group's sum goes to `sums`.
@compute @workgroup_size(WORKGROUP)
fn scan_group(thread: Thread) {
    let first = thread_number(thread) * NUMBERS_A_THREAD;
    var own = 0u;
    for (var i = 0u; i < NUMBERS_A_THREAD; i++) {
        if first + i < length.count {
            own += numbers[first + i];
        }
    }
    shared_sums[thread.local] = own;
    workgroupBarrier();
    for (var reach = 1u; reach < WORKGROUP; reach *= 2u) {
        var before = 0u;
        if thread.local >= reach {
            before = shared_sums[thread.local - reach];
        }
        workgroupBarrier();
        shared_sums[thread.local] += before;
        workgroupBarrier();
    }
    var sum = shared_sums[thread.local] - own;
    for (var i = 0u; i < NUMBERS_A_THREAD; i++) {
        if first + i < length.count {
            let number = numbers[first + i];
            numbers[first + i] = sum;
            sum += number;
        }
    }
    // The grid of workgroups may be larger than what it is for.
    if thread.local == WORKGROUP - 1u && group_number(thread) < arrayLength(&sums) {
        sums[group_number(thread)] = sum;
    }
}

// Adds what comes before each group.
@compute @workgroup_size(WORKGROUP)
fn scan_add(thread: Thread) {
    let first = thread_number(thread) * NUMBERS_A_THREAD;
    let before = sums[group_number(thread)];
    for (var i = 0u; i < NUMBERS_A_THREAD; i++) {
        if first + i < length.count {
            numbers[first + i] += before;
        }
    }
}
