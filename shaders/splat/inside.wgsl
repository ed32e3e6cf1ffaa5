// The twin of src/classify/inside.rs: whether a point is inside of a leaf, asked of some of its surfels. A patch is a run of
// partners, words of `tables`, each the number of a disk; disks are rows of `far`: see src/gpu/splat/clip.rs.

struct Patch {
    first: u32,
    end: u32,
    // −1 for one with all normals reversed.
    sign: f32,
    // Whether only disks whose balls hold the point count.
    holding: bool,
}

// What is asked about: a point relative to the centre of the surfel that is clipped, world axes; and that centre relative to the
// origin of what is far, as a sum of two.
var<private> clip_point: vec3<f32>;
var<private> clip_centre: vec3<f32>;
var<private> clip_centre_rest: vec3<f32>;

fn disk_at(place: u32) -> u32 {
    return view.disks + tables[place] * ROWS_A_DISK;
}

// The centre of the disk whose rows begin at `row`, relative to that of the surfel that is clipped.
fn disk_centre(row: u32) -> vec3<f32> {
    return (far[row].xyz - clip_centre) + (far[row + 1u].xyz - clip_centre_rest);
}

fn square_distance(a: vec3<f32>, b: vec3<f32>) -> f32 {
    let d = a - b;
    return dot(d, d);
}

// Whether the point is not behind the disk.
fn disk_clips(row: u32, x: vec3<f32>, sign: f32) -> bool {
    return !(sign * dot(x - disk_centre(row), far[row + 2u].xyz) < 0.0);
}

// |e|²/r², or eᵀSe.
fn disk_support(row: u32, e: vec3<f32>) -> f32 {
    if far[row + 2u].w == 0.0 {
        let radius = far[row].w;
        return dot(e, e) / (radius * radius);
    }
    return dot(e, times(vec4<f32>(far[row + 4u].zw, far[row + 5u].xy), far[row + 5u].zw, e));
}

fn counts(patch_: Patch, row: u32) -> bool {
    return !patch_.holding || square_distance(disk_centre(row), clip_point) < far[row].w * far[row].w;
}

// From inside of the patch to 1 inside of the leaf, and 0 outside.
fn of_leaf(patch_: Patch, inside: bool) -> i32 {
    return select(0, 1, inside != (patch_.sign < 0.0));
}

// The rows of the nearest two disks that count; NONE where there is none.
fn nearest_two(patch_: Patch) -> vec2<u32> {
    var rows = vec2<u32>(NONE);
    var squares = vec2<f32>(FARTHEST);
    for (var i = patch_.first; i < patch_.end; i++) {
        let row = disk_at(i);
        if !counts(patch_, row) {
            continue;
        }
        let square = square_distance(disk_centre(row), clip_point);
        // Of equally near ones the first.
        if square < squares.x || rows.x == NONE {
            rows = vec2<u32>(row, rows.x);
            squares = vec2<f32>(square, squares.x);
        } else if square < squares.y || rows.y == NONE {
            rows.y = row;
            squares.y = square;
        }
    }
    return rows;
}

fn inside_nearest(patch_: Patch) -> i32 {
    let row = nearest_two(patch_).x;
    if row == NONE {
        return -1;
    }
    return of_leaf(patch_, !disk_clips(row, clip_point, patch_.sign));
}

fn inside_two_nearest(patch_: Patch) -> i32 {
    let rows = nearest_two(patch_);
    if rows.x == NONE {
        return -1;
    }
    let in_first = !disk_clips(rows.x, clip_point, patch_.sign);
    if rows.y == NONE {
        return of_leaf(patch_, in_first);
    }
    let in_second = !disk_clips(rows.y, clip_point, patch_.sign);
    let is_concave = disk_clips(rows.x, disk_centre(rows.y), patch_.sign)
        && disk_clips(rows.y, disk_centre(rows.x), patch_.sign);
    return of_leaf(patch_, select(in_first && in_second, in_first || in_second, is_concave));
}

fn inside_any_plane(patch_: Patch) -> i32 {
    var is_reached = false;
    for (var i = patch_.first; i < patch_.end; i++) {
        let row = disk_at(i);
        if disk_support(row, clip_point - disk_centre(row)) < 1.0 {
            is_reached = true;
            if disk_clips(row, clip_point, patch_.sign) {
                return of_leaf(patch_, false);
            }
        }
    }
    if !is_reached {
        return inside_nearest(patch_);
    }
    return of_leaf(patch_, true);
}

fn inside_weighted(patch_: Patch, is_curved: bool) -> i32 {
    var weights = 0.0;
    var heights = 0.0;
    for (var i = patch_.first; i < patch_.end; i++) {
        let row = disk_at(i);
        let e = clip_point - disk_centre(row);
        let v = 1.0 - disk_support(row, e);
        if v > 0.0 {
            let w = (v * v) * (v * v);
            var height = dot(far[row + 2u].xyz, e);
            if is_curved {
                height += 0.5 * dot(e, times(far[row + 3u], far[row + 4u].xy, e));
            }
            weights += w;
            heights += w * height;
        }
    }
    if !(weights > 0.0) {
        return inside_nearest(patch_);
    }
    return select(0, 1, heights < 0.0);
}

// Whether the point is inside of the patch's leaf: 1 inside, 0 outside, −1 where there is no disk to ask.
fn ask(patch_: Patch) -> i32 {
    switch view.inside {
        case INSIDE_NEAREST: {
            return inside_nearest(patch_);
        }
        case INSIDE_TWO_NEAREST: {
            return inside_two_nearest(patch_);
        }
        case INSIDE_ANY_PLANE: {
            return inside_any_plane(patch_);
        }
        case INSIDE_BLEND: {
            return inside_weighted(patch_, false);
        }
        default: {
            return inside_weighted(patch_, true);
        }
    }
}
