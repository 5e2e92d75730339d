//! The robot's side of a cell's keys for a robot of ROS 2: set-points in, trajectories for its controllers out.

pub mod events;
pub mod goal;
pub mod hand;
pub mod link;
pub mod measured;
pub mod side;
#[cfg(test)]
mod tests;
pub mod unended;
