//! What a frame uploads: corners, surfaces, slots and the expression's steps.

use std::ops::Range;

use glam::Vec2;

use super::pieces::Pieces;
use crate::blister::frame::MeshFrame;
use crate::blister::frame::arrangement::{Arranged, Arrangement, DrawnSlot, DrawnSurface, SurfaceColour};
use crate::gpu::{Gpu, GpuError};
use crate::gpu_struct;
use crate::space::{Camera, PixelRect};

/// Bits of `Slot::flags` and `Surface::flags`, and those beside a slot's number.
pub(super) mod flags {
    /// Never in or out.
    pub const SLOT_SHEET: u32 = 1;
    /// A half-space.
    pub const SLOT_ENDLESS: u32 = 2;
    /// As `SURFACE_HIDDEN`, beside a slot's number.
    pub const PIECE_HIDDEN: u32 = 1 << 31;
    /// One of the leaves that hold all of the result.
    pub const SLOT_IN_SUPERSET: u32 = 4;
    /// Beside a slot's number: the result is entered, or the slot's leaf.
    pub const BOUNDARY_FRONT: u32 = 1 << 31;
    /// As `SURFACE_HIDDEN`, beside the slot's number of a surface and its fragments.
    pub const FRAGMENT_HIDDEN: u32 = 1 << 31;
    /// As `SLOT_SHEET`, there.
    pub const FRAGMENT_SHEET: u32 = 1 << 30;
    /// As `SLOT_ENDLESS`, there.
    pub const FRAGMENT_ENDLESS: u32 = 1 << 29;
    /// Nothing shows through, there.
    pub const FRAGMENT_OPAQUE: u32 = 1 << 28;
    /// The bits of the number itself.
    pub const SLOT_NUMBER: u32 = FRAGMENT_OPAQUE - 1;
    /// Boundaries on it do not show.
    pub const SURFACE_HIDDEN: u32 = 1;
    /// `colour` has the bits of linear RGB.
    pub const SURFACE_OWN_COLOUR: u32 = 2;
    /// `colour` has the sRGB bytes of a triangle's corners.
    pub const SURFACE_CORNER_COLOURS: u32 = 4;
}

gpu_struct! {
    /// A band of a frame.
    pub struct Frame {
        /// Its first pixel.
        origin: [u32; 2],
        /// Pixels across and down.
        size: [u32; 2],
        /// The ray's direction at the sample of the picture's first pixel.
        first_dir: [f32; 3],
        /// 1 or 0.
        is_perspective: u32,
        /// What a pixel to the right adds to the direction.
        dir_across: [f32; 3],
        /// The bits of the samples that are drawn.
        samples: u32,
        /// What a pixel down adds to the direction.
        dir_down: [f32; 3],
        /// 1 where nothing behind an opaque boundary is wanted.
        is_nearest: u32,
        /// How many slots are half-spaces.
        endless: u32,
        /// How many slots there are.
        slots: u32,
        /// 1 where a superset bounds the layers.
        is_bounded: u32,
        /// 1 where a pixel has one boundary at most.
        is_single: u32,
        /// Tiles of the picture across.
        tiles_across: u32,
        /// Where in `places` single fragments are.
        single_offsets: u32,
        /// Where in `places` their pieces are; 0 where there are none.
        singles: u32,
        /// Words that say of a ray which leaves it begins inside of; 0 where nobody asks.
        begins_words: u32,
        /// 1 where the expression is one product, whose next layer behind a front ends it whatever toggles there.
        is_product: u32,
        /// Nothing.
        gap: u32,
        /// Nothing.
        spare: [u32; 2],
        /// `Step::word` of the first `SHORT_STEPS` steps.
        words: [u32; 4],
        /// Of these steps: `Step::mask`.
        masks: [u32; 4],
        /// `Step::negated`.
        negated: [u32; 4],
        /// `Step::is_and`.
        are_ands: [u32; 4],
        /// `Step::decided`.
        decided: [u32; 4],
        /// `Step::open`.
        open: [u32; 4],
    }
}

/// Steps that shaders know without a look into memory.
const SHORT_STEPS: usize = 4;

gpu_struct! {
    /// A [`csg::steps::Step`](crate::csg::steps::Step).
    pub struct Step {
        /// Which word of the state.
        word: u32,
        /// Which bits of it.
        mask: u32,
        /// Those that are complemented.
        negated: u32,
        /// 1 where one literal that fails decides.
        is_and: u32,
        /// The next step where the literals decide.
        decided: u32,
        /// The next step where they do not.
        open: u32,
    }
}

gpu_struct! {
    /// How a leaf looks.
    pub struct Slot {
        /// Linear RGB.
        colour: [f32; 3],
        /// 0 to 1.
        opacity: f32,
        /// Rays begin inside a half-space where this, times (x, y, 1), is negative.
        begins: [f32; 3],
        /// Its index in the scene.
        leaf: u32,
        /// `SLOT_…`
        flags: u32,
        /// Nothing.
        gap: u32,
        /// Nothing.
        spare: [u32; 2],
    }
}

gpu_struct! {
    /// What fragments are of.
    pub struct Surface {
        /// The key's change to the right and down, and its value at the anchor.
        key: [f32; 3],
        /// The leaf, with `FRAGMENT_…`
        slot: u32,
        /// A whole pixel of the picture.
        anchor: [f32; 2],
        /// Least and greatest key.
        range: [f32; 2],
        /// Unit normal in world space, either way round.
        normal: [f32; 3],
        /// `SURFACE_…`
        flags: u32,
        /// What the flags say.
        colour: [u32; 3],
        /// Nothing.
        spare: u32,
    }
}

gpu_struct! {
    /// A vertex of what is drawn.
    pub struct PlacedCorner {
        /// Pixels of the picture.
        x: f32,
        /// Pixels of the picture.
        y: f32,
        /// What it is of.
        surface: u32,
    }
}

gpu_struct! {
    /// A fragment in the list of its pixel, and then a boundary.
    pub struct Fragment {
        /// Larger is nearer.
        key: f32,
        /// What it is of.
        surface: u32,
        /// Its leaf, with `FRAGMENT_…` Of a boundary, whose material is behind, with `BOUNDARY_FRONT` where the result is entered.
        slot: u32,
        /// The next of the pixel, plus one; 0 at the end.
        next: u32,
    }
}

gpu_struct! {
    /// A pixel that is being peeled.
    pub struct PeelPixel {
        /// The layer that is being classified, as an order; `ALL_ORDERS` before the first.
        front: u32,
        /// No boundary is behind this.
        back: u32,
        /// 1 where nothing more is wanted.
        is_done: u32,
        /// The boundary whose surface is not known yet: its order, or `NO_SLOT` where there is none.
        kept_order: u32,
        /// Its leaf.
        kept_owner: u32,
        /// Its place among all boundaries.
        kept_place: u32,
        /// Boundaries found so far.
        count: u32,
        /// 1 where memberships before the next layer are known: those of a product's inside.
        is_known: u32,
    }
}

gpu_struct! {
    /// A boundary that peeling found.
    pub struct KeptBoundary {
        /// Which pixel of the band.
        pixel: u32,
        /// Its number among the pixel's.
        number: u32,
        /// Larger is nearer.
        key: f32,
        /// Whose material is behind.
        body: u32,
        /// Whether the result is entered.
        is_front: u32,
        /// Nothing.
        gap: u32,
    }
}

gpu_struct! {
    /// A boundary.
    pub struct Survivor {
        /// Larger is nearer.
        key: f32,
        /// What it is of.
        surface: u32,
        /// Whose material is behind.
        slot: u32,
        /// Whether the result is entered.
        is_front: u32,
    }
}

/// One sample of a frame, uploaded.
#[derive(Debug)]
pub(super) struct Uploaded {
    /// Three for each triangle, then one for each fragment.
    pub corners: wgpu::Buffer,
    /// How many triangles there are.
    pub triangles: u32,
    /// How many fragments beside them.
    pub fragments: u32,
    pub surfaces: wgpu::Buffer,
    pub slots: wgpu::Buffer,
    pub steps: wgpu::Buffer,
    /// The triangles of a superset: ranges of them. `None` where only everything holds the result.
    pub superset: Option<Vec<Range<u32>>>,
    /// For the kernel of tiles: where pieces are, and the pieces. `None` for the other classifiers.
    pub tiles: Option<[wgpu::Buffer; 2]>,
    /// What every band of it has in common.
    pub frame: Frame,
    /// What its shaders are made for.
    pub traits: Traits,
    /// About how many fragments a pixel of the picture has on average.
    pub depth: f64,
}

/// What the shaders of a frame are made for: they have no code for what it has not, since lavapipe runs both sides of every branch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::gpu) struct Traits {
    /// Words of a state.
    pub words: u32,
    /// 1 where the expression is one step, [`SHORT_STEPS`] where it has a few, 0 where it has more.
    pub steps: u32,
    /// Whether there are sheets.
    pub has_sheets: bool,
    /// Whether there are half-spaces.
    pub has_endless: bool,
    /// Whether there are surfaces that have not their leaf's colour.
    pub has_colours: bool,
}

impl Traits {
    /// For states of so many words, with code for all that there can be.
    pub const fn general(words: u32) -> Self {
        Self { words, steps: 0, has_sheets: true, has_endless: true, has_colours: true }
    }

    /// For so many steps over few closed solids of one colour each.
    pub const fn simple(steps: u32) -> Self {
        Self { words: 1, steps, has_sheets: false, has_endless: false, has_colours: false }
    }
}

/// Gathers what is drawn.
#[derive(Default)]
struct Gathered {
    /// By slot: `FRAGMENT_…`
    bits: Vec<u32>,
    corners: Vec<PlacedCorner>,
    fragments: Vec<PlacedCorner>,
    surfaces: Vec<Surface>,
    /// By slot.
    extents: Vec<Extent>,
    /// The picture's, pixels.
    size: Vec2,
    /// What triangles cover of the picture, about, pixels.
    covered: f64,
}

/// Where on the picture a slot is.
#[derive(Debug, Clone)]
struct Extent {
    /// Its triangles, which stand together.
    triangles: Range<u32>,
    low: Vec2,
    high: Vec2,
}

impl Default for Extent {
    fn default() -> Self {
        Self { triangles: 0..0, low: Vec2::INFINITY, high: Vec2::NEG_INFINITY }
    }
}

impl Extent {
    fn take(&mut self, x: f32, y: f32) {
        self.low = self.low.min(Vec2::new(x, y));
        self.high = self.high.max(Vec2::new(x, y));
    }

    /// Pixels that it may cover, as far as they can be told from its box.
    fn area(&self) -> f64 {
        let size = (self.high - self.low).max(Vec2::ZERO);
        f64::from(size.x) * f64::from(size.y)
    }
}

impl Gathered {
    fn push(&mut self, surface: &DrawnSurface) -> u32 {
        let (mut flags, colour) = match surface.colour {
            SurfaceColour::Leaf => (0, [0; 3]),
            SurfaceColour::Own(colour) => (flags::SURFACE_OWN_COLOUR, colour.map(f32::to_bits)),
            SurfaceColour::Corners(colours) => {
                let packed = |[r, g, b]: [u8; 3]| u32::from_le_bytes([r, g, b, u8::MAX]);
                (flags::SURFACE_CORNER_COLOURS, colours.map(packed))
            }
        };
        if !surface.is_drawn {
            flags |= flags::SURFACE_HIDDEN;
        }
        self.surfaces.push(Surface {
            key: surface.key,
            slot: surface.slot
                | self.bits[surface.slot as usize]
                | if surface.is_drawn { 0 } else { flags::FRAGMENT_HIDDEN },
            anchor: surface.anchor,
            range: surface.range,
            normal: surface.normal.to_array(),
            flags,
            colour,
            spare: 0,
        });
        self.surfaces.len() as u32 - 1
    }
}

impl Arrangement for Gathered {
    fn triangle(&mut self, corners: [[f32; 2]; 3], surface: &DrawnSurface) {
        let (slot, surface) = (surface.slot as usize, self.push(surface));
        let extent = &mut self.extents[slot];
        if extent.triangles.is_empty() {
            extent.triangles.start = surface;
        }
        extent.triangles.end = surface + 1;
        corners.iter().for_each(|[x, y]| extent.take(*x, *y));
        self.covered += covered(corners.map(Vec2::from), self.size);
        self.corners.extend(corners.map(|[x, y]| PlacedCorner { x, y, surface }));
    }

    fn surface(&mut self, surface: &DrawnSurface) -> u32 {
        self.push(surface)
    }

    fn fragment(&mut self, x: u32, y: u32, surface: u32) {
        self.extents[(self.surfaces[surface as usize].slot & flags::SLOT_NUMBER) as usize].take(x as f32, y as f32);
        self.fragments.push(PlacedCorner { x: x as f32 + 0.5, y: y as f32 + 0.5, surface });
    }
}

impl Uploaded {
    /// One of the samples of `frame`, for drawing `rect`; `None` where the expression is a constant, and nothing is to be drawn.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`] for geometry that fits no buffer.
    pub fn new(
        gpu: &Gpu,
        frame: &MeshFrame,
        sample: usize,
        rect: PixelRect,
        has_tiles: bool,
    ) -> Result<Option<Self>, GpuError> {
        let Arranged { expression, slots, is_nearest } = frame.arranged(sample);
        let Some(expression) = expression else { return Ok(None) };
        let camera = frame.camera_of();
        let mut gathered = Gathered {
            bits: slots.iter().map(fragment_bits).collect(),
            extents: vec![Extent::default(); slots.len()],
            size: Vec2::new(camera.width as f32, camera.height as f32),
            ..Gathered::default()
        };
        frame.arrange(&expression, sample, rect, &mut gathered);
        let Gathered { mut corners, fragments, surfaces, extents, covered, .. } = gathered;
        let size = [camera.width, camera.height];
        let pieces = has_tiles.then(|| Pieces::new(size, &corners, (rect, &fragments), &surfaces));
        let triangles = corners.len() as u32 / 3;
        corners.extend_from_slice(&fragments);
        let steps: Vec<Step> = expression.steps().iter().map(step).collect();
        let endless = slots.iter().filter(|slot| slot.begins_inside.is_some()).count();
        // In front of the first layer of a leaf that holds the eye there is still the leaf.
        let bounds = expression
            .superset(|slot| extents[slot as usize].area())
            .filter(|leaves| leaves.iter().all(|slot| slots[*slot as usize].begins_outside));
        let mut looks: Vec<Slot> = slots.iter().map(slot).collect();
        for &slot in bounds.iter().flatten() {
            looks[slot as usize].flags |= flags::SLOT_IN_SUPERSET;
        }
        let superset = bounds.map(|slots| slots.iter().map(|slot| extents[*slot as usize].triangles.clone()).collect());
        let mut places: Vec<u32> = Vec::new();
        let [mut single_offsets, mut singles] = [0; 2];
        if let Some(pieces) = &pieces {
            places.extend(pieces.tiles.as_flattened());
            single_offsets = places.len() as u32;
            places.extend(&pieces.single_offsets);
            // Zero stands for none: tiles come before.
            singles = if pieces.singles.is_empty() { 0 } else { places.len() as u32 };
            places.extend(&pieces.singles);
        }
        let upload = |pieces: &Pieces| -> Result<_, GpuError> {
            Ok([gpu.upload("places", &places)?, gpu.upload("pieces", &pieces.pieces)?])
        };
        let samples = if frame.sample_count() == 1 { 1 } else { 1 << sample };
        const HAVE_COLOURS: u32 = flags::SURFACE_OWN_COLOUR | flags::SURFACE_CORNER_COLOURS;
        let is_single = is_nearest && slots.iter().all(|slot| slot.opacity >= 1.0);
        let traits = Traits {
            words: expression.words() as u32,
            steps: match steps.len() {
                1 => 1,
                2..=SHORT_STEPS => SHORT_STEPS as u32,
                _ => 0,
            },
            has_sheets: slots.iter().any(|slot| slot.is_sheet),
            has_endless: endless > 0,
            has_colours: surfaces.iter().any(|surface| surface.flags & HAVE_COLOURS != 0),
        };
        let of_steps = |part: fn(&Step) -> u32| std::array::from_fn(|number| steps.get(number).map_or(0, part));
        Ok(Some(Self {
            corners: gpu.upload("corners", &corners)?,
            triangles,
            fragments: fragments.len() as u32,
            surfaces: gpu.upload("surfaces", &surfaces)?,
            slots: gpu.upload("slots", &looks)?,
            steps: gpu.upload("steps", &steps)?,
            superset,
            tiles: pieces.as_ref().map(upload).transpose()?,
            frame: Frame {
                samples,
                is_nearest: u32::from(is_nearest),
                endless: endless as u32,
                slots: looks.len() as u32,
                is_single: u32::from(is_single),
                tiles_across: pieces.as_ref().map_or(0, |pieces| pieces.tiles_across),
                single_offsets,
                singles,
                is_product: u32::from(expression.is_product()),
                words: of_steps(|step| step.word),
                masks: of_steps(|step| step.mask),
                negated: of_steps(|step| step.negated),
                are_ands: of_steps(|step| step.is_and),
                decided: of_steps(|step| step.decided),
                open: of_steps(|step| step.open),
                ..view(camera, crate::layers::sample_offsets(frame.sample_count())[sample])
            },
            traits,
            depth: covered / (f64::from(camera.width) * f64::from(camera.height))
                + fragments.len() as f64 / rect.area() as f64,
        }))
    }

    /// The corners of triangles, and of the fragments beside them.
    pub fn vertices(&self) -> [Range<u32>; 2] {
        let triangles = 3 * self.triangles;
        [0..triangles, triangles..triangles + self.fragments]
    }

    /// What shaders know of a band.
    pub fn band(&self, rect: PixelRect) -> Frame {
        Frame { origin: [rect.x0, rect.y0], size: [rect.width(), rect.height()], ..self.frame }
    }
}

/// How many pixels of a picture of `size` a triangle covers, about: those of its part that its box has in the picture.
fn covered([a, b, c]: [Vec2; 3], size: Vec2) -> f64 {
    let (low, high) = (a.min(b).min(c), a.max(b).max(c));
    let area = 0.5 * (b - a).perp_dot(c - a).abs();
    let box_area = |low: Vec2, high: Vec2| (high - low).max(Vec2::ZERO).element_product();
    let inside = box_area(low.max(Vec2::ZERO), high.min(size));
    f64::from(area * (inside / box_area(low, high).max(f32::MIN_POSITIVE)).min(1.0))
}

fn step(step: &crate::csg::steps::Step) -> Step {
    Step {
        word: step.word,
        mask: step.mask,
        negated: step.negated,
        is_and: u32::from(step.is_and),
        decided: step.decided,
        open: step.open,
    }
}

/// What a surface says of its leaf.
fn fragment_bits(slot: &DrawnSlot) -> u32 {
    let bit = |holds, bit| if holds { bit } else { 0 };
    bit(slot.is_sheet, flags::FRAGMENT_SHEET)
        | bit(slot.begins_inside.is_some(), flags::FRAGMENT_ENDLESS)
        | bit(slot.opacity >= 1.0, flags::FRAGMENT_OPAQUE)
}

fn slot(slot: &DrawnSlot) -> Slot {
    let sheet = if slot.is_sheet { flags::SLOT_SHEET } else { 0 };
    let endless = if slot.begins_inside.is_some() { flags::SLOT_ENDLESS } else { 0 };
    Slot {
        colour: slot.colour,
        opacity: slot.opacity,
        begins: slot.begins_inside.map_or([0.0; 3], |side| side.map(|number| number as f32)),
        leaf: slot.leaf.0,
        flags: sheet | endless,
        ..Slot::default()
    }
}

/// The camera's part, for samples at `offset` in their pixels.
fn view(camera: &Camera, offset: glam::DVec2) -> Frame {
    let dir = |px: glam::DVec2| camera.ray(px + offset).dir;
    let first = dir(glam::DVec2::ZERO);
    let is_perspective = matches!(camera.projection, crate::space::Projection::Perspective { .. });
    Frame {
        first_dir: first.as_vec3().to_array(),
        is_perspective: u32::from(is_perspective),
        dir_across: (dir(glam::DVec2::X) - first).as_vec3().to_array(),
        dir_down: (dir(glam::DVec2::Y) - first).as_vec3().to_array(),
        ..Frame::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::layout::assert_same_layout;

    #[test]
    fn the_structs_are_the_shaders() {
        assert_same_layout::<Frame>();
        assert_same_layout::<Step>();
        assert_same_layout::<Slot>();
        assert_same_layout::<Surface>();
        assert_same_layout::<PlacedCorner>();
        assert_same_layout::<Fragment>();
        assert_same_layout::<Survivor>();
        assert_same_layout::<PeelPixel>();
        assert_same_layout::<KeptBoundary>();
    }
}
