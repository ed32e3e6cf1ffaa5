//! A classified scene on the GPU: what does not depend on the camera.

use glam::DVec3;
use rayon::prelude::*;

use super::far::Far;
use super::tables::{self, Kind};
use super::trace::Room;
use crate::classify::{LeafField, Model};
use crate::csg::LeafId;
use crate::gpu::{Gpu, GpuError};
use crate::gpu_struct;
use crate::splat::project::LeafLook;
use crate::surfel::CHUNK;

/// Groups and hits that there is room for at first: what a quarter of a million pixels with four surfaces each take.
const FIRST_ROOM: u32 = 1 << 20;

/// Why the GPU does not draw a scene of surfels.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum GpuSplatError {
    /// A leaf keeps its own form, and nobody tells where rays cross it.
    #[error("leaf {} keeps its own form, which surfels alone do not find: use --pipeline hybrid", leaf.0)]
    ExactLeaf {
        /// Which.
        leaf: LeafId,
    },
    /// A leaf has its own form beside surfels, which the CPU asks on which side of it a point is.
    #[error("leaf {} is sampled and asked for its own form, which the GPU does not: use --pipeline hybrid", leaf.0)]
    SampledLeaf {
        /// Which.
        leaf: LeafId,
    },
    /// The device.
    #[error(transparent)]
    Gpu(#[from] GpuError),
}

gpu_struct! {
    /// A surfel in world axes.
    pub(super) struct ModelSurfel {
        /// Centre less its chunk's origin.
        offset: [f32; 3],
        /// Of the support ball.
        radius: f32,
        /// Unit outward normal.
        normal: [f32; 3],
        /// 0 to 1.
        opacity: f32,
        /// Curvature: xx, xy, xz, yy.
        curvature_a: [f32; 4],
        /// And yz, zz.
        curvature_b: [f32; 2],
        /// What it is drawn as: [`Kind`].
        kind: u32,
        /// Fills the gap.
        unused: u32,
        /// Linear RGB.
        colour: [f32; 3],
        /// Fills the gap.
        unused_too: u32,
    }
}

gpu_struct! {
    /// The support of an elliptical surfel in world axes: eᵀSe = 1 on its border.
    pub(super) struct ModelSupport {
        /// xx, xy, xz, yy.
        a: [f32; 4],
        /// yz, zz.
        b: [f32; 2],
        /// Fills the gap.
        unused: [u32; 2],
    }
}

/// Chunks whose surfels fill one buffer.
#[derive(Debug)]
pub(super) struct Part {
    /// Leaf and chunk, ascending.
    pub chunks: Vec<(LeafId, u32)>,
    /// [`ModelSurfel`], [`CHUNK`] a chunk, but for a leaf's last one.
    pub surfels: wgpu::Buffer,
    /// [`ModelSupport`] of each, where any is an ellipse.
    pub supports: Option<wgpu::Buffer>,
}

/// A classified scene, uploaded.
#[derive(Debug)]
pub struct GpuSplatModel {
    state: u64,
    pub(super) parts: Vec<Part>,
    /// The expression, residuals and statuses: see [`tables`].
    pub(super) tables: wgpu::Buffer,
    /// Where surfels do not reach.
    pub(super) far: wgpu::Buffer,
    /// The origin of what is far, world space.
    pub(super) origin: DVec3,
    pub(super) leaves: usize,
    /// The first leaf of the expression that crossings have to tell of.
    pub(super) exact: Option<LeafId>,
    /// [`tables::LEAF_BITS`] to a word.
    pub(super) leaf_words: u32,
    /// Words of a set of the expression's entries.
    pub(super) list_words: u32,
    /// Whether crossings with any leaf are held to take turns.
    pub(super) takes_turns: bool,
    /// What the frames before took.
    pub(super) room: Room,
}

impl GpuSplatModel {
    /// Uploads `model`.
    ///
    /// # Errors
    /// [`GpuSplatError::SampledLeaf`], and [`GpuError::TooLarge`] where what decides sides
    /// far from surfels, or the expression's tables, fit no buffer. Surfels themselves are split.
    pub fn new(gpu: &Gpu, model: &Model) -> Result<Self, GpuSplatError> {
        let first = |is_it: &dyn Fn(&LeafField) -> bool| {
            model.fields.iter().position(|field| is_it(field)).map(|leaf| LeafId(leaf as u32))
        };
        if let Some(leaf) = first(&|field| field.exact.is_some() && !field.cloud.is_empty()) {
            return Err(GpuSplatError::SampledLeaf { leaf });
        }
        let origin = middle(model);
        let far = Far::of(model, origin);
        let tables = tables::Tables::of(model, &far);
        let parts = parts(gpu, model, |leaf, index| tables.kind(model, leaf, index))?;
        Ok(Self {
            state: model.state(),
            parts,
            tables: gpu.upload("tables", &tables.words)?,
            far: gpu.upload("far sides", &far.rows)?,
            origin,
            leaves: model.fields.len(),
            exact: model.tree.leaves().into_iter().find(|leaf| model.fields[leaf.0 as usize].exact.is_some()),
            leaf_words: tables::leaf_words(model.fields.len()),
            list_words: tables::list_words(model.list.entries().len()),
            takes_turns: model.fields.iter().any(|field| field.takes_turns()),
            room: Room::new(FIRST_ROOM),
        })
    }

    /// Whether this is `model` as it is now.
    pub fn is_of(&self, model: &Model) -> bool {
        self.state == model.state()
    }
}

/// A place amid the leaves.
fn middle(model: &Model) -> DVec3 {
    let origins = || model.fields.iter().flat_map(|field| field.cloud.chunks.iter().map(|chunk| chunk.origin));
    let low = origins().fold(DVec3::INFINITY, DVec3::min);
    let high = origins().fold(DVec3::NEG_INFINITY, DVec3::max);
    let middle = 0.5 * (low + high);
    if middle.is_finite() { middle } else { DVec3::ZERO }
}

/// The surfels in as many buffers as they need.
fn parts(gpu: &Gpu, model: &Model, kind: impl Fn(LeafId, usize) -> Kind + Sync) -> Result<Vec<Part>, GpuError> {
    let chunks: Vec<(LeafId, u32)> = (0..model.fields.len())
        .flat_map(|leaf| (0..model.fields[leaf].cloud.chunks.len()).map(move |c| (LeafId(leaf as u32), c as u32)))
        .collect();
    let most = gpu.largest_binding() as usize / std::mem::size_of::<ModelSurfel>() / CHUNK;
    chunks
        .chunks(most)
        .map(|chunks| {
            let of_chunk = |&(leaf, chunk): &(LeafId, u32)| {
                let field = &model.fields[leaf.0 as usize];
                let first = chunk as usize * CHUNK;
                let all = first..(first + CHUNK).min(field.cloud.len());
                all.map(move |index| (leaf, index, &**field))
            };
            let surfels: Vec<ModelSurfel> = chunks
                .par_iter()
                .flat_map_iter(of_chunk)
                .map(|(leaf, index, field)| surfel(model, field, (leaf, index), kind(leaf, index)))
                .collect();
            let has_ellipses = chunks.iter().any(|(leaf, _)| model.fields[leaf.0 as usize].cloud.supports.is_some());
            let supports = has_ellipses.then(|| {
                let supports: Vec<ModelSupport> =
                    chunks.par_iter().flat_map_iter(of_chunk).map(|(_, index, field)| support(field, index)).collect();
                gpu.upload("supports", &supports)
            });
            let supports = supports.transpose()?;
            Ok(Part { chunks: chunks.to_vec(), surfels: gpu.upload("surfels", &surfels)?, supports })
        })
        .collect()
}

fn surfel(model: &Model, field: &LeafField, (leaf, index): (LeafId, usize), kind: Kind) -> ModelSurfel {
    let surfel = &field.cloud.surfels[index];
    let look = model.looks[leaf.0 as usize];
    let class = model.classes[leaf.0 as usize].classes[index];
    let look = LeafLook { colour: look.colour, opacity: look.opacity, class };
    let [xx, xy, xz, yy, yz, zz] = surfel.curvature.0;
    ModelSurfel {
        offset: surfel.offset.to_array(),
        radius: surfel.radius,
        normal: surfel.normal.to_array(),
        opacity: look.opacity_of(surfel),
        curvature_a: [xx, xy, xz, yy],
        curvature_b: [yz, zz],
        kind: kind.0,
        colour: look.colour_of(surfel),
        ..ModelSurfel::default()
    }
}

/// A disk's support is that of its ball.
fn support(field: &LeafField, index: usize) -> ModelSupport {
    let [xx, xy, xz, yy, yz, zz] = match &field.cloud.supports {
        Some(supports) => supports[index].0,
        None => {
            let radius = f64::from(field.cloud.surfels[index].radius);
            let own = (1.0 / (radius * radius)) as f32;
            [own, 0.0, 0.0, own, 0.0, own]
        }
    };
    ModelSupport { a: [xx, xy, xz, yy], b: [yz, zz], unused: [0; 2] }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_structs_are_the_shaders() {
        crate::gpu::layout::assert_same_layout::<ModelSurfel>();
        crate::gpu::layout::assert_same_layout::<ModelSupport>();
    }
}
