//! What Foxglove's viewers, Lichtblick and Rerun draw of a recording: Foxglove's messages in Protocol Buffers, which all of them know, made of
//! those of the wire.

mod camera;
mod message;
mod robot;
mod scene;
mod types;

use std::collections::BTreeMap;

use repose_proto::robot::RobotState;
use repose_proto::{CallError, Frame, PlaceResult, Scene};

pub use message::VisualMessage;

/// Makes what is looked at of what is heard. Remembers what a message alone does not tell.
#[derive(Debug, Default)]
pub struct Looker {
    /// The box around each object of the newest scenes, by scene and object: what a placement moves.
    boxes: scene::Boxes,
    /// When each robot was drawn last, nanoseconds since the Unix epoch, and the stop that it showed.
    robots: BTreeMap<String, robot::DrawnRobot>,
}

impl Looker {
    /// A camera's picture and calibration.
    ///
    /// # Errors
    /// `internal` when the picture cannot be encoded.
    pub fn frame(&self, frame: &Frame) -> Result<Vec<VisualMessage>, CallError> {
        camera::looks(frame)
    }

    /// A scene's cloud and its objects.
    pub fn scene(&mut self, scene_id: &str, scene: &Scene) -> Vec<VisualMessage> {
        self.boxes.looks(scene_id, scene)
    }

    /// A robot's joints, links and body, as often as they are worth drawing; and its stop when it begins or ends.
    pub fn robot(&mut self, name: &str, state: &RobotState) -> Vec<VisualMessage> {
        robot::looks(name, state, self.robots.entry(name.to_owned()).or_default())
    }

    /// The placements of an answer, as ghosts of the object's box.
    pub fn placements(&self, result: &PlaceResult, at_ns: u64) -> Option<VisualMessage> {
        self.boxes.ghosts(result, at_ns)
    }
}
