//! The parts of a scene: its points, a summary of each object, where nothing was seen, and what should be looked into.

pub mod cloud;
pub mod summary;
pub mod unseen;
pub mod warnings;
