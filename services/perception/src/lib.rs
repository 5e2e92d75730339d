//! Perception: frames in, segmented scenes out.
//!
//! The domain is pure: [`segment()`] turns a frame into a scene, one algorithm a module. Around it is the service ([`run`]): it follows
//! cameras, publishes the summary of each new scene, keeps the newest scenes by id, and answers `segment`, `latest` and `scene`.
//! [`sources`] are frames from disk: folders, sequences of pictures, recordings of ROS 2.

pub mod borders;
pub mod camera_names;
pub mod cameras;
pub mod clean_masks;
pub mod cloud;
pub mod components;
pub mod config;
pub mod depth;
pub mod endpoints;
pub mod flying;
pub mod frame_folder;
pub mod gravity;
pub mod halves;
pub mod hollows;
pub mod newest;
pub mod newest_scenes;
pub mod objects;
pub mod point_map;
pub mod segment;
pub mod settings;
pub mod sources;
pub mod surfaces;
#[cfg(test)]
mod synthetic;
pub mod unlabelled;
pub mod unseen;
pub mod upward;
pub mod worker;

use std::sync::Arc;
use std::sync::atomic::Ordering;

use repose_proto::Service;
use repose_runtime::{RuntimeError, Session, Shutdown};

pub use config::PerceptionConfig;
pub use segment::{SegmentError, Segmented, segment, segment_with_labels, segment_with_left_out};
pub use settings::Settings;

/// Runs a perception worker until `shutdown`, then drains it.
///
/// # Errors
/// When the network or the operating system refuses, or the configuration names a camera that cannot be one.
pub async fn run(session: Session, config: PerceptionConfig, shutdown: Shutdown) -> Result<(), RuntimeError> {
    let worker = Arc::new(worker::Worker::start(&config)?);
    let cameras = cameras::Cameras::new(session.clone(), worker.clone(), &config);
    let stop = repose_runtime::CancellationToken::new();
    let _stop_following = stop.clone().drop_guard();
    cameras.clone().follow(&config.cameras, stop).await?;
    let endpoints = Arc::new(endpoints::Endpoints::new(worker));
    let served = session.serve(Service::Perception, endpoints, shutdown).await;
    let counts = cameras.counts();
    tracing::info!(
        received = counts.received.load(Ordering::Relaxed),
        dropped = counts.dropped.load(Ordering::Relaxed),
        late = counts.late.load(Ordering::Relaxed),
        failed = counts.failed.load(Ordering::Relaxed),
        published = counts.published.load(Ordering::Relaxed),
        "cameras no longer followed"
    );
    served
}
