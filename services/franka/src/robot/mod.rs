//! The robot: the rules ([`side`], [`fade`]), what they need of a robot ([`fci`], [`hand`], [`orders`]), and the real one
//! ([`connection`], [`gripper`]).

pub mod connection;
pub mod fade;
pub mod fci;
pub mod gripper;
pub mod hand;
pub mod identity;
pub mod orders;
pub mod side;
#[cfg(test)]
mod tests;
