//! What survived as the records of a tile: depth, normal, colour.

use glam::{DVec2, DVec3, Vec3};

use super::model::{Look, MeshModel};
use super::project::View;
use super::solids::SolidHit;
use super::survivors::{Row, SlotLook, Survivor};
use crate::layers::{Boundary, Facing, LayerTile};
use crate::scene::colour::linear_from_bytes;

/// Writes the boundaries of one tile at one sample.
pub(super) struct Writer<'a> {
    pub model: &'a MeshModel,
    pub view: &'a View,
    pub looks: &'a [SlotLook],
    pub hits: &'a [SolidHit],
    /// Of the sample in its pixel, pixels.
    pub offset: DVec2,
    /// The sample's bit.
    pub samples: u16,
}

impl Writer<'_> {
    /// Appends a row of pixels that begins at column `x0` of row `y`.
    pub fn row(&self, x0: u32, y: u32, row: &Row, tile: &mut LayerTile) {
        let dir_at = |x: u32| self.view.camera.ray(DVec2::new(f64::from(x), f64::from(y)) + self.offset).dir;
        let first = dir_at(x0);
        let step = (dir_at(x0 + 1) - first).as_vec3();
        let first = first.as_vec3();
        let mut end = tile.boundaries.len() as u32;
        tile.offsets.extend(row.counts.iter().map(|count| {
            end += count;
            end
        }));
        tile.boundaries.extend(
            row.survivors
                .iter()
                .map(|(column, survivor)| self.boundary(survivor, first + step * *column as f32, x0 + column, y)),
        );
    }

    #[inline(always)]
    pub(super) fn boundary(&self, survivor: &Survivor, dir: Vec3, x: u32, y: u32) -> Boundary {
        let SlotLook { leaf, look, is_solid, .. } = &self.looks[survivor.owner as usize];
        let depth = self.view.depth(survivor.key);
        let normal = if *is_solid {
            self.hits[survivor.what as usize].normal
        } else {
            self.model.surfaces[survivor.what as usize].normal
        };
        // Outward from the result: against the ray where it is entered, along it where it is left.
        let is_along = normal.dot(dir) > 0.0;
        let normal = normal * if is_along == survivor.is_front { -1.0 } else { 1.0 };
        let colour = if look.vertex_colours && !is_solid {
            self.mixed_colour(survivor.what, DVec2::new(f64::from(x), f64::from(y)), f64::from(depth), look)
        } else {
            look.colour
        };
        Boundary {
            depth,
            normal,
            colour,
            opacity: look.opacity,
            leaf: leaf.0,
            body: self.looks[survivor.body as usize].leaf.0,
            facing: if survivor.is_front { Facing::Front } else { Facing::Back },
            samples: self.samples,
        }
    }

    /// The colour of a triangle with vertex colours at a pixel, where it has this key.
    #[cfg(feature = "gpu")]
    pub fn colour_of(&self, triangle: u32, x: u32, y: u32, key: f32, look: &Look) -> [f32; 3] {
        let depth = f64::from(self.view.depth(key));
        self.mixed_colour(triangle, DVec2::new(f64::from(x), f64::from(y)), depth, look)
    }

    /// The vertex colours of a triangle, mixed linearly at the point of the pixel at `px`.
    fn mixed_colour(&self, triangle: u32, px: DVec2, depth: f64, look: &Look) -> [f32; 3] {
        let numbers = self.model.triangles[triangle as usize];
        let [a, b, c] = numbers.map(|v| self.model.position(v));
        let p = self.view.camera.ray(px + self.offset).at(depth);
        let normal = (b - a).cross(c - a);
        let weight = |q: DVec3, r: DVec3| (q - p).cross(r - p).dot(normal).max(0.0);
        let weights = [weight(b, c), weight(c, a), weight(a, b)];
        let sum: f64 = weights.iter().sum();
        if !(sum > 0.0) {
            return look.colour;
        }
        let mut mixed = [0.0; 3];
        for (number, weight) in numbers.into_iter().zip(weights) {
            let own = linear_from_bytes(self.model.vertex_colours[number as usize]);
            (0..3).for_each(|k| mixed[k] += (weight / sum) as f32 * own[k]);
        }
        mixed
    }
}
