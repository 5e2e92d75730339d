//! Bringing an arm back from where a stop has left it: backing off along the fingers, and going to the ready pose. Slow, and without anything in
//! the hand.
//!
//! The arm may stand in contact: its fingers around what they have let go of, a link against something. So what touches at the start may go on
//! touching until it is free, and nothing else may begin to. Where no scene is known only the arm itself and the keep-out zones are in the way.

use nalgebra::{Isometry3, Point3};
use rand::SeedableRng;
use rand_pcg::Pcg64;
use repose_panda::{
    InverseSettings, JOINT_COUNT, Joints, Link, LinkFrame, LinkFrames, PlacedSphere, READY, SPHERE_COUNT, SPHERE_LINKS, base_from_tcp,
    inverse_near, self_collides, spheres_in_base, visible_spheres_in_base,
};

use crate::collision::{ArmCollisionSettings, CollisionChecker, Contact};
use crate::obstacles::{ObstacleSettings, ObstacleShape, Obstacles};
use crate::path::rrt_connect::{RrtSettings, rrt_connect};
use crate::path::simplify::{SimplifySettings, simplified};
use crate::path::timed::timed;
use crate::path::timing::{TimingSettings, Trajectory};
use crate::pick_place::settings::PickPlaceSettings;
use crate::scene::ArmSurroundings;

/// How an arm is brought back.
#[derive(Debug, Clone, PartialEq)]
pub struct RecoverySettings {
    /// Where the robot stands.
    pub world_from_base: Isometry3<f64>,
    /// What no part of the arm may enter, whether or not a scene is known.
    pub keep_out: Vec<ObstacleShape>,
    /// What stands beside the robot and is in no scene: other robots.
    pub beside: Vec<ObstacleShape>,
    /// The obstacles' resolution.
    pub obstacles: ObstacleSettings,
    /// What is added to the robot's spheres, metres.
    pub padding_m: f64,
    /// How fast the arm moves.
    pub timing: TimingSettings,
    /// The joint angles of hand poses.
    pub inverse: InverseSettings,
    /// How far the hand backs off at most, metres. Default 0.10, the standoff of a grasp.
    pub retreat_m: f64,
    /// Less than this is no retreat, metres. Default 0.02: the depth of a grasp.
    pub least_m: f64,
    /// Scene points this near to the arm as it stands are taken for the arm itself, metres. Default 0.02: noise of depth and calibration.
    pub self_m: f64,
    /// The search for the way home.
    pub rrt: RrtSettings,
    /// The shortening of that way.
    pub simplify: SimplifySettings,
}

impl RecoverySettings {
    /// As for planning, at a share of its speed and acceleration.
    pub fn of(planning: &PickPlaceSettings, share: f64) -> Self {
        Self {
            world_from_base: planning.world_from_base,
            keep_out: planning.keep_out.clone(),
            beside: planning.beside.clone(),
            obstacles: planning.obstacles,
            padding_m: planning.padding_m,
            timing: TimingSettings { deviation_rad: 0.002, ..planning.timing.slowed(share) },
            // What planning keeps off the limits keeps nobody from having stopped the arm, or moved it by hand, nearer to them.
            inverse: InverseSettings { limit_margin_rad: 0.0, ..planning.reach.inverse },
            retreat_m: planning.reach.standoff_m,
            least_m: 0.02,
            self_m: 0.02,
            rrt: planning.rrt,
            simplify: planning.simplify,
        }
    }
}

/// Why an arm cannot be brought back by itself.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RecoveryError {
    /// The hand cannot back off.
    #[error("the hand cannot back off by more than {0:.3} m: {1}; open the fingers first, or move the arm by hand")]
    NoRetreat(f64, Stuck),
    /// The arm stands in contact.
    #[error("the arm cannot go home from where it stands: {0}; `repose robot retreat` first, or move the arm by hand")]
    StartBlocked(Contact),
    /// The ready pose is taken.
    #[error("the ready pose is not free: {0}; clear it, or move the arm by hand")]
    HomeBlocked(Contact),
    /// There is no way.
    #[error("no free way home was found; clear the table, or move the arm by hand")]
    NoWay,
}

/// What keeps the hand from backing off further.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Stuck {
    /// No joint angles.
    #[error("it is out of reach there")]
    Unreachable,
    /// Something is in the way.
    #[error("{0}")]
    Contact(Contact),
}

/// Step of the hand, metres: a fraction of the smallest sphere.
const STEP_M: f64 = 0.005;
/// Largest change of a joint over one step, radians; more is a jump to another branch.
const JUMP_RAD: f64 = 0.1;

/// Brings one arm back.
#[derive(Debug)]
pub struct Recovery<'a> {
    settings: &'a RecoverySettings,
    start: Joints,
    finger_opening_m: f64,
    obstacles: Obstacles,
}

impl<'a> Recovery<'a> {
    /// From where the arm stands, its fingers so far apart, in a scene where one is known.
    pub fn new(start: &Joints, finger_opening_m: f64, scene: Option<&ArmSurroundings>, settings: &'a RecoverySettings) -> Self {
        let mut recovery = Self { settings, start: *start, finger_opening_m, obstacles: Obstacles::solids(Vec::new()) };
        if let Some(scene) = scene {
            // As perception knows it.
            let arm = visible_spheres_in_base(&LinkFrames::at(start), finger_opening_m);
            let arm = arm.map(|s| PlacedSphere { center: settings.world_from_base * s.center, ..s });
            let is_arm = |p: &Point3<f32>| arm.iter().any(|s| (s.center - p.cast::<f64>()).norm() < s.radius_m + settings.self_m);
            let points: Vec<Point3<f32>> = scene.points.iter().filter(|p| !is_arm(p)).copied().collect();
            recovery.obstacles = Obstacles::new(&points, &scene.surfaces, &settings.obstacles);
        }
        recovery.obstacles = recovery.obstacles.with_solids(&settings.beside).with_keep_out(&settings.keep_out);
        recovery
    }

    /// The way back along the fingers, as far as it is free, and how far that is, metres.
    ///
    /// # Errors
    /// [`RecoveryError::NoRetreat`].
    pub fn retreat(&self) -> Result<(Trajectory, f64), RecoveryError> {
        let base_from_start = base_from_tcp(&self.start);
        let (mut way, mut exempt, mut stuck) = (vec![self.start], self.touching(&self.start), Stuck::Unreachable);
        for k in 1..=(self.settings.retreat_m / STEP_M).round() as usize {
            let back = base_from_start * Isometry3::translation(0.0, 0.0, -STEP_M * k as f64);
            match self.step(&way[way.len() - 1], &back, &mut exempt) {
                Ok(next) => way.push(next),
                Err(why) => {
                    stuck = why;
                    break;
                }
            }
        }
        let retreated_m = STEP_M * (way.len() - 1) as f64;
        let trajectory = (retreated_m >= self.settings.least_m).then(|| Trajectory::new(&way, &self.settings.timing)).flatten();
        trajectory.map(|trajectory| (trajectory, retreated_m)).ok_or(RecoveryError::NoRetreat(retreated_m, stuck))
    }

    /// The next posture of the retreat.
    fn step(&self, last: &Joints, base_from_tcp: &Isometry3<f64>, exempt: &mut [bool; SPHERE_COUNT]) -> Result<Joints, Stuck> {
        let inverse = self.inverse_from(last);
        let next = inverse_near(base_from_tcp, last, &inverse).map_err(|_| Stuck::Unreachable)?;
        if (0..JOINT_COUNT).any(|i| (next[i] - last[i]).abs() > JUMP_RAD) {
            return Err(Stuck::Unreachable);
        }
        if let Some(joint) = inverse.limits.outside(&next, 0.0) {
            return Err(Stuck::Contact(Contact::Limits(joint)));
        }
        let touching = self.touching(&next);
        for (i, touches) in touching.into_iter().enumerate() {
            if touches && !exempt[i] {
                return Err(Stuck::Contact(self.contact(&next, i)));
            }
            exempt[i] &= touches;
        }
        if self_collides(&spheres_in_base(&LinkFrames::at(&next), self.finger_opening_m)) {
            return Err(Stuck::Contact(Contact::Itself));
        }
        Ok(next)
    }

    /// Where the arm may go on to: within what planning keeps to, and where it has been stopped, or moved by hand, beyond that, back from there.
    fn inverse_from(&self, joints: &Joints) -> InverseSettings {
        InverseSettings { limits: self.settings.inverse.limits.including(joints), ..self.settings.inverse }
    }

    /// The way to the ready pose; none when the arm is there.
    ///
    /// # Errors
    /// [`RecoveryError`] when an end is blocked or no way is found.
    pub fn home(&self, should_stop: &dyn Fn() -> bool) -> Result<Option<Trajectory>, RecoveryError> {
        if self.start == READY {
            return Ok(None);
        }
        let world_from_base = LinkFrame::of(&self.settings.world_from_base);
        let arm = ArmCollisionSettings {
            world_from_base,
            padding_m: self.settings.padding_m,
            finger_opening_m: self.finger_opening_m,
            limits: self.inverse_from(&self.start).limits,
            ..ArmCollisionSettings::default()
        };
        let obstacles = [&self.obstacles];
        let checker = CollisionChecker::new(arm, &obstacles, None);
        if let Some(contact) = checker.contact(&self.start) {
            return Err(RecoveryError::StartBlocked(contact));
        }
        if let Some(contact) = checker.contact(&READY) {
            return Err(RecoveryError::HomeBlocked(contact));
        }
        // The same arm in the same scene goes home the same way.
        let mut rng = Pcg64::seed_from_u64(0);
        let corners = rrt_connect(&self.start, &[READY], &checker, &self.settings.rrt, &mut rng, should_stop);
        let corners = corners.map_err(|_| RecoveryError::NoWay)?;
        let shorter = simplified(&corners, &self.settings.simplify, &checker);
        timed(&shorter, &self.settings.timing, &checker).map(Some).ok_or(RecoveryError::NoWay)
    }

    /// Which of the robot's spheres touch the scene; the foot never counts.
    fn touching(&self, joints: &Joints) -> [bool; SPHERE_COUNT] {
        let spheres = self.spheres(joints);
        let foot = Link::Link0.sphere_range();
        std::array::from_fn(|i| {
            !foot.contains(&i) && self.obstacles.touches(&spheres[i].center, spheres[i].radius_m + self.settings.padding_m)
        })
    }

    /// What a sphere touches that does.
    fn contact(&self, joints: &Joints, sphere: usize) -> Contact {
        let (link, at) = (SPHERE_LINKS[sphere], &self.spheres(joints)[sphere]);
        let zone = self.obstacles.zone_touched(&at.center, at.radius_m + self.settings.padding_m);
        zone.map_or(Contact::Scene(link), |zone| Contact::Zone(link, zone))
    }

    /// The robot's spheres in the world.
    fn spheres(&self, joints: &Joints) -> [PlacedSphere; SPHERE_COUNT] {
        let in_base = spheres_in_base(&LinkFrames::at(joints), self.finger_opening_m);
        in_base.map(|s| PlacedSphere { center: self.settings.world_from_base * s.center, ..s })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pick_place::plan::Phase;
    use crate::pick_place::{PickPlaceRequest, pick_place};
    use crate::synthetic;
    use repose_panda::{FINGER_OPENING_MAX_M, FR3_LIMITS, LIMITS};

    fn settings() -> RecoverySettings {
        RecoverySettings::of(&PickPlaceSettings::default(), 0.2)
    }

    /// What is around the arm.
    fn around() -> ArmSurroundings {
        ArmSurroundings::of(&synthetic::wire_scene(0))
    }

    /// The arm at a grasp on box 1, and how far its fingers are apart.
    fn at_a_grasp() -> (Joints, f64) {
        let (scene, aside) = (synthetic::scene(), Isometry3::translation(0.0, 0.45, 0.0));
        let request = PickPlaceRequest { scene: &scene, query: 1, placements: &[aside], start: &READY, grasps: None, seed: 3 };
        let plan = pick_place(&request, &PickPlaceSettings::default()).unwrap();
        let approach = plan.phases.iter().find(|p| p.phase == Phase::Approach).unwrap().trajectory.as_ref().unwrap();
        (*approach.end(), FINGER_OPENING_MAX_M)
    }

    #[test]
    fn an_arm_at_a_grasp_backs_off_along_its_fingers_and_goes_home() {
        let (start, opening_m) = at_a_grasp();
        let (scene, settings) = (around(), settings());
        let (trajectory, retreated_m) = Recovery::new(&start, opening_m, Some(&scene), &settings).retreat().unwrap();
        assert!((retreated_m - 0.1).abs() < 1e-9, "{retreated_m}");
        let (from, to) = (base_from_tcp(&start), base_from_tcp(trajectory.end()));
        assert!((from.inverse() * to).translation.vector.xy().norm() < 0.002, "straight back");
        let stands = *trajectory.end();
        let home = Recovery::new(&stands, opening_m, Some(&scene), &settings).home(&|| false).unwrap().expect("a way");
        assert_eq!(*home.end(), READY);
        assert!(home.duration_s() > 2.0, "slowly: {} s", home.duration_s());
    }

    #[test]
    fn an_arm_that_was_stopped_next_to_a_joints_limit_backs_off() {
        let settings = settings();
        for last_rad in [LIMITS.position_lower_rad[6] + 0.004, LIMITS.position_upper_rad[6] - 0.004] {
            let start = [READY[0], READY[1], READY[2], READY[3], READY[4], READY[5], last_rad];
            let (_, retreated_m) = Recovery::new(&start, FINGER_OPENING_MAX_M, None, &settings).retreat().unwrap();
            assert!((retreated_m - 0.1).abs() < 1e-9, "{retreated_m}");
        }
    }

    #[test]
    fn an_arm_that_stands_nearer_to_a_limit_than_motions_are_planned_backs_off_and_goes_home() {
        let timing = TimingSettings { limits: FR3_LIMITS, ..TimingSettings::default() };
        let mut planning = PickPlaceSettings { timing, ..PickPlaceSettings::default() };
        planning.reach.inverse.limits = FR3_LIMITS.approachable(0.1);
        let settings = RecoverySettings::of(&planning, 0.2);
        // An FR3 allows no speed towards its limit there.
        for last_rad in [FR3_LIMITS.position_lower_rad[6] + 0.001, FR3_LIMITS.position_upper_rad[6] - 0.001] {
            let start = [READY[0], READY[1], READY[2], READY[3], READY[4], READY[5], last_rad];
            let recovery = Recovery::new(&start, FINGER_OPENING_MAX_M, None, &settings);
            let (back, retreated_m) = recovery.retreat().unwrap();
            assert!((retreated_m - 0.1).abs() < 1e-9, "{retreated_m}");
            let home = recovery.home(&|| false).unwrap().expect("a way");
            assert_eq!((back.end()[6], home.end()), (last_rad, &READY));
            for trajectory in [back, home] {
                assert!(trajectory.duration_s() < 60.0, "{} s", trajectory.duration_s());
                assert!(trajectory.sampled(0.01).all(|(_, point)| FR3_LIMITS.contains(&point.position_rad, 0.0)));
            }
        }
    }

    #[test]
    fn what_is_behind_the_hand_keeps_it_where_it_is() {
        let (start, opening_m) = at_a_grasp();
        let mut scene = around();
        let lid = synthetic::seen_box([0.45, -0.2], [0.4, 0.4, 0.01], 0.0);
        let above = base_from_tcp(&start).translation.z + 0.165;
        scene.points.extend(lid.iter().map(|p| Point3::new(p.x, p.y, above as f32)));
        let settings = settings();
        let error = Recovery::new(&start, opening_m, Some(&scene), &settings).retreat().map(|(_, m)| m).unwrap_err();
        assert!(matches!(error, RecoveryError::NoRetreat(_, Stuck::Contact(_))), "{error}");
    }

    #[test]
    fn without_a_scene_only_the_arm_itself_is_in_the_way_and_at_home_there_is_nothing_to_do() {
        let (start, opening_m) = at_a_grasp();
        let settings = settings();
        assert!(Recovery::new(&start, opening_m, None, &settings).home(&|| false).unwrap().is_some());
        assert!(Recovery::new(&READY, opening_m, None, &settings).home(&|| false).unwrap().is_none());
    }
}
