//! `repose place … --then …`: wishes achieved one after another, each planned on a fresh view of what the one before has left.
//!
//! Paper, appendix: mug and bowl to the right of a large box, one after the other, where the second may well end up on the first. Objects
//! are named as in the first view. A camera that finds its objects anew numbers them anew; they are told by where they are: the moved one
//! where it was put, every other where it was.

use std::collections::BTreeMap;
use std::time::Duration;

use nalgebra::{Isometry3, Point3};
use repose_geometry::ViewerFrame;
use repose_geometry::transform::from_row_major;
use repose_proto::motion::{ExecuteReply, ExecutionOutcome, MotionPlan, MotionPlanRequest};
use repose_proto::place::ReachingRobot;
use repose_proto::{CallError, ErrorCode, GoalTerm, Message, ObjectSummary, Payload, PlaceRequest, PlaceResult, Scene, Service};
use repose_relations::{ObservedObject, observed};
use repose_runtime::{CallOptions, Caller, Session};
use serde::Serialize;

use crate::answer::describe;
use crate::client::{self, ConnectArgs};
use crate::failure::{Failure, Outcome};
use crate::moving::{self, Interrupts, of_motion};
use crate::output::Output;
use crate::say::Said;
use crate::wish::{NextWish, WishArgs};

/// Placements that motion may choose from.
const COUNT: u32 = 5;
/// An object found anew is the known one that was to be nearest, up to this far away, metres.
const SAME_M: f64 = 0.08;

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
    /// The placement that motion chose, from 0; none where there was none to choose from.
    #[serde(skip_serializing_if = "Option::is_none")]
    placement: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    execution: Option<ExecutionOutcome>,
    #[serde(skip_serializing_if = "Option::is_none")]
    reason: Option<String>,
    /// Each term by rule on the view after it.
    holds: Vec<bool>,
}

impl Step {
    fn achieved(&self) -> bool {
        self.execution == Some(ExecutionOutcome::Done) && !self.holds.is_empty() && self.holds.iter().all(|holds| *holds)
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
    let end = match step.execution {
        Some(ExecutionOutcome::Done) => "executed".to_owned(),
        Some(other) => format!("{other:?}"),
        None => "not executed".to_owned(),
    };
    let holds = step.goal.iter().zip(&step.holds).map(|(t, h)| format!("{t} {}", if *h { "holds" } else { "does not hold" }));
    let said: Vec<String> = std::iter::once(end).chain(step.reason.clone()).chain(holds).collect();
    let understood = step.said.as_ref().map(|s| format!("{s}\n")).unwrap_or_default();
    format!("{understood}{}\n  {}", describe(&step.result), said.join("; "))
}

/// Adds what came of each wish to `steps`, also of one that an error ended.
async fn achieve(args: &Sequence<'_>, session: &Session, steps: &mut Vec<Step>) -> Outcome {
    let deadline = Duration::from_millis(args.connect.deadline_ms);
    let mut system = System {
        session,
        planner: session.caller(Service::Planner).await?,
        motion: session.caller(Service::Motion).await?,
        camera: &args.connect.camera,
        robot: args.robot,
        deadline,
        interrupts: Interrupts::listen()?,
    };
    let mut view = system.view_after(0).await?;
    let (first, mut said) = args.wish.on(&view.1)?;
    let reaching = system.reaching().await;
    let mut known = Known::of(&view.1.meta.objects);
    let wishes = || std::iter::once(&first).chain(args.then).enumerate();
    let request = |scene_id: &str, (query, goal): (u16, Vec<GoalTerm>)| {
        let asked = args.wish.request(scene_id.to_owned(), &NextWish { query, goal });
        let robot = asked.robot.clone().or_else(|| reaching.clone());
        let request = PlaceRequest { count: args.wish.count.max(COUNT), robot, ..asked };
        request.validate().map(|()| request)
    };
    // A wish that cannot be is refused before anything moves.
    for (k, wish) in wishes() {
        request(&view.0, known.translated(k, wish)?)?;
    }
    for (k, wish) in wishes() {
        let request = request(&view.0, known.translated(k, wish)?)?;
        let (result, _) = client::place(&system.planner, &request, Some(&view.1), CallOptions::within(deadline)).await?;
        let mut step = Step {
            query: wish.query,
            goal: wish.goal.clone(),
            said: said.take(),
            result,
            placement: None,
            execution: None,
            reason: None,
            holds: Vec::new(),
        };
        let carried_out = match step.result.placements.is_empty() {
            true => Ok(()),
            false => system.carry_out(&request, (k, wish), &mut step, &mut view, &mut known).await,
        };
        let achieved = step.achieved();
        steps.push(step);
        carried_out?;
        if !achieved {
            break;
        }
    }
    Ok(())
}

/// The running system as a sequence sees it.
struct System<'a> {
    session: &'a Session,
    planner: Caller,
    motion: Caller,
    camera: &'a str,
    robot: &'a str,
    deadline: Duration,
    interrupts: Interrupts,
}

impl System<'_> {
    /// The robot with the pose of its base, where it tells that and its reach is known.
    async fn reaching(&self) -> Option<ReachingRobot> {
        // One that does not answer is named when it is to move.
        let state = client::robot_state(self.session, self.robot, self.deadline).await.ok()?;
        let is_known = state.model.as_deref().is_none_or(|model| model == "panda");
        let pose = state.world_from_base.filter(|_| is_known)?;
        Some(ReachingRobot { name: self.robot.to_owned(), world_from_base: Some(pose) })
    }

    /// The first scene, with its id, that was seen after an instant.
    async fn view_after(&self, instant_ns: u64) -> Result<(String, Scene), Failure> {
        let give_up = tokio::time::Instant::now() + self.deadline;
        loop {
            let summary = client::newest_scene(self.session, self.camera, self.deadline, client::PATIENCE).await?;
            if summary.stamp_ns > instant_ns {
                let scene = client::whole_scene(self.session, &summary.scene_id, self.deadline).await?;
                return Ok((summary.scene_id, scene));
            }
            if tokio::time::Instant::now() >= give_up {
                let message = format!("camera {} has shown nothing new in {} ms", self.camera, self.deadline.as_millis());
                return Err(Failure::Other(CallError::new(ErrorCode::DeadlineExceeded, message)));
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    }

    /// Has a placement carried out, and looks at what has become of the wish; `step` says how far it came.
    async fn carry_out(
        &mut self,
        request: &PlaceRequest,
        (k, wish): (usize, &NextWish),
        step: &mut Step,
        view: &mut (String, Scene),
        known: &mut Known,
    ) -> Outcome {
        let (plan, executed) = match self.moved(request, &step.result, view).await {
            Ok(moved) => moved,
            Err(failure) => {
                step.reason = failure.error().map(ToString::to_string);
                return Err(failure);
            }
        };
        (step.placement, step.execution, step.reason) = (Some(plan.placement), Some(executed.outcome), executed.reason);
        let moved: Isometry3<f64> =
            from_row_major(&step.result.placements[plan.placement].placed_from_observed.0).map_err(Failure::other)?;
        *view = self.view_after(client::now_ns()).await?;
        known.move_on(wish.query, &moved, &view.1.meta.objects);
        if step.execution == Some(ExecutionOutcome::Done) {
            match known.translated(k, wish) {
                Ok((query, goal)) => step.holds = holds(&view.1, step.result.view_yaw_rad, query, &goal),
                Err(unseen) => step.reason = unseen.error().map(|e| format!("whether it holds cannot be seen: {}", e.message)),
            }
        }
        Ok(())
    }

    /// Has the motion service plan, and carry the plan out.
    async fn moved(
        &mut self,
        request: &PlaceRequest,
        result: &PlaceResult,
        view: &(String, Scene),
    ) -> Result<(MotionPlan, ExecuteReply), Failure> {
        let plan = self.motion_plan(request, result, view).await?;
        tracing::info!(query = request.query, placement = plan.placement, seconds = plan.duration_ms / 1e3, "executing");
        let execute = moving::call(self.session, &self.motion, (self.robot, "execute"), Payload::json(&plan)?, &mut self.interrupts);
        let answer = execute.await?;
        Ok((plan, answer.payload.decode_json()?))
    }

    async fn motion_plan(&self, request: &PlaceRequest, result: &PlaceResult, view: &(String, Scene)) -> Result<MotionPlan, Failure> {
        let state = client::robot_state(self.session, self.robot, self.deadline).await?;
        let placements = result.placements.iter().map(|p| p.placed_from_observed).collect();
        let request = MotionPlanRequest {
            seed: request.seed,
            ..MotionPlanRequest::new(view.0.clone(), self.robot.to_owned(), request.query, placements, state.q_rad)
        };
        client::plan_motion(&self.motion, &request, &view.1, CallOptions::within(self.deadline)).await.map_err(of_motion)
    }
}

/// The objects of the first view, and where each is now.
struct Known {
    /// By the id of the first view: the id in the newest one (none when it was not found again), and its centroid.
    now: BTreeMap<u16, (Option<u16>, Point3<f64>)>,
}

impl Known {
    fn of(objects: &[ObjectSummary]) -> Self {
        Self { now: objects.iter().map(|o| (o.id, (Some(o.id), Point3::from(o.centroid_m)))).collect() }
    }

    /// A wish in the ids of the newest view.
    fn translated(&self, step: usize, wish: &NextWish) -> Result<(u16, Vec<GoalTerm>), Failure> {
        let find = |id: u16, field: &str| match self.now.get(&id) {
            Some((Some(now), _)) => Ok(*now),
            Some((None, _)) => {
                Err(Failure::from(CallError::not_found(field, format!("object {id} is not found again in the newest view"))))
            }
            None => Err(Failure::from(CallError::not_found(field, format!("the first view has no object {id}")))),
        };
        let query = find(wish.query, &format!("step[{step}].query"))?;
        let term = |(i, t): (usize, &GoalTerm)| Ok(GoalTerm { anchor: find(t.anchor, &format!("step[{step}].goal[{i}].anchor"))?, ..*t });
        Ok((query, wish.goal.iter().enumerate().map(term).collect::<Result<_, Failure>>()?))
    }

    /// After `query` (first view's id) was moved: who is who among the objects of a new view. Nearest pairs first.
    fn move_on(&mut self, query: u16, placed_from_observed: &Isometry3<f64>, objects: &[ObjectSummary]) {
        if let Some((_, centroid)) = self.now.get_mut(&query) {
            *centroid = placed_from_observed * *centroid;
        }
        let mut pairs: Vec<(f64, u16, usize)> = Vec::new();
        for (id, (_, expected)) in &self.now {
            let distance = |o: &ObjectSummary| (Point3::from(o.centroid_m) - expected).norm();
            pairs.extend(objects.iter().enumerate().map(|(k, o)| (distance(o), *id, k)).filter(|p| p.0 <= SAME_M));
        }
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
        let mut taken = vec![false; objects.len()];
        let mut found: BTreeMap<u16, usize> = BTreeMap::new();
        for (_, id, k) in pairs {
            if !taken[k] && !found.contains_key(&id) {
                taken[k] = true;
                found.insert(id, k);
            }
        }
        for (id, (now, centroid)) in &mut self.now {
            *now = found.get(id).map(|k| objects[*k].id);
            if let Some(k) = found.get(id) {
                *centroid = Point3::from(objects[*k].centroid_m);
            }
        }
    }
}

/// Each term by rule on what is seen, for the viewer of the wish.
fn holds(scene: &Scene, view_yaw_rad: f64, query: u16, goal: &[GoalTerm]) -> Vec<bool> {
    let viewer = ViewerFrame::from_yaw(view_yaw_rad);
    let object = |id: u16| ObservedObject::new(&scene.points_of(id).map(Point3::from).collect::<Vec<_>>(), &viewer);
    let moved = object(query);
    let term = |t: &GoalTerm| match (&moved, object(t.anchor)) {
        (Some(moved), Some(anchor)) => observed(moved, &anchor)[t.relation.index()] == t.holds,
        _ => false,
    };
    goal.iter().map(term).collect()
}

#[cfg(test)]
mod tests {
    use repose_proto::Relation;

    use super::*;

    fn seen(id: u16, centroid_m: [f64; 3]) -> ObjectSummary {
        ObjectSummary { id, points: 100, centroid_m, extent_m: [0.1; 3], completeness: 1.0, score: None }
    }

    #[test]
    fn objects_are_told_by_where_they_were_put_when_a_view_numbers_them_anew() {
        let mut known = Known::of(&[seen(1, [0.0, 0.0, 0.0]), seen(2, [0.3, 0.0, 0.0]), seen(3, [0.0, 0.4, 0.0])]);
        let moved = Isometry3::translation(0.5, 0.0, 0.0);
        // 1 went to x = 0.5; 3 is hidden; all others have new numbers.
        known.move_on(1, &moved, &[seen(1, [0.31, 0.0, 0.0]), seen(2, [0.49, 0.01, 0.0]), seen(3, [0.9, 0.9, 0.0])]);
        let wish = |query: u16, anchor: u16| NextWish { query, goal: vec![GoalTerm { relation: Relation::Near, anchor, holds: true }] };
        let (query, goal) = known.translated(1, &wish(1, 2)).expect("both are there");
        assert_eq!((query, goal[0].anchor), (2, 1));
        let lost = known.translated(1, &wish(3, 2)).expect_err("it is hidden");
        assert_eq!(lost.error().and_then(|e| e.field.clone()).as_deref(), Some("step[1].query"));
        let unknown = known.translated(0, &wish(1, 9)).expect_err("there never was one");
        assert_eq!(unknown.error().and_then(|e| e.field.clone()).as_deref(), Some("step[0].goal[0].anchor"));
    }
}
