//! Which surfels the result keeps, drops or clips, and against what.
//!
//! [`Model`] is the scene after this stage: every leaf's field, how the surfels of each leaf lie to each other leaf
//! ([`pairs`]) and the class of every surfel ([`classes`]). It does not depend on the view, and moving one leaf redoes only
//! the pairs of that leaf.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::csg::positive::Positive;
use crate::csg::{Blist, LeafId, Tree};

pub mod classes;
pub mod field;
pub mod inside;
mod moves;
pub mod pairs;
pub mod partners;

pub use classes::{Class, ClassCounts, Drawn, LeafClasses, Wicke};
pub use field::LeafField;
use pairs::PairStatus;

/// How a leaf is drawn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LeafLook {
    /// Linear RGB; `None` takes the surfels' own colours.
    pub colour: Option<[f32; 3]>,
    /// 0 to 1; multiplies the surfels' own.
    pub opacity: f32,
}

/// A classified scene.
#[derive(Debug)]
pub struct Model {
    /// The expression over the leaves, positive form.
    pub tree: Positive,
    /// The same as a list, which asks for no more leaves than it needs.
    pub list: Blist,
    /// By leaf; shared with the models of other expressions over the same leaves.
    pub fields: Vec<Arc<LeafField>>,
    /// By leaf.
    pub looks: Vec<LeafLook>,
    /// By leaf.
    pub classes: Vec<LeafClasses>,
    /// `statuses[a][b]`: how the surfels of a lie to b. They do not depend on the expression.
    statuses: Arc<Vec<Vec<Option<PairStatus>>>>,
    positive_leaves: Vec<LeafId>,
    state: u64,
    pose: moves::Pose,
}

/// A number that no other state of any model has.
fn next_state() -> u64 {
    static NEXT: AtomicU64 = AtomicU64::new(0);
    NEXT.fetch_add(1, Ordering::Relaxed)
}

impl Model {
    /// Classifies the surfels of all leaves against `tree`.
    pub fn new(tree: &Tree, fields: Vec<LeafField>, looks: Vec<LeafLook>) -> Self {
        let by_leaf: Vec<&LeafField> = fields.iter().collect();
        let statuses = pairs::all_pairs(&by_leaf);
        Self::over(tree, fields.into_iter().map(Arc::new).collect(), looks, Arc::new(statuses))
    }

    /// The same leaves, as they are now, under another expression: what does not depend on it is shared.
    pub fn with_tree(&self, tree: &Tree) -> Self {
        Self::over(tree, self.fields.clone(), self.looks.clone(), Arc::clone(&self.statuses))
    }

    fn over(
        tree: &Tree,
        fields: Vec<Arc<LeafField>>,
        looks: Vec<LeafLook>,
        statuses: Arc<Vec<Vec<Option<PairStatus>>>>,
    ) -> Self {
        let tree = tree.positive();
        let by_leaf: Vec<&LeafField> = fields.iter().map(Arc::as_ref).collect();
        let classes =
            (0..fields.len()).map(|a| LeafClasses::of(&tree, LeafId(a as u32), &by_leaf, &statuses[a])).collect();
        let mut positive_leaves: Vec<LeafId> = tree.literals().filter(|l| !l.negated).map(|l| l.leaf).collect();
        positive_leaves.sort_unstable();
        positive_leaves.dedup();
        let pose = moves::Pose::default();
        let list = tree.blist();
        Self { tree, list, fields, looks, classes, statuses, positive_leaves, state: next_state(), pose }
    }

    /// The leaves that occur uncomplemented in the positive form: those whose material the result is made of.
    pub fn positive_leaves(&self) -> &[LeafId] {
        &self.positive_leaves
    }

    /// Which state of which model this is: it changes whenever a leaf moves, so that what was found for another is known.
    pub fn state(&self) -> u64 {
        self.state
    }

    /// Replaces leaf `moved` and classifies again what that touches: its own surfels, and those of the leaves whose
    /// status towards it changed. Returns how many leaves were classified again.
    pub fn move_leaf(&mut self, moved: LeafId, field: LeafField) -> usize {
        let m = moved.0 as usize;
        self.fields[m] = Arc::new(field);
        self.state = next_state();
        let by_leaf: Vec<&LeafField> = self.fields.iter().map(Arc::as_ref).collect();
        let statuses = Arc::make_mut(&mut self.statuses);
        let mut again = vec![m];
        for other in (0..by_leaf.len()).filter(|&o| o != m) {
            statuses[m][other] = Some(PairStatus::of(by_leaf[m], by_leaf[other]));
            let status = Some(PairStatus::of(by_leaf[other], by_leaf[m]));
            // Even with equal statuses the moved surface may have slid along within "near", where inside-edge and
            // outside-edge are told apart by the centre: keep the classes only where nothing is near.
            let untouched = statuses[other][m] == status && matches!(status, Some(PairStatus::Whole(_)));
            statuses[other][m] = status;
            if !untouched {
                again.push(other);
            }
        }
        for &a in &again {
            self.classes[a] = LeafClasses::of(&self.tree, LeafId(a as u32), &by_leaf, &statuses[a]);
        }
        again.len()
    }

    /// How the surfels of leaf `a` lie to leaf `b`; `None` where they are one leaf.
    #[cfg(feature = "gpu")]
    pub(crate) fn pair(&self, a: LeafId, b: LeafId) -> Option<&PairStatus> {
        self.statuses[a.0 as usize][b.0 as usize].as_ref()
    }

    /// How surfel `index` of leaf `a` lies to leaf `b`, as classification decided it.
    pub fn status(&self, a: LeafId, index: usize, b: LeafId) -> crate::csg::residual::Membership {
        use crate::csg::residual::Membership;
        match &self.statuses[a.0 as usize][b.0 as usize] {
            None => Membership::Near,
            Some(status) => match status.chunk(index / crate::surfel::CHUNK) {
                pairs::TouchRef::Apart(m) => m,
                pairs::TouchRef::Surfels(each) => each[index % crate::surfel::CHUNK],
            },
        }
    }

    /// Surfels by class, over all leaves.
    pub fn counts(&self) -> ClassCounts {
        self.classes.iter().map(LeafClasses::counts).fold(ClassCounts::default(), |a, b| ClassCounts {
            surface: a.surface + b.surface,
            inside_edge: a.inside_edge + b.inside_edge,
            outside_edge: a.outside_edge + b.outside_edge,
            outside: a.outside + b.outside,
        })
    }
}
