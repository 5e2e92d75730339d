//! `repose plan`: one placement on a frame folder, without a running system.

use std::path::PathBuf;
use std::sync::Arc;

use clap::Args;
use repose_evaluation::report::written::can_write;
use repose_evaluation::report::written::write_picture;
use repose_local::picture::before_and_after;
use repose_local::{ModelFiles, Models};

use crate::answer::print_result;
use crate::embedded::NetworkArgs;
use crate::failure::Outcome;
use crate::frames;
use crate::output::Output;
use crate::values::parse_png;
use crate::wish::WishArgs;

/// Arguments of `plan`.
#[derive(Debug, Args)]
pub struct PlanArgs {
    /// A frame folder, or anything that `play` plays: its first frame.
    pub frame: PathBuf,
    /// What is wished for.
    #[command(flatten)]
    pub wish: WishArgs,
    /// Which networks.
    #[command(flatten)]
    pub networks: NetworkArgs,
    /// Find the objects although the frame has labels.
    #[arg(long)]
    pub ignore_labels: bool,
    /// A picture of the frame with object ids, and with the object where it is to stand.
    #[arg(long, value_name = "PNG", value_parser = parse_png)]
    pub out: Option<PathBuf>,
}

/// Runs the command.
pub fn run(args: &PlanArgs, output: Output) -> Outcome {
    args.out.as_deref().map_or(Ok(()), can_write)?;
    let mut frame = frames::read(&args.frame)?;
    if args.ignore_labels {
        frame.labels = None;
    }
    let scene = Arc::new(frames::scene_of(&frame)?);
    let (wish, said) = args.wish.on(&scene)?;
    let mut request = args.wish.request(scene.id(), &wish);
    if let Some(robot) = &mut request.robot {
        robot.world_from_base = frame.robots.iter().find(|r| r.name == robot.name).map(|r| r.world_from_base);
    }
    let files = ModelFiles { weights: args.networks.weights.clone() };
    let result = repose_local::plan(&scene, &request, || Models::load(&files).map(Arc::new))?;
    if let Some(path) = &args.out {
        write_picture(path, &before_and_after(&scene, &result)?.into())?;
    }
    print_result(&result, said.as_ref(), output)
}
