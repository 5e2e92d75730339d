//! The command line: every subcommand with its arguments.

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand};
use repose_proto::place::{Rotation, Variant};
use repose_proto::scoring::RealismBy;
use repose_proto::{GoalTerm, Service};

use crate::commands::bench::BenchArgs;
use crate::commands::evaluate_segmentation::EvaluateSegmentationArgs;
use crate::commands::place_sequence::NextWish;
use crate::commands::play::{PlayArgs, TopicArgs};
use crate::embedded::NetworkArgs;

/// Repose finds where an object can be set down so that the asked relations hold and it stays, then puts it there.
#[derive(Debug, Parser)]
#[command(name = "repose", version, propagate_version = true)]
pub struct Cli {
    /// Print one JSON document on standard output (logs go to standard error).
    #[arg(long, global = true)]
    pub json: bool,
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// The subcommands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Everything in one process: a simulated cell, one placement asked, planned, executed and checked.
    Demo(DemoArgs),
    /// Every service as a process of its own on this machine, until interrupted.
    Up(UpArgs),
    /// One service.
    Serve(ServeArgs),
    /// One placement on a frame folder, without a running system.
    Plan(PlanArgs),
    /// Every pair's relations in a frame, learned and by rule.
    Relations(RelationsArgs),
    /// What the networks say of given placements.
    Score(ScoreArgs),
    /// One placement asked of a running system.
    Place(PlaceArgs),
    /// Many placements asked of a running system, and how long they took.
    Load(LoadArgs),
    /// A robot of a running system: stopped in an emergency, let go on, asked how it is.
    Robot(crate::commands::robot::RobotArgs),
    /// The objects and surfaces of a frame folder.
    Segment(SegmentArgs),
    /// Simulated scenes to train on.
    Generate(crate::commands::generate::GenerateArgs),
    /// Weights from simulated scenes.
    Train(TrainArgs),
    /// Parts of the weights that were trained apart, put into one file.
    Weights(crate::commands::weights::WeightsArgs),
    /// The paper's tables.
    Evaluate(EvaluateArgs),
    /// How fast a part is on this machine.
    Bench(BenchArgs),
    /// Frames from disk or a recording, published as a camera's.
    Play(PlayArgs),
}

/// A placement wished for: what both `plan` and `place` take.
#[derive(Debug, Clone, Args)]
pub struct WishArgs {
    /// The object to move, by id.
    #[arg(long = "move", value_name = "ID")]
    pub query: u16,
    /// What must hold, RELATION:ANCHOR or not:RELATION:ANCHOR; repeat for more terms.
    #[arg(long, required = true, value_name = "TERM")]
    pub goal: Vec<GoalTerm>,
    /// Which method plans: best, full, full_lambda_1, no_discriminator, mean_only, mdn_prior or geometric.
    #[arg(long, default_value = "best", value_parser = parse_variant)]
    pub variant: Variant,
    /// The source of every random number.
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// How many distinct placements are wanted.
    #[arg(long, default_value_t = 1)]
    pub count: u32,
    /// Whether the object may be turned: fixed or yaw.
    #[arg(long, default_value = "fixed", value_parser = parse_rotation)]
    pub rotation: Rotation,
    /// The viewer's direction, radians; the camera's where absent.
    #[arg(long, allow_negative_numbers = true)]
    pub view_yaw: Option<f64>,
    /// Iterations of the search.
    #[arg(long)]
    pub iterations: Option<u32>,
    /// Accepted candidates wanted per iteration.
    #[arg(long)]
    pub batch: Option<u32>,
    /// Least distance from everything but the support, metres.
    #[arg(long)]
    pub min_clearance: Option<f64>,
}

/// Where a router is looked for when nothing says otherwise, and where `up` has its own.
pub const ENDPOINT: &str = "tcp/127.0.0.1:7447";

/// How to reach a running system.
#[derive(Debug, Clone, Args)]
pub struct SystemArgs {
    /// A router of the deployment; the configuration's, or tcp/127.0.0.1:7447, where absent.
    #[arg(long, env = "REPOSE_CONNECT")]
    pub connect: Option<String>,
    /// The robot cell; the configuration's, or "cell", where absent.
    #[arg(long, env = "REPOSE_CELL")]
    pub cell: Option<String>,
    /// Configuration (TOML): its sections [session], [caller] and [worker].
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
}

/// A running system, and which of its cameras counts.
#[derive(Debug, Clone, Args)]
pub struct ConnectArgs {
    /// The system.
    #[command(flatten)]
    pub system: SystemArgs,
    /// The camera whose newest scene is used.
    #[arg(long, default_value = "front")]
    pub camera: String,
    /// The deadline of a request, milliseconds.
    #[arg(long, default_value_t = 60_000)]
    pub deadline_ms: u64,
}

/// Arguments of `demo`.
#[derive(Debug, Args)]
pub struct DemoArgs {
    /// The scene's seed.
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Which method plans.
    #[arg(long, default_value = "best", value_parser = parse_variant)]
    pub variant: Variant,
    /// Where the picture of before, plan and after goes.
    #[arg(long, default_value = "out/demo.png", value_name = "PNG")]
    pub out: PathBuf,
}

/// Arguments of `up`.
#[derive(Debug, Args)]
pub struct UpArgs {
    /// Where the router of this deployment listens; another machine needs tcp/0.0.0.0:7447.
    #[arg(long, default_value = ENDPOINT, env = "REPOSE_LISTEN")]
    pub listen: String,
    /// The robot cell; the configuration's, or "cell", where absent.
    #[arg(long, env = "REPOSE_CELL")]
    pub cell: Option<String>,
    /// How many inference processes.
    #[arg(long, default_value_t = 1)]
    pub inference: usize,
    /// How many planner processes.
    #[arg(long, default_value_t = 1)]
    pub planners: usize,
    /// Seed of the simulated scene; the configuration's, or 0, where absent.
    #[arg(long)]
    pub seed: Option<u64>,
    /// Configuration of the services (TOML).
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
}

/// Arguments of `serve`.
#[derive(Debug, Args)]
pub struct ServeArgs {
    /// perception, inference, planner, motion, simulator, or router.
    #[arg(value_parser = parse_served)]
    pub service: Served,
    /// The system. `--connect` is where the router itself listens.
    #[command(flatten)]
    pub system: SystemArgs,
    /// This worker's name in the key space; unique. The configuration's, or a new one, where absent.
    #[arg(long)]
    pub worker: Option<String>,
}

/// What a `serve` process is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Served {
    /// A service.
    Service(Service),
    /// The router that a deployment's processes meet at.
    Router,
}

/// Arguments of `plan`.
#[derive(Debug, Args)]
pub struct PlanArgs {
    /// The frame folder.
    pub frame: PathBuf,
    /// What is wished for.
    #[command(flatten)]
    pub wish: WishArgs,
    /// Which networks.
    #[command(flatten)]
    pub networks: NetworkArgs,
    /// A file of `train --network stability` to go with those weights; without it, what REPOSE_PLANNER__STABILITY names, as for services.
    #[arg(long, value_name = "FILE")]
    pub stability: Option<PathBuf>,
    /// Find the objects even where labels are given.
    #[arg(long)]
    pub ignore_labels: bool,
    /// A picture of before and after.
    #[arg(long, value_name = "PNG")]
    pub out: Option<PathBuf>,
}

/// Arguments of `relations`.
#[derive(Debug, Args)]
pub struct RelationsArgs {
    /// The frame folder.
    pub frame: PathBuf,
    /// Which networks.
    #[command(flatten)]
    pub networks: NetworkArgs,
}

/// Arguments of `score`.
#[derive(Debug, Args)]
pub struct ScoreArgs {
    /// The frame folder.
    pub frame: PathBuf,
    /// The object to move, by id.
    #[arg(long = "move", value_name = "ID")]
    pub query: u16,
    /// The anchor, by id.
    #[arg(long, value_name = "ID")]
    pub anchor: u16,
    /// JSON list of `placed_from_observed`, 16 numbers each.
    #[arg(long, value_name = "FILE")]
    pub transforms: PathBuf,
    /// Who answers for realism: discriminator (the paper's) or outcome (learned from simulated releases; what the variant `best` asks).
    #[arg(long, default_value = "discriminator", value_parser = parse_realism_by)]
    pub realism_by: RealismBy,
    /// Which networks.
    #[command(flatten)]
    pub networks: NetworkArgs,
}

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
    #[arg(long, value_name = "ID", conflicts_with_all = ["execute", "then"])]
    pub scene: Option<String>,
    /// Have the robot carry it out, and check the goal on the view after it.
    #[arg(long)]
    pub execute: bool,
    /// The next wish, ID=TERM[,TERM…] in the ids of the first view, once the one before has been carried out and its goal holds: planned
    /// on a fresh view. Repeat for more.
    #[arg(long, value_name = "WISH")]
    pub then: Vec<NextWish>,
    /// The robot that carries them out.
    #[arg(long, default_value = "panda")]
    pub robot: String,
}

/// Arguments of `load`.
#[derive(Debug, Clone, Args)]
pub struct LoadArgs {
    /// Where to ask.
    #[command(flatten)]
    pub connect: ConnectArgs,
    /// Clients that ask at the same time.
    #[arg(long, default_value_t = 4)]
    pub clients: usize,
    /// Requests in all.
    #[arg(long, default_value_t = 100)]
    pub requests: usize,
    /// Offered requests per second; without it each client asks as soon as it was answered.
    #[arg(long)]
    pub rate: Option<f64>,
    /// Which method plans.
    #[arg(long, default_value = "best", value_parser = parse_variant)]
    pub variant: Variant,
    /// Iterations of each search.
    #[arg(long, default_value_t = 1)]
    pub iterations: u32,
    /// Accepted candidates wanted per iteration.
    #[arg(long, default_value_t = 16)]
    pub batch: u32,
    /// Seed of the first request; each next one has the next.
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
}

/// Arguments of `segment`.
#[derive(Debug, Args)]
pub struct SegmentArgs {
    /// A frame folder, or anything that `play` plays.
    pub frame: PathBuf,
    /// Which of the source's frames, counted from 0.
    #[arg(long, default_value_t = 0)]
    pub nth: usize,
    /// Which topics of a recording.
    #[command(flatten)]
    pub topics: TopicArgs,
    /// Find the objects even where labels are given.
    #[arg(long)]
    pub ignore_labels: bool,
    /// The found labels as a 16-bit picture.
    #[arg(long, value_name = "PNG")]
    pub labels_out: Option<PathBuf>,
    /// A picture of color, depth, objects with ids and boxes, and the surfaces from above.
    #[arg(long, value_name = "PNG")]
    pub out: Option<PathBuf>,
}

/// Arguments of `train`.
#[derive(Debug, Args)]
pub struct TrainArgs {
    /// The folder of shards that `generate` wrote, with training and validation scenes somewhere below it.
    #[arg(long, value_name = "DIR")]
    pub data: PathBuf,
    /// Which networks: joint (encoders, relation predictor and prior), relations (the predictor alone, on the encoders of `--start`), discriminator,
    /// or outcome (the discriminator's layers on what simulated releases came to; needs `generate --releases`). The others keep the weights of
    /// `--start`. And stability: what `best` makes of the outcome network of `--start` with what geometry measures, a JSON file; needs the data
    /// of `generate --proposals`, made with its other settings as they are by default (`--steps` then limits the scenes).
    #[arg(long)]
    pub network: String,
    /// Which relation predictor `joint` and `relations` fit: measured (reads what can be measured of the pair beside the codes) or paper.
    #[arg(long, value_name = "VARIANT", default_value = "measured")]
    pub relations: String,
    /// What the networks are computed on: cpu, or cuda where the program was built with `--features cuda` (no two runs the same there).
    #[arg(long, value_name = "DEVICE", default_value = "cpu")]
    pub device: String,
    /// The weights file; a run that was stopped goes on from its checkpoint beside it (one that began with other weights is refused).
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Weights to start from; new ones from the seed by default.
    #[arg(long, value_name = "FILE")]
    pub start: Option<PathBuf>,
    /// Start from the mean of `--start` and these, runs of the same network from one ancestor; repeat for more. With `--steps 0` that mean is
    /// what is written, its batch statistics taken anew.
    #[arg(long, value_name = "FILE", requires = "start")]
    pub mean_with: Vec<PathBuf>,
    /// Seed of initial weights, order and augmentation.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// End after this many minutes, with weights.
    #[arg(long)]
    pub minutes: Option<f64>,
    /// End after this many steps.
    #[arg(long)]
    pub steps: Option<u64>,
    /// Threads, of which no more than `--slots` have work; all cores by default. The weights do not depend on it.
    #[arg(long)]
    pub threads: Option<usize>,
    /// Micro-batches of a step, whose gradients are averaged; 2 by default. More keep more threads busy, and give other weights.
    #[arg(long)]
    pub slots: Option<usize>,
}

/// Arguments of `evaluate`.
#[derive(Debug, Args)]
pub struct EvaluateArgs {
    /// Which table.
    #[command(subcommand)]
    pub table: Table,
}

/// The tables.
#[derive(Debug, Subcommand)]
pub enum Table {
    /// The planner's variants on simulated scenes never trained on.
    Planner(crate::commands::evaluate_planner::EvaluatePlannerArgs),
    /// Relations learned against by rule, on simulated scenes never trained on.
    Relations(crate::commands::evaluate_relations::EvaluateRelationsArgs),
    /// Realism against what physics does, on kitchens never trained on.
    Discriminator(crate::commands::evaluate_discriminator::EvaluateDiscriminatorArgs),
    /// The simulated world: rejected draws, rest, penetration, and whether releases depend on the physics step.
    World(crate::commands::evaluate_world::EvaluateWorldArgs),
    /// Perception's masks of labelled frames, labels ignored, against the labels.
    Segmentation(EvaluateSegmentationArgs),
    /// The simulated Panda picks and places named objects (the paper's Table 3).
    Robot(crate::commands::evaluate_robot::EvaluateRobotArgs),
}

/// The variant of that name.
pub fn parse_variant(name: &str) -> Result<Variant, String> {
    let known = || Variant::ALL.map(Variant::as_str).join(", ");
    Variant::parse(name).ok_or_else(|| format!("the variants are {}", known()))
}

fn parse_rotation(name: &str) -> Result<Rotation, String> {
    match name {
        "fixed" => Ok(Rotation::Fixed),
        "yaw" => Ok(Rotation::Yaw),
        _ => Err("expected fixed or yaw".to_owned()),
    }
}

fn parse_realism_by(name: &str) -> Result<RealismBy, String> {
    match name {
        "discriminator" => Ok(RealismBy::Discriminator),
        "outcome" => Ok(RealismBy::Outcome),
        _ => Err("expected discriminator or outcome".to_owned()),
    }
}

fn parse_served(name: &str) -> Result<Served, String> {
    if name == "router" {
        return Ok(Served::Router);
    }
    let known = || Service::ALL.map(Service::as_str).join(", ");
    Service::parse(name).map(Served::Service).ok_or_else(|| format!("the services are {}, router", known()))
}
