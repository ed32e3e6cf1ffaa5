// What all shaders of the mesh pipeline share: the frame, its surfaces, and the pixels of a band.

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> steps: array<Step>;
@group(0) @binding(2) var<storage, read> slots: array<Slot>;
@group(0) @binding(3) var<storage, read> surfaces: array<Surface>;

fn pixel_count() -> u32 {
    return frame.size.x * frame.size.y;
}

// The key that a surface has at a pixel of the band: the same bits for all surfaces of one plane.
fn key_at(key: vec3<f32>, anchor: vec2<f32>, range: vec2<f32>, pixel: vec2<u32>) -> f32 {
    let offset = vec2<f32>(pixel + frame.origin) - anchor;
    // Fused wherever it stands, so that no compiler fuses it in one place and not in another.
    return clamp(fma(key.x, offset.x, fma(key.y, offset.y, key.z)), range.x, range.y);
}

fn is_sheet(slot: u32) -> bool {
    return (slots[slot].flags & SLOT_SHEET) != 0u;
}

// Half-spaces: where a ray begins is told by a function of the pixel, not by its crossings.
fn is_endless(slot: u32) -> bool {
    return (slots[slot].flags & SLOT_ENDLESS) != 0u;
}

fn begins_inside(slot: u32, pixel: vec2<u32>) -> bool {
    let side = slots[slot].begins;
    let at = vec2<f32>(pixel + frame.origin);
    return side.x * at.x + side.y * at.y + side.z < 0.0;
}

// Whether the driver has ended a loop of this thread before its time, without a word: then it ends this one too. Its length must
// not be known beforehand, so that it stays a loop.
fn is_cut_short_within(turns: u32) -> bool {
    var turn = 0u;
    while turn < turns {
        turn++;
    }
    return turn < turns;
}

fn is_cut_short() -> bool {
    return is_cut_short_within(2u + frame.is_perspective);
}
