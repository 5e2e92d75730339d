//! `repose place`: one placement asked of a running system.

use std::time::Duration;

use clap::Args;
use repose_proto::place::PlaceProgress;
use repose_proto::{Message, Service};
use repose_runtime::CallOptions;
use repose_sentences::placement::center_of;
use tokio::sync::mpsc;

use crate::answer::print_result;
use crate::client::{self, ConnectArgs};
use crate::failure::CommandResult;
use crate::output::Output;
use crate::sequence::{self, Wishes};
use crate::wish::{NextWish, WishArgs};

/// Arguments of `place`.
#[derive(Debug, Args)]
pub struct PlaceArgs {
    /// What is wished for.
    #[command(flatten)]
    pub wish: WishArgs,
    /// Where to ask.
    #[command(flatten)]
    pub connect: ConnectArgs,
    /// Plan on this scene instead of the camera's newest.
    #[arg(long, value_name = "ID", conflicts_with_all = ["execute", "then", "attempts", "robot"])]
    pub scene: Option<String>,
    /// Have the robot carry out the placement, then check on a fresh view whether the goal holds and whether anything else has moved or fallen.
    #[arg(long)]
    pub execute: bool,
    /// With --execute, a further placement, ID=TERM[,TERM…], planned on a fresh view after the previous one was carried out and its goal holds.
    /// Ids are those of the first view. Repeat for more.
    #[arg(long, value_name = "WISH", requires = "execute")]
    pub then: Vec<NextWish>,
    /// With --execute, maximum attempts for an object that slips, falls or is not grasped, including the first: 1 to 10. No further attempt is
    /// made after a stop or a person's intervention.
    #[arg(long, default_value_t = 3, requires = "execute", value_parser = clap::value_parser!(u32).range(1..=10))]
    pub attempts: u32,
    /// With --execute, the robot that carries out the placements.
    #[arg(long, default_value = "panda", requires = "execute")]
    pub robot: String,
}

/// Progress replies that may wait to be printed.
const PROGRESS_WAITING: usize = 64;

/// Runs the command.
pub async fn run(args: &PlaceArgs, output: Output) -> CommandResult {
    if args.execute {
        let PlaceArgs { wish, then, connect, robot, attempts, .. } = args;
        let wishes = Wishes { wish, then, connect, robot, attempts: *attempts };
        return sequence::run(&wishes, output).await;
    }
    let session = client::connect(&args.connect.system).await?;
    let deadline = Duration::from_millis(args.connect.deadline_ms);
    let (scene_id, mut objects) = match &args.scene {
        Some(id) => (id.clone(), Vec::new()),
        None => {
            let newest = client::newest_scene(&session, &args.connect.camera, deadline, client::PATIENCE).await?;
            (newest.scene_id, newest.objects)
        }
    };
    let (wish, said) = match args.wish.numbered() {
        Some(wish) => (wish, None),
        None => {
            let scene = client::whole_scene(&session, &scene_id, deadline).await?;
            objects.clone_from(&scene.meta.objects);
            args.wish.on(&scene)?
        }
    };
    let reaching = client::reaching(&session, args.wish.reach_of.as_deref(), deadline).await;
    let request = args.wish.request(scene_id, &wish, reaching);
    request.validate()?;
    let planner = session.caller(Service::Planner).await?;
    let (sender, mut progress) = mpsc::channel::<repose_proto::Payload>(PROGRESS_WAITING);
    let printing = tokio::spawn(async move {
        while let Some(payload) = progress.recv().await {
            if let Ok(p) = payload.decode_json::<PlaceProgress>() {
                tracing::info!(iterations = p.iterations, evaluated = p.evaluated, best = p.best.map(|b| b.cost), "progress");
            }
        }
    });
    let options = CallOptions { progress: Some(sender), ..CallOptions::within(deadline) };
    let answered = planner.place(&request, None, options).await;
    printing.abort();
    client::close(session).await;
    let (result, answer) = answered?;
    tracing::info!(worker = answer.worker, attempts = answer.attempts, timing_ms = ?answer.timing_ms, "answered");
    print_result(&result, center_of(&objects, result.query), said.as_ref(), output)
}
