//! What is believed of the scene beyond what was seen: which places are free, how things go on where they are hidden, and how much of that a
//! plan heeds.

pub mod believed;
pub mod hidden;
pub mod sight;
