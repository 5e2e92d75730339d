//! The planner: where can an object be set down so that a goal holds and it stays?
//!
//! The domain is pure and synchronous: [`plan()`] searches on a [`Prepared`] scene (Algorithm 1 of the paper, `search`), asking learned
//! models through the [`Models`] port, or none for the `geometric` variant. `settings` says what each variant is made of.

pub mod answers;
pub mod candidate;
pub mod columns;
pub mod constraints;
pub mod cost;
pub mod footing;
pub mod judge;
pub mod judged;
pub mod mixture;
pub mod models;
pub mod modes;
pub mod obstruction;
pub mod plan;
pub mod prepared;
pub mod proposals;
pub mod query;
pub mod rules;
pub mod search;
pub mod settings;
pub mod shape;
pub mod surrogate;
pub mod view;

#[cfg(test)]
mod plan_tests;
#[cfg(test)]
pub(crate) mod synthetic;

pub use models::{Models, NoModels};
pub use plan::{Report, Step, plan, plan_with_report};
pub use prepared::Prepared;
pub use search::Stop;
