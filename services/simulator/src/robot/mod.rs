//! The simulated Panda: a hand that grasps by friction. Its arm is [`repose_robot_side::Arm`], as everybody's.

pub mod hand;

pub use hand::{Hand, HandSettings};
pub use repose_robot_side::{Arm, ArmSettings, TICK_S};
