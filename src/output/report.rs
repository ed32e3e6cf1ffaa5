//! The summary of a run: what it did, how long each phase took, what it used. Written as JSON.

use std::collections::BTreeMap;
use std::ops::{Add, Sub};
use std::time::Instant;

use serde::Serialize;

use super::resources::{cpu_ms, peak_memory_bytes};

/// Time that a phase took.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Times {
    /// Wall time in milliseconds.
    pub ms: f64,
    /// Processor time of all threads in milliseconds.
    pub cpu_ms: f64,
}

impl Add for Times {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self { ms: self.ms + other.ms, cpu_ms: self.cpu_ms + other.cpu_ms }
    }
}

impl Sub for Times {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        Self { ms: self.ms - other.ms, cpu_ms: self.cpu_ms - other.cpu_ms }
    }
}

/// A phase under way.
#[derive(Debug, Clone, Copy)]
pub struct Stopwatch {
    wall: Instant,
    cpu_ms: f64,
}

impl Stopwatch {
    /// Starts one.
    pub fn start() -> Self {
        Self { wall: Instant::now(), cpu_ms: cpu_ms() }
    }

    /// Time since the start.
    pub fn times(&self) -> Times {
        Times { ms: self.wall.elapsed().as_secs_f64() * 1e3, cpu_ms: cpu_ms() - self.cpu_ms }
    }
}

/// Medians over repeated frames.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct FrameTimes {
    /// Median wall time in milliseconds.
    pub ms: f64,
    /// Median processor time of all threads in milliseconds.
    pub cpu_ms: f64,
    /// Frames measured, the warm-up not among them.
    pub repeats: usize,
}

impl FrameTimes {
    /// The medians of `frames`; `None` where there is none.
    pub fn median(frames: &[Times]) -> Option<Self> {
        let median = |value: fn(&Times) -> f64| {
            let mut values: Vec<f64> = frames.iter().map(value).collect();
            values.sort_by(f64::total_cmp);
            let upper = *values.get(values.len() / 2)?;
            let lower = values[(values.len() - 1) / 2];
            Some(0.5 * (lower + upper))
        };
        Some(Self { ms: median(|t| t.ms)?, cpu_ms: median(|t| t.cpu_ms)?, repeats: frames.len() })
    }
}

/// The summary of a run. Keys are stable: other programs read them.
#[derive(Debug, Clone, Serialize)]
pub struct Report {
    /// The version that ran.
    pub surfcut: &'static str,
    /// The command line.
    pub command: Vec<String>,
    /// The scene's name.
    pub scene: Option<String>,
    /// The unit of lengths.
    pub units: Option<String>,
    /// Settings in force, by name.
    pub settings: BTreeMap<String, serde_json::Value>,
    /// Each phase's times, by name: load, convert, classify, partners, splat, composite …
    pub phases: BTreeMap<String, Times>,
    /// Medians over frames.
    pub frame: Option<FrameTimes>,
    /// Counts, by name: leaves, surfels, edge surfels, pixels covered …
    pub counts: BTreeMap<String, u64>,
    /// Shares from 0 to 1, by name, such as what a limit of layers leaves out; the largest over frames.
    pub shares: BTreeMap<String, f64>,
    /// Peak memory in bytes, where the system tells.
    pub peak_memory_bytes: Option<u64>,
    /// Threads used.
    pub threads: usize,
    /// What the user should know.
    pub warnings: Vec<String>,
}

impl Report {
    /// An empty report for `command`.
    pub fn new(command: Vec<String>) -> Self {
        Self {
            surfcut: env!("CARGO_PKG_VERSION"),
            command,
            scene: None,
            units: None,
            settings: BTreeMap::new(),
            phases: BTreeMap::new(),
            frame: None,
            counts: BTreeMap::new(),
            shares: BTreeMap::new(),
            peak_memory_bytes: None,
            threads: rayon::current_num_threads(),
            warnings: Vec::new(),
        }
    }

    /// Runs `work` as a phase called `name`; phases of one name add up.
    pub fn phase<T>(&mut self, name: &str, work: impl FnOnce() -> T) -> T {
        let watch = Stopwatch::start();
        let result = work();
        self.add_phase(name, watch.times());
        result
    }

    /// Adds `times` to the phase called `name`.
    pub fn add_phase(&mut self, name: &str, times: Times) {
        let sum = self.phases.entry(name.to_owned()).or_default();
        sum.ms += times.ms;
        sum.cpu_ms += times.cpu_ms;
    }

    /// Sets the count called `name`.
    pub fn count(&mut self, name: &str, value: u64) {
        self.counts.insert(name.to_owned(), value);
    }

    /// Sets the share called `name`, unless it is larger already.
    pub fn share(&mut self, name: &str, value: f64) {
        let share = self.shares.entry(name.to_owned()).or_default();
        *share = share.max(value);
    }

    /// The report as JSON, with peak memory as of now, and a newline at the end.
    pub fn to_json(&mut self) -> String {
        self.peak_memory_bytes = peak_memory_bytes();
        // Strings as keys and finite numbers: nothing here can fail to be JSON (infinities become null).
        let mut text = serde_json::to_string_pretty(self).unwrap_or_else(|error| format!("{{\"error\": \"{error}\"}}"));
        text.push('\n');
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_report_is_json_with_the_promised_keys() {
        let mut report = Report::new(vec!["surfcut".into(), "render".into()]);
        assert_eq!(report.phase("load", || 7), 7);
        report.phase("load", || ());
        report.count("surfels", 12);
        let frames = [3.0, 1.0, 2.0].map(|ms| Times { ms, cpu_ms: 2.0 * ms });
        report.frame = FrameTimes::median(&frames);
        let json: serde_json::Value = serde_json::from_str(&report.to_json()).unwrap();
        assert_eq!(json["frame"]["ms"], 2.0);
        assert_eq!(json["frame"]["cpu_ms"], 4.0);
        assert_eq!(json["frame"]["repeats"], 3);
        assert_eq!(json["counts"]["surfels"], 12);
        assert!(json["phases"]["load"]["cpu_ms"].is_number());
        assert_eq!(FrameTimes::median(&[]), None);
        assert_eq!(FrameTimes::median(&frames[..2]).unwrap().ms, 2.0);
    }
}
