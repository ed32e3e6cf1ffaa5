//! Scenes without a scene file: `A.ply --minus B.stl --and sphere:0,0,0,1`, read from left to right.

use std::path::Path;

use super::inline_solid::{self, InlineSolidError};
use super::{Leaf, LeafSource, Scene};
use crate::csg::{LeafId, Tree};

/// How an operand joins what stands before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Joint {
    /// Difference.
    Minus,
    /// Intersection.
    And,
    /// Union.
    Plus,
}

/// The leaf that an operand writes: a file's path, or a solid as `kind:numbers`. It is named after the file or the kind.
///
/// # Errors
/// [`InlineSolidError`] where a solid's numbers do not make one.
pub fn leaf(operand: &str) -> Result<Leaf, InlineSolidError> {
    if let Some(solid) = inline_solid::from_text(operand) {
        let kind = operand.split(':').next().unwrap_or("solid").replace('-', "_");
        return Ok(Leaf::new(kind, LeafSource::Solid(solid?)));
    }
    let path = Path::new(operand);
    let stem = path.file_stem().map_or_else(|| operand.into(), |stem| stem.to_string_lossy());
    Ok(Leaf::new(stem, LeafSource::File(path.to_owned())))
}

impl Scene {
    /// The scene of one operand, see [`leaf`].
    ///
    /// # Errors
    /// As [`leaf`].
    pub fn of_operand(operand: &str) -> Result<Self, InlineSolidError> {
        Ok(Self::new(vec![leaf(operand)?], Tree::leaf(LeafId(0))))
    }

    /// This scene with one more operand: the result so far is the left one. A name that is taken gets a number.
    ///
    /// # Errors
    /// As [`leaf`].
    pub fn joined(mut self, joint: Joint, operand: &str) -> Result<Self, InlineSolidError> {
        let mut leaf = leaf(operand)?;
        let is_taken = |name: &str| self.leaves.iter().any(|other| other.name == name);
        if is_taken(&leaf.name) {
            let free = (2..).map(|n: u64| format!("{}_{n}", leaf.name)).find(|name| !is_taken(name));
            leaf.name = free.unwrap_or(leaf.name);
        }
        let right = Tree::leaf(LeafId(self.leaves.len() as u32));
        self.leaves.push(leaf);
        self.tree = match joint {
            Joint::Minus => Tree::minus(self.tree, right),
            Joint::And => Tree::and(self.tree, right),
            Joint::Plus => Tree::or(self.tree, right),
        };
        Ok(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Solid;

    #[test]
    fn operands_are_joined_from_left_to_right() {
        let scene = Scene::of_operand("scans/femur.ply")
            .unwrap()
            .joined(Joint::Minus, "drill.stl")
            .unwrap()
            .joined(Joint::And, "half-space:0,0,0,0,0,1")
            .unwrap()
            .joined(Joint::Plus, "other/drill.obj")
            .unwrap();
        let text = scene.tree.display(|leaf| scene.leaves[leaf.0 as usize].name.clone()).to_string();
        assert_eq!(text, "(femur - drill) & half_space | drill_2");
        assert!(matches!(&scene.leaves[0].source, LeafSource::File(path) if path == Path::new("scans/femur.ply")));
        assert!(matches!(scene.leaves[2].source, LeafSource::Solid(Solid::HalfSpace { .. })));
        assert!(Scene::of_operand("sphere:1,2").is_err());
    }
}
