// Every layer under its ink, blended front to back: the twin of composite::layered.

@group(0) @binding(6) var<storage, read_write> surfaces: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read_write> depths: array<f32>;
@group(0) @binding(8) var<storage, read> ink_offsets: array<u32>;
@group(0) @binding(9) var<storage, read> inks: array<vec2<f32>>;
// By boundary: the share of the light that shadows keep off, in steps.
@group(0) @binding(16) var<storage, read> kept_off: array<u32>;

// The lit colours of all boundaries, with their opacities.
@compute @workgroup_size(WORKGROUP)
fn light_surfaces(thread: Thread) {
    let number = thread_number(thread);
    if number >= part_area() {
        return;
    }
    let at = part_pixel(number);
    let place = in_band(at);
    for (var i = offsets[place]; i < offsets[place + 1u]; i++) {
        // No branch: lavapipe compiles a loop anew at every dispatch where a uniform alone decides a branch in it.
        let colour = select(look.ink, lit(at, records[i].normal, records[i].colour, 1.0), look.tints == 0u);
        surfaces[i] = vec4<f32>(colour, clamp(records[i].opacity, 0.0, 1.0));
    }
}

// The same where shadows fall on surfaces that are lit.
@compute @workgroup_size(WORKGROUP)
fn light_shadowed_surfaces(thread: Thread) {
    let number = thread_number(thread);
    if number >= part_area() {
        return;
    }
    let at = part_pixel(number);
    let place = in_band(at);
    for (var i = offsets[place]; i < offsets[place + 1u]; i++) {
        let sun = 1.0 - f32(kept_off[i]) / LIGHT_STEPS;
        let colour = lit(at, records[i].normal, records[i].colour, sun);
        surfaces[i] = vec4<f32>(colour, clamp(records[i].opacity, 0.0, 1.0));
    }
}

// What a ray has gathered so far, front to back.
struct Gathered {
    light: vec3<f32>,
    // What the surfaces so far let through.
    through: f32,
    // The share of the pixel that ink covers so far.
    inked: f32,
    depth: f32,
    // Strength of the next layer's ink.
    strength: f32,
}

fn nothing_gathered() -> Gathered {
    return Gathered(vec3<f32>(0.0), 1.0, 0.0, FAR, 1.0);
}

// Adds a layer: its ink and the ink's depth, over a surface of premultiplied colour and alpha.
fn gather(so_far: Gathered, ink: vec2<f32>, surface: vec4<f32>, surface_depth: f32) -> Gathered {
    var gathered = so_far;
    if gathered.depth == FAR {
        if surface.a > 0.0 {
            gathered.depth = min(surface_depth, select(FAR, ink.y, ink.x > 0.0));
        } else if ink.x >= INK_HAS_DEPTH {
            gathered.depth = min(ink.y, surface_depth);
        }
    }
    let inked = max(gathered.inked, ink.x * gathered.strength);
    let fresh = gathered.through * (inked - gathered.inked);
    let bare = gathered.through * (1.0 - inked);
    gathered.light += fresh * look.ink + bare * surface.rgb;
    gathered.inked = inked;
    gathered.through *= 1.0 - surface.a;
    gathered.strength *= look.kept;
    return gathered;
}

// The share of what lies behind that shows.
fn transmitted_by(gathered: Gathered) -> f32 {
    return gathered.through * (1.0 - gathered.inked);
}

// The ink of a pixel's layer, whose first is number `first` and of which there are `count`.
fn ink_at(first: u32, count: u32, layer: u32) -> vec2<f32> {
    if layer < count {
        return inks[first + layer];
    }
    return vec2<f32>(0.0, FAR);
}

// One pixel: each sample's layers are counted and blended on their own; lines are the pixel's.
@compute @workgroup_size(WORKGROUP)
fn compose(thread: Thread) {
    let number = thread_number(thread);
    if number >= part_area() {
        return;
    }
    let place = in_band(part_pixel(number));
    let end = offsets[place + 1u];
    let first_ink = ink_offsets[place];
    let ink_count = ink_offsets[place + 1u] - first_ink;
    if offsets[place] == end && ink_count == 0u {
        pixels[number] = look.background;
        depths[number] = FAR;
        return;
    }
    var light = vec3<f32>(0.0);
    var through = 0.0;
    var depth = FAR;
    for (var sample = 0u; sample < view.samples; sample++) {
        var gathered = nothing_gathered();
        var layer = 0u;
        for (var i = offsets[place]; i < end; i++) {
            if (seen_by(records[i].samples) >> sample & 1u) == 0u {
                continue;
            }
            let surface = surfaces[i];
            let premultiplied = vec4<f32>(surface.a * surface.rgb, surface.a);
            gathered = gather(gathered, ink_at(first_ink, ink_count, layer), premultiplied, records[i].depth);
            layer += 1u;
            if gathered.through <= 0.0 || layer >= look.most {
                break;
            }
        }
        // Lines stand half a width over the border of their surface.
        while layer < ink_count && gathered.through > 0.0 {
            gathered = gather(gathered, inks[first_ink + layer], vec4<f32>(0.0), FAR);
            layer += 1u;
        }
        light += gathered.light;
        through += transmitted_by(gathered);
        depth = min(depth, gathered.depth);
    }
    let share = 1.0 / f32(view.samples);
    pixels[number] = over(light * share, through * share);
    depths[number] = depth;
}
