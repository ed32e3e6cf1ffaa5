// The twin of src/splat/project.rs: surfels of chunks as the camera sees them. A workgroup is a chunk.

@group(0) @binding(0) var<uniform> view: SplatView;
@group(0) @binding(1) var<storage, read> chunks: array<ChunkView>;
@group(0) @binding(2) var<storage, read> surfels: array<ModelSurfel>;
@group(0) @binding(3) var<storage, read> supports: array<ModelSupport>;
@group(0) @binding(4) var<storage, read_write> views: array<SurfelView>;

// Far beyond any picture: a ball about the eye may touch all pixels.
const ALL_PIXELS: f32 = 1e30;

// A symmetric matrix in view axes, from xx, xy, xz, yy and yz, zz in world axes; the same parts come back.
fn turned(a: vec4<f32>, b: vec2<f32>, turn: mat3x3<f32>) -> array<vec4<f32>, 2> {
    let m = mat3x3<f32>(vec3<f32>(a.x, a.y, a.z), vec3<f32>(a.y, a.w, b.x), vec3<f32>(a.z, b.x, b.y));
    let t = turn * m * transpose(turn);
    return array<vec4<f32>, 2>(vec4<f32>(t[0].x, t[1].x, t[2].x, t[1].y), vec4<f32>(t[2].y, t[2].z, 0.0, 0.0));
}

// Whether a ball in view space certainly misses the picture: the twin of `View::bounds`.
fn is_off_picture(centre: vec3<f32>, radius: f32) -> bool {
    var middle = centre.xy * view.focal_px;
    var half = vec2<f32>(radius * view.focal_px);
    if view.is_perspective != 0u {
        if centre.z <= radius {
            return false;
        }
        // The planes through the eye that touch the ball.
        let square = (centre.z - radius) * (centre.z + radius);
        middle *= centre.z / square;
        half *= sqrt(centre.xy * centre.xy + square) / square;
    }
    return any(middle + half < -view.half_size) || any(middle - half > view.half_size);
}

@compute @workgroup_size(WORKGROUP)
fn project(thread: Thread) {
    if group_number(thread) >= arrayLength(&chunks) {
        return;
    }
    let chunk = chunks[group_number(thread)];
    if thread.local >= chunk.count {
        return;
    }
    let number = chunk.first + thread.local;
    let surfel = surfels[number];
    // View from world.
    let turn = transpose(mat3x3<f32>(view.axes[0].xyz, view.axes[1].xyz, view.axes[2].xyz));
    let offset = turn * surfel.offset;
    let centre = chunk.origin + offset;
    let radius = surfel.radius;

    var out: SurfelView;
    out.kind = surfel.kind;
    out.index = chunk.index + thread.local;
    out.radius = radius;
    out.colour = surfel.colour;
    out.opacity = surfel.opacity;
    out.normal = turn * surfel.normal;
    let curvature = turned(surfel.curvature_a, surfel.curvature_b, turn);
    out.curvature_a = curvature[0];
    out.curvature_b = curvature[1].xy;
    let own = 1.0 / (radius * radius);
    out.support_a = vec4<f32>(own, 0.0, 0.0, own);
    out.support_b = vec2<f32>(0.0, own);
    if view.has_supports != 0u {
        let support = turned(supports[number].a, supports[number].b, turn);
        out.support_a = support[0];
        out.support_b = support[1].xy;
    }

    // Step 1: where the centre is projected to, and at which depth.
    out.lift = 0.0;
    out.depth = vec2<f32>(chunk.origin.z, chunk.depth_rest + offset.z);
    if view.is_perspective == 0u {
        out.scale = 1.0 / view.focal_px;
        out.middle = vec4<f32>(
            chunk.middle.x, chunk.middle.y + view.focal_px * offset.x,
            chunk.middle.z, chunk.middle.w + view.focal_px * offset.y,
        );
    } else if chunk.is_near != 0u {
        let reference = max(centre.z, NEAREST_REFERENCE_IN_RADII * radius);
        out.lift = reference - centre.z;
        out.depth.y += out.lift;
        out.scale = reference / view.focal_px;
        let middle = view.half_size + centre.xy / out.scale;
        out.middle = vec4<f32>(middle.x, 0.0, middle.y, 0.0);
    } else {
        out.scale = centre.z / view.focal_px;
        let aside = (offset.xy - chunk.slope * offset.z) / out.scale;
        out.middle = vec4<f32>(chunk.middle.x, chunk.middle.y + aside.x, chunk.middle.z, chunk.middle.w + aside.y);
    }

    // Step 2: the pixels that its ball may touch.
    var half = radius * view.focal_px;
    if view.is_perspective != 0u {
        let per_z = 1.0 / centre.z;
        let share = radius * per_z;
        let cosine = centre.z * (1.0 - share * share) - radius;
        half = view.focal_px * radius * length(centre) * (per_z / cosine);
        if !(centre.z >= 2.0 * radius) {
            half = ALL_PIXELS;
        }
    }
    let x = out.middle.x + out.middle.y;
    let y = out.middle.z + out.middle.w;
    let rounding = BOUNDS_ROUNDING_PX + F32_ROUNDING * (abs(x) + abs(y) + half);
    half += rounding;
    out.bounds = vec4<f32>(x - half, x + half, y - half, y + half);
    // Wholly behind the eye, or off the picture, whatever margin it is drawn with.
    if centre.z + radius <= 0.0 || is_off_picture(centre, radius) {
        out.kind = KIND_UNNEEDED;
    }

    // Step 3: which way it faces.
    let a = abs(surfel.curvature_a);
    let b = abs(surfel.curvature_b);
    let bend = max(max(a.x + a.y + a.z, a.y + a.w + b.x), a.z + b.x + b.y) * radius;
    var cosine = out.normal.z;
    var swing = bend + COSINE_ROUNDING;
    if view.is_perspective != 0u {
        let distance = length(centre);
        cosine = select(0.0, dot(out.normal, centre) / distance, distance > 0.0);
        swing += radius / max(distance, radius);
    }
    out.owner = chunk.leaf << OWNER_SHIFT;
    if cosine < swing {
        out.owner |= MAY_ENTER;
    }
    if cosine > -swing {
        out.owner |= MAY_LEAVE;
    }
    let c = clamp(abs(cosine), LEAST_SPREAD_COSINE, 1.0);
    let tangent = sqrt(max(1.0 - c * c, 0.0)) / c;
    out.reach = min(0.5 * radius * (tangent + 0.5), MOST_REACH_IN_RADII * radius);
    views[chunk.view + thread.local] = out;
}
