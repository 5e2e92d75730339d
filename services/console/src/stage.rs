//! How far what is carried out for viewers is.

use serde::Serialize;

/// How far a goal of a sequence is, or a move of an arrangement.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Stage {
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
