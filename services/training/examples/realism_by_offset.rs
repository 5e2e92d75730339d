//! How the discriminator's realism falls as a settled object is moved: `realism_by_offset DATA WEIGHTS`. Means over validation episodes.

use nalgebra::Vector3;
use repose_dataset::Split;
use repose_networks::{
    Kernel, Networks, NetworksConfig, Weights,
    crops::{Grouped, discriminator_input},
    layers::Mode,
    set_abstraction::Path,
};
use repose_training::{
    episode::{Episode, EpisodeSettings},
    step::generator,
    views::Views,
};

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [data, weights] = &arguments[..] else { return Err("realism_by_offset DATA WEIGHTS".into()) };
    let views = Views::open(data.as_ref(), Split::Validation)?;
    let config = NetworksConfig::default();
    let (networks, _) = Networks::stored(&config, &Weights::from_bytes(&std::fs::read(weights)?)?.values)?;
    let episodes: Vec<Episode> = (0..60)
        .filter_map(|i| {
            let (view, query) = views.query(i * 11 % views.queries())?;
            Episode::new(&view, query, &[], &config.cloud, &EpisodeSettings::default(), &mut generator(9, i as u64, 0))
        })
        .collect();
    for (name, axis) in [("right", Vector3::x()), ("away", Vector3::y()), ("up", Vector3::z())] {
        for offset_mm in [-100, -50, -30, -20, -10, -5, 0, 5, 10, 20, 30, 50, 100] {
            let crops: Vec<Grouped> = episodes
                .iter()
                .map(|e| {
                    let position = e.position + axis * (offset_mm as f32 * 1e-3);
                    discriminator_input(Kernel::detect(), &config, &e.scene, &e.placed(), position.into())
                })
                .collect();
            let logits = networks.discriminator.logits(&Grouped::concat(&crops), &Mode::Serving, Path::Fused)?.to_vec1::<f32>()?;
            let n = logits.len() as f32;
            let mean = logits.iter().map(|x| 1.0 / (1.0 + (-x).exp())).sum::<f32>() / n;
            let accepted = logits.iter().filter(|x| **x > 0.0).count() as f32 / n;
            println!("{name:>6} {offset_mm:>5} mm  mean {mean:.2}  above one half {accepted:.2}");
        }
    }
    Ok(())
}
