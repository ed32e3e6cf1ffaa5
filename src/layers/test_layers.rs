//! Layers that tests paint by hand.

use glam::{DVec3, Vec3};

use super::{Boundary, Facing};
use crate::space::{Camera, Lens};

/// A camera for pictures of `width` by `height` pixels.
pub fn camera(width: u32, height: u32) -> Camera {
    Camera::look_at(DVec3::new(0.0, -4.0, 0.0), DVec3::ZERO, DVec3::Z, Lens::Height(2.0), width, height).unwrap()
}

/// An opaque front of leaf 0 that the first sample sees.
pub fn boundary(depth: f32) -> Boundary {
    Boundary {
        depth,
        normal: Vec3::NEG_Y,
        colour: [0.5; 3],
        opacity: 1.0,
        leaf: 0,
        body: 0,
        facing: Facing::Front,
        samples: 1,
    }
}
