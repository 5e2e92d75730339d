//! Playing a recording: the cell as it was, in time, for whatever looks at cells.
//!
//! Pictures, robot states and stops are put again as they were. Scenes come from a perception worker that answers from the recording, and each is
//! announced when it is there, so that viewers may fetch what they are told of.

use std::collections::BTreeMap;
use std::ops::RangeInclusive;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use async_trait::async_trait;
use repose_proto::perception::{LatestRequest, SceneRequest};
use repose_proto::{CallError, Cell, Payload, Scene, SceneSummary, Service, keys};
use repose_runtime::{Call, Handler, SceneStore, Session, Shutdown, Traffic};
use tokio::time::Instant;

use crate::RecordingError;
use crate::file::SCENE_TOPIC;
use crate::file::reading::{RecordedMessage, RecordingReader};

/// Scenes that can be asked for, and their bytes at most.
const SCENES: usize = 64;
const SCENE_BYTES: usize = 256 << 20;
/// Longest time between two messages that is played as long as it was, nanoseconds.
const LONGEST_PAUSE_NS: u64 = 600_000_000_000;
/// By how much a message may be before the one that was written before it, nanoseconds, while the clock goes on.
const OUT_OF_ORDER_NS: u64 = 1_000_000_000;

/// How a recording is played.
#[derive(Debug, Clone, PartialEq)]
pub struct PlaySettings {
    /// The recording's files, in order.
    pub files: Vec<PathBuf>,
    /// How many times as fast as it was.
    pub speed: f64,
}

/// Speeds that a recording may be played at. A little above nothing, and a message would be due later than time can be told.
const SPEEDS: RangeInclusive<f64> = 1e-3..=1e3;

impl PlaySettings {
    fn check(&self) -> Result<(), RecordingError> {
        if SPEEDS.contains(&self.speed) {
            return Ok(());
        }
        let message = format!("expected {} to {}, got {}", SPEEDS.start(), SPEEDS.end(), self.speed);
        Err(RecordingError::Setting { field: "speed", message })
    }
}

/// What was played.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Played {
    /// Messages by kind.
    pub messages: BTreeMap<&'static str, u64>,
    /// From the first to the last, seconds of the recording.
    pub seconds: f64,
    /// Why a file ends early.
    pub cut: Vec<String>,
}

/// Plays a recording into a session's cell, in which nobody else may be alive.
///
/// # Errors
/// `failed_precondition` when somebody is, or when a file cannot be read, or the network refuses.
pub async fn play(session: &Session, settings: &PlaySettings, shutdown: &Shutdown) -> Result<Played, RecordingError> {
    settings.check()?;
    let cell = session.cell().clone();
    let alive = session.watch_alive(&cell.all_lives()).await?.current();
    if let Some((_, service, worker)) = alive.iter().find_map(|key| keys::of_live(key)) {
        let message = format!("cell {} is alive ({service} {worker}): a recording is played into a cell of its own", cell.name());
        return Err(CallError::precondition(message).at("cell").into());
    }
    let scenes = Arc::new(Scenes::default());
    let server = session.start(Service::Perception, scenes.clone()).await?;
    let (timeline, played) = (Timeline::default(), Played::default());
    let mut player = Player { session, cell, scenes, speed: settings.speed, begun: None, timeline, played };
    let mut ended = Ok(());
    for file in &settings.files {
        tokio::select! {
            played = player.file(file) => ended = played,
            () = shutdown.requested() => break,
        }
        if ended.is_err() {
            break;
        }
    }
    server.drain().await;
    ended.map(|()| player.played)
}

struct Player<'a> {
    session: &'a Session,
    cell: Cell,
    scenes: Arc<Scenes>,
    speed: f64,
    /// When the first message was played.
    begun: Option<Instant>,
    timeline: Timeline,
    played: Played,
}

/// How far a recording is, by the clock of the computer that made it. That may have been set meanwhile, as computers without a battery for it do
/// that are told the time after their start.
#[derive(Debug, Default)]
struct Timeline {
    /// When the last message was heard.
    last_ns: Option<u64>,
    since: Duration,
}

impl Timeline {
    /// How long after the first message one comes that was heard then. What nobody would wait for passes at once: a clock that was set, or a cell at
    /// rest.
    fn at(&mut self, at_ns: u64) -> Duration {
        let last_ns = *self.last_ns.get_or_insert(at_ns);
        let (ahead_ns, back_ns) = (at_ns.saturating_sub(last_ns), last_ns.saturating_sub(at_ns));
        if ahead_ns <= LONGEST_PAUSE_NS {
            self.since += Duration::from_nanos(ahead_ns);
        }
        if ahead_ns > 0 || back_ns > OUT_OF_ORDER_NS {
            self.last_ns = Some(at_ns);
        }
        self.since
    }
}

impl Player<'_> {
    async fn file(&mut self, file: &std::path::Path) -> Result<(), RecordingError> {
        let mut reading = RecordingReader::open(file)?;
        while let Some(recorded) = reading.next_message()? {
            // Scenes that are in the next file again say when they came first.
            let is_scene = keys::last_chunk(&recorded.topic) == SCENE_TOPIC;
            let since = if is_scene { self.timeline.since } else { self.timeline.at(recorded.at_ns) };
            let begun = *self.begun.get_or_insert_with(Instant::now);
            tokio::time::sleep_until(begun + since.div_f64(self.speed)).await;
            self.played.seconds = since.as_secs_f64();
            self.message(recorded).await?;
        }
        self.played.cut.extend(reading.cut().map(|reason| format!("{}: {reason}", file.display())));
        Ok(())
    }

    async fn message(&mut self, recorded: RecordedMessage) -> Result<(), RecordingError> {
        let last = keys::last_chunk(&recorded.topic);
        let name = keys::worker_of(&recorded.topic).unwrap_or_default();
        // The recorded cell's keys, in this one.
        let (kind, key, traffic) = match last {
            SCENE_TOPIC => return self.scene(recorded.payload).await,
            "frame" => ("frames", self.cell.camera_frame(name), Traffic::Frame),
            "state" => ("states", self.cell.robot_state(name), Traffic::RobotState),
            "@estop" => ("stops", self.cell.robot_estop(name), Traffic::EmergencyStop),
            _ => match recorded.payload.decode_json::<SceneSummary>() {
                // Announced when the scene itself is there.
                Ok(summary) => {
                    self.scenes.announced(summary);
                    return Ok(());
                }
                // Calls are there to be asked again.
                Err(_) => return Ok(()),
            },
        };
        self.session.put(&key, recorded.payload, traffic).await?;
        self.count(kind);
        Ok(())
    }

    async fn scene(&mut self, payload: Payload) -> Result<(), RecordingError> {
        let decoded = payload.clone();
        let scene = tokio::task::spawn_blocking(move || {
            let scene = Scene::from_bulk(&decoded.decode_bulk(Scene::SCHEMA)?)?;
            Ok::<_, CallError>(scene.summary(scene.id()))
        });
        let summary = match scene.await.map_err(|e| CallError::internal(format!("the scene was lost: {e}")))? {
            Ok(summary) => summary,
            // As a later release may have made it. What else was recorded is played all the same.
            Err(error) => {
                tracing::warn!(%error, "a scene cannot be read and is left out");
                self.count("unreadable");
                return Ok(());
            }
        };
        let Some(summary) = self.scenes.came(summary, payload) else { return Ok(()) };
        let key = self.cell.scene(&summary.camera);
        self.session.put(&key, Payload::json(&summary)?, Traffic::Scene).await?;
        self.count("scenes");
        Ok(())
    }

    fn count(&mut self, kind: &'static str) {
        *self.played.messages.entry(kind).or_default() += 1;
    }
}

/// Answers for perception, from a recording.
struct Scenes {
    whole: SceneStore<Payload>,
    /// The newest scene of each camera, and what was said of each that has not come yet.
    newest: Mutex<BTreeMap<String, Announced>>,
    announced: Mutex<BTreeMap<String, Announced>>,
    /// Announcements so far.
    count: AtomicU64,
}

/// What was said of a scene.
#[derive(Debug, Clone)]
struct Announced {
    summary: SceneSummary,
    /// As which of all announcements.
    number: u64,
}

impl Default for Scenes {
    fn default() -> Self {
        Self {
            whole: SceneStore::new(SCENES, SCENE_BYTES, |payload| payload.bytes.len()),
            newest: Mutex::default(),
            announced: Mutex::default(),
            count: AtomicU64::default(),
        }
    }
}

impl Scenes {
    fn announced(&self, summary: SceneSummary) {
        let mut announced = self.announced.lock().unwrap_or_else(PoisonError::into_inner);
        // Of most announcements the scene was not recorded.
        if announced.len() > SCENES {
            announced.clear();
        }
        let number = self.count.fetch_add(1, Ordering::Relaxed) + 1;
        announced.insert(summary.scene_id.clone(), Announced { summary, number });
    }

    /// Keeps a scene that came; what is said of it, where it is its camera's newest, is what was said when it was recorded, if that is known.
    ///
    /// A scene is recorded whenever somebody asks about it, and again in the next file: it may come long after newer ones.
    fn came(&self, own: SceneSummary, payload: Payload) -> Option<SceneSummary> {
        self.whole.keep(&own.scene_id, Arc::new(payload));
        let announced = self.announced.lock().unwrap_or_else(PoisonError::into_inner).remove(&own.scene_id);
        let mut newest = self.newest.lock().unwrap_or_else(PoisonError::into_inner);
        let before = newest.get(&own.camera);
        let is_newest = match &announced {
            Some(own) => before.is_none_or(|before| before.number < own.number),
            None => before.is_none_or(|before| before.summary.stamp_ns <= own.stamp_ns),
        };
        if !is_newest {
            return None;
        }
        let number = before.map_or(0, |before| before.number);
        let kept = announced.unwrap_or(Announced { summary: own, number });
        let summary = kept.summary.clone();
        newest.insert(summary.camera.clone(), kept);
        Some(summary)
    }
}

#[async_trait]
impl Handler for Scenes {
    async fn call(&self, call: Call) -> Result<Payload, CallError> {
        match call.method.as_str() {
            "latest" => {
                let LatestRequest { camera } = call.payload.decode_json()?;
                let newest = self.newest.lock().unwrap_or_else(PoisonError::into_inner).get(&camera).map(|newest| newest.summary.clone());
                let missing = || CallError::not_found("camera", format!("no scene of camera {camera:?} has been played yet"));
                Payload::json(&newest.ok_or_else(missing)?)
            }
            "scene" => {
                let request: SceneRequest = call.payload.decode_json()?;
                request.answer(self.whole.get(&request.scene_id)?.as_ref())
            }
            _ => Err(call.unknown_method()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn summary(scene_id: &str, stamp_ns: u64) -> SceneSummary {
        SceneSummary {
            scene_id: scene_id.to_owned(),
            camera: "front".to_owned(),
            stamp_ns,
            objects: Vec::new(),
            surfaces: Vec::new(),
            left_out: Vec::new(),
            warnings: Vec::new(),
        }
    }

    #[test]
    fn a_recording_is_played_on_where_the_clock_was_set_while_it_was_made() {
        const S: u64 = 1_000_000_000;
        let set = 1_700_000_000 * S;
        let mut timeline = Timeline::default();
        for (at_ns, since_ms) in [
            (5 * S, 0),
            (6 * S, 1000),
            (6 * S - 1, 1000),
            (7 * S, 2000),
            // It is told the time, and that an hour later once more.
            (set, 2000),
            (set + S, 3000),
            (set - 3600 * S, 3000),
            (set - 3600 * S + S / 2, 3500),
        ] {
            assert_eq!(timeline.at(at_ns), Duration::from_millis(since_ms), "{at_ns}");
        }
    }

    #[test]
    fn a_scene_that_comes_after_newer_ones_can_be_asked_for_and_is_not_the_newest() {
        let scenes = Scenes::default();
        let came = |scene_id: &str, stamp_ns: u64| {
            let payload = Payload { encoding: String::new(), bytes: Vec::new().into() };
            scenes.came(summary(scene_id, stamp_ns), payload).map(|summary| summary.scene_id)
        };
        let is_newest = |scene_id: &str| scenes.newest.lock().unwrap()["front"].summary.scene_id == scene_id;
        ["a", "b", "c"].iter().zip(1..).for_each(|(scene_id, stamp_ns)| scenes.announced(summary(scene_id, stamp_ns)));
        assert_eq!((came("a", 1), came("c", 3)), (Some("a".to_owned()), Some("c".to_owned())));
        // One that was asked about late, and one that the next file holds again.
        assert_eq!((came("b", 2), came("a", 1)), (None, None));
        assert!(is_newest("c") && ["a", "b", "c"].iter().all(|scene_id| scenes.whole.get(scene_id).is_ok()));
        // A clock that was set back: what is announced later is newer.
        scenes.announced(summary("d", 0));
        assert_eq!(came("d", 0), Some("d".to_owned()));
        // Nobody announced it, as scenes that a caller had made.
        assert_eq!(came("e", 4), Some("e".to_owned()));
        assert!(is_newest("e"));
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_scene_that_cannot_be_read_is_left_out_and_said() {
        let session = Session::embedded().await.expect("a session");
        let (cell, scenes) = (session.cell().clone(), Arc::<Scenes>::default());
        let (timeline, played) = (Timeline::default(), Played::default());
        let mut player = Player { session: &session, cell, scenes, speed: 1.0, begun: None, timeline, played };
        let topic = format!("repose/v1/lab/{SCENE_TOPIC}");
        let payload = Payload { encoding: "application/octet-stream;repose.Scene.v1".to_owned(), bytes: vec![0; 64].into() };
        player.message(RecordedMessage { topic, at_ns: 0, payload }).await.expect("the next message is played");
        assert_eq!(player.played.messages, BTreeMap::from([("unreadable", 1)]));
    }

    #[test]
    fn a_speed_at_which_messages_are_never_due_is_refused() {
        let check = |speed: f64| PlaySettings { files: Vec::new(), speed }.check();
        assert!([0.001, 0.5, 1.0, 1000.0].into_iter().all(|speed| check(speed).is_ok()));
        for speed in [0.0, -1.0, 1e-30, 1e4, f64::NAN] {
            assert!(matches!(check(speed), Err(RecordingError::Setting { field: "speed", .. })), "{speed}");
        }
    }
}
