//! The planner's models on scenes that are held: what the tables plan with.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use repose_inference::{Engine, HeldScene};
use repose_planner::{Forecasts, PlacementModels};
use repose_proto::scoring::{PriorReply, PriorRequest, ScoreReply, ScoreRequest};
use repose_proto::{CallError, Scene};

/// Scenes that are held: an arrangement goes back to the last few, and a search over the sides of an object leaves one for the next.
const SCENES: usize = 4;

/// The forecasts of an engine's weights, to be read once for many scenes.
///
/// # Errors
/// `failed_precondition` when the weights have none that this program reads.
pub fn forecasts_of(engine: &Engine) -> Result<Arc<Forecasts>, CallError> {
    Forecasts::read(&engine.forecasts().forecasts).map(Arc::new)
}

/// The models on the scenes that a search goes through, of which the last few are held.
pub struct HeldScenes<'a> {
    engine: &'a Engine,
    forecasts: Option<Arc<Forecasts>>,
    held: Mutex<VecDeque<Arc<HeldScene>>>,
}

impl<'a> HeldScenes<'a> {
    /// The networks of an engine.
    pub fn new(engine: &'a Engine) -> Self {
        Self { engine, forecasts: None, held: Mutex::default() }
    }

    /// The same with the forecasts of the engine's weights, which the variant `best` asks for.
    pub fn with_forecasts(self, forecasts: &Arc<Forecasts>) -> Self {
        Self { forecasts: Some(forecasts.clone()), ..self }
    }

    fn held(&self, scene_id: &str, scene: &Arc<Scene>) -> Arc<HeldScene> {
        let mut held = self.held.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(known) = held.iter().find(|known| known.scene_id() == scene_id) {
            return known.clone();
        }
        let new = Arc::new(HeldScene::new(scene_id.to_owned(), scene.clone()));
        held.push_back(new.clone());
        if held.len() > SCENES {
            held.pop_front();
        }
        new
    }
}

impl PlacementModels for HeldScenes<'_> {
    fn prior(&self, request: &PriorRequest, scene: &Arc<Scene>) -> Result<PriorReply, CallError> {
        self.engine.prior(request, &self.held(&request.scene.scene_id, scene))
    }

    fn score(&self, request: &ScoreRequest, scene: &Arc<Scene>) -> Result<ScoreReply, CallError> {
        self.engine.score(request, &self.held(&request.scene.scene_id, scene))
    }

    fn forecasts(&self) -> Result<Arc<Forecasts>, CallError> {
        match &self.forecasts {
            Some(forecasts) => Ok(forecasts.clone()),
            None => forecasts_of(self.engine),
        }
    }
}

#[cfg(test)]
mod tests {
    use repose_dataset::Split;
    use repose_networks::Models;
    use repose_proto::SceneRef;
    use repose_proto::scoring::RealismBy;

    use super::*;
    use crate::scenes::problem::{Problem, ProblemSettings};

    #[test]
    fn each_scene_that_a_search_makes_is_scored_as_it_is() {
        let engine = Engine::new(Models::embedded().expect("embedded weights"), 1);
        let problem = (0..20).find_map(|i| Problem::of_split(Split::Validation, i, &ProblemSettings::default())).expect("a problem");
        let seen = Arc::new(problem.observed.clone());
        let mut other = problem.observed;
        let query = other.labels.iter().map(|label| *label == problem.query).collect::<Vec<_>>();
        other.points.iter_mut().zip(query).filter(|(_, moves)| *moves).for_each(|(point, _)| point[2] *= 2.0);
        let other = Arc::new(other);
        let at = seen.object(problem.query).expect("the query").centroid_m.map(|v| v as f32);
        let said = |models: &HeldScenes<'_>, scene: &Arc<Scene>| {
            let request = ScoreRequest {
                scene: SceneRef { scene_id: scene.id() },
                query: problem.query,
                anchors: vec![problem.goal.anchor],
                view_yaw_rad: problem.viewer.yaw_rad(),
                realism: true,
                realism_by: RealismBy::Outcome,
                relations: true,
                candidates: vec![[at[0], at[1], at[2], 0.0]],
            };
            models.score(&request, scene).expect("an answer").realism
        };
        let one = HeldScenes::new(&engine);
        let (first, second, again) = (said(&one, &seen), said(&one, &other), said(&one, &seen));
        assert_eq!(second, said(&HeldScenes::new(&engine), &other));
        assert!(first == again && first != second, "{first:?} {second:?}");
    }
}
