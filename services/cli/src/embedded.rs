//! The networks in this process: what `plan`, `relations`, `score` and `evaluate` use instead of inference over the network.

use std::ops::ControlFlow;
use std::sync::Arc;

use repose_inference::{Engine, HeldScene, InferenceConfig, SceneStore, engine_of};
use repose_planner::{Models, Prepared, plan as search};
use repose_proto::place::Variant;
use repose_proto::scoring::{PriorReply, PriorRequest, ScoreReply, ScoreRequest};
use repose_proto::{CallError, PlaceRequest, PlaceResult, Scene};

use crate::failure::Failure;

/// Scenes held at once; `evaluate` goes from one to the next.
const SCENES: usize = 2;
const SCENES_BYTES: usize = 1 << 30;

/// The planner's models, computed here.
pub struct EmbeddedModels {
    engine: Engine,
    store: SceneStore,
}

impl EmbeddedModels {
    /// The weights that come with the program, on every core.
    pub fn load() -> Result<Self, Failure> {
        let engine = engine_of(&InferenceConfig::default()).map_err(Failure::other)?;
        Ok(Self { engine, store: SceneStore::new(SCENES, SCENES_BYTES) })
    }

    /// The networks.
    pub fn engine(&self) -> &Engine {
        &self.engine
    }

    fn held(&self, scene_id: &str, scene: &Arc<Scene>) -> Result<Arc<HeldScene>, CallError> {
        self.store.get(scene_id).or_else(|_| self.store.insert(scene_id, Scene::clone(scene)))
    }
}

impl Models for EmbeddedModels {
    fn prior(&self, request: &PriorRequest, scene: &Arc<Scene>) -> Result<PriorReply, CallError> {
        self.engine.prior(request, &*self.held(&request.scene.scene_id, scene)?)
    }

    fn score(&self, request: &ScoreRequest, scene: &Arc<Scene>) -> Result<ScoreReply, CallError> {
        self.engine.score(request, &*self.held(&request.scene.scene_id, scene)?)
    }
}

/// Plans in this process. The networks are loaded only for variants that ask them.
pub fn plan(scene: &Arc<Scene>, request: &PlaceRequest) -> Result<PlaceResult, Failure> {
    let prepared = Prepared::new(scene.clone());
    let models: Box<dyn Models> = match request.variant {
        Variant::Geometric => Box::new(repose_planner::NoModels),
        _ => Box::new(EmbeddedModels::load()?),
    };
    Ok(search(&prepared, request, models.as_ref(), &mut |_| ControlFlow::Continue(()))?)
}
