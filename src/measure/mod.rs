//! How good a picture is, and how fast: comparison with the truth, simulated scans, the accuracy suite, charts.
//!
//! * [`compare()`] measures one picture against the reference renderer's; [`outline`] finds the silhouettes and cut edges
//!   that it measures at, [`quality`] compares shaded images, [`difference`] paints what differs.
//! * [`simulate`] samples analytic solids as a scanner or a modeller would; [`scanner`] casts a scanner's rays, so that
//!   occlusion is real. All randomness comes from [`rng`].
//! * [`scenes`] holds the accuracy suite, [`sweeps`] what is pushed until methods break; both are data that become
//!   ordinary scenes, in memory or on disk ([`scene_files`]). [`suite`] runs them through any pipeline and writes tables;
//!   [`open`] gives it the reference renderer as truth.
//! * [`unknown_search`] looks for scenes in which the paper's rule for unknown leaves fails.
//! * [`algebra`] holds pictures of meshes against the laws of Boolean algebra.
//! * [`styles`] measures pictures in styles; [`line_likeness`] compares line drawings, and the layers of two pipelines.
//! * [`chart`] draws accuracy against time, and growth.

pub mod algebra;
pub mod chart;
pub mod compare;
pub mod difference;
pub mod distance;
pub mod line_likeness;
pub mod open;
pub mod outline;
pub mod quality;
pub mod rng;
pub mod scanner;
pub mod scene_files;
pub mod scenes;
pub mod simulate;
pub mod styles;
pub mod suite;
pub mod sweeps;
pub mod unknown_search;

pub use compare::{CompareError, Comparison, compare};
pub use outline::find_cut_edge;
pub use simulate::{ScanOptions, scan};
