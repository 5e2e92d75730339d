//! Instance masks: hints about them, strays in them, the uncertain band around each, their thin parts, and what is left of them without the band.

pub mod borders;
pub mod clean;
pub mod hints;
pub mod left_out;
pub mod stray;
pub mod thin;
