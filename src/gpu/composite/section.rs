//! The hatching of caps: the twin of [`composite::section`](crate::composite::section).
//!
//! *Theory.* The place across the stripes of what a pixel sees of a plane is a fraction of two linear functions of the pixel's
//! column and row: with a ray's direction d linear in them, t = (p − e)·n / d·n and the place is (e + t d)·a.
//!
//! *Practice.* Shaders have no f64. The fraction's coefficients are made in f64, after as many whole stripes are taken off it as lie
//! before the section's own point, so that what is left is as small as the picture.

use glam::DVec3;

use crate::composite::section::{Hatching, SPACINGS, SectionPlane, Stripes, WIDEST_SHARE};
use crate::gpu::shader::Shader;
use crate::gpu_struct;
use crate::space::{Camera, Projection};

gpu_struct! {
    /// The stripes on one section's plane, for leaves of one rank.
    pub struct StripesRow {
        /// The fraction's upper part: constant, by column and by row from the picture's middle.
        above: [f32; 3],
        /// Distance of lines, world units.
        spacing: f32,
        /// The lower part.
        below: [f32; 3],
        /// Fills the row.
        unused: u32,
    }
}

/// Ranks differ in the direction of lines, or in their distance; then they begin anew.
const HATCHINGS: usize = 2 * SPACINGS.len();

/// With what hatches.
pub(super) fn with_hatching(shader: Shader) -> Shader {
    shader
        .with_constant("HATCHINGS", HATCHINGS as u32)
        .with_constant("WIDEST_SHARE", WIDEST_SHARE as f32)
        .with_struct::<StripesRow>()
}

/// The stripes of all ranks, section by section; at least one row.
pub(super) fn stripes(hatching: Option<&Hatching>, camera: &Camera) -> Vec<StripesRow> {
    let Some(hatching) = hatching else { return vec![StripesRow::default()] };
    // A leaf beyond the table has its number as its rank.
    let beyond = hatching.ranks.len().next_multiple_of(HATCHINGS);
    let of_section = |section: &SectionPlane| {
        (0..HATCHINGS)
            .map(|rank| row(section, hatching.stripes(section, (beyond + rank) as u32), camera))
            .collect::<Vec<_>>()
    };
    hatching.sections.iter().flat_map(of_section).collect()
}

fn row(section: &SectionPlane, Stripes { across, spacing }: Stripes, camera: &Camera) -> StripesRow {
    let Camera { eye, right, down, forward, .. } = camera;
    let (normal, distance) = (section.normal, (section.point - eye).dot(section.normal));
    let whole_stripes = (section.point.dot(across) / spacing).round() * spacing;
    let eye_place = eye.dot(across) - whole_stripes;
    let (above, below) = match camera.projection {
        Projection::Perspective { focal_px } => {
            let directions = [*forward, *right / focal_px, *down / focal_px];
            let below = DVec3::from(directions.map(|d| d.dot(normal)));
            (below * eye_place + DVec3::from(directions.map(|d| d.dot(across))) * distance, below)
        }
        Projection::Orthographic { px_per_unit } => {
            let (along_normal, along_across) = (forward.dot(normal), forward.dot(across));
            let aside = |to: DVec3| (to.dot(across) * along_normal - to.dot(normal) * along_across) / px_per_unit;
            let middle = eye_place * along_normal + distance * along_across;
            (DVec3::new(middle, aside(*right), aside(*down)), DVec3::new(along_normal, 0.0, 0.0))
        }
    };
    StripesRow {
        above: above.as_vec3().to_array(),
        spacing: spacing as f32,
        below: below.as_vec3().to_array(),
        unused: 0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_struct_is_the_shaders() {
        crate::gpu::layout::assert_same_layout::<StripesRow>();
    }
}
