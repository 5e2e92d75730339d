//! The simulated Panda: a hand that grasps by friction, and a body to look at. Its arm is [`repose_robot_side::Arm`], as everybody's.

pub mod body;
pub mod hand;

pub use hand::{HandSettings, SimulatedHand};
pub use repose_robot_side::{Arm, ArmSettings, TICK_S};
