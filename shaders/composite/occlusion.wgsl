// Shade in hollows: the twin of composite::occlusion.

@group(0) @binding(1) var<storage, read> offsets: array<u32>;
@group(0) @binding(2) var<storage, read> records: array<LayerRecord>;
@group(0) @binding(3) var<storage, read_write> surfaces: array<vec4<f32>>;
// By pixel of the band: the depth of the nearest surface that is not clear.
@group(0) @binding(4) var<storage, read_write> nearest: array<f32>;
// By direction, the nearest ring first: columns and rows away, and one over the distance.
@group(0) @binding(5) var<storage, read> neighbours: array<vec4<f32>>;
@group(0) @binding(6) var<uniform> shade: Shade;

@compute @workgroup_size(WORKGROUP)
fn find_nearest(thread: Thread) {
    let place = thread_number(thread);
    if place >= part_area() {
        return;
    }
    var depth = FAR;
    for (var i = offsets[place]; i < offsets[place + 1u]; i++) {
        if records[i].opacity > 0.0 {
            depth = records[i].depth;
            break;
        }
    }
    nearest[place] = depth;
}

// The depth that a neighbour shows; FAR outside of the band.
fn nearest_at(at: vec2<i32>) -> f32 {
    let low = vec2<i32>(view.band.xy);
    if any(at < low) || any(at >= low + vec2<i32>(view.band.zw)) {
        return FAR;
    }
    return nearest[in_band(vec2<u32>(at))];
}

// The share of its light that a surface in the pixel `at` keeps.
fn light_kept(at: vec2<u32>, normal: vec3<f32>, depth: f32) -> f32 {
    let step = steps(normal, ray_at(at));
    let px_per_unit = px_per_unit_at(depth);
    var hidden = 0.0;
    for (var direction = 0u; direction < DIRECTIONS; direction++) {
        var highest = 0.0;
        for (var ring = 0u; ring < RINGS; ring++) {
            let neighbour = neighbours[direction * RINGS + ring];
            let there = nearest_at(vec2<i32>(at) + vec2<i32>(neighbour.xy));
            if there == FAR {
                continue;
            }
            let deeper = (there - depth) * px_per_unit;
            let height = (dot(step, neighbour.xy) - deeper) * neighbour.z;
            // Of what may be another body a part counts, so that no border shows where it begins to be.
            let same = (ANOTHER_BODY - height) * (1.0 / (ANOTHER_BODY - MAYBE_ANOTHER_BODY));
            highest = max(highest, clamp(same, 0.0, 1.0) * height);
        }
        if highest > LEAST_HEIGHT {
            hidden += highest / sqrt(1.0 + highest * highest);
        }
    }
    return 1.0 - shade.strength * hidden / f32(DIRECTIONS);
}

// Darkens the lit surfaces of a pixel.
@compute @workgroup_size(WORKGROUP)
fn darken(thread: Thread) {
    let number = thread_number(thread);
    if number >= part_area() {
        return;
    }
    let at = part_pixel(number);
    let place = in_band(at);
    for (var i = offsets[place]; i < offsets[place + 1u]; i++) {
        let kept = light_kept(at, records[i].normal, records[i].depth);
        surfaces[i] = vec4<f32>(surfaces[i].rgb * kept, surfaces[i].a);
    }
}
