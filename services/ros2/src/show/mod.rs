//! What others are shown: scenes and placements as messages of ROS.

pub mod link;
pub mod messages;
