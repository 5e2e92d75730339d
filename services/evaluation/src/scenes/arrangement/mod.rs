//! Arrangement tasks: a table on which several goals shall hold at the end, with a known solution, and what a planner's moves come to.
//!
//! A task is an arranged table that was disturbed ([`draft`]): its goals are read off the arranged one, its solution is the way back, which is
//! tried in the true world before the task counts ([`task`]). Moves are carried out there one after another, each let go where it was
//! planned to go, without another look ([`carried_out`]) and with one after each ([`looking`]), and counted ([`trial`]).

pub mod carried_out;
mod draft;
pub mod failure;
mod layout;
pub mod looking;
mod planned;
pub mod task;
pub mod trial;
mod true_view;
