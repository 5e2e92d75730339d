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
mod slices;

use std::fmt::Arguments;
use std::sync::OnceLock;

use nalgebra::Vector3;
use repose_relations::{ViewerExtents, directional::directional_margins};

pub use cloud::MeasuredCloud;

use bands::{OUTLINES, circles_apart, outlines_apart, points_from_circle};
use cloud::OutlineSource;
use gap::{CLOSE_M, nearest, separation};
use middles::Guess;

/// How many measures a pair has.
pub const PAIR_MEASURES: usize = 146;

/// Measures are limited to this many units either way.
const MOST_UNITS: f32 = 3.0;
/// The units of lengths, metres.
const COARSE_M: f32 = 0.1;
const FINE_M: f32 = 0.01;
const FINEST_M: f32 = 0.003;

const AXES: [&str; 3] = ["x", "y", "z"];

/// What a pair's measures are listed into: their values, or their names.
trait List {
    fn put(&mut self, name: Arguments<'_>, value: f32);

    fn put_length(&mut self, name: Arguments<'_>, length_m: f32, units_m: &[f32]) {
        for unit_m in units_m {
            self.put(format_args!("{name}/{}mm", (unit_m * 1e3).round()), length_m / unit_m);
        }
    }
}

struct Values {
    values: [f32; PAIR_MEASURES],
    next: usize,
}

impl List for Values {
    fn put(&mut self, _name: Arguments<'_>, value: f32) {
        self.values[self.next] = value.clamp(-MOST_UNITS, MOST_UNITS);
        self.next += 1;
    }
}

impl List for Vec<String> {
    fn put(&mut self, name: Arguments<'_>, _value: f32) {
        self.push(name.to_string());
    }
}

/// The measures of a pair: `offset_m` is the query's centroid minus the anchor's, viewer's axes, metres.
pub fn pair_measures(query: &MeasuredCloud, anchor: &MeasuredCloud, offset_m: [f32; 3]) -> [f32; PAIR_MEASURES] {
    let mut measures = Values { values: [0.0; PAIR_MEASURES], next: 0 };
    put_all(&mut measures, query, anchor, offset_m);
    debug_assert_eq!(measures.next, PAIR_MEASURES);
    measures.values
}

/// The name of each measure, in the order of [`pair_measures`]. Weights say by these names which measures they read.
pub fn pair_measure_names() -> &'static [String] {
    static NAMES: OnceLock<Vec<String>> = OnceLock::new();
    NAMES.get_or_init(|| {
        let mut names = Vec::with_capacity(PAIR_MEASURES);
        let point = MeasuredCloud::of_one_point();
        put_all(&mut names, &point, &point, [0.0; 3]);
        names
    })
}

fn put_all(list: &mut impl List, query: &MeasuredCloud, anchor: &MeasuredCloud, offset_m: [f32; 3]) {
    let pair = Pair { query, anchor, offset_m, offset: Vector3::from(offset_m), q: query.extents(offset_m), a: anchor.extents([0.0; 3]) };
    put_boxes(list, &pair);
    let between = put_gaps(list, &pair);
    put_completed_gaps(list, &pair, &between);
    put_gaps_by_height(list, &pair);
    put_restored_boxes(list, &pair);
    put_middles(list, &pair);
}

/// Two clouds, and the query's place relative to the anchor's.
struct Pair<'a> {
    query: &'a MeasuredCloud,
    anchor: &'a MeasuredCloud,
    /// The query's centroid minus the anchor's, metres.
    offset_m: [f32; 3],
    offset: Vector3<f32>,
    /// The query's box, where it stands relative to the anchor's centroid.
    q: ViewerExtents,
    /// The anchor's box.
    a: ViewerExtents,
}

/// Margins of the rules, and where the boxes are relative to each other.
fn put_boxes(list: &mut impl List, Pair { q, a, .. }: &Pair<'_>) {
    for (relation, margin_m) in ["left_of", "right_of", "in_front_of", "behind", "above", "below"].iter().zip(directional_margins(q, a)) {
        list.put_length(format_args!("margin.{relation}"), margin_m as f32, &[COARSE_M, FINE_M]);
    }
    for (k, axis) in AXES.iter().enumerate() {
        list.put_length(format_args!("box.center.{axis}"), (q.center[k] - a.center[k]) as f32, &[COARSE_M, FINE_M]);
        list.put_length(format_args!("box.query_size.{axis}"), (q.high[k] - q.low[k]) as f32, &[COARSE_M]);
        list.put_length(format_args!("box.anchor_size.{axis}"), (a.high[k] - a.low[k]) as f32, &[COARSE_M]);
        let gap_m = (q.low[k] - a.high[k]).max(a.low[k] - q.high[k]) as f32;
        list.put_length(format_args!("box.gap.{axis}"), gap_m, &[COARSE_M, FINE_M]);
    }
}

/// Gaps as observed and with what cleaning took put back on, where the planes in them face, and what it is that cleaning took. Returns the
/// normal of the second plane.
fn put_gaps(list: &mut impl List, Pair { query, anchor, offset, .. }: &Pair<'_>) -> Vector3<f32> {
    let (mut least_m, mut between) = (f32::INFINITY, Vector3::z());
    for (name, outline) in [("observed", OutlineSource::Observed), ("restored", OutlineSource::Restored)] {
        let (gap_m, normal) = separation(query, anchor, offset, outline);
        list.put_length(format_args!("plane.{name}.gap"), gap_m, &[COARSE_M, FINE_M, FINEST_M]);
        AXES.iter().zip(&normal).for_each(|(axis, n)| list.put(format_args!("plane.{name}.normal.{axis}"), *n));
        if outline == OutlineSource::Restored {
            // A gap along the line of sight is one that the nearer object may hide its own back in.
            for (of, cloud) in [("query", query), ("anchor", anchor)] {
                let along = normal.dot(&Vector3::from(cloud.rim.line_of_sight));
                list.put(format_args!("plane.{name}.normal_along_sight_of_{of}"), along);
            }
        }
        least_m = least_m.min(gap_m);
        between = normal;
    }
    let nearest_m = if least_m < CLOSE_M { nearest(query, anchor, offset) } else { [CLOSE_M; 2] };
    for (name, distance_m) in ["observed", "restored"].iter().zip(nearest_m) {
        list.put_length(format_args!("points.{name}.gap"), distance_m, &[FINE_M, FINEST_M]);
    }
    for (of, cloud) in [("query", query), ("anchor", anchor)] {
        list.put_length(format_args!("{of}.rim"), cloud.rim.width_m, &[FINE_M]);
        list.put(format_args!("{of}.line_of_sight.z"), cloud.rim.line_of_sight[2]);
    }
    between
}

/// The gap of the clouds completed by each guess at their middles, and where the plane in it faces; and how far the clouds are apart along
/// the normal of the plane between them uncompleted, with either completed and with both.
fn put_completed_gaps(list: &mut impl List, Pair { query, anchor, offset, .. }: &Pair<'_>, between: &Vector3<f32>) {
    for guess in Guess::ALL {
        let (name, completed) = (name_of(guess), OutlineSource::Completed(guess));
        let (gap_m, normal) = separation(query, anchor, offset, completed);
        list.put_length(format_args!("plane.completed_by_{name}.gap"), gap_m, &[COARSE_M, FINE_M, FINEST_M]);
        list.put(format_args!("plane.completed_by_{name}.normal.z"), normal.z);
        let along = normal.dot(&Vector3::from(query.rim.line_of_sight));
        list.put(format_args!("plane.completed_by_{name}.normal_along_sight_of_query"), along);
        let completions =
            [("query", completed, OutlineSource::Restored), ("anchor", OutlineSource::Restored, completed), ("both", completed, completed)];
        for (which, ours, theirs) in completions {
            let gap_m = between.dot(offset) - query.reach(&-between, ours) - anchor.reach(between, theirs);
            list.put_length(format_args!("plane.restored.gap_with_{which}_completed_by_{name}"), gap_m, &[FINE_M, FINEST_M]);
        }
    }
}

/// How far the clouds are apart at the heights that both reach, and how much of their heights they share.
fn put_gaps_by_height(list: &mut impl List, Pair { query, anchor, offset, q, a, .. }: &Pair<'_>) {
    for outline in OUTLINES {
        let name = match outline {
            OutlineSource::Observed => "observed",
            OutlineSource::Restored => "restored",
            OutlineSource::Completed(Guess::Top) => "completed_by_top",
            OutlineSource::Completed(Guess::Rectangle) => "completed_by_rectangle",
            OutlineSource::Completed(Guess::Circle) => "completed_by_circle",
        };
        let (gap_m, normal) = outlines_apart(query, anchor, offset, outline);
        list.put_length(format_args!("bands.{name}.gap"), gap_m, &[FINE_M, FINEST_M]);
        let [x, y, _] = query.rim.line_of_sight;
        list.put(format_args!("bands.{name}.normal_along_sight_of_query"), normal.x * x + normal.y * y);
    }
    let circles = circles_apart(query, anchor, offset);
    list.put_length(format_args!("bands.circles.gap"), circles.gap_m, &[FINE_M, FINEST_M]);
    for (of, share) in ["query", "anchor"].iter().zip(circles.residuals) {
        list.put(format_args!("bands.circles.residual_of_{of}"), share);
    }
    let of_query = points_from_circle(query, anchor, &-offset);
    let of_anchor = points_from_circle(anchor, query, offset);
    for (of, (gap_m, residual, radius_m)) in [("query", of_query), ("anchor", of_anchor)] {
        list.put_length(format_args!("bands.circle_of_{of}.gap_to_points"), gap_m, &[FINE_M, FINEST_M]);
        list.put(format_args!("bands.circle_of_{of}.residual"), residual);
        list.put_length(format_args!("bands.circle_of_{of}.radius"), radius_m, &[COARSE_M]);
    }
    let shared_m = q.high.z.min(a.high.z) - q.low.z.max(a.low.z);
    list.put_length(format_args!("box.shared_height"), shared_m as f32, &[COARSE_M, FINE_M]);
}

/// How far the boxes are apart with what cleaning took put back on; upwards, either on the other.
fn put_restored_boxes(list: &mut impl List, Pair { query, anchor, q, a, .. }: &Pair<'_>) {
    for (k, axis) in AXES.iter().enumerate() {
        let beyond_m = query.beyond_along(k) + anchor.beyond_along(k);
        let (over_m, under_m) = ((q.low[k] - a.high[k]) as f32 - beyond_m, (a.low[k] - q.high[k]) as f32 - beyond_m);
        list.put_length(format_args!("box.restored.gap.{axis}"), over_m.max(under_m), &[FINE_M, FINEST_M]);
        if k == 2 {
            list.put_length(format_args!("box.restored.gap_with_query_above"), over_m, &[FINE_M, FINEST_M]);
            list.put_length(format_args!("box.restored.gap_with_query_below"), under_m, &[FINE_M, FINEST_M]);
        }
    }
}

/// Where the middles are relative to each other, seen from above, and what speaks for which guess.
fn put_middles(list: &mut impl List, Pair { query, anchor, offset_m, q, a, .. }: &Pair<'_>) {
    let between = |of: [[f32; 2]; 2]| [0, 1].map(|k| of[0][k] + offset_m[k] - of[1][k]);
    let (ours, theirs) = (&query.middles, &anchor.middles);
    let [x, y] = [0, 1].map(|k| (q.center[k] - a.center[k]) as f32);
    list.put_length(format_args!("middle.by_box.distance"), x.hypot(y), &[COARSE_M, FINE_M, FINEST_M]);
    list.put_length(format_args!("middle.by_box.x"), x, &[FINEST_M]);
    list.put_length(format_args!("middle.by_box.y"), y, &[FINEST_M]);
    for guess in Guess::ALL {
        let name = name_of(guess);
        let [x, y] = between([ours.by(guess), theirs.by(guess)]);
        list.put_length(format_args!("middle.by_{name}.distance"), x.hypot(y), &[FINE_M, FINEST_M]);
        list.put_length(format_args!("middle.by_{name}.x"), x, &[FINEST_M]);
        list.put_length(format_args!("middle.by_{name}.y"), y, &[FINEST_M]);
    }
    for (of, middles) in [("query", ours), ("anchor", theirs)] {
        list.put_length(format_args!("{of}.circle_residual"), middles.residual, &[FINEST_M]);
        list.put_length(format_args!("{of}.circle_radius"), middles.radius, &[COARSE_M]);
        list.put_length(format_args!("{of}.shorter_edge"), middles.edges[0], &[COARSE_M]);
        list.put_length(format_args!("{of}.longer_edge"), middles.edges[1], &[COARSE_M]);
    }
}

fn name_of(guess: Guess) -> &'static str {
    match guess {
        Guess::Top => "top",
        Guess::Rectangle => "rectangle",
        Guess::Circle => "circle",
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;
    use proptest::prelude::*;

    use super::*;
    use crate::points::{CloudConfig, ObjectCloud, Observer};

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
        let observer = Observer { eye: Point3::new(0.0, -1.0, 0.0), pixel_rad: rim_m };
        ObjectCloud::new(points, &observer, &config).unwrap()
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
    fn each_measure_has_a_name_of_its_own_and_a_single_point_has_them_all() {
        let names = pair_measure_names();
        assert_eq!(names.len(), PAIR_MEASURES);
        assert_eq!(names.iter().collect::<std::collections::BTreeSet<_>>().len(), PAIR_MEASURES, "{names:?}");
        assert_eq!((&*names[0], &*names[1], &*names[145]), ("margin.left_of/100mm", "margin.left_of/10mm", "anchor.longer_edge/100mm"));
        let cloud = cuboid([0.03, 0.04, 0.05], 0.3, 0.004);
        assert!(pair_measures(&MeasuredCloud::of_one_point(), &cloud, [0.0; 3]).iter().all(|m| m.is_finite()));
    }

    #[test]
    fn a_name_belongs_to_its_number() {
        let (query, anchor) = (cuboid([0.03, 0.04, 0.05], 0.0, 0.004), cuboid([0.05, 0.04, 0.02], 0.0, 0.002));
        let measures = pair_measures(&query, &anchor, [0.1, 0.0, 0.05]);
        let by_name = |name: &str| measures[pair_measure_names().iter().position(|n| n == name).unwrap()];
        assert!((by_name("box.query_size.z/100mm") - 1.0).abs() < 0.05);
        assert!((by_name("box.gap.x/10mm") - 2.0).abs() < 0.1);
        assert!((by_name("query.rim/10mm") - 0.4).abs() < 0.02 && (by_name("anchor.rim/10mm") - 0.2).abs() < 0.02);
    }
}
