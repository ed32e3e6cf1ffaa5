// The twin of src/splat/ewa.rs: how much one flat surfel weighs at one pixel.

@group(0) @binding(9) var<storage, read_write> footprints: array<Footprint>;

fn determinant_of(form: vec3<f32>) -> f32 {
    return form.x * form.z - form.y * form.y;
}

// Inverse of a form + `square` I, and its determinant before inversion.
fn widened_inverse(form: vec3<f32>, square: f32) -> vec4<f32> {
    let wide = vec3<f32>(form.x + square, form.y, form.z + square);
    // Of a matrix ≥ 0 the determinant is too, and rounding must not say otherwise.
    let determinant = max(determinant_of(form), 0.0) + square * (form.x + form.z + square);
    return vec4<f32>(wide.z / determinant, -wide.y / determinant, wide.x / determinant, determinant);
}

fn form_at(form: vec3<f32>, d: vec2<f32>) -> f32 {
    return form.x * d.x * d.x + 2.0 * form.y * d.x * d.y + form.z * d.y * d.y;
}

// The border as the form r²(I − n nᵀ), its extent along a direction a is √(aᵀ F a): xx, xy, xz, yy and yz, zz.
fn border_form(id: u32) -> array<vec4<f32>, 2> {
    let n = views[id].normal;
    let a = views[id].support_a;
    let b = views[id].support_b;
    if a.x == a.w && a.x == b.y && a.y == 0.0 && a.z == 0.0 && b.x == 0.0 {
        let r = views[id].radius * views[id].radius;
        return array<vec4<f32>, 2>(
            vec4<f32>(r * (1.0 - n.x * n.x), -r * n.x * n.y, -r * n.x * n.z, r * (1.0 - n.y * n.y)),
            vec4<f32>(-r * n.y * n.z, r * (1.0 - n.z * n.z), 0.0, 0.0),
        );
    }
    // Any two directions of the plane (Duff 2017).
    let s = select(-1.0, 1.0, n.z >= 0.0);
    let p = -1.0 / (s + n.z);
    let q = n.x * n.y * p;
    let u = vec3<f32>(1.0 + s * n.x * n.x * p, s * q, -s * n.x);
    let v = vec3<f32>(q, s + n.y * n.y * p, -n.y);
    let uu = dot(u, times(a, b, u));
    let uv = dot(u, times(a, b, v));
    let vv = dot(v, times(a, b, v));
    let determinant = uu * vv - uv * uv;
    let row_u = (vv / determinant) * u - (uv / determinant) * v;
    let row_v = (uu / determinant) * v - (uv / determinant) * u;
    return array<vec4<f32>, 2>(
        vec4<f32>(
            row_u.x * u.x + row_v.x * v.x,
            row_u.x * u.y + row_v.x * v.y,
            row_u.x * u.z + row_v.x * v.z,
            row_u.y * u.y + row_v.y * v.y,
        ),
        vec4<f32>(row_u.y * u.z + row_v.y * v.z, row_u.z * u.z + row_v.z * v.z, 0.0, 0.0),
    );
}

@compute @workgroup_size(WORKGROUP)
fn find_footprints(thread: Thread) {
    let id = thread_number(thread);
    if id >= view.views || views[id].kind == KIND_UNNEEDED {
        return;
    }
    let border = border_form(id);
    let scale = views[id].scale;
    var aside = vec2<f32>();
    var out: Footprint;
    if view.is_perspective != 0u {
        let middle = views[id].middle;
        aside = ((middle.xz - view.half_size) + middle.yw) / view.focal_px;
        out.inverse_depth = 1.0 / (views[id].depth.x + (views[id].depth.y - views[id].lift));
    }
    let px = 1.0 / scale;
    let row_x = vec3<f32>(px, 0.0, -aside.x * px);
    let row_y = vec3<f32>(0.0, px, -aside.y * px);
    let border_x = times(border[0], border[1].xy, row_x);
    let border_y = times(border[0], border[1].xy, row_y);
    // The border's ellipse in the picture; J Σ Jᵀ is this in sigmas.
    let ellipse = vec3<f32>(dot(row_x, border_x), dot(row_x, border_y), dot(row_y, border_y));
    let gaussian = ellipse * (1.0 / (BORDER_IN_SIGMAS * BORDER_IN_SIGMAS));
    let outline = widened_inverse(ellipse, REACH_PX * REACH_PX);
    let low_passed = widened_inverse(gaussian, LOW_PASS_PX * LOW_PASS_PX);
    out.outline = outline.xyz;
    out.low_passed = low_passed.xyz;
    out.peak = max(sqrt(max(determinant_of(gaussian), 0.0) / low_passed.w), LEAST_PEAK);
    let reach_in_radii = REACH_PX * scale / views[id].radius;
    out.reach = views[id].reach * sqrt(1.0 + reach_in_radii * reach_in_radii);
    out.depth_reach = sqrt(max(border[1].y, 0.0));
    let is_close = views[id].lift != 0.0 || !(out.depth_reach * out.inverse_depth <= MOST_DEPTH_SHARE);
    out.is_close = select(0u, 1u, is_close);
    footprints[id] = out;
}

// One surfel on one ray.
struct Drawn {
    is_drawn: bool,
    // How far behind the surfel's reference depth it is met.
    tau: f32,
    weight: f32,
}

fn drawn_at(ray: Ray, id: u32) -> Drawn {
    let lift = views[id].lift;
    let n = views[id].normal;
    let start = at_reference(ray, id);
    let ahead = -dot(n, start);
    let slant = dot(n, ray.dir);
    let is_parallel = slant == 0.0;
    let to_plane = ahead / select(slant, 1.0, is_parallel);
    if footprints[id].is_close != 0u {
        // The point on the disk itself.
        let u = support(id, start + ray.dir * to_plane);
        let weight = exp(-0.5 * BORDER_IN_SIGMAS * BORDER_IN_SIGMAS * u);
        return Drawn(!is_parallel && u <= 1.0, to_plane, weight);
    }
    let depth_reach = footprints[id].depth_reach;
    let height = to_plane + lift;
    // Where the ray lies in the plane it is met at the centre's depth, and where it is parallel too.
    var held = 0.0;
    var is_beyond = ahead > 0.0;
    if !is_parallel {
        held = height;
        is_beyond = height > depth_reach;
        if abs(height) > depth_reach {
            held = depth_reach * depth_reach / height;
        }
    }
    let k = 1.0 + select(held, depth_reach, is_beyond) * footprints[id].inverse_depth;
    let square = k * k;
    let middle = views[id].middle;
    let delta = (ray.px - middle.xz) - middle.yw;
    let is_drawn = form_at(footprints[id].outline, delta) * square <= 1.0;
    let weight = footprints[id].peak * exp(-0.5 * square * form_at(footprints[id].low_passed, delta));
    return Drawn(is_drawn, held, weight);
}
