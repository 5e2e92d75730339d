//! Where iteration 0's candidates come from: the learned prior, the goal's geometry, or half of each.

use rand_pcg::Pcg64;
use repose_proto::scoring::PriorRequest;
use repose_proto::{CallError, RELATION_COUNT, SceneRef, limits};

use crate::judge::Judge;
use crate::judge::problem::PlacementProblem;
use crate::learned::mixture::PriorMixture;
use crate::scene::candidate::CandidatePose;
use crate::search::proposals::Proposer;
use crate::settings::{Proposals, Realism};

/// Draws iteration 0's candidates.
pub struct CandidateSource<'a> {
    /// Draws of the prior with their modes, to be used in order.
    drawn: std::vec::IntoIter<(CandidatePose, usize)>,
    /// Proposals from the goal's geometry.
    proposer: Option<Proposer<'a>>,
    /// How many of those were made.
    proposed: u64,
}

impl<'a> CandidateSource<'a> {
    /// The source of a problem. Asks the prior where the variant needs it, and tells the judge of its mixture.
    ///
    /// # Errors
    /// What inference answers.
    pub fn new(judge: &mut Judge<'a>, rng: &mut Pcg64) -> Result<Self, CallError> {
        let problem = judge.problem();
        let PlacementProblem { prepared, query, rules, request, settings, .. } = problem;
        let proposals = settings.recipe.proposals;
        let proposer = matches!(proposals, Proposals::Geometric | Proposals::Both).then_some(Proposer {
            prepared,
            query,
            rules,
            region: &request.region,
            observed_offset: problem.observed_offset(),
            rotation: settings.rotation,
            settings: &settings.fixed.proposals,
        });
        let needs_prior = proposals != Proposals::Geometric || settings.recipe.realism == Realism::PriorDensity;
        let drawn = if needs_prior { ask_prior(judge, rng)? } else { Vec::new() };
        Ok(Self { drawn: drawn.into_iter(), proposer, proposed: 0 })
    }

    /// Whether it has proposals from the goal's geometry, which never end.
    pub fn is_endless(&self) -> bool {
        self.proposer.is_some()
    }

    /// Up to `count` candidates, settled: half of each kind where there are both.
    pub fn draw(&mut self, count: usize, problem: &PlacementProblem<'_>, rng: &mut Pcg64) -> Vec<(CandidatePose, usize)> {
        let from_prior = if self.proposer.is_some() { count / 2 } else { count };
        let mut out: Vec<(CandidatePose, usize)> = self.drawn.by_ref().take(from_prior).collect();
        for (candidate, _) in &mut out {
            *candidate = problem.settled(candidate, problem.ceiling_over(candidate));
        }
        if let Some(proposer) = &self.proposer {
            while out.len() < count {
                let proposal = proposer.draw(self.proposed, rng);
                self.proposed += 1;
                out.push((problem.settled(&proposal.drawn, proposal.ceiling_m), 0));
            }
        }
        out
    }
}

/// Asks the prior; returns its draws (or means) with their modes.
fn ask_prior(judge: &mut Judge<'_>, rng: &mut Pcg64) -> Result<Vec<(CandidatePose, usize)>, CallError> {
    let PlacementProblem { prepared, rules, request, settings, .. } = judge.problem();
    let anchor = request.main_anchor().ok_or_else(|| CallError::invalid("goal", "at least one term must hold"))?;
    let mut goal = [0i8; RELATION_COUNT];
    for term in request.goal.iter().filter(|t| t.anchor == anchor) {
        goal[term.relation.index()] = if term.holds { 1 } else { -1 };
    }
    let means_only = settings.recipe.proposals == Proposals::PriorMeans;
    let count = if means_only { 0 } else { (settings.batch * settings.draws_per_batch).min(limits::MAX_CANDIDATES) };
    let reply = judge.scorer_mut().prior(&PriorRequest {
        scene: SceneRef { scene_id: prepared.scene_id.clone() },
        query: request.query,
        anchor,
        goal,
        view_yaw_rad: rules.viewer().yaw_rad(),
        rotation: settings.rotation,
        count: count as u32,
        seed: rand::RngExt::random(rng),
    })?;
    let (object, _) = prepared.object(anchor, "goal")?;
    let mixture = PriorMixture::new(reply.mixture, object.centroid, *rules.viewer(), settings.rotation);
    let modes = mixture.modes(settings.min_separation_m);
    let drawn = if means_only {
        mixture.means().into_iter().enumerate().map(|(i, c)| (c, i)).collect()
    } else {
        let mode = |component: &u8| modes.get(usize::from(*component)).copied().unwrap_or(0);
        reply.candidates.iter().zip(&reply.components).map(|(row, component)| (CandidatePose::from_row(*row), mode(component))).collect()
    };
    judge.take_mixture(mixture);
    Ok(drawn)
}
