//! `repose play`: frames from disk or a recording, put to a running system as a camera's.

use std::path::PathBuf;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use clap::Args;
use repose_perception::sources::{self, SourceError, Topics};
use repose_proto::{Frame, Payload, keys};
use repose_runtime::Traffic;

use crate::args::ConnectArgs;
use crate::client;
use crate::failure::{Failure, Outcome};
use crate::output::Output;

/// Frames per second where the source has no stamps and none were asked for.
const DEFAULT_RATE: f64 = 10.0;
/// Longest pause between two frames of a recording; longer ones are cut short.
const LONGEST_PAUSE_S: f64 = 5.0;

/// Arguments of `play`.
#[derive(Debug, Args)]
pub struct PlayArgs {
    /// A frame folder, a folder of them, a folder with depth/ and camera.json, an MCAP recording, or a folder of recordings.
    pub source: PathBuf,
    /// Where to publish, and as which camera.
    #[command(flatten)]
    pub connect: ConnectArgs,
    /// Frames per second; by default the recording's own pace, and 10 for pictures.
    #[arg(long)]
    pub rate: Option<f64>,
    /// Start again at the end, until interrupted.
    #[arg(long = "loop")]
    pub again: bool,
    /// Keep the source's stamps instead of the time of publishing.
    #[arg(long)]
    pub keep_stamps: bool,
    /// Which topics of a recording.
    #[command(flatten)]
    pub topics: TopicArgs,
}

/// Which topics of a recording make the frames; by default the first of each kind.
#[derive(Debug, Clone, Args)]
pub struct TopicArgs {
    /// Depth images of a recording.
    #[arg(long, value_name = "TOPIC")]
    pub depth_topic: Option<String>,
    /// Color images of a recording.
    #[arg(long, value_name = "TOPIC")]
    pub color_topic: Option<String>,
    /// Intrinsics in a recording.
    #[arg(long, value_name = "TOPIC")]
    pub info_topic: Option<String>,
    /// Organised clouds of a recording, instead of depth images.
    #[arg(long, value_name = "TOPIC")]
    pub points_topic: Option<String>,
    /// Make frames of the recording's first topic of organised clouds instead of depth images.
    #[arg(long)]
    pub clouds: bool,
}

impl TopicArgs {
    /// As perception takes them.
    pub fn topics(&self) -> Topics {
        Topics {
            depth: self.depth_topic.clone(),
            color: self.color_topic.clone(),
            info: self.info_topic.clone(),
            points: self.points_topic.clone(),
            clouds: self.clouds,
        }
    }
}

/// Runs the command.
pub async fn run(args: &PlayArgs, output: Output) -> Outcome {
    let camera = &args.connect.camera;
    keys::validate_chunk("camera", camera)?;
    if args.rate.is_some_and(|rate| !(rate > 0.0 && rate <= 1000.0)) {
        return Err(Failure::bad_input("rate", "expected above 0 and at most 1000 frames per second"));
    }
    let session = client::connect(&args.connect.system).await?;
    let key = session.cell().camera_frame(camera);
    let begin = tokio::time::Instant::now();
    let mut published = 0u64;
    loop {
        let mut due = tokio::time::Instant::now();
        let mut last_stamp_ns = None;
        for frame in sources::open(&args.source, &args.topics.topics()).map_err(|e| bad_source(&e))? {
            let mut frame = frame.map_err(|e| bad_source(&e))?;
            due += pause(args.rate, last_stamp_ns.replace(frame.stamp_ns), &frame);
            tokio::time::sleep_until(due).await;
            camera.clone_into(&mut frame.camera_name);
            if !args.keep_stamps {
                frame.stamp_ns = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_nanos() as u64);
            }
            session.put(&key, Payload::bulk(Frame::SCHEMA, &frame.to_bulk())?, Traffic::Frame).await?;
            published += 1;
            tracing::debug!(published, stamp_ns = frame.stamp_ns, "frame published");
        }
        if !args.again {
            break;
        }
    }
    // Every frame has been put; a router that is slow to say goodbye does not take that back.
    if let Err(error) = session.close().await {
        tracing::warn!(%error, "the session did not close in time");
    }
    let seconds = begin.elapsed().as_secs_f64();
    let document = serde_json::json!({"camera": camera, "published": published, "seconds": seconds});
    output.print(&document, || format!("{published} frames published as camera {camera} in {seconds:.1} s"))
}

/// How long after the frame before it this one comes.
fn pause(rate: Option<f64>, last_stamp_ns: Option<u64>, frame: &Frame) -> Duration {
    let Some(last_stamp_ns) = last_stamp_ns else { return Duration::ZERO };
    let recorded_s = frame.stamp_ns.checked_sub(last_stamp_ns).filter(|ns| *ns > 0).map(|ns| ns as f64 / 1e9);
    let seconds = rate.map(|rate| 1.0 / rate).or(recorded_s).unwrap_or(1.0 / DEFAULT_RATE);
    Duration::from_secs_f64(seconds.min(LONGEST_PAUSE_S))
}

fn bad_source(error: &SourceError) -> Failure {
    Failure::bad_input(&error.path().display().to_string(), error)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(stamp_ns: u64) -> Frame {
        let camera = repose_proto::CameraModel {
            width: 1,
            height: 1,
            fx: 1.0,
            fy: 1.0,
            cx: 0.0,
            cy: 0.0,
            depth_unit_m: 0.001,
            world_from_camera: None,
        };
        Frame { camera_name: "c".to_owned(), stamp_ns, camera, depth: vec![1], color: None, labels: None }
    }

    #[test]
    fn the_asked_rate_goes_before_the_stamps_and_those_before_the_default() {
        let ms = |rate, last, stamp| pause(rate, last, &frame(stamp)).as_millis();
        assert_eq!(ms(Some(50.0), None, 5), 0);
        assert_eq!(ms(Some(50.0), Some(0), 1_000_000_000), 20);
        assert_eq!(ms(None, Some(1_000_000_000), 1_033_000_000), 33);
        assert_eq!(ms(None, Some(0), 0), 100);
        assert_eq!(ms(None, Some(9), 3), 100);
        assert_eq!(ms(None, Some(0), u64::MAX), 5000);
    }
}
