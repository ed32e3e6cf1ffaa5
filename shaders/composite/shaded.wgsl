// Lit surfaces, blended front to back: the twin of composite::shaded.

@group(0) @binding(1) var<storage, read> offsets: array<u32>;
@group(0) @binding(2) var<storage, read> records: array<LayerRecord>;
@group(0) @binding(3) var<uniform> look: Paints;
@group(0) @binding(4) var<storage, read_write> pixels: array<vec4<f32>>;
// By row of the part: how many of its pixels show a surface.
@group(0) @binding(5) var<storage, read_write> covered: array<atomic<u32>>;

// `base` to a power of two, by squaring.
fn power(base: f32, exponent: u32) -> f32 {
    var result = base;
    for (var reached = 1u; reached < exponent; reached *= 2u) {
        result *= result;
    }
    return result;
}

// Linear RGB of a surface seen in the pixel `at`, where a share `sun` of the light arrives.
fn lit(at: vec2<u32>, normal: vec3<f32>, colour: vec3<f32>, sun: f32) -> vec3<f32> {
    let ray = ray_at(at);
    let towards_eye = -ray * (1.0 / sqrt(dot(ray, ray)));
    let towards = dot(normal, towards_eye);
    // Both sides are lit alike: products with the normal change sign where it looks away.
    let side = select(1.0, -1.0, towards < 0.0);
    let facing_eye = min(abs(towards), 1.0);
    let facing_light = max(side * dot(normal, look.towards_light), 0.0);
    let from_above = side * dot(normal, -view.down) * 0.5 + 0.5;
    let hemisphere = (from_above * (1.0 - GROUND_SHARE) + GROUND_SHARE) * look.ambient;
    let rim = power(1.0 - facing_eye, RIM_EXPONENT) * RIM;
    let diffuse = hemisphere + facing_light * (1.0 - look.ambient) * sun + rim;
    let between = towards_eye + look.towards_light;
    let squared = dot(between, between);
    // Straight from behind there is no direction between; nothing shines there.
    let per_length = select(1.0, 1.0 / sqrt(squared), squared > LEAST_SQUARED);
    let mirrored = max(side * dot(normal, between) * per_length, 0.0);
    let highlight = select(0.0, power(mirrored, HIGHLIGHT_EXPONENT) * HIGHLIGHT * sun, facing_light > 0.0);
    return colour * diffuse + highlight;
}

// Premultiplied light over the background, of which it lets a share `through`: straight alpha.
fn over(light: vec3<f32>, through: f32) -> vec4<f32> {
    let behind = through * look.background.a;
    let alpha = (1.0 - through) + behind;
    if !(alpha > 0.0) {
        return vec4<f32>(0.0);
    }
    return vec4<f32>((light + behind * look.background.rgb) / alpha, alpha);
}

// One pixel of the plain style with one sample: blended front to back.
@compute @workgroup_size(WORKGROUP)
fn blend_single(thread: Thread) {
    let number = thread_number(thread);
    if number >= part_area() {
        return;
    }
    let at = part_pixel(number);
    let place = in_band(at);
    let first = offsets[place];
    let end = offsets[place + 1u];
    if first == end {
        pixels[number] = look.background;
        return;
    }
    atomicAdd(&covered[at.y - view.part.y], 1u);
    var through = 1.0;
    var light = vec3<f32>(0.0);
    for (var i = first; i < end && through > 0.0; i++) {
        let opacity = clamp(records[i].opacity, 0.0, 1.0);
        light += through * opacity * lit(at, records[i].normal, records[i].colour, 1.0);
        through *= 1.0 - opacity;
    }
    pixels[number] = over(light, through);
}

// One pixel of the plain style: the mean over its samples, each blended front to back. Loops over samples have as many turns as there
// can be: lavapipe compiles a kernel anew at every dispatch where a uniform says how many.
@compute @workgroup_size(WORKGROUP)
fn blend(thread: Thread) {
    let number = thread_number(thread);
    if number >= part_area() {
        return;
    }
    let at = part_pixel(number);
    let place = in_band(at);
    let end = offsets[place + 1u];
    if offsets[place] == end {
        pixels[number] = look.background;
        return;
    }
    atomicAdd(&covered[at.y - view.part.y], 1u);
    var transmitted: array<f32, MAX_SAMPLES>;
    for (var sample = 0u; sample < MAX_SAMPLES; sample++) {
        transmitted[sample] = select(0.0, 1.0, sample < view.samples);
    }
    // Samples that still let light through.
    var open = (1u << view.samples) - 1u;
    var light = vec3<f32>(0.0);
    for (var i = offsets[place]; i < end && open != 0u; i++) {
        var rest = seen_by(records[i].samples) & open;
        if rest == 0u {
            continue;
        }
        let opacity = clamp(records[i].opacity, 0.0, 1.0);
        var weight = 0.0;
        while rest != 0u {
            let sample = firstTrailingBit(rest);
            rest &= rest - 1u;
            weight += transmitted[sample] * opacity;
            transmitted[sample] *= 1.0 - opacity;
            if transmitted[sample] <= 0.0 {
                open &= ~(1u << sample);
            }
        }
        light += weight * lit(at, records[i].normal, records[i].colour, 1.0);
    }
    var through = 0.0;
    for (var sample = 0u; sample < MAX_SAMPLES; sample++) {
        through += transmitted[sample];
    }
    let count = f32(view.samples);
    pixels[number] = over(light / count, through / count);
}

// How many pixels of each row show a surface, where `blend` does not count them.
@compute @workgroup_size(WORKGROUP)
fn count_covered(thread: Thread) {
    let number = thread_number(thread);
    if number >= part_area() {
        return;
    }
    let at = part_pixel(number);
    let place = in_band(at);
    if offsets[place] < offsets[place + 1u] {
        atomicAdd(&covered[at.y - view.part.y], 1u);
    }
}
