//! The planner: where can an object be set down so that a goal holds and it stays?
//!
//! ```
//! use std::ops::ControlFlow;
//! use std::sync::Arc;
//!
//! use repose_planner::{NoModels, PreparedScene, plan};
//! use repose_proto::place::{Outcome, Variant};
//! use repose_proto::{CameraModel, PlaceRequest, RigidTransform, Scene, SceneMeta, Surface};
//!
//! // A table of 1.2 m by 0.8 m, and on it two cubes of 8 cm, as points every centimetre (object 0 is furniture).
//! # let mut points: Vec<([f32; 3], u16)> = Vec::new();
//! # for (x, y) in (-60..=60).flat_map(|x| (-40..=40).map(move |y| (x, y))) {
//! #     points.push(([x as f32 * 0.01, y as f32 * 0.01, 0.0], 0));
//! # }
//! # for (x0, id) in [(0.0, 1), (-0.4, 2)] {
//! #     for (a, b) in (-4..=4).flat_map(|a| (0..=8).map(move |b| (a as f32 * 0.01, b as f32 * 0.01))) {
//! #         points.extend([([x0 + a, -0.04, b], id), ([x0 + a, b - 0.04, 0.08], id)]);
//! #     }
//! # }
//! # // A camera at (0, −1, 1) that looks along +y, down by 45°.
//! # let c = std::f64::consts::FRAC_1_SQRT_2;
//! # let world_from_camera = RigidTransform([1.0, 0.0, 0.0, 0.0, 0.0, -c, c, -1.0, 0.0, -c, -c, 1.0, 0.0, 0.0, 0.0, 1.0]);
//! # let camera = CameraModel {
//! #     width: 320, height: 240, fx: 240.0, fy: 240.0, cx: 159.5, cy: 119.5, depth_unit_m: 0.001,
//! #     world_from_camera: Some(world_from_camera),
//! # };
//! # let outline_m = vec![[-0.6, -0.4], [0.6, -0.4], [0.6, 0.4], [-0.6, 0.4]];
//! # let meta = SceneMeta {
//! #     objects: Vec::new(),
//! #     surfaces: vec![Surface { height_m: 0.0, outline_m, area_m2: 0.96, object: None }],
//! #     camera,
//! #     world_frame: repose_proto::scene::WorldFrame::Extrinsics,
//! #     view_yaw_rad: 0.0,
//! #     unseen: Default::default(),
//! #     left_out: Vec::new(),
//! #     warnings: Vec::new(),
//! # };
//! # let (points, labels) = points.into_iter().unzip();
//! let scene = Scene { camera_name: "table".to_owned(), stamp_ns: 0, points, labels, colors: None, meta, as_sent: None };
//! let prepared = PreparedScene::new(Arc::new(scene));
//!
//! // Where can cube 2 stand to the right of cube 1? By geometry, without networks.
//! let goal = vec!["right_of:1".parse()?];
//! let request = PlaceRequest { variant: Variant::Geometric, ..PlaceRequest::new(prepared.scene_id.clone(), 2, goal) };
//! let result = plan(&prepared, &request, &NoModels, &mut |_| ControlFlow::Continue(()))?;
//!
//! assert_eq!(result.outcome, Outcome::Found);
//! let best = &result.placements[0];
//! let moved_right_m = best.placed_from_observed.0[3];
//! assert!(moved_right_m > 0.4 && best.geometric[0].holds);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! The domain is pure and synchronous: [`plan()`] searches on a [`PreparedScene`] (Algorithm 1 of the paper, [`search`]) and asks the
//! networks through the [`PlacementModels`] port. [`settings`] says what each variant is made of. Around it is the service ([`run`]): it
//! fetches scenes from perception, searches on its own threads, and asks inference for scores.

pub mod answers;
pub mod arrange;
pub mod attitude;
pub mod cached_scene;
pub mod checks;
pub mod config;
pub mod endpoints;
pub mod judge;
pub mod learned;
pub mod plan;
pub mod remote_models;
pub mod scene;
pub mod search;
pub mod settings;
pub mod worker;

#[cfg(test)]
mod tests;

use std::sync::Arc;

use repose_proto::Service;
use repose_runtime::{CellCallers, RuntimeError, Session, Shutdown};

use config::Robots;

pub use config::PlannerConfig;
pub use learned::forecast::Forecasts;
pub use learned::models::{NoModels, PlacementModels};
pub use plan::{PlanReport, SearchStep, plan, plan_turned_with_report, plan_with_report};
pub use scene::prepared::PreparedScene;
pub use scene::turned::{TurnedOver, turned_over, turns};
pub use search::stop::StopReason;

/// Runs a planner worker until `shutdown`, then drains it.
///
/// # Errors
/// When the configuration is wrong, and when the network or the operating system refuses.
pub async fn run(session: Session, config: PlannerConfig, shutdown: Shutdown) -> Result<(), RuntimeError> {
    config.validate()?;
    let robots = Robots::of(&config)?;
    let worker = Arc::new(worker::Worker::start(&config, session.cell_shares())?);
    let perception = CellCallers::new(session.clone(), Service::Perception);
    let inference = session.caller(Service::Inference).await?;
    let endpoints = Arc::new(endpoints::Endpoints::new(worker, perception, inference, robots, &config));
    session.serve(Service::Planner, endpoints, shutdown).await
}
