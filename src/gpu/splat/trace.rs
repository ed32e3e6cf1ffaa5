//! From lists of surfels to the records of a rectangle: groups, or fragments, and hits in pools that grow.
//!
//! *Practice.* A pixel takes groups (or fragments) and hits from pools that all pixels share. Where a pool is too small its counter says how many
//! were asked for; the rectangle is then traced anew with more. A pixel without a group opens others, so that count may be far too
//! large, and never too small: pools grow by a factor at a time.

use std::sync::atomic::{AtomicU32, Ordering};

use super::bins::{Bins, LISTS};
use super::crossed;
use super::fragment::{self, Fragment, RANGE_WORDS};
use super::project::SplatView;
use super::shaders::{self, Asked};
use crate::gpu::buffers::Commands;
use crate::gpu::crossings::GpuCrossingSource;
use crate::gpu::layers::{GpuLayers, LayerRecord};
use crate::gpu::{Gpu, GpuError, scan};
use crate::gpu_struct;
use crate::layers::{MAX_SAMPLES, sample_offsets};
use crate::space::PixelRect;
use crate::splat::bins::BLOCK;

// A workgroup is a block.
const _: () = assert!(BLOCK * BLOCK == crate::gpu::shader::WORKGROUP);

gpu_struct! {
    /// Candidates that may be one surface: the twin of [`crate::splat::rows::Slot`], for one ray.
    pub(super) struct Group {
        /// Least depth of a candidate, less its reach.
        lower: f32,
        /// Greatest depth of a candidate, plus its reach.
        upper: f32,
        /// Sum of the candidates' weights.
        weight: f32,
        /// And of their depths by weight.
        weighted_depth: f32,
        /// The largest weight.
        best_weight: f32,
        /// The depth of that candidate.
        best_depth: f32,
        /// The view of its surfel.
        best: u32,
        /// The next group of the list.
        next: u32,
        /// What came of it, in bits: see `shaders/splat/turns.wgsl`.
        found: u32,
        /// The depth of its crossing.
        t: f32,
        /// How far a step of one in depth takes along the surface's normal there.
        steepness: f32,
    }
}

gpu_struct! {
    /// One boundary of the result on one ray: the twin of [`crate::splat::hits::Hit`].
    pub(super) struct Hit {
        /// The result's outward unit normal, view axes.
        normal: [f32; 3],
        /// Depth less the block's anchor.
        t: f32,
        /// Linear RGB.
        colour: [f32; 3],
        /// 0 to 1.
        opacity: f32,
        /// Whose surface.
        leaf: u32,
        /// Whose material lies behind.
        body: u32,
        /// The bits of the samples that see it; negative where the ray leaves the result. Until it is decided, [`TIED`].
        seen: i32,
        /// The next of the pixel.
        next: u32,
    }
}

/// Bits of [`Hit::seen`] beyond those of samples: the hit is not decided, since the surface of another leaf may coincide with its own
/// (the twin of [`crate::splat::tied`]); the ray enters its leaf; its surface shows there.
pub(super) const TIED: u32 = 1 << 30;
pub(super) const TIED_ENTERS: u32 = 1 << 29;
pub(super) const TIED_SHOWS: u32 = 1 << 28;

const _: () = assert!(MAX_SAMPLES <= TIED_SHOWS.trailing_zeros());

/// Where the words of pixels count groups or fragments, count hits, have the most groups that a sample before took, say whether a
/// thread's loops were cut short, and have the pixels' first hits.
pub(super) const GROUPS_NEEDED: u32 = 0;
pub(super) const HITS_NEEDED: u32 = 1;
pub(super) const GROUPS_MOST: u32 = 2;
pub(super) const UNFINISHED: u32 = 3;
pub(super) const FIRST_PIXEL: u32 = 4;

/// How many groups and hits there is room for at first, and then what drawing took, for the next draw.
#[derive(Debug)]
pub(super) struct Room {
    groups: AtomicU32,
    hits: AtomicU32,
}

impl Room {
    /// For so many of each.
    pub fn new(count: u32) -> Self {
        Self { groups: count.into(), hits: count.into() }
    }

    fn get(&self) -> [u32; 2] {
        [&self.groups, &self.hits].map(|room| room.load(Ordering::Relaxed))
    }

    /// For as many as were asked for, but no more than a few times what there was: `needed` may be far too large. Never more than one
    /// buffer holds, since other rectangles share the room.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`] where one buffer does not hold what this rectangle needs.
    fn grow(&self, gpu: &Gpu, way: &Way, needed: [u32; 2], pixels: u32) -> Result<(), GpuError> {
        const FACTOR: u32 = 4;
        let grow = |what: &str, room: &AtomicU32, needed: u32, size: usize| {
            let limit = gpu.largest_binding();
            let most = (limit / size as u64) as u32;
            let before = room.load(Ordering::Relaxed);
            if needed > before && before >= most {
                return Err(GpuError::TooLarge {
                    what: format!("bytes of {what}"),
                    needed: u64::from(needed) * size as u64,
                    limit,
                });
            }
            room.fetch_max(needed.min(before.saturating_mul(FACTOR).max(pixels)).min(most), Ordering::Relaxed);
            Ok(())
        };
        grow(way.pool(), &self.groups, needed[0], way.pool_size())?;
        grow("hits", &self.hits, needed[1], std::mem::size_of::<Hit>())
    }
}

/// What is traced: the views of surfels, their lists, and the scene.
pub(super) struct Scene<'a> {
    pub views: &'a wgpu::Buffer,
    pub bins: &'a Bins,
    pub far: &'a wgpu::Buffer,
    pub tables: &'a wgpu::Buffer,
    pub leaf_words: u32,
    /// Whether crossings with any leaf are held to take turns.
    pub takes_turns: bool,
    pub way: Way<'a>,
}

/// How hits are found.
pub(super) enum Way<'a> {
    /// Surface by surface, clipped on the fields of the leaves, and by the crossings of those that `source` finds, with the words that
    /// a set of the Blist's entries takes.
    Fields { source: Option<&'a dyn GpuCrossingSource>, list_words: u32 },
    /// Surface by surface, clipped by partners, with the words that the paper tree's stack takes.
    Surfaces { stack_words: u32 },
    /// Fragment by fragment, as in the paper: with the footprints, and the words that the paper tree's stack takes.
    Fragments { footprints: &'a wgpu::Buffer, stack_words: u32 },
}

impl Way<'_> {
    /// What the pool is of that pixels share before they have hits.
    fn pool(&self) -> &'static str {
        match self {
            Self::Fields { .. } | Self::Surfaces { .. } => "groups of fragments",
            Self::Fragments { .. } => "fragments",
        }
    }

    /// Bytes of one.
    fn pool_size(&self) -> usize {
        match self {
            Self::Fields { .. } | Self::Surfaces { .. } => size_of::<Group>(),
            Self::Fragments { .. } => size_of::<Fragment>(),
        }
    }

    /// Words that a pixel takes.
    fn pixel_words(&self) -> usize {
        match self {
            Self::Fields { .. } | Self::Surfaces { .. } => 1,
            Self::Fragments { .. } => 1 + RANGE_WORDS,
        }
    }
}

/// One sample being drawn.
pub(super) struct Drawing<'c, 'g> {
    pub commands: &'c mut Commands<'g>,
    /// What kernels know of it.
    pub of: SplatView,
    pub uniform: &'c wgpu::Buffer,
    pub pool: &'c wgpu::Buffer,
    pub pixels: &'c wgpu::Buffer,
    pub hits: &'c wgpu::Buffer,
    /// How many there are.
    pub blocks: usize,
}

impl Scene<'_> {
    /// Finds the hits of one sample, that of so many of `rect`.
    ///
    /// # Errors
    /// Those of crossings.
    fn find_hits(&self, drawing: &mut Drawing, rect: PixelRect, sample: usize) -> Result<(), GpuError> {
        let gpu = drawing.commands.gpu();
        let (asked, source) = match self.way {
            Way::Fields { source, list_words } => (Asked::Fields { list_words }, source),
            Way::Surfaces { stack_words } => (Asked::Partners { stack_words }, None),
            Way::Fragments { footprints, stack_words } => {
                fragment::dispatch(drawing, self, footprints, stack_words);
                return Ok(());
            }
        };
        let crossed = match source {
            Some(source) => {
                // What the source does waits for the device: what was told before is better begun with.
                std::mem::replace(drawing.commands, gpu.commands()).submit();
                let crossings = source.crossings(gpu, rect, sample)?;
                let (starts, of) =
                    crossed::beside(drawing.commands, &self.bins.starts, drawing.blocks, &crossings, &drawing.of)?;
                Some((starts, gpu.uniform("splat view", &of)))
            }
            None => None,
        };
        let (starts, uniform) =
            crossed.as_ref().map_or((&self.bins.starts, drawing.uniform), |(starts, uniform)| (starts, uniform));
        let shared = [
            (0, uniform),
            (1, self.views),
            (2, &self.bins.members),
            (3, starts),
            (5, drawing.pixels),
            (6, self.far),
            (7, self.tables),
            (8, drawing.hits),
        ];
        let buffers = [&shared[..], &[(4, drawing.pool)]].concat();
        let shader = shaders::trace(self.leaf_words, self.takes_turns, asked);
        let trace = gpu.kernel(&shader, "trace");
        drawing.commands.dispatch_groups(&trace, &gpu.bind(&trace, &buffers), drawing.blocks);
        let after: &[&str] = match (asked, &crossed) {
            (Asked::Partners { .. }, _) => &[],
            (Asked::Fields { .. }, None) => &["trace_tied"],
            (Asked::Fields { .. }, Some(_)) => &["trace_crossed", "trace_tied"],
        };
        for entry in after {
            let kernel = gpu.kernel(&shader, entry);
            drawing.commands.dispatch_groups(&kernel, &gpu.bind(&kernel, &shared), drawing.blocks);
        }
        Ok(())
    }

    /// The layers of `rect`, that of `of`, with so many samples a pixel.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`], [`GpuError::Lost`]; [`GpuError::CutShort`] where the driver ends loops early, as Mesa's llvmpipe does
    /// after 65 535 steps of all loops of a thread together.
    pub fn trace(
        &self,
        gpu: &Gpu,
        of: &SplatView,
        rect: PixelRect,
        samples: u32,
        room: &Room,
    ) -> Result<GpuLayers, GpuError> {
        let [merge, finish] = ["merge_sample", "finish_merge"].map(|entry| gpu.kernel(&shaders::merge(), entry));
        let merged = gpu.storage::<u32>("merged pixels", if samples > 1 { rect.area() } else { 0 })?;
        let blocks = (of.grid[2] * of.grid[3]) as usize;
        let pixels = gpu.storage::<u32>("pixels", FIRST_PIXEL as usize + rect.area() * self.way.pixel_words())?;
        let offsets = gpu.storage::<u32>("offsets", rect.area() + 1)?;
        loop {
            let [group_room, hit_room] = room.get();
            let pool = gpu.storage::<u8>(self.way.pool(), group_room as usize * self.way.pool_size())?;
            let hits = gpu.storage::<Hit>("hits", hit_room as usize)?;
            let rooms = SplatView { room: [group_room, hit_room], ..*of };
            let mut commands = gpu.commands();
            commands.clear(&pixels);
            let samples = sample_offsets(samples);
            for (sample, place) in samples.iter().enumerate() {
                let place = place.as_vec2().to_array();
                let of = SplatView { place, samples: 1 << sample, ..rooms };
                let uniform = gpu.uniform("splat view", &of);
                let mut drawing = Drawing {
                    commands: &mut commands,
                    of,
                    uniform: &uniform,
                    pool: &pool,
                    pixels: &pixels,
                    hits: &hits,
                    blocks,
                };
                self.find_hits(&mut drawing, rect, sample)?;
                if samples.len() > 1 {
                    let buffers = [(0, &uniform), (1, &hits), (2, &pixels), (3, &merged)];
                    commands.dispatch(&merge, &gpu.bind(&merge, &buffers), rect.area());
                    if sample + 1 == samples.len() {
                        commands.dispatch(&finish, &gpu.bind(&finish, &buffers), rect.area());
                    }
                }
            }
            // What opaque hits hide of a sample is not among what was merged.
            let nearest_only = if samples.len() > 1 { 0 } else { of.nearest_only };
            let uniform = gpu.uniform("splat view", &SplatView { nearest_only, ..rooms });
            let [count, write] = ["count_hits", "write_records"].map(|entry| gpu.kernel(&shaders::hits(), entry));
            let buffers = [(0, &uniform), (4, &hits), (5, &pixels), (6, &offsets)];
            commands.dispatch(&count, &gpu.bind(&count, &buffers), rect.area() + 1);
            scan::exclusive(gpu, &mut commands, &offsets, rect.area() + 1)?;
            commands.submit();
            let needed: Vec<u32> = gpu.download(&pixels, FIRST_PIXEL as usize)?;
            if needed[UNFINISHED as usize] != 0 {
                return Err(GpuError::CutShort);
            }
            let needed =
                [needed[GROUPS_NEEDED as usize].max(needed[GROUPS_MOST as usize]), needed[HITS_NEEDED as usize]];
            if needed[0] > group_room || needed[1] > hit_room {
                room.grow(gpu, &self.way, needed, rect.area() as u32)?;
                continue;
            }
            let total = gpu.download_from::<u32>(&offsets, 4 * rect.area() as u64, 1)?[0] as usize;
            let records = gpu.storage::<LayerRecord>("records", total)?;
            let buffers = [
                (0, &uniform),
                (1, self.views),
                (2, &self.bins.members),
                (3, &self.bins.starts),
                (4, &hits),
                (5, &pixels),
                (6, &offsets),
                (7, &records),
            ];
            let mut commands = gpu.commands();
            commands.dispatch(&write, &gpu.bind(&write, &buffers), rect.area());
            commands.submit();
            return Ok(GpuLayers { rect, offsets, records, count: total });
        }
    }
}

/// Blocks that cover `rect`: first column and row, and how many across and down.
pub(super) fn grid(rect: PixelRect) -> [u32; 4] {
    let (x, y) = (rect.x0 / BLOCK, rect.y0 / BLOCK);
    [x, y, rect.x1.div_ceil(BLOCK) - x, rect.y1.div_ceil(BLOCK) - y]
}

// The two lists of a block are those that rays can enter through, and the others.
const _: () = assert!(LISTS == 2);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_structs_are_the_shaders() {
        crate::gpu::layout::assert_same_layout::<Group>();
        crate::gpu::layout::assert_same_layout::<Hit>();
    }

    #[test]
    fn blocks_cover_a_rectangle_wherever_it_begins() {
        assert_eq!(grid(PixelRect { x0: 0, y0: 0, x1: 64, y1: 8 }), [0, 0, 8, 1]);
        assert_eq!(grid(PixelRect { x0: 7, y0: 17, x1: 9, y1: 18 }), [0, 2, 2, 1]);
    }
}
