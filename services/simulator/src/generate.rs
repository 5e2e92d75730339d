//! Training data: seeds in, shards out.
//!
//! Shards are made independently, each from its own range of seeds, so that any number of threads writes the same bytes, and a run that
//! was interrupted goes on with the shards that are missing. The split follows from the seed (`repose_dataset::Split`). A folder's
//! `dataset.json` says how its shards were made, down to what the first scene looks like: a run that would make others is refused.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use rand_pcg::Pcg64;
use repose_dataset::{
    Manifest, ManifestError, ReleaseRecord, ShardWriter, Split, ViewRecord, WriteError, releases_are_there, releases_path, write_releases,
};

use crate::render::DepthCanvas;
use crate::scene::{NoScene, Rejected, SceneSettings, scene_of_seed};
use crate::statistics::Statistics;
use crate::trials::{ReleaseTrialSettings, trials};
use crate::viewpoint::ViewpointSettings;
use crate::views::view_of_scene;

/// What to generate.
#[derive(Debug, Clone, PartialEq)]
pub struct GenerateSettings {
    /// Folder that the shards are written to.
    pub out: PathBuf,
    /// Which seeds.
    pub split: Split,
    /// The first scene of the split, a multiple of `scenes_per_shard`.
    pub first_scene: u64,
    /// How many scenes.
    pub scenes: u64,
    /// Viewpoints of each scene.
    pub views: u32,
    /// Whether layers keep their color; training does not need it. Default false: it makes shards two thirds larger.
    pub color: bool,
    /// Scenes in a shard.
    pub scenes_per_shard: u64,
    /// Threads to work with.
    pub threads: usize,
    /// How scenes are made.
    pub scene: SceneSettings,
    /// Where the cameras are.
    pub viewpoint: ViewpointSettings,
    /// Whether objects are let go too, and how ([`trials`]). May be asked for later: what is missing is added to the shards that are there.
    pub trials: Option<ReleaseTrialSettings>,
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
            color: false,
            scenes_per_shard: 16,
            threads: 2,
            scene: SceneSettings::default(),
            viewpoint: ViewpointSettings::default(),
            trials: None,
        }
    }

    /// How the folder's shards are made: all that their bytes depend on but the seed.
    fn manifest(&self) -> Manifest {
        let settings = serde_json::json!({
            "split": self.split,
            "views": self.views,
            "color": self.color,
            "scenes_per_shard": self.scenes_per_shard,
            "viewpoint": self.viewpoint,
            "scene": lines_of(&self.scene),
            "first_view": self.fingerprint(),
        });
        Manifest::new(concat!("repose ", env!("CARGO_PKG_VERSION")), settings)
    }

    /// What the split's first view looks like, as a number: a change of objects, physics, cameras or drawing changes it.
    fn fingerprint(&self) -> String {
        const SCENES: u64 = 8;
        let first = self.split.seeds().start;
        let view = (first..first + SCENES).find_map(|seed| scene_views(seed, self).ok()?.0.into_iter().next());
        let mut crc = flate2::Crc::new();
        for layer in view.iter().flat_map(|v| std::iter::once(&v.background).chain(v.objects.iter().map(|o| &o.alone))) {
            let bytes: Vec<u8> = layer.inverse_depth.iter().flat_map(|w| w.to_le_bytes()).collect();
            crc.update(&bytes);
        }
        format!("{:08x}", crc.sum())
    }
}

/// Settings as the data's files tell them: a line for every field, so that a difference is named.
pub fn lines_of(settings: &impl std::fmt::Debug) -> Vec<String> {
    format!("{settings:#?}").lines().map(|line| line.trim().to_owned()).collect()
}

/// How far generation is, or how it ended.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Generated {
    /// Scenes written by this run.
    pub scenes: usize,
    /// Scenes made of shards that are not written yet; none at the end.
    pub unwritten: usize,
    /// Scenes that were there already.
    pub skipped: usize,
    /// Views written.
    pub views: usize,
    /// Views for which no viewpoint showed enough of the scene.
    pub unseen: usize,
    /// Bytes written.
    pub bytes: u64,
    /// Draws that were no scene.
    pub rejected: usize,
    /// Seeds that gave no scene at all.
    pub failed: usize,
    /// Releases written.
    pub releases: usize,
    /// What the scenes written by this run are like.
    pub statistics: Statistics,
}

impl Generated {
    /// Bytes of a view on disk.
    pub fn bytes_per_view(&self) -> f64 {
        self.bytes as f64 / self.views.max(1) as f64
    }

    fn add(&mut self, other: &Self) {
        self.scenes += other.scenes;
        self.skipped += other.skipped;
        self.views += other.views;
        self.unseen += other.unseen;
        self.bytes += other.bytes;
        self.rejected += other.rejected;
        self.failed += other.failed;
        self.releases += other.releases;
        self.statistics.merge(&other.statistics);
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
    /// The folder cannot be read, or holds shards or outcomes that were made in another way.
    #[error(transparent)]
    Manifest(#[from] ManifestError),
    /// Shards begin at multiples of their size, so that runs over different ranges of scenes share a folder.
    #[error("first_scene: expected a multiple of {scenes_per_shard}, got {got}")]
    FirstScene {
        /// What was asked for.
        got: u64,
        /// Scenes in a shard.
        scenes_per_shard: u64,
    },
    /// An earlier, shorter run's last shard could not be removed.
    #[error("removing {path}: {source}", path = path.display())]
    Remove {
        /// The shard.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The split does not have that many seeds.
    #[error("split {split} has {available} scenes, not scenes {first} to {end}")]
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

/// Generates what is missing. `progress` is called after every scene with the totals so far, and stops the run by returning false: shards
/// that were begun are finished.
///
/// # Errors
/// [`GenerateError`]; shards that were finished stay, and the next run goes on from them.
pub fn generate(settings: &GenerateSettings, progress: impl FnMut(&Generated) -> bool + Send) -> Result<Generated, GenerateError> {
    let end = settings.first_scene.saturating_add(settings.scenes);
    if !settings.split.holds(settings.first_scene, settings.scenes) {
        let first = settings.first_scene;
        return Err(GenerateError::Seeds { first, end, split: settings.split.name(), available: settings.split.scenes() });
    }
    let per_shard = settings.scenes_per_shard.max(1);
    if !settings.first_scene.is_multiple_of(per_shard) {
        return Err(GenerateError::FirstScene { got: settings.first_scene, scenes_per_shard: per_shard });
    }
    settings.manifest().claim(&settings.out)?;
    let shards = settings.scenes.div_ceil(per_shard) as usize;
    let next = AtomicUsize::new(0);
    let stop = AtomicBool::new(false);
    let state = Mutex::new((Generated::default(), progress, None::<GenerateError>));
    // Tells of scenes: `count` gets the totals.
    let told = |count: &dyn Fn(&mut Generated)| {
        let mut state = state.lock().unwrap_or_else(PoisonError::into_inner);
        count(&mut state.0);
        let totals = state.0.clone();
        if !(state.1)(&totals) {
            state.2.get_or_insert(GenerateError::Stopped);
            stop.store(true, Ordering::Relaxed);
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..settings.threads.clamp(1, shards.max(1)) {
            scope.spawn(|| {
                while !stop.load(Ordering::Relaxed) {
                    let shard = next.fetch_add(1, Ordering::Relaxed);
                    if shard >= shards {
                        break;
                    }
                    let first = settings.first_scene + shard as u64 * per_shard;
                    match make_shard(settings, first, (first + per_shard).min(end), &|| told(&|totals| totals.unwritten += 1)) {
                        Ok(shard) => told(&|totals| {
                            totals.add(&shard);
                            totals.unwritten -= shard.scenes + shard.failed;
                        }),
                        Err(error) => {
                            state.lock().unwrap_or_else(PoisonError::into_inner).2.get_or_insert(error);
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

/// Makes one shard, unless its file is there; `scene_done` is called after each scene.
fn make_shard(settings: &GenerateSettings, first: u64, end: u64, scene_done: &dyn Fn()) -> Result<Generated, GenerateError> {
    let mut made = Generated::default();
    // Numbered by its first scene, so that runs over different ranges share a folder.
    let (number, scenes) = ((first / settings.scenes_per_shard.max(1)) as usize, (end - first) as usize);
    // A run's last shard may be short; its name says so, and only a longer run replaces it.
    let suffix = if scenes as u64 == settings.scenes_per_shard.max(1) { String::new() } else { format!("_of_{scenes}_scenes") };
    made.releases = make_releases(settings, first, end)?;
    let is_whole_there = ShardWriter::shard_path(&settings.out, number, "").exists();
    let longest_short = short_shards(&settings.out, number).map(|(there, _)| there).max().unwrap_or(0);
    let there = if is_whole_there { usize::MAX } else { longest_short };
    if there >= scenes {
        made.skipped = scenes;
        remove_shorter(&settings.out, number, there)?;
        return Ok(made);
    }
    let failed = |source| GenerateError::Write { folder: settings.out.clone(), source };
    let capacity = (scenes * settings.views as usize).max(1) + 1;
    let mut writer = ShardWriter::new(&settings.out, capacity, number).map_err(failed)?.with_suffix(&suffix);
    for scene in first..end {
        let made_scene = scene_views(settings.split.seeds().start + scene, settings);
        scene_done();
        let (views, rejected) = match made_scene {
            Ok(views) => views,
            Err(none) => {
                made.failed += 1;
                made.rejected += none.rejections.len();
                made.statistics.add_scene(&[], none.rejections.iter().map(Rejected::reason));
                continue;
            }
        };
        made.scenes += 1;
        made.rejected += rejected.len();
        made.unseen += settings.views as usize - views.len();
        made.statistics.add_scene(&views, rejected.iter().map(Rejected::reason));
        for view in views {
            made.views += 1;
            writer.push(&view).map_err(failed)?;
        }
    }
    made.bytes = writer.finish().map_err(failed)?;
    // Only now: had the disk been full, they would be all there is. Should this be interrupted, the next run removes them.
    remove_shorter(&settings.out, number, scenes)?;
    Ok(made)
}

/// Removes the short shards `number` of fewer scenes than the one in their place.
fn remove_shorter(folder: &Path, number: usize, scenes: usize) -> Result<(), GenerateError> {
    for (_, path) in short_shards(folder, number).filter(|(there, _)| *there < scenes) {
        std::fs::remove_file(&path).map_err(|source| GenerateError::Remove { path, source })?;
    }
    Ok(())
}

/// Makes the outcomes of one shard's scenes, where they are wanted and not there; says how many. Others that are there are refused.
fn make_releases(settings: &GenerateSettings, first: u64, end: u64) -> Result<usize, GenerateError> {
    let path = releases_path(&settings.out, first, end - first);
    let Some(trial_settings) = &settings.trials else { return Ok(0) };
    let made_with = serde_json::json!({ "releases": lines_of(trial_settings) });
    if releases_are_there(&path, &made_with)? {
        return Ok(0);
    }
    let seeds = (first..end).map(|scene| settings.split.seeds().start + scene);
    let scenes = seeds.filter_map(|seed| scene_of_seed(seed, &settings.scene).ok());
    let releases: Vec<ReleaseRecord> = scenes.flat_map(|(scene, _)| trials(&scene, trial_settings)).collect();
    write_releases(&path, &made_with, &releases).map_err(|source| GenerateError::Write { folder: settings.out.clone(), source })?;
    Ok(releases.len())
}

/// The random numbers of one of a scene's viewpoints: its own, since a change of scenes must not move cameras, nor the other way round.
pub fn view_rng(seed: u64, view: u32) -> Pcg64 {
    const VIEW_STREAM: u128 = 0x5eed_0000_0000_0001;
    Pcg64::new(u128::from(seed), VIEW_STREAM + u128::from(view))
}

/// The short shards `number` that runs have left, with how many scenes each is of.
fn short_shards(folder: &Path, number: usize) -> impl Iterator<Item = (usize, PathBuf)> {
    let prefix = format!("shard_{number:05}_of_");
    let scenes_of = move |name: &str| name.strip_prefix(&prefix)?.strip_suffix("_scenes.safetensors")?.parse().ok();
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    entries.filter_map(move |entry| Some((scenes_of(entry.file_name().to_str()?)?, entry.path())))
}

/// The views of a seed's scene, and the draws that were rejected before it. Views that no viewpoint gave are left out.
///
/// # Errors
/// [`NoScene`] when the seed gives none.
pub fn scene_views(seed: u64, settings: &GenerateSettings) -> Result<(Vec<ViewRecord>, Vec<Rejected>), NoScene> {
    let (scene, rejected) = scene_of_seed(seed, &settings.scene)?;
    let mut canvas = DepthCanvas::new(settings.viewpoint.width, settings.viewpoint.height);
    let views = (0..settings.views)
        .filter_map(|view| view_of_scene(&scene, view, &settings.viewpoint, settings.color, &mut canvas, &mut view_rng(seed, view)));
    Ok((views.collect(), rejected))
}

/// The statistics of scenes without writing them. `progress` is called after every scene.
pub fn surveyed(seeds: std::ops::Range<u64>, settings: &GenerateSettings, mut progress: impl FnMut()) -> Statistics {
    let mut statistics = Statistics::default();
    for seed in seeds {
        match scene_views(seed, settings) {
            Ok((views, rejected)) => statistics.add_scene(&views, rejected.iter().map(Rejected::reason)),
            Err(none) => statistics.add_scene(&[], none.rejections.iter().map(Rejected::reason)),
        }
        progress();
    }
    statistics
}
