// How much of the light reaches each boundary: the twin of composite::shadow.

@group(0) @binding(1) var<storage, read> offsets: array<u32>;
@group(0) @binding(2) var<storage, read> records: array<LayerRecord>;
@group(0) @binding(3) var<uniform> light: LightView;
// By boundary.
@group(0) @binding(4) var<storage, read_write> receivers: array<Receiver>;
// By level: the first column and row of texels that are asked for, and the last ones. After all levels: how many boundaries have
// texels larger than their pixel.
@group(0) @binding(5) var<storage, read_write> asked: array<atomic<i32>>;
// Where in a pixel its samples are.
@group(0) @binding(6) var<storage, read> sample_places: array<vec2<f32>>;
// By boundary: the share of the light that is kept off, in whole steps, so that it does not matter in what order texels are asked.
@group(0) @binding(7) var<storage, read_write> kept_off: array<u32>;
// What the light sees of a patch of its grid.
@group(0) @binding(8) var<storage, read> light_offsets: array<u32>;
@group(0) @binding(9) var<storage, read> light_records: array<LayerRecord>;
@group(0) @binding(10) var<uniform> patch_of_light: LightPatch;

// Along the axes of the light's grid.
fn on_grid(v: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(dot(v, light.right), dot(v, light.down), dot(v, light.forward));
}

// x of one times y of the other, less the other way round.
fn cross_of(a: vec2<f32>, b: vec2<f32>) -> f32 {
    return a.x * b.y - a.y * b.x;
}

// How a pixel lies on the texels.
struct Shape {
    // The factors of x², xy and y² in the square of how far a texel is, as a share of the way to where texels end to count.
    shrink: vec3<f32>,
    // How far from the pixel's middle texels still count.
    reach: vec2<f32>,
}

fn shape_of(a: vec2<f32>, b: vec2<f32>) -> Shape {
    let spread = vec3<f32>(a.x * a.x + b.x * b.x, a.x * a.y + b.x * b.y, a.y * a.y + b.y * b.y) + vec3<f32>(1.0, 0.0, 1.0);
    let skew = cross_of(a, b);
    let det = spread.x + spread.z - 1.0 + skew * skew;
    var shape: Shape;
    shape.shrink = vec3<f32>(spread.z, -2.0 * spread.y, spread.x) * (PER_REACH / det);
    shape.reach = sqrt(spread.xz / PER_REACH);
    return shape;
}

// How much a texel counts whose middle is `from_here`.
fn weight_of(shape: Shape, from_here: vec2<f32>) -> f32 {
    let squares = vec3<f32>(from_here.x * from_here.x, from_here.x * from_here.y, from_here.y * from_here.y);
    let within = max(1.0 - dot(shape.shrink, squares), 0.0);
    return within * within;
}

fn first_texel(at: vec2<f32>, reach: vec2<f32>) -> vec2<i32> {
    return vec2<i32>(ceil(at - reach - 0.5));
}

fn last_texel(at: vec2<f32>, reach: vec2<f32>) -> vec2<i32> {
    return vec2<i32>(floor(at + reach - 0.5));
}

// Where in the pixel the samples of a mask are, on average.
fn middle_of(mask: u32) -> vec2<f32> {
    let all = (1u << view.samples) - 1u;
    let seen = mask & all;
    if view.samples == 1u || seen == all || seen == 0u {
        return vec2<f32>(0.5);
    }
    var sum = vec2<f32>(0.0);
    for (var sample = 0u; sample < view.samples; sample++) {
        if (seen >> sample & 1u) == 1u {
            sum += sample_places[sample];
        }
    }
    return sum / f32(countOneBits(seen));
}

// A boundary as a receiver of light; without a level where it looks away from the light.
fn receiver_of(at: vec2<u32>, record: LayerRecord) -> Receiver {
    var receiver: Receiver;
    receiver.level = -1;
    let aside = vec2<f32>(at) - view.middle + (middle_of(record.samples) - 0.5);
    let ray = view.forward + (view.right * aside.x + view.down * aside.y) * view.tangent;
    // The side that is lit is the one that is seen, from the pixel's middle as in shaded.wgsl.
    let normal = select(record.normal, -record.normal, dot(record.normal, ray_at(at)) > 0.0);
    let sine = -dot(normal, light.forward);
    if !(sine > 0.0) {
        return receiver;
    }
    let along = dot(normal, ray);
    let per_along = along / (along * along + 0.25 / (STEEPEST * STEEPEST));
    let footprint = 1.0 / px_per_unit_at(record.depth);
    let a = on_grid((view.right - ray * (dot(view.right, normal) * per_along)) * footprint).xy;
    let b = on_grid((view.down - ray * (dot(view.down, normal) * per_along)) * footprint).xy;
    let long = max(length(a), length(b));
    let short = abs(cross_of(a, b)) / max(long, TINY);
    let wanted = max(clamp(short, LEAST_SHARE * footprint, footprint), long / MOST_TEXELS);
    receiver.level = clamp(i32(floor(STEPS * log2(wanted))) - light.least_level, 0, i32(LEVELS) - 1);
    let texel = exp2(f32(receiver.level + light.least_level) / STEPS);
    // A pixel of the picture is a footprint wide, whatever the lens.
    let beside = (view.right * aside.x + view.down * aside.y) * footprint;
    let place = light.at_depth + on_grid(view.forward * (record.depth - light.depth) + beside);
    receiver.at = place.xy / texel;
    receiver.depth = place.z;
    receiver.texel = texel;
    receiver.sides = vec4<f32>(a, b) / texel;
    let turned = on_grid(normal);
    receiver.normal = normalize(vec3<f32>(turned.xy, -max(sine, LEAST_SINE)));
    let rounding = DEPTH_ROUNDING * record.depth * abs(along);
    receiver.tolerance = max(max(TOLERANCE * footprint, rounding) / texel, 1.0);
    receiver.is_coarse = select(0u, 1u, texel > short);
    return receiver;
}

// Makes the boundaries of a pixel into receivers of light.
@compute @workgroup_size(WORKGROUP)
fn receive(thread: Thread) {
    let number = thread_number(thread);
    if number >= part_area() {
        return;
    }
    let at = part_pixel(number);
    let place = in_band(at);
    for (var i = offsets[place]; i < offsets[place + 1u]; i++) {
        var receiver = receiver_of(at, records[i]);
        if receiver.level >= 0 {
            let shape = shape_of(receiver.sides.xy, receiver.sides.zw);
            let first = first_texel(receiver.at, shape.reach);
            let last = last_texel(receiver.at, shape.reach);
            var whole = 0.0;
            for (var y = first.y; y <= last.y; y++) {
                for (var x = first.x; x <= last.x; x++) {
                    whole += weight_of(shape, vec2<f32>(vec2<i32>(x, y)) + 0.5 - receiver.at);
                }
            }
            receiver.per_weight = select(0.0, 1.0 / whole, whole > 0.0);
            let row = u32(receiver.level) * 4u;
            atomicMin(&asked[row], first.x);
            atomicMin(&asked[row + 1u], first.y);
            atomicMax(&asked[row + 2u], last.x);
            atomicMax(&asked[row + 3u], last.y);
            // What is around the band's own pixels is another band's to count.
            if all(at >= light.counted.xy) && all(at - light.counted.xy < light.counted.zw) {
                atomicAdd(&asked[LEVELS * 4u], i32(receiver.is_coarse));
            }
        }
        receivers[i] = receiver;
    }
}

// The share of the light that passes what stands in texel `texel` of the patch, which lies `from_here`.
fn through_of(receiver: Receiver, texel: u32, from_here: vec2<f32>) -> f32 {
    var through = 1.0;
    for (var i = light_offsets[texel]; i < light_offsets[texel + 1u]; i++) {
        let record = light_records[i];
        let opacity = clamp(record.opacity * light.opacity, 0.0, 1.0);
        if opacity == 0.0 {
            continue;
        }
        var normal = on_grid(record.normal);
        normal = select(normal, -normal, normal.z > 0.0);
        let to_caster = vec3<f32>(from_here, (record.depth - receiver.depth) / receiver.texel);
        let over_this = dot(receiver.normal, to_caster);
        let over_that = dot(normal, to_caster);
        if over_this > receiver.tolerance && over_that > receiver.tolerance {
            through *= 1.0 - opacity;
        }
        if opacity >= 1.0 {
            break;
        }
    }
    return through;
}

// Adds what a patch keeps of the light from the boundaries of a pixel.
@compute @workgroup_size(WORKGROUP)
fn shade(thread: Thread) {
    let number = thread_number(thread);
    if number >= part_area() {
        return;
    }
    let place = in_band(part_pixel(number));
    let patch_end = patch_of_light.corner + vec2<i32>(patch_of_light.size);
    for (var i = offsets[place]; i < offsets[place + 1u]; i++) {
        let receiver = receivers[i];
        if receiver.level != patch_of_light.level {
            continue;
        }
        let shape = shape_of(receiver.sides.xy, receiver.sides.zw);
        let first = max(first_texel(receiver.at, shape.reach), patch_of_light.corner);
        let last = min(last_texel(receiver.at, shape.reach), patch_end - 1);
        var sum = 0u;
        for (var y = first.y; y <= last.y; y++) {
            for (var x = first.x; x <= last.x; x++) {
                let from_here = vec2<f32>(vec2<i32>(x, y)) + 0.5 - receiver.at;
                let share = weight_of(shape, from_here) * receiver.per_weight;
                if !(share > 0.0) {
                    continue;
                }
                let in_patch = vec2<u32>(vec2<i32>(x, y) - patch_of_light.corner);
                let texel = in_patch.y * patch_of_light.size.x + in_patch.x;
                let blocked = 1.0 - through_of(receiver, texel, from_here);
                sum += u32(share * blocked * light.strength * LIGHT_STEPS + 0.5);
            }
        }
        kept_off[i] += sum;
    }
}
