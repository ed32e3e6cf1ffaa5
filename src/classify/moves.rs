//! Leaves that move between frames: what lies to each other as before is not classified again.
//!
//! *Practice.* A pose is a motion for each leaf, from where the scene has it. A pair of leaves that one motion moves lies as in
//! the scene's own pose, so the status found there holds; every other pair that changed is decided anew. What is kept of the
//! own pose is kept for the leaves that move alone. A pose does not depend on the poses before it: frames can be drawn in any
//! order, and a run that was stopped can go on.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::pairs::PairStatus;
use super::{LeafClasses, LeafField, Model, next_state};
use crate::csg::LeafId;
use crate::space::Motion;

/// The own pose of what moves.
#[derive(Debug, Default)]
pub(super) struct Pose {
    /// By leaf that has moved.
    motions: BTreeMap<usize, Motion>,
    /// By leaf that has moved.
    fields_at_rest: BTreeMap<usize, Arc<LeafField>>,
    /// By pair of leaves that have lain otherwise to each other.
    statuses_at_rest: BTreeMap<(usize, usize), Option<PairStatus>>,
}

impl Pose {
    fn motion(&self, leaf: usize) -> Motion {
        self.motions.get(&leaf).copied().unwrap_or(Motion::REST)
    }

    /// Whether a pair lies as in the own pose.
    fn is_at_rest(&self, a: usize, b: usize) -> bool {
        self.motion(a) == self.motion(b)
    }
}

impl Model {
    /// Brings the leaves to the pose `motions`, each from where the model was made with it; leaves without a motion go back
    /// there. Returns the leaves that were classified again, in order. Not to be mixed with [`move_leaf`](Self::move_leaf).
    pub fn pose(&mut self, motions: &[(LeafId, Motion)]) -> Vec<LeafId> {
        let leaves = self.fields.len();
        let wanted: BTreeMap<usize, Motion> =
            motions.iter().filter(|(_, m)| *m != Motion::REST).map(|(leaf, m)| (leaf.0 as usize, *m)).collect();
        let next = |leaf: usize| wanted.get(&leaf).copied().unwrap_or(Motion::REST);
        let moved: Vec<usize> = (0..leaves).filter(|&leaf| next(leaf) != self.pose.motion(leaf)).collect();
        if moved.is_empty() {
            return Vec::new();
        }
        for &leaf in &moved {
            let motion = next(leaf);
            let at_rest = self.pose.fields_at_rest.remove(&leaf);
            if motion == Motion::REST {
                // It was elsewhere, so its own field was kept.
                if let Some(field) = at_rest {
                    self.fields[leaf] = field;
                }
                continue;
            }
            let field = at_rest.as_ref().unwrap_or(&self.fields[leaf]).moved(&motion);
            let before = std::mem::replace(&mut self.fields[leaf], Arc::new(field));
            self.pose.fields_at_rest.insert(leaf, at_rest.unwrap_or(before));
        }
        let by_leaf: Vec<&LeafField> = self.fields.iter().map(Arc::as_ref).collect();
        let statuses = Arc::make_mut(&mut self.statuses);
        let mut again = vec![false; leaves];
        for a in 0..leaves {
            for b in (0..leaves).filter(|&b| b != a) {
                let has_moved = next(a) != self.pose.motion(a) || next(b) != self.pose.motion(b);
                let (was_at_rest, is_at_rest) = (self.pose.is_at_rest(a, b), next(a) == next(b));
                if !has_moved || (was_at_rest && is_at_rest) {
                    continue;
                }
                let status = match self.pose.statuses_at_rest.remove(&(a, b)) {
                    Some(at_rest) if is_at_rest => at_rest,
                    at_rest => {
                        let kept = at_rest.unwrap_or_else(|| statuses[a][b].clone());
                        self.pose.statuses_at_rest.insert((a, b), kept);
                        Some(PairStatus::of(by_leaf[a], by_leaf[b]))
                    }
                };
                // Even with equal statuses a surface may have slid along within "near", where inside-edge and outside-edge
                // are told apart by the centre: classes are kept only where nothing is near.
                again[a] |= !(statuses[a][b] == status && matches!(status, Some(PairStatus::Whole(_))));
                statuses[a][b] = status;
            }
        }
        let again: Vec<LeafId> = (0..leaves).filter(|&leaf| again[leaf]).map(|leaf| LeafId(leaf as u32)).collect();
        for &leaf in &again {
            let a = leaf.0 as usize;
            self.classes[a] = LeafClasses::of(&self.tree, leaf, &by_leaf, &statuses[a]);
        }
        self.pose.motions = wanted;
        self.state = next_state();
        again
    }

    /// Whether a surfel of leaf `a` may be near leaf `b`.
    pub(super) fn may_be_near(&self, a: LeafId, b: LeafId) -> bool {
        !matches!(self.statuses[a.0 as usize][b.0 as usize], Some(PairStatus::Whole(_)))
    }
}
