//! What is said and drawn of a placement that was asked for: by `plan`, `place` and sequences of them.

use nalgebra::Isometry3;
use repose_evaluation::report::picture::{Coloring, draw_ids, scene_picture, side_by_side};
use repose_geometry::transform::from_row_major;
use repose_proto::{PlaceResult, Scene};

use crate::failure::{Failure, Outcome};
use crate::output::Output;

/// The scene with ids, and the scene with the best placement drawn in.
pub fn before_and_after(scene: &Scene, result: &PlaceResult) -> Result<image::RgbImage, Failure> {
    let mut before = scene_picture(scene, Coloring::Seen, None);
    draw_ids(&mut before, scene);
    let Some(best) = result.placements.first() else { return Ok(before) };
    let placed_from_observed: Isometry3<f64> = from_row_major(&best.placed_from_observed.0).map_err(Failure::other)?;
    let after = scene_picture(scene, Coloring::Seen, Some((result.query, &placed_from_observed)));
    Ok(side_by_side(&[before, after]))
}

/// Prints a result; ends in [`Failure::NoPlacement`] when it has none.
pub fn print_result(result: &PlaceResult, output: Output) -> Outcome {
    output.print(result, || describe(result))?;
    if result.placements.is_empty() { Err(Failure::NoPlacement) } else { Ok(()) }
}

/// A result for people.
pub fn describe(result: &PlaceResult) -> String {
    let goal = result.goal.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
    let mut text = format!(
        "object {} to {goal}: {:?} after {} iterations and {} candidates ({})",
        result.query, result.outcome, result.iterations, result.evaluated, result.variant
    );
    for (rank, placement) in result.placements.iter().enumerate() {
        let m = &placement.placed_from_observed.0;
        let yaw = from_row_major(m).map_or(0.0, |t| repose_geometry::transform::yaw_of(&t).to_degrees());
        let relations = placement.relations.iter().map(|p| format!("{p:.2}")).collect::<Vec<_>>().join(" ");
        let by_rule = placement.geometric.iter().map(|g| if g.holds { "holds" } else { "fails" }).collect::<Vec<_>>().join(" ");
        text += &format!(
            "\n  {rank}: moved by ({:+.3}, {:+.3}, {:+.3}) m, turned {yaw:.0}°; realism {:.3}, relations {relations}, by rule: {by_rule}; {:.0} mm inside its support, {:.0} mm clear",
            m[3],
            m[7],
            m[11],
            placement.realism,
            placement.support_m * 1e3,
            placement.clearance_m * 1e3
        );
    }
    if result.placements.is_empty() {
        let tally = result.rejections.iter().map(|(reason, n)| format!("{n} {}", reason_name(*reason))).collect::<Vec<_>>().join(", ");
        text += &format!("\n  rejected: {tally}");
        if let Some(relaxation) = &result.relaxation {
            text += &format!("\n  without {} {} candidates would have passed", relaxation.term, relaxation.admits);
        }
    }
    text
}

fn reason_name(reason: repose_proto::place::Rejection) -> String {
    serde_json::to_value(reason).ok().and_then(|v| v.as_str().map(str::to_owned)).unwrap_or_default()
}
