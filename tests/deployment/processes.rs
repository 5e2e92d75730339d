//! Processes whose log is read while they run.

use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

use crate::common::{PATIENCE, Process};

/// A process and what it has logged so far.
pub struct Logged {
    /// Killed when this goes.
    _process: Process,
    lines: Arc<(Mutex<Vec<String>>, Condvar)>,
}

impl Logged {
    /// Starts a command with its log on a pipe.
    pub fn start(mut command: Command) -> Self {
        let mut child = command.stderr(Stdio::piped()).stdout(Stdio::null()).spawn().expect("the process starts");
        let log = BufReader::new(child.stderr.take().expect("its log"));
        let lines: Arc<(Mutex<Vec<String>>, Condvar)> = Arc::default();
        let told = lines.clone();
        std::thread::spawn(move || {
            for line in log.lines().map_while(Result::ok) {
                told.0.lock().unwrap_or_else(PoisonError::into_inner).push(line);
                told.1.notify_all();
            }
        });
        Self { _process: Process(child), lines }
    }

    /// Waits for a line that holds a text, and returns it.
    pub fn line(&self, text: &str) -> String {
        self.line_within(text, PATIENCE).unwrap_or_else(|| panic!("no line with {text:?} in:\n{}", self.log()))
    }

    /// The same, if it comes in time.
    pub fn line_within(&self, text: &str, bound: Duration) -> Option<String> {
        let give_up = Instant::now() + bound;
        let mut lines = self.lines.0.lock().unwrap_or_else(PoisonError::into_inner);
        loop {
            if let Some(line) = lines.iter().find(|line| line.contains(text)) {
                return Some(line.clone());
            }
            let left = give_up.checked_duration_since(Instant::now())?;
            lines = self.lines.1.wait_timeout(lines, left).unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// Everything so far.
    pub fn log(&self) -> String {
        self.lines.0.lock().unwrap_or_else(PoisonError::into_inner).join("\n")
    }
}
