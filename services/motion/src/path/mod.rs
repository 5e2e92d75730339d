//! The arm's way through joint space: found ([`rrt_connect`]), shortened ([`simplify`]), rounded ([`blend`]) and timed ([`timing`]).

pub mod blend;
pub mod joint_path;
pub mod rrt_connect;
pub mod simplify;
pub mod timed;
pub mod timing;
