//! From arguments to a loaded scene and its camera.

use std::path::Path;

use surfcut::formats::ReadOptions;
use surfcut::scene::{CameraSpec, LoadedScene, Scene, load, toml_file, tree_json};
use surfcut::space::{Camera, CameraError, Lens};

use super::args::{CameraArgs, SceneArgs, ViewArgs};
use super::progress::Bars;

/// The scene that the arguments write. Reads no file but a scene file.
pub fn scene(args: &SceneArgs) -> anyhow::Result<Scene> {
    let path = Path::new(&args.input);
    let is_scene_file = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("toml"));
    let first = if is_scene_file {
        toml_file::read(path)?
    } else if tree_json::is_tree_file(path) {
        tree_json::read(path)?
    } else {
        Scene::of_operand(&args.input)?
    };
    let joined = args.operands.0.iter().try_fold(first, |scene, (joint, operand)| scene.joined(*joint, operand))?;
    Ok(joined)
}

/// The scene with its files read.
pub fn loaded(args: &SceneArgs, view: Option<&ViewArgs>, bars: Bars) -> anyhow::Result<LoadedScene> {
    let mut scene = scene(args)?;
    if let Some(view) = view {
        scene.size = view.size.unwrap_or(scene.size);
        scene.background = view.background.or(scene.background);
    }
    let options = ReadOptions { drop_invalid: args.drop_invalid, ..ReadOptions::default() };
    Ok(load(scene, &options, &bars.bytes("reading"))?)
}

/// The name of what is drawn, for titles and default outputs.
pub fn name(args: &SceneArgs) -> String {
    // A solid such as sphere:0,0,0,1 has no file name worth keeping.
    let head = args.input.split(':').next().unwrap_or("scene");
    let head = head.strip_suffix(tree_json::TREE_SUFFIX).unwrap_or(head);
    Path::new(head).file_stem().map_or_else(|| "scene".into(), |stem| stem.to_string_lossy().into_owned())
}

/// The scene's camera, with what the flags change of it.
pub fn camera(scene: &LoadedScene, args: &CameraArgs) -> Result<Camera, CameraError> {
    camera_of(changed(scene.camera_spec(), args), scene.scene.size, args)
}

/// `spec` with what the flags change of it, but for the magnification.
pub fn changed(mut spec: CameraSpec, args: &CameraArgs) -> CameraSpec {
    spec.eye = args.eye.unwrap_or(spec.eye);
    spec.target = args.target.unwrap_or(spec.target);
    spec.up = args.up.unwrap_or(spec.up);
    match (args.fov_y, args.height) {
        (Some(degrees), _) => {
            spec.lens = Lens::FovY(degrees);
        }
        (None, Some(height)) => spec.lens = Lens::Height(height),
        (None, None) => {}
    }
    spec
}

/// The camera of `spec`, magnified as the flags say.
pub fn camera_of(spec: CameraSpec, size: (u32, u32), args: &CameraArgs) -> Result<Camera, CameraError> {
    let camera = spec.camera(size)?;
    match (args.zoom, args.at) {
        (None, None) => Ok(camera),
        (zoom, at) => camera.zoomed(at.unwrap_or(spec.target), zoom.unwrap_or(1.0)),
    }
}
