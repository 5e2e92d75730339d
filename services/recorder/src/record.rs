//! Recording a running cell: what is put is heard, calls are copied by the workers, and scenes are fetched from perception.
//!
//! Async code only listens. One thread owns the file: it encodes pictures, compresses and writes. What it cannot take in time is dropped where it is
//! heard, and counted: a recording slows nobody down, and says what it lacks.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use repose_proto::load::WorkerLoad;
use repose_proto::perception::SceneRequest;
use repose_proto::{ErrorCode, JournalEntry, JournalKind, Payload, SceneSummary, Service, keys};
use repose_runtime::{
    COPIES_WAIT, CallOptions, CancellationToken, CellCallers, SCENE_WITHIN, Sample, Session, Shutdown, Subscription, fetch_scene_payload,
    now_ns, yield_to_messages,
};
use tokio::runtime::Handle;
use tokio::sync::{mpsc, oneshot};
use tokio::time::Instant;

use crate::RecordingError;
use crate::file::parts::RecordingFiles;
use crate::lost::LostMessages;
use crate::settings::RecordSettings;
use crate::writer::{Captured, Summary, Writer};

/// Messages of each kind that may wait to be taken.
const WAITING: usize = 4096;
/// Pictures that may: they are large.
const PICTURES: usize = 16;
/// Messages that may wait for the file.
const FOR_FILE: usize = 1024;
/// How long scenes that are on their way may still take when the recording has ended.
const LAST_SCENES: Duration = Duration::from_secs(5);
/// How long workers may take to begin their journals before it is said who has not.
const JOURNALS_WITHIN: Duration = Duration::from_secs(2);

/// Records a session's cell until `shutdown`. `begun` is told when every worker that is alive copies its calls, or of those that do not.
///
/// # Errors
/// When a setting is out of range, a file cannot be written, or the network refuses.
pub async fn record(
    session: &Session,
    settings: RecordSettings,
    shutdown: &Shutdown,
    begun: impl FnOnce(&[String]),
) -> Result<Summary, RecordingError> {
    let cell = session.cell().clone();
    let about = BTreeMap::from([
        ("cell".to_owned(), cell.name().to_owned()),
        ("version".to_owned(), env!("CARGO_PKG_VERSION").to_owned()),
        ("started_ns".to_owned(), now_ns().to_string()),
    ]);
    let (to_file, captured) = mpsc::channel(FOR_FILE);
    let parts = RecordingFiles::begin(settings.clone(), about)?;
    let (chunk_period, looks) = (settings.chunk_period, settings.looks);
    let topic = format!("repose/v1/{}/{}", cell.name(), crate::file::SCENE_TOPIC);
    let lost = LostMessages::default();
    let turns = Arc::<AtomicUsize>::default();
    let writer = Writer::new(parts, topic, looks, lost.clone(), turns.clone());
    let mut writing = begin_writing(writer, captured, chunk_period);

    let subscribe = async |key: String, room: usize| session.subscribe_queue(&key, room).await;
    let mut heard = Heard {
        frames: subscribe(cell.camera_frames(), PICTURES).await?,
        scenes: subscribe(cell.scenes(), WAITING).await?,
        states: subscribe(cell.robot_states(), WAITING).await?,
        stops: subscribe(cell.robot_estops(), WAITING).await?,
        journals: subscribe(cell.journals(), WAITING).await?,
    };
    let late = CancellationToken::new();
    let mut capture = Capture {
        perceptions: Arc::new(CellCallers::new(session.clone(), Service::Perception)),
        to_file,
        settings,
        lost: lost.clone(),
        frame_due: BTreeMap::new(),
        picture_due: BTreeMap::new(),
        scene_due: BTreeMap::new(),
        asked_for: Arc::new(Mutex::new(AskedFor::counting(lost.clone()))),
        turns,
        late: late.clone(),
    };
    let mut recorder = Some(session.transport().declare_alive(&cell.live_recorder(&uuid::Uuid::new_v4().to_string())).await?);
    begun(&silent(session).await?);
    // After the shutdown: until when the copies made before it are waited for.
    let mut last = None;
    let early = loop {
        let over = last.unwrap_or_else(Instant::now);
        tokio::select! {
            sample = heard.next() => match sample {
                Some(sample) => capture.take(sample),
                None => break None,
            },
            // The file failed: nothing can be recorded any more.
            written = &mut writing => break Some(written),
            () = shutdown.requested(), if last.is_none() => {
                recorder = None;
                last = Some(Instant::now() + 2 * COPIES_WAIT);
            }
            () = tokio::time::sleep_until(over), if last.is_some() => break None,
        }
    };
    drop(recorder);
    heard.count_dropped(&lost);
    // The last sender, but for the scenes on their way: the writer ends its file when it has taken what waits.
    drop(capture);
    let written = match early {
        Some(written) => written,
        None => last_written(&mut writing, &late).await,
    };
    written.map_err(|e| repose_proto::CallError::internal(format!("the writer was lost: {e}")))?
}

/// Has a thread write: one that lets all others go first, for what it computes can wait and what a cell computes cannot.
fn begin_writing(
    writer: Writer,
    captured: mpsc::Receiver<Captured>,
    chunk_period: Duration,
) -> oneshot::Receiver<Result<Summary, RecordingError>> {
    let (ended, writing) = oneshot::channel();
    let runtime = Handle::current();
    std::thread::spawn(move || {
        // To those that carry messages, and to those that compute, which have yielded once.
        yield_to_messages();
        yield_to_messages();
        let _entered = runtime.enter();
        // Nobody waits for it where recording was given up.
        drop(ended.send(writer.run(captured, chunk_period)));
    });
    writing
}

/// Waits for the writer. Scenes on their way, which keep it from its end, are given up after a while: a perception that hangs, or a router that is gone,
/// would keep it for as long as a scene may take.
async fn last_written<T>(writing: &mut oneshot::Receiver<T>, late: &CancellationToken) -> Result<T, oneshot::error::RecvError> {
    match tokio::time::timeout(LAST_SCENES, &mut *writing).await {
        Ok(written) => written,
        Err(_) => {
            late.cancel();
            writing.await
        }
    }
}

/// The workers alive in the cell that do not copy their calls, after some time. Those of its pool are not among them: they copy calls for whoever
/// records the pool.
async fn silent(session: &Session) -> Result<Vec<String>, RecordingError> {
    let mut callers = Vec::new();
    for service in Service::ALL.into_iter().filter(|service| session.pool().is_none() || !service.is_poolable()) {
        callers.push((service, session.caller(service).await?));
    }
    let mut loads = session.subscribe_queue(&session.cell().all_loads(), WAITING).await?;
    let mut journals = BTreeSet::new();
    let give_up = Instant::now() + JOURNALS_WITHIN;
    loop {
        let waiting: Vec<String> = callers
            .iter()
            .flat_map(|(service, caller)| caller.workers().into_iter().map(move |worker| format!("{service} {}", worker.name)))
            .filter(|worker| !journals.contains(worker))
            .collect();
        if waiting.is_empty() {
            return Ok(waiting);
        }
        let Ok(Some(sample)) = tokio::time::timeout_at(give_up, loads.recv()).await else { return Ok(waiting) };
        let told = sample.payload.decode_json::<WorkerLoad>();
        if let (Some((service, worker)), Ok(true)) = (keys::of_load(&sample.key), told.map(|load| load.journals)) {
            journals.insert(format!("{service} {worker}"));
        }
    }
}

/// What is put in a cell.
struct Heard {
    frames: Subscription,
    scenes: Subscription,
    states: Subscription,
    stops: Subscription,
    journals: Subscription,
}

/// A message by what it is.
enum Message {
    Frame(Sample),
    Scene(Sample),
    Other(&'static str, Sample),
    Journal(Sample),
}

impl Heard {
    async fn next(&mut self) -> Option<Message> {
        tokio::select! {
            frame = self.frames.recv() => frame.map(Message::Frame),
            scene = self.scenes.recv() => scene.map(Message::Scene),
            state = self.states.recv() => state.map(|state| Message::Other("states", state)),
            stop = self.stops.recv() => stop.map(|stop| Message::Other("stops", stop)),
            journal = self.journals.recv() => journal.map(Message::Journal),
        }
    }

    /// Counts what came faster than it was taken.
    fn count_dropped(&self, lost: &LostMessages) {
        let Self { frames, scenes, states, stops, journals } = self;
        for (kind, heard) in [("frames", frames), ("summaries", scenes), ("states", states), ("stops", stops), ("calls", journals)] {
            lost.add(kind, heard.dropped());
        }
    }
}

/// Decides what is kept of what is heard, and fetches scenes.
struct Capture {
    /// Those of the cells that calls are for: a pool has no perception, and the scenes that its planners are asked about are of others.
    perceptions: Arc<CellCallers>,
    to_file: mpsc::Sender<Captured>,
    settings: RecordSettings,
    lost: LostMessages,
    frame_due: BTreeMap<String, Instant>,
    picture_due: BTreeMap<String, Instant>,
    scene_due: BTreeMap<String, Instant>,
    asked_for: Arc<Mutex<AskedFor>>,
    /// How often the writer has turned to the next file.
    turns: Arc<AtomicUsize>,
    /// Gives up the scenes that are on their way.
    late: CancellationToken,
}

/// Ids of scenes that are remembered as fetched, and as lost; then all are forgotten and may be fetched again.
const REMEMBERED: usize = 4096;

/// What is known of the scenes that are asked for.
#[derive(Default)]
struct AskedFor {
    /// Scenes that were fetched already, or are being fetched, with the file that was open then.
    files: BTreeMap<String, usize>,
    /// Scenes that could not be fetched, and are counted as lost.
    missing: BTreeSet<String>,
    lost: LostMessages,
}

impl AskedFor {
    /// Nothing yet; scenes that do not come are counted in `lost`.
    fn counting(lost: LostMessages) -> Self {
        Self { lost, ..Self::default() }
    }

    /// Takes note that somebody asks about a scene while a file is open; which file was, where somebody has before.
    fn again(&mut self, scene_id: &str, file: usize) -> Option<usize> {
        if self.files.len() >= REMEMBERED {
            self.files.clear();
        }
        self.files.insert(scene_id.to_owned(), file)
    }

    /// Takes note that a scene has come: if it was lost before, it is not.
    fn came(&mut self, scene_id: &str) {
        if self.missing.remove(scene_id) {
            self.lost.found("scenes");
        }
    }

    /// Takes note that a scene could not be fetched: it is lost, and tried again when it is asked about next. One that nobody has is not lost here,
    /// and stays noted: whoever asked about it may have sent it along, and then it is in the recording with the call.
    fn failed(&mut self, scene_id: &str, code: ErrorCode) {
        if code == ErrorCode::NotFound {
            return;
        }
        self.files.remove(scene_id);
        if self.missing.len() >= REMEMBERED {
            self.missing.clear();
        }
        if self.missing.insert(scene_id.to_owned()) {
            self.lost.add("scenes", 1);
        }
    }
}

impl Capture {
    fn take(&mut self, message: Message) {
        match message {
            Message::Frame(sample) => {
                if is_due(&mut self.frame_due, &sample.key, self.settings.frame_period) {
                    let is_drawn = is_due(&mut self.picture_due, &sample.key, self.settings.picture_period);
                    self.keep("frames", sample, is_drawn);
                }
            }
            Message::Scene(sample) => {
                if let Ok(summary) = sample.payload.decode_json::<SceneSummary>()
                    && is_due(&mut self.scene_due, &sample.key, self.settings.scene_period)
                {
                    self.fetch(summary.scene_id, None);
                }
                self.keep("summaries", sample, false);
            }
            Message::Other(kind, sample) => self.keep(kind, sample, true),
            Message::Journal(sample) => {
                let entry = sample.payload.decode_bulk(JournalEntry::SCHEMA).and_then(|bulk| JournalEntry::from_bulk(&bulk));
                if let Ok(JournalEntry { kind: JournalKind::Call, payload, cell, .. }) = entry
                    && let Some(scene_id) = scene_asked_about(&payload)
                {
                    self.fetch(scene_id, cell);
                }
                self.keep("calls", sample, true);
            }
        }
    }

    fn keep(&self, kind: &'static str, sample: Sample, is_drawn: bool) {
        hand_over(&self.to_file, &self.lost, kind, Captured::Sample { kind, sample, at_ns: now_ns(), is_drawn });
    }

    /// Fetches a scene from a cell, the recorded one where none is named, once a file: of those in the files before, the writer has the last few at hand
    /// and no others.
    fn fetch(&mut self, scene_id: String, cell: Option<String>) {
        let file = self.turns.load(Ordering::Relaxed);
        let before = self.asked_for.lock().unwrap_or_else(PoisonError::into_inner).again(&scene_id, file);
        if before.is_some() {
            // The file may be another one by now.
            hand_over(&self.to_file, &self.lost, "scenes", Captured::Asked { scene_id: scene_id.clone() });
        }
        if before == Some(file) {
            return;
        }
        let (perceptions, to_file, asked_for) = (self.perceptions.clone(), self.to_file.clone(), self.asked_for.clone());
        let options = CallOptions { cancel: self.late.clone(), ..CallOptions::within(SCENE_WITHIN) };
        tokio::spawn(async move {
            // As it is read again: not packed.
            let request = SceneRequest::new(scene_id.clone());
            let fetched = async { fetch_scene_payload(&perceptions.in_cell(cell.as_deref()).await?, &request, &options).await }.await;
            let mut asked_for = asked_for.lock().unwrap_or_else(PoisonError::into_inner);
            match fetched {
                Ok(payload) => {
                    let captured = Captured::Scene { scene_id: scene_id.clone(), payload, at_ns: now_ns() };
                    // It does not wait for room: while a disk stalls, scenes of megabytes would gather here without end.
                    match to_file.try_send(captured) {
                        Ok(()) => asked_for.came(&scene_id),
                        Err(_) => asked_for.failed(&scene_id, ErrorCode::ResourceExhausted),
                    }
                }
                Err(error) => {
                    match error.code {
                        ErrorCode::NotFound => tracing::debug!(scene_id, %error, "nobody has a scene any more"),
                        _ => tracing::warn!(scene_id, %error, "a scene cannot be fetched and is not in the recording"),
                    }
                    asked_for.failed(&scene_id, error.code);
                }
            }
        });
    }
}

/// Gives something to the file; where that has no room for it, it is lost.
fn hand_over(to_file: &mpsc::Sender<Captured>, lost: &LostMessages, kind: &'static str, captured: Captured) {
    if to_file.try_send(captured).is_err() {
        lost.add(kind, 1);
    }
}

/// Whether the next message of a key may be kept, and from when on the one after it.
fn is_due(due: &mut BTreeMap<String, Instant>, key: &str, period: Duration) -> bool {
    let now = Instant::now();
    match due.get_mut(key) {
        Some(at) if *at > now => false,
        // A message that comes a little early is not left out for it: the pace is kept, not the gap.
        Some(at) => {
            *at = (*at + period).max(now + period / 2);
            true
        }
        None => {
            due.insert(key.to_owned(), now + period);
            true
        }
    }
}

/// The scene that a request names, where it does not enclose it.
fn scene_asked_about(payload: &Payload) -> Option<String> {
    if payload.is_bulk() {
        return None;
    }
    let request: serde_json::Value = serde_json::from_slice(&payload.bytes).ok()?;
    Some(request.get("scene")?.get("scene_id")?.as_str()?.to_owned())
}

#[cfg(test)]
mod tests {
    use async_trait::async_trait;
    use repose_proto::CallError;
    use repose_runtime::{Call, Handler, RuntimeConfig};

    use super::*;

    struct Idle;

    #[async_trait]
    impl Handler for Idle {
        async fn call(&self, call: Call) -> Result<Payload, CallError> {
            Err(call.unknown_method())
        }
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_pools_workers_are_not_taken_for_some_that_cannot_copy_calls() {
        let mut config = RuntimeConfig::default();
        config.caller.pool = Some("rack".to_owned());
        let session = Session::open(config).await.expect("a session");
        let rack = session.in_cell("rack").expect("a cell");
        let _planner = rack.start(Service::Planner, Arc::new(Idle)).await.expect("a worker");
        session.caller(Service::Planner).await.expect("a caller").wait_for_workers(1, SCENE_WITHIN).await.expect("it is seen");
        assert_eq!(silent(&session).await.expect("heard"), Vec::<String>::new());
    }

    #[tokio::test(start_paused = true)]
    async fn a_scene_that_does_not_come_does_not_keep_a_recording_from_its_end() {
        let (late, (ended, mut writing)) = (CancellationToken::new(), oneshot::channel());
        let given_up = late.clone();
        tokio::spawn(async move {
            // As the writer does while a scene may come.
            given_up.cancelled().await;
            let _heard = ended.send("written");
        });
        assert_eq!(last_written(&mut writing, &late).await, Ok("written"));
    }

    #[test]
    fn a_scene_is_fetched_again_for_each_file_in_which_somebody_asks_about_it() {
        let mut asked_for = AskedFor::default();
        let files = [0, 0, 0, 1, 1, 3];
        let fetched = files.map(|file| asked_for.again("one", file) != Some(file));
        assert_eq!(fetched, [true, false, false, true, false, true]);
        assert_eq!(asked_for.again("another", 3), None, "nobody has before");
    }

    #[test]
    fn a_scene_that_did_not_come_is_fetched_again_when_it_is_asked_about_next_and_one_that_nobody_has_is_not() {
        let mut asked_for = AskedFor::default();
        for (scene, code, next) in [("busy", ErrorCode::ResourceExhausted, None), ("forgotten", ErrorCode::NotFound, Some(0))] {
            asked_for.again(scene, 0);
            asked_for.failed(scene, code);
            assert_eq!(asked_for.again(scene, 0), next, "{scene}");
        }
    }

    #[test]
    fn a_scene_that_cannot_be_fetched_is_lost_until_it_comes_after_all() {
        let lost = LostMessages::default();
        let mut asked_for = AskedFor::counting(lost.clone());
        let counted = || lost.by_kind().get("scenes").copied();
        // Perception is away. That nobody has a scene is no loss: it may be in a call.
        for (scene, code) in [("one", ErrorCode::Unavailable), ("one", ErrorCode::DeadlineExceeded), ("two", ErrorCode::Unavailable)] {
            asked_for.failed(scene, code);
        }
        asked_for.failed("three", ErrorCode::NotFound);
        assert_eq!(counted(), Some(2));
        for scene in ["one", "one", "three", "two"] {
            asked_for.came(scene);
        }
        assert_eq!(counted(), None);
        (0..3 * REMEMBERED).for_each(|scene| asked_for.failed(&scene.to_string(), ErrorCode::Unavailable));
        assert!(counted() == Some(3 * REMEMBERED as u64) && asked_for.missing.len() <= REMEMBERED);
    }

    #[test]
    fn what_the_file_has_no_room_for_is_counted_and_waits_for_none() {
        let ((to_file, mut captured), lost) = (mpsc::channel(1), LostMessages::default());
        let scene = || {
            let payload = Payload { encoding: String::new(), bytes: Vec::new().into() };
            Captured::Scene { scene_id: "one".to_owned(), payload, at_ns: 0 }
        };
        (0..2).for_each(|_| hand_over(&to_file, &lost, "scenes", scene()));
        assert!(captured.try_recv().is_ok() && captured.try_recv().is_err());
        assert_eq!(lost.by_kind(), BTreeMap::from([("scenes", 1)]));
    }

    #[test]
    fn what_is_remembered_of_scenes_is_bounded() {
        let mut asked_for = AskedFor::default();
        for scene in 0..3 * REMEMBERED {
            asked_for.again(&scene.to_string(), 0);
        }
        assert!(asked_for.files.len() <= REMEMBERED);
    }
}
