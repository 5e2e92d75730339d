//! Progress of long commands, on standard error: a bar where that is a terminal, a line now and then where it is a log.

use std::io::IsTerminal;
use std::sync::Mutex;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

/// How often a bar is drawn anew although nothing was done: its clock shows that the program is alive.
const TICK: Duration = Duration::from_millis(500);
/// How often a log is told.
const LOG_EVERY: Duration = Duration::from_secs(10);

/// How much of a known number of things is done.
pub struct Progress {
    bar: ProgressBar,
    what: String,
    /// When the log was told last; none where a bar is shown.
    logged: Option<Mutex<Instant>>,
}

impl Progress {
    /// Nothing of `total` done yet; `what` names the things: "scenes".
    pub fn new(total: u64, what: &str) -> Self {
        let bar = ProgressBar::new(total);
        if let Ok(style) = ProgressStyle::with_template(&format!("{{bar:40}} {{pos}}/{{len}} {what}, {{elapsed}} so far, {{eta}} left")) {
            bar.set_style(style);
        }
        let is_terminal = std::io::stderr().is_terminal();
        if is_terminal {
            bar.enable_steady_tick(TICK);
        }
        Self { bar, what: what.to_owned(), logged: (!is_terminal).then(|| Mutex::new(Instant::now())) }
    }

    /// So many more are done.
    pub fn add(&self, count: u64) {
        self.bar.inc(count);
        self.log();
    }

    /// So many are done.
    pub fn set(&self, done: u64) {
        self.bar.set_position(done);
        self.log();
    }

    /// Everything is done, or the rest will not be.
    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }

    fn log(&self) {
        let Some(logged) = &self.logged else { return };
        // Whoever comes while another thread writes has nothing newer to say.
        let Ok(mut last) = logged.try_lock() else { return };
        if last.elapsed() >= LOG_EVERY {
            *last = Instant::now();
            let (done, total) = (self.bar.position(), self.bar.length().unwrap_or_default());
            tracing::info!(done, total, seconds = self.bar.elapsed().as_secs(), "{} done", self.what);
        }
    }
}
