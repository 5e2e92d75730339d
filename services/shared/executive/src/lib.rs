//! What has a robot bring goals about on a running system: one after another ([`sequence`]), or together ([`arrangement`]).
//!
//! After every move it looks: whether the goal holds, what else moved, fell or is gone. What slipped is tried again, a bounded number of times.
//! After a stop, whoever latched it, and after a cancel nothing is tried again: a person decides, also where the stop was cleared between two
//! moves. Whoever has a cell and its robot at hand implements [`Site`]: a command, which Ctrl-C stops, or a page, which shows how far it is.

pub mod arrangement;
mod attended;
mod memory;
#[cfg(test)]
mod scripted;
pub mod sequence;
mod site;
mod tried;

pub use site::{AskedRecovery, COUNT, IdentifiedScene, MoveStage, SHOWS_WITHIN, Site, newest_after};
pub use tried::Tried;
