//! A placement's evidence, and why there is none.

use std::collections::BTreeMap;

use repose_geometry::transform::{from_row_major, yaw_of};
use repose_proto::PlaceResult;
use repose_proto::place::{Outcome, Placement, Rejection, Shortfall, ShortfallReason, Variant};

/// A result for people.
pub fn describe(result: &PlaceResult) -> String {
    let goal = result.goal.iter().map(ToString::to_string).collect::<Vec<_>>().join(" and ");
    let (iterations, evaluated, variant) = (result.iterations, result.evaluated, result.variant);
    let effort = format!("{evaluated} candidates in {} ({variant})", counted(iterations, "iteration"));
    let mut lines = vec![match result.placements.len() {
        0 => format!("object {}, goal {goal}: no placement among {effort}", result.query),
        found => format!("object {}, goal {goal}: {} from {effort}", result.query, counted(found as u32, "placement")),
    }];
    if result.outcome == Outcome::Partial {
        lines.push("  the search was cut short by its time".to_owned());
    }
    for (rank, placement) in result.placements.iter().enumerate() {
        lines.push(format!("  {}. {}", rank + 1, motion(placement)));
        lines.push(format!("     {}", merits(placement, result)));
    }
    if let Some(shortfall) = &result.shortfall {
        lines.push(format!("  {} were asked for: {}", result.count, limit(shortfall, result)));
    }
    if result.placements.is_empty() {
        lines.push(format!("  rejected: {}", tally(&result.rejections)));
        lines.extend(relaxation(result).map(|said| format!("  {said}")));
    }
    lines.join("\n")
}

/// The term to give up so that there would be a placement, where one is known.
pub fn relaxation(result: &PlaceResult) -> Option<String> {
    result.relaxation.as_ref().map(|relaxation| format!("without {}, {} of them would pass", relaxation.term, relaxation.admits))
}

/// What limited the number of placements.
fn limit(shortfall: &Shortfall, result: &PlaceResult) -> String {
    let separation_mm = result.min_separation_m * 1e3;
    match shortfall.reason {
        ShortfallReason::Separation => {
            format!("the {} others that passed are less than {separation_mm:.0} mm (the separation) from these", shortfall.too_close)
        }
        ShortfallReason::Constraints => "no other candidate passed the constraints".to_owned(),
        ShortfallReason::Budget => "the search ended before every candidate was judged".to_owned(),
    }
}

/// Where a placement moves the object.
pub fn motion(placement: &Placement) -> String {
    let m = &placement.placed_from_observed.0;
    let turned = from_row_major(m).map_or(0.0, |t| yaw_of(&t).to_degrees());
    let tilted = m[10].clamp(-1.0, 1.0).acos().to_degrees();
    let side = if tilted >= 1.0 { format!(", on another side: tilt by {tilted:.0}°") } else { String::new() };
    format!("move by ({:+.3}, {:+.3}, {:+.3}) m, turn by {turned:.0}°{side}", m[3], m[7], m[11])
}

/// What speaks for a placement: only what somebody evaluated.
pub fn merits(placement: &Placement, result: &PlaceResult) -> String {
    let mut said: Vec<String> = placement.success.into_iter().map(|success| format!("success {success:.2}")).collect();
    said.extend(placement.realism.map(|realism| format!("realism {realism:.2}")));
    for (k, term) in result.goal.iter().enumerate() {
        let rule = placement.geometric.get(k).map(|g| if g.holds { "holds by rule" } else { "fails by rule" });
        let learned = placement.relations.get(k).filter(|_| result.variant != Variant::Geometric).map(|p| format!("p {p:.2}"));
        said.push(format!("{term}: {}", learned.into_iter().chain(rule.map(str::to_owned)).collect::<Vec<_>>().join(", ")));
    }
    said.extend(placement.support_m.map(|m| format!("support margin {:.0} mm", m * 1e3)));
    said.extend(placement.clearance_m.map(|m| format!("clearance {:.0} mm", m * 1e3)));
    said.join("; ")
}

/// What rejected candidates, the most frequent reason first.
pub fn tally(rejections: &BTreeMap<Rejection, u64>) -> String {
    let mut counts: Vec<(u64, String)> = rejections.iter().map(|(reason, count)| (*count, reason_name(*reason))).collect();
    counts.sort_by(|a, b| b.0.cmp(&a.0).then_with(|| a.1.cmp(&b.1)));
    counts.iter().map(|(count, reason)| format!("{reason} {count}")).collect::<Vec<_>>().join(", ")
}

fn reason_name(reason: Rejection) -> String {
    serde_json::to_value(reason).ok().and_then(|v| v.as_str().map(|name| name.replace('_', " "))).unwrap_or_default()
}

fn counted(count: u32, noun: &str) -> String {
    if count == 1 { format!("1 {noun}") } else { format!("{count} {noun}s") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_most_frequent_reason_is_said_first() {
        let rejections = BTreeMap::from([(Rejection::Collision, 3), (Rejection::OutOfView, 7), (Rejection::Goal, 3)]);
        assert_eq!(tally(&rejections), "out of view 7, collision 3, goal 3");
    }
}
