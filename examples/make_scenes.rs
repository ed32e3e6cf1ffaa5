//! Writes the accuracy suite, the scenes about unknown leaves and the stability sweeps to disk, as scene files with their
//! scans, so that the command line draws what the tables are made of:
//!
//! ```text
//! cargo run --release --example make_scenes            # all, into data/generated
//! cargo run --release --example make_scenes torus      # those whose name contains `torus`
//! surfcut render data/generated/torus_4500.toml -o torus.png
//! ```

use std::path::Path;

use surfcut::measure::scenes::{accuracy_cases, speed_head, unknown_cases};
use surfcut::measure::sweeps::sweeps;

fn main() -> anyhow::Result<()> {
    let wanted: Vec<String> = std::env::args().skip(1).collect();
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/generated");
    let swept = sweeps().into_iter().flat_map(|sweep| sweep.cases);
    for case in accuracy_cases().into_iter().chain(unknown_cases()).chain([speed_head()]).chain(swept) {
        if wanted.is_empty() || wanted.iter().any(|part| case.name.contains(part.as_str())) {
            println!("{}", case.write(&folder)?.display());
        }
    }
    Ok(())
}
