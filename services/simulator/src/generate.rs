//! Training data: seeds in, shards out.
//!
//! Shards are made independently, each from its own range of seeds, so that any number of threads writes the same bytes, and a run that
//! was interrupted goes on with the shards that are missing. The split follows from the seed (`repose_dataset::Split`).

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use rand::SeedableRng;
use rand_pcg::Pcg64;
use repose_dataset::{ShardWriter, Split, ViewRecord, WriteError};

use crate::render::DepthCanvas;
use crate::scene::{NoScene, SceneSettings, scene_of_seed};
use crate::viewpoint::{ViewpointSettings, random_viewpoint};
use crate::views::view_record;

/// What to generate.
#[derive(Debug, Clone, PartialEq)]
pub struct GenerateSettings {
    /// Folder that the shards are written to.
    pub out: PathBuf,
    /// Which seeds.
    pub split: Split,
    /// The first scene of the split.
    pub first_scene: u64,
    /// How many scenes.
    pub scenes: u64,
    /// Viewpoints of each scene.
    pub views: u32,
    /// Scenes in a shard.
    pub scenes_per_shard: u64,
    /// Threads to work with.
    pub threads: usize,
    /// How scenes are made.
    pub scene: SceneSettings,
    /// Where the cameras are.
    pub viewpoint: ViewpointSettings,
}

impl GenerateSettings {
    /// The usual settings: five viewpoints, sixteen scenes a shard, two threads.
    pub fn new(out: &Path, split: Split, scenes: u64) -> Self {
        Self {
            out: out.to_path_buf(),
            split,
            first_scene: 0,
            scenes,
            views: 5,
            scenes_per_shard: 16,
            threads: 2,
            scene: SceneSettings::default(),
            viewpoint: ViewpointSettings::default(),
        }
    }
}

/// How far generation is, or how it ended.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Generated {
    /// Scenes written by this run.
    pub scenes: usize,
    /// Scenes that were there already.
    pub skipped: usize,
    /// Views written.
    pub views: usize,
    /// Draws that were no scene.
    pub rejected: usize,
    /// Seeds that gave no scene at all.
    pub failed: usize,
    /// Ordered pairs of objects, over all views.
    pub pairs: usize,
    /// Of those, the pairs for which each relation holds, in wire order.
    pub holding: [usize; repose_relations::RELATIONS],
}

impl Generated {
    /// The share of pairs for which each relation holds, percent.
    pub fn prevalence_percent(&self) -> [f64; repose_relations::RELATIONS] {
        self.holding.map(|n| 100.0 * n as f64 / self.pairs.max(1) as f64)
    }

    fn add(&mut self, other: &Self) {
        self.scenes += other.scenes;
        self.skipped += other.skipped;
        self.views += other.views;
        self.rejected += other.rejected;
        self.failed += other.failed;
        self.pairs += other.pairs;
        for (sum, n) in self.holding.iter_mut().zip(other.holding) {
            *sum += n;
        }
    }
}

/// Why generation stopped.
#[derive(Debug, thiserror::Error)]
pub enum GenerateError {
    /// A shard could not be written.
    #[error("writing {folder}: {source}", folder = folder.display())]
    Write {
        /// Where to.
        folder: PathBuf,
        /// Why.
        source: WriteError,
    },
    /// The split does not have that many seeds.
    #[error("scenes {first} to {end} of split {split}: it has {available}")]
    Seeds {
        /// First scene asked for.
        first: u64,
        /// One past the last.
        end: u64,
        /// Of which split.
        split: &'static str,
        /// How many it has.
        available: u64,
    },
    /// The caller's callback asked to stop; what is written stays.
    #[error("stopped on request")]
    Stopped,
}

/// Generates what is missing. `progress` is called after every shard with the totals so far, and stops the run by returning false.
///
/// # Errors
/// [`GenerateError`]; shards that were finished stay, and the next run goes on from them.
pub fn generate(settings: &GenerateSettings, progress: impl FnMut(&Generated) -> bool + Send) -> Result<Generated, GenerateError> {
    let seeds = settings.split.seeds();
    let (available, end) = (seeds.end - seeds.start, settings.first_scene + settings.scenes);
    if end > available {
        return Err(GenerateError::Seeds { first: settings.first_scene, end, split: settings.split.name(), available });
    }
    let per_shard = settings.scenes_per_shard.max(1);
    let shards = settings.scenes.div_ceil(per_shard) as usize;
    let next = AtomicUsize::new(0);
    let stop = AtomicBool::new(false);
    let state = Mutex::new((Generated::default(), progress, None::<GenerateError>));
    std::thread::scope(|scope| {
        for _ in 0..settings.threads.clamp(1, shards.max(1)) {
            scope.spawn(|| {
                while !stop.load(Ordering::Relaxed) {
                    let shard = next.fetch_add(1, Ordering::Relaxed);
                    if shard >= shards {
                        break;
                    }
                    let first = settings.first_scene + shard as u64 * per_shard;
                    let made = make_shard(settings, first, (first + per_shard).min(end));
                    let mut state = state.lock().unwrap_or_else(PoisonError::into_inner);
                    match made {
                        Ok(shard) => {
                            state.0.add(&shard);
                            let totals = state.0.clone();
                            if !(state.1)(&totals) {
                                state.2.get_or_insert(GenerateError::Stopped);
                                stop.store(true, Ordering::Relaxed);
                            }
                        }
                        Err(error) => {
                            state.2.get_or_insert(error);
                            stop.store(true, Ordering::Relaxed);
                        }
                    }
                }
            });
        }
    });
    let (totals, _, error) = state.into_inner().unwrap_or_else(PoisonError::into_inner);
    error.map_or(Ok(totals), Err)
}

/// Makes one shard, unless its file is there.
fn make_shard(settings: &GenerateSettings, first: u64, end: u64) -> Result<Generated, GenerateError> {
    // Numbered by its first scene, so that runs over different ranges share a folder.
    let number = (first / settings.scenes_per_shard.max(1)) as usize;
    let mut made = Generated::default();
    if settings.out.join(format!("shard_{number:05}.safetensors")).exists() {
        made.skipped = (end - first) as usize;
        return Ok(made);
    }
    let failed = |source| GenerateError::Write { folder: settings.out.clone(), source };
    let capacity = ((end - first) as usize * settings.views as usize).max(1) + 1;
    let mut writer = ShardWriter::new(&settings.out, capacity, number).map_err(failed)?;
    for scene in first..end {
        let Ok((views, rejected)) = scene_views(settings.split.seeds().start + scene, settings) else {
            made.failed += 1;
            made.rejected += settings.scene.max_attempts as usize;
            continue;
        };
        made.scenes += 1;
        made.rejected += rejected;
        for view in views {
            made.views += 1;
            let n = view.objects.len();
            made.pairs += n * n.saturating_sub(1);
            for relations in &view.relations {
                for (sum, holds) in made.holding.iter_mut().zip(relations) {
                    *sum += usize::from(*holds);
                }
            }
            writer.push(view).map_err(failed)?;
        }
    }
    writer.finish().map_err(failed)?;
    Ok(made)
}

/// The views of a seed's scene, and how many draws were rejected before it.
///
/// # Errors
/// [`NoScene`] when the seed gives none.
pub fn scene_views(seed: u64, settings: &GenerateSettings) -> Result<(Vec<ViewRecord>, usize), NoScene> {
    // Viewpoints have random numbers of their own: a change of scenes must not move cameras, nor the other way round.
    const VIEW_STREAM: u64 = 0x5eed_0000_0000_0001;
    let (scene, rejected) = scene_of_seed(seed, &settings.scene)?;
    let mut rng = Pcg64::seed_from_u64(seed ^ VIEW_STREAM);
    let mut canvas = DepthCanvas::new(settings.viewpoint.width, settings.viewpoint.height);
    let focus = scene.focus();
    let views = (0..settings.views).map(|view| {
        let (camera, world_from_camera) = random_viewpoint(&focus, &settings.viewpoint, &mut rng);
        view_record(&scene, view, &camera, &world_from_camera, &mut canvas, &mut rng)
    });
    Ok((views.collect(), rejected.len()))
}
