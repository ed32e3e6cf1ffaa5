//! Which leaves a picture shows, and in what colours: told from its layers while they are drawn.
//!
//! *Practice.* A surface shows where nothing opaque is nearer: no layer of its own picture, and no content that it is composed
//! with. Colours differ from point to point of a scan, so their mean is kept, by leaf and by whose material lies behind: a cut
//! face may have the colour of what was cut. Sums are of whole numbers, so that they are the same in any order.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

use super::merge::{Content, Contents};
use crate::layers::limit::first_layers;
use crate::layers::{LayerSource, LayerTile, MAX_SAMPLES};
use crate::scene::style::Style;
use crate::space::{Camera, PixelRect};

/// Steps of a colour's or an opacity's whole number to 1.
const STEPS: f64 = 65536.0;
/// Brighter colours count as this.
const BRIGHTEST: f32 = 16.0;

/// The surfaces of one leaf in front of the material of one leaf.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Surface {
    /// Whose surface.
    pub leaf: u32,
    /// Whose material lies behind it.
    pub body: u32,
    /// Boundaries that show; at most one a pixel and layer.
    pub count: u64,
    /// The mean, linear RGB, unlit.
    pub colour: [f32; 3],
    /// The mean, 0 to 1.
    pub opacity: f32,
}

#[derive(Debug, Clone, Copy, Default)]
struct Sum {
    count: u64,
    colour: [u64; 3],
    opacity: u64,
}

type Sums = BTreeMap<(u32, u32), Sum>;

/// Adds up what shows.
#[derive(Debug)]
pub(super) struct Shown {
    /// Whether clear surfaces show too, by their lines.
    has_lines: bool,
    /// Layers drawn at most.
    most: Option<u32>,
    sums: Mutex<Sums>,
}

impl Shown {
    /// Of a picture in `style`; nothing yet.
    pub fn new(style: &Style) -> Self {
        Self { has_lines: style.kind.has_lines(), most: style.max_layers, sums: Mutex::default() }
    }

    /// What showed, in the order of leaves and bodies.
    pub fn into_surfaces(self) -> Vec<Surface> {
        let sums = self.sums.into_inner().unwrap_or_else(PoisonError::into_inner);
        let surface = |((leaf, body), sum): ((u32, u32), Sum)| {
            let mean = |total: u64| (total as f64 / (STEPS * sum.count as f64)) as f32;
            Surface { leaf, body, count: sum.count, colour: sum.colour.map(mean), opacity: mean(sum.opacity) }
        };
        sums.into_iter().map(surface).collect()
    }

    fn add(&self, tile: &LayerTile, samples: u32, contents: &Contents) {
        if tile.boundaries.is_empty() {
            return;
        }
        let of_tile = match self.most {
            Some(most) => self.of_tile(&first_layers(tile.clone(), samples, most), samples, contents),
            None => self.of_tile(tile, samples, contents),
        };
        let mut sums = self.sums.lock().unwrap_or_else(PoisonError::into_inner);
        for (key, more) in of_tile {
            let sum = sums.entry(key).or_default();
            sum.count += more.count;
            sum.opacity += more.opacity;
            sum.colour.iter_mut().zip(more.colour).for_each(|(sum, more)| *sum += more);
        }
    }

    fn of_tile(&self, tile: &LayerTile, samples: u32, contents: &Contents) -> Sums {
        let mut sums = Sums::new();
        let all = u16::MAX >> (MAX_SAMPLES - samples.clamp(1, MAX_SAMPLES));
        let mut found: Vec<Content> = Vec::new();
        for (pixel, of_pixel) in tile.offsets.windows(2).enumerate().filter(|(_, of_pixel)| of_pixel[0] < of_pixel[1]) {
            let (x, y) = (pixel as u32 % tile.rect.width(), pixel as u32 / tile.rect.width());
            contents.at(tile.rect.x0 + x, tile.rect.y0 + y, &mut found);
            let wall = found.iter().find(|content| content.colour[3] >= 1.0).map_or(f32::INFINITY, |wall| wall.depth);
            // Samples whose ray nothing has stopped yet.
            let mut open = all;
            for boundary in &tile.boundaries[of_pixel[0] as usize..of_pixel[1] as usize] {
                if boundary.depth > wall || open == 0 {
                    break;
                }
                let seen_by = boundary.samples & open;
                if seen_by == 0 || (boundary.opacity <= 0.0 && !self.has_lines) {
                    continue;
                }
                let whole = |value: f32, most: f32| (f64::from(value.clamp(0.0, most)) * STEPS) as u64;
                let sum = sums.entry((boundary.leaf, boundary.body)).or_default();
                sum.count += 1;
                sum.opacity += whole(boundary.opacity, 1.0);
                sum.colour.iter_mut().zip(boundary.colour).for_each(|(sum, c)| *sum += whole(c, BRIGHTEST));
                if boundary.opacity >= 1.0 {
                    open &= !seen_by;
                }
            }
        }
        sums
    }
}

/// A source that tells [`Shown`] of every tile.
pub(super) struct Watched<'a> {
    source: &'a dyn LayerSource,
    shown: &'a Shown,
    contents: &'a Contents,
}

impl<'a> Watched<'a> {
    /// `source`, whose picture is composed with `contents`.
    pub fn new(source: &'a dyn LayerSource, shown: &'a Shown, contents: &'a Contents) -> Self {
        Self { source, shown, contents }
    }
}

impl LayerSource for Watched<'_> {
    fn camera(&self) -> &Camera {
        self.source.camera()
    }

    fn samples(&self) -> u32 {
        self.source.samples()
    }

    fn draw(&self, rect: PixelRect) -> LayerTile {
        let tile = self.source.draw(rect);
        self.shown.add(&tile, self.source.samples(), self.contents);
        tile
    }
}

#[cfg(test)]
mod tests {
    use glam::{DVec3, Vec3};

    use super::*;
    use crate::formats::depth_picture::DepthPicture;
    use crate::layers::{Boundary, Facing, LayerStack};
    use crate::scene::style::StyleKind;
    use crate::space::Lens;

    fn boundary(leaf: u32, depth: f32, opacity: f32, samples: u16) -> Boundary {
        let colour = [0.25 * leaf as f32, 0.5, 1.0];
        let facing = Facing::Front;
        Boundary { depth, normal: Vec3::NEG_Y, colour, opacity, leaf, body: leaf, facing, samples }
    }

    /// The leaves that show of one pixel's boundaries, with how often.
    fn leaves(boundaries: &[Boundary], samples: u32, style: &Style, contents: &Contents) -> Vec<(u32, u64)> {
        let camera =
            Camera::look_at(DVec3::new(0.0, -4.0, 0.0), DVec3::ZERO, DVec3::Z, Lens::Height(2.0), 1, 1).unwrap();
        let stack = LayerStack::from_fn(camera, samples, |_, _| boundaries.to_vec());
        let shown = Shown::new(style);
        Watched::new(&stack, &shown, contents).draw(PixelRect { x0: 0, y0: 0, x1: 1, y1: 1 });
        shown.into_surfaces().iter().map(|surface| (surface.leaf, surface.count)).collect()
    }

    #[test]
    fn what_is_behind_something_opaque_does_not_show() {
        let (shaded, none) = (Style::of(StyleKind::Shaded), Contents::default());
        let behind = [boundary(0, 1.0, 0.5, 1), boundary(1, 2.0, 1.0, 1), boundary(2, 3.0, 1.0, 1)];
        assert_eq!(leaves(&behind, 1, &shaded, &none), [(0, 1), (1, 1)]);
        // A sample that the first does not stop sees the second.
        let beside = [boundary(0, 1.0, 1.0, 0b0011), boundary(1, 2.0, 1.0, 0b0110), boundary(2, 3.0, 1.0, 0b0001)];
        assert_eq!(leaves(&beside, 4, &shaded, &none), [(0, 1), (1, 1)]);
        // What is clear shows by its lines alone.
        let clear = [boundary(3, 1.0, 0.0, 1)];
        assert_eq!(leaves(&clear, 1, &shaded, &none), []);
        assert_eq!(leaves(&clear, 1, &Style::of(StyleKind::Wireframe), &none), [(3, 1)]);
        // Beyond the last layer drawn.
        let two = Style { max_layers: Some(2), ..Style::of(StyleKind::EdgeTransparent) };
        let glass = [0, 1, 2].map(|leaf| boundary(leaf, leaf as f32, 0.5, 1));
        assert_eq!(leaves(&glass, 1, &two, &none), [(0, 1), (1, 1)]);
        // Behind a wall of another picture, but not behind its glass.
        let content = |alpha: f32| {
            Contents::new(vec![DepthPicture {
                width: 1,
                height: 1,
                pixels: vec![[0.0, 0.0, 0.0, alpha]],
                depth: vec![0.5],
            }])
        };
        assert_eq!(leaves(&glass, 1, &two, &content(1.0)), [(0, 1)]);
        assert_eq!(leaves(&glass, 1, &two, &content(0.5)), [(0, 1), (1, 1)]);
    }

    #[test]
    fn colours_are_the_mean_of_what_shows() {
        let camera =
            Camera::look_at(DVec3::new(0.0, -4.0, 0.0), DVec3::ZERO, DVec3::Z, Lens::Height(2.0), 70, 1).unwrap();
        let at = |x: u32, _: u32| vec![Boundary { colour: [x as f32 / 69.0, 0.1, 0.9], ..boundary(0, 1.0, 0.5, 1) }];
        let stack = LayerStack::from_fn(camera, 1, at);
        let shown = Shown::new(&Style::of(StyleKind::Transparent));
        LayerStack::collect(&Watched::new(&stack, &shown, &Contents::default()));
        let [surface] = shown.into_surfaces()[..] else { panic!("one surface") };
        let near = |a: f32, b: f32| (a - b).abs() < 1e-4;
        assert!(near(surface.colour[0], 0.5) && near(surface.colour[1], 0.1) && near(surface.colour[2], 0.9));
        assert!(surface.count == 70 && surface.opacity == 0.5, "{surface:?}");
    }
}
