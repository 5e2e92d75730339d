//! Candidates from the goal's geometry, without a network: beside, on, around or aligned with the anchors of the positive terms.
//!
//! A proposal says where the query's axis goes, seen from above, its yaw, and the height from which it is lowered; the observed supports
//! decide where it comes to rest. Terms take turns. Some proposals come from anywhere on the observed surfaces or in the asked regions,
//! so that a place is also found where the geometry of the terms would not look.

use nalgebra::{Point2, Point3, Vector2};
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use repose_geometry::transform::wrap_angle;
use repose_proto::place::{RegionBox, Rotation};
use repose_proto::{GoalTerm, Relation, limits};
use repose_relations::ViewerExtents;

use crate::checks::rules::{RuleObject, Rules};
use crate::scene::candidate::CandidatePose;
use crate::scene::prepared::PreparedScene;
use crate::scene::query::QueryObject;
use crate::settings::ProposerSettings;

/// A candidate that is still to be lowered onto its support.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Proposal {
    /// Where it was drawn; the height is that of the main anchor's support.
    pub drawn: CandidatePose,
    /// Its bottom is lowered from here, world z, metres.
    pub ceiling_m: f32,
}

/// Draws proposals for one request.
#[derive(Debug)]
pub struct Proposer<'a> {
    /// The scene.
    pub prepared: &'a PreparedScene,
    /// The object to move.
    pub query: &'a QueryObject,
    /// The goal.
    pub rules: &'a Rules,
    /// Boxes to stay inside or out of, asked about the centroid of what was observed of the object.
    pub region: &'a [RegionBox],
    /// Where that centroid is from the query's, before a turn, seen from above, metres.
    pub observed_offset: Vector2<f32>,
    /// Whether yaw is drawn.
    pub rotation: Rotation,
    /// Reach and shares.
    pub settings: &'a ProposerSettings,
}

impl Proposer<'_> {
    /// The `index`-th proposal. Where regions are asked for, what lies over none of them is drawn again: it would be tried in vain.
    pub fn draw(&self, index: u64, rng: &mut Pcg64) -> Proposal {
        const REDRAWS: usize = 20;
        let mut proposal = self.drawn(index, rng);
        for _ in 0..REDRAWS {
            if self.is_over_a_region(&proposal) {
                break;
            }
            proposal = self.drawn(index, rng);
        }
        proposal
    }

    /// Whether a proposal, seen from above, lies in a region that is asked for, if any is.
    fn is_over_a_region(&self, proposal: &Proposal) -> bool {
        let at = proposal.drawn.carry(&self.observed_offset);
        let mut asked = self.region.iter().filter(|r| r.inside).peekable();
        asked.peek().is_none() || asked.any(|r| (0..2).all(|k| (r.min_m[k]..=r.max_m[k]).contains(&f64::from(at[k]))))
    }

    fn drawn(&self, index: u64, rng: &mut Pcg64) -> Proposal {
        let positive: Vec<&GoalTerm> = self.rules.terms().iter().filter(|t| t.holds).collect();
        let anywhere = rng.random_range(0.0..1.0) < self.settings.anywhere_share;
        let term = positive.get(index as usize % positive.len().max(1)).filter(|_| !anywhere);
        let anchored = term.and_then(|term| Some((term, self.rules.anchor(term.anchor)?)));
        let axis_offset = self.query.shape.axis_offset();
        // How wide the query is beside an anchor is known once its turn is.
        let turned = |yaw_rad: f64| if self.rotation == Rotation::Fixed { 0.0 } else { yaw_rad };
        let (place, offset, yaw_rad) = match anchored {
            Some((term, anchor)) => {
                let (spot, yaw_rad) = (self.spot(term, anchor, rng), turned(self.yaw(term, rng)));
                (self.place_of(&spot, anchor, yaw_rad), axis_offset, yaw_rad)
            }
            None => {
                let ((place, offset), yaw_rad) = (self.anywhere(rng), turned(self.any_yaw(rng)));
                (place, offset, yaw_rad)
            }
        };
        let low_m = self.rules.terms().iter().find(|t| t.holds).and_then(|t| self.rules.anchor(t.anchor)).map_or(0.0, |a| a.shape.bottom_m);
        let turn = nalgebra::Rotation2::new(yaw_rad as f32);
        let axis = place + turn * (axis_offset - offset);
        let ceiling_m = self.ceiling_m(&axis, low_m, rng);
        let at = place - turn * offset;
        let centroid = Point3::new(at.x, at.y, low_m + self.query.shape.centroid_height_m());
        Proposal { drawn: CandidatePose::new(&centroid.cast(), yaw_rad), ceiling_m }
    }

    /// A spot for the axis where a term may hold.
    fn spot(&self, term: &GoalTerm, anchor: &RuleObject, rng: &mut Pcg64) -> Spot {
        let half_anchor = half_span(&anchor.extents);
        match term.relation {
            Relation::LeftOf => self.along(0, -1.0, rng),
            Relation::RightOf => self.along(0, 1.0, rng),
            Relation::InFrontOf => self.along(1, -1.0, rng),
            Relation::Behind => self.along(1, 1.0, rng),
            Relation::Above => {
                // Every fifth exactly on the middle, where a stack is best.
                let spread = if rng.random_range(0.0..1.0) < 0.2 { 0.0 } else { 0.5 };
                Spot::Over(half_anchor.map(|h| spread * h * normal(rng)))
            }
            Relation::Below => Spot::Over((half_anchor + Vector2::repeat(0.15)).map(|h| h * rng.random_range(-1.0..1.0))),
            Relation::Near => Self::around(rng.random_range(0.003..0.05), rng),
            Relation::Touching if rng.random_range(0.0..1.0) < 0.5 => Spot::Over(half_anchor.map(|h| 0.4 * h * normal(rng))),
            Relation::Touching => Self::around(rng.random_range(0.0..0.002), rng),
            Relation::Centered => Spot::Over(Vector2::zeros()),
            Relation::Aligned => Self::around(rng.random_range(0.01..self.settings.reach_m), rng),
        }
    }

    /// Along an axis of the viewer, beyond the anchor's face by a gap, within 45° sideways.
    fn along(&self, axis: usize, sign: f64, rng: &mut Pcg64) -> Spot {
        // The square of a uniform number: more of them close by.
        let u: f64 = rng.random_range(0.0..1.0);
        // A triangular distribution: the term holds by most straight beside the anchor.
        let aside: f64 = rng.random_range(-0.5..0.5) + rng.random_range(-0.5..0.5);
        Spot::Along { axis, sign, gap_m: self.settings.reach_m * u * u, aside }
    }

    /// In any direction around the anchor's box, a gap away from it.
    fn around(gap_m: f64, rng: &mut Pcg64) -> Spot {
        let along = rng.random_range(-1.0..1.0);
        Spot::Around { side: rng.random_range(0..4u8), gap_m, along }
    }

    /// Where the axis goes, world frame.
    fn place_of(&self, spot: &Spot, anchor: &RuleObject, yaw_rad: f64) -> Point2<f32> {
        let in_viewer = spot.offset(&half_span(&anchor.extents), &half_span(&self.rules.query_extents(yaw_rad)));
        let offset = self.rules.viewer().world_from_viewer() * in_viewer.push(0.0);
        let center = self.rules.viewer().world_from_viewer() * anchor.extents.center;
        Point2::from((center.coords + offset).xy().cast::<f32>())
    }

    /// A place anywhere in an asked region, or else on an observed surface, and which point of the object goes there, as an offset from the query's
    /// centroid: the observed centroid in a region, its axis elsewhere.
    fn anywhere(&self, rng: &mut Pcg64) -> (Point2<f32>, Vector2<f32>) {
        let asked: Vec<&RegionBox> = self.region.iter().filter(|r| r.inside).collect();
        if !asked.is_empty() {
            let region = asked[rng.random_range(0..asked.len())];
            let place = [0, 1].map(|k| self.stretch_m(region, k)).map(|[low_m, high_m]| between(low_m, high_m, rng) as f32);
            return (place.into(), self.observed_offset);
        }
        let (planes, axis_offset) = (&self.prepared.belief.planes, self.query.shape.axis_offset());
        if planes.is_empty() {
            return (self.query.shape.axis, axis_offset);
        }
        let (min, max) = planes[rng.random_range(0..planes.len())].outline.bounds();
        (Point2::from([0, 1].map(|k| between(f64::from(min[k]), f64::from(max[k]), rng) as f32)), axis_offset)
    }

    /// The stretch of a region along world x or y that is within reach of the surfaces that were seen, or, where none of it is, within the coordinates
    /// that scenes may have: a region may be unbounded.
    fn stretch_m(&self, region: &RegionBox, k: usize) -> [f64; 2] {
        let outlines = self.prepared.belief.planes.iter().map(|plane| plane.outline.bounds());
        let (low_m, high_m) =
            outlines.fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), (min, max)| (low.min(min[k]), high.max(max[k])));
        let around = [f64::from(low_m) - self.settings.reach_m, f64::from(high_m) + self.settings.reach_m];
        let within = [region.min_m[k].max(around[0]), region.max_m[k].min(around[1])];
        let most_m = f64::from(limits::MAX_COORDINATE_M);
        if within[0] <= within[1] { within } else { [region.min_m[k], region.max_m[k]].map(|v| v.clamp(-most_m, most_m)) }
    }

    fn yaw(&self, term: &GoalTerm, rng: &mut Pcg64) -> f64 {
        let aligning = self.rules.terms().iter().find(|t| t.holds && t.relation == Relation::Aligned).unwrap_or(term);
        match (aligning.relation, self.rules.aligning_yaw_rad(aligning.anchor)) {
            (Relation::Aligned, Some(yaw_rad)) => {
                let quarter = f64::from(rng.random_range(0..4u8)) * std::f64::consts::FRAC_PI_2;
                wrap_angle(yaw_rad + quarter + 0.03 * normal(rng))
            }
            _ => self.any_yaw(rng),
        }
    }

    /// As it stands, or any turn.
    fn any_yaw(&self, rng: &mut Pcg64) -> f64 {
        let turned = rng.random_range(0.0..1.0) < 0.6;
        let yaw_rad = rng.random_range(-std::f64::consts::PI..std::f64::consts::PI);
        if turned { yaw_rad } else { 0.0 }
    }

    /// From above everything, from just above what the main anchor stands on, or from just above a surface under the place.
    fn ceiling_m(&self, axis: &Point2<f32>, low_m: f32, rng: &mut Pcg64) -> f32 {
        let (from_above, pick): (f64, f64) = (rng.random_range(0.0..1.0), rng.random_range(0.0..1.0));
        if from_above < self.settings.from_above_share {
            return f32::INFINITY;
        }
        let under: Vec<f32> = self.prepared.belief.planes.iter().filter(|p| p.outline.contains(axis)).map(|p| p.height_m).collect();
        let choice = (pick * (under.len() + 1) as f64) as usize;
        under.get(choice).copied().unwrap_or(low_m) + self.settings.lowered_m
    }
}

/// A spot beside an anchor's middle, in the viewer's axes, before it is known how wide what goes there is; metres.
#[derive(Debug, Clone, Copy)]
enum Spot {
    /// That far from it, however wide that is.
    Over(Vector2<f64>),
    /// Beyond its face along an axis, and aside by a share of what the 45° allow.
    Along { axis: usize, sign: f64, gap_m: f64, aside: f64 },
    /// Beyond one of its four sides, and along it by a share.
    Around { side: u8, gap_m: f64, along: f64 },
}

impl Spot {
    /// From the anchor's middle, with half of what it spans and half of what the query spans.
    fn offset(&self, anchor: &Vector2<f64>, query: &Vector2<f64>) -> Vector2<f64> {
        match *self {
            Self::Over(offset) => offset,
            Self::Along { axis, sign, gap_m, aside } => {
                // Far enough that the query's near side lies beyond the anchor's middle, and its own middle beyond the anchor's face.
                let distance_m = (anchor[axis] + query[axis] + gap_m).max(anchor[axis] + 0.005);
                let sideways_m = (distance_m - anchor[axis] + anchor[1 - axis]) * 0.95;
                let mut offset = Vector2::zeros();
                offset[axis] = sign * distance_m;
                offset[1 - axis] = sideways_m * aside;
                offset
            }
            Self::Around { side, gap_m, along } => {
                let reach = anchor + query + Vector2::repeat(gap_m);
                match side {
                    0 => Vector2::new(-reach.x, along * reach.y),
                    1 => Vector2::new(reach.x, along * reach.y),
                    2 => Vector2::new(along * reach.x, -reach.y),
                    _ => Vector2::new(along * reach.x, reach.y),
                }
            }
        }
    }
}

/// Half of what something spans for the viewer, to the right and away.
fn half_span(extents: &ViewerExtents) -> Vector2<f64> {
    (extents.high - extents.low).xy() / 2.0
}

fn normal(rng: &mut Pcg64) -> f64 {
    StandardNormal.sample(rng)
}

fn between(low: f64, high: f64, rng: &mut Pcg64) -> f64 {
    low + (high - low) * rng.random_range(0.0..1.0)
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use repose_geometry::ViewerFrame;

    use super::*;
    use crate::settings::Fixed;
    use crate::tests::synthetic::{Prepared, SceneBuilder};

    /// Where so many proposals put what a region is asked about.
    fn drawn(region: RegionBox, observed_offset: Vector2<f32>, rotation: Rotation, count: u64) -> Vec<Point2<f32>> {
        let prepared = SceneBuilder::table().object(1, [0.0, 0.0], [0.1, 0.1, 0.1]).object(2, [-0.25, -0.2], [0.06, 0.05, 0.08]).prepared();
        let fixed = Fixed::default();
        let query = QueryObject::new(&prepared, 2, 0.0, &fixed).unwrap();
        assert!(query.shape.axis_offset().norm() > 0.005, "its axis is not where its observed centroid is");
        let goal = ["right_of:1".parse().unwrap()];
        let rules = Rules::new(&prepared, 2, &goal, &ViewerFrame::from_yaw(0.0), &fixed.rules).unwrap();
        let (region, settings) = ([region], &fixed.proposals);
        let proposer = Proposer { prepared: &prepared, query: &query, rules: &rules, region: &region, observed_offset, rotation, settings };
        let mut rng = Pcg64::seed_from_u64(3);
        (0..count).map(|i| proposer.draw(i, &mut rng).drawn.carry(&observed_offset)).collect()
    }

    #[test]
    fn what_is_drawn_for_a_region_puts_there_what_the_region_is_asked_about_however_narrow_it_is() {
        let region = RegionBox { min_m: [0.2, 0.05, -1.0], max_m: [0.203, 0.053, 1.0], inside: true };
        // As it lies, and on another side, where that centroid is elsewhere in what is judged.
        for observed_offset in [Vector2::zeros(), Vector2::new(0.03, -0.02)] {
            for rotation in [Rotation::Fixed, Rotation::Yaw] {
                let drawn = drawn(region.clone(), observed_offset, rotation, 200);
                let is_over = |at: &&Point2<f32>| (0.199..0.204).contains(&at.x) && (0.049..0.054).contains(&at.y);
                let over = drawn.iter().filter(is_over).count();
                assert!(over > 150, "{over} of 200, {rotation:?}");
            }
        }
    }

    #[test]
    fn what_is_drawn_turned_is_as_far_from_its_anchor_as_it_is_wide_then() {
        // Six times as long as wide.
        let prepared = SceneBuilder::table().object(1, [0.0, 0.0], [0.1, 0.1, 0.1]).object(2, [-0.3, -0.2], [0.24, 0.04, 0.06]).prepared();
        let fixed = Fixed::default();
        let query = QueryObject::new(&prepared, 2, 0.0, &fixed).unwrap();
        let rules = Rules::new(&prepared, 2, &["near:1".parse().unwrap()], &ViewerFrame::from_yaw(0.0), &fixed.rules).unwrap();
        let settings = &ProposerSettings { anywhere_share: 0.0, ..fixed.proposals.clone() };
        let (observed_offset, rotation) = (Vector2::zeros(), Rotation::Yaw);
        let proposer = Proposer { prepared: &prepared, query: &query, rules: &rules, region: &[], observed_offset, rotation, settings };
        let mut rng = Pcg64::seed_from_u64(3);
        let drawn = (0..600).map(|i| proposer.draw(i, &mut rng).drawn).filter(|drawn| drawn.yaw_rad != 0.0);
        // By how much the gap is less than what is near: all of that where the two overlap.
        let margins_m: Vec<f64> = drawn.map(|drawn| rules.checks(&drawn)[0].margin_m).collect();
        let (near, overlapping) = margins_m.iter().fold((0, 0), |(near, overlapping), margin_m| {
            (near + usize::from(*margin_m >= 0.0), overlapping + usize::from(*margin_m > 0.0499))
        });
        assert!(overlapping == 0 && 2 * near > margins_m.len(), "{near} near and {overlapping} overlapping of {}", margins_m.len());
    }

    #[test]
    fn of_a_region_that_goes_on_as_far_as_numbers_do_what_is_drawn_is_around_what_was_seen() {
        let region = RegionBox { min_m: [0.1, -f64::MAX, -f64::MAX], max_m: [f64::MAX; 3], inside: true };
        let drawn = drawn(region, Vector2::zeros(), Rotation::Yaw, 300);
        assert!(drawn.iter().all(|at| at.x < 0.9 && at.y.abs() < 0.9), "{drawn:?}");
    }
}
