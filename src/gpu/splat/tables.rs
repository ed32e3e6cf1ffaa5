//! The expression as kernels read it: one array of words.
//!
//! ```text
//! header │ leaves │ uncomplemented leaves │ Blist │ pairs of leaves ─► chunks ─► surfels │ residuals
//! ```
//!
//! A *status* is a word: a [`Membership`] where it holds for all that the word stands for, else three more than the place of the
//! words for its parts.

use crate::classify::pairs::{PairStatus, TouchRef};
use crate::classify::{Drawn, Model};
use crate::csg::LeafId;
use crate::csg::blist::{Blist, Jump};
use crate::csg::residual::{Crossing, EdgeResidual, Membership, Rule};
use crate::gpu::crossings::LEAVES_A_WORD;
use crate::gpu::shader::Shader;
use crate::scene::LeafKind;
use crate::surfel::CHUNK;

use super::far::{Far, Way};

/// Words of the header: where the parts begin, how many leaves occur uncomplemented, and how many entries the Blist has.
const HEADER: usize = 6;
const AT_LEAVES: usize = 0;
const AT_POSITIVE: usize = 1;
const POSITIVE_COUNT: usize = 2;
const AT_LIST: usize = 3;
const AT_PAIRS: usize = 4;
const LIST_LENGTH: usize = 5;

/// Bits of a leaf's first word: it holds no point; crossings tell of it, not surfels.
const LEAF_SHEET: u32 = 1;
const LEAF_EXACT: u32 = 2;

/// Words of a leaf: bits, what tells its far sides, and the largest radius of its surfels.
const LEAF_STRIDE: usize = 8;
const LEAF_RADIUS: u32 = 7;

/// Words of a Blist's entry: leaf, whether complemented, where to go on inside and outside.
const ENTRY_STRIDE: u32 = 4;

/// A jump to the result.
const JUMP_IN: u32 = u32::MAX - 1;
const JUMP_OUT: u32 = u32::MAX;

/// The surfel's own leaf in a residual's list.
const OWN_LEAF: u32 = u32::MAX;

/// Statuses of a chunk's surfels: two bits each.
const STATUS_BITS: u32 = 2;

/// The first place that parts of a status have, so that it differs from every [`Membership`].
const FIRST_PART: u32 = 3;

/// Leaves that one word of a set has bits for.
pub(super) const LEAF_BITS: u32 = LEAVES_A_WORD;

/// Words of a set of leaves.
pub(super) fn leaf_words(leaves: usize) -> u32 {
    (leaves as u32).div_ceil(LEAF_BITS).max(1)
}

/// Words of a set of a Blist's entries.
pub(super) fn list_words(entries: usize) -> u32 {
    (entries as u32).div_ceil(u32::BITS).max(1)
}

/// What a surfel is drawn as: one of the constants, or where its residual begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Kind(pub u32);

impl Kind {
    /// Not at all, but others may ask it.
    const OFF: Self = Self(0);
    /// Whole, entering the result with the leaf.
    const RISES: Self = Self(1);
    /// Whole, leaving the result with the leaf.
    const FALLS: Self = Self(2);
    /// Nobody needs it.
    const UNNEEDED: Self = Self(u32::MAX);
}

// Residuals begin behind the header.
const _: () = assert!(HEADER > Kind::FALLS.0 as usize);

fn word_of(status: Membership) -> u32 {
    match status {
        Membership::In => 0,
        Membership::Out => 1,
        Membership::Near => 2,
    }
}

/// All words.
#[derive(Debug, Default)]
pub(super) struct Tables {
    pub words: Vec<u32>,
    /// By leaf and residual: where it begins.
    residuals: Vec<Vec<u32>>,
}

impl Tables {
    /// Of `model`, with the places in `far`.
    pub fn of(model: &Model, far: &Far) -> Self {
        let mut tables = Self { words: vec![0; HEADER], residuals: Vec::new() };
        tables.words[AT_LEAVES] = tables.end();
        for (field, far) in model.fields.iter().zip(&far.leaves) {
            let sheet = if field.kind == LeafKind::Sheet { LEAF_SHEET } else { 0 };
            let kind = sheet | if field.exact.is_some() { LEAF_EXACT } else { 0 };
            let threshold = far.threshold.to_bits();
            let radius = field.largest_radius().min(f32::MAX).to_bits();
            let words = [kind, far.way as u32, far.nodes, far.runs, far.elements, far.count, threshold, radius];
            tables.words.extend::<[u32; LEAF_STRIDE]>(words);
        }
        tables.words[AT_POSITIVE] = tables.end();
        tables.words[POSITIVE_COUNT] = model.positive_leaves().len() as u32;
        tables.words.extend(model.positive_leaves().iter().map(|leaf| leaf.0));
        tables.words[AT_LIST] = tables.end();
        tables.words[LIST_LENGTH] = model.list.entries().len() as u32;
        tables.list(&model.list, |leaf| leaf.0);
        tables.pairs(model);
        for classes in &model.classes {
            let places = classes.residuals.iter().map(|residual| tables.residual(residual)).collect();
            tables.residuals.push(places);
        }
        tables
    }

    fn end(&self) -> u32 {
        self.words.len() as u32
    }

    fn list(&mut self, list: &Blist, name: impl Fn(LeafId) -> u32) {
        let jump = |jump| match jump {
            Jump::Entry(entry) => entry,
            Jump::In => JUMP_IN,
            Jump::Out => JUMP_OUT,
        };
        for entry in list.entries() {
            let words = [name(entry.leaf()), u32::from(entry.literal.negated), jump(entry.if_in), jump(entry.if_out)];
            self.words.extend::<[u32; ENTRY_STRIDE as usize]>(words);
        }
    }

    /// Statuses by pair, chunk and surfel.
    fn pairs(&mut self, model: &Model) {
        let leaves = model.fields.len();
        let at = self.words.len();
        self.words[AT_PAIRS] = at as u32;
        self.words.resize(at + leaves * leaves, word_of(Membership::Near));
        for a in 0..leaves {
            for b in 0..leaves {
                let Some(status) = model.pair(LeafId(a as u32), LeafId(b as u32)) else { continue };
                self.words[at + a * leaves + b] = match status {
                    PairStatus::Whole(status) => word_of(*status),
                    PairStatus::Chunks(chunks) => {
                        let first = self.words.len();
                        self.words.resize(first + chunks.len(), 0);
                        for chunk in 0..chunks.len() {
                            self.words[first + chunk] = self.chunk(status.chunk(chunk));
                        }
                        FIRST_PART + first as u32
                    }
                };
            }
        }
    }

    fn chunk(&mut self, status: TouchRef<'_>) -> u32 {
        let each = match status {
            TouchRef::Apart(status) => return word_of(status),
            TouchRef::Surfels(each) => each,
        };
        let first = self.words.len();
        let a_word = (u32::BITS / STATUS_BITS) as usize;
        self.words.resize(first + CHUNK / a_word, 0);
        for (index, status) in each.iter().enumerate() {
            self.words[first + index / a_word] |= word_of(*status) << (STATUS_BITS * (index % a_word) as u32);
        }
        FIRST_PART + first as u32
    }

    /// Appends a residual: how many leaves are near, which, whether a list follows or two truth tables, and that.
    fn residual(&mut self, residual: &EdgeResidual) -> u32 {
        let place = self.end();
        self.words.push(residual.near.len() as u32);
        self.words.extend(residual.near.iter().map(|leaf| leaf.0));
        match &residual.rule {
            Rule::Table { rises, falls } => {
                let halves = |table: u64| [table as u32, (table >> u32::BITS) as u32];
                self.words.push(0);
                self.words.extend(halves(*rises));
                self.words.extend(halves(*falls));
            }
            Rule::Walk { list, last_own } => {
                self.words.push(1);
                self.words.push(*last_own);
                self.list(list, |place| residual.near.get(place.0 as usize).map_or(OWN_LEAF, |leaf| leaf.0));
            }
        }
        place
    }

    /// What surfel `index` of `leaf` is drawn as.
    pub fn kind(&self, model: &Model, leaf: LeafId, index: usize) -> Kind {
        let class = model.classes[leaf.0 as usize].classes[index];
        match class.drawn() {
            _ if !class.is_needed() => Kind::UNNEEDED,
            None => Kind::OFF,
            Some(Drawn::Surface(Crossing::Rises)) => Kind::RISES,
            Some(Drawn::Surface(Crossing::Falls)) => Kind::FALLS,
            Some(Drawn::Edge(number)) => Kind(self.residuals[leaf.0 as usize][number as usize]),
        }
    }
}

/// The constants that name what words mean.
pub(super) fn with_constants(shader: Shader) -> Shader {
    shader
        .with_constant("AT_LEAVES", AT_LEAVES as u32)
        .with_constant("AT_POSITIVE", AT_POSITIVE as u32)
        .with_constant("POSITIVE_COUNT", POSITIVE_COUNT as u32)
        .with_constant("AT_LIST", AT_LIST as u32)
        .with_constant("AT_PAIRS", AT_PAIRS as u32)
        .with_constant("LIST_LENGTH", LIST_LENGTH as u32)
        .with_constant("LEAF_SHEET", LEAF_SHEET)
        .with_constant("LEAF_EXACT", LEAF_EXACT)
        .with_constant("LEAF_STRIDE", LEAF_STRIDE as u32)
        .with_constant("LEAF_RADIUS", LEAF_RADIUS)
        .with_constant("LEAF_BITS", LEAF_BITS)
        .with_constant("ENTRY_STRIDE", ENTRY_STRIDE)
        .with_constant("JUMP_IN", JUMP_IN)
        .with_constant("JUMP_OUT", JUMP_OUT)
        .with_constant("OWN_LEAF", OWN_LEAF)
        .with_constant("STATUS_BITS", STATUS_BITS)
        .with_constant("FIRST_PART", FIRST_PART)
        .with_constant("STATUS_IN", word_of(Membership::In))
        .with_constant("STATUS_OUT", word_of(Membership::Out))
        .with_constant("STATUS_NEAR", word_of(Membership::Near))
        .with_constant("FAR_WINDING", Way::Winding as u32)
        .with_constant("FAR_PLANE", Way::Plane as u32)
}

/// The constants that name kinds.
pub(super) fn with_kinds(shader: Shader) -> Shader {
    shader
        .with_constant("KIND_OFF", Kind::OFF.0)
        .with_constant("KIND_RISES", Kind::RISES.0)
        .with_constant("KIND_FALLS", Kind::FALLS.0)
        .with_constant("KIND_UNNEEDED", Kind::UNNEEDED.0)
        .with_constant("CHUNK", CHUNK as u32)
}
