//! Asks the networks about candidates, many in one request, and keeps account of which weights answered.

use std::sync::Arc;

use repose_proto::place::PlaceRequest;
use repose_proto::scoring::{PriorReply, PriorRequest, RealismBy, ScoreRequest};
use repose_proto::{CallError, ErrorCode, GoalTerm, RELATION_COUNT, SceneRef};

use crate::judge::judged::JudgedCandidate;
use crate::judge::problem::PlacementProblem;
use crate::learned::forecast::Forecasts;
use crate::learned::models::{PlacementModels, Provenance};
use crate::learned::stability::{NETWORK, measures};
use crate::settings::Realism;

/// What the networks are asked about candidates.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Question {
    /// The relation predictor: the goal's terms.
    Relations,
    /// The discriminator, or the outcome network where the recipe has it.
    Realism,
    /// Both in one message.
    Both,
}

/// Asks the networks on behalf of one problem.
pub struct Scorer<'a> {
    problem: PlacementProblem<'a>,
    models: &'a dyn PlacementModels,
    /// The goal's anchors, each once, in its order.
    anchors: Vec<u16>,
    provenance: Option<Provenance>,
    /// The forecasts of the weights that answered; none before they were needed.
    forecasts: Option<Arc<Forecasts>>,
}

impl<'a> Scorer<'a> {
    /// A scorer that has asked nothing yet.
    pub fn new(problem: PlacementProblem<'a>, models: &'a dyn PlacementModels) -> Self {
        Self { anchors: anchors(problem.request), problem, models, provenance: None, forecasts: None }
    }

    /// Which weights and kernel answered; none before the first answer.
    pub fn provenance(&self) -> Option<&Provenance> {
        self.provenance.as_ref()
    }

    /// Asks the prior.
    ///
    /// # Errors
    /// What inference answers; `unavailable` when the weights changed half way.
    pub fn prior(&mut self, request: &PriorRequest) -> Result<PriorReply, CallError> {
        let reply = self.models.prior(request, &self.problem.prepared.scene)?;
        self.note(&reply.weights_hash, &reply.kernel)?;
        Ok(reply)
    }

    /// Asks about some of the candidates, by position, in one request.
    ///
    /// # Errors
    /// As [`Scorer::prior`]; `internal` when the answer is not of the length that was asked for.
    pub fn ask(&mut self, what: Question, judged: &mut [JudgedCandidate], which: &[usize]) -> Result<(), CallError> {
        if which.is_empty() {
            return Ok(());
        }
        let (relations, realism) = (what != Question::Realism, what != Question::Relations);
        let request = ScoreRequest {
            scene: SceneRef { scene_id: self.problem.prepared.scene_id.clone() },
            query: self.problem.query.id,
            anchors: if relations { self.anchors.clone() } else { Vec::new() },
            view_yaw_rad: self.problem.rules.viewer().yaw_rad(),
            realism,
            realism_by: match self.problem.settings.recipe.realism {
                Realism::OutcomeRanks => RealismBy::Outcome,
                _ => RealismBy::Discriminator,
            },
            relations,
            candidates: which.iter().map(|i| judged[*i].candidate.row()).collect(),
        };
        let reply = self.models.score(&request, &self.problem.prepared.scene)?;
        self.note(&reply.weights_hash, &reply.kernel)?;
        let expected = |asked: bool, each: usize| if asked { which.len() * each } else { 0 };
        let (vectors, scores) = (expected(relations, self.anchors.len()), expected(realism, 1));
        if (reply.relations.len(), reply.realism.len()) != (vectors, scores) {
            let got = format!("got {} and {}", reply.relations.len(), reply.realism.len());
            return Err(CallError::internal(format!("expected {vectors} relation vectors and {scores} realism scores, {got}")));
        }
        for (row, i) in reply.relations.chunks_exact(self.anchors.len()).zip(which) {
            judged[*i].relations = Some(self.as_asked(row));
        }
        for (said, i) in reply.realism.iter().zip(which) {
            self.take_realism(&mut judged[*i], *said)?;
        }
        Ok(())
    }

    /// Realism from a network's answer: the discriminator's as it is, the outcome network's combined with geometry by the boosted trees.
    fn take_realism(&mut self, judged: &mut JudgedCandidate, said: f32) -> Result<(), CallError> {
        if self.problem.settings.recipe.realism != Realism::OutcomeRanks {
            judged.realism = Some(said);
            return Ok(());
        }
        self.measure(judged);
        if let Some(measured) = judged.measures.as_mut() {
            measured[NETWORK] = said;
            judged.realism = Some(self.forecasts()?.stability.of(&measured[..]) as f32);
        }
        Ok(())
    }

    /// Measures a candidate by geometry, unless that was done.
    pub fn measure(&self, judged: &mut JudgedCandidate) {
        let PlacementProblem { prepared, query, settings, .. } = self.problem;
        if judged.measures.is_none() {
            judged.measures = Some(Box::new(measures(prepared, query, &judged.candidate, 0.0, &settings.fixed)));
        }
    }

    /// The forecasts of the weights that answered.
    ///
    /// # Errors
    /// What inference answers; `failed_precondition` when the weights have none.
    pub fn forecasts(&mut self) -> Result<Arc<Forecasts>, CallError> {
        match &self.forecasts {
            Some(forecasts) => Ok(forecasts.clone()),
            None => Ok(self.forecasts.insert(self.models.forecasts()?).clone()),
        }
    }

    /// The probability of each goal term as asked, from one relation vector per anchor.
    fn as_asked(&self, by_anchor: &[[f32; RELATION_COUNT]]) -> Vec<f32> {
        let probability = |term: &GoalTerm| {
            let row = self.anchors.iter().position(|a| *a == term.anchor).unwrap_or(0);
            let p = by_anchor[row][term.relation.index()];
            if term.holds { p } else { 1.0 - p }
        };
        self.problem.request.goal.iter().map(probability).collect()
    }

    /// Notes who answered. Another answer than before is an error: results would then depend on who was asked.
    fn note(&mut self, weights_hash: &str, kernel: &str) -> Result<(), CallError> {
        let who = Provenance { weights_hash: weights_hash.to_owned(), kernel: kernel.to_owned() };
        match &self.provenance {
            Some(before) if *before != who => {
                let message = format!("the weights or the kernel changed during the request, from {before:?} to {who:?}");
                Err(CallError::new(ErrorCode::Unavailable, message))
            }
            _ => {
                self.provenance = Some(who);
                Ok(())
            }
        }
    }
}

/// The goal's anchors, each once, in its order.
fn anchors(request: &PlaceRequest) -> Vec<u16> {
    let mut anchors: Vec<u16> = Vec::new();
    for term in &request.goal {
        if !anchors.contains(&term.anchor) {
            anchors.push(term.anchor);
        }
    }
    anchors
}
