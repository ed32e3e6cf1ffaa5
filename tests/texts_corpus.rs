//! Replays `tests/corpus/expression` and `tests/corpus/scene`: small valid texts, and what fuzzing found. None may panic,
//! and what is read must be sound.

#[path = "../fuzz/text_invariants.rs"]
mod text_invariants;

use std::path::Path;

/// The texts of a folder, in the order of their names.
fn texts(folder: &str) -> Vec<(String, String)> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/corpus").join(folder);
    let mut files: Vec<_> = std::fs::read_dir(path).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    assert!(!files.is_empty());
    files.iter().map(|file| (file.display().to_string(), std::fs::read_to_string(file).unwrap())).collect()
}

/// Checks every text whole, cut off before every character, without that character, and with it replaced by others.
fn replay(folder: &str, check: fn(&str)) {
    for (name, text) in texts(folder) {
        println!("{name}");
        check(&text);
        for (at, character) in text.char_indices() {
            let (before, after) = (&text[..at], &text[at + character.len_utf8()..]);
            check(before);
            check(&format!("{before}{after}"));
            for spoilt in ['"', ')', '\n', '\u{0}', '\u{10ffff}'] {
                check(&format!("{before}{spoilt}{after}"));
            }
        }
    }
}

#[test]
fn every_expression_of_the_corpus_is_read_or_refused() {
    replay("expression", text_invariants::check_expression);
}

#[test]
fn every_scene_of_the_corpus_is_read_or_refused() {
    replay("scene", text_invariants::check_scene);
}

/// A finding is called `found_…`; everything else must be valid, or cutting it off would test little.
fn seeds(folder: &str) -> Vec<(String, String)> {
    texts(folder).into_iter().filter(|(name, _)| !name.contains("found_")).collect()
}

#[test]
fn the_seeds_are_sound() {
    for (name, text) in seeds("scene") {
        let scene = surfcut::scene::toml_file::parse(&text, Path::new(""));
        assert!(scene.is_ok(), "{name}: {}", scene.unwrap_err());
    }
    for (name, text) in seeds("expression") {
        let tree = surfcut::csg::expression::parse(&text, &mut |_| Some(surfcut::csg::LeafId(0)));
        assert!(tree.is_ok(), "{name}: {}", tree.unwrap_err());
    }
}
