//! `repose arrange`: goals about several objects that shall all hold at the end, on a frame folder or a running system's newest scene.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use clap::Args;
use repose_local::{LocalModels, ModelFiles};
use repose_proto::arrange::{ArrangeMove, ArrangeRequest, ArrangeResult, Conflict, ObjectGoal, Proof, Purpose};
use repose_proto::place::{Outcome as Found, Rotation, Variant};
use repose_proto::{Message, ObjectSummary, Payload, Scene, Service};
use repose_runtime::CallOptions;
use repose_sentences::placement::{carried, center_of, motion};

use crate::arrangement::{self, Arranging};
use crate::client::{self, ConnectArgs};
use crate::embedded::NetworkArgs;
use crate::failure::{CommandResult, Failure};
use crate::frames;
use crate::output::Output;
use crate::values::{parse_rotation, parse_variant};
use crate::wish::{NextWish, parse_view_yaw};

/// Arguments of `arrange`.
#[derive(Debug, Args)]
pub struct ArrangeArgs {
    /// A frame folder, or any source that `play` accepts, whose first frame is used. Default: a running system's newest scene.
    pub frame: Option<PathBuf>,
    /// A goal for one object: ID=TERM[,TERM…], such as 2=left_of:3 or 4=near:2,not:touching:2. Repeat for more objects.
    #[arg(long = "goal", required = true, value_name = "ID=TERMS")]
    pub goals: Vec<NextWish>,
    /// The method that finds each placement: best, full, full_lambda_1, no_discriminator, mean_only, mdn_prior or geometric.
    #[arg(long, default_value = "best", value_parser = parse_variant)]
    pub variant: Variant,
    /// Seed of the random number generator.
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Whether objects may be turned: fixed, yaw, or stable (turned, and where that does not do, set on another side).
    #[arg(long, default_value = "fixed", value_parser = parse_rotation)]
    pub rotation: Rotation,
    /// The viewer's direction of view, which `left_of` and the other directions refer to, radians about z. Default: the camera's.
    #[arg(long, allow_negative_numbers = true, value_name = "RADIANS", value_parser = parse_view_yaw)]
    pub view_yaw: Option<f64>,
    /// Maximum number of times an object is set aside to make room. Default: 2.
    #[arg(long)]
    pub max_parkings: Option<u32>,
    /// Maximum number of placement searches. Default: 60.
    #[arg(long)]
    pub max_searches: Option<u32>,
    /// Time limit, milliseconds, after which the best arrangement so far is printed; answers then depend on the machine. Default: no limit.
    #[arg(long)]
    pub time_ms: Option<u64>,
    /// Have the robot carry out the moves; after each one, the remaining moves are planned again on a fresh view.
    #[arg(long, conflicts_with = "frame")]
    pub execute: bool,
    /// With --execute, maximum attempts for an object that slips, falls or is not grasped, including the first: 1 to 10. No further attempt is
    /// made after a stop or a person's intervention.
    #[arg(long, default_value_t = 3, requires = "execute", conflicts_with = "frame", value_parser = clap::value_parser!(u32).range(1..=10))]
    pub attempts: u32,
    /// With --execute, the robot that carries out the moves.
    #[arg(long, default_value = "panda", requires = "execute", conflicts_with = "frame")]
    pub robot: String,
    /// Which networks, for a frame.
    #[command(flatten)]
    pub networks: NetworkArgs,
    /// Where to ask, without a frame.
    #[command(flatten)]
    pub connect: ConnectArgs,
}

/// Runs the command.
pub async fn run(args: &ArrangeArgs, output: Output) -> CommandResult {
    args.check()?;
    if args.execute {
        // The request names each view in turn.
        let (request, connect, attempts) = (args.request(String::new()), &args.connect, args.attempts as usize);
        return arrangement::run(Arranging { request, connect, robot: &args.robot, attempts }, output).await;
    }
    let (result, objects) = match &args.frame {
        Some(path) => {
            let scene: Arc<Scene> = Arc::new(repose_local::scene_of(&frames::read(path)?)?);
            let files = ModelFiles { weights: args.networks.weights.clone() };
            let request = args.request(scene.id());
            // Everything computes here; nothing else waits in this process.
            let arranged = || repose_local::arrange(&scene, &request, || LocalModels::load(&files).map(Arc::new));
            (tokio::task::block_in_place(arranged)?, scene.meta.objects.clone())
        }
        None => asked(args).await?,
    };
    output.print(&result, || describe(&result, &objects))?;
    ended(result.outcome, result.moves.len())
}

/// How the command ends, as `plan` and `place` do: moves that are part of what was asked for are an answer.
fn ended(outcome: Found, moves: usize) -> CommandResult {
    match (outcome, moves) {
        (Found::Found, _) | (Found::Partial, 1..) => Ok(()),
        _ => Err(Failure::NoPlacement),
    }
}

/// The answer of a running system for its newest scene, and that scene's objects.
async fn asked(args: &ArrangeArgs) -> Result<(ArrangeResult, Vec<ObjectSummary>), Failure> {
    let session = client::connect(&args.connect.system).await?;
    let deadline = Duration::from_millis(args.connect.deadline_ms);
    let summary = client::newest_scene(&session, &args.connect.camera, deadline, client::PATIENCE).await?;
    let request = args.request(summary.scene_id);
    request.validate()?;
    let planner = session.caller(Service::Planner).await?;
    let encode = |scene: Option<&Scene>| Payload::with_scene(&request, scene);
    let answered = planner.call_with_scene("arrange", None, encode, CallOptions::within(deadline)).await;
    client::close(session).await;
    Ok((answered?.payload.decode_json()?, summary.objects))
}

/// The options about a running system conflict with a frame. Those that the environment may set are looked at by [`ArrangeArgs::check`]: a variable
/// that is set for other commands is no mistake here.
pub fn with_own_conflicts(arrange: clap::Command) -> clap::Command {
    let options = ["camera", "deadline_ms", "pool", "config"];
    options.into_iter().fold(arrange, |arrange, option| arrange.mut_arg(option, |arg| arg.conflicts_with("frame")))
}

impl ArrangeArgs {
    /// Refuses what would go unheeded.
    fn check(&self) -> CommandResult {
        if self.frame.is_none() {
            return match self.networks.weights {
                Some(_) => Err(Failure::bad_input("weights", "is for a frame; a running system's inference has its own")),
                None => Ok(()),
            };
        }
        let refused = |option| Err(Failure::bad_input(option, "is of a running system, and a frame is arranged in this process"));
        self.connect.system.chosen().map_or(Ok(()), refused)
    }

    fn request(&self, scene_id: String) -> ArrangeRequest {
        let goals = self.goals.iter().map(|wish| ObjectGoal { object: wish.query, terms: wish.goal.clone() }).collect();
        let default = ArrangeRequest::new(scene_id, goals);
        ArrangeRequest {
            variant: self.variant,
            seed: self.seed,
            rotation: self.rotation,
            view_yaw_rad: self.view_yaw,
            max_parkings: self.max_parkings.unwrap_or(default.max_parkings),
            max_searches: self.max_searches.unwrap_or(default.max_searches),
            time_ms: self.time_ms,
            ..default
        }
    }
}

/// A result for people, on a scene of these objects.
fn describe(result: &ArrangeResult, objects: &[ObjectSummary]) -> String {
    let mut lines: Vec<String> = Vec::new();
    let is_view_needed = !result.needs_view.is_empty();
    lines.push(match (result.outcome, result.moves.len()) {
        (Found::Found, 0) => "all goals hold as things stand".to_owned(),
        (Found::Found, 1) => format!("1 move, {} placements searched", result.searches),
        (Found::Found, n) => format!("{n} moves, {} placements searched", result.searches),
        (Found::None, _) => format!("no arrangement among {} placements searched", result.searches),
        (Found::Partial, 1) if is_view_needed => format!("1 move before another view, {} placements searched", result.searches),
        (Found::Partial, n) if is_view_needed => format!("{n} moves before another view, {} placements searched", result.searches),
        (Found::Partial, n) => format!("the search was cut short after {} placements; its best so far has {n} moves", result.searches),
    });
    lines.extend(moves(&result.moves, objects));
    lines.extend(result.probability.map(|p| format!("probability that all moves succeed: {p:.2}")));
    if !result.satisfied.is_empty() && result.outcome != Found::None {
        lines.push(format!("their goals hold already: {}", ids(&result.satisfied)));
    }
    if !result.open.is_empty() && result.outcome == Found::Partial {
        lines.push(format!("still open: {}", ids(&result.open)));
    }
    if is_view_needed {
        let why = "covered in this view; plan the rest on a view after these moves, as --execute does";
        lines.push(format!("the top of {} is {why}", ids(&result.needs_view)));
    }
    lines.extend(result.conflict.as_ref().map(conflict));
    lines.join("\n")
}

/// A line for each move. An object that moves again goes on from where it was put.
fn moves(steps: &[ArrangeMove], objects: &[ObjectSummary]) -> Vec<String> {
    let mut centers_m: BTreeMap<u16, [f64; 3]> = BTreeMap::new();
    let mut lines = Vec::new();
    for (k, step) in steps.iter().enumerate() {
        let center_m = centers_m.get(&step.object).copied().or_else(|| center_of(objects, step.object));
        lines.push(line(k, step, center_m));
        centers_m.extend(center_m.map(|center| (step.object, carried(&step.placement.placed_from_observed, center))));
    }
    lines
}

fn line(k: usize, step: &ArrangeMove, center_m: Option<[f64; 3]>) -> String {
    let goal: Vec<String> = step.goal.iter().map(ToString::to_string).collect();
    let purpose = match step.purpose {
        Purpose::Goal => format!("so that {}", goal.join(" and ")),
        Purpose::Aside => "set down aside, to make room".to_owned(),
    };
    format!("  {}. object {}: {}, {purpose}", k + 1, step.object, motion(&step.placement, center_m))
}

fn conflict(conflict: &Conflict) -> String {
    let goals: Vec<String> = conflict.goals.iter().map(ToString::to_string).collect();
    let smallest = if conflict.smallest { "" } else { " (a smaller set of them may be to blame)" };
    match conflict.proof {
        Proof::Contradiction => format!("  these contradict each other on any table: {}", goals.join(" and ")),
        Proof::NotFound if goals.len() == 1 => format!("  for {} alone no place was found", goals[0]),
        Proof::NotFound => format!("  together no places were found for {}{smallest}", goals.join(" and ")),
    }
}

fn ids(objects: &[u16]) -> String {
    objects.iter().map(u16::to_string).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_placement_is_where_there_is_none() {
        let code = |outcome, moves| ended(outcome, moves).map_or_else(|failure| failure.exit_code(), |()| 0);
        assert_eq!([code(Found::Found, 0), code(Found::Found, 2), code(Found::Partial, 2)], [0; 3]);
        assert_eq!([code(Found::Partial, 0), code(Found::None, 0)], [3; 2]);
    }
}
