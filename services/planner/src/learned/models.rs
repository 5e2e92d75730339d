//! The port to the networks, which remote inference, in-process inference and the tests' fakes implement.

use std::sync::Arc;

use repose_proto::CallError;
use repose_proto::Scene;
use repose_proto::scoring::{PriorReply, PriorRequest, ScoreReply, ScoreRequest};

use crate::learned::forecast::Forecasts;

/// Which weights and kernel answered.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Provenance {
    /// BLAKE3 of the weights.
    pub weights_hash: String,
    /// The kernel.
    pub kernel: String,
}

/// The learned prior, relation predictor and discriminator. Synchronous: the planner's compute threads own the search and wait.
///
/// All replies to one request must come from the same weights and kernel.
pub trait PlacementModels: Send + Sync {
    /// Draws from the prior, and its mixture.
    ///
    /// # Errors
    /// What inference answers.
    fn prior(&self, request: &PriorRequest, scene: &Arc<Scene>) -> Result<PriorReply, CallError>;

    /// Scores candidates.
    ///
    /// # Errors
    /// What inference answers.
    fn score(&self, request: &ScoreRequest, scene: &Arc<Scene>) -> Result<ScoreReply, CallError>;

    /// The forecasts of the weights that answered, to be asked for after an answer.
    ///
    /// # Errors
    /// What inference answers; `failed_precondition` when the weights have none that this program reads.
    fn forecasts(&self) -> Result<Arc<Forecasts>, CallError>;
}

/// No models: enough for [`Variant::Geometric`](repose_proto::place::Variant::Geometric), an error for every other variant.
#[derive(Debug, Clone, Copy, Default)]
pub struct NoModels;

impl PlacementModels for NoModels {
    fn prior(&self, _: &PriorRequest, _: &Arc<Scene>) -> Result<PriorReply, CallError> {
        Err(CallError::precondition("this variant needs the learned models, and none are loaded").at("variant"))
    }

    fn score(&self, _: &ScoreRequest, _: &Arc<Scene>) -> Result<ScoreReply, CallError> {
        Err(CallError::precondition("this variant needs the learned models, and none are loaded").at("variant"))
    }

    fn forecasts(&self) -> Result<Arc<Forecasts>, CallError> {
        Err(CallError::precondition("this variant needs the learned models, and none are loaded").at("variant"))
    }
}
