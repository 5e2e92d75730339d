//! Time from ranked placements to a complete, timed pick-and-place plan on a synthetic table: `cargo bench -p repose-motion`.
//!
//! Seeded: problem `k` asks for a placement that depends on `k` only, with a second one in reserve.

use std::time::Instant;

use nalgebra::Isometry3;
use repose_motion::pick_place::{PickPlaceRequest, PickPlaceSettings, pick_place};
use repose_motion::synthetic;
use repose_panda::READY;

const PROBLEMS: usize = 400;

fn main() {
    let scene = synthetic::scene();
    let settings = PickPlaceSettings::default();
    let mut times_ms = Vec::with_capacity(PROBLEMS);
    let mut solved = 0;
    for problem in 0..PROBLEMS {
        let angle = problem as f64 * 2.4;
        // Box 1 stands at (0.45, -0.2).
        let moved = |x: f64, y: f64| Isometry3::translation(x - 0.45, y + 0.2, 0.0);
        let placements = [moved(0.45 + 0.12 * angle.cos(), 0.05 + 0.3 * (angle * 0.37).sin()), moved(0.45, 0.3)];
        let request =
            PickPlaceRequest { scene: &scene, query: 1, placements: &placements, start: &READY, grasps: None, seed: problem as u64 };
        let begin = Instant::now();
        solved += usize::from(pick_place(&request, &settings).is_ok());
        times_ms.push(begin.elapsed().as_secs_f64() * 1e3);
    }
    times_ms.sort_by(f64::total_cmp);
    let at = |share: f64| times_ms[((PROBLEMS - 1) as f64 * share) as usize];
    println!(
        "problems {PROBLEMS}, solved {solved}; p50 {:.1} ms, p95 {:.1} ms, p99 {:.1} ms, max {:.1} ms",
        at(0.5),
        at(0.95),
        at(0.99),
        at(1.0)
    );
}
