//! `repose place … --execute --then …`: wishes achieved one after another, each planned on a fresh view of what the one before has left.

use std::time::Duration;

use repose_executive::sequence::{GoalStep, Sequence};
use repose_proto::{CallError, PlaceRequest};
use repose_runtime::Session;
use repose_sentences::placement::describe;

use crate::client::{self, ConnectArgs};
use crate::failure::{CommandResult, Failure};
use crate::output::Output;
use crate::say::SentenceMeaning;
use crate::terminal::Terminal;
use crate::wish::{NextWish, WishArgs};

/// What is to be achieved, and where.
#[derive(Debug, Clone, Copy)]
pub struct Wishes<'a> {
    /// The first wish.
    pub wish: &'a WishArgs,
    /// Those after it.
    pub then: &'a [NextWish],
    /// The running system.
    pub connect: &'a ConnectArgs,
    /// The robot that carries them out.
    pub robot: &'a str,
    /// Attempts at each wish, at least 1.
    pub attempts: u32,
}

/// Runs the command: stops at the first wish that is not achieved.
pub async fn run(args: &Wishes<'_>, output: Output) -> CommandResult {
    let session = client::connect(&args.connect.system).await?;
    let tried = achieve(args, &session).await;
    client::close(session).await;
    let Achieved { steps, said, error } = tried?;
    let achieved = steps.iter().take_while(|s| s.achieved()).count();
    let wanted = 1 + args.then.len();
    let mut document = serde_json::json!({"wanted": wanted, "achieved": achieved, "steps": steps});
    if let Some(said) = &said {
        document["steps"][0]["said"] = serde_json::json!(said);
    }
    if let Some(error) = &error {
        document["error"] = serde_json::json!(error);
    }
    output.print(&document, || {
        let understood = said.iter().map(ToString::to_string);
        let mut lines: Vec<String> = understood.chain(steps.iter().map(line)).collect();
        lines.extend(error.as_ref().map(|error| format!("stopped: {error}")));
        lines.push(format!("{achieved} of {wanted} achieved"));
        lines.join("\n")
    })?;
    match steps.last() {
        _ if achieved == wanted => Ok(()),
        Some(last) if error.is_none() && last.result.placements.is_empty() => Err(Failure::NoPlacement),
        Some(_) => Err(Failure::NotAchieved),
        None => Err(Failure::other("nothing was tried")),
    }
}

fn line(step: &GoalStep) -> String {
    format!("{}\n  {}", describe(&step.result, step.center_m), step.describe().join("; "))
}

/// The results of the wishes.
struct Achieved {
    steps: Vec<GoalStep>,
    /// How words were taken, where the first was said in words.
    said: Option<SentenceMeaning>,
    error: Option<CallError>,
}

/// The results of the wishes; an error where nothing was tried.
async fn achieve(args: &Wishes<'_>, session: &Session) -> Result<Achieved, Failure> {
    let within = Duration::from_millis(args.connect.deadline_ms);
    let reaching = client::reaching(session, args.wish.reach_of.as_deref(), within).await;
    let site = Terminal::of(session, args.connect, args.robot).await?;
    let mut sequence = Sequence::begin(site, None, args.attempts as usize).await?;
    let (scene_id, scene) = sequence.view();
    let (first, said) = args.wish.on(scene)?;
    let wishes = std::iter::once(&first).chain(args.then);
    let goals: Vec<PlaceRequest> = wishes.map(|wish| args.wish.request(scene_id.clone(), wish, reaching.clone())).collect();
    let ended = sequence.achieve(&goals, |_| {}).await;
    match ended {
        // Nothing has moved.
        Err(error) if sequence.steps.is_empty() => Err(error.into()),
        ended => Ok(Achieved { steps: sequence.steps, said, error: ended.err() }),
    }
}
