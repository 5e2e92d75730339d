//! The report of `evaluate world`.

use std::collections::BTreeMap;

use serde_json::{Value, json};

use crate::report::text;
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

/// The tables for people.
pub fn text_of(report: &WorldReport) -> String {
    let mut kinds = text::table(["kind", "scenes", "objects", "ms", "rejected"]);
    for (kind, row) in &report.kinds {
        kinds.add_row([
            kind.name().to_owned(),
            row.scenes.to_string(),
            format!("{:.1}", row.objects),
            format!("{:.0}", row.mean_ms),
            format!("{:.1} %", row.rejected_percent_of_draws()),
        ]);
    }
    let names = report.kinds.keys().map(|kind| kind.name());
    let mut reasons = text::table(std::iter::once("rejected for, %").chain(names).chain(["all"]));
    for (reason, all) in &report.rejected_percent {
        let of_kinds = report.kinds.values().map(|row| row.rejected_percent.get(reason).copied().unwrap_or(0.0));
        let percent = of_kinds.chain([*all]).map(|percent| format!("{percent:.1}"));
        reasons.add_row(std::iter::once((*reason).to_owned()).chain(percent));
    }
    let spread = |name: &str, s: &Spread| format!("{name}: median {:.2}, 99th percentile {:.2}, most {:.2} mm", s.p50, s.p99, s.max);
    let releases = &report.releases;
    let mut lines = vec![
        format!("{} scenes ({} seeds gave none), {:.1} scenes/s settled", report.scenes, report.failed, report.scenes_per_s),
        format!("{kinds}\n{reasons}"),
        spread("deepest overlap", &report.penetration_mm),
        spread("motion in a further second", &report.residual_mm),
    ];
    lines.push(text::paragraph(&format!(
        "releases: {:.1} % of {} end alike at a quarter of the physics step ({} stable at both steps, {} unstable at both, {} stable at the \
         usual step only, {} at the finer only)",
        releases.agreement_percent(),
        releases.placements,
        releases.both_stable,
        releases.both_unstable,
        releases.only_usual_stable,
        releases.only_finer_stable
    )));
    lines.push(text::legend(&LEGEND));
    lines.join("\n")
}

/// The columns, in their order.
const LEGEND: [(&str, &str); 3] = [
    ("objects", "in a scene, on average"),
    ("ms", "to make and settle a scene on one thread, rejected draws included"),
    ("rejected", "share of the draws that were no scene, by reason below"),
];
