//! Perception: camera frames in, segmented scenes out.
//!
//! ```
//! use repose_perception::{Settings, segment};
//! use repose_proto::{CameraModel, Frame};
//!
//! // A camera one metre above a table, looking straight down at a box of 10 cm.
//! let (width, height) = (320, 240);
//! let camera = CameraModel {
//!     width, height, fx: 262.0, fy: 262.0, cx: 159.5, cy: 119.5, depth_unit_m: 0.001, world_from_camera: None,
//! };
//! let on_box = |i: usize| (140..170).contains(&(i % width)) && (100..130).contains(&(i / width));
//! let depth = (0..width * height).map(|i| if on_box(i) { 900 } else { 1000 }).collect();
//!
//! let scene = segment(&Frame::new("front".to_owned(), 0, camera, depth), &Settings::default())?;
//! assert_eq!(scene.meta.objects.len(), 1);
//! assert!((scene.meta.objects[0].centroid_m[2] - 0.1).abs() < 0.005, "its top is 10 cm above the table");
//! # Ok::<(), repose_perception::SegmentError>(())
//! ```
//!
//! | room | what is in it |
//! |---|---|
//! | [`segment`](mod@segment) | the way from a frame to a scene; pure, as are the next seven |
//! | [`view`] | what the frame shows: depth without stray readings and robots, the camera's pose, whose each pixel is |
//! | [`readings`] | the depth picture: metres, points, normals, stray readings |
//! | [`supports`] | which way is up, and the surfaces that things stand on |
//! | [`objects`] | finding objects in frames without labels |
//! | [`masks`] | cleaning instance masks, found or given |
//! | [`robots`] | telling robots and what they hold from the rest of the picture |
//! | [`scene`] | the scene's points, summaries of its objects, unseen space, warnings |
//! | [`sources`] | frames from disk: folders, sequences of pictures, recordings of ROS 2 |
//! | [`cameras`], [`endpoints`], [`worker`], [`newest_scenes`], [`unasked`] | the service that [`run`] starts: it follows cameras, publishes a summary of each new scene, keeps the newest scenes by id, and answers `segment`, `latest` and `scene` |

pub mod cameras;
pub mod config;
pub mod endpoints;
pub mod error;
pub mod masks;
pub mod newest_scenes;
pub mod objects;
pub mod readings;
pub mod report;
pub mod robots;
pub mod scene;
pub mod segment;
pub mod settings;
pub mod sources;
pub mod supports;
#[cfg(test)]
mod synthetic;
pub mod unasked;
pub mod view;
pub mod worker;

use std::sync::Arc;
use std::sync::atomic::Ordering;

use repose_proto::Service;
use repose_runtime::{RuntimeError, Session, Shutdown};

pub use config::PerceptionConfig;
pub use error::SegmentError;
pub use segment::{Segmented, segment, segment_with_labels};
pub use settings::Settings;
pub use sources::frame_folder;

/// Runs a perception worker until `shutdown`, then drains it.
///
/// # Errors
/// When the network or the operating system refuses, or the configuration names a camera that cannot be one.
pub async fn run(session: Session, config: PerceptionConfig, shutdown: Shutdown) -> Result<(), RuntimeError> {
    config.validate().map_err(|e| RuntimeError::Config {
        section: "perception".to_owned(),
        file: None,
        message: format!("{}: {}", e.field.unwrap_or_default(), e.message),
    })?;
    let worker = Arc::new(worker::Worker::start(&config)?);
    let cameras = cameras::CameraFollower::new(session.clone(), worker.clone(), &config);
    let stop = repose_runtime::CancellationToken::new();
    let _stop_following = stop.clone().drop_guard();
    cameras.clone().follow(&config.cameras, stop).await?;
    let endpoints = Arc::new(endpoints::Endpoints::new(worker));
    let served = session.serve(Service::Perception, endpoints, shutdown).await;
    let counts = cameras.counts();
    tracing::info!(
        received = counts.received.load(Ordering::Relaxed),
        dropped = counts.dropped.load(Ordering::Relaxed),
        unasked = counts.unasked.load(Ordering::Relaxed),
        late = counts.late.load(Ordering::Relaxed),
        failed = counts.failed.load(Ordering::Relaxed),
        published = counts.published.load(Ordering::Relaxed),
        "cameras no longer followed"
    );
    served
}
