//! What goes over a viewer's WebSocket as JSON. The page's side is `page/js/connection.js`.

use std::collections::BTreeMap;
use std::sync::Arc;

use repose_proto::load::WorkerLoad;
use repose_proto::motion::{ExecutionOutcome, RecoveryMove};
use repose_proto::robot::{RobotState, StopState};
use repose_proto::{ArrangeRequest, ArrangeResult, CallError, PlaceRequest, PlaceResult, RigidTransform, Service};
use serde::{Deserialize, Serialize};

use crate::access::Role;
use crate::activity::Activity;
use crate::arm::{LinkPoses, PlanShown};
use crate::viewers::ViewerMessage;

/// A request of a viewer's; `id` comes back with its answer.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Request {
    /// Chosen by the viewer, different for each of its requests.
    pub id: u64,
    /// What is asked.
    #[serde(flatten)]
    pub ask: Ask,
}

/// What a viewer asks.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(tag = "ask", rename_all = "snake_case")]
pub enum Ask {
    /// Follow a cell, and one of its cameras; the first of them where none is named.
    Watch {
        /// The cell.
        cell: String,
        /// The camera.
        camera: Option<String>,
    },
    /// The last picture, or the last scene, has been drawn: the next may come. Has no answer.
    Seen {
        /// Which of the two.
        what: DrawnMessage,
    },
    /// A message, whichever came next, is here: asked by viewers of a paced socket of each. Has no answer.
    Received,
    /// Keep a scene that was shown: goals are about it until another is held.
    Hold {
        /// The scene's id.
        scene_id: String,
    },
    /// Look for an object where none was found.
    Segment {
        /// The scene whose picture was clicked.
        scene_id: String,
        /// The pixel, column and row.
        pixel: [usize; 2],
    },
    /// Where an object can go.
    Place {
        /// The request, as the planner takes it.
        request: Box<PlaceRequest>,
    },
    /// How the arm would carry it there.
    Plan {
        /// The scene's id.
        scene_id: String,
        /// The robot.
        robot: String,
        /// The object.
        query: u16,
        /// Where it may go, best first.
        placements: Vec<RigidTransform>,
        /// The source of every random number.
        #[serde(default)]
        seed: u64,
    },
    /// Carry out the plan that was shown to this viewer last.
    Execute {
        /// The plan's id.
        plan: String,
    },
    /// Forget a plan of this viewer's.
    Discard {
        /// The plan's id.
        plan: String,
    },
    /// Carry out several goals one after another.
    Sequence {
        /// The scene whose ids the goals use.
        scene_id: String,
        /// The robot.
        robot: String,
        /// The goals, as the planner takes them.
        goals: Vec<PlaceRequest>,
    },
    /// Which moves make several goals hold together.
    Arrange {
        /// The request, as the planner takes it.
        request: Box<ArrangeRequest>,
    },
    /// Bring several goals about together.
    BringAbout {
        /// The robot.
        robot: String,
        /// What is asked for; its ids are those of its scene.
        request: Box<ArrangeRequest>,
    },
    /// End the sequence or the arrangement that is under way, after what moves now.
    EndSequence,
    /// Clear a robot's stop.
    Reset {
        /// The robot.
        robot: String,
        /// The stop that the viewer was shown: another stays. Without it whichever is latched is cleared.
        #[serde(default)]
        stop: Option<StopState>,
    },
    /// Bring a robot's arm back after a stop.
    Recover {
        /// The robot.
        robot: String,
        /// What it does.
        #[serde(rename = "move")]
        motion: RecoveryMove,
        /// Whether the arm may move although its way is checked against no scene.
        #[serde(default)]
        unchecked: bool,
    },
    /// A new scene in a simulated cell.
    NewScene {
        /// Its seed.
        seed: u64,
    },
    /// Give up a request of this viewer's.
    Cancel {
        /// The request's id.
        request: u64,
    },
}

/// Which large message the viewer acknowledges as drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DrawnMessage {
    /// A camera's picture.
    Picture,
    /// A camera's scene.
    Scene,
}

impl Ask {
    /// The least role that may ask it.
    pub fn needs(&self) -> Role {
        match self {
            Self::Watch { .. } | Self::Seen { .. } | Self::Received | Self::Hold { .. } | Self::Cancel { .. } | Self::Discard { .. } => {
                Role::Viewer
            }
            Self::Segment { .. } | Self::Place { .. } | Self::Plan { .. } | Self::Arrange { .. } => Role::Planner,
            Self::Execute { .. }
            | Self::Sequence { .. }
            | Self::BringAbout { .. }
            | Self::EndSequence
            | Self::Reset { .. }
            | Self::Recover { .. }
            | Self::NewScene { .. } => Role::Operator,
        }
    }

    /// Whether a robot moves until it is answered. A sequence and an arrangement are answered when they begin.
    pub fn moves_until_answered(&self) -> bool {
        matches!(self, Self::Execute { .. } | Self::Recover { .. })
    }
}

/// A message to a viewer.
#[derive(Debug, Clone, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum ServerMessage {
    /// First of all.
    Welcome {
        /// Of the console.
        version: &'static str,
        /// Of its page: a page of another hash is out of date.
        page: String,
        /// What this viewer may do.
        role: Role,
        /// The cell of the console's configuration.
        cell: String,
    },
    /// A viewer's cell is another: what it was told of one before is out of date, and what comes after this is of this one.
    Watching {
        /// The cell.
        cell: String,
    },
    /// The cells with anybody alive in them.
    Cells {
        /// Their names.
        cells: Vec<String>,
    },
    /// A cell's parts.
    System(SystemShown),
    /// A robot.
    Robot(Box<RobotShown>),
    /// What is being carried out in the cell, or was last.
    Activity(Box<Activity>),
    /// A motion that somebody planned in the cell; none once it has begun or is out of date.
    Plan {
        /// The plan.
        shown: Option<Arc<PlanShown>>,
    },
    /// How far a request is.
    Progress {
        /// The request's id.
        id: u64,
        /// What its worker says.
        progress: serde_json::Value,
    },
    /// The result of a request.
    Answer {
        /// The request's id.
        id: u64,
        /// The result.
        result: Box<Answered>,
    },
    /// Why a request has no result.
    Refused {
        /// The request's id; 0 where it could not be read.
        id: u64,
        /// The contract's error.
        error: CallError,
    },
}

impl ServerMessage {
    /// The message, encoded.
    pub fn encode(&self) -> ViewerMessage {
        ViewerMessage::Text(serde_json::to_string(self).unwrap_or_else(|e| format!(r#"{{"kind":"fault","message":"{e}"}}"#)).into())
    }
}

/// The result of a request.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Answered {
    /// It was done, and there is nothing to say.
    Done {},
    /// A placement's answer.
    Placed {
        /// The planner's result.
        placed: Box<PlaceResult>,
        /// Its worker.
        worker: String,
        /// Milliseconds by stage, as the worker counted them.
        timing_ms: BTreeMap<String, f64>,
        /// Milliseconds from the request's arrival here to its answer.
        took_ms: f64,
    },
    /// The moves after which several goals hold.
    Arranged {
        /// The planner's result.
        arranged: Box<ArrangeResult>,
        /// Its worker.
        worker: String,
        /// Milliseconds from the request's arrival here to its answer.
        took_ms: f64,
    },
    /// A motion plan.
    Planned {
        /// The plan's id.
        plan: String,
    },
    /// How an execution ended.
    Executed {
        /// How.
        outcome: ExecutionOutcome,
        /// Why, when not done.
        #[serde(skip_serializing_if = "Option::is_none")]
        reason: Option<String>,
    },
    /// How bringing an arm back ended.
    Recovered {
        /// How.
        outcome: ExecutionOutcome,
        /// Why, when not done.
        #[serde(skip_serializing_if = "Option::is_none")]
        reason: Option<String>,
        /// The scene that the arm's way was checked against; none where it was checked against the robot itself and the zones only.
        checked_against: Option<String>,
        /// The camera that is watched: the scene is of it.
        camera: String,
    },
    /// Whether a stop was cleared.
    Cleared {
        /// Whether there was one.
        was_stopped: bool,
    },
}

/// A cell's parts.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SystemShown {
    /// The cell.
    pub cell: String,
    /// Every worker alive.
    pub workers: Vec<WorkerShown>,
    /// Every camera that scenes come from.
    pub cameras: Vec<CameraShown>,
    /// Every robot that tells its state.
    pub robots: Vec<String>,
}

/// A worker.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WorkerShown {
    /// Its service.
    pub service: Service,
    /// Its name.
    pub name: String,
    /// Its newest load.
    pub load: Option<WorkerLoad>,
    /// How long it has been silent, milliseconds.
    pub silent_ms: f64,
}

/// A camera.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CameraShown {
    /// Its name.
    pub name: String,
    /// Scenes per second, smoothed.
    pub scenes_per_s: f64,
    /// How old its newest scene is, milliseconds.
    pub age_ms: f64,
}

/// A robot's state, and where its links are.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RobotShown {
    /// Its name.
    pub robot: String,
    /// What it says of itself.
    pub state: RobotState,
    /// Its links; none where a number of its state is one that no robot can have.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub links: Option<LinkPoses>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_request_is_read_with_its_id_and_an_unknown_one_is_refused() {
        let read = |text: &str| repose_proto::message::from_json::<Request>(text.as_bytes());
        let watch = read(r#"{"id": 3, "ask": "watch", "cell": "lab", "camera": null}"#).expect("a request");
        assert_eq!(watch, Request { id: 3, ask: Ask::Watch { cell: "lab".to_owned(), camera: None } });
        assert_eq!(watch.ask.needs(), Role::Viewer);
        assert_eq!(read(r#"{"id": 4, "ask": "reset", "robot": "panda"}"#).expect("a request").ask.needs(), Role::Operator);
        assert!(read(r#"{"id": 5, "ask": "dance"}"#).is_err_and(|e| e.message.contains("dance")));
    }

    #[test]
    fn an_error_is_told_with_its_field() {
        let told = ServerMessage::Refused { id: 9, error: CallError::invalid("goal[0].anchor", "no object 7") };
        let ViewerMessage::Text(text) = told.encode() else { panic!("expected JSON") };
        let value: serde_json::Value = serde_json::from_str(&text).expect("JSON");
        assert_eq!((&value["kind"], &value["id"], &value["error"]["field"]), (&"refused".into(), &9.into(), &"goal[0].anchor".into()));
    }
}
