//! `repose weights`: parts that were trained apart, put into one file; and the outcome network calibrated on what became of placements.

use std::path::{Path, PathBuf};

use clap::Args;
use repose_networks::Weights;
use repose_proto::place::Variant;
use repose_training::calibration::PlattScaling;
use repose_training::{Part, merge::merged};
use serde::Deserialize;
use serde_json::json;

use crate::failure::{Failure, Outcome};
use crate::output::Output;

/// Arguments of `weights`.
#[derive(Debug, Args)]
pub struct WeightsArgs {
    /// Weights whose encoders, relation predictor and prior are taken.
    #[arg(long, value_name = "FILE")]
    pub joint: PathBuf,
    /// Weights whose relation predictor is taken in place of that of `--joint`; it must have been trained on the same encoders.
    #[arg(long, value_name = "FILE")]
    pub relations: Option<PathBuf>,
    /// Weights whose discriminator is taken.
    #[arg(long, value_name = "FILE")]
    pub discriminator: PathBuf,
    /// Weights whose outcome network is taken; the result has none without.
    #[arg(long, value_name = "FILE")]
    pub outcome: Option<PathBuf>,
    /// What `evaluate discriminator --split validation` wrote (`discriminator.json`) of these very weights without this: the outcome network is
    /// scaled so that what it says of prior draws and of `best`'s placements comes true as often as it says.
    #[arg(long, value_name = "FILE", requires = "outcome")]
    pub calibrate: Option<PathBuf>,
    /// The file that is written.
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
}

/// Runs the command.
pub fn run(args: &WeightsArgs, output: Output) -> Outcome {
    let read = |field: &str, path: &Path| {
        let failed = |e: &dyn std::fmt::Display| Failure::bad_input(field, format!("{}: {e}", path.display()));
        Weights::from_bytes(&std::fs::read(path).map_err(|e| failed(&e))?).map_err(|e| failed(&e))
    };
    let mut parts = vec![(Part::Joint, read("joint", &args.joint)?), (Part::Discriminator, read("discriminator", &args.discriminator)?)];
    for (part, path) in [(Part::Relations, &args.relations), (Part::Outcome, &args.outcome)] {
        if let Some(path) = path {
            parts.push((part, read(part.name(), path)?));
        }
    }
    let mut bytes = merged(&parts).map_err(|e| Failure::bad_input("weights", e))?;
    if let Some(path) = &args.calibrate {
        bytes = calibrated(&bytes, path)?;
    }
    repose_dataset::write_whole(&args.out, &bytes).map_err(|e| Failure::bad_input("out", format!("{}: {e}", args.out.display())))?;
    let hash = Weights::from_bytes(&bytes).map_err(Failure::other)?.hash;
    let document = json!({"weights": args.out, "hash": hash, "bytes": bytes.len()});
    output.print(&document, || format!("{}: {} bytes, {hash}", args.out.display(), bytes.len()))
}

/// What is read of the document of `evaluate discriminator`.
#[derive(Debug, Deserialize)]
struct Tried {
    split: String,
    weights_hash: String,
    trials: Vec<Trial>,
}

#[derive(Debug, Deserialize)]
struct Trial {
    variant: Option<Variant>,
    realism: f64,
    outcome: Option<f64>,
    judged: Judged,
}

#[derive(Debug, Deserialize)]
struct Judged {
    stable: bool,
}

impl Tried {
    /// What the outcome network said, and what came of it.
    fn forecasts(&self) -> Vec<(f64, bool)> {
        let said = |t: &Trial| match t.variant {
            None => t.outcome,
            Some(Variant::Best) => Some(t.realism),
            Some(_) => None,
        };
        self.trials.iter().filter_map(|t| Some((said(t)?, t.judged.stable))).collect()
    }
}

/// The weights with their outcome network calibrated on the trials in a document; how is added to its recipe.
fn calibrated(bytes: &[u8], document: &Path) -> Result<Vec<u8>, Failure> {
    let bad = |e: &dyn std::fmt::Display| Failure::bad_input("calibrate", format!("{}: {e}", document.display()));
    let tried: Tried = serde_json::from_slice(&std::fs::read(document).map_err(|e| bad(&e))?).map_err(|e| bad(&e))?;
    let mut weights = Weights::from_bytes(bytes).map_err(Failure::other)?;
    if tried.split != repose_dataset::Split::Validation.name() {
        return Err(bad(&format!("expected trials on validation scenes, these are of the {} split", tried.split)));
    }
    if tried.weights_hash != weights.hash {
        return Err(bad(&format!("its trials are of the weights {}, and these are {}", tried.weights_hash, weights.hash)));
    }
    let forecasts = tried.forecasts();
    let scaling = PlattScaling::fit(&forecasts).map_err(|e| bad(&e))?;
    scaling.build_in(&mut weights.values).map_err(|e| bad(&e))?;
    weights.info.recipe[Part::Outcome.name()]["calibration"] =
        json!({"slope": scaling.slope, "shift": scaling.shift, "forecasts": forecasts.len(), "of": tried.weights_hash});
    Weights::to_bytes(&weights.values, &weights.info).map_err(Failure::other)
}

#[cfg(test)]
mod tests {
    use repose_networks::NetworksConfig;

    use super::*;

    fn run_with(arguments: &WeightsArgs) -> Result<Weights, Failure> {
        run(arguments, Output { json: false })?;
        Ok(Weights::from_bytes(&std::fs::read(&arguments.out).expect("written")).expect("weights"))
    }

    #[test]
    fn a_calibrated_network_says_what_came_of_it_and_foreign_trials_are_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        let at = |name: &str| folder.path().join(name);
        std::fs::write(at("start"), Weights::initial(&NetworksConfig::default(), 1).expect("weights")).expect("written");
        let arguments = |calibrate: Option<PathBuf>, out: &str| WeightsArgs {
            joint: at("start"),
            relations: None,
            discriminator: at("start"),
            outcome: Some(at("start")),
            calibrate,
            out: at(out),
        };
        let plain = run_with(&arguments(None, "plain")).unwrap_or_else(|e| panic!("{e:?}"));
        // It says .7, .75 and .8, of which a third, half and two thirds come true.
        let trial = |i: usize| {
            let said = [0.7, 0.75, 0.8][i % 3];
            let stable = [i % 9 < 3, i % 2 == 0, i % 9 < 6][i % 3];
            let (variant, outcome) = if i < 180 { (Some("best"), None) } else { (None, Some(said)) };
            json!({"variant": variant, "realism": said, "outcome": outcome, "judged": {"stable": stable}})
        };
        let trials: Vec<_> = (0..360).map(trial).collect();
        let write = |name: &str, split: &str, hash: &str| {
            let text = json!({"split": split, "weights_hash": hash, "trials": trials}).to_string();
            std::fs::write(at(name), text).expect("written");
            at(name)
        };
        let fitted = run_with(&arguments(Some(write("right", "validation", &plain.hash)), "out")).unwrap_or_else(|e| panic!("{e:?}"));
        let recipe = &fitted.info.recipe["outcome"]["calibration"];
        let scaling = PlattScaling { slope: recipe["slope"].as_f64().expect("a slope"), shift: recipe["shift"].as_f64().expect("a shift") };
        assert!((scaling.of(0.75) - 0.5).abs() < 0.02, "{scaling:?}");
        assert_eq!((&recipe["forecasts"], &recipe["of"]), (&json!(360), &json!(plain.hash)));
        assert_ne!(fitted.values["outcome/out/bias"], plain.values["outcome/out/bias"]);
        assert_eq!(fitted.values["discriminator/out/bias"], plain.values["discriminator/out/bias"]);
        for (name, split, hash) in [("test", "test", plain.hash.as_str()), ("foreign", "validation", "another")] {
            let refused = run_with(&arguments(Some(write(name, split, hash)), "refused")).expect_err(name);
            assert_eq!(refused.exit_code(), 2);
        }
        assert!(!at("refused").exists());
    }
}
