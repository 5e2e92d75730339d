//! What the forecast of success reads of a judged candidate ([`crate::learned::success`] names it).

use repose_belief::view::OutlineEnds;
use repose_proto::Relation;

use crate::checks::unseen::unread_share;
use crate::judge::judged::JudgedCandidate;
use crate::judge::problem::PlacementProblem;
use crate::judge::standing::Standing;
use crate::scene::traits::spans_m;
use crate::scene::turned::Turned;

/// Gaps are cut here, metres: more is as good.
const FAR_M: f64 = 0.06;
/// How far from an outline is cut here, metres: more is as good or as bad.
const FAR_OFF_M: f64 = 0.1;

/// The measures of a candidate that the networks were asked about; none before that.
pub fn measures(problem: &PlacementProblem<'_>, standing: &Standing, judged: &JudgedCandidate) -> Option<Vec<f32>> {
    let of_place = judged.measures.as_ref()?;
    let goal = judged.relations.as_ref()?.iter().copied().fold(1.0, f32::min);
    let margin_m = judged.checks.as_ref()?.iter().map(|check| check.margin_m).fold(FAR_M, f64::min);
    let query = problem.query;
    // What else lay against it is as it was where it was seen, however it is turned.
    let seen = problem.as_seen().standing_traits(query.id)?;
    let traits = problem.prepared.standing_traits(query.id)?;
    let [length_m, width_m] = traits.spans_m;
    let [gap_m, doubted_gap_m] = problem.shape_gaps_m(&judged.candidate);
    let beside = [
        f64::from(judged.realism?),
        f64::from(goal),
        margin_m.max(-FAR_M),
        standing.stands,
        standing.neighbours_stay,
        // No request that it was fitted on had a region, a robot or a clearance.
        judged.fragility?.of_any_request,
        gap_m.min(FAR_M),
        doubted_gap_m.min(FAR_M),
        seen.gap_m.min(FAR_M),
        seen.leaner.oblique.share,
        seen.leaner.oblique.off_rad,
        seen.leaner.over_m,
        f64::from(u8::from(seen.on_object)),
        traits.hidden_foot_m,
        f64::from(query.shape.foot_probability),
        anchor_foot(problem),
        traits.oblique.share,
        traits.oblique.off_rad,
        traits.oblique.level_share,
        f64::from(query.shape.axis_offset().norm()),
        length_m,
        width_m,
    ];
    let all = beside
        .into_iter()
        .chain(of_carriers(problem, judged))
        .chain(of_pictures(problem))
        .chain(of_anchor(problem, judged))
        .chain(of_turn(problem, standing))
        .chain(of_unknown(problem, judged));
    Some(of_place.iter().copied().chain(all.map(|value| value as f32)).collect())
}

/// How likely the main anchor's foot is as high as is believed; 1 without an anchor.
fn anchor_foot(problem: &PlacementProblem<'_>) -> f64 {
    let anchor = problem.request.main_anchor().and_then(|anchor| problem.prepared.belief.objects.get(&anchor));
    anchor.and_then(|anchor| anchor.shape.as_ref()).map_or(1.0, |shape| f64::from(shape.foot_probability))
}

/// What was seen to carry it.
fn of_carriers(problem: &PlacementProblem<'_>, judged: &JudgedCandidate) -> [f64; 5] {
    let carriers = problem.ground().carriers(&judged.candidate);
    let asked = problem.anchors_of(&[Relation::Above]);
    [
        carriers.share_of(|object| asked.contains(&object)),
        carriers.share_of(|object| object != 0 && !asked.contains(&object)),
        carriers.count() as f64,
        carriers.level_margin_m.unwrap_or(-FAR_OFF_M).max(-FAR_OFF_M),
        carriers.spread_m,
    ]
}

/// How much of it and of the main anchor was seen where they are.
fn of_pictures(problem: &PlacementProblem<'_>) -> [f64; 6] {
    let (prepared, query, anchor) = (problem.prepared, problem.query.id, problem.request.main_anchor());
    let ends = anchor.map_or_else(OutlineEnds::default, |anchor| prepared.outline_ends(anchor));
    let observed = |object: u16| prepared.scene.object(object).map_or(1.0, |summary| summary.completeness);
    let own = problem.as_seen().outline_ends(query);
    [own.cut_off, own.hidden, ends.cut_off, ends.hidden, observed(query), anchor.map_or(1.0, observed)]
}

/// Where it is on the main anchor, and how large that is.
fn of_anchor(problem: &PlacementProblem<'_>, judged: &JudgedCandidate) -> [f64; 6] {
    let anchor = problem.request.main_anchor().and_then(|anchor| problem.prepared.belief.objects.get(&anchor));
    let Some((anchor, shape)) = anchor.and_then(|anchor| Some((anchor, anchor.shape.as_ref()?))) else {
        return [FAR_OFF_M, 0.0, 0.0, 0.0, 0.0, 0.0];
    };
    let axis = judged.candidate.carry(&problem.query.shape.axis_offset());
    let inside_m = shape.slabs.last().map_or(FAR_OFF_M, |top| f64::from(top.outline.margin(&axis)));
    let [length_m, width_m] = spans_m(shape);
    let height_m = f64::from(shape.top_m - shape.bottom_m);
    [inside_m.clamp(-FAR_OFF_M, FAR_OFF_M), height_m, length_m, width_m, f64::from(shape.doubt.norm()), anchor.points.len() as f64]
}

/// How it was turned over, and how it stood before that.
fn of_turn(problem: &PlacementProblem<'_>, standing: &Standing) -> [f64; 3] {
    let [angle_rad, seen_base_share] = Turned::measures(problem.turned);
    [standing.stood, angle_rad, seen_base_share]
}

/// How likely it reaches something with what was not seen of it, and how much of it is where nothing was read; how likely what was not seen makes the
/// goal fail, and how likely it lands well.
fn of_unknown(problem: &PlacementProblem<'_>, judged: &JudgedCandidate) -> [f64; 4] {
    // The picture of the scene as it was seen: in that of another side there is a hole where the object was.
    let (view, unseen) = (&problem.as_seen().belief.view, &problem.settings.fixed.unseen);
    [
        judged.obstruction.map_or(0.0, |found| found.farther_chance),
        unread_share(view, problem.query, &judged.candidate, unseen),
        problem.rules.farther_chance(&judged.candidate),
        f64::from(problem.query.shape.landing_probability),
    ]
}
