//! Every key of the key space: `repose/v1/{cell}/…`. Nothing else spells one.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::CallError;

/// The longest chunk of a key.
const MAX_CHUNK: usize = 64;

/// A kind of service.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Service {
    /// Frames in, segmented scenes out.
    Perception,
    /// Batched scoring of candidates.
    Inference,
    /// Search over placements.
    Planner,
    /// Motion plans and their execution.
    Motion,
    /// The stand-in world.
    Simulator,
}

impl Service {
    /// All services.
    pub const ALL: [Self; 5] = [Self::Perception, Self::Inference, Self::Planner, Self::Motion, Self::Simulator];

    /// The service's chunk in keys, and its name on the command line.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Perception => "perception",
            Self::Inference => "inference",
            Self::Planner => "planner",
            Self::Motion => "motion",
            Self::Simulator => "simulator",
        }
    }

    /// The methods that its workers answer.
    pub fn methods(self) -> &'static [&'static str] {
        match self {
            Self::Perception => &["segment", "latest", "scene"],
            Self::Inference => &["prior", "score", "models", "forecasts"],
            Self::Planner => &["place", "arrange"],
            Self::Motion => &["plan", "execute", "reset", "recover"],
            Self::Simulator => &["reset", "truth"],
        }
    }

    /// Whether a method moves a robot, lets it move again, or changes the world: what only operators may call. Such calls go to
    /// [`Cell::operate`].
    pub fn operates(self, method: &str) -> bool {
        match self {
            Self::Motion => ["execute", "reset", "recover"].contains(&method),
            Self::Simulator => method == "reset",
            Self::Perception | Self::Inference | Self::Planner => false,
        }
    }

    /// Whether copies of a method's calls are made for whoever records. Not of those that only fetch what is held: a recorder fetches scenes too.
    pub fn journals(self, method: &str) -> bool {
        !(self == Self::Perception && ["scene", "latest"].contains(&method))
    }

    /// Whether its workers may serve several cells as a pool: what they hold of one is found again by its content, and they move nothing.
    pub fn is_poolable(self) -> bool {
        matches!(self, Self::Inference | Self::Planner)
    }

    /// Whether the service has such methods.
    pub fn has_operations(self) -> bool {
        matches!(self, Self::Motion | Self::Simulator)
    }

    /// The service of that name.
    pub fn parse(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|s| s.as_str() == name)
    }
}

impl std::fmt::Display for Service {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.as_str())
    }
}

/// Checks a name that becomes a chunk of a key: `[a-z0-9][a-z0-9_-]{0,63}`.
///
/// # Errors
/// `invalid_argument` that names `field`.
pub fn validate_chunk(field: &str, chunk: &str) -> Result<(), CallError> {
    let alphanumeric = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit();
    let good =
        chunk.len() <= MAX_CHUNK && chunk.starts_with(alphanumeric) && chunk.chars().all(|c| alphanumeric(c) || c == '_' || c == '-');
    if good { Ok(()) } else { Err(CallError::invalid(field, format!("{chunk:?} is not of the form [a-z0-9][a-z0-9_-]{{0,63}}"))) }
}

/// One robot cell's part of the key space. Every builder takes chunks that [`validate_chunk`] accepts.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Cell(String);

impl Cell {
    /// The cell of that name.
    ///
    /// # Errors
    /// `invalid_argument` on `cell` when the name is no chunk.
    pub fn new(name: &str) -> Result<Self, CallError> {
        validate_chunk("cell", name)?;
        Ok(Self(format!("repose/v1/{name}")))
    }

    /// Every cell at once: for rules about keys, and for no message.
    pub fn every() -> Self {
        Self("repose/v1/*".to_owned())
    }

    /// The cell's name.
    pub fn name(&self) -> &str {
        last_chunk(&self.0)
    }

    /// Put: a frame (bulk form).
    pub fn camera_frame(&self, camera: &str) -> String {
        format!("{}/camera/{camera}/frame", self.0)
    }

    /// Every camera's frames.
    pub fn camera_frames(&self) -> String {
        self.camera_frame("*")
    }

    /// Put: JSON summary of the newest scene, by the one perception worker that owns the camera.
    pub fn scene(&self, camera: &str) -> String {
        format!("{}/scene/{camera}", self.0)
    }

    /// The summaries of every camera's newest scene.
    pub fn scenes(&self) -> String {
        self.scene("*")
    }

    /// The states of every robot.
    pub fn robot_states(&self) -> String {
        self.robot_state("*")
    }

    /// Put: joint and gripper state, stop state, owner.
    pub fn robot_state(&self, robot: &str) -> String {
        format!("{}/robot/{robot}/state", self.0)
    }

    /// Put: timed set-points.
    pub fn robot_command(&self, robot: &str) -> String {
        format!("{}/robot/{robot}/command", self.0)
    }

    /// Put: an emergency stop, latched by the robot's side.
    pub fn robot_estop(&self, robot: &str) -> String {
        format!("{}/robot/{robot}/@estop", self.0)
    }

    /// Query: a call to one worker.
    pub fn call(&self, service: Service, worker: &str) -> String {
        format!("{}/service/{service}/{worker}/call", self.0)
    }

    /// Query: a call to one worker of this pool for another cell. A key of its own for each, because access control sees keys: a cell's users call
    /// for their own cell only.
    pub fn call_for(&self, service: Service, worker: &str, cell: &str) -> String {
        format!("{}/service/{service}/{worker}/call/{cell}", self.0)
    }

    /// Every call to one worker of this pool for another cell.
    pub fn calls_for_others(&self, service: Service, worker: &str) -> String {
        self.call_for(service, worker, "*")
    }

    /// Query: a call to one worker of a method that moves a robot or changes the world ([`Service::operates`]). A key of its own, because
    /// access control sees keys and not methods.
    pub fn operate(&self, service: Service, worker: &str) -> String {
        format!("{}/service/{service}/{worker}/operate", self.0)
    }

    /// Put: cancel of one request at one worker.
    pub fn cancel(&self, service: Service, worker: &str, request: &str) -> String {
        format!("{}/service/{service}/{worker}/@cancel/{request}", self.0)
    }

    /// Put while somebody records: copies of a worker's calls and replies ([`crate::JournalEntry`]).
    pub fn journal(&self, service: Service, worker: &str) -> String {
        format!("{}/service/{service}/{worker}/journal", self.0)
    }

    /// The journals of every worker of every service.
    pub fn journals(&self) -> String {
        format!("{}/service/*/*/journal", self.0)
    }

    /// Every cancel at one worker.
    pub fn cancels(&self, service: Service, worker: &str) -> String {
        self.cancel(service, worker, "*")
    }

    /// Put, 5 to 10 Hz: a worker's load.
    pub fn load(&self, service: Service, worker: &str) -> String {
        format!("{}/service/{service}/{worker}/load", self.0)
    }

    /// The loads of every worker of a service.
    pub fn loads(&self, service: Service) -> String {
        self.load(service, "*")
    }

    /// The loads of every worker of every service.
    pub fn all_loads(&self) -> String {
        format!("{}/service/*/*/load", self.0)
    }

    /// The liveliness tokens of every worker of every service.
    pub fn all_lives(&self) -> String {
        format!("{}/live/*/*", self.0)
    }

    /// Liveliness token of a worker.
    pub fn live(&self, service: Service, worker: &str) -> String {
        format!("{}/live/{service}/{worker}", self.0)
    }

    /// Liveliness token of the client that waits for a request: what moves a robot on its behalf ends with it.
    pub fn live_client(&self, request: &str) -> String {
        format!("{}/live/client/{request}", self.0)
    }

    /// Liveliness token of somebody who records the cell: workers put copies of their calls on their journals while there is one.
    pub fn live_recorder(&self, recorder: &str) -> String {
        format!("{}/live/recorder/{recorder}", self.0)
    }

    /// The emergency stops of every robot.
    pub fn robot_estops(&self) -> String {
        self.robot_estop("*")
    }

    /// The liveliness tokens of every worker of a service.
    pub fn lives(&self, service: Service) -> String {
        self.live(service, "*")
    }
}

/// The liveliness tokens of every worker in every cell.
pub const LIVES_EVERYWHERE: &str = "repose/v1/*/live/*/*";

/// The liveliness tokens of every worker of a service in every cell.
pub fn lives_everywhere(service: Service) -> String {
    Cell::every().lives(service)
}

/// Cell, service and worker of a liveliness token.
pub fn of_live(key: &str) -> Option<(&str, Service, &str)> {
    let mut chunks = key.strip_prefix("repose/v1/")?.split('/');
    let (cell, live, service, worker) = (chunks.next()?, chunks.next()?, chunks.next()?, chunks.next()?);
    Some((cell, Service::parse(service).filter(|_| live == "live")?, worker))
}

/// The cell that a key is in.
pub fn cell_of(key: &str) -> Option<&str> {
    key.strip_prefix("repose/v1/")?.split('/').next()
}

/// Service and worker of a `load` key.
pub fn of_load(key: &str) -> Option<(Service, &str)> {
    of_worker(key, "load")
}

/// Service and worker of a `journal` key.
pub fn of_journal(key: &str) -> Option<(Service, &str)> {
    of_worker(key, "journal")
}

fn of_worker<'a>(key: &'a str, last: &str) -> Option<(Service, &'a str)> {
    let mut chunks = key.rsplit('/');
    let (found, worker, service) = (chunks.next()?, chunks.next()?, chunks.next()?);
    Some((Service::parse(service).filter(|_| found == last)?, worker))
}

/// The last chunk of a key: the worker of a `live` key, the request of a `@cancel` key, the cell that a call to a pool is for.
pub fn last_chunk(key: &str) -> &str {
    key.rsplit('/').next().unwrap_or(key)
}

/// The worker of a `load` or `call` key, the robot of a `state` key: the chunk before the last.
pub fn worker_of(key: &str) -> Option<&str> {
    key.rsplit('/').nth(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_read_as_they_are_spelt() {
        let cell = Cell::new("lab").expect("a cell");
        assert_eq!(cell.name(), "lab");
        assert_eq!(of_live(&cell.live(Service::Planner, "p-1")), Some(("lab", Service::Planner, "p-1")));
        assert_eq!(of_load(&cell.load(Service::Motion, "m-1")), Some((Service::Motion, "m-1")));
        assert_eq!((cell_of(&cell.load(Service::Motion, "m-1")), cell_of("other/v1/lab/live")), (Some("lab"), None));
        assert_eq!(of_journal(&cell.journal(Service::Planner, "p-1")), Some((Service::Planner, "p-1")));
        assert_eq!(last_chunk(&cell.call_for(Service::Planner, "p-1", "line-1")), "line-1");
        assert_eq!(worker_of(&cell.robot_state("panda")), Some("panda"));
        assert_eq!(last_chunk(&cell.scene("front")), "front");
        assert_eq!((of_live(&cell.scene("front")), of_load(&cell.robot_state("panda"))), (None, None));
    }
}
