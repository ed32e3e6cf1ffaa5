//! What a leaf is drawn as, where the user chooses.
//!
//! By itself a leaf is drawn as what it is: points as surfels, a mesh by its triangles, a solid by its formula. To compare
//! ways of drawing on one scene, or to draw a mesh as a scan of it would be drawn, a leaf can be given another form.

use super::nearest_name::nearest_name;
use super::{LeafGeometry, Scene};

/// What a leaf is drawn as.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Representation {
    /// Surfels and nothing else: a mesh or a solid is sampled, and its own form forgotten.
    Surfels,
    /// Triangles: a solid is tessellated.
    Mesh,
    /// Itself: a mesh by its triangles, a solid by its formula.
    Exact,
}

impl Representation {
    /// Every choice.
    pub const ALL: [Self; 3] = [Self::Surfels, Self::Mesh, Self::Exact];

    /// Its name in flags and scene files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Surfels => "surfels",
            Self::Mesh => "mesh",
            Self::Exact => "exact",
        }
    }

    /// The choice called `name`.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|choice| choice.name() == name)
    }
}

/// Why a leaf cannot be given a representation.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum RepresentError {
    /// No leaf has the name.
    #[error("the scene has no leaf `{leaf}`{}: its leaves are {}", suggestion(meant), listed(leaves))]
    NoSuchLeaf {
        /// As given.
        leaf: String,
        /// The name that was probably meant.
        meant: Option<String>,
        /// The names there are.
        leaves: Vec<String>,
    },
    /// Points cannot become anything else.
    #[error(
        "leaf `{leaf}` is a cloud of points, which can only be drawn as surfels, not as `{}`: leave its representation \
         out, or give the leaf the file of a mesh",
        asked.name()
    )]
    Cloud {
        /// The leaf.
        leaf: String,
        /// What was asked for.
        asked: Representation,
    },
    /// A solid without a finite surface has no triangles.
    #[error(
        "leaf `{leaf}` is a half-space, whose surface has no end, so it cannot be a mesh: use `exact`, or a box in its place"
    )]
    Endless {
        /// The leaf.
        leaf: String,
    },
}

fn suggestion(meant: &Option<String>) -> String {
    meant.as_ref().map_or(String::new(), |name| format!(" (did you mean `{name}`?)"))
}

/// The first of `names`, as many as a line takes.
fn listed(names: &[String]) -> String {
    const MOST: usize = 12;
    let mut text = names.iter().take(MOST).map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ");
    if names.len() > MOST {
        text.push_str(&format!(" and {} more", names.len() - MOST));
    }
    text
}

impl Scene {
    /// Draws the leaf called `leaf` as `representation`.
    ///
    /// # Errors
    /// [`RepresentError::NoSuchLeaf`].
    pub fn represent(&mut self, leaf: &str, representation: Representation) -> Result<(), RepresentError> {
        if let Some(found) = self.leaves.iter_mut().find(|known| known.name == leaf) {
            found.represent = Some(representation);
            return Ok(());
        }
        let leaves: Vec<String> = self.leaves.iter().map(|leaf| leaf.name.clone()).collect();
        let meant = nearest_name(leaf, leaves.iter().map(String::as_str)).map(str::to_owned);
        Err(RepresentError::NoSuchLeaf { leaf: leaf.to_owned(), meant, leaves })
    }
}

/// What a leaf called `name`, of `geometry`, is drawn as where `asked` is what the user wants.
///
/// # Errors
/// [`RepresentError::Cloud`], [`RepresentError::Endless`].
pub fn resolved(
    name: &str,
    geometry: &LeafGeometry,
    asked: Option<Representation>,
) -> Result<Representation, RepresentError> {
    match (geometry, asked) {
        (LeafGeometry::Cloud(_), None | Some(Representation::Surfels)) => Ok(Representation::Surfels),
        (LeafGeometry::Cloud(_), Some(asked)) => Err(RepresentError::Cloud { leaf: name.to_owned(), asked }),
        (LeafGeometry::Solid(crate::geometry::Solid::HalfSpace { .. }), Some(Representation::Mesh)) => {
            Err(RepresentError::Endless { leaf: name.to_owned() })
        }
        (_, asked) => Ok(asked.unwrap_or(Representation::Exact)),
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::geometry::{PointCloud, Solid, TriMesh};
    use crate::scene::one_liner::Joint;

    #[test]
    fn unknown_leaves_are_refused_with_the_nearest_name() {
        let mut scene = Scene::of_operand("sphere:0,0,0,1").unwrap().joined(Joint::Minus, "box:0,0,0,1,1,1").unwrap();
        let name = scene.leaves[0].name.clone();
        scene.represent(&name, Representation::Surfels).unwrap();
        assert_eq!(scene.leaves[0].represent, Some(Representation::Surfels));
        let mistyped = format!("{name}x");
        let message = scene.represent(&mistyped, Representation::Mesh).unwrap_err().to_string();
        assert!(message.contains(&format!("did you mean `{name}`")), "{message}");
        let message = scene.represent("zzzzzzzzz", Representation::Mesh).unwrap_err().to_string();
        assert!(!message.contains("did you mean") && message.contains(&format!("`{name}`")), "{message}");
    }

    #[test]
    fn points_are_surfels_and_half_spaces_no_meshes() {
        let cloud = LeafGeometry::Cloud(Arc::new(PointCloud::default()));
        let mesh = LeafGeometry::Mesh(Arc::new(TriMesh::default()));
        let half = Solid::HalfSpace { point: glam::DVec3::ZERO, normal: glam::DVec3::Z, extent: 1.0 };
        let half = LeafGeometry::Solid(half);
        let of = |geometry: &LeafGeometry, asked| resolved("scan", geometry, asked);
        assert_eq!(of(&cloud, None), Ok(Representation::Surfels));
        assert_eq!(of(&mesh, None), Ok(Representation::Exact));
        assert_eq!(of(&mesh, Some(Representation::Surfels)), Ok(Representation::Surfels));
        for asked in [Representation::Mesh, Representation::Exact] {
            let message = of(&cloud, Some(asked)).unwrap_err().to_string();
            assert!(message.contains("`scan`") && message.contains("give the leaf the file of a mesh"), "{message}");
        }
        assert!(of(&half, Some(Representation::Mesh)).unwrap_err().to_string().contains("use `exact`"));
    }
}
