//! The networks rank the shortlist: those of it that can be among the answers are put to them, and no others.
//!
//! Before the networks are asked about a candidate, geometry tells the least that it can cost: what it costs if the networks say the best of it
//! that they can. Whatever would be an answer at that cost is asked about, until all answers have been. Who is left unasked would not be an answer
//! whatever the networks say of it, so the answers are those of asking about all, at a part of the work.

use repose_proto::CallError;

use crate::answers::distinct::distinct_places;
use crate::judge::Judge;
use crate::judge::judged::JudgedCandidate;
use crate::search::findings::Findings;
use crate::search::ranking::{believed, fragile_share, shortlist, without};

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
/// rejected, and answers come from those asked about alone. Returns the other accepted candidates.
///
/// # Errors
/// What the networks answer; nothing has changed then.
pub fn rank(judge: &mut Judge<'_>, findings: &mut Findings, count: usize) -> Result<Vec<JudgedCandidate>, CallError> {
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
        ask(judge, &mut list, turn, &mut doubted)?;
    }
    doubted.sort_by_key(|l| l.place);
    let believed: Vec<JudgedCandidate> = list.iter().filter(|l| l.known == Known::Asked).map(|l| l.judged.clone()).collect();
    let asked = list.iter().filter(|l| l.known == Known::Asked).chain(&doubted).map(|l| l.place).collect::<Vec<_>>();
    let rest = without(std::mem::replace(&mut findings.accepted, believed), &asked);
    findings.reject(doubted.into_iter().map(|l| l.judged).collect());
    Ok(rest)
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
    listed.judged.fragile_share = Some(fragile_share(judge, &listed.judged.candidate));
    listed.judged.cost = judge.least_cost(&mut listed.judged)?;
    listed.known = Known::Bounded;
    Ok(())
}

/// Asks the networks about some; those that they doubt leave the list.
fn ask(judge: &mut Judge<'_>, list: &mut Vec<Listed>, mut turn: Vec<usize>, doubted: &mut Vec<Listed>) -> Result<(), CallError> {
    turn.sort_unstable();
    let judged = believed(judge, turn.iter().map(|i| list[*i].judged.clone()).collect())?;
    for (i, judged) in turn.into_iter().zip(judged) {
        (list[i].judged, list[i].known) = (judged, Known::Asked);
    }
    doubted.extend(list.extract_if(.., |l| !l.judged.feasible()));
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;

    use rand::SeedableRng;
    use rand_pcg::Pcg64;
    use repose_proto::place::PlaceRequest;

    use crate::answers::Answers;
    use crate::judge::judged::JudgedCandidate;
    use crate::search::search;
    use crate::search::source::CandidateSource;
    use crate::settings::PlanSettings;
    use crate::tests::learned::{judging, scene};

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
