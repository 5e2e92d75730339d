//! `repose replay`: the requests in a recording asked again, and whether the answers are the same.

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use repose_proto::Service;
use repose_recorder::RecordingError;
use repose_recorder::calls::{Calls, RecordedScenes, scenes_of};
use repose_recorder::replay::{Repeated, Replay, is_repeatable};
use repose_runtime::{RuntimeConfig, Session, Shutdown};

use crate::client::{self, SystemArgs};
use crate::failure::{CommandResult, Failure};
use crate::output::Output;
use crate::services::ServiceConfigs;

/// Arguments of `replay`.
#[derive(Debug, Args)]
pub struct ReplayArgs {
    /// The recording: its files, in order.
    #[arg(required = true, value_name = "FILE.mcap")]
    pub files: Vec<PathBuf>,
    /// Only the request with this id.
    #[arg(long)]
    pub request: Option<String>,
    /// Send the requests to the running system instead of services in this process.
    #[arg(long)]
    pub running: bool,
    /// The running system, with --running; of the configuration also what services in this process are made with.
    #[command(flatten)]
    pub system: SystemArgs,
    /// The deadline of a request, milliseconds.
    #[arg(long, default_value_t = 60_000)]
    pub deadline_ms: u64,
}

/// What is asked again, and so what runs in this process for it.
const SERVICES: [Service; 4] = [Service::Perception, Service::Inference, Service::Planner, Service::Motion];

/// Runs the command.
pub async fn run(args: &ReplayArgs, output: Output) -> CommandResult {
    if let Some(option) = args.system.chosen().filter(|_| !args.running) {
        return Err(Failure::bad_input(
            option,
            "is of a running system, and the requests go to services in this process: --running asks it",
        ));
    }
    let (files, request) = (args.files.clone(), args.request.clone());
    let reading = tokio::task::spawn_blocking(move || read(&files, request.as_deref()));
    let (calls, scenes) = reading.await.map_err(Failure::other)??;
    for (file, reason) in &calls.cut {
        tracing::warn!(file = %file.display(), reason, "the recording ends early: what is there is asked");
    }
    if calls.asked.is_empty() {
        return Err(match &args.request {
            Some(id) => Failure::bad_input("request", format!("the recording has no answered request {id}")),
            None => Failure::bad_input("files", "the recording has no answered request that can be sent again"),
        });
    }
    let repeated = match args.running {
        true => {
            let session = client::connect(&args.system).await?;
            let repeated = repeat(&session, &calls, &scenes, args).await;
            client::close(session).await;
            repeated?
        }
        false => in_this_process(&calls, &scenes, args).await?,
    };
    report(&repeated, &calls, output)
}

/// What is asked again, the request with that id only where one is given, and the scenes that it is about.
fn read(files: &[PathBuf], request: Option<&str>) -> Result<(Calls, RecordedScenes), RecordingError> {
    let calls = Calls::read(files, |service, call| is_repeatable(service, &call.method) && request.is_none_or(|id| call.id == id))?;
    let scenes = scenes_of(&calls.asked, files)?;
    Ok((calls, scenes))
}

/// Starts what is needed here, and asks it.
async fn in_this_process(calls: &Calls, scenes: &RecordedScenes, args: &ReplayArgs) -> Result<Vec<Repeated>, Failure> {
    let session = Session::open(RuntimeConfig::default()).await?;
    let (shutdown, configs) = (Shutdown::new(), ServiceConfigs::load(args.system.config.as_deref())?);
    let services = SERVICES.map(|service| tokio::spawn(configs.clone().run(service, session.clone(), shutdown.child())));
    let repeated = repeat(&session, calls, scenes, args).await;
    shutdown.trigger();
    let mut served = Ok(());
    for service in services {
        served = served.and(service.await.map_err(Failure::other)?);
    }
    client::close(session).await;
    // Where a service failed, what failed for want of it says less.
    served.and(repeated)
}

async fn repeat(session: &Session, calls: &Calls, scenes: &RecordedScenes, args: &ReplayArgs) -> Result<Vec<Repeated>, Failure> {
    let replay = Replay::new(session, Duration::from_millis(args.deadline_ms)).await?;
    replay.ready(&calls.asked).await?;
    let mut repeated = Vec::new();
    for asked in &calls.asked {
        let one = replay.repeat(asked, scenes).await;
        tracing::info!(id = one.id, method = one.method, same = one.why.is_none(), "asked again");
        repeated.push(one);
    }
    Ok(repeated)
}

fn report(repeated: &[Repeated], calls: &Calls, output: Output) -> CommandResult {
    let differ: Vec<&Repeated> = repeated.iter().filter(|one| one.why.is_some()).collect();
    let same = repeated.len() - differ.len();
    let document = serde_json::json!({
        "requests": repeated.len(), "same": same, "differ": differ,
        "errors": calls.errors, "unanswered": calls.unanswered, "lost": calls.lost,
    });
    output.print(&document, || {
        let mut lines: Vec<String> =
            differ.iter().map(|one| format!("{} {}: {}", one.method, one.id, one.why.as_deref().unwrap_or_default())).collect();
        lines.push(format!("{same} of {} answers are the same, byte for byte", repeated.len()));
        for (code, count) in &calls.errors {
            lines.push(format!("{count} requests had ended in {code} and were not asked again"));
        }
        if calls.unanswered + calls.lost > 0 {
            lines.push(format!("{} requests have no answer in the recording; {} copies are missing from it", calls.unanswered, calls.lost));
        }
        lines.join("\n")
    })?;
    if differ.is_empty() { Ok(()) } else { Err(Failure::NotAchieved) }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::path::Path;

    use clap::Parser;
    use repose_proto::{Cell, JournalEntry, JournalKind, Payload};
    use repose_recorder::file::writing::PartWriter;

    use super::*;

    type Line = crate::testing::Line<ReplayArgs>;

    #[tokio::test(flavor = "multi_thread")]
    async fn a_running_system_that_would_not_be_asked_is_refused() {
        for option in ["--connect=tcp/127.0.0.1:1", "--cell=lab", "--pool=rack"] {
            let args = Line::parse_from(["replay", "no-such.mcap", option]).args;
            let refused = run(&args, Output { json: false }).await.expect_err("it would go unheeded");
            let field = refused.error().and_then(|e| e.field.clone()).unwrap_or_default();
            assert_eq!((refused.exit_code(), field.as_str()), (2, &option[2..option.find('=').unwrap_or(2)]));
        }
    }

    /// A recording of a planner's calls of `place`, each with an answer of this kind.
    fn recording(folder: &Path, answered: &[(&str, &str)]) -> PathBuf {
        let topic = Cell::new("lab").expect("a cell").journal(Service::Planner, "a");
        let file = folder.join("run.mcap");
        let mut writer = PartWriter::create(&file, BTreeMap::new()).expect("a file");
        let mut copies = 0..;
        let mut copy = |kind, attachment| {
            let seq = copies.next().expect("without end");
            let payload = Payload { encoding: "application/json;repose.X.v1".to_owned(), bytes: "{}".into() };
            let entry = JournalEntry { seq, stamp_ns: seq, kind, cell: None, attachment, payload };
            let payload = Payload::bulk(JournalEntry::SCHEMA, &entry.to_bulk()).expect("small");
            writer.wire(&topic, &payload, seq).expect("written");
        };
        for (id, kind) in answered {
            copy(JournalKind::Call, format!(r#"{{"v":1,"id":"{id}","method":"place","remaining_ms":1000}}"#));
            copy(JournalKind::Reply, format!(r#"{{"v":1,"id":"{id}","kind":"{kind}"}}"#));
        }
        writer.finish(BTreeMap::new()).expect("written");
        file
    }

    #[test]
    fn where_one_request_is_asked_again_no_other_is_held_or_told_of() {
        let folder = tempfile::tempdir().expect("a folder");
        let files = [recording(folder.path(), &[("one", "result"), ("two", "result"), ("three", "error")])];
        let told = |request| {
            let (calls, _) = read(&files, request).expect("a recording");
            (calls.asked.into_iter().map(|asked| asked.id).collect::<Vec<_>>(), calls.errors.values().sum::<u64>())
        };
        assert_eq!(told(None), (vec!["one".to_owned(), "two".to_owned()], 1));
        assert_eq!(told(Some("two")), (vec!["two".to_owned()], 0));
        assert_eq!(told(Some("three")), (Vec::new(), 1));
    }
}
