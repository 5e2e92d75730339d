//! A training run without the rest of the system: `train joint|discriminator DATA OUT MINUTES [START]`; THREADS, SLOTS, SAMPLES and CHECKPOINT
//! in the environment. Run it with RAYON_NUM_THREADS=1 and CANDLE_NUM_THREADS=1, or candle's own threads spin beside the workers.

use repose_training::{Part, TrainSettings, train};

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    tracing_subscriber::fmt().with_writer(std::io::stderr).init();
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [part, data, out, minutes, rest @ ..] = &arguments[..] else {
        return Err("train joint|discriminator DATA OUT MINUTES [START]".into());
    };
    let part = if part == "joint" { Part::Joint } else { Part::Discriminator };
    let number = |name: &str, default: usize| std::env::var(name).ok().and_then(|t| t.parse().ok()).unwrap_or(default);
    let settings = TrainSettings {
        part,
        data: data.into(),
        out: out.into(),
        start: rest.first().map(Into::into),
        steps: 1_000_000,
        minutes: Some(minutes.parse()?),
        threads: number("THREADS", 2),
        slots: number("SLOTS", 2),
        samples_per_slot: number("SAMPLES", 8),
        checkpoint_steps: number("CHECKPOINT", 500) as u64,
        ..TrainSettings::default()
    };
    println!("{}", serde_json::to_string_pretty(&train(&settings)?)?);
    Ok(())
}
