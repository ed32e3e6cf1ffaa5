// The hatching of caps: the twin of composite::section.

@group(0) @binding(8) var<storage, read> stripes: array<StripesRow>;

// The length of line from 0 to a place; a line begins at every multiple of the spacing.
fn inked(to: f32, spacing: f32, width: f32) -> f32 {
    let lines = floor(to / spacing);
    return lines * width + min(to - lines * spacing, width);
}

// The share of ink in a pixel of a cap.
fn hatch_ink(row: StripesRow, at: vec2<u32>) -> f32 {
    let here = vec3<f32>(1.0, vec2<f32>(at) - view.middle);
    let above = dot(row.above, here);
    let below = dot(row.below, here);
    let right = below * (below + row.below.y);
    let down = below * (below + row.below.z);
    // The plane is seen edge-on: the mean of all.
    if right == 0.0 || down == 0.0 {
        return WIDEST_SHARE;
    }
    let place = above / below;
    // To the next pixel: the difference of two fractions, without that of two large numbers.
    let pixel = length(vec2<f32>(
        (row.above.y * below - above * row.below.y) / right,
        (row.above.z * below - above * row.below.z) / down
    ));
    if !(pixel > 0.0 && pixel < FAR && abs(place) < FAR) {
        return WIDEST_SHARE;
    }
    let width = min(changes.line_px * pixel, WIDEST_SHARE * row.spacing);
    let edge = place - 0.5 * pixel;
    let from_line = edge - floor(edge / row.spacing) * row.spacing;
    let ink = inked(from_line + pixel, row.spacing, width) - inked(from_line, row.spacing, width);
    return clamp(ink / pixel, 0.0, 1.0);
}

// The boundary as hatched, where it is a cap.
fn hatched(was: LayerRecord, at: vec2<u32>) -> LayerRecord {
    var record = was;
    let leaf_count = arrayLength(&leaves);
    if record.leaf >= leaf_count {
        return record;
    }
    let section = leaves[record.leaf].known >> SECTION_SHIFT;
    if section == 0u {
        return record;
    }
    var rank = record.body;
    if record.body < leaf_count {
        rank = leaves[record.body].rank;
        if (leaves[record.body].known & KNOWS_CAP_COLOUR) != 0u {
            record.colour = leaves[record.body].cap_colour;
        }
    }
    let ink = hatch_ink(stripes[(section - 1u) * HATCHINGS + rank % HATCHINGS], at);
    let opacity = ink + (1.0 - ink) * record.opacity;
    if opacity > 0.0 {
        let surface = (1.0 - ink) * record.opacity / opacity;
        record.colour = record.colour * surface + changes.hatch_ink * (1.0 - surface);
    }
    record.opacity = opacity;
    return record;
}
