//! The `repose` command: every service, the tools around them, and the clients.

#![allow(rustdoc::broken_intra_doc_links, reason = "comments of arguments are help pages, in which brackets are brackets")]

mod answer;
mod arrangement;
mod asynchronous;
mod cell_survey;
mod client;
mod clocks;
mod commands;
mod embedded;
mod environment;
mod failure;
mod film;
mod frames;
mod moving;
mod output;
mod processes;
mod progress;
mod say;
mod segment_view;
mod sequence;
mod services;
mod terminal;
#[cfg(test)]
mod testing;
mod usage;
mod values;
mod wish;

use std::process::ExitCode;

use asynchronous::in_runtime;
use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use failure::CommandResult;
use output::Output;

// Tensors over 32 MB otherwise pay page faults on every operation.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Repose finds where an object can be placed so that the requested relations hold and it stays there, then has a robot place it.
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
    /// Run everything in one process: plan a placement in a simulated cell, have the robot carry it out, and check the result.
    Demo(commands::demo::DemoArgs),
    /// Start every service on this machine, each in its own process, and run until interrupted.
    Up(commands::up::UpArgs),
    /// Run one service, or the router, in this process.
    Serve(commands::serve::ServeArgs),
    /// Drive a real robot from its host, as this process.
    Driver(commands::driver::DriverArgs),
    /// Find a placement in a frame, without a running system.
    Plan(commands::plan::PlanArgs),
    /// Find the moves that make several goals hold together, in a frame or in a running system's newest scene.
    Arrange(commands::arrange::ArrangeArgs),
    /// List every pair of objects in a frame with its relations, learned and by rule.
    Relations(commands::relations::RelationsArgs),
    /// Score given placements with the networks.
    Score(commands::score::ScoreArgs),
    /// Ask a running system for a placement, and with --execute have its robot carry it out.
    Place(commands::place::PlaceArgs),
    /// Show the newest scene of a running system's camera: its objects and their ids.
    Scene(commands::scene::SceneArgs),
    /// Show what is running, how well it does, and what is wrong.
    Status(commands::status::StatusArgs),
    /// List the cells of a running system, with their cameras, robots and workers.
    Cells(commands::cells::CellsArgs),
    /// Ask a running system for many placements, and measure how long they take.
    Load(commands::load::LoadArgs),
    /// Stop or reset a robot of a running system, bring it home, or show its state.
    Robot(commands::robot::RobotArgs),
    /// Find the objects and surfaces of a frame or a recording.
    Segment(commands::segment::SegmentArgs),
    /// Generate simulated scenes to train on.
    Generate(commands::generate::GenerateArgs),
    /// Train networks on generated scenes.
    Train(commands::train::TrainArgs),
    /// Combine separately trained networks into one weights file.
    Weights(commands::weights::WeightsArgs),
    /// Measure accuracy: the paper's tables, and others.
    Evaluate(commands::evaluate::EvaluateArgs),
    /// Measure the speed of one part on this machine.
    Bench(commands::bench::BenchArgs),
    /// Record a running cell, to inspect, play back or replay.
    Record(commands::record::RecordArgs),
    /// Send the requests of a recording again, and compare the answers.
    Replay(commands::replay::ReplayArgs),
    /// Play frames or a recording as a camera, or play a whole recorded cell.
    Play(commands::play::PlayArgs),
    /// Serve tools for agents over the Model Context Protocol: look at a running cell, plan, and execute.
    Mcp(commands::mcp::McpArgs),
    /// Generate the configuration of a deployment with users from one roles file; `deploy check` tests the permissions.
    Deploy(commands::deploy::DeployArgs),
}

/// The command line. Several commands share options, of which some commands have their own help and their own conflicts.
fn command_line() -> clap::Command {
    let driver = |driver: clap::Command| driver.mut_subcommand("franka", commands::driver::with_own_help);
    let command = Cli::command().mut_subcommand("serve", commands::serve::with_own_help).mut_subcommand("driver", driver);
    command.mut_subcommand("arrange", commands::arrange::with_own_conflicts)
}

fn main() -> ExitCode {
    let cli = match command_line().try_get_matches().and_then(|matches| Cli::from_arg_matches(&matches)) {
        Ok(cli) => cli,
        Err(said) => return usage::print(&said),
    };
    repose_runtime::start_logging("warn,zenoh=error,repose=info");
    match environment::check().and_then(|()| run(&cli)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            if let Some(error) = failure.error() {
                Output { json: cli.json }.print_error(error);
            }
            ExitCode::from(failure.exit_code())
        }
    }
}

fn run(cli: &Cli) -> CommandResult {
    let output = Output { json: cli.json };
    match &cli.command {
        Command::Demo(args) => in_runtime(commands::demo::run(args, output)),
        Command::Up(args) => in_runtime(commands::up::run(args, output)),
        Command::Serve(args) => in_runtime(commands::serve::run(args)),
        Command::Driver(args) => in_runtime(commands::driver::run(args)),
        Command::Place(args) => in_runtime(commands::place::run(args, output)),
        Command::Arrange(args) => in_runtime(commands::arrange::run(args, output)),
        Command::Scene(args) => in_runtime(commands::scene::run(args, output)),
        Command::Status(args) => in_runtime(commands::status::run(args, output)),
        Command::Cells(args) => in_runtime(commands::cells::run(args, output)),
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
        Command::Record(args) => in_runtime(commands::record::run(args, output)),
        Command::Replay(args) => in_runtime(commands::replay::run(args, output)),
        Command::Play(args) => in_runtime(commands::play::run(args, output)),
        Command::Mcp(args) => in_runtime(commands::mcp::run(args)),
        Command::Deploy(args) => commands::deploy::run(args, output),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn processes_of_a_system_say_what_they_do_with_the_options_of_clients() {
        command_line().debug_assert();
        let help = |names: &[&str]| {
            let mut command = command_line();
            let found = names.iter().try_fold(&mut command, |command, name| command.find_subcommand_mut(name));
            let help = found.map(|command| command.render_long_help().to_string()).unwrap_or_default();
            help.split_whitespace().collect::<Vec<_>>().join(" ")
        };
        let serve = help(&["serve"]);
        assert!(serve.contains("`serve router` listens there") && serve.contains("[planner]"), "{serve}");
        assert!(help(&["driver", "franka"]).contains("[franka]"));
        assert!(help(&["scene"]).contains("its sections [session], [caller] and [worker]"), "clients read these");
    }
}
