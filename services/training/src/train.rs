//! The training loop: steps, learning rate, checkpoints, measurements, progress.

use std::{
    collections::BTreeMap,
    path::Path,
    time::{Duration, Instant},
};

use candle_core::Tensor;
use indicatif::{ProgressBar, ProgressStyle};
use repose_dataset::Split;
use repose_networks::{
    Networks, NetworksConfig, Weights, WeightsInfo,
    layers::{BatchStatistics, Mode},
    parameters::{DISCRIMINATOR, OUTCOME, Parameters, RELATIONS, WeightMap},
};

use crate::{
    adam::{AdamW, clip},
    checkpoint::{self, Origin, name_of},
    curve::{Curve, CurvePoint},
    discriminator::MovedPlaces,
    error::TrainError,
    joint::JointTask,
    merge::{forget_reader_of_relations, mean_with},
    outcome::ReleasedPlaces,
    placement::PlacementTask,
    relations::RelationsTask,
    settings::{RelationsVariant, TrainSettings, TrainedPart},
    step::{Slot, TrainingContext, draw, generator, gradient, nothing_prepared},
    task::TrainingTask,
    views::Views,
};

// The rates and counts below are ours; no comparison of values is recorded.

/// How fast running statistics follow the batches'.
const STATISTICS_RATE: f32 = 0.03;
/// Micro-batches that the saved weights' batch statistics are taken from, and the episodes that each is drawn from.
const STATISTICS_BATCHES: u64 = 32;
const STATISTICS_EPISODES: usize = 6;
/// How fast the averaged weights that are saved follow the trained ones, once training is under way.
const AVERAGE_RATE: f32 = 0.005;

/// Environment variables that keep candle on the calling worker's thread when they are 1 at the start of the process. Otherwise it spreads each
/// operation over a pool whose threads spin while they wait, which took a third of the time of a training on two busy cores.
pub const ONE_THREAD_VARIABLES: [&str; 2] = ["RAYON_NUM_THREADS", "CANDLE_NUM_THREADS"];

/// The result of a run.
#[derive(Debug, Clone, serde::Serialize)]
pub struct TrainReport {
    /// Steps done, those before a resumed checkpoint included.
    pub steps: u64,
    /// Training views read.
    pub views: usize,
    /// Samples (candidates, or pairs' episodes) a second of this run.
    pub samples_per_s: f64,
    /// Figures on validation scenes at the end; null without such scenes.
    pub metrics: serde_json::Value,
}

/// Trains one part for its steps or minutes, writing weights to `settings.out`.
///
/// Resumes from a checkpoint beside `settings.out` (of the same part and seed); one of a run that began with other weights is refused.
///
/// # Errors
/// [`TrainError`] when a setting is out of its range, the data is missing or broken, a file cannot be written, or the loss diverges.
pub fn train(settings: &TrainSettings) -> Result<TrainReport, TrainError> {
    settings.validate()?;
    match settings.part {
        TrainedPart::Joint => Run::new(settings, &JointTask::default())?.run(),
        TrainedPart::Relations => Run::new(settings, &RelationsTask::default())?.run(),
        TrainedPart::Discriminator => Run::new(settings, &PlacementTask(MovedPlaces::default()))?.run(),
        TrainedPart::Outcome => Run::new(settings, &PlacementTask(ReleasedPlaces))?.run(),
    }
}

struct Run<'a, T: TrainingTask> {
    settings: &'a TrainSettings,
    task: &'a T,
    config: NetworksConfig,
    networks: Networks,
    parameters: Parameters,
    info: WeightsInfo,
    origin: Origin,
    /// Averaged trainable weights by path: what is measured and saved.
    average: WeightMap,
    adam: AdamW,
    step: u64,
    views: Views,
    validation: Vec<T::Prepared>,
    curve: Curve,
    /// Running mean of the training loss.
    loss: Option<f64>,
}

/// What a run begins with.
struct Beginning {
    config: NetworksConfig,
    networks: Networks,
    parameters: Parameters,
    info: WeightsInfo,
    origin: Origin,
}

impl Beginning {
    /// The weights that the settings name to start from, or new ones.
    fn of(settings: &TrainSettings) -> Result<Self, TrainError> {
        let device = settings.device.open()?;
        let mut origin = Origin { start: None, mean_with: Vec::new(), relations: settings.relations };
        let (config, (networks, parameters), info) = match &settings.start {
            Some(path) => {
                let mut weights = read("start", path)?;
                origin.start = Some(name_of(&weights, path, &settings.out));
                let mut others = Vec::new();
                for path in &settings.mean_with {
                    let weights = read("mean_with", path)?;
                    origin.mean_with.push(name_of(&weights, path, &settings.out));
                    others.push((path.clone(), weights.values));
                }
                mean_with(&mut weights.values, &others, settings.part)?;
                let config = shapes(settings, Some(&weights.values));
                let rng = &mut generator(settings.seed, 0, u64::MAX);
                let networks = Networks::started(&config, &starting(weights.values), rng, &device)?;
                if settings.part.fits(RELATIONS) {
                    forget_reader_of_relations(&mut weights.info);
                }
                (config, networks, weights.info)
            }
            None if settings.part == TrainedPart::Relations => {
                return Err(TrainError::NoStart("the relation predictor is trained on encoders that are trained already"));
            }
            None if !settings.mean_with.is_empty() => {
                return Err(TrainError::NoStart("mean_with needs weights whose mean is taken with the others"));
            }
            None => {
                let config = shapes(settings, None);
                let networks = Networks::seeded(&config, &mut generator(settings.seed, 0, u64::MAX), &device)?;
                (config, networks, WeightsInfo::default())
            }
        };
        Ok(Self { config, networks, parameters, info, origin })
    }
}

impl<'a, T: TrainingTask> Run<'a, T> {
    fn new(settings: &'a TrainSettings, task: &'a T) -> Result<Self, TrainError> {
        let Beginning { config, networks, parameters, info, origin } = Beginning::of(settings)?;
        let views = training_views(settings)?;
        let average = parameters.to_map()?;
        let mut run = Self {
            settings,
            task,
            config,
            networks,
            parameters,
            info,
            origin,
            average,
            adam: AdamW::default(),
            step: 0,
            views,
            validation: Vec::new(),
            curve: Curve::default(),
            loss: None,
        };
        run.resume()?;
        let validation_views = views_of(settings, Split::Validation)?;
        if validation_views.is_empty() {
            tracing::warn!(
                data = %settings.data.display(),
                "there are no validation scenes: nothing will say how good the weights are; `repose generate --split validation` makes some"
            );
        } else {
            let shared = TrainingContext { views: &validation_views, ..run.shared() };
            let prepared = (0..settings.validation_episodes as u64).map(|i| draw(&shared, &mut generator(0, i, u64::MAX)));
            run.validation = prepared.filter_map(Result::transpose).collect::<Result<_, _>>()?;
        }
        Ok(run)
    }

    fn shared(&self) -> TrainingContext<'_, T> {
        TrainingContext {
            task: self.task,
            networks: &self.networks,
            parameters: &self.parameters,
            config: &self.config,
            settings: self.settings,
            views: &self.views,
        }
    }

    fn run(mut self) -> Result<TrainReport, TrainError> {
        let settings = self.settings;
        let pools = (0..settings.threads.max(1))
            .map(|_| rayon::ThreadPoolBuilder::new().num_threads(1).build())
            .collect::<Result<Vec<_>, _>>()
            .map_err(|e| candle_core::Error::Msg(e.to_string()))?;
        let mut slots: Vec<Slot<T::Prepared>> = (0..settings.slots.max(1)).map(|_| Slot::default()).collect();
        let spinning = candle_core::utils::get_num_threads();
        if spinning > 1 {
            tracing::warn!(
                threads = spinning,
                "candle's own threads compete with the workers; set {} to 1",
                ONE_THREAD_VARIABLES.join(" and ")
            );
        }
        let bar = progress_bar(settings);
        let (begin, first_step) = (Instant::now(), self.step);
        tracing::info!(part = self.task.part().name(), views = self.views.len(), parameters = self.parameters.count(), "training");
        loop {
            let share = progress(settings, self.step, begin.elapsed());
            if share >= 1.0 || settings.pause_at.is_some_and(|step| self.step >= step) {
                break;
            }
            if settings.rescan_steps > 0 && self.step % settings.rescan_steps == settings.rescan_steps - 1 {
                self.views.rescan()?;
            }
            let mut result = gradient(&self.shared(), &mut slots, &pools, self.step)?;
            if !result.loss.is_finite() {
                return Err(TrainError::Diverged { step: self.step, loss: result.loss });
            }
            let norm = clip(&mut result.gradients, settings.gradient_norm);
            let rate = learning_rate(settings, self.step, share);
            self.adam.step(&self.parameters.trainable, &result.gradients, rate, settings.weight_decay)?;
            self.follow(&result.statistics)?;
            self.step += 1;
            let loss = self.loss.map_or(result.loss, |mean| mean + 0.02 * (result.loss - mean));
            self.loss = Some(loss);
            let speed =
                ((self.step - first_step) * (settings.slots * settings.samples_per_slot) as u64) as f64 / begin.elapsed().as_secs_f64();
            bar.set_position((1000.0 * share) as u64);
            bar.set_message(format!("step {} loss {loss:.4} |g| {norm:.2} {speed:.1} samples/s", self.step));
            if self.step.is_multiple_of(100) {
                tracing::info!(step = self.step, loss, norm, rate, samples_per_s = speed, views = self.views.len(), "progress");
            }
            if self.step.is_multiple_of(settings.checkpoint_steps.max(1)) {
                self.save()?;
            }
        }
        let metrics = self.save()?;
        bar.finish();
        let samples = ((self.step - first_step) * (settings.slots * settings.samples_per_slot) as u64) as f64;
        Ok(TrainReport { steps: self.step, views: self.views.len(), samples_per_s: samples / begin.elapsed().as_secs_f64(), metrics })
    }

    /// Running statistics and averaged weights follow the step.
    fn follow(&mut self, statistics: &BTreeMap<String, Vec<f32>>) -> Result<(), TrainError> {
        // Early on both follow faster; otherwise they would keep the initial weights for too long.
        let early = 1.0 / (1.0 + self.step as f32);
        for (name, batch) in statistics {
            if let Some(var) = self.parameters.statistics.get(name) {
                let mut values = var.flatten_all()?.to_vec1::<f32>()?;
                let rate = STATISTICS_RATE.max(early);
                values.iter_mut().zip(batch).for_each(|(v, b)| *v += rate * (b - *v));
                var.set(&Tensor::from_vec(values, var.shape(), var.device())?)?;
            }
        }
        let rate = AVERAGE_RATE.max(10.0 * early).min(1.0);
        for (name, var) in self.parameters.trainable.iter().filter(|(name, _)| self.task.fits(name)) {
            let values = var.flatten_all()?.to_vec1::<f32>()?;
            if let Some((_, average)) = self.average.get_mut(name) {
                average.iter_mut().zip(values).for_each(|(a, v)| *a += rate * (v - *a));
            }
        }
        Ok(())
    }

    /// The weights that are saved: averaged where fitted, with the running statistics.
    fn weights(&self) -> Result<WeightMap, TrainError> {
        let mut weights = self.parameters.to_map()?;
        for (name, value) in &self.average {
            if self.parameters.trainable.contains_key(name) && self.task.fits(name) {
                weights.insert(name.clone(), value.clone());
            }
        }
        Ok(weights)
    }

    /// The batch norms' statistics under given weights, from training episodes. Running statistics belong to the weights of the moment; averaged
    /// weights have others (Izmailov et al. 2018, "Averaging weights leads to wider optima", section 3.2).
    fn statistics_of(&self, networks: &Networks) -> Result<BTreeMap<String, Vec<f32>>, TrainError> {
        let shared = self.shared();
        let mut sums: BTreeMap<String, Vec<f32>> = BTreeMap::new();
        if !self.parameters.statistics.keys().any(|name| self.task.fits(name)) {
            return Ok(sums);
        }
        for k in 0..STATISTICS_BATCHES {
            let mut rng = generator(self.settings.seed, self.step, u64::MAX - 1 - k);
            let drawn = (0..STATISTICS_EPISODES).map(|_| draw(&shared, &mut rng));
            let prepared: Vec<T::Prepared> = drawn.filter_map(Result::transpose).collect::<Result<_, _>>()?;
            if prepared.is_empty() {
                return Err(nothing_prepared().into());
            }
            let mode = Mode::Training(BatchStatistics::default());
            let samples = self.settings.samples_per_slot;
            self.task.loss(networks, &self.config, &prepared.iter().collect::<Vec<_>>(), samples, &mode, &mut rng)?;
            if let Mode::Training(statistics) = mode {
                for (name, values) in statistics.into_inner() {
                    let sum = sums.entry(name).or_insert_with(|| vec![0.0; values.len()]);
                    sum.iter_mut().zip(values).for_each(|(s, v)| *s += v / STATISTICS_BATCHES as f32);
                }
            }
        }
        Ok(sums)
    }

    /// Measures on validation scenes and writes weights and checkpoint. Nothing is written of what is no longer finite: nobody could read it, and
    /// no run go on from it.
    fn save(&mut self) -> Result<serde_json::Value, TrainError> {
        let mut weights = self.weights()?;
        let (averaged, _) = Networks::stored(&self.config, &weights, &self.networks.device)?;
        for (name, values) in self.statistics_of(&averaged)? {
            if let Some((_, stored)) = weights.get_mut(&name) {
                *stored = values;
            }
        }
        let values = self.parameters.to_map()?;
        if let Some((parameter, _)) = weights.iter().chain(&values).find(|(_, (_, numbers))| numbers.iter().any(|x| !x.is_finite())) {
            return Err(TrainError::NotFinite { step: self.step, parameter: parameter.clone() });
        }
        let (averaged, _) = Networks::stored(&self.config, &weights, &self.networks.device)?;
        let metrics = match self.validation.is_empty() {
            // Figures of no scenes would look like figures.
            true => serde_json::Value::Null,
            false => self.task.measure(&averaged, &self.config, &self.validation, &mut generator(0, 1, u64::MAX))?,
        };
        let part = self.task.part().name();
        tracing::info!(step = self.step, %metrics, "validation");
        set(&mut self.info.metrics, part, metrics.clone());
        let mut recipe = serde_json::json!({ "settings": self.settings, "steps": self.step, "views": self.views.len(), "train_seeds": Split::Train.seeds() });
        if let Some(settings) = recipe["settings"].as_object_mut() {
            settings.insert("mean_of".to_owned(), (1 + self.settings.mean_with.len()).into());
            // Paths, threads and pauses do not change the weights.
            settings.retain(|key, _| !["data", "out", "start", "mean_with", "threads", "pause_at"].contains(&key.as_str()));
        }
        set(&mut self.info.recipe, part, recipe);
        checkpoint::write(&self.settings.out, &Weights::to_bytes(&weights, &self.info)?)?;
        checkpoint::save(self.settings, &self.origin, self.step, &values, &self.average, &self.adam)?;
        // A finished run that is resumed has its last point already.
        let before = self.curve.points.last().map(|point| point.step);
        if let Some(loss) = self.loss.filter(|_| before.is_none_or(|step| step < self.step)) {
            self.curve.add(self.settings, CurvePoint { step: self.step, loss, validation: metrics.clone() })?;
        }
        Ok(metrics)
    }

    fn resume(&mut self) -> Result<(), TrainError> {
        if let Some(state) = checkpoint::load(self.settings, &self.origin)? {
            let (networks, parameters) = Networks::stored(&self.config, &state.values, &self.networks.device)?;
            (self.networks, self.parameters) = (networks, parameters);
            (self.average, self.adam, self.step) = (state.average, state.adam, state.step);
            self.curve = Curve::resumed(self.settings, self.step)?;
            // The running mean goes on: begun anew, it would be one step's loss at first.
            self.loss = self.curve.points.last().map(|point| point.loss);
            tracing::info!(step = self.step, "resumed");
        }
        Ok(())
    }
}

/// The views that a run draws its samples from.
fn views_of(settings: &TrainSettings, split: Split) -> Result<Views, TrainError> {
    let open = if settings.part == TrainedPart::Outcome { Views::released } else { Views::open };
    Ok(open(&settings.data, split)?)
}

/// The training views; why there are none to learn from, where there are none.
fn training_views(settings: &TrainSettings) -> Result<Views, TrainError> {
    let views = views_of(settings, Split::Train)?;
    let (folder, split) = (settings.data.clone(), Split::Train.name());
    match views.is_empty() {
        false => Ok(views),
        true if settings.part == TrainedPart::Outcome && !Views::open(&settings.data, Split::Train)?.is_empty() => {
            Err(TrainError::NoOutcomes { folder, split })
        }
        true => Err(TrainError::Empty { folder, split }),
    }
}

/// The shapes of a run's networks. A relation predictor that is not fitted stays of the variant that it is of in the weights to start from.
fn shapes(settings: &TrainSettings, start: Option<&WeightMap>) -> NetworksConfig {
    let fitted = match settings.relations {
        RelationsVariant::Paper => None,
        RelationsVariant::Measured => NetworksConfig::default().measures_code,
    };
    let is_kept = |weights: &&WeightMap| !settings.part.fits(RELATIONS) && weights.keys().any(|path| path.starts_with(RELATIONS));
    let measures_code = start.filter(is_kept).map_or(fitted, |weights| NetworksConfig::of_weights(weights).measures_code);
    NetworksConfig { measures_code, ..NetworksConfig::default() }
}

/// Weights to start from. A missing outcome network starts as a copy of the discriminator, which knows what objects at rest look like.
fn starting(mut weights: WeightMap) -> WeightMap {
    if !weights.keys().any(|path| path.starts_with(OUTCOME)) {
        let as_outcome =
            |(path, value): (&String, &_)| Some((format!("{OUTCOME}{}", path.strip_prefix(DISCRIMINATOR)?), Clone::clone(value)));
        let copies: WeightMap = weights.iter().filter_map(as_outcome).collect();
        weights.extend(copies);
    }
    weights
}

/// The share of the run that is done, by steps or by the clock, whichever is further.
fn progress(settings: &TrainSettings, step: u64, elapsed: Duration) -> f64 {
    let by_steps = if settings.steps == 0 { 1.0 } else { step as f64 / settings.steps as f64 };
    by_steps.max(settings.minutes.map_or(0.0, |m| elapsed.as_secs_f64() / (60.0 * m)))
}

/// Linear rise, then a half cosine down to a hundredth.
fn learning_rate(settings: &TrainSettings, step: u64, share: f64) -> f64 {
    let rise = ((step + 1) as f64 / settings.warmup_steps.max(1) as f64).min(1.0);
    let fall = 0.01 + 0.99 * 0.5 * (1.0 + (std::f64::consts::PI * share.clamp(0.0, 1.0)).cos());
    settings.learning_rate * rise * fall
}

fn progress_bar(settings: &TrainSettings) -> ProgressBar {
    let bar = ProgressBar::new(1000);
    let template = format!("{} [{{bar:30}}] {{percent}} % · {{msg}} · {{eta}} left", settings.part.name());
    if let Ok(style) = ProgressStyle::with_template(&template) {
        bar.set_style(style.progress_chars("=> "));
    }
    bar
}

fn set(object: &mut serde_json::Value, key: &str, value: serde_json::Value) {
    if !object.is_object() {
        *object = serde_json::json!({});
    }
    object[key] = value;
}

/// Weights to start from, as `field` names them.
fn read(field: &'static str, path: &Path) -> Result<Weights, TrainError> {
    let bytes = std::fs::read(path).map_err(|source| TrainError::StartFile { field, path: path.to_path_buf(), source })?;
    Weights::from_bytes(&bytes).map_err(|source| TrainError::StartWeights { field, path: path.to_path_buf(), source })
}
