//! What the planner answers on synthetic scenes, with and without networks.

mod arrange;
pub(crate) mod learned;
mod plan;
pub(crate) mod synthetic;
