//! The robot's side of the keys: which commands a robot takes, which set-points it follows, and when it stops by itself.
//!
//! The same code is under the simulated robot and under everybody's own (the driver kit of the Python package), so a driver has only to move
//! joints and read them. [`Arm`] is the controller; [`state_of`] is what it shows of itself. Pure: time is handed in.
//!
//! ```
//! use repose_proto::robot::{Owner, RobotCommand, RobotMode};
//! use repose_robot_side::Arm;
//!
//! let mut arm = Arm::default();
//! let owner = Owner { id: "motion-1".to_owned(), epoch: 1 };
//! arm.command(&RobotCommand::new(owner, 1, 500), 0.0).unwrap();
//! arm.tick(0.001);
//! assert_eq!(arm.mode(), RobotMode::Idle);
//! ```

mod arm;
mod state;
mod straight_way;
mod stream;

pub use arm::{Arm, ArmSettings, DRIVER_STARTED, FOLLOWING_ERROR, Ignored};
pub use state::{GripperState, StateDetails, state_of};
pub use straight_way::straight_way;
pub use stream::TICK_S;
