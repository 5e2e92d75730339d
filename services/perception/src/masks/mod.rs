//! Instance masks: hints about them, strays in them, the uncertain band around each, and what is left of them without it.

pub mod borders;
pub mod clean;
pub mod hints;
pub mod left_out;
pub mod stray;
