//! The report of `evaluate belief`.

use crate::report::text;
use crate::tables::belief::{BeliefTable, ErrorSpread};

/// The table for people.
pub fn text_of(table: &BeliefTable) -> String {
    let mut rows = text::table([
        "kind",
        "objects",
        "bottom",
        "feet",
        "far side",
        "near side",
        "mass away",
        "across",
        "in doubt",
        "base",
        "outline",
        "prisms",
        "volume",
    ]);
    for (name, row) in &table.rows {
        let error = |e: &ErrorSpread| format!("{:+.1} {:.1} {:.1}", e.middle, e.p50, e.p90);
        rows.add_row([
            name.clone(),
            row.objects.to_string(),
            error(&row.bottom_mm),
            row.foot_right.to_string(),
            error(&row.far_mm),
            error(&row.near_mm),
            error(&row.axis_away_mm),
            error(&row.axis_across_mm),
            format!("{:.1} %", row.within_doubt * 100.0),
            format!("{:.3}", row.base_overlap),
            format!("{:.3}", row.outline_overlap),
            format!("{:.3}", row.prism_overlap),
            format!("{:.3}", row.volume_overlap),
        ]);
    }
    let mut loads = text::table(["kind", "objects", "bearers: recall", "precision", "pairs: recall", "precision"]);
    for (name, row) in &table.loads {
        let rates = [row.bearers_told, row.bearers_right, row.pairs_told, row.pairs_right].map(|rate| rate.to_string());
        loads.add_row([name.clone(), row.objects.to_string()].into_iter().chain(rates));
    }
    [rows.to_string(), loads.to_string(), format!("{:.1} ms a scene (median)", table.ms), text::legend(&LEGEND)].join("\n")
}

/// The columns, in their order.
const LEGEND: [(&str, &str); 8] = [
    ("bottom, far side, near side", "errors in mm, believed less true: median with its sign, median and 90th percentile of their sizes"),
    ("feet", "objects whose bottom is as high as is believed, within 8 mm"),
    ("mass away, across", "the same of the centre of mass, away from the camera and across"),
    ("in doubt", "objects that end within what is said to be possible on the far side"),
    ("base, outline", "what the believed and the true one, seen from above, have in common, as a share of both together"),
    ("prisms, volume", "the same of the prisms that are believed, and of those around the true shape or its volume"),
    (
        "bearers",
        "objects on which another lies that the camera saw: of these, those believed to bear something; of those believed to, these",
    ),
    ("pairs", "the same of every object and each that lies on it"),
];
