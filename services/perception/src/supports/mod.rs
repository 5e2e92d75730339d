//! What things stand on: which way is up, and the horizontal surfaces.

pub mod gravity;
pub mod surfaces;
