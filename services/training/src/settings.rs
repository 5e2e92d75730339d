//! Settings of a training run.

use std::path::PathBuf;

use candle_core::Device;
use serde::{Deserialize, Serialize};

use crate::error::TrainError;

/// Which networks a run trains. The others keep the weights that the run started from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TrainedPart {
    /// Encoders, relation predictor and prior, jointly.
    Joint,
    /// The relation predictor alone, on the encoders that the run started from.
    Relations,
    /// The scene discriminator.
    Discriminator,
    /// The outcome network: the discriminator's layers, on outcomes of simulated releases.
    Outcome,
}

impl TrainedPart {
    /// The lower-case name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Joint => "joint",
            Self::Relations => "relations",
            Self::Discriminator => "discriminator",
            Self::Outcome => "outcome",
        }
    }

    /// The part of that name.
    pub fn parse(name: &str) -> Option<Self> {
        [Self::Joint, Self::Relations, Self::Discriminator, Self::Outcome].into_iter().find(|part| part.name() == name)
    }
}

/// Which relation predictor is fitted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RelationsVariant {
    /// Codes only.
    Paper,
    /// Codes and what can be measured of the pair ([`repose_networks::pair_measures`]).
    Measured,
}

impl RelationsVariant {
    /// The lower-case name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Paper => "paper",
            Self::Measured => "measured",
        }
    }

    /// The variant of that name.
    pub fn parse(name: &str) -> Option<Self> {
        [Self::Paper, Self::Measured].into_iter().find(|variant| variant.name() == name)
    }
}

/// What the networks are computed on while they are trained.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Compute {
    /// The fused kernels.
    Cpu,
    /// The first CUDA device, by candle's own operations; needs the `cuda` feature. Its sums are in any order.
    Cuda,
}

impl Compute {
    /// The one of that name.
    pub fn parse(name: &str) -> Option<Self> {
        match name {
            "cpu" => Some(Self::Cpu),
            "cuda" => Some(Self::Cuda),
            _ => None,
        }
    }

    /// The device.
    ///
    /// # Errors
    /// [`TrainError::Cuda`] when this build or this machine has none.
    pub fn open(self) -> Result<Device, TrainError> {
        match self {
            Self::Cpu => Ok(Device::Cpu),
            Self::Cuda => Device::new_cuda(0).map_err(TrainError::Cuda),
        }
    }
}

/// Settings of one run. Two runs on the CPU with the same settings, data and `minutes: None` give the same weights, whatever `threads` is.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TrainSettings {
    /// Folder with shards; those of training scenes are fitted, those of validation scenes are measured.
    pub data: PathBuf,
    /// The weights file that is written, at every checkpoint and at the end.
    pub out: PathBuf,
    /// Weights to start from; without, new ones from the seed.
    pub start: Option<PathBuf>,
    /// Weights of further runs: the run starts from their mean with `start` ([`crate::merge::mean_with`]). Without steps, the mean is the result.
    pub mean_with: Vec<PathBuf>,
    /// Which networks are fitted.
    pub part: TrainedPart,
    /// Which relation predictor.
    pub relations: RelationsVariant,
    /// What the networks are computed on.
    pub device: Compute,
    /// Seed of weights and samples.
    pub seed: u64,
    /// Steps at most, 0 for none. The learning rate falls to zero at the last.
    pub steps: u64,
    /// The step before which this session ends, with a checkpoint that the next session resumes: a run in parts.
    pub pause_at: Option<u64>,
    /// Minutes at most; the learning rate then follows the clock too, and the run is not repeatable.
    pub minutes: Option<f64>,
    /// Worker threads; at most `slots` have work. Changes the speed only.
    pub threads: usize,
    /// Micro-batches of a step, each with its own graph and batch statistics; their gradients are averaged in order.
    pub slots: usize,
    /// Samples of a micro-batch: candidates for the discriminator, (view, query) episodes for the joint training, views for the relation
    /// predictor's.
    pub samples_per_slot: usize,
    /// Largest learning rate.
    pub learning_rate: f64,
    /// Steps over which it rises from zero.
    pub warmup_steps: u64,
    /// Decoupled weight decay.
    pub weight_decay: f64,
    /// Gradients are scaled down to this norm.
    pub gradient_norm: f64,
    /// Steps between checkpoints (and measurements on validation scenes).
    pub checkpoint_steps: u64,
    /// Validation views that are measured.
    pub validation_episodes: usize,
    /// Prepared views that a slot draws its samples from; the oldest is replaced every step.
    pub episodes_kept: usize,
    /// Steps between looks at the data folder for new shards, so that training may start while data is still being generated. 0 never looks.
    pub rescan_steps: u64,
}

impl TrainSettings {
    /// Checks what the types cannot.
    ///
    /// # Errors
    /// [`TrainError::Setting`].
    pub fn validate(&self) -> Result<(), TrainError> {
        match self.minutes {
            // Of no such number the clock would ever reach an end.
            Some(minutes) if !(minutes.is_finite() && minutes > 0.0) => {
                Err(TrainError::Setting { field: "minutes", message: format!("expected a number above 0, got {minutes}") })
            }
            _ => Ok(()),
        }
    }

    /// The defaults for a part. One view's pairs have much in common, so the relation predictor's micro-batches mix many views; each is drawn
    /// about four times before it is replaced (with sixteen times it overfitted: the loss on validation scenes rose after 3,000 steps).
    pub fn of_part(part: TrainedPart) -> Self {
        let defaults = Self { part, ..Self::default() };
        match part {
            TrainedPart::Relations => Self {
                samples_per_slot: 4,
                episodes_kept: 400,
                weight_decay: 0.02,
                validation_episodes: 400,
                checkpoint_steps: 1000,
                ..defaults
            },
            TrainedPart::Joint | TrainedPart::Discriminator | TrainedPart::Outcome => defaults,
        }
    }
}

impl Default for TrainSettings {
    fn default() -> Self {
        Self {
            data: PathBuf::from("out/data"),
            out: PathBuf::from("out/weights.safetensors"),
            start: None,
            mean_with: Vec::new(),
            part: TrainedPart::Joint,
            relations: RelationsVariant::Measured,
            device: Compute::Cpu,
            seed: 1,
            steps: 20_000,
            pause_at: None,
            minutes: None,
            threads: 2,
            slots: 2,
            samples_per_slot: 8,
            learning_rate: 1e-3,
            warmup_steps: 200,
            weight_decay: 1e-4,
            gradient_norm: 5.0,
            checkpoint_steps: 500,
            validation_episodes: 100,
            episodes_kept: 24,
            rescan_steps: 200,
        }
    }
}
