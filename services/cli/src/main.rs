//! The `repose` command: every service, the tools around them, and the clients.

mod args;
mod client;
mod commands;
mod embedded;
mod failure;
mod frames;
mod histogram;
mod output;
mod picture;
mod segment_view;
mod services;
mod wish;

use std::process::ExitCode;

use args::{Cli, Command};
use clap::Parser;
use failure::{Failure, Outcome};
use output::Output;

// Tensors over 32 MB otherwise pay page faults on every operation.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    if let Err(error) = color_eyre::install() {
        eprintln!("panics will be reported plainly: {error}");
    }
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

/// Zenoh needs Tokio's multi-threaded runtime.
pub(crate) fn in_runtime(command: impl Future<Output = Outcome>) -> Outcome {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().map_err(Failure::other)?;
    runtime.block_on(command)
}
