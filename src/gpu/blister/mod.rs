//! The mesh pipeline on the GPU: [`blister`](crate::blister) with its fragments found by the GPU's rasteriser.
//!
//! ```text
//! MeshFrame (CPU, f64): snapped corners, planes, hits of solids ─► arrangement ─► raster ─► fragments ─► resolve ─► write ─► GpuLayers
//! ```
//!
//! *Theory.* Blister §3-4; what a boundary is, who owns it and what lies behind are as in [`blister`](crate::blister).
//!
//! *Changes from the paper.* WGSL has no `f64`, so vertices are projected and snapped on the CPU, as for its own pipeline: then both
//! cover the same samples. There are four ways to classify what is drawn. `list` puts every fragment into its pixel's list in one pass
//! and resolves the lists in compute (the default: the fastest on lavapipe). `tiles` looks through the triangles of a small tile once for
//! each layer, in compute. `running` and `parity` peel, the first carrying every leaf's membership from layer to layer, the second testing
//! every leaf's parity at every layer anew, as the paper does. Both sides of a layer are asked (§4.3 and Fig. 12 of the paper disagree on
//! ties), and all of its coincident fragments toggle together.
//!
//! *Practice.* Shaders are made for what a frame has: for its words of memberships, and without code for sheets, half-spaces or colours
//! where there are none. [`arrangement`] is what is uploaded; `list`, `tiles` and `peel` draw it, the rasterising ones with the pipelines of `draws`. A
//! band that needs more than one buffer's worth of fragments is refused with [`GpuError::TooLarge`](super::GpuError::TooLarge), and drawn
//! in parts by whoever asked.

pub mod arrangement;
mod crossings;
mod draws;
pub mod frame;
mod list;
mod peel;
mod pieces;
mod tiles;

pub(super) use arrangement::Traits;
pub use frame::{Classifier, GpuMeshFrame, Peeling};

use super::buffers::MOST_GROUPS;
use super::crossings::{CROSSING_ENTERS, CROSSING_SHOWS, CrossingRecord, LEAVES_A_WORD};
use super::layers::LayerRecord;
use super::shader::Shader;
use crate::csg::steps::{INSIDE, OUTSIDE};
use arrangement::{Fragment, Frame, KeptBoundary, PeelPixel, PlacedCorner, Slot, Step, Surface, Survivor, flags};
use pieces::{Piece, TILE, TileBoundary};

/// No slot.
const NO_SLOT: u32 = u32::MAX;

/// The bits of the least and the greatest size that a key can have for peeling, 2⁻⁶³ and 2⁶⁴. A depth buffer holds numbers from 0 to
/// 1, half as many as there are positive floats: these are as many.
const FIRST_KEY: u32 = (127 - 63) << 23;
const LAST_KEY: u32 = (127 + 64) << 23;

/// Nearer than every order: one more than that of the nearest key, whose bits are those of 1.
const ALL_ORDERS: u32 = LAST_KEY - FIRST_KEY + 1;

/// What a kernel says where the driver ended one of its loops: llvmpipe allows a thread 65 535 turns, and says nothing.
pub(super) const CUT_SHORT: u32 = u32::MAX;

/// Fragments that are counted: far more than one buffer holds, and far fewer than a counter does.
const MOST_COUNTED: u32 = 1 << 31;

/// The module, for frames with these traits.
pub(super) fn shader(traits: Traits) -> Shader {
    Shader::new("blister")
        .with_constant("WORDS", traits.words)
        .with_constant("STEPS", traits.steps)
        .with_constant("HAS_SHEETS", u32::from(traits.has_sheets))
        .with_constant("HAS_ENDLESS", u32::from(traits.has_endless))
        .with_constant("HAS_COLOURS", u32::from(traits.has_colours))
        .with_constant("MOST_WALKED", list::MOST_WALKED)
        .with_constant("MOST_GROUPS", MOST_GROUPS)
        .with_constant("NO_SLOT", NO_SLOT)
        .with_constant("CUT_SHORT", CUT_SHORT)
        .with_constant("MOST_COUNTED", MOST_COUNTED)
        .with_constant("STEP_INSIDE", INSIDE)
        .with_constant("STEP_OUTSIDE", OUTSIDE)
        .with_constant("BOUNDARY_FRONT", flags::BOUNDARY_FRONT)
        .with_constant("SLOT_NUMBER", flags::SLOT_NUMBER)
        .with_constant("FRAGMENT_HIDDEN", flags::FRAGMENT_HIDDEN)
        .with_constant("FRAGMENT_SHEET", flags::FRAGMENT_SHEET)
        .with_constant("FRAGMENT_ENDLESS", flags::FRAGMENT_ENDLESS)
        .with_constant("FRAGMENT_OPAQUE", flags::FRAGMENT_OPAQUE)
        .with_constant("SLOT_SHEET", flags::SLOT_SHEET)
        .with_constant("SLOT_IN_SUPERSET", flags::SLOT_IN_SUPERSET)
        .with_constant("PIECE_HIDDEN", flags::PIECE_HIDDEN)
        .with_constant("TILE", TILE)
        .with_constant("NO_KEY", f32::MIN)
        .with_constant("ALL_KEYS", f32::MAX)
        .with_constant("FIRST_KEY", FIRST_KEY)
        .with_constant("LAST_KEY", LAST_KEY)
        .with_constant("ALL_ORDERS", ALL_ORDERS)
        .with_constant("SLOT_ENDLESS", flags::SLOT_ENDLESS)
        .with_constant("LEAVES_A_WORD", LEAVES_A_WORD)
        .with_constant("CROSSING_ENTERS", CROSSING_ENTERS)
        .with_constant("CROSSING_SHOWS", CROSSING_SHOWS)
        .with_constant("SURFACE_HIDDEN", flags::SURFACE_HIDDEN)
        .with_constant("SURFACE_OWN_COLOUR", flags::SURFACE_OWN_COLOUR)
        .with_constant("SURFACE_CORNER_COLOURS", flags::SURFACE_CORNER_COLOURS)
        .with_struct::<Frame>()
        .with_struct::<Step>()
        .with_struct::<Slot>()
        .with_struct::<Surface>()
        .with_struct::<Fragment>()
        .with_struct::<Survivor>()
        .with_struct::<Piece>()
        .with_struct::<TileBoundary>()
        .with_struct::<PeelPixel>()
        .with_struct::<KeptBoundary>()
        .with_struct::<PlacedCorner>()
        .with_struct::<LayerRecord>()
        .with_struct::<CrossingRecord>()
        .with_text(include_str!("../../../shaders/blister/frame.wgsl"))
        .with_text(include_str!("../../../shaders/blister/expression.wgsl"))
        .with_text(include_str!("../../../shaders/blister/raster.wgsl"))
        .with_text(include_str!("../../../shaders/blister/list.wgsl"))
        .with_text(include_str!("../../../shaders/blister/resolve.wgsl"))
        .with_text(include_str!("../../../shaders/blister/write.wgsl"))
        .with_text(include_str!("../../../shaders/blister/crossings.wgsl"))
        .with_text(include_str!("../../../shaders/blister/peel.wgsl"))
        .with_text(include_str!("../../../shaders/blister/tiles.wgsl"))
}
