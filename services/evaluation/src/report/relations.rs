//! The report of `evaluate relations`: JSON with the contract's keys, tables with the paper's figures beside ours, bars as SVG.

use comfy_table::Table;
use serde_json::{Value, json};

use crate::report::plots::{BarSeries, DrawError, grouped_bars};
use crate::report::text::{legend, paragraph, table};
use crate::tables::paper;
use crate::tables::relations::{Figure, JudgedBy, MethodScores, RelationRow, RelationsTable};

/// What the table is of; part of the JSON.
const EXAMPLE: &str = "an example is an ordered pair of objects of one view (one view a scene), both seen in it and kept by perception; \
                       ground truth: instance masks, camera pose, meshes and poses; as in the paper's data, the query's cloud is from a picture without the other \
                       objects and the anchor's from one without the query, depth as rendered; `apart`: the same pictures with a random camera's faults, \
                       borders cleaned by perception; `together`: such a camera's picture of all, each object hiding what it hides";

/// The JSON: the table of pictures as rendered on top, the others under `apart` and `together`; `made_with` names split, weights and commit.
pub fn document(table: &RelationsTable, [apart, together]: &[RelationsTable; 2], made_with: &Value) -> Value {
    let of = |table: &RelationsTable| {
        json!({
            "examples": table.examples, "scenes": table.scenes, "views": table.views, "lost_pairs": table.lost,
            "relations": table.rows.iter().map(row_document).collect::<Vec<_>>(),
        })
    };
    let mut document = of(table);
    for (name, value) in made_with.as_object().into_iter().flatten() {
        document[name] = value.clone();
    }
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
    let ours = |name: &'static str, table: &RelationsTable, of: fn(&RelationRow) -> &MethodScores| BarSeries {
        name,
        values: table.rows.iter().map(|row| of(row).f1.value).collect(),
        intervals: table.rows.iter().map(|row| of(row).f1.interval).collect(),
    };
    let theirs = |name: &'static str, of: fn(&paper::PaperRelation) -> f64| BarSeries {
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
    let RelationsTable { examples, scenes, views, lost, .. } = table;
    let head = format!("{examples} examples of {views} views of {scenes} scenes; {lost} pairs were lost by perception.");
    format!(
        "{head}\n\nThe paper's Table 2: pictures as rendered\n{}\n\nF1 of the learned predictor with a camera's faults\n{}\n\nSensitivity and \
         specificity, pictures as rendered\n{}\n\n{}\n\n{}",
        f1_table(table),
        faults_table(table, apart, together),
        rates_table(table),
        legend(&LEGEND),
        paragraph(EXAMPLE)
    )
}

/// The columns, in the order of the tables.
const LEGEND: [(&str, &str); 6] = [
    ("true", "share of the examples in which the relation holds, percent; the paper's in brackets"),
    ("learned, rule", "the relation predictor, and the geometric rules on the same clouds; with 95 % intervals over scenes"),
    ("at paper's", "the F1 of this sensitivity and specificity at the paper's share of true examples: F1 depends on that share"),
    ("paper", "the same method's figure in the paper"),
    ("apart, together", "a random camera's faults; each object hides what it hides in `together` only"),
    ("(by rule)", "the networks leave this relation to the rules, as the paper's do"),
];

fn name(row: &RelationRow) -> String {
    match row.judged_by {
        JudgedBy::Network => row.relation.to_string(),
        JudgedBy::Rule => format!("{} (by rule)", row.relation),
    }
}

fn f1_table(of: &RelationsTable) -> Table {
    let mut table = table(["relation", "true", "F1 learned", "at paper's", "paper", "F1 rule", "at paper's", "paper"]);
    for row in &of.rows {
        let prevalence = row.paper.as_ref().map_or_else(|| "-".to_owned(), |p| format!("{:.1}", p.true_percent));
        table.add_row([
            name(row),
            format!("{:.1} ({prevalence})", row.learned.counts.true_percent()),
            with_interval(row.learned.f1),
            plain(row.learned.f1_at_paper_prevalence),
            papers(row, |p| p.f1),
            with_interval(row.baseline.f1),
            plain(row.baseline.f1_at_paper_prevalence),
            papers(row, |p| p.baseline_f1),
        ]);
    }
    table
}

fn faults_table(rendered: &RelationsTable, apart: &RelationsTable, together: &RelationsTable) -> Table {
    let mut table = table(["relation", "rendered", "apart", "together", "paper"]);
    for ((row, apart), together) in rendered.rows.iter().zip(&apart.rows).zip(&together.rows) {
        let f1 = |row: &RelationRow| with_interval(row.learned.f1);
        table.add_row([name(row), f1(row), f1(apart), f1(together), papers(row, |p| p.f1)]);
    }
    table
}

fn rates_table(of: &RelationsTable) -> Table {
    let columns = ["learned", "paper", "rule", "paper"];
    let header = ["sensitivity", "specificity"].into_iter().flat_map(|what| columns.map(|c| format!("{what} {c}")));
    let mut table = table(std::iter::once("relation".to_owned()).chain(header));
    for row in &of.rows {
        table.add_row([
            name(row),
            plain(row.learned.sensitivity),
            papers(row, |p| p.sensitivity),
            plain(row.baseline.sensitivity),
            papers(row, |p| p.baseline_sensitivity),
            plain(row.learned.specificity),
            papers(row, |p| p.specificity),
            plain(row.baseline.specificity),
            papers(row, |p| p.baseline_specificity),
        ]);
    }
    table
}

fn papers(row: &RelationRow, of: fn(&paper::PaperRelation) -> f64) -> String {
    row.paper.as_ref().map_or_else(|| "-".to_owned(), |p| format!("{:.3}", of(p)))
}

fn plain(figure: Figure) -> String {
    figure.value.map_or_else(|| "-".to_owned(), |v| format!("{v:.3}"))
}

fn with_interval(figure: Figure) -> String {
    let interval = figure.interval.map_or_else(String::new, |[low, high]| format!(" [{low:.3}, {high:.3}]"));
    format!("{}{interval}", plain(figure))
}
