//! The modules of the surfel pipeline.

use super::far::{ROWS_A_CLUSTER, ROWS_AN_ELEMENT};
use super::model::{ModelSupport, ModelSurfel};
use super::project::{ChunkView, MAY_ENTER, MAY_LEAVE, OWNER_SHIFT, SplatView, SurfelView};
use super::trace::{FIRST_PIXEL, GROUPS_MOST, GROUPS_NEEDED, Group, HITS_NEEDED, Hit, UNFINISHED};
use super::{bins, crossed, tables};
use crate::geometry::winding;
use crate::gpu::layers::LayerRecord;
use crate::gpu::shader::Shader;
use crate::splat::bins::BLOCK;
use crate::splat::{project, rows, surface};

/// Every module, for scenes of few leaves and of many.
pub(in crate::gpu) fn all() -> Vec<Shader> {
    vec![self::project(), bins::shader(), trace(1), trace(4), merge(), hits()]
}

/// Projects surfels.
pub(super) fn project() -> Shader {
    let shader = Shader::new("splat project")
        .with_struct::<SplatView>()
        .with_struct::<ChunkView>()
        .with_struct::<ModelSurfel>()
        .with_struct::<ModelSupport>()
        .with_struct::<SurfelView>();
    tables::with_kinds(owners(shader))
        .with_constant("NEAREST_REFERENCE_IN_RADII", project::NEAREST_REFERENCE_IN_RADII as f32)
        .with_constant("BOUNDS_ROUNDING_PX", project::BOUNDS_ROUNDING_PX as f32)
        .with_constant("F32_ROUNDING", ROUNDINGS * f32::EPSILON)
        .with_constant("COSINE_ROUNDING", project::COSINE_ROUNDING)
        .with_constant("LEAST_SPREAD_COSINE", project::LEAST_SPREAD_COSINE)
        .with_constant("MOST_REACH_IN_RADII", project::MOST_REACH_IN_RADII)
        .with_text(include_str!("../../../shaders/splat/project.wgsl"))
}

/// By how many roundings of the numbers that go into them bounds are widened.
const ROUNDINGS: f32 = 8.0;

/// How deep a tree over 2³² surfels may be.
const TREE_DEPTH: u32 = u32::BITS;

fn owners(shader: Shader) -> Shader {
    shader
        .with_constant("MAY_ENTER", MAY_ENTER)
        .with_constant("MAY_LEAVE", MAY_LEAVE)
        .with_constant("OWNER_SHIFT", OWNER_SHIFT)
}

/// Traces rays, in a scene whose sets of leaves take `leaf_words` words.
pub(super) fn trace(leaf_words: u32) -> Shader {
    let shader = Shader::new("splat trace").with_struct::<SplatView>().with_struct::<SurfelView>().with_struct::<Hit>();
    crossed::with_constants(tables::with_constants(tables::with_kinds(owners(shader))))
        .with_constant("LEAF_WORDS", leaf_words)
        .with_constant("BLOCK", BLOCK)
        .with_constant("LISTS", bins::LISTS)
        .with_constant("GROUPS_NEEDED", GROUPS_NEEDED)
        .with_constant("HITS_NEEDED", HITS_NEEDED)
        .with_constant("UNFINISHED", UNFINISHED)
        .with_constant("FIRST_PIXEL", FIRST_PIXEL)
        .with_constant("GRAZING_COSINE_SQUARED", rows::GRAZING_COSINE_SQUARED)
        .with_constant("SURE_WEIGHT", rows::SURE_WEIGHT)
        .with_constant("LEAST_WEIGHT", rows::LEAST_WEIGHT)
        .with_constant("FARTHEST_SOLVE_IN_RADII", rows::FARTHEST_SOLVE_IN_RADII)
        .with_constant("MOST_STEP_IN_RADII", rows::MOST_STEP_IN_RADII)
        .with_constant("EDGE_STEPS", surface::EDGE_STEPS)
        .with_constant("OPACITY_ROUNDING", surface::OPACITY_ROUNDING)
        .with_constant("FAR_IN_RADII", winding::FAR as f32)
        .with_constant("RUN_OF_ELEMENTS", winding::LEAF as u32)
        .with_constant("ROWS_A_CLUSTER", ROWS_A_CLUSTER)
        .with_constant("ROWS_AN_ELEMENT", ROWS_AN_ELEMENT)
        .with_constant("TREE_DEPTH", TREE_DEPTH)
        .with_struct::<Group>()
        .with_text(include_str!("../../../shaders/splat/rows.wgsl"))
        .with_text(include_str!("../../../shaders/splat/far.wgsl"))
        .with_text(include_str!("../../../shaders/splat/residual.wgsl"))
        .with_text(include_str!("../../../shaders/splat/surface.wgsl"))
        .with_text(include_str!("../../../shaders/splat/crossed.wgsl"))
}

/// Joins samples.
pub(super) fn merge() -> Shader {
    Shader::new("splat merge")
        .with_struct::<SplatView>()
        .with_struct::<Hit>()
        .with_constant("GROUPS_NEEDED", GROUPS_NEEDED)
        .with_constant("GROUPS_MOST", GROUPS_MOST)
        .with_constant("UNFINISHED", UNFINISHED)
        .with_constant("FIRST_PIXEL", FIRST_PIXEL)
        .with_text(include_str!("../../../shaders/splat/merge.wgsl"))
}

/// Writes records.
pub(super) fn hits() -> Shader {
    Shader::new("splat hits")
        .with_struct::<SplatView>()
        .with_struct::<SurfelView>()
        .with_struct::<Hit>()
        .with_struct::<LayerRecord>()
        .with_constant("BLOCK", BLOCK)
        .with_constant("LISTS", bins::LISTS)
        .with_constant("FIRST_PIXEL", FIRST_PIXEL)
        .with_text(include_str!("../../../shaders/splat/hits.wgsl"))
}
