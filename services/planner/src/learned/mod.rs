//! What is learned: the port to the networks, the prior's mixture, and the trees that predict stability.

pub mod boosted_trees;
pub mod mixture;
pub mod models;
pub mod stability;
