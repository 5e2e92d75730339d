//! Logs: structured, to standard error, so that standard output stays free for results.

use std::io::IsTerminal;

use tracing_subscriber::EnvFilter;

/// The environment variable with the filter, `info` or `repose_planner=debug,warn`.
pub const LOG_VARIABLE: &str = "REPOSE_LOG";
/// The environment variable that switches to one JSON document a line when it is `json`.
pub const FORMAT_VARIABLE: &str = "REPOSE_LOG_FORMAT";

/// Starts logging. The filter is `REPOSE_LOG` where it is set and valid, `default` otherwise. Later calls in the same process do nothing.
pub fn start_logging(default: &str) {
    let filter = EnvFilter::try_from_env(LOG_VARIABLE).unwrap_or_else(|_| EnvFilter::new(default));
    // Color codes are for eyes: a file or a journal gets none.
    let colors = std::io::stderr().is_terminal();
    let subscriber = tracing_subscriber::fmt().with_env_filter(filter).with_ansi(colors).with_writer(std::io::stderr);
    // A log that nobody reads any more (`2>&1 | head`) is no reason to end: reporting that on standard error would panic.
    let subscriber = subscriber.log_internal_errors(false);
    let json = std::env::var(FORMAT_VARIABLE).is_ok_and(|v| v == "json");
    // An error here means that a subscriber is set already, by an embedding program or a test.
    let _already_set = if json { subscriber.json().try_init() } else { subscriber.try_init() };
}
