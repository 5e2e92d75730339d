//! How fast the networks answer on this machine: candidates, relations, the prior, and the share of the machine's products.
//!
//! The scene is a simulated one through perception at a camera's size, the candidates lie around an anchor, as a search's do. The share
//! compares the arithmetic of the discriminator's layers (every neighbour that there is through every layer, two operations a weight,
//! as a formulation without shortcuts would do it) with a large product of matrices on as many threads by the tensor library.

use std::time::{Duration, Instant};

use candle_core::{Device, Tensor};
use repose_dataset::Split;
use repose_geometry::{Point3, ViewerFrame};
use repose_networks::crops::discriminator_input;
use repose_networks::points::{ObjectCloud, Observer, SceneCloud};
use repose_networks::serving::spread;
use repose_networks::{Candidate, Kernel, Models, NetworksConfig, SceneContext};
use repose_proto::{CallError, Scene};
use serde::Serialize;

use crate::scenes::problem::{Problem, ProblemSettings};

/// Sizes of the batches of candidates that are timed.
pub const BATCHES: [usize; 3] = [1, 25, 100];
/// Translations scored against one anchor at once.
const TRANSLATIONS: usize = 1000;
/// The prior's goal, by relations in wire order.
const TO_THE_LEFT: [i8; 10] = [1, 0, 0, 0, 0, 0, 0, 0, 0, 0];
/// Rows and columns of the product that stands for the machine.
const MATRIX: usize = 1024;

/// How long is measured.
#[derive(Debug, Clone, Copy)]
pub struct SpeedSettings {
    /// Time for each figure.
    pub each: Duration,
    /// Threads that score.
    pub threads: usize,
}

/// What was measured.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ScoringSpeed {
    /// Candidates a second by the discriminator, one a size of [`BATCHES`].
    pub discriminator_per_s: [f64; BATCHES.len()],
    /// Candidates a second by the outcome network, whose scene features candidates share, one a size of [`BATCHES`].
    pub outcome_per_s: [f64; BATCHES.len()],
    /// Points that the discriminator saw of a candidate.
    pub points: usize,
    /// Scores (all relations of one candidate to one anchor) a second, for translations.
    pub relations_per_s: f64,
    /// Mixtures a second, every thread with a question of its own, about a scene that was asked nothing before.
    pub prior_per_s: f64,
    /// The discriminator's arithmetic at the largest batch as a share of the machine's, 0 to 1 and beyond.
    pub matmul_share: f64,
    /// Operations of a candidate, 10⁹.
    pub candidate_gflop: f64,
    /// What the machine's product reaches, 10⁹ operations a second.
    pub matmul_gflops: f64,
    /// Which kernel.
    pub kernel: &'static str,
    /// Threads.
    pub threads: usize,
}

/// A scene with a query, an anchor, and candidates around the anchor.
pub struct ScoringScene {
    /// As the networks see it.
    pub context: SceneContext,
    /// The object to move.
    pub query: u16,
    /// The anchor.
    pub anchor: u16,
    /// [`TRANSLATIONS`] of them.
    pub candidates: Vec<Candidate>,
    observed: Scene,
    observer: Observer,
}

impl ScoringScene {
    /// The first problem of the validation split.
    ///
    /// # Errors
    /// When no seed gives a problem, or its clouds cannot be prepared.
    pub fn first(config: &NetworksConfig) -> Result<Self, CallError> {
        const SEEDS: u64 = 50;
        let problem = (0..SEEDS).find_map(|i| Problem::of_split(Split::Validation, i, &ProblemSettings::default()));
        let Problem { observed, query, goal, viewer, camera, world_from_camera, .. } =
            problem.ok_or_else(|| CallError::internal("no seed gave a problem"))?;
        let points: Vec<Point3<f32>> = observed.points.iter().map(|p| Point3::from(*p)).collect();
        let observer = Observer::of_camera(&camera, &world_from_camera);
        let context = SceneContext::new(&points, &observed.labels, viewer.yaw_rad(), &observer, &config.cloud);
        let context = context.map_err(|e| CallError::internal(e.to_string()))?;
        let centre = context.centroid_in_world(goal.anchor).ok_or_else(|| CallError::not_found("anchor", "the scene has no anchor"))?;
        // A spiral of 3 to 20 cm around the anchor: near and far, on all sides.
        let around = |i: usize| {
            let (turn, reach) = (i as f32 * 2.399_963, 0.03 + 0.17 * (i as f32 / TRANSLATIONS as f32).sqrt());
            Candidate { position_in_world: [centre.x + reach * turn.cos(), centre.y + reach * turn.sin(), centre.z], yaw_rad: 0.0 }
        };
        Ok(Self { context, query, anchor: goal.anchor, candidates: (0..TRANSLATIONS).map(around).collect(), observed, observer })
    }

    /// Points, and operations (two a weight and neighbour) of a candidate's discriminator, the mean of the first hundred.
    fn work(&self, config: &NetworksConfig) -> Option<(usize, f64)> {
        const LOOKED_AT: usize = 100;
        let viewer = ViewerFrame::from_yaw(self.context.viewer().yaw_rad());
        let viewer_from_world = viewer.viewer_from_world().cast::<f32>();
        let in_viewer = |of: &dyn Fn(usize) -> bool| -> (Vec<Point3<f32>>, Vec<u16>) {
            let kept = (0..self.observed.points.len()).filter(|i| of(*i));
            kept.map(|i| (viewer_from_world * Point3::from(self.observed.points[i]), self.observed.labels[i])).unzip()
        };
        let query = {
            let points = in_viewer(&|i| self.observed.labels[i] == self.query).0;
            ObjectCloud::new(&points, &self.observer.turned(&viewer_from_world), &config.cloud)?
        };
        let (points, labels) = in_viewer(&|_| true);
        let centers: Vec<Point3<f32>> =
            self.context.objects().filter_map(|id| Some(viewer_from_world * self.context.centroid_in_world(id)?)).collect();
        let without_query = SceneCloud::new(&points, &labels, &centers, &config.cloud).without(self.query);
        let crops: Vec<_> = self.candidates[..LOOKED_AT]
            .iter()
            .map(|c| {
                let position = viewer_from_world * Point3::from(c.position_in_world);
                discriminator_input(Kernel::detect(), config, &without_query, &query, position.into())
            })
            .collect();
        let operations = crops.iter().flat_map(|crop| crop.levels.iter().zip(&config.discriminator_levels)).map(|(grouping, level)| {
            let inputs = std::iter::once(level.inputs()).chain(level.widths.iter().copied());
            let weights: usize = inputs.zip(&level.widths).map(|(i, o)| i * o).sum();
            2.0 * weights as f64 * grouping.neighbours.indices().len() as f64
        });
        let operations = operations.sum::<f64>() / crops.len() as f64;
        Some((crops.iter().map(|c| c.points.len()).sum::<usize>() / crops.len(), operations))
    }
}

/// Measures everything, one figure after the other.
///
/// # Errors
/// When the scene cannot be made, or the networks do not take it.
pub fn scoring_speed(models: &Models, settings: &SpeedSettings) -> Result<ScoringSpeed, CallError> {
    let scene = ScoringScene::first(models.config())?;
    let internal = |e: &dyn std::fmt::Display| CallError::internal(e.to_string());
    let (points, operations) = scene.work(models.config()).ok_or_else(|| CallError::internal("the query has no points"))?;
    let (mut discriminator_per_s, mut outcome_per_s) = ([0.0; BATCHES.len()], [0.0; BATCHES.len()]);
    for (k, batch) in BATCHES.into_iter().enumerate() {
        // Each batch is another part of the candidates, or caches would know them.
        let mut batches = scene.candidates.chunks_exact(batch).cycle();
        let mut next = || batches.next().unwrap_or_default();
        let (context, query, threads) = (&scene.context, scene.query, settings.threads);
        let realism = || models.realism(context, query, next(), threads).map(drop).map_err(|e| internal(&e));
        discriminator_per_s[k] = batch as f64 * per_second(settings.each, realism)?;
        let outcome = || models.outcome(context, query, next(), threads).map(drop).map_err(|e| internal(&e));
        outcome_per_s[k] = batch as f64 * per_second(settings.each, outcome)?;
    }
    let relations_per_s = TRANSLATIONS as f64
        * per_second(settings.each, || {
            let scored = models.relations(&scene.context, scene.query, &[scene.anchor], &scene.candidates, settings.threads);
            scored.map(drop).map_err(|e| internal(&e))
        })?;
    let prior_per_s = mixtures_per_s(models, &scene, settings)?;
    let matmul_gflops = matmul_gflops(settings).map_err(|e| internal(&e))?;
    let candidate_gflop = operations * 1e-9;
    Ok(ScoringSpeed {
        discriminator_per_s,
        outcome_per_s,
        points,
        relations_per_s,
        prior_per_s,
        matmul_share: discriminator_per_s[BATCHES.len() - 1] * candidate_gflop / matmul_gflops,
        candidate_gflop,
        matmul_gflops,
        kernel: models.kernel_id(),
        threads: settings.threads,
    })
}

/// Mixtures a second for a goal to the left, by all threads together.
fn mixtures_per_s(models: &Models, scene: &ScoringScene, settings: &SpeedSettings) -> Result<f64, CallError> {
    let per_thread = per_second(settings.each, || {
        let asked = spread(
            settings.threads,
            settings.threads,
            || (),
            // A scene keeps what it was asked before, all but the last layers of it; and the threads would wait for each other.
            |(), _| models.prior(&scene.context.with_nothing_kept(), scene.query, scene.anchor, TO_THE_LEFT),
        );
        asked.into_iter().try_for_each(|a| a.map(drop)).map_err(|e| CallError::internal(e.to_string()))
    })?;
    Ok(settings.threads as f64 * per_thread)
}

/// How often a second `work` is done, warm: one run does not count, then as many as fit.
fn per_second(each: Duration, mut work: impl FnMut() -> Result<(), CallError>) -> Result<f64, CallError> {
    work()?;
    let begin = Instant::now();
    let mut runs = 0;
    while runs == 0 || begin.elapsed() < each {
        work()?;
        runs += 1;
    }
    Ok(f64::from(runs) / begin.elapsed().as_secs_f64())
}

/// The best of many products of square matrices by the tensor library, one product a thread at a time, 10⁹ operations a second in all.
fn matmul_gflops(settings: &SpeedSettings) -> candle_core::Result<f64> {
    let operations = 2.0 * (MATRIX as f64).powi(3);
    let pools: Result<Vec<_>, _> = (0..settings.threads).map(|_| rayon::ThreadPoolBuilder::new().num_threads(1).build()).collect();
    let pools = pools.map_err(|e| candle_core::Error::Msg(e.to_string()))?;
    let matrices = |seed: usize| {
        Tensor::from_vec((0..MATRIX * MATRIX).map(|i| ((i * 7 + seed) % 13) as f32 * 0.1).collect(), (MATRIX, MATRIX), &Device::Cpu)
    };
    let (a, b): (Tensor, Tensor) = (matrices(1)?, matrices(2)?);
    let (mut best, begin) = (f64::INFINITY, Instant::now());
    while best.is_infinite() || begin.elapsed() < settings.each {
        let start = Instant::now();
        // Pools of one thread each: the library would otherwise spread every product over threads that spin for each other.
        let done = spread(settings.threads, settings.threads, || (), |(), k| pools[k].install(|| a.matmul(&b).map(drop)));
        done.into_iter().collect::<candle_core::Result<()>>()?;
        best = best.min(start.elapsed().as_secs_f64());
    }
    Ok(settings.threads as f64 * operations / best * 1e-9)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_short_measurement_has_every_figure() {
        let models = Models::embedded().expect("embedded weights");
        let speed = scoring_speed(&models, &SpeedSettings { each: Duration::from_millis(50), threads: 2 }).expect("figures");
        let figures = [
            &speed.discriminator_per_s[..],
            &speed.outcome_per_s,
            &[speed.relations_per_s, speed.prior_per_s, speed.matmul_share, speed.matmul_gflops],
        ]
        .concat();
        assert!(figures.iter().all(|f| f.is_finite() && *f > 0.0), "{speed:?}");
        let begun = matmul_gflops(&SpeedSettings { each: Duration::ZERO, threads: 1 }).expect("a figure");
        assert!(begun.is_finite() && begun > 0.0, "one product at least: {begun}");
        assert_eq!(speed.points, 2048);
        // 512 · 64 neighbours of 32 and 64 wide layers alone are 0.14 · 10⁹ at most; all levels stay below 2.
        assert!((0.05..2.0).contains(&speed.candidate_gflop), "{speed:?}");
    }
}
