//! `repose play`: frames from disk or a recording, put to a running system as a camera's; or a whole cell as `repose record` has recorded it.

use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::Args;
use repose_perception::sources::{self, SourceError};
use repose_proto::{Frame, Payload, SceneSummary, keys};
use repose_recorder::file::reading::is_recording;
use repose_recorder::play::{PlaySettings, Played, play};
use repose_runtime::{Shutdown, Subscription, Traffic};
use tokio::time::Instant;

use crate::client::{self, SystemArgs};
use crate::failure::{CommandResult, Failure};
use crate::frames::TopicArgs;
use crate::output::Output;

/// The camera that frames are published as unless told.
const CAMERA: &str = "recording";
/// Frames per second that may be asked for.
const RATES: RangeInclusive<f64> = 1e-3..=1e3;
/// Frames per second where the source has no stamps and none were asked for.
const DEFAULT_RATE: f64 = 10.0;
/// How long the scene of the last frame may take to be seen.
const LAST_SCENE_WITHIN: Duration = Duration::from_secs(5);
/// Scenes that may wait to be looked at; only the newest matter.
const SCENES_WAITING: usize = 16;
/// Longest pause between two frames of a recording; longer ones are cut short.
const LONGEST_PAUSE_S: f64 = 5.0;

/// Arguments of `play`.
#[derive(Debug, Args)]
pub struct PlayArgs {
    /// A frame folder, a folder of them, a folder with depth/ and camera.json, an MCAP recording, or a folder of recordings. A recording made by
    /// `repose record` (its files, in order) is played as a whole cell, into a cell without live workers (`--cell`).
    #[arg(required = true)]
    pub source: Vec<PathBuf>,
    /// Where to publish.
    #[command(flatten)]
    pub system: SystemArgs,
    /// The camera name to publish frames under. Nothing else should publish under it: `front` is the camera of `repose up`. Default: recording.
    #[arg(long)]
    pub camera: Option<String>,
    /// Frames per second. Default: the recording's own rate, or 10 for pictures.
    #[arg(long)]
    pub rate: Option<f64>,
    /// Playback speed of a recorded cell. Default: 1.
    #[arg(long)]
    pub speed: Option<f64>,
    /// Start again at the end, until interrupted.
    #[arg(long = "loop")]
    pub again: bool,
    /// Keep the frames' time stamps instead of the time of publishing.
    #[arg(long)]
    pub keep_stamps: bool,
    /// Which topics of a recording.
    #[command(flatten)]
    pub topics: TopicArgs,
}

/// Runs the command.
pub async fn run(args: &PlayArgs, output: Output) -> CommandResult {
    match &args.source[..] {
        files if files.iter().all(|file| is_recording(file)) => {
            args.check_for_cell()?;
            cell(files, args, output).await
        }
        [source] => {
            args.check_for_frames(source)?;
            frames(source, args, output).await
        }
        _ => Err(Failure::bad_input(
            "source",
            "several sources must be the files of one recording made by `repose record`; one of these is not",
        )),
    }
}

impl PlayArgs {
    /// Refuses what would go unheeded: a recorded cell has cameras, stamps and a pace of its own.
    fn check_for_cell(&self) -> CommandResult {
        let of_frames = [("camera", self.camera.is_some()), ("rate", self.rate.is_some()), ("keep-stamps", self.keep_stamps)];
        let given = of_frames.into_iter().find(|(_, is_given)| *is_given).map(|(option, _)| option).or_else(|| self.topics.given());
        given.map_or(Ok(()), |option| {
            Err(Failure::bad_input(option, "is for frames, and a recording made by `repose record` is played as a whole cell"))
        })
    }

    fn check_for_frames(&self, source: &Path) -> CommandResult {
        if self.speed.is_some() {
            return Err(Failure::bad_input("speed", "is for a recording made by `repose record`; frames have a --rate"));
        }
        self.topics.check(source)
    }
}

/// Plays a recorded cell.
async fn cell(files: &[PathBuf], args: &PlayArgs, output: Output) -> CommandResult {
    let session = client::connect(&args.system).await?;
    let shutdown = Shutdown::on_signals()?;
    let settings = PlaySettings { files: files.to_owned(), speed: args.speed.unwrap_or(1.0) };
    let name = session.cell().name().to_owned();
    tracing::info!(cell = name, "playing; Ctrl-C ends it");
    let mut all = Played::default();
    let ended = loop {
        match play(&session, &settings, &shutdown).await {
            Ok(pass) => add(&mut all, pass),
            Err(error) => break Err(error),
        }
        if !args.again || shutdown.is_requested() {
            break Ok(());
        }
    };
    client::close(session).await;
    ended?;
    let Played { messages, seconds, cut } = all;
    cut.iter().for_each(|reason| tracing::warn!(reason, "the recording ends early"));
    output.print(&serde_json::json!({"cell": name, "messages": messages, "seconds": seconds, "cut": cut}), || {
        let counts: Vec<String> = messages.iter().map(|(kind, count)| format!("{count} {kind}")).collect();
        format!("{seconds:.1} s of a cell played into cell {name}: {}", counts.join(", "))
    })
}

/// Adds what was played once more of the same recording.
fn add(all: &mut Played, pass: Played) {
    pass.messages.into_iter().for_each(|(kind, count)| *all.messages.entry(kind).or_default() += count);
    all.seconds += pass.seconds;
    // Its files end as they did before, where it came to their ends.
    if all.cut.is_empty() {
        all.cut = pass.cut;
    }
}

/// Plays frames as a camera's.
async fn frames(source: &Path, args: &PlayArgs, output: Output) -> CommandResult {
    let camera = args.camera.as_deref().unwrap_or(CAMERA);
    keys::validate_chunk("camera", camera)?;
    if args.rate.is_some_and(|rate| !RATES.contains(&rate)) {
        return Err(Failure::bad_input("rate", format!("expected {} to {} frames per second", RATES.start(), RATES.end())));
    }
    let session = client::connect(&args.system).await?;
    let key = session.cell().camera_frame(camera);
    let mut scenes = session.subscribe_queue(&session.cell().scene(camera), SCENES_WAITING).await?;
    let begin = Instant::now();
    let mut published = 0u64;
    let mut last_stamp_ns = 0;
    let mut pace = Pace::new(args.rate, begin);
    loop {
        let published_before = published;
        for frame in sources::open(source, &args.topics.topics()).map_err(|e| bad_source(&e))? {
            let mut frame = frame.map_err(|e| bad_source(&e))?;
            tokio::time::sleep_until(pace.due(frame.stamp_ns)).await;
            camera.clone_into(&mut frame.camera_name);
            if !args.keep_stamps {
                frame.stamp_ns = repose_runtime::now_ns();
            }
            last_stamp_ns = frame.stamp_ns;
            session.put(&key, Payload::bulk(Frame::SCHEMA, &frame.to_bulk())?, Traffic::Frame).await?;
            published += 1;
            tracing::debug!(published, stamp_ns = frame.stamp_ns, "frame published");
        }
        if !args.again || published == published_before {
            break;
        }
    }
    let seconds = begin.elapsed().as_secs_f64();
    // A frame is sent in many parts, and closing the session drops those that still wait. Its scene says that it arrived.
    let last_scene = scene_of_stamp(&mut scenes, last_stamp_ns).await;
    drop(scenes);
    client::close(session).await;
    let scene_id = last_scene.map(|scene| scene.scene_id);
    let document = serde_json::json!({"camera": camera, "published": published, "seconds": seconds, "last_scene_id": scene_id});
    output.print(&document, || {
        let plural = if published == 1 { "" } else { "s" };
        let said = format!("{published} frame{plural} published as camera {camera} in {seconds:.1} s");
        match &scene_id {
            Some(id) => format!("{said}; the scene of the last one is {id}"),
            None => format!(
                "{said}, but no scene of the last one came within {} s: is a perception worker running that follows this camera?",
                LAST_SCENE_WITHIN.as_secs()
            ),
        }
    })
}

/// The scene of the frame with this stamp, where it comes in time.
async fn scene_of_stamp(scenes: &mut Subscription, stamp_ns: u64) -> Option<SceneSummary> {
    let search = async {
        loop {
            let sample = scenes.recv().await?;
            let summary = sample.payload.decode_json::<SceneSummary>().ok();
            if let Some(summary) = summary.filter(|summary| summary.stamp_ns == stamp_ns) {
                return Some(summary);
            }
        }
    };
    tokio::time::timeout(LAST_SCENE_WITHIN, search).await.ok().flatten()
}

/// When frames are due, over all passes: a single frame that is played again and again keeps the pace, too.
struct Pace {
    rate: Option<f64>,
    due: Instant,
    last_stamp_ns: Option<u64>,
}

impl Pace {
    fn new(rate: Option<f64>, begin: Instant) -> Self {
        Self { rate, due: begin, last_stamp_ns: None }
    }

    /// When the next frame is due; the first one is at once.
    fn due(&mut self, stamp_ns: u64) -> Instant {
        if let Some(last_stamp_ns) = self.last_stamp_ns.replace(stamp_ns) {
            // Back at the beginning stamps say nothing, as in pictures.
            let recorded_s = stamp_ns.checked_sub(last_stamp_ns).filter(|ns| *ns > 0).map(|ns| ns as f64 / 1e9);
            let asked_s = self.rate.map(|rate| 1.0 / rate);
            let seconds = asked_s.or(recorded_s.map(|pause_s| pause_s.min(LONGEST_PAUSE_S))).unwrap_or(1.0 / DEFAULT_RATE);
            self.due += Duration::from_secs_f64(seconds);
        }
        self.due
    }
}

fn bad_source(error: &SourceError) -> Failure {
    Failure::bad_input(&error.path().display().to_string(), error)
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    type Line = crate::testing::Line<PlayArgs>;

    fn parsed(options: &[&str]) -> PlayArgs {
        Line::parse_from(["play", "run.mcap"].iter().chain(options)).args
    }

    #[test]
    fn options_of_frames_are_refused_for_a_recorded_cell_and_the_other_way_round() {
        let field = |refused: CommandResult| refused.err().and_then(|failure| failure.error().and_then(|e| e.field.clone()));
        let of_frames: [(&[&str], &str); 4] =
            [(&["--camera", "left"], "camera"), (&["--rate", "5"], "rate"), (&["--keep-stamps"], "keep-stamps"), (&["--clouds"], "clouds")];
        for (options, named) in of_frames {
            assert_eq!(field(parsed(options).check_for_cell()).as_deref(), Some(named));
            assert!(parsed(options).check_for_frames(Path::new("run.mcap")).is_ok(), "{named}");
        }
        let quick = parsed(&["--speed", "2"]);
        assert_eq!(field(quick.check_for_frames(Path::new("run.mcap"))).as_deref(), Some("speed"));
        assert!(quick.check_for_cell().is_ok() && parsed(&["--loop"]).check_for_cell().is_ok());
    }

    #[test]
    fn every_pass_of_a_recorded_cell_counts() {
        let pass = |scenes, cut: &[&str]| Played {
            messages: [("scene", scenes)].into(),
            seconds: 2.0,
            cut: cut.iter().map(|reason| (*reason).to_owned()).collect(),
        };
        let mut all = Played::default();
        [pass(3, &["half"]), pass(1, &[])].into_iter().for_each(|pass| add(&mut all, pass));
        assert_eq!(all, Played { seconds: 4.0, ..pass(4, &["half"]) });
    }

    /// When frames with these stamps are due, milliseconds from the first.
    fn due_ms(rate: Option<f64>, stamps_ns: &[u64]) -> Vec<u128> {
        let begin = Instant::now();
        let mut pace = Pace::new(rate, begin);
        stamps_ns.iter().map(|stamp_ns| (pace.due(*stamp_ns) - begin).as_millis()).collect()
    }

    #[test]
    fn the_asked_rate_goes_before_the_stamps_and_those_before_the_default() {
        assert_eq!(due_ms(Some(50.0), &[5, 1_000_000_005]), [0, 20]);
        assert_eq!(due_ms(Some(0.1), &[5, 1_000_000_005]), [0, 10_000], "a slow rate is as asked for");
        assert_eq!(due_ms(None, &[1_000_000_000, 1_033_000_000]), [0, 33]);
        assert_eq!(due_ms(None, &[0, 0, u64::MAX]), [0, 100, 5100]);
    }

    #[test]
    fn passes_keep_the_pace_even_of_a_single_frame() {
        assert_eq!(due_ms(Some(10.0), &[7, 7, 7]), [0, 100, 200]);
        assert_eq!(due_ms(None, &[0, 30_000_000, 0, 30_000_000]), [0, 30, 130, 160]);
    }
}
