// Twin of blister/fragments.rs: every fragment once, in a linked list for each pixel.

// How many there are, and whether the driver cut a thread short.
@group(0) @binding(4) var<storage, read_write> length: array<atomic<u32>, 2>;
// The newest fragment of each pixel, plus one; 0 where there is none.
@group(0) @binding(5) var<storage, read_write> heads: array<atomic<u32>>;
@group(0) @binding(7) var<storage, read_write> nodes: array<Fragment>;

// Appends the fragment. Those that find no place are counted, and all are drawn again into a longer list.
@fragment
fn list_fragment(drawn: Drawn) -> @location(0) vec4<f32> {
    let at = vec2<u32>(drawn.position.xy);
    let place = atomicAdd(&length[0], 1u);
    // More than a buffer ever holds is not counted: the number would begin anew.
    if place >= MOST_COUNTED {
        atomicSub(&length[0], 1u);
    }
    if place < arrayLength(&nodes) {
        let before = atomicExchange(&heads[at.y * frame.size.x + at.x], place + 1u);
        nodes[place] = Fragment(key_of_drawn(drawn, at), drawn.surface, drawn.slot, before);
    }
    return vec4<f32>(0.0);
}
