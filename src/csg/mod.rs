//! The one Boolean semantics: expression, tree, positive form, Blist, three-valued evaluation, residuals.

/// A leaf, by its index in the scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct LeafId(pub u32);

/// An expression tree.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Tree;
