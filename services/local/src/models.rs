//! The networks and the forecasts in this process.

use std::path::PathBuf;
use std::sync::Arc;

use repose_inference::{Engine, HeldScene, InferenceConfig, engine_of};
use repose_planner::{Forecasts, PlacementModels};
use repose_proto::scoring::{PriorReply, PriorRequest, ScoreReply, ScoreRequest};
use repose_proto::{CallError, Scene};
use repose_runtime::{SceneStore, check_scene_id};

use crate::configured::section;

/// Scenes held at once; who works through many goes from one to the next.
const SCENES: usize = 2;
const SCENES_BYTES: usize = 1 << 30;

/// A file in place of the models that come with the program. Where none is named it is taken from the environment as services take it
/// (REPOSE_INFERENCE__WEIGHTS), and else from the program.
#[derive(Debug, Clone, Default)]
pub struct ModelFiles {
    /// A weights file.
    pub weights: Option<PathBuf>,
}

/// The learned models, computed in this process on every core.
pub struct LocalModels {
    engine: Engine,
    store: SceneStore<HeldScene>,
    /// Weights without forecasts do for everything but the variant `best`.
    forecasts: Result<Arc<Forecasts>, CallError>,
}

impl LocalModels {
    /// Loads the models and tries them once.
    ///
    /// # Errors
    /// `invalid_argument` on `weights` or `config` when a file cannot be read or does not fit.
    pub fn load(files: &ModelFiles) -> Result<Self, CallError> {
        let mut inference: InferenceConfig = section("inference")?;
        inference.weights = files.weights.clone().or(inference.weights);
        let engine = engine_of(&inference).map_err(|e| CallError::invalid("weights", e.to_string()))?;
        Ok(Self::of(engine))
    }

    /// The models that come with the program, whatever the environment says.
    ///
    /// # Errors
    /// `internal` when they do not fit this program.
    pub fn embedded() -> Result<Self, CallError> {
        let engine = engine_of(&InferenceConfig::default()).map_err(|e| CallError::internal(e.to_string()))?;
        Ok(Self::of(engine))
    }

    fn of(engine: Engine) -> Self {
        let forecasts = Forecasts::read(&engine.forecasts().forecasts).map(Arc::new);
        Self { engine, store: SceneStore::new(SCENES, SCENES_BYTES, HeldScene::bytes), forecasts }
    }

    /// The networks.
    pub fn engine(&self) -> &Engine {
        &self.engine
    }

    fn held(&self, scene_id: &str, scene: &Arc<Scene>) -> Result<Arc<HeldScene>, CallError> {
        if let Ok(held) = self.store.get(scene_id) {
            return Ok(held);
        }
        check_scene_id(scene, scene_id)?;
        Ok(self.store.keep(scene_id, Arc::new(HeldScene::new(scene_id.to_owned(), scene.clone()))))
    }
}

impl PlacementModels for LocalModels {
    fn prior(&self, request: &PriorRequest, scene: &Arc<Scene>) -> Result<PriorReply, CallError> {
        self.engine.prior(request, &*self.held(&request.scene.scene_id, scene)?)
    }

    fn score(&self, request: &ScoreRequest, scene: &Arc<Scene>) -> Result<ScoreReply, CallError> {
        self.engine.score(request, &*self.held(&request.scene.scene_id, scene)?)
    }

    fn forecasts(&self) -> Result<Arc<Forecasts>, CallError> {
        self.forecasts.clone()
    }
}
