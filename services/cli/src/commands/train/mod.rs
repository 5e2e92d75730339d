//! `repose train`: weights from simulated scenes.

mod back;
mod bearing;
mod cut;
mod farther;
mod foot;
pub mod made_with;
mod stability;
mod standing;
mod success;
mod tried;

use std::path::{Path, PathBuf};

use clap::Args;
use repose_evaluation::report::written::can_write;
use repose_networks::Weights;
use repose_planner::learned::forecast::{Forecast, STABILITY, SUCCESS};
use repose_training::{Compute, ONE_THREAD_VARIABLES, RelationsVariant, TrainError, TrainSettings, TrainedPart, train};

use self::tried::FitArgs;
use crate::failure::{CommandResult, Failure};
use crate::output::Output;
use crate::values::threads;

/// Scenes that `success` tries unless told.
const SUCCESS_SCENES: u64 = 700;
/// What `--network` calls the forecasts of how objects stand.
const STANDING: &str = "standing";
/// What `--network` calls how far objects go on behind what was seen of them.
const BACK: &str = "back";
/// Scenes that `back` tries unless told.
const BACK_SCENES: u64 = 1500;
/// What `--network` calls how far objects go on where they are cut off.
const CUT: &str = "cut";
/// Scenes that `cut` tries unless told.
const CUT_SCENES: u64 = 4000;
/// What `--network` calls how likely objects go on farther than is believed.
const FARTHER: &str = "farther";
/// Scenes that `farther` tries unless told.
const FARTHER_SCENES: u64 = 3000;
/// What `--network` calls which objects bear which.
const BEARING: &str = "bearing";
/// Scenes that `bearing` tries unless told.
const BEARING_SCENES: u64 = 1500;
/// What `--network` calls how high objects' bottoms are.
const FOOT: &str = "foot";
/// Scenes that `foot` tries unless told.
const FOOT_SCENES: u64 = 3000;
/// Scenes that `standing` tries unless told.
const STANDING_SCENES: u64 = 2000;

/// What is fitted in place of trained.
const FITTED: [&str; 8] = [STABILITY, STANDING, SUCCESS, BACK, CUT, FARTHER, BEARING, FOOT];
/// The relation predictor that is trained unless told.
const RELATIONS: &str = "measured";
/// Where networks are trained unless told.
const DEVICE: &str = "cpu";

/// Arguments of `train`.
#[derive(Debug, Args)]
pub struct TrainArgs {
    /// The folder of shards written by `generate`: training and validation scenes in it, or each in a folder `train` and `validation` of it. Scenes that
    /// are tried for a fit are kept there, and refused once what they were measured with has changed.
    #[arg(long, value_name = "DIR")]
    pub data: PathBuf,
    /// What to train. Networks: joint (encoders, relation predictor and prior), relations (the predictor alone, on the encoders of `--start`),
    /// discriminator, or outcome (on the outcomes of `generate --releases`); networks that are not trained keep the weights of `--start`.
    /// Forecasts, boosted trees on geometry and on the outcome network of `--start`, which the variant `best` uses: standing (whether objects
    /// stand by themselves, and whether their neighbours stay when they are taken away; fitted on `--steps` scenes, 2000 by default), then
    /// stability (fitted on `generate --proposals` with its other settings at their defaults; `--steps` limits the scenes), then success (fitted
    /// on outcomes of the planner's own answers in `--steps` scenes, 700 by default). Shape completion: back (how far
    /// objects extend behind their observed points; fitted on `--steps` scenes, 1500 by default), cut (how far where something nearer or the
    /// picture's edge cuts them off; 4000), foot (how high their bottoms are; 3000), farther (how likely they go on farther than all that says; 3000), and
    /// loads: bearing (which objects lie on which; 1500), which are not part of the weights: set `--out` to back.json, cut.json, foot.json, farther.json
    /// or bearing.json in services/shared/belief/weights and build the program again.
    #[arg(long)]
    pub network: String,
    /// The relation predictor that `joint` and `relations` train: measured (uses geometric measures of the pair beside the codes) or paper.
    #[arg(long, value_name = "VARIANT", default_value = RELATIONS)]
    pub relations: String,
    /// Where to compute: cpu, or cuda where the program was built with `--features cuda` (runs are not reproducible there).
    #[arg(long, value_name = "DEVICE", default_value = DEVICE)]
    pub device: String,
    /// The weights file to write. An interrupted run resumes from the checkpoint beside it, unless it started from other weights.
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Weights to start from. Default: new ones, drawn from the seed.
    #[arg(long, value_name = "FILE")]
    pub start: Option<PathBuf>,
    /// Start from the mean of `--start` and these weights, which must come from runs of the same network with one ancestor; repeat for more. With
    /// `--steps 0` the mean itself is written, with new batch statistics.
    #[arg(long, value_name = "FILE", requires = "start")]
    pub mean_with: Vec<PathBuf>,
    /// Seed of initial weights, order and augmentation.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Stop after this many minutes, and write the weights. Of networks only.
    #[arg(long)]
    pub minutes: Option<f64>,
    /// Stop after this many steps.
    #[arg(long)]
    pub steps: Option<u64>,
    /// The first scene that a forecast, `back`, `cut`, `farther`, `foot` or `bearing` is fitted on, to make its data in parts.
    #[arg(long, default_value_t = 0)]
    pub first: u64,
    /// Threads; at most `--slots` of them are used. Default: one per core. The weights do not depend on it.
    #[arg(long)]
    pub threads: Option<usize>,
    /// Micro-batches per step, whose gradients are averaged. Default: 2. More of them use more threads, and give other weights.
    #[arg(long)]
    pub slots: Option<usize>,
}

/// Runs the command.
pub fn run(args: &TrainArgs, output: Output) -> CommandResult {
    args.check()?;
    // After the training would be too late to say so.
    can_write(&args.out)?;
    let fit_on = |scenes: u64| FitArgs {
        data: &args.data,
        start: args.start.as_deref(),
        out: &args.out,
        first: args.first,
        scenes: args.steps.unwrap_or(scenes),
        threads: threads(args.threads),
        seed: args.seed,
    };
    match args.network.as_str() {
        SUCCESS => return success::run(&fit_on(SUCCESS_SCENES), output),
        BACK => return back::run(&fit_on(BACK_SCENES), output),
        CUT => return cut::run(&fit_on(CUT_SCENES), output),
        FARTHER => return farther::run(&fit_on(FARTHER_SCENES), output),
        BEARING => return bearing::run(&fit_on(BEARING_SCENES), output),
        FOOT => return foot::run(&fit_on(FOOT_SCENES), output),
        STANDING => return standing::run(&fit_on(STANDING_SCENES), output),
        // All that there are.
        STABILITY => return stability::run(&fit_on(u64::MAX), output),
        _ => {}
    }
    let part = TrainedPart::parse(&args.network).ok_or_else(|| {
        Failure::bad_input(
            "network",
            format!(
                "expected joint, relations, discriminator, outcome, stability, standing, success, back, cut, farther, foot or bearing, got {:?}",
                args.network
            ),
        )
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
        threads: threads(args.threads),
        ..defaults
    };
    let report = train(&settings).map_err(|e| failure_of(&e))?;
    output.print(&report, || {
        let figures = report.metrics.as_object().into_iter().flatten().map(|(name, value)| format!("  {name}: {value}"));
        let measured = if report.metrics.is_null() { "no validation scenes: not measured" } else { "figures on validation scenes:" };
        let head = format!(
            "{}: {} steps on {} training views, {:.0} samples/s\n{measured}",
            args.out.display(),
            report.steps,
            report.views,
            report.samples_per_s
        );
        std::iter::once(head).chain(figures).collect::<Vec<_>>().join("\n")
    })
}

impl TrainArgs {
    /// Refuses what would go unheeded: a fit has no steps that end early, and networks are trained on all scenes that there are.
    fn check(&self) -> CommandResult {
        let is_fitted = FITTED.contains(&self.network.as_str());
        let of_networks = [
            ("minutes", self.minutes.is_some()),
            ("slots", self.slots.is_some()),
            ("mean-with", !self.mean_with.is_empty()),
            ("relations", self.relations != RELATIONS),
            ("device", self.device != DEVICE),
        ];
        let of_fits = [("first", self.first != 0)];
        let unheeded = if is_fitted { &of_networks[..] } else { &of_fits[..] };
        match unheeded.iter().find(|(_, is_given)| *is_given) {
            Some((option, _)) if is_fitted => Err(Failure::bad_input(option, format!("is for networks, and {} is fitted", self.network))),
            Some((option, _)) => Err(Failure::bad_input(option, "is for what is fitted: a forecast, or how shapes are completed")),
            None => Ok(()),
        }
    }
}

/// The weights of `start`, or the program's own.
fn weights_of(start: Option<&Path>) -> Result<Weights, Failure> {
    let Some(path) = start else { return Weights::embedded().map_err(Failure::other) };
    let bad = |e: &dyn std::fmt::Display| Failure::bad_input("start", format!("{}: {e}", path.display()));
    Weights::from_bytes(&std::fs::read(path).map_err(|e| bad(&e))?).map_err(|e| bad(&e))
}

/// Writes the weights of `start`, or the program's own, with forecasts in place of those of their names. The forecast of success, which reads
/// what the others say, goes when one of those is fitted anew.
fn with_forecasts(start: Option<&Path>, out: &Path, forecasts: &[(&str, &Forecast)]) -> CommandResult {
    let mut weights = weights_of(start)?;
    weights.info.forecasts.remove(SUCCESS);
    for (name, forecast) in forecasts {
        weights.info.forecasts.insert((*name).to_owned(), serde_json::to_value(forecast).map_err(Failure::other)?);
    }
    let bytes = Weights::to_bytes(&weights.values, &weights.info).map_err(Failure::other)?;
    repose_dataset::write_whole(out, &bytes).map_err(|e| Failure::bad_input("out", format!("{}: {e}", out.display())))
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
    use clap::Parser;

    use super::*;

    type Line = crate::testing::Line<TrainArgs>;

    #[test]
    fn what_a_fit_or_a_training_would_not_heed_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let [data, out] = ["data", "out.json"].map(|name| folder.path().join(name).display().to_string());
        let refused = |network: &str, options: &[&str]| {
            let line = ["train", "--steps", "1", "--data", &data, "--out", &out, "--network", network];
            let failure = run(&Line::parse_from(line.iter().chain(options)).args, Output { json: false }).unwrap_err();
            (failure.exit_code(), failure.error().and_then(|e| e.field.clone()).unwrap_or_default())
        };
        let of_networks: [&[&str]; 4] = [&["--minutes", "5"], &["--slots", "4"], &["--relations", "paper"], &["--device", "cuda"]];
        for options in of_networks {
            assert_eq!(refused(STANDING, options), (2, options[0].trim_start_matches('-').to_owned()));
        }
        assert_eq!(refused(BACK, &["--start", "w.safetensors", "--mean-with", "w.safetensors"]), (2, "mean-with".to_owned()));
        assert_eq!(refused("joint", &["--first", "40"]), (2, "first".to_owned()));
        assert_eq!(refused(FOOT, &["--first", "50000000"]), (2, "first".to_owned()), "there the validation scenes begin");
    }

    #[test]
    fn the_forecast_that_a_new_relation_predictor_leaves_out_is_that_of_success() {
        assert_eq!(repose_training::merge::READS_RELATIONS, SUCCESS);
    }

    #[test]
    fn a_setting_at_fault_is_bad_input_that_names_it_and_the_rest_is_not() {
        let start = TrainSettings { start: Some("no/such.safetensors".into()), ..TrainSettings::default() };
        let field = |failure: Failure| failure.error().and_then(|e| e.field.clone());
        let failure = failure_of(&train(&start).unwrap_err());
        assert_eq!((failure.exit_code(), field(failure).as_deref()), (2, Some("start")));
        for minutes in [f64::NAN, f64::INFINITY, 0.0, -1.0] {
            let timed = TrainSettings { minutes: Some(minutes), ..TrainSettings::default() };
            assert_eq!(field(failure_of(&train(&timed).unwrap_err())).as_deref(), Some("minutes"), "{minutes}");
        }
        let failure = failure_of(&TrainError::Diverged { step: 3, loss: f64::NAN });
        assert_eq!((failure.exit_code(), field(failure)), (1, None));
    }
}
