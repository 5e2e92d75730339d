//! The paper's tables, regenerated: problems with a known truth, the outcome of each answer, rates with intervals, reports.
//!
//! [`scenes`] makes problems and judges answers by physics, [`statistics`] counts, [`tables`] tries many problems, [`report`] prints and
//! draws what came out. This crate may use any service's domain code; only the command line depends on it.
//!
//! ```
//! use repose_evaluation::statistics::rate::Rate;
//!
//! let rate: Rate = [true, true, false, true].into_iter().collect();
//! assert_eq!(rate.percent(), Some(75.0));
//! let [low, high] = rate.interval_percent();
//! assert!(low > 30.0 && high < 96.0, "four trials say little");
//! ```

pub mod report;
pub mod scenes;
pub mod statistics;
pub mod tables;
