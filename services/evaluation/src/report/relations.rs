//! The report of `evaluate relations`: JSON with the contract's keys, tables with the paper's figures beside ours, bars as SVG.

use comfy_table::Table;
use serde_json::{Value, json};

use crate::report::plots::{Bars, DrawError, grouped_bars};
use crate::tables::paper;
use crate::tables::relations::{Figure, JudgedBy, MethodScores, RelationRow, RelationsTable};

/// What the table is of; part of the JSON.
const EXAMPLE: &str = "an example is an ordered pair of objects of one view (one view a scene), both seen in it and kept by perception; \
                       ground truth: instance masks, camera pose, meshes and poses; as in the paper's data, the query's cloud is from a picture without the other \
                       objects and the anchor's from one without the query, depth as rendered; `apart`: the same pictures with a random camera's faults, \
                       borders cleaned by perception; `together`: such a camera's picture of all, each object hiding what it hides";

/// The JSON: the table of pictures as rendered on top, the others under `apart` and `together`.
pub fn document(table: &RelationsTable, [apart, together]: &[RelationsTable; 2], split: &str, weights_hash: &str) -> Value {
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

/// F1 of every relation and method, as bars.
///
/// # Errors
/// When the picture cannot be drawn.
pub fn pictures(table: &RelationsTable, [apart, together]: &[RelationsTable; 2]) -> Result<Vec<(String, String)>, DrawError> {
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
    let svg = grouped_bars(&format!("F1 of {} held-out examples", table.examples), &names, &series)?;
    Ok(vec![("relations".to_owned(), svg)])
}

/// The tables for people.
pub fn text_of(table: &RelationsTable, [apart, together]: &[RelationsTable; 2]) -> String {
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
