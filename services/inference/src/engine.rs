//! Answers to `prior` and `score`: the networks on a held scene. Synchronous; the service and the command line share it.
//!
//! Nine relations are the networks'; `aligned` is judged by rule on the observed clouds, as a probability of 0 or 1. A candidate is one
//! unit of work for one thread, so an answer does not depend on how candidates were batched or spread.

use std::collections::BTreeMap;

use nalgebra::Point3;
use rand::SeedableRng;
use rand_pcg::Pcg64;
use repose_networks::points::Sight;
use repose_networks::serving::spread;
use repose_networks::{Candidate, InputError, Models, SceneContext};
use repose_proto::scoring::{MixtureComponent, ModelInfo, ModelsReply, PriorReply, PriorRequest, RealismBy, ScoreReply, ScoreRequest};
use repose_proto::{CallError, RELATION_COUNT, Relation, Scene};
use repose_relations::margins::ALIGNED_RAD;
use repose_relations::rectangle::{quarter_turn_difference_rad, rectangle_yaw_rad};

use crate::mixture;
use crate::scene_store::HeldScene;

/// Candidates that a thread takes at once.
const PIECE: usize = 4;

/// The networks and the threads that they may use.
#[derive(Debug)]
pub struct Engine {
    models: Models,
    threads: usize,
}

impl Engine {
    /// Scores with `models` on up to `threads` threads per request.
    pub fn new(models: Models, threads: usize) -> Self {
        Self { models, threads: threads.max(1) }
    }

    /// Asks every network once about a small scene made up for it, so that the first caller does not wait for memory and threads, and weights
    /// that give no numbers are noticed before they are served.
    ///
    /// # Errors
    /// What the networks answer.
    pub fn warm_up(&self) -> Result<(), InputError> {
        let side = |i: u32| 0.05 * (i % 8) as f32 / 8.0;
        let block = |label: u16| (0..64u32).map(move |i| (Point3::new(0.2 * f32::from(label) + side(i), side(i / 8), 0.05), label));
        let table = (0..900u32).map(|i| (Point3::new((i % 30) as f32 * 0.03 - 0.3, (i / 30) as f32 * 0.03 - 0.3, 0.0), 0));
        let (points, labels): (Vec<_>, Vec<_>) = table.chain(block(1)).chain(block(2)).unzip();
        let sight = Sight { eye: Point3::new(0.2, -0.5, 0.5), pixel_rad: 0.002 };
        let context = SceneContext::new(&points, &labels, 0.0, &sight, &self.models.config().cloud)?;
        let candidates = vec![Candidate { position_in_world: [0.3, 0.1, 0.05], yaw_rad: 0.1 }; 4 * self.threads];
        self.models.prior(&context, 1, 2, [1, 0, 0, 0, 0, 0, 0, 0, 0, 0])?;
        self.models.relations(&context, 1, &[2], &candidates, self.threads)?;
        self.models.realism(&context, 1, &candidates, self.threads)?;
        self.models.outcome(&context, 1, &candidates, self.threads)?;
        Ok(())
    }

    /// BLAKE3 of the weights.
    pub fn weights_hash(&self) -> &str {
        self.models.hash()
    }

    /// The kernel in use.
    pub fn kernel(&self) -> &str {
        self.models.kernel_id()
    }

    /// Mixture and draws of the prior.
    ///
    /// # Errors
    /// `not_found` on `query` or `anchor`.
    pub fn prior(&self, request: &PriorRequest, held: &HeldScene) -> Result<PriorReply, CallError> {
        let context = self.prepared(held, request.view_yaw_rad)?;
        let predicted = self.models.prior(&context, request.query, request.anchor, request.goal).map_err(|e| wire_error(&e, "anchor"))?;
        let mixture: Vec<MixtureComponent> = (0..predicted.weights.len())
            .map(|k| MixtureComponent {
                weight: f64::from(predicted.weights[k]),
                mean_m: predicted.means_in_viewer_m[k].map(f64::from),
                sigma_m: predicted.sigmas_m[k].map(f64::from),
                yaw_mean_rad: f64::from(predicted.yaw_mean_rad[k]),
                yaw_concentration: f64::from(predicted.kappa[k]),
            })
            .collect();
        let anchor = context.centroid_in_world(request.anchor).map(|c| c.cast::<f64>());
        let anchor = anchor.ok_or_else(|| CallError::not_found("anchor", format!("the scene has no object {}", request.anchor)))?;
        let mut rng = Pcg64::seed_from_u64(request.seed);
        let count = request.count as usize;
        let (candidates, components) = mixture::draw(&mixture, &anchor, &context.viewer(), request.rotation, count, &mut rng);
        let (weights_hash, kernel) = self.identity();
        Ok(PriorReply { mixture, weights_hash, kernel, candidates, components })
    }

    /// Realism and relations of candidates, as asked.
    ///
    /// # Errors
    /// `not_found` on `query` or `anchors`.
    pub fn score(&self, request: &ScoreRequest, held: &HeldScene) -> Result<ScoreReply, CallError> {
        self.score_together(&[(request, held)]).pop().unwrap_or_else(|| Err(CallError::internal("a request without an answer")))
    }

    /// Several requests at once: their candidates share the threads, and each answer is what [`Engine::score`] would give alone.
    pub fn score_together(&self, requests: &[(&ScoreRequest, &HeldScene)]) -> Vec<Result<ScoreReply, CallError>> {
        let mut replies: Vec<_> = requests.iter().map(|(request, held)| self.relations_of(request, held)).collect();
        let pieces: Vec<(usize, usize)> = requests
            .iter()
            .enumerate()
            .filter(|(i, (request, _))| request.realism && replies[*i].is_ok())
            .flat_map(|(i, (request, _))| (0..request.candidates.len()).step_by(PIECE).map(move |first| (i, first)))
            .collect();
        let scored = spread(
            pieces.len(),
            self.threads,
            || (),
            |(), k| {
                let (i, first) = pieces[k];
                let (request, held) = requests[i];
                let last = (first + PIECE).min(request.candidates.len());
                let context = self.prepared(held, request.view_yaw_rad)?;
                let candidates = candidates_of(&request.candidates[first..last]);
                let scored = match request.realism_by {
                    RealismBy::Discriminator => self.models.realism(&context, request.query, &candidates, 1),
                    RealismBy::Outcome => self.models.outcome(&context, request.query, &candidates, 1),
                };
                scored.map_err(|e| wire_error(&e, "query"))
            },
        );
        for ((i, _), realism) in pieces.into_iter().zip(scored) {
            match (&mut replies[i], realism) {
                (Ok(reply), Ok(realism)) => reply.realism.extend(realism),
                (reply, Err(error)) => *reply = Err(error),
                (Err(_), Ok(_)) => {}
            }
        }
        replies
    }

    /// The reply without realism.
    fn relations_of(&self, request: &ScoreRequest, held: &HeldScene) -> Result<ScoreReply, CallError> {
        let context = self.prepared(held, request.view_yaw_rad)?;
        let mut relations = Vec::new();
        if request.relations {
            let candidates = candidates_of(&request.candidates);
            let learned = self.models.relations(&context, request.query, &request.anchors, &candidates, self.threads);
            let learned = learned.map_err(|e| wire_error(&e, "anchors"))?;
            let aligned = Alignment::new(held.scene(), request);
            for (candidate, of_anchors) in request.candidates.iter().zip(&learned) {
                for (anchor, learned) in request.anchors.iter().zip(of_anchors) {
                    let mut row = [0.0; RELATION_COUNT];
                    row[..learned.len()].copy_from_slice(learned);
                    row[Relation::Aligned.index()] = f32::from(u8::from(aligned.holds(*anchor, f64::from(candidate[3]))));
                    relations.push(row);
                }
            }
        } else if context.centroid_in_world(request.query).is_none() {
            return Err(CallError::not_found("query", format!("the scene has no object {}", request.query)));
        }
        let (weights_hash, kernel) = self.identity();
        Ok(ScoreReply { weights_hash, kernel, realism: Vec::new(), relations, anchors: request.anchors.len() })
    }

    /// The weights served.
    pub fn models(&self) -> ModelsReply {
        let (weights_hash, kernel) = self.identity();
        let info = self.models.info();
        let (recipe, metrics) = (info.recipe.clone(), info.metrics.clone());
        let model = ModelInfo { name: "default".to_owned(), hash: weights_hash.clone(), recipe, metrics };
        ModelsReply { weights_hash, kernel, models: vec![model] }
    }

    fn identity(&self) -> (String, String) {
        (self.models.hash().to_owned(), self.models.kernel_id().to_owned())
    }

    fn prepared(&self, held: &HeldScene, view_yaw_rad: f64) -> Result<std::sync::Arc<SceneContext>, CallError> {
        held.prepared(view_yaw_rad, &self.models.config().cloud)
    }
}

fn candidates_of(rows: &[[f32; 4]]) -> Vec<Candidate> {
    rows.iter().map(|c| Candidate { position_in_world: [c[0], c[1], c[2]], yaw_rad: c[3] }).collect()
}

/// Orientations of the query's and the anchors' clouds seen from above.
struct Alignment {
    query_yaw_rad: Option<f64>,
    anchor_yaws_rad: BTreeMap<u16, Option<f64>>,
}

impl Alignment {
    fn new(scene: &Scene, request: &ScoreRequest) -> Self {
        let yaw = |id: u16| rectangle_yaw_rad(&scene.points_of(id).map(Point3::from).collect::<Vec<_>>());
        Self { query_yaw_rad: yaw(request.query), anchor_yaws_rad: request.anchors.iter().map(|id| (*id, yaw(*id))).collect() }
    }

    fn holds(&self, anchor: u16, turn_rad: f64) -> bool {
        match (self.query_yaw_rad, self.anchor_yaws_rad.get(&anchor).copied().flatten()) {
            (Some(query), Some(anchor)) => quarter_turn_difference_rad(query + turn_rad, anchor) < ALIGNED_RAD,
            _ => false,
        }
    }
}

/// The contract's error for a question that the networks cannot take; `anchor_field` is what the request calls its anchors.
fn wire_error(error: &InputError, anchor_field: &str) -> CallError {
    let message = error.to_string();
    match error {
        InputError::UnknownObject { field: "query", .. } => CallError::not_found("query", message),
        InputError::UnknownObject { .. } => CallError::not_found(anchor_field, message),
        InputError::AnchorIsQuery { .. } => CallError::invalid(anchor_field, message),
        InputError::NotFinite { field, index } => CallError::invalid(format!("{field}[{index}]"), message),
        InputError::LabelCount { .. } => CallError::invalid("labels", message),
    }
}
