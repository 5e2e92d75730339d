//! Tries candidates: the constraints in their order, cheap ones first, then the cost of what passed.
//!
//! One judge serves every variant; the recipe says which tests it has (paper, equations 1 to 5 and Algorithm 1, lines 9 to 15). The
//! networks see a whole batch in one request for relations, and then those that pass in one for realism.

use nalgebra::Point3;
use repose_proto::place::{PlaceRequest, Rejection};
use repose_proto::scoring::{RealismBy, ScoreRequest};
use repose_proto::{CallError, ErrorCode, RELATION_COUNT, Relation, SceneRef};

use crate::candidate::Candidate;
use crate::constraints::{region_miss, support_miss, view_miss};
use crate::cost::{Standing, relations_cost, rules_cost, soundness_cost};
use crate::footing::Ground;
use crate::judged::Judged;
use crate::mixture::Mixture;
use crate::models::Models;
use crate::obstruction::{WideClearance, obstacles, obstruction};
use crate::prepared::Prepared;
use crate::query::Query;
use crate::rules::Rules;
use crate::settings::{GoalBy, Realism, Settings};
use crate::stability::measures;
use crate::unseen::unseen_share;

/// Which weights and kernel answered.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Provenance {
    /// BLAKE3 of the weights; empty until asked.
    pub weights_hash: String,
    /// The kernel.
    pub kernel: String,
}

/// What the networks are asked about candidates.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Asked {
    /// The relation predictor: the goal's terms.
    Relations,
    /// The discriminator, or the outcome network where the recipe has it.
    Realism,
    /// Both at once: one message each way instead of two.
    Both,
}

/// Tries candidates of one request.
pub struct Judge<'a> {
    /// The scene.
    pub prepared: &'a Prepared,
    /// The object to move.
    pub query: &'a Query,
    /// The goal by rule.
    pub rules: &'a Rules,
    /// The request.
    pub request: &'a PlaceRequest,
    /// The request's settings.
    pub settings: &'a Settings,
    /// The networks.
    pub models: &'a dyn Models,
    /// The prior's mixture, where the variant has one.
    pub mixture: Option<Mixture>,
    /// Who answered so far.
    pub provenance: Provenance,
    /// The scene's points without the query's, thinned out.
    pub obstacles: Vec<Point3<f32>>,
    /// Where a wider clearance is asked than the cells around the query reach.
    wide: Option<WideClearance>,
    anchors: Vec<u16>,
    touched: Vec<u16>,
    carriers: Vec<u16>,
}

impl<'a> Judge<'a> {
    /// A judge for a request whose query and rules have been made.
    pub fn new(
        prepared: &'a Prepared,
        query: &'a Query,
        rules: &'a Rules,
        request: &'a PlaceRequest,
        settings: &'a Settings,
        models: &'a dyn Models,
    ) -> Self {
        let positive = |wanted: &[Relation]| {
            let terms = request.goal.iter().filter(|t| t.holds && wanted.contains(&t.relation));
            terms.map(|t| t.anchor).collect::<Vec<u16>>()
        };
        let mut anchors: Vec<u16> = Vec::new();
        for term in &request.goal {
            if !anchors.contains(&term.anchor) {
                anchors.push(term.anchor);
            }
        }
        let (touched, clearance) = (positive(&[Relation::Touching]), &settings.fixed.clearance);
        let wide = settings.min_clearance_m > f64::from(clearance.max_ring_m);
        Self {
            wide: wide.then(|| WideClearance::new(prepared, query, &touched, clearance.voxel_m)),
            touched,
            carriers: positive(&[Relation::Above, Relation::Touching, Relation::Centered]),
            obstacles: obstacles(prepared, query, clearance.voxel_m),
            prepared,
            query,
            rules,
            request,
            settings,
            models,
            mixture: None,
            provenance: Provenance::default(),
            anchors,
        }
    }

    /// The candidate set down on what is under it when it is lowered from `ceiling_m`; as it is when there is nothing, or when the
    /// variant does not ground its candidates. A goal of being centered draws it over the anchor first.
    pub fn settle(&self, candidate: &Candidate, ceiling_m: f32) -> Candidate {
        if !self.settings.recipe.grounded {
            return *candidate;
        }
        let mut settled = *candidate;
        let centered = self.request.goal.iter().find(|t| t.holds && t.relation == Relation::Centered);
        if let Some(anchor) = centered.and_then(|t| self.rules.anchor(t.anchor)) {
            let center = self.rules.viewer().world_from_viewer() * anchor.extents.center;
            let shift = center.xy().cast::<f32>() - settled.carry(&self.query.shape.axis_offset());
            settled.centroid_m[0] += shift.x;
            settled.centroid_m[1] += shift.y;
        }
        if let Some(rest_m) = self.ground().rest_m(&settled, ceiling_m) {
            settled.centroid_m[2] = rest_m + self.query.shape.centroid_height_m();
        }
        settled
    }

    /// The height that a drawn candidate is lowered from.
    pub fn ceiling_over(&self, candidate: &Candidate) -> f32 {
        self.query.bottom_of(candidate.centroid_m[2]) + self.settings.fixed.proposals.lowered_m
    }

    /// Tries candidates, each with its mode; in their order.
    ///
    /// # Errors
    /// What the networks answer; `unavailable` when their weights changed half way.
    pub fn judge(&mut self, candidates: &[(Candidate, usize)]) -> Result<Vec<Judged>, CallError> {
        let mut judged: Vec<Judged> = candidates.iter().map(|(candidate, mode)| self.without_networks(*candidate, *mode)).collect();
        let by = self.settings.recipe.goal_by;
        if by == GoalBy::Learned {
            let open: Vec<usize> = (0..judged.len()).filter(|i| judged[*i].feasible()).collect();
            self.ask(Asked::Relations, &mut judged, &open)?;
            for i in open {
                self.judge_learned_goal(&mut judged[i]);
            }
        }
        match self.settings.recipe.realism {
            Realism::Discriminator => {
                let open: Vec<usize> = (0..judged.len()).filter(|i| judged[*i].feasible()).collect();
                self.ask(Asked::Realism, &mut judged, &open)?;
                for i in open {
                    self.judge_realism(&mut judged[i]);
                }
            }
            Realism::OutcomeRanks | Realism::Unasked | Realism::PriorDensity => {}
        }
        for j in judged.iter_mut().filter(|j| j.feasible()) {
            j.cost = self.cost(j);
        }
        Ok(judged)
    }

    /// Asks the networks what was not asked yet of some candidates, for the evidence beside answers.
    ///
    /// # Errors
    /// As [`Judge::judge`].
    pub fn complete(&mut self, judged: &mut [Judged]) -> Result<(), CallError> {
        let recipe = self.settings.recipe;
        let wants_realism = matches!(recipe.realism, Realism::Discriminator | Realism::OutcomeRanks);
        let wants_relations = recipe.goal_by != GoalBy::Rule;
        for what in [Asked::Both, Asked::Realism, Asked::Relations] {
            let lacks = |j: &Judged| match (wants_realism && j.realism.is_none(), wants_relations && j.relations.is_none()) {
                (true, true) => Some(Asked::Both),
                (true, false) => Some(Asked::Realism),
                (false, true) => Some(Asked::Relations),
                (false, false) => None,
            };
            let open: Vec<usize> = (0..judged.len()).filter(|i| lacks(&judged[*i]) == Some(what)).collect();
            self.ask(what, judged, &open)?;
        }
        for j in judged {
            if j.footing.is_none() {
                j.footing = Some(self.ground().footing(&j.candidate));
            }
            if j.checks.is_none() {
                j.checks = Some(self.rules.checks(self.query, &j.candidate, &self.settings.fixed.rules));
            }
        }
        Ok(())
    }

    /// The cost of a candidate from what is known of it; what was not asked counts as bad as can be, unless networks only rank.
    pub fn cost(&self, judged: &Judged) -> f64 {
        let (settings, recipe) = (self.settings, self.settings.recipe);
        // Where networks only rank, what they were not asked about is compared by geometry alone.
        let unasked = if recipe.realism == Realism::OutcomeRanks { 0.0 } else { 1.0 };
        let unrealistic = judged.realism.map_or(unasked, |f| 1.0 - f64::from(f));
        let learned = judged.relations.as_ref().map_or(unasked, |p| relations_cost(p));
        let ruled = judged.checks.as_ref().map_or(0.0, |c| rules_cost(&self.request.goal, c, &settings.fixed.rules));
        let relations = match recipe.goal_by {
            GoalBy::Learned => learned,
            GoalBy::Rule => ruled,
            GoalBy::RuleRankedByLearned => ruled + learned,
        };
        let soundness = if recipe.grounded { self.soundness(judged) } else { 0.0 };
        let realism = match recipe.realism {
            Realism::Unasked => soundness,
            Realism::Discriminator | Realism::OutcomeRanks => unrealistic + soundness,
            Realism::PriorDensity => self.mixture.as_ref().map_or(0.0, |m| -m.log_density(&judged.candidate)),
        };
        settings.realism_weight * realism + settings.relations_weight * relations
    }

    /// The ground under this request's candidates.
    pub fn ground(&self) -> Ground<'_> {
        Ground { prepared: self.prepared, query: self.query, settings: &self.settings.fixed.support }
    }

    /// Every constraint that needs no network, in their order; also after one has failed, so that the search knows where less is missed.
    pub fn without_networks(&self, candidate: Candidate, mode: usize) -> Judged {
        let mut judged = Judged::new(candidate, mode);
        let fixed = &self.settings.fixed;
        if let Some(miss) = region_miss(&candidate, &self.request.region) {
            judged.reject(Rejection::Region, miss);
        }
        let (visibility, miss) = view_miss(&self.prepared.view, self.query, &candidate, &fixed.view);
        judged.unhidden = Some(visibility.unhidden);
        if let Some(miss) = miss {
            judged.reject(Rejection::OutOfView, miss);
        }
        let grounded = self.settings.recipe.grounded;
        if grounded {
            let unseen = unseen_share(self.prepared.scene.meta.unseen.space.as_ref(), self.query, &candidate, &fixed.unseen);
            judged.unseen_share = Some(unseen);
            if unseen > fixed.unseen.max_share {
                judged.reject(Rejection::OutOfView, unseen - fixed.unseen.max_share);
            }
        }
        if grounded || self.settings.min_clearance_m > 0.0 {
            self.judge_obstruction(&mut judged);
        }
        if grounded {
            let footing = self.ground().footing(&candidate);
            judged.footing = Some(footing);
            if let Some(miss) = support_miss(&footing, self.query, &fixed.support) {
                judged.reject(Rejection::Unsupported, miss);
            }
        }
        if self.settings.recipe.goal_by != GoalBy::Learned {
            self.judge_goal_by_rule(&mut judged);
        }
        if !judged.feasible() {
            let learned_goal = usize::from(self.settings.recipe.goal_by == GoalBy::Learned);
            judged.leave_untried(learned_goal + usize::from(self.settings.recipe.realism == Realism::Discriminator));
        }
        judged
    }

    fn judge_obstruction(&self, judged: &mut Judged) {
        let (fixed, wanted_m) = (&self.settings.fixed, self.settings.min_clearance_m);
        let mut found = obstruction(self.prepared, self.query, &judged.candidate, &self.touched, &fixed.clearance, &fixed.support);
        if self.settings.recipe.grounded && found.colliding_share > 0.0 {
            judged.reject(Rejection::Collision, found.colliding_share);
        } else {
            // What the cells around the query leave free, points may not; they take longer.
            if let Some(wide) = self.wide.as_ref().filter(|_| judged.feasible())
                && found.clearance_m >= f64::from(fixed.clearance.max_ring_m)
            {
                found.clearance_m = wide.of(self.query, &judged.candidate, &fixed.support, wanted_m);
            }
            // Where collisions are not a constraint of their own, they are still no clearance: theirs is 0.
            if found.clearance_m < wanted_m {
                judged.reject(Rejection::Clearance, wanted_m - found.clearance_m);
            }
        }
        judged.obstruction = Some(found);
    }

    fn judge_goal_by_rule(&self, judged: &mut Judged) {
        let rules = &self.settings.fixed.rules;
        let checks = self.rules.checks(self.query, &judged.candidate, rules);
        let mut missing = 0.0;
        for (i, (term, check)) in self.request.goal.iter().zip(&checks).enumerate() {
            let wanted_m = if term.relation.index() <= Relation::Below.index() { rules.min_margin_m } else { 0.0 };
            if !check.holds || check.margin_m < wanted_m {
                judged.failing.push(i);
                missing += (wanted_m - check.margin_m).max(0.0);
            }
        }
        judged.checks = Some(checks);
        if !judged.failing.is_empty() {
            // A tenth of a metre counts as one.
            judged.reject(Rejection::Goal, 10.0 * missing);
        }
    }

    fn judge_learned_goal(&self, judged: &mut Judged) {
        let threshold = self.settings.relations_threshold;
        let Some(probabilities) = &judged.relations else { return };
        let missing = |p: &f32| (threshold - f64::from(*p)).max(0.0);
        let failing: Vec<usize> = probabilities.iter().enumerate().filter(|(_, p)| f64::from(**p) <= threshold).map(|(i, _)| i).collect();
        let total = probabilities.iter().map(missing).sum();
        if !failing.is_empty() {
            judged.failing = failing;
            judged.reject(Rejection::Goal, total);
            judged.leave_untried(usize::from(self.settings.recipe.realism == Realism::Discriminator));
        }
    }

    /// Rejects a candidate that the discriminator does not believe.
    pub fn judge_realism(&self, judged: &mut Judged) {
        let realism = judged.realism.map_or(0.0, f64::from);
        if realism <= self.settings.realism_threshold {
            judged.reject(Rejection::Unrealistic, self.settings.realism_threshold - realism);
        }
    }

    fn soundness(&self, judged: &Judged) -> f64 {
        let (Some(footing), Some(found)) = (judged.footing, judged.obstruction) else { return 1.0 };
        let fixed = &self.settings.fixed;
        let standing = Standing {
            footing,
            rim_share: self.ground().rim_share(&judged.candidate),
            clearance_m: found.clearance_m,
            unhidden: judged.unhidden.unwrap_or(0.0),
            on_stranger: footing.carrier.is_some_and(|c| c != 0 && !self.carriers.contains(&c)),
            unseen_share: judged.unseen_share.unwrap_or(0.0),
            fragile_share: judged.fragile_share.unwrap_or(0.0),
            doubtful_share: found.doubtful_share,
        };
        let main = self.request.main_anchor().and_then(|a| self.prepared.objects.get(&a));
        let distance_m = main.map_or(0.0, |a| (a.centroid - judged.candidate.centroid()).xy().norm());
        soundness_cost(&standing, self.query, &fixed.soundness) + fixed.soundness.distance_per_m * distance_m
    }

    /// Asks the networks about some of the candidates, in one request.
    ///
    /// # Errors
    /// As [`Judge::judge`].
    pub fn ask(&mut self, what: Asked, judged: &mut [Judged], which: &[usize]) -> Result<(), CallError> {
        if which.is_empty() {
            return Ok(());
        }
        let (relations, realism) = (what != Asked::Realism, what != Asked::Relations);
        let request = ScoreRequest {
            scene: SceneRef { scene_id: self.prepared.scene_id.clone() },
            query: self.query.id,
            anchors: if relations { self.anchors.clone() } else { Vec::new() },
            view_yaw_rad: self.rules.viewer().yaw_rad(),
            realism,
            realism_by: match self.settings.recipe.realism {
                Realism::OutcomeRanks => RealismBy::Outcome,
                _ => RealismBy::Discriminator,
            },
            relations,
            candidates: which.iter().map(|i| judged[*i].candidate.row()).collect(),
        };
        let reply = self.models.score(&request, &self.prepared.scene)?;
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
        for (f, i) in reply.realism.iter().zip(which) {
            judged[*i].realism = Some(self.believed(&judged[*i].candidate, *f));
        }
        Ok(())
    }

    /// What is made of a network's word on a candidate: the discriminator's is taken as it is, the outcome network's with what geometry measures.
    fn believed(&self, candidate: &Candidate, said: f32) -> f32 {
        match self.settings.recipe.realism {
            Realism::OutcomeRanks => {
                self.models.stability().of(&measures(self.prepared, self.query, candidate, said, &self.settings.fixed)) as f32
            }
            _ => said,
        }
    }

    /// The probability of each goal term as asked, from one relation vector per anchor.
    fn as_asked(&self, by_anchor: &[[f32; RELATION_COUNT]]) -> Vec<f32> {
        let probability = |term: &repose_proto::GoalTerm| {
            let row = self.anchors.iter().position(|a| *a == term.anchor).unwrap_or(0);
            let p = by_anchor[row][term.relation.index()];
            if term.holds { p } else { 1.0 - p }
        };
        self.request.goal.iter().map(probability).collect()
    }

    /// Notes who answered.
    ///
    /// # Errors
    /// `unavailable` when another answered before: results would then depend on who was asked.
    pub fn note(&mut self, weights_hash: &str, kernel: &str) -> Result<(), CallError> {
        let who = Provenance { weights_hash: weights_hash.to_owned(), kernel: kernel.to_owned() };
        if self.provenance == Provenance::default() {
            self.provenance = who;
        } else if self.provenance != who {
            let message = format!("the weights or the kernel changed during the request, from {:?} to {who:?}", self.provenance);
            return Err(CallError::new(ErrorCode::Unavailable, message));
        }
        Ok(())
    }
}
