//! Searches seeded random scenes for those in which the paper's rule for unknown leaves fails and the resolved rule does
//! not, and prints the worst as a table.
//!
//! ```text
//! cargo run --release --example search_unknown            # seeds 0 to 999
//! cargo run --release --example search_unknown 5000 9000  # others
//! ```

use surfcut::measure::suite::short;
use surfcut::measure::unknown_search::{Found, judge, random_case};

fn main() -> anyhow::Result<()> {
    let bounds: Vec<u64> = std::env::args().skip(1).map(|text| text.parse()).collect::<Result<_, _>>()?;
    let (first, end) = match bounds[..] {
        [] => (0, 1000),
        [count] => (0, count),
        [first, end, ..] => (first, end),
    };
    let mut found: Vec<Found> = Vec::new();
    for seed in first..end {
        match judge(seed) {
            Ok(judged) => found.extend(judged),
            Err(error) => eprintln!("seed {seed}: {error}"),
        }
    }
    let share = |count: usize| 100.0 * count as f64 / found.len().max(1) as f64;
    // A thousandth of the picture: what flat disks and edges leave is below it.
    const SHOWS: f64 = 1e-3;
    let count = |shows: &dyn Fn(&Found) -> bool| found.iter().filter(|f| shows(f)).count();
    println!("{} scenes; {} are empty", found.len(), (end - first) as usize - found.len());
    let lost = count(&|f| f.lost() > SHOWS);
    let won = count(&|f| -f.lost() > SHOWS);
    let ours = count(&|f| f.ours > SHOWS);
    println!(
        "the paper's rule is worse in {lost} ({} %), better in {won} ({} %)",
        short(share(lost)),
        short(share(won))
    );
    println!("the defaults are wrong in {ours} ({} %)", short(share(ours)));
    let table = |title: &str, key: &dyn Fn(&Found) -> f64| {
        const LINES: usize = 10;
        let mut sorted = found.clone();
        sorted.sort_by(|a, b| key(b).total_cmp(&key(a)).then(a.seed.cmp(&b.seed)));
        println!(
            "\n{title}\n\n| seed | expression | points | paper wrong % | resolved | defaults |\n|---|---|---|---|---|---|"
        );
        for f in sorted.iter().filter(|f| key(f) > SHOWS).take(LINES) {
            let case = random_case(f.seed);
            let points: Vec<String> = case.leaves.iter().map(|leaf| leaf.scan.count.to_string()).collect();
            let [paper, resolved, ours] = [f.paper, f.resolved, f.ours].map(|share| short(100.0 * share));
            let csg = case.csg.replace('|', "\\|");
            println!("| {} | `{csg}` | {} | {paper} | {resolved} | {ours} |", f.seed, points.join(", "));
        }
    };
    table("Worst for the paper's rule", &|f| f.lost());
    table("Worst for the resolved rule", &|f| -f.lost());
    table("Worst for the defaults", &|f| f.ours);
    Ok(())
}
