//! The calls in a recording, each with its answer; and the scenes that they are about, which are read when it is known which these are: a recording of
//! hours has thousands, of which most are about nobody's request.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use repose_proto::{CallAttachment, JournalEntry, JournalKind, Payload, ReplyAttachment, ReplyKind, Scene, Service, keys};

use crate::RecordingError;
use crate::copies::CopyNumbers;
use crate::file::SCENE_TOPIC;
use crate::file::reading::{RecordedMessage, RecordingReader};

/// A recorded call: the request and its answer, as they were on the wire.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedCall {
    /// The request's id.
    pub id: String,
    /// Whom it was asked of.
    pub service: Service,
    /// The method.
    pub method: String,
    /// The request.
    pub request: Payload,
    /// The result.
    pub result: Payload,
    /// The worker that answered.
    pub worker: String,
    /// When it came, nanoseconds since the Unix epoch.
    pub at_ns: u64,
}

/// What a recording holds to ask again.
#[derive(Debug, Default)]
pub struct Calls {
    /// Calls with a result, in the order in which they came.
    pub asked: Vec<RecordedCall>,
    /// Calls that ended in an error, by its code.
    pub errors: BTreeMap<String, u64>,
    /// Calls whose answer is not in the recording.
    pub unanswered: u64,
    /// Copies that are missing between others: so many messages were lost.
    pub lost: u64,
    /// Files that end early, and why.
    pub cut: Vec<(PathBuf, String)>,
}

impl Calls {
    /// Reads a recording's files. Calls that are not `wanted` are left out, and not counted either: none of them is held.
    ///
    /// # Errors
    /// When a file is no recording or cannot be read.
    pub fn read(files: &[PathBuf], wanted: impl Fn(Service, &CallAttachment) -> bool) -> Result<Self, RecordingError> {
        let mut calls = Self::default();
        let mut pending = Pending::default();
        for file in files {
            let mut reading = RecordingReader::open(file)?;
            while let Some(recorded) = reading.next_message()? {
                calls.take(&recorded, &mut pending, &wanted);
            }
            calls.cut.extend(reading.cut().map(|reason| (file.clone(), reason.to_owned())));
        }
        calls.unanswered = pending.open.len() as u64;
        calls.asked.sort_by_key(|asked| asked.at_ns);
        Ok(calls)
    }

    fn take(&mut self, recorded: &RecordedMessage, pending: &mut Pending, wanted: &impl Fn(Service, &CallAttachment) -> bool) {
        let Some((service, worker)) = keys::of_journal(&recorded.topic) else { return };
        let entry = recorded.payload.decode_bulk(JournalEntry::SCHEMA).and_then(|bulk| JournalEntry::from_bulk(&bulk));
        let Ok(entry) = entry else { return };
        self.lost += pending.copies.came(&recorded.topic, entry.seq);
        match entry.kind {
            JournalKind::Call => {
                let Ok(call) = CallAttachment::decode(entry.attachment.as_bytes()) else { return };
                // A call that is asked a second time while it is open, or is asked again elsewhere, is the same call.
                if wanted(service, &call) && !pending.done.contains(&call.id) {
                    pending.open.insert((worker.to_owned(), call.id), (service, call.method, entry.payload, entry.stamp_ns));
                }
            }
            JournalKind::Reply => {
                let Ok(reply) = ReplyAttachment::decode(entry.attachment.as_bytes()) else { return };
                if reply.kind == ReplyKind::Progress {
                    return;
                }
                let key = (worker.to_owned(), reply.id.clone());
                let Some((service, method, request, at_ns)) = pending.open.remove(&key) else { return };
                if reply.kind == ReplyKind::Error {
                    let code = entry.payload.decode_json::<repose_proto::CallError>().map_or("unreadable", |e| e.code.as_str());
                    *self.errors.entry(code.to_owned()).or_default() += 1;
                } else if pending.done.insert(reply.id.clone()) {
                    self.asked.push(RecordedCall { id: reply.id, service, method, request, result: entry.payload, worker: key.0, at_ns });
                }
            }
        }
    }
}

/// Whom a call was asked of, what, with which request, and when.
type Open = (Service, String, Payload, u64);

/// What reading has to remember.
#[derive(Default)]
struct Pending {
    /// Calls without an answer yet, by worker and id.
    open: BTreeMap<(String, String), Open>,
    /// Calls with a result.
    done: BTreeSet<String>,
    copies: CopyNumbers,
}

/// Whole scenes by their ids, in bulk form.
pub type RecordedScenes = BTreeMap<String, Payload>;

/// Reads the scenes out of a recording's files that calls name by their ids, and no others.
///
/// # Errors
/// When a file is no recording or cannot be read.
pub fn scenes_of(asked: &[RecordedCall], files: &[PathBuf]) -> Result<RecordedScenes, RecordingError> {
    let mut wanted: BTreeSet<String> = asked.iter().filter_map(|asked| scene_asked_about(&asked.request)).collect();
    let mut scenes = RecordedScenes::new();
    for file in files {
        let mut reading = RecordingReader::open(file)?;
        while !wanted.is_empty()
            && let Some(recorded) = reading.next_message()?
        {
            if keys::last_chunk(&recorded.topic) != SCENE_TOPIC {
                continue;
            }
            // Its id is the hash of its content: whatever else is said of it counts for nothing.
            let read = recorded.payload.decode_bulk(Scene::SCHEMA).and_then(|bulk| Scene::from_bulk(&bulk));
            if let Some(scene_id) = read.ok().and_then(|scene| wanted.take(&scene.id())) {
                scenes.insert(scene_id, recorded.payload);
            }
        }
    }
    Ok(scenes)
}

/// The scene that a request names, where it does not enclose it.
pub(crate) fn scene_asked_about(request: &Payload) -> Option<String> {
    if request.is_bulk() {
        return None;
    }
    let request: serde_json::Value = serde_json::from_slice(&request.bytes).ok()?;
    Some(request.get("scene")?.get("scene_id")?.as_str()?.to_owned())
}

#[cfg(test)]
mod tests {
    use repose_proto::{Bulk, CallError, Cell, limits};

    use super::*;
    use crate::file::writing::PartWriter;

    const METHOD: &str = "place";

    fn json(text: &str) -> Payload {
        Payload { encoding: "application/json;repose.X.v1".to_owned(), bytes: text.to_owned().into() }
    }

    fn copy(worker: &str, seq: u64, kind: JournalKind, attachment: &str, payload: Payload) -> RecordedMessage {
        let entry = JournalEntry { seq, stamp_ns: 100 + seq, kind, cell: None, attachment: attachment.to_owned(), payload };
        let topic = Cell::new("lab").expect("a cell").journal(Service::Planner, worker);
        RecordedMessage { topic, at_ns: seq, payload: Payload::bulk(JournalEntry::SCHEMA, &entry.to_bulk()).expect("small") }
    }

    fn call(worker: &str, seq: u64, id: &str, request: &str) -> RecordedMessage {
        let attachment = format!(r#"{{"v":{},"id":"{id}","method":"{METHOD}","remaining_ms":1000}}"#, limits::VERSION);
        copy(worker, seq, JournalKind::Call, &attachment, json(request))
    }

    fn reply(worker: &str, seq: u64, id: &str, kind: &str, payload: Payload) -> RecordedMessage {
        copy(worker, seq, JournalKind::Reply, &format!(r#"{{"v":1,"id":"{id}","kind":"{kind}"}}"#), payload)
    }

    #[test]
    fn calls_are_paired_with_their_results_and_everything_else_is_counted() {
        let error = Payload::json(&CallError::not_found("scene_id", "no")).expect("small");
        let heard = [
            call("a", 0, "one", "1"),
            call("b", 7, "two", "2"),
            reply("a", 1, "one", "progress", json("0")),
            reply("b", 8, "two", "error", error),
            reply("a", 2, "one", "result", json("I")),
            call("b", 9, "two", "2, with its scene"),
            // The first attempt of this one is answered, too, but later: it counts once.
            call("a", 3, "three", "3"),
            call("b", 11, "three", "3"),
            reply("b", 12, "three", "result", json("III")),
            reply("a", 4, "three", "result", json("III")),
            reply("b", 13, "two", "result", json("II")),
            call("a", 5, "four", "4"),
        ];
        let (mut calls, mut pending) = (Calls::default(), Pending::default());
        for recorded in heard {
            let wanted = |service: Service, call: &CallAttachment| service == Service::Planner && call.method == METHOD;
            calls.take(&recorded, &mut pending, &wanted);
        }
        let mut asked: Vec<_> = calls.asked.iter().map(|a| (a.id.as_str(), &a.request.bytes[..], &a.result.bytes[..])).collect();
        asked.sort();
        let expected: [(&str, &[u8], &[u8]); 3] = [("one", b"1", b"I"), ("three", b"3", b"III"), ("two", b"2, with its scene", b"II")];
        assert_eq!(asked, expected);
        assert_eq!((calls.lost, calls.errors), (1, BTreeMap::from([("not_found".to_owned(), 1)])), "number 10 of b is missing");
        assert_eq!(pending.open.len(), 1);
    }

    #[test]
    fn of_calls_that_are_not_wanted_nothing_is_held_or_counted() {
        let error = Payload::json(&CallError::not_found("scene_id", "no")).expect("small");
        let heard = [
            call("a", 0, "one", "1"),
            call("a", 1, "two", "2"),
            call("a", 2, "three", "3"),
            call("a", 3, "four", "4"),
            reply("a", 4, "one", "result", json("I")),
            reply("a", 5, "two", "result", json("II")),
            reply("a", 6, "three", "error", error),
        ];
        let (mut calls, mut pending) = (Calls::default(), Pending::default());
        for (k, recorded) in heard.iter().enumerate() {
            calls.take(recorded, &mut pending, &|_: Service, call: &CallAttachment| call.id == "two");
            assert_eq!(pending.open.len(), usize::from((1..5).contains(&k)), "after message {k}");
        }
        assert_eq!(calls.asked.iter().map(|asked| asked.id.as_str()).collect::<Vec<_>>(), ["two"]);
        assert_eq!((calls.errors, calls.lost), (BTreeMap::new(), 0));
    }

    #[test]
    fn of_a_hundred_scenes_the_one_that_a_call_is_about_is_kept() {
        let golden = include_bytes!("../../../proto/tests/golden/Scene.v1.safetensors");
        let golden = Scene::from_bulk(&Bulk::decode(golden).expect("bulk")).expect("a scene");
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("run.mcap");
        let mut writer = PartWriter::create(&file, BTreeMap::new()).expect("a file");
        let mut scenes = Vec::new();
        for k in 0..100u64 {
            let mut scene = golden.clone();
            scene.points[0][0] += k as f32 * 1e-3;
            let payload = Payload::bulk(Scene::SCHEMA, &scene.to_bulk()).expect("small");
            writer.wire(&format!("repose/v1/lab/{SCENE_TOPIC}"), &payload, k).expect("written");
            scenes.push((scene.id(), payload));
        }
        let request = format!(r#"{{"scene":{{"scene_id":"{}"}}}}"#, scenes[42].0);
        for heard in [call("a", 0, "one", &request), reply("a", 1, "one", "result", json("I"))] {
            writer.wire(&heard.topic, &heard.payload, heard.at_ns).expect("written");
        }
        writer.finish(BTreeMap::new()).expect("written");
        let files = [file];
        let calls = Calls::read(&files, |_, _| true).expect("a recording");
        assert_eq!(calls.asked.len(), 1);
        assert_eq!(scenes_of(&calls.asked, &files).expect("a recording"), BTreeMap::from([scenes.swap_remove(42)]));
        assert_eq!(scenes_of(&[], &files).expect("a recording"), RecordedScenes::new());
    }
}
