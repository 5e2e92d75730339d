//! A camera on both networks: its topics on one side, its frames on the other.

use std::sync::Arc;
use std::time::{Duration, Instant};

use repose_proto::{Frame, Payload};
use repose_runtime::{Publisher, Session, Traffic, now_ns};

use super::stream::{CameraStream, Made, Now};
use super::topics::{Event, SILENCE, Topics};
use crate::config::{CameraConfig, Ros2Config};
use crate::error::BridgeError;
use crate::node::Node;
use crate::report::Reports;
use crate::tree::Tree;

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
    let mut topics = Topics::of(&node, &camera).await?;
    let mut moved = tree.changes();
    let mut looks = tokio::time::interval(SILENCE / 3);
    let mut stream = CameraStream::new(camera.clone(), config.world_frame.clone());
    let started = Instant::now();
    let now = || Now { ms: started.elapsed().as_millis() as u64, ns: now_ns() };
    let due = |ms: u64| started + Duration::from_millis(ms);
    loop {
        tokio::select! {
            event = topics.next() => match event? {
                Some(Event::Info(Ok(info))) => stream.info(*info),
                Some(Event::Info(Err(error))) => stream.unreadable(&error),
                Some(Event::Depth(taken)) => stream.depth(taken, now()),
                Some(Event::Color(taken)) => stream.color(taken, now()),
                None => return Ok(()),
            },
            // What waits for a transform looks again when some have come.
            _ = moved.changed(), if stream.waits_for_pose() => {}
            () = wait(stream.due_ms().map(due)) => {}
            _ = looks.tick() => topics.tell_silence(&camera.name, &reports),
        }
        let place = |to: &str, of: &str, stamp_ns| tree.held().lookup(to, of, stamp_ns);
        while let Some(made) = tokio::task::block_in_place(|| stream.next(place, now())) {
            put(&frames, made, &reports).await;
        }
        if let Some((lost, why)) = stream.take_why() {
            reports.warn(&camera.name, lost.as_str(), &why);
        }
        tell(&stream, &camera.name, topics.dropped(), &reports);
    }
}

/// Until what waits has waited long enough; for ever where nothing waits.
async fn wait(due: Option<Instant>) {
    match due {
        Some(due) => tokio::time::sleep_until(due.into()).await,
        None => std::future::pending().await,
    }
}

async fn put(frames: &Publisher, Made { frame, complete }: Made, reports: &Reports) {
    let made_ms = complete.elapsed().as_secs_f64() * 1e3;
    let payload = tokio::task::block_in_place(|| Payload::bulk(Frame::SCHEMA, &frame.to_bulk()));
    let put = match payload {
        Ok(payload) => frames.put(payload).await.map_err(BridgeError::from),
        Err(error) => Err(error.into()),
    };
    match put {
        Ok(()) => {
            let took_ms = complete.elapsed().as_secs_f64() * 1e3;
            metrics::histogram!("repose_ros2_picture_to_frame_seconds", "camera" => frame.camera_name.clone()).record(took_ms * 1e-3);
            tracing::debug!(camera = frame.camera_name, stamp_ns = frame.stamp_ns, made_ms, took_ms, "frame put");
        }
        Err(error) => reports.warn(&frame.camera_name, "frame", &error.to_string()),
    }
}

fn tell(stream: &CameraStream, camera: &str, dropped: u64, reports: &Reports) {
    let (counts, pairs) = stream.counts();
    let lost = counts.lost.iter().map(|(why, count)| (why.as_str(), *count));
    let pairing = [("depth_alone", pairs.depth_alone), ("color_alone", pairs.color_alone), ("overtaken", pairs.late)];
    let all = [("frames", counts.frames), ("dropped", dropped)].into_iter().chain(pairing).chain(lost);
    for (what, count) in all {
        metrics::counter!("repose_ros2_pictures_total", "camera" => camera.to_owned(), "became" => what).absolute(count);
        reports.count(camera, what, count);
    }
}
