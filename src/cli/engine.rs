//! What draws: a pipeline made ready for one scene.

use std::sync::Arc;

use anyhow::Context;
use glam::DAffine3;

use surfcut::blister::{MeshFrame, MeshLeaf, MeshModel};
use surfcut::classify::field::Sides;
use surfcut::classify::partners::{Among, PartnerLists};
use surfcut::classify::{LeafField, Model};
use surfcut::csg::{LeafId, TooManyProducts, Tree};
#[cfg(feature = "gpu")]
use surfcut::gpu::blister::{Classifier, GpuMeshFrame};
#[cfg(feature = "gpu")]
use surfcut::gpu::hybrid::{GpuHybridError, GpuHybridModel};
#[cfg(feature = "gpu")]
use surfcut::gpu::merged::GpuMergedLayers;
#[cfg(feature = "gpu")]
use surfcut::gpu::splat::{GpuClipping, GpuSplatError, GpuSplatFrame, GpuSplatModel};
#[cfg(feature = "gpu")]
use surfcut::gpu::{Gpu, GpuLayerSource};
use surfcut::hybrid::HybridModel;
use surfcut::layers::merged::MergedLayers;
use surfcut::layers::{LayerLimit, LayerSource};
use surfcut::output::report::Report;
use surfcut::pipeline::{self, Converted, Density, ExactLeaves, Prepared};
use surfcut::reference::{Reference, TruthLeaf};
use surfcut::scene::{Leaf, LeafGeometry, LoadedScene};
use surfcut::space::{Camera, Motion};
use surfcut::splat::{Frame, Partners, SplatSettings};

use super::args::{Pipeline, PipelineArgs, Union};
#[cfg(feature = "gpu")]
use super::backend::BackendError;
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
    /// How many samples and which boundaries the frames of the picture have.
    fn args(&self) -> FrameArgs;
    /// One frame, of other samples and boundaries than the picture's.
    fn frame_with(&self, camera: &Camera, frame: FrameArgs) -> anyhow::Result<Box<dyn LayerSource + '_>>;
    /// One frame.
    fn frame(&self, camera: &Camera) -> anyhow::Result<Box<dyn LayerSource + '_>> {
        self.frame_with(camera, self.args())
    }
    /// One frame that `gpu` draws, of other samples and boundaries than the picture's.
    #[cfg(feature = "gpu")]
    fn gpu_frame_with(&self, _: &Gpu, _: &Camera, _: FrameArgs) -> Result<Box<dyn GpuLayerSource + '_>, BackendError> {
        Err(BackendError::NotThere(format!("with --pipeline {}", self.pipeline())))
    }
    /// One frame that `gpu` draws.
    #[cfg(feature = "gpu")]
    fn gpu_frame(&self, gpu: &Gpu, camera: &Camera) -> Result<Box<dyn GpuLayerSource + '_>, BackendError> {
        self.gpu_frame_with(gpu, camera, self.args())
    }
    /// Brings the leaves to a pose: each from where the scene has it; those that are not named, back there.
    fn pose(&mut self, motions: &[(LeafId, Motion)]) -> anyhow::Result<()>;
}

/// How many samples a pixel, and which boundaries.
#[derive(Debug, Clone, Copy)]
pub struct FrameArgs {
    /// Samples a pixel.
    pub samples: u32,
    /// Which boundaries.
    pub limit: LayerLimit,
    /// Whether the pixels are those of a picture, and what befalls them is to be told.
    pub is_picture: bool,
}

/// The engine that the flags ask for. `camera` is the first to be drawn from: sampling goes by its pixels. `has_device` tells whether a
/// GPU is to draw what it can.
pub fn engine(
    loaded: &mut LoadedScene,
    args: &PipelineArgs,
    frame: FrameArgs,
    (camera, has_device): (&Camera, bool),
    bars: Bars,
    report: &mut Report,
) -> anyhow::Result<Box<dyn Engine>> {
    let products = products(loaded, args.union)?;
    if let Some(products) = &products {
        report.count("products", products.len() as u64);
    }
    let surfels = |loaded: &mut LoadedScene, report: &mut Report| -> anyhow::Result<Box<dyn Engine>> {
        let mut scene = SplatScene::new(loaded, args.density.density(), camera, bars, report)?;
        let (model, partners) = scene.parts(args.splat_settings(), report);
        // Nothing else shares it from here on, so that its leaves can move.
        drop(scene);
        Ok(Box::new(SplatEngine::new(model, frame, args.splat_settings(), partners, products.clone())))
    };
    for (leaf, representation) in &args.represent {
        loaded.represent(leaf, *representation)?;
    }
    if matches!(args.pipeline, Pipeline::Mesh | Pipeline::Hybrid) && args.asks_for_surfels() {
        report.warnings.push("--clip, --inside and --unknown change nothing: they are of --pipeline splat".to_owned());
    }
    let density = args.density.density();
    match args.pipeline {
        Pipeline::Reference => Ok(Box::new(ReferenceEngine { products, ..ReferenceEngine::new(loaded, frame)? })),
        Pipeline::Splat => surfels(loaded, report),
        Pipeline::Auto if args.asks_for_surfels() => surfels(loaded, report),
        Pipeline::Mesh | Pipeline::Auto | Pipeline::Hybrid => {
            let hybrid = |loaded: &mut LoadedScene, name, products, report: &mut Report| {
                let prepared = prepared(loaded, density, ExactLeaves::Crossed, camera, bars, report)?;
                Ok(HybridEngine::boxed(prepared, loaded, name, frame, products, report))
            };
            if args.pipeline != Pipeline::Mesh && pipeline::has_surfels(loaded)? {
                // Surfels find exact leaves in two thirds of the time, since what a scan cuts of them is known before the first
                // frame; their hits are as exact. Whoever says what a leaf is drawn as is taken at their word, and crossings of an
                // open mesh have to be counted. A GPU finds exact leaves by their crossings alone, so where one is to draw they are not
                // sampled; should it fail, the CPU draws the same crossings.
                let is_chosen = loaded.scene.leaves.iter().any(|leaf| leaf.represent.is_some());
                let is_open =
                    |geometry: &LeafGeometry| matches!(geometry, LeafGeometry::Mesh(mesh) if !mesh.is_closed());
                let is_plain = !is_chosen && !loaded.geometry.iter().any(is_open);
                if args.pipeline == Pipeline::Auto && is_plain && !has_device {
                    return surfels(loaded, report);
                }
                return hybrid(loaded, "hybrid", products, report);
            }
            let leaves = pipeline::mesh_leaves(loaded, camera, density)?;
            let model = report.phase("convert", || pipeline::mesh_model_of(loaded, &leaves))?;
            if model.open_leaves().next().is_some() {
                return hybrid(loaded, "mesh", products, report);
            }
            report.count("triangles", model.triangle_count() as u64);
            report.count("shared_planes", model.shared_plane_count() as u64);
            let mut engine = MeshEngine {
                model,
                parts: None,
                leaves,
                tree: loaded.canonical_tree(),
                products,
                frame,
                #[cfg(feature = "gpu")]
                list_length: Default::default(),
            };
            engine.part();
            Ok(Box::new(engine))
        }
    }
}

/// The expressions that are drawn each by itself; `None` where the result is.
fn products(loaded: &LoadedScene, union: Union) -> Result<Option<Vec<Tree>>, TooManyProducts> {
    match union {
        Union::Volume => Ok(None),
        Union::Products => {
            let products = loaded.canonical_tree().positive().products()?;
            Ok(Some(products.iter().map(|product| product.tree()).collect()))
        }
    }
}

/// The layers of all `frames`, or of the only one.
fn merged<'f>(camera: &Camera, samples: u32, mut frames: Vec<Box<dyn LayerSource + 'f>>) -> Box<dyn LayerSource + 'f> {
    match frames.len() {
        1 => frames.swap_remove(0),
        _ => Box::new(MergedLayers::new(camera.clone(), samples, frames)),
    }
}

/// The same on the GPU.
#[cfg(feature = "gpu")]
fn gpu_merged<'f>(
    camera: &Camera,
    samples: u32,
    mut frames: Vec<Box<dyn GpuLayerSource + 'f>>,
) -> Box<dyn GpuLayerSource + 'f> {
    match frames.len() {
        1 => frames.swap_remove(0),
        _ => Box::new(GpuMergedLayers::new(camera.clone(), samples, frames)),
    }
}

/// What `models` are on the GPU: what is `kept` from the frames before, or uploaded now.
#[cfg(feature = "gpu")]
fn uploaded<'u, M: Copy, U, E>(
    kept: &'u std::cell::OnceCell<Vec<U>>,
    models: &[M],
    upload: impl Fn(M) -> Result<U, E>,
) -> Result<&'u [U], E> {
    if kept.get().is_none() {
        // It was empty, and there is but one thread.
        let _ = kept.set(models.iter().map(|model| upload(*model)).collect::<Result<_, _>>()?);
    }
    Ok(kept.get().expect("they were just uploaded"))
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
    report.warnings.extend(doubts(loaded, &converted));
    let prepared = report.phase("classify", || converted.classify());
    let counts = prepared.model.counts();
    report.count("surface_surfels", counts.surface as u64);
    report.count("inside_edge_surfels", counts.inside_edge as u64);
    report.count("outside_edge_surfels", counts.outside_edge as u64);
    report.count("outside_surfels", counts.outside as u64);
    Ok(prepared)
}

/// Leaves that cut by guessing, and how to mend it.
fn doubts(loaded: &LoadedScene, converted: &Converted) -> Vec<String> {
    let cuts = loaded.canonical_tree().leaves().len() > 1;
    let of_leaf = |(leaf, field): (&Leaf, &LeafField)| {
        let name = &leaf.name;
        match field.sides() {
            Sides::Inward => Some(format!(
                "leaf `{name}` is inside-out: its normals look inwards; turn them round, or write !{name} in the expression"
            )),
            Sides::Unclear => Some(format!(
                "the surfels of leaf `{name}` do not agree where its inside is: what it cuts far from them is a guess, made by \
                 the nearest one's plane; orient its normals, or remove them so that they are estimated"
            )),
            Sides::Open => Some(format!(
                "the surface of leaf `{name}` is open: where it has no points its inside is a guess, made by the nearest surfel's \
                 plane; declare it kind = \"sheet\" if it is only to be cut and shows no cut faces"
            )),
            Sides::Itself | Sides::Winding | Sides::HalfSpace => None,
        }
    };
    match cuts {
        true => loaded.scene.leaves.iter().zip(converted.fields()).filter_map(of_leaf).collect(),
        false => Vec::new(),
    }
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
        let (model, partners) = self.parts(settings, report);
        Box::new(SplatEngine::new(model, frame, settings, partners, None))
    }

    /// What an engine with `settings` is made of.
    fn parts(&mut self, settings: SplatSettings, report: &mut Report) -> (Arc<Model>, Option<Arc<PartnerLists>>) {
        let partners = match settings.partners_among() {
            Some(among) if settings.partners == Partners::ObjectSpace => Some(self.partners(among, report)),
            _ => None,
        };
        (self.model.clone(), partners)
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
    /// The expressions that are drawn in place of the model's.
    products: Option<Vec<Tree>>,
    /// Their models, over the same leaves.
    parts: Option<Vec<(Model, Option<PartnerLists>)>>,
    /// What is drawn, on the GPU that drew last, and how it clips: the parts, or else the model.
    #[cfg(feature = "gpu")]
    uploaded: std::cell::OnceCell<Vec<(GpuSplatModel, Option<GpuClipping>)>>,
}

impl SplatEngine {
    fn new(
        model: Arc<Model>,
        frame: FrameArgs,
        settings: SplatSettings,
        partners: Option<Arc<PartnerLists>>,
        products: Option<Vec<Tree>>,
    ) -> Self {
        let mut engine = Self {
            model,
            frame,
            settings,
            partners,
            products,
            parts: None,
            #[cfg(feature = "gpu")]
            uploaded: std::cell::OnceCell::new(),
        };
        engine.part();
        engine
    }

    /// Makes the products' models of the model as it is.
    fn part(&mut self) {
        let part = |tree: &Tree| {
            let model = self.model.with_tree(tree);
            let partners = self.partners.as_ref().map(|lists| PartnerLists::in_space(&model, lists.among()));
            (model, partners)
        };
        self.parts = self.products.as_ref().map(|products| products.iter().map(part).collect());
    }
}

impl Engine for SplatEngine {
    fn pipeline(&self) -> &'static str {
        "splat"
    }

    fn args(&self) -> FrameArgs {
        self.frame
    }

    fn frame_with(&self, camera: &Camera, frame: FrameArgs) -> anyhow::Result<Box<dyn LayerSource + '_>> {
        let FrameArgs { samples, limit, .. } = frame;
        let frame = |model, partners| -> Box<dyn LayerSource + '_> {
            Box::new(Frame::new(model, camera.clone(), limit, samples, self.settings, partners))
        };
        Ok(match &self.parts {
            None => frame(&self.model, self.partners.as_deref()),
            Some(parts) => {
                let frames = parts.iter().map(|(model, partners)| frame(model, partners.as_ref())).collect();
                merged(camera, samples, frames)
            }
        })
    }

    #[cfg(feature = "gpu")]
    fn gpu_frame_with(
        &self,
        gpu: &Gpu,
        camera: &Camera,
        frame: FrameArgs,
    ) -> Result<Box<dyn GpuLayerSource + '_>, BackendError> {
        let refused = |error| match error {
            GpuSplatError::Gpu(error) => BackendError::Gpu(error),
            GpuSplatError::ExactLeaf { .. } | GpuSplatError::SampledLeaf { .. } => BackendError::NotThere(
                match self.settings.takes_crossings() {
                    true => "meshes or solids with --pipeline splat (with --pipeline hybrid it does)",
                    false => "meshes or solids beside scans that are clipped in another way than the default one",
                }
                .to_owned(),
            ),
        };
        let models: Vec<(&Model, Option<&PartnerLists>)> = match &self.parts {
            None => vec![(&self.model, self.partners.as_deref())],
            Some(parts) => parts.iter().map(|(model, lists)| (model, lists.as_ref())).collect(),
        };
        let upload = |(model, lists): (&Model, Option<&PartnerLists>)| {
            let uploaded = GpuSplatModel::new(gpu, model)?;
            let clipping = GpuClipping::new(gpu, model, &uploaded, self.settings, lists)?;
            Ok((uploaded, clipping))
        };
        let uploaded = uploaded(&self.uploaded, &models, upload).map_err(refused)?;
        let FrameArgs { samples, limit, .. } = frame;
        let mut frames: Vec<Box<dyn GpuLayerSource + '_>> = Vec::new();
        for ((model, _), (uploaded, clipping)) in models.into_iter().zip(uploaded) {
            let frame = GpuSplatFrame::new(model, uploaded, camera.clone(), limit, samples, clipping.as_ref());
            frames.push(Box::new(frame.map_err(refused)?));
        }
        Ok(gpu_merged(camera, samples, frames))
    }

    fn pose(&mut self, motions: &[(LeafId, Motion)]) -> anyhow::Result<()> {
        #[cfg(feature = "gpu")]
        self.uploaded.take();
        // What the parts share with the model is about to change.
        self.parts = None;
        let model = Arc::get_mut(&mut self.model).context("a model that other engines share cannot be moved")?;
        let again = model.pose(motions);
        if let Some(partners) = self.partners.take() {
            self.partners = Some(Arc::new(Arc::unwrap_or_clone(partners).after_pose(model, &again)));
        }
        self.part();
        Ok(())
    }
}

/// Every leaf in its own form.
struct HybridEngine {
    model: HybridModel,
    pipeline: &'static str,
    /// Of the leaves.
    names: Vec<String>,
    /// The expressions that are drawn in place of the model's.
    products: Option<Vec<Tree>>,
    /// Their models, over the same leaves.
    parts: Option<Vec<HybridModel>>,
    frame: FrameArgs,
    /// What is drawn, on the GPU that drew last: the parts, or else the model.
    #[cfg(feature = "gpu")]
    uploaded: std::cell::OnceCell<Vec<GpuHybridModel>>,
}

impl HybridEngine {
    /// Called `pipeline`, or `splat` where all leaves are surfels.
    fn boxed(
        prepared: Prepared,
        loaded: &LoadedScene,
        pipeline: &'static str,
        frame: FrameArgs,
        products: Option<Vec<Tree>>,
        report: &mut Report,
    ) -> Box<dyn Engine> {
        let names = loaded.scene.leaves.iter().map(|leaf| leaf.name.clone()).collect();
        let model = prepared.into_hybrid();
        if let Some(exact) = model.exact() {
            report.count("triangles", exact.triangle_count() as u64);
            report.count("shared_planes", exact.shared_plane_count() as u64);
        }
        let pipeline = if model.exact().is_some() { pipeline } else { "splat" };
        let mut engine = Self {
            model,
            pipeline,
            names,
            products,
            parts: None,
            frame,
            #[cfg(feature = "gpu")]
            uploaded: std::cell::OnceCell::new(),
        };
        engine.part();
        Box::new(engine)
    }

    /// Makes the products' models of the model as it is.
    fn part(&mut self) {
        let part = |tree: &Tree| self.model.with_tree(tree);
        self.parts = self.products.as_ref().map(|products| products.iter().map(part).collect());
    }

    /// What is drawn: the parts, or else the model.
    #[cfg(feature = "gpu")]
    fn models(&self) -> Vec<&HybridModel> {
        self.parts.as_ref().map_or_else(|| vec![&self.model], |parts| parts.iter().collect())
    }
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
        let mut counts = self.model.undecided();
        for (leaf, count) in self.parts.iter().flatten().flat_map(HybridModel::undecided) {
            counts.iter_mut().filter(|(other, _)| *other == leaf).for_each(|(_, sum)| *sum += count);
        }
        let named = |(leaf, count): (LeafId, u64)| (self.names[leaf.0 as usize].clone(), count);
        counts.into_iter().map(named).collect()
    }

    fn args(&self) -> FrameArgs {
        self.frame
    }

    fn frame_with(&self, camera: &Camera, frame: FrameArgs) -> anyhow::Result<Box<dyn LayerSource + '_>> {
        fn boxed<'m>(model: &'m HybridModel, camera: &Camera, frame: FrameArgs) -> Box<dyn LayerSource + 'm> {
            let FrameArgs { samples, limit, is_picture } = frame;
            let frame = if is_picture { HybridModel::frame } else { HybridModel::frame_aside };
            Box::new(frame(model, camera, limit, samples))
        }
        let samples = frame.samples;
        let frame = |model| boxed(model, camera, frame);
        Ok(match &self.parts {
            None => frame(&self.model),
            Some(parts) => merged(camera, samples, parts.iter().map(frame).collect()),
        })
    }

    #[cfg(feature = "gpu")]
    fn gpu_frame_with(
        &self,
        gpu: &Gpu,
        camera: &Camera,
        frame: FrameArgs,
    ) -> Result<Box<dyn GpuLayerSource + '_>, BackendError> {
        let refused = |error| match error {
            GpuHybridError::OpenMesh { leaf } => {
                BackendError::NotThere(format!("the open mesh of leaf `{}` as a solid", self.names[leaf.0 as usize]))
            }
            GpuHybridError::Gpu(error) | GpuHybridError::Surfels(GpuSplatError::Gpu(error)) => BackendError::Gpu(error),
            GpuHybridError::Surfels(error) => BackendError::NotThere(format!("this scene ({error})")),
        };
        let models = self.models();
        let uploaded = uploaded(&self.uploaded, &models, |model| GpuHybridModel::new(gpu, model)).map_err(refused)?;
        let FrameArgs { samples, limit, .. } = frame;
        let mut frames: Vec<Box<dyn GpuLayerSource + '_>> = Vec::new();
        for (model, uploaded) in models.into_iter().zip(uploaded) {
            frames.push(Box::new(uploaded.frame(model, camera, limit, samples).map_err(refused)?));
        }
        Ok(gpu_merged(camera, samples, frames))
    }

    fn pose(&mut self, motions: &[(LeafId, Motion)]) -> anyhow::Result<()> {
        // What the parts share with the model is about to change.
        self.parts = None;
        self.model.pose(motions)?;
        self.part();
        #[cfg(feature = "gpu")]
        if let Some(uploaded) = self.uploaded.get()
            && !self.models().into_iter().zip(uploaded).all(|(model, uploaded)| uploaded.is_of(model))
        {
            self.uploaded.take();
        }
        Ok(())
    }
}

/// The mesh pipeline.
struct MeshEngine {
    model: MeshModel,
    /// Where the scene has them.
    leaves: Vec<MeshLeaf>,
    tree: Tree,
    /// The expressions that are drawn in place of `tree`.
    products: Option<Vec<Tree>>,
    /// Their models, over the same leaves.
    parts: Option<Vec<MeshModel>>,
    frame: FrameArgs,
    /// How long the GPU's lists of fragments had to be.
    #[cfg(feature = "gpu")]
    list_length: std::rc::Rc<std::cell::Cell<usize>>,
}

impl MeshEngine {
    /// Makes the products' models of the model as it is.
    fn part(&mut self) {
        // A product has leaves of the expression alone.
        let part = |tree: &Tree| self.model.with_tree(tree);
        self.parts = self.products.as_ref().map(|products| products.iter().filter_map(part).collect());
    }
}

impl Engine for MeshEngine {
    fn pipeline(&self) -> &'static str {
        "mesh"
    }

    fn args(&self) -> FrameArgs {
        self.frame
    }

    fn frame_with(&self, camera: &Camera, frame: FrameArgs) -> anyhow::Result<Box<dyn LayerSource + '_>> {
        let FrameArgs { samples, limit, .. } = frame;
        let frame =
            |model| -> Box<dyn LayerSource + '_> { Box::new(MeshFrame::new(model, camera.clone(), limit, samples)) };
        Ok(match &self.parts {
            None => frame(&self.model),
            Some(parts) => merged(camera, samples, parts.iter().map(frame).collect()),
        })
    }

    #[cfg(feature = "gpu")]
    fn gpu_frame_with(
        &self,
        _: &Gpu,
        camera: &Camera,
        frame: FrameArgs,
    ) -> Result<Box<dyn GpuLayerSource + '_>, BackendError> {
        let FrameArgs { samples, limit, .. } = frame;
        let frame = |model| -> Box<dyn GpuLayerSource + '_> {
            let frame = MeshFrame::new(model, camera.clone(), limit, samples);
            let frame = GpuMeshFrame::new(frame, Classifier::default());
            Box::new(frame.with_length(std::rc::Rc::clone(&self.list_length)))
        };
        Ok(match &self.parts {
            None => frame(&self.model),
            Some(parts) => gpu_merged(camera, samples, parts.iter().map(frame).collect()),
        })
    }

    fn pose(&mut self, motions: &[(LeafId, Motion)]) -> anyhow::Result<()> {
        let mut leaves = self.leaves.clone();
        for leaf in &mut leaves {
            place(leaf.leaf, &mut leaf.world_from_leaf, motions);
        }
        self.model = MeshModel::new(&leaves, &self.tree)?;
        self.part();
        Ok(())
    }
}

/// Moves a leaf that has a motion.
fn place(leaf: LeafId, world_from_leaf: &mut DAffine3, motions: &[(LeafId, Motion)]) {
    if let Some((_, motion)) = motions.iter().find(|(other, motion)| *other == leaf && *motion != Motion::REST) {
        *world_from_leaf = motion.affine() * *world_from_leaf;
    }
}

/// The judge, over what the leaves truly are.
struct ReferenceEngine {
    /// Where the scene has them.
    own: Vec<TruthLeaf>,
    leaves: Vec<TruthLeaf>,
    tree: Tree,
    /// The expressions that are drawn in place of `tree`.
    products: Option<Vec<Tree>>,
    frame: FrameArgs,
}

impl ReferenceEngine {
    fn new(loaded: &LoadedScene, frame: FrameArgs) -> anyhow::Result<Self> {
        let tree = loaded.canonical_tree();
        let leaves: Vec<TruthLeaf> =
            tree.leaves().into_iter().map(|leaf| truth_leaf(loaded, leaf)).collect::<Result<_, _>>()?;
        Ok(Self { own: leaves.clone(), leaves, tree, products: None, frame })
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

    fn args(&self) -> FrameArgs {
        self.frame
    }

    fn frame_with(&self, camera: &Camera, frame: FrameArgs) -> anyhow::Result<Box<dyn LayerSource + '_>> {
        let FrameArgs { samples, limit, .. } = frame;
        let frame = |tree: &Tree| -> anyhow::Result<Box<dyn LayerSource + '_>> {
            let reference = Reference::new(self.leaves.clone(), tree.clone(), camera.clone(), samples, limit)?;
            Ok(Box::new(reference))
        };
        match &self.products {
            None => frame(&self.tree),
            Some(products) => Ok(merged(camera, samples, products.iter().map(frame).collect::<Result<_, _>>()?)),
        }
    }

    fn pose(&mut self, motions: &[(LeafId, Motion)]) -> anyhow::Result<()> {
        self.leaves.clone_from(&self.own);
        for leaf in &mut self.leaves {
            place(LeafId(leaf.leaf), &mut leaf.world_from_leaf, motions);
        }
        Ok(())
    }
}
