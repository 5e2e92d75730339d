//! How a finger's pad touches the surface on its side: how much of it, how squarely, and how much it faces the hand.
//!
//! Friction holds what is squeezed only while the surface faces the hand by less than friction bridges. Where a side faces the camera its normals
//! tell; where it is seen edge on, as the sides of most things are, its outline does. All in the grasp centre's frame.

use nalgebra::{Isometry3, Vector3};

use super::GraspCloud;

/// A point of the cloud in the grasp centre's frame, and its index.
pub type SlabPoint = (Vector3<f64>, usize);

/// How far from the outermost point of a side the finger's pad touches it, metres: the noise of depth, and what gives way.
const TOUCHED_M: f64 = 0.004;

/// How much of the surface on one side lies along the approach where a flat pad would touch it, metres: much on a wall, little on a shoulder
/// or a rounded edge, down which the fingers slide.
pub fn contact_depth_m(run: &[SlabPoint], extreme: f64) -> f64 {
    let touched = run.iter().filter(|(p, _)| (p.y - extreme).abs() < TOUCHED_M).map(|(p, _)| p.z);
    let (nearest, farthest) = touched.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), z| (a.min(z), b.max(z)));
    (farthest - nearest).max(0.0)
}

/// What a side counts whose surface was not seen.
const UNSEEN: f64 = 0.7;

/// The outward normals in the grasp centre's frame, y along `side`, of what was seen within 6 mm of an extreme: those that lie more along the closing
/// direction than across it.
pub fn touched_normals(
    run: &[SlabPoint],
    extreme: f64,
    side: f64,
    world_from_tcp: &Isometry3<f64>,
    object: &GraspCloud,
) -> Vec<Vector3<f64>> {
    let tcp_from_world = world_from_tcp.rotation.inverse();
    let normal = |i: &usize| tcp_from_world * object.normals[*i].cast::<f64>();
    let touched = run.iter().filter(|(p, _)| (p.y - extreme).abs() < 0.006).map(|(_, i)| normal(i));
    let outwards = touched.map(|n| if n.y * side < 0.0 { -n } else { n }).map(|n| Vector3::new(n.x, n.y * side, n.z));
    outwards.filter(|n| n.y > 0.5).collect()
}

/// Mean `|n · y|` of both sides; one on which no such surface was seen counts as one that lies across.
pub fn squareness(sides: &[Vec<Vector3<f64>>; 2]) -> f64 {
    let mean = |normals: &Vec<Vector3<f64>>| match normals.len() {
        0 => UNSEEN,
        count => normals.iter().map(|n| n.y).sum::<f64>() / count as f64,
    };
    0.5 * (mean(&sides[0]) + mean(&sides[1]))
}

/// How much a side faces the hand by its normals; `None` where none was seen.
pub fn slope_rad(side: &[Vector3<f64>]) -> Option<f64> {
    (!side.is_empty()).then(|| side.iter().map(|n| (-n.z).atan2(n.y)).sum::<f64>() / side.len() as f64)
}

/// Height of the slices of an outline, metres.
const SLICE_M: f64 = 0.004;

/// How much a side that is seen edge on faces the hand, by its outline: a line through how far it reaches out in slices along the approach,
/// where a pad touches it. `None` where one slice only reaches that far.
pub fn outline_slope_rad(run: &[SlabPoint], extreme: f64, side: f64) -> Option<f64> {
    let (nearest, farthest) = run.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), (p, _)| (a.min(p.z), b.max(p.z)));
    let slice_of = |z: f64| ((z - nearest) / SLICE_M) as usize;
    let mut outermost = vec![(0.0, f64::NEG_INFINITY); slice_of(farthest) + 1];
    for (p, _) in run {
        let place = &mut outermost[slice_of(p.z)];
        if side * p.y > place.1 {
            *place = (p.z, side * p.y);
        }
    }
    let touched: Vec<(f64, f64)> = outermost.into_iter().filter(|(_, reach_m)| *reach_m > side * extreme - TOUCHED_M).collect();
    let count = touched.len() as f64;
    let (mean_z, mean_y) = (touched.iter().map(|t| t.0).sum::<f64>() / count, touched.iter().map(|t| t.1).sum::<f64>() / count);
    let spread: f64 = touched.iter().map(|(z, _)| (z - mean_z).powi(2)).sum();
    let rise: f64 = touched.iter().map(|(z, y)| (z - mean_z) * (y - mean_y)).sum();
    (touched.len() > 1).then(|| (rise / spread).atan())
}

/// How much both sides together face the hand.
pub fn mean_slope_rad(slopes: [Option<f64>; 2], is_hollow: bool) -> f64 {
    match slopes {
        [Some(one), Some(other)] => 0.5 * (one + other),
        [Some(one), None] | [None, Some(one)] if !is_hollow => one,
        _ => 0.0,
    }
}

/// How far the pads turn a wall between them to lie flat against it, radians: how much it slopes along the approach, by the mean of its normals on
/// whichever side they were seen. What lies across more than along the closing direction is no wall, but the ground beside it or the rim's top.
pub fn wall_turn_rad(run: &[SlabPoint], world_from_tcp: &Isometry3<f64>, object: &GraspCloud) -> f64 {
    const ACROSS: f64 = 0.25;
    let tcp_from_world = world_from_tcp.rotation.inverse();
    let normals = run.iter().map(|(_, i)| tcp_from_world * object.normals[*i].cast::<f64>()).filter(|n| n.y.abs() > ACROSS);
    let (sum, count) = normals.fold((0.0, 0.0), |(sum, count), n| (sum + n.y.signum() * (-n.z).atan2(n.y.abs()), count + 1.0));
    if count > 0.0 { (sum / count).abs() } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The heights of the places looked at along the approach, metres.
    const FROM_M: f64 = -0.045;

    /// What lies between the pads of something whose half width is given by the place along the approach.
    fn run_of(half_m: impl Fn(f64) -> f64) -> Vec<SlabPoint> {
        let places = (0..29).map(|k| FROM_M + 0.002 * f64::from(k));
        places.flat_map(|z| [-1.0, -0.5, 0.5, 1.0].map(|share| (Vector3::new(0.0, share * half_m(z), z), 0))).collect()
    }

    #[test]
    fn the_outline_of_a_side_seen_edge_on_tells_how_much_it_faces_the_hand() {
        let slope = |half_m: &dyn Fn(f64) -> f64| {
            let run = run_of(half_m);
            let extreme = run.iter().map(|(p, _)| p.y).fold(0.0, f64::max);
            [1.0, -1.0].map(|side| outline_slope_rad(&run, side * extreme, side).expect("it is touched at some height"))
        };
        for (expected, slopes) in
            [(0.0, slope(&|_| 0.02)), (0.5, slope(&|z| 0.03 + 0.5f64.tan() * z)), (-0.4, slope(&|z| 0.03 - 0.4f64.tan() * z))]
        {
            assert!(slopes.iter().all(|s| (s - expected).abs() < 0.05), "{slopes:?} for {expected}");
        }
        // A neck that widens to a shoulder at the tips is pressed on at the shoulder.
        let shoulder = slope(&|z| 0.015 + (z - 0.005).max(0.0) * 1.5);
        assert!(shoulder.iter().all(|s| *s > 0.5), "{shoulder:?}");
        assert_eq!(outline_slope_rad(&run_of(|z| if z > 0.01 { 0.03 } else { 0.01 })[112..], 0.03, 1.0), None, "an edge has no slope");
    }

    #[test]
    fn a_wall_is_turned_by_its_slope_whichever_side_of_it_was_seen() {
        let tcp = crate::grasp::pose(&nalgebra::Point3::new(0.08, 0.0, 0.02), &-Vector3::z(), &Vector3::x()).expect("a pose");
        let turn = |normals: Vec<Vector3<f32>>| {
            let run: Vec<SlabPoint> = (0..normals.len()).map(|i| (Vector3::zeros(), i)).collect();
            let points = vec![nalgebra::Point3::origin(); normals.len()];
            let bounds = repose_geometry::Aabb::of(&points).expect("it has points");
            let (axis, behind) = (nalgebra::Vector2::zeros(), Vec::new());
            wall_turn_rad(&run, &tcp, &GraspCloud { points, normals, axis, behind, bounds, middle_m: 0.0, floor_m: 0.0 })
        };
        for slope in [0.0_f32, 0.3, 0.9] {
            let (inside, outside) = (Vector3::new(-slope.cos(), 0.0, slope.sin()), Vector3::new(slope.cos(), 0.0, -slope.sin()));
            for seen in [vec![inside; 4], vec![outside; 4], vec![inside, outside], vec![inside, Vector3::z()]] {
                assert!((turn(seen) - f64::from(slope)).abs() < 1e-6, "{slope}");
            }
        }
        let cone = vec![Vector3::new(0.8, 0.0, 0.6), Vector3::new(-0.8, 0.0, 0.6)];
        assert!(turn(cone) < 1e-6, "both sides of a cone face the hand, and it is not turned");
    }

    #[test]
    fn surfaces_that_face_the_hand_on_one_side_only_are_taken_for_alike_unless_they_are_a_wall() {
        assert_eq!(mean_slope_rad([Some(0.4), Some(-0.2)], false), 0.1);
        assert_eq!(mean_slope_rad([None, Some(0.4)], false), 0.4);
        assert_eq!(mean_slope_rad([None, Some(0.4)], true), 0.0);
        assert_eq!(mean_slope_rad([None, None], false), 0.0);
    }
}
