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
