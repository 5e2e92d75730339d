//! What the forecast of success reads of a judged candidate ([`crate::learned::success`] names it).

use crate::judge::judged::JudgedCandidate;
use crate::judge::problem::PlacementProblem;
use crate::judge::standing::Standing;

/// Gaps are cut here, metres: more is as good.
const FAR_M: f64 = 0.06;

/// The measures of a candidate that the networks were asked about; none before that.
pub fn measures(problem: &PlacementProblem<'_>, standing: &Standing, judged: &JudgedCandidate) -> Option<Vec<f32>> {
    let of_place = judged.measures.as_ref()?;
    let goal = judged.relations.as_ref()?.iter().copied().fold(1.0, f32::min);
    let margin_m = judged.checks.as_ref()?.iter().map(|check| check.margin_m).fold(FAR_M, f64::min);
    let query = problem.query;
    let [length_m, width_m] = query.traits.spans_m;
    let beside = [
        f64::from(judged.realism?),
        f64::from(goal),
        margin_m.max(-FAR_M),
        standing.stands,
        standing.neighbours_stay,
        judged.fragile_share?,
        problem.shape_gap_m(&judged.candidate).min(FAR_M),
        query.traits.gap_m.min(FAR_M),
        query.traits.leaner.oblique.share,
        query.traits.leaner.oblique.off_rad,
        query.traits.leaner.over_m,
        f64::from(u8::from(query.traits.on_object)),
        query.traits.hidden_foot_m,
        query.traits.oblique.share,
        query.traits.oblique.off_rad,
        query.traits.oblique.level_share,
        f64::from(query.shape.axis_offset().norm()),
        length_m,
        width_m,
    ];
    Some(of_place.iter().copied().chain(beside.map(|value| value as f32)).collect())
}
