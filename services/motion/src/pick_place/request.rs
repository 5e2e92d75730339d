//! What a pick and place is planned for.

use nalgebra::Isometry3;
use repose_panda::Joints;

use crate::grasp::GraspCandidate;
use crate::scene::PlanningScene;

/// What to plan.
#[derive(Debug, Clone, Copy)]
pub struct PickPlaceRequest<'a> {
    /// The scene.
    pub scene: &'a PlanningScene,
    /// The object to move.
    pub query: u16,
    /// Where it may go, best first: `placed_from_observed` in the world frame.
    pub placements: &'a [Isometry3<f64>],
    /// Where the arm stands, radians.
    pub start: &'a Joints,
    /// Grasps from elsewhere, in the order in which they are tried; none to find them here.
    pub grasps: Option<&'a [GraspCandidate]>,
    /// The source of every random number.
    pub seed: u64,
}
