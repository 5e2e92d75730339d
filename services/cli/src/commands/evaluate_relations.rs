//! `repose evaluate relations`: the paper's Table 2 with its appendix, learned against by rule.

use std::path::PathBuf;

use clap::Args;
use comfy_table::Table;
use repose_evaluation::relations_table::{Figure, JudgedBy, MethodScores, RelationRow, Shown};
use repose_evaluation::svg::{Bars, grouped_bars};
use repose_evaluation::{RelationsSettings, RelationsTable, evaluate_relations, paper};
use serde_json::{Value, json};

use crate::commands::evaluate_scenes::{TableArgs, only_meshes, write_report};
use crate::failure::{Failure, Outcome};
use crate::output::Output;

/// What the table is of; part of the JSON.
const EXAMPLE: &str = "an example is an ordered pair of objects of one view (one view a scene), both seen in it and kept by perception; \
                       ground truth: instance masks, camera pose, meshes and poses; as in the paper's data, the query's cloud is from a picture without the other \
                       objects and the anchor's from one without the query, depth as rendered; `apart`: the same pictures with a random camera's faults, \
                       borders cleaned by perception; `together`: such a camera's picture of all, each object hiding what it hides";

/// Arguments of `evaluate relations`.
#[derive(Debug, Args)]
pub struct EvaluateRelationsArgs {
    /// How many examples at least; the paper has 2,696.
    #[arg(long, default_value_t = 4000)]
    pub examples: usize,
    /// A folder of meshes to make the scenes of, in place of the objects that training uses.
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
pub fn run(args: &EvaluateRelationsArgs, output: Output) -> Outcome {
    let split = args.common.split()?;
    let mut settings = RelationsSettings { threads: args.common.threads(), ..RelationsSettings::default() };
    if let Some(folder) = &args.objects {
        only_meshes(&mut settings.scene, folder)?;
    }
    let engine = args.common.engine()?;
    let mut table_of = |shown: Shown| {
        settings.shown = shown;
        evaluate_relations(split, args.examples, &engine, &settings, |examples| tracing::info!(?shown, examples, "judged"))
    };
    let (table, beside) = (table_of(Shown::Rendered)?, [table_of(Shown::Apart)?, table_of(Shown::Together)?]);
    let document = document(&table, &beside, &args.common.split, engine.weights_hash());
    if let Some(folder) = &args.out {
        write_report(folder, "relations", &document, &[("relations", picture(&table, &beside)?)])?;
    }
    output.print(&document, || text_of(&table, &beside))
}

fn document(table: &RelationsTable, [apart, together]: &[RelationsTable; 2], split: &str, weights_hash: &str) -> Value {
    let of = |table: &RelationsTable| {
        json!({
            "examples": table.examples, "scenes": table.scenes, "views": table.views, "lost_pairs": table.lost,
            "relations": table.rows.iter().map(row_document).collect::<Vec<_>>(),
        })
    };
    let mut document = of(table);
    document["split"] = json!(split);
    document["weights_hash"] = json!(weights_hash);
    document["definition"] = json!(EXAMPLE);
    document["paper_examples"] = json!(paper::RELATION_EXAMPLES);
    document["apart"] = of(apart);
    document["together"] = of(together);
    document
}

fn row_document(row: &RelationRow) -> Value {
    let mut document = json!({
        "relation": row.relation, "judged_by": row.judged_by, "true_percent": row.learned.counts.true_percent(), "paper": row.paper,
    });
    for (prefix, scores) in [("", &row.learned), ("baseline_", &row.baseline)] {
        let figures = [
            ("f1", scores.f1),
            ("f1_at_paper_prevalence", scores.f1_at_paper_prevalence),
            ("sensitivity", scores.sensitivity),
            ("specificity", scores.specificity),
        ];
        for (name, figure) in figures {
            document[format!("{prefix}{name}")] = json!(figure.value);
            document[format!("{prefix}{name}_interval")] = json!(figure.interval);
        }
        document[format!("{prefix}counts")] = json!(scores.counts);
    }
    document
}

fn picture(table: &RelationsTable, [apart, together]: &[RelationsTable; 2]) -> Result<String, Failure> {
    let names: Vec<&str> = table.rows.iter().map(|row| row.relation.as_str()).collect();
    let ours = |name: &'static str, table: &RelationsTable, of: fn(&RelationRow) -> &MethodScores| Bars {
        name,
        values: table.rows.iter().map(|row| of(row).f1.value).collect(),
        intervals: table.rows.iter().map(|row| of(row).f1.interval).collect(),
    };
    let theirs = |name: &'static str, of: fn(&paper::PaperRelation) -> f64| Bars {
        name,
        values: table.rows.iter().map(|row| row.paper.as_ref().map(of)).collect(),
        intervals: vec![None; table.rows.len()],
    };
    let series = [
        ours("learned", table, |row| &row.learned),
        ours("learned, apart", apart, |row| &row.learned),
        ours("learned, together", together, |row| &row.learned),
        ours("by rule", table, |row| &row.baseline),
        theirs("paper, learned", |p| p.f1),
        theirs("paper, by rule", |p| p.baseline_f1),
    ];
    grouped_bars(&format!("F1 of {} held-out examples", table.examples), &names, &series).map_err(Failure::other)
}

fn text_of(table: &RelationsTable, [apart, together]: &[RelationsTable; 2]) -> String {
    let mut text = Table::new();
    text.set_header([
        "relation",
        "% true (paper)",
        "F1 learned",
        "at paper's %",
        "paper",
        "apart",
        "together",
        "F1 by rule",
        "at paper's %",
        "paper",
        "sensitivity learned, rule (paper)",
        "specificity learned, rule (paper)",
    ]);
    for (row, (apart, together)) in table.rows.iter().zip(apart.rows.iter().zip(&together.rows)) {
        let paper = |of: fn(&paper::PaperRelation) -> f64| row.paper.as_ref().map_or_else(|| "-".to_owned(), |p| format!("{:.3}", of(p)));
        let pair = |of: fn(&MethodScores) -> Figure, theirs: String, their_baseline: String| {
            format!("{}, {} ({theirs}, {their_baseline})", plain(of(&row.learned)), plain(of(&row.baseline)))
        };
        let name = match row.judged_by {
            JudgedBy::Network => row.relation.to_string(),
            JudgedBy::Rule => format!("{} (by rule)", row.relation),
        };
        let prevalence = row.paper.as_ref().map_or_else(|| "-".to_owned(), |p| format!("{:.1}", p.true_percent));
        text.add_row([
            name,
            format!("{:.1} ({prevalence})", row.learned.counts.true_percent()),
            with_interval(row.learned.f1),
            plain(row.learned.f1_at_paper_prevalence),
            paper(|p| p.f1),
            with_interval(apart.learned.f1),
            with_interval(together.learned.f1),
            with_interval(row.baseline.f1),
            plain(row.baseline.f1_at_paper_prevalence),
            paper(|p| p.baseline_f1),
            pair(|s| s.sensitivity, paper(|p| p.sensitivity), paper(|p| p.baseline_sensitivity)),
            pair(|s| s.specificity, paper(|p| p.specificity), paper(|p| p.baseline_specificity)),
        ]);
    }
    let RelationsTable { examples, scenes, views, lost, .. } = table;
    format!("{examples} examples of {views} views of {scenes} scenes ({lost} pairs lost by perception); {EXAMPLE}\n{text}")
}

fn plain(figure: Figure) -> String {
    figure.value.map_or_else(|| "-".to_owned(), |v| format!("{v:.3}"))
}

fn with_interval(figure: Figure) -> String {
    let interval = figure.interval.map_or_else(String::new, |[low, high]| format!(" [{low:.3}, {high:.3}]"));
    format!("{}{interval}", plain(figure))
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        args: EvaluateRelationsArgs,
    }

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
        let failed = |line: &[&str]| run(&Line::parse_from(line).args, Output { json: false }).expect_err("a failure").exit_code();
        assert_eq!(failed(&["x", "--split", "tests"]), 2);
        assert_eq!(failed(&["x", "--objects", "no/such/folder"]), 2);
    }
}
