//! Surfels from an analytic solid: its smooth patches, sampled evenly in world space.
//!
//! *Practice.* [`Patch::sample`](crate::geometry::solid::Patch::sample) covers in leaf space. A rotation, mirror or even scale
//! keeps that; under an uneven scale the samples are taken densely enough for the direction that is stretched most and then
//! thinned in world space, so that an elongated ellipsoid gets no more surfels than its area needs.

use glam::{DAffine3, DVec3, Vec3};

use super::place::{even_scale, normal_map};
use super::sampled::{KEPT, Sample, Sampling, Thinner, check_count, from_samples, largest_stretch};
use super::{SurfelCloud, SurfelError};
use crate::geometry::Solid;
use crate::geometry::solid::{COVER, SurfacePoint};

/// Spacing of the candidates of a thinned sampling, in spacings.
const CANDIDATES: f64 = 0.4;

/// Surfels over `solid` (leaf space, valid), in world space, about `spacing` world units apart. They have the solid's exact
/// normals; no disk's curvature was fitted across a crease; balls of the surfels' radii about them hold the whole surface
/// (of a half-space: the square that is drawn).
///
/// # Errors
/// [`SurfelError::Spacing`], [`SurfelError::Transform`], [`SurfelError::TooMany`], and [`SurfelError::Empty`] for a solid without surface.
pub fn from_solid(solid: &Solid, world_from_leaf: DAffine3, spacing: f64) -> Result<SurfelCloud, SurfelError> {
    let stretch = largest_stretch(world_from_leaf, spacing)?;
    let normal_map = normal_map(world_from_leaf)?;
    let thinned = even_scale(world_from_leaf.matrix3).is_none();
    let in_leaf = spacing / stretch * if thinned { CANDIDATES } else { 1.0 };
    let patches = solid.patches();
    check_count(patches.iter().map(|patch| patch.area()).sum(), in_leaf)?;
    let mut samples = Vec::new();
    let mut thinner = Thinner::new(world_from_leaf.translation, KEPT * spacing);
    for (index, patch) in patches.iter().enumerate() {
        patch.sample(in_leaf, &mut |SurfacePoint { p, normal }| {
            let p: DVec3 = world_from_leaf.transform_point3(p);
            let normal: Vec3 = (normal_map * normal).normalize_or_zero().as_vec3();
            if normal != Vec3::ZERO && (!thinned || thinner.keep(index as u32, p, normal)) {
                samples.push(Sample { p, normal, patch: index as u32, colour: [u8::MAX; 4] });
            }
        });
    }
    let cover = if thinned { COVER * CANDIDATES + KEPT } else { COVER } * spacing;
    from_samples(samples, Sampling { spacing, cover }, false)
}
