//! The thread that owns a recording's file: adds what is looked at, writes both, and turns to the next file.

use std::collections::{BTreeMap, BTreeSet};
use std::num::NonZeroUsize;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use lru::LruCache;
use repose_proto::{Frame, JournalEntry, JournalKind, Payload, PlaceResult, ReplyAttachment, ReplyKind, Scene, keys};
use repose_runtime::{Sample, read_robot_state};
use tokio::runtime::Handle;
use tokio::sync::mpsc;
use tokio::time::{Instant, timeout_at};

use crate::RecordingError;
use crate::file::parts::{RecordingFiles, RecordingReport};
use crate::look::{Looker, VisualMessage};
use crate::lost::LostMessages;

/// Scenes kept to be written into the next file, too, where somebody asks about them there.
const SCENES: NonZeroUsize = NonZeroUsize::new(8).expect("above 0");

/// What a recording holds, in numbers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Summary {
    /// Its files.
    pub written: RecordingReport,
    /// Messages by kind: `frames`, `scenes`, `states`, `stops`, `calls`, ….
    pub messages: BTreeMap<&'static str, u64>,
    /// Messages that were heard, or announced, and are not in it, by the same kinds; and `outages` of the router, during which nothing was heard.
    pub lost: BTreeMap<&'static str, u64>,
}

/// Something for the file.
pub enum Captured {
    /// A message that was put.
    Sample {
        /// What it counts as.
        kind: &'static str,
        /// The message.
        sample: Sample,
        /// When it was heard.
        at_ns: u64,
        /// Whether it is to be looked at, too.
        is_drawn: bool,
    },
    /// A whole scene.
    Scene {
        /// Its id.
        scene_id: String,
        /// The scene, in bulk form.
        payload: Payload,
        /// When it came.
        at_ns: u64,
    },
    /// A scene that has been fetched before is asked about again.
    Asked {
        /// Its id.
        scene_id: String,
    },
}

/// Writes what is captured.
pub struct Writer {
    parts: RecordingFiles,
    scene_topic: String,
    looker: Option<Looker>,
    /// Scenes by id, with the instants at which they came.
    scenes: LruCache<String, (Payload, u64)>,
    /// Scenes that the open file has.
    in_file: BTreeSet<String>,
    messages: BTreeMap<&'static str, u64>,
    lost: LostMessages,
    /// How often it has turned to the next file, for those who capture.
    turns: Arc<AtomicUsize>,
}

impl Writer {
    /// A writer of `parts`; whole scenes go to `scene_topic`. What is not written is added to `lost`, and each turn to the next file to `turns`.
    pub fn new(parts: RecordingFiles, scene_topic: String, looks: bool, lost: LostMessages, turns: Arc<AtomicUsize>) -> Self {
        let looker = looks.then(Looker::default);
        let (in_file, messages) = (BTreeSet::new(), BTreeMap::new());
        Self { parts, scene_topic, looker, scenes: LruCache::new(SCENES), in_file, messages, lost, turns }
    }

    /// Writes until nobody sends any more; what was heard is in the file after `chunk_period` at most. Blocks: not for async code.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn run(mut self, mut captured: mpsc::Receiver<Captured>, chunk_period: Duration) -> Result<Summary, RecordingError> {
        let runtime = Handle::current();
        let mut due = Instant::now() + chunk_period;
        loop {
            // Where nothing comes any more, what came last is written out, too.
            match runtime.block_on(async { timeout_at(due, captured.recv()).await }) {
                Ok(Some(captured)) => self.take(captured)?,
                Ok(None) => break,
                Err(_) => {}
            }
            if Instant::now() >= due {
                due = Instant::now() + chunk_period;
                self.parts.open().flush()?;
                if self.parts.turn()? {
                    self.in_file.clear();
                    self.turns.fetch_add(1, Ordering::Relaxed);
                }
            }
        }
        let mut about: BTreeMap<String, String> =
            self.messages.iter().map(|(kind, count)| ((*kind).to_owned(), count.to_string())).collect();
        let lost = self.lost.by_kind();
        about.insert("lost".to_owned(), lost.values().sum::<u64>().to_string());
        let outages = self.lost.outages();
        if !outages.is_empty() {
            about.insert("outages_ns".to_owned(), format!("{outages:?}"));
        }
        Ok(Summary { written: self.parts.finish(about)?, messages: self.messages, lost })
    }

    fn take(&mut self, captured: Captured) -> Result<(), RecordingError> {
        match captured {
            Captured::Sample { kind, sample, at_ns, is_drawn } => {
                if !self.parts.open().wire(&sample.key, &sample.payload, at_ns)? {
                    self.lost.add(kind, 1);
                    return Ok(());
                }
                self.count(kind);
                if is_drawn { self.look_at(kind, &sample, at_ns) } else { Ok(()) }
            }
            Captured::Scene { scene_id, payload, at_ns } => {
                self.scenes.put(scene_id.clone(), (payload, at_ns));
                self.scene(&scene_id)
            }
            Captured::Asked { scene_id } => self.scene(&scene_id),
        }
    }

    fn count(&mut self, kind: &'static str) {
        *self.messages.entry(kind).or_default() += 1;
    }

    /// Writes a scene that is at hand, once a file.
    fn scene(&mut self, scene_id: &str) -> Result<(), RecordingError> {
        let Some((payload, at_ns)) = self.scenes.get(scene_id).cloned() else { return Ok(()) };
        if !self.in_file.insert(scene_id.to_owned()) {
            return Ok(());
        }
        if !self.parts.open().wire(&self.scene_topic, &payload, at_ns)? {
            self.lost.add("scenes", 1);
            return Ok(());
        }
        self.count("scenes");
        let Some(looker) = &mut self.looker else { return Ok(()) };
        let looks = payload.decode_bulk(Scene::SCHEMA).and_then(|bulk| Scene::from_bulk(&bulk)).map(|scene| looker.scene(scene_id, &scene));
        self.show(&looks.unwrap_or_default())
    }

    fn look_at(&mut self, kind: &str, sample: &Sample, at_ns: u64) -> Result<(), RecordingError> {
        let Some(looker) = &mut self.looker else { return Ok(()) };
        let looks = match kind {
            // Nobody looks at what cannot be read; as it was on the wire it is in the file.
            "frames" => {
                let frame = sample.payload.decode_bulk(Frame::SCHEMA).and_then(|bulk| Frame::from_bulk(&bulk));
                frame.and_then(|frame| looker.frame(&frame)).unwrap_or_default()
            }
            "states" => match (keys::worker_of(&sample.key), read_robot_state(sample)) {
                (Some(robot), Ok(state)) => looker.robot(robot, &state),
                _ => Vec::new(),
            },
            "calls" => answered(&sample.payload).and_then(|result| looker.placements(&result, at_ns)).into_iter().collect(),
            _ => Vec::new(),
        };
        self.show(&looks)
    }

    fn show(&mut self, looks: &[VisualMessage]) -> Result<(), RecordingError> {
        // What the file has no room for is not drawn.
        looks.iter().try_for_each(|look| self.parts.open().look(look).map(|_has_room| ()))
    }
}

/// The placements that a copy answers with.
fn answered(copy: &Payload) -> Option<PlaceResult> {
    let entry = JournalEntry::from_bulk(&copy.decode_bulk(JournalEntry::SCHEMA).ok()?).ok()?;
    let is_answer = entry.kind == JournalKind::Reply && entry.payload.schema() == "PlaceResult.v1";
    let reply = is_answer.then(|| ReplyAttachment::decode(entry.attachment.as_bytes()).ok())??;
    (reply.kind == ReplyKind::Result).then(|| entry.payload.decode_json().ok())?
}
