// Twin of blister/fragments.rs: every fragment once, in lists by pixel.

@group(0) @binding(4) var<storage, read_write> length: atomic<u32>;
@group(0) @binding(5) var<storage, read_write> counts: array<atomic<u32>>;
@group(0) @binding(6) var<storage, read> offsets: array<u32>;
@group(0) @binding(7) var<storage, read_write> fragments: array<Fragment>;
@group(0) @binding(8) var<storage, read_write> sorted: array<Survivor>;

// Appends the fragment. Those that find no place are counted, and drawn again into a longer list.
@fragment
fn list_fragment(drawn: Drawn) -> @location(0) vec4<f32> {
    let at = vec2<u32>(drawn.position.xy);
    let pixel = at.y * frame.size.x + at.x;
    let place = atomicAdd(&length, 1u);
    if place < arrayLength(&fragments) {
        let number = atomicAdd(&counts[pixel], 1u);
        fragments[place] = Fragment(pixel, number, drawn.surface, key_at(drawn.surface, at));
    }
    return vec4<f32>(0.0);
}

// Puts every fragment where its pixel's begin.
@compute @workgroup_size(WORKGROUP)
fn place_fragments(thread: Thread) {
    let number = thread_number(thread);
    if number >= min(atomicLoad(&length), arrayLength(&fragments)) {
        return;
    }
    let fragment = fragments[number];
    let slot = surfaces[fragment.surface].slot;
    sorted[offsets[fragment.pixel] + fragment.number] = Survivor(fragment.key, fragment.surface, slot, 0u);
}
