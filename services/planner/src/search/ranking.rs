//! The last step where networks only rank: geometry has found places where the object can stand, the networks and small errors of the pose
//! rank them.
//!
//! An optimiser picks candidates whose geometry only just holds. So each candidate of the shortlist is tried again a little off and a
//! little turned, as a robot may put it, and the share of failures counts against it.

use repose_proto::CallError;

use crate::judge::Judge;
use crate::judge::constraints::Slip;
use crate::judge::judged::{Fragility, JudgedCandidate};
use crate::judge::scorer::Question;
use crate::scene::candidate::CandidatePose;
use crate::search::findings::Findings;
use crate::search::levels::by_level;
use crate::search::stop::{StopReason, in_time};

/// Directions in which a pose is off: along the axes, and diagonally with a turn either way.
const OFF: [[f32; 3]; 8] = [
    [1.0, 0.0, 0.0],
    [-1.0, 0.0, 0.0],
    [0.0, 1.0, 0.0],
    [0.0, -1.0, 0.0],
    [0.7, 0.7, 1.0],
    [-0.7, -0.7, 1.0],
    [0.7, -0.7, -1.0],
    [-0.7, 0.7, -1.0],
];

/// Finds more answers where the shortlist gave fewer than `count`: asks the networks about the best of the `rest` that are far enough from
/// those chosen, and appends the believed ones, until there are enough, none is left, or some rounds are over. `control` is asked before
/// each round. Returns why it stopped early if it did. Candidates that the networks were not asked about stay in `rest`.
///
/// # Errors
/// What the networks answer.
pub fn fill(
    judge: &mut Judge<'_>,
    findings: &mut Findings,
    chosen: &mut Vec<JudgedCandidate>,
    rest: &mut Vec<JudgedCandidate>,
    control: &mut dyn FnMut() -> Option<StopReason>,
) -> Result<Option<StopReason>, CallError> {
    let settings = judge.problem().settings;
    let (count, first) = (judge.problem().request.count as usize, chosen.len());
    for _ in 0..settings.fixed.ranking.more_rounds {
        keep_apart(rest, chosen, settings.min_separation_m);
        let list = shortlist(rest, count - chosen.len(), settings.min_separation_m, settings.fixed.surrogate.level_gap_m);
        if list.is_empty() {
            break;
        }
        if let Some(stop) = control() {
            return Ok(Some(stop));
        }
        let asked = list.iter().map(|i| rest[*i].clone()).collect();
        let Some(asked) = in_time(believed(judge, asked))? else { return Ok(Some(StopReason::Deadline)) };
        let (believed, doubted) = asked.into_iter().partition(JudgedCandidate::feasible);
        findings.reject(doubted);
        chosen.extend(believed);
        chosen[first..].sort_by(JudgedCandidate::better);
        *rest = without(std::mem::take(rest), &list);
    }
    Ok(None)
}

/// Keeps the candidates that are at least `apart_m` from all those chosen.
pub fn keep_apart(rest: &mut Vec<JudgedCandidate>, chosen: &[JudgedCandidate], apart_m: f64) {
    rest.retain(|j| chosen.iter().all(|c| are_apart(&c.candidate, &j.candidate, apart_m)));
}

/// Whether two candidates can both be answers: their centroids are at least `apart_m` apart, and even where that is 0 they are not the same.
pub fn are_apart(one: &CandidatePose, other: &CandidatePose, apart_m: f64) -> bool {
    one != other && (one.centroid() - other.centroid()).norm() >= apart_m
}

/// All but the listed, by position.
pub fn without(all: Vec<JudgedCandidate>, list: &[usize]) -> Vec<JudgedCandidate> {
    all.into_iter().enumerate().filter(|(i, _)| !list.contains(i)).map(|(_, j)| j).collect()
}

/// Candidates costed anew after the networks were asked, those rejected that are below a threshold.
///
/// # Errors
/// What the networks answer.
pub fn believed(judge: &mut Judge<'_>, mut asked: Vec<JudgedCandidate>) -> Result<Vec<JudgedCandidate>, CallError> {
    appraise(judge, &mut asked)?;
    for j in &mut asked {
        judge.judge_realism(j);
        judge.judge_success(j);
    }
    Ok(asked)
}

/// Asks the networks about candidates, tries them a little off, and costs them anew.
///
/// # Errors
/// What the networks answer.
pub fn appraise(judge: &mut Judge<'_>, candidates: &mut [JudgedCandidate]) -> Result<(), CallError> {
    let all: Vec<usize> = (0..candidates.len()).collect();
    judge.scorer_mut().ask(Question::Both, candidates, &all)?;
    for j in candidates {
        if j.fragility.is_none() {
            j.fragility = Some(fragility(judge, &j.candidate));
        }
        judge.forecast_success(j)?;
        j.cost = judge.cost(j);
    }
    Ok(())
}

/// The best candidates, apart from each other, levels of support taking turns; by position.
pub fn shortlist(accepted: &[JudgedCandidate], count: usize, apart_m: f64, level_gap_m: f32) -> Vec<usize> {
    let mut levels: Vec<std::vec::IntoIter<usize>> = by_level(accepted, level_gap_m).into_iter().map(Vec::into_iter).collect();
    let mut list: Vec<usize> = Vec::new();
    while list.len() < count && !levels.is_empty() {
        levels.retain_mut(|level| {
            let apart = |i: &usize| list.iter().all(|k| are_apart(&accepted[*k].candidate, &accepted[*i].candidate, apart_m));
            let Some(next) = level.find(apart) else { return false };
            if list.len() < count {
                list.push(next);
            }
            true
        });
    }
    list
}

/// How many small errors of a candidate's pose break a constraint.
pub fn fragility(judge: &Judge<'_>, candidate: &CandidatePose) -> Fragility {
    let problem = judge.problem();
    let settings = &problem.settings.fixed.ranking;
    let slips = OFF.map(|[x, y, turn]| {
        let [px, py, pz] = candidate.centroid_m;
        let centroid = nalgebra::Point3::new(px + x * settings.off_m, py + y * settings.off_m, pz).cast::<f64>();
        let off = CandidatePose::new(&centroid, f64::from(candidate.yaw_rad + turn * settings.off_rad));
        // Where it was to be centered it is off all the same.
        judge.slip(problem.lowered(&off, problem.ceiling_over(&off)))
    });
    let share = |broken: &[Slip]| slips.iter().filter(|slip| broken.contains(slip)).count() as f64 / slips.len() as f64;
    Fragility { of_any_request: share(&[Slip::Breaks]), as_asked: share(&[Slip::Breaks, Slip::BreaksOwn]) }
}

#[cfg(test)]
mod tests {
    use repose_proto::place::{PlaceRequest, RegionBox, Variant};

    use super::*;
    use crate::learned::models::NoModels;
    use crate::learned::success;
    use crate::scene::prepared::PreparedScene;
    use crate::scene::query::QueryObject;
    use crate::settings::PlanSettings;
    use crate::tests::fake::{BESIDE, Fake, request, scene};
    use crate::tests::synthetic::{Prepared, SceneBuilder, posed, standing_at};

    #[test]
    fn a_region_hardly_larger_than_errors_of_the_pose_makes_a_place_dearer_and_success_no_less_likely() {
        let prepared = scene();
        let wanted = request(&prepared, Variant::Best, &["right_of:1"]);
        let settings = PlanSettings::of(&wanted);
        let place = |query: &QueryObject| standing_at(query, 0.22, 0.0, settings.fixed.support.release_m);
        let centroid: [f64; 3] = posed(&prepared, &wanted, &settings, |problem| problem.placed_centroid(&place(problem.query)).into());
        let fragile = |region: Vec<RegionBox>| {
            let wanted = PlaceRequest { region, ..wanted.clone() };
            let fake = Fake::new(&[BESIDE]);
            posed(&prepared, &wanted, &settings, |problem| {
                let mut judge = Judge::new(problem, &fake);
                let mut judged = [judge.without_networks(place(problem.query), 0)];
                assert!(judged[0].feasible(), "{:?}", judged[0].rejection);
                appraise(&mut judge, &mut judged).unwrap();
                let read = judged[0].success_measures.as_ref().unwrap();
                (read[success::names().iter().position(|name| *name == "fragile").unwrap()], judged[0].fragility.unwrap().as_asked)
            })
        };
        let around = RegionBox { min_m: centroid.map(|v| v - 0.004), max_m: centroid.map(|v| v + 0.004), inside: true };
        assert_eq!(fragile(Vec::new()), (0.0, 0.0));
        let (of_success, of_cost) = fragile(vec![around]);
        assert!(of_success == 0.0 && of_cost > 0.4, "every error along an axis leads out of it: {of_success} {of_cost}");
    }

    #[test]
    fn what_is_to_be_centered_is_as_fragile_as_if_that_were_not_asked_for() {
        let of_goal = |prepared: &PreparedScene, goal: &[&str], at: Option<CandidatePose>| {
            let wanted = request(prepared, Variant::Best, goal);
            let settings = PlanSettings::of(&wanted);
            posed(prepared, &wanted, &settings, |problem| {
                let drawn = standing_at(problem.query, 0.1, 0.0, 0.07);
                let at = at.unwrap_or_else(|| problem.settled(&drawn, problem.ceiling_over(&drawn)));
                let judge = Judge::new(problem, &NoModels);
                (at, judge.without_networks(at, 0).feasible(), fragility(&judge, &at))
            })
        };
        // On a block, a post comes closer to what is set on the middle, by less than errors of the pose, until there is no room for that.
        let beside = |gap_m: f64| {
            SceneBuilder::table()
                .object(1, [0.1, 0.0], [0.16, 0.16, 0.06])
                .object_at(3, [0.1 + 0.03 + gap_m + 0.01, 0.0], 0.06, [0.02, 0.02, 0.12])
                .object(2, [-0.25, -0.2], [0.06, 0.05, 0.08])
                .prepared()
        };
        let scenes = (0..12_u8).map(|k| beside(0.012 - 0.002 * f64::from(k)));
        let scenes = scenes.take_while(|prepared| of_goal(prepared, &["above:1", "centered:1"], None).1);
        let closest = scenes.last().expect("there is room beside a post that is 12 mm away");
        let (at, _, centered) = of_goal(&closest, &["above:1", "centered:1"], None);
        let (_, fits, free) = of_goal(&closest, &["above:1"], Some(at));
        assert!(fits && free.of_any_request > 0.0, "{free:?}");
        assert_eq!(centered, free);
    }
}
