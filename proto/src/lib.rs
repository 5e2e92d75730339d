//! What crosses the wire between Repose's services, robots and clients, and nothing else.
//!
//! Plain data with its validation and encoding: messages (JSON), the bulk form (safetensors) for clouds and images, the
//! attachments of calls and replies, errors, and every key. No behaviour beyond that, and no dependency on anything of ours.
//! The promises behind these types are the project's contract, version 1; [`frames`] is the glossary of coordinate frames.

pub mod bulk;
pub mod envelope;
pub mod error;
pub mod frame;
pub mod frames;
pub mod keys;
pub mod limits;
pub mod load;
pub mod message;
pub mod motion;
pub mod perception;
pub mod place;
pub mod relation;
pub mod robot;
pub mod scene;
pub mod schemas;
pub mod scoring;
pub mod simulator;

pub use bulk::{Bulk, Tensor};
pub use envelope::{CallAttachment, Priority, ReplyAttachment, ReplyKind};
pub use error::{CallError, ErrorCode};
pub use frame::{CameraModel, Frame};
pub use frames::RigidTransform;
pub use keys::{Cell, Service};
pub use message::{Message, Payload};
pub use place::{PlaceRequest, PlaceResult};
pub use relation::{GoalTerm, RELATION_COUNT, Relation};
pub use scene::{ObjectSummary, Scene, SceneMeta, SceneRef, SceneSummary, Surface, Unseen, UnseenSpace};
