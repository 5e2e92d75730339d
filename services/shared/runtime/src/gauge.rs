//! What a worker knows of its own load: a smoothed time per job, and counts of what waits and what runs.

use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::time::Duration;

use repose_proto::load::WorkerLoad;

/// Weight of the newest job in the smoothed service time.
const SMOOTHING: f64 = 0.2;

/// Counts and times, shared between the threads that work and the one that reports.
#[derive(Debug, Default)]
pub struct LoadGauge {
    waiting: AtomicUsize,
    running: AtomicUsize,
    /// The smoothed time as the bits of an `f64`; 0 before the first job.
    service_ms: AtomicU64,
    /// How far times are from it, smoothed, likewise.
    spread_ms: AtomicU64,
}

impl LoadGauge {
    /// Jobs that wait.
    pub fn waiting(&self) -> usize {
        self.waiting.load(Ordering::Relaxed)
    }

    /// Jobs that are being computed.
    pub fn running(&self) -> usize {
        self.running.load(Ordering::Relaxed)
    }

    /// Smoothed time to serve one job, milliseconds; 0 before the first.
    pub fn service_ms(&self) -> f64 {
        f64::from_bits(self.service_ms.load(Ordering::Relaxed))
    }

    /// Smoothed distance of single times from [`Self::service_ms`], milliseconds.
    pub(crate) fn spread_ms(&self) -> f64 {
        f64::from_bits(self.spread_ms.load(Ordering::Relaxed))
    }

    pub(crate) fn set_waiting(&self, waiting: usize) {
        self.waiting.store(waiting, Ordering::Relaxed);
    }

    pub(crate) fn started(&self, jobs: usize) {
        self.running.fetch_add(jobs, Ordering::Relaxed);
    }

    /// Counts `jobs` as done that took `elapsed` together.
    pub(crate) fn finished(&self, jobs: usize, elapsed: Duration) {
        self.running.fetch_sub(jobs, Ordering::Relaxed);
        let each_ms = elapsed.as_secs_f64() * 1e3 / jobs.max(1) as f64;
        let smooth = |old: f64, new: f64| if old == 0.0 { new } else { old + SMOOTHING * (new - old) };
        // The closures never decline.
        let update = |bits| Some(smooth(f64::from_bits(bits), each_ms).to_bits());
        let before = self.service_ms.fetch_update(Ordering::Relaxed, Ordering::Relaxed, update);
        if let Some(before_ms) = before.ok().map(f64::from_bits).filter(|before_ms| *before_ms > 0.0) {
            let update = |bits| Some(smooth(f64::from_bits(bits), (each_ms - before_ms).abs()).to_bits());
            let _previous = self.spread_ms.fetch_update(Ordering::Relaxed, Ordering::Relaxed, update);
        }
    }

    /// Counts `jobs` as over that were refused after they had started: how long that took says nothing of those that are served.
    pub(crate) fn refused(&self, jobs: usize) {
        self.running.fetch_sub(jobs, Ordering::Relaxed);
    }

    /// When a refused job may be worth another try, milliseconds: once half of what is here is done by `threads`.
    pub fn retry_after_ms(&self, threads: usize) -> u64 {
        let jobs = (self.waiting() + self.running()) as f64;
        (jobs / 2.0 * self.service_ms() / threads.max(1) as f64).clamp(1.0, 10_000.0) as u64
    }
}

/// A load made of a queue's gauge; the caller adds weights and kernel where it has any.
pub fn load_of(gauge: &LoadGauge, queue_capacity: usize) -> WorkerLoad {
    WorkerLoad {
        queue_depth: gauge.waiting(),
        queue_capacity,
        in_flight: gauge.running(),
        service_ms: gauge.service_ms(),
        ..WorkerLoad::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_service_time_starts_at_the_first_job_and_then_moves_slowly() {
        let gauge = LoadGauge::default();
        gauge.started(2);
        gauge.finished(2, Duration::from_millis(20));
        assert!((gauge.service_ms() - 10.0).abs() < 1e-9);
        gauge.started(1);
        gauge.finished(1, Duration::from_millis(20));
        assert!((gauge.service_ms() - 12.0).abs() < 1e-9);
        assert!((gauge.spread_ms() - 10.0).abs() < 1e-9, "the second took 10 ms longer than the first");
        gauge.started(1);
        gauge.refused(1);
        assert!((gauge.service_ms() - 12.0).abs() < 1e-9, "one that was refused took no time");
        assert_eq!(gauge.running(), 0);
    }
}
