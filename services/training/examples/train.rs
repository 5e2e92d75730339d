//! A training run without the rest of the system: `train joint|discriminator DATA OUT MINUTES [START]`.

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
    let threads = std::env::var("THREADS").ok().and_then(|t| t.parse().ok()).unwrap_or(2);
    let settings = TrainSettings {
        part,
        data: data.into(),
        out: out.into(),
        start: rest.first().map(Into::into),
        steps: 1_000_000,
        minutes: Some(minutes.parse()?),
        threads,
        ..TrainSettings::default()
    };
    println!("{}", serde_json::to_string_pretty(&train(&settings)?)?);
    Ok(())
}
