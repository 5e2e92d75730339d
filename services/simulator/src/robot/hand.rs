//! The hand: a palm that goes where the arm carries it, and two fingers that press with a force.
//!
//! The palm is kinematic, the fingers are rigid bodies on prismatic joints with force-based motors, so what they hold is held by friction
//! and nothing else. The hand's frame is Franka's: z along the fingers, y the direction they open in.

use nalgebra::Isometry3;
use rapier3d::dynamics::{ImpulseJointHandle, MotorModel, PrismaticJointBuilder, RigidBodyBuilder, RigidBodyHandle};
use rapier3d::geometry::{ColliderBuilder, Group, InteractionGroups, InteractionTestMode, SharedShape};
use rapier3d::math::{Pose, Vector};

use crate::convert;
use crate::physics::World;
use repose_panda::FINGER_OPENING_MAX_M;
use repose_panda::spheres::FINGER_M;
use repose_proto::robot::GripperCommand;

/// How the fingers press and move.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HandSettings {
    /// Stiffness of a finger's motor, N/m.
    pub stiffness_n_m: f32,
    /// Damping of a finger's motor, N s/m.
    pub damping_n_s_m: f32,
    /// Most that a finger presses with whatever is commanded, newtons; Franka's hand holds 70 N continuously.
    pub max_force_n: f32,
    /// Speed at which a finger's set-point moves, m/s.
    pub speed_m_s: f32,
    /// Friction of the finger pads.
    pub friction: f32,
    /// Mass of a finger with what its drive adds to it, kg. The drive's inertia, seen through its gearing, is many times the finger's own; and
    /// the solver needs it: between fingers of 0.1 kg what is held turns by degrees a second, between these it stays.
    pub finger_mass_kg: f32,
}

impl Default for HandSettings {
    fn default() -> Self {
        Self { stiffness_n_m: 2000.0, damping_n_s_m: 50.0, max_force_n: 70.0, speed_m_s: 0.06, friction: 0.9, finger_mass_kg: 3.0 }
    }
}

/// Half the pad's and finger's edge lengths in the finger's axes (x across, y thickness, z along), metres.
pub(super) const FINGER_HALF_M: [f32; 3] = [0.0105, 0.0065, 0.0268];
/// Half the palm's edge lengths and how far its centre is ahead of the hand's frame, metres.
const PALM_HALF_M: [f32; 3] = [0.0316, 0.102, 0.0329];
/// Fingers count as standing that have moved by no more than this, metres, for this long, seconds. On thin things they tremble by a third of a
/// millimetre for as long as they press; what is squeezed out from between them goes at some millimetres a second.
const STANDING_M: f32 = 0.0005;
const STANDING_FOR_S: f32 = 0.25;
/// Objects thinner than this are not told from a closed gripper, metres.
const HOLDING_M: f32 = 0.002;

/// What the hand takes up with its fingers `opening_m` apart: convex parts in the hand's frame.
pub fn parts(opening_m: f64) -> Vec<(Pose, SharedShape)> {
    let [px, py, pz] = PALM_HALF_M;
    let [fx, fy, fz] = FINGER_HALF_M;
    let boxed = |half: [f32; 3], x: f64, y: f64, z: f64| {
        (convert::pose(&Isometry3::translation(x, y, z)), SharedShape::cuboid(half[0], half[1], half[2]))
    };
    let finger = |side: f64| boxed([fx, fy, fz], 0.0, side * (opening_m / 2.0 + f64::from(fy)), FINGER_M + f64::from(fz));
    vec![boxed([px, py, pz], 0.0, 0.0, f64::from(pz)), finger(1.0), finger(-1.0)]
}

/// The simulated hand: palm, fingers, and their commands.
#[derive(Debug, Clone)]
pub struct SimulatedHand {
    settings: HandSettings,
    palm: RigidBodyHandle,
    fingers: [RigidBodyHandle; 2],
    joints: [ImpulseJointHandle; 2],
    /// Where each finger is to end: half the commanded width, metres.
    goal_m: f32,
    /// Where each finger is to be now: moves towards the goal at the gripper's speed.
    target_m: f32,
    force_n: f32,
    /// Where the fingers were on average before the last step, metres.
    middle_m: f32,
    /// Between where they have stood, and for how long, seconds.
    stood_m: [f32; 2],
    standing_s: f32,
}

impl SimulatedHand {
    /// Adds an open hand to a world.
    pub fn new(world: &mut World, world_from_hand: &Isometry3<f64>, settings: HandSettings) -> Self {
        const HAND: Group = Group::GROUP_2;
        // The hand's parts pass through each other and touch everything else.
        let groups = InteractionGroups::new(HAND, !HAND, InteractionTestMode::And);
        let open_m = FINGER_OPENING_MAX_M as f32 / 2.0;
        let engine = world.engine();
        let [px, py, pz] = PALM_HALF_M;
        let palm_body = RigidBodyBuilder::kinematic_position_based().pose(convert::pose(world_from_hand));
        let palm_shape =
            ColliderBuilder::cuboid(px, py, pz).translation(Vector::new(0.0, 0.0, pz)).friction(settings.friction).collision_groups(groups);
        let (palm, _) = engine.insert(palm_body, palm_shape);
        let [fx, fy, fz] = FINGER_HALF_M;
        let finger = |side: f32| {
            let hand_from_finger = Isometry3::translation(0.0, f64::from(side * open_m), FINGER_M);
            let body =
                RigidBodyBuilder::dynamic().pose(convert::pose(&(world_from_hand * hand_from_finger))).gravity_scale(0.0).can_sleep(false);
            let shape = ColliderBuilder::cuboid(fx, fy, fz).translation(Vector::new(0.0, side * fy, fz));
            let shape = shape.mass(settings.finger_mass_kg).friction(settings.friction).collision_groups(groups);
            (body, shape, side)
        };
        let [left, right] = [1.0f32, -1.0].map(|side| {
            let (body, shape, side) = finger(side);
            let (handle, _) = engine.insert(body, shape);
            let joint = PrismaticJointBuilder::new(Vector::new(0.0, side, 0.0))
                .local_anchor1(Vector::new(0.0, 0.0, FINGER_M as f32))
                .local_anchor2(Vector::ZERO)
                .limits([0.0, open_m])
                .motor_model(MotorModel::ForceBased)
                .motor_position(open_m, settings.stiffness_n_m, settings.damping_n_s_m)
                .motor_max_force(settings.max_force_n);
            (handle, engine.insert_impulse_joint(palm, handle, joint.build()))
        });
        let (goal_m, force_n) = (open_m, settings.max_force_n);
        Self {
            settings,
            palm,
            fingers: [left.0, right.0],
            joints: [left.1, right.1],
            goal_m,
            target_m: open_m,
            force_n,
            middle_m: open_m,
            stood_m: [open_m; 2],
            standing_s: 0.0,
        }
    }

    /// Starts a gripper action, from where the fingers are: a grip that opens lets go at once, not as its pressure fades, in which what it
    /// holds would swing about the pads.
    pub fn command(&mut self, command: &GripperCommand) {
        self.target_m = self.middle_m;
        self.goal_m = (command.width_m.clamp(0.0, FINGER_OPENING_MAX_M) / 2.0) as f32;
        self.force_n = (command.force_n as f32).clamp(1.0, self.settings.max_force_n);
    }

    /// Leaves off what it does: the fingers stay where they are.
    pub fn halt(&mut self) {
        (self.goal_m, self.target_m) = (self.middle_m, self.middle_m);
    }

    /// Prepares the next step of the world: the palm will be at `world_from_hand` at its end.
    pub fn before_step(&mut self, world: &mut World, world_from_hand: &Isometry3<f64>) {
        let reach = self.settings.speed_m_s * world.step_s();
        self.target_m += (self.goal_m - self.target_m).clamp(-reach, reach);
        // The real fingers are geared together. Each is aimed at the same distance inside where the two are on average, so that both press
        // alike and neither gives way sideways.
        let middle_m = self.finger_positions_m(world).iter().sum::<f32>() / 2.0;
        self.middle_m = middle_m;
        self.stood_m = [self.stood_m[0].min(middle_m), self.stood_m[1].max(middle_m)];
        self.standing_s += world.step_s();
        if self.stood_m[1] - self.stood_m[0] > STANDING_M {
            (self.stood_m, self.standing_s) = ([middle_m; 2], 0.0);
        }
        let squeeze_m = self.force_n / self.settings.stiffness_n_m;
        let aim_m = self.target_m.clamp(middle_m - squeeze_m, middle_m + squeeze_m);
        let engine = world.engine();
        let palm = &mut engine.bodies[self.palm];
        palm.set_next_kinematic_position(convert::next_pose(world_from_hand, palm.position()));
        for joint in self.joints {
            if let Some(joint) = engine.impulse_joints.get_mut(joint, true) {
                let axis = rapier3d::dynamics::JointAxis::LinX;
                joint.data.set_motor_position(axis, aim_m, self.settings.stiffness_n_m, self.settings.damping_n_s_m);
                joint.data.set_motor_max_force(axis, 2.0 * self.force_n);
            }
        }
    }

    /// How far each finger is from the middle, metres.
    pub fn finger_positions_m(&self, world: &mut World) -> [f32; 2] {
        let engine = world.engine();
        let palm_from_world = engine.bodies[self.palm].position().inverse();
        let along = |k: usize| (palm_from_world * engine.bodies[self.fingers[k]].translation()).y;
        [along(0), -along(1)]
    }

    /// The opening, metres.
    pub fn width_m(&self, world: &mut World) -> f64 {
        f64::from(self.finger_positions_m(world).iter().sum::<f32>())
    }

    /// Whether the fingers stand: where they were to go, or against something.
    pub fn is_settled(&self) -> bool {
        self.target_m == self.goal_m && self.standing_s >= STANDING_FOR_S
    }

    /// Whether the fingers stand against something before they are where they were to go.
    pub fn is_holding(&self, world: &mut World) -> bool {
        self.is_settled() && self.grips(world)
    }

    /// The same while the fingers may still tremble: they press, and something keeps them apart.
    pub fn grips(&self, world: &mut World) -> bool {
        self.target_m == self.goal_m && self.width_m(world) as f32 > 2.0 * self.goal_m + HOLDING_M
    }
}
