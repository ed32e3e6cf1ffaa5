//! Replays the files of `tests/corpus`: small valid ones, and what fuzzing found. None may panic, and what is read must be
//! sound.

#[path = "../fuzz/invariants.rs"]
mod invariants;

use surfcut::formats::Format;

#[test]
fn every_file_of_the_corpus_is_read_or_refused() {
    for (folder, format) in [("ply", Format::Ply), ("stl", Format::Stl), ("obj", Format::Obj), ("xyz", Format::Xyz)] {
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/corpus").join(folder);
        let mut files: Vec<_> = std::fs::read_dir(path).unwrap().map(|entry| entry.unwrap().path()).collect();
        files.sort();
        assert!(!files.is_empty());
        for file in files {
            let bytes = std::fs::read(&file).unwrap();
            println!("{}", file.display());
            invariants::check(Some(format), &bytes);
            invariants::check(None, &bytes);
            // Cut off at every length, and with every byte spoilt: the commonest damage.
            for length in 0..bytes.len() {
                invariants::check(Some(format), &bytes[..length]);
                let mut spoilt = bytes.clone();
                spoilt[length] = !spoilt[length];
                invariants::check(Some(format), &spoilt);
            }
        }
    }
}
