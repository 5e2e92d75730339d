//! The stage of a goal or a move that the console carries out.

use serde::Serialize;

/// The stage of a goal in a sequence, or of a move in an arrangement.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum GoalStage {
    /// Not begun.
    Waiting,
    /// A fresh view is waited for.
    Looking,
    /// The planner searches.
    Placing,
    /// Motion plans.
    Planning,
    /// The robot moves.
    Moving,
    /// Carried out, and its goal holds.
    Held,
    /// Ended without its goal.
    Failed,
}
