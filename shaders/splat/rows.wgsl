// The twin of src/splat/rows.rs: what one ray meets of one leaf's surfels.

@group(0) @binding(0) var<uniform> view: SplatView;
@group(0) @binding(1) var<storage, read> views: array<SurfelView>;
@group(0) @binding(2) var<storage, read> members: array<u32>;
@group(0) @binding(3) var<storage, read> starts: array<u32>;

// No member of a list.
const NONE: u32 = 0xffffffffu;
// A depth behind all others.
const FARTHEST: f32 = 3.4e38;

struct Ray {
    // Picture pixels.
    px: vec2<f32>,
    // Direction, whose third component is 1, view axes.
    dir: vec3<f32>,
    // The depth that all others are relative to, as a sum of two.
    anchor: vec2<f32>,
}

// The surfels of one leaf that touch a block: runs of `members`, those that rays can enter the leaf through first.
struct Run {
    leaf: u32,
    first: array<u32, LISTS>,
    end: array<u32, LISTS>,
}

// A surfel's terms at one point of a ray.
struct Terms {
    // |e|²/r², or eᵀSe.
    support: f32,
    // n·e + ½ eᵀMe, and its derivatives along the ray.
    value: f32,
    slope: f32,
    half_bend: f32,
    // n + Me, and its derivative along the ray.
    normal: vec3<f32>,
    turn: vec3<f32>,
}

fn times(a: vec4<f32>, b: vec2<f32>, v: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(
        a.x * v.x + a.y * v.y + a.z * v.z,
        a.y * v.x + a.w * v.y + b.x * v.z,
        a.z * v.x + b.x * v.y + b.y * v.z,
    );
}

fn reference_depth(ray: Ray, id: u32) -> f32 {
    return (views[id].depth.x - ray.anchor.x) + (views[id].depth.y - ray.anchor.y);
}

// The ray's point at the reference depth, less the surfel's centre.
fn at_reference(ray: Ray, id: u32) -> vec3<f32> {
    let middle = views[id].middle;
    let aside = (ray.px - middle.xz) - middle.yw;
    return vec3<f32>(aside * views[id].scale, views[id].lift);
}

fn support(id: u32, e: vec3<f32>) -> f32 {
    return dot(e, times(views[id].support_a, views[id].support_b, e));
}

fn terms_at(ray: Ray, id: u32, t: f32) -> Terms {
    let e = at_reference(ray, id) + ray.dir * (t - reference_depth(ray, id));
    let normal = views[id].normal;
    let bend = times(views[id].curvature_a, views[id].curvature_b, e);
    let turn = times(views[id].curvature_a, views[id].curvature_b, ray.dir);
    var terms: Terms;
    terms.support = support(id, e);
    terms.value = dot(normal, e) + 0.5 * dot(e, bend);
    terms.slope = dot(normal, ray.dir) + dot(ray.dir, bend);
    terms.half_bend = 0.5 * dot(ray.dir, turn);
    terms.normal = normal + bend;
    terms.turn = turn;
    return terms;
}

fn field_weight(support: f32) -> f32 {
    let v = 1.0 - support;
    return (v * v) * (v * v);
}

// Whether the surfel's ball may hold a point of the ray between two depths.
fn touches(ray: Ray, id: u32, nearest: f32, farthest: f32) -> bool {
    let b = views[id].bounds;
    if ray.px.x < b.x || ray.px.x > b.y || ray.px.y < b.z || ray.px.y > b.w {
        return false;
    }
    let centre = reference_depth(ray, id) - views[id].lift;
    let radius = views[id].radius;
    return centre - radius <= farthest && centre + radius >= nearest;
}

// Groups of candidates that may be one surface, and those that nobody uses, are lists in one pool.
@group(0) @binding(4) var<storage, read_write> groups: array<Group>;
// How many groups and hits all pixels together asked for, then every pixel's first hit.
@group(0) @binding(5) var<storage, read_write> pixels: array<atomic<u32>>;

// The pixel's own: groups of surfaces that the ray enters and leaves, and those to use again.
var<private> entering: u32;
var<private> leaving: u32;
var<private> unused: u32;

// A group to use; NONE where the pool has no room, which is counted, so that the next one has.
fn new_group() -> u32 {
    if unused != NONE {
        let group = unused;
        unused = groups[group].next;
        return group;
    }
    let group = atomicAdd(&pixels[GROUPS_NEEDED], 1u);
    return select(NONE, group, group < view.room.x);
}

// Gives back a list of groups.
fn give_back(first: u32) {
    var group = first;
    while group != NONE {
        let next = groups[group].next;
        groups[group].next = unused;
        unused = group;
        group = next;
    }
}

// Adds a candidate to the first group whose surface it belongs to, or opens one.
fn join(ray: Ray, id: u32, front: bool, t: f32, w: f32) {
    let reach = views[id].reach;
    var last = NONE;
    var group = select(leaving, entering, front);
    while group != NONE {
        if t + reach >= groups[group].lower && t - reach <= groups[group].upper {
            groups[group].lower = min(groups[group].lower, t - reach);
            groups[group].upper = max(groups[group].upper, t + reach);
            groups[group].weight += w;
            groups[group].weighted_depth += w * t;
            if w >= groups[group].best_weight {
                groups[group].best_weight = w;
                groups[group].best_depth = t;
                groups[group].best = id;
            }
            return;
        }
        last = group;
        group = groups[group].next;
    }
    group = new_group();
    if group == NONE {
        return;
    }
    groups[group] = Group(t - reach, t + reach, w, w * t, w, t, id, NONE, 0u, 0.0, 0.0);
    if last != NONE {
        groups[last].next = group;
    } else if front {
        entering = group;
    } else {
        leaving = group;
    }
}

// Where a0 + a1 tau + a2 tau^2 vanishes with the slope -root, in the form that subtracts no nearly equal numbers.
fn crossing(a0: f32, a1: f32, a2: f32, root: f32) -> f32 {
    if a1 * root > 0.0 {
        return (-a1 - root) / (2.0 * a2);
    }
    return 2.0 * a0 / (root - a1);
}

// Adds the root of a surfel's quadric that enters the leaf, or the one that leaves it, where inside the support: `z` is the
// reference depth and `root` that of the discriminant.
fn offer(ray: Ray, id: u32, q: Terms, z: f32, root: f32, front: bool, hidden_from: f32) {
    if (views[id].owner & select(MAY_LEAVE, MAY_ENTER, front)) == 0u {
        return;
    }
    let tau = crossing(q.value, q.slope, q.half_bend, select(-root, root, front));
    let u = support(id, at_reference(ray, id) + ray.dir * tau);
    let t = tau + z;
    // Comparisons are false for NaN, so a vanishing denominator drops the candidate.
    if u < 1.0 && t < hidden_from {
        let v = 1.0 - u;
        join(ray, id, front, t, v * v);
    }
}

// Adds the surfaces that the ray meets among the surfels of one list to the groups; nothing is seen from `hidden_from` on.
fn detect(ray: Ray, first: u32, end: u32, hidden_from: f32) {
    for (var i = first; i < end; i++) {
        let id = members[i];
        if views[id].kind == KIND_OFF || !touches(ray, id, -FARTHEST, hidden_from) {
            continue;
        }
        let z = reference_depth(ray, id);
        let q = terms_at(ray, id, z);
        let square = q.slope * q.slope - 4.0 * q.value * q.half_bend;
        if square >= 0.0 {
            offer(ray, id, q, z, sqrt(square), true, hidden_from);
            offer(ray, id, q, z, sqrt(square), false, hidden_from);
        }
    }
}

// Where and how the ray meets one surface.
struct Solution {
    hit: bool,
    // It seems to pass the surface although it meets it by what the nearest surfel says.
    dropped: bool,
    t: f32,
    // The leaf's outward normal in view axes, of any length.
    normal: vec3<f32>,
    colour: vec3<f32>,
    opacity: f32,
}

// Which surfels are of the surface that a group is about: those that the ray meets from its side, and, where the nearest is met
// edge-on, those of the same sheet that are so too, whichever way they turn.
struct Sheet {
    front: bool,
    // That of the group's nearest surfel.
    normal: vec3<f32>,
    // The slope along the ray up to which a surfel is met edge-on; 0 where the nearest is not.
    edge_on: f32,
}

fn is_edge_on(id: u32) -> bool {
    return (views[id].owner & (MAY_ENTER | MAY_LEAVE)) == (MAY_ENTER | MAY_LEAVE);
}

fn sheet_of(ray: Ray, group: Group, front: bool) -> Sheet {
    let grazing = select(0.0, GRAZING_COSINE_SQUARED, is_edge_on(group.best));
    return Sheet(front, views[group.best].normal, sqrt(dot(ray.dir, ray.dir) * grazing));
}

// Whether a field of this slope is met from the group's side.
fn faces(sheet: Sheet, slope: f32) -> bool {
    return select(slope > 0.0, slope < 0.0, sheet.front);
}

// Whether it is so, or edge-on.
fn may_face(sheet: Sheet, slope: f32) -> bool {
    return select(slope > -sheet.edge_on, slope < sheet.edge_on, sheet.front);
}

fn is_on_sheet(sheet: Sheet, id: u32, slope: f32) -> bool {
    let of_sheet = dot(sheet.normal, views[id].normal) > SAME_SHEET;
    return faces(sheet, slope) || (is_edge_on(id) && of_sheet && may_face(sheet, slope));
}

// With `crosses` the ray is known to meet the surface, and is not dropped.
fn solve(ray: Ray, run: Run, group: Group, front: bool, steps: u32, crosses: bool) -> Solution {
    let start = group.weighted_depth / group.weight;
    let sheet = sheet_of(ray, group, front);
    // Step 1: the quadratic about the mean candidate.
    var a0 = 0.0;
    var a1 = 0.0;
    var a2 = 0.0;
    var weight = 0.0;
    var normal = vec3<f32>();
    var turn = vec3<f32>();
    var colour = vec3<f32>();
    var opacity = 0.0;
    for (var list = 0u; list < LISTS; list++) {
        for (var i = run.first[list]; i < run.end[list]; i++) {
            let id = members[i];
            if !touches(ray, id, start, start) {
                continue;
            }
            let q = terms_at(ray, id, start);
            if !(q.support < 1.0 && is_on_sheet(sheet, id, q.slope)) {
                continue;
            }
            let w = field_weight(q.support);
            weight += w;
            a0 += w * q.value;
            a1 += w * q.slope;
            a2 += w * q.half_bend;
            normal += w * q.normal;
            turn += w * q.turn;
            colour += w * views[id].colour;
            opacity += w * views[id].opacity;
        }
    }
    let square = a1 * a1 - 4.0 * a0 * a2;
    let root = sqrt(max(square, 0.0));
    let tau = crossing(a0, a1, a2, select(-root, root, front));
    let radius = views[group.best].radius;
    let near = abs(tau) < radius * FARTHEST_SOLVE_IN_RADII;
    // Edge-on, the mean candidate may lie beyond where the ray is nearest to the surface: the root lies before.
    let solved = square >= 0.0 && may_face(sheet, a1 / weight) && near && weight > LEAST_WEIGHT;
    // A ray that misses passes the surface at a grazing angle: that is a silhouette, and the group is dropped. A steep ray that
    // has no solution meets a surface whose surfels disagree: it keeps its nearest surfel's hit.
    let along = dot(normal, ray.dir);
    let grazing = dot(normal, normal) * dot(ray.dir, ray.dir) * GRAZING_COSINE_SQUARED;
    let steep = along * along > grazing || weight <= LEAST_WEIGHT;
    var out: Solution;
    let sure = group.best_weight > SURE_WEIGHT;
    out.hit = solved || (sure && (steep || crosses));
    out.dropped = sure && !out.hit;
    if !out.hit {
        return out;
    }
    out.t = group.best_depth;
    out.normal = normal;
    if solved {
        out.t = start + tau;
        out.normal = normal + turn * tau;
    }
    // Step 2: Newton steps on the field, weights renewed. A step that diverges keeps the hit it had.
    for (var step = 0u; step < select(0u, steps, solved); step++) {
        var value = 0.0;
        var rate = 0.0;
        var total = 0.0;
        for (var list = 0u; list < LISTS; list++) {
            for (var i = run.first[list]; i < run.end[list]; i++) {
                let id = members[i];
                if !touches(ray, id, out.t, out.t) {
                    continue;
                }
                let q = terms_at(ray, id, out.t);
                if !(q.support < 1.0 && is_on_sheet(sheet, id, q.slope)) {
                    continue;
                }
                let w = field_weight(q.support);
                total += w;
                value += w * q.value;
                rate += w * q.slope;
            }
        }
        let change = value / rate;
        if total > LEAST_WEIGHT && faces(sheet, rate) && abs(change) < radius * MOST_STEP_IN_RADII {
            out.t -= change;
        }
    }
    if weight <= LEAST_WEIGHT {
        out.normal = views[group.best].normal;
        out.colour = views[group.best].colour;
        out.opacity = views[group.best].opacity;
    } else {
        out.colour = colour / weight;
        out.opacity = opacity / weight;
    }
    return out;
}

// A leaf's field at a point of a ray: sums over the surfels that reach it, by their weights.
struct FieldAt {
    weight: f32,
    // Of their quadrics' values.
    value: f32,
    // Of their quadrics' normals, view axes.
    normal: vec3<f32>,
    // Of their radii.
    radius: f32,
}

// The field of a leaf at the ray's point of depth `t`. No surfel reaches it where the weight is `LEAST_WEIGHT` or less.
fn field_at(ray: Ray, run: Run, t: f32) -> FieldAt {
    var field: FieldAt;
    for (var list = 0u; list < LISTS; list++) {
        for (var i = run.first[list]; i < run.end[list]; i++) {
            let id = members[i];
            if !touches(ray, id, t, t) {
                continue;
            }
            let q = terms_at(ray, id, t);
            if q.support < 1.0 {
                let w = field_weight(q.support);
                field.weight += w;
                field.value += w * q.value;
                field.normal += w * q.normal;
                field.radius += w * views[id].radius;
            }
        }
    }
    return field;
}
