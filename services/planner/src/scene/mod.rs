//! A scene prepared for planning, the object to move in it, and where that may go.

pub mod candidate;
pub mod moved;
pub mod prepared;
pub mod query;
pub mod traits;
pub mod turned;
