//! A training run without the rest of the system: `train joint|relations|discriminator|outcome DATA OUT MINUTES [START]`; THREADS, SLOTS, SAMPLES and
//! CHECKPOINT in the environment. Run it with RAYON_NUM_THREADS=1 and CANDLE_NUM_THREADS=1, or candle's own threads spin beside the workers.

use repose_training::{Part, TrainSettings, train};

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    tracing_subscriber::fmt().with_writer(std::io::stderr).init();
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [part, data, out, minutes, rest @ ..] = &arguments[..] else {
        return Err("train joint|relations|discriminator|outcome DATA OUT MINUTES [START]".into());
    };
    let defaults = TrainSettings::of_part(Part::parse(part).ok_or("expected joint, relations, discriminator or outcome")?);
    let number = |name: &str, default: usize| std::env::var(name).ok().and_then(|t| t.parse().ok()).unwrap_or(default);
    let settings = TrainSettings {
        data: data.into(),
        out: out.into(),
        start: rest.first().map(Into::into),
        steps: 1_000_000,
        minutes: Some(minutes.parse()?),
        threads: number("THREADS", 2),
        slots: number("SLOTS", defaults.slots),
        samples_per_slot: number("SAMPLES", defaults.samples_per_slot),
        checkpoint_steps: number("CHECKPOINT", defaults.checkpoint_steps as usize) as u64,
        ..defaults
    };
    println!("{}", serde_json::to_string_pretty(&train(&settings)?)?);
    Ok(())
}
