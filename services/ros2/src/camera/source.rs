//! Pictures as they come on a topic, read on a task of its own: depth and color of one instant are unpacked side by side.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use repose_ros_messages::cloud::{self, Sight};
use repose_ros_messages::pictures::{self, Color};
use repose_ros_messages::{CompressedImage, Header, MessageError, PointCloud2, RosImage};
use serde::de::DeserializeOwned;
use tokio::sync::mpsc;
use tokio::task::JoinSet;

use super::packed;
use crate::config::{CameraConfig, DepthSource};
use crate::error::BridgeError;
use crate::node::{Node, RosSubscription};
use crate::wire::names::Qos;

/// How many pictures may wait to be read.
const PICTURES: Qos = Qos { depth: 4, ..Qos::SENSOR };

/// What came: a picture, or why it cannot be read.
pub struct Taken<T> {
    /// When it came.
    pub arrived: Instant,
    /// Whose it is and what it shows.
    pub read: Result<(Header, T), BridgeError>,
}

/// The pictures of one topic.
pub struct Source<T> {
    pictures: mpsc::Receiver<Taken<T>>,
    dropped: Arc<AtomicU64>,
}

impl<T> Source<T> {
    /// The next picture, or none when the session has closed. Cancel safe.
    pub async fn recv(&mut self) -> Option<Taken<T>> {
        self.pictures.recv().await
    }

    /// How many were dropped because they were not read in time.
    pub fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }
}

/// A camera's depth; `readers` keeps the task.
///
/// # Errors
/// When the network refuses.
pub async fn depths(node: &Node, camera: &CameraConfig, readers: &mut JoinSet<()>) -> Result<Source<Sight>, BridgeError> {
    Ok(match camera.depth_source() {
        DepthSource::Cloud(topic) => {
            let clouds = node.subscribe::<PointCloud2>(topic, "sensor_msgs/msg/PointCloud2", PICTURES).await?;
            reader(clouds, readers, |cloud| (cloud.header.clone(), cloud::sight(&cloud)))
        }
        DepthSource::Packed(topic) => {
            let images = node.subscribe::<CompressedImage>(topic, "sensor_msgs/msg/CompressedImage", PICTURES).await?;
            reader(images, readers, |image| (image.header.clone(), packed::depth(&image).map(Sight::from)))
        }
        DepthSource::Plain(topic) => {
            let images = node.subscribe::<RosImage>(topic, "sensor_msgs/msg/Image", PICTURES).await?;
            reader(images, readers, |image| (image.header.clone(), pictures::depth(&image).map(Sight::from)))
        }
    })
}

/// A camera's color, on a topic of its own; `readers` keeps the task.
///
/// # Errors
/// When the network refuses.
pub async fn colors(node: &Node, topic: &str, readers: &mut JoinSet<()>) -> Result<Source<Color>, BridgeError> {
    if crate::config::is_packed(topic) {
        let images = node.subscribe::<CompressedImage>(topic, "sensor_msgs/msg/CompressedImage", PICTURES).await?;
        return Ok(reader(images, readers, |image| (image.header.clone(), packed::color(&image))));
    }
    let images = node.subscribe::<RosImage>(topic, "sensor_msgs/msg/Image", PICTURES).await?;
    Ok(reader(images, readers, |image| (image.header.clone(), pictures::color(&image))))
}

/// Reads what comes until nobody takes it any more.
fn reader<M, T>(
    mut topic: RosSubscription<M>,
    readers: &mut JoinSet<()>,
    read: impl Fn(M) -> (Header, Result<T, MessageError>) + Send + 'static,
) -> Source<T>
where
    M: DeserializeOwned + 'static,
    T: Send + 'static,
{
    // Further ones wait in the subscription, which drops the oldest.
    let (taken, pictures) = mpsc::channel(1);
    let dropped = Arc::<AtomicU64>::default();
    let counted = dropped.clone();
    readers.spawn(async move {
        while let Some(message) = topic.recv_bytes().await {
            let read = tokio::task::block_in_place(|| {
                let (header, picture) = read(topic.decode(&message)?);
                Ok((header, picture?))
            });
            counted.store(topic.dropped(), Ordering::Relaxed);
            if taken.send(Taken { arrived: message.arrived, read }).await.is_err() {
                return;
            }
        }
    });
    Source { pictures, dropped }
}
