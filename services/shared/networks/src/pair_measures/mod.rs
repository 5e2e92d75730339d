//! What can be measured of a pair of observed clouds without learning, as inputs of the `measured` relation predictor.
//!
//! The paper's predictor sees two codes and has to find millimetres in them (`touching` and `centered` mean one). Beside the codes, the
//! `measured` variant reads the margins of the directional rules, how far the boxes, the clouds' nearest points and their hulls are apart
//! (the widest gap that a plane can be put into), and guesses at where the objects' middles are. Border cleaning has taken the points at a
//! contact from both clouds, and the nearer the camera, the less of them; so gaps are also given with what was taken put back on
//! ([`crate::points::Rim`]). What is nearer hides its own back, so gaps are also given between clouds that were completed: by their half turn
//! about a guess at the middle.
//!
//! Each length is given more than once, in units from decimetres to millimetres and cut off, so that a small network can use all of them.

mod bands;
mod cloud;
mod gap;
mod middles;

use nalgebra::Vector3;
use repose_relations::{ViewerExtents, directional::directional_margins};

pub use cloud::MeasuredCloud;

use bands::{OUTLINES, circles_apart, outlines_apart, points_from_circle};
use cloud::Outline;
use gap::{CLOSE_M, nearest, separation};
use middles::Guess;

/// How many numbers [`pair_measures`] gives.
pub const PAIR_MEASURES: usize = 146;

/// Numbers are cut off at this many units.
const MOST_UNITS: f32 = 3.0;
/// The units, metres.
const COARSE_M: f32 = 0.1;
const FINE_M: f32 = 0.01;
const FINEST_M: f32 = 0.003;

/// Numbers, one after the other.
struct Measures {
    values: [f32; PAIR_MEASURES],
    next: usize,
}

impl Measures {
    fn put(&mut self, value: f32) {
        self.values[self.next] = value.clamp(-MOST_UNITS, MOST_UNITS);
        self.next += 1;
    }

    fn put_length(&mut self, length_m: f32, units_m: &[f32]) {
        units_m.iter().for_each(|unit_m| self.put(length_m / unit_m));
    }
}

/// The measures of a pair: `offset_m` is the query's centroid minus the anchor's, viewer's axes, metres.
pub fn pair_measures(query: &MeasuredCloud, anchor: &MeasuredCloud, offset_m: [f32; 3]) -> [f32; PAIR_MEASURES] {
    let mut measures = Measures { values: [0.0; PAIR_MEASURES], next: 0 };
    let (q, a) = (query.extents(offset_m), anchor.extents([0.0; 3]));
    put_boxes(&mut measures, &q, &a);
    let offset = Vector3::from(offset_m);
    let between = put_gaps(&mut measures, query, anchor, &offset);
    put_completed_gaps(&mut measures, query, anchor, &offset, &between);
    put_gaps_by_height(&mut measures, query, anchor, &offset, &q, &a);
    put_restored_boxes(&mut measures, query, anchor, &q, &a);
    put_middles(&mut measures, query, anchor, offset_m, &q, &a);
    debug_assert_eq!(measures.next, PAIR_MEASURES);
    measures.values
}

/// Margins of the rules, and how the boxes lie to each other.
fn put_boxes(measures: &mut Measures, q: &ViewerExtents, a: &ViewerExtents) {
    for margin_m in directional_margins(q, a) {
        measures.put_length(margin_m as f32, &[COARSE_M, FINE_M]);
    }
    for k in 0..3 {
        measures.put_length((q.center[k] - a.center[k]) as f32, &[COARSE_M, FINE_M]);
        measures.put_length((q.high[k] - q.low[k]) as f32, &[COARSE_M]);
        measures.put_length((a.high[k] - a.low[k]) as f32, &[COARSE_M]);
        measures.put_length((q.low[k] - a.high[k]).max(a.low[k] - q.high[k]) as f32, &[COARSE_M, FINE_M]);
    }
}

/// Gaps as observed and with what cleaning took put back on, where the planes in them face, and what it is that cleaning took. Returns the
/// normal of the second plane.
fn put_gaps(measures: &mut Measures, query: &MeasuredCloud, anchor: &MeasuredCloud, offset: &Vector3<f32>) -> Vector3<f32> {
    let (mut least_m, mut between) = (f32::INFINITY, Vector3::z());
    for outline in [Outline::Observed, Outline::Restored] {
        let (gap_m, normal) = separation(query, anchor, offset, outline);
        measures.put_length(gap_m, &[COARSE_M, FINE_M, FINEST_M]);
        normal.iter().for_each(|n| measures.put(*n));
        if outline == Outline::Restored {
            // A gap along the line of sight is one that the nearer object may hide its own back in.
            [query, anchor].iter().for_each(|cloud| measures.put(normal.dot(&Vector3::from(cloud.rim.line_of_sight))));
        }
        least_m = least_m.min(gap_m);
        between = normal;
    }
    let nearest_m = if least_m < CLOSE_M { nearest(query, anchor, offset) } else { [CLOSE_M; 2] };
    nearest_m.iter().for_each(|distance_m| measures.put_length(*distance_m, &[FINE_M, FINEST_M]));
    for cloud in [query, anchor] {
        measures.put_length(cloud.rim.width_m, &[FINE_M]);
        measures.put(cloud.rim.line_of_sight[2]);
    }
    between
}

/// The gap of the clouds completed by each guess at their middles, and where the plane in it faces; and how far the clouds are apart along
/// the normal of the plane between them uncompleted, with either completed and with both.
fn put_completed_gaps(
    measures: &mut Measures,
    query: &MeasuredCloud,
    anchor: &MeasuredCloud,
    offset: &Vector3<f32>,
    between: &Vector3<f32>,
) {
    for guess in Guess::ALL {
        let completed = Outline::Completed(guess);
        let (gap_m, normal) = separation(query, anchor, offset, completed);
        measures.put_length(gap_m, &[COARSE_M, FINE_M, FINEST_M]);
        measures.put(normal.z);
        measures.put(normal.dot(&Vector3::from(query.rim.line_of_sight)));
        for [ours, theirs] in [[completed, Outline::Restored], [Outline::Restored, completed], [completed; 2]] {
            let gap_m = between.dot(offset) - query.reach(&-between, ours) - anchor.reach(between, theirs);
            measures.put_length(gap_m, &[FINE_M, FINEST_M]);
        }
    }
}

/// How far the clouds are apart at the heights that both reach, and at how many millimetres of height that is.
fn put_gaps_by_height(
    measures: &mut Measures,
    query: &MeasuredCloud,
    anchor: &MeasuredCloud,
    offset: &Vector3<f32>,
    q: &ViewerExtents,
    a: &ViewerExtents,
) {
    for outline in OUTLINES {
        let (gap_m, normal) = outlines_apart(query, anchor, offset, outline);
        measures.put_length(gap_m, &[FINE_M, FINEST_M]);
        let [x, y, _] = query.rim.line_of_sight;
        measures.put(normal.x * x + normal.y * y);
    }
    let circles = circles_apart(query, anchor, offset);
    measures.put_length(circles.gap_m, &[FINE_M, FINEST_M]);
    circles.residuals.iter().for_each(|share| measures.put(*share));
    for (gap_m, residual, radius_m) in [points_from_circle(query, anchor, &-offset), points_from_circle(anchor, query, offset)] {
        measures.put_length(gap_m, &[FINE_M, FINEST_M]);
        measures.put(residual);
        measures.put_length(radius_m, &[COARSE_M]);
    }
    let shared_m = q.high.z.min(a.high.z) - q.low.z.max(a.low.z);
    measures.put_length(shared_m as f32, &[COARSE_M, FINE_M]);
}

/// How far the boxes are apart with what cleaning took put back on; upwards, either on the other.
fn put_restored_boxes(measures: &mut Measures, query: &MeasuredCloud, anchor: &MeasuredCloud, q: &ViewerExtents, a: &ViewerExtents) {
    for k in 0..3 {
        let beyond_m = query.beyond_along(k) + anchor.beyond_along(k);
        let (over_m, under_m) = ((q.low[k] - a.high[k]) as f32 - beyond_m, (a.low[k] - q.high[k]) as f32 - beyond_m);
        measures.put_length(over_m.max(under_m), &[FINE_M, FINEST_M]);
        if k == 2 {
            measures.put_length(over_m, &[FINE_M, FINEST_M]);
            measures.put_length(under_m, &[FINE_M, FINEST_M]);
        }
    }
}

/// Where the middles are to each other, seen from above, and what speaks for which guess.
fn put_middles(
    measures: &mut Measures,
    query: &MeasuredCloud,
    anchor: &MeasuredCloud,
    offset_m: [f32; 3],
    q: &ViewerExtents,
    a: &ViewerExtents,
) {
    let between = |of: [[f32; 2]; 2]| [0, 1].map(|k| of[0][k] + offset_m[k] - of[1][k]);
    let (ours, theirs) = (&query.middles, &anchor.middles);
    let of_boxes = [0, 1].map(|k| (q.center[k] - a.center[k]) as f32);
    measures.put_length(of_boxes[0].hypot(of_boxes[1]), &[COARSE_M, FINE_M, FINEST_M]);
    measures.put_length(of_boxes[0], &[FINEST_M]);
    measures.put_length(of_boxes[1], &[FINEST_M]);
    for pair in [[ours.top, theirs.top], [ours.rectangle, theirs.rectangle], [ours.circle, theirs.circle]] {
        let [x, y] = between(pair);
        measures.put_length(x.hypot(y), &[FINE_M, FINEST_M]);
        measures.put_length(x, &[FINEST_M]);
        measures.put_length(y, &[FINEST_M]);
    }
    for middles in [ours, theirs] {
        measures.put_length(middles.residual, &[FINEST_M]);
        [middles.radius, middles.edges[0], middles.edges[1]].iter().for_each(|m| measures.put_length(*m, &[COARSE_M]));
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;
    use proptest::prelude::*;

    use super::*;
    use crate::points::{CloudConfig, ObjectCloud, Sight};

    /// The surface of a box about its middle, turned about z, seen along y before it was turned by a camera whose border cleaning takes `rim_m`.
    pub(super) fn cuboid(half: [f32; 3], yaw_rad: f32, rim_m: f32) -> MeasuredCloud {
        let mut points = Vec::new();
        let steps = half.map(|h| (h / 0.004).ceil() as i32);
        for i in -steps[0]..=steps[0] {
            for j in -steps[1]..=steps[1] {
                for k in -steps[2]..=steps[2] {
                    let at = [i, j, k];
                    if (0..3).any(|a| at[a].abs() == steps[a]) {
                        points.push(Point3::from(std::array::from_fn::<f32, 3, _>(|a| half[a] * at[a] as f32 / steps[a] as f32)));
                    }
                }
            }
        }
        MeasuredCloud::new(&cloud_of(&points, rim_m).turned(yaw_rad))
    }

    /// Points seen along y by a camera whose border cleaning takes `rim_m`.
    pub(super) fn measured(points: &[Point3<f32>], rim_m: f32) -> MeasuredCloud {
        MeasuredCloud::new(&cloud_of(points, rim_m))
    }

    fn cloud_of(points: &[Point3<f32>], rim_m: f32) -> ObjectCloud {
        let config = CloudConfig { voxel_m: 0.001, object_points: points.len(), border_px: 0.5, ..CloudConfig::default() };
        let sight = Sight { eye: Point3::new(0.0, -1.0, 0.0), pixel_rad: rim_m };
        ObjectCloud::new(points, &sight, &config).unwrap()
    }

    proptest! {
        #[test]
        fn measures_are_finite_and_cut_off(offset in prop::array::uniform3(-2.0..2.0f32)) {
            let (query, anchor) = (cuboid([0.03, 0.04, 0.05], 0.3, 0.004), cuboid([0.05, 0.04, 0.02], -0.8, 0.002));
            let measures = pair_measures(&query, &anchor, offset);
            prop_assert!(measures.iter().all(|m| m.abs() <= MOST_UNITS));
        }
    }

    #[test]
    fn there_are_as_many_measures_as_it_says_and_a_single_point_has_them_too() {
        let mut measures = Measures { values: [0.0; PAIR_MEASURES], next: 0 };
        let cloud = cuboid([0.03, 0.04, 0.05], 0.3, 0.004);
        let (q, a) = (cloud.extents([0.1, 0.0, 0.0]), cloud.extents([0.0; 3]));
        put_boxes(&mut measures, &q, &a);
        let offset = Vector3::new(0.1, 0.0, 0.0);
        let between = put_gaps(&mut measures, &cloud, &cloud, &offset);
        put_completed_gaps(&mut measures, &cloud, &cloud, &offset, &between);
        put_gaps_by_height(&mut measures, &cloud, &cloud, &offset, &q, &a);
        put_restored_boxes(&mut measures, &cloud, &cloud, &q, &a);
        put_middles(&mut measures, &cloud, &cloud, [0.1, 0.0, 0.0], &q, &a);
        assert_eq!(measures.next, PAIR_MEASURES);
        let sight = Sight { eye: Point3::new(0.0, -1.0, 0.0), pixel_rad: 0.002 };
        let point = MeasuredCloud::new(&ObjectCloud::new(&[Point3::origin()], &sight, &CloudConfig::default()).unwrap());
        assert!(pair_measures(&point, &cloud, [0.0; 3]).iter().all(|m| m.is_finite()));
    }
}
