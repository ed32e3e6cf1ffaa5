//! Clipping partners: for every edge surfel, the surfels of other leaves that may clip it.
//!
//! # Theory
//! Wicke 2004 §3.2: two surfels of different patches are close enough to clip where their centres are nearer than the sum
//! of their radii. The paper's partners are edge surfels, which fails where sampling densities differ, since "edge" is
//! decided by a surfel's own radius and partnership by the sum of two: a coarse edge surfel beside fine *surface* surfels
//! finds none. So partners may also be all surfels of the leaves that classification calls near, those off the result
//! included.
//!
//! # Changes from the paper
//! The paper finds partners in the picture ([`clip_buffer`](crate::splat::clip_buffer)). [`PartnerLists::in_space`] finds
//! them in space: independent of the view, so kept from frame to frame.
//!
//! # Practice
//! Lists are compressed rows, ordered by leaf and then by index, without repetition and without a longest length. A leaf
//! that is represented as itself is asked exactly and lends no partners, nor does a sheet, which never cuts.

use rayon::prelude::*;

use super::{Drawn, Model};
use crate::csg::LeafId;

/// Which surfels may be partners.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Among {
    /// Edge surfels of all other leaves: the paper's rule.
    EdgeSurfels,
    /// All surfels of the leaves that are near the surfel.
    NearLeaves,
}

/// A surfel of the scene; ordered by leaf, then index.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SurfelId {
    /// Whose.
    pub leaf: LeafId,
    /// Its index in its leaf.
    pub index: u32,
}

/// The partners of every edge surfel of a scene.
#[derive(Debug, Clone)]
pub struct PartnerLists {
    /// Whose rule the lists follow.
    among: Among,
    by_leaf: Vec<OfLeaf>,
    /// The [state](Model::state) of the model that they were found for; `None` where they were given.
    state: Option<u64>,
}

/// Equal lists, whatever model they were found for.
impl PartialEq for PartnerLists {
    fn eq(&self, other: &Self) -> bool {
        (self.among, &self.by_leaf) == (other.among, &other.by_leaf)
    }
}

/// One leaf's lists.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
struct OfLeaf {
    /// The edge surfels that have partners, ascending.
    surfels: Vec<u32>,
    /// Where each one's partners start; one more than there are surfels.
    starts: Vec<usize>,
    partners: Vec<SurfelId>,
}

impl OfLeaf {
    fn push(&mut self, surfel: u32, partners: &[SurfelId]) {
        if !partners.is_empty() {
            self.surfels.push(surfel);
            self.starts.push(self.partners.len());
            self.partners.extend_from_slice(partners);
        }
    }

    fn of(&self, surfel: u32) -> &[SurfelId] {
        match self.surfels.binary_search(&surfel) {
            Ok(place) => {
                let end = self.starts.get(place + 1).copied().unwrap_or(self.partners.len());
                &self.partners[self.starts[place]..end]
            }
            Err(_) => &[],
        }
    }
}

impl PartnerLists {
    /// Searches space for the partners of every edge surfel of `model`. The same lists on any number of threads.
    pub fn in_space(model: &Model, among: Among) -> Self {
        let by_leaf = (0..model.fields.len()).map(|leaf| search_leaf(model, LeafId(leaf as u32), among)).collect();
        Self { among, by_leaf, state: Some(model.state()) }
    }

    /// The lists of `model` after its leaves moved, where these are those of before and `again` are the leaves that were
    /// classified again: only lists that may have changed are searched for.
    pub fn after_pose(mut self, model: &Model, again: &[LeafId]) -> Self {
        let by_leaf = (0..model.fields.len()).map(|index| {
            let leaf = LeafId(index as u32);
            let is_near = |&other: &LeafId| other == leaf || model.may_be_near(leaf, other);
            let may_differ = again.iter().any(is_near);
            if may_differ { search_leaf(model, leaf, self.among) } else { std::mem::take(&mut self.by_leaf[index]) }
        });
        let by_leaf = by_leaf.collect();
        Self { among: self.among, by_leaf, state: Some(model.state()) }
    }

    /// From pairs (edge surfel, partner) in any order and repeated at will, which the caller has found to be partners by
    /// the rule `among`, over `leaves` leaves.
    pub fn from_pairs(among: Among, leaves: usize, mut pairs: Vec<(SurfelId, SurfelId)>) -> Self {
        pairs.par_sort_unstable();
        pairs.dedup();
        let mut by_leaf = vec![OfLeaf::default(); leaves];
        let mut partners = Vec::new();
        for of_surfel in pairs.chunk_by(|a, b| a.0 == b.0) {
            partners.clear();
            partners.extend(of_surfel.iter().map(|pair| pair.1));
            let surfel = of_surfel[0].0;
            by_leaf[surfel.leaf.0 as usize].push(surfel.index, &partners);
        }
        Self { among, by_leaf, state: None }
    }

    /// Whether they are those of `model` as it is now, under the rule `among`: a leaf that moves makes lists useless.
    pub fn serve(&self, model: &Model, among: Among) -> bool {
        self.among == among && self.state.is_none_or(|state| state == model.state())
    }

    /// The rule that the lists follow.
    pub fn among(&self) -> Among {
        self.among
    }

    /// The partners of a surfel, by leaf, then index; none where it is no edge surfel.
    pub fn of(&self, surfel: SurfelId) -> &[SurfelId] {
        self.by_leaf[surfel.leaf.0 as usize].of(surfel.index)
    }

    /// How many partners all surfels have together.
    pub fn len(&self) -> usize {
        self.by_leaf.iter().map(|l| l.partners.len()).sum()
    }

    /// Whether no surfel has a partner.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// All pairs (edge surfel, partner), in order.
    pub fn pairs(&self) -> impl Iterator<Item = (SurfelId, SurfelId)> + '_ {
        self.by_leaf.iter().enumerate().flat_map(|(leaf, of_leaf)| {
            of_leaf.surfels.iter().flat_map(move |&index| {
                let surfel = SurfelId { leaf: LeafId(leaf as u32), index };
                of_leaf.of(index).iter().map(move |&partner| (surfel, partner))
            })
        })
    }
}

/// Whether surfel `s` accepts `t` as a partner, distance apart: `s` is an edge surfel and `t` one that the rule admits.
pub fn admits(model: &Model, among: Among, s: SurfelId, t: SurfelId) -> bool {
    if s.leaf == t.leaf || !model.fields[t.leaf.0 as usize].lends_surfels() {
        return false;
    }
    let of_leaf = &model.classes[s.leaf.0 as usize];
    let Some(Drawn::Edge(residual)) = of_leaf.classes[s.index as usize].drawn() else { return false };
    match among {
        Among::EdgeSurfels => model.classes[t.leaf.0 as usize].classes[t.index as usize].is_edge(),
        Among::NearLeaves => of_leaf.residuals[residual as usize].near.binary_search(&t.leaf).is_ok(),
    }
}

fn search_leaf(model: &Model, own: LeafId, among: Among) -> OfLeaf {
    const SURFELS_A_TASK: usize = 1024;
    let classes = &model.classes[own.0 as usize];
    let edges: Vec<u32> =
        (0..classes.classes.len() as u32).filter(|&i| classes.classes[i as usize].is_edge()).collect();
    let lending: Vec<LeafId> = (0..model.fields.len())
        .filter(|&b| b != own.0 as usize && model.fields[b].lends_surfels())
        .map(|b| LeafId(b as u32))
        .collect();
    let found: Vec<OfLeaf> = edges
        .par_chunks(SURFELS_A_TASK)
        .map(|task| {
            let mut lists = OfLeaf::default();
            let mut partners = Vec::new();
            let mut scratch = Vec::new();
            for &index in task {
                partners.clear();
                let s = SurfelId { leaf: own, index };
                match among {
                    Among::EdgeSurfels => {
                        for &leaf in &lending {
                            search_one(model, among, s, leaf, &mut scratch, &mut partners);
                        }
                    }
                    Among::NearLeaves => {
                        let Some(Drawn::Edge(residual)) = classes.classes[index as usize].drawn() else { continue };
                        for &leaf in &classes.residuals[residual as usize].near {
                            search_one(model, among, s, leaf, &mut scratch, &mut partners);
                        }
                    }
                }
                lists.push(index, &partners);
            }
            lists
        })
        .collect();
    let mut joined = OfLeaf::default();
    for lists in &found {
        let before = joined.partners.len();
        joined.surfels.extend_from_slice(&lists.surfels);
        joined.starts.extend(lists.starts.iter().map(|start| before + start));
        joined.partners.extend_from_slice(&lists.partners);
    }
    joined
}

/// Appends the partners of `s` among the surfels of `leaf`, ascending.
fn search_one(
    model: &Model,
    among: Among,
    s: SurfelId,
    leaf: LeafId,
    scratch: &mut Vec<(u32, f32)>,
    partners: &mut Vec<SurfelId>,
) {
    let own = &model.fields[s.leaf.0 as usize].cloud;
    let radius = own.surfels[s.index as usize].radius;
    let other = &model.fields[leaf.0 as usize];
    other.touching(own.centre(s.index as usize), f64::from(radius), scratch);
    let first = partners.len();
    for &(index, distance) in scratch.iter() {
        let t = SurfelId { leaf, index };
        if distance < radius + other.cloud.surfels[index as usize].radius && admits(model, among, s, t) {
            partners.push(t);
        }
    }
    partners[first..].sort_unstable();
}
