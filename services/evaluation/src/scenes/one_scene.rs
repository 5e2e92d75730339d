//! One observed scene, and the planner's models that are asked about it and about what a search makes of it.

use std::sync::Arc;

use repose_inference::Engine;
use repose_planner::{Forecasts, PlacementModels};
use repose_proto::scoring::{PriorReply, PriorRequest, ScoreReply, ScoreRequest};
use repose_proto::{CallError, Scene};

use crate::scenes::held_scenes::HeldScenes;

/// A scene and the models.
pub struct OneScene<'a> {
    scene: Arc<Scene>,
    scene_id: String,
    models: HeldScenes<'a>,
}

impl<'a> OneScene<'a> {
    /// Of a scene. Hashes it for its id.
    pub fn new(engine: &'a Engine, scene: Arc<Scene>) -> Self {
        Self { scene_id: scene.id(), scene, models: HeldScenes::new(engine) }
    }

    /// The same with the forecasts of the engine's weights, which the variant `best` asks for.
    pub fn with_forecasts(self, forecasts: &Arc<Forecasts>) -> Self {
        Self { models: self.models.with_forecasts(forecasts), ..self }
    }

    /// The scene's id.
    pub fn scene_id(&self) -> &str {
        &self.scene_id
    }

    /// The scene.
    pub fn scene(&self) -> &Arc<Scene> {
        &self.scene
    }
}

impl PlacementModels for OneScene<'_> {
    fn prior(&self, request: &PriorRequest, scene: &Arc<Scene>) -> Result<PriorReply, CallError> {
        self.models.prior(request, scene)
    }

    fn score(&self, request: &ScoreRequest, scene: &Arc<Scene>) -> Result<ScoreReply, CallError> {
        self.models.score(request, scene)
    }

    fn forecasts(&self) -> Result<Arc<Forecasts>, CallError> {
        self.models.forecasts()
    }
}
