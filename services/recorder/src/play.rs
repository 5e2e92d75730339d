//! Playing a recording: the cell as it was, in time, for whatever looks at cells.
//!
//! Pictures, robot states and stops are put again as they were. Scenes come from a perception worker that answers from the recording, and each is
//! announced when it is there, so that viewers may fetch what they are told of.

use std::collections::BTreeMap;
use std::ops::RangeInclusive;
use std::path::PathBuf;
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
    let mut player = Player { session, cell, scenes, speed: settings.speed, begun: None, played: Played::default() };
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
    /// When the first message was played, and when it was recorded.
    begun: Option<(Instant, u64)>,
    played: Played,
}

impl Player<'_> {
    async fn file(&mut self, file: &std::path::Path) -> Result<(), RecordingError> {
        let mut reading = RecordingReader::open(file)?;
        while let Some(recorded) = reading.next_message()? {
            let (begun, first_ns) = *self.begun.get_or_insert((Instant::now(), recorded.at_ns));
            let since = Duration::from_nanos(recorded.at_ns.saturating_sub(first_ns));
            tokio::time::sleep_until(begun + since.div_f64(self.speed)).await;
            self.played.seconds = self.played.seconds.max(since.as_secs_f64());
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
        let summary = scene.await.map_err(|e| CallError::internal(format!("the scene was lost: {e}")))??;
        let summary = self.scenes.came(summary, payload);
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
    newest: Mutex<BTreeMap<String, SceneSummary>>,
    announced: Mutex<BTreeMap<String, SceneSummary>>,
}

impl Default for Scenes {
    fn default() -> Self {
        Self {
            whole: SceneStore::new(SCENES, SCENE_BYTES, |payload| payload.bytes.len()),
            newest: Mutex::default(),
            announced: Mutex::default(),
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
        announced.insert(summary.scene_id.clone(), summary);
    }

    /// Keeps a scene that came; what is said of it is what was said when it was recorded, where that is known.
    fn came(&self, own: SceneSummary, payload: Payload) -> SceneSummary {
        let announced = self.announced.lock().unwrap_or_else(PoisonError::into_inner).remove(&own.scene_id);
        let summary = announced.unwrap_or(own);
        self.whole.keep(&summary.scene_id, Arc::new(payload));
        self.newest.lock().unwrap_or_else(PoisonError::into_inner).insert(summary.camera.clone(), summary.clone());
        summary
    }
}

#[async_trait]
impl Handler for Scenes {
    async fn call(&self, call: Call) -> Result<Payload, CallError> {
        match call.method.as_str() {
            "latest" => {
                let LatestRequest { camera } = call.payload.decode_json()?;
                let newest = self.newest.lock().unwrap_or_else(PoisonError::into_inner).get(&camera).cloned();
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

    #[test]
    fn a_speed_at_which_messages_are_never_due_is_refused() {
        let check = |speed: f64| PlaySettings { files: Vec::new(), speed }.check();
        assert!([0.001, 0.5, 1.0, 1000.0].into_iter().all(|speed| check(speed).is_ok()));
        for speed in [0.0, -1.0, 1e-30, 1e4, f64::NAN] {
            assert!(matches!(check(speed), Err(RecordingError::Setting { field: "speed", .. })), "{speed}");
        }
    }
}
