//! Goals about several objects, brought about move by move, with a look after each.
//!
//! Only the first move of a plan is carried out: what it has truly left is seen, and the rest is planned anew from there. So what slipped,
//! fell or was pushed by somebody is simply where it is now; what cannot be seen is told from what is gone ([`Fate`]). A goal that was seen to
//! hold counts as held while what it is about is hidden by what came before it, untouched; and where the newest view gives no moves, the complete
//! plan before it goes on, if its last move succeeded and what its next one is about stands where it stood. A plan may end where a view is needed:
//! its first move is made as any other, and the view follows. A move that the robot cannot make from where things stand is put off, and the next one
//! that does not need it is made: what it leaves may have room for the other. Where no moves are found after some were made, a fresh view and other
//! draws are tried, as often as an object. Objects are named as in the first view. Nothing moves where an object that must move offers the hand no
//! grasp. Every object is tried a bounded number of times and set aside a bounded number of times, and the moves together are bounded too; after a
//! stop, whoever latched it, and after a cancel nothing is tried again: a person decides.

mod order;
mod report;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};

use repose_proto::arrange::{ArrangeMove, ArrangeRequest, ArrangeResult, Conflict, ObjectGoal, Proof, Purpose};
use repose_proto::motion::ExecutionOutcome;
use repose_proto::place::{Outcome as Found, Placement};
use repose_proto::{CallError, GoalTerm, Message, Payload, PlaceRequest, Scene, SceneRef};
use repose_runtime::CallOptions;
use repose_sentences::{fate, robot};
use repose_tracking::{Fate, Followed, holds};

use self::order::{next_possible, renamed};
pub use self::report::{ArrangementEnd, ArrangementReport, NamedMove, News, PlannedMoves, TriedMove};
use crate::attended::Attended;
use crate::memory::{GoalMemory, about};
use crate::site::{COUNT, IdentifiedScene, MoveStage, Site, is_unserved, is_without_grasp};
use crate::tried::Tried;

/// Fresh views in which something that is not seen is looked for before it counts as lost.
const LOOKS: usize = 3;
/// Times that an object is set aside: once to uncover a top or to make room, and once more where things went otherwise. More often, and the moves
/// undo each other.
const ASIDE: usize = 2;

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
    let site = Attended::from_now(site).await;
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
    let mut run = Run {
        site,
        told,
        request,
        attempts,
        view,
        followed,
        memory,
        steps: Vec::new(),
        failed: BTreeMap::new(),
        put_off: BTreeSet::new(),
        barren: 0,
        aside: BTreeMap::new(),
        earlier: Vec::new(),
        conflict: None,
        maybe_moved: None,
    };
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
    site: Attended<S>,
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
    /// Objects whose move the robot could not make since anything moved last.
    put_off: BTreeSet<u16>,
    /// Views on which no moves were found, after some were made.
    barren: usize,
    /// How often an object was set aside.
    aside: BTreeMap<u16, usize>,
    /// What the last complete plan has left to do, in the ids of the first view; nothing once a move of it has failed.
    earlier: Vec<ArrangeMove>,
    conflict: Option<Conflict>,
    /// The object that the robot may have moved since the newest view, by its id in the first one.
    maybe_moved: Option<u16>,
}

impl<S: Site, T: FnMut(News<'_>) + Send> Run<S, T> {
    /// Plans, moves and looks until all goals hold, or until it has to end; how it ended, and why.
    async fn until_the_end(&mut self) -> Result<(ArrangementEnd, Option<String>), CallError> {
        let most_moves = 2 * self.request.goals.len() + self.request.max_parkings as usize + self.attempts;
        self.note_goals();
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
            let named = self.to_come(&result, next.as_ref().map(|(step, _)| step));
            self.conflict.clone_from(&named.conflict);
            (self.told)(News::Planned(named));
            let Some((step, is_first)) = next else {
                if self.is_worth_another_look(&result) {
                    self.barren += 1;
                    self.view = self.site.fresh_view().await?;
                    self.look();
                    continue;
                }
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
            let carried_out = self.carry_out(object, &step, is_first).await;
            if let Some(tried) = self.steps.last() {
                (self.told)(News::Tried(tried));
                match tried.tried.execution {
                    Some(_) => self.put_off.clear(),
                    None => self.put_off.extend(object),
                }
            }
            let achieved = carried_out?;
            if let Some(why) = self.counted(object, step.purpose, achieved) {
                return Ok((ArrangementEnd::GaveUp, Some(why)));
            }
        }
    }

    /// Counts a move that was tried; the reason to give up, where there is one.
    fn counted(&mut self, object: Option<u16>, purpose: Purpose, achieved: bool) -> Option<String> {
        if !achieved {
            // What the plan has left starts from where this move should have ended.
            self.earlier.clear();
        }
        let object = object?;
        if achieved {
            *self.aside.entry(object).or_default() += usize::from(purpose == Purpose::Aside);
            return None;
        }
        let tried = self.failed.entry(object).or_default();
        *tried += 1;
        (*tried >= self.attempts).then(|| format!("object {object} was tried {tried} times"))
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
        self.maybe_moved = None;
        self.followed.look_again(&self.view.1);
        self.note_goals();
        if let Some(step) = self.steps.last_mut() {
            step.tried.fates = Some(self.followed.disturbed());
        }
    }

    /// Notes which goals hold on the newest view, before something hides what they are about.
    fn note_goals(&mut self) {
        let holds = self.holds();
        self.memory.look(&holds, &self.followed.disturbed());
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

    /// Whether moves may be found where none were: they were before, and one view's noise, or the draws, may be to blame.
    fn is_worth_another_look(&self, result: &ArrangeResult) -> bool {
        let contradicts = result.conflict.as_ref().is_some_and(|conflict| conflict.proof == Proof::Contradiction);
        result.outcome == Found::None && !contradicts && !self.steps.is_empty() && self.barren + 1 < self.attempts
    }

    /// The move to make now, and whether it is the plan's first: that, or one that needs nothing of those put off before it; or where the plan has none
    /// and goals are open, the next one of the complete plan before it.
    fn next_move(&mut self, result: &ArrangeResult) -> Option<(ArrangeMove, bool)> {
        if result.moves.is_empty() {
            return if result.outcome == Found::Found { None } else { self.of_earlier_plan().map(|step| (step, true)) };
        }
        let known = self.followed.known();
        let named = |m: &ArrangeMove| renamed(m, |id| known.named(id));
        let at = next_possible(&result.moves, |object| known.named(object).is_some_and(|object| self.put_off.contains(&object)));
        let goes_on = at == 0 && result.outcome == Found::Found;
        self.earlier = result.moves.iter().skip(1).filter(|_| goes_on).map_while(named).collect();
        Some((result.moves[at].clone(), at == 0))
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
    async fn carry_out(&mut self, object: Option<u16>, planned: &ArrangeMove, is_first: bool) -> Result<bool, CallError> {
        self.steps.push(TriedMove { object, planned: planned.clone(), to_come: self.earlier.len(), tried: Tried::default() });
        let (request, placements) = self.choices(planned, is_first).await?;
        let carried_out = match placements.is_empty() {
            true => {
                Err(CallError::precondition("nothing of what is planned before it was done, and no other place was found").at("placements"))
            }
            false => self.site.carry_out(&request, &placements, &self.view).await,
        };
        // Whatever came of it, the robot may have taken the object up.
        let may_have_begun = !carried_out.as_ref().is_err_and(is_unserved);
        self.maybe_moved = object.filter(|_| may_have_begun);
        self.maybe_moved.into_iter().for_each(|object| self.memory.carried(object));
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

    /// The placements that the robot may choose from: the plan's own, and others for the same terms. A place that is planned for after other moves may be
    /// taken, or have nothing to stand on, before them.
    async fn choices(&self, planned: &ArrangeMove, is_first: bool) -> Result<(PlaceRequest, Vec<Placement>), CallError> {
        let request = PlaceRequest {
            count: COUNT,
            view_yaw_rad: self.request.view_yaw_rad,
            rotation: self.request.rotation,
            variant: self.request.variant,
            robot: self.request.robot.clone(),
            seed: self.request.seed.wrapping_add(self.steps.len() as u64),
            ..PlaceRequest::new(self.view.0.clone(), planned.object, planned.goal.clone())
        };
        let others = match self.site.placed(&request, &self.view).await {
            Ok(others) => others.placements,
            // A planner that is too busy to say where else it could go takes nothing from the place that is planned.
            Err(error) if is_first => {
                tracing::warn!(object = planned.object, %error, "there is the planned place only");
                Vec::new()
            }
            Err(error) => return Err(error),
        };
        let own = is_first.then(|| planned.placement.clone());
        Ok((request, own.into_iter().chain(others).collect()))
    }

    /// By object, whether its goal holds on the newest view; none where that cannot be seen, and where something that it is about may have been moved
    /// since.
    fn holds(&self) -> BTreeMap<u16, Option<bool>> {
        let view = &self.view.1;
        let yaw_rad = self.request.view_yaw_rad.unwrap_or(view.meta.view_yaw_rad);
        let of = |goal: &ObjectGoal| {
            if about(goal).any(|object| self.maybe_moved == Some(object)) {
                return None;
            }
            let translated = self.followed.translated("goals", goal.object, &goal.terms).ok();
            translated.map(|(object, terms)| holds(view, yaw_rad, object, &terms).into_iter().all(|holds| holds))
        };
        self.request.goals.iter().map(|goal| (goal.object, of(goal))).collect()
    }
}

/// The field at fault as the request names it.
fn in_request(error: CallError) -> CallError {
    let field = error.field.as_ref().map(|field| field.replace(".query", ".object").replace(".goal[", ".terms["));
    CallError { field, ..error }
}
