//! Generates training data: `generate OUT train|validation|test SCENES`.

use repose_dataset::Split;
use repose_simulator::generate::{GenerateSettings, generate};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, out, split, scenes] = arguments.as_slice() else { return Err("usage: generate OUT SPLIT SCENES".into()) };
    let split = Split::ALL.into_iter().find(|s| s.name() == split).ok_or("no such split")?;
    let start = std::time::Instant::now();
    let made = generate(&GenerateSettings::new(out.as_ref(), split, scenes.parse()?), |_| true)?;
    println!("{made:?}\n{:.2} scenes/s", made.scenes as f64 / start.elapsed().as_secs_f64());
    println!("prevalence: {:.1?}", made.prevalence_percent());
    Ok(())
}
