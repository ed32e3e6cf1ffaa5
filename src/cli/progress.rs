//! Progress bars: on a terminal, never in a pipe, never with `--quiet`.

use std::io::IsTerminal;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use surfcut::formats::Progress;

/// Makes bars, or bars that nobody sees.
#[derive(Debug, Clone, Copy)]
pub struct Bars {
    is_visible: bool,
}

impl Bars {
    /// Visible where standard error is a terminal and the user wants to see them.
    pub fn new(quiet: bool) -> Self {
        Self { is_visible: !quiet && std::io::stderr().is_terminal() }
    }

    /// Bars that nobody sees.
    pub fn hidden() -> Self {
        Self { is_visible: false }
    }

    /// A bar over bytes, whose length grows with every file.
    pub fn bytes(&self, what: &'static str) -> BytesBar {
        BytesBar(self.bar(0, what, "{msg:>12} {bar:40} {bytes}/{total_bytes} {bytes_per_sec}"))
    }

    /// A bar over `count` things.
    pub fn count(&self, count: u64, what: &'static str) -> ProgressBar {
        self.bar(count, what, "{msg:>12} {bar:40} {pos}/{len} {eta}")
    }

    fn bar(&self, length: u64, what: &'static str, template: &str) -> ProgressBar {
        let bar = ProgressBar::with_draw_target(Some(length), ProgressDrawTarget::hidden());
        if self.is_visible {
            bar.set_draw_target(ProgressDrawTarget::stderr());
        }
        // Both templates are known to be sound; a plain bar would do as well.
        let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
        bar.with_style(style).with_message(what)
    }
}

/// Bytes read, over all files.
#[derive(Debug)]
pub struct BytesBar(ProgressBar);

impl Progress for BytesBar {
    fn set_len(&self, bytes: u64) {
        self.0.inc_length(bytes);
    }
    fn advance(&self, bytes: u64) {
        self.0.inc(bytes);
    }
}

impl Drop for BytesBar {
    fn drop(&mut self) {
        self.0.finish_and_clear();
    }
}
