// Lines and surfaces drawn by a loose hand: the twin of composite::sketchy. What a tile's window holds there is here a list of
// layers at each pixel of the band.

// How many layers each pixel has; their sums once that is known.
@group(0) @binding(10) var<storage, read_write> layer_counts: array<u32>;
@group(0) @binding(11) var<storage, read> layer_offsets: array<u32>;
// By layer, the mean over the pixel's samples: premultiplied colour, and the nearest depth.
@group(0) @binding(12) var<storage, read_write> layer_colours: array<vec4<f32>>;
@group(0) @binding(13) var<storage, read_write> layer_depths: array<f32>;
// Two values of noise at every NOISE_GRID_PX-th column and row.
@group(0) @binding(14) var<storage, read> noise: array<vec2<f32>>;
@group(0) @binding(15) var<uniform> sketch: Sketch;

// How many layers the samples of a pixel have, the most of them.
@compute @workgroup_size(WORKGROUP)
fn count_layers(thread: Thread) {
    let place = thread_number(thread);
    if place >= part_area() {
        return;
    }
    var seen: array<u32, MAX_SAMPLES>;
    var most = 0u;
    for (var i = offsets[place]; i < offsets[place + 1u]; i++) {
        var rest = seen_by(records[i].samples);
        while rest != 0u {
            let sample = firstTrailingBit(rest);
            rest &= rest - 1u;
            seen[sample] += 1u;
            most = max(most, seen[sample]);
        }
    }
    layer_counts[place] = min(most, look.most);
}

// The layers of each pixel: a boundary may be the k-th of one sample and another of the next.
@compute @workgroup_size(WORKGROUP)
fn make_layers(thread: Thread) {
    let place = thread_number(thread);
    if place >= part_area() {
        return;
    }
    let first = layer_offsets[place];
    let count = layer_offsets[place + 1u] - first;
    for (var i = 0u; i < count; i++) {
        layer_colours[first + i] = vec4<f32>(0.0);
        layer_depths[first + i] = FAR;
    }
    var seen: array<u32, MAX_SAMPLES>;
    for (var i = offsets[place]; i < offsets[place + 1u]; i++) {
        let surface = surfaces[i];
        let share = surface.a / f32(view.samples);
        var rest = seen_by(records[i].samples);
        while rest != 0u {
            let sample = firstTrailingBit(rest);
            rest &= rest - 1u;
            let layer = seen[sample];
            if layer < count {
                layer_colours[first + layer] += share * vec4<f32>(surface.rgb, 1.0);
                layer_depths[first + layer] = min(layer_depths[first + layer], records[i].depth);
                seen[sample] += 1u;
            }
        }
    }
}

// The layers and the ink of one pixel.
struct Lists {
    first_layer: u32,
    layers: u32,
    first_ink: u32,
    inks: u32,
}

fn lists_at(at: vec2<i32>) -> Lists {
    let low = vec2<i32>(view.band.xy);
    if any(at < low) || any(at >= low + vec2<i32>(view.band.zw)) {
        return Lists(0u, 0u, 0u, 0u);
    }
    let place = in_band(vec2<u32>(at));
    let first_layer = layer_offsets[place];
    let first_ink = ink_offsets[place];
    return Lists(first_layer, layer_offsets[place + 1u] - first_layer, first_ink, ink_offsets[place + 1u] - first_ink);
}

// The four pixels around a position, by what shares; whole numbers are pixels' middles.
struct Tap {
    corners: array<Lists, 4>,
    shares: vec4<f32>,
    nearest: Lists,
}

fn tap(at: vec2<f32>) -> Tap {
    let low = floor(at);
    let within = at - low;
    let corner = vec2<i32>(low);
    var result: Tap;
    for (var i = 0u; i < 4u; i++) {
        result.corners[i] = lists_at(corner + vec2<i32>(i32(i & 1u), i32(i >> 1u)));
    }
    let left = 1.0 - within;
    result.shares = vec4<f32>(left.x * left.y, within.x * left.y, left.x * within.y, within.x * within.y);
    result.nearest = result.corners[select(0u, 1u, within.x >= 0.5) + select(0u, 2u, within.y >= 0.5)];
    return result;
}

// The nearest depth of a pixel's layer, of its surface and its ink.
fn depth_of(lists: Lists, layer: u32) -> f32 {
    var depth = ink_at(lists.first_ink, lists.inks, layer).y;
    if layer < lists.layers {
        depth = min(depth, layer_depths[lists.first_layer + layer]);
    }
    return depth;
}

// The offset in pixels for a noise value, by the rows of a matrix.
fn turned(rows: vec4<f32>, value: vec2<f32>) -> vec2<f32> {
    let offset = vec2<f32>(dot(rows.xy, value), dot(rows.zw, value));
    let size = length(offset);
    if size > MOST_OFFSET_PX {
        return offset * (MOST_OFFSET_PX / size);
    }
    return offset;
}

// The noise at a pixel.
fn noise_at(at: vec2<u32>) -> vec2<f32> {
    let cell = at / NOISE_GRID_PX - sketch.grid.xy;
    let within = vec2<f32>(at % NOISE_GRID_PX) / f32(NOISE_GRID_PX);
    let first = cell.y * sketch.grid.z + cell.x;
    let below = first + sketch.grid.z;
    let top = mix(noise[first], noise[first + 1u], within.x);
    let bottom = mix(noise[below], noise[below + 1u], within.x);
    return mix(top, bottom, within.y);
}

// One pixel of the drawing.
@compute @workgroup_size(WORKGROUP)
fn draw(thread: Thread) {
    let number = thread_number(thread);
    if number >= part_area() {
        return;
    }
    let at = part_pixel(number);
    let value = noise_at(at);
    var edge = tap(vec2<f32>(at) + turned(sketch.edge, value));
    var shade = tap(vec2<f32>(at) + turned(sketch.shade, value));
    var count = 0u;
    for (var i = 0u; i < 4u; i++) {
        count = max(count, max(edge.corners[i].inks, shade.corners[i].layers));
    }
    var gathered = nothing_gathered();
    for (var layer = 0u; layer < count && gathered.through > 0.0; layer++) {
        var ink = 0.0;
        var surface = vec4<f32>(0.0);
        for (var i = 0u; i < 4u; i++) {
            ink += edge.shares[i] * ink_at(edge.corners[i].first_ink, edge.corners[i].inks, layer).x;
            if layer < shade.corners[i].layers {
                surface += shade.shares[i] * layer_colours[shade.corners[i].first_layer + layer];
            }
        }
        var depth = FAR;
        if ink > 0.0 || surface.a > 0.0 {
            depth = min(depth_of(edge.nearest, layer), depth_of(shade.nearest, layer));
        }
        gathered = gather(gathered, vec2<f32>(ink, depth), surface, depth);
    }
    pixels[number] = over(gathered.light, transmitted_by(gathered));
    depths[number] = gathered.depth;
}
