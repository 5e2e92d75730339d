//! What a planned pick and place is: its phases, and the reasons for what was not chosen.

pub use repose_proto::motion::Phase;

use crate::believed::Heeded;
use crate::collision::Contact;
use crate::grasp::{GraspCandidate, GraspTally};
use crate::path::timing::Trajectory;

/// What the fingers are to do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GripperMove {
    /// Opening to reach, metres.
    pub width_m: f64,
    /// Force when something is in the way, newtons.
    pub force_n: f64,
}

/// A stretch of the plan: the fingers act first, then the arm moves.
#[derive(Debug, Clone, PartialEq)]
pub struct PlannedPhase {
    /// Which.
    pub phase: Phase,
    /// What the fingers do.
    pub gripper: Option<GripperMove>,
    /// How the arm moves.
    pub trajectory: Option<Trajectory>,
}

/// Why the arm cannot carry out a placement: the furthest stage that any grasp reached.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum PlacementFailure {
    /// No grasp can be reached at the object.
    PickUnreachable,
    /// Every reachable grasp is blocked at the object.
    PickBlocked,
    /// No grasp can be reached at the placement.
    PlaceUnreachable,
    /// Every reachable grasp is blocked at the placement.
    PlaceBlocked,
    /// No free path between the two was found.
    NoPath,
}

/// A placement that was passed over for a lower-ranked one, and why.
#[derive(Debug, Clone, PartialEq)]
pub struct SkippedPlacement {
    /// Its rank, from 0.
    pub placement: usize,
    /// What kept the arm from it.
    pub failure: PlacementFailure,
    /// How many grasps failed where.
    pub tally: EndTally,
}

/// How many grasps failed where.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct EndTally {
    /// Out of reach at the object.
    pub pick_unreachable: usize,
    /// Blocked at the object.
    pub pick_blocked: usize,
    /// Out of reach at the placement.
    pub place_unreachable: usize,
    /// Blocked at the placement.
    pub place_blocked: usize,
    /// Without a path between.
    pub no_path: usize,
    /// The last contact that blocked one.
    pub contact: Option<Contact>,
}

impl EndTally {
    /// The furthest that any grasp came.
    pub fn failure(&self) -> PlacementFailure {
        if self.no_path > 0 {
            PlacementFailure::NoPath
        } else if self.place_blocked > 0 {
            PlacementFailure::PlaceBlocked
        } else if self.place_unreachable > 0 {
            PlacementFailure::PlaceUnreachable
        } else if self.pick_blocked > 0 {
            PlacementFailure::PickBlocked
        } else {
            PlacementFailure::PickUnreachable
        }
    }
}

impl std::fmt::Display for EndTally {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { pick_unreachable, pick_blocked, place_unreachable, place_blocked, no_path, contact } = self;
        write!(f, "of the grasps tried, {pick_unreachable} were out of reach and {pick_blocked} blocked at the object, ")?;
        write!(f, "{place_unreachable} out of reach and {place_blocked} blocked at the placement, {no_path} without a path between")?;
        contact.map_or(Ok(()), |contact| write!(f, " (last contact: {contact})"))
    }
}

/// A complete, timed pick and place.
#[derive(Debug, Clone, PartialEq)]
pub struct PickPlacePlan {
    /// The chosen placement's rank, from 0.
    pub placement: usize,
    /// Why not the better ones.
    pub not_chosen: Vec<SkippedPlacement>,
    /// What was heeded of what was not seen.
    pub heeded: Heeded,
    /// The grasp.
    pub grasp: GraspCandidate,
    /// All phases in order.
    pub phases: Vec<PlannedPhase>,
}

/// Why there is no plan.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PickPlaceError {
    /// The query object has no points.
    #[error("object {0} has no points in the scene")]
    NoObject(u16),
    /// The arm cannot start from where it stands.
    #[error("the arm cannot start where it stands: {0}")]
    StartBlocked(Contact),
    /// The object offers no grasp.
    #[error("no grasp on the object: of {} proposed, {} close on nothing, {} are too wide, {} would slide off, {} run into the object, {} touch the scene",
        .0.proposed, .0.empty, .0.too_wide, .0.slanted, .0.object_in_the_way, .0.scene_in_the_way)]
    NoGrasp(GraspTally),
    /// None of the placements can be had.
    #[error("none of the {} placements can be reached; the best: {}", .0.len(), .0.first().map(|n| n.tally.to_string()).unwrap_or_default())]
    NoPlacement(Vec<SkippedPlacement>),
    /// It was told to stop.
    #[error("stopped before a plan was found")]
    Stopped,
}
