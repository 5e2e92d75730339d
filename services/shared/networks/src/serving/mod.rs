//! Scoring: the networks on the fused kernels, without candle.
//!
//! A candidate is one unit of work for one thread, in one order of operations; batches only spread such units over threads.

mod context;
mod kept;
mod models;
mod pairs;
mod point_net;
mod shared;
mod spread;

pub use context::{Candidate, InputError, SceneContext};
pub(crate) use models::EMBEDDED;
pub use models::{Mixture, Models};
pub use pairs::Pairs;
pub use spread::spread;
