//! How the simulated world behaves: which draws are rejected and why, how deep and how still scenes rest, and whether the outcome of a
//! release depends on the length of the physics step.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use repose_dataset::Split;
use repose_simulator::scene::{Rejected, SceneKind, SceneSettings, SimulatedScene, displacement_m, scene_of_seed};

use crate::scenes::agreement::{Releases, StepSettings, compared};
use crate::statistics::quantile::Spread;

/// What is looked at.
#[derive(Debug, Clone)]
pub struct WorldReportSettings {
    /// How scenes are made.
    pub scene: SceneSettings,
    /// Which seeds.
    pub split: Split,
    /// How many scenes.
    pub scenes: usize,
    /// How many releases are simulated at two step lengths.
    pub placements: usize,
    /// The two step lengths.
    pub steps: StepSettings,
}

impl Default for WorldReportSettings {
    fn default() -> Self {
        Self { scene: SceneSettings::default(), split: Split::Validation, scenes: 1000, placements: 200, steps: StepSettings::default() }
    }
}

/// The draws of one kind of scene.
#[derive(Debug, Clone, Default, PartialEq, serde::Serialize)]
pub struct KindRow {
    /// Scenes that came out.
    pub scenes: usize,
    /// Seeds that gave none.
    pub failed: usize,
    /// Draws, rejected ones too.
    pub draws: usize,
    /// Share of the draws that were rejected, percent, by reason.
    pub rejected_percent: BTreeMap<&'static str, f64>,
    /// Time for each scene on one thread, rejected draws included, milliseconds.
    pub mean_ms: f64,
    /// Objects in a scene, on average.
    pub objects: f64,
}

impl KindRow {
    /// Share of the draws that were rejected for any reason, percent.
    pub fn rejected_percent_of_draws(&self) -> f64 {
        self.rejected_percent.values().sum()
    }
}

/// The result of evaluating the simulated world.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct WorldReport {
    /// Scenes that came out.
    pub scenes: usize,
    /// Seeds that gave none.
    pub failed: usize,
    /// Scenes settled per second by all threads together, without pictures.
    pub scenes_per_s: f64,
    /// Share of all draws that were rejected, percent, by reason.
    pub rejected_percent: BTreeMap<&'static str, f64>,
    /// By kind of scene, those that occurred.
    pub kinds: BTreeMap<SceneKind, KindRow>,
    /// The deepest overlap of each scene, millimetres.
    pub penetration_mm: Spread,
    /// The farthest that any point of each scene moves in a further second, in a fresh world, millimetres.
    pub residual_mm: Spread,
    /// Releases at two step lengths.
    pub releases: Releases,
}

/// What is kept of a seed.
struct Looked {
    kind: SceneKind,
    rejected: Vec<Rejected>,
    ms: f64,
    /// Objects, overlap and residual motion in metres; `None` when there was no scene.
    scene: Option<(usize, f64, f64)>,
}

/// Makes the scenes and releases on `threads` threads; `progress` is told how many of both are done. Times aside, the report does not
/// depend on the number of threads.
pub fn world_report(settings: &WorldReportSettings, threads: usize, progress: impl Fn(usize) + Sync) -> WorldReport {
    let done = AtomicUsize::new(0);
    let count = || progress(done.fetch_add(1, Ordering::Relaxed) + 1);
    let first = settings.split.seeds().start;
    let looked = in_parallel(settings.scenes, threads, |i| {
        let looked = look(first + i as u64, &settings.scene);
        count();
        looked
    });
    let outcomes = in_parallel(settings.placements, threads, |i| {
        // Seeds after those of the scenes above; every second of them may give no scene before placements run short.
        let outcome = compared(first + (settings.scenes + i) as u64, &settings.scene, &settings.steps);
        count();
        outcome
    });
    let mut report = summed(&looked, threads.max(1));
    report.releases = Releases::of(&outcomes);
    report
}

/// `of(0)`, …, `of(count - 1)`, computed by several threads, in order.
fn in_parallel<T: Send>(count: usize, threads: usize, of: impl Fn(usize) -> T + Sync) -> Vec<T> {
    let next = AtomicUsize::new(0);
    let results = Mutex::new(Vec::with_capacity(count));
    std::thread::scope(|scope| {
        for _ in 0..threads.clamp(1, count.max(1)) {
            scope.spawn(|| {
                loop {
                    let i = next.fetch_add(1, Ordering::Relaxed);
                    if i >= count {
                        break;
                    }
                    let result = of(i);
                    results.lock().unwrap_or_else(PoisonError::into_inner).push((i, result));
                }
            });
        }
    });
    let mut results = results.into_inner().unwrap_or_else(PoisonError::into_inner);
    results.sort_by_key(|(i, _)| *i);
    results.into_iter().map(|(_, result)| result).collect()
}

fn look(seed: u64, settings: &SceneSettings) -> Looked {
    let start = Instant::now();
    let made = scene_of_seed(seed, settings);
    let ms = start.elapsed().as_secs_f64() * 1e3;
    match made {
        Ok((scene, rejected)) => {
            let measured = (scene.objects.len(), f64::from(scene.penetration_m()), residual_m(&scene, settings));
            Looked { kind: scene.kind, rejected, ms, scene: Some(measured) }
        }
        Err(none) => Looked { kind: none.kind, rejected: none.rejections, ms, scene: None },
    }
}

/// The farthest that any point of an object moves in a further second.
fn residual_m(scene: &SimulatedScene, settings: &SceneSettings) -> f64 {
    let mut world = scene.world(settings.physics);
    for _ in 0..settings.watch_steps {
        world.step();
    }
    let moved = scene.objects.iter().zip(world.poses()).map(|(o, pose)| displacement_m(&o.shape, &o.world_from_object, &pose));
    moved.fold(0.0, f64::max)
}

fn summed(looked: &[Looked], threads: usize) -> WorldReport {
    let mut report = WorldReport::default();
    let (mut counts, mut draws, mut total_ms) = (BTreeMap::<&str, usize>::new(), 0, 0.0);
    let mut of_kind = BTreeMap::<(SceneKind, &str), usize>::new();
    let (mut penetrations, mut residuals) = (Vec::new(), Vec::new());
    for seed in looked {
        let row = report.kinds.entry(seed.kind).or_default();
        row.draws += seed.rejected.len() + usize::from(seed.scene.is_some());
        row.mean_ms += seed.ms;
        draws += seed.rejected.len() + usize::from(seed.scene.is_some());
        total_ms += seed.ms;
        for why in &seed.rejected {
            *counts.entry(why.reason()).or_default() += 1;
            *of_kind.entry((seed.kind, why.reason())).or_default() += 1;
        }
        match seed.scene {
            Some((objects, penetration_m, residual_m)) => {
                row.scenes += 1;
                row.objects += objects as f64;
                penetrations.push(penetration_m * 1e3);
                residuals.push(residual_m * 1e3);
            }
            None => row.failed += 1,
        }
    }
    let percent = |n: usize, of: usize| 100.0 * n as f64 / of.max(1) as f64;
    for (kind, row) in &mut report.kinds {
        row.mean_ms /= row.scenes.max(1) as f64;
        row.objects /= row.scenes.max(1) as f64;
        row.rejected_percent = Rejected::REASONS
            .into_iter()
            .map(|reason| (reason, percent(of_kind.get(&(*kind, reason)).copied().unwrap_or(0), row.draws)))
            .collect();
        report.scenes += row.scenes;
        report.failed += row.failed;
    }
    report.rejected_percent =
        Rejected::REASONS.into_iter().map(|reason| (reason, percent(counts.get(reason).copied().unwrap_or(0), draws))).collect();
    report.scenes_per_s = report.scenes as f64 * 1e3 * threads as f64 / total_ms.max(1e-9);
    report.penetration_mm = Spread::of(penetrations);
    report.residual_mm = Spread::of(residuals);
    report
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_small_report_counts_everything_and_does_not_depend_on_threads() {
        let settings = WorldReportSettings { scenes: 6, placements: 4, ..WorldReportSettings::default() };
        let last = Mutex::new(0);
        let mut one = world_report(&settings, 1, |done| *last.lock().expect("not poisoned") = done);
        let mut two = world_report(&settings, 2, |_| ());
        assert_eq!(*last.lock().expect("not poisoned"), 10);
        assert_eq!((one.scenes + one.failed, one.releases.placements), (6, 4));
        assert_eq!(one.kinds.values().map(|k| k.scenes).sum::<usize>(), one.scenes);
        assert!(one.penetration_mm.max <= 2.0 && one.residual_mm.max <= 1.0, "{one:?}");
        for report in [&mut one, &mut two] {
            report.scenes_per_s = 0.0;
            report.kinds.values_mut().for_each(|row| row.mean_ms = 0.0);
        }
        assert_eq!(one, two);
    }
}
