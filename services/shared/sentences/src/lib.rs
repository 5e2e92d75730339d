//! Answers and states in sentences: what commands print for people and agents are told. Pure: no I/O, no async, no global state.

pub mod fate;
pub mod placement;
pub mod robot;
