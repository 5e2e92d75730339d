//! `repose bench perception`: how long a frame in memory takes to become a scene, and whether a rate is held for minutes.
//!
//! The plain run times the domain on one thread: frame to scene, then scene to bytes and id, as a worker does both. The soak runs the
//! whole service on an embedded session and is its camera: frames at a fixed rate, each one different, and the published summaries
//! counted.

use std::ops::RangeInclusive;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use clap::Args;
use repose_evaluation::statistics::quantile::Sorted;
use repose_local::configured::section;
use repose_perception::{PerceptionConfig, segment};
use repose_proto::{CallError, Frame, Payload, Scene, SceneSummary, Service};
use repose_runtime::{Session, Shutdown, Traffic};

use crate::asynchronous::in_runtime;
use crate::failure::{CommandResult, Failure};
use crate::frames;
use crate::output::Output;
use crate::values::parse_count;

/// Runs before those that count: caches and the allocator settle.
const WARM_UP_RUNS: usize = 10;
/// Seconds of a soak before memory is first read.
const WARM_UP_S: f64 = 5.0;

/// Seconds that a soak may take, and frames a second that it may have.
const SOAKS_S: RangeInclusive<f64> = 1e-3..=86_400.0;
const RATES: RangeInclusive<f64> = 1e-3..=1e3;

/// How many times memory is read after that.
const RSS_READINGS: f64 = 10.0;

/// Arguments of `bench perception`.
#[derive(Debug, Args)]
pub struct BenchPerceptionArgs {
    /// The frame folder.
    pub frame: PathBuf,
    /// Keep the labels that come with the frame instead of finding objects.
    #[arg(long)]
    pub labels: bool,
    /// Resample the frame to this size first.
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = parse_size)]
    pub size: Option<(usize, usize)>,
    /// Timed runs.
    #[arg(long, default_value_t = 300, value_parser = parse_count)]
    pub runs: usize,
    /// Run the service for this long instead, seconds, and check whether it keeps up.
    #[arg(long, value_name = "SECONDS", conflicts_with = "runs", value_parser = parse_soak)]
    pub soak_s: Option<f64>,
    /// Frames per second of the soak.
    #[arg(long, default_value_t = 30.0, requires = "soak_s", value_parser = parse_rate)]
    pub rate: f64,
}

/// Runs the command.
pub fn run(args: &BenchPerceptionArgs, output: Output) -> CommandResult {
    let mut frame = frames::read(&args.frame)?;
    if !args.labels {
        frame.labels = None;
    }
    if let Some((width, height)) = args.size {
        frame = resampled(&frame, width, height);
    }
    match args.soak_s {
        Some(seconds) => in_runtime(soak(frame, seconds, args.rate, output)),
        None => time(&frame, args.runs, output),
    }
}

/// Frame to scene and scene to bytes, again and again on this thread.
fn time(frame: &Frame, runs: usize, output: Output) -> CommandResult {
    let settings = repose_local::segmentation()?;
    let (mut scene_ms, mut encode_ms, mut both_ms) = (Vec::new(), Vec::new(), Vec::new());
    let mut objects = 0;
    for run in 0..WARM_UP_RUNS + runs {
        let begin = Instant::now();
        let scene = segment(frame, &settings).map_err(CallError::from)?;
        let segmented = begin.elapsed().as_secs_f64() * 1e3;
        let payload = Payload::bulk(Scene::SCHEMA, &scene.to_bulk())?;
        std::hint::black_box((scene.id(), payload));
        let published = begin.elapsed().as_secs_f64() * 1e3;
        objects = scene.meta.objects.len();
        if run >= WARM_UP_RUNS {
            scene_ms.push(segmented);
            encode_ms.push(published - segmented);
            both_ms.push(published);
        }
    }
    let [scene_ms, encode_ms, both_ms] = [scene_ms, encode_ms, both_ms].map(Sorted::new);
    let document = serde_json::json!({
        "p50_ms": scene_ms.at_or_nan(0.5), "p99_ms": scene_ms.at_or_nan(0.99), "min_ms": scene_ms.at_or_nan(0.0),
        "encode_p50_ms": encode_ms.at_or_nan(0.5), "published_p50_ms": both_ms.at_or_nan(0.5), "published_p99_ms": both_ms.at_or_nan(0.99),
        "width": frame.camera.width, "height": frame.camera.height, "labels": frame.labels.is_some(), "objects": objects, "runs": runs,
        "threads": 1,
    });
    output.print(&document, || {
        format!(
            "{} x {}, {} objects {}: frame to scene p50 {:.2} ms, p99 {:.2} ms; with bytes and id p50 {:.2} ms, p99 {:.2} ms ({runs} runs, one thread)",
            frame.camera.width,
            frame.camera.height,
            objects,
            if frame.labels.is_some() { "given" } else { "found" },
            scene_ms.at_or_nan(0.5),
            scene_ms.at_or_nan(0.99),
            both_ms.at_or_nan(0.5),
            both_ms.at_or_nan(0.99)
        )
    })
}

/// The service under a camera of a fixed rate.
async fn soak(frame: Frame, seconds: f64, rate: f64, output: Output) -> CommandResult {
    // Every frame counts, although nobody asks for scenes.
    let config = PerceptionConfig { idle_period_ms: 0, ..section("perception")? };
    let session = Session::embedded().await?;
    let shutdown = Shutdown::new();
    let mut scenes = session.subscribe_queue(&session.cell().scene("soak"), 64).await?;
    let service = tokio::spawn(repose_perception::run(session.clone(), config, shutdown.clone()));
    let perception = session.caller(Service::Perception).await?;
    perception.wait_for_workers(1, Duration::from_secs(10)).await?;

    let begin = Instant::now();
    let camera = tokio::spawn(publish(session.clone(), frame, seconds, rate, begin));
    let mut latency_ms = Vec::new();
    let (mut rss, mut first_s, mut last_s) = (Vec::new(), None, 0.0);
    // Memory is read once warm, and then ten times more in even steps.
    let warm_s = WARM_UP_S.min(seconds / 2.0);
    let until = begin + Duration::from_secs_f64(seconds) + Duration::from_secs(2);
    while let Ok(Some(sample)) = tokio::time::timeout_at(until.into(), scenes.recv()).await {
        let summary: SceneSummary = sample.payload.decode_json()?;
        let since_begin = begin.elapsed().as_secs_f64();
        latency_ms.push(since_begin * 1e3 - summary.stamp_ns as f64 / 1e6);
        first_s.get_or_insert(since_begin);
        last_s = since_begin;
        if since_begin >= warm_s + rss.len() as f64 * (seconds - warm_s) / RSS_READINGS {
            rss.push(resident_bytes());
        }
    }
    let sent = camera.await.map_err(Failure::other)??;
    rss.push(resident_bytes());
    shutdown.trigger();
    service.await.map_err(Failure::other)??;
    session.close().await?;

    let span_s = last_s - first_s.unwrap_or(last_s);
    let achieved = if span_s > 0.0 { (latency_ms.len() - 1) as f64 / span_s } else { 0.0 };
    let published = latency_ms.len();
    let latency_ms = Sorted::new(latency_ms);
    let rss_mib: Vec<Option<f64>> = rss.iter().map(|bytes| bytes.map(|b| b as f64 / f64::from(1 << 20))).collect();
    let (start_mib, end_mib) = (rss_mib.first().copied().flatten(), rss_mib.last().copied().flatten());
    let document = serde_json::json!({
        "seconds": seconds, "rate": rate, "sent": sent, "scenes": published, "missing": sent.saturating_sub(published as u64), "achieved_per_s": achieved,
        "p50_ms": latency_ms.at_or_nan(0.5), "p99_ms": latency_ms.at_or_nan(0.99), "max_ms": latency_ms.at_or_nan(1.0),
        "rss_start_mib": start_mib, "rss_end_mib": end_mib, "rss_mib": rss_mib,
    });
    output.print(&document, || {
        let shown = |mib: Option<f64>| mib.map_or_else(|| "unknown".to_owned(), |m| format!("{m:.1} MiB"));
        format!(
            "{sent} frames at {rate}/s for {seconds} s: {published} scenes, {achieved:.2}/s; frame put to scene seen p50 {:.1} ms, p99 {:.1} ms, max {:.1} ms; resident {} after warm-up, {} at the end",
            latency_ms.at_or_nan(0.5),
            latency_ms.at_or_nan(0.99),
            latency_ms.at_or_nan(1.0),
            shown(start_mib),
            shown(end_mib)
        )
    })
}

/// Is the camera: stamps are nanoseconds since `begin`, and every frame differs, so that no scene is kept twice under one id.
async fn publish(session: Session, mut frame: Frame, seconds: f64, rate: f64, begin: Instant) -> Result<u64, CallError> {
    "soak".clone_into(&mut frame.camera_name);
    let key = session.cell().camera_frame("soak");
    let mut ticks = tokio::time::interval(Duration::from_secs_f64(1.0 / rate));
    let mut sent = 0;
    while begin.elapsed().as_secs_f64() < seconds {
        ticks.tick().await;
        let changed = (sent as usize).wrapping_mul(7919) % frame.depth.len();
        frame.depth[changed] = frame.depth[changed].wrapping_add(1);
        frame.stamp_ns = begin.elapsed().as_nanos() as u64;
        session.put(&key, Payload::bulk(Frame::SCHEMA, &frame.to_bulk())?, Traffic::Frame).await?;
        sent += 1;
    }
    Ok(sent)
}

/// The frame at another size: nearest pixels, intrinsics scaled alike.
fn resampled(frame: &Frame, width: usize, height: usize) -> Frame {
    let camera = &frame.camera;
    let (across, down) = (width as f64 / camera.width as f64, height as f64 / camera.height as f64);
    let source = |i: usize| {
        let nearest = |k: usize, scale: f64, most: usize| (((k as f64 + 0.5) / scale) as usize).min(most - 1);
        nearest(i / width, down, camera.height) * camera.width + nearest(i % width, across, camera.width)
    };
    let pixels = 0..width * height;
    Frame {
        camera: repose_proto::CameraModel {
            width,
            height,
            fx: camera.fx * across,
            fy: camera.fy * down,
            cx: (camera.cx + 0.5) * across - 0.5,
            cy: (camera.cy + 0.5) * down - 0.5,
            ..camera.clone()
        },
        depth: pixels.clone().map(|i| frame.depth[source(i)]).collect(),
        color: frame.color.as_ref().map(|c| pixels.clone().map(|i| c[source(i)]).collect()),
        labels: frame.labels.as_ref().map(|l| pixels.clone().map(|i| l[source(i)]).collect()),
        ..frame.clone()
    }
}

/// Resident memory of this process; none where the system does not tell.
fn resident_bytes() -> Option<u64> {
    let statm = std::fs::read_to_string("/proc/self/statm").ok()?;
    let pages: u64 = statm.split_whitespace().nth(1)?.parse().ok()?;
    // SAFETY: sysconf reads a constant of the system and touches no memory of ours.
    let page_bytes = unsafe { libc::sysconf(libc::_SC_PAGESIZE) };
    Some(pages * u64::try_from(page_bytes).ok()?)
}

fn parse_size(text: &str) -> Result<(usize, usize), String> {
    let sides = text.split_once('x').and_then(|(w, h)| Some((w.parse::<usize>().ok()?, h.parse::<usize>().ok()?)));
    let most = repose_proto::limits::MAX_IMAGE_SIDE;
    sides
        .filter(|(w, h)| (1..=most).contains(w) && (1..=most).contains(h))
        .ok_or_else(|| format!("expected WIDTHxHEIGHT, 1 to {most} each"))
}

fn parse_soak(text: &str) -> Result<f64, String> {
    parse_within(text, &SOAKS_S)
}

fn parse_rate(text: &str) -> Result<f64, String> {
    parse_within(text, &RATES)
}

fn parse_within(text: &str, range: &RangeInclusive<f64>) -> Result<f64, String> {
    let number: f64 = text.parse().map_err(|e| format!("{e}"))?;
    if range.contains(&number) { Ok(number) } else { Err(format!("expected {} to {}", range.start(), range.end())) }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    type Line = crate::testing::Line<BenchPerceptionArgs>;

    #[test]
    fn a_soak_has_a_length_and_a_rate_that_a_clock_can_keep_and_only_a_soak_has_them() {
        let parsed = |options: &[&str]| Line::try_parse_from(["perception", "frame"].iter().chain(options)).map(|line| line.args);
        let soak = parsed(&["--soak-s", "165", "--rate", "30"]).expect("a soak");
        assert_eq!((soak.soak_s, soak.rate), (Some(165.0), 30.0));
        assert!(parsed(&["--runs", "3"]).is_ok() && parsed(&["--soak-s", "5"]).is_ok());
        for number in ["0", "-1", "nan", "inf", "1e-300", "1e300"] {
            assert!(parsed(&["--soak-s", number]).is_err() && parsed(&["--soak-s", "5", "--rate", number]).is_err(), "{number}");
        }
        assert!(parsed(&["--rate", "30"]).is_err() && parsed(&["--soak-s", "5", "--runs", "3"]).is_err(), "one of them would go unheeded");
    }
}
