//! How long the network for masks takes for a picture of 320 × 240: `cargo run --release -p repose-networks --example mask_speed`.

use std::time::Instant;

use nalgebra::Vector3;
use repose_geometry::Pinhole;
use repose_networks::masks::{MaskInputs, MaskNetwork};

fn main() -> Result<(), repose_networks::WeightsError> {
    const REPEATS: usize = 30;
    let camera = Pinhole { width: 320, height: 240, fx: 262.0, fy: 262.0, cx: 159.5, cy: 119.5 };
    let depth: Vec<f32> = (0..320 * 240).map(|i| 0.7 / (0.6 + 0.8 * ((i / 320) as f32 - 119.5) / 262.0)).collect();
    let network = MaskNetwork::embedded()?;
    let (mut of_inputs, mut of_network) = (Vec::new(), Vec::new());
    for _ in 0..REPEATS {
        let start = Instant::now();
        let inputs = MaskInputs::new(&depth, &camera, &Vector3::new(0.0, -0.8, -0.6));
        of_inputs.push(start.elapsed());
        let start = Instant::now();
        std::hint::black_box(network.logits(&inputs));
        of_network.push(start.elapsed());
    }
    for (name, mut times) in [("inputs", of_inputs), ("network", of_network)] {
        times.sort_unstable();
        println!("{name}: median {:.1} ms, least {:.1} ms", times[REPEATS / 2].as_secs_f64() * 1e3, times[0].as_secs_f64() * 1e3);
    }
    Ok(())
}
