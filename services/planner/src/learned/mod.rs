//! What is learned: the port to the networks, the prior's mixture, and the forecasts by boosted trees.

pub mod forecast;
pub mod mixture;
pub mod models;
pub mod neighbours;
pub mod stability;
pub mod standing;
pub mod success;
