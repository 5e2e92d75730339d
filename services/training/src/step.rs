//! The gradient of one step, data-parallel: every slot has its own episodes, random numbers, graph and batch statistics.
//!
//! Slots are averaged in their order, so the result depends on the number of slots, not of threads. Each worker runs in a rayon pool of
//! its own with one thread, or candle's products would all fight over every core.

use std::collections::{BTreeMap, VecDeque};

use candle_core::Result;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use repose_networks::{
    Networks, NetworksConfig,
    layers::{BatchStatistics, Mode},
    parameters::Parameters,
};

use crate::{
    adam::Gradients,
    episode::{Episode, EpisodeSettings},
    settings::TrainSettings,
    task::Task,
    views::Views,
};

/// How many draws an episode may take before a slot goes without a new one.
const TRIES: usize = 20;

/// One slot's prepared episodes, newest last.
#[derive(Debug, Default)]
pub struct Slot {
    episodes: VecDeque<Episode>,
}

/// What a step gives.
#[derive(Debug)]
pub struct StepResult {
    /// Mean loss of the slots.
    pub loss: f64,
    /// Mean gradients.
    pub gradients: Gradients,
    /// Mean batch statistics by statistic path.
    pub statistics: BTreeMap<String, Vec<f32>>,
}

/// What all slots of a run share.
#[derive(Clone, Copy)]
pub struct Shared<'a> {
    /// What is fitted.
    pub task: &'a dyn Task,
    /// The networks, which see the parameters' newest values.
    pub networks: &'a Networks,
    /// The parameters.
    pub parameters: &'a Parameters,
    /// Shapes.
    pub config: &'a NetworksConfig,
    /// The run's settings.
    pub settings: &'a TrainSettings,
    /// How episodes are disturbed.
    pub episode: &'a EpisodeSettings,
    /// What episodes are drawn from.
    pub views: &'a Views,
}

/// The gradient of step `step` over all slots.
///
/// # Errors
/// Tensor errors.
pub fn gradient(shared: &Shared<'_>, slots: &mut [Slot], pools: &[rayon::ThreadPool], step: u64) -> Result<StepResult> {
    let per_thread = slots.len().div_ceil(pools.len().max(1));
    let mut results: Vec<Result<StepResult>> = Vec::new();
    std::thread::scope(|scope| {
        let workers: Vec<_> = slots
            .chunks_mut(per_thread.max(1))
            .zip(pools)
            .enumerate()
            .map(|(w, (slots, pool))| {
                scope.spawn(move || {
                    pool.install(|| {
                        let of = |(k, slot): (usize, &mut Slot)| slot_gradient(shared, slot, step, (w * per_thread + k) as u64);
                        slots.iter_mut().enumerate().map(of).collect::<Vec<_>>()
                    })
                })
            })
            .collect();
        for worker in workers {
            match worker.join() {
                Ok(done) => results.extend(done),
                Err(panic) => std::panic::resume_unwind(panic),
            }
        }
    });
    mean(results.into_iter().collect::<Result<Vec<_>>>()?)
}

/// A generator for one purpose at one step: independent of what was drawn before, so that a resumed run draws what it would have.
pub fn generator(seed: u64, step: u64, slot: u64) -> Pcg64 {
    let mixed = [step, slot]
        .iter()
        .fold(seed, |h, x| (h ^ x.wrapping_mul(0x9e37_79b9_7f4a_7c15)).rotate_left(29).wrapping_mul(0xbf58_476d_1ce4_e5b9));
    Pcg64::seed_from_u64(mixed)
}

fn slot_gradient(shared: &Shared<'_>, slot: &mut Slot, step: u64, number: u64) -> Result<StepResult> {
    let settings = shared.settings;
    // The first step fills half of the store, later ones add one episode each.
    let wanted = if slot.episodes.is_empty() { (settings.episodes_kept as u64 / 2).max(1) } else { 1 };
    for k in (0..wanted).rev() {
        let mut rng = generator(settings.seed, step.wrapping_sub(k), number.wrapping_mul(2));
        if let Some(episode) = draw(shared, &mut rng) {
            slot.episodes.push_back(episode);
        }
    }
    while slot.episodes.len() > settings.episodes_kept.max(1) {
        slot.episodes.pop_front();
    }
    let mut rng = generator(settings.seed, step, number.wrapping_mul(2) + 1);
    let mut episodes: Vec<&Episode> = slot.episodes.iter().collect();
    if episodes.is_empty() {
        candle_core::bail!("no episode could be made from the data in {TRIES} tries");
    }
    for i in (1..episodes.len()).rev() {
        episodes.swap(i, rng.random_range(0..=i));
    }
    let mode = Mode::Training(BatchStatistics::default());
    let loss = shared.task.loss(shared.networks, shared.config, &episodes, settings.samples_per_slot, &mode, &mut rng)?;
    let store = loss.backward()?;
    let mut gradients = Gradients::new();
    for (name, var) in shared.parameters.trainable.iter().filter(|(name, _)| shared.task.fits(name)) {
        if let Some(gradient) = store.get(var) {
            gradients.insert(name.clone(), gradient.flatten_all()?.to_vec1::<f32>()?);
        }
    }
    let statistics = match mode {
        Mode::Training(statistics) => statistics.into_inner(),
        Mode::Serving => BTreeMap::new(),
    };
    Ok(StepResult { loss: f64::from(loss.to_scalar::<f32>()?), gradients, statistics })
}

/// An episode of a random query, or none after some tries.
pub fn draw(shared: &Shared<'_>, rng: &mut Pcg64) -> Option<Episode> {
    (0..TRIES).find_map(|_| {
        let (view, query) = shared.views.query(rng.random_range(0..shared.views.queries()))?;
        let releases = shared.views.releases_of(view.scene_seed, view.objects[query].id);
        Episode::new(&view, query, releases, &shared.config.cloud, shared.episode, rng)
    })
}

fn mean(results: Vec<StepResult>) -> Result<StepResult> {
    let share = 1.0 / results.len().max(1) as f32;
    let mut total = StepResult { loss: 0.0, gradients: Gradients::new(), statistics: BTreeMap::new() };
    for result in results {
        total.loss += result.loss * f64::from(share);
        for (into, from) in [(&mut total.gradients, result.gradients), (&mut total.statistics, result.statistics)] {
            for (name, values) in from {
                let sum = into.entry(name).or_insert_with(|| vec![0.0; values.len()]);
                sum.iter_mut().zip(values).for_each(|(s, v)| *s += share * v);
            }
        }
    }
    Ok(total)
}
