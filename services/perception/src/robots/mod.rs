//! Robots in the picture: what shows of them is neither object nor obstacle nor free, but unseen.

pub mod body;
pub mod calibration;
pub mod held;
pub mod nearness;
pub mod self_filter;
pub mod shown;
pub mod states;
