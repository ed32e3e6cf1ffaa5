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
    // A thousandth of the picture: what flat disks and edges leave is below it.
    const SHOWS: f64 = 1e-3;
    let (mut found, mut empty): (Vec<Found>, Vec<Found>) = Default::default();
    for seed in first..end {
        match judge(seed) {
            Ok(judged) if judged.is_empty => empty.push(judged),
            Ok(judged) => found.push(judged),
            Err(error) => eprintln!("seed {seed}: {error}"),
        }
    }
    let count = |of: &[Found], shows: &dyn Fn(&Found) -> bool| of.iter().filter(|f| shows(f)).count();
    let share = |count: usize| short(100.0 * count as f64 / found.len().max(1) as f64);
    let lost = count(&found, &|f| f.lost() > SHOWS);
    let won = count(&found, &|f| -f.lost() > SHOWS);
    let ours = count(&found, &|f| f.ours > SHOWS);
    println!("{} scenes; the result of {} is empty", found.len() + empty.len(), empty.len());
    println!(
        "of the {} others the paper's rule is worse in {lost} ({} %), better in {won} ({} %);",
        found.len(),
        share(lost),
        share(won)
    );
    println!("the defaults are wrong in {ours} ({} %)", share(ours));
    let [paper, resolved, ours] = [|f: &Found| f.paper, |f: &Found| f.resolved, |f: &Found| f.ours]
        .map(|wrong| count(&empty, &|f| wrong(f) > 0.0));
    println!(
        "of the empty ones the paper's rule draws something in {paper}, the resolved rule in {resolved}, the defaults in {ours}"
    );
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
