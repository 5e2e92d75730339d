//! Writes untrained weights: `cargo run --release -p repose-networks --example initial_weights -- weights/default.safetensors`.

use repose_networks::{NetworksConfig, Weights};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = std::env::args().nth(1).ok_or("which file?")?;
    std::fs::write(path, Weights::initial(&NetworksConfig::default(), 1)?)?;
    Ok(())
}
