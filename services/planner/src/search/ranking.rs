//! The last step where networks only rank: geometry has found places where the object can stand, the networks and small errors of the pose
//! rank them.
//!
//! An optimiser picks candidates whose geometry only just holds. So each candidate of the shortlist is tried again a little off and a
//! little turned, as a robot may put it, and the share of failures counts against it.

use repose_proto::CallError;

use crate::judge::Judge;
use crate::judge::judged::JudgedCandidate;
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
        if j.fragile_share.is_none() {
            j.fragile_share = Some(fragile_share(judge, &j.candidate));
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

/// The share of small errors of a candidate's pose after which a constraint fails.
pub fn fragile_share(judge: &Judge<'_>, candidate: &CandidatePose) -> f64 {
    let problem = judge.problem();
    let settings = &problem.settings.fixed.ranking;
    let failing = OFF.iter().filter(|[x, y, turn]| {
        let [px, py, pz] = candidate.centroid_m;
        let centroid = nalgebra::Point3::new(px + x * settings.off_m, py + y * settings.off_m, pz).cast::<f64>();
        let off = CandidatePose::new(&centroid, f64::from(candidate.yaw_rad + turn * settings.off_rad));
        !judge.without_networks(problem.settled(&off, problem.ceiling_over(&off)), 0).feasible()
    });
    failing.count() as f64 / OFF.len() as f64
}
