//! How long a picture takes on one core: `sensor_speed`.

use std::time::Instant;

use repose_geometry::Pinhole;
use repose_sensor::SensorModel;

fn main() {
    for (width, height) in [(320usize, 240usize), (640, 480)] {
        let f = width as f64 * 0.9;
        let camera = Pinhole { width, height, fx: f, fy: f, cx: (width as f64 - 1.0) / 2.0, cy: (height as f64 - 1.0) / 2.0 };
        // A table seen from above with a grid of boxes on it.
        let depth = |i: usize| {
            let (u, v) = (i % width * 320 / width, i / width * 240 / height);
            if u % 80 > 40 && v % 60 > 25 { 0.7 } else { 1.1 - 0.001 * v as f32 }
        };
        let truth: Vec<f32> = (0..width * height).map(depth).collect();
        for name in SensorModel::NAMES {
            let model = SensorModel::named(name).unwrap_or_default();
            let mut times: Vec<f64> = (0..50)
                .map(|seed| {
                    let mut picture = truth.clone();
                    let start = Instant::now();
                    model.disturb(&mut picture, &camera, seed);
                    start.elapsed().as_secs_f64() * 1e3
                })
                .collect();
            times.sort_by(f64::total_cmp);
            println!("{width} x {height}, {name}: {:.2} ms (median of {})", times[times.len() / 2], times.len());
        }
    }
}
