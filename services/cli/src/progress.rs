//! Progress of long commands, on standard error where that is a terminal.

use indicatif::{ProgressBar, ProgressStyle};

/// A bar over scenes.
pub fn progress_bar(scenes: u64, what: &str) -> ProgressBar {
    let bar = ProgressBar::new(scenes);
    if let Ok(style) = ProgressStyle::with_template(&format!("{{bar:40}} {{pos}}/{{len}} {what}, {{per_sec}}, {{eta}} left")) {
        bar.set_style(style);
    }
    bar
}
