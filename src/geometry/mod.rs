//! What a leaf is made of: point clouds, triangle meshes, analytic solids, and the searches over them.

pub mod bvh;
pub mod cloud;
pub mod exact;
pub mod mesh;
pub mod neighbours;
pub mod solid;
pub mod winding;

pub use bvh::MeshBvh;
pub use cloud::{Ellipse, PointCloud};
pub use mesh::TriMesh;
pub use solid::{Solid, SolidError};
