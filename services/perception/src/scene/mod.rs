//! The parts of a scene: its points, a summary of each object, and where nothing was seen.

pub mod cloud;
pub mod summary;
pub mod unseen;
