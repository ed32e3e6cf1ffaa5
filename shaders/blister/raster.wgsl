// Twin of blister/raster.rs: triangles on the grid, and single fragments, into fragments.

struct Corner {
    // Pixels of the picture.
    @location(0) position: vec2<f32>,
    @location(1) surface: u32,
}

// What a fragment stage knows without a look into memory.
struct Drawn {
    @builtin(position) position: vec4<f32>,
    @location(0) @interpolate(flat) surface: u32,
    // With FRAGMENT_…
    @location(1) @interpolate(flat) slot: u32,
    @location(2) @interpolate(flat) key: vec3<f32>,
    @location(3) @interpolate(flat) anchor: vec2<f32>,
    @location(4) @interpolate(flat) range: vec2<f32>,
}

@vertex
fn raster_vertex(corner: Corner) -> Drawn {
    let across = (corner.position - vec2<f32>(frame.origin)) * (2.0 / vec2<f32>(frame.size));
    let position = vec4<f32>(across.x - 1.0, 1.0 - across.y, 0.0, 1.0);
    let surface = surfaces[corner.surface];
    return Drawn(position, corner.surface, surface.slot, surface.key, surface.anchor, surface.range);
}

fn slot_of_drawn(drawn: Drawn) -> u32 {
    return drawn.slot & SLOT_NUMBER;
}

fn key_of_drawn(drawn: Drawn, pixel: vec2<u32>) -> f32 {
    return key_at(drawn.key, drawn.anchor, drawn.range, pixel);
}
