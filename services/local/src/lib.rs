//! Everything on one frame in this process, without a running system: what commands on frame folders and the Python package call.
//!
//! A frame becomes a scene ([`scene_of`]); on a scene one can plan a placement ([`plan()`]), judge relations ([`relations()`]) and
//! placements ([`score()`]), plan the motion ([`plan_motion`]) and draw ([`picture`]). The same messages go in and out as over the
//! network, and the services' settings are read from the environment as they read them, so the answers are the services' own, byte for byte.
//! [`LocalModels`] holds the networks; loading them takes a while, so keep it.

pub mod configured;
pub mod models;
pub mod motion;
pub mod picture;
pub mod plan;
pub mod relations;
pub mod score;
pub mod wireframe;

use repose_perception::segment;
use repose_proto::{CallError, Frame, Scene};

pub use configured::segmentation;
pub use models::{LocalModels, ModelFiles};
pub use motion::plan_motion;
pub use plan::{arrange, plan};
pub use relations::{PairRelations, relations};
pub use score::{PlacementScores, score};

/// Segments a frame as the perception service does, with its configuration from the environment (`REPOSE_PERCEPTION__SEGMENTATION__…`).
///
/// # Errors
/// `invalid_argument` that names the field; what perception says of the picture.
pub fn scene_of(frame: &Frame) -> Result<Scene, CallError> {
    Ok(segment(frame, &segmentation()?)?)
}
