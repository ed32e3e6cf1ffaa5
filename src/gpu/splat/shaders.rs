//! The modules of the surfel pipeline.

use super::far::{ROWS_A_CLUSTER, ROWS_AN_ELEMENT};
use super::fragment::{Footprint, Fragment, RESOLVED_TOGETHER};
use super::model::{ModelSupport, ModelSurfel};
use super::project::{ChunkView, MAY_ENTER, MAY_LEAVE, OWNER_SHIFT, SplatView, SurfelView};
use super::trace::{
    FIRST_PIXEL, GROUPS_MOST, GROUPS_NEEDED, Group, HITS_NEEDED, Hit, TIED, TIED_ENTERS, TIED_SHOWS, UNFINISHED,
};
use super::{bins, clip, crossed, tables};
use crate::geometry::winding;
use crate::gpu::layers::LayerRecord;
use crate::gpu::shader::Shader;
use crate::splat::bins::BLOCK;
use crate::splat::{self, ewa, project, rows, surface, tied, turns};
use crate::surfel::SAME_SHEET;

/// Every module, for scenes of few leaves and of many.
pub(in crate::gpu) fn all() -> Vec<Shader> {
    let mut all = vec![self::project(), bins::shader(), merge(), hits(), partners()];
    for (leaf_words, list_words, stack_words) in [(1, 1, 1), (4, 9, 2)] {
        for takes_turns in [false, true] {
            all.push(trace(leaf_words, takes_turns, Asked::Fields { list_words }));
            all.push(trace(leaf_words, takes_turns, Asked::Partners { stack_words }));
        }
        all.push(fragment(leaf_words, stack_words));
        all.push(clip_buffer(leaf_words, stack_words));
    }
    all
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

/// Who tells sides where surfaces are clipped.
#[derive(Debug, Clone, Copy)]
pub(super) enum Asked {
    /// Leaves' fields, and crossings of those that have no surfels, in a scene whose sets of the Blist's entries take so many words.
    Fields { list_words: u32 },
    /// Surfels' partners, with the words that the paper tree's stack takes.
    Partners { stack_words: u32 },
}

/// Traces rays, in a scene whose sets of leaves take `leaf_words` words. Without `takes_turns` there is no code that puts crossings in
/// turn: llvmpipe goes through loops that no ray wants, and counts them.
pub(super) fn trace(leaf_words: u32, takes_turns: bool, asked: Asked) -> Shader {
    let shader = sides(Shader::new("splat trace"), leaf_words)
        .with_constant("EDGE_STEPS", surface::EDGE_STEPS)
        .with_constant("OPACITY_ROUNDING", surface::OPACITY_ROUNDING);
    let shader = match asked {
        Asked::Partners { stack_words } => clip::with_partners(shader, stack_words),
        Asked::Fields { list_words } => crossed::with_constants(shader)
            .with_constant("LIST_WORDS", list_words)
            .with_text(include_str!("../../../shaders/splat/field.wgsl"))
            .with_constant("TIED_SHARE", tied::TIED_SHARE)
            .with_constant("MOST_SINE", tied::MOST_SINE)
            .with_constant("LEAST_TIED_COSINE", tied::LEAST_COSINE)
            .with_constant("MOST_TIED_REACH_IN_RADII", tied::MOST_REACH_IN_RADII)
            .with_text(include_str!("../../../shaders/splat/crossed.wgsl"))
            .with_text(include_str!("../../../shaders/splat/tied.wgsl")),
    };
    with_hit_list(shader)
        .with_constant("TAKES_TURNS", u32::from(takes_turns))
        .with_constant("LEAST_STEEPNESS", turns::LEAST_STEEPNESS)
        .with_constant("MOST_STRAY_IN_RADII", turns::MOST_STRAY_IN_RADII)
        .with_text(include_str!("../../../shaders/splat/turns.wgsl"))
        .with_text(include_str!("../../../shaders/splat/surface.wgsl"))
}

/// Lists and clips fragments, in a scene whose sets of leaves take `leaf_words` words and whose paper tree's stack `stack_words`.
pub(super) fn fragment(leaf_words: u32, stack_words: u32) -> Shader {
    with_hit_list(footprints(Shader::new("splat fragment"), leaf_words, stack_words))
        .with_struct::<Fragment>()
        .with_constant("RESOLVED_TOGETHER", RESOLVED_TOGETHER)
        .with_constant("REACHES_OF_A_SURFACE", splat::fragment::REACHES_OF_A_SURFACE)
        .with_text(include_str!("../../../shaders/splat/fragment.wgsl"))
}

/// Finds partners in the picture; as [`fragment`].
pub(super) fn clip_buffer(leaf_words: u32, stack_words: u32) -> Shader {
    footprints(Shader::new("splat clip buffer"), leaf_words, stack_words)
        .with_text(include_str!("../../../shaders/splat/clip_buffer.wgsl"))
}

/// Keeps each partner once.
pub(super) fn partners() -> Shader {
    Shader::new("splat partners").with_text(include_str!("../../../shaders/splat/partners.wgsl"))
}

fn footprints(shader: Shader, leaf_words: u32, stack_words: u32) -> Shader {
    clip::with_partners(sides(shader, leaf_words), stack_words)
        .with_struct::<Footprint>()
        .with_constant("BORDER_IN_SIGMAS", ewa::BORDER_IN_SIGMAS)
        .with_constant("LOW_PASS_PX", ewa::LOW_PASS_PX)
        .with_constant("REACH_PX", ewa::REACH_PX)
        .with_constant("MOST_DEPTH_SHARE", ewa::MOST_DEPTH_SHARE)
        .with_constant("LEAST_PEAK", ewa::LEAST_PEAK)
        .with_text(include_str!("../../../shaders/splat/ewa.wgsl"))
}

/// What tells sides, in a scene whose sets of leaves take `leaf_words` words.
fn sides(shader: Shader, leaf_words: u32) -> Shader {
    let shader = shader.with_struct::<SplatView>().with_struct::<SurfelView>();
    tables::with_constants(tables::with_kinds(owners(shader)))
        .with_constant("LEAF_WORDS", leaf_words)
        .with_constant("BLOCK", BLOCK)
        .with_constant("LISTS", bins::LISTS)
        .with_constant("GROUPS_NEEDED", GROUPS_NEEDED)
        .with_constant("UNFINISHED", UNFINISHED)
        .with_constant("FIRST_PIXEL", FIRST_PIXEL)
        .with_constant("GRAZING_COSINE_SQUARED", rows::GRAZING_COSINE_SQUARED)
        .with_constant("SAME_SHEET", SAME_SHEET)
        .with_constant("SURE_WEIGHT", rows::SURE_WEIGHT)
        .with_constant("LEAST_WEIGHT", rows::LEAST_WEIGHT)
        .with_constant("FARTHEST_SOLVE_IN_RADII", rows::FARTHEST_SOLVE_IN_RADII)
        .with_constant("MOST_STEP_IN_RADII", rows::MOST_STEP_IN_RADII)
        .with_constant("FAR_IN_RADII", winding::FAR as f32)
        .with_constant("RUN_OF_ELEMENTS", winding::LEAF as u32)
        .with_constant("ROWS_A_CLUSTER", ROWS_A_CLUSTER)
        .with_constant("ROWS_AN_ELEMENT", ROWS_AN_ELEMENT)
        .with_constant("TREE_DEPTH", TREE_DEPTH)
        .with_struct::<Group>()
        .with_text(include_str!("../../../shaders/splat/rows.wgsl"))
        .with_text(include_str!("../../../shaders/splat/far.wgsl"))
        .with_text(include_str!("../../../shaders/splat/residual.wgsl"))
        .with_text(include_str!("../../../shaders/splat/sides.wgsl"))
}

/// The lists of pixels' hits.
fn with_hit_list(shader: Shader) -> Shader {
    shader
        .with_struct::<Hit>()
        .with_constant("HITS_NEEDED", HITS_NEEDED)
        .with_constant("TIED", TIED)
        .with_constant("TIED_ENTERS", TIED_ENTERS)
        .with_constant("TIED_SHOWS", TIED_SHOWS)
        .with_text(include_str!("../../../shaders/splat/hit_list.wgsl"))
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
