use std::fs;

use glam::DVec3;

use super::*;
use crate::csg::expression;
use crate::formats::NoProgress;
use crate::scene::{Leaf, toml_file};

/// A directory with two equal point files and a mesh.
fn files() -> tempfile::TempDir {
    let directory = tempfile::tempdir().unwrap();
    let points = "0 0 0\n1 0 0\n0 1 0\n0 0 2\n";
    fs::write(directory.path().join("a.xyz"), points).unwrap();
    fs::write(directory.path().join("copy.xyz"), points).unwrap();
    let mesh = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n";
    fs::write(directory.path().join("m.obj"), mesh).unwrap();
    directory
}

fn load_text(text: &str, base: &Path) -> Result<LoadedScene, LoadError> {
    load(toml_file::parse(text, base).unwrap(), &ReadOptions::default(), &NoProgress)
}

#[test]
fn a_file_is_read_once_and_equal_leaves_are_one() {
    let directory = files();
    let text = "csg = 'a | b | c | d | e'\n\
        [leaf.a]\nfile = 'a.xyz'\n\
        [leaf.b]\nfile = './a.xyz'\ntranslate = [1, 0, 0]\n\
        [leaf.c]\nfile = 'a.xyz'\n\
        [leaf.d]\nfile = 'copy.xyz'\n\
        [leaf.e]\nfile = 'm.obj'";
    let loaded = load_text(text, directory.path()).unwrap();
    assert_eq!(loaded.files.len(), 3);
    let (LeafGeometry::Cloud(a), LeafGeometry::Cloud(b)) = (&loaded.geometry[0], &loaded.geometry[1]) else {
        panic!("two clouds")
    };
    assert!(Arc::ptr_eq(a, b));
    assert_eq!(loaded.canonical, [0, 1, 0, 0, 4].map(LeafId));
    assert_eq!(loaded.canonical_tree().leaves(), [0, 1, 4].map(LeafId));
    let same = |note: &&SceneNote| matches!(note, SceneNote::SameContent { earlier, .. } if earlier == "a");
    assert_eq!(loaded.notes.iter().filter(same).count(), 2);
    assert_eq!(loaded.bounds[1], Some(Bounds { min: DVec3::X, max: DVec3::new(2.0, 1.0, 2.0) }));
    loaded.camera().unwrap();
}

#[test]
fn the_first_bad_leaf_is_named_with_its_file() {
    let directory = files();
    let text = "csg = 'ok | gone'\n[leaf.ok]\nfile = 'a.xyz'\n[leaf.gone]\nfile = 'gone.ply'";
    let error = load_text(text, directory.path()).unwrap_err();
    assert!(matches!(&error, LoadError::File { leaf, .. } if leaf == "gone"));
    assert!(error.to_string().contains("gone.ply"), "{error}");
    let text = "[leaf.a]\nfile = 'm.obj'\ntruth = 'a.xyz'";
    assert!(matches!(load_text(text, directory.path()), Err(LoadError::TruthIsCloud { .. })));
    let text = "[leaf.a]\nfile = 'a.xyz'\ntruth = 'm.obj'";
    assert!(matches!(load_text(text, directory.path()).unwrap().truths[0], Some(LoadedTruth::Mesh(_))));
}

#[test]
fn a_half_space_reaches_past_the_scene() {
    let base = Path::new(".");
    let text = "csg = 'a - h'\n[leaf.a]\nsphere = { centre = [3, 0, 0], radius = 1 }\n\
        [leaf.h]\nhalf_space = { point = [0, 0, 0], normal = [0, 0, 1] }\nscale = 2";
    let loaded = load_text(text, base).unwrap();
    let LeafGeometry::Solid(Solid::HalfSpace { extent, .. }) = loaded.geometry[1] else { panic!("a half-space") };
    // The sphere's box reaches (4, ±1) in the plane, which is (2, ±½) before the scale.
    let corner = 4.25f64.sqrt();
    assert!(extent > corner && extent < 1.2 * corner, "{extent}");
    assert_eq!(loaded.extent(), Extent::Within(loaded.bounds[0].unwrap()));
    let text = "[leaf.h]\nhalf_space = { point = [0, 0, 0], normal = [0, 0, 1] }";
    assert!(matches!(load_text(text, base), Err(LoadError::NoExtent { leaf }) if leaf == "h"));
    let text = "[leaf.h]\nhalf_space = { point = [0, 0, 0], normal = [0, 0, 1], extent = 3 }";
    load_text(text, base).unwrap().camera().unwrap();
}

#[test]
fn what_the_user_should_know_is_noted() {
    let text = "csg = 'a & b'\n[leaf.a]\nsphere = { centre = [0, 0, 0], radius = 1 }\n\
        [leaf.b]\nsphere = { centre = [9, 0, 0], radius = 1 }\n[leaf.c]\nsphere = { centre = [0, 0, 0], radius = 2 }";
    let loaded = load_text(text, Path::new(".")).unwrap();
    assert!(loaded.notes.contains(&SceneNote::CannotMeet));
    assert!(loaded.notes.contains(&SceneNote::Unused { leaf: "c".into() }));
    assert!(loaded.notes.iter().all(SceneNote::is_warning));
    loaded.camera().unwrap();
}

#[test]
fn callers_of_the_library_are_checked_too() {
    let cloud = |positions| LeafSource::Cloud(Arc::new(PointCloud { positions, ..Default::default() }));
    let load_one = |leaf: Leaf| {
        load(Scene::new(vec![leaf], Tree::leaf(LeafId(0))), &ReadOptions::default(), &NoProgress).map(|_| ())
    };
    load_one(Leaf::new("a", cloud(vec![DVec3::ZERO]))).unwrap();
    assert!(matches!(load_one(Leaf::new("a", cloud(vec![]))), Err(LoadError::Memory { .. })));
    assert!(matches!(load_one(Leaf::new("a", cloud(vec![DVec3::NAN]))), Err(LoadError::Memory { .. })));
    let mut flat = Leaf::new("a", cloud(vec![DVec3::ZERO]));
    flat.world_from_leaf = DAffine3::from_scale(DVec3::new(1.0, 0.0, 1.0));
    assert!(matches!(load_one(flat), Err(LoadError::Singular { .. })));
    let mut far = Leaf::new("a", cloud(vec![DVec3::ZERO]));
    far.world_from_leaf = DAffine3::from_translation(DVec3::X * 1e16);
    assert!(matches!(load_one(far), Err(LoadError::TooFar { .. })));
    for radius in [1e16, 1e300] {
        let huge = Solid::Sphere { centre: DVec3::ZERO, radius };
        assert!(matches!(load_one(Leaf::new("a", LeafSource::Solid(huge))), Err(LoadError::TooFar { .. })));
    }
    let sphere = Solid::Sphere { centre: DVec3::ZERO, radius: -1.0 };
    assert!(matches!(load_one(Leaf::new("a", LeafSource::Solid(sphere))), Err(LoadError::Solid { .. })));
    let mut sheet = Leaf::new("a", cloud(vec![DVec3::ZERO]));
    sheet.kind = LeafKind::Sheet;
    let tree = expression::parse("!a", &mut |_| Some(LeafId(0))).unwrap();
    let scene = Scene::new(vec![sheet], tree);
    assert!(matches!(load(scene, &ReadOptions::default(), &NoProgress), Err(LoadError::SheetCuts { .. })));
}
