//! What everybody who follows the robots of a cell reckons with: perception, motion and the console.

use std::time::Duration;

/// Robots of a cell that are followed.
pub const MAX_ROBOTS: usize = 16;
/// A robot that has told nothing for longer than this is silent: states come twenty times a second or more often.
pub const SILENT: Duration = Duration::from_secs(2);
/// Bases within this are one robot's, under two names, metres: no two arms stand there.
pub const SAME_BASE_M: f64 = 0.1;
