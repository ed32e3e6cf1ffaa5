//! The one Boolean semantics: every pipeline asks this module what an expression means, and none has its own.
//!
//! ```text
//! text ─ expression::parse ─► Tree ─ positive() ─► Positive ─┬─ Blist      one point, lazily: a forward walk
//!          ▲                   │                             ├─ Residual   one surfel: which neighbours still matter
//!          │                   │                             ├─ Flat       many points of a tile: masks, or toggle by toggle
//!          └──── display() ────┘                             ├─ Product    each intersection that the result is a union of
//!                                                            └─ PaperTree  Wicke's own rules, for comparison
//! ```
//!
//! Trees are flat arenas in post-order, so nothing here recurses: an expression a million levels deep is read, printed,
//! converted, evaluated and dropped in linear time and constant call depth.

mod bits;
pub mod blist;
#[cfg(test)]
mod deep;
#[cfg(test)]
mod exhaustive;
pub mod expression;
pub mod flat;
pub mod paper;
pub mod positive;
pub mod products;
pub mod residual;
mod tree;
mod tri;

pub use blist::{Blist, Jump};
pub use expression::ExpressionError;
pub use flat::{Counters, Flat, Kept, Shrunk};
pub use paper::PaperTree;
pub use positive::{Literal, Positive};
pub use products::{Product, TooManyProducts};
pub use residual::{Crossing, EdgeResidual, Membership, Residual};
pub use tree::{DisplayTree, Node, Tree, TreeBuilder};
pub use tri::Tri;

/// A leaf, by its index in the scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct LeafId(pub u32);
