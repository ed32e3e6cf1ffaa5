//! Writes the accuracy suite, the scenes about unknown leaves and the stability sweeps to disk, as scene files with their
//! scans, so that the command line draws what the tables are made of:
//!
//! ```text
//! cargo run --release --example make_scenes            # all, into data/generated
//! cargo run --release --example make_scenes torus      # those whose name contains `torus`
//! cargo run --release --example make_scenes unknown_seed_37 # a scene of `search_unknown` by its seed
//! surfcut render data/generated/torus_4500.toml -o torus.png
//! ```

use std::path::Path;

use surfcut::measure::scenes::{accuracy_cases, figure_2, speed_head, unknown_cases};
use surfcut::measure::sweeps::sweeps;
use surfcut::measure::unknown_search::{WORST, random_case};

fn main() -> anyhow::Result<()> {
    let wanted: Vec<String> = std::env::args().skip(1).collect();
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/generated");
    let seeds = wanted.iter().filter_map(|name| name.strip_prefix("unknown_seed_")?.parse().ok());
    let searched = WORST.into_iter().chain(seeds).map(random_case);
    let swept = sweeps().into_iter().flat_map(|sweep| sweep.cases);
    for case in accuracy_cases()
        .into_iter()
        .chain(unknown_cases())
        .chain([figure_2(), speed_head()])
        .chain(searched)
        .chain(swept)
    {
        if wanted.is_empty() || wanted.iter().any(|part| case.name.contains(part.as_str())) {
            println!("{}", case.write(&folder)?.display());
        }
    }
    Ok(())
}
