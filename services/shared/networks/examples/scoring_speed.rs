//! Candidates scored a second on this machine, by number of threads.

use std::time::Instant;

use nalgebra::Point3;
use repose_networks::{Candidate, Models, SceneContext};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let models = Models::embedded()?;
    let mut points = Vec::new();
    let mut labels = Vec::new();
    for i in 0..300_000u32 {
        let (u, v) = ((i % 600) as f32 / 300.0 - 1.0, (i / 600) as f32 / 250.0 - 1.0);
        let object = u.abs() < 0.05 && v.abs() < 0.05;
        points.push(Point3::new(u, v, if object { 0.08 } else { 0.0 }));
        labels.push(u16::from(object));
    }
    let start = Instant::now();
    let scene = SceneContext::new(&points, &labels, 0.0, &models.config().cloud)?;
    println!("kernel {}, scene prepared in {:.1} ms", models.kernel_id(), start.elapsed().as_secs_f64() * 1e3);
    let candidates: Vec<_> = (0..200).map(|i| Candidate { position_in_world: [0.2, 0.001 * i as f32, 0.05], yaw_rad: 0.0 }).collect();
    for threads in [1, 2] {
        models.realism(&scene, 1, &candidates[..10], threads)?;
        let start = Instant::now();
        models.realism(&scene, 1, &candidates, threads)?;
        println!("{threads} thread(s): {:.0} candidates/s", candidates.len() as f64 / start.elapsed().as_secs_f64());
    }
    Ok(())
}
