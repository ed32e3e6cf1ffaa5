//! surfcut cuts scans and meshes with Boolean expressions and draws the result, without first turning a scan into a mesh.

pub mod blister;
pub mod classify;
pub mod composite;
pub mod crossings;
pub mod csg;
pub mod formats;
pub mod geometry;
#[cfg(feature = "gpu")]
pub mod gpu;
pub mod hybrid;
pub mod layers;
pub mod measure;
pub mod output;
pub mod pipeline;
pub mod reference;
pub mod scene;
pub mod space;
pub mod splat;
pub mod surfel;
