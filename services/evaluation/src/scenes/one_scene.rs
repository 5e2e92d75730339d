//! The planner's models on one scene that is held: what the tables plan with.

use std::sync::Arc;

use repose_inference::{Engine, HeldScene};
use repose_planner::PlacementModels;
use repose_planner::learned::stability::Stability;
use repose_proto::scoring::{PriorReply, PriorRequest, ScoreReply, ScoreRequest};
use repose_proto::{CallError, Scene as ObservedScene};

/// An engine and the scene that it is asked about.
pub struct OneScene<'a> {
    engine: &'a Engine,
    held: HeldScene,
    stability: &'a Stability,
}

impl<'a> OneScene<'a> {
    /// Holds a scene. Hashes it for its id.
    pub fn new(engine: &'a Engine, scene: Arc<ObservedScene>) -> Self {
        Self { engine, held: HeldScene::new(scene.id(), scene), stability: Stability::embedded() }
    }

    /// The same with another stability than the one that comes with the program.
    pub fn with_stability(self, stability: &'a Stability) -> Self {
        Self { stability, ..self }
    }

    /// The scene's id.
    pub fn scene_id(&self) -> &str {
        self.held.scene_id()
    }

    /// The scene.
    pub fn scene(&self) -> &Arc<ObservedScene> {
        self.held.scene()
    }
}

impl PlacementModels for OneScene<'_> {
    fn prior(&self, request: &PriorRequest, _: &Arc<ObservedScene>) -> Result<PriorReply, CallError> {
        self.engine.prior(request, &self.held)
    }

    fn score(&self, request: &ScoreRequest, _: &Arc<ObservedScene>) -> Result<ScoreReply, CallError> {
        self.engine.score(request, &self.held)
    }

    fn stability(&self) -> &Stability {
        self.stability
    }
}
