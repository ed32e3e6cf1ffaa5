//! Sections: the solid cap where a plane cuts the result, hatched as technical drawings are (ISO 128-50).
//!
//! *Theory.* A cut face is hatched with thin parallel lines at 45°; touching parts differ in the direction of their lines, and
//! where more than two meet, in the distance. The cap is nothing that has to be built: it is the boundaries of the result whose
//! surface is the section's plane, and each knows the leaf whose material lies behind it (its `body`).
//!
//! *Practice.* Lines are a function of the place in the plane, in world space: they stand still when the camera turns, and when
//! the plane is pushed through a part. Their distance is in scene units; their width is in pixels, as that of all lines is, but
//! never more than a share of their distance, so that a far cap is grey and not black. Coverage of a pixel is the exact mean
//! of the stripes over the pixel's extent across them (a box filter), so that lines have no steps and a far cap no moiré.

use glam::{DVec2, DVec3};

use crate::csg::LeafId;
use crate::geometry::Solid;
use crate::layers::{LayerSource, LayerTile};
use crate::scene::style::Style;
use crate::scene::{LeafGeometry, LoadedScene};
use crate::space::{Camera, Motion, PixelRect};

/// Distance of lines where the scene does not say, as a share of the diagonal of what is drawn: some 15 pixels in a picture
/// of 1000.
pub const SPACING_SHARE: f64 = 1.0 / 64.0;

/// Lines are at most this share of their distance wide.
pub(crate) const WIDEST_SHARE: f64 = 1.0 / 3.0;

/// Distances of the lines of leaves that share a direction, as multiples of the section's.
pub(crate) const SPACINGS: [f64; 3] = [1.0, 1.5, 0.7];

/// One cutting plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SectionPlane {
    /// The half-space's index in the scene.
    pub leaf: u32,
    /// On the plane, world space.
    pub point: DVec3,
    /// Unit normal, world space.
    pub normal: DVec3,
    /// Distance of hatch lines, world units, positive.
    pub spacing: f64,
}

/// How caps are hatched.
#[derive(Debug, Clone, PartialEq)]
pub struct Hatching {
    pub(crate) sections: Vec<SectionPlane>,
    /// By leaf that may be cut: its rank among those, which chooses direction and distance.
    pub(crate) ranks: Vec<usize>,
    /// Width of lines, pixels.
    pub(crate) line_px: f64,
    /// Linear RGB.
    pub(crate) ink: [f32; 3],
    /// Of leaves, by index, linear RGB: a cap shows the colour of what was cut.
    pub(crate) colours: Vec<[f32; 3]>,
}

/// How lines run on one cap of one leaf.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct CapLines {
    /// Unit vector along the lines, world space.
    pub along: DVec3,
    /// Their distance as a multiple of the section's.
    pub spacing: f64,
}

/// The stripes on one cap of one leaf.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Stripes {
    /// Unit vector across the lines, in the plane, world space.
    pub(crate) across: DVec3,
    pub(crate) spacing: f64,
}

impl Hatching {
    /// On the caps of `sections`, with lines `line_px` pixels wide of linear RGB `ink`. `bodies` are the leaves that may be
    /// cut, in an order in which neighbours should differ; `colours` those of all leaves, linear RGB.
    pub fn new(
        sections: Vec<SectionPlane>,
        bodies: &[u32],
        line_px: f64,
        ink: [f32; 3],
        colours: Vec<[f32; 3]>,
    ) -> Self {
        let mut ranks = vec![0; bodies.iter().max().map_or(0, |last| *last as usize + 1)];
        for (rank, body) in bodies.iter().enumerate() {
            ranks[*body as usize] = rank;
        }
        Self { sections, ranks, line_px, ink, colours }
    }

    /// For the scene's sections where the scene has them, with lines of the style's.
    pub fn of_scene(loaded: &LoadedScene, style: &Style) -> Self {
        let scene = &loaded.scene;
        let index = |leaf: LeafId| leaf.0 as usize;
        let diagonal = loaded.extent().bounds().map(|bounds| bounds.diagonal());
        let plane = |leaf: LeafId| {
            let section = scene.leaves[index(leaf)].section?;
            let LeafGeometry::Solid(Solid::HalfSpace { point, normal, extent }) = &loaded.geometry[index(leaf)] else {
                return None;
            };
            let world_from_leaf = scene.leaves[index(leaf)].world_from_leaf;
            Some(SectionPlane {
                leaf: leaf.0,
                point: world_from_leaf.transform_point3(*point),
                normal: (world_from_leaf.matrix3.inverse().transpose() * *normal).normalize(),
                spacing: section.hatch_spacing.unwrap_or(SPACING_SHARE * diagonal.unwrap_or(2.0 * extent)),
            })
        };
        let leaves = (0..scene.leaves.len() as u32).map(LeafId);
        let sections: Vec<SectionPlane> = leaves.clone().filter_map(plane).collect();
        let positive = loaded.canonical_tree().positive();
        let mut bodies: Vec<u32> = positive.literals().filter(|l| !l.negated).map(|l| l.leaf.0).collect();
        bodies.retain(|body| scene.leaves[*body as usize].section.is_none());
        bodies.sort_unstable();
        bodies.dedup();
        let colours = leaves.map(|leaf| loaded.colour(leaf)).collect();
        let ink = style.ink(loaded.scene.background_for(style));
        Self::new(sections, &bodies, f64::from(style.lines.width_px), ink, colours)
    }

    /// With each section moved by its leaf's motion; the lines' distance stays.
    pub fn moved(&self, motion: impl Fn(LeafId) -> Motion) -> Self {
        let moved = |section: &SectionPlane| {
            let motion = motion(LeafId(section.leaf));
            SectionPlane {
                point: motion.point(section.point),
                normal: (motion.rotation * section.normal).normalize(),
                ..*section
            }
        };
        Self { sections: self.sections.iter().map(moved).collect(), ..self.clone() }
    }

    /// Whether there is nothing to hatch.
    pub fn is_empty(&self) -> bool {
        self.sections.is_empty()
    }

    /// By leaf index, whether it is a section: its outline is drawn stronger.
    pub fn heavy(&self) -> Vec<bool> {
        let mut heavy = vec![false; self.sections.iter().map(|section| section.leaf as usize + 1).max().unwrap_or(0)];
        self.sections.iter().for_each(|section| heavy[section.leaf as usize] = true);
        heavy
    }

    /// The direction of the lines on the cap that section `leaf` makes of leaf `body`; `None` where the leaf is no section.
    pub(super) fn lines(&self, leaf: u32, body: u32) -> Option<CapLines> {
        let section = self.section(leaf)?;
        let stripes = self.stripes(section, body);
        Some(CapLines { along: section.normal.cross(stripes.across), spacing: stripes.spacing / section.spacing })
    }

    /// The lines' colour, linear RGB.
    pub(super) fn ink(&self) -> [f32; 3] {
        self.ink
    }

    /// The lines' width in pixels.
    pub(super) fn line_px(&self) -> f64 {
        self.line_px
    }

    /// The colour of caps of leaf `body`, linear RGB; `None` where that is the surface's own.
    pub(super) fn colour(&self, body: u32) -> Option<[f32; 3]> {
        self.colours.get(body as usize).copied()
    }

    fn section(&self, leaf: u32) -> Option<&SectionPlane> {
        self.sections.iter().find(|section| section.leaf == leaf)
    }

    pub(crate) fn stripes(&self, section: &SectionPlane, body: u32) -> Stripes {
        let rank = self.ranks.get(body as usize).copied().unwrap_or(body as usize);
        let u = DVec3::Z.cross(section.normal).try_normalize().unwrap_or(DVec3::X);
        let v = section.normal.cross(u);
        let across = if rank.is_multiple_of(2) { u + v } else { u - v };
        let spacing = section.spacing * SPACINGS[rank / 2 % SPACINGS.len()];
        Stripes { across: across.normalize_or(u), spacing }
    }

    /// The share of ink, 0 to 1, at `p_in_world` of the cap that section `leaf` makes of leaf `body`, where a pixel is
    /// `pixel` world units wide across the lines; `None` where the leaf is no section.
    pub fn ink_at(&self, leaf: u32, body: u32, p_in_world: DVec3, pixel: f64) -> Option<f32> {
        let stripes = self.stripes(self.section(leaf)?, body);
        Some(stripes.coverage(p_in_world.dot(stripes.across), pixel, self.line_px))
    }

    /// The share of ink in the pixel at column `x`, row `y`.
    fn ink_in_pixel(&self, section: &SectionPlane, body: u32, camera: &Camera, x: u32, y: u32) -> f32 {
        let stripes = self.stripes(section, body);
        let at = |dx: f64, dy: f64| {
            let ray = camera.ray(DVec2::new(f64::from(x) + 0.5 + dx, f64::from(y) + 0.5 + dy));
            let t = (section.point - ray.origin).dot(section.normal) / ray.dir.dot(section.normal);
            ray.at(t).dot(stripes.across)
        };
        let here = at(0.0, 0.0);
        stripes.coverage(here, (at(1.0, 0.0) - here).hypot(at(0.0, 1.0) - here), self.line_px)
    }
}

impl Stripes {
    /// The mean of the stripes over `pixel` around `place`, both measured across them in world units.
    fn coverage(&self, place: f64, pixel: f64, line_px: f64) -> f32 {
        let width = (line_px * pixel).min(WIDEST_SHARE * self.spacing);
        // The plane is seen edge-on, or the numbers run out: the mean of all.
        if !(pixel > 0.0 && pixel.is_finite() && place.is_finite()) {
            return WIDEST_SHARE as f32;
        }
        // The length of line from 0 to a place; a line begins at every multiple of the spacing.
        let inked = |to: f64| {
            let lines = (to / self.spacing).floor();
            lines * width + (to - lines * self.spacing).min(width)
        };
        ((inked(place + 0.5 * pixel) - inked(place - 0.5 * pixel)) / pixel).clamp(0.0, 1.0) as f32
    }
}

/// A source whose caps have the colours of what was cut and are hatched: lines take the place of the surface's colour, and
/// are opaque where it is not.
pub struct Hatched<'a> {
    source: &'a dyn LayerSource,
    hatching: &'a Hatching,
}

impl<'a> Hatched<'a> {
    /// `source`, hatched.
    pub fn new(source: &'a dyn LayerSource, hatching: &'a Hatching) -> Self {
        Self { source, hatching }
    }
}

impl LayerSource for Hatched<'_> {
    fn camera(&self) -> &Camera {
        self.source.camera()
    }

    fn samples(&self) -> u32 {
        self.source.samples()
    }

    fn draw(&self, rect: PixelRect) -> LayerTile {
        let mut tile = self.source.draw(rect);
        let camera = self.source.camera();
        for pixel in 0..rect.area() {
            let (x, y) = (rect.x0 + pixel as u32 % rect.width(), rect.y0 + pixel as u32 / rect.width());
            for boundary in &mut tile.boundaries[tile.offsets[pixel] as usize..tile.offsets[pixel + 1] as usize] {
                let Some(section) = self.hatching.section(boundary.leaf) else { continue };
                let ink = self.hatching.ink_in_pixel(section, boundary.body, camera, x, y);
                boundary.colour = *self.hatching.colours.get(boundary.body as usize).unwrap_or(&boundary.colour);
                let opacity = ink + (1.0 - ink) * boundary.opacity;
                if opacity > 0.0 {
                    let surface = (1.0 - ink) * boundary.opacity / opacity;
                    for (colour, of_ink) in boundary.colour.iter_mut().zip(self.hatching.ink) {
                        *colour = *colour * surface + of_ink * (1.0 - surface);
                    }
                }
                boundary.opacity = opacity;
            }
        }
        tile
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layers::{Boundary, LayerStack};
    use crate::space::Lens;
    use glam::DQuat;

    fn plane() -> SectionPlane {
        SectionPlane { leaf: 2, point: DVec3::new(0.3, 0.0, 0.1), normal: DVec3::NEG_Y, spacing: 0.25 }
    }

    fn hatching() -> Hatching {
        Hatching::new(vec![plane()], &[0, 1, 3], 1.0, [0.0; 3], vec![[1.0; 3]; 4])
    }

    /// Shares of ink along a line in the plane.
    fn along(hatching: &Hatching, body: u32, direction: DVec3) -> Vec<f32> {
        let at = |i: i32| direction * f64::from(i) * 0.01;
        (0..400).map(|i| hatching.ink_at(2, body, at(i), 0.01).unwrap()).collect()
    }

    #[test]
    fn lines_run_at_45_degrees_and_neighbours_differ() {
        let hatching = hatching();
        let (rising, falling) = (DVec3::new(1.0, 0.0, 1.0).normalize(), DVec3::new(1.0, 0.0, -1.0).normalize());
        let is_even = |inks: &[f32]| inks.iter().all(|ink| (ink - inks[0]).abs() < 1e-6);
        let directions = |body| (is_even(&along(&hatching, body, rising)), is_even(&along(&hatching, body, falling)));
        // Along its lines ink is the same; neighbours' lines cross.
        assert!(directions(0) != directions(1) && directions(0).0 != directions(0).1);
        // The third has the first one's direction and another distance.
        assert_eq!(directions(3), directions(0));
        assert_ne!(along(&hatching, 3, DVec3::X), along(&hatching, 0, DVec3::X));
        assert_eq!(hatching.ink_at(0, 1, DVec3::ZERO, 0.01), None);
        assert_eq!(hatching.heavy(), [false, false, true]);
    }

    #[test]
    fn a_moved_section_takes_its_lines_along() {
        let rotation = DQuat::from_rotation_x(0.7);
        let motion = Motion { scale: 2.0, rotation, translation: DVec3::new(0.1, 0.2, 0.3) };
        let moved = hatching().moved(|leaf| if leaf == LeafId(2) { motion } else { Motion::REST });
        let (before, after) = (plane(), moved.section(2).unwrap());
        assert!(after.point.distance(motion.point(before.point)) < 1e-12);
        // A vector in the plane is still in it.
        for in_plane in [DVec3::X, DVec3::Z] {
            assert!(motion.vector(in_plane).dot(after.normal).abs() < 1e-12);
        }
        assert!((after.normal.length() - 1.0).abs() < 1e-12 && after.spacing == before.spacing);
        assert_eq!(hatching().moved(|_| Motion::REST), hatching());
    }

    #[test]
    fn a_pixels_ink_is_its_share_of_the_lines_at_any_distance() {
        let hatching = hatching();
        let mean = |pixel: f64| {
            let across = DVec3::new(1.0, 0.0, 1.0).normalize();
            let other = DVec3::new(1.0, 0.0, -1.0).normalize();
            let of = |direction: DVec3| {
                // A line begins between two pixels, at the middle of the plane.
                let at = |i: i32| direction * ((f64::from(i) + 0.5) * 0.01);
                let inks: Vec<f32> = (0..1000).map(|i| hatching.ink_at(2, 0, at(i), pixel).unwrap()).collect();
                (inks.iter().sum::<f32>() / 1000.0, inks.iter().fold(0.0, |m: f32, i| m.max(*i)))
            };
            // Across the lines, whichever that is.
            let (a, b) = (of(across), of(other));
            if a.1 - a.0 > b.1 - b.0 { a } else { b }
        };
        // A pixel's width of ink each 0.25.
        let (share, most) = mean(0.01);
        assert!((share - 0.04).abs() < 1e-3 && most > 0.99, "{share} {most}");
        // From afar all pixels are alike.
        let (share, most) = mean(25.0);
        assert!((share - 1.0 / 3.0).abs() < 0.01 && (most - share).abs() < 0.01, "{share} {most}");
    }

    #[test]
    fn hatching_stays_in_its_plane_when_the_camera_turns() {
        let hatching = hatching();
        let lit = |degrees: f64| {
            let eye = DQuat::from_rotation_z(degrees.to_radians()) * DVec3::new(0.0, -8.0, 1.0);
            let camera = Camera::look_at(eye, DVec3::ZERO, DVec3::Z, Lens::FovY(20.0), 160, 160).unwrap();
            let cap = Boundary {
                depth: 8.0,
                normal: glam::Vec3::NEG_Y,
                colour: [1.0; 3],
                opacity: 1.0,
                leaf: 2,
                body: 0,
                facing: crate::layers::Facing::Front,
                samples: 1,
            };
            let stack = LayerStack::from_fn(camera.clone(), 1, |_, _| vec![cap]);
            let hatched = LayerStack::collect(&Hatched::new(&stack, &hatching));
            // What is seen at places of the plane, between the pixels' centres.
            let at = |p: DVec3| {
                let px = camera.px_from_view(camera.view_from_world(p)) - 0.5;
                let (x, y) = (px.x.floor(), px.y.floor());
                let pixel = |dx: f64, dy: f64| hatched.at((x + dx) as u32, (y + dy) as u32)[0].colour[0];
                let mix = |a: f32, b: f32, u: f64| a + (b - a) * u as f32;
                let row = |dy: f64| mix(pixel(0.0, dy), pixel(1.0, dy), px.x - x);
                mix(row(0.0), row(1.0), px.y - y)
            };
            let places =
                (0..900).map(|i| DVec3::new(f64::from(i % 30) * 0.03 - 0.45, 0.0, f64::from(i / 30) * 0.03 - 0.45));
            places.map(at).collect::<Vec<f32>>()
        };
        let front = lit(0.0);
        let dark = front.iter().filter(|l| **l < 0.7).count();
        assert!(dark > 40, "{dark}");
        for degrees in [3.0, 20.0] {
            // A place on a line stays on it, though the line's width is the pixels'.
            let turned = lit(degrees);
            let moved = front.iter().zip(&turned).filter(|(a, b)| (*a - *b).abs() > 0.5).count();
            assert!(moved * 100 < front.len() * 2, "{moved} at {degrees}");
        }
    }
}
