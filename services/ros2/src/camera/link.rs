//! A camera on both networks: its topics on one side, its frames on the other.

use std::sync::Arc;
use std::time::{Duration, Instant};

use repose_proto::{Frame, Payload};
use repose_ros_messages::{CameraInfo, CompressedImage, Header, MessageError, RosImage};
use repose_runtime::{Publisher, Session, Traffic};

use super::pictures::{self, Color, Depth};
use super::stream::CameraStream;
use crate::config::{CameraConfig, Ros2Config};
use crate::error::BridgeError;
use crate::node::{Node, RosSubscription, now_ns};
use crate::report::Reports;
use crate::tree::Tree;
use crate::wire::names::Qos;

/// How many pictures may wait to be read.
const PICTURES: Qos = Qos { depth: 4, ..Qos::SENSOR };
/// Between two looks at what waits for a transform.
const LOOK: Duration = Duration::from_millis(5);

/// Pictures of one kind, plain or packed.
enum Source {
    Plain(RosSubscription<RosImage>),
    Packed(RosSubscription<CompressedImage>),
}

/// What came: the picture, or why it cannot be read.
enum Came {
    Plain(RosImage),
    Packed(CompressedImage),
    Broken(BridgeError),
}

impl Source {
    async fn of(node: &Node, topic: &str, packed: &str) -> Result<Self, BridgeError> {
        Ok(if topic.ends_with(packed) {
            Self::Packed(node.subscribe(topic, "sensor_msgs/msg/CompressedImage", PICTURES).await?)
        } else {
            Self::Plain(node.subscribe(topic, "sensor_msgs/msg/Image", PICTURES).await?)
        })
    }

    async fn recv(&mut self) -> Option<Came> {
        Some(match self {
            Self::Plain(topic) => topic.recv().await?.map_or_else(Came::Broken, Came::Plain),
            Self::Packed(topic) => topic.recv().await?.map_or_else(Came::Broken, Came::Packed),
        })
    }

    fn dropped(&self) -> u64 {
        match self {
            Self::Plain(topic) => topic.dropped(),
            Self::Packed(topic) => topic.dropped(),
        }
    }
}

type Read<T> = (Header, Result<T, MessageError>);

fn read_depth(came: Came) -> Result<Read<Depth>, BridgeError> {
    match came {
        Came::Plain(image) => Ok((image.header.clone(), pictures::depth(&image))),
        Came::Packed(image) => Ok((image.header.clone(), pictures::packed_depth(&image))),
        Came::Broken(error) => Err(error),
    }
}

fn read_color(came: Came) -> Result<Read<Color>, BridgeError> {
    match came {
        Came::Plain(image) => Ok((image.header.clone(), pictures::color(&image))),
        Came::Packed(image) => Ok((image.header.clone(), pictures::packed_color(&image))),
        Came::Broken(error) => Err(error),
    }
}

/// Runs a camera until its session closes.
///
/// # Errors
/// When a network refuses.
pub async fn run(
    session: Session,
    node: Node,
    config: Arc<Ros2Config>,
    camera: CameraConfig,
    tree: Tree,
    reports: Reports,
) -> Result<(), BridgeError> {
    let frames = session.publisher(session.cell().camera_frame(&camera.name), Traffic::Frame);
    let mut infos = node.subscribe::<CameraInfo>(&camera.info, "sensor_msgs/msg/CameraInfo", Qos::SENSOR).await?;
    let mut depths = Source::of(&node, &camera.depth, "/compressedDepth").await?;
    let mut colors = match &camera.color {
        Some(color) => Some(Source::of(&node, color, "/compressed").await?),
        None => None,
    };
    let mut stream = CameraStream::new(camera.clone(), config.world_frame.clone());
    let started = Instant::now();
    let now_ms = || started.elapsed().as_millis() as u64;
    loop {
        let broken = |error: BridgeError| reports.warn(&camera.name, error.to_string());
        tokio::select! {
            info = infos.recv() => match info {
                Some(Ok(info)) => stream.info(info),
                Some(Err(error)) => broken(error),
                None => return Ok(()),
            },
            came = depths.recv() => {
                let Some(came) = came else { return Ok(()) };
                match tokio::task::block_in_place(|| read_depth(came)) {
                    Ok((header, depth)) => stream.depth(header, depth, now_ms(), now_ns()),
                    Err(error) => broken(error),
                }
            }
            came = next_of(&mut colors) => {
                let Some(came) = came else { return Ok(()) };
                match tokio::task::block_in_place(|| read_color(came)) {
                    Ok((header, color)) => stream.color(&header, color, now_ms(), now_ns()),
                    Err(error) => broken(error),
                }
            }
            () = wait(stream.due_ms()) => {}
        }
        while let Some(frame) = tokio::task::block_in_place(|| stream.next(&tree.held(), now_ms(), now_ns())) {
            put(&frames, &frame, &reports).await;
        }
        if let Some(why) = stream.take_why() {
            reports.warn(&camera.name, why);
        }
        tell(&stream, &camera.name, depths.dropped() + colors.as_ref().map_or(0, Source::dropped), &reports);
    }
}

async fn next_of(colors: &mut Option<Source>) -> Option<Came> {
    match colors {
        Some(colors) => colors.recv().await,
        None => std::future::pending().await,
    }
}

/// A little while, where something waits; otherwise for ever.
async fn wait(due_ms: Option<u64>) {
    match due_ms {
        Some(_) => tokio::time::sleep(LOOK).await,
        None => std::future::pending().await,
    }
}

async fn put(frames: &Publisher, frame: &Frame, reports: &Reports) {
    let payload = tokio::task::block_in_place(|| Payload::bulk(Frame::SCHEMA, &frame.to_bulk()));
    let put = match payload {
        Ok(payload) => frames.put(payload).await.map_err(BridgeError::from),
        Err(error) => Err(error.into()),
    };
    if let Err(error) = put {
        reports.warn(&frame.camera_name, error.to_string());
    }
}

fn tell(stream: &CameraStream, camera: &str, dropped: u64, reports: &Reports) {
    let (counts, pairs) = stream.counts();
    let lost = counts.lost.iter().map(|(why, count)| (why.as_str(), *count));
    let pairing = [("depth_alone", pairs.depth_alone), ("color_alone", pairs.color_alone), ("overtaken", pairs.late)];
    let all = [("frames", counts.frames), ("dropped", dropped)].into_iter().chain(pairing).chain(lost);
    all.for_each(|(what, count)| reports.count(camera, what, count));
}
