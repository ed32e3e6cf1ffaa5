// Twin of blister/raster.rs: triangles on the grid, and single fragments, into fragments.

struct Corner {
    // Pixels of the picture.
    @location(0) position: vec2<f32>,
    @location(1) surface: u32,
}

struct Drawn {
    @builtin(position) position: vec4<f32>,
    @location(0) @interpolate(flat) surface: u32,
}

@vertex
fn raster_vertex(corner: Corner) -> Drawn {
    let across = (corner.position - vec2<f32>(frame.origin)) * (2.0 / vec2<f32>(frame.size));
    return Drawn(vec4<f32>(across.x - 1.0, 1.0 - across.y, 0.0, 1.0), corner.surface);
}
