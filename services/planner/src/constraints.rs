//! The constraints that need no network: regions, view, collision, clearance and support. Cheap ones first.
//!
//! Each answers by how much it is missed, as a plain non-negative number that grows with the miss, so that a search without feasible
//! candidates knows which way to go.

use repose_proto::place::RegionBox;

use crate::candidate::Candidate;
use crate::footing::Footing;
use crate::query::Query;
use crate::settings::{SupportSettings, ViewSettings};
use crate::view::{ObservedView, Visibility};

/// Metres by which a region is missed are weighed by this.
const PER_METRE: f64 = 10.0;

/// By how much the placed centroid misses the asked regions: it must be inside one of the boxes to stay inside of, if there are any,
/// and outside of every other.
pub fn region_miss(candidate: &Candidate, region: &[RegionBox]) -> Option<f64> {
    let p: [f64; 3] = candidate.centroid().into();
    let outside_m = |b: &RegionBox| (0..3).map(|k| (b.min_m[k] - p[k]).max(p[k] - b.max_m[k]).max(0.0).powi(2)).sum::<f64>().sqrt();
    let depth_m = |b: &RegionBox| (0..3).map(|k| (p[k] - b.min_m[k]).min(b.max_m[k] - p[k])).fold(f64::INFINITY, f64::min);
    let nearest = region.iter().filter(|b| b.inside).map(outside_m).reduce(f64::min).unwrap_or(0.0);
    let deepest = region.iter().filter(|b| !b.inside).map(depth_m).fold(0.0, f64::max);
    let miss = nearest + deepest;
    (miss > 0.0).then_some(miss * PER_METRE)
}

/// How well a candidate would be seen, and by how much that is too little.
pub fn view_miss(view: &ObservedView, query: &Query, candidate: &Candidate, settings: &ViewSettings) -> (Visibility, Option<f64>) {
    let placed_from_observed = candidate.placed_from_observed(&query.shape.centroid);
    let visibility = view.visibility(query.view_points.iter().map(|p| placed_from_observed * p), query.id, settings);
    let miss = (settings.min_in_picture - visibility.in_picture).max(0.0) + (settings.min_unhidden - visibility.unhidden).max(0.0);
    (visibility, (miss > 0.0).then_some(miss))
}

/// By how much a candidate stands too badly.
pub fn support_miss(footing: &Footing, query: &Query, settings: &SupportSettings) -> Option<f64> {
    // A thin object has no margin to give: half of what its own base allows is then enough.
    let wanted_m = settings.min_margin_m.min(0.5 * query.base_margin_m);
    let miss = (wanted_m - footing.margin_m).max(0.0) * PER_METRE + (settings.min_seen_share - footing.seen_share).max(0.0);
    (miss > 0.0).then_some(miss)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn regions_to_stay_inside_of_are_alternatives_and_those_to_stay_out_of_are_not() {
        let boxed = |x: f64, inside: bool| RegionBox { min_m: [x - 0.1, -0.1, -0.1], max_m: [x + 0.1, 0.1, 0.1], inside };
        let at = |x: f32| Candidate { centroid_m: [x, 0.0, 0.0], yaw_rad: 0.0 };
        let region = [boxed(0.0, true), boxed(1.0, true), boxed(0.1, false)];
        assert_eq!(region_miss(&at(-0.05), &region), None);
        assert_eq!(region_miss(&at(1.0), &region), None);
        assert!(region_miss(&at(0.05), &region).is_some(), "in the forbidden box");
        assert!(region_miss(&at(0.5), &region) > region_miss(&at(0.8), &region));
        assert_eq!(region_miss(&at(7.0), &[]), None);
    }
}
