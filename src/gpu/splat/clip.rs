//! Clipping by partners on the GPU: the twin of [`crate::splat::clip`], [`crate::classify::inside`] and [`crate::csg::paper`].
//!
//! ```text
//! words: the model's tables │ header │ leaves ─► chunks, occurrences │ paper tree │ sides │ lists: starts, partners
//! rows:  what is far        │ disks
//! ```
//!
//! *Practice.* A *disk* is a surfel that may clip or be clipped; disks are numbered by leaf, then index, and a list of partners is
//! numbers in order, so those of one leaf stand together. What clipping reads is put behind what all kernels read, in the same two
//! buffers, since a stage has no more than eight. Centres are sums of two about the scene's origin: their differences are as good as
//! the CPU's.

use glam::DVec3;
use rayon::prelude::*;

use super::model::GpuSplatModel;
use crate::classify::partners::{Among, PartnerLists, SurfelId};
use crate::classify::{Drawn, Model, Wicke};
use crate::csg::positive::PositiveNode;
use crate::csg::{LeafId, PaperTree};
use crate::gpu::shader::Shader;
use crate::gpu::{Gpu, GpuError};
use crate::splat::clip::LONGEST_WALK;
use crate::splat::clip_buffer::takes_part;
use crate::splat::{Inside, Partners, SplatSettings, Unknown};
use crate::surfel::CHUNK;

/// Words of the header: where its parts begin, and how many disks there are.
const HEADER: usize = 5;
const CLIP_LEAVES: usize = 0;
/// [`NOWHERE`] under the resolved rule.
const CLIP_PAPER: usize = 1;
const CLIP_SIDES: usize = 2;
const CLIP_LISTS: usize = 3;
const CLIP_DISKS: usize = 4;

/// Words of a leaf: where its chunks begin, its first disk and the one past its last, whether it is asked as its complement, and
/// where its occurrences begin and end.
const LEAF_STRIDE: usize = 6;

/// Words of a chunk: how many disks are before it, and a bit for each of its surfels that is one.
const CHUNK_STRIDE: usize = 1 + CHUNK / u32::BITS as usize;

/// Words of a node of the paper tree: its kind, leaf or left operand, whether complemented or right operand, operator, and where
/// its subtree begins.
const NODE_STRIDE: usize = 5;
const NODE_LITERAL: u32 = 0;
const NODE_AND: u32 = 1;
const NODE_OR: u32 = 2;

/// No place.
const NOWHERE: u32 = u32::MAX;

/// Rows of four numbers that a disk takes: centre and radius; the rest of the centre, and 1 where that is on the result; normal,
/// and 1 where elliptical; curvature and support, six numbers each.
const ROWS_A_DISK: usize = 6;

/// How a point is found to be inside of partners.
fn word_of(inside: Inside) -> u32 {
    match inside {
        Inside::Nearest => 0,
        Inside::TwoNearest => 1,
        Inside::AnyPlane => 2,
        Inside::Blend => 3,
        Inside::Curved => 4,
    }
}

/// How the frames of a model clip, where they ask partners: what does not depend on the camera, uploaded once.
#[derive(Debug)]
pub struct GpuClipping {
    settings: SplatSettings,
    state: u64,
    /// Behind what is far: the disks.
    pub(super) rows: wgpu::Buffer,
    /// Behind the model's tables: what is asked; its lists are missing where every frame finds its own.
    pub(super) words: wgpu::Buffer,
    /// The first row of the disks.
    pub(super) disks: u32,
    /// Where in `words` the header is.
    pub(super) clip: u32,
    /// How many disks there are.
    pub(super) count: usize,
    /// Words of a stack as deep as the paper tree.
    pub(super) stack_words: u32,
}

impl GpuClipping {
    /// For the frames of `scene`, which was uploaded as `model`, that are drawn with `settings`; `None` where those ask for no
    /// partners. `lists` are partners that the caller found; they serve where the settings search space, follow the same rule and
    /// were found for the scene as it is.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`] where the disks or their lists fit no buffer.
    pub fn new(
        gpu: &Gpu,
        scene: &Model,
        model: &GpuSplatModel,
        settings: SplatSettings,
        lists: Option<&PartnerLists>,
    ) -> Result<Option<Self>, GpuError> {
        let Some(among) = settings.partners_among() else { return Ok(None) };
        let disks = Disks::of(scene, among);
        let clip = (model.tables.size() / size_of::<u32>() as u64) as u32;
        let paper = (settings.unknown == Unknown::Paper).then(|| PaperTree::from(&scene.tree));
        let mut words = words(scene, &disks, paper.as_ref(), clip);
        if settings.partners == Partners::ObjectSpace {
            words.extend(match lists {
                Some(lists) if lists.serve(scene, among) => disks.lists(lists),
                _ => disks.lists(&PartnerLists::in_space(scene, among)),
            });
        }
        let rows = disks.rows(scene, model.origin);
        Ok(Some(Self {
            settings,
            state: scene.state(),
            rows: behind(gpu, "disks", &model.far, &rows)?,
            words: behind(gpu, "partners", &model.tables, &words)?,
            disks: (model.far.size() / size_of::<[f32; 4]>() as u64) as u32,
            clip,
            count: disks.count(),
            stack_words: paper.as_ref().map_or(1, stack_words),
        }))
    }

    /// What the frames are drawn with.
    pub fn settings(&self) -> SplatSettings {
        self.settings
    }

    /// Whether this is of `model` as it is now.
    pub fn is_of(&self, model: &Model) -> bool {
        self.state == model.state()
    }

    /// How points are found to be inside, as kernels read it.
    pub(super) fn inside(&self) -> u32 {
        word_of(self.settings.inside)
    }
}

/// A buffer of what is in `first`, and then `data`.
fn behind<T: bytemuck::Pod>(
    gpu: &Gpu,
    label: &str,
    first: &wgpu::Buffer,
    data: &[T],
) -> Result<wgpu::Buffer, GpuError> {
    let bytes = size_of_val(data) as u64;
    joined(gpu, label, &[(first, first.size()), (&gpu.upload(label, data)?, bytes)])
}

/// A buffer of the first bytes of each of `parts`, one after the other.
pub(super) fn joined(gpu: &Gpu, label: &str, parts: &[(&wgpu::Buffer, u64)]) -> Result<wgpu::Buffer, GpuError> {
    let all = gpu.storage::<u8>(label, parts.iter().map(|(_, bytes)| *bytes as usize).sum())?;
    let mut commands = gpu.commands();
    let mut at = 0;
    for (part, bytes) in parts {
        commands.encoder.copy_buffer_to_buffer(part, 0, &all, at, *bytes);
        at += bytes;
    }
    commands.submit();
    Ok(all)
}

/// The surfels that may clip or be clipped, numbered.
struct Disks {
    /// By leaf: the indices of its disks, ascending.
    by_leaf: Vec<Vec<u32>>,
    /// By leaf: the number of its first disk; and how many there are.
    starts: Vec<u32>,
}

impl Disks {
    fn of(model: &Model, among: Among) -> Self {
        let of_leaf = |leaf: &crate::classify::LeafClasses| {
            (0..leaf.classes.len() as u32).filter(|index| takes_part(leaf.classes[*index as usize], among)).collect()
        };
        let by_leaf: Vec<Vec<u32>> = model.classes.par_iter().map(of_leaf).collect();
        let mut starts = vec![0];
        for of_leaf in &by_leaf {
            starts.push(starts[starts.len() - 1] + of_leaf.len() as u32);
        }
        Self { by_leaf, starts }
    }

    fn count(&self) -> usize {
        self.starts[self.by_leaf.len()] as usize
    }

    /// All, in order.
    fn iter(&self) -> impl Iterator<Item = SurfelId> {
        let of_leaf = |(leaf, indices): (usize, &Vec<u32>)| {
            indices.iter().map(move |&index| SurfelId { leaf: LeafId(leaf as u32), index }).collect::<Vec<_>>()
        };
        self.by_leaf.iter().enumerate().flat_map(of_leaf)
    }

    /// The number of a surfel.
    fn number(&self, surfel: SurfelId) -> u32 {
        let leaf = surfel.leaf.0 as usize;
        // All partners are disks.
        self.starts[leaf] + self.by_leaf[leaf].partition_point(|&index| index < surfel.index) as u32
    }

    /// Where each disk's partners begin, where the last's end, and all partners.
    fn lists(&self, lists: &PartnerLists) -> Vec<u32> {
        let mut words = Vec::with_capacity(self.count() + 1 + lists.len());
        let mut end = 0;
        words.push(end);
        for disk in self.iter() {
            end += lists.of(disk).len() as u32;
            words.push(end);
        }
        words.extend(self.iter().flat_map(|disk| lists.of(disk)).map(|&partner| self.number(partner)));
        words
    }

    fn rows(&self, model: &Model, origin: DVec3) -> Vec<[f32; 4]> {
        let of_disk = |disk: SurfelId| {
            let cloud = &model.fields[disk.leaf.0 as usize].cloud;
            let index = disk.index as usize;
            let surfel = &cloud.surfels[index];
            let centre = cloud.centre(index) - origin;
            let [c, rest] = [centre.as_vec3(), (centre - centre.as_vec3().as_dvec3()).as_vec3()];
            let on_result = model.classes[disk.leaf.0 as usize].classes[index].wicke() == Wicke::InsideEdge;
            let support = cloud.supports.as_ref().map(|supports| supports[index].0);
            let n = surfel.normal;
            let m = surfel.curvature.0;
            let s = support.unwrap_or_default();
            let flag = |is: bool| if is { 1.0 } else { 0.0 };
            let rows: [[f32; 4]; ROWS_A_DISK] = [
                [c.x, c.y, c.z, surfel.radius],
                [rest.x, rest.y, rest.z, flag(on_result)],
                [n.x, n.y, n.z, flag(support.is_some())],
                [m[0], m[1], m[2], m[3]],
                [m[4], m[5], s[0], s[1]],
                [s[2], s[3], s[4], s[5]],
            ];
            rows
        };
        self.iter().flat_map(of_disk).collect()
    }

    /// Where each disk's sides begin, where the last's end, and all sides: twice the leaf, and one more where it is inside.
    fn sides(&self, model: &Model) -> Vec<u32> {
        let disks: Vec<SurfelId> = self.iter().collect();
        let sides: Vec<Vec<u32>> = disks.par_iter().map(|&disk| sides_of(model, disk)).collect();
        let mut words = vec![0];
        for of_disk in &sides {
            words.push(words[words.len() - 1] + of_disk.len() as u32);
        }
        words.extend(sides.into_iter().flatten());
        words
    }
}

/// The sides of the leaves that are near a surfel without a disk of theirs reaching its ball: see [`crate::splat::clip`].
fn sides_of(model: &Model, surfel: SurfelId) -> Vec<u32> {
    let classes = &model.classes[surfel.leaf.0 as usize];
    let cloud = &model.fields[surfel.leaf.0 as usize].cloud;
    let Some(Drawn::Edge(number)) = classes.classes[surfel.index as usize].drawn() else { return Vec::new() };
    let centre = cloud.centre(surfel.index as usize);
    let radius = f64::from(cloud.surfels[surfel.index as usize].radius);
    let side = |near: &LeafId| {
        let field = &model.fields[near.0 as usize];
        let is_clear = field.lends_surfels() && !field.reaches(centre, radius);
        is_clear.then(|| 2 * near.0 + u32::from(field.far_inside(centre)))
    };
    classes.residuals[number as usize].near.iter().filter_map(side).collect()
}

/// All words but the lists, which follow; `base` words are before them.
fn words(model: &Model, disks: &Disks, paper: Option<&PaperTree>, base: u32) -> Vec<u32> {
    let leaves = model.fields.len();
    let mut words = vec![0_u32; HEADER + leaves * LEAF_STRIDE];
    let end = |words: &Vec<u32>| base + words.len() as u32;
    words[CLIP_LEAVES] = base + HEADER as u32;
    words[CLIP_PAPER] = NOWHERE;
    words[CLIP_DISKS] = disks.count() as u32;
    let mut uses = vec![[false; 2]; leaves];
    for literal in model.tree.literals() {
        uses[literal.leaf.0 as usize][usize::from(literal.negated)] = true;
    }
    for (leaf, used) in uses.iter().enumerate() {
        let mut of_leaf = [0; LEAF_STRIDE];
        of_leaf[0] = end(&words);
        of_leaf[1] = disks.starts[leaf];
        of_leaf[2] = disks.starts[leaf + 1];
        of_leaf[3] = u32::from(*used == [false, true]);
        chunks(&disks.by_leaf[leaf], disks.starts[leaf], model.fields[leaf].cloud.chunks.len(), &mut words);
        of_leaf[4] = end(&words);
        let occurrences = paper
            .into_iter()
            .flat_map(|paper| paper.occurrences_of(LeafId(leaf as u32)).map(|occurrence| paper.node_of(occurrence)));
        words.extend(occurrences);
        of_leaf[5] = end(&words);
        let at = HEADER + leaf * LEAF_STRIDE;
        words[at..at + LEAF_STRIDE].copy_from_slice(&of_leaf);
    }
    if let Some(paper) = paper {
        words[CLIP_PAPER] = end(&words);
        words.extend(paper.nodes().flat_map(|(node, parent, start)| node_words(node, parent, start)));
        words[CLIP_SIDES] = end(&words);
        words.extend(disks.sides(model));
    }
    words[CLIP_LISTS] = end(&words);
    words
}

/// Appends the words of a leaf's chunks.
fn chunks(disks: &[u32], first: u32, count: usize, words: &mut Vec<u32>) {
    let at = words.len();
    words.resize(at + count * CHUNK_STRIDE, 0);
    for &index in disks {
        let (chunk, place) = (index as usize / CHUNK, index % CHUNK as u32);
        words[at + chunk * CHUNK_STRIDE + 1 + (place / u32::BITS) as usize] |= 1 << (place % u32::BITS);
    }
    let mut before = first;
    for of_chunk in words[at..].chunks_exact_mut(CHUNK_STRIDE) {
        of_chunk[0] = before;
        before += of_chunk[1..].iter().map(|word| word.count_ones()).sum::<u32>();
    }
}

fn node_words(node: PositiveNode, parent: u32, start: u32) -> [u32; NODE_STRIDE] {
    let (kind, a, b) = match node {
        PositiveNode::Literal(literal) => (NODE_LITERAL, literal.leaf.0, u32::from(literal.negated)),
        PositiveNode::And(a, b) => (NODE_AND, a, b),
        PositiveNode::Or(a, b) => (NODE_OR, a, b),
    };
    [kind, a, b, parent, start]
}

/// Words with a bit for each left operand that may wait for its right one.
fn stack_words(paper: &PaperTree) -> u32 {
    let parents: Vec<u32> = paper.nodes().map(|(_, parent, _)| parent).collect();
    let mut waiting = vec![0_u32; parents.len()];
    // Operators come after their operands, and a right operand directly before its operator.
    for node in (0..parents.len()).rev() {
        let parent = parents[node] as usize;
        if parent != node {
            waiting[node] = waiting[parent] + u32::from(node + 1 == parent);
        }
    }
    waiting.into_iter().max().unwrap_or(0).div_ceil(u32::BITS).max(1)
}

/// What clips by partners, with the constants that name what words mean.
pub(super) fn with_partners(shader: Shader, stack_words: u32) -> Shader {
    shader
        .with_constant("CLIP_LEAVES", CLIP_LEAVES as u32)
        .with_constant("CLIP_PAPER", CLIP_PAPER as u32)
        .with_constant("CLIP_SIDES", CLIP_SIDES as u32)
        .with_constant("CLIP_LISTS", CLIP_LISTS as u32)
        .with_constant("CLIP_DISKS", CLIP_DISKS as u32)
        .with_constant("CLIP_LEAF_STRIDE", LEAF_STRIDE as u32)
        .with_constant("CLIP_CHUNK_STRIDE", CHUNK_STRIDE as u32)
        .with_constant("NODE_STRIDE", NODE_STRIDE as u32)
        .with_constant("NODE_AND", NODE_AND)
        .with_constant("ROWS_A_DISK", ROWS_A_DISK as u32)
        .with_constant("LONGEST_WALK", LONGEST_WALK as u32)
        .with_constant("STACK_WORDS", stack_words)
        .with_constant("INSIDE_NEAREST", word_of(Inside::Nearest))
        .with_constant("INSIDE_TWO_NEAREST", word_of(Inside::TwoNearest))
        .with_constant("INSIDE_ANY_PLANE", word_of(Inside::AnyPlane))
        .with_constant("INSIDE_BLEND", word_of(Inside::Blend))
        .with_text(include_str!("../../../shaders/splat/inside.wgsl"))
        .with_text(include_str!("../../../shaders/splat/paper.wgsl"))
        .with_text(include_str!("../../../shaders/splat/clip.wgsl"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::csg::expression::parse;

    #[test]
    fn a_stack_is_as_deep_as_right_operands_are_nested() {
        let words = |text: &str| {
            let letters = |name: &str| Some(LeafId(u32::from(name.as_bytes()[0] - b'a')));
            stack_words(&PaperTree::from(&parse(text, &mut { letters }).unwrap().positive()))
        };
        assert_eq!(words("a"), 1);
        assert_eq!(words("a | b | c"), 1);
        let nested = |depth: usize| "a | (b & (".repeat(depth) + "c" + &"))".repeat(depth);
        assert_eq!((words(&nested(16)), words(&nested(17))), (1, 2));
    }

    #[test]
    fn disks_are_counted_chunk_by_chunk() {
        let mut words = vec![7];
        let last = CHUNK as u32 - 1;
        chunks(&[0, 5, last, last + 2], 10, 2, &mut words);
        let of_chunk = |chunk: usize| &words[1 + chunk * CHUNK_STRIDE..][..CHUNK_STRIDE];
        assert_eq!((of_chunk(0)[0], of_chunk(0)[1]), (10, 0b10_0001));
        assert_eq!((of_chunk(1)[0], of_chunk(1)[1]), (13, 0b10));
    }
}
