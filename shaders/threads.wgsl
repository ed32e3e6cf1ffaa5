// What every kernel begins with: the number of its thread. Dispatches are two-dimensional, since one dimension ends at 65 535
// workgroups.

struct Thread {
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
}

fn group_number(thread: Thread) -> u32 {
    return thread.group.y * thread.groups.x + thread.group.x;
}

fn thread_number(thread: Thread) -> u32 {
    return group_number(thread) * WORKGROUP + thread.local;
}

// Whether this thread's loops were cut short, asked at its end: a driver that ends loops after so many steps leaves them without a
// word, and then these steps are too many as well. `none` is a 0 that the driver does not know of.
fn are_loops_cut(none: u32) -> bool {
    var step = 0u;
    while step < 2u + none {
        step++;
    }
    return step < 2u;
}
