//! The table of cases (`testdata/cases.toml`): boxes and what is said of them, judged as ground truth and as observed clouds.
//!
//! A cloud is sampled from the box's surface. Where the two must not agree the table says what is observed instead, and why.

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use repose_geometry::{OrientedBox, ViewerFrame};
use repose_relations::margins::{NEAR_M, index};
use repose_relations::{ObservedObject, RELATIONS, TrueBounds, ground_truth, observed};
use serde::Deserialize;

/// The contract's names, in the contract's order.
const NAMES: [&str; RELATIONS] =
    ["left_of", "right_of", "in_front_of", "behind", "above", "below", "near", "touching", "centered", "aligned"];
/// Spacing of the sampled points, metres.
const SPACING_M: f64 = 0.002;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Table {
    case: Vec<Case>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Case {
    name: String,
    query: BoxCase,
    anchor: BoxCase,
    #[serde(default)]
    viewer_yaw_deg: f64,
    gap_m: f64,
    holds: Vec<String>,
    observed: Option<Observed>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct BoxCase {
    center_m: [f64; 3],
    size_m: [f64; 3],
    #[serde(default)]
    yaw_deg: f64,
    /// Only the faces towards the viewer and the upper one have points.
    #[serde(default)]
    half_seen: bool,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Observed {
    holds: Vec<String>,
    why: String,
}

impl BoxCase {
    fn bounds(&self) -> OrientedBox {
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.yaw_deg.to_radians());
        let world_from_box = Isometry3::from_parts(Vector3::from(self.center_m).into(), rotation);
        OrientedBox { world_from_box, half_extents: Vector3::from(self.size_m) / 2.0 }
    }

    /// Points on the faces, in the world.
    fn cloud(&self, viewer: &ViewerFrame) -> Vec<Point3<f32>> {
        let bounds = self.bounds();
        let steps = self.size_m.map(|s| (s / SPACING_M).ceil() as usize);
        let mut points = Vec::new();
        for axis in 0..3 {
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            for side in [-1.0, 1.0] {
                let mut normal = Vector3::zeros();
                normal[axis] = side;
                let in_viewer = viewer.viewer_from_world() * (bounds.world_from_box.rotation * normal);
                if self.half_seen && in_viewer.z - in_viewer.y < 0.1 {
                    continue;
                }
                for (a, b) in (0..=steps[u]).flat_map(|a| (0..=steps[v]).map(move |b| (a, b))) {
                    let mut at = normal;
                    at[u] = 2.0 * a as f64 / steps[u] as f64 - 1.0;
                    at[v] = 2.0 * b as f64 / steps[v] as f64 - 1.0;
                    points.push((bounds.world_from_box * Point3::from(at.component_mul(&bounds.half_extents))).cast());
                }
            }
        }
        points
    }
}

fn names(holds: [bool; RELATIONS]) -> Vec<&'static str> {
    (0..RELATIONS).filter(|i| holds[*i]).map(|i| NAMES[i]).collect()
}

fn table() -> Table {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/testdata/cases.toml");
    toml::from_str(&std::fs::read_to_string(path).expect("the table")).expect("its format")
}

#[test]
fn ground_truth_says_what_the_table_says() {
    for case in table().case {
        let viewer = ViewerFrame::from_yaw(case.viewer_yaw_deg.to_radians());
        let [query, anchor] = [&case.query, &case.anchor].map(|b| TrueBounds { bounds: b.bounds() });
        assert_eq!(names(ground_truth(&query, &anchor, case.gap_m, &viewer)), case.holds, "{}", case.name);
    }
}

#[test]
fn observed_clouds_say_the_same_but_where_the_table_says_why_not() {
    for case in table().case {
        let viewer = ViewerFrame::from_yaw(case.viewer_yaw_deg.to_radians());
        let [query, anchor] = [&case.query, &case.anchor].map(|b| ObservedObject::new(&b.cloud(&viewer), &viewer).expect("points"));
        let found = names(observed(&query, &anchor));
        match &case.observed {
            None => assert_eq!(found, case.holds, "{}", case.name),
            Some(differs) => {
                assert_eq!(found, differs.holds, "{}: {}", case.name, differs.why);
                assert_ne!(found, case.holds, "{}: nothing differs, the entry is stale", case.name);
            }
        }
    }
}

#[test]
fn the_gaps_in_the_table_are_those_between_the_boxes() {
    for case in table().case.iter().filter(|c| !c.query.half_seen && !c.anchor.half_seen && c.gap_m > 0.0) {
        let viewer = ViewerFrame::from_yaw(0.0);
        let [query, anchor] = [&case.query, &case.anchor].map(|b| ObservedObject::new(&b.cloud(&viewer), &viewer).expect("points"));
        let found = query.distance_m(&anchor);
        if case.gap_m > NEAR_M + 0.009 {
            assert!(found > NEAR_M + 0.009, "{}: {found} m", case.name);
        } else {
            // Points face each other within half a diagonal of the sampling.
            let most = case.gap_m.hypot(SPACING_M);
            assert!(found > case.gap_m - 1e-4 && found < most + 1e-4, "{}: {found} m, said to be {}", case.name, case.gap_m);
        }
    }
}

#[test]
fn the_table_has_every_relation_and_every_pair_of_opposite_ones() {
    let cases = table().case;
    for (i, name) in NAMES.iter().enumerate() {
        assert!(cases.iter().any(|c| c.holds.iter().any(|h| h == name)), "{name} never holds");
        assert!(i == index::ALIGNED || cases.iter().any(|c| c.holds.iter().all(|h| h != name)), "{name} always holds");
    }
}
