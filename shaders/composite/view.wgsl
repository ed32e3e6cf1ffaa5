// Which pixel a thread is about, and what the camera makes of it: the twin of `Camera` and of `facets::Slopes`.

@group(0) @binding(0) var<uniform> view: View;

// Pixels of the view's part.
fn part_area() -> u32 {
    return view.part.z * view.part.w;
}

// Column and row in the picture of pixel `number` of the part, counted row by row.
fn part_pixel(number: u32) -> vec2<u32> {
    return view.part.xy + vec2<u32>(number % view.part.z, number / view.part.z);
}

// The number, among those of the band, of the pixel at a column and row of the picture.
fn in_band(at: vec2<u32>) -> u32 {
    return (at.y - view.band.y) * view.band.z + (at.x - view.band.x);
}

// Along the ray of a pixel, one unit forward; world space.
fn ray_at(at: vec2<u32>) -> vec3<f32> {
    let aside = (vec2<f32>(at) - view.middle) * view.tangent;
    return view.forward + view.right * aside.x + view.down * aside.y;
}

// Pixels to a world unit at `depth`.
fn px_per_unit_at(depth: f32) -> f32 {
    // No branch: lavapipe compiles a loop anew at every dispatch where a uniform alone decides a branch in it.
    return select(view.px_per_unit, view.px_per_unit / depth, view.is_perspective != 0u);
}

// How many footprints deeper the plane with this normal is one pixel to the right of where the ray meets it, and one down.
fn steps(normal: vec3<f32>, ray: vec3<f32>) -> vec2<f32> {
    let along = dot(normal, ray);
    let per_along = -along / (along * along + 0.25 / (STEEPEST * STEEPEST));
    return vec2<f32>(dot(normal, view.right), dot(normal, view.down)) * per_along;
}

// The samples of the pixel that see a boundary with this mask: with one sample a pixel, that one.
fn seen_by(mask: u32) -> u32 {
    return select(mask & ((1u << view.samples) - 1u), 1u, view.samples == 1u);
}
