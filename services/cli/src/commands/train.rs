//! `repose train`: weights from simulated scenes.

use repose_training::{Compute, ONE_THREAD_VARIABLES, Part, RelationsVariant, TrainError, TrainSettings, train};

use crate::args::TrainArgs;
use crate::failure::{Failure, Outcome};
use crate::output::Output;

/// Runs the command.
pub fn run(args: &TrainArgs, output: Output) -> Outcome {
    if args.network == super::train_stability::NAME {
        return super::train_stability::run(args, output);
    }
    let part = Part::parse(&args.network).ok_or_else(|| {
        Failure::bad_input("network", format!("expected joint, relations, discriminator, outcome or stability, got {:?}", args.network))
    })?;
    let relations = RelationsVariant::parse(&args.relations)
        .ok_or_else(|| Failure::bad_input("relations", format!("expected measured or paper, got {:?}", args.relations)))?;
    let device =
        Compute::parse(&args.device).ok_or_else(|| Failure::bad_input("device", format!("expected cpu or cuda, got {:?}", args.device)))?;
    for variable in ONE_THREAD_VARIABLES {
        // SAFETY: this command is synchronous and has started no thread yet that could read the environment meanwhile.
        unsafe { std::env::set_var(variable, "1") };
    }
    let defaults = TrainSettings::of_part(part);
    let settings = TrainSettings {
        data: args.data.clone(),
        out: args.out.clone(),
        start: args.start.clone(),
        mean_with: args.mean_with.clone(),
        relations,
        device,
        seed: args.seed,
        steps: args.steps.unwrap_or(defaults.steps),
        minutes: args.minutes,
        threads: args.threads.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, usize::from)),
        ..defaults
    };
    let report = train(&settings).map_err(|e| match e {
        TrainError::Cuda(reason) => Failure::bad_input("device", reason),
        e => Failure::bad_input("data", e),
    })?;
    output.print(&report, || serde_json::to_string_pretty(&report).unwrap_or_default())
}
