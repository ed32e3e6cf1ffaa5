// Edge points into strokes, and strokes into the ink of each layer at each pixel: the twin of composite::strokes.
//
// The CPU draws stroke after stroke; here each pixel asks the strokes around it, so that nothing is written by two threads.

@group(0) @binding(1) var<uniform> rules: LineRules;
@group(0) @binding(2) var<storage, read> point_offsets: array<u32>;
@group(0) @binding(3) var<storage, read> points: array<EdgePoint>;
@group(0) @binding(4) var<storage, read_write> strokes: array<Stroke>;
// How many layers of ink each pixel has; their sums once that is known.
@group(0) @binding(5) var<storage, read_write> ink_offsets: array<u32>;
// By layer, from the nearest on: the share of the pixel that ink covers, and its depth.
@group(0) @binding(6) var<storage, read_write> inks: array<vec2<f32>>;
@group(0) @binding(7) var<uniform> mode: Mode;

// The pixels of one row of the band, and the points of which they are the left or upper pixel.
struct Row {
    first: u32,
    end: u32,
}

// The points of pixels at most `reach` columns from column `x`, in row `y` of the picture, which is one of the band's.
fn points_of_row(x: u32, y: u32, reach: u32) -> Row {
    let low = max(x, view.band.x + reach) - reach;
    let high = min(x + reach, view.band.x + view.band.z - 1u);
    return Row(point_offsets[in_band(vec2<u32>(low, y))], point_offsets[in_band(vec2<u32>(high, y)) + 1u]);
}

// The band's rows at most `reach` from row `y`: the first, and one past the last.
fn rows_around(y: u32, reach: u32) -> vec2<u32> {
    return vec2<u32>(max(y, view.band.y + reach) - reach, min(y + reach + 1u, view.band.y + view.band.w));
}

fn weight(p: EdgePoint, q: EdgePoint) -> f32 {
    let apart = p.at - q.at;
    let left = max(1.0 - dot(apart, apart) / (WEIGHT_ENDS_PX * WEIGHT_ENDS_PX), 0.0);
    return left * left;
}

fn shares_layers(p: EdgePoint, q: EdgePoint) -> bool {
    return p.layer < q.until && q.layer < p.until;
}

fn is_of_kind(p: EdgePoint, q: EdgePoint) -> bool {
    return ((p.marks ^ q.marks) & IS_SILHOUETTE) == 0u;
}

// The unit vector across the longer axis of points with these second moments: a quarter turn from half of the angle of
// (xx − yy, 2 xy).
fn across_moments(xx: f32, xy: f32, yy: f32) -> vec2<f32> {
    let doubled = vec2<f32>(xx - yy, 2.0 * xy);
    let size = length(doubled);
    if !(size > 0.0) {
        return vec2<f32>(0.0, 1.0);
    }
    let cos_double = doubled.x / size;
    var cos_angle = sqrt(0.5 * (1.0 + abs(cos_double)));
    var sin_angle = 0.5 * doubled.y / size / cos_angle;
    if cos_double < 0.0 {
        // The larger of the two is the one that the root gives well.
        let side = select(1.0, -1.0, sin_angle < 0.0);
        let larger = cos_angle;
        cos_angle = abs(sin_angle);
        sin_angle = side * larger;
    }
    return vec2<f32>(-sin_angle, cos_angle);
}

// The stroke at point number `number`, of the pixel `at`; its strength is 0 for a speck, and for what is not drawn.
fn stroke(number: u32, at: vec2<u32>) -> Stroke {
    let point = points[number];
    var result: Stroke;
    let is_heavy = (point.marks & IS_HEAVY) != 0u;
    if rules.draws_all == 0u && !is_heavy {
        return result;
    }
    let rows = rows_around(at.y, NEAR_PX);
    var neighbours = 0u;
    var sum = 0.0;
    var middle = vec2<f32>(0.0);
    for (var y = rows.x; y < rows.y; y++) {
        let row = points_of_row(at.x, y, NEAR_PX);
        for (var i = row.first; i < row.end; i++) {
            let p = points[i];
            if shares_layers(p, point) {
                neighbours += 1u;
                if is_of_kind(p, point) {
                    let w = weight(p, point);
                    sum += w;
                    middle += w * p.at;
                }
            }
        }
    }
    if neighbours <= FEWEST_NEIGHBOURS {
        return result;
    }
    // The direction: of the surfaces where they know it, else of the points.
    let is_known = any(point.across != vec2<f32>(0.0));
    var across = point.across;
    if !is_known {
        middle /= sum;
        var xx = 0.0;
        var xy = 0.0;
        var yy = 0.0;
        for (var y = rows.x; y < rows.y; y++) {
            let row = points_of_row(at.x, y, NEAR_PX);
            for (var i = row.first; i < row.end; i++) {
                let p = points[i];
                if shares_layers(p, point) && is_of_kind(p, point) {
                    let w = weight(p, point);
                    let d = p.at - middle;
                    xx += w * d.x * d.x;
                    xy += w * d.x * d.y;
                    yy += w * d.y * d.y;
                }
            }
        }
        across = across_moments(xx, xy, yy);
    }
    sum = 0.0;
    var aside = 0.0;
    var mean = vec2<f32>(0.0);
    for (var y = rows.x; y < rows.y; y++) {
        let row = points_of_row(at.x, y, NEAR_PX);
        for (var i = row.first; i < row.end; i++) {
            let p = points[i];
            let off = dot(across, p.at - point.at);
            let way = dot(p.across, across);
            let same_way = (all(p.across == vec2<f32>(0.0)) || abs(way) > SAME_WAY) && abs(off) < SAME_LINE_PX;
            if same_way && shares_layers(p, point) && is_of_kind(p, point) {
                let w = weight(p, point);
                sum += w;
                aside += w * off;
                mean += w * select(1.0, -1.0, way < 0.0) * p.across;
            }
        }
    }
    // The point itself is one of them, so there is a mean.
    if is_known {
        let squared = dot(mean, mean);
        across = select(across, mean * (1.0 / sqrt(squared)), squared > LEAST_SQUARED);
    }
    result.at = point.at + across * (aside / sum);
    result.along = vec2<f32>(-across.y, across.x);
    result.depth = point.depth;
    result.layer = point.layer;
    result.strength = point.strength;
    result.width = rules.width_px * select(1.0, HEAVY, is_heavy);
    return result;
}

// A stroke for each point.
@compute @workgroup_size(WORKGROUP)
fn make_strokes(thread: Thread) {
    let place = thread_number(thread);
    if place >= part_area() {
        return;
    }
    for (var i = point_offsets[place]; i < point_offsets[place + 1u]; i++) {
        strokes[i] = stroke(i, part_pixel(place));
    }
}

// Whether position `at` of a line along `along` is in a dash: 1, in a gap: 0, between at their borders.
fn dash_at(at: vec2<f32>, along: vec2<f32>) -> f32 {
    var ways = DASH_WAYS;
    var direction = ways[0];
    for (var i = 1u; i < DASH_DIRECTIONS; i++) {
        if abs(dot(ways[i], along)) > abs(dot(direction, along)) {
            direction = ways[i];
        }
    }
    let dash = rules.dash.x;
    let period = dash + rules.dash.y;
    let place = dot(at, direction);
    let phase = place - period * floor(place / period);
    return clamp(max(min(0.5 + phase, 0.5 + dash - phase), 0.5 + phase - period), 0.0, 1.0);
}

// The share of the pixel `at` that a stroke inks.
fn ink_of(s: Stroke, at: vec2<u32>) -> f32 {
    let half = 0.5 * s.width;
    let reach = max(half + 0.5, FADED_PX);
    let from_middle = vec2<f32>(at) + 0.5 - s.at;
    if any(abs(from_middle) > vec2<f32>(reach)) {
        return 0.0;
    }
    let aside = abs(s.along.x * from_middle.y - s.along.y * from_middle.x);
    let ahead = abs(dot(s.along, from_middle));
    // A line of `width` through a pixel's box covers so much of it; a hair line is pale, not thin.
    let width_covered = clamp(half + 0.5 - aside, 0.0, min(s.width, 1.0));
    // Round ends, so that wide strokes meet in corners.
    let end = clamp(max(FADED_PX + half - 0.5 - ahead, FADED_PX - ahead) / (FADED_PX - WHOLE_PX), 0.0, 1.0);
    var ink = width_covered * end * s.strength;
    if rules.is_dashed != 0u && s.layer > 0u {
        ink *= dash_at(vec2<f32>(at), s.along);
    }
    return ink;
}

// The ink at each pixel: first how many layers of it, then, in a second pass, the ink.
@compute @workgroup_size(WORKGROUP)
fn find_inks(thread: Thread) {
    let place = thread_number(thread);
    if place >= part_area() {
        return;
    }
    let writes = mode.writes != 0u;
    let at = part_pixel(place);
    var first = 0u;
    if writes {
        first = ink_offsets[place];
        for (var i = first; i < ink_offsets[place + 1u]; i++) {
            inks[i] = vec2<f32>(0.0, FAR);
        }
    }
    var layers = 0u;
    let rows = rows_around(at.y, rules.window);
    for (var y = rows.x; y < rows.y; y++) {
        let row = points_of_row(at.x, y, rules.window);
        for (var i = row.first; i < row.end; i++) {
            let s = strokes[i];
            if !(s.strength > 0.0) || s.layer >= rules.most {
                continue;
            }
            let ink = ink_of(s, at);
            if ink > 0.0 {
                layers = max(layers, s.layer + 1u);
                if writes {
                    let so_far = inks[first + s.layer];
                    inks[first + s.layer] = vec2<f32>(max(so_far.x, ink), min(so_far.y, s.depth));
                }
            }
        }
    }
    if !writes {
        ink_offsets[place] = layers;
    }
}
