//! The one Boolean semantics: every pipeline asks this module what an expression means, and none has its own.
//!
//! ```text
//! text ─ expression::parse ─► Tree ─ positive() ─► Positive ─┬─ Blist      one point, lazily: a forward walk
//!          │                   │                             │  ├─ Walk       the same point as leaves are toggled
//!          │                   │                             │  └─ StatusList 64 points at once, decided or not
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
pub mod left_heavy;
pub mod paper;
pub mod positive;
pub mod products;
pub mod residual;
pub mod status;
pub mod steps;
pub mod superset;
mod table;
mod tree;
mod tri;
pub mod walk;

pub use blist::{Blist, Jump};
pub use expression::ExpressionError;
pub use flat::{Counters, Flat, Kept, Shrunk};
pub use left_heavy::First;
pub use paper::PaperTree;
pub use positive::{Literal, Positive};
pub use products::{Product, TooManyProducts};
pub use residual::{Crossing, EdgeResidual, Membership, Residual};
pub use status::{Points, StatusList};
pub use tree::{DisplayTree, Node, Tree, TreeBuilder};
pub use tri::Tri;
pub use walk::Walk;

/// A leaf, by its index in the scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct LeafId(pub u32);
