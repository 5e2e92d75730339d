//! What crosses the wire between Repose's services, robots and clients, and nothing else.
//!
//! ```
//! use repose_proto::{GoalTerm, Payload, PlaceRequest};
//!
//! let goal: Vec<GoalTerm> = vec!["left_of:2".parse()?, "not:near:3".parse()?];
//! let request = PlaceRequest::new("0".repeat(64), 1, goal);
//! let payload = Payload::json(&request)?;
//! assert_eq!(payload.encoding, "application/json;repose.PlaceRequest.v1");
//! assert_eq!(payload.decode_json::<PlaceRequest>()?, request);
//! # Ok::<(), repose_proto::CallError>(())
//! ```
//!
//! Plain data with its validation and encoding: messages (JSON), the bulk form (safetensors) for clouds and images, the
//! attachments of calls and replies, errors, and every key. No behaviour beyond that, and no dependency on anything of ours.
//! The promises behind these types are the project's contract, version 1; [`glossary`] has the words, [`frames`] the
//! coordinate frames.
//!
//! ```
//! use repose_proto::{Cell, ErrorCode, Payload, PlaceRequest, Service};
//!
//! // A request as it goes to the key of one worker.
//! let request = PlaceRequest::new("0".repeat(64), 2, vec!["left_of:3".parse()?]);
//! let payload = Payload::json(&request)?;
//! assert_eq!(payload.schema(), "PlaceRequest.v1");
//! assert_eq!(payload.decode_json::<PlaceRequest>()?, request);
//! assert_eq!(Cell::new("lab")?.call(Service::Planner, "p-1"), "repose/v1/lab/service/planner/p-1/call");
//!
//! // What cannot be is refused, with the field at fault.
//! let wrong = Payload { bytes: String::from_utf8_lossy(&payload.bytes).replace("left_of", "beside").into(), ..payload };
//! let error = wrong.decode_json::<PlaceRequest>().unwrap_err();
//! assert_eq!((error.code, error.field.as_deref()), (ErrorCode::InvalidArgument, Some("goal[0].relation")));
//! # Ok::<(), repose_proto::CallError>(())
//! ```

pub mod arrange;
pub mod bulk;
pub mod checks;
pub mod enclosed;
pub mod envelope;
pub mod error;
pub mod followed_robots;
pub mod frame;
pub mod frames;
pub mod glossary;
pub mod journal;
pub mod keys;
pub mod limits;
pub mod load;
pub mod message;
pub mod motion;
pub mod packed;
pub mod perception;
pub mod place;
pub mod relation;
pub mod robot;
pub mod scene;
pub mod schemas;
pub mod scoring;
pub mod simulator;

pub use arrange::{ArrangeRequest, ArrangeResult};
pub use bulk::{Bulk, Tensor};
pub use envelope::{CallAttachment, Priority, ReplyAttachment, ReplyKind};
pub use error::{CallError, ErrorCode};
pub use frame::{CameraModel, Frame, RobotInView, SegmentHints};
pub use frames::RigidTransform;
pub use journal::{JournalEntry, JournalKind};
pub use keys::{Cell, Service};
pub use message::{Message, Payload};
pub use place::{PlaceRequest, PlaceResult};
pub use relation::{GoalTerm, RELATION_COUNT, Relation};
pub use scene::{
    LeftOut, LeftOutReason, ObjectSummary, Scene, SceneMeta, SceneRef, SceneSummary, SceneWarning, Surface, Unseen, UnseenSpace,
};
