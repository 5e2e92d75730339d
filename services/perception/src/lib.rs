//! Perception: frames in, segmented scenes out.
//!
//! The domain is pure: [`segment::segment`] turns a frame into a scene, one algorithm a module. [`frame_folder`] reads frames from
//! disk for the command line.

pub mod borders;
pub mod components;
pub mod frame_folder;
pub mod gravity;
pub mod halves;
pub mod hollows;
pub mod objects;
pub mod point_map;
pub mod segment;
pub mod settings;
pub mod surfaces;
#[cfg(test)]
mod synthetic;
pub mod unlabelled;
pub mod upward;

pub use segment::{SegmentError, Segmented, segment, segment_with_labels};
pub use settings::Settings;
