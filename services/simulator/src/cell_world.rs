//! The running cell: scene, arm and hand in one world, stepped in robot time.
//!
//! The arm's controller ticks at 1 kHz; physics steps every other tick. Pictures show the robot, as cameras
//! do, unless asked not to.

use nalgebra::Isometry3;
use repose_panda::base_from_hand;
use repose_proto::RigidTransform;
use repose_proto::robot::RobotState;
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
        Self { settings, hand_settings: hand, scene, world, hand: hand_in_world, arm, ticks: 0, pictures: 0 }
    }

    /// Clears the table and sets up the scene of another seed; the arm goes back to its ready pose.
    ///
    /// # Errors
    /// [`NoScene`] when the seed gives none; everything is as before then.
    pub fn reset(&mut self, seed: u64) -> Result<(), NoScene> {
        self.scene = cell_of_seed(seed, &self.settings)?;
        self.arm.rehome();
        (self.world, self.hand) = furnished(&self.scene, &self.settings, &self.arm, self.hand_settings);
        Ok(())
    }

    /// One physics step of robot time; `now_s` is the receiver's monotonic clock.
    pub fn step(&mut self, now_s: f64) {
        let ticks = (f64::from(self.world.step_s()) / TICK_S).round().max(1.0) as usize;
        self.arm.set_grips(self.hand.grips(&mut self.world));
        for _ in 0..ticks {
            self.arm.tick(now_s);
        }
        self.ticks += ticks as u64;
        if let Some(command) = self.arm.take_gripper() {
            self.hand.command(&command);
        }
        self.hand.before_step(&mut self.world, &base_from_hand(self.arm.q_rad()));
        self.world.step();
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

    /// What the camera reports: noisy depth; with the robot in the picture or without it.
    pub fn sensed_picture(&mut self, sensor: &SensorModel, show_robot: bool) -> Picture {
        let mut picture = self.true_picture(show_robot);
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
