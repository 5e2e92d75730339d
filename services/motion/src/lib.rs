//! Motion: from ranked placements to a timed pick and place of the Panda, and its execution.
//!
//! The domain is pure: [`grasp`] finds grasps on the observed cloud, [`obstacles`] and [`collision`] judge configurations, [`rrt_connect`] and
//! [`simplify`] find paths, [`timing`] times them under the robot's limits, and [`pick_place`] puts them together over the ranked placements.

pub mod blend;
pub mod collision;
pub mod config;
pub mod execution;
pub mod grasp;
pub mod joint_path;
pub mod ledger;
pub mod obstacles;
pub mod pick_place;
pub mod plan;
pub mod reach;
pub mod rrt_connect;
pub mod scene;
pub mod simplify;
pub mod synthetic;
pub mod timing;
pub mod wire;
