//! Goals achieved one after another, each planned on a fresh view of what the one before has left.
//!
//! Paper, appendix: mug and bowl to the right of a large box, one after the other, where the second may well end up on the first. Objects
//! are named as in the first view. A camera that finds its objects anew numbers them anew; they are told by where they are: the moved one
//! where it was put, every other where it was.
//!
//! What slips, falls or is not grasped is looked for on a fresh view and tried again, with another draw of grasps and placements, a bounded
//! number of times. Every look also says whether anything else was moved, fell or is gone. After a stop, whoever latched it, and after a cancel
//! nothing is tried again: a person decides.

use repose_proto::motion::ExecutionOutcome;
use repose_proto::{CallError, GoalTerm, Message, PlaceRequest, PlaceResult, Scene, SceneRef};
use repose_sentences::placement::center_of;
use repose_tracking::{Followed, holds};
use serde::Serialize;

use crate::attended::Attended;
use crate::site::{COUNT, IdentifiedScene, Site, is_unserved};
use crate::tried::Tried;

/// The result of one goal of a sequence.
#[derive(Debug, Clone, Serialize)]
pub struct GoalStep {
    /// The object, by its id in the first view.
    pub query: u16,
    /// What was to hold, ids as in the first view.
    pub goal: Vec<GoalTerm>,
    /// The answer; ids are those of its own view.
    pub result: PlaceResult,
    /// Where the object's centre was in that view.
    #[serde(skip)]
    pub center_m: Option<[f64; 3]>,
    /// The result of the last attempt.
    #[serde(flatten)]
    pub last: GoalAttempt,
    /// The results of earlier attempts.
    pub attempts: Vec<GoalAttempt>,
}

/// The result of one attempt at a goal.
#[derive(Debug, Clone, Default, Serialize)]
pub struct GoalAttempt {
    /// How far it came.
    #[serde(flatten)]
    pub tried: Tried,
    /// Each term by rule on the view after it.
    pub holds: Vec<bool>,
}

impl GoalStep {
    /// Whether it was carried out, and its goal holds.
    pub fn achieved(&self) -> bool {
        self.last.tried.execution == Some(ExecutionOutcome::Done)
            && !self.last.holds.is_empty()
            && self.last.holds.iter().all(|holds| *holds)
    }

    /// The result for people: earlier attempts, how the last one ended, which terms hold, and what else was seen.
    pub fn describe(&self) -> Vec<String> {
        let end = match self.last.tried.execution {
            Some(ExecutionOutcome::Done) => "executed",
            Some(ExecutionOutcome::Stopped) => "stopped",
            Some(ExecutionOutcome::GraspLost) => "the grasp was lost",
            None => "not executed",
        };
        let disturbances = |attempt: &GoalAttempt| attempt.tried.disturbances(Some(self.query));
        let before = self.attempts.iter().enumerate().map(|(k, attempt)| {
            let why = attempt.tried.reason.clone().unwrap_or_else(|| "the goal did not hold afterwards".to_owned());
            format!("attempt {}: {}", k + 1, std::iter::once(why).chain(disturbances(attempt)).collect::<Vec<_>>().join(", "))
        });
        let holds = self.goal.iter().zip(&self.last.holds).map(|(t, h)| format!("{t} {}", if *h { "holds" } else { "does not hold" }));
        let last = std::iter::once(end.to_owned()).chain(self.last.tried.reason.clone()).chain(holds).chain(disturbances(&self.last));
        before.chain(last).collect()
    }

    /// Makes room for another attempt.
    fn begin_again(&mut self, result: PlaceResult, view: &IdentifiedScene) {
        self.attempts.push(std::mem::take(&mut self.last));
        self.center_m = center_of(&view.1.meta.objects, result.query);
        self.result = result;
    }
}

/// Goals being achieved one after another.
pub struct Sequence<S> {
    site: Attended<S>,
    /// Attempts at each goal, at least 1.
    attempts: usize,
    view: IdentifiedScene,
    followed: Followed,
    /// The result of each goal that was tried, also of one that an error ended.
    pub steps: Vec<GoalStep>,
}

impl<S: Site> Sequence<S> {
    /// On the view after `seen`, whose ids the goals use; without it on the newest view, whose ids they will use.
    ///
    /// # Errors
    /// Those of [`Site::view_after`].
    pub async fn begin(site: S, seen: Option<&Scene>, attempts: usize) -> Result<Self, CallError> {
        let site = Attended::from_now(site).await;
        let view = site.view_after(seen.map_or(0, |scene| scene.stamp_ns)).await?;
        let mut followed = Followed::of(seen.unwrap_or(&view.1));
        if seen.is_some() {
            followed.look_again(&view.1);
        }
        Ok(Self { site, attempts, view, followed, steps: Vec::new() })
    }

    /// The newest view, with its id.
    pub fn view(&self) -> &IdentifiedScene {
        &self.view
    }

    /// Achieves goals, whose ids are those of the first view, until one is not achieved; `told` hears of each that was tried.
    ///
    /// # Errors
    /// Whatever ended it; the step that it ended is the last of `steps`.
    pub async fn achieve(&mut self, goals: &[PlaceRequest], mut told: impl FnMut(&GoalStep) + Send) -> Result<(), CallError> {
        let reaching = self.site.reaching().await;
        let requests: Vec<PlaceRequest> = goals
            .iter()
            .map(|goal| PlaceRequest {
                count: goal.count.max(COUNT),
                robot: goal.robot.clone().or_else(|| reaching.clone()),
                ..goal.clone()
            })
            .collect();
        // A goal that cannot be is refused before anything moves.
        for (k, goal) in requests.iter().enumerate() {
            self.translated(k, goal)?.validate()?;
        }
        for (k, goal) in requests.iter().enumerate() {
            if !self.site.goes_on() {
                break;
            }
            let asked = self.translated(k, goal)?;
            let result = self.site.placed(&asked, &self.view).await?;
            let (query, terms) = (goal.query, goal.goal.clone());
            let center_m = center_of(&self.view.1.meta.objects, result.query);
            let mut step = GoalStep { query, goal: terms, result, center_m, last: GoalAttempt::default(), attempts: Vec::new() };
            let carried_out = self.carry_out_or_try_again(asked, (k, goal), &mut step).await;
            told(&step);
            let achieved = step.achieved();
            self.steps.push(step);
            carried_out?;
            if !achieved {
                break;
            }
        }
        Ok(())
    }

    /// A goal in the ids of the newest view.
    fn translated(&self, k: usize, goal: &PlaceRequest) -> Result<PlaceRequest, CallError> {
        let (query, terms) = self.followed.translated(&format!("step[{k}]"), goal.query, &goal.goal)?;
        Ok(PlaceRequest { scene: SceneRef { scene_id: self.view.0.clone() }, query, goal: terms, ..goal.clone() })
    }

    /// Has a placement of `asked` carried out, and tries again while that makes sense; `step` says what the last attempt came to.
    async fn carry_out_or_try_again(
        &mut self,
        mut asked: PlaceRequest,
        (k, goal): (usize, &PlaceRequest),
        step: &mut GoalStep,
    ) -> Result<(), CallError> {
        loop {
            let carried_out = match step.result.placements.is_empty() {
                true => Ok(()),
                false => self.carry_out(&asked, (k, goal), step).await,
            };
            if step.attempts.len() + 1 >= self.attempts || !self.may_try_again(step, &carried_out).await {
                return carried_out;
            }
            match self.asked_again(&asked, (k, goal), step).await {
                Ok(Some((request, result))) => {
                    asked = request;
                    step.begin_again(result, &self.view);
                }
                // Nothing is left to do.
                Ok(None) => return carried_out,
                // What is in the way of another attempt is said beside what came of this one.
                Err(why) => {
                    let before = step.last.tried.reason.take().map_or_else(String::new, |reason| format!("{reason}; "));
                    step.last.tried.reason = Some(format!("{before}not tried again: {why}"));
                    return carried_out;
                }
            }
        }
    }

    /// The same request on a fresh view, with other draws, and its answer. Where the arm has moved it is brought home first; none where the goal is seen to
    /// hold then: what it is about was behind the arm.
    async fn asked_again(
        &mut self,
        asked: &PlaceRequest,
        (k, goal): (usize, &PlaceRequest),
        step: &mut GoalStep,
    ) -> Result<Option<(PlaceRequest, PlaceResult)>, CallError> {
        if step.last.tried.execution.is_some() {
            self.view = self.site.back_and_looking().await?;
            self.followed.look_for_lost(goal.query, &self.view.1);
            // The arm is in nobody's way any more.
            self.judge((k, goal), step);
            if step.achieved() {
                return Ok(None);
            }
        }
        let request = PlaceRequest { seed: asked.seed.wrapping_add(1), ..self.translated(k, goal)? };
        let result = self.site.placed(&request, &self.view).await?;
        Ok(Some((request, result)))
    }

    /// Has a placement carried out, and looks at what has become of the goal; `step` says how far it came.
    async fn carry_out(&mut self, request: &PlaceRequest, (k, goal): (usize, &PlaceRequest), step: &mut GoalStep) -> Result<(), CallError> {
        let placements = &step.result.placements;
        step.last.tried = match self.site.carry_out(request, placements, &self.view).await {
            Ok(tried) => tried,
            Err(error) => {
                step.last.tried = Tried::failed(&error);
                return Err(error);
            }
        };
        // What was not placed is looked for where it was.
        let moved = step.last.tried.moved(placements)?;
        self.followed.carried(Some(goal.query), &moved);
        self.view = self.site.fresh_view().await?;
        self.followed.look_again(&self.view.1);
        self.judge((k, goal), step);
        Ok(())
    }

    /// Notes on a step what the newest view shows of the objects, and of the goal where the placement was carried out.
    fn judge(&self, (k, goal): (usize, &PlaceRequest), step: &mut GoalStep) {
        step.last.tried.fates = Some(self.followed.disturbed());
        if step.last.tried.execution != Some(ExecutionOutcome::Done) {
            return;
        }
        (step.last.holds, step.last.tried.reason) = match self.followed.translated(&format!("step[{k}]"), goal.query, &goal.goal) {
            Ok((query, terms)) => (holds(&self.view.1, step.result.view_yaw_rad, query, &terms), None),
            Err(unseen) => (Vec::new(), Some(format!("whether it holds cannot be seen: {}", unseen.message))),
        };
    }

    /// Whether another attempt makes sense and is nobody else's decision: nothing could be served and nothing has moved, or the object was not
    /// grasped, was lost, or does not stand where it should, and the robot stands there free, without a stop.
    async fn may_try_again(&self, step: &GoalStep, carried_out: &Result<(), CallError>) -> bool {
        if let Err(error) = carried_out {
            return step.last.tried.execution.is_none() && is_unserved(error);
        }
        let failed = match step.last.tried.execution {
            Some(ExecutionOutcome::GraspLost) => true,
            Some(ExecutionOutcome::Done) => !step.achieved(),
            Some(ExecutionOutcome::Stopped) | None => false,
        };
        failed && self.site.is_free().await
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use repose_proto::Relation;
    use repose_runtime::Session;

    use super::*;
    use crate::scripted::{Script, ScriptedCell, term, view};

    #[tokio::test(flavor = "multi_thread")]
    async fn what_the_arm_had_covered_is_looked_at_before_the_object_is_moved_again() {
        let after = [(1, [-0.3, 0.0]), (2, [0.1, 0.0])];
        let script = Script {
            views: Mutex::new([view(&[(1, [-0.1, 0.2]), (2, [0.1, 0.0])]), view(&after[..1])].into()),
            home: Mutex::new(Some(view(&after))),
            place: Some([-0.2, -0.2, 0.0]),
            outcomes: Mutex::new([ExecutionOutcome::Done].into()),
            ..Script::default()
        };
        let session = Session::embedded().await.expect("a session");
        let (site, _servers) = ScriptedCell::of(&session, script).await;
        let script = site.script.clone();
        let mut sequence = Sequence::begin(site, None, 3).await.expect("a view");
        let goal = PlaceRequest::new("0".repeat(64), 1, vec![term(Relation::LeftOf, 2)]);
        sequence.achieve(&[goal], |_| ()).await.expect("nothing more is to be moved");
        assert!(sequence.steps[0].achieved(), "{:?}", sequence.steps[0].last);
        assert_eq!(*script.moved.lock().expect("moved"), [1]);
    }
}
