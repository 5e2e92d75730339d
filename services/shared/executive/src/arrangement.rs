//! Goals about several objects, brought about move by move, with a look after each.
//!
//! Only the first move of a plan is carried out: what it has truly left is seen, and the rest is planned anew from there. So what slipped,
//! fell or was pushed by somebody is simply where it is now; what cannot be seen is told from what is gone ([`Fate`]). A goal that was seen to
//! hold counts as held while what it is about is hidden by what came before it, untouched; and where the newest view gives no moves, the complete
//! plan before it goes on, if what its next move is about stands where it stood. A plan may end where a view is needed: its first move is
//! made as any other, and the view follows. Objects are named as in the first view. Nothing moves where an object that must move offers the hand no
//! grasp. Every object is tried a bounded number of times and set aside a bounded number of times, and the moves together are bounded too; after a
//! stop, whoever latched it, and after a cancel nothing is tried again: a person decides.

use std::collections::{BTreeMap, BTreeSet};

use repose_proto::arrange::{ArrangeMove, ArrangeRequest, ArrangeResult, Conflict, ObjectGoal, Purpose};
use repose_proto::motion::ExecutionOutcome;
use repose_proto::place::{Outcome as Found, Placement};
use repose_proto::{CallError, GoalTerm, Message, Payload, PlaceRequest, Scene, SceneRef};
use repose_runtime::CallOptions;
use repose_sentences::{fate, robot};
use repose_tracking::{Fate, Followed, holds};
use serde::Serialize;

use crate::memory::GoalMemory;
use crate::site::{COUNT, IdentifiedScene, MoveStage, Site, is_unserved, is_without_grasp};
use crate::tried::Tried;

/// Fresh views in which something that is not seen is looked for before it counts as lost.
const LOOKS: usize = 3;
/// Times that an object is set aside: once to uncover a top or to make room, and once more where things went otherwise. More often, and the moves
/// undo each other.
const ASIDE: usize = 2;

/// A move of an arrangement that was tried, and its result.
#[derive(Debug, Clone, Serialize)]
pub struct TriedMove {
    /// The object, as in the first view; none where that did not have it.
    pub object: Option<u16>,
    /// The move as it was planned; ids are those of its own view.
    pub planned: ArrangeMove,
    /// Moves that were still to come after it.
    pub to_come: usize,
    /// How far it came. Placement 0 is the plan's, others are alternatives for the same goal that the robot could serve.
    #[serde(flatten)]
    pub tried: Tried,
}

impl TriedMove {
    /// The result for people: how the move ended, and what else was seen.
    pub fn describe(&self) -> Vec<String> {
        let end = match (self.tried.execution, &self.tried.reason) {
            (Some(ExecutionOutcome::Done), _) => "executed".to_owned(),
            (_, Some(reason)) => reason.clone(),
            (Some(ExecutionOutcome::Stopped), None) => "stopped".to_owned(),
            (Some(ExecutionOutcome::GraspLost), None) => "the grasp was lost".to_owned(),
            (None, None) => "not executed".to_owned(),
        };
        std::iter::once(end).chain(self.tried.disturbances(self.object)).collect()
    }
}

/// How the execution of an arrangement ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ArrangementEnd {
    /// All goals hold, those of [`ArrangementReport::remembered`] as far as was seen.
    Achieved,
    /// From where things stand no moves were found, or none that the hand can make.
    NoArrangement,
    /// As often as may be tried, it was.
    GaveUp,
    /// An object that a goal is about is not seen any more.
    Lost,
    /// The robot was stopped, or a call failed.
    Stopped,
}

/// The result of an arrangement.
#[derive(Debug, Serialize)]
pub struct ArrangementReport {
    /// Goals that were asked for.
    pub wanted: usize,
    /// Goals that hold on the last view, and those that are remembered.
    pub achieved: usize,
    /// How it ended.
    pub ended: ArrangementEnd,
    /// Why it ended there, where it was not achieved.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub why: Option<String>,
    /// By object, whether its goal holds on the last view, by rule; null where that cannot be seen.
    pub holds: BTreeMap<u16, Option<bool>>,
    /// Objects whose goals were seen to hold and cannot be seen any more: what they are about is hidden, and was not touched since.
    #[serde(skip_serializing_if = "BTreeSet::is_empty")]
    pub remembered: BTreeSet<u16>,
    /// Every move that was tried.
    pub steps: Vec<TriedMove>,
    /// Where the smallest set of goals without an arrangement is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub conflict: Option<Conflict>,
    /// How the robot stands.
    pub robot: String,
    /// The error that ended it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub error: Option<CallError>,
}

/// What is told while goals are brought about, with the names of the first view.
#[derive(Debug)]
pub enum News<'a> {
    /// Moves are planned from where things stand.
    Planned(PlannedMoves),
    /// A move was tried.
    Tried(&'a TriedMove),
}

/// The moves planned from the current scene.
#[derive(Debug, Clone, PartialEq)]
pub struct PlannedMoves {
    /// In order.
    pub moves: Vec<NamedMove>,
    /// The probability that all of them succeed.
    pub probability: Option<f64>,
    /// Objects whose tops these moves uncover, where the rest can only be planned on a view after them, in the first view's ids.
    pub needs_view: Vec<u16>,
    /// The smallest set of goals that is known to have no arrangement, in the first view's ids.
    pub conflict: Option<Conflict>,
}

/// A move that is planned. What the first view did not have is left out.
#[derive(Debug, Clone, PartialEq)]
pub struct NamedMove {
    /// The object.
    pub object: Option<u16>,
    /// What it moves for.
    pub purpose: Purpose,
    /// The terms that its place was chosen by.
    pub goal: Vec<GoalTerm>,
}

/// Has goals brought about; its scene is each view in turn. The request's ids are those of `seen`, or without it those of the newest view, which
/// becomes the first. An object is tried `attempts` times, at least once; `told` hears how it goes.
///
/// # Errors
/// Whatever ended it before a move was tried.
pub async fn bring_about<S: Site>(
    site: S,
    seen: Option<&Scene>,
    mut request: ArrangeRequest,
    attempts: usize,
    told: impl FnMut(News<'_>) + Send,
) -> Result<ArrangementReport, CallError> {
    let view = site.view_after(seen.map_or(0, |scene| scene.stamp_ns)).await?;
    let mut followed = Followed::of(seen.unwrap_or(&view.1));
    if seen.is_some() {
        followed.look_again(&view.1);
    }
    if request.robot.is_none() {
        request.robot = site.reaching().await;
    }
    let memory = GoalMemory::of(&request.goals);
    request.fresh_views = true;
    let (steps, failed, aside, earlier) = (Vec::new(), BTreeMap::new(), BTreeMap::new(), Vec::new());
    let mut run = Run { site, told, request, attempts, view, followed, memory, steps, failed, aside, earlier, conflict: None };
    let (ended, why, error) = match run.until_the_end().await {
        // Nothing was tried.
        Err(error) if run.steps.is_empty() => return Err(error),
        Err(error) => (ArrangementEnd::Stopped, Some(error.to_string()), Some(error)),
        Ok((ended, why)) => (ended, why, None),
    };
    let robot = match run.site.state().await {
        Ok(state) => robot::describe(run.site.robot(), &state),
        Err(_) => format!("{} does not tell its state", run.site.robot()),
    };
    let (holds, remembered) = (run.holds(), run.memory.remembered(&run.followed));
    Ok(ArrangementReport {
        wanted: holds.len(),
        achieved: holds.values().filter(|holds| **holds == Some(true)).count() + remembered.len(),
        ended,
        why,
        holds,
        remembered,
        steps: run.steps,
        conflict: run.conflict,
        robot,
        error,
    })
}

/// An arrangement that is being brought about.
struct Run<S, T> {
    site: S,
    told: T,
    /// What is asked for, in the ids of the first view.
    request: ArrangeRequest,
    attempts: usize,
    view: IdentifiedScene,
    followed: Followed,
    memory: GoalMemory,
    steps: Vec<TriedMove>,
    /// How often an object, by its id in the first view, was tried in vain.
    failed: BTreeMap<u16, usize>,
    /// How often an object was set aside.
    aside: BTreeMap<u16, usize>,
    /// What the last complete plan has left to do, in the ids of the first view.
    earlier: Vec<ArrangeMove>,
    conflict: Option<Conflict>,
}

impl<S: Site, T: FnMut(News<'_>) + Send> Run<S, T> {
    /// Plans, moves and looks until all goals hold, or until it has to end; how it ended, and why.
    async fn until_the_end(&mut self) -> Result<(ArrangementEnd, Option<String>), CallError> {
        let most_moves = 2 * self.request.goals.len() + self.request.max_parkings as usize + self.attempts;
        loop {
            let goals = match self.goals_in_view().await {
                Ok(goals) => goals,
                Err(unseen) if self.steps.is_empty() => return Err(unseen),
                Err(unseen) => return Ok((ArrangementEnd::Lost, Some(unseen.message))),
            };
            if goals.is_empty() {
                return Ok((ArrangementEnd::Achieved, None));
            }
            let result = self.planned(goals).await?;
            let next = self.next_move(&result);
            let named = self.to_come(&result, next.as_ref());
            self.conflict.clone_from(&named.conflict);
            (self.told)(News::Planned(named));
            let Some(step) = next else {
                let why = match result.outcome {
                    Found::Found => return Ok((ArrangementEnd::Achieved, None)),
                    Found::Partial => "the search was cut short before a move",
                    Found::None => "no moves were found",
                };
                return Ok((ArrangementEnd::NoArrangement, Some(why.to_owned())));
            };
            if !self.site.goes_on() {
                return Ok((ArrangementEnd::Stopped, Some("no more was wanted".to_owned())));
            }
            if self.steps.is_empty()
                && let Some(why) = self.without_grasp(&result.moves).await
            {
                return Ok((ArrangementEnd::NoArrangement, Some(why)));
            }
            if self.steps.len() >= most_moves {
                return Ok((ArrangementEnd::GaveUp, Some(format!("{most_moves} moves were tried"))));
            }
            let object = self.followed.known().named(step.object);
            if let Some(object) = object.filter(|object| step.purpose == Purpose::Aside && self.aside.get(object) == Some(&ASIDE)) {
                return Ok((ArrangementEnd::GaveUp, Some(format!("object {object} was set aside {ASIDE} times"))));
            }
            let carried_out = self.carry_out(object, &step, self.earlier.len()).await;
            if let Some(tried) = self.steps.last() {
                (self.told)(News::Tried(tried));
            }
            let achieved = carried_out?;
            if let Some(object) = object.filter(|_| achieved && step.purpose == Purpose::Aside) {
                *self.aside.entry(object).or_default() += 1;
            }
            let tried = object.map(|object| self.failed.entry(object).or_default());
            if let Some(tried) = tried.filter(|_| !achieved) {
                *tried += 1;
                if *tried >= self.attempts {
                    let why = format!("object {} was tried {} times", object.unwrap_or_default(), *tried);
                    return Ok((ArrangementEnd::GaveUp, Some(why)));
                }
            }
        }
    }

    /// The goals in the ids of the newest view, without those that are remembered. What is not seen is looked for in a few more views: something may
    /// have been before it.
    async fn goals_in_view(&mut self) -> Result<Vec<ObjectGoal>, CallError> {
        let mut looks = 0;
        while !self.steps.is_empty() && looks < LOOKS && self.memory.misses(&self.followed) {
            looks += 1;
            if let Ok(view) = self.site.fresh_view().await {
                self.view = view;
                self.look();
            }
        }
        let remembered = self.memory.remembered(&self.followed);
        let translated = |(i, goal): (usize, &ObjectGoal)| {
            let (object, terms) = self.followed.translated(&format!("goals[{i}]"), goal.object, &goal.terms).map_err(in_request)?;
            Ok(ObjectGoal { object, terms })
        };
        let goals = self.request.goals.iter().enumerate().filter(|(_, goal)| !remembered.contains(&goal.object));
        goals.map(translated).collect::<Result<_, CallError>>().map_err(|unseen| self.explained(unseen))
    }

    /// That something is not seen, with what is known of why.
    fn explained(&self, unseen: CallError) -> CallError {
        let disturbed = self.followed.disturbed();
        let why: Vec<String> = disturbed
            .iter()
            .filter(|(_, fate)| matches!(fate, Fate::Hidden | Fate::Gone))
            .map(|(id, fate)| fate::sentence(*id, fate))
            .collect();
        if why.is_empty() { unseen } else { CallError { message: why.join("; "), ..unseen } }
    }

    /// Finds the objects again in the newest view, and notes on the last step what became of them.
    fn look(&mut self) {
        self.followed.look_again(&self.view.1);
        let holds = self.holds();
        self.memory.look(&holds);
        if let Some(step) = self.steps.last_mut() {
            step.tried.fates = Some(self.followed.disturbed());
        }
    }

    /// The arrangement planned on the newest view; every failed attempt gives other draws.
    async fn planned(&self, goals: Vec<ObjectGoal>) -> Result<ArrangeResult, CallError> {
        let failed: usize = self.failed.values().sum();
        let request = ArrangeRequest {
            scene: SceneRef { scene_id: self.view.0.clone() },
            goals,
            seed: self.request.seed.wrapping_add(failed as u64),
            ..self.request.clone()
        };
        request.validate()?;
        let encode = |scene: Option<&Scene>| Payload::with_scene(&request, scene);
        let options = CallOptions::within(self.site.deadline());
        self.site.begins(MoveStage::Placing);
        let answered = self.site.planner().call_with_scene("arrange", Some(&self.view.1), encode, options).await?;
        answered.payload.decode_json()
    }

    /// A plan with the names of the first view.
    fn named(&self, result: &ArrangeResult) -> PlannedMoves {
        let known = self.followed.known();
        let term = |t: &GoalTerm| Some(GoalTerm { anchor: known.named(t.anchor)?, ..*t });
        let terms = |terms: &[GoalTerm]| terms.iter().filter_map(term).collect::<Vec<_>>();
        let named = |m: &ArrangeMove| NamedMove { object: known.named(m.object), purpose: m.purpose, goal: terms(&m.goal) };
        let goal = |g: &ObjectGoal| Some(ObjectGoal { object: known.named(g.object)?, terms: terms(&g.terms) });
        let conflict = |c: &Conflict| Conflict { goals: c.goals.iter().filter_map(goal).collect(), ..c.clone() };
        PlannedMoves {
            moves: result.moves.iter().map(named).collect(),
            probability: result.probability,
            needs_view: result.needs_view.iter().filter_map(|top| known.named(*top)).collect(),
            conflict: result.conflict.as_ref().map(conflict),
        }
    }

    /// The move to make now: a plan's first, or where it has none and goals are open, the next one of the complete plan before it.
    fn next_move(&mut self, result: &ArrangeResult) -> Option<ArrangeMove> {
        let Some(first) = result.moves.first() else {
            return if result.outcome == Found::Found { None } else { self.of_earlier_plan() };
        };
        let known = self.followed.known();
        let named = |m: &ArrangeMove| renamed(m, |id| known.named(id));
        let is_complete = result.outcome == Found::Found;
        self.earlier = result.moves.iter().skip(1).filter(|_| is_complete).map_while(named).collect();
        Some(first.clone())
    }

    /// What is told of the moves to come: the plan's, or where an earlier one goes on, that one's.
    fn to_come(&self, result: &ArrangeResult, next: Option<&ArrangeMove>) -> PlannedMoves {
        let named = self.named(result);
        let Some(next) = next.filter(|_| result.moves.is_empty()) else { return named };
        let now = renamed(next, |id| self.followed.known().named(id));
        let moves = now.iter().chain(&self.earlier);
        let shown = |m: &ArrangeMove| NamedMove { object: Some(m.object), purpose: m.purpose, goal: m.goal.clone() };
        PlannedMoves { moves: moves.map(shown).collect(), probability: None, conflict: None, ..named }
    }

    /// The next move of an earlier plan, in the ids of the newest view: what was set down since may hide what that plan went by. None where
    /// anything that the move is about is not seen, or does not stand where it should.
    fn of_earlier_plan(&mut self) -> Option<ArrangeMove> {
        let (step, rest) = self.earlier.split_first()?;
        let disturbed = self.followed.disturbed();
        let is_there = |id: u16| self.followed.known().now(id).filter(|_| !disturbed.contains_key(&id));
        let now = renamed(step, is_there)?;
        self.earlier = rest.to_vec();
        Some(now)
    }

    /// Has a move carried out, and looks: whether the object stands where it was to go. An error ends it all.
    async fn carry_out(&mut self, object: Option<u16>, planned: &ArrangeMove, to_come: usize) -> Result<bool, CallError> {
        self.steps.push(TriedMove { object, planned: planned.clone(), to_come, tried: Tried::default() });
        let (request, placements) = self.choices(planned).await?;
        let carried_out = self.site.carry_out(&request, &placements, &self.view).await;
        let Some(step) = self.steps.last_mut() else { return Ok(false) };
        step.tried = match carried_out {
            Ok(tried) => tried,
            Err(error) => {
                step.tried = Tried::failed(&error);
                return if is_unserved(&error) { Ok(false) } else { Err(error) };
            }
        };
        let is_done = step.tried.execution == Some(ExecutionOutcome::Done);
        let motion = step.tried.moved(&placements)?;
        let why = step.tried.reason.clone();
        let goes_on = is_done || (step.tried.execution == Some(ExecutionOutcome::GraspLost) && self.site.is_free().await);
        if !goes_on {
            let why = why.unwrap_or_else(|| "the robot was stopped".to_owned());
            return Err(CallError::precondition(why));
        }
        self.view = if is_done { self.site.fresh_view().await? } else { self.site.back_and_looking().await? };
        self.followed.carried(object, &motion);
        object.into_iter().for_each(|object| self.memory.carried(object));
        self.look();
        let stands = object.is_none_or(|object| matches!(self.followed.disturbed().get(&object), None | Some(Fate::Hidden)));
        Ok(is_done && stands)
    }

    /// Why one of the moves cannot be made: its object offers the hand no grasp, in as many draws as an object is tried. None where all offer one.
    /// Whatever else keeps the robot from a move may be different when its turn comes, and is said then.
    async fn without_grasp(&self, moves: &[ArrangeMove]) -> Option<String> {
        let mut asked = BTreeSet::new();
        for step in moves.iter().filter(|step| asked.insert(step.object)) {
            let mut why = None;
            for draw in 0..self.attempts.max(1) as u64 {
                let request = PlaceRequest {
                    seed: self.request.seed.wrapping_add(draw),
                    ..PlaceRequest::new(self.view.0.clone(), step.object, step.goal.clone())
                };
                why = match self.site.motion_for(&request, std::slice::from_ref(&step.placement), &self.view).await {
                    Err(error) if is_without_grasp(&error) => Some(error.message),
                    _ => None,
                };
                if why.is_none() {
                    break;
                }
            }
            if let Some(why) = why {
                let object = self.followed.known().named(step.object).unwrap_or(step.object);
                return Some(format!("object {object} must move: {why}"));
            }
        }
        None
    }

    /// The placements that the robot may choose from: the plan's own, and others for the same terms.
    async fn choices(&self, planned: &ArrangeMove) -> Result<(PlaceRequest, Vec<Placement>), CallError> {
        let request = PlaceRequest {
            count: COUNT,
            view_yaw_rad: self.request.view_yaw_rad,
            rotation: self.request.rotation,
            variant: self.request.variant,
            robot: self.request.robot.clone(),
            seed: self.request.seed.wrapping_add(self.steps.len() as u64),
            ..PlaceRequest::new(self.view.0.clone(), planned.object, planned.goal.clone())
        };
        let others = self.site.placed(&request, &self.view).await?.placements;
        Ok((request, std::iter::once(planned.placement.clone()).chain(others).collect()))
    }

    /// By object, whether its goal holds on the newest view; none where that cannot be seen.
    fn holds(&self) -> BTreeMap<u16, Option<bool>> {
        let view = &self.view.1;
        let yaw_rad = self.request.view_yaw_rad.unwrap_or(view.meta.view_yaw_rad);
        let of = |goal: &ObjectGoal| {
            let translated = self.followed.translated("goals", goal.object, &goal.terms).ok();
            translated.map(|(object, terms)| holds(view, yaw_rad, object, &terms).into_iter().all(|holds| holds))
        };
        self.request.goals.iter().map(|goal| (goal.object, of(goal))).collect()
    }
}

/// A move with other ids; none where one has no other.
fn renamed(step: &ArrangeMove, id: impl Fn(u16) -> Option<u16>) -> Option<ArrangeMove> {
    let goal = step.goal.iter().map(|term| Some(GoalTerm { anchor: id(term.anchor)?, ..*term })).collect::<Option<_>>()?;
    Some(ArrangeMove { object: id(step.object)?, goal, ..step.clone() })
}

/// The field at fault as the request names it.
fn in_request(error: CallError) -> CallError {
    let field = error.field.as_ref().map(|field| field.replace(".query", ".object").replace(".goal[", ".terms["));
    CallError { field, ..error }
}
