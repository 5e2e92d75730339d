//! A placement's evidence, and why there is none.

use std::collections::BTreeMap;

use repose_geometry::transform::{from_row_major, yaw_of};
use repose_proto::place::{Outcome, Placement, Rejection, Shortfall, ShortfallReason, Variant};
use repose_proto::{ObjectSummary, PlaceResult, RigidTransform};

/// The centre of an object among a scene's.
pub fn center_of(objects: &[ObjectSummary], id: u16) -> Option<[f64; 3]> {
    objects.iter().find(|object| object.id == id).map(|object| object.centroid_m)
}

/// A result for people, with the centre of its object where that is known.
pub fn describe(result: &PlaceResult, center_m: Option<[f64; 3]>) -> String {
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
        lines.push(format!("  {}. {}", rank + 1, motion(placement, center_m)));
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

/// Where a placement moves the object: how far its centre goes, and how it is turned about that. Without the centre, how the whole space is turned
/// about its origin and moved.
pub fn motion(placement: &Placement, center_m: Option<[f64; 3]>) -> String {
    let m = &placement.placed_from_observed.0;
    let turned = from_row_major(m).map_or(0.0, |t| yaw_of(&t).to_degrees());
    let tilted = m[10].clamp(-1.0, 1.0).acos().to_degrees();
    let side = if tilted >= 1.0 { format!(", on another side: tilt by {tilted:.0}°") } else { String::new() };
    let [x, y, z] = center_m.map_or([m[3], m[7], m[11]], |center| {
        let placed = carried(&placement.placed_from_observed, center);
        std::array::from_fn(|k| placed[k] - center[k])
    });
    let moved = format!("move by ({x:+.3}, {y:+.3}, {z:+.3}) m");
    let is_about_origin = center_m.is_none() && (turned.abs() >= 0.5 || tilted >= 1.0);
    if is_about_origin {
        format!("turn by {turned:.0}° about the world's origin{side}, then {moved}")
    } else {
        format!("{moved}, turn by {turned:.0}°{side}")
    }
}

/// Where a motion carries a point.
pub fn carried(placed_from_observed: &RigidTransform, point: [f64; 3]) -> [f64; 3] {
    let m = &placed_from_observed.0;
    std::array::from_fn(|row| (0..3).map(|k| m[4 * row + k] * point[k]).sum::<f64>() + m[4 * row + 3])
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
    fn an_object_that_is_turned_goes_where_its_centre_goes() {
        // A quarter turn about its own centre, and 10 cm along x.
        let placed_from_observed = RigidTransform([0., -1., 0., 0.8, 1., 0., 0., -0.4, 0., 0., 1., 0., 0., 0., 0., 1.]);
        let placement = Placement {
            placed_from_observed,
            cost: 0.0,
            realism: None,
            success: None,
            relations: Vec::new(),
            geometric: Vec::new(),
            support_m: None,
            clearance_m: None,
        };
        assert_eq!(motion(&placement, Some([0.55, 0.15, 0.05])), "move by (+0.100, +0.000, +0.000) m, turn by 90°");
        assert_eq!(motion(&placement, None), "turn by 90° about the world's origin, then move by (+0.800, -0.400, +0.000) m");
        let shifted = Placement {
            placed_from_observed: RigidTransform([1., 0., 0., 0.1, 0., 1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1.]),
            ..placement
        };
        assert_eq!(motion(&shifted, None), motion(&shifted, Some([0.55, 0.15, 0.05])), "what is not turned needs no centre");
    }

    #[test]
    fn the_most_frequent_reason_is_said_first() {
        let rejections = BTreeMap::from([(Rejection::Collision, 3), (Rejection::OutOfView, 7), (Rejection::Goal, 3)]);
        assert_eq!(tally(&rejections), "out of view 7, collision 3, goal 3");
    }
}
