//! The Franka Panda and the FR3: kinematics, limits, Franka's rules for commands, and the spheres that stand for the body.
//!
//! ```
//! use repose_panda::{InverseSettings, READY, base_from_tcp, inverse_near};
//!
//! let mut target = base_from_tcp(&READY);
//! target.translation.z -= 0.1;
//! let lower = inverse_near(&target, &READY, &InverseSettings::default()).unwrap();
//! assert!((base_from_tcp(&lower).translation.vector - target.translation.vector).norm() < 1e-6);
//! ```
//!
//! Pure. Frames: `base` is the robot's foot, `flange` the end of link 7, `hand` the flange turned by −45° about z, `tcp` the point between
//! the fingertips 0.1034 m along the hand's z. The hand approaches along +z and its fingers move along y. Angles are radians.

pub mod command_rules;
pub mod commander_watch;
pub mod held_off;
pub mod interpolation;
pub mod inverse;
pub mod kinematics;
pub mod lane_frames;
pub mod levers;
pub mod limits;
pub mod model;
pub mod self_collision;
pub mod spheres;
pub mod stop;

pub use command_rules::{CommandRuleSettings, CommandRules, START_TOLERANCE_RAD, Violation};
pub use commander_watch::CommanderWatch;
pub use held_off::with_room_to_fade;
pub use interpolation::{hermite, smooth_step};
pub use inverse::{InverseError, InverseSettings, inverse_at, inverse_near, inverse_sweep};
pub use kinematics::{
    Jacobian, LinkFrame, LinkFrames, base_from_flange, base_from_hand, base_from_tcp, flange_from_hand, hand_from_tcp, jacobian,
};
pub use levers::levers;
pub use limits::{ApproachLimits, FINGER_OPENING_MAX_M, FR3_LIMITS, JointLimits, LIMITS};
pub use model::Model;
pub use self_collision::{SELF_COLLISION_PAIRS, self_collides};
pub use spheres::{
    GRIPPER_SPHERES, LINKS, Link, PlacedSphere, SPHERE_COUNT, SPHERE_LINKS, gripper_spheres, spheres_in_base, spheres_in_link,
    visible_spheres_in_base, visible_spheres_in_link,
};
pub use stop::{MotionState, Stop, StopSettings};

/// How many joints the arm has.
pub const JOINT_COUNT: usize = 7;

/// Joint angles (or, where a name says so, their rates) from the base outwards, radians.
pub type Joints = [f64; JOINT_COUNT];

/// Franka's ready pose: the hand points straight down in front of the robot, 0.307 m ahead and about 0.59 m up (flange).
pub const READY: Joints = [
    0.0,
    -std::f64::consts::FRAC_PI_4,
    0.0,
    -3.0 * std::f64::consts::FRAC_PI_4,
    0.0,
    std::f64::consts::FRAC_PI_2,
    std::f64::consts::FRAC_PI_4,
];
