//! What must hold of whatever the readers of expressions and scene files return, for the fuzz targets and for the test that
//! replays their findings.

// The targets use one half each.
#![allow(dead_code)]

use std::path::Path;

use surfcut::csg::LeafId;
use surfcut::csg::expression::{ExpressionError, parse};
use surfcut::scene::toml_file;
use surfcut::space::Camera;

/// Reads `text` as an expression over whatever names it uses, and over none.
pub fn check_expression(text: &str) {
    let mut names: Vec<String> = Vec::new();
    let result = parse(text, &mut |name| Some(interned(&mut names, name)));
    match &result {
        Ok(tree) => {
            // What is printed reads back to the same tree, with the same names in the same places.
            let printed = tree.display(|leaf| &names[leaf.0 as usize]).to_string();
            let mut again = names.clone();
            assert_eq!(parse(&printed, &mut |name| Some(interned(&mut again, name))).as_ref(), Ok(tree), "{printed}");
            assert_eq!(again, names, "{printed}");
            // Pushing complements to the leaves changes no value.
            let positive = tree.positive();
            for bit in 0..4 {
                let inside = |leaf: LeafId| leaf.0 >> (bit % 2) & 1 == bit / 2;
                assert_eq!(tree.eval(inside), positive.eval(inside), "{printed}");
            }
        }
        Err(error) => check_expression_error(text, error),
    }
    match parse(text, &mut |_| None) {
        Ok(_) => panic!("an expression without leaves: {text:?}"),
        Err(error) => check_expression_error(text, &error),
    }
}

fn interned(names: &mut Vec<String>, name: &str) -> LeafId {
    let place = names.iter().position(|known| known == name).unwrap_or_else(|| {
        names.push(name.to_owned());
        names.len() - 1
    });
    LeafId(place as u32)
}

fn check_expression_error(text: &str, error: &ExpressionError) {
    assert!(error.offset() <= text.len() && text.is_char_boundary(error.offset()), "{text:?}: {error}");
    assert!(!error.to_string().is_empty());
}

/// Reads `text` as a scene file.
pub fn check_scene(text: &str) {
    match toml_file::parse(text, Path::new("")) {
        Ok(scene) => {
            assert!(!scene.leaves.is_empty());
            assert!(scene.tree.leaves().iter().all(|leaf| (leaf.0 as usize) < scene.leaves.len()));
            let sides = 1..=Camera::MAX_SIDE;
            assert!(sides.contains(&scene.size.0) && sides.contains(&scene.size.1));
            assert!(scene.background.iter().flatten().all(|channel| channel.is_finite()));
            if let Some(camera) = &scene.camera {
                assert!(camera.camera(scene.size).is_ok());
            }
            for leaf in &scene.leaves {
                assert!(!leaf.name.is_empty());
                assert!((0.0..=1.0).contains(&leaf.opacity));
                assert!(leaf.spacing.is_none_or(|spacing| spacing > 0.0 && spacing.is_finite()));
                assert!(leaf.world_from_leaf.is_finite());
                assert!(leaf.colour.iter().flatten().all(|channel| channel.is_finite()));
            }
        }
        Err(error) => {
            // The place is in the text, or one past its end.
            let lines: Vec<&str> = text.split('\n').collect();
            let place = error.place;
            assert!(place.line >= 1 && place.column >= 1, "{text:?}: {error}");
            let line = lines.get(place.line - 1).unwrap_or_else(|| panic!("{text:?}: {error}"));
            assert!(place.column <= line.chars().count() + 1, "{text:?}: {error}");
            assert!(!error.to_string().is_empty());
        }
    }
}
