//! Grasps on an object of which only one side was seen.
//!
//! Two sources propose poses of the grasp centre: [`top_down`] (over the top, in every direction across, at the rim of hollow things) and
//! [`antipodal`] (pairs of points whose normals oppose each other). [`gripper`] measures what the fingers would close on and refuses what the
//! hand would run into; what is left is scored, thinned to distinct grasps, and handed on best first.

pub mod antipodal;
mod choice;
pub mod contact;
pub mod gripper;
pub mod normals;
mod run;
pub mod score;
pub mod settings;
pub mod top_down;
pub mod wedge;

use nalgebra::{Isometry3, Point2, Point3, Vector2, Vector3};
use rand_pcg::Pcg64;
use repose_belief::ObservedView;
use repose_belief::far_side::far_side;
use repose_geometry::{Aabb, cloud};
use repose_panda::{GRIPPER_SPHERES, Link, LinkFrame, SPHERE_LINKS, gripper_spheres, kinematics::TCP_M};

use crate::collision::PALM_OUT_M;
use crate::obstacles::Obstacles;
use choice::Choice;
pub use score::GraspWeights;
use settings::GripperSettings;

/// A candidate grasp: the pose of the grasp centre, and the finger opening on approach.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GraspCandidate {
    /// Pose of the grasp centre: z is the approach, y the direction in which the fingers close.
    pub world_from_tcp: Isometry3<f64>,
    /// How far from there along y the open hand comes down, metres; it is then moved to where the fingers close. That is about the middle of the
    /// object: fingers that close beside it push it along, or lean it over, with the one that touches it first.
    pub aside_m: f64,
    /// Opening on approach, metres.
    pub opening_m: f64,
    /// How wide the object is between the fingers, metres; none when that is not known (external grasps).
    pub width_m: Option<f64>,
    /// Higher is better.
    pub score: f64,
}

impl GraspCandidate {
    /// The same grasp with the fingers exchanged: the hand turned by 180° about its approach.
    pub fn flipped(&self) -> Self {
        let turned = self.world_from_tcp * Isometry3::rotation(Vector3::z() * std::f64::consts::PI);
        Self { world_from_tcp: turned, aside_m: -self.aside_m, ..*self }
    }
}

/// How grasps are found and judged.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GraspSettings {
    /// What the fingers close on, and what they must not run into.
    pub gripper: GripperSettings,
    /// Voxel that the object's points are thinned to, metres. Default 0.004.
    pub voxel_m: f32,
    /// Directions across the object, over half a turn. Default 12.
    pub directions: usize,
    /// Tilts of the approach from the vertical, radians: each is tried to both sides. Default 0.4.
    pub tilt_rad: f64,
    /// Pairs of points drawn for antipodal grasps. Default 300.
    pub pairs: usize,
    /// Coefficient of friction between finger and object. Default 0.5.
    pub friction: f64,
    /// How far the approach may be from straight down, radians. Default 1.2.
    pub approach_max_rad: f64,
    /// How far the fingertips stay above what the object stands on, metres. Default 0.004.
    pub support_clearance_m: f64,
    /// What is added to the hand's spheres against the rest of the scene, metres. Default 0.005.
    pub padding_m: f64,
    /// Grasps handed on at most. Default 32.
    pub count: usize,
    /// Grasps nearer than this to a better one are dropped, metres (a radian of turn counts as 0.05 m). Default 0.01.
    pub separation_m: f64,
    /// What makes a grasp good.
    pub weights: GraspWeights,
}

impl Default for GraspSettings {
    fn default() -> Self {
        Self {
            gripper: GripperSettings::default(),
            voxel_m: 0.004,
            directions: 12,
            tilt_rad: 0.4,
            pairs: 300,
            friction: 0.5,
            approach_max_rad: 1.2,
            support_clearance_m: 0.004,
            padding_m: 0.005,
            count: 32,
            separation_m: 0.01,
            weights: GraspWeights::default(),
        }
    }
}

/// How many grasps were proposed, and why others were refused.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct GraspTally {
    /// Poses proposed.
    pub proposed: usize,
    /// Refused because nothing lay between the fingers.
    pub empty: usize,
    /// Refused because the object is too wide there.
    pub too_wide: usize,
    /// Refused because the surfaces under the fingers are at a slant that friction does not bridge.
    pub slanted: usize,
    /// Refused because a finger or the palm would run into the object.
    pub object_in_the_way: usize,
    /// Refused because the hand would touch something else.
    pub scene_in_the_way: usize,
}

/// The object's point cloud as the grasp samplers use it.
#[derive(Debug, Clone)]
pub struct GraspCloud {
    /// Thinned observed points, world frame.
    pub points: Vec<Point3<f32>>,
    /// Unit surface normal at each, towards the side from which it was seen.
    pub normals: Vec<Vector3<f32>>,
    /// Its upright axis, seen from above.
    pub axis: Vector2<f64>,
    /// What is believed of its far side, hidden from the camera: no finger comes down there. Empty where guesses are not heeded.
    pub behind: Vec<Point3<f32>>,
    /// The smallest axis-aligned box around the points.
    pub bounds: Aabb,
    /// The height of its middle, between what it stands on and its top, world z, metres.
    pub middle_m: f64,
    /// The lowest the grasp centre may go, world z, metres.
    pub floor_m: f64,
}

/// The object and what is around it. All in the world frame.
#[derive(Debug, Clone, Copy)]
pub struct GraspScene<'a> {
    /// The object's observed points.
    pub points: &'a [Point3<f32>],
    /// The height of what it stands on, metres.
    pub support_m: f64,
    /// Its believed upright axis, seen from above; none: the middle of what was seen.
    pub axis: Option<Point2<f32>>,
    /// What the camera saw.
    pub view: &'a ObservedView,
    /// The rest of the scene.
    pub others: &'a Obstacles,
    /// Whether the object is believed to have a far side like its near one.
    pub believes: bool,
}

/// Distinct grasps on the object, best first, with the tally of what was refused.
pub fn grasps(scene: &GraspScene<'_>, settings: &GraspSettings, rng: &mut Pcg64) -> (Vec<GraspCandidate>, GraspTally) {
    let mut tally = GraspTally::default();
    let thinned = cloud::voxel_downsampled(scene.points, settings.voxel_m);
    let Some(bounds) = Aabb::of(&thinned) else { return (Vec::new(), tally) };
    let normals = normals::estimated(&thinned, 3.0 * settings.voxel_m, &scene.view.eye());
    let floor_m = scene.support_m + gripper::TIP_BEYOND_TCP_M + settings.support_clearance_m;
    let middle_m = 0.5 * (scene.support_m + f64::from(bounds.max.z));
    let axis = scene.axis.unwrap_or_else(|| bounds.center().xy());
    let behind = match scene.believes {
        true => far_side(&thinned, &axis).into_iter().filter(|p| !scene.view.is_free(p)).collect(),
        false => Vec::new(),
    };
    let object = GraspCloud { points: thinned, normals, axis: axis.coords.cast(), behind, bounds, middle_m, floor_m };

    let mut proposals = top_down::proposals(&object, settings);
    proposals.extend(antipodal::proposals(&object, settings, rng));
    tally.proposed = proposals.len();
    let found = Choice { proposals: &proposals, object: &object, scene, settings }.best(&mut tally);
    (found, tally)
}

/// Whether hand or fingers, fingers `opening_m` apart, touch `obstacles`.
pub fn gripper_touches(world_from_tcp: &Isometry3<f64>, opening_m: f64, obstacles: &Obstacles, padding_m: f64) -> bool {
    let world_from_hand = world_from_tcp * Isometry3::translation(0.0, 0.0, -TCP_M);
    let spheres = gripper_spheres(&LinkFrame::of(&world_from_hand), opening_m);
    spheres.iter().zip(&SPHERE_LINKS[GRIPPER_SPHERES]).any(|(sphere, link)| {
        let out_m = if *link == Link::Hand { PALM_OUT_M } else { 0.0 };
        obstacles.touches(&sphere.center, sphere.radius_m + padding_m + out_m)
    })
}

/// A pose of the grasp centre from its place, its approach and the direction in which the fingers close (made square to the approach).
///
/// `None` when the two directions are nearly parallel.
pub(crate) fn pose(place: &Point3<f64>, approach: &Vector3<f64>, closing: &Vector3<f64>) -> Option<Isometry3<f64>> {
    let z = approach.try_normalize(1e-9)?;
    let y = (closing - z * closing.dot(&z)).try_normalize(1e-6)?;
    let rotation = nalgebra::Rotation3::from_matrix_unchecked(nalgebra::Matrix3::from_columns(&[y.cross(&z), y, z]));
    Some(Isometry3::from_parts(place.coords.into(), nalgebra::UnitQuaternion::from_rotation_matrix(&rotation)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{obstacles::ObstacleSettings, synthetic};
    use rand::SeedableRng;

    fn find(points: &[Point3<f32>], others: &[Point3<f32>]) -> (Vec<GraspCandidate>, GraspTally) {
        let seen = synthetic::scene_of(&[(0, synthetic::table_points()), (1, points.to_vec()), (0, others.to_vec())]);
        let others = Obstacles::new(others, &[synthetic::table()], &ObstacleSettings::default());
        let axis = seen.belief.objects[&1].shape.as_ref().map(|shape| shape.axis);
        let scene = GraspScene { points, support_m: 0.0, axis, view: &seen.belief.view, others: &others, believes: true };
        grasps(&scene, &GraspSettings::default(), &mut Pcg64::seed_from_u64(5))
    }

    #[test]
    fn a_box_is_grasped_across_its_narrow_side() {
        let points = synthetic::seen_box([0.5, 0.1], [0.12, 0.05, 0.10], 0.4);
        let (found, tally) = find(&points, &[]);
        assert!(!found.is_empty(), "{tally:?}");
        let closing = found[0].world_from_tcp.rotation * Vector3::y();
        let narrow = Vector3::new(-(0.4f64.sin()), 0.4f64.cos(), 0.0);
        assert!(closing.dot(&narrow).abs() > 0.95, "{closing}");
        assert!((found[0].width_m.unwrap() - 0.05).abs() < 0.012, "{:?}", found[0].width_m);
        assert!(found.windows(2).all(|w| w[0].score >= w[1].score));
    }

    /// What the camera sees of a bottle that stands on the table: its near side, and its cap from above.
    fn seen_bottle(at: [f64; 2]) -> Vec<Point3<f32>> {
        let towards = (synthetic::CAMERA.y - at[1]).atan2(synthetic::CAMERA.x - at[0]);
        let radius_m = |z: f64| 0.034 - 0.021 * ((z - 0.10) / 0.03).clamp(0.0, 1.0);
        let ring = |z: f64, radius_m: f64, half_rad: f64| {
            (-20..=20).map(move |k| {
                let angle = towards + half_rad * f64::from(k) / 20.0;
                Point3::new(at[0] + radius_m * angle.cos(), at[1] + radius_m * angle.sin(), z).cast::<f32>()
            })
        };
        let side = (2..57).flat_map(|k| ring(0.003 * f64::from(k), radius_m(0.003 * f64::from(k)), 1.2));
        let cap = (1..=4).flat_map(|k| ring(0.17, 0.003 * f64::from(k), std::f64::consts::PI));
        side.chain(cap).collect()
    }

    #[test]
    fn a_bottle_is_grasped_at_its_axis_and_not_at_the_middle_of_what_is_seen_of_it() {
        for at in [[0.5, 0.0], [0.45, 0.2], [0.6, -0.15]] {
            let points = seen_bottle(at);
            let (found, tally) = find(&points, &[]);
            assert!(!found.is_empty(), "{tally:?}");
            let aside_m = (found[0].world_from_tcp.translation.vector.xy() - Vector2::from(at)).norm();
            assert!(aside_m < 0.01, "{aside_m} at {at:?}");
        }
    }

    #[test]
    fn no_finger_comes_down_on_the_far_side_that_the_camera_did_not_see() {
        let (at, radius_m, height_m) = ([0.5, 0.1], 0.03, 0.08);
        let seen: Vec<Point3<f32>> = synthetic::seen_bowl(at, radius_m, height_m)
            .into_iter()
            .filter(|p| p.z > 0.074 || f64::from(p.x) > at[0] + 0.3 * radius_m)
            .collect();
        let (found, tally) = find(&seen, &[]);
        assert!(!found.is_empty(), "{tally:?}");
        let open = found.iter().filter(|g| g.opening_m > 2.0 * radius_m);
        // Where they come down, and where they close.
        for (grasp, aside_m) in open.flat_map(|g| [(g, 0.0), (g, g.aside_m)]) {
            let tcp_from_world = (grasp.world_from_tcp * Isometry3::translation(0.0, aside_m, 0.0)).inverse();
            let in_finger = |k: i32| {
                let angle = std::f64::consts::TAU * f64::from(k) / 90.0;
                let p = tcp_from_world * Point3::new(at[0] + radius_m * angle.cos(), at[1] + radius_m * angle.sin(), height_m - 0.02);
                p.x.abs() < 0.008 && p.z > -0.04 && p.z < 0.012 && (0.002..0.018).contains(&(p.y.abs() - 0.5 * grasp.opening_m))
            };
            assert!((0..90).filter(|k| in_finger(*k)).count() <= 2, "{grasp:?}");
        }
    }

    #[test]
    fn a_bowl_that_is_too_wide_is_grasped_at_its_rim() {
        let points = synthetic::seen_bowl([0.5, 0.0], 0.07, 0.06);
        let (found, tally) = find(&points, &[]);
        assert!(!found.is_empty(), "{tally:?}");
        for grasp in &found {
            let from_axis = (grasp.world_from_tcp.translation.vector.xy() - Vector2::new(0.5, 0.0)).norm();
            let (wall_m, width_m) = ((from_axis - 0.07).abs(), grasp.width_m.unwrap_or(1.0));
            assert!(wall_m < 0.5 * width_m + 0.005 && width_m < 0.03, "they close about the wall, not across: {wall_m} {width_m}");
        }
        // A finger that comes down unseen gets all the room there is, before both are moved to the wall.
        assert!(found.iter().any(|grasp| grasp.aside_m.abs() > 0.02), "the bowl's far wall hides what is behind it");
    }

    /// What the camera sees of a bowl on the table whose wall of 4 mm narrows to two thirds downwards: the outside in front, the inside at the back, the
    /// floor inside.
    fn seen_narrowing_bowl(at: [f64; 2], rim_m: f64, height_m: f64) -> Vec<Point3<f32>> {
        const WALL_M: f64 = 0.004;
        let around = (std::f64::consts::TAU * rim_m / 0.003) as i32;
        let ring = |z: f64, radius_m: f64, shows: fn(f64) -> bool| {
            let angles = (0..around).map(move |k| std::f64::consts::TAU * f64::from(k) / f64::from(around));
            // The camera is in the direction of +x.
            angles
                .filter(move |angle| shows(angle.cos()))
                .map(move |angle| Point3::new(at[0] + radius_m * angle.cos(), at[1] + radius_m * angle.sin(), z).cast::<f32>())
        };
        let outside_m = move |z: f64| rim_m * (2.0 + z / height_m) / 3.0;
        let levels = move || (2..=(height_m / 0.003) as i32).map(|k| 0.003 * f64::from(k));
        let outside = levels().flat_map(move |z| ring(z, outside_m(z), |towards| towards > 0.0));
        let inside = levels().flat_map(move |z| ring(z, outside_m(z) - WALL_M, |towards| towards < 0.0));
        let rim = ring(height_m, rim_m, |_| true).chain(ring(height_m, rim_m - WALL_M, |_| true));
        outside.chain(inside).chain(rim).collect()
    }

    #[test]
    fn no_more_of_a_bowl_is_between_the_fingers_than_they_are_believed_to_close_on() {
        let height_m = 0.045;
        let mut across = 0;
        for (rim_m, at) in [0.028, 0.033, 0.036, 0.039, 0.045].into_iter().flat_map(|r| [[0.5, 0.0], [0.45, 0.2]].map(|at| (r, at))) {
            let (found, tally) = find(&seen_narrowing_bowl(at, rim_m, height_m), &[]);
            assert!(!found.is_empty(), "{tally:?} at {rim_m}");
            for grasp in &found {
                let tcp_from_world = grasp.world_from_tcp.inverse();
                let rim = (0..180).map(|k| std::f64::consts::TAU * f64::from(k) / 180.0);
                let (low, high) = rim
                    .map(|angle| tcp_from_world * Point3::new(at[0] + rim_m * angle.cos(), at[1] + rim_m * angle.sin(), height_m))
                    .filter(|p| p.x.abs() < 0.0105 && p.y.abs() < 0.5 * grasp.opening_m)
                    .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), p| (low.min(p.y), high.max(p.y)));
                let width_m = grasp.width_m.expect("found here");
                assert!(high - low < width_m + 0.01, "{} mm between the fingers: {grasp:?}", 1e3 * (high - low));
                across += usize::from(width_m > rim_m);
            }
        }
        assert!(across > 0, "those that go between the fingers are taken across");
    }

    /// What the camera sees of a cylinder that lies on the table across its view.
    fn seen_lying(at: [f64; 2], radius_m: f64, half_length_m: f64) -> Vec<Point3<f32>> {
        let ring = |angle: f64| {
            let (outwards, along) = (Vector3::new(angle.cos(), 0.0, angle.sin()), (half_length_m / 0.003) as i32);
            let middle = Point3::new(at[0], at[1], radius_m) + outwards * radius_m;
            let is_seen = outwards.dot(&(synthetic::CAMERA - middle)) > 0.0;
            (-along..=along).filter(move |_| is_seen).map(move |k| (middle + Vector3::y() * (0.003 * f64::from(k))).cast::<f32>())
        };
        (0..180).flat_map(|k| ring(std::f64::consts::TAU * f64::from(k) / 180.0)).collect()
    }

    #[test]
    fn a_cylinder_is_hardly_worth_pinching_above_its_middle_where_it_would_be_squeezed_out_downwards() {
        let best = |radius_m: f64| {
            let (found, _) = find(&seen_lying([0.5, 0.0], radius_m, 0.08), &[]);
            let across = |grasp: &&GraspCandidate| (grasp.world_from_tcp.rotation * Vector3::y()).x.abs() > 0.9;
            found.iter().find(across).map_or(0.0, |grasp| grasp.score)
        };
        let (between, pinched) = (best(0.025), best(0.038));
        assert!(between > 0.3, "one that goes between the fingers: {between}");
        assert!(pinched < 0.1 * between, "one that is only reached above its middle: {pinched}");
    }

    #[test]
    fn a_box_that_is_too_wide_everywhere_has_no_grasp() {
        let (found, tally) = find(&synthetic::seen_box([0.5, 0.0], [0.2, 0.2, 0.2], 0.0), &[]);
        assert!(found.is_empty() && tally.proposed > 0, "{} {tally:?}", found.len());
    }

    #[test]
    fn a_neighbour_takes_away_the_grasps_that_would_touch_it() {
        let points = synthetic::seen_box([0.5, 0.0], [0.05, 0.05, 0.1], 0.0);
        let neighbour = synthetic::seen_box([0.5, 0.065], [0.05, 0.05, 0.2], 0.0);
        let (free, _) = find(&points, &[]);
        let (found, tally) = find(&points, &neighbour);
        assert!(tally.scene_in_the_way > 0 && !found.is_empty() && !free.is_empty());
        let closing = found[0].world_from_tcp.rotation * Vector3::y();
        assert!(closing.x.abs() > 0.8, "the finger does not go between the two: {closing}");
    }
}
