//! The constraints that need no network, in their order, the cheap ones first (paper, equations 2 to 5).
//!
//! The first that fails is the reason for the rejection. The others are tried all the same, so that a search without feasible candidates
//! knows where less is missed.

use repose_proto::place::Rejection;
use repose_proto::{GoalTerm, Relation};

use crate::checks::MISS_PER_METRE;
use crate::checks::clearance::Clearance;
use crate::checks::footing::support_miss;
use crate::checks::obstruction::{Obstruction, obstruction};
use crate::checks::reach::Reach;
use crate::checks::region::region_miss;
use crate::checks::unseen::unseen_share;
use crate::checks::visibility::view_miss;
use crate::judge::judged::JudgedCandidate;
use crate::judge::problem::PlacementProblem;
use crate::scene::candidate::CandidatePose;
use crate::settings::{GoalBy, StandingBy};

/// What it does to the constraints where an object ends up a little off a candidate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Slip {
    /// All hold still.
    Harmless,
    /// One fails that only this request makes: its region, its clearance, or the reach of its robot.
    BreaksOwn,
    /// One fails that any request makes.
    Breaks,
}

/// Which constraints a candidate is tried by.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Scope {
    /// All.
    All,
    /// Those that any request makes, and of its goal all but to be centered: that is asked of where an object is meant to be, to the millimetre.
    OfAnyRequest,
}

/// The constraints of one problem.
#[derive(Debug)]
pub struct Constraints<'a> {
    problem: PlacementProblem<'a>,
    /// Objects that a goal term asks to touch.
    touched: Vec<u16>,
    clearance: Clearance<'a>,
    /// Of the robot that the request names.
    reach: Option<Reach<'a>>,
    /// Why the object cannot be moved anywhere, with by how much: it tips wherever it is set down in the attitude in which it was seen, or
    /// something comes down when it is taken away.
    refused: Vec<(Rejection, f64)>,
    /// Heights at which things stand and of their tops; empty where the request says itself where to look.
    levels_m: Vec<f32>,
}

impl<'a> Constraints<'a> {
    /// The constraints of a problem.
    pub fn new(problem: PlacementProblem<'a>) -> Self {
        let touched = problem.anchors_of(&[Relation::Touching]);
        let clearance = Clearance::new(problem.prepared, problem.query, &problem.settings.fixed, touched.clone());
        let reach = problem.settings.world_from_base.map(|pose| Reach::new(&pose, &problem.settings.fixed.reach));
        // The floor beside a table is no second choice, but a region or a goal of being below something may ask for it.
        let asked = !problem.anchors_of(&[Relation::Above, Relation::Below]).is_empty() || problem.request.region.iter().any(|r| r.inside);
        let shapes = problem.prepared.belief.objects.values().filter_map(|object| object.shape.as_ref()).filter(|_| !asked);
        let levels_m = shapes.flat_map(|shape| [shape.bottom_m, shape.top_m]).collect();
        let leans = || problem.prepared.standing_traits(problem.query.id).is_some_and(|traits| traits.leans());
        let tips = problem.settings.recipe.standing_by == StandingBy::Rule && leans();
        let refused = if tips { vec![(Rejection::Tips, 1.0)] } else { Vec::new() };
        Self { problem, touched, clearance, reach, refused, levels_m }
    }

    /// Rejects every candidate from now on for these reasons, each with by how much.
    pub fn refuse(&mut self, reasons: impl IntoIterator<Item = (Rejection, f64)>) {
        self.refused.extend(reasons);
    }

    /// Whether every candidate is rejected.
    pub fn refuse_all(&self) -> bool {
        !self.refused.is_empty()
    }

    /// A candidate after every constraint that needs no network.
    pub fn tried(&self, candidate: CandidatePose, mode: usize) -> JudgedCandidate {
        self.tried_by(Scope::All, candidate, mode)
    }

    /// What it does to the constraints where an object ends up in a place a little off a candidate.
    pub fn slip(&self, off: CandidatePose) -> Slip {
        let judged = self.tried_by(Scope::OfAnyRequest, off, 0);
        let is_too_near = || judged.obstruction.is_some_and(|found| self.clearance_miss(&judged, &found).is_some());
        if !judged.feasible() {
            Slip::Breaks
        } else if self.region_miss(&off).is_some() || is_too_near() || self.reach_miss(&off).is_some() {
            Slip::BreaksOwn
        } else {
            Slip::Harmless
        }
    }

    fn tried_by(&self, scope: Scope, candidate: CandidatePose, mode: usize) -> JudgedCandidate {
        let PlacementProblem { prepared, query, settings, .. } = self.problem;
        let (fixed, recipe) = (&settings.fixed, settings.recipe);
        let mut judged = JudgedCandidate::new(candidate, mode);
        for (reason, miss) in &self.refused {
            judged.reject(*reason, *miss);
        }
        if scope == Scope::All
            && let Some(miss) = self.region_miss(&candidate)
        {
            judged.reject(Rejection::Region, miss);
        }
        let (visibility, miss) = view_miss(&prepared.belief.view, query, &candidate, &fixed.view);
        judged.unhidden = Some(visibility.unhidden);
        if let Some(miss) = miss {
            judged.reject(Rejection::OutOfView, miss);
        }
        if recipe.grounded {
            let unseen = unseen_share(prepared.scene.meta.unseen.space.as_ref(), query, &candidate, &fixed.unseen);
            judged.unseen_share = Some(unseen);
            if unseen > fixed.unseen.max_share {
                judged.reject(Rejection::OutOfView, unseen - fixed.unseen.max_share);
            }
        }
        if recipe.grounded || settings.min_clearance_m > 0.0 {
            self.try_obstruction(scope, &mut judged);
        }
        if recipe.grounded {
            let footing = self.problem.ground().footing(&candidate);
            judged.footing = Some(footing);
            let miss = support_miss(&footing, query, &fixed.support).unwrap_or(0.0) + self.level_miss(&candidate);
            if miss > 0.0 {
                judged.reject(Rejection::Unsupported, miss);
            }
        }
        // Postures are looked for where nothing else speaks against the place.
        if scope == Scope::All
            && judged.feasible()
            && let Some(miss) = self.reach_miss(&candidate)
        {
            judged.reject(Rejection::OutOfReach, miss);
        }
        if recipe.goal_by != GoalBy::Learned {
            self.try_goal_by_rule(scope, &mut judged);
        }
        if !judged.feasible() {
            judged.leave_untried(recipe.learned_constraints());
        }
        judged
    }

    /// By how much a candidate misses the regions that are asked for.
    fn region_miss(&self, candidate: &CandidatePose) -> Option<f64> {
        region_miss(&self.problem.placed_centroid(candidate), &self.problem.request.region)
    }

    /// By how much the place where the hand lets go of the object is out of the robot's reach.
    fn reach_miss(&self, candidate: &CandidatePose) -> Option<f64> {
        self.reach.as_ref()?.miss(self.problem.query, &self.problem.let_go(candidate))
    }

    /// By how much a candidate keeps less clear than is asked for, metres; `found` is what is in its way.
    fn clearance_miss(&self, judged: &JudgedCandidate, found: &Obstruction) -> Option<f64> {
        let PlacementProblem { prepared, settings, .. } = self.problem;
        let wanted_m = settings.min_clearance_m;
        if wanted_m <= 0.0 {
            return None;
        }
        // A variant without a collision constraint still keeps the clearance: in collision it is 0.
        let by_cells_m = wanted_m.min(f64::from(settings.fixed.clearance.max_ring_m));
        if found.most_clear_m(prepared.belief.columns.cell_m()) < by_cells_m {
            return Some(wanted_m - found.clearance_m);
        }
        if !judged.feasible() {
            return None;
        }
        // The cells are exact to about a centimetre, and do not see low things, nor farther than their ring.
        let clearance_m = self.clearance.within(&judged.candidate, wanted_m)?;
        (clearance_m < wanted_m).then_some(wanted_m - clearance_m)
    }

    /// By how much a candidate's level is farther from all that things stand on than counts.
    fn level_miss(&self, candidate: &CandidatePose) -> f64 {
        let PlacementProblem { query, settings, .. } = self.problem;
        let bottom_m = query.bottom_of(candidate.centroid_m[2]);
        let nearest_m = self.levels_m.iter().map(|level_m| (bottom_m - level_m).abs()).reduce(f32::min);
        nearest_m.map_or(0.0, |off_m| MISS_PER_METRE * f64::from((off_m - settings.fixed.support.far_level_m).max(0.0)))
    }

    fn try_obstruction(&self, scope: Scope, judged: &mut JudgedCandidate) {
        let PlacementProblem { prepared, query, settings, .. } = self.problem;
        let fixed = &settings.fixed;
        let found = obstruction(prepared, query, &judged.candidate, &self.touched, &fixed.clearance, &fixed.support);
        if settings.recipe.grounded && found.colliding_share > 0.0 {
            judged.reject(Rejection::Collision, found.colliding_share);
        } else if scope == Scope::All
            && let Some(missing_m) = self.clearance_miss(judged, &found)
        {
            judged.reject(Rejection::Clearance, missing_m);
        }
        judged.obstruction = Some(found);
    }

    fn try_goal_by_rule(&self, scope: Scope, judged: &mut JudgedCandidate) {
        let PlacementProblem { rules, request, settings, .. } = self.problem;
        let rule_settings = &settings.fixed.rules;
        let checks = rules.checks(&judged.candidate);
        let counts = |term: &GoalTerm| scope == Scope::All || term.relation != Relation::Centered;
        let mut missing = 0.0;
        for (i, (term, check)) in request.goal.iter().zip(&checks).enumerate().filter(|(_, (term, _))| counts(term)) {
            let wanted_m = if term.relation.index() <= Relation::Below.index() { rule_settings.min_margin_m } else { 0.0 };
            let aside_m = rules.off_anchor_m(&judged.candidate, term, settings.recipe.goal_by);
            if !check.holds || check.margin_m < wanted_m || aside_m > 0.0 {
                judged.failing.push(i);
                missing += (wanted_m - check.margin_m).max(0.0) + aside_m;
            }
        }
        judged.checks = Some(checks);
        if !judged.failing.is_empty() {
            // A tenth of a metre counts as one.
            judged.reject(Rejection::Goal, 10.0 * missing);
        }
    }
}

#[cfg(test)]
mod tests {
    use repose_proto::RigidTransform;
    use repose_proto::place::{PlaceRequest, ReachingRobot, Variant};

    use super::*;
    use crate::scene::prepared::PreparedScene;
    use crate::settings::PlanSettings;
    use crate::tests::synthetic::{Prepared, SceneBuilder, posed, standing_at};

    #[test]
    fn reach_is_asked_about_where_the_hand_lets_go_of_an_object_whose_foot_may_be_lower() {
        let table = SceneBuilder::table().object(1, [-0.3, 0.25], [0.06; 3]).object(2, [-0.3, -0.2], [0.06, 0.06, 0.08]).prepared();
        let mut shapes = table.belief.shapes();
        shapes.get_mut(&2).unwrap().foot_doubt_m = 0.025;
        let prepared = PreparedScene::with_shapes(table.scene.clone(), shapes);
        let mut pose = RigidTransform::IDENTITY;
        pose.0[3] = -0.75;
        let request = PlaceRequest {
            variant: Variant::Geometric,
            robot: Some(ReachingRobot { name: "arm".to_owned(), world_from_base: Some(pose) }),
            ..PlaceRequest::new(prepared.scene_id.clone(), 2, vec!["right_of:1".parse().unwrap()])
        };
        let settings = PlanSettings::of(&request);
        let reach = Reach::new(&settings.world_from_base.unwrap(), &settings.fixed.reach);
        let mut differ = 0;
        posed(&prepared, &request, &settings, |problem| {
            let (constraints, query) = (Constraints::new(problem), problem.query);
            for k in 0..174 {
                let judged = standing_at(query, -0.1 + 0.003 * k as f32, 0.0, settings.fixed.support.release_m);
                let [where_judged, where_let_go] = [judged, problem.let_go(&judged)].map(|pose| reach.miss(query, &pose).is_some());
                assert_eq!(constraints.tried(judged, 0).rejection == Some(Rejection::OutOfReach), where_let_go, "{judged:?}");
                differ += usize::from(where_judged != where_let_go);
            }
        });
        assert!(differ > 0, "nowhere is it decisive how high the object is let go");
    }
}
