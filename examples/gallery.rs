//! Draws the pictures of `docs/gallery.md`: every line of it that begins with `surfcut render` is run.
//!
//! ```text
//! cargo build --release && cargo run --release --example gallery          # all
//! cargo run --release --example gallery -- spanner                         # those whose line contains a word
//! ```

use std::path::Path;
use std::process::Command;

use anyhow::{Context, ensure};

fn main() -> anyhow::Result<()> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    // An example lies beside the program, one folder down.
    let example = std::env::current_exe()?;
    let folder = example.parent().and_then(Path::parent).context("an example has a folder")?;
    let program = folder.join(format!("surfcut{}", std::env::consts::EXE_SUFFIX));
    ensure!(program.exists(), "{}: build it first: cargo build --release", program.display());
    let text = std::fs::read_to_string(root.join("docs/gallery.md"))?;
    for line in text.lines().filter(|line| line.starts_with("surfcut render")) {
        if !words.iter().all(|word| line.contains(word.as_str())) {
            continue;
        }
        println!("{line}");
        let status = Command::new(&program)
            .args(line.split_whitespace().skip(1))
            .args(["--overwrite", "-q"])
            .current_dir(root)
            .status()?;
        ensure!(status.success(), "it ended with {status}");
    }
    Ok(())
}
