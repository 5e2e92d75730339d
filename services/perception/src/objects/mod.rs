//! Objects in a frame without labels: connected readings above the supports, cut and joined.

pub mod agreed;
pub mod coarse;
pub mod color;
pub mod components;
pub mod ends;
pub mod find;
pub mod foreground;
pub mod halves;
pub mod holes;
pub mod hollows;
pub mod insides;
pub mod islands;
pub mod learned;
pub mod parts;
pub mod regions;
pub mod seen;
pub mod spread;
pub mod tops;
pub mod upright;
pub mod watershed;
