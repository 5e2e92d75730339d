//! `repose arrange … --execute`: goals about several objects, brought about move by move, with a look after each.

use repose_executive::arrangement::{ArrangementEnd, ArrangementReport, TriedMove, bring_about};
use repose_proto::arrange::{ArrangeRequest, Purpose};
use repose_runtime::Session;

use crate::client::{self, ConnectArgs};
use crate::failure::{CommandResult, Failure};
use crate::output::Output;
use crate::terminal::Terminal;

/// What is to be brought about, and where.
pub struct Arranging<'a> {
    /// What is asked for, in the ids of the first view; its scene is each view in turn.
    pub request: ArrangeRequest,
    /// The running system.
    pub connect: &'a ConnectArgs,
    /// The robot that carries the moves out.
    pub robot: &'a str,
    /// How often an object is tried, at least 1.
    pub attempts: usize,
}

/// Runs the command.
pub async fn run(args: Arranging<'_>, output: Output) -> CommandResult {
    let session = client::connect(&args.connect.system).await?;
    let told = brought_about(args, &session).await;
    client::close(session).await;
    let told = told?;
    output.print(&told, || describe(&told))?;
    match told.ended {
        ArrangementEnd::Achieved => Ok(()),
        ArrangementEnd::NoArrangement if told.steps.is_empty() => Err(Failure::NoPlacement),
        _ => Err(Failure::NotAchieved),
    }
}

async fn brought_about(args: Arranging<'_>, session: &Session) -> Result<ArrangementReport, Failure> {
    let site = Terminal::of(session, args.connect, args.robot).await?;
    Ok(bring_about(site, None, args.request, args.attempts, |_| {}).await?)
}

/// The result, for people.
fn describe(told: &ArrangementReport) -> String {
    let mut lines: Vec<String> = told.steps.iter().enumerate().map(|(k, step)| line(k, step)).collect();
    let hold = |(object, holds): (&u16, &Option<bool>)| match holds {
        Some(true) => None,
        Some(false) => Some(format!("the goal of object {object} does not hold")),
        None if told.remembered.contains(object) => {
            Some(format!("the goal of object {object} held when it was last seen; it is hidden now"))
        }
        None => Some(format!("whether the goal of object {object} holds cannot be seen")),
    };
    lines.extend(told.holds.iter().filter_map(hold));
    lines.extend(told.why.as_ref().map(|why| format!("ended: {why}")));
    lines.push(format!("{} of {} goals hold", told.achieved, told.wanted));
    lines.push(told.robot.clone());
    lines.join("\n")
}

fn line(k: usize, step: &TriedMove) -> String {
    let name = step.object.map_or_else(|| "an object that came in".to_owned(), |object| format!("object {object}"));
    let purpose = match step.planned.purpose {
        Purpose::Goal => "to its goal",
        Purpose::Aside => "aside, to make room",
    };
    format!("  {}. {name} {purpose}: {}", k + 1, step.describe().join("; "))
}
