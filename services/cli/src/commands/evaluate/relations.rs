//! `repose evaluate relations`: the paper's Table 2 with its appendix, learned against by rule.

use std::path::PathBuf;

use clap::Args;
use repose_evaluation::report::relations::{document, pictures, text_of};
use repose_evaluation::report::written::write_report;
use repose_evaluation::tables::relations::{CloudSource, RelationsSettings, evaluate_relations};
use serde_json::json;

use super::shared::{TableArgs, can_report, folder_name, only_meshes, told};
use crate::failure::{CommandResult, Failure};
use crate::output::Output;
use crate::progress::Progress;
use crate::values::parse_count;

/// Arguments of `evaluate relations`.
#[derive(Debug, Args)]
pub struct EvaluateRelationsArgs {
    /// Minimum number of examples; the paper has 2,696.
    #[arg(long, default_value_t = 4000, value_parser = parse_count)]
    pub examples: usize,
    /// A folder of meshes to make the scenes from, instead of the objects that training uses.
    #[arg(long, value_name = "DIR")]
    pub objects: Option<PathBuf>,
    /// Split, weights and threads.
    #[command(flatten)]
    pub common: TableArgs,
    /// A folder for the table as JSON and as SVG.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

/// Runs the command.
pub fn run(args: &EvaluateRelationsArgs, output: Output) -> CommandResult {
    can_report(args.out.as_deref(), "relations")?;
    let mut settings = RelationsSettings { threads: args.common.threads(), ..RelationsSettings::default() };
    if let Some(folder) = &args.objects {
        only_meshes(&mut settings.scene, folder)?;
    }
    let engine = args.common.engine()?;
    let objects = folder_name(args.objects.as_deref());
    let made_with = json!({"weights_hash": engine.weights_hash(), "objects": objects, "examples": args.examples});
    let scenes = args.common.first("relations", &made_with)?;
    settings.first = scenes.first;
    let mut table_of = |shown: CloudSource| {
        settings.shown = shown;
        let progress = Progress::new(args.examples as u64, &format!("examples, {shown:?}").to_lowercase());
        let table = evaluate_relations(scenes.seeds_of, args.examples, &engine, &settings, |examples| progress.set(examples as u64));
        progress.finish();
        table
    };
    let (table, beside) = (table_of(CloudSource::Rendered)?, [table_of(CloudSource::Apart)?, table_of(CloudSource::Together)?]);
    let document = document(&table, &beside, &scenes.named(&made_with));
    let written = match &args.out {
        Some(folder) => write_report(folder, "relations", &document, &pictures(&table, &beside).map_err(Failure::other)?),
        None => Ok(()),
    };
    told(written, || output.print(&document, || text_of(&table, &beside)))
}

#[cfg(test)]
mod tests {
    use clap::Parser;
    use serde_json::Value;

    use super::*;

    type Line = crate::testing::Line<EvaluateRelationsArgs>;

    #[test]
    fn a_few_examples_leave_a_report_with_the_contracts_keys() {
        let folder = tempfile::tempdir().expect("a folder");
        let out = folder.path().join("out");
        let line = ["x", "--examples", "12", "--split", "validation", "--out", out.to_str().expect("a plain path")];
        run(&Line::parse_from(line).args, Output { json: false }).unwrap_or_else(|e| panic!("{e:?}"));
        let document: Value = serde_json::from_slice(&std::fs::read(out.join("relations.json")).expect("a file")).expect("JSON");
        assert!(document["examples"].as_u64().is_some_and(|n| n >= 12));
        let rows = document["relations"].as_array().expect("rows");
        assert_eq!(rows.len(), 10);
        let keys = ["f1", "sensitivity", "specificity", "true_percent", "baseline_f1", "baseline_sensitivity", "baseline_specificity"];
        for row in rows {
            assert!(row["relation"].is_string());
            assert!(keys.iter().all(|k| row.get(k).is_some_and(|v| v.is_null() || v.as_f64().is_some_and(|f| f >= 0.0))), "{row}");
        }
        assert!(std::fs::read_to_string(out.join("relations.svg")).expect("a picture").contains("</svg>"));
    }

    #[test]
    fn what_cannot_be_is_named() {
        let refused = Line::try_parse_from(["x", "--split", "tests"]).err().expect("refused").to_string();
        assert!(refused.contains("--split") && refused.contains("validation"), "{refused}");
        let failed = run(&Line::parse_from(["x", "--objects", "no/such/folder"]).args, Output { json: false }).expect_err("a failure");
        assert_eq!(failed.exit_code(), 2);
        // Before anything else is looked at: making the table takes hours.
        let file = tempfile::NamedTempFile::new().expect("a file");
        let below = file.path().join("out").display().to_string();
        let line = ["x", "--objects", "no/such/folder", "--out", &below];
        let failed = run(&Line::parse_from(line).args, Output { json: false }).expect_err("a failure");
        assert_eq!((failed.exit_code(), failed.error().and_then(|e| e.field.as_deref())), (2, Some(&*below)));
    }
}
