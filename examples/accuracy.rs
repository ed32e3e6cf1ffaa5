//! Runs the accuracy suite, the scenes about unknown leaves and the stability sweeps through the surfel pipeline, judged by
//! the reference renderer, and prints the tables of `docs/measurements.md`.
//!
//! ```text
//! cargo run --release --example accuracy                  # the accuracy suite and its chart
//! cargo run --release --example accuracy -- large         # holes at 1024²
//! cargo run --release --example accuracy -- unknown       # the scenes about unknown leaves
//! cargo run --release --example accuracy -- sweeps        # the stability sweeps, every inside test and clip mode
//! cargo run --release --example accuracy -- suite torus   # only cases whose name contains `torus`
//! ```
//!
//! The chart and all figures go to `target/accuracy`. Sweeps are drawn at 256² and untimed: they tell where a method fails, not
//! how fast.

use std::path::{Path, PathBuf};

use surfcut::layers::LayerLimit;
use surfcut::measure::chart::Chart;
use surfcut::measure::open::{open_reference, open_surfels};
use surfcut::measure::scenes::{Case, accuracy_cases, unknown_cases};
use surfcut::measure::suite::{DrawError, Drawer, Measured, Outcome, Row, Setting, SuiteOptions, Table, run, short};
use surfcut::measure::sweeps::sweeps;
use surfcut::measure::unknown_search::{WORST, random_case};
use surfcut::output::Destination;
use surfcut::scene::Scene;
use surfcut::splat::{Clip, Inside, SplatSettings};

/// How the suite is run: three timed frames a picture.
const SUITE: SuiteOptions = SuiteOptions { repeats: 3, size: None };

/// How holes are looked for in pictures that are finer than what scans are sampled for.
const LARGE: SuiteOptions = SuiteOptions { repeats: 0, size: Some((1024, 1024)) };

/// How the sweeps are run.
const SWEEPS: SuiteOptions = SuiteOptions { repeats: 0, size: Some((256, 256)) };

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let what = arguments.first().map_or("suite", String::as_str);
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("target/accuracy");
    std::fs::create_dir_all(&folder)?;
    let chosen =
        |case: &Case| arguments.len() < 2 || arguments[1..].iter().any(|part| case.name.contains(part.as_str()));
    match what {
        "suite" => {
            let cases: Vec<Case> = accuracy_cases().into_iter().filter(chosen).collect();
            let table = measured(&cases, &two_settings(), SUITE);
            print!("{}", table.markdown());
            let chart = Chart::accuracy_against_time("Accuracy against frame time, 1×", table.accuracy_series(1.0));
            for (extension, content) in chart.files()? {
                write(&folder.join(format!("accuracy.{extension}")), &content)?;
            }
            write(&folder.join("accuracy_rows.json"), serde_json::to_string_pretty(&table)?.as_bytes())
        }
        "large" => {
            let unzoomed = |case: Case| Case { zooms: vec![1.0], ..case };
            let cases: Vec<Case> = accuracy_cases().into_iter().filter(chosen).map(unzoomed).collect();
            print!("{}", measured(&cases, &[setting("surface curved", SplatSettings::default())], LARGE).markdown());
            Ok(())
        }
        "unknown" => {
            let cases: Vec<Case> = unknown_cases().into_iter().chain(WORST.map(random_case)).filter(chosen).collect();
            print!("{}", measured(&cases, &two_settings(), SUITE).markdown());
            Ok(())
        }
        "sweeps" => {
            for sweep in sweeps() {
                let cases: Vec<Case> = sweep.cases.into_iter().filter(chosen).collect();
                if cases.is_empty() {
                    continue;
                }
                let table = measured(&cases, &every_setting(), SWEEPS);
                println!("\n### {}\n", sweep.name);
                print!("{}", table.pivot(sweep.parameter, &edge_and_holes));
                let rows = serde_json::to_string_pretty(&table)?;
                write(&folder.join(format!("{}.json", sweep.name)), rows.as_bytes())?;
            }
            Ok(())
        }
        other => anyhow::bail!("`{other}` is none of suite, large, unknown, sweeps"),
    }
}

fn setting(name: impl Into<String>, value: SplatSettings) -> Setting<SplatSettings> {
    Setting { name: name.into(), value }
}

/// Ours and the paper's.
fn two_settings() -> Vec<Setting<SplatSettings>> {
    vec![setting("surface curved", SplatSettings::default()), setting("paper", SplatSettings::PAPER)]
}

/// Every inside test under both clip modes, and the paper's rules.
fn every_setting() -> Vec<Setting<SplatSettings>> {
    let both = [Clip::Surface, Clip::Fragment].into_iter();
    let named = |clip: Clip, inside: Inside| {
        let value = SplatSettings { clip, inside, ..SplatSettings::default() };
        setting(format!("{} {}", clip.name(), inside.name()), value)
    };
    let mut all: Vec<_> = both.flat_map(|clip| Inside::ALL.map(|inside| named(clip, inside))).collect();
    all.push(setting("paper", SplatSettings::PAPER));
    all
}

/// A cell of the sweeps' tables: `edge_px`, and the pixels that are holes or spill, where there are any.
fn edge_and_holes(measured: &Measured) -> String {
    let c = &measured.comparison;
    let edge_px = c.edge_px.map_or_else(|| format!("{} %", short(100.0 * c.wrong_pixels)), short);
    let counts = [(c.holes, "h"), (c.spill, "s")].into_iter().filter(|(count, _)| *count > 0);
    counts.fold(edge_px, |cell, (count, letter)| format!("{cell} {count}{letter}"))
}

fn measured(cases: &[Case], settings: &[Setting<SplatSettings>], options: SuiteOptions) -> Table {
    let open = |scene: &Scene, settings: &SplatSettings| -> Result<Drawer, DrawError> {
        open_surfels(scene, LayerLimit::Nearest, *settings)
    };
    let open_truth = |scene: &Scene| open_reference(scene, LayerLimit::Nearest);
    run(cases, settings, &open, &open_truth, options, &mut say)
}

fn say(row: &Row) {
    let state = match &row.outcome {
        Outcome::Failed(reason) => format!("failed: {reason}"),
        Outcome::Measured(measured) => {
            let c = &measured.comparison;
            let verdict = if row.passes() { "" } else { "  misses its bar" };
            let edge_px = c.edge_px.map_or("none".to_owned(), short);
            format!("edge_px {edge_px}, wrong {} %, {} holes{verdict}", short(100.0 * c.wrong_pixels), c.holes)
        }
    };
    eprintln!("{} {}×: {state}", row.case, row.zoom);
}

fn write(path: &Path, content: &[u8]) -> anyhow::Result<()> {
    Ok(Destination::File(path.to_owned()).write(true, content)?)
}
