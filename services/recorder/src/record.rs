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
use repose_proto::{ErrorCode, JournalEntry, JournalKind, SceneSummary, Service, keys};
use repose_runtime::{
    COPIES_WAIT, CallOptions, CancellationToken, CellCallers, SCENE_WITHIN, Sample, Session, Shutdown, fetch_scene_payload, now_ns,
    yield_to_messages,
};
use tokio::runtime::Handle;
use tokio::sync::{mpsc, oneshot};
use tokio::time::{Instant, MissedTickBehavior};

use crate::RecordingError;
use crate::asked_for::AskedFor;
use crate::calls::scene_asked_about;
use crate::copies::CopyNumbers;
use crate::file::parts::RecordingFiles;
use crate::heard::{Heard, Message};
use crate::lost::LostMessages;
use crate::outages::Outages;
use crate::settings::RecordSettings;
use crate::writer::{Captured, Summary, Writer};

/// Messages that may wait for the file.
const FOR_FILE: usize = 1024;
/// How long scenes that are on their way may still take when the recording has ended.
const LAST_SCENES: Duration = Duration::from_secs(5);
/// Loads of workers that may wait to be taken before a recording begins.
const LOADS: usize = 4096;
/// How often the connection is looked at; what comes and goes between is seen by its number.
const LOOK: Duration = Duration::from_millis(200);
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
    let mut capture = Capture::of(session, settings, to_file, lost.clone());
    let late = capture.late.clone();
    let writer = Writer::new(parts, topic, looks, lost.clone(), capture.turns.clone());
    let mut writing = begin_writing(writer, captured, chunk_period);

    let connection = || session.transport().connection();
    let mut outages = Outages::after(connection(), now_ns(), lost.clone());
    let mut heard = Heard::of(session).await?;
    let mut recorder = Some(session.transport().declare_alive(&cell.live_recorder(&uuid::Uuid::new_v4().to_string())).await?);
    begun(&silent(session).await?);
    let mut look = tokio::time::interval(LOOK);
    look.set_missed_tick_behavior(MissedTickBehavior::Delay);
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
            _ = look.tick() => outages.look(connection(), now_ns()),
            () = shutdown.requested(), if last.is_none() => {
                recorder = None;
                last = Some(Instant::now() + 2 * COPIES_WAIT);
            }
            () = tokio::time::sleep_until(over), if last.is_some() => break None,
        }
    };
    drop(recorder);
    outages.finish(connection(), now_ns());
    heard.count_dropped(&lost, capture.copies.missing());
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
    let mut loads = session.subscribe_queue(&session.cell().all_loads(), LOADS).await?;
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
    copies: CopyNumbers,
    asked_for: Arc<Mutex<AskedFor>>,
    /// How often the writer has turned to the next file.
    turns: Arc<AtomicUsize>,
    /// Gives up the scenes that are on their way.
    late: CancellationToken,
}

impl Capture {
    /// Of a session's cell; what finds no room on its way to the file is counted in `lost`.
    fn of(session: &Session, settings: RecordSettings, to_file: mpsc::Sender<Captured>, lost: LostMessages) -> Self {
        Self {
            perceptions: Arc::new(CellCallers::new(session.clone(), Service::Perception)),
            to_file,
            settings,
            frame_due: BTreeMap::new(),
            picture_due: BTreeMap::new(),
            scene_due: BTreeMap::new(),
            copies: CopyNumbers::default(),
            asked_for: Arc::new(Mutex::new(AskedFor::counting(lost.clone()))),
            lost,
            turns: Arc::default(),
            late: CancellationToken::new(),
        }
    }

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
                if let Ok(JournalEntry { seq, kind, payload, cell, .. }) = entry {
                    self.count_missing(&sample.key, seq);
                    if kind == JournalKind::Call
                        && let Some(scene_id) = scene_asked_about(&payload)
                    {
                        self.fetch(scene_id, cell);
                    }
                }
                self.keep("calls", sample, true);
            }
        }
    }

    /// Counts the copies before one that did not come. What comes and does not reach the file is counted where it is dropped.
    fn count_missing(&mut self, journal: &str, seq: u64) {
        let missing = self.copies.came(journal, seq);
        if missing > 0 {
            tracing::warn!(journal, missing, before = seq, "copies of calls did not come");
            self.lost.add("calls", missing);
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

#[cfg(test)]
mod tests {
    use std::path::Path;

    use async_trait::async_trait;
    use repose_proto::{CallError, Payload};
    use repose_runtime::{Call, Handler, RuntimeConfig, SessionMode};

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

    /// A worker's copy, as it comes over the wire.
    fn copy(session: &Session, seq: u64) -> Sample {
        let payload = Payload { encoding: String::new(), bytes: Vec::new().into() };
        let entry = JournalEntry { seq, stamp_ns: 0, kind: JournalKind::Reply, cell: None, attachment: "{}".to_owned(), payload };
        let payload = Payload::bulk(JournalEntry::SCHEMA, &entry.to_bulk()).expect("small");
        Sample { key: session.cell().journal(Service::Planner, "w"), payload }
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_copy_is_lost_once_whether_it_does_not_come_or_does_not_reach_the_file() {
        let session = Session::embedded().await.expect("a session");
        let folder = tempfile::tempdir().expect("a folder");
        let settings = RecordSettings::new(folder.path().join("run.mcap"));
        let (lost, (to_file, mut on_its_way)) = (LostMessages::default(), mpsc::channel(1));
        let mut capture = Capture::of(&session, settings.clone(), to_file, lost.clone());
        let (for_file, captured) = mpsc::channel(FOR_FILE);
        // Where two come at once there is no room for the second; number 3 does not come.
        for at_once in [&[0, 1][..], &[2], &[4]] {
            at_once.iter().for_each(|seq| capture.take(Message::Journal(copy(&session, *seq))));
            for_file.try_send(on_its_way.try_recv().expect("the first")).expect("room");
        }
        drop(for_file);
        let parts = RecordingFiles::begin(settings, BTreeMap::new()).expect("a file");
        let writer = Writer::new(parts, crate::file::SCENE_TOPIC.to_owned(), true, lost, capture.turns.clone());
        let written = begin_writing(writer, captured, Duration::from_secs(1)).await.expect("its end").expect("written");
        assert_eq!((written.messages, written.lost), (BTreeMap::from([("calls", 3)]), BTreeMap::from([("calls", 2)])));
    }

    async fn router(endpoint: &str) -> Session {
        let mut config = RuntimeConfig::default();
        (config.session.mode, config.session.listen) = (SessionMode::Router, vec![endpoint.to_owned()]);
        loop {
            // The port is free a moment after its last owner has closed.
            if let Ok(router) = Session::open(config.clone()).await {
                return router;
            }
            tokio::task::yield_now().await;
        }
    }

    /// Waits until a session's connection is up, or down.
    async fn until(session: &Session, is_up: bool) {
        while session.transport().connection().is_up != is_up {
            tokio::task::yield_now().await;
        }
    }

    /// What the file's end says of outages.
    fn told_outages(file: &Path) -> Vec<[u64; 2]> {
        let bytes = std::fs::read(file).expect("the file");
        let records = mcap::read::LinearReader::new(&bytes).expect("a recording").map(|record| record.expect("readable"));
        let mut outages = records.filter_map(|record| match record {
            mcap::records::Record::Metadata(told) => told.metadata.get("outages_ns").cloned(),
            _ => None,
        });
        serde_json::from_str(&outages.next().expect("an entry")).expect("pairs of instants")
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn an_outage_of_the_router_is_counted_and_the_file_says_when_it_was() {
        let address = std::net::TcpListener::bind("127.0.0.1:0").and_then(|listener| listener.local_addr()).expect("a free port");
        let endpoint = format!("tcp/{address}");
        let first = router(&endpoint).await;
        let mut config = RuntimeConfig::default();
        (config.session.mode, config.session.connect) = (SessionMode::Client, vec![endpoint.clone()]);
        let session = Session::open(config).await.expect("a session");
        let folder = tempfile::tempdir().expect("a folder");
        let out = folder.path().join("run.mcap");
        let (shutdown, (begun, has_begun)) = (Shutdown::new(), oneshot::channel());
        let recording = record(&session, RecordSettings::new(out.clone()), &shutdown, |_| {
            let _waited_for = begun.send(());
        });
        let outage = async {
            has_begun.await.expect("it begins");
            first.close().await.expect("closed");
            until(&session, false).await;
            let second = router(&endpoint).await;
            until(&session, true).await;
            shutdown.trigger();
            second
        };
        let (recorded, _second) = tokio::join!(recording, outage);
        assert_eq!(recorded.expect("a recording").lost, BTreeMap::from([("outages", 1)]));
        assert!(matches!(told_outages(&out)[..], [[since, until]] if since < until));
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
}
