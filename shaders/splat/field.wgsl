// Surfaces that are clipped on the fields of the leaves, without partners, and by crossings of those that have no field: see
// src/splat/surface.rs.

fn side(leaf: u32) -> bool {
    if !is_crossed(leaf) {
        return side_by_field(leaf);
    }
    if !is_known(leaf) {
        let beside = coincident_crossing(leaf);
        if is_sheet(leaf) {
            note(leaf, false, false);
        } else if beside != NONE {
            note_tie(leaf, has_flag(beside, CROSSING_ENTERS));
        } else {
            let inside = side_by_crossings(hit_ray, hit_pixel, leaf, hit_t);
            note(leaf, inside, inside);
        }
    }
    return known_side(leaf, false);
}

// How the result changes where the ray of the hit meets the edge surfel with view `id`.
fn edge_crossing(id: u32, tau: f32) -> u32 {
    return crossing_of(views[id].kind);
}
