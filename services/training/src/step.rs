//! The gradient of one step, data-parallel: every slot has its own prepared views, random numbers, graph and batch statistics.
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

use crate::{adam::Gradients, settings::TrainSettings, task::TrainingTask, views::Views};

/// How many views are tried for one that can be prepared before a slot goes without a new one.
const TRIES: usize = 20;

/// One slot's prepared views, newest last.
#[derive(Debug)]
pub struct Slot<P> {
    prepared: VecDeque<P>,
}

impl<P> Default for Slot<P> {
    fn default() -> Self {
        Self { prepared: VecDeque::new() }
    }
}

/// The result of a step.
#[derive(Debug)]
pub struct StepResult {
    /// Mean loss of the slots.
    pub loss: f64,
    /// Mean gradients.
    pub gradients: Gradients,
    /// Mean batch statistics by statistic path.
    pub statistics: BTreeMap<String, Vec<f32>>,
}

/// What all slots of a training run share.
pub struct TrainingContext<'a, T> {
    /// Which training.
    pub task: &'a T,
    /// The networks, which see the parameters' newest values.
    pub networks: &'a Networks,
    /// The parameters.
    pub parameters: &'a Parameters,
    /// Shapes.
    pub config: &'a NetworksConfig,
    /// The run's settings.
    pub settings: &'a TrainSettings,
    /// The views that samples are drawn from.
    pub views: &'a Views,
}

/// The gradient of step `step` over all slots.
///
/// # Errors
/// Tensor errors.
pub fn gradient<T: TrainingTask>(
    shared: &TrainingContext<'_, T>,
    slots: &mut [Slot<T::Prepared>],
    pools: &[rayon::ThreadPool],
    step: u64,
) -> Result<StepResult> {
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
                        let of =
                            |(k, slot): (usize, &mut Slot<T::Prepared>)| slot_gradient(shared, slot, step, (w * per_thread + k) as u64);
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

fn slot_gradient<T: TrainingTask>(
    shared: &TrainingContext<'_, T>,
    slot: &mut Slot<T::Prepared>,
    step: u64,
    number: u64,
) -> Result<StepResult> {
    let settings = shared.settings;
    let most = settings.episodes_kept.max(1);
    // The first step fills half of the store, later ones add one view each; a resumed run starts with what the store would hold by then.
    let draws = if slot.prepared.is_empty() { (most as u64 / 2).max(1) + step } else { 1 };
    let mut newest = VecDeque::new();
    for k in 0..draws {
        if newest.len() == most {
            break;
        }
        let mut rng = generator(settings.seed, step.wrapping_sub(k), number.wrapping_mul(2));
        if let Some(prepared) = draw(shared, &mut rng)? {
            newest.push_front(prepared);
        }
    }
    slot.prepared.append(&mut newest);
    while slot.prepared.len() > most {
        slot.prepared.pop_front();
    }
    let mut rng = generator(settings.seed, step, number.wrapping_mul(2) + 1);
    let mut prepared: Vec<&T::Prepared> = slot.prepared.iter().collect();
    if prepared.is_empty() {
        return Err(nothing_prepared());
    }
    for i in (1..prepared.len()).rev() {
        prepared.swap(i, rng.random_range(0..=i));
    }
    let mode = Mode::Training(BatchStatistics::default());
    let loss = shared.task.loss(shared.networks, shared.config, &prepared, settings.samples_per_slot, &mode, &mut rng)?;
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

/// A random view prepared for a random query of it, or none after some tries.
///
/// # Errors
/// Tensor errors.
pub fn draw<T: TrainingTask>(shared: &TrainingContext<'_, T>, rng: &mut Pcg64) -> Result<Option<T::Prepared>> {
    for _ in 0..TRIES {
        let Some(drawn) = shared.views.query(rng.random_range(0..shared.views.queries())) else { continue };
        let prepared = shared.task.prepare(shared.networks, shared.config, &drawn, rng)?;
        if prepared.is_some() {
            return Ok(prepared);
        }
    }
    Ok(None)
}

/// Why there is nothing to learn from, though there are views: each that was drawn shows too little.
pub fn nothing_prepared() -> candle_core::Error {
    candle_core::Error::Msg(format!("no view of the data could be prepared in {TRIES} tries"))
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
