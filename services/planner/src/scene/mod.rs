//! A scene prepared for planning, the object to move in it, and where that may go.

pub mod candidate;
pub mod kept;
pub mod moved;
pub mod point_grid;
pub mod prepared;
pub mod queries;
pub mod query;
pub mod traits;
pub mod turned;
