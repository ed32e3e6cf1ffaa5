//! The pipelines as a suite opens them: the reference renderer as its truth, and what is to be judged.

use super::suite::{DrawError, Drawer};
use crate::blister::MeshFrame;
use crate::classify::partners::PartnerLists;
use crate::csg::LeafId;
use crate::formats::{NoProgress, ReadOptions};
use crate::layers::{LayerLimit, LayerStack};
use crate::pipeline::{self, Density, ExactLeaves};
use crate::reference::{Reference, TruthLeaf, TruthShape};
use crate::scene::load::LoadedTruth;
use crate::scene::{LeafGeometry, LoadedScene, Scene, load};
use crate::space::Camera;
use crate::splat::{Frame, Partners, SplatSettings};

/// The leaf `id` as the judge sees it: its truth, else itself; `None` for points without a truth.
pub fn truth_leaf(loaded: &LoadedScene, id: LeafId) -> Option<TruthLeaf> {
    let index = id.0 as usize;
    let leaf = &loaded.scene.leaves[index];
    let shape = match (&loaded.truths[index], &loaded.geometry[index]) {
        (Some(LoadedTruth::Mesh(mesh)), _) | (None, LeafGeometry::Mesh(mesh)) => TruthShape::Mesh(mesh.clone()),
        (Some(LoadedTruth::Solid(solid)), _) | (None, LeafGeometry::Solid(solid)) => TruthShape::Solid(solid.clone()),
        (None, LeafGeometry::Cloud(_)) => return None,
    };
    Some(TruthLeaf {
        leaf: id.0,
        shape,
        world_from_leaf: leaf.world_from_leaf,
        colour: loaded.colour(id),
        vertex_colours: loaded.has_own_colours(id),
        opacity: leaf.opacity,
        kind: leaf.kind,
    })
}

/// Makes `scene` ready for the reference renderer, one sample a pixel.
///
/// # Errors
/// Where the scene cannot be loaded, or a point leaf has no truth.
pub fn open_reference(scene: &Scene, limit: LayerLimit) -> Result<Drawer, DrawError> {
    let loaded = load(scene.clone(), &ReadOptions::default(), &NoProgress)?;
    let tree = loaded.canonical_tree();
    let leaf = |id: LeafId| {
        let name = &loaded.scene.leaves[id.0 as usize].name;
        truth_leaf(&loaded, id).ok_or_else(|| format!("the points of leaf `{name}` have no truth to be judged by"))
    };
    let leaves: Vec<TruthLeaf> = tree.leaves().into_iter().map(leaf).collect::<Result<_, _>>()?;
    Ok(Box::new(move |camera: &Camera| {
        let reference = Reference::new(leaves.clone(), tree.clone(), camera.clone(), 1, limit)?;
        Ok(LayerStack::collect(&reference))
    }))
}

/// Makes `scene` ready for the surfel pipeline with `settings`, one sample a pixel. Meshes and solids are drawn in their own form where
/// the settings take them so, else they are sampled for the scene's own view.
///
/// # Errors
/// Where the scene cannot be loaded or converted.
pub fn open_surfels(scene: &Scene, limit: LayerLimit, settings: SplatSettings) -> Result<Drawer, DrawError> {
    if settings.takes_crossings() {
        return open_own_forms(scene, limit, Density::default());
    }
    let mut loaded = load(scene.clone(), &ReadOptions::default(), &NoProgress)?;
    let camera = loaded.camera()?;
    let converted = pipeline::convert(&mut loaded, &camera, Density::default(), ExactLeaves::Sampled, &|_| ())?;
    let model = converted.classify().model;
    let partners = match settings.partners_among() {
        Some(among) if settings.partners == Partners::ObjectSpace => Some(PartnerLists::in_space(&model, among)),
        _ => None,
    };
    Ok(Box::new(move |camera: &Camera| {
        Ok(LayerStack::collect(&Frame::new(&model, camera.clone(), limit, 1, settings, partners.as_ref())))
    }))
}

/// Makes `scene` ready for the mesh pipeline, one sample a pixel; solids that are to be meshes are tessellated at `density`.
///
/// # Errors
/// Where the scene cannot be loaded, or has a leaf of points.
pub fn open_meshes(scene: &Scene, limit: LayerLimit, density: Density) -> Result<Drawer, DrawError> {
    let loaded = load(scene.clone(), &ReadOptions::default(), &NoProgress)?;
    let model = pipeline::mesh_model(&loaded, &loaded.camera()?, density)?;
    Ok(Box::new(move |camera: &Camera| Ok(LayerStack::collect(&MeshFrame::new(&model, camera.clone(), limit, 1)))))
}

/// Makes `scene` ready to be drawn with every leaf in its own form, one sample a pixel; leaves that are to be surfels are sampled
/// at `density`.
///
/// # Errors
/// Where the scene cannot be loaded or converted.
pub fn open_own_forms(scene: &Scene, limit: LayerLimit, density: Density) -> Result<Drawer, DrawError> {
    let mut loaded = load(scene.clone(), &ReadOptions::default(), &NoProgress)?;
    let camera = loaded.camera()?;
    let converted = pipeline::convert(&mut loaded, &camera, density, ExactLeaves::Crossed, &|_| ())?;
    let model = converted.classify().into_hybrid();
    Ok(Box::new(move |camera: &Camera| Ok(LayerStack::collect(&model.frame(camera, limit, 1)))))
}
