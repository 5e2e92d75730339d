//! What geometry says of one candidate, a question a file. No network, no search.
//!
//! A check that can fail answers by how much it is missed: a plain non-negative number that grows with the miss, so that a search without
//! feasible candidates knows which way to go.

pub mod carriers;
pub mod clearance;
pub mod contact;
pub mod footing;
pub mod obstruction;
pub mod prisms;
pub mod reach;
pub mod region;
pub mod rules;
pub mod unseen;
pub mod visibility;

/// Metres by which a constraint is missed count this much: a tenth of a metre as one.
pub const MISS_PER_METRE: f64 = 10.0;
