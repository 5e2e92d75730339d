//! `repose evaluate discriminator`: realism against what physics does with an object that is let go there.

use std::path::PathBuf;

use clap::Args;
use repose_evaluation::report::discriminator::{document, pictures, text_of};
use repose_evaluation::report::written::write_report;
use repose_evaluation::tables::discriminator::{DiscriminatorSettings, evaluate_discriminator};
use repose_proto::place::Variant;
use serde_json::json;

use super::shared::{TableArgs, can_report, folder_name, only_meshes, told};
use crate::failure::{CommandResult, Failure};
use crate::output::Output;
use crate::progress::Progress;
use crate::values::{distinct_or, parse_count, parse_variant};

/// Arguments of `evaluate discriminator`.
#[derive(Debug, Args)]
pub struct EvaluateDiscriminatorArgs {
    /// How many scenes; the paper has 100.
    #[arg(long, default_value_t = 100, value_parser = parse_count)]
    pub scenes: usize,
    /// Random prior samples per scene; the paper has one.
    #[arg(long, default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub samples: u32,
    /// A variant whose placements are scored; repeat for more. The first gives the main figures.
    #[arg(long = "variant", default_values = ["best", "full"], value_parser = parse_variant)]
    pub variants: Vec<Variant>,
    /// A folder of meshes to make the scenes from, instead of the objects that training uses.
    #[arg(long, value_name = "DIR")]
    pub objects: Option<PathBuf>,
    /// Split, weights and threads.
    #[command(flatten)]
    pub common: TableArgs,
    /// A folder for the table as JSON, the scatter plot and the reliability diagrams as SVG.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

/// Runs the command.
pub fn run(args: &EvaluateDiscriminatorArgs, output: Output) -> CommandResult {
    can_report(args.out.as_deref(), "discriminator")?;
    let mut settings = DiscriminatorSettings {
        samples: args.samples,
        variants: distinct_or(&args.variants, &[]),
        threads: args.common.threads(),
        ..DiscriminatorSettings::default()
    };
    if let Some(folder) = &args.objects {
        only_meshes(&mut settings.problem.scene, folder)?;
    }
    let engine = args.common.engine()?;
    let objects = folder_name(args.objects.as_deref());
    let made_with = json!({
        "weights_hash": engine.weights_hash(), "objects": objects, "scenes": args.scenes, "samples": settings.samples,
        "variants": settings.variants,
    });
    let scenes = args.common.first("discriminator", &made_with)?;
    settings.first = scenes.first;
    let progress = Progress::new(args.scenes as u64, "scenes");
    let table = evaluate_discriminator(scenes.seeds_of, args.scenes, &engine, &settings, |scenes| progress.set(scenes as u64))?;
    progress.finish();
    let document = document(&table, &scenes.named(&made_with));
    let written = match &args.out {
        Some(folder) => write_report(folder, "discriminator", &document, &pictures(&table).map_err(Failure::other)?),
        None => Ok(()),
    };
    told(written, || output.print(&document, || text_of(&table)))
}

#[cfg(test)]
mod tests {
    use clap::Parser;
    use serde_json::Value;

    use super::*;

    type Line = crate::testing::Line<EvaluateDiscriminatorArgs>;

    #[test]
    fn two_scenes_leave_a_report_with_the_contracts_keys() {
        let folder = tempfile::tempdir().expect("a folder");
        let out = folder.path().to_str().expect("a plain path");
        let line = ["x", "--scenes", "2", "--samples", "2", "--variant", "geometric", "--split", "validation", "--out", out];
        run(&Line::parse_from(line).args, Output { json: false }).unwrap_or_else(|e| panic!("{e:?}"));
        let document: Value =
            serde_json::from_slice(&std::fs::read(folder.path().join("discriminator.json")).expect("a file")).expect("JSON");
        for key in ["scenes", "stable", "stable_with_goal", "pearson_r", "pearson_p", "auc_random", "calibration_error"] {
            assert!(document.get(key).is_some_and(|v| v.is_null() || v.is_number()), "{key}: {document}");
        }
        assert_eq!(document["scenes"], 2);
        assert!(document["pearson_one_a_scene"]["n"].as_u64().is_some_and(|n| n <= 2), "{document}");
        assert!(document["stable"].as_f64().is_some_and(|s| (0.0..=100.0).contains(&s)));
        for picture in ["discriminator.svg", "reliability_geometric.svg"] {
            assert!(std::fs::read_to_string(folder.path().join(picture)).expect("a picture").contains("</svg>"));
        }
    }
}
