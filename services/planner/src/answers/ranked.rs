//! The networks rank the shortlist: those of it that can be among the answers are put to them, and no others.
//!
//! Before the networks are asked about a candidate, geometry tells the least that it can cost: what it costs if the networks say the best of it
//! that they can. Whatever would be an answer at that cost is asked about, until all answers have been. Who is left unasked would not be an answer
//! whatever the networks say of it, so the answers are those of asking about all, at a part of the work.

use std::ops::ControlFlow;

use repose_proto::CallError;

use crate::answers::distinct::distinct_places;
use crate::judge::Judge;
use crate::judge::judged::JudgedCandidate;
use crate::search::findings::Findings;
use crate::search::ranking::{believed, fragility, keep_apart, shortlist, without};
use crate::search::stop::StopReason;

/// How much is known of a candidate of the shortlist.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Known {
    /// What the search found: its cost without small errors of the pose and without forecasts.
    Searched,
    /// The least that it can cost.
    Bounded,
    /// Its cost, for the networks were asked.
    Asked,
}

/// A candidate of the shortlist; its cost is the least that is known.
struct Listed {
    /// Its position among the accepted.
    place: usize,
    judged: JudgedCandidate,
    known: Known,
}

/// Puts the shortlist of the accepted candidates to the networks as far as it matters, and costs it anew. Candidates below the realism threshold are
/// rejected, and answers come from those asked about alone. Returns the other accepted candidates. `control` is asked before each question; where it
/// stops that, nothing has changed but that those that the networks believe in are among the heard.
///
/// # Errors
/// What the networks answer; no more has changed then.
pub fn rank(
    judge: &mut Judge<'_>,
    findings: &mut Findings,
    count: usize,
    control: &mut dyn FnMut() -> Option<StopReason>,
) -> Result<ControlFlow<StopReason, Vec<JudgedCandidate>>, CallError> {
    let settings = judge.problem().settings;
    let (ranking, level_gap_m) = (&settings.fixed.ranking, settings.fixed.surrogate.level_gap_m);
    let places = shortlist(&findings.accepted, ranking.candidates.max(count), ranking.apart_m, level_gap_m);
    let of_place = |place: usize| Listed { place, judged: findings.accepted[place].clone(), known: Known::Searched };
    let mut list: Vec<Listed> = places.into_iter().map(of_place).collect();
    let mut doubted: Vec<Listed> = Vec::new();
    take_heard(judge, findings, &mut list, &mut doubted);
    loop {
        let costed: Vec<JudgedCandidate> = list.iter().map(|l| l.judged.clone()).collect();
        let mut turn = distinct_places(&costed, count, settings.min_separation_m, level_gap_m);
        turn.retain(|i| list[*i].known != Known::Asked);
        if turn.is_empty() {
            break;
        }
        fill_turn(&mut turn, &list, count, ranking.asked_at_once);
        if turn.iter().any(|i| list[*i].known == Known::Searched) {
            // Dearer than it seemed, it may not be worth asking about.
            for i in turn.iter().filter(|i| list[**i].known == Known::Searched).copied().collect::<Vec<_>>() {
                bound(judge, &mut list[i])?;
            }
            continue;
        }
        if let Some(stop) = control() {
            return Ok(ControlFlow::Break(stop));
        }
        findings.heard.extend(ask(judge, &mut list, turn, &mut doubted)?);
    }
    doubted.sort_by_key(|l| l.place);
    let believed: Vec<JudgedCandidate> = list.iter().filter(|l| l.known == Known::Asked).map(|l| l.judged.clone()).collect();
    let asked = list.iter().filter(|l| l.known == Known::Asked).chain(&doubted).map(|l| l.place).collect::<Vec<_>>();
    let mut doubted: Vec<JudgedCandidate> = doubted.into_iter().map(|l| l.judged).collect();
    if believed.is_empty() {
        let mut rest = without(findings.accepted.clone(), &asked);
        if !rest.is_empty()
            && let Some(stop) = control()
        {
            return Ok(ControlFlow::Break(stop));
        }
        findings.accepted = elsewhere(judge, &mut rest, &mut doubted)?;
        findings.reject(doubted);
        return Ok(ControlFlow::Continue(rest));
    }
    let rest = without(std::mem::replace(&mut findings.accepted, believed), &asked);
    findings.reject(doubted);
    Ok(ControlFlow::Continue(rest))
}

/// Those that the networks believe far from all that they doubt: the best of a search lie side by side, and where these are doubted the place is, not the
/// object. Whoever is asked about leaves the rest.
fn elsewhere(
    judge: &mut Judge<'_>,
    rest: &mut Vec<JudgedCandidate>,
    doubted: &mut Vec<JudgedCandidate>,
) -> Result<Vec<JudgedCandidate>, CallError> {
    let settings = judge.problem().settings;
    let (ranking, level_gap_m) = (&settings.fixed.ranking, settings.fixed.surrogate.level_gap_m);
    let mut far = rest.clone();
    keep_apart(&mut far, doubted, ranking.elsewhere_m);
    let places = shortlist(&far, ranking.candidates, ranking.elsewhere_m, level_gap_m);
    let list: Vec<JudgedCandidate> = places.into_iter().map(|place| far[place].clone()).collect();
    if list.is_empty() {
        return Ok(Vec::new());
    }
    rest.retain(|j| list.iter().all(|asked| asked.candidate != j.candidate));
    let (believed, others): (Vec<_>, Vec<_>) = believed(judge, list)?.into_iter().partition(JudgedCandidate::feasible);
    doubted.extend(others);
    Ok(believed)
}

/// Takes over what the networks said of candidates after iterations.
fn take_heard(judge: &Judge<'_>, findings: &Findings, list: &mut Vec<Listed>, doubted: &mut Vec<Listed>) {
    for listed in list.iter_mut() {
        if let Some(heard) = findings.heard.iter().find(|heard| heard.candidate == listed.judged.candidate) {
            (listed.judged, listed.known) = (heard.clone(), Known::Asked);
            judge.judge_realism(&mut listed.judged);
            judge.judge_success(&mut listed.judged);
        }
    }
    doubted.extend(list.extract_if(.., |l| !l.judged.feasible()));
}

/// Adds to those whose turn it is the next that may yet be answers, up to `most`: they go in the same message.
fn fill_turn(turn: &mut Vec<usize>, list: &[Listed], count: usize, most: usize) {
    let mut asked: Vec<f64> = list.iter().filter(|l| l.known == Known::Asked).map(|l| l.judged.cost).collect();
    asked.sort_by(f64::total_cmp);
    let worth = asked.get(count - 1).copied().unwrap_or(f64::INFINITY);
    let mut open: Vec<usize> = (0..list.len()).filter(|i| list[*i].known != Known::Asked && list[*i].judged.cost < worth).collect();
    open.sort_by(|a, b| list[*a].judged.better(&list[*b].judged).then(a.cmp(b)));
    let missing = most.saturating_sub(turn.len());
    let more: Vec<usize> = open.into_iter().filter(|i| !turn.contains(i)).take(missing).collect();
    turn.extend(more);
}

/// The least that a candidate can cost.
fn bound(judge: &mut Judge<'_>, listed: &mut Listed) -> Result<(), CallError> {
    listed.judged.fragility = Some(fragility(judge, &listed.judged.candidate));
    listed.judged.cost = judge.least_cost(&mut listed.judged)?;
    listed.known = Known::Bounded;
    Ok(())
}

/// Asks the networks about some, and returns those that they believe in; those that they doubt leave the list.
fn ask(
    judge: &mut Judge<'_>,
    list: &mut Vec<Listed>,
    mut turn: Vec<usize>,
    doubted: &mut Vec<Listed>,
) -> Result<Vec<JudgedCandidate>, CallError> {
    turn.sort_unstable();
    let judged = believed(judge, turn.iter().map(|i| list[*i].judged.clone()).collect())?;
    let heard = judged.iter().filter(|j| j.feasible()).cloned().collect();
    for (i, judged) in turn.into_iter().zip(judged) {
        (list[i].judged, list[i].known) = (judged, Known::Asked);
    }
    doubted.extend(list.extract_if(.., |l| !l.judged.feasible()));
    Ok(heard)
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;

    use rand::SeedableRng;
    use rand_pcg::Pcg64;
    use repose_proto::place::PlaceRequest;

    use crate::answers::Answers;
    use crate::judge::judged::JudgedCandidate;
    use crate::learned::success;
    use crate::search::ranking::are_apart;
    use crate::search::search;
    use crate::search::source::CandidateSource;
    use crate::search::stop::StopReason;
    use crate::settings::PlanSettings;
    use crate::tests::fake::{BESIDE, Fake, judging, judging_with, scene, stepped};

    /// The answers, and how many candidates were believed of those asked about.
    fn answers(count: u32, seed: u64, asked_at_once: usize) -> (Vec<JudgedCandidate>, usize) {
        let request = PlaceRequest { count, seed, ..PlaceRequest::new(scene().scene_id.clone(), 2, vec!["right_of:1".parse().unwrap()]) };
        let mut settings = PlanSettings::of(&request);
        settings.fixed.ranking.asked_at_once = asked_at_once;
        judging(&request, &settings, |judge| {
            let mut rng = Pcg64::seed_from_u64(request.seed);
            let source = CandidateSource::new(judge, &mut rng).unwrap();
            let (mut findings, mut stopped) = search(judge, source, &mut rng, &mut |_| ControlFlow::Continue(())).unwrap();
            let answers = Answers::choose(judge, &mut findings, &|_| true, &mut stopped, &mut || None).unwrap();
            (answers.chosen, findings.accepted.len())
        })
    }

    #[test]
    fn where_all_of_the_best_are_doubted_others_are_asked_about_that_are_far_from_them() {
        let request = PlaceRequest::new(scene().scene_id.clone(), 2, vec!["right_of:1".parse().unwrap()]);
        // Doubted where the goal holds by more than 5 cm, as the best of a search do.
        let mut fake = Fake::new(&[BESIDE]);
        fake.success = Some(stepped(&success::names(), "goal_margin", 0.05, [0.9, 0.1]));
        let chosen = |elsewhere_m: f64| {
            let mut settings = PlanSettings::of(&request);
            settings.fixed.ranking.elsewhere_m = elsewhere_m;
            judging_with(&fake, &request, &settings, |judge| {
                let mut rng = Pcg64::seed_from_u64(request.seed);
                let source = CandidateSource::new(judge, &mut rng).unwrap();
                let (mut findings, mut stopped) = search(judge, source, &mut rng, &mut |_| ControlFlow::Continue(())).unwrap();
                Answers::choose(judge, &mut findings, &|_| true, &mut stopped, &mut || None).unwrap().chosen
            })
        };
        assert!(chosen(f64::INFINITY).is_empty(), "the search settles where it is doubted");
        let answer = &chosen(0.05)[0];
        assert!(answer.success.unwrap() > 0.8, "{answer:?}");
    }

    #[test]
    fn what_was_believed_before_time_ended_is_answered_and_what_was_not_asked_about_is_not_too_close() {
        let goal = vec!["right_of:1".parse().unwrap()];
        let request = PlaceRequest { count: 16, min_separation_m: Some(0.25), ..PlaceRequest::new(scene().scene_id.clone(), 2, goal) };
        // The most that may be said of a place is more than is said of any, so that all of the shortlist are asked about.
        let mut fake = Fake::new(&[BESIDE]);
        fake.success = Some(stepped(&success::names(), "stays", 2.0, [0.6, 0.9]));
        let mut settings = PlanSettings::of(&request);
        settings.fixed.ranking.asked_at_once = 1;
        judging_with(&fake, &request, &settings, |judge| {
            let mut rng = Pcg64::seed_from_u64(request.seed);
            let source = CandidateSource::new(judge, &mut rng).unwrap();
            let (mut findings, mut stopped) = search(judge, source, &mut rng, &mut |_| ControlFlow::Continue(())).unwrap();
            // As if the best after each iteration had been doubted.
            findings.heard.clear();
            let mut questions = 0;
            let mut control = || {
                questions += 1;
                (questions > 1).then_some(StopReason::Deadline)
            };
            let answers = Answers::choose(judge, &mut findings, &|_| true, &mut stopped, &mut control).unwrap();
            let (chosen, sep_m) = (&answers.chosen, settings.min_separation_m);
            assert!(stopped == Some(StopReason::Deadline) && !chosen.is_empty() && chosen.len() < 16, "{chosen:?}");
            assert!(chosen.iter().all(|j| j.realism.is_some() && j.success.is_some()), "{chosen:?}");
            let is_close = |j: &&JudgedCandidate| chosen.iter().any(|c| !are_apart(&c.candidate, &j.candidate, sep_m));
            let close = findings.accepted.iter().filter(is_close).count() - chosen.len();
            let shortfall = answers.passed.shortfall(chosen.len(), request.count, true).unwrap();
            assert_eq!((shortfall.passed, shortfall.too_close), (findings.accepted.len() as u64, close as u64));
        });
    }

    #[test]
    fn the_answers_are_those_of_asking_about_all_and_fewer_are_asked_about() {
        let (mut of_few, mut of_all) = (0, 0);
        for (count, seed) in [(1, 0), (1, 1), (1, 2), (1, 3), (3, 4), (3, 5)] {
            let (few, asked) = answers(count, seed, 2);
            let (all, whole) = answers(count, seed, usize::MAX);
            assert_eq!(few, all, "{count} answers, seed {seed}");
            assert_eq!(few.len(), count as usize);
            of_few += asked;
            of_all += whole;
        }
        assert!(4 * of_few < 3 * of_all, "{of_few} of {of_all}");
    }
}
