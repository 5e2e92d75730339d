//! The running cell: scene, arm and hand in one world, stepped in robot time.
//!
//! The arm's controller ticks at 1 kHz; physics steps every other tick. Pictures show the robot, as cameras
//! do, unless asked not to.

use nalgebra::Isometry3;
use repose_panda::base_from_hand;
use repose_proto::RigidTransform;
use repose_proto::robot::{RobotMode, RobotState};
use repose_robot_side::{GripperState, StateDetails, state_of};
use repose_sensor::SensorModel;

use crate::cell::{CellSettings, cell_of_seed};
use crate::physics::{Touchable, World};
use crate::render::{Picture, picture};
use crate::robot::{Arm, ArmSettings, HandSettings, SimulatedHand, TICK_S, body};
use crate::scene::{NoScene, SimulatedScene};

/// A cell at work.
pub struct CellWorld {
    settings: CellSettings,
    hand_settings: HandSettings,
    scene: SimulatedScene,
    world: World,
    hand: SimulatedHand,
    /// The arm, to be commanded and watched.
    pub arm: Arm,
    ticks: u64,
    pictures: u64,
    /// The last true picture, with what it shows.
    drawn: Option<(Shows, Picture)>,
}

/// Objects and fingers that moved by less than this look the same, metres: a tenth of what the camera can tell apart, and more than contacts tremble.
const SAME_M: f64 = 5e-5;
/// The same of orientations and joints, radians.
const SAME_RAD: f64 = 1e-4;

/// What a picture shows.
#[derive(Debug, Clone, PartialEq)]
struct Shows {
    world_from_objects: Vec<Isometry3<f64>>,
    /// Joints and fingers; none where the robot is not drawn.
    robot: Option<([f64; 7], [f32; 2])>,
}

impl Shows {
    fn looks_like(&self, other: &Self) -> bool {
        let objects = self.world_from_objects.iter().zip(&other.world_from_objects);
        let mut poses = objects
            .map(|(a, b)| (a.translation.vector - b.translation.vector).norm() < SAME_M && a.rotation.angle_to(&b.rotation) < SAME_RAD);
        let robot = match (&self.robot, &other.robot) {
            (Some((joints, fingers)), Some((other_joints, other_fingers))) => {
                joints.iter().zip(other_joints).all(|(a, b)| (a - b).abs() < SAME_RAD)
                    && fingers.iter().zip(other_fingers).all(|(a, b)| f64::from((a - b).abs()) < SAME_M)
            }
            (None, None) => true,
            _ => false,
        };
        robot && self.world_from_objects.len() == other.world_from_objects.len() && poses.all(|alike| alike)
    }
}

impl CellWorld {
    /// The cell with the scene of a seed, the arm ready, the hand open.
    ///
    /// # Errors
    /// [`NoScene`] when the seed gives none.
    pub fn new(seed: u64, settings: CellSettings, arm: ArmSettings, hand: HandSettings) -> Result<Self, NoScene> {
        let scene = cell_of_seed(seed, &settings)?;
        Ok(Self::with_scene(scene, settings, arm, hand))
    }

    /// The cell with a given scene, the arm ready, the hand open.
    pub fn with_scene(scene: SimulatedScene, settings: CellSettings, arm: ArmSettings, hand: HandSettings) -> Self {
        let arm = Arm::new(arm);
        let (world, hand_in_world) = furnished(&scene, &settings, &arm, hand);
        Self { settings, hand_settings: hand, scene, world, hand: hand_in_world, arm, ticks: 0, pictures: 0, drawn: None }
    }

    /// Clears the table and sets up the scene of another seed; the arm goes back to its ready pose.
    ///
    /// # Errors
    /// [`NoScene`] when the seed gives none; everything is as before then.
    pub fn reset(&mut self, seed: u64) -> Result<(), NoScene> {
        self.scene = cell_of_seed(seed, &self.settings)?;
        self.arm.rehome();
        (self.world, self.hand) = furnished(&self.scene, &self.settings, &self.arm, self.hand_settings);
        // Other objects may stand at the same places.
        self.drawn = None;
        Ok(())
    }

    /// One physics step of robot time; `now_s` is the receiver's monotonic clock.
    pub fn step(&mut self, now_s: f64) {
        let ticks = (f64::from(self.world.step_s()) / TICK_S).round().max(1.0) as usize;
        self.arm.set_grips(self.hand.grips(&mut self.world), now_s);
        for _ in 0..ticks {
            self.arm.tick(now_s);
        }
        self.ticks += ticks as u64;
        // As at a robot: fingers that press on something go on, for it must not fall.
        if self.arm.take_hand_halt() && !self.hand.grips(&mut self.world) {
            self.hand.halt();
        }
        if let Some(command) = self.arm.take_gripper() {
            self.hand.command(&command);
        }
        self.hand.before_step(&mut self.world, &base_from_hand(self.arm.q_rad()));
        self.world.step();
    }

    /// A step of robot time in which nothing but the arm's controller goes on: for a world that [`Self::is_still`].
    pub fn pass(&mut self, now_s: f64) {
        let ticks = (f64::from(self.world.step_s()) / TICK_S).round().max(1.0) as usize;
        for _ in 0..ticks {
            self.arm.tick(now_s);
        }
        self.ticks += ticks as u64;
    }

    /// Whether nothing moves, and nothing is held that could slip: arm, fingers and objects.
    pub fn is_still(&mut self) -> bool {
        let arm_stands = self.arm.mode() != RobotMode::Moving && self.arm.dq_rad_s().iter().all(|speed| *speed == 0.0);
        arm_stands && self.hand.is_settled() && self.at_rest() && !self.hand.is_holding(&mut self.world)
    }

    /// Length of a step, seconds of robot time.
    pub fn step_s(&self) -> f64 {
        f64::from(self.world.step_s())
    }

    /// Robot time, milliseconds.
    pub fn robot_ms(&self) -> f64 {
        self.ticks as f64 * TICK_S * 1e3
    }

    /// The settings that it was made with.
    pub fn settings(&self) -> &CellSettings {
        &self.settings
    }

    /// The scene's furniture and objects where they are now, distances measured.
    pub fn truth(&self) -> SimulatedScene {
        self.scene.with_poses(&self.world.poses())
    }

    /// Where the objects are now, in the scene's order; cheaper than the truth, which measures distances too.
    pub fn world_from_objects(&self) -> Vec<Isometry3<f64>> {
        self.world.poses()
    }

    /// What touches what since the last step; fixtures and objects by their place in the scene's lists.
    pub fn contacts(&self) -> Vec<[Touchable; 2]> {
        self.world.contacts()
    }

    /// What the robot shows of itself: its state number `seq`, made at `stamp_ns` of the wall clock.
    pub fn robot_state(&mut self, seq: u64, stamp_ns: u64) -> RobotState {
        let (width_m, settled, holding) = self.gripper();
        let gripper = GripperState { width_m, settled, holding };
        // The cell's world is the base's.
        let world_from_base = Some(RigidTransform::IDENTITY);
        state_of(&self.arm, &StateDetails { seq, stamp_ns, robot_ms: self.robot_ms(), gripper, world_from_base })
    }

    /// Whether every object is at rest.
    pub fn at_rest(&self) -> bool {
        self.world.first_moving(&self.settings.scene.rest).is_none()
    }

    /// Gripper opening (metres), whether the fingers stand, and whether they hold something.
    pub fn gripper(&mut self) -> (f64, bool, bool) {
        (self.hand.width_m(&mut self.world), self.hand.is_settled(), self.hand.is_holding(&mut self.world))
    }

    /// What the camera sees, true depth; with the robot in the picture or without it.
    pub fn true_picture(&mut self, show_robot: bool) -> Picture {
        let poses = self.world.poses();
        let mut drawables = self.scene.drawables();
        let fixtures = self.scene.fixtures.len();
        for (drawable, pose) in drawables[fixtures..].iter_mut().zip(poses) {
            drawable.world_from_mesh = pose;
        }
        if show_robot {
            drawables.extend(body::drawables(self.arm.q_rad(), self.hand.finger_positions_m(&mut self.world)));
        }
        picture(&self.settings.camera, &self.settings.world_from_camera(), &drawables)
    }

    /// What the camera reports: noisy depth; with the robot in the picture or without it. What has not moved is not drawn again: its noise is new.
    pub fn sensed_picture(&mut self, sensor: &SensorModel, show_robot: bool) -> Picture {
        let robot = show_robot.then(|| (*self.arm.q_rad(), self.hand.finger_positions_m(&mut self.world)));
        let shows = Shows { world_from_objects: self.world.poses(), robot };
        let drawn = self.drawn.take().filter(|(drawn, _)| drawn.looks_like(&shows));
        let (shows, mut picture) = drawn.unwrap_or_else(|| (shows, self.true_picture(show_robot)));
        self.drawn = Some((shows, picture.clone()));
        self.pictures += 1;
        sensor.disturb(picture.depth_m.pixels_mut(), &self.settings.camera, self.scene.seed.wrapping_add(self.pictures << 32));
        picture
    }
}

fn furnished(scene: &SimulatedScene, settings: &CellSettings, arm: &Arm, hand: HandSettings) -> (World, SimulatedHand) {
    let mut world = scene.world(settings.scene.physics);
    let hand = SimulatedHand::new(&mut world, &base_from_hand(arm.q_rad()), hand);
    (world, hand)
}

#[cfg(test)]
mod tests {
    use nalgebra::{Translation3, UnitQuaternion, Vector3};
    use serde_json::json;

    use super::*;

    fn cell(seed: u64) -> CellWorld {
        CellWorld::new(seed, CellSettings::default(), ArmSettings::default(), HandSettings::default()).expect("a scene")
    }

    #[test]
    fn what_moved_by_less_than_the_camera_can_tell_looks_the_same() {
        let pose =
            |x: f64, yaw_rad: f64| Isometry3::from_parts(Translation3::new(x, 0.0, 0.0), UnitQuaternion::new(Vector3::z() * yaw_rad));
        let shows = |x, yaw_rad, joint_rad, finger_m| Shows {
            world_from_objects: vec![pose(x, yaw_rad)],
            robot: Some(([joint_rad; 7], [finger_m; 2])),
        };
        let before = shows(0.5, 0.1, 0.2, 0.04);
        assert!(shows(0.500_01, 0.100_01, 0.200_01, 0.040_01).looks_like(&before));
        for moved in
            [shows(0.5002, 0.1, 0.2, 0.04), shows(0.5, 0.101, 0.2, 0.04), shows(0.5, 0.1, 0.201, 0.04), shows(0.5, 0.1, 0.2, 0.0402)]
        {
            assert!(!moved.looks_like(&before), "{moved:?}");
        }
        assert!(!Shows { robot: None, ..before.clone() }.looks_like(&before));
        assert!(!Shows { world_from_objects: Vec::new(), ..before.clone() }.looks_like(&before));
    }

    #[test]
    fn a_stop_leaves_the_fingers_where_they_are() {
        let mut cell = cell(1);
        let mut now_s = 0.0;
        let mut run = |cell: &mut CellWorld, seconds: f64| {
            for _ in 0..(seconds / cell.step_s()) as usize {
                now_s += cell.step_s();
                cell.step(now_s);
            }
            cell.hand.width_m(&mut cell.world)
        };
        run(&mut cell, 0.5);
        let close =
            json!({"v": 1, "seq": 1, "owner": {"id": "test", "epoch": 1}, "ttl_ms": 60_000, "gripper": {"width_m": 0.0, "force_n": 20.0}});
        cell.arm.command(&serde_json::from_value(close).expect("a command"), 0.5).expect("taken");
        let before_m = run(&mut cell, 0.2);
        assert!((0.03..0.078).contains(&before_m), "they are on their way: {before_m}");
        cell.arm.emergency_stop(&repose_proto::robot::EmergencyStop::read(b"a hand"));
        let after_m = run(&mut cell, 2.0);
        assert!((before_m - after_m).abs() < 3e-3, "{before_m} {after_m}");
    }

    #[test]
    fn a_world_in_which_nothing_moves_is_still_and_its_robots_time_goes_on() {
        let mut cell = cell(1);
        let mut now_s = 0.0;
        while !cell.is_still() {
            now_s += cell.step_s();
            assert!(now_s < 10.0, "it never comes to rest");
            cell.step(now_s);
        }
        let (before, poses) = (cell.robot_ms(), cell.world_from_objects());
        for _ in 0..50 {
            now_s += cell.step_s();
            cell.pass(now_s);
        }
        assert!((cell.robot_ms() - before - 100.0).abs() < 1e-3, "fifty steps of two ticks");
        assert_eq!(cell.world_from_objects(), poses);
        cell.arm.emergency_stop(&repose_proto::robot::EmergencyStop::read(b"a hand"));
        cell.pass(now_s);
        assert!(cell.is_still() && cell.arm.mode() == RobotMode::Stopped, "a stop latches all the same");
    }

    #[test]
    fn pictures_show_the_world_as_it_is_with_noise_of_their_own() {
        let mut cell = cell(1);
        let sensor = SensorModel::structured_light();
        let (first, second) = (cell.sensed_picture(&sensor, true), cell.sensed_picture(&sensor, true));
        assert!(first.color == second.color && first.labels == second.labels && first.depth_m != second.depth_m);
        assert!(cell.sensed_picture(&sensor, false).color != first.color, "the robot is left out when it is asked for");
        cell.reset(2).expect("another scene");
        assert_eq!(cell.sensed_picture(&SensorModel::ideal(), true), cell.true_picture(true));
        assert!(cell.sensed_picture(&sensor, true).labels != first.labels);
    }
}
