//! One request on one scene: what every step of a search reads and none changes.

use nalgebra::{Point3, Vector2};
use repose_geometry::ViewerFrame;
use repose_proto::place::PlaceRequest;
use repose_proto::{CallError, Relation};

use crate::checks::footing::Ground;
use crate::checks::prisms::PlacedPrisms;
use crate::checks::rules::Rules;
use crate::scene::candidate::CandidatePose;
use crate::scene::prepared::PreparedScene;
use crate::scene::query::QueryObject;
use crate::scene::turned::Turned;
use crate::settings::PlanSettings;

/// A placement problem.
#[derive(Debug, Clone, Copy)]
pub struct PlacementProblem<'a> {
    /// The scene.
    pub prepared: &'a PreparedScene,
    /// How the object was turned over in it; none as it lies.
    pub turned: Option<&'a Turned<'a>>,
    /// The object to move.
    pub query: &'a QueryObject,
    /// The goal by rule.
    pub rules: &'a Rules,
    /// The request.
    pub request: &'a PlaceRequest,
    /// The request's settings.
    pub settings: &'a PlanSettings,
}

/// Has work done on the problem that a request poses on a scene, in which the object lies as it was seen or was turned over.
///
/// # Errors
/// `not_found` on `query` or `goal[i].anchor`, `failed_precondition` for an object of which too little was seen.
pub fn posed<T>(
    prepared: &PreparedScene,
    turned: Option<&Turned<'_>>,
    request: &PlaceRequest,
    settings: &PlanSettings,
    work: impl FnOnce(PlacementProblem<'_>) -> T,
) -> Result<T, CallError> {
    let viewer = ViewerFrame::from_yaw(request.view_yaw_rad.unwrap_or(prepared.scene.meta.view_yaw_rad));
    let query = prepared.query(request.query, settings.min_clearance_m, &settings.fixed)?;
    let rules = Rules::new(prepared, query.id, &request.goal, &viewer, &settings.fixed.rules)?;
    Ok(work(PlacementProblem { prepared, turned, query: &query, rules: &rules, request, settings }))
}

impl<'a> PlacementProblem<'a> {
    /// The scene in which the object is as it was seen: that which it is taken from.
    pub fn as_seen(&self) -> &'a PreparedScene {
        self.turned.map_or(self.prepared, |turned| turned.as_seen)
    }

    /// The ground under this problem's candidates.
    pub fn ground(&self) -> Ground<'a> {
        Ground { prepared: self.prepared, query: self.query, settings: &self.settings.fixed.support }
    }

    /// The anchors of the terms that must hold for one of some relations, in the goal's order.
    pub fn anchors_of(&self, relations: &[Relation]) -> Vec<u16> {
        let terms = self.request.goal.iter().filter(|t| t.holds && relations.contains(&t.relation));
        terms.map(|t| t.anchor).collect()
    }

    /// The least distance from a candidate to the shape of another object that does not carry it, and to all that the back of one may be, metres;
    /// infinite without one.
    pub fn shape_gaps_m(&self, candidate: &CandidatePose) -> [f64; 2] {
        let (under, placed) = (self.ground().objects_under(candidate), PlacedPrisms::new(&self.query.shape, candidate));
        let others = self.prepared.belief.objects.iter().filter(|(id, _)| **id != self.query.id && !under.contains(id));
        let gaps = others.filter_map(|(_, object)| object.shape.as_ref()).map(|shape| {
            let gap_m = placed.to_shape_m(shape, 0.0);
            [gap_m, shape.with_doubt().map_or(gap_m, |doubted| placed.to_shape_m(&doubted, 0.0))]
        });
        gaps.fold([f64::INFINITY; 2], |[least, doubted], [gap_m, doubted_m]| [least.min(gap_m), doubted.min(doubted_m)])
    }

    /// The candidate set down ([`PlacementProblem::lowered`]); a goal of being centered moves it over the anchor first. Unchanged when the variant does
    /// not ground its candidates.
    pub fn settled(&self, candidate: &CandidatePose, ceiling_m: f32) -> CandidatePose {
        if !self.settings.recipe.grounded {
            return *candidate;
        }
        let mut over_anchor = *candidate;
        let centered = self.request.goal.iter().find(|t| t.holds && t.relation == Relation::Centered);
        if let Some(shift) = centered.and_then(|t| self.rules.to_center_m(&over_anchor, t.anchor)) {
            over_anchor.centroid_m[0] += shift.x as f32;
            over_anchor.centroid_m[1] += shift.y as f32;
        }
        self.lowered(&over_anchor, ceiling_m)
    }

    /// The candidate set down on what is under it when it is lowered from `ceiling_m`; unchanged when nothing is.
    pub fn lowered(&self, candidate: &CandidatePose, ceiling_m: f32) -> CandidatePose {
        let mut lowered = *candidate;
        if let Some(rest_m) = self.ground().rest_m(candidate, ceiling_m) {
            lowered.centroid_m[2] = rest_m + self.query.shape.centroid_height_m();
        }
        lowered
    }

    /// Where an answer lets go of the object: higher than it was judged where its foot may be lower than is believed. A fall of that much is harmless,
    /// being pressed into what carries it is not.
    pub fn let_go(&self, candidate: &CandidatePose) -> CandidatePose {
        let mut let_go = *candidate;
        if self.settings.recipe.grounded {
            let_go.centroid_m[2] += self.query.shape.foot_doubt_m;
        }
        let_go
    }

    /// Where the answer that a candidate makes puts the centroid of what was observed of the object, world frame, metres.
    pub fn placed_centroid(&self, candidate: &CandidatePose) -> Point3<f64> {
        let let_go = self.let_go(candidate);
        let carried = |turned: &Turned<'_>| let_go.placed_from_observed(&self.query.shape.centroid) * turned.observed_centroid;
        self.turned.map_or_else(|| let_go.centroid(), carried)
    }

    /// From the centroid that candidates are given by to that of the object's observed points, before a turn, seen from above, metres: zero unless the
    /// object was turned over.
    pub fn observed_offset(&self) -> Vector2<f32> {
        let apart = |turned: &Turned<'_>| (turned.observed_centroid - self.query.shape.centroid).xy().cast::<f32>();
        self.turned.map_or_else(Vector2::zeros, apart)
    }

    /// The height that a drawn candidate is lowered from, world z, metres.
    pub fn ceiling_over(&self, candidate: &CandidatePose) -> f32 {
        self.query.bottom_of(candidate.centroid_m[2]) + self.settings.fixed.proposals.lowered_m
    }
}

#[cfg(test)]
mod tests {
    use repose_proto::place::Variant;

    use super::*;
    use crate::tests::synthetic::{Prepared, SceneBuilder, posed};

    #[test]
    fn what_is_to_be_centered_is_so_by_the_rule_though_its_mass_is_to_one_side() {
        let seen = SceneBuilder::table().object(1, [0.1, 0.0], [0.12, 0.12, 0.06]).object(2, [-0.25, -0.2], [0.06, 0.05, 0.08]).prepared();
        let mut shapes = seen.belief.shapes();
        shapes.get_mut(&2).unwrap().axis.x += 0.01;
        let prepared = PreparedScene::with_shapes(seen.scene.clone(), shapes);
        let goal = vec!["centered:1".parse().unwrap()];
        let wanted = PlaceRequest { variant: Variant::Geometric, ..PlaceRequest::new(prepared.scene_id.clone(), 2, goal) };
        let request = PlaceRequest { view_yaw_rad: Some(0.3), ..wanted };
        posed(&prepared, &request, &PlanSettings::of(&request), |problem| {
            for yaw_rad in [0.0, 0.7] {
                let checks = problem.rules.checks(&problem.settled(&CandidatePose { centroid_m: [0.2, 0.1, 0.1], yaw_rad }, 0.2));
                assert!(checks[0].holds, "turned by {yaw_rad}: {checks:?}");
            }
        });
    }
}
