//! `repose place … --then …`: wishes achieved one after another, each planned on a fresh view of what the one before has left.
//!
//! Paper, appendix: mug and bowl to the right of a large box, one after the other, where the second may well end up on the first. Objects
//! are named as in the first view. A camera that finds its objects anew numbers them anew; they are told by where they are: the moved one
//! where it was put, every other where it was.
//!
//! What slips, falls or is not grasped is looked for on a fresh view and tried again, with another draw of grasps and placements, a bounded
//! number of times. Every look also says whether anything else was moved, fell or is gone. After a stop, whoever latched it, and after a cancel
//! nothing is tried again: a person decides.

use repose_proto::motion::ExecutionOutcome;
use repose_proto::{GoalTerm, Message, PlaceRequest, PlaceResult, SceneRef};
use repose_runtime::{Session, now_ns};
use repose_sentences::placement::describe;
use repose_tracking::{Followed, holds};
use serde::Serialize;

use crate::client::{self, ConnectArgs};
use crate::failure::{Failure, Outcome};
use crate::output::Output;
use crate::say::Said;
use crate::system::{COUNT, System, Tried, View, is_unserved};
use crate::wish::{NextWish, WishArgs};

/// What is to be achieved, and where.
#[derive(Debug, Clone, Copy)]
pub struct Sequence<'a> {
    /// The first wish.
    pub wish: &'a WishArgs,
    /// Those after it.
    pub then: &'a [NextWish],
    /// The running system.
    pub connect: &'a ConnectArgs,
    /// The robot that carries them out.
    pub robot: &'a str,
    /// Attempts at each wish, at least 1.
    pub attempts: u32,
}

/// What came of one wish.
#[derive(Debug, Serialize)]
struct Step {
    query: u16,
    goal: Vec<GoalTerm>,
    /// How words were taken, where it was said in words.
    #[serde(skip_serializing_if = "Option::is_none")]
    said: Option<Said>,
    /// The answer; ids are those of its own view.
    result: PlaceResult,
    /// What the last attempt came to.
    #[serde(flatten)]
    last: Attempt,
    /// What earlier attempts came to.
    attempts: Vec<Attempt>,
}

/// What an attempt came to.
#[derive(Debug, Default, Serialize)]
struct Attempt {
    #[serde(flatten)]
    tried: Tried,
    /// Each term by rule on the view after it.
    holds: Vec<bool>,
}

impl Step {
    fn achieved(&self) -> bool {
        self.last.tried.execution == Some(ExecutionOutcome::Done)
            && !self.last.holds.is_empty()
            && self.last.holds.iter().all(|holds| *holds)
    }

    /// Makes room for another attempt.
    fn begin_again(&mut self, result: PlaceResult) {
        self.attempts.push(std::mem::take(&mut self.last));
        self.result = result;
    }
}

/// Runs the command: stops at the first wish that is not achieved.
pub async fn run(args: &Sequence<'_>, output: Output) -> Outcome {
    let session = client::connect(&args.connect.system).await?;
    let mut steps = Vec::new();
    let ended = achieve(args, &session, &mut steps).await;
    client::close(session).await;
    let error = match ended {
        // Nothing has moved.
        Err(failure) if steps.is_empty() => return Err(failure),
        ended => ended.err().and_then(|failure| failure.error().cloned()),
    };
    let achieved = steps.iter().take_while(|s| s.achieved()).count();
    let wanted = 1 + args.then.len();
    let mut document = serde_json::json!({"wanted": wanted, "achieved": achieved, "steps": steps});
    if let Some(error) = &error {
        document["error"] = serde_json::json!(error);
    }
    output.print(&document, || {
        let mut lines: Vec<String> = steps.iter().map(line).collect();
        lines.extend(error.as_ref().map(|error| format!("stopped: {error}")));
        lines.push(format!("{achieved} of {wanted} achieved"));
        lines.join("\n")
    })?;
    match steps.last() {
        _ if achieved == wanted => Ok(()),
        Some(last) if error.is_none() && last.result.placements.is_empty() => Err(Failure::NoPlacement),
        Some(_) => Err(Failure::NotAchieved),
        None => Err(Failure::other("nothing was tried")),
    }
}

fn line(step: &Step) -> String {
    let end = match step.last.tried.execution {
        Some(ExecutionOutcome::Done) => "executed".to_owned(),
        Some(other) => format!("{other:?}"),
        None => "not executed".to_owned(),
    };
    let holds = step.goal.iter().zip(&step.last.holds).map(|(t, h)| format!("{t} {}", if *h { "holds" } else { "does not hold" }));
    let disturbances = |attempt: &Attempt| attempt.tried.disturbances(Some(step.query));
    let before = step.attempts.iter().enumerate().map(|(k, a)| {
        let why = a.tried.reason.as_deref().unwrap_or("the goal did not hold afterwards").to_owned();
        format!("attempt {}: {}", k + 1, std::iter::once(why).chain(disturbances(a)).collect::<Vec<_>>().join(", "))
    });
    let last = std::iter::once(end).chain(step.last.tried.reason.clone()).chain(holds).chain(disturbances(&step.last));
    let said: Vec<String> = before.chain(last).collect();
    let understood = step.said.as_ref().map(|s| format!("{s}\n")).unwrap_or_default();
    format!("{understood}{}\n  {}", describe(&step.result), said.join("; "))
}

/// Adds what came of each wish to `steps`, also of one that an error ended.
async fn achieve(args: &Sequence<'_>, session: &Session, steps: &mut Vec<Step>) -> Outcome {
    let system = System::of(session, args.connect, args.robot).await?;
    let view = system.view_after(0).await?;
    let (first, mut said) = args.wish.on(&view.1)?;
    let reaching = system.reaching().await;
    let followed = Followed::of(&view.1);
    let mut run = Run { system, attempts: args.attempts as usize, view, followed };
    let wishes = || std::iter::once(&first).chain(args.then).enumerate();
    let request = |scene_id: &str, (query, goal): (u16, Vec<GoalTerm>)| {
        let asked = args.wish.request(scene_id.to_owned(), &NextWish { query, goal });
        let robot = asked.robot.clone().or_else(|| reaching.clone());
        let request = PlaceRequest { count: args.wish.count.max(COUNT), robot, ..asked };
        request.validate().map(|()| request)
    };
    // A wish that cannot be is refused before anything moves.
    for (k, wish) in wishes() {
        request(&run.view.0, run.translated(k, wish)?)?;
    }
    for (k, wish) in wishes() {
        let asked = request(&run.view.0, run.translated(k, wish)?)?;
        let result = run.system.placed(&asked, &run.view).await?;
        let mut step =
            Step { query: wish.query, goal: wish.goal.clone(), said: said.take(), result, last: Attempt::default(), attempts: Vec::new() };
        let carried_out = run.carry_out_or_try_again(asked, (k, wish), &mut step).await;
        let achieved = step.achieved();
        steps.push(step);
        carried_out?;
        if !achieved {
            break;
        }
    }
    Ok(())
}

/// A sequence that is being carried out.
struct Run<'a> {
    system: System<'a>,
    attempts: usize,
    view: View,
    followed: Followed,
}

impl Run<'_> {
    /// A wish in the ids of the newest view.
    fn translated(&self, k: usize, wish: &NextWish) -> Result<(u16, Vec<GoalTerm>), Failure> {
        Ok(self.followed.translated(&format!("step[{k}]"), wish.query, &wish.goal)?)
    }

    /// Has a placement of `asked` carried out, and tries again while that makes sense; `step` says what the last attempt came to.
    async fn carry_out_or_try_again(&mut self, mut asked: PlaceRequest, (k, wish): (usize, &NextWish), step: &mut Step) -> Outcome {
        loop {
            let carried_out = match step.result.placements.is_empty() {
                true => Ok(()),
                false => self.carry_out(&asked, (k, wish), step).await,
            };
            if step.attempts.len() + 1 >= self.attempts || !self.may_try_again(step, &carried_out).await {
                return carried_out;
            }
            match self.asked_again(&asked, (k, wish), step).await {
                Ok((request, result)) => {
                    asked = request;
                    step.begin_again(result);
                }
                // What is in the way of another attempt is said beside what came of this one.
                Err(failure) => {
                    let why = failure.error().map_or_else(String::new, ToString::to_string);
                    let before = step.last.tried.reason.take().map_or_else(String::new, |reason| format!("{reason}; "));
                    step.last.tried.reason = Some(format!("{before}not tried again: {why}"));
                    return carried_out;
                }
            }
        }
    }

    /// The same request on a fresh view, with other draws, and its answer. Where the arm has moved it is brought home first.
    async fn asked_again(
        &mut self,
        asked: &PlaceRequest,
        (k, wish): (usize, &NextWish),
        step: &mut Step,
    ) -> Result<(PlaceRequest, PlaceResult), Failure> {
        if step.last.tried.execution.is_some() {
            self.view = self.system.back_and_looking().await?;
            self.followed.look_for_lost(wish.query, &self.view.1);
            // The arm is in nobody's way any more.
            step.last.tried.fates = Some(self.followed.disturbed());
        }
        let (query, goal) = self.translated(k, wish)?;
        let scene = SceneRef { scene_id: self.view.0.clone() };
        let request = PlaceRequest { scene, query, goal, seed: asked.seed.wrapping_add(1), ..asked.clone() };
        let result = self.system.placed(&request, &self.view).await?;
        Ok((request, result))
    }

    /// Has a placement carried out, and looks at what has become of the wish; `step` says how far it came.
    async fn carry_out(&mut self, request: &PlaceRequest, (k, wish): (usize, &NextWish), step: &mut Step) -> Outcome {
        let placements = &step.result.placements;
        step.last.tried = match self.system.carry_out(request, placements, &self.view).await {
            Ok(tried) => tried,
            Err(failure) => {
                step.last.tried = Tried::failed(&failure);
                return Err(failure);
            }
        };
        // What was not placed is looked for where it was.
        let moved = step.last.tried.moved(placements)?;
        self.followed.carried(Some(wish.query), &moved);
        self.view = self.system.view_after(now_ns()).await?;
        self.followed.look_again(&self.view.1);
        step.last.tried.fates = Some(self.followed.disturbed());
        if step.last.tried.execution == Some(ExecutionOutcome::Done) {
            match self.followed.translated(&format!("step[{k}]"), wish.query, &wish.goal) {
                Ok((query, goal)) => step.last.holds = holds(&self.view.1, step.result.view_yaw_rad, query, &goal),
                Err(unseen) => step.last.tried.reason = Some(format!("whether it holds cannot be seen: {}", unseen.message)),
            }
        }
        Ok(())
    }

    /// Whether another attempt makes sense and is nobody else's decision: nothing could be served and nothing has moved, or the object was not
    /// grasped, was lost, or does not stand where it should, and the robot stands there free, without a stop.
    async fn may_try_again(&self, step: &Step, carried_out: &Outcome) -> bool {
        if let Err(failure) = carried_out {
            return step.last.tried.execution.is_none() && is_unserved(failure);
        }
        let failed = match step.last.tried.execution {
            Some(ExecutionOutcome::GraspLost) => true,
            Some(ExecutionOutcome::Done) => !step.achieved(),
            Some(ExecutionOutcome::Stopped) | None => false,
        };
        failed && self.system.is_free().await
    }
}
