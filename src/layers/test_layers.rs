//! Layers that tests paint by hand.

use glam::{DVec3, Vec3};

use super::{Boundary, Facing, LayerSource, LayerTile};
use crate::space::{Camera, Lens, PixelRect};

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

/// A source whose pixel (x, y) holds what a function says.
pub struct Painted<F> {
    camera: Camera,
    samples: u32,
    at: F,
}

impl<F: Fn(u32, u32) -> Vec<Boundary> + Sync> Painted<F> {
    /// See the type.
    pub fn new(camera: Camera, samples: u32, at: F) -> Self {
        Self { camera, samples, at }
    }
}

impl<F: Fn(u32, u32) -> Vec<Boundary> + Sync> LayerSource for Painted<F> {
    fn camera(&self) -> &Camera {
        &self.camera
    }
    fn samples(&self) -> u32 {
        self.samples
    }
    fn draw(&self, rect: PixelRect) -> LayerTile {
        let mut tile = LayerTile { rect, offsets: vec![0], boundaries: Vec::new() };
        for y in rect.y0..rect.y1 {
            for x in rect.x0..rect.x1 {
                tile.boundaries.extend((self.at)(x, y));
                tile.offsets.push(tile.boundaries.len() as u32);
            }
        }
        tile
    }
}
