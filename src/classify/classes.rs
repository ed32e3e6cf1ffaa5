//! Wicke's four classes for every surfel, with the residual expression of each edge surfel.
//!
//! # Theory
//! Wicke 2004 §3.1.2: *surface* surfels lie on the result, *outside* surfels do not, and *inside-* and *outside-edge*
//! surfels may be clipped. The tree is evaluated with the three values in, out and near (Kleene's logic); a surfel whose
//! class is decided on the boundary is a surface surfel, decided off is dropped, and an undecided one keeps the
//! *residual*: the expression over its near leaves alone, with every decided leaf a constant.
//!
//! # Changes from the paper
//! Classification is against the whole tree at once, not operator by operator, and a dropped surfel is kept as *support*
//! where another leaf's surfels may reach it: it is still a clipping partner under the resolved rule ([`super::partners`]).
//!
//! # Practice
//! Residuals are interned: surfels of one leaf with the same near leaves and truth table share one. The classes of a
//! chunk depend only on its own row of pair statuses, which is what makes moving a leaf cheap.

use std::collections::HashMap;

use rayon::prelude::*;

use super::field::LeafField;
use super::pairs::{PairStatus, TouchRef};
use crate::csg::LeafId;
use crate::csg::positive::Positive;
use crate::csg::residual::{Crossing, EdgeResidual, Membership, Residual};
use crate::surfel::CHUNK;

/// What becomes of one surfel: a small number so that a million of them stay a few megabytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Class(u32);

impl Class {
    const OFF: u32 = 0;
    const RISES: u32 = 1;
    const FALLS: u32 = 2;
    const FIRST_EDGE: u32 = 3;
    /// Another leaf may ask this surfel for its side: it is a clipping partner.
    const PARTNER: u32 = 1 << 31;
    /// An edge surfel whose centre is on the result: Wicke's inside-edge.
    const INSIDE: u32 = 1 << 30;
    const KIND: u32 = !(Self::PARTNER | Self::INSIDE);

    /// What the surfel is drawn as; `None` where it is not drawn.
    #[inline]
    pub fn drawn(self) -> Option<Drawn> {
        match self.0 & Self::KIND {
            Self::OFF => None,
            Self::RISES => Some(Drawn::Surface(Crossing::Rises)),
            Self::FALLS => Some(Drawn::Surface(Crossing::Falls)),
            edge => Some(Drawn::Edge(edge - Self::FIRST_EDGE)),
        }
    }

    /// Whether other leaves may need it, drawn or not.
    #[inline]
    pub fn is_partner(self) -> bool {
        self.0 & Self::PARTNER != 0
    }

    /// Whether a frame has to look at it at all.
    #[inline]
    pub fn is_needed(self) -> bool {
        self.0 & !Self::INSIDE != Self::OFF
    }

    /// Whether it is an edge surfel.
    #[inline]
    pub fn is_edge(self) -> bool {
        self.0 & Self::KIND >= Self::FIRST_EDGE
    }

    /// Wicke's name for it.
    pub fn wicke(self) -> Wicke {
        match self.drawn() {
            None => Wicke::Outside,
            Some(Drawn::Surface(_)) => Wicke::Surface,
            Some(Drawn::Edge(_)) if self.0 & Self::INSIDE != 0 => Wicke::InsideEdge,
            Some(Drawn::Edge(_)) => Wicke::OutsideEdge,
        }
    }
}

/// How a surfel is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Drawn {
    /// Whole; its surface crosses the result this way everywhere.
    Surface(Crossing),
    /// Clipped by the residual with this index.
    Edge(u32),
}

/// The four classes of Wicke 2004 §3.1.2.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Wicke {
    /// On the result, out of reach of other surfaces.
    Surface,
    /// Its centre is on the result.
    InsideEdge,
    /// Its centre is not, but part of it may be.
    OutsideEdge,
    /// Off the result.
    Outside,
}

/// How many surfels of a scene are in each class.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ClassCounts {
    /// [`Wicke::Surface`].
    pub surface: usize,
    /// [`Wicke::InsideEdge`].
    pub inside_edge: usize,
    /// [`Wicke::OutsideEdge`].
    pub outside_edge: usize,
    /// [`Wicke::Outside`].
    pub outside: usize,
}

impl ClassCounts {
    /// Both kinds of edge surfel.
    pub fn edge(&self) -> usize {
        self.inside_edge + self.outside_edge
    }
}

/// The classes of one leaf's surfels.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct LeafClasses {
    /// One for each surfel, in the leaf's order.
    pub classes: Vec<Class>,
    /// The residuals of its edge surfels, by [`Drawn::Edge`] index.
    pub residuals: Vec<EdgeResidual>,
}

impl LeafClasses {
    /// Classifies leaf `own` from its row of pair statuses (`row[b]` is `None` for `own` itself).
    pub fn of(tree: &Positive, own: LeafId, fields: &[&LeafField], row: &[Option<PairStatus>]) -> Self {
        let chunk_count = fields[own.0 as usize].cloud.chunks.len();
        let surfels = fields[own.0 as usize].cloud.len();
        let by_chunk: Vec<Vec<Local>> = (0..chunk_count)
            .into_par_iter()
            .with_min_len(16)
            .map(|chunk| {
                let members = CHUNK.min(surfels - chunk * CHUNK);
                classify_chunk(tree, own, fields, row, chunk, members)
            })
            .collect();
        // Intern in surfel order, so that numbers do not depend on threads.
        let mut result = Self { classes: Vec::with_capacity(surfels), residuals: Vec::new() };
        let mut numbers: HashMap<EdgeResidual, u32> = HashMap::new();
        for locals in by_chunk {
            for local in locals {
                match local {
                    Local::Run(class, count) => result.classes.extend(std::iter::repeat_n(class, count)),
                    Local::Edge(residual, flags) => {
                        let next = result.residuals.len() as u32;
                        let number = *numbers.entry(*residual).or_insert_with_key(|r| {
                            result.residuals.push(r.clone());
                            next
                        });
                        result.classes.push(Class((Class::FIRST_EDGE + number) | flags));
                    }
                }
            }
        }
        result
    }

    /// How many surfels are in each class.
    pub fn counts(&self) -> ClassCounts {
        let mut counts = ClassCounts::default();
        for class in &self.classes {
            match class.wicke() {
                Wicke::Surface => counts.surface += 1,
                Wicke::InsideEdge => counts.inside_edge += 1,
                Wicke::OutsideEdge => counts.outside_edge += 1,
                Wicke::Outside => counts.outside += 1,
            }
        }
        counts
    }
}

/// A chunk's classes before residuals have numbers.
enum Local {
    Run(Class, usize),
    Edge(Box<EdgeResidual>, u32),
}

fn classify_chunk(
    tree: &Positive,
    own: LeafId,
    fields: &[&LeafField],
    row: &[Option<PairStatus>],
    chunk: usize,
    members: usize,
) -> Vec<Local> {
    let own_field = fields[own.0 as usize];
    let touches: Vec<TouchRef> =
        row.iter().map(|status| status.as_ref().map_or(TouchRef::Apart(Membership::Out), |s| s.chunk(chunk))).collect();
    // Surfels of a leaf that lends its surface are partners of whatever leaf is within reach of the chunk.
    let has_surface = |b: usize| !fields[b].cloud.is_empty() || fields[b].exact.is_some();
    let within_reach = |b: usize| matches!(touches[b], TouchRef::Surfels(_)) && has_surface(b);
    let partner = if own_field.lends_surfels() && (0..touches.len()).any(within_reach) { Class::PARTNER } else { 0 };

    let apart = |b: LeafId| match touches[b.0 as usize] {
        TouchRef::Apart(m) => m,
        TouchRef::Surfels(_) => Membership::Near,
    };
    let open: Vec<usize> = (0..touches.len()).filter(|&b| matches!(touches[b], TouchRef::Surfels(_))).collect();
    // Most chunks are decided as a whole, near leaves or not.
    match Residual::decided(tree, own, apart) {
        Some(Residual::Off) => return vec![Local::Run(Class(Class::OFF | partner), members)],
        Some(Residual::On(crossing)) => return vec![Local::Run(Class(surface(crossing) | partner), members)],
        _ => {}
    }
    let mut known: HashMap<Vec<Membership>, Residual> = HashMap::new();
    let mut found = Vec::new();
    let mut locals = Vec::with_capacity(members);
    for member in 0..members {
        let signature: Vec<Membership> = open
            .iter()
            .map(|&b| match touches[b] {
                TouchRef::Surfels(each) => each[member],
                TouchRef::Apart(m) => m,
            })
            .collect();
        let residual = known.entry(signature).or_insert_with_key(|signature| {
            Residual::of(tree, own, |b| match open.iter().position(|&o| o == b.0 as usize) {
                Some(place) => signature[place],
                None => apart(b),
            })
        });
        locals.push(match residual {
            Residual::Off => Local::Run(Class(Class::OFF | partner), 1),
            Residual::On(crossing) => Local::Run(Class(surface(*crossing) | partner), 1),
            Residual::Edge(edge) => {
                let centre = own_field.cloud.centre(chunk * CHUNK + member);
                let on =
                    edge.crossing(|near| fields[edge.near[near].0 as usize].contains(centre, &mut found)).is_some();
                let inside = if on { Class::INSIDE } else { 0 };
                Local::Edge(Box::new(edge.clone()), partner | inside)
            }
        });
    }
    locals
}

fn surface(crossing: Crossing) -> u32 {
    match crossing {
        Crossing::Rises => Class::RISES,
        Crossing::Falls => Class::FALLS,
    }
}
