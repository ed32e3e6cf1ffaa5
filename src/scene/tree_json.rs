//! Scenes as a tree in JSON, `NAME.tree.json`, with the camera in `NAME.camera.json` beside it: the format of the
//! programs that surfcut is measured against.
//!
//! A node is `{"op": "union" | "intersection" | "difference", "children": [...]}` (a difference is the first child minus all
//! others) or a leaf, `{"mesh": file, "transform": [16 numbers, row by row]}`, the file relative to the tree's. The camera is
//! `{"eye", "target", "up", "fovy", "width", "height"}`, `fovy` in vertical degrees.

use std::fmt;
use std::fs;
use std::path::{Path, PathBuf};

use glam::{DAffine3, DMat4, DVec3, DVec4};
use serde::Deserialize;
use serde::de::{Deserializer, Error as _, MapAccess, SeqAccess, Visitor};

use super::{CameraSpec, Leaf, LeafSource, Scene};
use crate::csg::{LeafId, Tree, TreeBuilder};
use crate::space::Lens;

/// What a scene's name ends with.
pub const TREE_SUFFIX: &str = ".tree.json";

/// What its camera's name ends with, in place of [`TREE_SUFFIX`].
pub const CAMERA_SUFFIX: &str = ".camera.json";

/// The last row of an affine transform may differ from (0, 0, 0, 1) by this much: writers round.
const LAST_ROW_TOLERANCE: f64 = 1e-9;

/// Why a tree cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum TreeJsonError {
    /// A file cannot be opened or read.
    #[error("cannot read {}: {source}", path.display())]
    File {
        /// Which.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// It is not such a file; serde_json tells line and column.
    #[error("{}: {source}", path.display())]
    Json {
        /// Which.
        path: PathBuf,
        /// What is wrong, and where.
        source: serde_json::Error,
    },
}

/// Whether `path` names a scene of this format.
pub fn is_tree_file(path: &Path) -> bool {
    path.file_name().and_then(|name| name.to_str()).is_some_and(|name| name.to_ascii_lowercase().ends_with(TREE_SUFFIX))
}

/// Reads the tree at `path` and the camera beside it; without a camera file the scene is framed.
///
/// # Errors
/// [`TreeJsonError`] names the file, and the line and column of a mistake.
pub fn read(path: &Path) -> Result<Scene, TreeJsonError> {
    let directory = path.parent().unwrap_or(Path::new(""));
    let text =
        |path: &Path| fs::read_to_string(path).map_err(|source| TreeJsonError::File { path: path.to_owned(), source });
    let json = |path: &Path, source| TreeJsonError::Json { path: path.to_owned(), source };
    let Written { leaves, tree } = serde_json::from_str(&text(path)?).map_err(|source| json(path, source))?;
    let leaf = |(number, (file, world_from_leaf)): (usize, (PathBuf, DAffine3))| {
        let stem = file.file_stem().map_or_else(|| "mesh".into(), |stem| stem.to_string_lossy().into_owned());
        let mut leaf = Leaf::new(format!("{stem}_{number}"), LeafSource::File(directory.join(file)));
        leaf.world_from_leaf = world_from_leaf;
        leaf
    };
    let mut scene = Scene::new(leaves.into_iter().enumerate().map(leaf).collect(), tree);
    let camera_path = camera_path(path);
    if camera_path.exists() {
        let camera: Camera = serde_json::from_str(&text(&camera_path)?).map_err(|source| json(&camera_path, source))?;
        scene.size = (camera.width, camera.height);
        scene.camera = Some(CameraSpec {
            eye: DVec3::from_array(camera.eye),
            target: DVec3::from_array(camera.target),
            up: DVec3::from_array(camera.up),
            lens: Lens::FovY(camera.fovy),
        });
    }
    Ok(scene)
}

fn camera_path(path: &Path) -> PathBuf {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    path.with_file_name(format!("{}{CAMERA_SUFFIX}", &name[..name.len().saturating_sub(TREE_SUFFIX.len())]))
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Camera {
    eye: [f64; 3],
    target: [f64; 3],
    up: [f64; 3],
    fovy: f64,
    width: u32,
    height: u32,
}

/// All that a tree file holds.
#[derive(Debug)]
struct Written {
    leaves: Vec<(PathBuf, DAffine3)>,
    tree: Tree,
}

impl<'de> Deserialize<'de> for Written {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let root = Node::deserialize(deserializer)?;
        let mut written = Builder::default();
        written.node(root).map_err(D::Error::custom)?;
        let tree = written.tree.finish().ok_or_else(|| D::Error::custom("the tree is empty"))?;
        Ok(Self { leaves: written.leaves, tree })
    }
}

#[derive(Default)]
struct Builder {
    leaves: Vec<(PathBuf, DAffine3)>,
    tree: TreeBuilder,
}

impl Builder {
    /// serde_json holds nesting to 128 levels, so recursion is bounded.
    fn node(&mut self, node: Node) -> Result<(), String> {
        let (op, children) = match node {
            Node::Leaf { mesh, transform } => {
                let id = u32::try_from(self.leaves.len()).map_err(|_| "there are more leaves than 2^32")?;
                self.leaves.push((mesh, transform));
                self.tree.leaf(LeafId(id));
                return Ok(());
            }
            Node::Operator { op, children } => (op, children),
        };
        for (number, child) in children.into_iter().enumerate() {
            self.node(child)?;
            if number > 0 {
                match op {
                    Operator::Union => self.tree.or(),
                    Operator::Intersection => self.tree.and(),
                    Operator::Difference => self.tree.minus(),
                };
            }
        }
        Ok(())
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Operator {
    Union,
    Intersection,
    Difference,
}

enum Node {
    Leaf { mesh: PathBuf, transform: DAffine3 },
    Operator { op: Operator, children: Vec<Node> },
}

/// Sixteen numbers, row by row.
struct Transform(DAffine3);

impl<'de> Deserialize<'de> for Transform {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let rows = <[f64; 16]>::deserialize(deserializer)?;
        let matrix = DMat4::from_cols_array(&rows).transpose();
        let last = matrix.row(3);
        if !((last - DVec4::W).abs().max_element() <= LAST_ROW_TOLERANCE) {
            return Err(D::Error::custom("the last row of `transform` must be 0, 0, 0, 1: it must be affine"));
        }
        Ok(Self(DAffine3::from_mat4(matrix)))
    }
}

// Written out, not derived: an untagged enum would answer every mistake with "data did not match any variant".
impl<'de> Deserialize<'de> for Node {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct NodeVisitor;

        impl<'de> Visitor<'de> for NodeVisitor {
            type Value = Node;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a leaf with `mesh` and `transform`, or a node with `op` and `children`")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Node, A::Error> {
                let (mut op, mut children, mut mesh, mut transform) = (None, None, None, None);
                while let Some(key) = map.next_key::<String>()? {
                    match key.as_str() {
                        "op" => op = Some(map.next_value::<Operator>()?),
                        "children" => children = Some(map.next_value::<Children>()?.0),
                        "mesh" => mesh = Some(map.next_value::<PathBuf>()?),
                        "transform" => transform = Some(map.next_value::<Transform>()?.0),
                        _ => {
                            let known = &["op", "children", "mesh", "transform"];
                            return Err(A::Error::unknown_field(&key, known));
                        }
                    }
                }
                match (op, children, mesh, transform) {
                    (Some(op), Some(children), None, None) => Ok(Node::Operator { op, children }),
                    (None, None, Some(mesh), transform) => {
                        Ok(Node::Leaf { mesh, transform: transform.unwrap_or(DAffine3::IDENTITY) })
                    }
                    _ => Err(A::Error::custom(
                        "a node has either `op` and `children`, or `mesh` and perhaps `transform`",
                    )),
                }
            }
        }

        /// At least one child.
        struct Children(Vec<Node>);

        impl<'de> Deserialize<'de> for Children {
            fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                struct ChildrenVisitor;

                impl<'de> Visitor<'de> for ChildrenVisitor {
                    type Value = Children;

                    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                        f.write_str("a list of nodes")
                    }

                    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Children, A::Error> {
                        let mut children = Vec::new();
                        while let Some(child) = seq.next_element()? {
                            children.push(child);
                        }
                        if children.is_empty() {
                            return Err(A::Error::custom("`children` is empty: an operator needs at least one"));
                        }
                        Ok(Children(children))
                    }
                }
                deserializer.deserialize_seq(ChildrenVisitor)
            }
        }
        deserializer.deserialize_map(NodeVisitor)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written(text: &str) -> Result<Scene, TreeJsonError> {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.tree.json");
        fs::write(&path, text).unwrap();
        read(&path)
    }

    const LEAF: &str = r#"{"mesh": "m/box.ply", "transform": [2,0,0,5, 0,1,0,6, 0,0,1,7, 0,0,0,1]}"#;

    #[test]
    fn operators_take_their_children_from_left_to_right_and_transforms_are_row_major() {
        let text = format!(
            r#"{{"op": "difference", "children": [{{"op": "union", "children": [{LEAF}, {LEAF}]}}, {LEAF},
               {{"op": "intersection", "children": [{LEAF}, {LEAF}, {LEAF}]}}]}}"#
        );
        let scene = written(&text).unwrap();
        let shown = scene.tree.display(|leaf| char::from(b'a' + leaf.0 as u8).to_string()).to_string();
        assert_eq!(shown, "a | b - c - d & e & f");
        let leaf = &scene.leaves[0];
        assert_eq!(leaf.world_from_leaf.transform_point3(DVec3::ONE), DVec3::new(7.0, 7.0, 8.0));
        assert!(matches!(&leaf.source, LeafSource::File(path) if path.ends_with("m/box.ply")));
        assert_eq!(leaf.name, "box_0");
        assert!(scene.camera.is_none());
    }

    #[test]
    fn the_camera_beside_it_is_the_scene_s() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("b.tree.json");
        fs::write(&path, LEAF).unwrap();
        let camera = r#"{"eye": [1,2,3], "target": [0,0,0], "up": [0,0,1], "fovy": 32, "width": 512, "height": 256}"#;
        fs::write(directory.path().join("b.camera.json"), camera).unwrap();
        let scene = read(&path).unwrap();
        assert_eq!(scene.size, (512, 256));
        let spec = scene.camera.unwrap();
        assert_eq!((spec.eye, spec.lens), (DVec3::new(1.0, 2.0, 3.0), Lens::FovY(32.0)));
    }

    #[test]
    fn mistakes_are_told_with_their_line() {
        for (text, part) in [
            (r#"{"op": "xor", "children": []}"#, "union"),
            (r#"{"op": "union", "children": []}"#, "empty"),
            (r#"{"op": "union"}"#, "children"),
            (r#"{"mesh": "a.ply", "colour": 1}"#, "colour"),
            (r#"{"mesh": "a.ply", "transform": [1, 2]}"#, "16"),
            (r#"{"mesh": "a.ply", "transform": [1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,1,1]}"#, "affine"),
            ("{", "line 1"),
        ] {
            let message = written(text).unwrap_err().to_string();
            assert!(message.contains(part) && message.contains("a.tree.json"), "{text}: {message}");
        }
    }
}
