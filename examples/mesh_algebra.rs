//! Draws both sides of every law of Boolean algebra on random scenes of meshes, and tells which laws the pictures break:
//! `cargo run --release --example mesh_algebra -- [FIRST_SEED [END_SEED [SIDE]]]`, by default seeds 0 to 499 at 128².

use anyhow::{Context, ensure};
use rayon::prelude::*;
use surfcut::measure::algebra::broken_laws;

fn main() -> anyhow::Result<()> {
    let mut numbers = std::env::args().skip(1).map(|text| text.parse::<u32>().context("write whole numbers"));
    let mut next = |default: u32| numbers.next().unwrap_or(Ok(default));
    let (first, end, side) = (next(0)?, next(500)?, next(128)?);
    let found: Vec<(u32, Vec<_>)> = (first..end)
        .into_par_iter()
        .map(|seed| Ok((seed, broken_laws(u64::from(seed), side)?)))
        .collect::<anyhow::Result<_>>()?;
    let mut broken = 0;
    for (seed, laws) in found {
        for law in laws {
            println!("seed {seed}: {} pixels break {}", law.pixels, law.law);
            broken += 1;
        }
    }
    println!("{} scenes at {side}x{side}, {broken} laws broken", end.saturating_sub(first));
    ensure!(broken == 0, "the pictures break laws of Boolean algebra");
    Ok(())
}
