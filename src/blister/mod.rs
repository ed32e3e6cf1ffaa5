//! From meshes and analytic solids to the boundaries of the result at every pixel, without an intermediate mesh.
//!
//! ```text
//! MeshModel ─► visible ─► project ─► bins ─► one tile at a time:
//!  (world)                (24.8)            the expression shrinks to the leaves present ─► raster, beyond, solids ─► fragments
//!                                                                                 peel: leaf bits toggled front to back
//!                                                                                 ─► boundaries ─► LayerTile
//! ```
//!
//! *Theory.* Blister (Hable and Rossignac 2005) peels the depth layers of all leaves, classifies every layer against
//! every leaf by parity, evaluates the expression, and keeps the nearest layer where it holds. A pixel's peel is the set
//! of all fragments that share the next depth.
//!
//! *Changes from the paper.* The paper draws every leaf again for every layer, because a GPU of 2004 keeps one depth a
//! pixel. Here every triangle is drawn once, into lists of fragments; peels come from the lists. The parity of a leaf at a
//! depth is the running toggle of the leaf's fragments peeled so far. A layer is a boundary where the expression before
//! a peel differs from the expression after it, so back faces are layers too and coincident faces toggle
//! together. There is no superset R: a tile that lacks a leaf knows that the leaf is a constant there.
//!
//! *Practice.* [`model`] holds the scene in world space, `planes` the planes that leaves share; `visible` leaves out groups of
//! triangles that lie aside, `project` snaps vertices to the picture, `bins` sorts what is visible by tile; `setup` and `raster` draw
//! the ordinary triangles, `beyond` those that pass the eye, `solids` the analytic leaves; `fragments` is where all three put what they
//! find, and `peel` and, of simple blocks, `few` find boundaries in it, with the rules of `ties`; `survivors` puts them in order and
//! `write` fills them in. [`frame`] is the [`LayerSource`](crate::layers::LayerSource). Fragments are always rasterised: casting rays
//! through a hierarchy for each leaf was measured to win from some 40 triangles a pixel on, and to cost as much as fifty to hundreds of frames
//! before it does.

mod beyond;
mod bins;
mod few;
mod fragments;
pub mod frame;
pub mod model;
mod peel;
mod planes;
mod project;
mod raster;
mod setup;
mod solids;
mod survivors;
#[cfg(test)]
mod tests;
mod ties;
mod visible;
mod write;

pub use frame::MeshFrame;
pub use model::{MeshLeaf, MeshModel, MeshModelError, MeshShape};
