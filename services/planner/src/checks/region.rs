//! Whether the placed centroid keeps to the boxes that a request asks to stay inside or out of.

use nalgebra::Point3;
use repose_proto::place::RegionBox;

use crate::checks::MISS_PER_METRE;

/// By how much the placed centroid (world frame, metres) misses the asked regions: it must be inside one of the boxes to stay inside of, if
/// there are any, and outside of every other.
pub fn region_miss(p: &Point3<f64>, region: &[RegionBox]) -> Option<f64> {
    let outside_m = |b: &RegionBox| (0..3).map(|k| (b.min_m[k] - p[k]).max(p[k] - b.max_m[k]).max(0.0).powi(2)).sum::<f64>().sqrt();
    let depth_m = |b: &RegionBox| (0..3).map(|k| (p[k] - b.min_m[k]).min(b.max_m[k] - p[k])).fold(f64::INFINITY, f64::min);
    let nearest = region.iter().filter(|b| b.inside).map(outside_m).reduce(f64::min).unwrap_or(0.0);
    let deepest = region.iter().filter(|b| !b.inside).map(depth_m).fold(0.0, f64::max);
    let miss = nearest + deepest;
    (miss > 0.0).then_some(miss * MISS_PER_METRE)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn regions_to_stay_inside_of_are_alternatives_and_those_to_stay_out_of_are_not() {
        let boxed = |x: f64, inside: bool| RegionBox { min_m: [x - 0.1, -0.1, -0.1], max_m: [x + 0.1, 0.1, 0.1], inside };
        let at = |x: f64| Point3::new(x, 0.0, 0.0);
        let region = [boxed(0.0, true), boxed(1.0, true), boxed(0.1, false)];
        assert_eq!(region_miss(&at(-0.05), &region), None);
        assert_eq!(region_miss(&at(1.0), &region), None);
        assert!(region_miss(&at(0.05), &region).is_some(), "in the forbidden box");
        assert!(region_miss(&at(0.5), &region) > region_miss(&at(0.8), &region));
        assert_eq!(region_miss(&at(7.0), &[]), None);
    }
}
