//! What things stand on: which way is up, and the horizontal surfaces.

pub mod extent;
pub mod gravity;
pub mod levels;
pub mod plane;
pub mod surfaces;
