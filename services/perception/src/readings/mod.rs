//! A depth picture's readings: in metres, as points, without those that hang in the air, and which of them face up.

pub mod depth;
pub mod flying;
pub mod noise;
pub mod point_map;
pub mod repeats;
pub mod upward;
