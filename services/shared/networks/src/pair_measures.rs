//! What can be measured of a pair of observed clouds without learning, as inputs of the `measured` relation predictor.
//!
//! The paper's predictor sees two codes and has to find millimetres in them (`touching` and `centered` mean one). Beside the codes, the
//! `measured` variant reads the margins of the directional rules, how far the boxes and their centres are apart, and how far the clouds'
//! hulls are apart: the largest gap that a plane can be put into. Where two objects touch, the border cleaning has taken the points at the
//! contact from both, so the distance between points says little; a plane between them still fits, within millimetres.
//!
//! Each length is given more than once, in units from decimetres to millimetres and cut off, so that a small network can use all of them.

use std::sync::OnceLock;

use nalgebra::{Point3, Vector3};
use repose_relations::{ViewerExtents, directional::directional_margins};

use crate::points::ObjectCloud;

/// How many numbers [`pair_measures`] gives.
pub const PAIR_MEASURES: usize = 39;

/// Numbers are cut off at this many units.
const MOST_UNITS: f32 = 3.0;
/// The units, metres.
const COARSE_M: f32 = 0.1;
const FINE_M: f32 = 0.01;
const FINEST_M: f32 = 0.003;
/// Directions tried for the plane between two clouds before the best is refined: azimuths, and their elevations.
const AZIMUTHS: usize = 16;
const ELEVATIONS: [f32; 3] = [0.0, std::f32::consts::FRAC_PI_4, -std::f32::consts::FRAC_PI_4];
const DIRECTIONS: usize = AZIMUTHS * ELEVATIONS.len() + 2;
/// Hulls farther apart than this are far apart: their plane is not refined.
const REFINED_WITHIN_M: f32 = 0.06;
/// How far a direction is tilted when it is refined, radians, one size after another.
const TILTS_RAD: [f32; 5] = [0.2, 0.1, 0.05, 0.025, 0.012];
/// The share of points that a box leaves out at either end of each axis, as in the rules on observed clouds.
const STRAY_SHARE: f32 = 0.01;

/// A cloud prepared for measuring: once per object and turn.
#[derive(Debug, Clone)]
pub struct MeasuredCloud {
    /// Coordinates relative to the centroid, by axis.
    axes: [Vec<f32>; 3],
    /// The box without strays, relative to the centroid.
    low: [f32; 3],
    high: [f32; 3],
    /// How far the cloud reaches in each of [`directions`], from its centroid.
    reaches: [f32; DIRECTIONS],
}

impl MeasuredCloud {
    /// Prepares a cloud (already turned).
    pub fn new(object: &ObjectCloud) -> Self {
        let axes: [Vec<f32>; 3] = std::array::from_fn(|k| object.points.iter().map(|p| p[k]).collect());
        let stray = (STRAY_SHARE * object.points.len() as f32) as usize;
        let (mut low, mut high) = ([0.0; 3], [0.0; 3]);
        for (k, axis) in axes.iter().enumerate() {
            let mut sorted = axis.clone();
            sorted.sort_by(f32::total_cmp);
            if let (Some(first), Some(last)) = (sorted.get(stray), sorted.len().checked_sub(stray + 1).and_then(|i| sorted.get(i))) {
                (low[k], high[k]) = (*first, *last);
            }
        }
        let mut cloud = Self { axes, low, high, reaches: [0.0; DIRECTIONS] };
        cloud.reaches = std::array::from_fn(|d| cloud.reach(&directions()[d].0));
        cloud
    }

    /// How far the cloud reaches in a direction, from its centroid.
    fn reach(&self, direction: &Vector3<f32>) -> f32 {
        // Sixteen lanes keep the loop free of a single chain of comparisons.
        const LANES: usize = 16;
        let [x, y, z] = &self.axes;
        let mut best = [f32::NEG_INFINITY; LANES];
        let along = |i: usize| x[i] * direction.x + y[i] * direction.y + z[i] * direction.z;
        let whole = x.len() / LANES * LANES;
        for i in (0..whole).step_by(LANES) {
            for (l, best) in best.iter_mut().enumerate() {
                *best = best.max(along(i + l));
            }
        }
        (whole..x.len()).map(along).chain(best).fold(f32::NEG_INFINITY, f32::max)
    }

    fn extents(&self, at: [f32; 3]) -> ViewerExtents {
        let point = |corner: &[f32; 3]| Point3::from(std::array::from_fn::<f64, 3, _>(|k| f64::from(corner[k] + at[k])));
        let (low, high) = (point(&self.low), point(&self.high));
        ViewerExtents { low, high, center: nalgebra::center(&low, &high) }
    }
}

/// The directions tried first, each with the index of its opposite.
fn directions() -> &'static [(Vector3<f32>, usize); DIRECTIONS] {
    static ALL: OnceLock<[(Vector3<f32>, usize); DIRECTIONS]> = OnceLock::new();
    ALL.get_or_init(|| {
        let direction = |d: usize| match d.checked_sub(AZIMUTHS * ELEVATIONS.len()) {
            Some(up) => Vector3::z() * (1.0 - 2.0 * up as f32),
            None => {
                let (sin, cos) = (std::f32::consts::TAU * (d % AZIMUTHS) as f32 / AZIMUTHS as f32).sin_cos();
                let (rise, level) = ELEVATIONS[d / AZIMUTHS].sin_cos();
                Vector3::new(level * cos, level * sin, rise)
            }
        };
        let all: [Vector3<f32>; DIRECTIONS] = std::array::from_fn(direction);
        std::array::from_fn(|d| {
            let opposite = (0..DIRECTIONS).min_by(|a, b| all[*a].dot(&all[d]).total_cmp(&all[*b].dot(&all[d])));
            (all[d], opposite.unwrap_or(d))
        })
    })
}

/// The widest gap that a plane between the anchor's and the query's points can have, metres, negative when their hulls overlap (then minus
/// about the least way that parts them); and the plane's normal, towards the query.
fn separation(query: &MeasuredCloud, anchor: &MeasuredCloud, offset: &Vector3<f32>) -> (f32, Vector3<f32>) {
    let known =
        directions().iter().enumerate().map(|(d, (u, opposite))| (u.dot(offset) - query.reaches[*opposite] - anchor.reaches[d], *u));
    let widest = |best: (f32, Vector3<f32>), next: (f32, Vector3<f32>)| if next.0 > best.0 { next } else { best };
    let mut best = known.fold((f32::NEG_INFINITY, Vector3::z()), widest);
    if best.0 > REFINED_WITHIN_M {
        return best;
    }
    for tilt in TILTS_RAD {
        let (first, second) = across(&best.1);
        let tilted = [first, -first, second, -second].map(|t| (best.1 + t * tilt).normalize());
        best = tilted.into_iter().map(|u| (u.dot(offset) - query.reach(&-u) - anchor.reach(&u), u)).fold(best, widest);
    }
    best
}

/// Two directions across a direction and each other.
fn across(u: &Vector3<f32>) -> (Vector3<f32>, Vector3<f32>) {
    let other = if u.z.abs() < 0.9 { Vector3::z() } else { Vector3::x() };
    let first = u.cross(&other).normalize();
    (first, u.cross(&first))
}

/// The measures of a pair: `offset_m` is the query's centroid minus the anchor's, viewer's axes, metres.
pub fn pair_measures(query: &MeasuredCloud, anchor: &MeasuredCloud, offset_m: [f32; 3]) -> [f32; PAIR_MEASURES] {
    let (q, a) = (query.extents(offset_m), anchor.extents([0.0; 3]));
    let mut measures = [0.0; PAIR_MEASURES];
    let mut next = 0;
    let mut put = |value: f32| {
        measures[next] = value;
        next += 1;
    };
    let in_units = |length_m: f32, unit_m: f32| (length_m / unit_m).clamp(-MOST_UNITS, MOST_UNITS);
    for margin_m in directional_margins(&q, &a) {
        put(in_units(margin_m as f32, COARSE_M));
        put(in_units(margin_m as f32, FINE_M));
    }
    let between = (q.center - a.center).cast::<f32>();
    for k in 0..3 {
        put(in_units(between[k], COARSE_M));
        put(in_units(between[k], FINE_M));
        put(in_units((q.high[k] - q.low[k]) as f32, COARSE_M));
        put(in_units((a.high[k] - a.low[k]) as f32, COARSE_M));
        let apart_m = (q.low[k] - a.high[k]).max(a.low[k] - q.high[k]) as f32;
        put(in_units(apart_m, COARSE_M));
        put(in_units(apart_m, FINE_M));
    }
    let (gap_m, normal) = separation(query, anchor, &Vector3::from(offset_m));
    for unit_m in [COARSE_M, FINE_M, FINEST_M] {
        put(in_units(between.xy().norm(), unit_m));
        put(in_units(gap_m, unit_m));
    }
    normal.iter().for_each(|n| put(*n));
    debug_assert_eq!(next, PAIR_MEASURES);
    measures
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::points::CloudConfig;

    /// The surface of a box about its middle, turned about z.
    fn cuboid(half: [f32; 3], yaw_rad: f32) -> MeasuredCloud {
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
        let config = CloudConfig { voxel_m: 0.001, object_points: points.len(), ..CloudConfig::default() };
        MeasuredCloud::new(&ObjectCloud::new(&points, &config).unwrap().turned(yaw_rad))
    }

    proptest! {
        #[test]
        fn the_gap_between_boxes_face_to_face_is_found_whatever_way_they_are_turned(
            yaw_rad in -3.1..3.1f32, gap_m in -0.01..0.05f32, slide_m in -0.02..0.02f32,
        ) {
            let (query, anchor) = (cuboid([0.03, 0.04, 0.05], yaw_rad), cuboid([0.05, 0.04, 0.05], yaw_rad));
            let (sin, cos) = yaw_rad.sin_cos();
            let along = 0.08 + gap_m;
            let offset = Vector3::new(cos * along - sin * slide_m, sin * along + cos * slide_m, 0.0);
            let (found_m, normal) = separation(&query, &anchor, &offset);
            prop_assert!((found_m - gap_m).abs() < 0.002, "{} instead of {}", found_m, gap_m);
            prop_assert!(normal.dot(&Vector3::new(cos, sin, 0.0)) > 0.99 || gap_m < 0.002);
        }

        #[test]
        fn measures_are_finite_and_cut_off(offset in prop::array::uniform3(-2.0..2.0f32)) {
            let (query, anchor) = (cuboid([0.03, 0.04, 0.05], 0.3), cuboid([0.05, 0.04, 0.02], -0.8));
            let measures = pair_measures(&query, &anchor, offset);
            prop_assert!(measures.iter().all(|m| m.abs() <= MOST_UNITS));
        }
    }

    #[test]
    fn one_on_the_other_is_parted_by_a_level_plane() {
        let (query, anchor) = (cuboid([0.03, 0.04, 0.05], 0.3), cuboid([0.05, 0.04, 0.02], -0.8));
        let (gap_m, normal) = separation(&query, &anchor, &Vector3::new(0.01, 0.0, 0.072));
        assert!((gap_m - 0.002).abs() < 1e-4 && normal.z > 0.999, "{gap_m} {normal}");
    }

    #[test]
    fn every_direction_knows_its_opposite() {
        for (direction, opposite) in directions() {
            assert!((directions()[*opposite].0 + direction).norm() < 1e-5);
        }
    }
}
