//! What draws: a pipeline made ready for one scene.

use std::sync::Arc;

use surfcut::blister::{MeshFrame, MeshModel};
use surfcut::classify::Model;
use surfcut::classify::partners::{Among, PartnerLists};
use surfcut::csg::{LeafId, Tree};
use surfcut::hybrid::HybridModel;
use surfcut::layers::{LayerLimit, LayerSource};
use surfcut::output::report::Report;
use surfcut::pipeline::{self, Density, ExactLeaves, Prepared};
use surfcut::reference::{Reference, TruthLeaf};
use surfcut::scene::{LeafGeometry, LoadedScene};
use surfcut::space::Camera;
use surfcut::splat::{Frame, Partners, SplatSettings};

use super::args::{Pipeline, PipelineArgs};
use super::failure::InputError;
use super::progress::Bars;

/// A scene that is ready to be drawn from any camera.
pub trait Engine {
    /// The pipeline's name, as the flag spells it.
    fn pipeline(&self) -> &'static str;
    /// What there is to say of the frames drawn so far.
    fn warnings(&self) -> Vec<String> {
        Vec::new()
    }
    /// Pixels drawn so far where the crossings of an open mesh did not tell its inside, by leaf.
    fn undecided(&self) -> Vec<(String, u64)> {
        Vec::new()
    }
    /// One frame.
    fn frame(&self, camera: &Camera) -> anyhow::Result<Box<dyn LayerSource + '_>>;
}

/// How many samples a pixel, and which boundaries.
#[derive(Debug, Clone, Copy)]
pub struct FrameArgs {
    /// Samples a pixel.
    pub samples: u32,
    /// Which boundaries.
    pub limit: LayerLimit,
}

/// The engine that the flags ask for. `camera` is the first to be drawn from: sampling goes by its pixels.
pub fn engine(
    loaded: &mut LoadedScene,
    args: &PipelineArgs,
    frame: FrameArgs,
    camera: &Camera,
    bars: Bars,
    report: &mut Report,
) -> anyhow::Result<Box<dyn Engine>> {
    let surfels = |loaded: &mut LoadedScene, report: &mut Report| -> anyhow::Result<Box<dyn Engine>> {
        let mut scene = SplatScene::new(loaded, args.density.density(), camera, bars, report)?;
        Ok(scene.engine(args.splat_settings(), frame, report))
    };
    for (leaf, representation) in &args.represent {
        loaded.represent(leaf, *representation)?;
    }
    let density = args.density.density();
    match args.pipeline {
        Pipeline::Reference => reference(loaded, frame),
        Pipeline::Splat => surfels(loaded, report),
        Pipeline::Auto if args.asks_for_surfels() => surfels(loaded, report),
        Pipeline::Mesh | Pipeline::Auto => {
            if args.pipeline == Pipeline::Auto && pipeline::has_surfels(loaded)? {
                return hybrid(loaded, "hybrid", density, frame, camera, bars, report);
            }
            let model = report.phase("convert", || pipeline::mesh_model(loaded, camera, density))?;
            if model.open_leaves().next().is_some() {
                return hybrid(loaded, "mesh", density, frame, camera, bars, report);
            }
            report.count("triangles", model.triangle_count() as u64);
            report.count("shared_planes", model.shared_plane_count() as u64);
            Ok(Box::new(MeshEngine { model, frame }))
        }
    }
}

/// Every leaf in its own form; called `pipeline`, or `splat` where all are surfels.
fn hybrid(
    loaded: &mut LoadedScene,
    pipeline: &'static str,
    density: Density,
    frame: FrameArgs,
    camera: &Camera,
    bars: Bars,
    report: &mut Report,
) -> anyhow::Result<Box<dyn Engine>> {
    let names = loaded.scene.leaves.iter().map(|leaf| leaf.name.clone()).collect();
    let prepared = prepared(loaded, density, ExactLeaves::Crossed, camera, bars, report)?;
    let model = prepared.into_hybrid();
    if let Some(exact) = model.exact() {
        report.count("triangles", exact.triangle_count() as u64);
        report.count("shared_planes", exact.shared_plane_count() as u64);
    }
    let pipeline = if model.exact().is_some() { pipeline } else { "splat" };
    Ok(Box::new(HybridEngine { model, pipeline, names, frame }))
}

/// The judge. Ask for it before a [`SplatScene`] takes the clouds out of `loaded`.
pub fn reference(loaded: &LoadedScene, frame: FrameArgs) -> anyhow::Result<Box<dyn Engine>> {
    Ok(Box::new(ReferenceEngine::new(loaded, frame)?))
}

/// Converts and classifies; takes the clouds out of `loaded`.
fn prepared(
    loaded: &mut LoadedScene,
    density: Density,
    exact: ExactLeaves,
    camera: &Camera,
    bars: Bars,
    report: &mut Report,
) -> anyhow::Result<Prepared> {
    let points = loaded.geometry.iter().map(|g| match g {
        LeafGeometry::Cloud(cloud) => cloud.len() as u64,
        _ => 0,
    });
    let bar = bars.count(points.sum(), "surfels");
    let converted =
        report.phase("convert", || pipeline::convert(loaded, camera, density, exact, &|points| bar.inc(points)))?;
    bar.finish_and_clear();
    report.count("surfels", converted.surfels() as u64);
    let prepared = report.phase("classify", || converted.classify());
    let counts = prepared.model.counts();
    report.count("surface_surfels", counts.surface as u64);
    report.count("inside_edge_surfels", counts.inside_edge as u64);
    report.count("outside_edge_surfels", counts.outside_edge as u64);
    report.count("outside_surfels", counts.outside as u64);
    Ok(prepared)
}

/// A scene as classified surfels: what the pipeline's settings do not change, made once for all of them.
pub struct SplatScene {
    model: Arc<Model>,
    /// Partners found in space so far; one list for each rule.
    partners: Vec<Arc<PartnerLists>>,
}

impl SplatScene {
    /// Converts and classifies, meshes and solids sampled; takes the clouds out of `loaded`.
    pub fn new(
        loaded: &mut LoadedScene,
        density: Density,
        camera: &Camera,
        bars: Bars,
        report: &mut Report,
    ) -> anyhow::Result<Self> {
        let prepared = prepared(loaded, density, ExactLeaves::Sampled, camera, bars, report)?;
        Ok(Self { model: Arc::new(prepared.model), partners: Vec::new() })
    }

    /// The scene drawn with `settings`.
    pub fn engine(&mut self, settings: SplatSettings, frame: FrameArgs, report: &mut Report) -> Box<dyn Engine> {
        let partners = match settings.partners_among() {
            Some(among) if settings.partners == Partners::ObjectSpace => Some(self.partners(among, report)),
            _ => None,
        };
        Box::new(SplatEngine { model: self.model.clone(), frame, settings, partners })
    }

    fn partners(&mut self, among: Among, report: &mut Report) -> Arc<PartnerLists> {
        if let Some(known) = self.partners.iter().find(|lists| lists.among() == among) {
            return known.clone();
        }
        let found = Arc::new(report.phase("partners", || PartnerLists::in_space(&self.model, among)));
        report.count("partners", found.len() as u64);
        self.partners.push(found.clone());
        found
    }
}

/// The surfel pipeline.
struct SplatEngine {
    model: Arc<Model>,
    frame: FrameArgs,
    settings: SplatSettings,
    /// Partners found in space, kept from frame to frame.
    partners: Option<Arc<PartnerLists>>,
}

impl Engine for SplatEngine {
    fn pipeline(&self) -> &'static str {
        "splat"
    }

    fn frame(&self, camera: &Camera) -> anyhow::Result<Box<dyn LayerSource + '_>> {
        let FrameArgs { samples, limit } = self.frame;
        let frame = Frame::new(&self.model, camera.clone(), limit, samples, self.settings, self.partners.as_deref());
        Ok(Box::new(frame))
    }
}

/// Every leaf in its own form.
struct HybridEngine {
    model: HybridModel,
    pipeline: &'static str,
    /// Of the leaves.
    names: Vec<String>,
    frame: FrameArgs,
}

impl Engine for HybridEngine {
    fn pipeline(&self) -> &'static str {
        self.pipeline
    }

    fn warnings(&self) -> Vec<String> {
        let told = |(name, pixels): &(String, u64)| match pixels {
            0 => format!("the mesh of leaf `{name}` is open; no ray drawn passes a hole, so that does not show"),
            _ => format!(
                "the mesh of leaf `{name}` is open: at {pixels} pixels rays do not enter and leave it in turn, and what is \
                 inside is decided there by its winding number; close it, or give the leaf `kind = \"sheet\"`"
            ),
        };
        self.undecided().iter().map(told).collect()
    }

    fn undecided(&self) -> Vec<(String, u64)> {
        let named = |(leaf, count): (LeafId, u64)| (self.names[leaf.0 as usize].clone(), count);
        self.model.undecided().into_iter().map(named).collect()
    }

    fn frame(&self, camera: &Camera) -> anyhow::Result<Box<dyn LayerSource + '_>> {
        let FrameArgs { samples, limit } = self.frame;
        Ok(Box::new(self.model.frame(camera, limit, samples)))
    }
}

/// The mesh pipeline.
struct MeshEngine {
    model: MeshModel,
    frame: FrameArgs,
}

impl Engine for MeshEngine {
    fn pipeline(&self) -> &'static str {
        "mesh"
    }

    fn frame(&self, camera: &Camera) -> anyhow::Result<Box<dyn LayerSource + '_>> {
        let FrameArgs { samples, limit } = self.frame;
        Ok(Box::new(MeshFrame::new(&self.model, camera.clone(), limit, samples)))
    }
}

/// The judge, over what the leaves truly are.
struct ReferenceEngine {
    leaves: Vec<TruthLeaf>,
    tree: Tree,
    frame: FrameArgs,
}

impl ReferenceEngine {
    fn new(loaded: &LoadedScene, frame: FrameArgs) -> anyhow::Result<Self> {
        let tree = loaded.canonical_tree();
        let leaves = tree.leaves().into_iter().map(|leaf| truth_leaf(loaded, leaf)).collect::<Result<_, _>>()?;
        Ok(Self { leaves, tree, frame })
    }
}

/// The leaf as the judge sees it.
fn truth_leaf(loaded: &LoadedScene, id: LeafId) -> Result<TruthLeaf, InputError> {
    surfcut::measure::open::truth_leaf(loaded, id).ok_or_else(|| {
        InputError(format!(
            "the reference cannot cast rays at the points of leaf `{}`: give it a `truth`, the mesh or solid that it was \
             sampled from, or draw with --pipeline splat",
            loaded.scene.leaves[id.0 as usize].name
        ))
    })
}

impl Engine for ReferenceEngine {
    fn pipeline(&self) -> &'static str {
        "reference"
    }

    fn frame(&self, camera: &Camera) -> anyhow::Result<Box<dyn LayerSource + '_>> {
        let FrameArgs { samples, limit } = self.frame;
        let reference = Reference::new(self.leaves.clone(), self.tree.clone(), camera.clone(), samples, limit)?;
        Ok(Box::new(reference))
    }
}
