//! The report of `evaluate world`.

use std::collections::BTreeMap;

use comfy_table::Table;
use serde_json::{Value, json};

use crate::statistics::quantile::Spread;
use crate::tables::world::WorldReport;

/// The JSON.
pub fn document(report: &WorldReport) -> Value {
    let by_kind: BTreeMap<&str, f64> = report.kinds.iter().map(|(kind, row)| (kind.name(), row.rejected_percent_of_draws())).collect();
    json!({
        "scenes": report.scenes,
        "failed": report.failed,
        "scenes_per_s": report.scenes_per_s,
        "rejected_percent": {"by_reason": report.rejected_percent, "by_kind": by_kind},
        "kinds": report.kinds,
        "penetration_mm": report.penetration_mm,
        "residual_mm": report.residual_mm,
        "release_agreement_percent": report.releases.agreement_percent(),
        "placements": report.releases.placements,
        "releases": report.releases,
    })
}

/// The table for people.
pub fn text_of(report: &WorldReport) -> String {
    let mut table = Table::new();
    let reasons: Vec<&str> = report.rejected_percent.keys().copied().collect();
    let mut header = vec!["kind", "scenes", "objects", "ms", "rejected %"];
    header.extend(&reasons);
    table.set_header(header);
    for (kind, row) in &report.kinds {
        let mut cells = vec![
            kind.name().to_owned(),
            row.scenes.to_string(),
            format!("{:.1}", row.objects),
            format!("{:.0}", row.mean_ms),
            format!("{:.1}", row.rejected_percent_of_draws()),
        ];
        cells.extend(reasons.iter().map(|reason| format!("{:.1}", row.rejected_percent.get(reason).copied().unwrap_or(0.0))));
        table.add_row(cells);
    }
    let spread = |name: &str, s: &Spread| format!("{name}: median {:.2}, 99 % {:.2}, most {:.2} mm", s.p50, s.p99, s.max);
    let releases = &report.releases;
    format!(
        "{} scenes ({} seeds gave none), {:.1} scenes/s settled\n{table}\n{}\n{}\nreleases: {:.1} % of {} the same at a quarter of the step ({} stable, {} not, {} only at the usual step, {} only at the finer)",
        report.scenes,
        report.failed,
        report.scenes_per_s,
        spread("deepest overlap", &report.penetration_mm),
        spread("motion in a further second", &report.residual_mm),
        releases.agreement_percent(),
        releases.placements,
        releases.both_stable,
        releases.both_unstable,
        releases.only_usual_stable,
        releases.only_finer_stable
    )
}
