//! The `repose` command: every service, the tools around them, and the clients.

mod answer;
mod asynchronous;
mod client;
mod commands;
mod embedded;
mod failure;
mod frames;
mod output;
mod processes;
mod progress;
mod segment_view;
mod sequence;
mod services;
mod values;
mod wish;

use std::process::ExitCode;

use asynchronous::in_runtime;
use clap::{Parser, Subcommand};
use failure::Outcome;
use output::Output;

// Tensors over 32 MB otherwise pay page faults on every operation.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Repose finds where an object can be set down so that the asked relations hold and it stays, then puts it there.
#[derive(Debug, Parser)]
#[command(name = "repose", version, propagate_version = true)]
struct Cli {
    /// Print one JSON document on standard output (logs go to standard error).
    #[arg(long, global = true)]
    json: bool,
    /// What to do.
    #[command(subcommand)]
    command: Command,
}

/// The subcommands.
#[derive(Debug, Subcommand)]
enum Command {
    /// Everything in one process: a simulated cell, one placement asked, planned, executed and checked.
    Demo(commands::demo::DemoArgs),
    /// Every service as a process of its own on this machine, until interrupted.
    Up(commands::up::UpArgs),
    /// One service.
    Serve(commands::serve::ServeArgs),
    /// One placement on a frame folder, without a running system.
    Plan(commands::plan::PlanArgs),
    /// Every pair's relations in a frame, learned and by rule.
    Relations(commands::relations::RelationsArgs),
    /// What the networks say of given placements.
    Score(commands::score::ScoreArgs),
    /// One placement asked of a running system.
    Place(commands::place::PlaceArgs),
    /// Many placements asked of a running system, and how long they took.
    Load(commands::load::LoadArgs),
    /// A robot of a running system: stopped in an emergency, let go on, asked how it is.
    Robot(commands::robot::RobotArgs),
    /// The objects and surfaces of a frame folder.
    Segment(commands::segment::SegmentArgs),
    /// Simulated scenes to train on.
    Generate(commands::generate::GenerateArgs),
    /// Weights from simulated scenes.
    Train(commands::train::TrainArgs),
    /// Parts of the weights that were trained apart, put into one file.
    Weights(commands::weights::WeightsArgs),
    /// The paper's tables.
    Evaluate(commands::evaluate::EvaluateArgs),
    /// How fast a part is on this machine.
    Bench(commands::bench::BenchArgs),
    /// Frames from disk or a recording, published as a camera's.
    Play(commands::play::PlayArgs),
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    repose_runtime::start_logging("warn,zenoh=error,repose=info");
    match run(&cli) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            if let Some(error) = failure.error() {
                eprintln!("error: {error}");
                if cli.json {
                    println!("{}", serde_json::json!({"error": error}));
                }
            }
            ExitCode::from(failure.exit_code())
        }
    }
}

fn run(cli: &Cli) -> Outcome {
    let output = Output { json: cli.json };
    match &cli.command {
        Command::Demo(args) => in_runtime(commands::demo::run(args, output)),
        Command::Up(args) => in_runtime(commands::up::run(args, output)),
        Command::Serve(args) => in_runtime(commands::serve::run(args)),
        Command::Place(args) => in_runtime(commands::place::run(args, output)),
        Command::Load(args) => in_runtime(commands::load::run(args, output)),
        Command::Robot(args) => in_runtime(commands::robot::run(args, output)),
        Command::Plan(args) => commands::plan::run(args, output),
        Command::Relations(args) => commands::relations::run(args, output),
        Command::Score(args) => commands::score::run(args, output),
        Command::Segment(args) => commands::segment::run(args, output),
        Command::Generate(args) => commands::generate::run(args, output),
        Command::Weights(args) => commands::weights::run(args, output),
        Command::Train(args) => commands::train::run(args, output),
        Command::Evaluate(args) => commands::evaluate::run(args, output),
        Command::Bench(args) => commands::bench::run(args, output),
        Command::Play(args) => in_runtime(commands::play::run(args, output)),
    }
}
