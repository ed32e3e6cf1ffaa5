//! Clipping by partners: whether a point on an edge surfel is on the result, asked of the surfel's own partners.
//!
//! # Theory
//! Wicke 2004 §3.3: a fragment asks its surfel's clipping partners, patch by patch, and the tree. Under the paper's rule
//! ([`PaperTree`]) each occurrence of a leaf is a patch, and a patch without partners is *unknown*. Under the resolved rule
//! the surfel's residual is asked, and a near leaf without partners takes the side of its nearest surfel ([`crate::csg::residual`]).
//!
//! # Changes from the paper
//! * An exact leaf has no partners: it is asked itself. For the paper's rule it is known where its surface passes through
//!   the surfel's ball, which is where partners of it would have been found.
//! * Where everything is unknown the paper keeps the surfel whole, arguing that it would have been dropped if it lay off the
//!   result. An outside-edge surfel does lie off it: its ball meets another surface, but its disk may meet no partner, or
//!   in the clip buffer only one beyond the border of the picture. So with all unknown, outside-edge surfels are dropped.
//! * The surfels of another occurrence of the fragment's own leaf lie *on* the fragment, so they clip nothing: unknown.
//! * A sheet never cuts: no point is inside one.
//! * A list of very many partners (a coarse surfel over a dense leaf) is not walked but searched: under the resolved
//!   rule, the surfels about the point come from the leaf's own search structure.
//!
//! # Practice
//! Partners are gathered once for each surfel and tile, relative to the surfel's centre in world axes.

use std::borrow::Cow;

use glam::{DVec2, Vec2, Vec3};

use super::ewa;
use super::project::{View, ViewSurfel};
use super::settings::{Clip, Inside, SplatSettings, Unknown};
use super::surface::Tile;
use crate::classify::inside::{PartnerDisk, Patch};
use crate::classify::partners::{Among, PartnerLists, SurfelId};
use crate::classify::{Drawn, LeafField, Model, Wicke};
use crate::csg::residual::{Crossing, Membership};
use crate::csg::{LeafId, PaperTree, Tri};
use crate::scene::LeafKind;

/// Partners of one leaf above which its search structure is asked at the point instead: a search costs about as much as
/// walking a list of this length.
pub(crate) const LONGEST_WALK: usize = 96;

impl SplatSettings {
    /// Whose partners a frame with these settings asks for; `None` where it asks for none, since clipping surfaces on the
    /// curved field needs no lists ([`super::surface`]).
    pub fn partners_among(&self) -> Option<Among> {
        let without = self.clip == Clip::Surface && self.inside == Inside::Curved && self.unknown == Unknown::Resolved;
        (!without).then_some(match self.unknown {
            Unknown::Paper => Among::EdgeSurfels,
            Unknown::Resolved => Among::NearLeaves,
        })
    }
}

impl SplatSettings {
    /// Whether leaves may come from elsewhere ([`super::crossed`]): surfaces are clipped on the field. The paper's ways are about
    /// surfels, and there all leaves are made of them.
    pub fn takes_crossings(&self) -> bool {
        self.partners_among().is_none()
    }
}

/// What a frame's clipping shares between tiles.
pub struct Clipping<'a> {
    settings: SplatSettings,
    model: &'a Model,
    partners: Cow<'a, PartnerLists>,
    /// For the paper's rule.
    paper: Option<PaperTree>,
    /// By leaf: whether it occurs complemented and not otherwise, and so is asked as its complement.
    reversed: Vec<bool>,
}

impl<'a> Clipping<'a> {
    /// For the frames of `model` whose partners are `partners`.
    pub fn new(model: &'a Model, partners: Cow<'a, PartnerLists>, settings: SplatSettings) -> Self {
        let mut uses = vec![[false; 2]; model.fields.len()];
        for literal in model.tree.literals() {
            uses[literal.leaf.0 as usize][usize::from(literal.negated)] = true;
        }
        let reversed = uses.iter().map(|&[plain, complemented]| complemented && !plain).collect();
        let paper = (settings.unknown == Unknown::Paper).then(|| PaperTree::from(&model.tree));
        Self { settings, model, partners, paper, reversed }
    }

    /// The lists that are asked.
    pub fn partners(&self) -> &PartnerLists {
        &self.partners
    }

    /// The partners of a tile's surfels; `leaves` are the runs of one leaf in `surfels`.
    pub fn of_tile(&self, surfels: &[ViewSurfel], leaves: &[(LeafId, std::ops::Range<usize>)]) -> Clipper<'_> {
        let mut clipper =
            Clipper { of: self, lists: Vec::with_capacity(surfels.len()), parts: Vec::new(), disks: Vec::new() };
        for (leaf, range) in leaves {
            for s in &surfels[range.clone()] {
                clipper.gather(*leaf, s);
            }
        }
        clipper
    }
}

/// The partners of one leaf of one surfel.
#[derive(Debug, Clone, Copy)]
struct Part {
    leaf: LeafId,
    /// Into [`Clipper::disks`]; empty where the leaf's search is to be asked.
    start: u32,
    end: u32,
    /// Under the paper's rule, the side of a leaf that no disk brings near: the paper's classification is by the surfels that
    /// reach a ball, and ours calls it near as well where its side is not proven.
    side: Option<bool>,
}

/// One tile's partners.
pub struct Clipper<'a> {
    of: &'a Clipping<'a>,
    /// Per surfel of the tile: its parts.
    lists: Vec<(u32, u32)>,
    parts: Vec<Part>,
    disks: Vec<PartnerDisk>,
}

/// Reused between points.
#[derive(Debug, Default)]
pub struct ClipScratch {
    found: Vec<(u32, f32)>,
    disks: Vec<PartnerDisk>,
}

impl Clipper<'_> {
    fn gather(&mut self, leaf: LeafId, s: &ViewSurfel) {
        let first = self.parts.len() as u32;
        if s.class.is_edge() {
            let model = self.of.model;
            let centre = model.fields[leaf.0 as usize].cloud.centre(s.index as usize);
            for of_leaf in self.of.partners.of(SurfelId { leaf, index: s.index }).chunk_by(|a, b| a.leaf == b.leaf) {
                let other = &model.fields[of_leaf[0].leaf.0 as usize];
                let start = self.disks.len() as u32;
                if self.of.settings.unknown == Unknown::Paper || of_leaf.len() <= LONGEST_WALK {
                    let disk = |id: &SurfelId| disk_of(other, id.index, |c| (c - centre).as_vec3());
                    self.disks.extend(of_leaf.iter().map(disk));
                }
                self.parts.push(Part { leaf: of_leaf[0].leaf, start, end: self.disks.len() as u32, side: None });
            }
        }
        if self.of.settings.unknown == Unknown::Paper {
            self.gather_sides(leaf, s, first as usize);
        }
        self.lists.push((first, self.parts.len() as u32));
    }

    /// Adds the sides of the leaves that are near surfel `s` of `leaf` without a disk of theirs reaching its ball; its parts so
    /// far begin at `first`.
    fn gather_sides(&mut self, leaf: LeafId, s: &ViewSurfel, first: usize) {
        let Some(Drawn::Edge(number)) = s.class.drawn() else { return };
        let model = self.of.model;
        let centre = model.fields[leaf.0 as usize].cloud.centre(s.index as usize);
        for &near in &model.classes[leaf.0 as usize].residuals[number as usize].near {
            let field = &model.fields[near.0 as usize];
            let is_known = self.parts[first..].iter().any(|part| part.leaf == near);
            if is_known || !field.lends_surfels() || field.reaches(centre, f64::from(s.radius)) {
                continue;
            }
            self.parts.push(Part { leaf: near, start: 0, end: 0, side: Some(field.far_inside(centre)) });
        }
    }

    /// Whether and how the result changes at the point `e` (relative to its centre, view axes) of edge surfel `s` of
    /// `leaf`, the tile's surfel number `place`.
    pub fn crossing(
        &self,
        view: &View,
        leaf: LeafId,
        place: usize,
        s: &ViewSurfel,
        e: Vec3,
        scratch: &mut ClipScratch,
    ) -> Option<Crossing> {
        let model = self.of.model;
        let x = view.normal_to_world(e);
        match &self.of.paper {
            Some(paper) => {
                let mut any_known = false;
                let mut inside = |occurrence: usize| {
                    let literal = paper.literal(occurrence);
                    let inside = self.known_inside(leaf, place, s, literal.leaf, literal.negated, x);
                    any_known |= inside != Tri::Unknown;
                    inside
                };
                let kept = paper.occurrences_of(leaf).find(|&own| !paper.clipped(own, &mut inside))?;
                (any_known || s.class.wicke() != Wicke::OutsideEdge).then(|| paper.crossing(kept))
            }
            None => match s.class.drawn()? {
                Drawn::Surface(crossing) => Some(crossing),
                Drawn::Edge(number) => {
                    let residual = &model.classes[leaf.0 as usize].residuals[number as usize];
                    residual.crossing(|near| self.resolved_inside(leaf, place, s, residual.near[near], x, scratch))
                }
            },
        }
    }

    /// [`Self::crossing`] where the ray through the tile-relative pixel position `px` has depth `t` (less the anchor's).
    pub fn crossing_on_ray(
        &self,
        tile: &Tile<'_>,
        leaf: LeafId,
        place: usize,
        px: DVec2,
        t: f32,
        scratch: &mut ClipScratch,
    ) -> Option<Crossing> {
        let s = &tile.surfels[place];
        let direction = ewa::direction(tile.view, tile.rect, px);
        let tau = t - s.z;
        let delta = px.as_vec2() - Vec2::new(s.u, s.v);
        let e = (delta * s.scale + direction * tau).extend(tau + s.lift);
        self.crossing(tile.view, leaf, place, s, e, scratch)
    }

    fn part(&self, place: usize, leaf: LeafId) -> Option<Part> {
        let (first, end) = self.lists[place];
        self.parts[first as usize..end as usize].iter().find(|part| part.leaf == leaf).copied()
    }

    fn disks(&self, part: Part) -> &[PartnerDisk] {
        &self.disks[part.start as usize..part.end as usize]
    }

    /// The paper's `insidePatch`: unknown without partners. `x` relative to the centre of `s`, world axes.
    fn known_inside(&self, own: LeafId, place: usize, s: &ViewSurfel, other: LeafId, reversed: bool, x: Vec3) -> Tri {
        let field = &self.of.model.fields[other.0 as usize];
        if other == own {
            return Tri::Unknown;
        }
        if field.kind == LeafKind::Sheet {
            return Tri::False;
        }
        if let Some(exact) = &field.exact {
            return match self.of.model.status(own, s.index as usize, other) {
                Membership::Near => {
                    let centre = self.of.model.fields[own.0 as usize].cloud.centre(s.index as usize);
                    Tri::from(exact.contains(centre + x.as_dvec3()))
                }
                _ => Tri::Unknown,
            };
        }
        let Some(part) = self.part(place, other) else { return Tri::Unknown };
        if let Some(inside) = part.side {
            return Tri::from(inside);
        }
        let patch = Patch { disks: self.disks(part), reversed };
        self.ask(&patch, x).map_or(Tri::Unknown, Tri::from)
    }

    /// Whether `x` (relative to the centre of `s`, world axes) is inside the near leaf `other`.
    fn resolved_inside(
        &self,
        own: LeafId,
        place: usize,
        s: &ViewSurfel,
        other: LeafId,
        x: Vec3,
        scratch: &mut ClipScratch,
    ) -> bool {
        let field = &self.of.model.fields[other.0 as usize];
        let reversed = self.of.reversed[other.0 as usize];
        let centre = self.of.model.fields[own.0 as usize].cloud.centre(s.index as usize);
        if let Some(exact) = &field.exact {
            return exact.contains(centre + x.as_dvec3());
        }
        let near_x = centre + x.as_dvec3();
        match self.part(place, other) {
            Some(part) if part.end > part.start => {
                let patch = Patch { disks: self.disks(part), reversed };
                if let Some(inside) = self.ask(&patch, x) {
                    return inside;
                }
            }
            Some(_) => {
                match self.of.settings.inside {
                    Inside::Nearest | Inside::TwoNearest => field.nearest_k(near_x, 2, &mut scratch.found),
                    _ => field.touching(near_x, 0.0, &mut scratch.found),
                }
                scratch.disks.clear();
                let disk = |&(t, _): &(u32, f32)| disk_of(field, t, |c| (c - centre).as_vec3());
                scratch.disks.extend(scratch.found.iter().map(disk));
                if let Some(inside) = self.ask(&Patch { disks: &scratch.disks, reversed }, x) {
                    return inside;
                }
            }
            None => {}
        }
        field.far_inside(near_x)
    }

    #[inline]
    fn ask(&self, patch: &Patch<'_>, x: Vec3) -> Option<bool> {
        match self.of.settings.inside {
            Inside::Nearest => patch.nearest(x),
            Inside::TwoNearest => patch.two_nearest(x),
            Inside::AnyPlane => patch.any_plane(x),
            Inside::Blend => patch.blend(x),
            Inside::Curved => patch.curved(x),
        }
    }
}

/// Surfel `index` of a leaf as a partner; `relative` puts its centre where it belongs.
#[inline]
fn disk_of(field: &LeafField, index: u32, relative: impl Fn(glam::DVec3) -> Vec3) -> PartnerDisk {
    let cloud = &field.cloud;
    let support = cloud.supports.as_ref().map(|s| s[index as usize]);
    PartnerDisk::new(&cloud.surfels[index as usize], relative(cloud.centre(index as usize)), support)
}
