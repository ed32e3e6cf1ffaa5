// Where the lines of each layer pass between two pixels: the twin of composite::edges.

@group(0) @binding(1) var<storage, read> facet_offsets: array<u32>;
@group(0) @binding(2) var<storage, read> facets: array<Facet>;
@group(0) @binding(3) var<uniform> rules: LineRules;
// How many points each pixel has with those to its right and below it; their sums once that is known.
@group(0) @binding(4) var<storage, read_write> point_offsets: array<u32>;
@group(0) @binding(5) var<storage, read_write> points: array<EdgePoint>;
@group(0) @binding(6) var<uniform> mode: Mode;

// Two pixels side by side (axis 0) or one above the other (1).
struct Place {
    at: vec2<u32>,
    axis: u32,
}

// A facet, where there is one.
struct Found {
    is_there: bool,
    facet: Facet,
}

// Where a line passes: the share of the way between two pixels' middles, and the unit vector across it, zero where unknown.
struct Crossing {
    t: f32,
    across: vec2<f32>,
}

fn faces_alike(a: Facet, b: Facet) -> bool {
    return ((a.marks ^ b.marks) & IS_FRONT) == 0u;
}

// How many footprints deeper `b` is.
fn deeper(a: Facet, b: Facet) -> f32 {
    return (b.depth - a.depth) * a.px_per_unit;
}

// Whether `b`, of the next pixel along `axis`, shows the surface of `a`.
fn goes_on(a: Facet, b: Facet, axis: u32) -> bool {
    let by = deeper(a, b);
    let amiss = min(abs(by - a.step[axis]), abs(by - b.step[axis]));
    let curved = min(abs(a.step[axis]), abs(b.step[axis]));
    return faces_alike(a, b) && amiss <= rules.jump_px + CURVED_SHARE * curved;
}

fn moved(at: vec2<u32>, axis: u32, by: i32) -> vec2<i32> {
    let step = select(vec2<i32>(0, by), vec2<i32>(by, 0), axis == 0u);
    return vec2<i32>(at) + step;
}

fn is_in_band(at: vec2<i32>) -> bool {
    let low = vec2<i32>(view.band.xy);
    return all(at >= low) && all(at < low + vec2<i32>(view.band.zw));
}

// The facet that goes on from `facet`, `by` pixels from the place's first pixel.
fn neighbour(facet: Facet, place: Place, by: i32) -> Found {
    var found: Found;
    let at = moved(place.at, place.axis, by);
    if !is_in_band(at) {
        return found;
    }
    let pixel = in_band(vec2<u32>(at));
    for (var i = facet_offsets[pixel]; i < facet_offsets[pixel + 1u]; i++) {
        let other = facets[i];
        if by < 0 {
            found.is_there = goes_on(other, facet, place.axis);
        } else {
            found.is_there = goes_on(facet, other, place.axis);
        }
        if found.is_there {
            found.facet = other;
            break;
        }
    }
    return found;
}

// How many times `whole` is in `part`: very often where it is nothing.
fn times(part: f32, whole: f32) -> f32 {
    if whole == 0.0 {
        return FAR;
    }
    return part / whole;
}

// The share of the way and the direction as two planes have them; half way and none where they cannot be right.
fn trusted(t: f32, across: vec2<f32>) -> Crossing {
    let squared = dot(across, across);
    if squared > LEAST_SQUARED && t > -SLACK && t < 1.0 + SLACK {
        return Crossing(clamp(t, 0.0, 1.0), across * (1.0 / sqrt(squared)));
    }
    return Crossing(0.5, vec2<f32>(0.0));
}

fn point_at(place: Place, crossing: Crossing) -> EdgePoint {
    var point: EdgePoint;
    point.at = vec2<f32>(place.at) + 0.5;
    point.at += select(vec2<f32>(0.0, crossing.t), vec2<f32>(crossing.t, 0.0), place.axis == 0u);
    point.across = crossing.across;
    return point;
}

// How far two facets' normals are apart, as a chord of the unit circle.
fn turn(a: Facet, b: Facet) -> f32 {
    return distance(a.normal, b.normal);
}

// Where the surface of `a` folds into that of `b`; a strength of 0 where it does not.
fn crease(a: Facet, b: Facet, place: Place) -> EdgePoint {
    var none: EdgePoint;
    var turned = turn(a, b);
    let before = neighbour(a, place, -1);
    let after = neighbour(b, place, 2);
    let turn_before = select(0.0, turn(before.facet, a), before.is_there);
    let turn_after = select(0.0, turn(b, after.facet), after.is_there);
    // The fastest turn is the crease; of two alike, the first.
    if !(turned >= turn_before && turned > turn_after) {
        return none;
    }
    var left = a;
    var right = b;
    var from_left = 0.0;
    var from_right = 1.0;
    if turned < rules.crease {
        // Towards a silhouette every body turns faster; only a turn that slows down again is a crease.
        if !before.is_there || !after.is_there || !(turned >= PEAK * max(turn_before, turn_after)) {
            return none;
        }
        turned = turn(before.facet, after.facet);
        left = before.facet;
        right = after.facet;
        from_left = -1.0;
        from_right = 2.0;
    }
    let strength = (turned / rules.crease - 1.0) / (FULL_CREASE - 1.0);
    if !(strength > 0.0) {
        return none;
    }
    let bend = left.step - right.step;
    let apart = deeper(left, right) + from_left * left.step[place.axis] - from_right * right.step[place.axis];
    var point = point_at(place, trusted(times(apart, bend[place.axis]), bend));
    point.depth = min(a.depth, b.depth);
    point.strength = min(strength, 1.0);
    point.marks = (a.marks | b.marks) & IS_HEAVY;
    return point;
}

// Where the surface of `facet`, with the back `mate` where that ends with it, ends before the other pixel's `other`.
fn silhouette(facet: Facet, mate: Found, other: Found, place: Place, ends_in_second: bool) -> EdgePoint {
    var crossing = Crossing(0.5, vec2<f32>(0.0));
    if mate.is_there {
        let smoothness = clamp((dot(facet.normal, mate.facet.normal) - SHARP_COS) / (SMOOTH_COS - SHARP_COS), 0.0, 1.0);
        let thinning = mate.facet.step - facet.step;
        let along = select(-thinning[place.axis], thinning[place.axis], ends_in_second);
        let reach = times(-deeper(facet, mate.facet), along) * (1.0 - 0.5 * smoothness);
        crossing = trusted(select(1.0 - reach, reach, ends_in_second), thinning);
    }
    var point = point_at(place, crossing);
    point.depth = facet.depth;
    point.strength = 1.0;
    point.marks = IS_SILHOUETTE | (facet.marks & IS_HEAVY);
    if other.is_there {
        point.marks |= other.facet.marks & IS_HEAVY;
    }
    return point;
}

fn put(number: u32, point: EdgePoint, layer: u32, until: u32) {
    if mode.writes != 0u {
        points[number] = point;
        points[number].layer = layer;
        points[number].until = until;
    }
}

fn facet_if(is_there: bool, number: u32) -> Found {
    var found: Found;
    found.is_there = is_there;
    if is_there {
        found.facet = facets[number];
    }
    return found;
}

// Finds the points between two pixels and puts them from number `first` on; returns how many there are.
fn pair(place: Place, first: u32) -> u32 {
    let writes = mode.writes != 0u;
    let here = in_band(place.at);
    let there = in_band(vec2<u32>(moved(place.at, place.axis, 1)));
    let p0 = facet_offsets[here];
    let q0 = facet_offsets[there];
    let p_count = facet_offsets[here + 1u] - p0;
    let q_count = facet_offsets[there + 1u] - q0;
    let deepest = max(p_count, q_count);
    var made = 0u;
    // The first of those whose last layer is not known yet.
    var first_open = 0u;
    var i = 0u;
    var j = 0u;
    while i < p_count || j < q_count {
        let a = facet_if(i < p_count, p0 + i);
        let b = facet_if(j < q_count, q0 + j);
        let layer = min(i, j);
        if a.is_there && b.is_there && goes_on(a.facet, b.facet, place.axis) {
            if i == j && writes {
                // From here on, layers are the same surfaces again.
                for (var k = first + first_open; k < first + made; k++) {
                    if (points[k].marks & IS_SILHOUETTE) != 0u {
                        points[k].until = max(layer, points[k].layer + 1u);
                    }
                }
            }
            if dot(a.facet.normal, b.facet.normal) < rules.least_cos {
                let point = crease(a.facet, b.facet, place);
                if point.strength > 0.0 {
                    put(first + made, point, layer, layer + 1u);
                    made += 1u;
                }
            }
            if i == j {
                first_open = made;
            }
            i += 1u;
            j += 1u;
            continue;
        }
        // The nearer of the two has no match: whatever matched it would be nearer than the other.
        let p_is_nearer = select(a.is_there, a.facet.depth <= b.facet.depth, a.is_there && b.is_there);
        var near = b;
        var other = a;
        var mate = facet_if(j + 1u < q_count, q0 + j + 1u);
        var others = p0 + i;
        var others_end = p0 + p_count;
        if p_is_nearer {
            near = a;
            other = b;
            mate = facet_if(i + 1u < p_count, p0 + i + 1u);
            others = q0 + j;
            others_end = q0 + q_count;
        }
        mate.is_there = mate.is_there && !faces_alike(mate.facet, near.facet);
        var mate_goes_on = false;
        if mate.is_there {
            for (var k = others; k < others_end && !mate_goes_on; k++) {
                if p_is_nearer {
                    mate_goes_on = goes_on(mate.facet, facets[k], place.axis);
                } else {
                    mate_goes_on = goes_on(facets[k], mate.facet, place.axis);
                }
            }
        }
        mate.is_there = mate.is_there && !mate_goes_on;
        put(first + made, silhouette(near.facet, mate, other, place, p_is_nearer), layer, deepest);
        made += 1u;
        // A surface that stepped is both pixels' k-th; one that ended is one pixel's alone.
        let ended = select(1u, 2u, mate.is_there);
        if mate_goes_on && other.is_there && faces_alike(other.facet, near.facet) {
            i += 1u;
            j += 1u;
        } else if p_is_nearer {
            i += ended;
        } else {
            j += ended;
        }
    }
    if writes {
        // Edges with nothing behind them end with the last layer.
        for (var k = first + first_open; k < first + made; k++) {
            points[k].until = max(points[k].until, points[k].layer + 1u);
        }
    }
    return made;
}

// The points between each pixel and those to its right and below it: first how many, then, in a second pass, the points.
@compute @workgroup_size(WORKGROUP)
fn find_edges(thread: Thread) {
    let number = thread_number(thread);
    if number >= part_area() {
        return;
    }
    let at = part_pixel(number);
    var first = 0u;
    if mode.writes != 0u {
        first = point_offsets[number];
    }
    var made = 0u;
    for (var axis = 0u; axis < 2u; axis++) {
        if is_in_band(moved(at, axis, 1)) {
            made += pair(Place(at, axis), first + made);
        }
    }
    if mode.writes == 0u {
        point_offsets[number] = made;
    }
}
