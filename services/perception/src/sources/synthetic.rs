//! Recordings to test with, of messages that were written by hand.

use std::collections::BTreeMap;
use std::path::Path;

use repose_ros_messages::synthetic;

use super::messages::Channel;

/// A message of a topic.
#[derive(Clone)]
pub struct SyntheticMessage {
    pub topic: String,
    pub schema: &'static str,
    pub bytes: Vec<u8>,
}

impl SyntheticMessage {
    pub fn channel(&self) -> Channel {
        Channel { topic: self.topic.clone(), schema: self.schema.to_owned() }
    }
}

/// [`synthetic::image`] of a topic.
pub fn image(topic: &str, frame_id: &str, encoding: &str, side: u32) -> SyntheticMessage {
    let bytes = synthetic::image(frame_id, encoding, side);
    SyntheticMessage { topic: topic.to_owned(), schema: "sensor_msgs/msg/Image", bytes }
}

/// [`synthetic::info`] of a topic.
pub fn info(topic: &str, frame_id: &str, side: u32) -> SyntheticMessage {
    let bytes = synthetic::info(frame_id, side);
    SyntheticMessage { topic: topic.to_owned(), schema: "sensor_msgs/msg/CameraInfo", bytes }
}

/// [`synthetic::cloud`] of a topic.
pub fn cloud(topic: &str, frame_id: &str, side: u32, point: impl Fn(u32, u32) -> [f32; 3]) -> SyntheticMessage {
    let bytes = synthetic::cloud(frame_id, side, point);
    SyntheticMessage { topic: topic.to_owned(), schema: "sensor_msgs/msg/PointCloud2", bytes }
}

/// Writes a recording with messages a tenth of a second apart.
pub fn record(path: &Path, messages: &[SyntheticMessage]) {
    let mut writer = mcap::Writer::new(std::fs::File::create(path).unwrap()).unwrap();
    let mut channels = BTreeMap::new();
    for (i, message) in (0u64..).zip(messages) {
        let channel_id = *channels.entry(&message.topic).or_insert_with(|| {
            let schema = writer.add_schema(message.schema, "ros2msg", b"").unwrap();
            writer.add_channel(schema, &message.topic, "cdr", &BTreeMap::new()).unwrap()
        });
        let header = mcap::records::MessageHeader { channel_id, sequence: 0, log_time: i * 100_000_000, publish_time: 0 };
        writer.write_to_known_channel(&header, &message.bytes).unwrap();
    }
    writer.finish().unwrap();
}
