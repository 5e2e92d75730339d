//! Motion: from ranked placements to a timed pick and place of the Panda, and its execution.
//!
//! ```
//! use nalgebra::Isometry3;
//! use repose_motion::pick_place::{PickPlaceRequest, PickPlaceSettings, pick_place};
//! use repose_motion::synthetic;
//!
//! // Object 1 of a table of boxes, 45 cm to the side.
//! let (scene, aside) = (synthetic::scene(), Isometry3::translation(0.0, 0.45, 0.0));
//! let request = PickPlaceRequest { scene: &scene, query: 1, placements: &[aside], start: &repose_panda::READY, grasps: None, seed: 3 };
//! let plan = pick_place(&request, &PickPlaceSettings::default()).unwrap();
//! assert_eq!((plan.placement, plan.phases.len()), (0, 9));
//! ```
//!
//! The domain is pure: [`grasp`] finds grasps on the observed cloud, [`obstacles`] and [`collision`] judge configurations, [`path`] finds the
//! arm's way and times it under the robot's limits, [`pick_place`] puts them together over the ranked placements, [`execution`] decides what a
//! robot is told, and [`recovery`] brings an arm back after a stop. Around it is the service ([`run`]): calls `plan`, `execute`, `reset` and
//! `recover`, and the link to robots.

pub mod believed;
pub mod benchmark;
pub mod client_watch;
pub mod collision;
pub mod config;
pub mod endpoints;
pub mod execution;
pub mod grasp;
pub mod motion_scene;
pub mod neighbours;
pub mod obstacles;
pub mod path;
pub mod pick_place;
pub mod recovery;
pub mod request;
pub mod robot_link;
pub mod scene;
pub mod synthetic;
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
    let endpoints = endpoints::Endpoints::start(&session, &config).await?;
    session.serve(Service::Motion, Arc::new(endpoints), shutdown).await
}
