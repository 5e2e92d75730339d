//! Publishes every new scene of the cell's cameras.

use std::sync::Arc;
use std::time::Duration;

use repose_geometry::Aabb;
use repose_proto::{Scene, SceneSummary, Service};
use repose_ros_messages::{Detection3DArray, MarkerArray, PointCloud2, PoseArray};
use repose_runtime::{CallOptions, Caller, Session, fetch_scene};

use super::messages;
use crate::config::Ros2Config;
use crate::error::BridgeError;
use crate::node::{Node, RosPublisher};
use crate::report::Reports;
use crate::wire::names::Qos;

/// How long a whole scene may take to come.
const FETCH: Duration = Duration::from_secs(3);

/// The topics of one camera's scenes.
pub struct SceneTopics {
    detections: RosPublisher<Detection3DArray>,
    poses: RosPublisher<PoseArray>,
    markers: RosPublisher<MarkerArray>,
    cloud: RosPublisher<PointCloud2>,
}

impl SceneTopics {
    /// Offers them.
    ///
    /// # Errors
    /// When the network refuses.
    pub async fn of(node: &Node, camera: &str) -> Result<Self, BridgeError> {
        let camera = topic_part(camera);
        let own = |topic: &str| node.own(&format!("{camera}/{topic}"));
        Ok(Self {
            detections: node.publisher(&own("detections"), "vision_msgs/msg/Detection3DArray", Qos::DEFAULT).await?,
            poses: node.publisher(&own("objects"), "geometry_msgs/msg/PoseArray", Qos::DEFAULT).await?,
            markers: node.publisher(&own("markers"), "visualization_msgs/msg/MarkerArray", Qos::DEFAULT).await?,
            cloud: node.publisher(&own("points"), "sensor_msgs/msg/PointCloud2", Qos { depth: 2, ..Qos::SENSOR }).await?,
        })
    }

    async fn publish(&self, config: &Ros2Config, summary: &SceneSummary, scene: &Scene) -> Result<(), BridgeError> {
        let header = messages::header(&messages::frame_of(&config.world_frame, scene), scene.stamp_ns);
        let boxes = tokio::task::block_in_place(|| Aabb::of_labels(&scene.points, &scene.labels));
        self.detections.publish(&messages::detections(&header, summary, &boxes)).await?;
        self.poses.publish(&messages::poses(&header, summary)).await?;
        self.markers.publish(&messages::markers(&header, summary, &boxes)).await?;
        let cloud = tokio::task::block_in_place(|| messages::cloud(&header, scene));
        self.cloud.publish(&cloud).await
    }
}

/// Follows one camera's scenes until the session closes: the newest, where they come faster than they can be shown.
///
/// # Errors
/// When a network refuses.
pub async fn run(session: Session, node: Node, config: Arc<Ros2Config>, camera: String, reports: Reports) -> Result<(), BridgeError> {
    let shown = SceneTopics::of(&node, &camera).await?;
    let perception = session.caller(Service::Perception).await?;
    let mut scenes = session.subscribe_latest(&session.cell().scene(&camera)).await?;
    let part = format!("{camera} scenes");
    let mut count = 0;
    while let Some(sample) = scenes.recv().await {
        let published = async {
            let summary: SceneSummary = sample.payload.decode_json()?;
            let scene = whole(&perception, &summary.scene_id).await?;
            shown.publish(&config, &summary, &scene).await
        };
        match published.await {
            Ok(()) => {
                count += 1;
                reports.count(&part, "published", count);
            }
            Err(error) => reports.warn(&part, "scene", error.to_string()),
        }
    }
    Ok(())
}

/// A camera's name as a part of a topic. Keys may have dashes, and begin with a digit as serial numbers do; in ROS that is no name.
fn topic_part(camera: &str) -> String {
    let part = camera.replace('-', "_");
    if part.starts_with(|c: char| c.is_ascii_digit()) { format!("camera_{part}") } else { part }
}

/// A scene with its points.
///
/// # Errors
/// When no perception worker has it any more.
pub async fn whole(perception: &Caller, scene_id: &str) -> Result<Scene, BridgeError> {
    Ok(fetch_scene(perception, scene_id, &CallOptions::within(FETCH)).await?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::names;

    #[test]
    fn every_name_that_a_camera_may_have_is_part_of_a_topic() {
        for (camera, part) in
            [("front", "front"), ("wrist-left_2", "wrist_left_2"), ("138422075228", "camera_138422075228"), ("3d-top", "camera_3d_top")]
        {
            repose_proto::keys::validate_chunk("name", camera).expect("a camera may be called that");
            assert_eq!(topic_part(camera), part);
            assert_eq!(names::check(&format!("/repose/{}/points", topic_part(camera))), Ok(()));
        }
    }
}
