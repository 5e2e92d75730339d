//! Where the time of a training sample goes: `episode_speed DATA`.

use std::time::Instant;

use repose_dataset::Split;
use repose_networks::{Kernel, NetworksConfig, crops};
use repose_training::{
    episode::{Episode, EpisodeSettings},
    step::generator,
    views::Views,
};

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let data = std::env::args().nth(1).ok_or("episode_speed DATA")?;
    let views = Views::open(data.as_ref(), Split::Validation)?;
    let config = NetworksConfig::default();
    let start = Instant::now();
    let episodes: Vec<Episode> = (0..20)
        .filter_map(|i| {
            let (view, query) = views.query(i * 7 % views.queries())?;
            Episode::new(&view, query, &[], &config.cloud, &EpisodeSettings::default(), &mut generator(1, i as u64, 0))
        })
        .collect();
    println!("{:.1} ms an episode", start.elapsed().as_secs_f64() * 1e3 / episodes.len().max(1) as f64);
    let start = Instant::now();
    let mut points = 0;
    let mut pairs = 0;
    for e in &episodes {
        let crop = crops::discriminator_input(Kernel::detect(), &config, &e.scene, &e.placed(), e.position.into());
        points += crop.points.len();
        pairs += crop.levels[..3].iter().map(|l| l.neighbours.indices().len()).sum::<usize>();
    }
    println!(
        "{:.2} ms a crop; {} points, {} pairs, scene {} points",
        start.elapsed().as_secs_f64() * 1e3 / episodes.len().max(1) as f64,
        points / episodes.len(),
        pairs / episodes.len(),
        episodes[0].scene.points.len()
    );
    Ok(())
}
