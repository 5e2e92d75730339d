//! ROS 2 on Zenoh as `rmw_zenoh` has it, from Jazzy on: types and their hashes, keys and tokens, attachments. No network.

pub mod attachment;
pub mod catalog;
pub mod definition;
pub mod names;
pub mod token;
pub mod type_hash;
