//! The planner's models on one scene that is held: what the tables plan with.

use std::sync::Arc;

use repose_inference::{Engine, HeldScene};
use repose_planner::{Forecasts, PlacementModels};
use repose_proto::scoring::{PriorReply, PriorRequest, ScoreReply, ScoreRequest};
use repose_proto::{CallError, Scene};

/// An engine and the scene that it is asked about.
pub struct OneScene<'a> {
    engine: &'a Engine,
    held: HeldScene,
    forecasts: Option<Arc<Forecasts>>,
}

/// The forecasts of an engine's weights, to be read once for many scenes.
///
/// # Errors
/// `failed_precondition` when the weights have none that this program reads.
pub fn forecasts_of(engine: &Engine) -> Result<Arc<Forecasts>, CallError> {
    Forecasts::read(&engine.forecasts().forecasts).map(Arc::new)
}

impl<'a> OneScene<'a> {
    /// Holds a scene. Hashes it for its id.
    pub fn new(engine: &'a Engine, scene: Arc<Scene>) -> Self {
        Self { engine, held: HeldScene::new(scene.id(), scene), forecasts: None }
    }

    /// The same with the forecasts of the engine's weights, which the variant `best` asks for.
    pub fn with_forecasts(self, forecasts: &Arc<Forecasts>) -> Self {
        Self { forecasts: Some(forecasts.clone()), ..self }
    }

    /// The scene's id.
    pub fn scene_id(&self) -> &str {
        self.held.scene_id()
    }

    /// The scene.
    pub fn scene(&self) -> &Arc<Scene> {
        self.held.scene()
    }
}

impl PlacementModels for OneScene<'_> {
    fn prior(&self, request: &PriorRequest, _: &Arc<Scene>) -> Result<PriorReply, CallError> {
        self.engine.prior(request, &self.held)
    }

    fn score(&self, request: &ScoreRequest, _: &Arc<Scene>) -> Result<ScoreReply, CallError> {
        self.engine.score(request, &self.held)
    }

    fn forecasts(&self) -> Result<Arc<Forecasts>, CallError> {
        match &self.forecasts {
            Some(forecasts) => Ok(forecasts.clone()),
            None => forecasts_of(self.engine),
        }
    }
}
