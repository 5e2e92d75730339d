//! Motion: from ranked placements to a timed pick and place of the Panda, and its execution.
//!
//! The domain is pure: [`grasp`] finds grasps on the observed cloud, [`obstacles`] and [`collision`] judge configurations, [`rrt_connect`] and
//! [`simplify`] find paths, [`timing`] times them under the robot's limits, [`pick_place`] puts them together over the ranked placements, and
//! [`execution`] decides what a robot is told. Around it is the service ([`run`]): calls `plan`, `execute` and `reset`, and the link to robots.

pub mod believed;
pub mod benchmark;
pub mod blend;
pub mod collision;
pub mod config;
pub mod endpoints;
pub mod execution;
pub mod grasp;
pub mod halt;
pub mod hidden;
pub mod joint_path;
pub mod obstacles;
pub mod pick_place;
pub mod plan;
pub mod reach;
pub mod request;
pub mod robot_link;
pub mod rrt_connect;
pub mod scene;
pub mod simplify;
pub mod synthetic;
pub mod timing;
pub mod wire;
pub mod worker;

use std::sync::Arc;

use repose_proto::Service;
use repose_runtime::{RuntimeError, Session, Shutdown};

pub use config::MotionConfig;

/// Runs a motion worker until `shutdown`, then drains it.
///
/// # Errors
/// When the network or the operating system refuses, or the configuration is out of range.
pub async fn run(session: Session, config: MotionConfig, shutdown: Shutdown) -> Result<(), RuntimeError> {
    let worker = worker::Worker::start(&config)?;
    let link = robot_link::RobotLink::new(session.clone(), &config)?;
    session.serve(Service::Motion, Arc::new(endpoints::Endpoints::new(worker, link)), shutdown).await
}
