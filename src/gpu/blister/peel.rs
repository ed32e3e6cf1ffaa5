//! Depth peeling: every pass draws everything, and finds the next layer of every pixel while it classifies the last.
//!
//! *Theory.* Blister 2005 §4: layers are peeled front to back, each is classified by the parity of every leaf and the expression, and
//! the first that holds is kept; a superset R of the result bounds the layers from the front and the back ([`superset`]); pixels that
//! have what they need are rejected early.
//!
//! *Changes from the paper.* The paper looks for a layer in one set of passes and tests parity in another, a leaf at a time, with the
//! stencil. Here a pass marks in one word a pixel and 32 leaves which leaves toggle at the layer, with atomics: so one pass classifies
//! layer i and finds layer i + 1 (`running`), or two do (`parity`). Behind a front of a
//! single product no leaf is counted again: all are where the product wants them, and whatever toggles next ends it (Blueprint, Nienhaus
//! et al. 2006, §4.4: *even layers need no CSG test*). Layers are ordered by the bits of their keys, so that coincident
//! fragments are equal and others are not.
//!
//! *Practice.* How many passes there are is not known beforehand. They are submitted [`A_BATCH`] at a time with arguments that a kernel
//! sets to nothing once no pixel wants another: the CPU waits once a batch.
//!
//! [`superset`]: crate::csg::superset

use super::arrangement::{KeptBoundary, PeelPixel, Survivor, Uploaded};
use super::draws::{DEPTH, KINDS, NO_COLOUR, pass, pipeline};
use super::frame::{GpuMeshFrame, Peeling, with_room};
use super::{list, shader};
use crate::gpu::layers::GpuLayers;
use crate::gpu::shader::WORKGROUP;
use crate::gpu::{Commands, Gpu, GpuError, scan};
use crate::space::PixelRect;

/// Passes that are submitted before the CPU waits for them.
const A_BATCH: u32 = 8;

/// Boundaries that there is room for at first, for each pixel.
const FIRST_BOUNDARIES_A_PIXEL: usize = 1;

/// Words of `Control`: boundaries, active pixels, rejected pixels, passes, layers that needed no test.
const CONTROL_WORDS: usize = 5;

/// Everything that a band's passes share.
struct Peel<'p> {
    gpu: &'p Gpu,
    uploaded: &'p Uploaded,
    rect: PixelRect,
    is_bounded: bool,
    is_parity: bool,
    frame: wgpu::Buffer,
    target: wgpu::TextureView,
    depth: wgpu::TextureView,
    pixels: wgpu::Buffer,
    states: wgpu::Buffer,
    toggles: wgpu::Buffer,
    kept_surfaces: wgpu::Buffer,
    boundaries: wgpu::Buffer,
    control: wgpu::Buffer,
    arguments: wgpu::Buffer,
}

/// The layers of a band.
pub(super) fn draw(
    gpu: &Gpu,
    frame: &GpuMeshFrame,
    uploaded: &Uploaded,
    rect: PixelRect,
    is_parity: bool,
) -> Result<GpuLayers, GpuError> {
    let of = ("boundaries", std::mem::size_of::<KeptBoundary>());
    with_room(gpu, &frame.length, of, rect.area() * FIRST_BOUNDARIES_A_PIXEL, |room| {
        let is_bounded = frame.is_bounded && uploaded.superset.is_some();
        let peel = Peel::new(gpu, uploaded, rect, room, (is_bounded, frame.is_short), is_parity)?;
        let [length, _, rejected, passes, known] = peel.run()?;
        let before = frame.peeling.get();
        frame.peeling.set(Peeling {
            passes: before.passes + u64::from(passes),
            rejected: before.rejected + u64::from(rejected),
            untested: before.untested + u64::from(known),
        });
        let has_room = length as usize <= room;
        Ok((length as usize, has_room.then(|| peel.finish(length as usize)).transpose()?))
    })
}

impl<'p> Peel<'p> {
    fn new(
        gpu: &'p Gpu,
        uploaded: &'p Uploaded,
        rect: PixelRect,
        room: usize,
        (is_bounded, is_short): (bool, bool),
        is_parity: bool,
    ) -> Result<Self, GpuError> {
        let (pixels, words) = (rect.area(), uploaded.traits.words as usize);
        let mut band = uploaded.band(rect);
        band.is_bounded = u32::from(is_bounded);
        band.is_product &= u32::from(is_short);
        // The bounds need two words.
        let states = gpu.storage::<u32>("states", pixels * words.max(2))?;
        let groups = groups(pixels);
        let [triangles, fragments] = uploaded.vertices().map(|range| [range.end - range.start, 1, range.start, 0]);
        Ok(Self {
            gpu,
            uploaded,
            rect,
            is_bounded,
            is_parity,
            frame: gpu.uniform("frame", &band),
            target: gpu.target("target", rect, NO_COLOUR)?,
            depth: gpu.target("depth", rect, DEPTH)?,
            pixels: gpu.storage::<PeelPixel>("pixels", pixels)?,
            states,
            toggles: gpu.storage::<u32>("toggles", 2 * pixels * words)?,
            kept_surfaces: gpu.storage::<u32>("kept surfaces", room)?,
            boundaries: gpu.storage::<KeptBoundary>("boundaries", room)?,
            control: gpu.storage::<u32>("control", CONTROL_WORDS)?,
            arguments: gpu.upload("arguments", &[triangles, fragments, [groups[0], groups[1], 1, 0]])?,
        })
    }

    /// Peels until no pixel wants another layer; returns the words of `Control`.
    fn run(&self) -> Result<[u32; CONTROL_WORDS], GpuError> {
        let mut commands = self.gpu.commands();
        if self.is_bounded {
            self.render(&mut commands, "bound_fragment", false);
        }
        self.kernel(&mut commands, "begin_pixels");
        commands.clear(&self.states);
        let mut passes = 0;
        loop {
            for _ in 0..A_BATCH {
                if self.is_parity {
                    self.parity_pass(&mut commands, passes);
                } else {
                    self.render(&mut commands, if passes == 0 { "first_fragment" } else { "running_fragment" }, true);
                    self.kernel(&mut commands, "running_layer");
                }
                self.kernel(&mut commands, "next_pass");
                passes += 1;
            }
            commands.submit();
            let control: Vec<u32> = self.gpu.download(&self.control, CONTROL_WORDS)?;
            // Passes count only while there is something to do.
            if control[3] < passes {
                return Ok(std::array::from_fn(|word| control[word]));
            }
            commands = self.gpu.commands();
        }
    }

    /// Passes in turn: where the layer is, and what it is. With a superset the first layer is where that begins.
    fn parity_pass(&self, commands: &mut Commands, number: u32) {
        let is_search = number.is_multiple_of(2) != self.is_bounded;
        if is_search {
            self.render(commands, "peel_fragment", true);
            self.kernel(commands, "peel_layer");
        } else {
            self.render(commands, "parity_fragment", false);
            self.kernel(commands, "parity_layer");
        }
    }

    /// Draws everything that the arguments leave, or the superset.
    fn render(&self, commands: &mut Commands, fragment: &'static str, has_depth: bool) {
        let (gpu, uploaded) = (self.gpu, self.uploaded);
        let is_bound = fragment == "bound_fragment";
        let ranges = uploaded.superset.iter().flatten();
        let mut draws = 0;
        {
            let depth = has_depth.then_some(&self.depth);
            let mut pass = pass(&mut commands.encoder, fragment, &self.target, depth);
            pass.set_vertex_buffer(0, uploaded.corners.slice(..));
            for (kind, (topology, vertices)) in KINDS.into_iter().zip(uploaded.vertices()).enumerate() {
                if vertices.is_empty() {
                    continue;
                }
                let pipeline = pipeline(gpu, uploaded, fragment, topology, has_depth);
                let buffers: &[(u32, &wgpu::Buffer)] = match fragment {
                    "bound_fragment" => &[(2, &uploaded.slots), (15, &self.states)],
                    "first_fragment" | "parity_fragment" => {
                        &[(2, &uploaded.slots), (14, &self.pixels), (15, &self.states), (16, &self.toggles)]
                    }
                    "running_fragment" => {
                        &[(2, &uploaded.slots), (14, &self.pixels), (16, &self.toggles), (17, &self.kept_surfaces)]
                    }
                    _ => &[(14, &self.pixels), (17, &self.kept_surfaces)],
                };
                let buffers = [&[(0, &self.frame), (3, &uploaded.surfaces)], buffers].concat();
                pass.set_pipeline(&pipeline);
                pass.set_bind_group(0, &gpu.bind_layout(&pipeline.get_bind_group_layout(0), &buffers), &[]);
                if is_bound && topology == wgpu::PrimitiveTopology::TriangleList {
                    for range in ranges.clone().filter(|range| !range.is_empty()) {
                        pass.draw(3 * range.start..3 * range.end, 0..1);
                        draws += 1;
                    }
                } else if is_bound {
                    pass.draw(vertices, 0..1);
                    draws += 1;
                } else {
                    pass.draw_indirect(&self.arguments, 16 * kind as u64);
                    draws += 1;
                }
            }
        }
        let of_superset = ranges.map(|range| u64::from(range.end - range.start)).sum();
        commands.count_pass(draws, if is_bound { of_superset } else { u64::from(uploaded.triangles) });
    }

    /// Runs a kernel over the pixels, as far as the arguments say.
    fn kernel(&self, commands: &mut Commands, entry: &'static str) {
        let kernel = self.gpu.kernel(&shader(self.uploaded.traits), entry);
        let uploaded = self.uploaded;
        let depth = wgpu::BindGroupEntry { binding: 20, resource: wgpu::BindingResource::TextureView(&self.depth) };
        let classify: [(u32, &wgpu::Buffer); 9] = [
            (0, &self.frame),
            (1, &uploaded.steps),
            (2, &uploaded.slots),
            (14, &self.pixels),
            (15, &self.states),
            (16, &self.toggles),
            (17, &self.kept_surfaces),
            (18, &self.boundaries),
            (19, &self.control),
        ];
        let (buffers, has_depth): (&[(u32, &wgpu::Buffer)], bool) = match entry {
            "begin_pixels" => (&[(0, &self.frame), (14, &self.pixels), (15, &self.states)], false),
            "running_layer" => (&classify, true),
            "parity_layer" => (&classify, false),
            "peel_layer" => (&[(0, &self.frame), (14, &self.pixels), (19, &self.control)], true),
            _ => (&[(19, &self.control), (21, &self.arguments)], false),
        };
        let mut entries: Vec<_> = buffers
            .iter()
            .map(|(binding, buffer)| wgpu::BindGroupEntry { binding: *binding, resource: buffer.as_entire_binding() })
            .collect();
        entries.extend(has_depth.then_some(depth));
        let group = self.gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &kernel.get_bind_group_layout(0),
            entries: &entries,
        });
        if entry == "next_pass" {
            commands.dispatch_groups(&kernel, &group, 1);
        } else if entry == "begin_pixels" {
            commands.dispatch(&kernel, &group, self.rect.area());
        } else {
            commands.dispatch_indirect(&kernel, &group, &self.arguments, 32);
        }
    }

    /// Puts the boundaries in order, and makes records of them.
    fn finish(&self, length: usize) -> Result<GpuLayers, GpuError> {
        let (gpu, uploaded, pixels) = (self.gpu, self.uploaded, self.rect.area());
        let shader = shader(uploaded.traits);
        let kept = gpu.storage::<u32>("kept", pixels + 1)?;
        let sorted = gpu.storage::<Survivor>("sorted", length)?;
        let mut commands = gpu.commands();
        let count = gpu.kernel(&shader, "count_boundaries");
        commands.dispatch(&count, &gpu.bind(&count, &[(0, &self.frame), (9, &kept), (14, &self.pixels)]), pixels);
        scan::exclusive(gpu, &mut commands, &kept, pixels + 1)?;
        let place = gpu.kernel(&shader, "place_boundaries");
        let buffers =
            [(6, &kept), (8, &sorted), (17, &self.kept_surfaces), (18, &self.boundaries), (19, &self.control)];
        commands.dispatch(&place, &gpu.bind(&place, &buffers), length);
        commands.submit();
        let offsets = kept.clone();
        list::write(gpu, uploaded, &self.frame, self.rect, &sorted, &offsets, kept)
    }
}

/// A grid of workgroups with a thread for each pixel.
fn groups(pixels: usize) -> [u32; 2] {
    crate::gpu::buffers::grid(pixels.div_ceil(WORKGROUP as usize))
}
