//! The tools: their names, what an agent reads of them, and how a call of one is carried out and logged.

use std::time::Instant;

use repose_proto::{CallError, ErrorCode, message};
use repose_runtime::CancellationToken;
use schemars::{JsonSchema, schema_for};
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};

use crate::answer::ToolResult;
use crate::arguments::{ExecuteArguments, LookArguments, PlanArguments, StateArguments, StopArguments};
use crate::asker::Asker;
use crate::desk::Desk;
use crate::execute::Executed;
use crate::look::Looked;
use crate::plan::PlanOutput;
use crate::robot::RobotTold;

/// What every agent is told first.
pub const INSTRUCTIONS: &str = "A robot cell in which one object at a time is put somewhere by its relations to others. `look` shows the objects \
with numbers; `plan` finds where an object can stand and shows it; `execute`, where it is offered, has the robot carry a plan out: show the \
plan's picture to a person before you ask for that. Look again after anything has moved: numbers are of one scene. `stop` stops the robot at \
once, always; only a person lets it go on.";

/// Longest arguments that a log line repeats, characters.
const LOGGED: usize = 300;

/// A tool.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Tool {
    /// The newest view.
    Look,
    /// Where an object can go.
    Plan,
    /// Carries a plan out.
    Execute,
    /// What the robot does.
    State,
    /// Stops the robot.
    Stop,
}

impl Tool {
    /// Every tool.
    pub const ALL: [Self; 5] = [Self::Look, Self::Plan, Self::Execute, Self::State, Self::Stop];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Look => "look",
            Self::Plan => "plan",
            Self::Execute => "execute",
            Self::State => "state",
            Self::Stop => "stop",
        }
    }

    /// The tool of a name.
    pub fn parse(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|tool| tool.name() == name)
    }

    /// What it does, for an agent.
    pub fn description(self) -> &'static str {
        match self {
            Self::Look => {
                "The camera's newest view: a picture with every object outlined and numbered, and of each object its color, shape, size, place \
                 and relations to the others. Numbers are of this scene only; `plan` takes them with the scene's name."
            }
            Self::Plan => {
                "Where an object can be set down so that the asked relations hold and it stays. Answers with a plan's id, a picture with the object \
                 drawn in green where it is to stand, and the evidence; or with what stands in the way. Nothing moves. Objects are named by number \
                 (with `scene`) or by what they look like; what may mean several objects is refused, and they are named. Directions are the camera's."
            }
            Self::Execute => {
                "Has the robot carry out a plan that `plan` made in this session. Refused when anything in the scene has moved since, and while \
                 another motion is under way. Answers when the motion has ended: how, and from a fresh view whether the asked relations hold and \
                 whether anything else has moved, fallen or is gone. A plan is carried out once."
            }
            Self::State => "What the robot does and holds, whether it is stopped and why, and whether plans may be carried out.",
            Self::Stop => {
                "Stops the robot at once, also while it carries a plan out. The stop stays until a person clears it. Answers when the robot's state \
                 shows the stop."
            }
        }
    }

    /// The schema of what it takes.
    pub fn input(self) -> Map<String, Value> {
        match self {
            Self::Look => schema::<LookArguments>(),
            Self::Plan => schema::<PlanArguments>(),
            Self::Execute => schema::<ExecuteArguments>(),
            Self::State => schema::<StateArguments>(),
            Self::Stop => schema::<StopArguments>(),
        }
    }

    /// The schema of what it answers beside text and picture.
    pub fn output(self) -> Map<String, Value> {
        match self {
            Self::Look => schema::<Looked>(),
            Self::Plan => schema::<PlanOutput>(),
            Self::Execute => schema::<Executed>(),
            Self::State | Self::Stop => schema::<RobotTold>(),
        }
    }

    /// Whether it leaves everything as it is.
    pub fn only_reads(self) -> bool {
        matches!(self, Self::Look | Self::Plan | Self::State)
    }

    /// Whether a server offers it.
    pub fn is_offered(self, allow_execute: bool) -> bool {
        self != Self::Execute || allow_execute
    }
}

fn schema<T: JsonSchema>() -> Map<String, Value> {
    match schema_for!(T).to_value() {
        Value::Object(schema) => schema,
        _ => Map::new(),
    }
}

/// Calls a tool by name, and logs who asked for what and how it ended.
///
/// # Errors
/// `not_found` on `tool`; `invalid_argument` that names the argument; what the tool says.
pub async fn call(desk: &Desk, name: &str, arguments: Value, asker: &Asker, cancel: CancellationToken) -> Result<ToolResult, CallError> {
    let started = Instant::now();
    let (client, session) = (asker.client.as_str(), asker.session.as_str());
    let asked: String = arguments.to_string().chars().take(LOGGED).collect();
    let tool = Tool::parse(name);
    if tool.is_some_and(|tool| !tool.only_reads()) {
        // Said before it is done: a log that ends here says what was under way.
        tracing::info!(client, session, tool = name, arguments = asked, "asked");
    }
    let ended = match tool {
        Some(tool) => carry_out(desk, tool, arguments, asker, cancel).await,
        None => Err(unknown(name)),
    };
    let ms = started.elapsed().as_millis() as u64;
    match &ended {
        Ok(_) => tracing::info!(client, session, tool = name, arguments = asked, ms, "answered"),
        Err(error) => tracing::warn!(client, session, tool = name, arguments = asked, ms, %error, "refused"),
    }
    ended
}

async fn carry_out(desk: &Desk, tool: Tool, given: Value, asker: &Asker, cancel: CancellationToken) -> Result<ToolResult, CallError> {
    match tool {
        Tool::Look => unless_given_up(&cancel, desk.look(&read(given)?, asker)).await,
        Tool::Plan => unless_given_up(&cancel, desk.plan(&read(given)?, asker)).await,
        Tool::Execute => desk.execute(&read(given)?, asker, cancel).await,
        Tool::State => unless_given_up(&cancel, desk.state(&read::<StateArguments>(given)?)).await,
        Tool::Stop => desk.stop(&read(given)?, asker).await,
    }
}

/// Does what only reads, until it is given up: a call that is dropped is cancelled at its worker, too.
async fn unless_given_up<T>(cancel: &CancellationToken, asking: impl Future<Output = Result<T, CallError>>) -> Result<T, CallError> {
    let given_up = || Err(CallError::new(ErrorCode::Cancelled, "given up by who asked"));
    cancel.run_until_cancelled(asking).await.unwrap_or_else(given_up)
}

/// Arguments, with errors that name the field at fault.
fn read<T: DeserializeOwned>(given: Value) -> Result<T, CallError> {
    let given = if given.is_null() { Value::Object(Map::new()) } else { given };
    message::from_json(given.to_string().as_bytes())
}

fn unknown(name: &str) -> CallError {
    let names = Tool::ALL.map(Tool::name).join(", ");
    CallError::new(ErrorCode::NotFound, format!("there is no tool {name:?}; the tools are {names}")).at("tool")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arguments::Named;

    #[test]
    fn every_tool_has_a_name_of_its_own_and_object_schemas() {
        for tool in Tool::ALL {
            assert_eq!(Tool::parse(tool.name()), Some(tool));
            assert_eq!((&tool.input()["type"], &tool.output()["type"]), (&"object".into(), &"object".into()), "{}", tool.name());
        }
        assert!(Tool::ALL.iter().all(|tool| tool.is_offered(true)) && !Tool::Execute.is_offered(false) && Tool::Stop.is_offered(false));
    }

    #[test]
    fn arguments_are_typed_and_no_joint_or_pose_is_among_them() {
        let plan: PlanArguments =
            read(serde_json::json!({"scene": "ab", "move": 3, "goal": [{"relation": "left_of", "to": "the box"}]})).expect("arguments");
        assert_eq!((plan.object, plan.goal[0].to.clone()), (Some(Named::Number(3)), Named::Description("the box".to_owned())));
        let refused = |given: Value| read::<PlanArguments>(given).expect_err("refused");
        let error = refused(serde_json::json!({"move": 3, "goal": [{"relation": "beside", "to": 2}]}));
        assert_eq!((error.code, error.field.as_deref()), (ErrorCode::InvalidArgument, Some("goal[0].relation")));
        assert_eq!(refused(serde_json::json!({"joints": [0, 0, 0]})).code, ErrorCode::InvalidArgument);
        assert!(read::<ExecuteArguments>(serde_json::json!({"plan": "p", "q_rad": [0.0]})).is_err());
        assert!(read::<LookArguments>(Value::Null).is_ok(), "no arguments are no arguments");
    }
}
