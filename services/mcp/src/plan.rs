//! `plan`: from numbers or words to a place that can be carried out, drawn and with its evidence; or to what stands in the way.

use std::collections::BTreeMap;
use std::sync::Arc;

use nalgebra::Isometry3;
use repose_geometry::transform::from_row_major;
use repose_pictures::jpeg_of;
use repose_pictures::scene::with_placement;
use repose_proto::motion::{MotionPlan, MotionPlanRequest};
use repose_proto::place::{Placement, Rotation};
use repose_proto::robot::RobotState;
use repose_proto::{CallError, ErrorCode, GoalTerm, Message, PlaceRequest, PlaceResult};
use repose_runtime::{CallOptions, reaching_robot};
use repose_sentences::placement::{center_of, describe, merits, motion, relaxation, tally};
use repose_words::{ObjectAppearance, Reason, RefusedSentence, find, looks_of, names_by_number, understand};
use schemars::JsonSchema;
use serde::Serialize;
use tokio::time::Instant;

use crate::answer::ToolResult;
use crate::arguments::{Named, PlanArguments};
use crate::asker::Asker;
use crate::desk::{Desk, computed};
use crate::look::QUALITY;
use crate::plans::Plan;
use crate::seen::ShownScene;

/// Placements that motion may choose from.
const COUNT: u32 = 5;

/// What `plan` answers beside the picture.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "Planned")]
pub struct PlanOutput {
    /// The plan, for `execute`; none where there is no place, or the arm cannot serve one.
    pub plan: Option<String>,
    /// The scene that it was made on.
    pub scene: String,
    /// The object that was meant to move, by its number in the scene.
    #[serde(rename = "move")]
    pub query: u16,
    /// What was asked to hold, numbers of the scene: `left_of:2`, `not:near:3`.
    pub goal: Vec<String>,
    /// How words were taken: each phrase with the numbers of its objects, several of "the books".
    pub understood: PhraseObjects,
    /// How the object is moved.
    pub motion: Option<String>,
    /// The probability that it succeeds in every respect; none where nobody evaluated it.
    pub success: Option<f64>,
    /// What speaks for the place.
    pub evidence: Option<String>,
    /// How long the arm takes, seconds; none where no arm was asked.
    pub seconds: Option<f64>,
    /// Why there is no plan, why no arm was asked, or what the arm's way ignores.
    pub reasons: Vec<String>,
}

/// Phrases, each with the numbers of its objects.
type PhraseObjects = BTreeMap<String, Vec<u16>>;

/// What is wished for on a scene.
struct Wish {
    query: u16,
    goal: Vec<GoalTerm>,
    understood: PhraseObjects,
}

/// What the arm says of ranked placements.
enum Arm {
    /// How it would carry one of them out.
    Can(Box<MotionPlan>),
    /// Why it cannot.
    Cannot(String),
    /// Nobody could be asked.
    Unasked(String),
}

impl Desk {
    /// Finds a place.
    ///
    /// # Errors
    /// `invalid_argument` and `not_found` that name the argument, with the objects in question where words are not clear; what the cell says.
    pub async fn plan(&self, asked: &PlanArguments, asker: &Asker) -> Result<ToolResult, CallError> {
        let deadline = self.deadline();
        let seen = match &asked.scene {
            Some(handle) => self.shown(handle, &asker.session)?,
            None => self.newest(&asker.session, deadline).await?,
        };
        let wish = {
            let (seen, asked) = (seen.clone(), asked.clone());
            computed(move || wish_of(&asked, &seen)).await?
        };
        // A place is found without a robot, too: what is waited for it leaves as much time for that.
        let halfway = Instant::now() + deadline.saturating_duration_since(Instant::now()) / 2;
        let state = self.robot_state(halfway).await;
        let request = self.request(asked, &seen, &wish, state.as_ref().ok());
        request.validate()?;
        let (result, _) = self.planner.place(&request, Some(&seen.scene), CallOptions::default().until(deadline)).await?;
        let arm = match (&state, result.placements.is_empty()) {
            (_, true) => None,
            (Err(error), false) => Some(Arm::Unasked(error.message.clone())),
            (Ok(state), false) => Some(self.arm(&request, &result, &seen, state, CallOptions::default().until(deadline)).await?),
        };
        let (planned, plan) = judged(&wish, &seen, &result, arm, &request, asker);
        self.answer(planned, plan, &result, &seen).await
    }

    fn request(&self, asked: &PlanArguments, seen: &ShownScene, wish: &Wish, state: Option<&RobotState>) -> PlaceRequest {
        PlaceRequest {
            count: COUNT,
            rotation: if asked.may_turn { Rotation::Yaw } else { Rotation::Fixed },
            min_success: asked.min_success,
            seed: asked.seed,
            robot: state.and_then(|state| reaching_robot(&self.settings().robot, state)),
            ..PlaceRequest::new(seen.scene_id.clone(), wish.query, wish.goal.clone())
        }
    }

    /// Asks motion for the way of the best placement that the arm can serve.
    async fn arm(
        &self,
        request: &PlaceRequest,
        result: &PlaceResult,
        seen: &ShownScene,
        state: &RobotState,
        options: CallOptions,
    ) -> Result<Arm, CallError> {
        let placements = result.placements.iter().map(|p| p.placed_from_observed).collect();
        let robot = self.settings().robot.clone();
        let request = MotionPlanRequest {
            seed: request.seed,
            ..MotionPlanRequest::new(seen.scene_id.clone(), robot, request.query, placements, state.q_rad)
        };
        match self.motion.plan_motion(&request, Some(&seen.scene), options).await {
            Ok(plan) if plan.placement < result.placements.len() => Ok(Arm::Can(Box::new(plan))),
            Ok(_) => Err(CallError::internal("motion chose no placement of ours")),
            Err(error) if error.code == ErrorCode::FailedPrecondition => Ok(Arm::Cannot(error.message)),
            Err(error) if error.code == ErrorCode::Unavailable => Ok(Arm::Unasked(error.message)),
            Err(error) => Err(error),
        }
    }

    /// Keeps a plan, and draws what was found of it.
    async fn answer(
        &self,
        planned: PlanOutput,
        plan: Option<Plan>,
        result: &PlaceResult,
        seen: &Arc<ShownScene>,
    ) -> Result<ToolResult, CallError> {
        let shown = plan.as_ref().map(|plan| plan.placement.clone()).or_else(|| result.placements.first().cloned());
        let (seen, query) = (seen.clone(), planned.query);
        let picture = match shown {
            Some(placement) => Some(computed(move || drawn(&seen, query, &placement)).await?),
            None => None,
        };
        let text = sentences(&planned, result);
        if let Some(plan) = plan {
            self.plans().keep(plan);
        }
        ToolResult::new(text, &planned, picture)
    }
}

fn drawn(seen: &ShownScene, query: u16, placement: &Placement) -> Result<Vec<u8>, CallError> {
    jpeg_of(&with_placement(&seen.scene, query, &moved_by(placement)?), QUALITY)
}

/// A placement's motion of world space.
///
/// # Errors
/// `internal` when a planner answered something else.
pub fn moved_by(placement: &Placement) -> Result<Isometry3<f64>, CallError> {
    from_row_major(&placement.placed_from_observed.0).map_err(|e| CallError::internal(e.to_string()))
}

/// The wish that arguments make on a scene.
fn wish_of(asked: &PlanArguments, seen: &ShownScene) -> Result<Wish, CallError> {
    let looks = looks_of(&seen.scene, seen.scene.meta.view_yaw_rad);
    match (&asked.say, &asked.object) {
        (Some(_), Some(_)) => Err(CallError::invalid("say", "expected either a sentence, or `move` and `goal`")),
        (Some(_), None) if !asked.goal.is_empty() => Err(CallError::invalid("goal", "a sentence says the goal, too")),
        (None, None) => Err(CallError::invalid("move", "expected the object to move, or the wish as a sentence in `say`")),
        (Some(sentence), None) if asked.scene.is_none() && names_by_number(sentence) => Err(of_no_scene("say")),
        (Some(sentence), None) => {
            let meant = understand(sentence, &looks).map_err(|refused| unclear("say", &refused))?;
            let mut understood = PhraseObjects::new();
            for taken in meant.taken {
                let objects = understood.entry(taken.phrase).or_default();
                if !objects.contains(&taken.object) {
                    objects.push(taken.object);
                }
            }
            Ok(Wish { query: meant.query, goal: meant.goal, understood })
        }
        (None, Some(object)) => {
            let mut naming = Naming { looks: &looks, has_scene: asked.scene.is_some(), understood: PhraseObjects::new() };
            let query = naming.number("move", object)?;
            let term = |(k, term): (usize, &crate::arguments::Term)| {
                let anchor = naming.number(&format!("goal[{k}].to"), &term.to)?;
                Ok(GoalTerm { relation: term.relation, anchor, holds: !term.not })
            };
            let goal = asked.goal.iter().enumerate().map(term).collect::<Result<_, CallError>>()?;
            Ok(Wish { query, goal, understood: naming.understood })
        }
    }
}

/// Objects' numbers from what an agent calls them.
struct Naming<'a> {
    looks: &'a [ObjectAppearance],
    has_scene: bool,
    understood: PhraseObjects,
}

impl Naming<'_> {
    fn number(&mut self, field: &str, named: &Named) -> Result<u16, CallError> {
        match named {
            Named::Number(_) if !self.has_scene => Err(of_no_scene(field)),
            Named::Description(phrase) if !self.has_scene && names_by_number(phrase) => Err(of_no_scene(field)),
            Named::Number(number) if self.looks.iter().any(|look| look.id == *number) => Ok(*number),
            Named::Number(number) => Err(CallError::not_found(field, format!("the scene has no object {number}"))),
            Named::Description(phrase) => {
                let number = find(phrase, self.looks).map_err(|refused| unclear(field, &refused))?;
                self.understood.insert(phrase.clone(), vec![number]);
                Ok(number)
            }
        }
    }
}

/// The refusal of a number without its scene: the newest view may number its objects otherwise than the one that the agent has in mind.
fn of_no_scene(field: &str) -> CallError {
    CallError::invalid("scene", format!("{field} names an object by its number: say of which scene, as `look` called it"))
}

/// The refusal of words, with what an agent can do where they are about several objects.
fn unclear(field: &str, refused: &RefusedSentence) -> CallError {
    let way = match (&refused.reason, field) {
        (Reason::Plural { .. }, "move" | "say") => "; a plan moves one object: ask for a plan for each of them",
        (Reason::Plural { .. }, _) => "; give each of them a term of its own",
        (Reason::SeveralObjects { .. }, _) => "; say more of the one that is meant, or give its number with the scene's name",
        _ => "",
    };
    CallError::invalid(field, format!("{refused}{way}"))
}

/// What is said of an answer, and the plan that comes of it.
fn judged(
    wish: &Wish,
    seen: &Arc<ShownScene>,
    result: &PlaceResult,
    arm: Option<Arm>,
    request: &PlaceRequest,
    asker: &Asker,
) -> (PlanOutput, Option<Plan>) {
    let mut planned = PlanOutput {
        plan: None,
        scene: seen.handle().to_owned(),
        query: wish.query,
        goal: wish.goal.iter().map(ToString::to_string).collect(),
        understood: wish.understood.clone(),
        motion: None,
        success: None,
        evidence: None,
        seconds: None,
        reasons: Vec::new(),
    };
    let chosen = match arm {
        None => {
            planned.reasons = vec![format!("every candidate was rejected: {}", tally(&result.rejections))];
            planned.reasons.extend(relaxation(result));
            return (planned, None);
        }
        Some(Arm::Cannot(why)) => {
            planned.reasons = vec![format!("there are places, and the arm can serve none of them: {why}")];
            return (planned, None);
        }
        Some(Arm::Unasked(why)) => {
            planned.reasons = vec![format!("the arm was not asked: {why}")];
            &result.placements[0]
        }
        Some(Arm::Can(motion)) => {
            planned.seconds = Some((motion.duration_ms / 100.0).round() / 10.0);
            planned.reasons.extend(motion.ignored_in_words().map(str::to_owned));
            &result.placements[motion.placement]
        }
    };
    let id = uuid::Uuid::new_v4().to_string();
    planned.plan = Some(id.clone());
    planned.motion = Some(motion(chosen, center_of(&seen.scene.meta.objects, wish.query)));
    planned.success = chosen.success;
    planned.evidence = Some(merits(chosen, result));
    let (query, goal, view_yaw_rad) = (wish.query, wish.goal.clone(), result.view_yaw_rad);
    let session = asker.session.clone();
    let plan = Plan { id, seen: seen.clone(), query, goal, view_yaw_rad, placement: chosen.clone(), seed: request.seed, session };
    (planned, Some(plan))
}

fn sentences(planned: &PlanOutput, result: &PlaceResult) -> String {
    let taken = |(phrase, objects): (&String, &Vec<u16>)| match objects[..] {
        [object] => format!("{phrase:?} is object {object}"),
        _ => format!("{phrase:?} are objects {}", objects.iter().map(u16::to_string).collect::<Vec<_>>().join(" and ")),
    };
    let mut lines: Vec<String> = planned.understood.iter().map(taken).collect();
    match (&planned.plan, &planned.motion, &planned.evidence) {
        (Some(plan), Some(motion), Some(evidence)) => {
            lines.push(format!("plan {plan}: object {}, goal {}: {motion}", planned.query, planned.goal.join(" and ")));
            lines.push(format!("evidence: {evidence}"));
            lines.extend(planned.seconds.map(|seconds| format!("the arm takes {seconds} s")));
            lines.extend(planned.reasons.iter().cloned());
        }
        _ => {
            lines.push("no plan".to_owned());
            lines.extend(planned.reasons.iter().cloned());
            if result.placements.is_empty() {
                lines.extend(describe(result, None).lines().next().map(str::to_owned));
            }
        }
    }
    lines.join("\n")
}
