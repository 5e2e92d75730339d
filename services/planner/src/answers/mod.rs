//! From what passed to answers: ranked, distinct, each with its evidence, or the reason why there are none.

pub mod distinct;
pub mod placement;
pub mod ranked;
pub mod relaxation;

use std::ops::ControlFlow;

use repose_proto::CallError;
use repose_proto::place::{Shortfall, ShortfallReason};

use crate::answers::distinct::distinct;
use crate::answers::ranked::rank;
use crate::judge::Judge;
use crate::judge::judged::JudgedCandidate;
use crate::search::findings::Findings;
use crate::search::ranking::{fill, keep_apart};
use crate::search::stop::{StopReason, in_time};
use crate::settings::Realism;

/// The answers of a search.
#[derive(Debug)]
pub struct Answers {
    /// Best first.
    pub chosen: Vec<JudgedCandidate>,
    /// What they were chosen from.
    pub passed: Passed,
}

/// How many candidates an answer was chosen from.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Passed {
    /// Candidates that passed every constraint that was tried.
    all: u64,
    /// Of those, far enough from all chosen, but the networks were not asked about them.
    unasked: u64,
}

impl Answers {
    /// The answers, once the search is over, of the candidates that are `apart` from answers that there are already. Where networks only rank, they do
    /// so now; `control` is asked before each question to them, and `stopped` is told.
    ///
    /// # Errors
    /// What the networks answer.
    pub fn choose(
        judge: &mut Judge<'_>,
        findings: &mut Findings,
        apart: &dyn Fn(&JudgedCandidate) -> bool,
        stopped: &mut Option<StopReason>,
        control: &mut dyn FnMut() -> Option<StopReason>,
    ) -> Result<Self, CallError> {
        let (settings, count) = (judge.problem().settings, judge.problem().request.count as usize);
        let found = findings.accepted.len();
        findings.accepted.retain(apart);
        let close = found - findings.accepted.len();
        let distinct =
            |accepted: &[JudgedCandidate]| distinct(accepted, count, settings.min_separation_m, settings.fixed.surrogate.level_gap_m);
        let passed = |findings: &Findings, rest: &[JudgedCandidate]| (close + findings.accepted.len() + rest.len()) as u64;
        if settings.recipe.realism != Realism::OutcomeRanks {
            return Ok(Self { chosen: distinct(&findings.accepted), passed: Passed { all: passed(findings, &[]), unasked: 0 } });
        }
        let mut rest = Vec::new();
        if stopped.is_none() && !findings.accepted.is_empty() {
            match in_time(rank(judge, findings, count, control))? {
                Some(ControlFlow::Continue(unasked)) => rest = unasked,
                Some(ControlFlow::Break(stop)) => *stopped = Some(stop),
                None => *stopped = Some(StopReason::Deadline),
            }
        }
        if stopped.is_some() {
            // Time ended before the networks had ranked: the answers are of those that they were asked about until then, and believe in.
            let believed: Vec<JudgedCandidate> = findings.heard.iter().filter(|j| j.believed(settings) && apart(j)).cloned().collect();
            let chosen = distinct(&believed);
            let mut unasked = findings.accepted.clone();
            keep_apart(&mut unasked, &chosen, settings.min_separation_m);
            return Ok(Self { chosen, passed: Passed { all: passed(findings, &[]), unasked: unasked.len() as u64 } });
        }
        let mut chosen = distinct(&findings.accepted);
        let rejected = |findings: &Findings| findings.rejections.values().sum::<u64>();
        let (passed, rejected_before) = (passed(findings, &rest), rejected(findings));
        if !chosen.is_empty() {
            *stopped = fill(judge, findings, &mut chosen, &mut rest, control)?;
        }
        keep_apart(&mut rest, &chosen, settings.min_separation_m);
        let all = passed - (rejected(findings) - rejected_before);
        Ok(Self { chosen, passed: Passed { all, unasked: rest.len() as u64 } })
    }
}

impl Passed {
    /// Those of several searches together.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        Self { all: self.all + other.all, unasked: self.unasked + other.unasked }
    }

    /// Why so many were `chosen` from these, if that is fewer than `count`; none where there are as many, or none at all.
    pub fn shortfall(&self, chosen: usize, count: u32, stopped: bool) -> Option<Shortfall> {
        let chosen = chosen as u64;
        if chosen == 0 || chosen >= u64::from(count) {
            return None;
        }
        let too_close = self.all.saturating_sub(chosen + self.unasked);
        let reason = if stopped || self.unasked > 0 {
            ShortfallReason::Budget
        } else if too_close > 0 {
            ShortfallReason::Separation
        } else {
            ShortfallReason::Constraints
        };
        Some(Shortfall { reason, passed: self.all, too_close })
    }
}

#[cfg(test)]
mod tests {
    use repose_proto::place::PlaceRequest;

    use super::*;
    use crate::scene::candidate::CandidatePose;
    use crate::settings::PlanSettings;
    use crate::tests::fake::{judging, scene};

    #[test]
    fn where_time_ends_the_best_that_is_believed_is_the_answer() {
        let request = PlaceRequest::new(scene().scene_id.clone(), 2, vec!["right_of:1".parse().unwrap()]);
        let heard = |cost: f64, realism: f32, success: f64| {
            let judged = JudgedCandidate::new(CandidatePose { centroid_m: [0.2, 0.0, cost as f32], yaw_rad: 0.0 }, 0);
            JudgedCandidate { cost, realism: Some(realism), success: Some(success), ..judged }
        };
        let (unreal, unsure, good, dearer) = (heard(1.0, 0.01, 0.9), heard(2.0, 0.99, 0.1), heard(3.0, 0.99, 0.9), heard(4.0, 0.99, 0.95));
        let chosen = |heard: &[&JudgedCandidate]| {
            let mut findings = Findings::default();
            findings.heard.extend(heard.iter().copied().cloned());
            let mut stopped = Some(StopReason::Deadline);
            judging(&request, &PlanSettings::of(&request), |judge| {
                Answers::choose(judge, &mut findings, &|_| true, &mut stopped, &mut || None).unwrap().chosen
            })
        };
        assert_eq!(chosen(&[&unreal, &unsure, &dearer, &good]), std::slice::from_ref(&good));
        assert!(chosen(&[&unreal, &unsure]).is_empty());
    }
}
