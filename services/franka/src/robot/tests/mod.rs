//! The driver's rules on a robot made up for it.

mod bench;
mod cases;
mod properties;
