//! Goal terms by rule on completed shapes: a constraint of the grounded variants, and a check beside every answer that is independent of
//! the networks.
//!
//! The rules are those of the paper's appendix (`repose-relations`), applied to completed shapes, because labels are made from whole objects.

use std::collections::BTreeMap;

use nalgebra::{Point2, Point3, Vector2, Vector3};
use repose_geometry::{ViewerFrame, cloud};
use repose_proto::place::GeometricCheck;
use repose_proto::{CallError, GoalTerm, Relation};
use repose_relations::ViewerExtents;
use repose_relations::directional::directional_margins;
use repose_relations::margins::{ALIGNED_RAD, CENTERED_M, NEAR_M, TOUCHING_CLOUDS_M};
use repose_relations::rectangle::{quarter_turn_difference_rad, rectangle_yaw_rad};

use crate::checks::prisms::PlacedPrisms;
use crate::scene::candidate::CandidatePose;
use crate::scene::prepared::PreparedScene;
use crate::settings::{GoalBy, RuleSettings};
use repose_belief::outlines::to_outline_m;
use repose_belief::shape::{Shape, Slab};
use repose_belief::unseen_end::{STEPS_M, UnseenEnd};

/// One of the two objects of a relation, as far as the rules need it.
#[derive(Debug, Clone)]
pub struct RuleObject {
    /// Its shape, world frame.
    pub shape: Shape,
    /// What it spans for the viewer.
    pub extents: ViewerExtents,
    corners: Vec<Point3<f32>>,
    yaw_rad: Option<f64>,
}

impl RuleObject {
    /// Of a completed shape and the cloud that its orientation is read from, both where the object was observed (world frame).
    pub fn new(shape: &Shape, cloud: &[Point3<f32>], viewer: &ViewerFrame) -> Self {
        let corners = boxed(shape);
        Self { shape: shape.clone(), extents: extents(&corners, viewer), corners, yaw_rad: rectangle_yaw_rad(cloud) }
    }
}

/// The rules of one request.
#[derive(Debug, Clone)]
pub struct Rules {
    terms: Vec<GoalTerm>,
    anchors: BTreeMap<u16, RuleObject>,
    viewer: ViewerFrame,
    query: RuleObject,
    settings: RuleSettings,
}

impl Rules {
    /// The rules for a goal about an object as a viewer sees it.
    ///
    /// # Errors
    /// As [`PreparedScene::object`], on `query` and `goal[i].anchor`.
    pub fn new(
        prepared: &PreparedScene,
        query: u16,
        goal: &[GoalTerm],
        viewer: &ViewerFrame,
        settings: &RuleSettings,
    ) -> Result<Self, CallError> {
        let mut anchors = BTreeMap::new();
        for (i, term) in goal.iter().enumerate() {
            let (object, shape) = prepared.object(term.anchor, &format!("goal[{i}].anchor"))?;
            anchors.entry(term.anchor).or_insert_with(|| RuleObject::new(shape, &object.points, viewer));
        }
        let (object, shape) = prepared.object(query, "query")?;
        let query = RuleObject::new(shape, &object.points, viewer);
        Ok(Self { terms: goal.to_vec(), anchors, viewer: *viewer, query, settings: settings.clone() })
    }

    /// The goal.
    pub fn terms(&self) -> &[GoalTerm] {
        &self.terms
    }

    /// The viewer.
    pub fn viewer(&self) -> &ViewerFrame {
        &self.viewer
    }

    /// An anchor of the goal.
    pub fn anchor(&self, id: u16) -> Option<&RuleObject> {
        self.anchors.get(&id)
    }

    /// What the query spans for the viewer where it was observed, turned about its centroid.
    pub fn query_extents(&self, yaw_rad: f64) -> ViewerExtents {
        if yaw_rad == 0.0 {
            return self.query.extents;
        }
        self.placed_extents(&CandidatePose::new(&self.query.shape.centroid, yaw_rad))
    }

    /// The turn that aligns the query with an anchor, modulo a quarter turn, radians; none if either has no orientation.
    pub fn aligning_yaw_rad(&self, anchor: u16) -> Option<f64> {
        Some(self.anchors.get(&anchor)?.yaw_rad? - self.query.yaw_rad?)
    }

    /// From the middle of a candidate's box to that of an anchor's, seen from above, world frame, metres: what `centered` goes by.
    pub fn to_center_m(&self, candidate: &CandidatePose, anchor: u16) -> Option<Vector2<f64>> {
        let to_center = self.anchors.get(&anchor)?.extents.center - self.placed_extents(candidate).center;
        Some((self.viewer.world_from_viewer() * to_center).xy())
    }

    /// Checks each term (negation included) for a candidate, in the goal's order.
    pub fn checks(&self, candidate: &CandidatePose) -> Vec<GeometricCheck> {
        let placed = self.placed_extents(candidate);
        let prisms = PlacedPrisms::new(&self.query.shape, candidate);
        let gap_m = |anchor: &RuleObject| prisms.to_shape_m(&anchor.shape, self.settings.contact_m);
        let mut directions: BTreeMap<u16, [f64; 6]> = BTreeMap::new();
        let check = |term: &GoalTerm| {
            // `new` has put every term's anchor in.
            let Some(anchor) = self.anchors.get(&term.anchor) else { return GeometricCheck { holds: false, margin_m: -1.0 } };
            let margin_m = match term.relation {
                Relation::Near => NEAR_M - gap_m(anchor),
                Relation::Touching => TOUCHING_CLOUDS_M - gap_m(anchor),
                Relation::Centered => CENTERED_M - placed.center_offset_m(&anchor.extents),
                Relation::Aligned => ALIGNED_RAD - self.turn_rad(candidate, anchor),
                direction => {
                    directions.entry(term.anchor).or_insert_with(|| directional_margins(&placed, &anchor.extents))[direction.index()]
                }
            };
            let at_limit = matches!(term.relation, Relation::Near | Relation::Touching | Relation::Centered);
            let holds = if at_limit { margin_m >= 0.0 } else { margin_m > 0.0 };
            let sign = if term.holds { 1.0 } else { -1.0 };
            GeometricCheck { holds: holds == term.holds, margin_m: sign * margin_m }
        };
        self.terms.iter().map(check).collect()
    }

    /// How far a candidate is from being over an anchor, metres; 0 where the middle of one is within the outline of the other, seen from above.
    ///
    /// The rule of `above` opens by 45°: what stands on a high box 20 cm beside the anchor is above it by the rule, and nobody would say so.
    fn aside_m(&self, candidate: &CandidatePose, anchor: u16) -> f64 {
        let Some(RuleObject { shape: anchor, .. }) = self.anchors.get(&anchor) else { return f64::INFINITY };
        let (query, observed) = (&self.query.shape, self.query.shape.centroid.xy().cast::<f32>());
        let carried = candidate.carrying();
        let middle = carried.place(&query.axis_offset());
        let of_anchor = anchor.slabs.iter().map(|slab| to_outline_m(&middle, slab.outline.corners()));
        let placed = |slab: &Slab| slab.outline.corners().iter().map(|c| carried.place(&(c - observed))).collect::<Vec<_>>();
        let of_query = query.slabs.iter().map(|slab| to_outline_m(&anchor.axis, &placed(slab)));
        f64::from(of_anchor.chain(of_query).fold(f32::INFINITY, f32::min))
    }

    /// How far a candidate is from being over the anchor of a term, metres; 0 where `goal_by` does not ask that of the term.
    pub fn off_anchor_m(&self, candidate: &CandidatePose, term: &GoalTerm, goal_by: GoalBy) -> f64 {
        let wants_over = term.holds && term.relation == Relation::Above && goal_by == GoalBy::RuleRankedByLearned;
        if wants_over { self.aside_m(candidate, term.anchor) } else { 0.0 }
    }

    /// Whether every term holds of the object where it was observed, as `goal_by` asks it of a place.
    pub fn hold_as_observed(&self, goal_by: GoalBy) -> bool {
        let observed = CandidatePose::new(&self.query.shape.centroid, 0.0);
        let is_over = |term: &GoalTerm| self.off_anchor_m(&observed, term, goal_by) <= 0.0;
        self.checks(&observed).iter().all(|check| check.holds) && self.terms.iter().all(is_over)
    }

    /// How likely an end of the query or of an anchor that may be farther out than is believed makes a goal of a direction fail: by the end that is
    /// likeliest to.
    pub fn farther_chance(&self, candidate: &CandidatePose) -> f64 {
        let placed = self.placed_extents(candidate);
        let ends = self.query.shape.ends_after(&candidate.placed_from_observed(&self.query.shape.centroid));
        let chance = |term: &GoalTerm| {
            // Directions have a converse, and nothing else has.
            let anchor = self.anchors.get(&term.anchor).filter(|_| term.relation.converse() != term.relation)?;
            let holds = |query: &ViewerExtents, anchor: &ViewerExtents| {
                (directional_margins(query, anchor)[term.relation.index()] > 0.0) == term.holds
            };
            let of_query = ends.iter().map(|end| self.failing_chance(end, &placed, |grown| holds(grown, &anchor.extents)));
            let of_anchor = anchor.shape.ends.iter().map(|end| self.failing_chance(end, &anchor.extents, |grown| holds(&placed, grown)));
            of_query.chain(of_anchor).reduce(f32::max)
        };
        self.terms.iter().filter_map(chance).fold(0.0, f32::max).into()
    }

    /// How likely an end is so far out that something does not hold of what its object spans.
    fn failing_chance(&self, end: &UnseenEnd, extents: &ViewerExtents, holds: impl Fn(&ViewerExtents) -> bool) -> f32 {
        if !holds(extents) {
            return 1.0;
        }
        let outwards = self.viewer.viewer_from_world() * end.outwards.push(0.0).cast::<f64>();
        let mut before_m = 0.0;
        for step_m in STEPS_M {
            if !holds(&grown(extents, &(outwards * f64::from(step_m)))) {
                // It fails somewhere between the two.
                return end.chance((before_m + step_m) / 2.0);
            }
            before_m = step_m;
        }
        0.0
    }

    fn placed_extents(&self, candidate: &CandidatePose) -> ViewerExtents {
        let placed_from_observed = candidate.placed_from_observed(&self.query.shape.centroid);
        if candidate.yaw_rad != 0.0 {
            return extents(&cloud::transformed(&self.query.corners, &placed_from_observed), &self.viewer);
        }
        let shift = self.viewer.viewer_from_world() * placed_from_observed.translation.vector;
        let e = &self.query.extents;
        ViewerExtents { low: e.low + shift, high: e.high + shift, center: e.center + shift }
    }

    fn turn_rad(&self, candidate: &CandidatePose, anchor: &RuleObject) -> f64 {
        match (self.query.yaw_rad, anchor.yaw_rad) {
            (Some(query), Some(anchor)) => quarter_turn_difference_rad(query + f64::from(candidate.yaw_rad), anchor),
            // Without an area there is no orientation to compare: the largest difference between two rectangles.
            _ => std::f64::consts::FRAC_PI_4,
        }
    }
}

/// The corners of the upright box around a shape, its sides along those of the smallest rectangle seen from above (world frame).
///
/// The rules compare boxes: a box's corner reaches further than the rounded rim inside it.
fn boxed(shape: &Shape) -> Vec<Point3<f32>> {
    let corners: Vec<Point3<f32>> = shape.corners().collect();
    let turn = nalgebra::Rotation2::new(rectangle_yaw_rad(&corners).unwrap_or(0.0) as f32);
    let start = (Point2::new(f32::INFINITY, f32::INFINITY), Point2::new(f32::NEG_INFINITY, f32::NEG_INFINITY));
    let (low, high) = corners.iter().fold(start, |(low, high), c| {
        let along = turn.inverse() * c.xy();
        (low.inf(&along), high.sup(&along))
    });
    let of_height = |z: f32| {
        [[low.x, low.y], [high.x, low.y], [high.x, high.y], [low.x, high.y]].map(|[x, y]| {
            let at = turn * Point2::new(x, y);
            Point3::new(at.x, at.y, z)
        })
    };
    of_height(shape.bottom_m).into_iter().chain(of_height(shape.top_m)).collect()
}

/// What is spanned by what goes on so far in a direction, viewer's axes, metres.
fn grown(extents: &ViewerExtents, by: &Vector3<f64>) -> ViewerExtents {
    let nothing = Vector3::zeros();
    let (low, high) = (extents.low + by.inf(&nothing), extents.high + by.sup(&nothing));
    ViewerExtents { low, high, center: nalgebra::center(&low, &high) }
}

/// What corners (world frame) span for a viewer; the centre is the box's.
fn extents(corners: &[Point3<f32>], viewer: &ViewerFrame) -> ViewerExtents {
    let viewer_from_world = viewer.viewer_from_world();
    let infinity = f64::INFINITY;
    let start = (Point3::new(infinity, infinity, infinity), Point3::new(-infinity, -infinity, -infinity));
    let (low, high) = corners.iter().fold(start, |(low, high), c| {
        let c = viewer_from_world * c.cast::<f64>();
        (low.inf(&c), high.sup(&c))
    });
    ViewerExtents { low, high, center: nalgebra::center(&low, &high) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::query::QueryObject;
    use crate::settings::Fixed;
    use crate::tests::synthetic::{Prepared, SceneBuilder, standing_at};

    #[test]
    fn a_table_of_places_has_the_relations_that_people_would_say() {
        let prepared = SceneBuilder::table().object(1, [0.0, 0.0], [0.1, 0.1, 0.1]).object(2, [-0.3, -0.2], [0.06, 0.06, 0.06]).prepared();
        let fixed = Fixed::default();
        let query = QueryObject::new(&prepared, 2, 0.0, &fixed).unwrap();
        let goal: Vec<GoalTerm> = Relation::ALL.map(|relation| GoalTerm { relation, anchor: 1, holds: true }).to_vec();
        let rules = Rules::new(&prepared, 2, &goal, &ViewerFrame::from_yaw(0.0), &fixed.rules).unwrap();
        let holding = |x: f32, y: f32, bottom_m: f32| {
            let checks = rules.checks(&standing_at(&query, x, y, bottom_m));
            let held = checks.iter().zip(Relation::ALL).filter(|(c, _)| c.holds);
            held.map(|(_, r)| r).filter(|r| *r != Aligned).collect::<Vec<_>>()
        };
        use Relation::*;
        assert_eq!(holding(-0.2, 0.0, 0.0), [LeftOf]);
        assert_eq!(holding(0.12, 0.0, 0.0), [RightOf, Near]);
        assert_eq!(holding(0.0, 0.2, 0.0), [Behind]);
        assert_eq!(holding(0.0, -0.082, 0.0), [InFrontOf, Near, Touching]);
        let anchor = &rules.anchor(1).unwrap().extents;
        let [x, y] = [anchor.center.x as f32, anchor.center.y as f32];
        assert_eq!(holding(x, y, 0.102), [Above, Near, Touching, Centered]);
    }

    #[test]
    fn what_is_above_by_the_rule_may_be_beside_its_anchor() {
        let prepared = SceneBuilder::table().object(1, [0.0, 0.0], [0.1, 0.1, 0.1]).object(2, [-0.3, -0.2], [0.06, 0.06, 0.06]).prepared();
        let fixed = Fixed::default();
        let query = QueryObject::new(&prepared, 2, 0.0, &fixed).unwrap();
        let goal = ["above:1".parse().unwrap()];
        let rules = Rules::new(&prepared, 2, &goal, &ViewerFrame::from_yaw(0.0), &fixed.rules).unwrap();
        let [over, aside] = [[0.03, 0.32], [0.15, 0.32]].map(|[x, bottom_m]| standing_at(&query, x, 0.0, bottom_m));
        assert!([over, aside].iter().all(|at| rules.checks(at)[0].holds), "both by the rule");
        assert_eq!(rules.aside_m(&over, 1), 0.0);
        assert!((rules.aside_m(&aside, 1) - 0.1).abs() < 0.02, "{}", rules.aside_m(&aside, 1));
    }

    #[test]
    fn a_goal_fails_as_likely_as_the_anchor_goes_on_behind_to_where_the_query_is() {
        let mut prepared =
            SceneBuilder::table().object(1, [0.0, 0.0], [0.1, 0.1, 0.1]).object(2, [-0.3, -0.2], [0.06, 0.06, 0.06]).prepared();
        // Behind its front the anchor goes on by 4 cm and more in three of ten cases, and by 8 cm in none.
        let back = UnseenEnd { outwards: Vector2::y(), chances: [0.3, 0.3, 0.3, 0.3, 0.0, 0.0] };
        for (id, ends) in [(1, vec![back]), (2, Vec::new())] {
            prepared.belief.objects.get_mut(&id).and_then(|object| object.shape.as_mut()).expect("a shape").ends = ends;
        }
        let fixed = Fixed::default();
        let query = QueryObject::new(&prepared, 2, 0.0, &fixed).unwrap();
        let chance = |goal: &str, x: f32, y: f32| {
            let rules = Rules::new(&prepared, 2, &[goal.parse().unwrap()], &ViewerFrame::from_yaw(0.0), &fixed.rules).unwrap();
            let at = standing_at(&query, x, y, 0.0);
            assert!(rules.checks(&at)[0].holds, "{goal} at {x}, {y}");
            rules.farther_chance(&at)
        };
        assert!((chance("behind:1", 0.0, 0.08) - 0.3).abs() < 1e-6, "right behind it: {}", chance("behind:1", 0.0, 0.08));
        assert_eq!(chance("behind:1", 0.0, 0.25), 0.0, "far behind it");
        assert_eq!((chance("left_of:1", -0.2, 0.0), chance("near:1", 0.0, 0.08)), (0.0, 0.0), "to its left, and no direction at all");
    }

    #[test]
    fn the_turn_that_aligns_two_small_things_is_the_same_from_either() {
        let prepared =
            SceneBuilder::table().object(1, [0.0, 0.0], [0.03, 0.02, 0.03]).object(2, [-0.13, -0.07], [0.02, 0.02, 0.04]).prepared();
        let turn_rad = |query: u16, anchor: u16| {
            let goal = [GoalTerm { relation: Relation::Aligned, anchor, holds: true }];
            let rules = Rules::new(&prepared, query, &goal, &ViewerFrame::from_yaw(0.0), &RuleSettings::default()).unwrap();
            rules.aligning_yaw_rad(anchor).unwrap()
        };
        assert_eq!(turn_rad(1, 2), -turn_rad(2, 1));
    }

    #[test]
    fn a_negated_term_turns_the_answer_and_the_margin() {
        let prepared = SceneBuilder::table().object(1, [0.0, 0.0], [0.1, 0.1, 0.1]).object(2, [-0.3, -0.2], [0.06, 0.06, 0.06]).prepared();
        let fixed = Fixed::default();
        let goal = [true, false].map(|holds| GoalTerm { relation: Relation::Near, anchor: 1, holds });
        let rules = Rules::new(&prepared, 2, &goal, &ViewerFrame::from_yaw(0.0), &fixed.rules).unwrap();
        let checks = rules.checks(&CandidatePose { centroid_m: [0.3, 0.0, 0.03], yaw_rad: 0.4 });
        assert!(!checks[0].holds && checks[1].holds);
        assert_eq!(checks[0].margin_m, -checks[1].margin_m);
        assert!((0.13..0.19).contains(&checks[1].margin_m), "{checks:?}");
    }

    #[test]
    fn what_holds_as_observed_is_judged_by_whole_shapes_like_any_place() {
        // The lower front of 2, from which the gap is measured, hides behind 1.
        let prepared = SceneBuilder::table().object(1, [0.0, 0.0], [0.1, 0.1, 0.1]).object(2, [0.0, 0.12], [0.06, 0.06, 0.12]).prepared();
        let holds = |term: &str| {
            let goal: [GoalTerm; 1] = [term.parse().unwrap()];
            Rules::new(&prepared, 2, &goal, &ViewerFrame::from_yaw(0.0), &RuleSettings::default()).unwrap().hold_as_observed(GoalBy::Rule)
        };
        assert!(holds("behind:1") && holds("near:1") && holds("not:touching:1") && !holds("in_front_of:1"));
    }
}
