//! The networks in this process: what `plan`, `relations`, `score` and `evaluate` use instead of inference over the network.

use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::Arc;

use clap::Args;
use repose_inference::{Engine, HeldScene, InferenceConfig, engine_of};
use repose_planner::learned::stability::Stability;
use repose_planner::{PlacementModels, PlannerConfig, PreparedScene, plan as search, stability_of};
use repose_proto::place::Variant;
use repose_proto::scoring::{PriorReply, PriorRequest, ScoreReply, ScoreRequest};
use repose_proto::{CallError, PlaceRequest, PlaceResult, Scene};
use repose_runtime::{SceneStore, check_scene_id, load_config};

use crate::failure::Failure;

/// Scenes held at once; `evaluate` goes from one to the next.
const SCENES: usize = 2;
const SCENES_BYTES: usize = 1 << 30;

/// Which networks a command uses that computes in this process.
#[derive(Debug, Clone, Default, Args)]
pub struct NetworkArgs {
    /// A weights file. Default: the file that REPOSE_INFERENCE__WEIGHTS names, or the program's own weights.
    #[arg(long, value_name = "FILE")]
    pub weights: Option<PathBuf>,
}

impl NetworkArgs {
    /// The models of the file named here, or else in the environment, or else those of the program.
    pub fn models(&self) -> Result<EmbeddedModels, Failure> {
        let mut config: InferenceConfig = load_config("inference", None)?;
        config.weights = self.weights.clone().or(config.weights);
        EmbeddedModels::of(&config)
    }
}

/// The planner's models, computed here.
pub struct EmbeddedModels {
    engine: Engine,
    scenes: SceneStore<HeldScene>,
    stability: Stability,
}

impl EmbeddedModels {
    /// The weights that come with the program, on every core.
    pub fn load() -> Result<Self, Failure> {
        Self::of(&InferenceConfig::default())
    }

    fn of(config: &InferenceConfig) -> Result<Self, Failure> {
        let engine = engine_of(config).map_err(|e| Failure::bad_input("weights", e))?;
        Ok(Self { engine, scenes: SceneStore::new(SCENES, SCENES_BYTES, HeldScene::bytes), stability: Stability::embedded().clone() })
    }

    /// The networks.
    pub fn engine(&self) -> &Engine {
        &self.engine
    }

    fn held(&self, scene_id: &str, scene: &Arc<Scene>) -> Result<Arc<HeldScene>, CallError> {
        if let Ok(held) = self.scenes.get(scene_id) {
            return Ok(held);
        }
        check_scene_id(scene, scene_id)?;
        Ok(self.scenes.keep(scene_id, Arc::new(HeldScene::new(scene_id.to_owned(), scene.clone()))))
    }
}

impl PlacementModels for EmbeddedModels {
    fn prior(&self, request: &PriorRequest, scene: &Arc<Scene>) -> Result<PriorReply, CallError> {
        self.engine.prior(request, &*self.held(&request.scene.scene_id, scene)?)
    }

    fn score(&self, request: &ScoreRequest, scene: &Arc<Scene>) -> Result<ScoreReply, CallError> {
        self.engine.score(request, &*self.held(&request.scene.scene_id, scene)?)
    }

    fn stability(&self) -> &Stability {
        &self.stability
    }
}

/// Plans in this process. The networks are loaded only for variants that ask them. `stability` goes with the weights, from the planner's
/// configuration where it is not given.
pub fn plan(
    scene: &Arc<Scene>,
    request: &PlaceRequest,
    networks: &NetworkArgs,
    stability: Option<PathBuf>,
) -> Result<PlaceResult, Failure> {
    let prepared = PreparedScene::new(scene.clone());
    let models: Box<dyn PlacementModels> = match request.variant {
        Variant::Geometric => Box::new(repose_planner::NoModels),
        _ => {
            let mut config: PlannerConfig = load_config("planner", None)?;
            config.stability = stability.or(config.stability);
            Box::new(EmbeddedModels { stability: stability_of(&config)?, ..networks.models()? })
        }
    };
    Ok(search(&prepared, request, models.as_ref(), &mut |_| ControlFlow::Continue(()))?)
}

/// The networks of a file, or those that come with the program, one thread a request.
pub fn engine(weights: Option<PathBuf>) -> Result<Engine, Failure> {
    let config = InferenceConfig { weights, threads: 1, ..InferenceConfig::default() };
    engine_of(&config).map_err(|e| Failure::bad_input("weights", e))
}
