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
        slots: args.slots.unwrap_or(defaults.slots),
        threads: args.threads.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, usize::from)),
        ..defaults
    };
    let report = train(&settings).map_err(|e| failure_of(&e))?;
    output.print(&report, || serde_json::to_string_pretty(&report).unwrap_or_default())
}

/// The user's, where a setting is at fault.
fn failure_of(error: &TrainError) -> Failure {
    match error.field() {
        Some(field) => Failure::bad_input(field, error),
        None => Failure::other(error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_setting_at_fault_is_bad_input_that_names_it_and_the_rest_is_not() {
        let start = TrainSettings { start: Some("no/such.safetensors".into()), ..TrainSettings::default() };
        let field = |failure: Failure| failure.error().and_then(|e| e.field.clone());
        let failure = failure_of(&train(&start).unwrap_err());
        assert_eq!((failure.exit_code(), field(failure).as_deref()), (2, Some("start")));
        let failure = failure_of(&TrainError::Diverged { step: 3, loss: f64::NAN });
        assert_eq!((failure.exit_code(), field(failure)), (1, None));
    }
}
