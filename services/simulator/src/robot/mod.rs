//! The simulated Panda: an arm that follows timed set-points under Franka's rules, and a hand that grasps by friction.

pub mod arm;
pub mod hand;
mod stream;

pub use arm::{Arm, ArmSettings};
pub use hand::{Hand, HandSettings};
pub use stream::TICK_S;
