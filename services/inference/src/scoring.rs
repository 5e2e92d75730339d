//! One request to score: split into pieces of a few candidates that any thread may score, and joined when the last piece is done.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

use repose_networks::serving::Pairs;
use repose_networks::{Candidate, Models, PREDICTED_RELATIONS, SceneContext};
use repose_proto::scoring::{RealismBy, ScoreReply, ScoreRequest};
use repose_proto::{CallError, RELATION_COUNT, Relation};
use repose_relations::margins::ALIGNED_RAD;
use repose_relations::rectangle::quarter_turn_difference_rad;

use crate::held_scene::HeldScene;
use crate::wire_error::wire_error;

/// Candidates that a thread takes at once.
const PIECE: usize = 2;

/// A request to score, together with others.
pub struct ScoreJob<'a> {
    /// The request.
    pub request: &'a ScoreRequest,
    /// Its scene.
    pub held: &'a HeldScene,
    /// Whether the reply is still wanted; called before every few candidates.
    pub check: &'a (dyn Fn() -> Result<(), CallError> + Sync),
}

/// A job in progress: its pieces are scored on any thread and in any order.
pub(crate) struct Scoring<'a> {
    models: &'a Models,
    job: &'a ScoreJob<'a>,
    pub pieces: usize,
    /// Made by the first piece.
    prepared: OnceLock<Result<Prepared, CallError>>,
    /// The scores of each piece that is done.
    scored: Mutex<Vec<Option<Piece>>>,
    /// The first error, after which nothing more is computed.
    failed: OnceLock<CallError>,
    /// Pieces that are not done.
    open: AtomicUsize,
}

/// What a request's pieces share.
struct Prepared {
    context: Arc<SceneContext>,
    relations: Option<(Arc<Pairs>, Alignment)>,
}

/// Scores of a few candidates.
#[derive(Default)]
struct Piece {
    realism: Vec<f32>,
    relations: Vec<[f32; RELATION_COUNT]>,
}

impl<'a> Scoring<'a> {
    pub fn new(models: &'a Models, job: &'a ScoreJob<'a>) -> Self {
        // A request without candidates has a piece too, which checks the request.
        let pieces = job.request.candidates.len().div_ceil(PIECE).max(1);
        let scored = Mutex::new((0..pieces).map(|_| None).collect());
        Self { models, job, pieces, prepared: OnceLock::new(), scored, failed: OnceLock::new(), open: AtomicUsize::new(pieces) }
    }

    /// Scores a piece. Returns the reply if no other piece is open.
    pub fn score(&self, piece: usize) -> Option<Result<ScoreReply, CallError>> {
        if self.failed.get().is_none() {
            match self.scores_of(piece) {
                Ok(scores) => self.scored()[piece] = Some(scores),
                // Another piece's error may have come first; one is enough.
                Err(error) => drop(self.failed.set(error)),
            }
        }
        (self.open.fetch_sub(1, Ordering::AcqRel) == 1).then(|| self.reply())
    }

    fn scores_of(&self, piece: usize) -> Result<Piece, CallError> {
        let ScoreJob { request, check, .. } = self.job;
        check()?;
        let Prepared { context, relations } = self.prepared.get_or_init(|| self.prepare()).as_ref().map_err(Clone::clone)?;
        let models = self.models;
        let rows = request.candidates.chunks(PIECE).nth(piece).unwrap_or_default();
        let candidates: Vec<Candidate> = rows.iter().map(|c| Candidate { position_in_world: [c[0], c[1], c[2]], yaw_rad: c[3] }).collect();
        let mut scores = Piece::default();
        if let Some((pairs, aligned)) = relations {
            let learned = models.relations_of(context, pairs, &candidates, 1).map_err(|e| wire_error(&e, "anchors"))?;
            for (candidate, of_anchors) in rows.iter().zip(&learned) {
                let of_anchors = request.anchors.iter().zip(of_anchors);
                scores.relations.extend(of_anchors.map(|(anchor, learned)| aligned.with(learned, *anchor, candidate[3])));
            }
        }
        if request.realism {
            let realism = match request.realism_by {
                RealismBy::Discriminator => models.realism(context, request.query, &candidates, 1),
                RealismBy::Outcome => models.outcome(context, request.query, &candidates, 1),
            };
            scores.realism = realism.map_err(|e| wire_error(&e, "query"))?;
        }
        Ok(scores)
    }

    fn prepare(&self) -> Result<Prepared, CallError> {
        let ScoreJob { request, held, .. } = self.job;
        let context = held.prepared(request.view_yaw_rad, &self.models.config().cloud)?;
        let relations = if request.relations {
            let pairs = self.models.pairs(&context, request.query, &request.anchors).map_err(|e| wire_error(&e, "anchors"))?;
            Some((pairs, Alignment::new(held, request)))
        } else {
            None
        };
        if context.centroid_in_world(request.query).is_none() {
            return Err(CallError::not_found("query", format!("the scene has no object {}", request.query)));
        }
        Ok(Prepared { context, relations })
    }

    /// The reply, once no piece is open.
    fn reply(&self) -> Result<ScoreReply, CallError> {
        if let Some(error) = self.failed.get() {
            return Err(error.clone());
        }
        let mut reply = ScoreReply {
            weights_hash: self.models.hash().to_owned(),
            kernel: self.models.kernel_id().to_owned(),
            realism: Vec::new(),
            relations: Vec::new(),
            anchors: self.job.request.anchors.len(),
        };
        for piece in self.scored().drain(..).flatten() {
            reply.realism.extend(piece.realism);
            reply.relations.extend(piece.relations);
        }
        Ok(reply)
    }

    fn scored(&self) -> MutexGuard<'_, Vec<Option<Piece>>> {
        self.scored.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Orientations of the query's and the anchors' clouds, seen from above.
struct Alignment {
    query_yaw_rad: Option<f64>,
    anchor_yaws_rad: BTreeMap<u16, Option<f64>>,
}

impl Alignment {
    fn new(held: &HeldScene, request: &ScoreRequest) -> Self {
        let anchor_yaws_rad = request.anchors.iter().map(|id| (*id, held.yaw_rad(*id))).collect();
        Self { query_yaw_rad: held.yaw_rad(request.query), anchor_yaws_rad }
    }

    /// Learned probabilities of a turned query, and `aligned` by rule beside them.
    fn with(&self, learned: &[f32; PREDICTED_RELATIONS], anchor: u16, turn_rad: f32) -> [f32; RELATION_COUNT] {
        let mut row = [0.0; RELATION_COUNT];
        row[..learned.len()].copy_from_slice(learned);
        row[Relation::Aligned.index()] = f32::from(u8::from(self.holds(anchor, f64::from(turn_rad))));
        row
    }

    fn holds(&self, anchor: u16, turn_rad: f64) -> bool {
        match (self.query_yaw_rad, self.anchor_yaws_rad.get(&anchor).copied().flatten()) {
            (Some(query), Some(anchor)) => quarter_turn_difference_rad(query + turn_rad, anchor) < ALIGNED_RAD,
            _ => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use repose_networks::{NetworksConfig, Weights};
    use repose_proto::{ErrorCode, Scene, SceneRef};

    use super::*;
    use crate::engine::Engine;
    use crate::held_scene::tests::scene;

    fn engine(threads: usize) -> Engine {
        Engine::new(Models::load(&Weights::initial(&NetworksConfig::paper(), 1).unwrap()).unwrap(), threads)
    }

    /// A table with two blocks on it.
    fn held() -> HeldScene {
        let block = |label: u16| {
            (0..64u16).map(move |i| ([0.2 * f32::from(label) + 0.006 * f32::from(i % 8), 0.006 * f32::from(i / 8), 0.05], label))
        };
        let table = (0..400u16).map(|i| ([0.04 * f32::from(i % 20) - 0.2, 0.04 * f32::from(i / 20) - 0.4, 0.0], 0));
        let (points, labels) = table.chain(block(1)).chain(block(2)).unzip();
        HeldScene::new("scene".to_owned(), Arc::new(Scene { points, labels, ..scene(0, 0.0) }))
    }

    fn request(candidates: usize) -> ScoreRequest {
        ScoreRequest {
            scene: SceneRef { scene_id: "scene".to_owned() },
            view_yaw_rad: 0.0,
            query: 1,
            anchors: vec![2],
            realism: true,
            realism_by: RealismBy::Discriminator,
            relations: true,
            candidates: (0..candidates).map(|i| [0.3, 0.02 * i as f32, 0.05, if i % 2 == 0 { 0.0 } else { 0.4 }]).collect(),
        }
    }

    /// The answers, in the order in which they came.
    fn answers(engine: &Engine, jobs: &[ScoreJob<'_>]) -> Vec<(usize, Result<ScoreReply, CallError>)> {
        let answers = Mutex::new(Vec::new());
        engine.score_together(jobs, |i, reply| answers.lock().unwrap().push((i, reply)));
        answers.into_inner().unwrap()
    }

    #[test]
    fn each_request_is_answered_as_if_alone_and_as_soon_as_it_is_done() {
        let (engine, held) = (engine(1), held());
        let requests = [request(PIECE + 1), ScoreRequest { query: 9, ..request(PIECE + 1) }, request(0), request(2 * PIECE)];
        let checks = [const { AtomicUsize::new(0) }; 4];
        let counts = [0, 1, 2, 3].map(|i: usize| {
            let checks = &checks;
            move || {
                // The last request only starts when the first has its reply.
                assert!(i != 3 || checks[0].load(Ordering::Relaxed) == 2);
                checks[i].fetch_add(1, Ordering::Relaxed);
                Ok(())
            }
        });
        let jobs: Vec<_> = requests.iter().zip(&counts).map(|(request, check)| ScoreJob { request, held: &held, check }).collect();
        let answers = answers(&engine, &jobs);
        assert_eq!(answers.iter().map(|(i, _)| *i).collect::<Vec<_>>(), [0, 1, 2, 3]);
        assert_eq!(answers[1].1.as_ref().unwrap_err().field.as_deref(), Some("query"));
        assert_eq!(checks.map(AtomicUsize::into_inner), [2, 1, 1, 2], "a request that failed is not computed any further");
        for (i, answer) in answers {
            assert_eq!(answer, engine.score(&requests[i], &held), "request {i}");
        }
        let on_two = self::engine(2).score(&requests[0], &held).unwrap();
        assert_eq!((on_two.realism.len(), on_two.relations.len()), (PIECE + 1, PIECE + 1));
        assert_eq!(on_two, engine.score(&requests[0], &held).unwrap());
    }

    #[test]
    fn a_request_that_nobody_waits_for_is_not_computed_to_its_end() {
        let (engine, held) = (engine(1), held());
        let (long, short) = (request(10 * PIECE), request(1));
        let checks = AtomicUsize::new(0);
        let gone = || match checks.fetch_add(1, Ordering::Relaxed) {
            0 => Ok(()),
            _ => Err(CallError::new(ErrorCode::Cancelled, "gone")),
        };
        let jobs = [ScoreJob { request: &long, held: &held, check: &gone }, ScoreJob { request: &short, held: &held, check: &|| Ok(()) }];
        let answers = answers(&engine, &jobs);
        assert_eq!(answers[0].1.as_ref().unwrap_err().code, ErrorCode::Cancelled);
        assert_eq!(answers[1].1.as_ref().unwrap().realism.len(), 1);
        assert_eq!(checks.into_inner(), 2);
    }

    #[test]
    fn weights_without_an_outcome_network_refuse_to_score_by_it() {
        let request = ScoreRequest { realism_by: RealismBy::Outcome, ..request(3) };
        let error = engine(1).score(&request, &held()).unwrap_err();
        assert_eq!((error.code, error.field.as_deref()), (ErrorCode::FailedPrecondition, Some("realism_by")));
    }
}
